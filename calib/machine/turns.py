"""Angles beyond a region of joint space, and the same angles a whole turn away, where they may be inside."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from calib.foundations.arrays import Array

_TURN = 2.0 * np.pi


def turned_towards(values: Array, low: npt.ArrayLike, high: npt.ArrayLike, turns: npt.ArrayLike) -> Array:
    """Return values (N, k) with those that are beyond ``low`` to ``high`` (k) by whole turns nearer to the middle.

    Only of joints that whole turns bring back, ``turns`` (k): :attr:`calib.robot.robot.Reading.turns`.
    """
    low, high = np.asarray(low), np.asarray(high)
    beyond = ((values < low) | (values > high)) & np.asarray(turns, dtype=np.bool_)
    away = np.round((values - 0.5 * (low + high)) / _TURN)
    return np.asarray(np.where(beyond, values - _TURN * away, values))


def points_of(
    readings: npt.ArrayLike, joints: Sequence[int], low: npt.ArrayLike, high: npt.ArrayLike, turning: Sequence[bool]
) -> Array:
    """Return the readings (N, nr) of some joints (N, k), turned towards ``low`` to ``high`` (k) where they are beyond.

    ``turning`` (nr): of all joints, whether a whole turn brings them back; empty where none is known to.
    """
    points = np.asarray(readings, dtype=np.float64)[:, list(joints)]
    return turned_towards(points, low, high, [turning[j] for j in joints]) if turning else points
