"""Observation ``pose``: an instrument saw where a tool frame was and how it was turned."""

import numpy as np

from calib.foundations import rigid
from calib.identification.observations import position
from calib.identification.observations.seen import Linearised, Seen
from calib.robot.kinematics import Follow


def residual(seen: Seen) -> Linearised:
    """Return r = (x_measured - x, log(R^T R_measured)) (n, 6) in m and rad.

    The position part is in the instrument's axes, the rotation part in those of the tool.
    """
    orientation = seen.data.orientation
    assert orientation is not None, "poses have measured orientations"
    R_t, linear = np.swapaxes(seen.tools[:, :3, :3], 1, 2), position.residual(seen)
    turn = rigid.log3(R_t @ orientation[seen.rows])
    # log(exp(-w) exp(r)) = r - Jl(r)^-1 w, with w in the axes of the tool.
    by_turn = np.ascontiguousarray((-rigid.left_jacobian_inverse(turn) @ R_t).transpose(1, 2, 0))
    return Linearised(np.concatenate([linear.residual, turn], axis=1), (*linear.tool, Follow(None, by_turn)))
