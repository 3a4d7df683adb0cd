"""Commands out: the joint targets with which a calibrated machine goes where it should."""

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from calib.compensation.corrections import Corrections, better
from calib.compensation.inverse import Asked, Effort, How, cut_short, price, rowwise, solve
from calib.compensation.order import by_order, with_sides
from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray
from calib.foundations.choices import PoseFrame, What
from calib.foundations.errors import JobError
from calib.foundations.ranges import are_numbers, refuse_beyond
from calib.foundations.words import not_calibrated
from calib.machine.calibrated import CalibratedMachine, refuse_unfollowed
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.robot import TipModel
from calib.robot.sampling import limits
from calib.robot.transmission import lacking

# A reading that changes by more (rad or m) than any calibration error asks is worth a remark.
_REMARKABLE = 0.1
_STARTS = 12
# Links that bend and errors of positions make an arm longer by less than this share.
_SPARE = 0.05


@checked
def for_joint_targets(
    model: CalibratedMachine,
    readings: Array,
    tool: str | Sequence[str] = "tool",
    *,
    what: What = "pose",
    clamp: bool = False,
    conditions: Conditions = NO_CONDITIONS,
    tolerance: tuple[float, float] = (1e-6, 1e-6),
) -> Corrections:
    """Return the commands with which the calibrated machine goes where the nominal one would at readings (N, nr).

    The nominal machine has the same base and tool. ``tool``: one for all rows, or N. ``what``: reach the tool's whole
    pose, or its position alone, as arms of fewer than six joints need. Outside the range of the machine's residual
    model, rows are refused; with ``clamp`` they use the value at its edge, with a remark. A row is reached within
    ``tolerance``, in m and rad. ``conditions`` of the rows: what joint terms need besides readings; of rows that are
    visited one after the other, ``Conditions(ordered=True)`` takes the sides of approach from the commands themselves.

    Raises JobError when an option or an array cannot be used, or a condition that a joint term needs is not given.
    """
    model = at_tip(model, tool)
    readings = _start(model, readings)
    conditions = _conditions(model, conditions, len(readings))
    tools = _tools(model, tool, len(readings))
    nominal = TipModel(model.robot)
    tips, why = rowwise(nominal.tips, readings, (4, 4))
    reasons = ["" if not text else f"the nominal machine: {text}" for text in why]
    how = How(what, model.residual_model, clamp, tolerance, _REMARKABLE)
    asked = Asked(tips @ tools, tools, readings, tuple(reasons), conditions)
    if not conditions.ordered:
        return solve(model, asked, how)

    def correct(told: Conditions, rows: IntArray, _: Corrections | None) -> Corrections:
        return solve(model, replace(asked, conditions=told).subset(rows), how)

    return by_order(model, tools, readings, conditions, correct)


@checked
def for_poses(
    model: CalibratedMachine,
    poses: Array,
    start: Array | None = None,
    tool: str | Sequence[str] = "tool",
    *,
    frame: PoseFrame = "base",
    clamp: bool = False,
    conditions: Conditions = NO_CONDITIONS,
    tolerance: tuple[float, float] = (1e-6, 1e-6),
) -> Corrections:
    """Return the commands that bring the tool to poses (N, 4, 4), or to positions (N, 3) in any orientation.

    ``frame``: that of the poses, the robot's base link or the instrument that it was calibrated with. The search starts
    from readings ``start`` (N, nr) and ends in the same configuration if it can; without them, it starts from the
    middle of the limits and then from up to eleven other places, the same ones at every call. Other options, and
    errors, as :func:`for_joint_targets`.
    """
    poses = np.asarray(poses, dtype=np.float64)
    if poses.shape[1:] not in ((4, 4), (3,)):
        raise JobError(f"the poses have the shape {poses.shape}; allowed are (N, 4, 4), and (N, 3) for positions.")
    if not np.isfinite(poses).all():
        raise JobError("the poses must be finite numbers.")
    places = poses if poses.ndim == 2 else poses[:, :3, 3]
    if len(places):
        refuse_beyond([places.min(), places.max()], "position, station, point", "the poses: a position")
    if frame not in ("base", "instrument"):
        raise JobError(f"the frame of the poses is {frame!r}; allowed are base, instrument.")
    model = at_tip(model, tool)
    conditions = _conditions(model, conditions, len(poses))
    what: What = "pose"
    if poses.ndim == 2:
        what, poses = "position", rigid.translation(poses)
    elif len(poses) and not (are_numbers(poses) and rigid.are_placements(poses).all()):
        raise JobError("the poses are not all placements: a rotation is not one, or the last row is not 0 0 0 1.")
    if frame == "instrument":
        poses = rigid.inverse(model.base) @ poses
    n, how = len(poses), How(what, model.residual_model, clamp, tolerance, np.inf)
    tools = _tools(model, tool, n)
    if start is not None:
        start = _start(model, start)
        if len(start) != n:
            raise JobError(
                f"there are {len(start)} rows of readings to start from and {n} poses; there must be as many."
            )

    def correct(told: Conditions, rows: IntArray, so_far: Corrections | None) -> Corrections:
        # In the configuration that was found: another one would be reached from other sides.
        begin = so_far.readings if start is None and so_far is not None else start
        if begin is None:
            return _from_anywhere(model, poses[rows], tools[rows], told.subset(rows), how)
        return solve(model, Asked(poses, tools, begin, ("",) * n, told).subset(rows), how)

    if not conditions.ordered:
        return correct(conditions, np.arange(n), None)
    return by_order(model, tools, start, conditions, correct)


def at_tip(model: CalibratedMachine, tool: str | Sequence[str]) -> CalibratedMachine:
    """Return the machine looked at the tip that carries all the tools. Raises JobError where these are on several."""
    names = [name for name in dict.fromkeys((tool,) if isinstance(tool, str) else tool) if name in model.tools]
    tips = {model.of(name).robot.tip: name for name in names}
    if len(tips) > 1:
        one, other = list(tips.values())[:2]
        raise JobError(f"the tools {one!r} and {other!r} are on different links; correct their targets one by one.")
    return model.of(names[0]) if names else model


def _from_anywhere(
    model: CalibratedMachine, poses: Array, tools: Array, conditions: Conditions, how: How
) -> Corrections:
    """Return the commands for poses (N, 4, 4) in the base link that no readings are given to start from."""
    n = len(poses)
    found: Corrections | None = None
    refused = _out_of_reach(model, poses, tools)
    effort = Effort(n, price(model, how.residuals))
    for row in _starting_places(model):
        left = np.arange(n) if found is None else np.flatnonzero(~found.reached & [not text for text in refused])
        if found is not None and not len(left):
            break
        if found is not None and effort.spent:
            return cut_short(found, refused)
        asked = Asked(poses, tools, np.broadcast_to(row, (n, len(row))), refused, conditions)
        more = solve(model, asked.subset(left), how, effort)
        found = more if found is None else better(found, more, left)
        if found.reached.all():
            break
    return cast(Corrections, found)


# ---- arguments


def _start(model: CalibratedMachine, readings: Array) -> Array:
    readings = np.asarray(readings, dtype=np.float64)
    k = len(model.robot.readings)
    if readings.ndim != 2 or readings.shape[1] != k:
        raise JobError(f"the readings have the shape {readings.shape}; allowed is (N, {k}), a column for each joint.")
    if not are_numbers(readings):
        raise JobError("the readings must be finite numbers.")
    return readings


def _conditions(model: CalibratedMachine, conditions: Conditions, rows: int) -> Conditions:
    """Return the conditions of the rows, of which joint terms of the machine lack nothing."""
    names = [reading.name for reading in model.robot.readings]
    conditions.refuse_other_rows(rows, len(names))
    conditions = with_sides(conditions, rows, len(names))
    if missing := lacking(model.robot.terms, names, conditions):
        raise JobError(f"{missing[0]} of the machine needs {missing[1]!r} for every target.")
    refuse_unfollowed(model.robot, conditions)
    return conditions


def _tools(model: CalibratedMachine, tool: str | Sequence[str], n: int) -> Array:
    """Return the tool's pose in the tip link of every row: (N, 4, 4)."""
    names = [tool] * n if isinstance(tool, str) else list(tool)
    if len(names) != n:
        raise JobError(f"{len(names)} tools are named for {n} targets; there must be one, or as many.")
    for name in {tool} if isinstance(tool, str) else dict.fromkeys(names):
        if name not in model.tools:
            raise JobError(f"{not_calibrated('tool', name, model.tools)}.")
    return np.array([model.tools[name] for name in names]).reshape(-1, 4, 4)


def _out_of_reach(model: CalibratedMachine, poses: Array, tools: Array) -> tuple[str, ...]:
    """Return why no search is needed for poses (N, 4, 4) in the base link: farther than all links in one line."""
    d = model.deviations
    longest = model.robot.reach + float(np.sum(np.linalg.norm(d.placements[:, :3], axis=1)) + np.sum(np.abs(d.offsets)))
    reach = (1.0 + _SPARE) * longest + np.linalg.norm(tools[:, :3, 3], axis=1)
    away = np.linalg.norm(poses[:, :3, 3], axis=1)
    return tuple(
        f"is {there:.4g} m from the base, and all links in one line are {most:.4g} m" if there > most else ""
        for there, most in zip(away, reach, strict=True)
    )


def _starting_places(model: CalibratedMachine) -> Array:
    """Return readings (12, nr) within the limits: the middle, then others spread at random, always the same."""
    low, high = limits(model.robot.readings)
    size = np.array([np.pi if reading.dimension == "angle" else 1.0 for reading in model.robot.readings])
    low = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high - size, -size))
    high = np.where(np.isfinite(high), high, low + 2.0 * size)
    share = np.random.default_rng(0).uniform(0.1, 0.9, (_STARTS, len(low)))
    share[0] = 0.5
    return np.asarray(low + share * (high - low))
