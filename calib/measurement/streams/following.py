"""How well joints followed what they were commanded to do: by how much they came late, and what else was left."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.units import Dimension

# A joint that moves more slowly, in rad/s or m/s, does not show how late it is.
_SLOWEST = 1e-3


class Following(NamedTuple):
    """The following error of a ``joint``, actual minus commanded, in rad or m: its ``rms`` and the ``largest`` one.

    ``late``: by how many s the joint came late, 0 where it hardly moved; ``left``: the rms of what that leaves.
    """

    joint: str
    dimension: Dimension
    rms: float
    largest: float
    late: float
    left: float


def following(joints: Mapping[str, Dimension], actual: Array, commanded: Array, rates: Array) -> tuple[Following, ...]:
    """Return how joints followed, from actual and commanded readings (N, k), and ``rates`` (N, k) of the actual ones.

    A joint that is late by d is behind by d times its rate: d is the slope of a line through all samples.
    """
    found = []
    for (joint, dimension), error, rate in zip(joints.items(), (actual - commanded).T, rates.T, strict=True):
        centred, moving = error - error.mean(), rate - rate.mean()
        power = float(moving @ moving)
        late = -float(moving @ centred) / power if power > len(rate) * _SLOWEST**2 else 0.0
        rms, left = (float(np.sqrt(np.mean(e**2))) for e in (error, centred + late * moving))
        found.append(Following(joint, dimension, rms, float(np.abs(error).max()), late, left))
    return tuple(found)
