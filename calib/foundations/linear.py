"""Linear algebra that more than one room needs."""

from contextlib import AbstractContextManager
from typing import Any, cast

import numpy as np
import scipy.linalg
from threadpoolctl import ThreadpoolController

from calib.foundations.arrays import Array

# NumPy's and SciPy's, found once: to look through all that a process has loaded takes as long as half a fit.
_LIBRARIES = ThreadpoolController()


def triangle(M: Array) -> Array:
    """Return the triangle R (min(m, n), n) of ``M = Q R`` (m, n), which has the same ``M^T M``."""
    return cast(Array, cast(Any, np.linalg.qr)(M, mode="r"))


def svd(M: Array, *, full_matrices: bool = True) -> tuple[Array, Array, Array]:
    """Return the singular value decomposition (U, s, Vt) of matrices (..., m, n), as NumPy's.

    NumPy's way, divide and conquer, does not converge for a few sound matrices; the slower QR iteration does.
    """
    try:
        return cast(tuple[Array, Array, Array], np.linalg.svd(M, full_matrices=full_matrices))
    except np.linalg.LinAlgError:
        several = M.reshape(-1, *M.shape[-2:])
        found = [scipy.linalg.svd(one, full_matrices=full_matrices, lapack_driver="gesvd") for one in several]
        U, s, Vt = (np.array(part).reshape(*M.shape[:-2], *part[0].shape) for part in zip(*found, strict=True))
        return U, s, Vt


def one_thread() -> AbstractContextManager[object]:
    """Return a context in which linear algebra runs in one thread.

    Our matrices are small: a second thread gains nothing, and waits a hundred times longer where a core is shared.
    """
    return cast(AbstractContextManager[object], _LIBRARIES.limit(limits=1, user_api="blas"))
