"""``model.json``: the calibrated machine, whole, for programs that want more than a URDF can hold."""

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.choices import PlacedIn
from calib.foundations.errors import JobError, OutputError, RobotError
from calib.foundations.files import LARGEST_JSON, read_bytes
from calib.foundations.folders import reading_folder
from calib.foundations.json_text import NotJsonError, first_wrong, validated
from calib.foundations.linear import triangle
from calib.foundations.ranges import MOST_SETUPS, MOST_TERMS, MOST_TOOLS
from calib.foundations.words import shown
from calib.machine.calibrated import CalibratedMachine
from calib.machine.gaussian import GaussianResiduals, gaussian_bytes, load_gaussian
from calib.machine.grid import SectorGrid, grid_bytes, load_grid
from calib.machine.place import Place, Placed
from calib.machine.residual_model import ResidualModel
from calib.machine.run import MODEL_FILE, Sha256, run_name, text_digest
from calib.machine.uncertainty_file import UNCERTAINTY_FILE, Strict, load_uncertainty, uncertainty_json
from calib.machine.urdf import calibrated_urdf
from calib.measurement.measurements import ONLY_SETUP
from calib.robot.gravity import STANDARD_GRAVITY, Load, Payload
from calib.robot.joint_terms import foreign, in_setup, with_joint_terms
from calib.robot.load import load_robot, robot_in_urdf
from calib.robot.robot import ClosedLoop, Coupling, Deviations, Robot
from calib.robot.terms import NAMED, JointTerm, kind_of
from calib.robot.urdf import LARGEST_URDF, parse_urdf

NOMINAL_FILE: Final = "nominal.urdf"
CALIBRATED_FILE = "calibrated.urdf"
# Geometry of ``model.json``, for whoever adds its joint terms or closes its loops.
GEOMETRY_FILE = "model.urdf"
GRID_FILE: Final = "grid.npz"
GAUSSIAN_FILE: Final = "gaussian.npz"

ResidualFile = Literal["grid.npz", "gaussian.npz"]


# In m, rad and kg, as in a URDF: beyond any machine.
Number = Annotated[float, Field(ge=-1e6, le=1e6)]
# Quaternions are written to the last digit; anything farther off was edited by hand.
_NORM_TOLERANCE = 1e-6


def _unit(quaternion: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    norm = float(np.linalg.norm(quaternion))
    if not abs(norm - 1.0) <= _NORM_TOLERANCE:
        raise ValueError(f"has the norm {norm:.6g}, and must have 1")
    return quaternion


def _equally_long(rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    if len({len(row) for row in rows}) != 1:
        raise ValueError("the rows are not equally long")
    return rows


_SixRows = Annotated[tuple[tuple[Number, ...], ...], Field(min_length=6, max_length=6), AfterValidator(_equally_long)]


class PoseEntry(Strict):
    """A pose: position in m, quaternion in the order w, x, y, z."""

    position: tuple[Number, Number, Number]
    quaternion: Annotated[tuple[Number, Number, Number, Number], AfterValidator(_unit)]

    @classmethod
    def of(cls, T: Array) -> "PoseEntry":
        """Return the entry of a placement (4, 4)."""
        x, y, z = map(float, T[:3, 3])
        qw, qx, qy, qz = map(float, rigid.quaternion_of(T[:3, :3]))
        return cls(position=(x, y, z), quaternion=(qw, qx, qy, qz))

    @property
    def placement(self) -> Array:
        """The placement (4, 4)."""
        return rigid.placement(rigid.rotation_of_quaternion(np.array(self.quaternion)), np.array(self.position))


class JointEntry(Strict):
    """A joint of the chain: ``deviation`` (tx, ty, tz, rx, ry, rz) in m and rad, ``offset`` in rad or m if it moves."""

    name: str
    type: Literal["revolute", "prismatic", "fixed"]
    deviation: tuple[Number, Number, Number, Number, Number, Number]
    offset: Number | None

    @model_validator(mode="after")
    def _has_an_offset_if_it_moves(self) -> "JointEntry":
        if (self.offset is None) != (self.type == "fixed"):
            raise ValueError("a joint has an offset if, and only if, it moves")
        return self


class CouplingEntry(Strict):
    """Position of a moving joint = sum of multiples of readings + constant + its share of the offsets."""

    joint: str
    readings: dict[str, float]
    constant: float
    offsets: dict[str, float]


def _known_kind(name: str) -> str:
    if name not in NAMED:
        raise ValueError(f"{shown(name)} is no kind of joint terms")
    return name


class TermEntry(Strict):
    """A joint term: the reading, or the link before a joint, moves by ``coefficient`` (SI) times what its kind says."""

    reading: str
    kind: Annotated[str, AfterValidator(_known_kind)]
    order: int = Field(ge=0)
    body: str = ""
    coefficient: Number

    @model_validator(mode="after")
    def _is_as_its_kind(self) -> "TermEntry":
        if not kind_of(self.term).well_formed(self.term):
            raise ValueError("a term has an order, or a body, if, and only if, its kind has")
        return self

    @property
    def term(self) -> JointTerm:
        """What it is, without its coefficient."""
        return JointTerm(self.reading, self.kind, self.order, self.body)

    @model_serializer(mode="wrap")
    def _without_an_empty_body(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # As files had it before masses could be at joints.
        return {key: value for key, value in plain(self).items() if value != "" or key != "body"}


class GeometryEntry(Strict):
    """The machine of ``calibrated.urdf``, where a URDF cannot hold the whole one."""

    joints: tuple[JointEntry, ...]
    base: PoseEntry
    setups: dict[str, PoseEntry] = Field(default_factory=dict)
    tools: dict[str, PoseEntry]


class PlaceEntry(Strict):
    """What errors of the arm that touched do to the place, as :class:`calib.machine.place.Place` has them."""

    factor: _SixRows
    undetermined: _SixRows
    degrees_of_freedom: Annotated[Number, Field(gt=0.0)] | None


class PlacedEntry(Strict):
    """In whose frame the bases are."""

    within: PlacedIn
    by_arm: PlaceEntry | None = None

    @classmethod
    def of(cls, placed: Placed) -> "PlacedEntry":
        """Return the entry."""
        by = placed.by_arm
        if by is None:
            return cls(within=placed.within)
        # As many columns as the covariance needs.
        factor, freedom = triangle(by.factor.T).T, None if np.isinf(by.freedom) else by.freedom
        entry = PlaceEntry(factor=_rows(factor), undetermined=_rows(by.undetermined_basis), degrees_of_freedom=freedom)
        return cls(within=placed.within, by_arm=entry)

    @property
    def placed(self) -> Placed:
        """What it says."""
        if self.by_arm is None:
            return Placed(self.within)
        factor, undetermined = (
            read_only(np.array(rows).reshape(6, -1)) for rows in (self.by_arm.factor, self.by_arm.undetermined)
        )
        freedom = self.by_arm.degrees_of_freedom
        return Placed(self.within, Place(factor, undetermined, float("inf") if freedom is None else freedom))


class ModelFile(Strict):
    """Schema 1 of ``model.json``. Lengths in m, angles in rad.

    ``run``: of whose results it is one, as the files beside it name it; ``urdf_sha256``: of ``urdf``, its lines ended
    by a newline alone. Earlier versions wrote neither.
    ``base``: in the set-up named ``setup``; ``setups``: the base in the others; ``loads``: gravity and payload in those
    where they are not ``gravity`` and ``payload``. ``links``: the tip and other links that
    the robot was loaded with; ``tool_tips``: which of them carries a tool that is not on the tip. ``placed``: in whose
    frame the bases are.
    """

    schema_: Literal[1] = Field(alias="schema")
    run: Sha256 | None = None
    urdf: Literal["nominal.urdf"]
    urdf_sha256: Sha256 | None = None
    base_link: str
    tip: str
    joints: tuple[JointEntry, ...]
    transmission: tuple[CouplingEntry, ...]
    base: PoseEntry
    setup: str = ONLY_SETUP
    setups: dict[str, PoseEntry] = Field(default_factory=dict)
    tools: dict[str, PoseEntry]
    links: tuple[str, ...] = ()
    tool_tips: dict[str, str] = Field(default_factory=dict)
    residual_model: ResidualFile | None = None
    couplings: tuple[Coupling, ...] = ()
    loops: tuple[ClosedLoop, ...] = ()
    terms: tuple[TermEntry, ...] = ()
    gravity: tuple[Number, Number, Number] = STANDARD_GRAVITY
    payload: Payload | None = None
    loads: dict[str, Load] = Field(default_factory=dict)
    in_urdf: GeometryEntry | None = None
    placed: PlacedEntry | None = None

    @model_validator(mode="after")
    def _has_each_setup_once(self) -> "ModelFile":
        if self.setup in self.setups:
            raise ValueError("a set-up has one pose of the base")
        return self


def residual_file(known: ResidualModel | None) -> ResidualFile | None:
    """Return the name of the file that holds a residual model beside ``model.json``."""
    if known is None:
        return None
    return GRID_FILE if isinstance(known, SectorGrid) else GAUSSIAN_FILE


def model_file(machine: CalibratedMachine, run: str | None = None) -> ModelFile:
    """Return the contents of ``model.json`` of a machine, as one of the results of a run."""
    robot, deviations, geometry = machine.robot, machine.deviations, machine.in_urdf
    return ModelFile(
        schema=1,
        run=run,
        urdf=NOMINAL_FILE,
        urdf_sha256=text_digest(robot.urdf.source),
        base_link=robot.base,
        tip=robot.tip,
        **_geometry_of(machine),
        transmission=_transmission(robot),
        setup=machine.setup,
        links=robot.links if len(robot.links) > 1 else (),
        tool_tips=dict(machine.tool_tips),
        residual_model=residual_file(machine.residual_model),
        couplings=robot.couplings,
        loops=robot.closed_loops,
        terms=tuple(
            TermEntry(
                reading=term.reading, kind=term.kind, order=term.order, body=term.body, coefficient=float(coefficient)
            )
            for term, coefficient in zip(robot.terms, deviations.terms, strict=True)
        ),
        gravity=robot.gravity,
        payload=robot.payload,
        loads=dict(robot.loads),
        in_urdf=None if geometry is None else GeometryEntry(**_geometry_of(geometry)),
        placed=None if machine.placed is None else PlacedEntry.of(machine.placed),
    )


def _geometry_of(machine: CalibratedMachine) -> dict[str, Any]:
    """Return what :class:`GeometryEntry` holds of a machine, and a whole model as well."""
    offsets = iter(map(float, machine.deviations.offsets))
    joints = tuple(
        JointEntry(
            name=joint.name,
            type=joint.type,
            deviation=_six(d),
            offset=None if joint.type == "fixed" else next(offsets),
        )
        for joint, d in zip(machine.robot.chain, machine.deviations.placements, strict=True)
    )
    setups, tools = ({name: PoseEntry.of(T) for name, T in of.items()} for of in (machine.others, machine.tools))
    return {"joints": joints, "base": PoseEntry.of(machine.base), "setups": setups, "tools": tools}


def _transmission(robot: Robot) -> tuple[CouplingEntry, ...]:
    names = [robot.chain[i].name for i in robot.moving]
    readings = [reading.name for reading in robot.readings]
    return tuple(
        CouplingEntry(
            joint=name,
            readings=_nonzero(readings, robot.coupling[j]),
            constant=float(robot.coupling_offset[j]),
            offsets=_nonzero(names, robot.offset_coupling[j]),
        )
        for j, name in enumerate(names)
    )


@checked
def load_machine(folder: str | Path) -> CalibratedMachine:
    """Read the calibrated machine from the folder that ``calib calibrate`` or :func:`calib.save` wrote.

        machine = calib.load_machine("results")

    Raises OutputError when the folder holds no readable model.
    """
    folder = Path(folder)
    with reading_folder(folder):
        return _loaded(folder)


def _loaded(folder: Path) -> CalibratedMachine:
    path, urdf = folder / MODEL_FILE, folder / NOMINAL_FILE
    try:
        source = read_bytes(path, JobError, LARGEST_JSON)
    except JobError as e:
        raise OutputError(str(e)) from e
    model = _parsed(source, path)
    _refuse_many(model, path)
    try:
        robot = load_robot(
            parse_urdf(read_bytes(urdf, RobotError, LARGEST_URDF), str(urdf)),
            model.tip,
            model.base_link,
            links=model.links,
            couplings=model.couplings,
            loops=model.loops,
            gravity=model.gravity,
            payload=model.payload,
        ).with_loads(model.loads)
        terms = tuple(entry.term for entry in model.terms)
        if len(set(terms)) < len(terms) or foreign(robot, terms):
            raise OutputError(f"{path}: its joint terms are not those of {NOMINAL_FILE}, or one appears twice.")
        equipped = in_setup(with_joint_terms(robot, terms), model.setup)
    except RobotError as e:
        raise OutputError(f"{path}: its robot cannot be used: {e}") from e
    _refuse_other_joints(robot, model.joints, path)
    if _transmission(robot) != model.transmission:
        raise OutputError(f"{path}: its couplings are not those of {NOMINAL_FILE}.")
    if model.urdf_sha256 not in (None, text_digest(robot.urdf.source)):
        raise OutputError(f"{urdf}: is not the URDF of {MODEL_FILE} beside it, as their SHA-256 differ.")
    deviations = replace(_deviations(model.joints), terms=read_only([term.coefficient for term in model.terms]))
    base = read_only(model.base.placement)
    tools = {name: read_only(tool.placement) for name, tool in model.tools.items()}
    if alien := [name for name, tip in model.tool_tips.items() if name not in tools or tip not in robot.links]:
        raise OutputError(f"{path}: the tool {alien[0]!r} is on no link of {NOMINAL_FILE}.")
    others = {name: read_only(other.placement) for name, other in model.setups.items()}
    in_urdf = None if model.in_urdf is None else _geometry(robot, model, model.in_urdf, path)
    path, counts = folder / UNCERTAINTY_FILE, (1 + len(others), len(tools))
    uncertainty = load_uncertainty(path, equipped, *counts) if tools and os.path.lexists(path) else None
    residuals = _residual_model(folder, model.residual_model, robot)
    placed = None if model.placed is None else model.placed.placed
    return CalibratedMachine(
        equipped, deviations, base, tools, residuals, uncertainty, model.setup, others, model.tool_tips, in_urdf, placed
    )


def _refuse_many(model: ModelFile, path: Path) -> None:
    """Raise OutputError where there are more set-ups, tools or joint terms than a calibration finds."""
    for what, count, most in (
        ("set-ups", 1 + len(model.setups), MOST_SETUPS),
        ("tools", len(model.tools), MOST_TOOLS),
        ("joint terms", len(model.terms), MOST_TERMS),
    ):
        if count > most:
            raise OutputError(f"{path}: has {count} {what}; allowed are {most}.")


def _refuse_other_joints(robot: Robot, joints: Sequence[JointEntry], path: Path) -> None:
    if [(joint.name, joint.type) for joint in robot.chain] != [(joint.name, joint.type) for joint in joints]:
        raise OutputError(f"{path}: its joints are not those of {NOMINAL_FILE}.")


def _deviations(joints: Sequence[JointEntry]) -> Deviations:
    offsets = [joint.offset for joint in joints if joint.offset is not None]
    return Deviations(read_only([joint.deviation for joint in joints]), read_only(offsets))


def _geometry(robot: Robot, model: ModelFile, entry: GeometryEntry, path: Path) -> CalibratedMachine:
    """Return the machine of the calibrated URDF; ``robot`` is the whole one, without its terms."""
    held = (robot_in_urdf(robot) if robot.loops or robot.couplings else None) or robot
    _refuse_other_joints(held, entry.joints, path)
    tools = {name: read_only(tool.placement) for name, tool in entry.tools.items()}
    if tools.keys() != model.tools.keys() or entry.setups.keys() != model.setups.keys():
        raise OutputError(f"{path}: in_urdf has other tools or set-ups than the machine.")
    return CalibratedMachine(
        held,
        _deviations(entry.joints),
        read_only(entry.base.placement),
        tools,
        setup=model.setup,
        others={name: read_only(other.placement) for name, other in entry.setups.items()},
        tool_tips=model.tool_tips,
    )


def _residual_model(folder: Path, name: ResidualFile | None, robot: Robot) -> SectorGrid | GaussianResiduals | None:
    if name is None:
        return None
    return (load_grid if name == GRID_FILE else load_gaussian)(folder / name, robot.readings)


def _parsed(source: bytes, path: Path) -> ModelFile:
    """Return the contents of a model file, or raise OutputError with the place of the first thing that is wrong."""
    try:
        model = validated(ModelFile, source)
    except NotJsonError as e:
        raise OutputError(f"{path}: {e}.") from e
    except ValidationError as e:
        raise OutputError(f"{path}: is not a model of this toolkit: {first_wrong(e)}.") from e
    # Who names a run writes every key: without it, a residual model or a payload would be dropped unseen.
    left_out = [name for name in ModelFile.model_fields if name not in model.model_fields_set]
    if model.run is not None and left_out:
        raise OutputError(f"{path}: is not a model of this toolkit: {left_out[0]} is missing.")
    return model


def _rows(M: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, M.tolist()))


def _six(d: Array) -> tuple[float, float, float, float, float, float]:
    a, b, c, e, f, g = map(float, d)
    return a, b, c, e, f, g


def _nonzero(names: list[str], row: Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, row, strict=True) if value != 0.0}


def model_json(machine: CalibratedMachine, run: str | None = None) -> str:
    """Return ``model.json`` of a machine as text, as one of the results of a run."""
    contents: dict[str, Any] = model_file(machine, run).model_dump(by_alias=True)
    return json.dumps(contents, indent=2, allow_nan=False) + "\n"


def run_of(machine: CalibratedMachine) -> str:
    """Return the name of the run that a machine is the result of.

    Of its numbers, so that the same calibration has the same name. What else a run writes follows from these.
    """
    known, residuals = machine.uncertainty, machine.residual_model
    arrays = (None if known is None else known.factor, getattr(residuals, "errors", None))
    return run_name([model_json(machine).encode(), *(b"" if array is None else array.tobytes() for array in arrays)])


def machine_files(machine: CalibratedMachine) -> dict[str, bytes | str]:
    """Return the files that hold a machine, by name: what :func:`load_machine` reads, and the calibrated URDF.

    Raises OutputError when the URDF cannot hold the deviations.
    """
    robot, known, geometry = machine.robot, machine.residual_model, machine.geometry
    run = run_of(machine)
    files: dict[str, bytes | str] = {
        CALIBRATED_FILE: calibrated_urdf(geometry.robot, geometry.deviations),
        NOMINAL_FILE: robot.urdf.source,
        MODEL_FILE: model_json(machine, run),
    }
    if geometry is not machine:
        files[GEOMETRY_FILE] = calibrated_urdf(robot, machine.deviations)
    if machine.uncertainty is not None:
        files[UNCERTAINTY_FILE] = uncertainty_json(machine.uncertainty, robot, run)
    if isinstance(known, SectorGrid):
        files[GRID_FILE] = grid_bytes(known, run)
    elif isinstance(known, GaussianResiduals):
        files[GAUSSIAN_FILE] = gaussian_bytes(known, run)
    elif known is not None:
        raise OutputError(
            f"a residual model of the type {type(known).__name__} has no file; allowed are grids and "
            "Gaussian processes of this toolkit."
        )
    return files
