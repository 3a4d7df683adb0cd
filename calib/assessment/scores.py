"""Score tests (C. R. Rao, 1948) of directions that no parameter stands for: what they gain, and by what chance."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.assessment.effects import TAKEN, memory
from calib.assessment.stretches import Stretch
from calib.foundations.arrays import Array, IntArray
from calib.foundations.chance import exceeded


class Score(NamedTuple):
    """What directions gain, taken together: chi-squared ``gain`` (...) of so many ``numbers`` (...).

    ``sizes`` (..., k): by what directions would have to be multiplied.
    """

    gain: Array
    numbers: IntArray
    sizes: Array


def score_test(A: Array, S: Array, g: Array, C: Array, *, taken: float = TAKEN) -> Score:
    """Return the score test of directions D: of A = D^T D (..., k, k), S = D^T J (..., k, p) and g = D^T r (..., k).

    Directions of whose square the parameters leave less than the share ``taken`` are theirs.
    """
    values, V = np.linalg.eigh(A - S @ C @ np.swapaxes(S, -1, -2))
    kept = values > taken * np.trace(A, axis1=-2, axis2=-1)[..., None] / A.shape[-1]
    u = np.einsum("...ij,...i->...j", V, g)
    weighed = np.where(kept, u / np.where(kept, values, 1.0), 0.0)
    return Score(
        np.sum(u * weighed, axis=-1), np.count_nonzero(kept, axis=-1), -np.einsum("...ij,...j->...i", V, weighed)
    )


def score_of(D: Array, part: Stretch, C: Array, *, taken: float = TAKEN) -> tuple[Score, Array]:
    """Return the score test of directions D (n d, k) of a part alone, and what they change in it (n, d)."""
    J = part.J.reshape(part.r.size, -1)
    S = D.T @ J
    score = score_test(D.T @ D, S, D.T @ part.r.ravel(), C, taken=taken)
    return score, ((D - J @ (C @ S.T)) @ score.sizes).reshape(part.r.shape)


def variance_of(rest: Array, part: Stretch, taken: int = 0) -> float:
    """Return the variance of what remains (n, d), of which the parameters, and so many directions, take up some."""
    return max(float(np.sum(rest**2)) / max(rest.size - part.used - taken, 1.0), part.least)


def chance_of(found: Score, rest: Array, part: Stretch, along: Array | None = None) -> float:
    """Return how probable a gain is, against what remains (n, d), of rows that remember each other: by F.

    Of what remains, parameters take up some numbers and the directions some more; 1 where they leave none. ``along``
    (n, d): what the effect does to rows that have it, where what remains is judged by what it is in that direction.
    """
    numbers = int(found.numbers)
    freedom = rest.size - part.used - numbers
    if numbers < 1 or freedom < 1.0:
        return 1.0
    variance, inflation = variance_of(rest, part, numbers), 1.0 + 2.0 * memory([rest])
    more = inflation if along is None else inflation * _more_along(rest, along, variance)
    return float(exceeded(float(found.gain) / variance / more, numbers, max(freedom / inflation, 1.0)))


class Asked(NamedTuple):
    """How surely rows ask for a change: ``sizes`` (k,) of its directions, and the ``chance`` of that much.

    ``follows`` (p,): by how much parameters follow such a change, in their scales; nothing of directions that they take
    up whole. ``left``: what it leaves of the squares of the rows, as a share.
    """

    sizes: Array
    follows: Array
    chance: float
    left: float


def asked(parts: Sequence[Stretch], directions: Sequence[Array], C: Array) -> Asked:
    """Return how surely rows ask for a change of their numbers along ``directions`` (n, d, k) of every part."""
    both = list(zip(parts, directions, strict=True))
    A = np.sum([np.tensordot(D, D, ((0, 1), (0, 1))) for _, D in both], axis=0)
    S = np.sum([np.tensordot(D, part.J, ((0, 1), (0, 1))) for part, D in both], axis=0)
    g = np.sum([np.einsum("ndk,nd->k", D, part.r) for part, D in both], axis=0)
    score = score_test(A, S, g, C)
    numbers, follows = int(score.numbers), -C @ (S.T @ score.sizes)
    along = [(D @ score.sizes).ravel()[:, None] for _, D in both]
    rest = np.concatenate(
        [
            part.r.ravel()[:, None] + D + (part.J @ follows).ravel()[:, None]
            for D, (part, _) in zip(along, both, strict=True)
        ]
    )
    freedom = rest.size - sum(part.used for part in parts) - numbers
    if numbers < 1 or freedom < 1.0:
        return Asked(score.sizes, follows, 1.0, 1.0)
    variance = max(float(np.sum(rest**2)) / freedom, *(part.least for part in parts))
    more = _more_along(rest, np.concatenate(along), variance)
    chance = float(exceeded(float(score.gain) / variance / more, numbers, freedom))
    return Asked(score.sizes, follows, chance, float(np.sum(rest**2)) / sum(float(np.sum(part.r**2)) for part in parts))


def _more_along(rest: Array, along: Array, variance: float) -> float:
    """Return how many times the variance of all numbers that of what remains is ``along`` a motion (n, d), at least 1.

    What a model leaves out of a joint turns that joint: it is all in one direction of a row, and largest in the rows
    that a turn moves most. Of the mean over three rows it makes far more than as much noise in all directions.
    """
    weights = float(np.sum(along**2)) * variance
    return max(float(np.sum(np.sum(along * rest, axis=1) ** 2)) / weights, 1.0) if weights > 0.0 else 1.0
