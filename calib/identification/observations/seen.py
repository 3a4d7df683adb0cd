"""What an observation is told of its rows, and what it answers."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array
from calib.measurement.measurements import Measurements


class Seen(NamedTuple):
    """Rows of one set as a machine predicts them.

    ``tools`` (n, 4, 4): tool placements in the instrument's frame; ``others``: those at the other ends, ``targets``:
    what each row is about, both empty where the kind has none. ``scalars``: unknown numbers that the rows depend on, by
    what they are to them.
    """

    data: Measurements
    rows: slice
    tools: Array
    others: Array
    targets: Array
    scalars: Mapping[str, float]


class Linearised(NamedTuple):
    """Residuals (n, d), measured minus predicted, and their change (n, d, 6) with the local twist of each tool.

    ``other`` and ``target`` (n, d, 6): their change with the local twists of the other end and of the target; None
    where the kind has none. ``scalars`` (n, d) each: their change with one unit of every scalar of ``Seen``.
    """

    residual: Array
    twist: Array
    other: Array | None = None
    target: Array | None = None
    scalars: Mapping[str, Array] = MappingProxyType({})


def point_columns(by_point: Array, frames: Array) -> Array:
    """Return derivatives (n, d, 6) by the local twist of frames (n, 4, 4), of what depends on their origins alone.

    ``by_point`` (n, d, 3): derivatives by the origin's position.
    """
    found = np.zeros((*by_point.shape[:2], 6))
    found[:, :, :3] = by_point @ frames[:, :3, :3]
    return found
