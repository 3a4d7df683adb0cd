"""Backlash: half the gap of the gears. Basis: the side from which the reading was reached, +1, 0 or -1."""

from typing import cast

from calib.foundations.arrays import Array
from calib.robot.terms.kind import SIDE, Basis, Coefficient, Kind, Shares


class Backlash(Kind):
    """Half a gap: 20 arc seconds, or a hundredth of a millimetre."""

    names = ("backlash",)
    key = "backlash"
    coefficients = {"angle": Coefficient("rad", 1e-4), "length": Coefficient("m", 1e-5)}
    needs = (SIDE,)

    def basis(self, shares: Shares) -> Basis:
        """Return the sides."""
        return lambda rows: cast(Array, rows.conditions.approach)[:, shares.reading]
