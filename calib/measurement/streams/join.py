"""Measurements of a stream and joint readings of another, as rows of one table."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.foundations.arrays import Array, BoolArray, read_only
from calib.foundations.errors import JobError, MeasurementError
from calib.measurement.from_table import reached
from calib.measurement.measurements import Measurements
from calib.measurement.scalars import Scalar
from calib.measurement.streams.joints import JointStream
from calib.measurement.streams.lags import Lag, Moved, Seen, clock_lag, refined
from calib.measurement.streams.samples import not_bridged, refuse_no_stream
from calib.measurement.streams.sides import sides
from calib.measurement.streams.stream import LATENCY, OFFSET, SKEW, Clock, OneClock, Stream
from calib.robot.conditions import ordinary
from calib.robot.robot import Robot

# Rows so near to the end of what the joints' stream knows, in s, are left out: the fit still moves the clock a little.
MARGIN = 0.02
# Fewer rows that both clocks know, and a smaller share, are no overlap.
_FEWEST, _LEAST_SHARE = 20, 0.1
# Rows at which some joint has just turned are left out where such a share is not of them.
_LEAST_SETTLED = 0.2
# Parameter scales and weak priors of offset and skew: a millisecond, a tenth of a millisecond a second; the start is
# far nearer than the priors.
_SCALES = {OFFSET: 1e-3, SKEW: 1e-4}
_WIDTHS = {OFFSET: 1.0, SKEW: 1e-2}
# Clocks that are farther apart, in s, would cost digits.
_FARTHEST = 1e6


def streamed(
    data: Measurements,
    joints: JointStream,
    clock: Clock,
    robot: Robot,
    *,
    ordered: bool = False,
) -> Measurements:
    """Return measurements with ``times`` whose readings are those of a joint stream, by a clock.

    The start of a free clock is where speeds and positions fit the nominal robot
    (:mod:`calib.measurement.streams.lags`). Rows for which no joint is known, between pieces of the stream or beyond
    its ends, are left out. ``ordered``: the side from which joints were reached is that of their motion.

    Raises MeasurementError where the streams have nothing in common, JobError for a clock that the kind cannot show.
    """
    if data.times is None:
        raise TypeError("rows of a stream have times")
    # The marks of one photograph have one time.
    refuse_no_stream(data.times if data.camera is None else np.unique(data.times), data.where)
    if data.other is not None:
        raise JobError(f"{data.where}: a pair_distance has two ends, and a row of a stream only one moment.")
    if clock.of is not None:
        return _in_order(_of_one_clock(data, joints, clock, robot, clock.of), ordered)
    if clock.latency and clock.kind == "free":
        raise JobError(
            "latency: is free, and the clock is free too: the data cannot tell the latency from the clock's offset; "
            'write clock = "given", or clock_of if another stream has the same clock, or leave latency out.'
        )
    middle = float(0.5 * (data.times[0] + data.times[-1]))
    stream = Stream(joints, read_only(data.times - middle), middle)
    lag = _lag(data, stream, clock, robot)
    given = {} if lag is None else {OFFSET: lag.offset, SKEW: lag.skew}
    roles = tuple(given) if clock.kind == "free" else tuple(given)[:1]
    shifts = {role: given[role] for role in roles}
    known = _known(data, stream, shifts)
    # The offset is told in the middle of what is used.
    used = data.times[known]
    middle = float(0.5 * (used[0] + used[-1]))
    if lag is not None:
        shifts[OFFSET] = lag.offset - shifts.get(SKEW, 0.0) * (middle - stream.middle)
    stream = Stream(joints, read_only(used - middle), middle)
    rows = replace(data.subset(known), stream=stream)
    scalars = tuple(
        Scalar(
            f"{clock.name}.{_said(role, clock)}",
            "s" if role == OFFSET else "s/s",
            _SCALES[role],
            start,
            weak_prior=_WIDTHS[role],
        )
        for role, start in shifts.items()
    )
    return _in_order(_with_clock(rows, dict(zip(shifts, scalars, strict=True))), ordered)


def _in_order(rows: Measurements, ordered: bool) -> Measurements:
    """Return rows with the readings that they have at the start, and where asked for those with known sides."""
    starts = np.array([one.start for one in rows.scalars])
    rows = rows.at_clock(starts)
    if not ordered or rows.stream is None:
        return rows
    came = sides(rows.stream.joints, rows.stream.times(rows.shifts(starts)))
    settled = np.all(np.isfinite(came), axis=1)
    if settled.mean() < _LEAST_SETTLED:
        settled[:] = True
    found = rows.subset(settled).with_own_names()
    # Where there is hardly a row at which all are known, a joint between two sides is in the middle.
    approach = read_only(np.nan_to_num(came[settled]))
    found = reached(replace(found, conditions=replace(found.conditions, approach=approach)))
    return replace(found, unreached=found.unreached + int(np.count_nonzero(~settled)))


def _known(data: Measurements, stream: Stream, shifts: Mapping[str, float]) -> BoolArray:
    """Return the rows for which joints are known. Raises MeasurementError where they are too few."""
    joints = stream.joints
    known = joints.covers(stream.times(shifts), MARGIN)
    if known.sum() < _FEWEST or known.mean() < _LEAST_SHARE:
        t, u = stream.since + stream.middle, (joints.starts[0], joints.ends[-1])
        raise MeasurementError(
            f"{data.where}: {int(known.sum())} of its {len(data)} rows are within the time of {joints.where}: by its "
            f"clock {t[0]:.3f} to {t[-1]:.3f} s, there {u[0]:.3f} to {u[1]:.3f} s; the clocks do not overlap."
        )
    return known


def _of_one_clock(data: Measurements, joints: JointStream, clock: Clock, robot: Robot, first: OneClock) -> Measurements:
    """Return a stream that goes by the clocks of another one, whose middle is where the offset of both is told."""
    assert data.times is not None, "rows of a stream have times"
    middle = first.middle
    stream = Stream(joints, read_only(data.times - middle), middle)
    shifts = {OFFSET: first.offset.start, SKEW: first.skew.start}
    scalars = [first.offset, first.skew]
    if clock.latency:
        near = Lag(shifts[OFFSET], shifts[SKEW])
        found = refined(*_moving(data, joints, robot, clock), middle, near).lag
        own = float(0.5 * (data.times[0] + data.times[-1])) - middle
        shifts[LATENCY] = (found.offset - near.offset) - (found.skew - near.skew) * own
        name, size, wide = f"{clock.name}.latency", _SCALES[OFFSET], _WIDTHS[OFFSET]
        scalars.append(Scalar(name, "s", size, shifts[LATENCY], weak_prior=wide))
    known = _known(data, stream, shifts)
    rows = replace(data.subset(known), stream=stream.subset(known))
    return _with_clock(rows, dict(zip(shifts, scalars, strict=True)))


def _with_clock(rows: Measurements, clock: Mapping[str, Scalar]) -> Measurements:
    """Return rows of a stream with the unknown numbers of its clock, by what they are to it."""
    uses = {role: len(rows.scalars) + k for k, role in enumerate(clock)}
    absent = rows.absent if rows.stream is None else rows.stream.joints.absent
    return replace(rows, scalars=(*rows.scalars, *clock.values()), uses={**rows.uses, **uses}, absent=absent)


def _said(role: str, clock: Clock) -> str:
    return "latency" if clock.latency else role.removeprefix("clock ")


def _lag(data: Measurements, stream: Stream, clock: Clock, robot: Robot) -> Lag | None:
    """Return where the search for a clock begins, None where nothing of it is free."""
    if clock.kind == "given" and not clock.latency:
        return None
    seen, moved = _moving(data, stream.joints, robot, clock)
    if clock.latency:
        return refined(seen, moved, stream.middle, Lag(0.0, 0.0)).lag
    try:
        lag = clock_lag(seen, moved, stream.middle, not_bridged(seen.times, clock.gap))
    except MeasurementError as e:
        if data.points is None or not np.ptp(data.points, axis=0).any():
            raise
        raise MeasurementError(
            f"{data.where}: its points are at other places of the tool from row to row (point_x, point_y, point_z), so "
            'their speed does not show when they were measured; write clock = "given" if both files have one clock, or '
            "stream one point."
        ) from e
    if not abs(lag.offset) <= _FARTHEST:
        raise MeasurementError(
            f"{data.where}: its clock is {lag.offset:.6g} s apart from that of {moved.where}; allowed are "
            f"{_FARTHEST:g} s: subtract the first time from one of them."
        )
    return lag


def _moving(data: Measurements, joints: JointStream, robot: Robot, clock: Clock) -> tuple[Seen, Moved]:
    """Return what was seen, and how the nominal tip moved. Raises JobError for a kind that shows no clock."""
    if data.position is None or data.times is None:
        what, remedy = ("latency", "leave latency out") if clock.latency else ("clock", 'write clock = "given"')
        raise JobError(
            f"{data.where}: a {data.kind} alone does not show when it was measured, and a free {what} is found from "
            f"positions and poses only; {remedy}, or measure positions or poses."
        )
    view = robot.with_tip(data.tip or robot.tip)

    def tips(times: Array) -> Array:
        readings = joints.at(times)
        return view.tips(readings, conditions=ordinary(readings))

    moved = Moved(tips, joints.covers, float(joints.starts[0]), float(joints.ends[-1]), joints.where)
    groups = np.unique(np.column_stack([data.setup, data.tool]), axis=0, return_inverse=True)[1].ravel()
    return Seen(data.times, data.position, data.where, groups.astype(np.intp)), moved
