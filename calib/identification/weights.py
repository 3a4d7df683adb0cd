"""Weights of the rows: standard deviations from the instrument, from what the model cannot explain, and from losses."""

from collections.abc import Sequence

import numpy as np
import scipy

from calib.foundations.arrays import Array
from calib.foundations.errors import JobError
from calib.foundations.words import counted
from calib.identification import losses
from calib.identification.least_squares import LeastSquares
from calib.identification.noise import RARELY, model_variance
from calib.identification.system import Component

NEGLIGIBLE_CHANGE_OF_SIGMA = 1e-3
# Noise of a search, in px and in m or rad, where nobody states the instrument's and nothing is known of it yet.
_PIXEL_NOISE, _NOISE = 0.1, 1e-4
# A perfect fit of noise-free data has no scatter at all; any positive number then weighs the rows alike.
_LEAST_SIGMA = 1e-15
# Beside weak priors it must be more than rounding: this share of the noise above.
_ROUNDING = 1e-5


def refuse_number_of_sigmas(sigmas: Sequence[float | None], components: int) -> None:
    """Raise JobError where there is not one for each component of the data."""
    if len(sigmas) != components:
        raise JobError(f"{len(sigmas)} model sigmas are given for {counted(components, 'component')} of the data.")


def sigmas_of(
    problem: LeastSquares, variances: Sequence[float], r: Sequence[Array] | None = None, *, search: bool = False
) -> tuple[Array, ...]:
    """Return the standard deviations (N, d) of every set: instrument and model part together, in SI units.

    ``variances``: of the model part, one for each component of the problem, squared. With residuals ``r`` (N, d) of
    every set, rows that lie off are given larger ones, as their set's loss says. ``search``: beside weak priors, while
    the solution is sought.
    """
    plain = _plain_sigmas(problem, variances, search=search)
    if r is None:
        return plain
    return tuple(
        sigma if loss == "linear" else sigma / np.sqrt(losses.weight(loss, _row_distances(sigma, own)))[:, None]
        for loss, sigma, own in zip(problem.losses, plain, r, strict=True)
    )


def cost(problem: LeastSquares, variances: Sequence[float], r: Sequence[Array]) -> float:
    """Return the sum of squares of the residuals ``r`` (N, d) of every set, in a search, as their losses count them."""
    plain = _plain_sigmas(problem, variances, search=True)
    return sum(
        float(np.sum((own / sigma) ** 2))
        if loss == "linear"
        else own.shape[1] * float(np.sum(losses.squares(loss, _row_distances(sigma, own))))
        for loss, sigma, own in zip(problem.losses, plain, r, strict=True)
    )


def _row_distances(sigma: Array, residual: Array) -> Array:
    """Return how far off (N,) the rows of a set are, 1 for an ordinary one."""
    return np.asarray(np.sqrt(np.mean((residual / sigma) ** 2, axis=1)))


def _plain_sigmas(problem: LeastSquares, variances: Sequence[float], *, search: bool) -> tuple[Array, ...]:
    sigmas = [np.zeros_like(data.sigma) for data in problem.measurements]
    for c, v in zip(problem.components, variances, strict=True):
        instrument = problem.measurements[c.measurements].sigma[:, c.columns]
        sigmas[c.measurements][:, c.columns] = np.maximum(
            np.sqrt(instrument**2 + v), _rounding(c) if search else _LEAST_SIGMA
        )
    return tuple(sigmas)


def _noise(component: Component) -> float:
    return _PIXEL_NOISE if component.quantity == "pixels" else _NOISE


def _rounding(component: Component) -> float:
    return _ROUNDING * _noise(component)


def search_variances(problem: LeastSquares) -> tuple[float, ...]:
    """Return the model variances of a search: none where the instrument's noise is stated, else an ordinary one."""
    return tuple(
        0.0 if np.all(problem.measurements[c.measurements].sigma[:, c.columns] > 0.0) else _noise(c) ** 2
        for c in problem.components
    )


def model_variances(
    problem: LeastSquares,
    r: Sequence[Array],
    redundancies: Sequence[float],
    variances: Sequence[float],
    *,
    search: bool = False,
) -> tuple[float, ...]:
    """Return the model variance of every component from the residuals (N, d) of every set and degrees of freedom.

    ``variances``: the last ones, by which losses tell which rows lie off. ``search``: only where the instrument's noise
    clearly does not explain the residuals.
    """
    counted = list(r)
    if problem.robust:
        plain = _plain_sigmas(problem, variances, search=search)
        for i, (loss, sigma, residual) in enumerate(zip(problem.losses, plain, r, strict=True)):
            if loss != "linear":
                share = losses.scatter_weight(loss, _row_distances(sigma, residual))
                counted[i] = residual * np.sqrt(share / losses.shrinkage(loss, residual.shape[1]))[:, None]
    return tuple(
        model_variance(
            counted[c.measurements][:, c.columns].ravel(),
            problem.measurements[c.measurements].sigma[:, c.columns].ravel(),
            redundancy,
            clearly=search,
        )
        for c, redundancy in zip(problem.components, redundancies, strict=True)
    )


def scatter(problem: LeastSquares, r: Sequence[Array], sigmas: Sequence[Array], redundancies: Sequence[float]) -> float:
    """Return the rms of whitened residuals, for their degrees of freedom, where it is clearly less than 1; else 1."""
    squares, freedom = 0.0, sum(redundancies)
    for c in problem.components:
        sigma = sigmas[c.measurements][:, c.columns]
        squares += float(np.sum((np.maximum(np.abs(r[c.measurements][:, c.columns]), _rounding(c)) / sigma) ** 2))
    return (
        float(np.sqrt(squares / freedom)) if freedom > 0.0 and scipy.special.chdtr(freedom, squares) < RARELY else 1.0
    )


def factors_of(problem: LeastSquares, old: Sequence[Array], new: Sequence[Array]) -> tuple[Array, bool]:
    """Return the mean factor new / old of each component's sigmas, and whether it is one and the same for its rows."""
    logs = [np.log(new[c.measurements][:, c.columns] / old[c.measurements][:, c.columns]) for c in problem.components]
    middle = np.array([log.mean() for log in logs])
    spread = max(float(np.max(np.abs(log - m))) for log, m in zip(logs, middle, strict=True))
    return np.exp(middle), spread < NEGLIGIBLE_CHANGE_OF_SIGMA
