"""Kinds of observation: what one row of measurements says of a tool point, and in which quantities it can be wrong."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, NamedTuple

Kind = Literal["position", "pose", "socket", "distance", "pair_distance", "plane", "sphere", "indicator", "pixels"]


class Quantity(NamedTuple):
    """One quantity of a kind's residuals: its name, its unit, and the columns it takes."""

    name: str
    unit: Literal["m", "rad", "px"]
    columns: slice


_POSITION = Quantity("position", "m", slice(0, 3))
QUANTITIES: Mapping[Kind, tuple[Quantity, ...]] = MappingProxyType(
    {
        "position": (_POSITION,),
        "pose": (_POSITION, Quantity("orientation", "rad", slice(3, 6))),
        "socket": (Quantity("socket", "m", slice(0, 3)),),
        "distance": (Quantity("distance", "m", slice(0, 1)),),
        "pair_distance": (Quantity("pair_distance", "m", slice(0, 1)),),
        "plane": (Quantity("plane", "m", slice(0, 1)),),
        "sphere": (Quantity("sphere", "m", slice(0, 1)),),
        "indicator": (Quantity("indicator", "m", slice(0, 1)),),
        "pixels": (Quantity("pixels", "px", slice(0, 2)),),
    }
)

# The unit of every quantity.
UNIT_OF: Mapping[str, Literal["m", "rad", "px"]] = MappingProxyType(
    {quantity.name: quantity.unit for quantities in QUANTITIES.values() for quantity in quantities}
)

# Kinds whose rows are about something beside the robot: a socket, an anchor, a plane, a ball, a camera.
WITH_TARGET: frozenset[Kind] = frozenset(("socket", "distance", "plane", "sphere", "indicator", "pixels"))
# Kinds that say where the tool was in the frame of an instrument, which is not the robot's base.
IN_INSTRUMENT_FRAME: frozenset[Kind] = frozenset(("position", "pose"))
# Kinds without a number of an instrument: the residual is how far the tool is from where all touches are.
TOUCHES: frozenset[Kind] = frozenset(("socket", "plane", "sphere"))


def size(kind: Kind) -> int:
    """Return how many numbers the residual of one row has."""
    return int(max(quantity.columns.stop for quantity in QUANTITIES[kind]))
