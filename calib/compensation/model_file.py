"""``model.json``: the calibrated machine, whole, for programs that want more than a URDF can hold."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)

from calib.assessment.uncertainty import Uncertainty, shifted
from calib.compensation.gaussian import GaussianResiduals, load_gaussian
from calib.compensation.grid import SectorGrid, load_grid
from calib.compensation.uncertainty_file import UNCERTAINTY_FILE, load_uncertainty
from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import JobError, OutputError, RobotError
from calib.foundations.files import LARGEST_JSON, read_bytes
from calib.foundations.folders import reading_folder
from calib.foundations.json_text import NotJsonError, parse_json
from calib.identification.fit import Fit
from calib.identification.machine import Frames
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.gravity import STANDARD_GRAVITY, Payload
from calib.robot.joint_terms import is_term_of, with_joint_terms
from calib.robot.load import load_robot
from calib.robot.robot import ClosedLoop, Coupling, Deviations, Robot
from calib.robot.transmission import JointTerm, TermKind
from calib.robot.urdf import LARGEST_URDF, parse_urdf

MODEL_FILE = "model.json"
NOMINAL_FILE: Final = "nominal.urdf"
GRID_FILE: Final = "grid.npz"
GAUSSIAN_FILE: Final = "gaussian.npz"

ResidualFile = Literal["grid.npz", "gaussian.npz"]


# In m, rad and kg, as in a URDF: beyond any machine.
Number = Annotated[float, Field(ge=-1e6, le=1e6)]
# Quaternions are written to the last digit; anything farther off was edited by hand.
_NORM_TOLERANCE = 1e-6


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


def _unit(quaternion: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    norm = float(np.linalg.norm(quaternion))
    if not abs(norm - 1.0) <= _NORM_TOLERANCE:
        raise ValueError(f"has the norm {norm:.6g}, and must have 1")
    return quaternion


class PoseEntry(_Strict):
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


class JointEntry(_Strict):
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


class CouplingEntry(_Strict):
    """Position of a moving joint = sum of multiples of readings + constant + its share of the offsets."""

    joint: str
    readings: dict[str, float]
    constant: float
    offsets: dict[str, float]


class DriverEntry(_Strict):
    """A joint coupled to several drivers, as the job says."""

    joint: str
    drivers: dict[str, Number]
    offset: Number


class LoopEntry(_Strict):
    """A closed loop, as the job says."""

    name: str
    frames: tuple[str, str]
    closes: tuple[Literal["x", "y", "z"], ...]
    passive: tuple[str, ...]


class TermEntry(_Strict):
    """A joint term: the reading, or the link before a joint, moves on by ``amount`` (SI) times what its kind says."""

    reading: str
    kind: TermKind
    order: int = Field(ge=0)
    body: str = ""
    amount: Number

    @model_validator(mode="after")
    def _has_an_order_if_it_is_a_harmonic(self) -> "TermEntry":
        if (self.order > 0) != (self.kind in ("cos", "sin")):
            raise ValueError("a term has an order if, and only if, it is a harmonic")
        if bool(self.body) != (self.kind == "moment"):
            raise ValueError("a term has a body if, and only if, it is a moment")
        return self

    @property
    def term(self) -> JointTerm:
        """What it is, without its amount."""
        return JointTerm(self.reading, self.kind, self.order, self.body)

    @model_serializer(mode="wrap")
    def _without_an_empty_body(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # As files had it before masses could be at joints.
        return {key: value for key, value in plain(self).items() if value != "" or key != "body"}


class PayloadEntry(_Strict):
    """What the tip link carries: kg, and m in its frame."""

    mass: Number = Field(ge=0.0)
    position: tuple[Number, Number, Number]


class ModelFile(_Strict):
    """Schema 1 of ``model.json``. Lengths in m, angles in rad."""

    schema_: Literal[1] = Field(alias="schema")
    urdf: Literal["nominal.urdf"]
    base_link: str
    tip: str
    joints: tuple[JointEntry, ...]
    transmission: tuple[CouplingEntry, ...]
    base: PoseEntry
    tools: dict[str, PoseEntry]
    residual_model: ResidualFile | None = None
    couplings: tuple[DriverEntry, ...] = ()
    loops: tuple[LoopEntry, ...] = ()
    terms: tuple[TermEntry, ...] = ()
    gravity: tuple[Number, Number, Number] = STANDARD_GRAVITY
    payload: PayloadEntry | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedModel:
    """A calibrated machine read back from its folder. Made by :func:`load_model`.

    ``base`` (4, 4): the robot's base in the instrument's frame; ``tools``: poses (4, 4) in the tip link, by name.
    ``residual_model``: errors of tool positions that the rest leaves, over joint space, or None. ``uncertainty``: how
    sure all of it is, for :func:`calib.tool_uncertainty`, or None where the folder does not say.
    """

    robot: Robot
    deviations: Deviations
    base: Array
    tools: Mapping[str, Array]
    residual_model: SectorGrid | GaussianResiduals | None = None
    uncertainty: Uncertainty | None = None

    @checked
    def tips(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return the placements (N, 4, 4) of the tip link in the base link at readings (N, nr), in rad and m.

        Without the residual model. Raises RobotError for a joint term that needs ``conditions`` which are not given.
        """
        return self.robot.tips(readings, self.deviations, conditions)

    @checked
    def placements(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return the placements (N, 4, 4) of the tip link in the base link, positions shifted by the residual model.

        Where it knows nothing, it adds nothing. Raises as :meth:`tips` does.
        """
        tips = self.tips(readings, conditions)
        return tips if self.residual_model is None else shifted(self.residual_model, tips, readings)

    @checked
    def predict(self, readings: Array, tool: str = "tool", conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return the placements (N, 4, 4) of a tool in the instrument's frame. Raises KeyError for an unknown tool.

        With the residual model, as :meth:`placements`.
        """
        return np.asarray(self.base @ self.placements(readings, conditions) @ self.tools[tool])


def residual_file(known: SectorGrid | GaussianResiduals | None) -> ResidualFile | None:
    """Return the name of the file that holds a residual model beside ``model.json``."""
    if known is None:
        return None
    return GRID_FILE if isinstance(known, SectorGrid) else GAUSSIAN_FILE


def model_file(fit: Fit, residuals: ResidualFile | None = None) -> ModelFile:
    """Return the contents of ``model.json`` for a fit; ``residuals``: the residual model that lies beside it."""
    robot, machine, deviations = fit.robot, fit.machine, fit.deviations
    offsets = iter(map(float, deviations.offsets))
    joints = tuple(
        JointEntry(
            name=joint.name,
            type=joint.type,
            deviation=_six(d),
            offset=None if joint.type == "fixed" else next(offsets),
        )
        for joint, d in zip(robot.chain, deviations.placements, strict=True)
    )
    tools = dict(zip(fit.measurements[0].tools, map(PoseEntry.of, machine.frames.tools), strict=True))
    return ModelFile(
        schema=1,
        urdf=NOMINAL_FILE,
        base_link=robot.base,
        tip=robot.tip,
        joints=joints,
        transmission=_transmission(robot),
        base=PoseEntry.of(machine.frames.base),
        tools=tools,
        residual_model=residuals,
        couplings=tuple(DriverEntry(joint=c.joint, drivers=dict(c.drivers), offset=c.offset) for c in robot.couplings),
        loops=tuple(
            LoopEntry(name=loop.name, frames=loop.frames, closes=loop.closes, passive=loop.passive)
            for loop in robot.closed_loops
        ),
        terms=tuple(
            TermEntry(reading=term.reading, kind=term.kind, order=term.order, body=term.body, amount=float(amount))
            for term, amount in zip(robot.terms, deviations.terms, strict=True)
        ),
        gravity=robot.gravity,
        payload=None
        if robot.payload is None
        else PayloadEntry(mass=robot.payload.mass, position=robot.payload.position),
    )


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
def load_model(folder: str | Path) -> CalibratedModel:
    """Read the calibrated machine from the folder that ``calib calibrate`` wrote.

    Raises OutputError when the folder holds no readable model.
    """
    folder = Path(folder)
    with reading_folder(folder):
        return _loaded(folder)


def _loaded(folder: Path) -> CalibratedModel:
    path, urdf = folder / MODEL_FILE, folder / NOMINAL_FILE
    try:
        source = read_bytes(path, JobError, LARGEST_JSON)
    except JobError as e:
        raise OutputError(str(e)) from e
    model = _parsed(source, path)
    try:
        robot = load_robot(
            parse_urdf(read_bytes(urdf, RobotError, LARGEST_URDF), str(urdf)),
            model.tip,
            model.base_link,
            couplings=[Coupling(c.joint, c.drivers, c.offset) for c in model.couplings],
            loops=[ClosedLoop(loop.name, loop.frames, loop.closes, loop.passive) for loop in model.loops],
            gravity=model.gravity,
            payload=None if model.payload is None else Payload(model.payload.mass, model.payload.position),
        )
        terms = tuple(entry.term for entry in model.terms)
        if len(set(terms)) < len(terms) or not all(is_term_of(robot, term) for term in terms):
            raise OutputError(f"{path}: its joint terms are not those of {NOMINAL_FILE}, or one is there twice.")
        equipped = with_joint_terms(robot, terms)
    except RobotError as e:
        raise OutputError(f"{path}: its robot cannot be used: {e}") from e
    if [(joint.name, joint.type) for joint in robot.chain] != [(joint.name, joint.type) for joint in model.joints]:
        raise OutputError(f"{path}: its joints are not those of {NOMINAL_FILE}.")
    if _transmission(robot) != model.transmission:
        raise OutputError(f"{path}: its transmission is not that of {NOMINAL_FILE}.")
    offsets = [joint.offset for joint in model.joints if joint.offset is not None]
    amounts = [term.amount for term in model.terms]
    deviations = Deviations(
        read_only([joint.deviation for joint in model.joints]), read_only(offsets), read_only(amounts)
    )
    base = read_only(model.base.placement)
    tools = {name: read_only(tool.placement) for name, tool in model.tools.items()}
    doubts = folder / UNCERTAINTY_FILE
    known = os.path.lexists(doubts) and bool(tools)
    frames = Frames(base, np.stack(list(tools.values()))) if known else None
    residuals = _residual_model(folder, model.residual_model, robot)
    uncertainty = None
    if frames is not None:
        uncertainty = load_uncertainty(doubts, equipped, deviations, frames, tuple(tools))
        uncertainty = replace(uncertainty, residual_model=residuals)
    return CalibratedModel(equipped, deviations, base, tools, residuals, uncertainty)


def _residual_model(folder: Path, name: ResidualFile | None, robot: Robot) -> SectorGrid | GaussianResiduals | None:
    if name is None:
        return None
    return (load_grid if name == GRID_FILE else load_gaussian)(folder / name, robot.readings)


def _parsed(source: bytes, path: Path) -> ModelFile:
    """Return the contents of a model file, or raise OutputError with the place of the first thing that is wrong."""
    try:
        parse_json(source)  # pydantic takes the last of two values under one name
        return ModelFile.model_validate_json(source)
    except NotJsonError as e:
        raise OutputError(f"{path}: {e}.") from e
    except ValidationError as e:
        first = e.errors(include_url=False)[0]
        if first["type"] == "json_invalid":
            raise OutputError(f"{path}: is not JSON, or is truncated.") from e
        place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"])
        reason = {"missing": "is missing", "extra_forbidden": "is not known"}.get(first["type"], "has a wrong value")
        raise OutputError(f"{path}: is not a model of this toolkit: {place[1:101]} {reason}.") from e


def _six(d: Array) -> tuple[float, float, float, float, float, float]:
    a, b, c, e, f, g = map(float, d)
    return a, b, c, e, f, g


def _nonzero(names: list[str], row: Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, row, strict=True) if value != 0.0}


def model_json(fit: Fit, residuals: ResidualFile | None = None) -> str:
    """Return ``model.json`` of a fit as text."""
    contents: dict[str, Any] = model_file(fit, residuals).model_dump(by_alias=True)
    return json.dumps(contents, indent=2, allow_nan=False) + "\n"
