"""How far placements are from each other, and which readings are far from where an arm cannot move on."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib
from calib.robot.robot import TipModel

Array = NDArray[np.float64]


def apart(a: Array, b: Array) -> tuple[float, float]:
    """Largest distance in m and turn in rad between placements (N, 4, 4), by scipy."""
    turn = Rotation.from_matrix(np.swapaxes(a[:, :3, :3], 1, 2) @ b[:, :3, :3]).magnitude()
    return float(np.linalg.norm(a[:, :3, 3] - b[:, :3, 3], axis=1).max()), float(turn.max())


def well_posed(model: calib.CalibratedMachine, readings: Array) -> Array:
    J = TipModel(model.robot, model.deviations).driven(readings)[1]
    return readings[np.linalg.svd(J, compute_uv=False)[:, -1] > 0.03]
