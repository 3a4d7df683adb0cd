"""Identifiability: the ranks, the null space, and what is done about it.

Everything here works on a triangle R (q, p) of the whitened Jacobian whose columns are scaled: one unit is one
parameter scale (1 mm, 1 mrad, or the prior), so that 1/s is the standard deviation of a direction in scales. Two
ranks follow. The formal rank counts singular values above ``RANK_TOLERANCE`` of the largest: what the data determine at
all. The numerical rank counts those above ``NUMERICAL_TOLERANCE``: directions known to ten parameter scales or better.
The rest would take any value that noise, or a second-order effect of a direction of the null space, dictates - turns of
a tenth of a radian on real arms - and moves no prediction by more than the noise; they belong to the null space as
well.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray, read_only
from calib.foundations.brief import brief
from calib.foundations.linear import svd, triangle
from calib.foundations.sealing import sealed
from calib.foundations.units import MM, MRAD
from calib.identification.arrow import Arrow, Inverse, Reduced, Split
from calib.identification.parameters import Parameter

RANK_TOLERANCE = 1e-9
NUMERICAL_TOLERANCE = 0.1
# A parameter is not identifiable when a unit direction of the null space moves it by more than this. Shares of
# identifiable parameters stay below 0.02 (second-order effects of deviations up to 10 mm), those of others above 0.1.
# What such shares leave open where the truth is far along the direction is in sigmas (AlongNullSpace).
MOVED = 0.02
# Directions that are determined up to so many times better than those of the null space help to find these; by so weak
# a prior, in as many steps. What moves what counts by less than this share does not move it.
_AROUND, _SHIFT, _ITERATIONS, _SHORT = 10.0, 1e-2, 6, 1e-8
# A column is small below so many times the last singular value that counts, times the share that is asked of it.
_SMALL = 10.0
# Smaller shares of a direction of the null space are not told.
_TOLD_SHARE = 1e-2
_MOST_NAMED = 4


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Directions:
    """Directions in scaled space, best known first: columns of ``vectors`` (c, c), with values ``of_common`` (c,).

    ``of_blocks`` (k,): singular values of what was eliminated.
    """

    vectors: Array
    of_common: Array
    of_blocks: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def singular_values(self) -> Array:
        """All singular values (p,), the largest first."""
        return np.sort(np.concatenate([self.of_common, self.of_blocks]))[::-1]

    @property
    def rank(self) -> int:
        """Number of parameter combinations that the data determine."""
        return self._above(0.0)

    @property
    def numerical_rank(self) -> int:
        """Number of parameter combinations that the data determine to ten parameter scales or better."""
        return self._above(NUMERICAL_TOLERANCE)

    def null_basis(self, rank: int) -> Array:
        """Return a basis (p, p - rank) of the null space: the directions beyond the best ``rank`` ones."""
        return self.vectors[:, rank:]

    def common_rank(self, threshold: float) -> int:
        """Return how many directions of common parameters are determined better than by a threshold."""
        return int(np.count_nonzero(self.of_common > self.least(threshold)))

    def _above(self, threshold: float) -> int:
        return self.common_rank(threshold) + int(np.count_nonzero(self.of_blocks > self.least(threshold)))

    def least(self, threshold: float) -> float:
        """Return the threshold; where it is below what counts beside the largest singular value, that."""
        largest = max(float(self.of_common.max(initial=0.0)), float(self.of_blocks.max(initial=0.0)))
        return max(threshold, RANK_TOLERANCE * largest)


def singular_directions(rows: Array) -> Directions:
    """Return the directions of a whitened, scaled Jacobian or its triangle (q, p)."""
    p = rows.shape[1]
    _, values, Vt = svd(rows, full_matrices=len(rows) < p)
    return Directions(Vt.T, np.concatenate([values, np.zeros(p - len(values))]))


def directions_of(rows: Reduced) -> Directions:
    """Return the directions of rows from which targets are eliminated: those of common parameters, and of each target.

    A direction of common parameters counts with the targets where they follow best: how well it is known does not
    depend on how many targets move with it.
    """
    found = singular_directions(rows.rest[:, :-1])
    alone = rows.singular_values[np.isfinite(rows.singular_values)]
    return Directions(found.vectors, found.of_common, alone)


def inner_constraints(null_basis: Array, parameters: Sequence[Parameter]) -> Array:
    """Return rows G (k, p) such that ``G z = 0`` picks, among all equal fits, the one nearest to the nominal machine.

    Among the fits that the data cannot tell apart (z moves along ``null_basis`` (p, k)), the chosen one has the least
    sum of squares over the robot's parameters; base and tool carry no weight, except where a direction of the null
    space moves only them: there they stay nearest to their start. These are the inner constraints of a free network
    adjustment (P. Meissl, 1962). As the data do not determine these directions, the rows add nothing to the residuals'
    cost.
    """
    of_robot = np.array([parameter.of_robot for parameter in parameters], dtype=bool)
    U, values, Wt = svd(null_basis * of_robot[:, None])
    # One that hardly moves the robot would hold there what the data determine, and stay open itself.
    seen = values > MOVED
    first = U[:, : len(values)][:, seen].T * of_robot
    # Directions that leave the robot alone.
    rest = (null_basis @ Wt[~seen].T).T
    return np.concatenate([first, rest])


def unidentifiable(null_basis: Array) -> BoolArray:
    """Return which parameters (p,) some direction of the null space moves: no single value of theirs is known."""
    return np.asarray(np.linalg.norm(null_basis, axis=1) > MOVED)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """What ``rows`` determine and what they do not, found when asked for: of targets by themselves, and of others.

    ``of_targets``: as in :func:`undetermined`. The others count with targets where they follow best, whichever of them
    ``rows`` have eliminated.
    """

    __repr__ = brief

    rows: Arrow
    of_targets: Split

    @cached_property
    def values(self) -> Array:
        """The singular values (p,), the largest first."""
        if np.array_equal(self.rows.split.common, self.of_targets.common):
            return read_only(directions_of(self.rows.reduced(RANK_TOLERANCE)).singular_values)
        alone = [
            np.linalg.svd(triangle(self.rows.columns(own[own >= 0])), compute_uv=False)
            for own in self.of_targets.blocks
        ]
        largest = max((float(own.max(initial=0.0)) for own in alone), default=0.0)
        others = np.linalg.svd(self._without_targets(RANK_TOLERANCE * largest), compute_uv=False)
        found = np.sort(np.concatenate([*alone, others]))[::-1]
        return read_only(np.append(found, np.zeros(self.rows.split.size - len(found))))

    @cached_property
    def undetermined(self) -> tuple[Array, BoolArray]:
        """What :func:`undetermined` finds: a basis (p, k), and what (p,) targets' own rows leave open."""
        return undetermined(self.rows, self.of_targets)

    def _without_targets(self, least: float) -> Array:
        """Return rows (q, c) about all that is no target's, with what is seen of targets at ``least`` eliminated."""
        rows, a = self.rows, self.rows.a
        split, is_target = rows.split, self.of_targets.block_of >= 0
        left = split.blocks[split.real & ~is_target[split.blocks]]
        # Targets that are common come first, so that they can be turned out of all rows at once.
        kept = np.concatenate([split.common[is_target[split.common]], split.common[~is_target[split.common]], left])
        place = np.full(split.size, -1, dtype=np.intp)
        place[kept] = np.arange(len(kept))
        found = [np.zeros((len(rows.rest), len(kept)))]
        found[0][:, place[split.common]] = rows.rest[:, :-1]
        for own, real, heads in zip(split.blocks, split.real, rows.heads, strict=True):
            order = np.flatnonzero(real)[np.argsort(~is_target[own[real]], kind="stable")]
            targets = int(np.count_nonzero(is_target[own[real]]))
            turned = _beyond(heads[:, [*order, *range(a, heads.shape[1] - 1)]], targets, least)
            more = np.zeros((len(turned), len(kept)))
            more[:, place[np.concatenate([own[order[targets:]], split.common])]] = turned
            found.append(more)
        whole = triangle(np.concatenate(found))
        targets = int(np.count_nonzero(is_target[split.common]))
        return _beyond(whole, targets, least)


def _beyond(rows: Array, first: int, least: float) -> Array:
    """Return what rows (q, n) say of all but the first columns, wherever these are."""
    U, s, _ = svd(rows[:, :first], full_matrices=True)
    return np.asarray(U[:, np.count_nonzero(s > least) :].T @ rows[:, first:])


def undetermined(rows: Arrow, of_targets: Split) -> tuple[Array, BoolArray]:
    """Return a basis (p, k) of what rows do not determine well enough, and what (p,) targets' own rows leave open.

    ``of_targets``: of the unknowns of every target by itself, the others being common. Directions are of length one in
    the scales of these others, with targets where they follow best: so which parameters they move depends neither on
    how many targets move with them, nor on which unknowns ``rows`` have eliminated beside targets. A target of which a
    direction is open is so in all of its unknowns: an anchor of two lengths is anywhere on a circle, which leads out of
    every plane that it touches.
    """
    reduced = rows.reduced(RANK_TOLERANCE)
    found = directions_of(reduced)
    if np.array_equal(rows.split.common, of_targets.common):
        common = found.null_basis(found.common_rank(NUMERICAL_TOLERANCE))
        weak = np.any(reduced.singular_values <= NUMERICAL_TOLERANCE, axis=1)
        return rows.split.whole(common, reduced.follow @ common), np.append(weak, False)[rows.split.block_of]
    alone = np.zeros(rows.split.size, dtype=np.bool_)
    for own in of_targets.blocks:
        of_target = own[own >= 0]
        s = np.linalg.svd(triangle(rows.columns(of_target)), compute_uv=False)
        alone[of_target] = np.count_nonzero(s > NUMERICAL_TOLERANCE) < len(of_target)
    return _undetermined(rows, reduced, found, of_targets.common), alone


def _undetermined(rows: Arrow, reduced: Reduced, found: Directions, counted: IntArray) -> Array:
    """Return a basis (p, k) of what rows do not determine, of length one in the ``counted`` unknowns.

    Of weak directions of common unknowns, and of blocks by themselves, inverse iteration makes those of all unknowns
    (K.-J. Bathe, E. L. Wilson, *Solution methods for eigenvalue problems in structural mechanics*, 1973).
    """
    least = found.least(NUMERICAL_TOLERANCE)
    split, p = rows.split, rows.split.size
    common = found.vectors[:, found.of_common <= _AROUND * least]
    block, column = np.nonzero(reduced.singular_values <= _AROUND * least)
    own = np.zeros((*split.blocks.shape, len(block)))
    own[block, :, np.arange(len(block))] = reduced.vectors[block, :, column]
    none = np.zeros((len(split.common), len(block)))
    V = np.hstack([split.whole(common, reduced.follow @ common), split.whole(none, own)])
    if not V.shape[1]:
        return V
    counts = np.zeros(p)
    counts[counted] = 1.0
    # As a prior, so weak that it changes no direction, it leaves nothing open but what does not count.
    held = Inverse.of(rows.held(_SHIFT * least * counts, np.zeros(p))).covariance
    for _ in range(_ITERATIONS):
        V = held.times(counts[:, None] * _of_length_one(V, counts))
    V = _of_length_one(V, counts)
    _, s, Wt = svd(triangle(rows.moved(V)), full_matrices=True)
    s = np.append(s, np.zeros(len(Wt) - len(s)))
    return np.asarray(V @ Wt[s <= least].T)


def _of_length_one(V: Array, counts: Array) -> Array:
    """Return directions (p, k) of the same space, orthonormal in what counts, without those that move none of it."""
    _, s, Wt = svd(triangle(counts[:, None] * V / np.linalg.norm(V, axis=0)), full_matrices=False)
    kept = s > _SHORT * s.max(initial=0.0)
    return np.asarray((V / np.linalg.norm(V, axis=0)) @ (Wt[kept].T / s[kept]))


def preference(parameters: Sequence[Parameter]) -> tuple[int, ...]:
    """Return the order in which a minimal set prefers parameters.

    Targets and scalars, which nobody knows beforehand, then base, tool, offsets, placements from the base on, terms.
    """
    rank = {"target": 0, "instrument": 0, "base": 1, "tool": 2, "offset": 3, "placement": 4, "term": 5}
    return tuple(sorted(range(len(parameters)), key=lambda k: (rank[parameters[k].kind], k)))


def minimal_set(rows: Array, rank: int, order: Sequence[int]) -> tuple[int, ...]:
    """Return the indices of ``rank`` parameters that together determine all that the data determine.

    In ascending order, and chosen greedily in the given order of preference: a parameter is taken when its column (of
    ``rows`` (q, p), of which the best ``rank`` directions alone count: what else moves a parameter does not tell it)
    lies clearly outside the span of those taken before. Unlike pivoting by size, whose ties follow
    rounding, the choice depends on the order alone. Columns that are nearly in that span, or small beside the last
    direction that counts as determined, are considered only when rank is still missing.
    """
    if rank == 0:
        return ()
    found = singular_directions(rows)
    least = found.of_common[rank - 1]
    rows = found.of_common[:rank, None] * found.vectors[:, :rank].T
    basis = np.zeros((rows.shape[0], 0))
    taken: list[int] = []
    for share in (3e-2, 1e-3, 1e-5, 1e-7, RANK_TOLERANCE):
        for k in order:
            if len(taken) == rank:
                return tuple(sorted(taken))
            if k in taken:
                continue
            column = rows[:, k]
            for _ in range(2):  # twice is enough for orthogonality to rounding
                column = column - basis @ (basis.T @ column)
            remainder = np.linalg.norm(column)
            if remainder > share * max(np.linalg.norm(rows[:, k]), _SMALL * least):
                basis = np.column_stack([basis, column / remainder])
                taken.append(k)
    return tuple(sorted(taken))


@dataclass(frozen=True, slots=True)
class NullDirection:
    """A direction of the null space, in parameters: ``shares`` in SI units, the largest first after ``parameter``.

    ``parameter`` is one that a minimal set does without; it moves by one parameter scale and the others imitate it.
    """

    parameter: str
    shares: dict[str, float]
    units: dict[str, str]

    def __str__(self) -> str:
        """Say the direction in mm and mrad."""
        own, *others = (f"{_figure(v, self.units[name])} of {name}" for name, v in self.shares.items())
        more = f" and {len(others) - _MOST_NAMED} more" if len(others) > _MOST_NAMED else ""
        return f"{own} cannot be told from {', '.join(others[:_MOST_NAMED]) + more if others else 'no change at all'}."


def told(
    rows: Arrow, common_rank: int, parameters: Sequence[Parameter]
) -> tuple[tuple[int, ...], tuple[NullDirection, ...]]:
    """Return a minimal set of parameters, and the directions of the null space that the others are in.

    ``rows``: scaled, at a point where shares are simple, such as the nominal robot; of the common parameters they
    determine ``common_rank`` combinations. What a target's own rows do not show of it is a direction of its own.
    """
    split, reduced = rows.split, rows.reduced(RANK_TOLERANCE)
    J = reduced.rest[:, :-1]
    kept = minimal_set(J, common_rank, preference([parameters[k] for k in split.common]))
    basis = singular_directions(J).null_basis(common_rank)
    dropped = np.setdiff1d(np.arange(len(split.common)), np.array(kept, dtype=np.intp))
    directions = np.asarray(np.linalg.solve(basis[dropped].T, basis.T).T, dtype=np.float64)
    whole = split.whole(directions, reduced.follow @ directions)
    said = [_direction(whole[:, i], int(split.common[own]), parameters) for i, own in enumerate(dropped)]
    of_blocks, more = _told_of_blocks(rows, reduced, parameters)
    return tuple(sorted([*split.common[list(kept)].tolist(), *of_blocks])), (*said, *more)


def _told_of_blocks(
    rows: Arrow, reduced: Reduced, parameters: Sequence[Parameter]
) -> tuple[list[int], list[NullDirection]]:
    """Return the parameters of blocks in a minimal set, and directions of what their own rows leave open."""
    real = np.isfinite(reduced.singular_values)
    least = max(NUMERICAL_TOLERANCE, RANK_TOLERANCE * float(reduced.singular_values[real].max(initial=0.0)))
    weak = real & (reduced.singular_values <= least)
    kept = rows.split.blocks[~weak.any(axis=1)]
    said: list[NullDirection] = []
    numbers = kept[kept >= 0].tolist()
    for i in np.flatnonzero(weak.any(axis=1)):
        own = rows.split.blocks[i][rows.split.real[i]]
        J = rows.heads[i][:, : len(own)]
        rank = int(np.count_nonzero(~weak[i][: len(own)]))
        seen = minimal_set(J, rank, range(len(own)))
        numbers += own[list(seen)].tolist()
        basis = singular_directions(J).null_basis(rank)
        said += null_directions(basis, [parameters[n] for n in own], seen)
    return numbers, said


def null_directions(
    null_basis: Array, parameters: Sequence[Parameter], kept: Sequence[int]
) -> tuple[NullDirection, ...]:
    """Return the null space (p, k), scaled, as directions that a person can read; ``kept`` is a minimal set."""
    dropped = np.setdiff1d(np.arange(len(null_basis)), np.array(kept, dtype=np.intp))
    basis = np.linalg.solve(null_basis[dropped].T, null_basis.T)
    return tuple(_direction(direction, int(own), parameters) for own, direction in zip(dropped, basis, strict=True))


def _direction(direction: Array, own: int, parameters: Sequence[Parameter]) -> NullDirection:
    """Return a direction (p,), scaled, as one that a person can read: what parameter ``own`` does, others imitate."""
    # Beside a wide prior's standard deviation a millimetre is small, and all the same it is what imitates.
    sizes = np.abs(direction) * np.array([[1.0] * len(parameters), [p.scale / p.typical_size for p in parameters]])
    told = np.any(sizes > _TOLD_SHARE * np.max(sizes, axis=1, keepdims=True), axis=0)
    told[own] = True
    order = sorted(map(int, np.flatnonzero(told)), key=lambda k: (k != own, -abs(direction[k]), k))
    # The imitation carries the opposite sign: moving the one is undone by moving the others.
    shares = {parameters[k].name: float(direction[k] * parameters[k].scale) * (1 if k == own else -1) for k in order}
    return NullDirection(parameters[own].name, shares, {parameters[k].name: parameters[k].unit for k in order})


def _figure(value: float, unit: str) -> str:
    milli = {"m": MM, "rad": MRAD}
    return f"{value / milli[unit]:+.3g} m{unit}" if unit in milli else f"{value:+.3g} {unit}".removesuffix(" 1")
