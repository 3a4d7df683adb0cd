"""Kinds of observation: what a row of measurements leaves unexplained, with its exact derivative.

Every kind is one function ``residual(seen) -> Linearised``. Kinds that see the same geometry share one: touching a ball
of known size is a distance from its centre, an indicator shows the height above a plane.
"""

from collections.abc import Callable, Mapping

from calib.identification.observations import distance, plane, pose, position, socket
from calib.identification.observations.seen import Linearised, Seen
from calib.measurement.kinds import Kind

_RESIDUALS: Mapping[Kind, Callable[[Seen], Linearised]] = {
    "position": position.residual,
    "pose": pose.residual,
    "socket": socket.residual,
    "distance": distance.residual,
    "sphere": distance.residual,
    "pair_distance": distance.residual_of_pairs,
    "plane": plane.residual,
    "indicator": plane.residual,
}


def observe(kind: Kind, seen: Seen) -> Linearised:
    """Return the residuals of rows of one kind."""
    return _RESIDUALS[kind](seen)
