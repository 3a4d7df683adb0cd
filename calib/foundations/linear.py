"""Linear algebra that more than one room needs."""

from typing import Any, cast

import numpy as np

from calib.foundations.arrays import Array


def triangle(M: Array) -> Array:
    """Return the triangle R (min(m, n), n) of ``M = Q R`` (m, n), which has the same ``M^T M``."""
    return cast(Array, cast(Any, np.linalg.qr)(M, mode="r"))
