"""Which poses to measure: optimal designs by exchange.

Every candidate pose c has whitened rows A_c (m, r), in the directions that all candidates together can see. A design D
has the information M = M_0 + sum A_c^T A_c, where M_0 is what is known before (priors, poses measured already).

    D-optimal: the largest log det M: the smallest region of the parameters.
    A-optimal: the least tr M^-1: the least sum of the parameters' variances, in parameter scales.
    I-optimal: the least tr(M^-1 C), C = mean B_w^T B_w over working poses: the least mean variance of the tool there.

A model that leaves something out (H_c at the candidates, H_w at the working poses, one column for every effect of unit
variance) errs by B_w X - H_w, where X = M^-1 sum A_c^T H_c is what the fit makes of the effects. The I-criterion adds
the mean of its square: extreme poses determine the parameters best and are where a wrong model bends them most (G. E.
P. Box, N. R. Draper, *A basis for the selection of a response surface design*, JASA 54, 1959).

The design begins with the poses that bring most one after another; then every pose in turn is exchanged for the best of
all candidates, until none improves (V. V. Fedorov, *Theory of Optimal Experiments*, 1972). A pose changes M by rank m,
so that all candidates are judged by matrices of m rows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.foundations import linear
from calib.foundations.arrays import Array
from calib.foundations.choices import Criterion
from calib.foundations.errors import JobError
from calib.identification import identifiability

_MOST_PASSES = 30
# An exchange must improve by more than this share: equal poses would change places for ever.
_IMPROVES = 1e-9
# What stands in for information where nothing is known yet, as a share of what a typical candidate brings.
_NOTHING_KNOWN = 1e-9


class DesignRows(NamedTuple):
    """Rows of N poses. ``of_parameters`` (N, m, p): whitened, for a change of each parameter by its scale.

    ``of_misfit`` (N, m, h): what effects that the model leaves out do, each of unit variance, whitened; h may be 0.
    """

    of_parameters: Array
    of_misfit: Array

    @classmethod
    def without_misfit(cls, of_parameters: Array) -> "DesignRows":
        """Return rows of a model that leaves nothing out."""
        return cls(of_parameters, np.zeros((*of_parameters.shape[:2], 0)))


@dataclass(frozen=True, slots=True, eq=False)
class Space:
    """Everything a design is judged by, in the directions that the candidates see. Made by :func:`space`.

    ``A`` (N, m, r) and ``H`` (N, m, h): rows of the candidates. ``given`` (r, r) and ``given_misfit`` (r, h): of the
    poses measured already, and of priors. ``C`` (r, r), ``C_misfit`` (r, h) and ``misfit``: means over the working
    poses of B^T B, B^T H and tr H^T H. ``V`` (p, r): the directions, of which poses alone see ``seen``, and priors the
    rest. ``criterion``: A is I with C = 1.
    """

    A: Array
    H: Array
    given: Array
    given_misfit: Array
    C: Array
    C_misfit: Array
    misfit: float
    V: Array
    seen: int
    criterion: Criterion


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """Chosen candidates, ascending. ``value`` of the criterion: of D log det M, else the mean square, less is better.

    ``exchanges``: how many poses changed places; ``converged``: no exchange would improve it.
    """

    chosen: tuple[int, ...]
    value: float
    exchanges: int
    converged: bool


def space(
    candidates: DesignRows,
    criterion: Criterion = "I",
    working: DesignRows | None = None,
    given: DesignRows | None = None,
    prior: Array | None = None,
) -> Space:
    """Return what designs of the candidates are judged by, in the directions that all of them would know usably.

    ``working``: rows of the tool's position at the working poses, in the unit of the criterion's answer; the candidates
    when None. ``given``: poses measured already. ``prior`` (p,): standard deviations of the parameters in parameter
    scales, infinite for none.

    Raises JobError when the criterion is not known, or the candidates see nothing.
    """
    if criterion not in ("D", "A", "I"):
        raise JobError(f"criterion: {criterion!r} is not one of D, A, I.")
    J = candidates.of_parameters
    p = J.shape[2]
    known = np.diag(np.zeros(p) if prior is None else prior**-2.0)
    before = [] if given is None else [_flat(given.of_parameters)]
    of_poses = linear.triangle(np.concatenate([_flat(J), *before]))
    directions = identifiability.singular_directions(np.concatenate([of_poses, np.sqrt(known)]))
    V = directions.vectors[:, : directions.numerical_rank]
    if not V.shape[1]:
        raise JobError("the candidate poses determine no parameter.")
    A = np.ascontiguousarray(J @ V)
    M, G = V.T @ known @ V, np.zeros((V.shape[1], candidates.of_misfit.shape[2]))
    if given is not None:
        rows = _flat(given.of_parameters @ V)
        M, G = M + rows.T @ rows, G + rows.T @ _flat(given.of_misfit)
    C, C_misfit, misfit = np.eye(V.shape[1]), np.zeros_like(G), 0.0
    if criterion == "I":
        at = candidates if working is None else working
        n = len(at.of_parameters)
        B, H = _flat(at.of_parameters @ V), _flat(at.of_misfit)
        C, C_misfit, misfit = B.T @ B / n, B.T @ H / n, float(np.sum(H**2)) / n
    typical = float(np.mean(np.sum(A**2, axis=(1, 2)))) / V.shape[1]
    M = M + _NOTHING_KNOWN * typical * np.eye(V.shape[1])
    H = candidates.of_misfit if criterion == "I" else np.zeros((*J.shape[:2], 0))
    G, C_misfit = (G, C_misfit) if criterion == "I" else (G[:, :0], C_misfit[:, :0])
    return Space(
        A, H, M, G, C, C_misfit, misfit, V, identifiability.singular_directions(of_poses).numerical_rank, criterion
    )


def value_of(s: Space, chosen: Sequence[int]) -> float:
    """Return the criterion's value of a design: of D log det M, else the mean square error at the working poses."""
    return _state(s, chosen).value(s)


def parts_of(s: Space, chosen: Sequence[int]) -> tuple[float, float]:
    """Return the two parts of an A- or I-design's value: the mean variance, and the mean square of the misfit."""
    return _state(s, chosen).parts(s)


def unseen(s: Space) -> float:
    """Return the part of an A- or I-design's mean variance that no candidate makes less: before, priors bound it.

    It is what remains when all candidates are measured without noise.
    """
    A = linear.triangle(_flat(s.A))
    _, sizes, Vt = np.linalg.svd(A)
    Z = Vt[int(np.count_nonzero(sizes > identifiability.RANK_TOLERANCE * sizes[0])) :].T
    return float(np.trace(np.linalg.solve(Z.T @ s.given @ Z, Z.T @ s.C @ Z)))


def choose(
    s: Space,
    count: int,
    *,
    starts: int = 1,
    seed: int = 0,
    order: Sequence[int] | None = None,
    progress: Callable[[int, int], None] = lambda _done, _of: None,
) -> Design:
    """Return the best design of ``count`` candidates that exchanges lead to, the first time from the best sequence.

    ``order``: that sequence, of ``count`` or more, where it is known. Further ``starts`` begin with random designs.
    Raises JobError when there are fewer candidates than ``count``.
    """
    if not 0 < count <= len(s.A):
        raise JobError(f"{count} poses cannot be chosen from {len(s.A)} candidates.")
    rng = np.random.default_rng(seed)
    best: Design | None = None
    for start in range(starts):
        progress(start, starts)
        if start > 0:
            begin = tuple(map(int, rng.permutation(len(s.A))[:count]))
        else:
            begin = sequence(s, count) if order is None else tuple(order[:count])
        found = _exchanged(s, begin)
        if best is None or _better(s, found.value, best.value):
            best = found
    progress(starts, starts)
    assert best is not None, "one start at least"
    return best


def sequence(s: Space, count: int) -> tuple[int, ...]:
    """Return candidates in the order in which each one brings most to those before it: the next best poses.

    Raises JobError when there are fewer candidates than ``count``.
    """
    if not 0 <= count <= len(s.A):
        raise JobError(f"{count} poses cannot be chosen from {len(s.A)} candidates.")
    chosen: list[int] = []
    for _ in range(count):
        gains = _state(s, chosen).gains(s)
        gains[chosen] = -np.inf
        chosen.append(int(np.argmax(gains)))
    return tuple(chosen)


def random_values(s: Space, count: int, designs: int, seed: int = 0) -> Array:
    """Return the criterion's values (designs,) of random designs of ``count`` candidates, for comparison."""
    rng = np.random.default_rng(seed)
    return np.array([value_of(s, tuple(map(int, rng.permutation(len(s.A))[:count]))) for _ in range(designs)])


def _exchanged(s: Space, begin: Sequence[int]) -> Design:
    chosen = list(begin)
    exchanges, unchanged = 0, 0
    for step in range(_MOST_PASSES * len(chosen)):
        if unchanged == len(chosen):
            return Design(tuple(sorted(chosen)), value_of(s, chosen), exchanges, True)
        i = step % len(chosen)
        c = chosen[i]
        gains = _state(s, chosen[:i] + chosen[i + 1 :]).gains(s)
        taken = gains[c]
        gains[chosen] = -np.inf
        new = int(np.argmax(gains))
        if gains[new] > taken + _IMPROVES * abs(taken):
            chosen[i] = new
            exchanges, unchanged = exchanges + 1, 0
        else:
            unchanged += 1
    return Design(tuple(sorted(chosen)), value_of(s, chosen), exchanges, False)


class _State(NamedTuple):
    """A design's inverse information ``P`` (r, r) and what a fit makes of the misfit, ``X`` (r, h)."""

    P: Array
    X: Array

    @classmethod
    def of(cls, M: Array, G: Array) -> "_State":
        P = np.linalg.inv(M)
        return cls(0.5 * (P + P.T), P @ G)

    def value(self, s: Space) -> float:
        if s.criterion == "D":
            return -float(np.linalg.slogdet(self.P)[1])
        return sum(self.parts(s))

    def parts(self, s: Space) -> tuple[float, float]:
        bias = np.sum(self.X * (s.C @ self.X)) - 2.0 * np.sum(self.X * s.C_misfit) + s.misfit
        return float(np.sum(self.P * s.C)), float(bias)

    def gains(self, s: Space) -> Array:
        """Return by how much each candidate (N,) would improve the criterion if it came on top."""
        N, m, r = s.A.shape
        AP = (_flat(s.A) @ self.P).reshape(N, m, r)
        S = AP @ np.swapaxes(s.A, 1, 2) + np.eye(m)
        if s.criterion == "D":
            return np.asarray(np.linalg.slogdet(S)[1])
        # P' = P - K A P and X' = X + K (H - A X), with K = P A^T S^-1; all of it in matrices of m rows.
        S_inverse = _inverses(S)
        W = (_flat(AP) @ s.C).reshape(N, m, r) @ np.swapaxes(AP, 1, 2)
        gain = np.einsum("nij,nij->n", S_inverse, W)
        if s.H.shape[2]:
            h = s.H.shape[2]
            E = S_inverse @ (s.H - (_flat(s.A) @ self.X).reshape(N, m, h))
            toward = (_flat(AP) @ (s.C @ self.X - s.C_misfit)).reshape(N, m, h)
            gain -= 2.0 * np.einsum("nij,nij->n", E, toward)
            gain -= np.einsum("nij,nij->n", W, E @ np.swapaxes(E, 1, 2))
        return np.asarray(gain)


def _state(s: Space, chosen: Sequence[int]) -> _State:
    index = np.asarray(chosen, dtype=np.intp)
    A, H = _flat(s.A[index]), _flat(s.H[index])
    return _State.of(s.given + A.T @ A, s.given_misfit + A.T @ H)


def _inverses(S: Array) -> Array:
    """Return the inverses (N, m, m) of many small positive definite matrices.

    Gauss and Jordan's elimination of all of them at once: definite ones need no pivots, and a call of LAPACK for each
    takes ten times as long.
    """
    T = np.ascontiguousarray(np.moveaxis(S, 0, 2))
    for k in range(len(T)):
        row, column = T[k] / T[k, k], T[:, k].copy()
        T -= column[:, None] * row
        T[k], T[:, k] = row, -column / column[k]
        T[k, k] = 1.0 / column[k]
    return np.ascontiguousarray(np.moveaxis(T, 2, 0))


def _flat(rows: Array) -> Array:
    """Return (N m, k) of (N, m, k), where any of them may be 0."""
    return rows.reshape(rows.shape[0] * rows.shape[1], rows.shape[2])


def _better(s: Space, a: float, b: float) -> bool:
    return a > b if s.criterion == "D" else a < b
