"""Deviations of placements: six small numbers beside each nominal placement, and their exact derivatives.

A deviation ``d = (tx, ty, tz, rx, ry, rz)`` is the motion ``E(d) = Trans(tx, ty, tz) Rx(rx) Ry(ry) Rz(rz)``, applied on
the right of a nominal placement whose frame has z along the joint's axis.
"""

from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array

COMPONENTS = ("tx", "ty", "tz", "rx", "ry", "rz")


class Motions(NamedTuple):
    """What n deviations d make: ``E`` (n, 4, 4), as :func:`motion` has it, and ``W`` (n, 6, 6) of :func:`twists`."""

    E: Array
    W: Array

    @classmethod
    def of(cls, d: Array) -> "Motions":
        """Return those of deviations (n, 6) in m and rad."""
        x, y, z = rigid.turns(d[:, 3:])
        R = rigid.product(x, rigid.product(y, z))
        return cls(rigid.placement(R, d[:, :3]), _twists(R, z))


def motion(d: Array) -> Array:
    """Return E(d) (..., 4, 4) of deviations (..., 6) in m and rad."""
    return rigid.placement(rigid.rx_ry_rz(d[..., 3:]), d[..., :3])


def twists(d: Array) -> Array:
    """Return the matrices W (..., 6, 6) with ``E(d + e) = E(d) exp(W e)`` to first order in e.

    Column k is the local twist of component k: a translation is seen through the rotation that follows it, and each of
    the three rotations through those on its right.
    """
    x, y, z = rigid.turns(d[..., 3:])
    return _twists(rigid.product(x, rigid.product(y, z)), z)


def _twists(R: Array, z: Array) -> Array:
    W = np.zeros((*R.shape[:-2], 6, 6))
    W[..., :3, :3] = np.swapaxes(R, -1, -2)
    # Rows of Ry Rz and Rz: Rx, on the left, leaves the first row of R as it is.
    W[..., 3:, 3], W[..., 3:, 4], W[..., 5, 5] = R[..., 0, :], z[..., 1, :], 1.0
    return W


def axis_frame(axis: Array) -> Array:
    """Return the rotation P (4, 4) whose z is ``axis``: the frame in which a joint's deviation is named.

    Along a coordinate axis P permutes the axes (x -> yzx, y -> zxy), so that its x and y stay axes of the URDF frame;
    along a skew axis P turns z, or -z for an axis that looks down, into it by the shortest way.
    """
    for k in range(3):
        if np.array_equal(axis, np.eye(3)[k]):
            return rigid.placement(np.roll(np.eye(3), 2 - k, axis=1), np.zeros(3))
    # Opposite to z there is no shortest way: half a turn about x comes first.
    first = np.eye(3) if axis[2] > -0.5 else np.diag([1.0, -1.0, -1.0])
    return rigid.placement(first @ _shortest_turn(np.eye(3)[2], first.T @ axis), np.zeros(3))


def _shortest_turn(a: Array, b: Array) -> Array:
    K = rigid.skew(np.cross(a, b))
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + float(a @ b)))
