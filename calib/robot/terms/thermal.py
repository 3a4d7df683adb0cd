"""Temperature: the zero wanders as the machine warms up. Basis: T - 20 degC."""

import numpy as np

from calib.foundations.arrays import Array
from calib.robot.conditions import REFERENCE_TEMPERATURE
from calib.robot.terms.kind import TEMPERATURE, Basis, Coefficient, Kind, Rows, Shares


class Thermal(Kind):
    """Ten kelvin move a zero by a tenth of a milliradian, or of a millimetre."""

    names = ("thermal",)
    key = "thermal"
    coefficients = {"angle": Coefficient("rad/K", 1e-5), "length": Coefficient("m/K", 1e-5)}
    shown = {"rad/K": "urad/K", "m/K": "um/K"}
    needs = (TEMPERATURE,)

    def basis(self, shares: Shares) -> Basis:
        """Return the same for all."""
        return lambda rows: np.repeat(warmth(rows), len(shares.terms), axis=1)


def warmth(rows: Rows) -> Array:
    """Return how much warmer (N, 1) than the temperature at which lengths are stated the machine is, in K."""
    if rows.conditions.temperature is None:
        raise TypeError("rows without a temperature are refused before")
    return np.asarray((rows.conditions.temperature - REFERENCE_TEMPERATURE)[:, None])
