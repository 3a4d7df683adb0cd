"""The least-squares solution of a problem: Levenberg-Marquardt by SciPy, then Gauss-Newton to the last digit.

Blind directions are closed by inner constraints (:func:`calib.identification.identifiability.gauge`), taken anew at
every step of the second phase, so that the chosen machine does not depend on where the search began. Model variances
are estimated on the way and the rows are weighted anew.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from calib.foundations import linear
from calib.foundations.arrays import Array
from calib.foundations.errors import IdentificationError, JobError
from calib.identification import identifiability, weights
from calib.identification.identifiability import Directions
from calib.identification.least_squares import LeastSquares
from calib.identification.parameters import scales
from calib.identification.system import Evaluation

_MOST_STEPS = 40
# Weights of rows that lie off settle more slowly than the parameters.
_MOST_ROBUST_STEPS = 160
# The rank is decided at the second step, where the noise is known; to decide it at every step would make them jump.
_STEP_OF_DECISION = 1
# The last step is applied and not evaluated: each one is about a thousand times smaller than the one before it, so 1e-6
# ordinary deviations (1e-9 m) leave less than 1e-12 m.
_NEGLIGIBLE_STEP = 1e-6
# Values below 1e-13 m or rad are zero: joints that nothing moves keep their exact origins.
_ROUNDING = 1e-10
# Noise foretold at the start, as a share of the residuals there: less would leave blind directions without a hold.
_LEAST_FORETOLD = 1e-3
# Levenberg-Marquardt brings the search near; the last digits are left to Gauss-Newton.
_ROUGH = 1e-4


class Solution(NamedTuple):
    """A least-squares solution.

    ``x`` (p,): values in SI units; ``covariance`` (p, p). ``directions``: what the data see at x, priors left out.
    ``unseen`` (p, k), scaled: what neither data nor priors see well enough. ``start`` (q, p): the data's triangle at
    the start point, whitened with the final noise. ``variances`` and ``redundancies``: of every component. ``step``:
    the last one, in ordinary deviations.
    """

    x: Array
    covariance: Array
    directions: Directions
    unseen: Array
    start: Array
    variances: tuple[float, ...]
    redundancies: tuple[float, ...]
    evaluations: int
    step: float
    converged: bool


def solve(
    problem: LeastSquares,
    x0: Array,
    variances: Sequence[float | None] | None = None,
    *,
    at_start: Sequence[Array] | None = None,
) -> Solution:
    """Solve a problem from x0 (p,); ``variances`` of the model part for every component; None is estimated.

    ``at_start``: the residuals (N, d) of every set at x0, where they are known already.

    Raises IdentificationError when there are no more rows and priors than the rank.
    """
    s = scales(problem.parameters)
    z0 = x0 / s
    # Nearest to nominal: the robot to zero, frames to where they start.
    nominal = np.where([parameter.of_robot for parameter in problem.parameters], 0.0, z0)
    fixed = (None,) * len(problem.components) if variances is None else tuple(variances)
    if len(fixed) != len(problem.components):
        raise JobError(f"{len(fixed)} model sigmas are given for {len(problem.components)} components of the data.")
    v = _keep(fixed, weights.mean_squares(problem, x0, at_start))
    evaluator = _Evaluator(problem, s)
    sigmas = first_sigmas = weights.sigmas_of(problem, v)
    first = evaluator(z0, sigmas)
    G = _first_gauge(problem, first, _prior_rows(problem, z0), estimated=None in fixed)
    z = _levenberg_marquardt(problem, evaluator, sigmas, z0, nominal, G)

    step, settled, rank = np.inf, False, None
    for k in range(_MOST_ROBUST_STEPS if problem.robust else _MOST_STEPS):
        evaluation = evaluator(z, sigmas)
        state = _State.of(problem, evaluation, z, sigmas, v, fixed, rank)
        rank = state.rank if k >= _STEP_OF_DECISION else None
        delta = state.spread @ -np.concatenate([state.data[:, -1], state.priors[:, -1], state.gauge @ (z - nominal)])
        z, step = z + delta, float(np.max(np.abs(delta)))
        v, sigmas, settled = state.variances, state.sigmas, state.settled
        if step < _NEGLIGIBLE_STEP and settled:
            break
    z = np.where(np.abs(z) < _ROUNDING, 0.0, z)
    A = state.spread[:, : len(state.data) + len(state.priors)]
    factors, _ = weights.factors_of(problem, first_sigmas, sigmas)
    return Solution(
        z * s,
        (A @ A.T) * s[:, None] * s,
        identifiability.directions(state.data[:, :-1]),
        state.unseen,
        first.reweighted(factors).rows[:, :-1],
        state.variances,
        state.redundancies,
        evaluator.count,
        step,
        step < _NEGLIGIBLE_STEP and settled,
    )


class _State(NamedTuple):
    """The system at one point: whitened ``[J r]`` of data and priors, inner constraints, and the noise that fits them.

    ``rank``: number of directions that data and priors see; inner constraints close the rest, ``unseen`` (p, k).
    ``spread`` (p, q + k) is the inverse that maps residuals of data, priors and constraints to parameters. ``settled``:
    the rows of this evaluation were weighted by the sigmas that its residuals show.
    """

    data: Array
    priors: Array
    gauge: Array
    rank: int
    unseen: Array
    spread: Array
    variances: tuple[float, ...]
    sigmas: tuple[Array, ...]
    redundancies: tuple[float, ...]
    settled: bool

    @classmethod
    def of(
        cls,
        problem: LeastSquares,
        evaluation: Evaluation,
        z: Array,
        weighted_by: tuple[Array, ...],
        v: tuple[float, ...],
        fixed: Sequence[float | None],
        rank: int | None,
    ) -> "_State":
        """Find the model variances that agree with the residuals at z, without a new evaluation.

        Weights that are new by one factor for a whole component scale its triangle; if they change from row to row, the
        triangle keeps the mean factor and is not settled until the next evaluation.
        """
        priors = _prior_rows(problem, z)
        sigmas, settled = weighted_by, True
        factors = np.ones(len(problem.components))
        for _ in range(_MOST_STEPS):
            weighted = evaluation.reweighted(factors)
            data = weighted.rows
            rows = np.concatenate([data, priors])[:, :-1]
            directions = identifiability.directions(rows)
            seen = directions.usable if rank is None else rank
            gauge = _gauge(problem, directions, seen)
            # Full rank by construction: what neither data nor priors see, the inner constraints do.
            spread = np.linalg.pinv(np.concatenate([rows, gauge]), rcond=1e-14)
            redundancies = weights.redundancies_of(problem, weighted.triangles, spread)
            if None not in fixed and not problem.robust:
                break
            v = _keep(fixed, weights.model_variances(problem, evaluation.residuals, redundancies, v))
            sigmas = weights.sigmas_of(problem, v, evaluation.residuals)
            new, settled = weights.factors_of(problem, weighted_by, sigmas)
            change, factors = float(np.max(np.abs(np.log(new / factors)))), new
            if change < weights.NEGLIGIBLE_CHANGE_OF_SIGMA:
                break
        return cls(data, priors, gauge, seen, directions.hidden(seen), spread, v, sigmas, redundancies, settled)


class _Evaluator:
    """Evaluates a problem at scaled values, remembers the last answer, and counts."""

    def __init__(self, problem: LeastSquares, s: Array) -> None:
        self.count = 0
        self._problem, self._s = problem, s
        self._at: tuple[Array, Sequence[Array]] | None = None
        self._last: Evaluation | None = None

    def __call__(self, z: Array, sigmas: Sequence[Array]) -> Evaluation:
        known = self._at is not None and self._at[1] is sigmas and np.array_equal(self._at[0], z)
        if not known or self._last is None:
            self._last = self._problem.evaluate(sigmas, z * self._s)
            self._at = (z.copy(), sigmas)
            self.count += 1
        return self._last


def _levenberg_marquardt(
    problem: LeastSquares, evaluator: _Evaluator, sigmas: Sequence[Array], z0: Array, nominal: Array, G: Array
) -> Array:
    def rows(z: Array) -> Array:
        gauge = np.column_stack([G, G @ (z - nominal)])
        return np.concatenate([evaluator(z, sigmas).rows, _prior_rows(problem, z), gauge])

    def residual(z: Array) -> Array:
        return rows(z)[:, -1]

    def jacobian(z: Array) -> Array:
        return rows(z)[:, :-1]

    # lm and not trf: its first step is not held back, which saves half of the evaluations on nearly linear problems.
    # The columns are scaled already; SciPy's own scaling, its default since 1.16, would hold the first step back.
    result = least_squares(
        residual,
        z0,
        jac=jacobian,
        method="lm",
        x_scale=1.0,
        ftol=_ROUGH,
        xtol=_ROUGH,
        gtol=_ROUGH,
        max_nfev=_MOST_STEPS,
    )
    return np.asarray(result.x)


def _first_gauge(problem: LeastSquares, evaluation: Evaluation, priors: Array, *, estimated: bool) -> Array:
    """Return the inner constraints at the start, where residuals are large and the noise is still unknown.

    What would remain of the residuals after a linear fit foretells the noise, on which the usable rank depends.
    Raises IdentificationError when there are no more rows and priors than the rank.
    """
    data = linear.triangle(evaluation.rows)
    count = sum(measured.sigma.size for measured in problem.measurements) + len(evaluation.relations)
    rank = identifiability.directions(np.concatenate([data, priors])[:, :-1]).rank
    if count + len(priors) <= rank:
        raise IdentificationError(
            f"{count} measured numbers and {len(priors)} priors determine {rank} unknowns and leave none to judge the "
            "fit; measure more poses, free fewer parameters, or give priors."
        )
    p = data.shape[1] - 1
    foretold = 1.0
    if estimated and len(data) > p:
        foretold = max(float(abs(data[p, p]) / np.sqrt(max(count - min(rank, p), 1))), _LEAST_FORETOLD)
    rows = np.concatenate([data / foretold, priors])
    directions = identifiability.directions(rows[:, :-1])
    return _gauge(problem, directions, directions.usable) * foretold


def _gauge(problem: LeastSquares, directions: Directions, rank: int) -> Array:
    """Return the inner constraints of what lies beyond ``rank``, weighted like an ordinary direction."""
    seen = directions.singular_values[:rank]
    weight = float(np.sqrt(seen[0] * seen[-1])) if len(seen) else 1.0
    return weight * identifiability.gauge(directions.hidden(rank), problem.parameters)


def _prior_rows(problem: LeastSquares, z: Array) -> Array:
    """Return ``[J r]`` of the priors, x / sigma: a scaled parameter times its hold is a whitened residual."""
    hold = np.array([parameter.hold for parameter in problem.parameters])
    with_prior = hold > 0.0
    return np.column_stack([np.diag(hold)[with_prior], (hold * z)[with_prior]])


def _keep(fixed: Sequence[float | None], estimated: Sequence[float]) -> tuple[float, ...]:
    return tuple(e if f is None else f for f, e in zip(fixed, estimated, strict=True))
