"""Wind-up by friction: it grows with what the drive holds, and keeps the joint behind. Basis: -side |tau|.

A drive that came to rest growing winds up by what it holds and, on top, by the friction of its gears, which is in
proportion to that; falling, by so much less. The side is that from which the reading was reached, +1, 0 or -1.
"""

from typing import cast

import numpy as np

from calib.foundations.arrays import Array
from calib.robot.terms.kind import SIDE, Basis, Coefficient, Kind, Shares


class Hysteresis(Kind):
    """A compliance times a coefficient of friction: a tenth of that of ordinary drives."""

    names = ("hysteresis",)
    key = "hysteresis"
    coefficients = {"angle": Coefficient("rad/Nm", 1e-6), "length": Coefficient("m/N", 1e-8)}
    shown = {"rad/Nm": "urad/Nm", "m/N": "um/N"}
    masses = "stated"
    needs = (SIDE,)

    def basis(self, shares: Shares) -> Basis:
        """Return the size of what the readings hold, against their sides."""
        return lambda rows: (
            -cast(Array, rows.conditions.approach)[:, shares.reading] * np.abs(rows.held[:, shares.coordinate])
        )
