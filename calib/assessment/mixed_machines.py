"""Are all rows of one machine? A payload that is there or not, backlash, or another robot's rows make them of several.

Each row is taken to be of one of K machines that differ by a common change: ``r = J e + s D a + noise``, where s has
one of K values in every row and D is what joints and parameters do. Values and change are found in turns, each the best
for the other (H. Spaeth, *Algorithm 39: clusterwise linear regression*, Computing 22, 1979), from several starts. A
value for every row and a change always explain something: where there is but one machine, no more than the degrees of
freedom they take. An effect that varies steadily, as of one gear that wobbles, is cut into K parts, which leaves K
times less; only rows of K machines leave far less than that. Of photographs whose rows err together, each is one row.

Rows of one pose that err together are looked at twice. Their means are of different machines where poses are; by what
they differ from these, rows of one pose are, of which nothing that a model leaves out makes several.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.assessment.effects import per_metre
from calib.assessment.scores import score_test
from calib.assessment.stretches import Stretch, as_means, by_photograph
from calib.foundations.arrays import Array
from calib.foundations.linear import svd
from calib.measurement.kinds import QUANTITIES

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
# How often it is drawn what chance leaves of few poses.
_DRAWS = 10


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
    again = [part for part in usable if part.repeats]
    found = list(_told(_among_rows([_as_poses(part) if part.repeats else part for part in usable]))) if usable else []
    if again:
        found += _told(_within_poses(again))
    return tuple(found) or (ONE_MACHINE,)


def _told(search: "_Search") -> Iterator[MixedMachines]:
    """Yield what becomes of the rows for every number of machines, nothing where they are too few."""
    n, left = search.n, search.numbers - search.used
    most = int(search.numbers * (1.0 - _LEFT)) - search.values - search.used
    before = float(search.r @ search.r) / max(left, 1)
    if before <= search.least:
        return
    if most < _FEWEST:
        if search.poses:
            yield from _of_few_poses(search)
        return
    search = replace(search, D=search.D[:, :most])
    for machines, best in search.apart().items():
        after = max(best.left / (left - search.D.shape[1] - search.values), search.least)
        yield best.told(n, machines, float(np.sqrt(before / after)), search.metre)


def _of_few_poses(search: "_Search") -> Iterator[MixedMachines]:
    """Yield what becomes of poses that are too few for a value of each: as many times less as chance does not leave.

    What values and change take of noise is not counted, but drawn: the search is made of noise in the place of the
    residuals as well, by few directions.
    """
    most = min(_FEWEST, (search.numbers - search.used) // 3)
    if most < 1:
        return
    search, rng = replace(search, D=search.D[:, :most]), np.random.default_rng(0)
    found = search.apart()
    chance = dict.fromkeys(found, 0.0)
    for _ in range(_DRAWS):
        noise = rng.standard_normal(len(search.r))
        drawn = replace(search, r=noise - search.Q @ (search.Q.T @ noise))
        for machines, best in drawn.apart().items():
            chance[machines] += drawn.times(best) / _DRAWS
    for machines, best in found.items():
        yield best.told(search.n, machines, search.times(best) / chance[machines], search.metre)


def _among_rows(parts: Sequence[Stretch]) -> "_Search":
    """Return the search among rows, of very many some, clear of what parameters take up."""
    every = np.concatenate([part.r for part in parts])
    rows = np.unique(np.linspace(0, len(every) - 1, _MOST_ROWS).astype(np.intp))
    (n, d), r = (len(rows), every.shape[1]), every[rows].ravel()
    J = np.concatenate([part.J for part in parts])[rows].reshape(n * d, -1)
    moved = np.concatenate([part.by_joint for part in parts])[rows].reshape(n * d, -1)
    U, s, _ = svd(J, full_matrices=False)
    Q = U[:, s > _SEEN * s.max(initial=0.0)]
    D, used = _directions(np.hstack([moved, J])), Q.shape[1]
    poses = any(part.repeats for part in parts)
    return _Search(r - Q @ (Q.T @ r), D, Q, n, n * d, used, n, per_metre(parts), _least(parts), poses)


def _as_poses(part: Stretch) -> Stretch:
    """Return the means of poses in place of rows, all of one noise, however often a pose was measured."""
    own, many = as_means(part, part.pose), np.bincount(part.pose)
    share = np.ones((len(many), part.r.shape[1], 1))
    for told, quantity in itertools.product(part.repeats, QUANTITIES[part.data.kind]):
        if told.quantity == quantity.name:
            share[:, quantity.columns, 0] = 1.0 / np.hypot(1.0, np.sqrt(many) * told.common / told.alone)[:, None]
    moved = {name: getattr(own, name) * share for name in ("J", "by_joint", "by_base", "by_tool")}
    return replace(own, r=own.r * share[:, :, 0], **moved)


def _within_poses(parts: Sequence[Stretch]) -> "_Search":
    """Return the search among rows of repeated poses, of very many some poses, clear of what each has in common."""
    first = np.cumsum([0, *(int(part.pose.max()) + 1 for part in parts)])
    pose = np.concatenate([part.pose + start for part, start in zip(parts, first, strict=False)])
    many = np.bincount(pose)
    again = np.flatnonzero(many > 1)
    most = min(len(again), max(1, int(len(again) * _MOST_ROWS / many[again].sum())))
    rows = np.flatnonzero(np.isin(pose, again[np.linspace(0, len(again) - 1, most).astype(np.intp)]))
    number = np.unique(pose[rows], return_inverse=True)[1].reshape(-1)
    r = np.concatenate([part.r for part in parts])[rows]
    n, d = r.shape
    D = np.concatenate([np.concatenate([part.by_joint, part.J], axis=2) for part in parts])[rows].reshape(n * d, -1)
    Q = np.asarray(np.kron(np.eye(most)[number] / np.sqrt(np.bincount(number)), np.eye(d)), dtype=np.float64)
    clear = r.ravel() - Q @ (Q.T @ r.ravel())
    return _Search(clear, _directions(D), Q, n, (n - most) * d, 0, n - most, per_metre(parts), _least(parts))


def _least(parts: Sequence[Stretch]) -> float:
    return max(part.least for part in parts)


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

    def told(self, n: int, machines: int, times: float, metre: float) -> MixedMachines:
        """Return what is found of n rows, told apart into ``machines`` that leave so many ``times`` less."""
        values = self.values - self.values.mean()
        far = np.sqrt(np.mean(np.sum((values[:, None] * self.change.reshape(n, -1)) ** 2, axis=1)))
        largest = np.unique(self.values, return_counts=True)[1].max()
        return MixedMachines(machines, times, 2.0 * float(far) / metre, 1.0 - float(largest) / n)


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """Residuals r (q,) of n rows, clear of Q (q, p), and directions D (q, k) of a change.

    Q: of the parameters, which take up ``used`` of the ``numbers`` that there are beside what poses have in common, or
    of just that. ``values``: in how many values rows may differ. ``metre`` and ``least`` as of :class:`Stretch`.
    ``poses``: whether rows are means of poses.
    """

    r: Array
    D: Array
    Q: Array
    n: int
    numbers: int
    used: int
    values: int
    metre: float
    least: float
    poses: bool = False

    def apart(self) -> dict[int, _ToldApart]:
        """Return rows told apart into two machines, and into more, by their number."""
        # Begun with a value for every row, whatever it is, and those that leave least.
        starts = range(min(_STARTS, self.D.shape[1]))
        begun = [self.ended(np.sum((self.D[:, j] * self.r).reshape(self.n, -1), axis=1), self.n) for j in starts]
        begun = sorted(begun, key=lambda one: one.left)[:_TRIED]
        return {
            machines: min((self.ended(one.values, machines) for one in begun), key=lambda one: one.left)
            for machines in range(2, _MOST_MACHINES + 1)
        }

    def times(self, found: _ToldApart) -> float:
        """Return how many times less is left, whatever numbers values and change take."""
        return float(np.sqrt(self.r @ self.r / max(found.left, len(self.r) * self.least)))

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
