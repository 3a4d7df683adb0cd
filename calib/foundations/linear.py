"""Linear algebra that more than one room needs."""

import functools
import mmap
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from importlib import import_module
from typing import Any, cast

import numpy as np
import scipy
from threadpoolctl import ThreadpoolController

from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import LITTLE_MEMORY, CalibError

# Singular values below this share of the largest are rounding.
ROUNDING = 1e-14
# A condition estimated in sums of columns is off by at most the number of columns, and by little else.
_SURELY = 100.0
# Fewer columns are reduced as they are; so many are reduced at once.
_MANY, _TOGETHER = 100, 32
# So many rows see the same columns, or they are not worth telling apart; numbers of such rows, before they meet others.
_LEAST_ALIKE, _MOST_APART = 4, 4_000_000
# The memory that a library of linear algebra sets aside when it first needs it, in bytes, and a little more: OpenBLAS
# takes 2^25.
_SET_ASIDE = 35_000_000


def triangle(M: Array) -> Array:
    """Return the triangle R (..., min(m, n), n) of ``M = Q R`` (..., m, n), which has the same ``M^T M``."""
    m, n = M.shape[-2:]
    if M.ndim == 2 and _MANY <= n < m <= 2 * n and not np.tril(M[:n], -1).any() and not np.tril(M[n:], -1).any():
        # A triangle on another takes a fifth of the time.
        return np.triu(scipy.linalg.lapack.dtpqrt(m - n, _TOGETHER, M[:n], M[n:])[0])
    return cast(Array, cast(Any, np.linalg.qr)(M, mode="r"))


class Gathered:
    """The triangle of rows of w columns that come bit by bit.

    Of many columns rows mostly see few: those of the arm, and of one base and one tool among all that there are. Rows
    that see the same ones are reduced by themselves, and meet the others when all have come.
    """

    def __init__(self, width: int) -> None:
        self._triangle = np.empty((0, width))
        self._few: dict[bytes, tuple[IntArray, Array]] = {}

    def add(self, *several: Array) -> None:
        """Add rows (n, d, w), of which d see the same columns."""
        width = self._triangle.shape[1]
        flat = [one for rows in several for one in (self._apart(rows) if width >= _MANY else [rows])]
        self._reduce([rows.reshape(-1, width) for rows in flat])
        if sum(rows.size for _, rows in self._few.values()) > _MOST_APART:
            self._join()

    @property
    def triangle(self) -> Array:
        """The triangle (q, w) of all rows."""
        self._join()
        return self._triangle

    def _reduce(self, rows: Sequence[Array]) -> None:
        if rows:
            self._triangle = triangle(np.concatenate([self._triangle, *rows]))

    def _apart(self, rows: Array) -> list[Array]:
        """Take rows that see few columns, and return those that see many."""
        seen, many = np.zeros((len(rows), rows.shape[2]), dtype=np.bool_), []
        for row in np.swapaxes(rows, 0, 1):
            seen |= row != 0.0
        if 2 * np.count_nonzero(seen) > seen.size:
            return [rows]
        columns_of, number = np.unique(np.packbits(seen, axis=1), axis=0, return_inverse=True)
        if _LEAST_ALIKE * len(columns_of) >= len(rows):
            return [rows]
        order = np.argsort(number.ravel(), kind="stable")
        for own in np.split(order, np.cumsum(np.bincount(number.ravel()))[:-1]):
            columns = np.flatnonzero(seen[own[0]])
            if not len(columns):
                continue
            if 2 * len(columns) > rows.shape[2]:
                many.append(rows[own])
                continue
            key = columns_of[number.ravel()[own[0]]].tobytes()
            few = rows[own][:, :, columns].reshape(-1, len(columns))
            if key in self._few:
                few = np.concatenate([self._few[key][1], few])
            self._few[key] = columns, triangle(few) if len(few) > len(columns) else few
        return many

    def _join(self) -> None:
        """Let rows that see few columns meet: turned so that few of them see the columns that no others see."""
        times = np.zeros(self._triangle.shape[1], dtype=np.intp)
        for columns, _ in self._few.values():
            times[columns] += 1
        found: list[tuple[IntArray, Array]] = []
        rest: dict[bytes, list[tuple[IntArray, Array]]] = {}
        for those, several in self._few.values():
            order = np.argsort(times[those], kind="stable")
            columns, few = those[order], triangle(several[:, order])
            own = np.count_nonzero(times[columns] == 1)
            found.append((columns, few[:own]))
            rest.setdefault(columns[own:].tobytes(), []).append((columns[own:], few[own:, own:]))
        found += [(of[0][0], triangle(np.concatenate([few for _, few in of]))) for of in rest.values()]
        self._few = {}
        self._reduce([self._written_out(*one) for one in found])

    def _written_out(self, columns: IntArray, few: Array) -> Array:
        whole = np.zeros((len(few), self._triangle.shape[1]))
        whole[:, columns] = few
        return whole


def spread(x: Array) -> float:
    """Return the rms distance of points (n, k) from their mean."""
    return float(np.sqrt(np.mean(np.sum((x - x.mean(axis=0)) ** 2, axis=1))))


def inverse_triangle(rows: Array) -> tuple[Array, Array] | None:
    """Return the inverse (c, c) of a triangle ``[R r]`` (q, c + 1), and ``-R^-1 r`` (c,); None where R is singular.

    It is where its condition does not rule out singular values below a hundred times :data:`ROUNDING`.
    """
    c = rows.shape[1] - 1
    if len(rows) < c or c == 0:
        return None
    R = rows[:c, :c]
    if not np.all(np.diag(R)) or scipy.linalg.lapack.dtrcon(R)[0] < _SURELY * c * ROUNDING:
        return None
    inverse = np.triu(scipy.linalg.lapack.dtrtri(R)[0])
    return inverse, -inverse @ rows[:c, c]


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


def one_thread(*, of_scipy: bool = True) -> AbstractContextManager[object]:
    """Return a context in which linear algebra runs in one thread.

    Our matrices are small: a second thread gains nothing, and waits a hundred times longer where a core is shared.
    ``of_scipy``: that of SciPy, too, which is loaded for it. False where the block calls NumPy alone. Raises CalibError
    where there is no memory for it.
    """
    if of_scipy:
        import_module("scipy.linalg")  # which has threads of its own
    libraries = _libraries("scipy.linalg" in sys.modules)
    return cast(AbstractContextManager[object], libraries.limit(limits=1, user_api="blas"))


@functools.cache
def _libraries(of_scipy: bool) -> ThreadpoolController:
    """Return NumPy's and SciPy's, found once: to look through all that is loaded takes as long as half a fit.

    Each sets aside its memory here, while there is some: OpenBLAS tries again without end where it gets none later.
    """
    _refuse_little_memory()
    np.linalg.solve(np.eye(1), np.ones(1))
    if of_scipy:
        _refuse_little_memory()
        scipy.linalg.lapack.dgesv(np.eye(1), np.ones(1))
    return ThreadpoolController()


def _refuse_little_memory() -> None:
    try:
        mmap.mmap(-1, _SET_ASIDE).close()
    except OSError as e:
        raise CalibError(LITTLE_MEMORY) from e
