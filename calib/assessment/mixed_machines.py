"""Are all rows of one machine? A payload that is there or not, backlash, or another robot's rows make them of several.

Each row is taken to be of one of K machines that differ by a common change: ``r = J e + s D a + noise``, where s has
one of K values in every row and D is what joints and parameters do. Values and change are found in turns, each the best
for the other (H. Spaeth, *Algorithm 39: clusterwise linear regression*, Computing 22, 1979), from several starts. A
value for every row and a change always explain something: where there is but one machine, no more than the degrees of
freedom they take. An effect that varies steadily, as of one gear that wobbles, is cut into K parts, which leaves K
times less; only rows of K machines leave far less than that. Of photographs whose rows err together, each is one row.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.assessment.effects import per_metre, score_test
from calib.assessment.stretches import Stretch, by_photograph
from calib.foundations.arrays import Array
from calib.foundations.linear import svd

# Of more rows so many are looked at, spread evenly.
_MOST_ROWS = 300
_MOST_MACHINES = 4
_STARTS, _TRIED, _MOST_TURNS = 8, 2, 15
# Turns end where one leaves no less than this share of what the one before it left.
_ENOUGH = 1.0 - 1e-6
# Directions below this share of the largest are none.
_DIRECTION = 1e-3
_SEEN = 1e-6
# The share of all numbers that are left beside parameters, change and values; else fewer directions are tried, though
# not fewer than these.
_LEFT, _FEWEST = 1.0 / 3.0, 6


class MixedMachines(NamedTuple):
    """What is found when rows are told apart into ``machines``: so many ``times`` less is left.

    ``apart``: rms distance in m of the rows from their mean machine, times two; of two machines with as many rows, that
    between them. ``share``: of rows that are not of the machine with most. 1, 1, 0 and 0 where rows are too few to be
    told apart.
    """

    machines: int
    times: float
    apart: float
    share: float


ONE_MACHINE = MixedMachines(1, 1.0, 0.0, 0.0)


def mixed_machines(parts: Sequence[Stretch]) -> tuple[MixedMachines, ...]:
    """Return what becomes of the residuals of all parts where rows are taken to be of two machines, or more."""
    own = [by_photograph(part) for part in parts]
    usable = [part for part in own if part.data.other is None and part.r.shape[1] == own[0].r.shape[1]]
    if not usable:
        return (ONE_MACHINE,)
    every = np.concatenate([part.r for part in usable])
    rows = np.unique(np.linspace(0, len(every) - 1, _MOST_ROWS).astype(np.intp))
    (n, d), r = (len(rows), every.shape[1]), every[rows].ravel()
    J = np.concatenate([part.J for part in usable])[rows].reshape(n * d, -1)
    moved = np.concatenate([part.by_joint for part in usable])[rows].reshape(n * d, -1)
    U, s, _ = svd(J, full_matrices=False)
    Q = U[:, s > _SEEN * s.max(initial=0.0)]
    r = r - Q @ (Q.T @ r)
    most = int(n * d * (1.0 - _LEFT)) - n - Q.shape[1]
    least = max(part.least for part in usable)
    before = float(r @ r) / max(n * d - Q.shape[1], 1)
    if most < _FEWEST or before <= least:
        return (ONE_MACHINE,)
    D = _directions(np.hstack([moved, J]))[:, :most]
    search = _Search(r, D, Q, n)
    # Begun with a value for every row, whatever it is, and those that leave least.
    begun = [search.ended(np.sum((D[:, j] * r).reshape(n, d), axis=1), n) for j in range(min(_STARTS, D.shape[1]))]
    begun = sorted(begun, key=lambda one: one.left)[:_TRIED]
    metre = per_metre(usable)

    def told(machines: int) -> MixedMachines:
        best = min((search.ended(one.values, machines) for one in begun), key=lambda one: one.left)
        after = max(best.left / (n * d - Q.shape[1] - D.shape[1] - n), least)
        values = best.values - best.values.mean()
        far = np.sqrt(np.mean(np.sum((values[:, None] * best.change.reshape(n, d)) ** 2, axis=1)))
        largest = np.unique(best.values, return_counts=True)[1].max()
        return MixedMachines(
            machines, float(np.sqrt(before / after)), 2.0 * float(far) / metre, 1.0 - float(largest) / n
        )

    return tuple(told(machines) for machines in range(2, _MOST_MACHINES + 1))


def _directions(D: Array) -> Array:
    """Return orthogonal directions (q, k) that span those of D, all taken as equally large, the most common first."""
    U, s, _ = svd(D / np.maximum(np.linalg.norm(D, axis=0), np.finfo(float).tiny), full_matrices=False)
    return np.asarray((U * s)[:, s > _DIRECTION * s.max(initial=0.0)])


class _ToldApart(NamedTuple):
    """Rows with ``values`` (n,), the ``change`` (q,) for a value of 1, the ``rest`` (q,) and its square ``left``."""

    values: Array
    change: Array
    rest: Array
    left: float


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """Residuals r (q,) of n rows, clear of the parameters' Q (q, p), and directions D (q, k) of a change."""

    r: Array
    D: Array
    Q: Array
    n: int

    def ended(self, values: Array, machines: int) -> _ToldApart:
        """Return rows told apart into so many machines, at most n, beginning with values (n,)."""
        found = self._changed(_parted(values, np.ones(self.n), machines))
        for _ in range(_MOST_TURNS):
            change = found.change.reshape(self.n, -1)
            weights = np.sum(change**2, axis=1)
            weights = np.maximum(weights, _SEEN * max(float(weights.max()), np.finfo(float).tiny))
            # What is left but for the change, of which every row takes as much as leaves least.
            without = found.rest.reshape(self.n, -1) - found.values[:, None] * change
            better = _parted(-np.sum(without * change, axis=1) / weights, weights, machines)
            turned = self._changed(better)
            if not turned.left < _ENOUGH * found.left:
                break
            found = turned
        return found

    def _changed(self, values: Array) -> _ToldApart:
        """Return the best change for values (n,)."""
        by_number = np.repeat(values, len(self.r) // self.n)
        weighed = self.D * by_number[:, None]
        S = weighed.T @ self.Q
        sizes = score_test(weighed.T @ weighed, S, weighed.T @ self.r, np.eye(self.Q.shape[1])).sizes
        change = self.D @ sizes
        moved = by_number * change
        rest = self.r + moved - self.Q @ (self.Q.T @ moved)
        return _ToldApart(values, change, rest, float(np.sum(rest**2)))


def _parted(x: Array, weights: Array, parts: int) -> Array:
    """Return x (n,) with every value replaced by the mean of its part: of so many, those with the least squares.

    In order of their values the parts are stretches (W. D. Fisher, *On grouping for maximum homogeneity*, 1958).
    """
    n = len(x)
    if parts >= n:
        return x
    order = np.argsort(x, kind="stable")
    w, v = weights[order], x[order] - np.average(x, weights=weights)
    W, S, T = (np.concatenate([[0.0], np.cumsum(of)]) for of in (w, w * v, w * v * v))
    # Of values from the i-th to before the j-th.
    none = np.tri(n + 1, dtype=np.bool_)
    among = np.where(none, 1.0, W[None] - W[:, None])
    cost = np.where(none, np.inf, T[None] - T[:, None] - (S[None] - S[:, None]) ** 2 / among)
    least, begins = cost[0], []
    for _ in range(parts - 1):
        total = least[:, None] + cost
        begins.append(np.argmin(total, axis=0))
        least = np.min(total, axis=0)
    out, end = np.empty(n), n
    for begin in [*(b for b in reversed(begins)), None]:
        start = 0 if begin is None else int(begin[end])
        out[order[start:end]] = np.average(x[order[start:end]], weights=w[start:end])
        end = start
    return out
