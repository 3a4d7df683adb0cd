"""Noise that remembers: rows of a stream err together, and say less than as many rows that err alone.

The whitened residuals of one number, in the order of time, are taken as a sum of noises that forget, each in its own
time, and one that does not remember:

    E[r(t) r(s)] = w_0 [t = s] + sum_k w_k exp(-|t - s| / tau_k),   w >= 0

Such noise has a state: a sum over all earlier rows follows from that over those before the last one, so that nothing of
N x N numbers is needed (P. Hartikainen, S. Sarkka, Kalman filtering and smoothing solutions to temporal Gaussian
process regression models, 2010). Weights are those that fit the autocovariances of the residuals best (C. L. Lawson,
R. J. Hanson, Solving Least Squares Problems, 1974, chapter 23); over how many times tau the weights are spread, the
data say. The parameters have followed a part of the noise, the slowest most of all; what they leave of each of these
noises is known, and weights are fitted to that (as restricted maximum likelihood does for one: H. D. Patterson,
R. Thompson, Recovery of inter-block information when block sizes are unequal, Biometrika 58, 1971).

Rows that repeat a pose err together as well (:mod:`calib.identification.repeats`).

The estimate stays that of least squares; its covariance is the sandwich ``C (J^T S J + priors) C`` in the place of C.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.foundations.arrays import Array, IntArray, evenly_in_runs
from calib.foundations.brief import brief
from calib.foundations.sealing import sealed
from calib.identification.arrow import Covariance
from calib.identification.parameters import scales
from calib.identification.repeats import MOST_ROWS, Repeats, beyond_alone, repeated
from calib.identification.system import Component, Problem
from calib.measurement.measurements import Measurements
from calib.measurement.poses import poses_of

# Times that noise may remember, in rows' distances and s; sums of neighbours stand for what is between them.
_SHORTEST, _LONGEST, _TIMES = 0.5, 10.0, 14
# Lags whose autocovariances are fitted; rows beyond the longest are not looked at.
_LAGS = 60
# Of more rows, runs of neighbours that are as many together; each is so long.
_MOST_ROWS, _RUN = 12000, 3000
# Fewer rows tell no memory.
_FEWEST = 60
# Less than this share of all noise is none.
_NONE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Memory:
    """How one quantity of one set errs in time: shares ``weights`` (k,) of the variance that last ``times`` (k,) in s.

    ``alone``: the share of what does not remember. ``step``: between rows, in s. ``rows``: how many there are.
    """

    __repr__ = brief

    measurements: int
    quantity: str
    alone: float
    weights: Array
    times: Array
    step: float
    rows: int

    @property
    def rows_as_one(self) -> float:
        """How many rows count as one in a mean over many: the integrated autocorrelation."""
        rates = np.exp(-self.step / self.times)
        whole = self.alone + float(np.sum(self.weights))
        return (self.alone + float(np.sum(self.weights * (1.0 + rates) / (1.0 - rates)))) / whole


def with_memory(
    problem: Problem, x: Array, sigmas: Sequence[Array], residuals: Sequence[Array], covariance: Covariance
) -> tuple[Covariance, tuple[Memory, ...], tuple[Repeats, ...]]:
    """Return the covariance at x (p,) when rows with times, or of one pose, err together, and how they do.

    ``sigmas`` and ``residuals`` (N, d) of every set; ``covariance``: as if rows erred alone. Looked at are common
    parameters, with targets that follow them.
    """
    units = scales(problem.parameters)
    scaled = covariance.scaled(1.0 / units)
    C = scaled.common
    more, found, again = np.zeros_like(C), [], []
    poses = [_poses(data) for data in problem.measurements]
    for component in problem.components:
        data, pose = problem.measurements[component.measurements], poses[component.measurements]
        if not _in_time(data) and pose is None:
            continue
        rows = evenly_in_runs(len(data), _MOST_ROWS, _RUN)
        part = data.subset(rows)
        J = (
            _jacobian(problem, x, part, component, scaled)
            / sigmas[component.measurements][rows][:, component.columns, None]
        )
        r = (residuals[component.measurements] / sigmas[component.measurements])[rows][:, component.columns]
        if pose is not None:
            told = repeated(pose, r, J, C)
            if told is not None:
                level = float(np.median(sigmas[component.measurements][:, component.columns]))
                alone, common = (level * float(np.sqrt(w)) for w in told)
                poses_there = int(pose.max()) + 1
                again.append(Repeats(component.measurements, component.quantity, alone, common, len(data), poses_there))
                more += beyond_alone(*told, pose, J)
            continue
        assert part.times is not None, "rows in time have times"
        memory = _memory(component, part.times, J, r, C, len(data))
        if memory is not None:
            found.append(memory)
            share = len(data) / len(rows)
            more += share * (_gram(memory, part.times, J) - np.einsum("ndi,ndj->ij", J, J))
    if not found and not again:
        return covariance, (), ()
    C = C + C @ more @ C
    return replace(scaled, common=0.5 * (C + C.T)).scaled(units), tuple(found), tuple(again)


def _in_time(data: Measurements) -> bool:
    """Return whether rows are in the order of time, and near to each other in it."""
    if data.times is None or len(data) < _FEWEST:
        return False
    steps = np.diff(data.times)
    return bool(np.all(steps >= 0.0) and 0.0 < float(np.median(steps)) <= _LONGEST / 4.0)


def _poses(data: Measurements) -> IntArray | None:
    """Return the poses (N,) of rows that are not in time, where some repeat one."""
    if _in_time(data) or len(data) > MOST_ROWS:
        return None
    pose = poses_of(data)
    return pose if len(pose) and int(pose.max()) + 1 < len(pose) else None


def _jacobian(problem: Problem, x: Array, part: Measurements, component: Component, known: Covariance) -> Array:
    rates, found = problem.rates(problem.machine(x), scales(problem.parameters), known.split), []
    for block in rates.blocks(part):
        J = block.J
        if block.own is not None and block.block is not None:
            J = J + block.own @ known.follow[block.block]
        found.append(J[:, component.columns])
    return np.concatenate(found)


def _memory(component: Component, times: Array, J: Array, r: Array, C: Array, rows: int) -> Memory | None:
    """Return how residuals (n, d) remember, None where they do not; J (n, d, p) and C (p, p) are those of the fit."""
    step = float(np.median(np.diff(times)))
    taus = np.geomspace(_SHORTEST * step, min(_LONGEST, 0.1 * (times[-1] - times[0])), _TIMES)
    lags = _Lags.of(times, step, float(taus[-1]))
    shares = lags.fitted(lags.covariances(r), lags.model(taus) - _taken(lags, taus, times, J, C))
    if float(np.sum(shares[1:])) < _NONE * float(np.sum(shares)):
        return None
    kept = np.flatnonzero(shares[1:] > 0.0)
    return Memory(
        component.measurements, component.quantity, float(shares[0]), shares[1:][kept], taus[kept], step, rows
    )


def _taken(lags: "_Lags", taus: Array, times: Array, J: Array, C: Array) -> Array:
    """Return what parameters take (l, k + 1) of the autocovariances of one unit of every noise.

    A fit leaves ``(1 - H) S (1 - H)`` of noise S, with ``H = J C J^T``; nothing of N x N is made of
    ``H S + S H - H S H = A X^T + X A^T`` with ``A = J C``, ``X = S J - A (J^T S J) / 2``.
    """
    n, d, p = J.shape
    A, found = (J.reshape(-1, p) @ C).reshape(n, d * p), np.empty((len(lags.rows), len(taus) + 1))
    for k in range(len(taus) + 1):
        SJ = J if k == 0 else _remembered(times, float(taus[k - 1]), J)
        G = np.einsum("ndi,ndj->ij", J, SJ, optimize=True)
        X = SJ.reshape(n, d * p) - 0.5 * (A.reshape(-1, p) @ G).reshape(n, d * p)
        for row, (lag, own) in enumerate(zip(lags.rows, lags.pairs, strict=True)):
            both = np.einsum("nq,nq->n", A[lag:], X[: n - lag]) + np.einsum("nq,nq->n", X[lag:], A[: n - lag])
            found[row, k] = float(np.mean(both[own])) / d if len(own) else 0.0
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Lags:
    """Distances ``rows`` (l,) between rows, 0 first, their ``times`` (l,) in s, and first rows of such ``pairs``."""

    rows: IntArray
    times: Array
    pairs: tuple[IntArray, ...]

    @classmethod
    def of(cls, times: Array, step: float, longest: float) -> "_Lags":
        most = min(int(2.0 * longest / step), len(times) // 2)
        rows = np.unique(np.concatenate([[0], np.geomspace(1, max(most, 2), _LAGS)]).astype(np.intp))
        pairs: list[IntArray] = []
        for lag in rows:
            apart = times[lag:] - times[: len(times) - lag]
            pairs.append(np.flatnonzero(apart <= (lag + 0.5) * step * 1.1))
        return cls(rows, np.asarray(rows * step, dtype=np.float64), tuple(pairs))

    def covariances(self, r: Array) -> Array:
        """Return the autocovariances (l,) of rows (n, d)."""
        return np.array(
            [
                float(np.mean(r[own + lag] * r[own])) if len(own) else 0.0
                for lag, own in zip(self.rows, self.pairs, strict=True)
            ]
        )

    def model(self, taus: Array) -> Array:
        """Return the autocovariances (l, k + 1) of one unit of every noise, that without memory first."""
        return np.column_stack([self.rows == 0, np.exp(-self.times[:, None] / taus)])

    def fitted(self, seen: Array, model: Array) -> Array:
        """Return the shares (k + 1,) that fit autocovariances (l,) best by a model (l, k + 1); near lags are surest."""
        surest = 1.0 / np.sqrt(1.0 + self.times / self.times[1])
        return np.asarray(scipy.optimize.nnls(model * surest[:, None], seen * surest)[0])


def _steps(times: Array, tau: float) -> Array:
    """Return what is left (n,) of the noise of the row before."""
    return np.asarray(np.exp(-np.diff(times, prepend=-np.inf) / tau))


def _remembered(times: Array, tau: float, x: Array) -> Array:
    """Return ``S x`` (n, ...), S being the covariance of one unit of noise that lasts tau."""
    after = _recursive(_steps(-times[::-1], tau), x[::-1])[::-1]
    return np.asarray(_recursive(_steps(times, tau), x) + after - x)


def _recursive(keep: Array, x: Array) -> Array:
    """Return ``y_n = keep_n y_(n-1) + x_n`` (n, ...)."""
    y: Array = np.array(x, dtype=np.float64)
    for n in range(1, len(y)):
        y[n] += keep[n] * y[n - 1]
    return y


def _gram(memory: Memory, times: Array, J: Array) -> Array:
    """Return ``J^T S J`` (p, p) of rows (n, d, p), numbers of a row being independent."""
    own = np.einsum("ndi,ndj->ij", J, J)
    found = (memory.alone + float(np.sum(memory.weights))) * own
    for weight, tau in zip(memory.weights, memory.times, strict=True):
        before = _recursive(_steps(times, tau), J) - J
        both = np.einsum("ndi,ndj->ij", J, before)
        found += weight * (both + both.T)
    return np.asarray(found)
