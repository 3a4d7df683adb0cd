"""The arm and its error model, as the sections of a job state them."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.errors import JobError
from calib.foundations.files import read_bytes
from calib.foundations.units import Dimension
from calib.foundations.words import shown
from calib.identification.error_model import ErrorModel, Known, error_model
from calib.identification.parameters import Prior, Priors, refuse_none_free
from calib.identification.relations import Relation
from calib.identification.set_ups import SetUp
from calib.identification.targets import Target
from calib.job import schema
from calib.job.fields import Quantity
from calib.job.read import read_job
from calib.measurement.checks import Finding
from calib.measurement.measurements import ONLY_SETUP
from calib.robot.deviation import axis_frame
from calib.robot.dh.free import Free
from calib.robot.gravity import Load, Payload
from calib.robot.load import load_robot
from calib.robot.robot import ClosedLoop, Coupling, Robot
from calib.robot.sources import EXAMPLE, examples_folder, find_mesh, mesh_uris, package_folders, resolve
from calib.robot.urdf import Urdf, read_urdf


class JobArm(NamedTuple):
    """What a job says of the arm and what is free of it; its measurements need not be there yet."""

    job: schema.Job
    urdf: Path
    robot: Robot
    model: ErrorModel
    mesh_roots: tuple[Path, ...]


def load_arm(path: Path, job: schema.Job | None = None) -> JobArm:
    """Read the arm and the error model of a job, and nothing else. Raises CalibError with one sentence."""
    job = read_job(path) if job is None else job
    urdf = resolve(job.robot.urdf) if job.robot.urdf.startswith(EXAMPLE) else path.parent / job.robot.urdf
    robot = _robot(job, urdf, path)
    return JobArm(job, urdf, robot, _model(job, robot, path), _mesh_roots(job, urdf, path))


def _robot(job: schema.Job, urdf: Path, path: Path) -> Robot:
    section, document = job.robot, read_urdf(urdf)
    tips = [table.tip for table in job.measurements if table.tip is not None]
    links = [*tips, *section.links, *(target.on for target in job.targets.values() if target.on != schema.FLOOR)]
    payloads = [section.payload, *(setup.payload for setup in job.setups.values())]
    payloads += [table.payload for table in job.measurements]
    links += [payload.link for payload in payloads if payload is not None and payload.link is not None]
    used = {table.instrument for table in job.measurements}
    links += [link for name, eye in job.instruments.items() if name in used and (link := carrier_of(eye)) is not None]
    return load_robot(
        document,
        section.tip or next(iter(tips), None),
        section.base,
        links=links,
        couplings=[_coupling(coupling, i, document, path) for i, coupling in enumerate(section.coupling)],
        loops=[ClosedLoop(loop.name, loop.frames, loop.closes, loop.passive) for loop in section.loop],
        gravity=[component.si for component in section.gravity],
        payload=payload_of(section.payload),
    ).with_loads({name: _load(setup, section) for name, setup in job.setups.items() if setup.gravity or setup.payload})


def _load(setup: schema.SetupSection, robot: schema.RobotSection) -> Load:
    """Return what bears on the robot in a set-up: what that does not say is as everywhere."""
    x, y, z = (component.si for component in setup.gravity or robot.gravity)
    return Load((x, y, z), payload_of(setup.payload or robot.payload))


def carrier_of(section: schema.InstrumentSection) -> str | None:
    """Return the link that carries a camera, None for the floor, the tip, and for other instruments."""
    return section.camera_on["link"] if isinstance(section.camera_on, dict) else None


def _coupling(section: schema.CouplingSection, i: int, document: Urdf, path: Path) -> Coupling:
    slides = {joint.name for joint in document.joints if joint.type == "prismatic"}
    dimension: Dimension = "length" if section.joint in slides else "angle"
    offset = 0.0 if section.offset is None else section.offset.of(dimension, f"{path}: robot.coupling[{i}].offset")
    return Coupling(section.joint, section.drivers, offset)


def payload_of(section: schema.PayloadSection | None) -> Payload | None:
    """Return a payload as a section states it."""
    if section is None:
        return None
    x, y, z = (length.si for length in section.position)
    return Payload(section.mass.si, (x, y, z), section.link or "")


def _mesh_roots(job: schema.Job, urdf: Path, path: Path) -> tuple[Path, ...]:
    """Return the folders where the scene may look for meshes."""
    named = [path.parent / root for root in job.robot.mesh_roots]
    for i, (root, text) in enumerate(zip(named, job.robot.mesh_roots, strict=True)):
        if not _is_folder(root):
            raise JobError(f"{path}: robot.mesh_roots[{i}]: {text!r} is not a folder.")
    examples = (examples_folder().parents[1],) if job.robot.urdf.startswith(EXAMPLE) else ()
    return (urdf.parent, *named, *examples, *package_folders(read_bytes(urdf, JobError), urdf))


# Of more, none is drawn.
_MOST_MESHES = 1000


def meshes_not_found(source: bytes, roots: Sequence[Path], where: str) -> list[Finding]:
    """Find meshes that the scene, or a plan without collisions, will lack, and say the cure."""
    uris = mesh_uris(source)
    lost = [uri for uri in uris[:_MOST_MESHES] if find_mesh(uri, roots) is None]
    if not lost:
        return []
    many = f"its {len(uris)}" if len(uris) <= _MOST_MESHES else f"the first {_MOST_MESHES} of its {len(uris)}"
    needed = (("visual", "the scene shows sticks"), ("collision", "calib plan judges no collisions of them"))
    lacks = " and ".join(what for shape, what in needed if not set(lost).isdisjoint(mesh_uris(source, (shape,))))
    return [
        Finding.warning(
            "meshes-not-found",
            f"{where}: {len(lost)} of {many} meshes are not found, such as {shown(lost[0])}; {lacks}, and nothing else "
            "needs them. Name the folder above the package in robot.mesh_roots, or source its workspace "
            "(AMENT_PREFIX_PATH).",
        )
    ]


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:  # such as a name longer than the file system takes
        return False


def _model(job: schema.Job, robot: Robot, path: Path) -> ErrorModel:
    section = job.error_model
    try:
        model = error_model(
            robot,
            offsets=section.offsets,
            placements=Free(section.dh, section.dh_convention, section.dh_parallel.si, section.placements),
            terms=section.chosen_terms,
            base=section.base,
            tool=section.tool,
            priors=_priors(section.prior),
            known=Known(
                None if job.base is None else _placement(job.base),
                {name: _placement(tool) for name, tool in job.tools.items()},
                {name: _target(target) for name, target in job.targets.items() if target.says_where},
                [_relation(relation) for relation in job.relations],
                _setups(job),
            ),
        )
    except JobError as e:
        raise JobError(f"{path}: error_model.{e}") from e
    try:
        refuse_none_free(model.parameters())
    except JobError as e:  # of names that two joints or tools give, and no key
        raise JobError(f"{path}: error_model: {e}") from e
    return model


def _placement(frame: schema.FrameSection) -> Array:
    position = np.array([length.si for length in frame.position])
    return rigid.placement(rigid.rotation_of_quaternion(np.array(frame.quaternion)), position)


def _setups(job: schema.Job) -> dict[str, SetUp]:
    """Return what is known of where the base stood; of the set-up without a name only with a prior."""
    known = {ONLY_SETUP: job.base} if job.base is not None and job.base.prior is not None else {}
    known |= {name: base for name, section in job.setups.items() if (base := section.base) is not None}
    return {
        name: SetUp(
            _placement(section),
            None if section.prior is None else in_si(section.prior.length),
            None if section.prior is None else in_si(section.prior.angle),
        )
        for name, section in known.items()
    }


def _target(section: schema.TargetSection) -> Target:
    if section.position is not None:
        point = np.array([length.si for length in section.position])
        turn = np.eye(3) if section.quaternion is None else rigid.rotation_of_quaternion(np.array(section.quaternion))
        return Target(rigid.placement(turn, point))
    normal = np.array(section.normal)
    T = axis_frame(normal / math.hypot(*normal))
    height = in_si(section.height)
    return Target(T @ rigid.translation(np.array([0.0, 0.0, height or 0.0])), height is not None)


def _relation(section: schema.RelationSection) -> Relation:
    return Relation(section.kind, section.targets, getattr(section, section.kind).si, section.sigma.si)


def _priors(section: schema.PriorSection) -> Priors:
    elastic = section.elastic
    slides = isinstance(elastic, Quantity) and elastic.dimension == "sliding compliance"
    turning, sliding = (None, elastic) if slides else (elastic, elastic if elastic == "learned" else None)
    return Priors(*map(_width, (section.length, section.angle, section.harmonics, turning, sliding)))


def _width(width: Quantity | Literal["learned"] | None) -> Prior | None:
    return width.si if isinstance(width, Quantity) else width


def in_si(of: Quantity | None) -> float | None:
    """Return a quantity in SI units, None where there is none."""
    return None if of is None else of.si
