"""What ``calib plan`` is told, in words and files, as the planner takes it; and what it tells."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from calib.assessment.candidates import Candidates, Sight
from calib.assessment.planning import Plan
from calib.assessment.views import Views, plan_views, view_candidates
from calib.cli.application import Telling
from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.choices import MOST_CANDIDATES, Criterion, Observed
from calib.foundations.csv_text import csv_text
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.files import is_there, write_new
from calib.foundations.ranges import OF_DIMENSION, RANGES, parse_within
from calib.foundations.units import DISPLAY_OF, NUMBER, Dimension
from calib.foundations.words import listed, shown
from calib.identification.error_model import ErrorModel, error_model
from calib.identification.identify import identify
from calib.job.columns import columns_alike
from calib.job.inputs import load
from calib.job.stated import load_arm
from calib.measurement.columns import stacked
from calib.measurement.table import AS_WRITTEN, Columns, read_table
from calib.presentation.command_tables import enough_sentence, forecast_sheet, index_sheet
from calib.presentation.console import warning
from calib.robot.collision import SelfCollision, self_collision
from calib.robot.conditions import NO_CONDITIONS, ordinary
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.sampling import limited_followers, limits, outside
from calib.robot.sources import EXAMPLE, examples_folder
from calib.robot.transmission import lacking

if TYPE_CHECKING:
    from calib.presentation.console import Steps

_NUMBER = re.compile(r"[+-]?[0-9]+", re.ASCII)


def pose_table(robot: Robot, readings: Array) -> str:
    """Return poses (N, nr) as the beginning of a measurement table: joints in degrees and mm."""
    header = [f"{reading.name} [{DISPLAY_OF[reading.dimension].symbol}]" for reading in robot.readings]
    factors = [DISPLAY_OF[reading.dimension].times for reading in robot.readings]
    return csv_text([header, *([f"{value:.4f}" for value in row] for row in readings * factors)])


class PlannedArm(NamedTuple):
    """An arm, what is to be found of it, the folders that may be read for its meshes, and how tables are read."""

    robot: Robot
    model: ErrorModel
    mesh_roots: tuple[Path, ...]
    columns: Columns


def arm(source: str, tip: str | None, observes: Observed, roots: tuple[Path, ...]) -> PlannedArm:
    """Return the arm of a job or of a URDF; of a job with several tips that of ``tip``."""
    if source.endswith(".toml"):
        arm = load_arm(Path(source))
        if tip is not None and tip not in arm.robot.links:
            tips = ", ".join(map(repr, arm.robot.links))
            raise JobError(f"{source}: {tip!r} is not a tip of the job; allowed is {tips}.")
        robot, model = arm.robot, arm.model
        if tip is not None and tip != arm.robot.tip:
            robot, model = robot.with_tip(tip), replace(model, robot=model.robot.with_tip(tip))
        return PlannedArm(robot, model, (*arm.mesh_roots, *roots), columns_alike(arm.job.measurements))
    if is_there(Path(source), Path.is_dir):
        raise JobError(
            f"{source}: is a folder; poses are planned for a URDF or a job, of results for calibrated.urdf in it."
        )
    robot = load_robot(source, tip)
    model = error_model(robot, offsets="all", placements="all", tool="pose" if observes == "pose" else "position")
    own = (examples_folder().parents[1],) if source.startswith(EXAMPLE) else (Path(source).parent,)
    return PlannedArm(robot, model, (*own, *roots), AS_WRITTEN)


def collision(robot: Robot, roots: tuple[Path, ...], *, wanted: bool) -> tuple[SelfCollision | None, list[str]]:
    """Return how the arm touches itself, None where that is not wanted or not known, and what is to be said of it."""
    if not wanted or b"<collision" not in robot.urdf.source:
        return None, []
    found = self_collision(robot, roots)
    if found is None:
        return None, ["None of the URDF's collision shapes can be read; --mesh-root may help."]
    return found, list(found.notes)


def untold(model: ErrorModel) -> list[str]:
    """Return what is to be said of joint terms that depend on more than the pose."""
    names = [reading.name for reading in model.robot.readings]
    free = [term for term in model.robot.terms if term.name in model.terms]
    untold = [term.name for term in free if lacking([term], names, NO_CONDITIONS)]
    if not untold:
        return []
    return [
        f"{', '.join(untold)}: depend on sides of approach, temperatures or torques and not on the poses alone; the "
        "plan is for the other parameters."
    ]


def without_room(robot: Robot) -> list[str]:
    """Return what is to be said of joints that their limits hold in one place."""
    held = [reading.name for reading in robot.readings if reading.lower is not None and reading.lower == reading.upper]
    if not held:
        return []
    return [
        f"{robot.urdf.where}: limits leave no room to {listed(held)}: no pose moves them, and a calibration says that "
        "it cannot be trusted. A <limit> without lower and upper is from 0 to 0."
    ]


def led_beyond(robot: Robot, readings: Array) -> list[str]:
    """Return what is to be said of joints that follow others, beyond their own limits at readings (N, nr)."""
    led = limited_followers(robot)
    if not led:
        return []
    columns, joints = [k for k, _ in led], [joint for _, joint in led]
    q = robot.joint_positions(readings, conditions=ordinary(readings))[:, columns]
    beyond = outside(q, *limits(joints))
    if not beyond.any():
        return []
    names = [joint.name for joint, own in zip(joints, beyond.T, strict=True) if own.any()]
    many = np.count_nonzero(beyond.any(axis=1))
    return [
        f"{listed(names)}: beyond the limits in the URDF in {many} of {len(readings)} poses; limits of "
        "what follows other joints are often written without care. If these are right, narrow those of the joints that "
        "are followed, or give --candidates."
    ]


def is_count(text: str) -> bool:
    """Return whether candidates are a number, and no file."""
    return _NUMBER.fullmatch(text) is not None


def parsed_count(text: str) -> int:
    """Return a number of candidates."""
    # A number of thousands of digits is none for Python.
    if not 1 <= float(text) <= MOST_CANDIDATES:
        raise JobError(f"candidates: {shown(text)} is not a number from 1 to {MOST_CANDIDATES}, nor a file.")
    return int(text)


def base(tracker: str | None) -> Array:
    """Return the base in the instrument's frame, whose axes are taken to be the base's."""
    return np.eye(4) if tracker is None else rigid.translation(-point(tracker, "tracker"))


def sight(tracker: str | None, facing: str | None, acceptance: str, nearest: str, farthest: str | None) -> Sight | None:
    """Return what the tracker sees; None where nothing is said of it."""
    if tracker is None:
        return None
    return Sight(
        facing=None if facing is None else _direction(facing, "facing"),
        acceptance=parsed(acceptance, "acceptance", "angle"),
        nearest=parsed(nearest, "nearest"),
        farthest=float("inf") if farthest is None else parsed(farthest, "farthest"),
    )


def table_readings(path: Path, robot: Robot, columns: Columns) -> Array:
    """Return the readings (N, nr) of a table, whatever else is in it."""
    table = read_table(path, columns)
    dimensions: dict[str, Dimension] = {reading.name: reading.dimension for reading in robot.readings}
    if missing := [name for name in dimensions if name not in table.columns]:
        raise MeasurementError(f"{path}: there is no column {', '.join(map(repr, missing))} of a joint.")
    return stacked(table, dimensions)


def different_readings(path: Path, robot: Robot, columns: Columns) -> Array:
    """Return the readings of a table, each pose once: a table of marks has a row of its pose for every mark."""
    readings = table_readings(path, robot, columns)
    _, first = np.unique(readings, axis=0, return_index=True)
    return np.asarray(readings[np.sort(first)], dtype=np.float64)


def refuse_few(path: str, count: int, found: Candidates) -> None:
    """Raise JobError where a table has fewer candidates than poses are asked for, with what was in the way."""
    if count > len(found.readings):
        left_out = f" of its {found.tried} poses: {_rejected(found)}" if found.rejected else " candidates"
        raise JobError(f"{path}: {count} poses cannot be chosen from {len(found.readings)}{left_out}.")


def impossible(path: Path, found: Candidates) -> list[str]:
    """Return what is to be said of rows of a table where the arm cannot have been."""
    said = f"{path}: of {found.tried} rows {_rejected(found)}: are its columns and units right?"
    return [said] if found.rejected else []


def _rejected(found: Candidates) -> str:
    return ", ".join(f"{n} {reason}" for reason, n in found.rejected.items())


def point(text: str, what: str) -> Array:
    """Return a point (3,) in m of a text like ``50 0 50 mm``."""
    *numbers, unit = text.split() or [""]
    return np.array([parsed(f"{number} {unit}", what) for number in _words(numbers, text, what)])


def _direction(text: str, what: str) -> tuple[float, float, float]:
    """Return what points somewhere, three numbers without a unit; the planner says whether they are in range."""
    words = _words(text.split(), text, what, "0 0 1")
    if not all(map(NUMBER.fullmatch, words)):
        raise _not_three(text, what, "0 0 1")
    x, y, z = map(float, words)
    return x, y, z


def _words(numbers: list[str], text: str, what: str, example: str = "50 0 50 mm") -> list[str]:
    if len(numbers) != 3:
        raise _not_three(text, what, example)
    return numbers


def _not_three(text: str, what: str, example: str) -> JobError:
    return JobError(f"{what}: {text!r} is not three numbers, like {example!r}.")


def parsed(text: str, what: str, dimension: Dimension = "length") -> float:
    """Return a quantity in SI units, in the range of its name or of its dimension."""
    return parse_within(text, RANGES.get(what, OF_DIMENSION[dimension]), what)


def tell_plan(
    telling: Telling,
    planned: Plan,
    found: Candidates,
    notes: Sequence[str],
    names: tuple[str, str],
    out: Path,
    target: str | None,
    *,
    more: bool,
) -> None:
    """Tell what was chosen, and from what. ``names``: of candidates, and of what is in ``out``."""
    rejected = _rejected(found)
    telling.tell(
        lambda: {**planned.contents(), "rejected": dict(found.rejected), "notes": list(notes)},
        lambda: [
            *map(warning, notes),
            f"{len(found.readings)} {names[0]} of {found.tried} tried{': ' + rejected if rejected else ''}.",
            f"They determine {planned.rank} combinations of {planned.parameters} parameters.",
            forecast_sheet(planned),
            index_sheet(planned),
            *([] if target is None else [enough_sentence(planned, target, more=more)]),
            f"{len(planned.readings)} {names[1]} are in {out}.",
        ],
    )


def sampling(say: "Steps") -> Callable[[int, int], None]:
    """Return what tells how many candidates there are."""

    def told(done: int, of: int) -> None:
        say(f"sampling candidates, {done} of {of} found")
        say.expect(1)

    return told


def choosing(say: "Steps", what: str) -> Callable[[int, int], None]:
    """Return what tells how many designs are made."""

    def told(done: int, of: int) -> None:
        if done < of:
            say(f"choosing {what}")
            say.expect(of - done - 1)

    return told


def plan_photographs(
    job: str,
    out: Path,
    count: int,
    candidates: str,
    working: Path | None,
    criterion: Criterion,
    target: str | None,
    collisions: bool,
    mesh_roots: Sequence[Path],
    seed: int,
    telling: Telling,
) -> None:
    """Write the readings at which to take photographs, as ``calib plan`` writes poses."""
    if not job.endswith(".toml"):
        raise JobError(f"{job}: photographs are planned beside those of a job; take a few, and calib import images.")
    if not is_count(candidates):
        raise JobError(
            f"candidates: {shown(candidates)} is not a number from 1 to {MOST_CANDIDATES}; views to photograph are "
            "drawn at random."
        )
    drawn = parsed_count(candidates)
    with telling.progress(steps=4) as say:
        say("reading the job")
        inputs = load(Path(job))
        say("finding camera, board and lens")
        fit = identify(inputs.model, [*inputs.identify, *inputs.validate])
        views = Views(fit)
        columns = columns_alike(inputs.job.measurements)
        right = None if working is None else table_readings(working, fit.robot, columns)
        touching, notes = collision(fit.robot, (*inputs.mesh_roots, *mesh_roots), wanted=collisions)
        say("sampling views")
        found = view_candidates(views, drawn, touching, seed=seed)
        planned = plan_views(
            views,
            count,
            candidates=found.readings,
            criterion=criterion,
            working=right,
            target=None if target is None else parse_within(target, RANGES["sigma"], "target"),
            progress=choosing(say, f"{count} of {len(found.readings)} views"),
        )
        write_new(out, pose_table(fit.robot, planned.readings))
    tell_plan(telling, planned, found, notes, ("views", "photographs to take"), out, target, more=True)
