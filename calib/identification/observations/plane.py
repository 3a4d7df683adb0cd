"""Observations ``plane`` and ``indicator``: how high the tool point was above a plane.

A probe that touches a surface is above it by its ball's radius; an indicator shows the component along its direction,
which is the height above a plane across it, whose own height is the indicator's zero.
"""

import numpy as np

from calib.foundations.arrays import Array
from calib.identification.observations.seen import Linearised, Seen, by_point


def residual(seen: Seen) -> Linearised:
    """Return r = h - z (n, 1) in m, with h the measured height and z that of the tool point in the target's frame."""
    R = seen.targets[:, :3, :3]
    local: Array = (np.swapaxes(R, -1, -2) @ (seen.tools[:, :3, 3] - seen.targets[:, :3, 3])[:, :, None])[:, :, 0]
    # The frame moved by (v, w): a point that stays has its z changed by -v_z - w_x y + w_y x.
    target = np.zeros((len(local), 1, 6))
    target[:, 0, 2], target[:, 0, 3], target[:, 0, 4] = 1.0, local[:, 1], -local[:, 0]
    return Linearised(seen.data.value[seen.rows] - local[:, 2:], (by_point(-R[:, None, :, 2]),), target=target)
