"""Temperature: the zero wanders as the machine warms up. Basis: T - 20 degC."""

import numpy as np

from calib.foundations.arrays import Array
from calib.robot.conditions import REFERENCE_TEMPERATURE, Conditions
from calib.robot.terms.kind import Basis, Coefficient, Kind, Parts, Rows, Shares, changes
from calib.robot.terms.term import JointTerm


class Thermal(Kind):
    """Ten kelvin move a zero by a tenth of a milliradian, or of a millimetre."""

    names = ("thermal",)
    key = "thermal"
    coefficients = {"angle": Coefficient("rad/K", 1e-5), "length": Coefficient("m/K", 1e-5)}
    shown = {"rad/K": "urad/K", "m/K": "um/K"}

    def basis(self, shares: Shares) -> Basis:
        """Return the same for all."""
        return lambda rows: np.repeat(warmth(rows), len(shares.terms), axis=1)

    def lacking(self, term: JointTerm, reading: int, conditions: Conditions) -> str | None:
        """Return the column of the temperature, where it is not told."""
        return "temperature" if conditions.temperature is None else None

    def shows(self, parts: Parts, told: Conditions, reading: int) -> bool:
        """Return whether the temperature changes."""
        return changes(told.temperature)


def warmth(rows: Rows) -> Array:
    """Return how much warmer (N, 1) than the temperature at which lengths are stated the machine is, in K."""
    if rows.conditions.temperature is None:
        raise TypeError("rows without a temperature are refused before")
    return np.asarray((rows.conditions.temperature - REFERENCE_TEMPERATURE)[:, None])
