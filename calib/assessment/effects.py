"""Effects that no parameter of a fit stands for, sought in its residuals: how large each would be, and how sure.

An effect is a direction d in the space of all measured numbers: what one unit of it would do to them. With whitened
residuals r, Jacobian J and covariance C of the parameters, those take up ``J C J^T d`` of it and leave l, the rest. The
size of the effect is

    a = -(l^T r) / (l^T l)

a score test (C. R. Rao, 1948): nothing is fitted anew. With l in place of d, what r still has along the parameters, as
weak priors keep it, is no effect: of a large d that the parameters nearly take up, little of it would be a multiple.
Neighbouring rows go together - a gear that wobbles errs alike in all of them -, so that N rows say less than N
independent ones: the standard error of ``a`` is that of sums over blocks of neighbours, each longer than residuals
remember (W. K. Newey, K. D. West, Econometrica 55, 1987, with blocks).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from calib.assessment.stretches import Stretch
from calib.foundations.arrays import Array, IntArray
from calib.foundations.chance import autocorrelations

# Fewer blocks than these give no standard error.
LEAST_BLOCKS = 8
# A correlation below this is none.
_FORGOTTEN = 0.1
# Directions of whose square the parameters leave less than this share are theirs.
TAKEN = 1e-7
# No motion that is fitted enlarges the whitened sum of squares; priors let it grow by less than this.
_GROWN = 1.0


@dataclass(frozen=True, slots=True)
class Effect:
    """How large an effect is: ``value`` with its standard error ``sigma``, in the effect's own unit.

    ``size``: what it does to a row, over the standard deviation of what remains of one number without it. Nan where the
    parameters could stand for it, or where rows are too few. ``freedom``: degrees of freedom of the standard error.
    """

    value: float
    sigma: float
    size: float
    freedom: float = np.inf

    @property
    def t(self) -> float:
        """The value over its standard error; 0 where nothing is known."""
        return self.value / self.sigma if self.sigma > 0.0 else 0.0


NO_EFFECT = Effect(float("nan"), float("nan"), float("nan"))


def effect(
    parts: Sequence[Stretch], directions: Sequence[Array], C: Array, runs: Sequence[IntArray] | None = None
) -> Effect:
    """Return how large an effect is that would change the whitened numbers of every part by ``directions`` (n, d).

    ``runs`` (n,), by number from 0: rows that err together too, for however long. Where each has a sign of its own,
    as many numbers as there are runs tell the effect, and its standard error.
    """
    if not parts:
        return NO_EFFECT
    r, d = (np.concatenate([x.ravel() for x in xs]) for xs in ([part.r for part in parts], directions))
    both = [(part.J.reshape(-1, len(C)), own.ravel()) for part, own in zip(parts, directions, strict=True)]
    taken = C @ np.sum([J.T @ own for J, own in both], axis=0)
    left = np.concatenate([own - J @ taken for J, own in both])
    M = float(left @ left)
    if not TAKEN * float(d @ d) < M:
        return NO_EFFECT
    value = -float(left @ r) / M
    rest = r + left * value
    lengths = [len(part.r) for part in parts]
    ends = np.cumsum([part.r.size for part in parts])[:-1]
    scores = [
        (own * what).reshape(n, -1).sum(axis=1)
        for own, what, n in zip(np.split(left, ends), np.split(rest, ends), lengths, strict=True)
    ]
    after = [x.reshape(n, -1) for x, n in zip(np.split(rest, ends), lengths, strict=True)]
    length = 1 + int(np.ceil(2.0 * memory(after)))
    sums = np.concatenate([np.add.reduceat(score, np.arange(0, len(score), length)) for score in scores if len(score)])
    if len(sums) < LEAST_BLOCKS:
        return NO_EFFECT
    # Of numbers the parameters have taken some.
    free = max(len(r) - sum(part.used for part in parts), 0.05 * len(r), 1.0)
    variance = max(float(rest @ rest) / free, *(part.least for part in parts))
    squares, freedom = float(sums @ sums) * len(r) / free, np.inf
    if runs is not None:
        of_runs = np.concatenate([np.bincount(run, score) for run, score in zip(runs, scores, strict=True)])
        freedom = float(np.count_nonzero(of_runs) - 1)
        if freedom < 1.0:
            return NO_EFFECT
        squares = max(squares, float(of_runs @ of_runs) * (1.0 + 1.0 / freedom))
    sigma = np.sqrt(max(squares, M * variance)) / M
    size = float(np.sqrt(value**2 * M / sum(lengths) / variance))
    return Effect(value, float(sigma), size, freedom)


def memory(parts: Sequence[Array]) -> float:
    """Return how many rows residuals (n, d) remember: the sum of their autocorrelations until one is small."""
    most = max((len(r) for r in parts), default=0) // 6
    return sum(takewhile(lambda rho: rho >= _FORGOTTEN, autocorrelations(parts, most)))


def gains(parts: Sequence[Stretch], C: Array) -> dict[str, Effect]:
    """Return for every joint by which share more than it says it would move; its zero may be elsewhere too."""
    return {
        name: _gain(parts, [part.by_joint[:, :, j] for part in parts], [part.values[:, j] for part in parts], C)
        for j, name in enumerate(parts[0].joints if parts else ())
    }


def ratios(parts: Sequence[Stretch], C: Array) -> dict[tuple[str, str], Effect]:
    """Return for every joint, and reading of another that it follows, by which share more it would follow that one."""
    return {
        tie: _gain(parts, [part.by_follower[:, :, j] for part in parts], [part.followed[:, j] for part in parts], C)
        for j, tie in enumerate(parts[0].followers if parts else ())
    }


def _gain(parts: Sequence[Stretch], turned: Sequence[Array], motions: Sequence[Array], C: Array) -> Effect:
    """Return by which share more a joint would move than by ``motions`` (n,); ``turned`` (n, d): what its turn does."""
    within, own = besides(parts, [Z[:, :, None] for Z in turned], C)
    every = zip(within, turned, motions, strict=True)
    usable = [(part, Z * motion[:, None]) for part, Z, motion in every if part.data.other is None]
    return effect([part for part, _ in usable], [d for _, d in usable], own)


def besides(parts: Sequence[Stretch], motions: Sequence[Array], C: Array) -> tuple[tuple[Stretch, ...], Array]:
    """Return parts and covariance as of a fit that had sought ``motions`` (n, d, k) of all rows of every part too.

    Where the fit has parameters for them, nothing changes. Where it has none, what is elsewhere in all rows would look
    like a step that leaves out but a few of them.
    """
    both = list(zip(motions, parts, strict=True))
    A = np.sum([np.tensordot(Z, Z, ((0, 1), (0, 1))) for Z in motions], axis=0)
    S = np.sum([np.tensordot(Z, part.J, ((0, 1), (0, 1))) for Z, part in both], axis=0)
    g = np.sum([np.einsum("ndk,nd->k", Z, part.r) for Z, part in both], axis=0)
    values, V = np.linalg.eigh(A - S @ C @ S.T)
    kept = values > TAKEN * np.trace(A) / len(A)
    values, V = values[kept], V[:, kept]
    sizes = -(V.T @ g) / values
    # What the parameters leave of it: so the covariance has no terms of both.
    taken = C @ S.T @ V
    left = [Z @ V - (part.J.reshape(-1, len(C)) @ taken).reshape(*Z.shape[:2], -1) for Z, part in both]
    # A fit that ended a hair early leaves some along its parameters, and that is no motion they nearly take up.
    kept = np.sum([_grown(part.r, L, sizes) for L, part in zip(left, parts, strict=True)], axis=0) < _GROWN
    if not kept.any():
        return tuple(parts), C
    values, sizes = values[kept], sizes[kept]
    found = []
    for whole, part in zip(left, parts, strict=True):
        L = whole[:, :, kept]
        r, J = part.r + L @ sizes, np.concatenate([part.J, L], axis=2)
        found.append(replace(part, r=r, J=J, used=part.used + float(np.sum(L**2 / values))))
    p = len(C)
    covariance = np.zeros((p + len(values), p + len(values)))
    covariance[:p, :p], covariance[p:, p:] = C, np.diag(1.0 / values)
    return tuple(found), covariance


def _grown(r: Array, left: Array, sizes: Array) -> Array:
    """Return by how much each of the directions ``left`` (n, d, k), ``sizes`` (k,) of it, enlarges the sum of r^2."""
    return np.asarray(sizes * (2.0 * np.einsum("ndk,nd->k", left, r) + sizes * np.sum(left**2, axis=(0, 1))))


def per_metre(parts: Sequence[Stretch]) -> float:
    """Return by how much the whitened numbers of a row (rms of their norms) follow a metre by which base or tool move.

    Of the two that which shows more: where only the way from one pose to another is measured, the base shows nothing.
    """
    squares = [
        sum(float(np.sum(by[:, :, :3] ** 2)) / 3.0 for by in every)
        for every in ([part.by_base for part in parts], [part.by_tool for part in parts])
    ]
    return max(float(np.sqrt(max(squares) / sum(len(part.r) for part in parts))), 1e-12)
