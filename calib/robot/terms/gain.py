"""Gain: the reading's scale. Basis: u."""

import numpy as np

from calib.robot.terms.kind import Basis, Coefficient, Kind, Shares, Slope


class Gain(Kind):
    """A reading that is too long or too short by a per mille, or so."""

    names = ("gain",)
    key = "gain"
    coefficients = {"angle": Coefficient("1", 1e-3), "length": Coefficient("1", 1e-3)}
    shown = {"1": "ppm"}
    grows = True

    def basis(self, shares: Shares) -> Basis:
        """Return the readings."""
        return lambda rows: rows.readings[:, shares.reading]

    def slope(self, shares: Shares) -> Slope:
        """Return ones."""
        return lambda readings: np.ones((len(readings), len(shares.reading)))
