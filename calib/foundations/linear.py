"""Linear algebra that more than one room needs."""

from contextlib import AbstractContextManager
from typing import Any, cast

import numpy as np
import scipy.linalg  # noqa: F401 - so that its library is there to be found
from threadpoolctl import ThreadpoolController

from calib.foundations.arrays import Array

# NumPy's and SciPy's, found once: to look through all that a process has loaded takes as long as half a fit.
_LIBRARIES = ThreadpoolController()


def triangle(M: Array) -> Array:
    """Return the triangle R (min(m, n), n) of ``M = Q R`` (m, n), which has the same ``M^T M``."""
    return cast(Array, cast(Any, np.linalg.qr)(M, mode="r"))


def one_thread() -> AbstractContextManager[object]:
    """Return a context in which linear algebra runs in one thread.

    Our matrices are small: a second thread gains nothing, and waits a hundred times longer where a core is shared.
    """
    return cast(AbstractContextManager[object], _LIBRARIES.limit(limits=1, user_api="blas"))
