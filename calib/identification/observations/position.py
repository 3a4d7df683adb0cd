"""Observation ``position``: an instrument saw where a tool point was."""

import numpy as np

from calib.identification.observations.seen import Linearised, Seen


def residual(seen: Seen) -> Linearised:
    """Return r = x_measured - x (n, 3) in m in the instrument's axes."""
    position = seen.data.position
    assert position is not None, "positions and poses have measured positions"
    twist = np.zeros((len(seen.tools), 3, 6))
    twist[:, :, :3] = -seen.tools[:, :3, :3]
    return Linearised(position[seen.rows] - seen.tools[:, :3, 3], twist)
