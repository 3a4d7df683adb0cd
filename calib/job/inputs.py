"""What a job names, read and checked before anything is solved."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from calib.assessment.validation import hold_out
from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.errors import JobError, MeasurementError, naming_rows
from calib.foundations.files import read_bytes, sha256, stamp
from calib.foundations.units import Dimension
from calib.foundations.words import shown
from calib.identification.error_model import ErrorModel, Known, error_model
from calib.identification.losses import Loss
from calib.identification.observability import rank_findings
from calib.identification.optics_choice import OpticsChoice, choose_optics
from calib.identification.parameters import Prior, Priors
from calib.identification.relations import Relation
from calib.identification.sanity import signatures
from calib.identification.set_ups import SetUp
from calib.identification.targets import Target, shapes
from calib.job.arm import ReadArm, read_arm
from calib.job.fields import Quantity
from calib.job.propose import reading_that_fits
from calib.job.read import read_board, read_job
from calib.job.schema import (
    FLOOR,
    CouplingSection,
    FrameSection,
    InstrumentSection,
    Job,
    MeasurementsSection,
    PayloadSection,
    PriorSection,
    RelationSection,
    RobotSection,
    SetupSection,
    TargetSection,
)
from calib.machine.touching import touched
from calib.measurement.checks import Finding, copied_tables, table_findings
from calib.measurement.formats.lens_files import read_lens
from calib.measurement.instruments import Camera, CameraPlace, LaserTracker
from calib.measurement.kinds import QUANTITIES
from calib.measurement.lens import BENT, CENTRE, FOCAL, RATIONAL, Lens
from calib.measurement.measurements import ONLY_SETUP, Measurements
from calib.measurement.optics import seen_by
from calib.measurement.prints import Print
from calib.measurement.read import read_measurements, stream_of
from calib.measurement.streams.stream import GAP, ONLY_CLOCK, SKEW, Clock, OneClock
from calib.measurement.table import Columns, HeaderError
from calib.robot.deviation import axis_frame
from calib.robot.dh import Free
from calib.robot.gravity import Load, Payload
from calib.robot.joint_terms import weighed_at_zero
from calib.robot.load import load_robot
from calib.robot.robot import ClosedLoop, Coupling, Robot
from calib.robot.sources import EXAMPLE, examples_folder, find_mesh, mesh_uris, package_folders, resolve
from calib.robot.urdf import Urdf, read_urdf

Progress = Callable[[str], None]
_MOST_MESHES = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """Everything a job names, read and checked.

    ``model``: with what is known of targets and set-ups that are identified from; ``whole_model``: of all.
    ``hashes``: SHA-256 of every input file by its name in the job. ``optics``: how many numbers lenses and boards have.
    """

    job: Job
    path: Path
    robot: Robot
    model: ErrorModel
    whole_model: ErrorModel
    identify: tuple[Measurements, ...]
    validate: tuple[Measurements, ...]
    nodes: tuple[Measurements, ...]
    model_sigmas: tuple[tuple[float | None, ...], ...]
    mesh_roots: tuple[Path, ...]
    findings: tuple[Finding, ...]
    hashes: Mapping[str, str]
    files: tuple[Path, ...]
    optics: tuple[OpticsChoice, ...] = ()

    @property
    def losses(self) -> tuple[Loss, ...]:
        """The losses of the sets to identify from."""
        return tuple(section.loss for section in self.job.measurements if section.use == "identify")

    def tables(self, use: Literal["identify", "validate"]) -> tuple[str, ...]:
        """Return the names, as the job has them, of the tables of one use."""
        return tuple(section.file for section in self.job.measurements if section.use == use)


class JobArm(NamedTuple):
    """What a job says of the arm and what is free of it; its measurements need not be there yet."""

    job: Job
    urdf: Path
    robot: Robot
    model: ErrorModel
    mesh_roots: tuple[Path, ...]


def load_arm(path: Path, job: Job | None = None) -> JobArm:
    """Read the arm and the error model of a job, and nothing else. Raises CalibError with one sentence."""
    job = read_job(path) if job is None else job
    urdf = resolve(job.robot.urdf) if job.robot.urdf.startswith(EXAMPLE) else path.parent / job.robot.urdf
    robot = _robot(job, urdf, path)
    return JobArm(job, urdf, robot, _model(job, robot, path), _mesh_roots(job, urdf, path))


def load(path: Path, progress: Progress = lambda _: None, job: Job | None = None) -> Inputs:
    """Read a job and all it names. Raises CalibError with one sentence for the first thing that is wrong.

    Doubtful but usable things are returned as findings. ``job``: what would stand in ``path``, which is not there yet.
    """
    progress("reading the job")
    stamps = {path: stamp(path)}
    written = job is None
    arm = load_arm(path, job)
    job, urdf, robot, model, folder = _with_held_out(arm.job), arm.urdf, arm.robot, arm.model, path.parent
    progress("reading the measurements")
    sections = job.measurements
    named = list(dict.fromkeys(name for section in sections for name in (section.file, section.readings) if name))
    prints = _prints(job, folder)
    lenses = _lenses(job, folder)
    named += [name for name in (*prints, *lenses) if name not in named]
    stamps |= {folder / name: stamp(folder / name) for name in named}
    arms = _arms(job, path)
    doubts = [finding for arm in arms.values() for finding in arm.findings]
    # Rows held out are those of a table above: it is read once.
    tables: list[tuple[MeasurementsSection, Measurements]] = []
    sets: list[Measurements] = []
    for section in sections:
        own = section.model_copy(update={**_OF_HELD_OUT, "use": "identify"})
        data = next((read for other, read in tables if other == own), None)
        if data is None:
            of = _of_one_clock(section, tables)
            data = _measurements(section, job, robot, folder, arms, prints, lenses, doubts, of)
            tables.append((own, data))
        sets.append(_shared_out(data, section))
    sets, optics = _with_optics(job, sets, prints, progress)
    _refuse_open_loops(robot, sets)
    chosen = tuple(data for data, section in zip(sets, sections, strict=True) if section.use == "identify")
    held_out = tuple(data for data, section in zip(sets, sections, strict=True) if section.use == "validate")
    nodes = tuple(data for data, section in zip(sets, sections, strict=True) if section.use == "nodes")
    _refuse_levels(job, path)
    _refuse_unknown_names(job, sets, path)
    _refuse_wrong_shapes(job, sets, path)
    whole, model = model, model.within(chosen)
    doubts += _found_from_held_out(whole, chosen, held_out)
    _refuse_no_noise(job, sets, path)
    doubts += _weighed_at_zero(model, sets)
    doubts += _meshes_not_found(robot.urdf.source, arm.mesh_roots, job.robot.urdf)
    findings = doubts + [finding for data in sets for finding in table_findings(data, robot.readings, robot.reach)]
    findings += [finding for one_use in (chosen, held_out, nodes) for finding in copied_tables(one_use)]
    if len(chosen) > 1:
        # A joint that rests in one table may move in another; what is never seen, the rank says.
        findings = [finding for finding in findings if finding.code != "joint-at-rest"]
    _refuse(findings)
    progress("looking for typical mistakes")
    findings += signatures(model, chosen)
    _refuse(findings)
    hashes = {
        **({path.name: sha256(read_bytes(path, JobError))} if written else {}),
        job.robot.urdf: sha256(robot.urdf.source),
        **{name: sha256(read_bytes(folder / name, JobError)) for name in named},
        **{name: sha256(read_bytes(file, JobError)) for arm in arms.values() for name, file in arm.files.items()},
    }
    # The hashes are to be those of what was read.
    for file, before in stamps.items():
        if stamp(file) != before:
            raise JobError(f"{file}: has changed while it was read; run again when it is whole.")
    findings += [*_not_held_out(job, hashes, path), *_rank_findings(model, chosen, path)]
    return Inputs(
        job=job,
        path=path,
        robot=robot,
        model=model,
        whole_model=whole,
        identify=chosen,
        validate=held_out,
        nodes=nodes,
        model_sigmas=tuple(_sigmas(section) for section in sections if section.use == "identify"),
        mesh_roots=arm.mesh_roots,
        findings=tuple(findings),
        hashes=hashes,
        files=(
            path,
            urdf,
            *(folder / name for name in named),
            *(file for arm in arms.values() for file in arm.files.values()),
        ),
        optics=optics,
    )


def _prints(job: Job, folder: Path) -> dict[str, Print]:
    """Return what is printed on the boards of a job, by the names of their files."""
    names = dict.fromkeys(section.board for section in job.measurements if section.board is not None)
    return {name: read_board(folder / name) for name in names}


def _lenses(job: Job, folder: Path) -> dict[str, tuple[Lens, tuple[int, int] | None]]:
    """Return the lenses that files of a job state, by the names of these."""
    used = {section.instrument for section in job.measurements}
    names = (eye.lens_file for name, eye in job.instruments.items() if name in used)
    return {name: read_lens(folder / name) for name in dict.fromkeys(names) if name is not None}


def _with_optics(
    job: Job, sets: Sequence[Measurements], prints: Mapping[str, Print], progress: Progress
) -> tuple[list[Measurements], tuple[OpticsChoice, ...]]:
    """Return sets with lenses and boards of as many numbers as photographs ask for, and what was compared for it.

    Of every camera with a free lens, and of boards that may have several shapes; told by what is to be identified from.
    """
    found, choices, done = list(sets), [], set()
    for data, section in zip(sets, job.measurements, strict=True):
        if data.camera is None or data.board is None or section.use != "identify" or section.instrument is None:
            continue
        key = (data.camera.name, data.board.name)
        shapes = ("flat",) if section.board is None else prints[section.board].shapes
        rational = job.instruments[section.instrument].lens == "free"
        if key in done or not (rational or len(shapes) > 1 or data.camera.unknown):
            continue
        done.add(key)
        progress(f"looking at the lens of {section.instrument}")
        same = [_is_of(key, other) for other in found]
        own = zip(found, job.measurements, same, strict=True)
        chosen = choose_optics(
            [other for other, one, alike in own if alike and one.use == "identify"], shapes, rational=rational
        )
        if chosen is not None:
            camera, board, choice = chosen
            choices.append(choice)
            found = [
                seen_by(other, camera, board) if alike else other for other, alike in zip(found, same, strict=True)
            ]
            # Another board of the same camera has the same lens.
            found = [_of_camera(other, camera) for other in found]
    return found, tuple(choices)


def _is_of(key: tuple[str, str], data: Measurements) -> bool:
    return data.camera is not None and data.board is not None and (data.camera.name, data.board.name) == key


def _of_camera(data: Measurements, camera: Camera) -> Measurements:
    same = data.camera is not None and data.camera.name == camera.name and data.camera != camera
    return seen_by(data, camera, data.board) if same else data


def _refuse_levels(job: Job, path: Path) -> None:
    """Refuse levels that name files which are not to be identified from, and files that come twice."""
    files = [section.file for section in job.measurements if section.use == "identify"]
    nodes = [section.file for section in job.measurements if section.use == "nodes"]
    for i, level in enumerate(job.levels):
        residual = level.residual_model is not None
        if residual == bool(level.free) or (residual and i + 1 < len(job.levels)) or (residual and i == 0):
            raise JobError(
                f"{path}: levels[{i}]: needs either free parameters or, if it is the last of several levels, a "
                "residual_model."
            )
        for file in level.measurements or ():
            if file not in (nodes if residual else files):
                known = ", ".join(map(repr, nodes if residual else files)) or "none"
                kind = "nodes" if residual else "identify"
                raise JobError(
                    f'{path}: levels[{i}].measurements: {file!r} has not use = "{kind}", which {known} have.'
                )
    if not nodes and any(level.residual_model and level.residual_model.kind == "grid" for level in job.levels):
        raise JobError(f'{path}: levels: no measurements have use = "nodes", and a residual grid is made of these.')
    if nodes and not any(level.residual_model for level in job.levels):
        raise JobError(f'{path}: measurements: {nodes[0]!r} has use = "nodes", and no level has a residual_model.')
    if job.levels and len(set(files)) < len(files):
        raise JobError(f"{path}: measurements: a file appears twice, so that levels cannot name one of the two.")
    if job.levels and job.solver.kind != "least_squares":
        raise JobError(f"{path}: solver.kind: {job.solver.kind!r} does not work in levels; leave one of them out.")


def _robot(job: Job, urdf: Path, path: Path) -> Robot:
    section, document = job.robot, read_urdf(urdf)
    tips = [table.tip for table in job.measurements if table.tip is not None]
    links = [*tips, *section.links, *(target.on for target in job.targets.values() if target.on != FLOOR)]
    payloads = [section.payload, *(setup.payload for setup in job.setups.values())]
    payloads += [table.payload for table in job.measurements]
    links += [payload.link for payload in payloads if payload is not None and payload.link is not None]
    used = {table.instrument for table in job.measurements}
    links += [link for name, eye in job.instruments.items() if name in used and (link := _carrier(eye)) is not None]
    return load_robot(
        document,
        section.tip or next(iter(tips), None),
        section.base,
        links=links,
        couplings=[_coupling(coupling, i, document, path) for i, coupling in enumerate(section.coupling)],
        loops=[ClosedLoop(loop.name, loop.frames, loop.closes, loop.passive) for loop in section.loop],
        gravity=[component.si for component in section.gravity],
        payload=_payload(section.payload),
    ).with_loads({name: _load(setup, section) for name, setup in job.setups.items() if setup.gravity or setup.payload})


def _load(setup: SetupSection, robot: RobotSection) -> Load:
    """Return what bears on the robot in a set-up: what that does not say is as everywhere."""
    x, y, z = (component.si for component in setup.gravity or robot.gravity)
    return Load((x, y, z), _payload(setup.payload or robot.payload))


def _carrier(section: InstrumentSection) -> str | None:
    """Return the link that carries a camera, None for the floor, the tip, and for other instruments."""
    return section.camera_on["link"] if isinstance(section.camera_on, dict) else None


def _coupling(section: CouplingSection, i: int, document: Urdf, path: Path) -> Coupling:
    slides = {joint.name for joint in document.joints if joint.type == "prismatic"}
    dimension: Dimension = "length" if section.joint in slides else "angle"
    offset = 0.0 if section.offset is None else section.offset.of(dimension, f"{path}: robot.coupling[{i}].offset")
    return Coupling(section.joint, section.drivers, offset)


def _payload(section: PayloadSection | None) -> Payload | None:
    if section is None:
        return None
    x, y, z = (length.si for length in section.position)
    return Payload(section.mass.si, (x, y, z), section.link or "")


def _refuse_open_loops(robot: Robot, sets: Sequence[Measurements]) -> None:
    for data in sets if robot.loops else ():
        for end in data.ends:
            with naming_rows(data.where, data.lines):
                robot.joint_positions(end.readings)


def _refuse(findings: Sequence[Finding]) -> None:
    for finding in findings:
        if finding.severity == "error":
            raise MeasurementError(finding.sentence)


def _refuse_unknown_names(job: Job, sets: Sequence[Measurements], path: Path) -> None:
    """Refuse tools and set-ups that no row has, and such of rows that are missing where the others are given."""
    tools = tuple(dict.fromkeys(tool for data in sets for tool in data.tools))
    setups = tuple(dict.fromkeys(setup for data in sets for setup in data.setups))
    for what, given, there in (("tools", job.tools, tools), ("setups", job.setups, setups)):
        for name in given:
            if name not in there:
                raise JobError(
                    f"{path}: {what}: {name!r} is in no measurement; the measurements have "
                    f"{', '.join(map(repr, there))}."
                )
    for tool in tools:
        if job.tools and tool not in job.tools:
            raise JobError(f"{path}: tools: the tool {tool!r} of the measurements is missing.")
    for setup in setups:
        known = [ONLY_SETUP, *(name for name, section in job.setups.items() if section.base is not None)]
        if job.error_model.base == "fixed" and setup not in known:
            raise JobError(f"{path}: setups: the base is fixed, and its pose in {setup!r} is missing.")
    if job.base is not None and ONLY_SETUP not in setups:
        raise JobError(
            f"{path}: base: a pose is given, and every measurement has a named set-up: "
            f"{', '.join(map(repr, setups))}; give it in [setups.NAME]."
        )


def _found_from_held_out(
    model: ErrorModel, chosen: Sequence[Measurements], held_out: Sequence[Measurements]
) -> Iterator[Finding]:
    """Yield the tools and set-ups that only rows held out have."""
    tools = {tool for data in chosen for tool in data.tools}
    setups = {setup for data in chosen for setup in data.setups}
    for data in held_out:
        names = [("tool", name) for name in data.tools if name not in tools and model.tool != "fixed"]
        for name in data.setups:
            known = model.known_base(name)
            if name not in setups and (known is None or not known.fixed):
                names.append(("set-up", name))
        for what, name in names:
            yield Finding(
                "warning",
                "found-from-held-out",
                f"{data.where}: the {what} {name!r} is in no table to identify from, so it is found from these "
                "held-out rows; where they are few, their errors look too small.",
            )


def _weighed_at_zero(model: ErrorModel, sets: Sequence[Measurements]) -> Iterator[Finding]:
    """Yield tables that tell joints on which something hangs whose weight matters, and which the arm does not know."""
    if model.robot.weights is None or not model.robot.weights.bodies:
        return
    at_zero = weighed_at_zero(model.urdf_robot)
    for data in sets:
        if names := [name for name in data.unused if name in at_zero]:
            yield Finding(
                "warning",
                "weighed-at-zero",
                f"{data.where}: what hangs on joint {', '.join(map(repr, names))} is weighed as if it were at zero, "
                "and the table tells where it is; name a link behind it in robot.links.",
            )


def _refuse_wrong_shapes(job: Job, sets: Sequence[Measurements], path: Path) -> None:
    """Refuse a plane that is said to be at a point, a point with a normal, and what was not measured at all."""
    found = shapes(sets)
    listed = ", ".join(found) or "no targets"
    for name, target in job.targets.items():
        if name not in found:
            raise JobError(f"{path}: targets: {name!r} does not appear in the measurements, which have {listed}.")
        if not target.says_where:
            continue
        said = "point" if target.normal is None else "plane"
        # Boards and cameras have a position as points have.
        if found[name] not in (said, "frame" if said == "point" else said):
            raise JobError(f"{path}: targets.{name}: is said to be a {said}, and was measured as a {found[name]}.")
    for relation in job.relations:
        shape = "point" if relation.kind == "distance" else "plane"
        for name in relation.targets:
            if name not in found:
                raise JobError(
                    f"{path}: relations: a known {relation.kind} is between two {shape}s, and {name!r} is in no "
                    "measurement."
                )


def _refuse_no_noise(job: Job, sets: Sequence[Measurements], path: Path) -> None:
    """Refuse a model part of zero beside an instrument whose noise nobody stated: infinite weights."""
    for i, (section, data) in enumerate(zip(job.measurements, sets, strict=True)):
        keys = ("model_sigma", "model_sigma_angle")
        for key, sigma, quantity in zip(keys, _sigmas(section), QUANTITIES[data.kind], strict=False):
            if sigma == 0.0 and not np.all(data.sigma[:, quantity.columns] > 0.0):
                raise JobError(
                    f"{path}: measurements[{i}].{key}: is zero, and the noise of the instrument is not given; "
                    "give one of them."
                )


# What a table says otherwise of those of its rows that are held out.
_OF_HELD_OUT = {"use": "validate", "model_sigma": None, "model_sigma_angle": None, "loss": "linear"}


def _with_held_out(job: Job) -> Job:
    """Return the job in which a table that holds out rows stands a second time, for these, behind all others."""
    again = [section.model_copy(update=_OF_HELD_OUT) for section in job.measurements if section.hold_out is not None]
    return job.model_copy(update={"measurements": (*job.measurements, *again)})


def _shared_out(data: Measurements, section: MeasurementsSection) -> Measurements:
    """Return what of a table one section has: all, or whole groups of rows, spread at random but alike every time.

    Raises MeasurementError when the rows are of one pose or one group.
    """
    if section.hold_out is None:
        return data
    kept, held_out = hold_out(data, section.hold_out)
    return held_out if section.use == "validate" else kept


def _not_held_out(job: Job, hashes: Mapping[str, str], path: Path) -> list[Finding]:
    """Find tables that the model is both fitted to and judged by."""
    fitted = {hashes[section.file]: section.file for section in job.measurements if section.use == "identify"}
    return [
        Finding(
            "warning",
            "not-held-out",
            f"{path}: measurements[{i}].file: {section.file!r} is {fitted[hashes[section.file]]!r} again, from which "
            "the parameters are identified; a validation with the same rows proves nothing.",
        )
        for i, section in enumerate(job.measurements)
        if section.use == "validate" and section.hold_out is None and hashes[section.file] in fitted
    ]


def _rank_findings(model: ErrorModel, chosen: Sequence[Measurements], path: Path) -> tuple[Finding, ...]:
    try:
        return rank_findings(model, chosen)
    except JobError as e:
        raise JobError(f"{path}: {e}") from e


def _mesh_roots(job: Job, urdf: Path, path: Path) -> tuple[Path, ...]:
    """Return the folders where the scene may look for meshes."""
    named = [path.parent / root for root in job.robot.mesh_roots]
    for i, (root, text) in enumerate(zip(named, job.robot.mesh_roots, strict=True)):
        if not _is_folder(root):
            raise JobError(f"{path}: robot.mesh_roots[{i}]: {text!r} is not a folder.")
    examples = (examples_folder().parents[1],) if job.robot.urdf.startswith(EXAMPLE) else ()
    return (urdf.parent, *named, *examples, *package_folders(read_bytes(urdf, JobError), urdf))


def _meshes_not_found(source: bytes, roots: Sequence[Path], where: str) -> list[Finding]:
    """Find meshes that the scene will lack, and say the cure."""
    uris = mesh_uris(source)
    lost = [uri for uri in uris[:_MOST_MESHES] if find_mesh(uri, roots) is None]
    if not lost:
        return []
    return [
        Finding(
            "warning",
            "meshes-not-found",
            f"{where}: {len(lost)} of its {len(uris)} meshes are not found, such as {shown(lost[0])}; the scene shows "
            "sticks, and nothing else needs them. Name the folder above the package in robot.mesh_roots, or source its "
            "workspace (AMENT_PREFIX_PATH).",
        )
    ]


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:  # such as a name longer than the file system takes
        return False


def _model(job: Job, robot: Robot, path: Path) -> ErrorModel:
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
        free = model.parameters()
    except JobError as e:
        raise JobError(f"{path}: error_model.{e}") from e
    if not free:
        raise JobError(f"{path}: error_model: no parameter is free; free offsets, placements, the base or the tool.")
    return model


def _placement(frame: FrameSection) -> Array:
    position = np.array([length.si for length in frame.position])
    return rigid.placement(rigid.rotation_of_quaternion(np.array(frame.quaternion)), position)


def _setups(job: Job) -> dict[str, SetUp]:
    """Return what is known of where the base stood; of the set-up without a name only with a prior."""
    known = {ONLY_SETUP: job.base} if job.base is not None and job.base.prior is not None else {}
    known |= {name: base for name, section in job.setups.items() if (base := section.base) is not None}
    return {
        name: SetUp(
            _placement(section),
            None if section.prior is None else _si(section.prior.length),
            None if section.prior is None else _si(section.prior.angle),
        )
        for name, section in known.items()
    }


def _target(section: TargetSection) -> Target:
    if section.position is not None:
        point = np.array([length.si for length in section.position])
        turn = np.eye(3) if section.quaternion is None else rigid.rotation_of_quaternion(np.array(section.quaternion))
        return Target(rigid.placement(turn, point))
    normal = np.array(section.normal)
    T = axis_frame(normal / math.hypot(*normal))
    height = _si(section.height)
    return Target(T @ rigid.translation(np.array([0.0, 0.0, height or 0.0])), height is not None)


def _relation(section: RelationSection) -> Relation:
    return Relation(section.kind, section.targets, getattr(section, section.kind).si, section.sigma.si)


def _arms(job: Job, path: Path) -> dict[str, ReadArm]:
    """Return the instruments of a job that are arms and that some table was measured with."""
    used = {section.instrument for section in job.measurements}
    arms = {name: arm for name, arm in job.instruments.items() if arm.kind == "arm" and name in used}
    try:
        return {name: read_arm(name, section, path.parent) for name, section in arms.items()}
    except JobError as e:
        raise JobError(f"{path}: {e}") from e


def _measurements(
    section: MeasurementsSection,
    job: Job,
    robot: Robot,
    folder: Path,
    arms: Mapping[str, ReadArm],
    prints: Mapping[str, Print],
    lenses: Mapping[str, tuple[Lens, tuple[int, int] | None]],
    doubts: list[Finding],
    of: OneClock | None,
) -> Measurements:
    clock = _clock(section, job, of)
    if section.instrument is not None and section.instrument in arms:
        if clock is not None:
            raise JobError(f"{section.file}: readings: an arm that measures has its own, and is no stream.")
        data, found = touched(folder / section.file, arms[section.instrument].arm, robot, _columns(section))
        doubts += found
        return _under_its_load(data.named(tool=section.tool, setup=section.setup), section, robot)
    seen_from = robot.with_tip(section.tip or robot.tip)
    try:
        how: dict[str, Any] = {
            "sigma": (_si(section.sigma), _si(section.sigma_angle)),
            "instrument": None
            if section.instrument is None
            else _instrument(section.instrument, job.instruments[section.instrument], lenses),
            "offset": section.length_offset,
            "in_order": section.in_order,
            "columns": _columns(section),
        }
        if section.readings is None or clock is None:
            data = read_measurements(folder / section.file, seen_from, section.observes, **how)
        else:
            joints = folder / section.readings
            data = stream_of(folder / section.file, joints, seen_from, section.observes, clock=clock, **how)
    except HeaderError as e:
        ready = reading_that_fits(folder / section.file, seen_from, section.observes)
        raise MeasurementError(f"{str(e).removesuffix('.')}; what fits is: {ready}." if ready else str(e)) from e
    if section.board is not None and data.camera is not None:
        data = seen_by(data, data.camera, prints[section.board].board(Path(section.board).stem))
    for name in section.targets:
        if name not in data.targets:
            known = ", ".join(map(repr, data.targets)) or "none"
            raise MeasurementError(f"{data.where}: there is no target {name!r} to rename; there are {known}.")
    names = tuple(section.targets.get(name, name) for name in data.targets)
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise MeasurementError(f"{data.where}: two targets would be called {twice!r}.")
    on = {name: target.on for name, target in job.targets.items() if target.on != FLOOR}
    link = None if section.instrument is None else _carrier(job.instruments[section.instrument])
    if link is not None:
        # The camera is what the rows are about, and the board or mark is on the tip.
        for name in names:
            if on.setdefault(name, link) != link:
                raise JobError(f"{data.where}: the camera {name!r} is on {link!r}, and [targets] says {on[name]!r}.")
    data = replace(data, targets=names).named(tool=section.tool, setup=section.setup, on=on)
    return _under_its_load(data, section, robot)


def _under_its_load(data: Measurements, section: MeasurementsSection, robot: Robot) -> Measurements:
    payload = _payload(section.payload)
    return (data if payload is None else data.carrying(robot, payload)).loaded(robot)


def _clock(section: MeasurementsSection, job: Job, of: OneClock | None) -> Clock | None:
    """Return what a job says of the clock of a stream, None of other tables."""
    if section.readings is None:
        for key in ("clock", "clock_of", "latency", "gap"):
            if getattr(section, key) is not None:
                raise JobError(f"{section.file}: {key}: is of a stream, and no readings are named.")
        return None
    streams = list(dict.fromkeys(other.file for other in job.measurements if other.readings is not None))
    stems = [Path(file).stem for file in streams]
    own = Path(section.file).stem
    name = ONLY_CLOCK if len(streams) == 1 else f"{ONLY_CLOCK}.{own if stems.count(own) == 1 else section.file}"
    gap = GAP if section.gap is None else section.gap.si
    return Clock(section.clock or "free", section.latency is not None, gap, name, of)


def _of_one_clock(
    section: MeasurementsSection, read: Sequence[tuple[MeasurementsSection, Measurements]]
) -> OneClock | None:
    """Return the clock of the stream by which another one goes, None where it has its own."""
    if section.clock_of is None or section.readings is None:
        return None
    for other, data in read:
        if other.file == section.clock_of and other.clock_of is None and SKEW in data.uses:
            return data.clock
    raise JobError(
        f"{section.file}: clock_of: {section.clock_of!r} is not a stream with a clock of its own above this one."
    )


def _columns(section: MeasurementsSection) -> Columns:
    return Columns(section.columns, section.ignore, section.orientation)


def _instrument(
    name: str, section: InstrumentSection, lenses: Mapping[str, tuple[Lens, tuple[int, int] | None]]
) -> LaserTracker | Camera:
    sigma = 0.0 if section.sigma is None else section.sigma.si
    if section.kind == "camera":
        fx, fy, cx, cy = (None if q is None else q.si for q in (section.fx, section.fy, section.cx, section.cy))
        place: CameraPlace = "tip" if section.camera_on == "tip" else "floor"
        free = {"given": (), "free": (*FOCAL, *CENTRE, *BENT)}.get(section.lens, section.lens)
        bent = {key: getattr(section, key) for key in (*BENT, *RATIONAL)}
        numbers: dict[str, Any] = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, **bent}
        size = section.size
        if section.lens_file is not None:
            lens, size = lenses[section.lens_file]
            numbers = lens._asdict()
        return Camera(
            place, **numbers, sigma=sigma, free=tuple(free), size=size, name=name, lens_sigma=section.lens_sigma.by_name
        )
    x, y, z = (length.si for length in section.station)
    return LaserTracker(sigma, section.sigma_per_metre.si, (x, y, z))


def _sigmas(section: MeasurementsSection) -> tuple[float | None, ...]:
    """Return the standard deviations of the model part that the job fixes: of positions and, for poses, of angles."""
    position = _si(section.model_sigma)
    return (position, _si(section.model_sigma_angle)) if section.observes == "pose" else (position,)


def _priors(section: PriorSection) -> Priors:
    elastic = section.elastic
    slides = isinstance(elastic, Quantity) and elastic.dimension == "sliding compliance"
    turning, sliding = (None, elastic) if slides else (elastic, elastic if elastic == "learned" else None)
    return Priors(*map(_width, (section.length, section.angle, section.harmonics, turning, sliding)))


def _width(width: Quantity | Literal["learned"] | None) -> Prior | None:
    return width.si if isinstance(width, Quantity) else width


def _si(of: Quantity | None) -> float | None:
    return None if of is None else of.si
