"""Observation ``pose``: an instrument saw where a tool frame was and how it was turned."""

import numpy as np

from calib.foundations import rigid
from calib.identification.observations import position
from calib.identification.observations.seen import Linearised, Seen


def residual(seen: Seen) -> Linearised:
    """Return r = (x_measured - x, log(R^T R_measured)) (n, 6) in m and rad.

    The position part is in the instrument's axes, the rotation part in those of the tool.
    """
    orientation = seen.data.orientation
    assert orientation is not None, "poses have measured orientations"
    turn = rigid.log3(np.swapaxes(seen.tools[:, :3, :3], -1, -2) @ orientation[seen.rows])
    linear = position.residual(seen)
    twist = np.zeros((len(seen.tools), 6, 6))
    twist[:, :3] = linear.twist
    # log(exp(-w) exp(r)) = r - Jl(r)^-1 w
    twist[:, 3:, 3:] = -rigid.left_jacobian_inverse(turn)
    return Linearised(np.concatenate([linear.residual, turn], axis=1), twist)
