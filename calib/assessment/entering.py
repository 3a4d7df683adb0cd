"""Linear least squares into which blocks of unknowns enter one after the other, for several folds of rows.

Of a thousand unknowns few ever enter. So of the normal equations only the rows of these are formed, and what each block
says by itself.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from calib.assessment.eliminated import Eliminated, Own
from calib.foundations.arrays import Array, BoolArray, IntArray

_NO_BLOCKS = np.zeros((0, 0))


class Products:
    """Products of the columns of whitened rows ``[J r]``, for rows without each fold, blocks of few rows eliminated.

    All products are kept, or, where these are fewer numbers, the rows, and products that were asked for.
    """

    def __init__(
        self,
        rows: Iterable[tuple[IntArray, Array, Own | None]],
        folds: int,
        numbers: int,
        size: int,
        columns: IntArray,
        held: Array = _NO_BLOCKS,
    ) -> None:
        """Collect ``rows``: folds (n,), ``[J r]`` (n, d, size) and their own; ``numbers``: n * d of all together.

        ``columns`` (m, b): of groups of unknowns. ``held`` (k, a): weights by which the unknowns of blocks are held at
        zero.
        """
        of_fold: list[list[Array]] = [[np.zeros((0, size))] for _ in range(folds)]
        self._all = None if numbers < folds * size else np.zeros((folds, size, size))
        self._counts = np.zeros(folds)
        self._known: dict[tuple[int, ...], tuple[Array, Array]] = {}
        of_blocks: dict[tuple[int, int], Array] = {}
        for fold, block, own in rows:
            for k in np.unique(fold):
                flat = block[fold == k].reshape(-1, size)
                self._counts[k] += len(flat)
                if self._all is None:
                    of_fold[k].append(flat)
                else:
                    self._all[k] += flat.T @ flat
            if own is not None:
                _add(of_blocks, own, fold, block)
        self._rows = [np.concatenate(own) for own in of_fold]
        if self._all is not None:
            self._sum = self._all.sum(axis=0)
            C, g = self._all[:, columns[:, :, None], columns[:, None, :]], self._all[:, columns, -1]
        else:
            C = np.stack([np.einsum("nmi,nmj->mij", own, own) for own in (r[:, columns] for r in self._rows)])
            g = np.stack([own[:, -1] @ own for own in self._rows])[:, columns]
        self._columns, self._blocks = columns, (C, C.sum(axis=0), g, g.sum(axis=0))
        self._eliminated = Eliminated(held, of_blocks, folds, size)

    def __len__(self) -> int:
        return len(self._rows)

    def freedom(self, without: int | None) -> float:
        """Return how many numbers rows have, of all or ``without`` a fold, less what the blocks take of them."""
        counted = self._counts.sum() - (0.0 if without is None else self._counts[without])
        return float(counted - self._eliminated.taught(without))

    def rows(self, which: Sequence[int], without: int | None) -> Array:
        """Return the products (k, size) of some columns with all, of all rows or ``without`` those of a fold."""
        less = self._eliminated.rows(which, slice(None))
        if without is not None:
            less = less + self._eliminated.change(which, slice(None), without)
        if self._all is not None:
            return np.asarray(self._sum[which] - (0.0 if without is None else self._all[without, which]) - less)
        key = tuple(which)
        if key not in self._known:
            of_folds = np.stack([own[:, which].T @ own for own in self._rows])
            self._known[key] = of_folds, of_folds.sum(axis=0)
        of_folds, of_all = self._known[key]
        return np.asarray((of_all if without is None else of_all - of_folds[without]) - less)

    def grams(self, which: IntArray) -> Array:
        """Return the products (folds + 1, k, k) of some columns with each other: without each fold, last of all."""
        if self._all is not None:
            of_folds = self._all[:, which[:, None], which]
        else:
            of_folds = np.stack([own.T @ own for own in (rows[:, which] for rows in self._rows)])
        of_all = of_folds.sum(axis=0)
        columns = which.tolist()
        of_all -= self._eliminated.rows(columns, which)
        changes = np.stack([self._eliminated.change(columns, which, k) for k in range(len(self))])
        return np.concatenate([of_all - of_folds - changes, of_all[None]])

    def blocks(self, without: int | None) -> tuple[Array, Array]:
        """Return the same within groups of columns, (m, b, b), and of their columns with the last one, (m, b)."""
        C, every_C, g, every_g = self._blocks
        less_C, less_g = self._eliminated.blocks(self._columns, without)
        if without is None:
            return every_C - less_C, every_g - less_g
        return every_C - C[without] - less_C, every_g - g[without] - less_g

    def following(self, rows: Array, own: Own | None, without: int) -> Array:
        """Return held-out rows ``[J r]`` (n, d, size), blocks being where the rows without theirs place them."""
        return self._eliminated.following(rows, own, without)


def _add(found: dict[tuple[int, int], Array], own: Own, fold: IntArray, rows: Array) -> None:
    """Add the products (a, a + size) of rows (n, d, size) with unknowns of their own, by block and fold."""
    those = np.flatnonzero(own.block >= 0)
    keys, count = np.unique(np.stack([own.block[those], fold[those]]), axis=1, return_counts=True)
    order = those[np.lexsort((fold[those], own.block[those]))]
    ends = np.cumsum(count)
    for (block, k), first, last in zip(keys.T.tolist(), ends - count, ends, strict=True):
        here = order[first:last]
        by = own.by[here].reshape(-1, own.by.shape[2])
        more = np.concatenate([by.T @ by, by.T @ rows[here].reshape(len(by), -1)], axis=1)
        found[block, k] = found[block, k] + more if (block, k) in found else more


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
