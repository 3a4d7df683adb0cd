"""Observation ``position``: an instrument saw where a tool point was."""

import numpy as np

from calib.foundations.arrays import Array
from calib.identification.observations import Linearised


def residual(measured: Array, tools: Array) -> Linearised:
    """Return r = x_measured - x (N, 3) in m in the instrument's axes; ``tools`` (N, 4, 4), ``measured`` (N, 3)."""
    twist = np.zeros((len(tools), 3, 6))
    twist[:, :, :3] = -tools[:, :3, :3]
    return Linearised(measured - tools[:, :3, 3], twist)
