"""Observation ``socket``: the tool point sat in a socket, cone or hole, the same for all rows of one target."""

import numpy as np

from calib.identification.observations.seen import Linearised, Seen, minus_position, point_columns


def residual(seen: Seen) -> Linearised:
    """Return r = c - x (n, 3) in m in the instrument's axes, c being where the target is."""
    one = np.broadcast_to(np.eye(3), (len(seen.tools), 3, 3))
    return Linearised(
        seen.targets[:, :3, 3] - seen.tools[:, :3, 3],
        (minus_position(),),
        target=point_columns(one, seen.targets),
    )
