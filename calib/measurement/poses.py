"""Which rows are of one pose, visited again."""

import numpy as np

from calib.foundations.arrays import Array, IntArray
from calib.measurement.measurements import Measurements

# Readings (rad or m) that agree to within this are of one pose, visited again: servos come back to 0.1 mrad, and
# different poses of a calibration are a tenth of a radian apart.
ONE_POSE = 1e-3
# Rows that spread over more of these are of a path, of which each is near to the next.
_WIDEST = 2.0


def both_ends(data: Measurements) -> Array:
    """Return the readings (N, 2 k) at both ends of every row, where it has one that twice."""
    return np.hstack([data.ends[0].readings, data.ends[-1].readings])


def things_of(data: Measurements) -> IntArray:
    """Return what every row is about (N, m), by numbers: its target, its set-up, and the tool at each of its ends."""
    return np.column_stack([data.target, data.setup, *(end.tool for end in data.ends)])


def poses_of(data: Measurements) -> IntArray:
    """Return the number (N,) of every row's pose, from 0: rows that measure one thing at the same readings share it.

    It does not matter in which order rows are. Rows of streams, of photographs and of points have poses of their own.
    """
    n = len(data)
    if n < 2 or data.stream is not None or data.kind == "pixels" or data.points is not None:
        return np.arange(n)
    readings = both_ends(data) / ONE_POSE
    number = _without_gaps(np.column_stack([things_of(data).astype(np.float64) * 2.0, readings]))
    order = np.argsort(number, kind="stable")
    first = np.flatnonzero(np.diff(number[order], prepend=-1))
    apart = np.maximum.reduceat(readings[order], first) - np.minimum.reduceat(readings[order], first)
    path = (apart.max(axis=1) > _WIDEST)[number]
    number = np.where(path, len(first) + np.arange(n), number)
    return np.asarray(np.unique(number, return_inverse=True)[1].ravel(), dtype=np.intp)


def _without_gaps(at: Array) -> IntArray:
    """Return numbers (N,) of parts, from 0, of which no column of ``at`` (N, k) has a gap wider than 1."""
    number, parts = np.zeros(len(at), dtype=np.intp), 0
    while parts <= number.max():
        parts = int(number.max()) + 1
        for column in at.T:
            order = np.lexsort((column, number))
            new = (np.diff(number[order]) > 0) | (np.diff(column[order]) > 1.0)
            number[order] = np.concatenate([[0], np.cumsum(new)])
    return number
