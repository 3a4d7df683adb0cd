"""Where machines truly stand against each other, by numpy alone: what a cell's stated place is held against."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
_LEAST = 0.1


def cross(v: Array) -> Array:
    """The matrices (..., 3, 3) of cross products by vectors (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(v, dtype=float), -1, 0)
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)


def field(found: Array, true: Array) -> Array:
    """Motions (N, 6) that take links (N, 4, 4) to where they truly are, in the axes of the frame they are given in."""
    turns = Rotation.from_matrix(true[:, :3, :3] @ np.swapaxes(found[:, :3, :3], 1, 2)).as_rotvec()
    return np.hstack([true[:, :3, 3] - found[:, :3, 3], turns])


def shift_of_all(found: Array, true: Array, origin: Array) -> Array:
    """The twist (6,), at ``origin``, that takes a machine where it is, whatever is beyond its last link.

    Base and tool side are fitted together, as in robot-world calibration: a motion of all, and one in the link.
    """
    points, R = found[:, :3, 3], found[:, :3, :3]
    apart = points - points.mean(axis=0)
    weights = np.repeat([1.0, max(float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))), _LEAST)], 3)
    A = np.zeros((len(found), 6, 12))
    A[:, :3, :3] = A[:, 3:, 3:6] = np.eye(3)
    A[:, :3, 3:6] = -cross(points - origin)
    A[:, :3, 6:9] = A[:, 3:, 9:] = R
    rows, moved = weights[:, None] * A, weights * field(found, true)
    return np.linalg.lstsq(rows.reshape(-1, 12), moved.ravel(), rcond=1e-4)[0][:6]


def at(twist: Array, offset: Array) -> Array:
    """The same motion, told at a point that is ``offset`` away."""
    return np.concatenate([twist[:3] + np.cross(twist[3:], offset), twist[3:]])


def turned(twist: Array, R: Array) -> Array:
    """The same twist in other axes."""
    return np.concatenate([R @ twist[:3], R @ twist[3:]])
