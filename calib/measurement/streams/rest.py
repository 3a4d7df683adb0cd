"""Poses at which the arm stood still, from rows of a stream: averages, and how sure these are."""

from dataclasses import replace

import numpy as np
import scipy

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.chance import correlation_time
from calib.foundations.errors import JobError, MeasurementError
from calib.measurement.measurements import Measurements

# A joint is still while its reading stays within so many rad or m: above the jitter of encoders.
STILL = 2e-4
# What rests has settled after such a time, in s, and clocks are not known better.
_SETTLED = 0.2
# Fewer rows of a rest have no scatter.
_FEWEST = 5
# The scatter of so few numbers is not below this share of that of all rests.
_LEAST_SHARE = 0.3


@checked
def at_rest(data: Measurements, least: float = 0.5, still: float = STILL) -> Measurements:
    """Return one row for every time when all joints stood still: readings and points are means over it.

        stops = calib.measuring.at_rest(calib.measuring.read_stream("tracker.csv", robot, "joints.csv"))

    ``data``: positions or poses with a column ``time``. ``least``: how long a rest is at least, in s, the first and
    last 0.2 s left out; ``still``: within which readings stay, in rad or m. ``sigma`` of the means is what the rows of
    a rest scatter by, over the square root of as many as are independent. A change of target, tool or set-up ends a
    rest.

    Raises MeasurementError when there are no times or no rests, JobError for other kinds.
    """
    if data.kind not in ("position", "pose") or data.position is None:
        raise JobError(f"{data.where}: only positions and poses can be averaged, not a {data.kind}.")
    if data.times is None:
        raise MeasurementError(f"{data.where}: there is no column 'time', which says how long the arm rested.")
    rests = _rests(data, data.times, least, still)
    if not rests:
        raise MeasurementError(
            f"{data.where}: all joints never rest together for {least:g} s, within {still:g} rad or m; let the arm "
            "stop for longer."
        )
    first = np.array([rows[0] for rows in rests], dtype=np.intp)
    residual = [_apart(data, rows) for rows in rests]
    whole = np.sqrt(np.mean(np.concatenate([r**2 for r in residual]), axis=0))
    sigma = np.stack([_of_mean(r, whole) for r in residual])
    told = data.subset(first)
    return replace(
        told,
        readings=read_only([data.readings[rows].mean(axis=0) for rows in rests]),
        position=read_only([data.position[rows].mean(axis=0) for rows in rests]),
        orientation=None
        if data.orientation is None
        else read_only([rigid.nearest_rotation(data.orientation[rows].mean(axis=0)) for rows in rests]),
        sigma=read_only(sigma),
        times=read_only([data.times[rows].mean() for rows in rests]),
        stream=None,
        scalars=(),
        uses={},
    )


def _rests(data: Measurements, times: Array, least: float, still: float) -> list[IntArray]:
    step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    if not step > 0.0:
        return []
    window = max(round(2.0 * _SETTLED / step), 1)
    swing = scipy.ndimage.maximum_filter1d(data.readings, window, axis=0) - scipy.ndimage.minimum_filter1d(
        data.readings, window, axis=0
    )
    rests = np.all(swing <= still, axis=1)
    of = np.column_stack([data.tool, data.setup, data.target])
    begins = np.concatenate([[True], (np.diff(times) > 5.0 * step) | np.any(np.diff(of, axis=0) != 0, axis=1)])
    begins |= np.concatenate([[True], rests[1:] != rests[:-1]])
    runs = np.split(np.arange(len(times)), np.flatnonzero(begins)[1:])
    # The window has taken what settles from both ends already.
    return [
        rows for rows in runs if rests[rows[0]] and len(rows) >= _FEWEST and times[rows[-1]] - times[rows[0]] >= least
    ]


def _apart(data: Measurements, rows: IntArray) -> Array:
    """Return how far rows are from their mean (n, d), in m and rad."""
    assert data.position is not None, "rests are of positions"
    x = data.position[rows] - data.position[rows].mean(axis=0)
    if data.orientation is None:
        return np.asarray(x)
    R = data.orientation[rows]
    return np.hstack([x, rigid.log3(rigid.nearest_rotation(R.mean(axis=0)).T @ R)])


def _of_mean(r: Array, whole: Array) -> Array:
    """Return the standard deviation (d,) of a mean of rows (n, d); ``whole``: the scatter of rows of all rests."""
    n = len(r)
    scatter = np.maximum(np.sqrt(np.sum(r**2, axis=0) / (n - 1)), _LEAST_SHARE * whole)
    return np.asarray(scatter * np.sqrt(correlation_time(r, n) / n))
