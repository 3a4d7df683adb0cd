"""A lens in numbers: OpenCV's camera matrix and distortion."""

from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array

FOCAL, CENTRE = ("fx", "fy"), ("cx", "cy")
# Brown and Conrady's five, and those of the rational model beside them.
BENT, RATIONAL = ("k1", "k2", "p1", "p2", "k3"), ("k4", "k5", "k6")


class Lens(NamedTuple):
    """Focal lengths and centre in px, and the distortion, in OpenCV's order; see :mod:`calib.measurement.projection`.

    ``k4``, ``k5``, ``k6`` are those of the rational model, zero in that of Brown and Conrady.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0

    @property
    def numbers(self) -> Array:
        """The twelve numbers."""
        return np.array(self)


NAMES = Lens._fields
