"""Observation ``pose``: an instrument saw where a tool frame was and how it was turned."""

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.identification.observations import Linearised, position


def residual(measured: Array, orientation: Array, tools: Array) -> Linearised:
    """Return r = (x_measured - x, log(R^T R_measured)) (N, 6) in m and rad.

    The position part is in the instrument's axes, the rotation part in those of the tool; ``tools`` (N, 4, 4),
    ``measured`` (N, 3), ``orientation`` (N, 3, 3).
    """
    turn = rigid.log3(np.swapaxes(tools[:, :3, :3], -1, -2) @ orientation)
    linear = position.residual(measured, tools)
    twist = np.zeros((len(tools), 6, 6))
    twist[:, :3] = linear.twist
    # log(exp(-w) exp(r)) = r - Jl(r)^-1 w
    twist[:, 3:, 3:] = -rigid.left_jacobian_inverse(turn)
    return Linearised(np.concatenate([linear.residual, turn], axis=1), twist)
