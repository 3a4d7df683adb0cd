"""Which rows are of one pose, visited again."""

from collections.abc import Sequence

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.measurement.measurements import Measurements

# Readings (rad or m) that agree to within this are of one pose, visited again: servos come back to 0.1 mrad, and
# different poses of a calibration are a tenth of a radian apart.
ONE_POSE = 1e-3
# Rows that spread over more of these are of a path, of which each is near to the next.
_WIDEST = 2.0


def both_ends(data: Measurements) -> Array:
    """Return the readings (N, 2 k) at both ends of every row, where it has one that twice.

    The end with the lesser readings comes first: which one a table tells first says nothing, and is another one when
    its rows are in another order.
    """
    own, other, turned = data.ends[0].readings, data.ends[-1].readings, _turned(data)
    return np.hstack([np.where(turned, other, own), np.where(turned, own, other)])


def tools_of(data: Measurements) -> IntArray:
    """Return the number (N, 2) of the tool at both ends of every row, the ends as :func:`both_ends` has them."""
    own, other, turned = data.ends[0].tool[:, None], data.ends[-1].tool[:, None], _turned(data)
    return np.hstack([np.where(turned, other, own), np.where(turned, own, other)])


def things_of(data: Measurements) -> IntArray:
    """Return what every row is about (N, m), by numbers: its target, its set-up, and the tool at each of its ends."""
    return np.column_stack([data.target, data.setup, tools_of(data)])


def _turned(data: Measurements) -> BoolArray:
    """Return whether (N, 1) the other end of a row has the lesser readings.

    By the first joint that stands elsewhere there, by more than the visits of one pose differ.
    """
    apart = data.ends[0].readings - data.ends[-1].readings
    first = np.argmax(np.abs(apart) > ONE_POSE, axis=1)
    return np.asarray(np.take_along_axis(apart, first[:, None], axis=1) > 0.0)


def poses_of(data: Measurements, *, pieces: bool = False) -> IntArray:
    """Return the number (N,) of every row's pose, from 0: rows that measure one thing at the same readings share it.

    It does not matter in which order rows are. Rows of streams, of photographs and of points have poses of their own;
    so have rows of a path, of which each is near to the next, unless it is cut into ``pieces`` as wide as a pose.
    """
    if data.stream is not None or data.kind == "pixels" or data.points is not None:
        return np.arange(len(data))
    return same_pose(data, pieces=pieces)


def same_pose(data: Measurements, others: Sequence[Array] = (), *, pieces: bool = False) -> IntArray:
    """Return the number (N,) of every row's pose, from 0, whatever the rows are.

    ``others`` (N, k): what else must be equal in the rows of a pose. ``pieces``: see :func:`poses_of`.
    """
    n = len(data)
    if n < 2:
        return np.arange(n)
    readings, apart = both_ends(data) / ONE_POSE, np.column_stack([things_of(data), *others])
    number = _without_gaps(np.column_stack([_numbered(apart) * 2.0, readings]))
    order = np.argsort(number, kind="stable")
    first = np.flatnonzero(np.diff(number[order], prepend=-1))
    wide = np.maximum.reduceat(readings[order], first) - np.minimum.reduceat(readings[order], first)
    path = (wide.max(axis=1) > _WIDEST)[number]
    if pieces:
        cells = np.where(path[:, None], np.round(readings), 0.0)
        return _numbered(np.column_stack([number, cells]))
    return _numbered(np.where(path, len(first) + np.arange(n), number)[:, None])


def _numbered(rows: Array) -> IntArray:
    """Return a number (N,), from 0, of every row (N, k) that is the same for equal ones."""
    return np.asarray(np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1), dtype=np.intp)


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
