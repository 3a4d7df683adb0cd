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
from dataclasses import dataclass

import numpy as np

from calib.foundations.arrays import Array, BoolArray
from calib.foundations.units import MM, MRAD
from calib.identification.parameters import Parameter

RANK_TOLERANCE = 1e-9
NUMERICAL_TOLERANCE = 0.1
# A parameter is not identifiable when a unit direction of the null space moves it by more than this. Shares of
# identifiable parameters stay below 0.02 (second-order effects of deviations up to 10 mm), those of others above 0.1.
_MOVED = 0.02
# A column is small below so many times the last singular value that counts, times the share that is asked of it.
_SMALL = 10.0
# Smaller shares of a direction of the null space are not told.
_TOLD_SHARE = 1e-2
_MOST_NAMED = 4


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Directions in scaled space, best known first: columns of ``vectors`` (p, p), with ``singular_values`` (p,)."""

    vectors: Array
    singular_values: Array

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

    def _above(self, threshold: float) -> int:
        values = self.singular_values
        return int(np.count_nonzero(values > max(threshold, RANK_TOLERANCE * values[0]))) if values.size else 0


def singular_directions(triangle: Array) -> Directions:
    """Return the directions of a whitened, scaled Jacobian or its triangle (q, p)."""
    p = triangle.shape[1]
    _, values, Vt = np.linalg.svd(triangle, full_matrices=len(triangle) < p)
    return Directions(Vt.T, np.concatenate([values, np.zeros(p - len(values))]))


def inner_constraints(null_basis: Array, parameters: Sequence[Parameter]) -> Array:
    """Return rows G (k, p) such that ``G z = 0`` picks, among all equal fits, the one nearest to the nominal machine.

    Among the fits that the data cannot tell apart (z moves along ``null_basis`` (p, k)), the chosen one has the least
    sum of squares over the robot's parameters; base and tool carry no weight, except where a direction of the null
    space moves only them: there they stay nearest to their start. These are the inner constraints of a free network
    adjustment (P. Meissl, 1962). As the data do not determine these directions, the rows add nothing to the residuals'
    cost.
    """
    of_robot = np.array([parameter.of_robot for parameter in parameters], dtype=bool)
    U, values, Wt = np.linalg.svd(null_basis * of_robot[:, None])
    seen = values > 1e-9
    first = U[:, : len(values)][:, seen].T * of_robot
    # Directions that leave the robot alone.
    rest = (null_basis @ Wt[~seen].T).T
    return np.concatenate([first, rest])


def unidentifiable(null_basis: Array) -> BoolArray:
    """Return which parameters (p,) some direction of the null space moves: no single value of theirs is known."""
    return np.asarray(np.linalg.norm(null_basis, axis=1) > _MOVED)


def preference(parameters: Sequence[Parameter]) -> tuple[int, ...]:
    """Return the order in which a minimal set prefers parameters.

    Targets and scalars, which nobody knows beforehand, then base, tool, offsets, placements from the base on, terms.
    """
    rank = {"target": 0, "instrument": 0, "base": 1, "tool": 2, "offset": 3, "placement": 4, "term": 5}
    return tuple(sorted(range(len(parameters)), key=lambda k: (rank[parameters[k].kind], k)))


def minimal_set(triangle: Array, rank: int, order: Sequence[int]) -> tuple[int, ...]:
    """Return the indices of ``rank`` parameters that together determine all that the data determine.

    In ascending order, and chosen greedily in the given order of preference: a parameter is taken when its column (of
    ``triangle`` (q, p)) lies clearly outside the span of those taken before. Unlike pivoting by size, whose ties follow
    rounding, the choice depends on the order alone. Columns that are nearly in that span, or small beside the last
    direction that counts as determined, are considered only when rank is still missing.
    """
    if rank == 0:
        return ()
    least = singular_directions(triangle).singular_values[rank - 1]
    basis = np.zeros((triangle.shape[0], 0))
    taken: list[int] = []
    for share in (3e-2, 1e-3, 1e-5, 1e-7, RANK_TOLERANCE):
        for k in order:
            if len(taken) == rank:
                return tuple(sorted(taken))
            if k in taken:
                continue
            column = triangle[:, k]
            for _ in range(2):  # twice is enough for orthogonality to rounding
                column = column - basis @ (basis.T @ column)
            remainder = np.linalg.norm(column)
            if remainder > share * max(np.linalg.norm(triangle[:, k]), _SMALL * least):
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


def told(rows: Array, rank: int, parameters: Sequence[Parameter]) -> tuple[tuple[int, ...], tuple[NullDirection, ...]]:
    """Return a minimal set of ``rank`` parameters, and the directions of the null space that the others are in.

    ``rows`` (q, p): scaled Jacobian or its triangle, at a point where shares are simple, such as the nominal robot.
    """
    kept = minimal_set(rows, rank, preference(parameters))
    return kept, null_directions(singular_directions(rows).null_basis(rank), parameters, kept)


def null_directions(
    null_basis: Array, parameters: Sequence[Parameter], kept: Sequence[int]
) -> tuple[NullDirection, ...]:
    """Return the null space (p, k), scaled, as directions that a person can read; ``kept`` is a minimal set."""
    dropped = [k for k in range(len(null_basis)) if k not in kept]
    basis = np.linalg.solve(null_basis[dropped].T, null_basis.T)
    said = []
    for own, direction in zip(dropped, basis, strict=True):
        told = np.abs(direction) > _TOLD_SHARE * np.max(np.abs(direction))
        order = sorted(map(int, np.flatnonzero(told)), key=lambda k: (k != own, -abs(direction[k]), k))
        # The imitation carries the opposite sign: moving the one is undone by moving the others.
        shares = {
            parameters[k].name: float(direction[k] * parameters[k].scale) * (1 if k == own else -1) for k in order
        }
        said.append(
            NullDirection(parameters[own].name, shares, {parameters[k].name: parameters[k].unit for k in order})
        )
    return tuple(said)


def _figure(value: float, unit: str) -> str:
    milli = {"m": MM, "rad": MRAD}
    return f"{value / milli[unit]:+.3g} m{unit}" if unit in milli else f"{value:+.3g} {unit}".removesuffix(" 1")
