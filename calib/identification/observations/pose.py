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
    # Rows last, in memory as well, so that what is done to all of them is done at once.
    R = seen.tools[:, :3, :3].transpose(1, 2, 0)
    measured = np.ascontiguousarray(orientation[seen.rows].transpose(1, 2, 0))
    linear, (turn, back) = position.residual(seen), rigid.log3_with_derivative(np.einsum("kin,kjn->ijn", R, measured))
    # log(exp(-w) exp(r)) = r - Jl(r)^-1 w, with w in the axes of the tool.
    by_turn = np.einsum("ikn,jkn->ijn", back, R)
    np.negative(by_turn, out=by_turn)
    return Linearised(np.concatenate([linear.residual, turn.T], axis=1), (*linear.tool, Follow(None, by_turn)))
