"""Least squares where most unknowns are of some rows only: targets are eliminated, one by one, exactly.

A row is about one target at most, so that the columns of a Jacobian fall into *common* ones - robot, base, tools - and
*blocks*, one for each target, of which no row sees two. Rows of one block are turned by an orthogonal matrix until all
but as many as the block has columns see nothing of it:

    Q^T [B C r] = [B' C' r']    heads, as many rows as B has columns
                  [0  C" r"]    the rest, which is about common unknowns alone

The rests of all blocks together are an ordinary small least-squares problem for the common unknowns; the heads say
where every target is, given these. Nothing is squared and nothing neglected: cost, gradient and steps are those of the
whole Jacobian, at a cost that grows with the number of targets alone (the arrow of a bundle adjustment: D. C. Brown, *A
solution to the general problem of multiple station analytical stereotriangulation*, 1958; G. H. Golub, V. Pereyra,
*The differentiation of pseudo-inverses and nonlinear least squares problems whose variables separate*, 1973).

Heads are kept, and not inverted, until priors are added: what a block leaves open flows back into the rest then.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.foundations import linear
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.sealing import sealed


@dataclass(frozen=True, eq=False)
@sealed
class Split:
    """Which of p parameters are common (c,), and which make up the blocks (m, a): numbers, -1 where one has fewer."""

    common: IntArray
    blocks: IntArray

    @classmethod
    def none(cls, p: int) -> "Split":
        """Return the split of p parameters that are all common."""
        return cls(np.arange(p), np.zeros((0, 0), dtype=np.intp))

    @property
    def size(self) -> int:
        """The number of parameters: p."""
        return len(self.common) + int(np.count_nonzero(self.real))

    @cached_property
    def real(self) -> BoolArray:
        """Which columns of blocks (m, a) are parameters."""
        return np.asarray(self.blocks >= 0)

    @cached_property
    def block_of(self) -> IntArray:
        """The block (p,) of every parameter, -1 for common ones."""
        found = np.full(self.size, -1, dtype=np.intp)
        found[self.blocks[self.real]] = np.nonzero(self.real)[0]
        return found

    @cached_property
    def columns(self) -> IntArray:
        """The column (p,) of every parameter: the common ones first, then, from c on, its place in its block."""
        found = np.empty(self.size, dtype=np.intp)
        found[self.common] = np.arange(len(self.common))
        found[self.blocks[self.real]] = len(self.common) + np.nonzero(self.real)[1]
        return found

    def of_blocks(self, which: IntArray) -> "Split":
        """Return the split with some of the blocks."""
        return Split(self.common, self.blocks[which])

    def without(self, parameters: BoolArray) -> "Split":
        """Return the split of which blocks with any of some ``parameters`` (p,) are common."""
        also = np.any(self.real & parameters[self.blocks], axis=1)
        more = self.blocks[also][self.real[also]]
        if also.all():
            # No block is of any width: rows have no columns of their own.
            return Split.none(self.size)
        return Split(np.sort(np.concatenate([self.common, more])), self.blocks[~also])

    def parts(self, x: Array) -> tuple[Array, Array]:
        """Return the common entries (c, ...) of numbers (p, ...), and those of the blocks (m, a, ...), 0 for none."""
        own = np.asarray(x)[np.where(self.real, self.blocks, 0)]
        own[~self.real] = 0.0
        return np.asarray(x)[self.common], own

    def whole(self, common: Array, own: Array) -> Array:
        """Return numbers (p, ...) from common ones (c, ...) and those of the blocks (m, a, ...)."""
        found = np.empty((self.size, *common.shape[1:]))
        found[self.common] = common
        found[self.blocks[self.real]] = own[self.real]
        return found


class Heads(NamedTuple):
    """Heads (k, a, a + c + 1) ``[B C r]`` of those blocks ``which`` (k,) that some rows are about."""

    which: IntArray
    rows: Array


class Part(NamedTuple):
    """Whitened rows ``[J r]`` of one component: ``heads`` of those blocks that it sees, and the ``rest`` (q, c + 1)."""

    split: Split
    heads: Heads
    rest: Array

    def after(self, step: Array) -> float:
        """Return the sum of squares of ``J step + r``."""
        common, own = self.split.parts(step)
        return _after(self.heads.rows, self.rest, common, own[self.heads.which], 1.0)


def _after(heads: Array, rest: Array, common: Array, own: Array, share: float) -> float:
    a = own.shape[1]
    of_blocks = (heads[:, :, :a] @ own[:, :, None])[:, :, 0] + heads[:, :, a:-1] @ common + share * heads[:, :, -1]
    return float(np.sum(of_blocks**2) + np.sum((rest[:, :-1] @ common + share * rest[:, -1]) ** 2))


class Collected:
    """``[B C r]`` of the rows of one component, reduced as they come: heads of blocks, and a triangle of the rest."""

    def __init__(self, which: IntArray, blocks: int, a: int, c: int) -> None:
        self._a, self._c = a, c
        self._place = np.full(blocks + 1, -1, dtype=np.intp)
        self._place[which] = np.arange(len(which))
        self.heads = Heads(which, np.zeros((len(which), a, a + c + 1)))
        self._rest = linear.Gathered(c + 1)

    @property
    def rest(self) -> Array:
        """The triangle (q, c + 1) of what sees nothing of a block."""
        return self._rest.triangle

    def forget(self) -> None:
        """Begin the rest anew."""
        self._rest = linear.Gathered(self._c + 1)

    def add(self, rows: Array, own: Array | None, block: IntArray | None) -> None:
        """Add rows: ``rows`` (n, d, c + 1) ``[C r]``, ``own`` (n, d, a) and ``block`` (n,), -1 for none."""
        left = [rows if own is None or block is None else rows[block < 0]]
        if own is not None and block is not None:
            place = self._place[block]
            left += self._folded(np.concatenate([own, rows], axis=2)[place >= 0], place[place >= 0])
        self._rest.add(*left)

    def _folded(self, rows: Array, place: IntArray) -> list[Array]:
        """Take rows (n, d, a + c + 1) into the heads of their blocks, and return what is left."""
        left = []
        for these, of in alike(place):
            own = rows[of]
            own[of < 0] = 0.0
            both = np.concatenate([self.heads.rows[these], own.reshape(len(these), -1, rows.shape[2])], axis=1)
            if both.shape[1] > both.shape[2]:
                both = linear.triangle(both)
            else:
                turn(both, self._a)
            self.heads.rows[these] = both[:, : self._a]
            left.append(both[:, self._a :, self._a :])
        return left


def alike(number: IntArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield numbers (k,) that about as many of all ``number`` (n,) are, and where these are (k, h); -1 for no more."""
    order = np.argsort(number, kind="stable")
    there, counts = np.unique(number, return_counts=True)
    starts, sizes = np.cumsum(counts) - counts, np.frexp(counts - 0.5)[1]
    for size in np.unique(sizes):
        these = np.flatnonzero(sizes == size)
        nth = np.arange(int(counts[these].max()))
        inside = nth < counts[these, None]
        yield there[these], np.where(inside, order[np.where(inside, starts[these, None] + nth, 0)], -1)


def turn(blocks: Array, a: int) -> None:
    """Turn rows of blocks (m, h, w), in place, until only the first ones see the first a columns: Householder's way."""
    for j in range(min(a, blocks.shape[1])):
        v = blocks[:, j:, j].copy()
        length = np.linalg.norm(v, axis=1)
        v[:, 0] += np.copysign(length, v[:, 0])
        square = np.einsum("mh,mh->m", v, v)
        v *= np.sqrt(np.divide(2.0, square, out=np.zeros_like(square), where=square > 0.0))[:, None]
        part = blocks[:, j:, j:]
        part -= v[:, :, None] * (v[:, None] @ part)
        blocks[:, j + 1 :, j] = 0.0


class Reduced(NamedTuple):
    """Blocks solved for, given the common unknowns z: they are at ``follow @ z + constant``.

    ``root`` (m, a, a): its square ``root @ root^T`` is their covariance for known z. ``singular_values`` (m, a) of the
    blocks with their ``vectors`` (m, a, a), as columns; inf where a block has fewer columns. ``rest`` (q, c + 1): what
    rows say of z.
    """

    follow: Array
    constant: Array
    root: Array
    singular_values: Array
    vectors: Array
    rest: Array


@dataclass(frozen=True, eq=False)
@sealed
class Arrow:
    """Whitened rows ``[J r]`` of a split: ``heads`` (m, h, a + c + 1) and ``rest`` (q, c + 1)."""

    split: Split
    heads: Array
    rest: Array

    @classmethod
    def plain(cls, J: Array) -> "Arrow":
        """Return rows J (q, p) of which all columns are common, and r is zero."""
        p = J.shape[1]
        return cls(Split.none(p), np.zeros((0, 0, p + 1)), np.pad(J, ((0, 0), (0, 1))))

    @classmethod
    def empty(cls, split: Split) -> "Arrow":
        """Return no rows at all."""
        (m, a), c = split.blocks.shape, len(split.common)
        return cls(split, np.zeros((m, 0, a + c + 1)), np.zeros((0, c + 1)))

    @property
    def a(self) -> int:
        """The number of columns of a block."""
        return int(self.split.blocks.shape[1])

    @property
    def sum_of_squares(self) -> float:
        """That of r."""
        return float(np.sum(self.heads[:, :, -1] ** 2) + np.sum(self.rest[:, -1] ** 2))

    def after(self, step: Array, share: float = 1.0) -> float:
        """Return the sum of squares of ``J step + share r``."""
        return _after(self.heads, self.rest, *self.split.parts(step), share)

    def moved(self, directions: Array) -> Array:
        """Return rows (q, k) with the sums of squares and products of ``J directions``, of directions (p, k)."""
        (common, own), a = self.split.parts(directions), self.a
        of_blocks = self.heads[:, :, :a] @ own + self.heads[:, :, a:-1] @ common
        return np.concatenate([*of_blocks, self.rest[:, :-1] @ common])

    def columns(self, parameters: IntArray) -> Array:
        """Return the columns (q, k) of some parameters, which are common ones, or of one block."""
        block, column = self.split.block_of[parameters], self.split.columns[parameters]
        if block[0] >= 0:
            return np.asarray(self.heads[block[0]][:, column - len(self.split.common)])
        return np.concatenate([self.heads[:, :, self.a + column].reshape(-1, len(column)), self.rest[:, column]])

    @property
    def lengths(self) -> Array:
        """The lengths (p,) of the columns of J."""
        a = self.a
        common = np.sum(self.heads[:, :, a:-1] ** 2, axis=(0, 1)) + np.sum(self.rest[:, :-1] ** 2, axis=0)
        return np.sqrt(self.split.whole(common, np.sum(self.heads[:, :, :a] ** 2, axis=1)))

    def held(self, hold: Array, residual: Array) -> "Arrow":
        """Return the rows with one more for every parameter: weights ``hold`` (p,) and residuals (p,)."""
        common, own = self.split.parts(hold)
        off, own_off = self.split.parts(residual)
        a, rows = self.a, np.column_stack([np.diag(common), off])[common > 0.0]
        more = np.zeros((len(own), a, self.heads.shape[2]))
        more[:, range(a), range(a)], more[:, :, -1] = own, own_off
        return Arrow(self.split, np.concatenate([self.heads, more], axis=1), np.concatenate([self.rest, rows]))

    def reduced(self, tolerance: float) -> Reduced:
        """Return the rows with the blocks eliminated; singular values below a share of the largest are none."""
        a, c = self.a, self.rest.shape[1] - 1
        if not len(self.heads):
            none = np.zeros((0, a, a))
            return Reduced(np.zeros((0, a, c)), np.zeros((0, a)), none, np.zeros((0, a)), none, self.rest)
        U, s, Vt = linear.svd(self.heads[:, :, :a])
        turned = np.swapaxes(U, -1, -2) @ self.heads[:, :, a:]
        seen = s > tolerance * s.max(initial=0.0)
        root = np.swapaxes(Vt, -1, -2) * np.divide(1.0, s, out=np.zeros_like(s), where=seen)[:, None]
        found = -root @ turned[:, :a]
        rest = np.concatenate([self.rest, turned[:, :a][~seen], turned[:, a:].reshape(-1, c + 1)])
        return Reduced(
            found[:, :, :-1],
            found[:, :, -1],
            root,
            np.where(np.arange(a) < self.split.real.sum(axis=1)[:, None], s, np.inf),
            np.swapaxes(Vt, -1, -2),
            linear.triangle(rest),
        )


def gathered(split: Split, heads: Sequence[Heads], rests: Sequence[Array]) -> Arrow:
    """Return the rows of several components together."""
    (m, a), c = split.blocks.shape, len(split.common)
    total, left = np.zeros((m, a, a + c + 1)), list(rests)
    for which, rows in heads:
        if not total[which].any():
            total[which] = rows
            continue
        both = np.concatenate([total[which], rows], axis=1)
        turn(both, a)
        total[which] = both[:, :a]
        left.append(both[:, a:, a:].reshape(-1, c + 1))
    return Arrow(split, total, np.concatenate(left))


class Inverse(NamedTuple):
    """The solution of rows of an :class:`Arrow`, priors among them.

    ``step`` (p,): the unknowns; ``spread`` (c, k): a root of the covariance of common ones, of the ``reduced`` rest.
    """

    split: Split
    step: Array
    spread: Array
    reduced: Reduced

    @property
    def covariance(self) -> "Covariance":
        """The covariance of the solution, for whitened rows."""
        return Covariance(self.split, self.spread @ self.spread.T, self.reduced.follow, self.reduced.root)

    @classmethod
    def of(cls, rows: Arrow) -> "Inverse":
        """Solve for the step that makes ``J step + r`` smallest."""
        reduced = rows.reduced(linear.ROUNDING)
        spread, common = _solved(reduced.rest)
        return cls(rows.split, rows.split.whole(common, reduced.follow @ common + reduced.constant), spread, reduced)

    def used(self, part: Part) -> float:
        """Return how many of the unknowns the rows of one component determine: the trace of their hat matrix."""
        which, rows = part.heads
        a = self.split.blocks.shape[1]
        B = rows[:, :, :a]
        through = (B @ self.reduced.follow[which] + rows[:, :, a:-1]) @ self.spread
        own = np.sum((B @ self.reduced.root[which]) ** 2)
        return float(own + np.sum(through**2) + np.sum((part.rest[:, :-1] @ self.spread) ** 2))


def _solved(rows: Array) -> tuple[Array, Array]:
    """Return a root (c, k) of the covariance of what rows (q, c + 1) are about, and its solution (c,).

    By a triangle, unless its condition lets singular values be no more than rounding: these count as none.
    """
    found = linear.inverse_triangle(linear.triangle(rows))
    if found is None:
        spread = np.asarray(np.linalg.pinv(rows[:, :-1], rcond=linear.ROUNDING), dtype=np.float64)
        return spread, -spread @ rows[:, -1]
    return found


@dataclass(frozen=True, eq=False)
@sealed
class Covariance:
    """The covariance (p, p) of all parameters by parts, of which any block of entries can be had.

    ``common`` (c, c); blocks are at ``follow`` (m, a, c) times the common ones, and scatter by ``root`` (m, a, a)
    beside that.
    """

    split: Split
    common: Array
    follow: Array
    root: Array

    @classmethod
    def whole(cls, covariance: Array) -> "Covariance":
        """Return that of parameters which are all common, of their covariance (p, p)."""
        return cls(Split.none(len(covariance)), covariance, np.zeros((0, 0, len(covariance))), np.zeros((0, 0, 0)))

    def of(self, parameters: IntArray | Sequence[int] | None = None) -> Array:
        """Return the covariance (k, k) of some parameters, by number; of all where there are none given."""
        chosen = np.arange(self.split.size) if parameters is None else np.asarray(parameters, dtype=np.intp)
        c, a = len(self.split.common), self.split.blocks.shape[1]
        place = np.empty(self.split.size, dtype=np.intp)
        place[self.split.common] = np.arange(c)
        place[self.split.blocks[self.split.real]] = c + np.flatnonzero(self.split.real)
        at = place[chosen]
        follow = np.zeros((len(at), c))
        own = at >= c
        follow[~own, at[~own]] = 1.0
        block, entry = np.divmod(at[own] - c, max(a, 1))
        follow[own] = self.follow[block, entry]
        found = follow @ self.common @ follow.T
        root = self.root[block, entry]
        i, j = np.nonzero(block[:, None] == block[None])
        numbers = np.flatnonzero(own)
        found[numbers[i], numbers[j]] += np.einsum("nk,nk->n", root[i], root[j])
        return np.asarray(found)

    def of_rows(self, J: Array, blocks: IntArray) -> Array:
        """Return the covariances (n, c + a, d) of parameters with what rows say by Jacobians J (n, d, c + a).

        The columns are those of the common parameters, then those of a row's block (n,); -1: of none. Without any, a
        may be 0.
        """
        c = len(self.common)
        common, own = np.swapaxes(J[:, :, :c], -1, -2), np.swapaxes(J[:, :, c:], -1, -2)
        if not own.size:
            return np.asarray(self.common @ common)
        # The matrices of all rows would be gigabytes.
        F, L = self.follow[blocks], self.root[blocks]
        F[blocks < 0], L[blocks < 0] = 0.0, 0.0
        found = self.common @ (common + np.swapaxes(F, -1, -2) @ own)
        return np.concatenate([found, F @ found + L @ (np.swapaxes(L, -1, -2) @ own)], axis=1)

    def times(self, values: Array) -> Array:
        """Return the covariance times ``values`` (p, k)."""
        common, own = self.split.parts(values)
        found = self.common @ (common + np.einsum("mac,mak->ck", self.follow, own, optimize=True))
        return self.split.whole(found, self.follow @ found + self.root @ (np.swapaxes(self.root, -1, -2) @ own))

    def scaled(self, s: Array) -> "Covariance":
        """Return that of parameters in other units, each of which is 1 / s (p,) of its own."""
        common, own = self.split.parts(s)
        follow = own[:, :, None] * self.follow / common
        return Covariance(self.split, self.common * common[:, None] * common, follow, own[:, :, None] * self.root)

    @property
    def variances(self) -> Array:
        """The variances (p,)."""
        own = np.einsum("mac,cd,mad->ma", self.follow, self.common, self.follow, optimize=True)
        return self.split.whole(np.diag(self.common), own + np.sum(self.root**2, axis=2))
