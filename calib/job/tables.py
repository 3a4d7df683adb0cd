"""The tables of a job as measurements: read with their instruments, shared out, lenses and boards chosen."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from calib.assessment.validation import hold_out
from calib.foundations.arrays import Array
from calib.foundations.errors import JobError, MeasurementError, naming
from calib.identification.relations import related_targets
from calib.job.read import Progress, read_board
from calib.job.schema import FLOOR, InstrumentSection, Job, MeasurementsSection
from calib.job.stated import carrier_of, in_si, payload_of
from calib.machine.place import Placed
from calib.machine.touching import touched, touches_of
from calib.measurement.checks import Finding
from calib.measurement.formats.lens_files import read_lens
from calib.measurement.instruments import Camera, CameraPlace, LaserTracker, refuse_other_focal_lengths
from calib.measurement.lens import BENT, CENTRE, FOCAL, NAMES, Lens
from calib.measurement.measurements import Measurements
from calib.measurement.optics import seen_by
from calib.measurement.prints import Print
from calib.measurement.read import read_measurements, stream_of
from calib.measurement.streams.stream import ONLY_CLOCK, SKEW, Clock, OneClock
from calib.measurement.table import Columns, HeaderError
from calib.robot.conditions import Conditions
from calib.robot.robot import Robot

if TYPE_CHECKING:
    from calib.identification.optics_choice import OpticsChoice
    from calib.job.arm import ReadArm


def prints_of(job: Job, folder: Path) -> dict[str, Print]:
    """Return what is printed on the boards of a job, by the names of their files."""
    names = dict.fromkeys(section.board for section in job.measurements if section.board is not None)
    return {name: read_board(folder / name) for name in names}


def lenses_of(job: Job, folder: Path) -> dict[str, tuple[Lens, tuple[int, int] | None]]:
    """Return the lenses that files of a job state, by the names of these."""
    used = {section.instrument for section in job.measurements}
    names = (eye.lens_file for name, eye in job.instruments.items() if name in used)
    return {name: read_lens(folder / name) for name in dict.fromkeys(names) if name is not None}


def with_optics(
    job: Job, sets: Sequence[Measurements], prints: Mapping[str, Print], progress: Progress
) -> tuple[list[Measurements], "tuple[OpticsChoice, ...]"]:
    """Return sets with lenses and boards of as many numbers as photographs ask for, and what was compared for it.

    Of every camera with a free lens, and of boards that may have several shapes; told by what is to be identified from.
    """
    from calib.identification.optics_choice import choose_optics  # noqa: PLC0415 - slow to load; few jobs have cameras

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


# What a table says otherwise of those of its rows that are held out.
OF_HELD_OUT = {"use": "validate", "model_sigma": None, "model_sigma_angle": None, "loss": "linear"}


def with_held_out(job: Job) -> Job:
    """Return the job in which a table that holds out rows stands a second time, for these, behind all others."""
    again = [section.model_copy(update=OF_HELD_OUT) for section in job.measurements if section.hold_out is not None]
    return job.model_copy(update={"measurements": (*job.measurements, *again)})


def shared_out(data: Measurements, section: MeasurementsSection, job: Job) -> Measurements:
    """Return what of a table is of one use: whole groups of rows, spread at random but alike every time.

    Targets of relations stay among those to identify from; rows of sockets in known places are spread one by one.

    Raises MeasurementError when the rows are of one pose or one group.
    """
    assert section.hold_out is not None, "a table that holds out rows"
    known = {name for name, target in job.targets.items() if target.position is not None}
    kept, held_out = hold_out(data, section.hold_out, keep=related_targets(job.relations), known=known)
    return held_out if section.use == "validate" else kept


def arms_of(job: Job, path: Path) -> dict[str, "ReadArm"]:
    """Return the instruments of a job that are arms and that some table was measured with."""
    used = {section.instrument for section in job.measurements}
    arms = {name: arm for name, arm in job.instruments.items() if arm.kind == "arm" and name in used}
    if not arms:
        return {}
    from calib.job.arm import read_arm  # noqa: PLC0415 - slow to load, and few jobs measure with an arm

    with naming(path, JobError):
        return {name: read_arm(name, section, path.parent) for name, section in arms.items()}


class ShownBy(NamedTuple):
    """What shows where a robot's bases are: an instrument, or an ``arm`` by its ``touches``."""

    arm: "ReadArm | None" = None
    touches: tuple[tuple[Array, Conditions], ...] = ()

    def placed(self) -> Placed:
        """Return in whose frame the bases are, and what the arm's own errors do to them, which takes some time."""
        return Placed("instrument") if self.arm is None else Placed("arm", self.arm.place(self.touches))


def bases_shown_by(
    sections: Sequence[MeasurementsSection], sets: Sequence[Measurements], arms: Mapping[str, "ReadArm"], folder: Path
) -> ShownBy | None:
    """Return by what tables to identify from show the robot's bases; None where by several, or by none."""
    showing = {
        section.instrument if section.instrument in arms else None
        for section, data in zip(sections, sets, strict=True)
        if section.use == "identify" and (data.position is not None or data.camera is not None)
    }
    if len(showing) != 1:
        return None
    (name,) = showing
    if name is None:
        return ShownBy()
    # Rows that were held out are of the same touches.
    arm = arms[name]
    own = [section for section in sections if section.use == "identify" and section.instrument == name]
    files = {section.file: _columns(section) for section in own}
    return ShownBy(arm, tuple(touches_of(folder / file, arm.arm, columns) for file, columns in files.items()))


def measurements_of(
    section: MeasurementsSection,
    job: Job,
    robot: Robot,
    folder: Path,
    arms: Mapping[str, "ReadArm"],
    prints: Mapping[str, Print],
    lenses: Mapping[str, tuple[Lens, tuple[int, int] | None]],
    doubts: list[Finding],
    of: OneClock | None,
) -> Measurements:
    """Read the table of one section, with its instrument, lens, board, clock and load."""
    clock, seen_from = _clock(section, job, of), robot.with_tip(section.tip or robot.tip)
    if section.instrument is not None and section.instrument in arms:
        if clock is not None:
            raise JobError(f"{section.file}: readings: an arm that measures has its own, and is no stream.")
        arm, columns = arms[section.instrument].arm, _columns(section)
        data, found = touched(folder / section.file, arm, seen_from, columns, in_order=section.in_order)
        doubts += found
        return _under_its_load(data.named(tool=section.tool, setup=section.setup), section, robot)
    try:
        how: dict[str, Any] = {
            "sigma": (in_si(section.sigma), in_si(section.sigma_angle)),
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
        from calib.job.propose import reading_that_fits  # noqa: PLC0415 - slow to load, and needed for this hint alone

        ready = reading_that_fits(folder / section.file, seen_from, section.observes)
        raise MeasurementError(f"{str(e).removesuffix('.')}; write in the job: {ready}." if ready else str(e)) from e
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
    link = None if section.instrument is None else carrier_of(job.instruments[section.instrument])
    if link is not None:
        # The camera is what the rows are about, and the board or mark is on the tip.
        for name in names:
            if on.setdefault(name, link) != link:
                raise JobError(f"{data.where}: the camera {name!r} is on {link!r}, and [targets] says {on[name]!r}.")
    data = replace(data, targets=names).named(tool=section.tool, setup=section.setup, on=on)
    return _under_its_load(data, section, robot)


def _under_its_load(data: Measurements, section: MeasurementsSection, robot: Robot) -> Measurements:
    payload = payload_of(section.payload)
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
    gap = None if section.gap is None else section.gap.si
    return Clock(section.clock or "free", section.latency is not None, gap, name, of)


def of_one_clock(
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
        place: CameraPlace = "tip" if section.camera_on == "tip" else "floor"
        free = {"given": (), "free": (*FOCAL, *CENTRE, *BENT)}.get(section.lens, section.lens)
        stated = {name: getattr(section, name) for name in NAMES}
        numbers: dict[str, Any] = {name: getattr(value, "si", value) for name, value in stated.items()}
        size = section.size
        if section.lens_file is not None:
            lens, of_file = lenses[section.lens_file]
            if of_file is not None and size not in (None, of_file):
                raise JobError(
                    f"instruments.{name}.size: is {size[0]} x {size[1]}, and {section.lens_file} says "
                    f"{of_file[0]} x {of_file[1]}; keep one of them."
                )
            numbers, size = lens._asdict(), of_file or size
        known = section.lens_sigma.by_name
        camera = Camera(place, **numbers, sigma=sigma, free=tuple(free), size=size, name=name, lens_sigma=known)
        refuse_other_focal_lengths(camera, f"instruments.{name}")
        return camera
    x, y, z = (length.si for length in section.station)
    return LaserTracker(sigma, section.sigma_per_metre.si, (x, y, z))


def model_sigmas(section: MeasurementsSection) -> tuple[float | None, ...]:
    """Return the standard deviations of the model part that the job fixes: of positions and, for poses, of angles."""
    position = in_si(section.model_sigma)
    return (position, in_si(section.model_sigma_angle)) if section.observes == "pose" else (position,)
