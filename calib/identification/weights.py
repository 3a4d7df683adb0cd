"""Weights of the rows: standard deviations from the instrument, from what the model cannot explain, and from losses."""

from collections.abc import Sequence

import numpy as np

from calib.foundations.arrays import Array
from calib.identification import losses
from calib.identification.least_squares import LeastSquares
from calib.identification.noise import model_variance

NEGLIGIBLE_CHANGE_OF_SIGMA = 1e-3
# A perfect fit of noise-free data has no scatter at all; any positive number then weighs the rows alike.
_LEAST_SIGMA = 1e-15


def sigmas_of(problem: LeastSquares, variances: Sequence[float], r: Sequence[Array] | None = None) -> tuple[Array, ...]:
    """Return the standard deviations (N, d) of every set: instrument and model part together, in SI units.

    ``variances``: of the model part, one for each component of the problem, squared. With residuals ``r`` (N, d) of
    every set, rows that lie off are given larger ones, as their set's loss says.
    """
    plain = _plain_sigmas(problem, variances)
    if r is None:
        return plain
    return tuple(
        sigma / np.sqrt(losses.weight(loss, t))[:, None]
        for loss, sigma, t in zip(problem.losses, plain, _row_distances(plain, r), strict=True)
    )


def _row_distances(sigmas: Sequence[Array], r: Sequence[Array]) -> tuple[Array, ...]:
    """Return how far off (N,) the rows of every set are, 1 for an ordinary one."""
    return tuple(np.sqrt(np.mean((residual / sigma) ** 2, axis=1)) for residual, sigma in zip(r, sigmas, strict=True))


def _plain_sigmas(problem: LeastSquares, variances: Sequence[float]) -> tuple[Array, ...]:
    added = [np.zeros_like(data.sigma) for data in problem.measurements]
    for component, v in zip(problem.components, variances, strict=True):
        added[component.measurements][:, component.columns] = v
    return tuple(
        np.maximum(np.sqrt(data.sigma**2 + a), _LEAST_SIGMA)
        for data, a in zip(problem.measurements, added, strict=True)
    )


def mean_squares(problem: LeastSquares, x: Array, known: Sequence[Array] | None = None) -> tuple[float, ...]:
    """Return the mean squared residual of every component at x (p,); ``known``: the residuals there."""
    r = problem.residuals(x) if known is None else known
    return tuple(float(np.mean(r[c.measurements][:, c.columns] ** 2)) for c in problem.components)


def model_variances(
    problem: LeastSquares, r: Sequence[Array], redundancies: Sequence[float], variances: Sequence[float]
) -> tuple[float, ...]:
    """Return the model variance of every component from the residuals (N, d) of every set and degrees of freedom.

    ``variances``: the last ones, by which losses tell which rows lie off.
    """
    counted = [
        residual * np.sqrt(losses.scatter_weight(loss, t) / losses.shrinkage(loss, residual.shape[1]))[:, None]
        for loss, residual, t in zip(
            problem.losses, r, _row_distances(_plain_sigmas(problem, variances), r), strict=True
        )
    ]
    return tuple(
        model_variance(
            counted[c.measurements][:, c.columns].ravel(),
            problem.measurements[c.measurements].sigma[:, c.columns].ravel(),
            redundancy,
        )
        for c, redundancy in zip(problem.components, redundancies, strict=True)
    )


def redundancies_of(problem: LeastSquares, triangles: Sequence[Array], spread: Array) -> tuple[float, ...]:
    """Return the degrees of freedom of every component: its rows less those the parameters have used up.

    ``triangles``: whitened ``[J r]`` (q, p + 1) of each component; ``spread`` (p, all rows): from residuals to values.
    """
    found, start = [], 0
    for component, triangle in zip(problem.components, triangles, strict=True):
        used = float(np.sum(spread[:, start : start + len(triangle)] * triangle[:, :-1].T))
        start += len(triangle)
        found.append(problem.measurements[component.measurements].sigma[:, component.columns].size - used)
    return tuple(found)


def factors_of(problem: LeastSquares, old: Sequence[Array], new: Sequence[Array]) -> tuple[Array, bool]:
    """Return the mean factor new / old of each component's sigmas, and whether it is one and the same for its rows."""
    logs = [np.log(new[c.measurements][:, c.columns] / old[c.measurements][:, c.columns]) for c in problem.components]
    middle = np.array([log.mean() for log in logs])
    spread = max(float(np.max(np.abs(log - m))) for log, m in zip(logs, middle, strict=True))
    return np.exp(middle), spread < NEGLIGIBLE_CHANGE_OF_SIGMA
