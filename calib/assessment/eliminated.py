"""Unknowns of few rows each, eliminated from normal equations: of all rows, and of those without each fold.

Targets, and tools and set-ups of which there are many, are *blocks* of unknowns, no two of which one row is about
(:mod:`calib.identification.elimination`). What rows say of all others is the Schur complement of the blocks, and
where a fold is left out, only blocks of which it has rows change.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import IdentificationError
from calib.identification.widths import TOO_UNLIKE


class Own(NamedTuple):
    """How rows follow unknowns of the ``block`` (n,) that each is about, -1 for none: ``by`` (n, d, a)."""

    by: Array
    block: IntArray


class _Solved(NamedTuple):
    """Equations (k, a, size) of ``blocks`` (k,) with all columns, the same solved for their unknowns, and ``taught``.

    ``taught`` (k,): how many unknowns of each the data tell, rather than what holds them.
    """

    blocks: IntArray
    equations: Array
    solved: Array
    taught: Array

    @classmethod
    def of(cls, blocks: IntArray, products: Array, held: Array) -> "_Solved":
        """Solve the products (k, a, a + size) of blocks that are held by weights (k, a)."""
        a = held.shape[1]
        H = products[:, :, :a].copy()
        H[:, range(a), range(a)] += held
        try:
            inverse = np.linalg.inv(H)
        except np.linalg.LinAlgError as e:
            raise IdentificationError(TOO_UNLIKE) from e
        taught = a - np.einsum("ka,kaa->k", held, inverse)
        return cls(blocks, products[:, :, a:], inverse @ products[:, :, a:], taught)


class Eliminated:
    """What is taken from normal equations when blocks of unknowns are eliminated."""

    def __init__(self, held: Array, products: Mapping[tuple[int, int], Array], folds: int, size: int) -> None:
        """Eliminate blocks, held by weights ``held`` (m, a), of ``products`` (a, a + size) by block and fold."""
        m, a = held.shape
        self._size, of_block = size, [list[int]() for _ in range(m)]
        parts = np.array(list(products.values())).reshape(len(products), a, a + size)
        for k, (block, _) in enumerate(products):
            of_block[block].append(k)
        whole, without = np.zeros((m, a, a + size)), np.zeros_like(parts)
        for block, own in enumerate(of_block):
            whole[block] = parts[own].sum(axis=0)
            for k in own:
                # Not by a difference, of which rounding would be left where a fold has all rows of a block.
                without[k] = parts[[other for other in own if other != k]].sum(axis=0)
        self._whole = _Solved.of(np.arange(m), whole, held)
        block_of, fold_of = np.array(list(products), dtype=np.intp).reshape(-1, 2).T
        self._without = [
            _Solved.of(block_of[here], without[here], held[block_of[here]])
            for here in (np.flatnonzero(fold_of == k) for k in range(folds))
        ]

    def _changes(self, fold: int) -> list[tuple[float, Array, Array]]:
        """Return equations and solutions (k, a, size), and by what they count, that change without a fold."""
        changed = self._without[fold]
        before = self._whole.equations[changed.blocks], self._whole.solved[changed.blocks]
        return [(-1.0, *before), (1.0, changed.equations, changed.solved)]

    def rows(self, which: Sequence[int], columns: IntArray | slice) -> Array:
        """Return what is taken from products of columns ``which`` with ``columns``, of all rows."""
        return _rows(which, columns, self._whole.equations, self._whole.solved)

    def change(self, which: Sequence[int], columns: IntArray | slice, fold: int) -> Array:
        """Return how much more is taken from them without a fold."""
        return np.asarray(sum(sign * _rows(which, columns, *of) for sign, *of in self._changes(fold)))

    def blocks(self, columns: IntArray, without: int | None) -> tuple[Array, Array]:
        """Return what is taken from products within groups of columns (m, b), and of these with the last one."""
        C, g = np.zeros((*columns.shape, columns.shape[1])), np.zeros(columns.shape)
        whole = (1.0, self._whole.equations, self._whole.solved)
        for sign, equations, solved in [whole, *([] if without is None else self._changes(without))]:
            ours, theirs = equations.reshape(-1, self._size), solved.reshape(-1, self._size)
            chosen = ours[:, columns]
            C += sign * np.einsum("kmi,kmj->mij", chosen, theirs[:, columns])
            g += sign * np.einsum("kmi,k->mi", chosen, theirs[:, -1])
        return C, g

    def taught(self, without: int | None) -> float:
        """Return how many unknowns of the blocks all rows tell, or those ``without`` a fold."""
        total = self._whole.taught.sum()
        if without is not None:
            changed = self._without[without]
            total += changed.taught.sum() - self._whole.taught[changed.blocks].sum()
        return float(total)

    def following(self, rows: Array, own: Own | None, without: int) -> Array:
        """Return held-out rows ``[J r]`` (n, d, size), blocks being where the rows without theirs place them."""
        if own is None:
            return rows
        changed = self._without[without]
        place = np.full(len(self._whole.blocks) + 1, -1, dtype=np.intp)
        place[changed.blocks] = np.arange(len(changed.blocks))
        of, found = place[own.block], rows.copy()
        there = of >= 0
        found[there] -= own.by[there] @ changed.solved[of[there]]
        return found


def _rows(which: Sequence[int], columns: IntArray | slice, equations: Array, solved: Array) -> Array:
    flat = equations.reshape(-1, equations.shape[2]), solved.reshape(-1, solved.shape[2])
    return np.asarray(flat[0][:, which].T @ flat[1][:, columns])
