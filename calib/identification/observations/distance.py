"""Observations ``distance``, ``sphere`` and ``pair_distance``: how far the tool point was from another point.

A telescoping ball bar or a draw wire measures the distance from its anchor; a probe that touches a ball is away from
its centre by the sum of both radii; a gauge touched at both ends is a distance between two places of the tool.
"""

import numpy as np

from calib.foundations.arrays import Array
from calib.identification.observations.seen import Linearised, Seen, by_point, point_columns

# Where both points are one, the distance has no direction; any answer this small leaves the derivative zero.
_TINY = 1e-12
# A length is too long by its offset; the centre is the ball's radius further away than the probe's.
_SIGNS = {"offset": -1.0, "radius": 1.0}


def residual(seen: Seen) -> Linearised:
    """Return r = l - o + b - |x - c| (n, 1) in m: length l, its unknown part o or the ball's radius b."""
    r, by_tool = _between(seen, seen.targets)
    target = point_columns(-by_tool, seen.targets)
    return Linearised(r, (by_point(by_tool),), target=target, scalars=_by_scalars(seen, r))


def residual_of_pairs(seen: Seen) -> Linearised:
    """Return r = l - o - |x - x'| (n, 1) in m, with x' the tool point at the other end."""
    r, by_tool = _between(seen, seen.others)
    return Linearised(r, (by_point(by_tool),), (by_point(-by_tool),), scalars=_by_scalars(seen, r))


def _between(seen: Seen, ends: Array) -> tuple[Array, Array]:
    """Return the residuals (n, 1), and their derivatives (n, 1, 3) by the tool point."""
    apart = seen.tools[:, :3, 3] - ends[:, :3, 3]
    distance = np.linalg.norm(apart, axis=1, keepdims=True)
    direction = apart / np.maximum(distance, _TINY)
    unknown = sum(_SIGNS[role] * value for role, value in seen.scalars.items())
    return seen.data.value[seen.rows] - distance + unknown, -direction[:, None, :]


def _by_scalars(seen: Seen, r: Array) -> dict[str, Array]:
    return {role: np.full_like(r, _SIGNS[role]) for role in seen.scalars}
