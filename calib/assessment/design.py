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
so that all candidates are judged by matrices of m rows. Of very many candidates only some are looked at further: those
that bring most to a design that knows all directions, and others of all kinds, as what brings most by itself bends a
model that leaves something out. Large designs end before all exchanges are tried.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.foundations import linear
from calib.foundations.arrays import Array, IntArray
from calib.foundations.choices import Criterion
from calib.foundations.errors import JobError
from calib.foundations.sealing import sealed
from calib.foundations.words import refuse_other
from calib.identification import identifiability

_MOST_PASSES = 30
# An exchange must improve by more than this share: equal poses would change places for ever.
_IMPROVES = 1e-9
# What stands in for information where nothing is known yet, as a share of what a typical candidate brings.
_NOTHING_KNOWN = 1e-9
# Of how many numbers in their matrices of m rows candidates are looked at again and again: 5000 positions, 1250 poses.
_MOST_NUMBERS = 45_000
# The share of these that are those that bring most; the others are taken evenly from the rest.
_MOST_TELLING = 0.5
# How many such numbers the exchanges of a design look at: some seconds. Designs of 150 poses or fewer hardly need more.
_MOST_LOOKED_AT = 45_000_000
# A pose that changes what is known in some direction by more than this factor is reckoned with from scratch.
_KEEPS_DIGITS = 1e3


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
@sealed
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
    refuse_other(criterion, ("D", "A", "I"), "criterion")
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
    return _State.of(s, chosen).value(s)


def parts_of(s: Space, chosen: Sequence[int]) -> tuple[float, float]:
    """Return the two parts of an A- or I-design's value: the mean variance, and the mean square of the misfit."""
    return _State.of(s, chosen).parts(s)


def unseen(s: Space) -> float:
    """Return the part of an A- or I-design's mean variance that no candidate makes less: before, priors bound it.

    It is what remains when all candidates are measured without noise.
    """
    A = linear.triangle(_flat(s.A))
    _, sizes, Vt = linear.svd(A)
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
    gains = _Gains.of(s, ())
    _, m, r = s.A.shape
    known = -(-2 * r // m)
    while len(gains.chosen) < count:
        if len(gains.chosen) == known:
            gains = gains.narrowed(max(2 * count, _MOST_NUMBERS // m**2))
        of_each = gains.of_each()
        of_each[gains.places] = -np.inf
        gains = gains.plus(int(gains.kept[np.argmax(of_each)]), len(gains.chosen))
    return gains.chosen


def random_values(s: Space, count: int, designs: int, seed: int = 0) -> Array:
    """Return the criterion's values (designs,) of random designs of ``count`` candidates, for comparison."""
    return np.array([value_of(s, chosen) for chosen in random_sets(s, count, designs, seed)])


def random_sets(s: Space, count: int, designs: int, seed: int = 0) -> list[tuple[int, ...]]:
    """Return random designs of ``count`` candidates."""
    rng = np.random.default_rng(seed)
    return [tuple(map(int, rng.permutation(len(s.A))[:count])) for _ in range(designs)]


def _exchanged(s: Space, begin: Sequence[int]) -> Design:
    numbers = s.A.shape[1] ** 2
    gains = _Gains.of(s, tuple(begin)).narrowed(max(2 * len(begin), _MOST_NUMBERS // numbers))
    most = min(_MOST_PASSES * len(begin), _MOST_LOOKED_AT // (numbers * len(gains.kept)))
    exchanges, unchanged = 0, 0
    for step in range(most):
        chosen = gains.chosen
        if unchanged == len(chosen):
            return Design(tuple(sorted(chosen)), value_of(s, chosen), exchanges, True)
        place = step % len(chosen)
        without = gains.less(place)
        of_each, own = without.of_each(), gains.places
        taken = of_each[own[place]]
        of_each[own] = -np.inf
        new = int(np.argmax(of_each))
        if of_each[new] > taken + _IMPROVES * abs(taken):
            gains = without.plus(int(gains.kept[new]), place)
            exchanges, unchanged = exchanges + 1, 0
        else:
            unchanged += 1
    return Design(tuple(sorted(gains.chosen)), value_of(s, gains.chosen), exchanges, False)


class _State(NamedTuple):
    """A design's inverse information ``P`` (r, r) and what a fit makes of the misfit, ``X`` (r, h)."""

    P: Array
    X: Array

    @classmethod
    def of(cls, s: Space, chosen: Sequence[int]) -> "_State":
        index = np.asarray(chosen, dtype=np.intp)
        A, H = _flat(s.A[index]), _flat(s.H[index])
        P = np.linalg.inv(s.given + A.T @ A)
        P = 0.5 * (P + P.T)
        return cls(P, P @ (s.given_misfit + A.T @ H))

    def value(self, s: Space) -> float:
        if s.criterion == "D":
            return -float(np.linalg.slogdet(self.P)[1])
        return sum(self.parts(s))

    def parts(self, s: Space) -> tuple[float, float]:
        bias = np.sum(self.X * (s.C @ self.X)) - 2.0 * np.sum(self.X * s.C_misfit) + s.misfit
        return float(np.sum(self.P * s.C)), float(bias)


@dataclass(frozen=True, slots=True, eq=False)
class _Gains:
    """By how much each candidate would improve a design, for designs of which each differs little from the last.

    ``kept`` (N,): which candidates are looked at, ascending.

    ``S`` (m, m, N): A P A^T + 1 of every candidate, and ``W`` (m, m, N): A P C P A^T, zeros for D. A pose that comes
    or goes changes both by matrices of rank m, which costs a candidate r m^2 in place of r^2 m.
    """

    s: Space
    kept: IntArray
    rows: Array
    misfit: Array
    chosen: tuple[int, ...]
    state: _State
    S: Array
    W: Array

    @classmethod
    def of(cls, s: Space, chosen: tuple[int, ...]) -> "_Gains":
        """Return them of a design from scratch."""
        N, m, r = s.A.shape
        rows = np.ascontiguousarray(s.A.transpose(2, 1, 0)).reshape(r, m * N)
        return cls._at(s, np.arange(N), rows, np.ascontiguousarray(s.H.transpose(2, 1, 0)), chosen)

    @classmethod
    def _at(cls, s: Space, kept: IntArray, rows: Array, misfit: Array, chosen: tuple[int, ...]) -> "_Gains":
        N, (_, m, r) = len(kept), s.A.shape
        state = _State.of(s, chosen)
        AP = (state.P @ rows).reshape(r, m, N)
        S = np.einsum("rin,rjn->ijn", AP, rows.reshape(r, m, N)) + np.eye(m)[:, :, None]
        W = np.zeros_like(S)
        if s.criterion != "D":
            W = np.einsum("rin,rjn->ijn", (s.C @ AP.reshape(r, m * N)).reshape(r, m, N), AP)
        return cls(s, kept, rows, misfit, chosen, state, S, W)

    @property
    def places(self) -> IntArray:
        """Where those that are chosen stand among the candidates that are looked at."""
        return np.searchsorted(self.kept, self.chosen)

    def narrowed(self, most: int) -> "_Gains":
        """Return the gains of ``most`` candidates: the chosen, those that bring most, and of the others evenly."""
        if len(self.kept) <= most:
            return self
        of_each = self.of_each()
        of_each[self.places] = np.inf
        order = np.argsort(-of_each, kind="stable")
        first = max(len(self.chosen), int(_MOST_TELLING * most))
        others = np.linspace(first, len(order), most - first, endpoint=False, dtype=np.intp)
        best = np.sort(order[np.concatenate([np.arange(first), others])])
        rows = self.rows.reshape(len(self.rows), -1, len(self.kept))[..., best]
        return replace(
            self,
            kept=self.kept[best],
            rows=np.ascontiguousarray(rows).reshape(len(rows), -1),
            misfit=np.ascontiguousarray(self.misfit[..., best]),
            S=np.ascontiguousarray(self.S[..., best]),
            W=np.ascontiguousarray(self.W[..., best]),
        )

    def less(self, place: int) -> "_Gains":
        """Return the gains beside the design without the candidate at a place."""
        return self._changed(self.chosen[place], -1.0, self.chosen[:place] + self.chosen[place + 1 :])

    def plus(self, c: int, place: int) -> "_Gains":
        """Return the gains beside the design with one more candidate, at a place."""
        return self._changed(c, 1.0, (*self.chosen[:place], c, *self.chosen[place:]))

    def _changed(self, c: int, sign: float, chosen: tuple[int, ...]) -> "_Gains":
        s, (P, X) = self.s, self.state
        # P' = P - U T U^T, with U = P A_c^T; where little of the information remains, its digits would not.
        m, N = len(s.A[c]), len(self.kept)
        U = P @ s.A[c].T
        left = np.eye(m) + sign * (s.A[c] @ U)
        if not 1.0 / _KEEPS_DIGITS < np.linalg.eigvalsh(left)[0] < np.linalg.eigvalsh(left)[-1] < _KEEPS_DIGITS:
            return self._at(s, self.kept, self.rows, self.misfit, chosen)
        T = sign * np.linalg.inv(left)
        T = 0.5 * (T + T.T)
        state = _State(P - U @ T @ U.T, X + U @ T @ (s.H[c] - s.A[c] @ X))
        PCU = P @ (s.C @ U)
        K = (0.5 * U @ T @ (U.T @ s.C @ U) - PCU) @ T
        moved = np.concatenate([U, U @ T, K], axis=1).T @ self.rows
        Y, YT, YK = moved.reshape(3, m, m, N)
        S = self.S - np.einsum("kin,kjn->ijn", YT, Y)
        W = self.W
        if s.criterion != "D":
            of_rows = np.einsum("kin,kjn->ijn", Y, YK)
            W = W + of_rows + np.swapaxes(of_rows, 0, 1)
        return _Gains(s, self.kept, self.rows, self.misfit, chosen, state, S, W)

    def of_each(self) -> Array:
        """Return by how much each candidate (N,) would improve the criterion if it came on top."""
        s = self.s
        inverse, log_determinant = _inverses(self.S)
        if s.criterion == "D":
            return log_determinant
        # P' = P - K A P and X' = X + K (H - A X), with K = P A^T S^-1; all of it in matrices of m rows.
        gain = np.einsum("ijn,ijn->n", inverse, self.W)
        if h := s.H.shape[2]:
            P, X = self.state
            toward = np.concatenate([X, P @ (s.C @ X - s.C_misfit)], axis=1).T @ self.rows
            AX, AY = toward.reshape(2, h, *self.S.shape[1:])
            E = np.einsum("ijn,hjn->hin", inverse, self.misfit - AX)
            gain -= 2.0 * np.einsum("hin,hin->n", E, AY)
            gain -= np.einsum("ijn,ijn->n", self.W, np.einsum("hin,hjn->ijn", E, E))
        return np.asarray(gain)


def _inverses(S: Array) -> tuple[Array, Array]:
    """Return the inverses (m, m, N) of many small positive definite matrices, and their log determinants (N,).

    Gauss and Jordan's elimination of all of them at once: definite ones need no pivots, and a call of LAPACK for each
    takes ten times as long.
    """
    T, log_determinant = S.copy(), np.zeros(S.shape[2])
    for k in range(len(T)):
        pivot = T[k, k].copy()
        row, column = T[k] / pivot, T[:, k].copy()
        T -= column[:, None] * row
        T[k], T[:, k] = row, -column / pivot
        T[k, k] = 1.0 / pivot
        log_determinant += np.log(pivot)
    return T, log_determinant


def _flat(rows: Array) -> Array:
    """Return (N m, k) of (N, m, k), where any of them may be 0."""
    return rows.reshape(rows.shape[0] * rows.shape[1], rows.shape[2])


def _better(s: Space, a: float, b: float) -> bool:
    return a > b if s.criterion == "D" else a < b
