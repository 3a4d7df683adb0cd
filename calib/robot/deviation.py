"""Deviations of placements: six small numbers beside each nominal placement, and their exact derivatives.

A deviation ``d = (tx, ty, tz, rx, ry, rz)`` is the motion ``E(d) = Trans(tx, ty, tz) Rx(rx) Ry(ry) Rz(rz)``, applied on
the right of a nominal placement whose frame has z along the joint's axis.
"""

from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, read_only

COMPONENTS = ("tx", "ty", "tz", "rx", "ry", "rz")


class Motions(NamedTuple):
    """What deviations d make: the motions ``E`` (..., 4, 4), and how these follow: ``W`` (..., 6, 6).

    ``E(d + e) = E(d) exp(W e)`` to first order in e: column k of W is the local twist of component k.
    """

    E: Array
    W: Array

    @classmethod
    def of(cls, d: Array) -> "Motions":
        """Return those of deviations (..., 6) in m and rad."""
        numbers = rigid.products_of_turns(d[..., 3:]) @ _E_AND_W
        E, W = numbers[..., :16].reshape(*d.shape[:-1], 4, 4), numbers[..., 16:].reshape(*d.shape, 6)
        E[..., :3, 3] = d[..., :3]
        return cls(E, W)


def _of_products() -> Array:
    """Return how E without its translation, and W behind it, (27, 16 + 36), follow the products of turns."""
    R, E, W = rigid.RX_RY_RZ, np.zeros((27, 4, 4)), np.zeros((27, 6, 6))
    E[:, :3, :3], E[0, 3, 3] = R, 1.0
    # A translation is seen through the rotation that follows it, and each of the three rotations through those on its
    # right: rows of Ry Rz and of Rz, and Rx, on the left, leaves the first row of R as it is.
    W[:, :3, :3], W[:, 3:, 3], W[:, 3:, 4], W[0, 5, 5] = np.swapaxes(R, 1, 2), R[:, 0], rigid.RZ[:, 1], 1.0
    return read_only(np.concatenate([E.reshape(27, 16), W.reshape(27, 36)], axis=1))


_E_AND_W = _of_products()


def motion(d: Array) -> Array:
    """Return E(d) (..., 4, 4) of deviations (..., 6) in m and rad."""
    return rigid.placement(rigid.rx_ry_rz(d[..., 3:]), d[..., :3])


def twists(d: Array) -> Array:
    """Return the matrices W (..., 6, 6) of :class:`Motions`."""
    return Motions.of(d).W


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
