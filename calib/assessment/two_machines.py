"""Are all rows of one machine? A payload that is there or not, backlash, or another robot's rows make them of two.

Each row is taken to be of one of two machines that differ by a common change: ``r = J e + s D a + noise``, s = +1 or -1
for a row, D what joints and parameters do. Signs and change are found in turns, each the best for the other (H. Spaeth,
*Algorithm 39: clusterwise linear regression*, Computing 22, 1979), from several starts. A sign for every row and a
change always explain something; where there is but one machine, no more than the degrees of freedom they take.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.assessment.effects import Stretch, per_metre, score_test
from calib.foundations.arrays import Array

# Of more rows so many are looked at, spread evenly.
_MOST_ROWS = 300
_STARTS, _MOST_TURNS = 8, 15
# Directions below this share of the largest are none.
_DIRECTION = 1e-3
_SEEN = 1e-6
# The share of all numbers that are left beside parameters, change and signs; else fewer directions are tried, though
# not fewer than these.
_LEFT, _FEWEST = 1.0 / 3.0, 6


class TwoMachines(NamedTuple):
    """What is found when rows are told apart: they leave so many ``times`` less, and are ``apart`` by so much, in m.

    ``share``: of rows that are of the machine with fewer. 1, 0 and 0 where they are too few to be told apart.
    """

    times: float
    apart: float
    share: float


ONE_MACHINE = TwoMachines(1.0, 0.0, 0.0)


def two_machines(parts: Sequence[Stretch]) -> TwoMachines:
    """Return what becomes of the residuals of all parts where rows are taken to be of two machines."""
    usable = [part for part in parts if part.data.other is None and part.r.shape[1] == parts[0].r.shape[1]]
    if not usable:
        return ONE_MACHINE
    every = np.concatenate([part.r for part in usable])
    rows = np.unique(np.linspace(0, len(every) - 1, _MOST_ROWS).astype(np.intp))
    (n, d), r = (len(rows), every.shape[1]), every[rows].ravel()
    J = np.concatenate([part.J for part in usable])[rows].reshape(n * d, -1)
    moved = np.concatenate([part.by_joint for part in usable])[rows].reshape(n * d, -1)
    U, s, _ = np.linalg.svd(J, full_matrices=False)
    Q = U[:, s > _SEEN * s.max(initial=0.0)]
    r = r - Q @ (Q.T @ r)
    most = int(n * d * (1.0 - _LEFT)) - n - Q.shape[1]
    least = max(part.least for part in usable)
    before = float(r @ r) / max(n * d - Q.shape[1], 1)
    if most < _FEWEST or before <= least:
        return ONE_MACHINE
    D = _directions(np.hstack([moved, J]))[:, :most]
    by_start = [
        _told_apart(np.sum((D[:, j] * r).reshape(n, d), axis=1), r, D, Q) for j in range(min(_STARTS, D.shape[1]))
    ]
    best = min(by_start, key=lambda one: float(one.rest @ one.rest))
    after = max(float(best.rest @ best.rest) / (n * d - Q.shape[1] - D.shape[1] - n), least)
    share = float(np.mean(best.signs > 0.0))
    return TwoMachines(
        float(np.sqrt(before / after)),
        2.0 * float(np.sqrt(np.sum(best.change**2) / n)) / per_metre(usable),
        min(share, 1.0 - share),
    )


def _directions(D: Array) -> Array:
    """Return orthogonal directions (q, k) that span those of D, all taken as equally large, the most common first."""
    U, s, _ = np.linalg.svd(D / np.maximum(np.linalg.norm(D, axis=0), np.finfo(float).tiny), full_matrices=False)
    return np.asarray((U * s)[:, s > _DIRECTION * s.max(initial=0.0)])


class _ToldApart(NamedTuple):
    """Rows with ``signs`` (n,), the ``change`` (q,) for sign +1 and what residuals (q,) are ``rest``."""

    signs: Array
    change: Array
    rest: Array


def _told_apart(start: Array, r: Array, D: Array, Q: Array) -> _ToldApart:
    """Return rows told apart, beginning with the signs of ``start`` (n,): r (q,), D (q, k), Q (q, p) of parameters."""
    n, A, one = len(start), D.T @ D, np.eye(Q.shape[1])
    signs = np.where(start < 0.0, -1.0, 1.0)
    for _ in range(_MOST_TURNS):
        signed = D * np.repeat(signs, len(r) // n)[:, None]
        S = signed.T @ Q
        sizes = score_test(A, S, signed.T @ r, one).sizes
        change = D @ sizes
        # What is left but for the change, which is then taken by the sign that leaves less.
        left = r - Q @ (S.T @ sizes)
        better = np.where(np.sum((left * change).reshape(n, -1), axis=1) > 0.0, -1.0, 1.0)
        if np.array_equal(better, signs):
            break
        signs = better
    return _ToldApart(signs, change, left + np.repeat(signs, len(r) // n) * change)
