"""Backlash: half the gap of the gears. Basis: the side from which the reading was reached, +1, 0 or -1."""

from typing import cast

from calib.foundations.arrays import Array
from calib.robot.conditions import Conditions
from calib.robot.terms.kind import Basis, Coefficient, Kind, Parts, Shares, unsaid
from calib.robot.terms.term import JointTerm


class Backlash(Kind):
    """Half a gap: 20 arc seconds, or a hundredth of a millimetre."""

    names = ("backlash",)
    key = "backlash"
    coefficients = {"angle": Coefficient("rad", 1e-4), "length": Coefficient("m", 1e-5)}

    def basis(self, shares: Shares) -> Basis:
        """Return the sides."""
        return lambda rows: cast(Array, rows.conditions.approach)[:, shares.reading]

    def lacking(self, term: JointTerm, reading: int, conditions: Conditions) -> str | None:
        """Return the column of the reading's side, where it is not told."""
        return f"direction_{term.reading}" if unsaid(conditions.approach, reading) else None

    def shows(self, parts: Parts, told: Conditions, reading: int) -> bool:
        """Return whether the reading was reached from both sides."""
        return told.approach is not None and {-1.0, 1.0} <= set(told.approach[:, reading].tolist())
