"""Samples of a controller and of an instrument, as a table has them: times that grow, and readings of joints."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from calib.foundations.arrays import Array, read_only, read_only_view
from calib.foundations.errors import MeasurementError
from calib.foundations.units import Dimension
from calib.measurement.columns import filled, numbers, refuse_unknown, require, stacked
from calib.measurement.from_table import ALL_READ, Joints
from calib.measurement.streams.joints import AT_REST, JointStream, following
from calib.measurement.table import APPROACH, COMMANDED, TORQUE, Table
from calib.robot.robot import Reading

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

# What has samples rarer than one a second, or ten thousand in it, is no stream of joints or points.
SLOWEST, FASTEST = 1.0, 1e-4
# Steps between times that are differences of large numbers.
_ROUNDING = 1e-3
# Rows of which half follow in so small a part of their mean distance were sent many at once.
_BURST = 20.0
# Gaps from so many steps of a stream on are not bridged: one lost sample is. In s, at the least and at the most.
_STEPS, _LEAST_GAP, _MOST_GAP = 2.5, 0.1, 0.25
# A cubic needs as many samples.
_FEWEST = 4
# Samples of which the equations of a cubic are in memory at a time, and beside them.
_PART, _BESIDE = 50_000, 100
# So many samples tell how joints follow.
_MOST = 200_000


def joint_stream(
    table: Table, readings: Sequence[Reading], gap: float | None, joints: Joints = ALL_READ
) -> JointStream:
    """Return the joint readings of a table with ``time``; a ``gap`` in s, or a longer one, is not bridged.

    None is the gap of :func:`not_bridged`.

    Columns ``commanded_<joint>`` tell how well joints followed; where there are no others, they stand for the readings.
    ``joints``: which of the URDF's are needed. Raises MeasurementError when a column is missing, when time runs
    backwards or is in another unit than it says, and when no joint moves.
    """
    dimensions: dict[str, Dimension] = {reading.name: reading.dimension for reading in readings}
    absent = tuple(name for name in joints.spare if name in dimensions and name not in table.columns)
    told: dict[str, Dimension] = {
        name: dimensions[name] for name in dimensions if f"{COMMANDED}{name}" in table.columns
    }
    needed = [name for name in dimensions if name not in absent]
    # A log of commands alone is better than none.
    commanded = bool(told) and not any(name in table.columns for name in needed)
    require(table, [f"{COMMANDED}{name}" for name in needed] if commanded else needed, "of a joint")
    refuse_unknown(table, dimensions, joints.unread, joints.idle, (TORQUE, APPROACH, COMMANDED))
    called = {f"{COMMANDED if commanded else ''}{name}": dimension for name, dimension in dimensions.items()}
    times, values = times_of(table), filled(table, called)
    keep = np.concatenate([[True], np.diff(times) > 0.0])
    doubled = np.flatnonzero(~keep)
    if len(doubled) and np.any(values[doubled] != values[doubled - 1]):
        row = int(doubled[np.any(values[doubled] != values[doubled - 1], axis=1)][0])
        raise MeasurementError(
            f"{table.where}:{table.lines[row]}: has the same time as the row before, but other readings; give each row "
            "its own time."
        )
    asked = stacked(table, {f"{COMMANDED}{name}": dimension for name, dimension in told.items()})
    times, values, asked = times[keep], values[keep], asked[keep]
    refuse_no_stream(times, table.where)
    if np.ptp(values, axis=0).max(initial=0.0) <= AT_REST:
        raise MeasurementError(
            f"{table.where}: no joint moves by more than {AT_REST:g} rad or m; a clock shows only while the arm moves."
        )
    gap = not_bridged(times, gap)
    ends = np.flatnonzero(np.diff(times) >= gap)
    runs = [
        (a, b) for a, b in zip(np.append(0, ends + 1), np.append(ends + 1, len(times)), strict=True) if b - a >= _FEWEST
    ]
    if not runs:
        raise MeasurementError(
            f"{table.where}: no {_FEWEST} samples follow each other within {gap:.4g} s; allow longer gaps, or give a "
            "denser stream."
        )
    turning = [k for k, dimension in enumerate(dimensions.values()) if dimension == "angle"]
    whole = values.copy()
    for a, b in runs:
        # What is told as -179.9 deg after 179.9 has not gone all the way back between two samples.
        whole[a:b, turning] = np.unwrap(values[a:b, turning], axis=0)
    stream = JointStream(
        tuple(dimensions),
        tuple(_cubic(times[a:b], whole[a:b]) for a, b in runs),
        read_only([times[a] for a, _ in runs]),
        read_only([times[b - 1] for _, b in runs]),
        table.where,
        absent,
        commanded=commanded,
    )
    if told and not commanded:
        some = np.flatnonzero(stream.covers(times))
        some = some[:: len(some) // _MOST + 1]
        own = [k for k, name in enumerate(dimensions) if name in told]
        stream = replace(
            stream, following=following(told, values[some][:, own], asked[some], stream.rates(times[some])[:, own])
        )
    a, b = max(runs, key=lambda run: run[1] - run[0])
    b = min(b, a + _PART)
    if b - a < 2 * _FEWEST:
        return stream
    t = times[a:b:2]
    half = _cubic(t, whole[a:b:2])
    return stream.showing(replace(stream, pieces=(half,), starts=read_only(t[:1]), ends=read_only(t[-1:])))


def _cubic(times: Array, values: Array) -> "BSpline":
    """Return the cubic spline through samples (n,), (n, k), part by part where there are many.

    What samples far away change, fades by a factor of 4 from one to the next.
    """
    from scipy.interpolate import BSpline, make_interp_spline  # noqa: PLC0415 - slow to load; few jobs have streams

    n = len(times)
    if n <= _PART + 2 * _BESIDE:
        return make_interp_spline(times, values, k=3)
    coefficients = np.empty_like(values)
    for start in range(0, n, _PART):
        low, high = max(start - _BESIDE, 0), min(start + _PART + _BESIDE, n)
        own = make_interp_spline(times[low:high], values[low:high], k=3).c
        coefficients[start : start + _PART] = own[start - low : start - low + _PART]
    # Knots are the samples but the second and the last but one: not a knot (C. de Boor).
    knots = np.concatenate([np.repeat(times[0], 4), times[2:-2], np.repeat(times[-1], 4)])
    return BSpline.construct_fast(knots, coefficients, 3)


def times_of(table: Table) -> Array:
    """Return the column ``time`` (N,) in s. Raises MeasurementError where it is missing or runs backwards."""
    require(table, ("time",), "of a stream")
    times = numbers(table, "time", "time")
    table.refuse(
        np.diff(times, prepend=times[0]) < 0.0,
        lambda row: (
            f"the time {times[row]:.6f} s is before that of the row above, {times[row - 1]:.6f} s; the rows of a "
            "stream are in order of time."
        ),
    )
    return read_only_view(times)


def not_bridged(times: Array, gap: float | None) -> float:
    """Return from which gap on, in s, nothing is bridged between rows at times (N,) in s: what is given, or usual."""
    return float(np.clip(_STEPS * np.median(np.diff(times)), _LEAST_GAP, _MOST_GAP)) if gap is None else gap


def refuse_no_stream(times: Array, where: str) -> None:
    """Raise MeasurementError when the rows are too few or too far apart for a stream, as with a wrong unit of time."""
    if len(times) < _FEWEST:
        raise MeasurementError(f"{where}: has {len(times)} samples, and a stream needs {_FEWEST}.")
    steps = np.diff(times)
    step = float(np.median(steps))
    if not FASTEST * (1.0 - _ROUNDING) <= step <= SLOWEST * (1.0 + _ROUNDING):
        than = "more" if step > SLOWEST else "less"
        said = f"half of its rows are {step:.4g} s apart or {than}; in a stream it is {FASTEST:g} to {SLOWEST:g} s"
        # Of an instrument that sends many samples at once, the times of arrival say little of when each was taken.
        asked = "is the unit of 'time' right?"
        if step > SLOWEST:
            asked += " Points at which the arm stood still are no stream: give each its own row of the joints."
        if step < FASTEST and float(steps.mean()) > max(_BURST * step, FASTEST):
            asked = "they come in bursts: are these the times at which they arrived, and not those of measurement?"
        raise MeasurementError(f"{where}: {said}: {asked}")
