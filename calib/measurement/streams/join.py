"""Measurements of a stream and joint readings of another, as rows of one table."""

from dataclasses import replace

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import JobError, MeasurementError
from calib.measurement.measurements import Measurements
from calib.measurement.scalars import Scalar
from calib.measurement.streams.joints import JointStream
from calib.measurement.streams.lags import Lag, Moved, Seen, clock_lag, refined
from calib.measurement.streams.samples import refuse_no_stream
from calib.measurement.streams.stream import OFFSET, SKEW, Clock, Stream
from calib.robot.conditions import in_order, ordinary
from calib.robot.robot import Robot

# Rows so near to the end of what the joints' stream knows, in s, are left out: the fit still moves the clock a little.
MARGIN = 0.02
# Fewer rows that both clocks know, and a smaller share, are no overlap.
_FEWEST, _LEAST_SHARE = 20, 0.1
# Parameter scales and weak priors of offset and skew: a millisecond, a tenth of a millisecond a second; the start is
# far nearer than the priors.
_SCALES = {OFFSET: 1e-3, SKEW: 1e-4}
_WIDTHS = {OFFSET: 1.0, SKEW: 1e-2}
# Clocks that are farther apart, in s, would cost digits.
_FARTHEST = 1e6


def streamed(
    data: Measurements, joints: JointStream, clock: Clock, robot: Robot, *, ordered: bool = False
) -> Measurements:
    """Return measurements with ``times`` whose readings are those of a joint stream, by a clock.

    The start of a free clock is where speeds and positions fit the nominal robot
    (:mod:`calib.measurement.streams.lags`). Rows for which no joint is known, between pieces of the stream or beyond
    its ends, are left out. ``ordered``: the side from which joints were reached is that of their motion.

    Raises MeasurementError where the streams have nothing in common, JobError for a clock that the kind cannot show.
    """
    if data.times is None:
        raise TypeError("rows of a stream have times")
    refuse_no_stream(data.times, data.where)
    if data.other is not None:
        raise JobError(f"{data.where}: a pair_distance has two ends, and a row of a stream is of one moment.")
    middle = float(0.5 * (data.times[0] + data.times[-1]))
    stream = Stream(joints, read_only(data.times - middle), middle)
    lag = _lag(data, stream, clock, robot)
    given = {} if lag is None else {OFFSET: lag.offset, SKEW: lag.skew}
    roles = tuple(given) if clock.kind == "free" else tuple(given)[:1]
    shifts = {role: given[role] for role in roles}
    known = joints.covers(stream.times(shifts), MARGIN)
    if known.sum() < _FEWEST or known.mean() < _LEAST_SHARE:
        t, u = data.times, (joints.starts[0], joints.ends[-1])
        raise MeasurementError(
            f"{data.where}: {int(known.sum())} of its {len(data)} rows are within the time of {joints.where}: by its "
            f"clock {t[0]:.3f} to {t[-1]:.3f} s, there {u[0]:.3f} to {u[1]:.3f} s; the clocks do not overlap."
        )
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
    uses = {**rows.uses, **{role: len(rows.scalars) + k for k, role in enumerate(shifts)}}
    rows = replace(rows, scalars=(*rows.scalars, *scalars), uses=uses, absent=joints.absent)
    rows = rows.at_clock(np.array([one.start for one in rows.scalars]))
    if ordered:
        rows = replace(rows, conditions=replace(rows.conditions, approach=in_order(rows.readings)))
    return rows


def _said(role: str, clock: Clock) -> str:
    return "latency" if clock.latency else role.removeprefix("clock ")


def _lag(data: Measurements, stream: Stream, clock: Clock, robot: Robot) -> Lag | None:
    """Return where the search for a clock begins, None where nothing of it is free."""
    if clock.kind == "given" and not clock.latency:
        return None
    if data.position is None or data.times is None:
        raise JobError(
            f"{data.where}: a {data.kind} does not show by itself when it was measured; clocks are found from "
            'positions and poses; write clock = "given", or measure these.'
        )
    seen = Seen(data.times, data.position, data.where)
    joints, view = stream.joints, robot.with_tip(data.tip or robot.tip)

    def tips(times: Array) -> Array:
        readings = joints.at(times)
        return view.tips(readings, conditions=ordinary(readings))

    moved = Moved(tips, joints.covers, float(joints.starts[0]), float(joints.ends[-1]), joints.where)
    if clock.latency:
        return refined(seen, moved, stream.middle, Lag(0.0, 0.0)).lag
    lag = clock_lag(seen, moved, stream.middle, clock.gap)
    if not abs(lag.offset) <= _FARTHEST:
        raise MeasurementError(
            f"{data.where}: its clock is {lag.offset:.6g} s apart from that of {joints.where}; allowed are "
            f"{_FARTHEST:g} s: subtract the first time from one of them."
        )
    return lag
