"""Linear least squares into which blocks of unknowns enter one after the other, for several folds of rows.

Of a thousand unknowns few ever enter. So of the normal equations only the rows of these are formed, and what each block
says by itself.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray


class Products:
    """Products of the columns of whitened rows ``[J r]``, for every fold of them.

    ``counts`` (folds,): numbers in each. All products are kept, or, where these are fewer numbers, the rows, and
    products that were asked for.
    """

    def __init__(
        self, rows: Iterable[tuple[IntArray, Array]], folds: int, numbers: int, size: int, columns: IntArray
    ) -> None:
        """Collect ``rows``: folds (n,), and ``[J r]`` (n, d, size); ``numbers``: n * d of all together.

        ``columns`` (m, b): of blocks of unknowns.
        """
        of_fold: list[list[Array]] = [[np.zeros((0, size))] for _ in range(folds)]
        self._all = None if numbers < folds * size else np.zeros((folds, size, size))
        self.counts = np.zeros(folds)
        self._known: dict[tuple[int, ...], tuple[Array, Array]] = {}
        for fold, block in rows:
            for k in np.unique(fold):
                flat = block[fold == k].reshape(-1, size)
                self.counts[k] += len(flat)
                if self._all is None:
                    of_fold[k].append(flat)
                else:
                    self._all[k] += flat.T @ flat
        self._rows = [np.concatenate(own) for own in of_fold]
        if self._all is not None:
            self._sum = self._all.sum(axis=0)
            C, g = self._all[:, columns[:, :, None], columns[:, None, :]], self._all[:, columns, -1]
        else:
            C = np.stack([np.einsum("nmi,nmj->mij", own, own) for own in (r[:, columns] for r in self._rows)])
            g = np.stack([own[:, -1] @ own for own in self._rows])[:, columns]
        self._blocks = C, C.sum(axis=0), g, g.sum(axis=0)

    def __len__(self) -> int:
        return len(self._rows)

    def rows(self, which: Sequence[int], without: int | None) -> Array:
        """Return the products (k, size) of some columns with all, of all rows or ``without`` those of a fold."""
        if self._all is not None:
            return np.asarray(self._sum[which] - (0.0 if without is None else self._all[without, which]))
        key = tuple(which)
        if key not in self._known:
            of_folds = np.stack([own[:, which].T @ own for own in self._rows])
            self._known[key] = of_folds, of_folds.sum(axis=0)
        of_folds, of_all = self._known[key]
        return np.asarray(of_all if without is None else of_all - of_folds[without])

    def grams(self, which: IntArray) -> Array:
        """Return the products (folds, k, k) of some columns with each other, of the rows of every fold."""
        if self._all is not None:
            return self._all[:, which[:, None], which]
        return np.stack([own.T @ own for own in (rows[:, which] for rows in self._rows)])

    def blocks(self, without: int | None) -> tuple[Array, Array]:
        """Return the same within blocks of columns, (m, b, b), and of their columns with the last one, (m, b)."""
        C, every_C, g, every_g = self._blocks
        return (every_C, every_g) if without is None else (every_C - C[without], every_g - g[without])


class Blocks:
    """What normal equations say of each block of unknowns by itself, others being eliminated."""

    def __init__(
        self, blocks: tuple[IntArray, BoolArray], C: Array, g: Array, costs: Array, among: Sequence[int]
    ) -> None:
        """Begin with the equations C (m, b, b) and g (m, b) of every block, and what each of them costs (m,).

        ``blocks`` as :func:`filled` has them; only those ``among`` which is chosen are ever taken.
        """
        self._columns, there = blocks
        self._there, self._both = there, there[:, :, None] & there[:, None, :]
        self._C, self._g = C * self._both, g * there
        self._C[:, range(there.shape[1]), range(there.shape[1])] += ~there
        self._costs = costs
        self._left = np.zeros(len(there), dtype=np.bool_)
        self._left[list(among)] = True

    def take(self) -> tuple[int, float]:
        """Take the block that would lower the sum of squares most for what it costs; return it, and by how much."""
        left = np.flatnonzero(self._left)
        C, g = self._C[left], self._g[left]
        if g.shape[1] == 2:  # this is most of the work, and done by hand four times as quick
            (a, b), c, (u, v) = C[:, 0].T, C[:, 1, 1], g.T
            gains = (c * u**2 - 2.0 * b * u * v + a * v**2) / (a * c - b**2)
        else:
            gains = np.sum(g * np.linalg.solve(C, g[:, :, None])[:, :, 0], axis=1)
        gains = gains / self._costs[left]
        best = int(np.argmax(gains))
        self._left[left[best]] = False
        return int(left[best]), float(gains[best])

    def eliminate(self, rows: Array, solved: Array) -> None:
        """Eliminate unknowns, given their rows (k, p + 1) and the same solved for them."""
        ours, theirs = rows[:, self._columns], solved[:, self._columns]
        self._C -= np.einsum("kni,knj->nij", ours, theirs) * self._both
        self._g -= np.einsum("kni,k->ni", ours, solved[:, -1]) * self._there


def filled(blocks: Sequence[Sequence[int]]) -> tuple[IntArray, BoolArray]:
    """Return the columns of blocks (m, b), smaller ones filled up with some of their own, and which are no filling."""
    size = max(map(len, blocks), default=0)
    columns = np.array([[*block, *[block[0]] * (size - len(block))] for block in blocks], dtype=np.intp)
    sizes = np.array([len(block) for block in blocks], dtype=np.intp)
    return columns.reshape(len(blocks), size), np.arange(size) < sizes[:, None]
