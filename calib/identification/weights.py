"""Weights of the rows: standard deviations from the instrument and from what the model cannot explain."""

from collections.abc import Sequence

import numpy as np

from calib.foundations.arrays import Array
from calib.identification.noise import model_variance
from calib.identification.system import Problem, residuals

NEGLIGIBLE_CHANGE_OF_SIGMA = 1e-3
# A perfect fit of noise-free data has no scatter at all; any positive number then weighs the rows alike.
_LEAST_SIGMA = 1e-15


def sigmas_of(problem: Problem, variances: Sequence[float]) -> tuple[Array, ...]:
    """Return the standard deviations (N, d) of every set: instrument and model part together, in m and rad.

    ``variances``: of the model part, one for each component of the problem, in m^2 or rad^2.
    """
    added = [np.zeros_like(data.sigma) for data in problem.measurements]
    for component, v in zip(problem.components, variances, strict=True):
        added[component.measurements][:, component.columns] = v
    return tuple(
        np.maximum(np.sqrt(data.sigma**2 + a), _LEAST_SIGMA)
        for data, a in zip(problem.measurements, added, strict=True)
    )


def mean_squares(problem: Problem, x: Array) -> tuple[float, ...]:
    """Return the mean squared residual of every component at parameter values x (p,)."""
    r = residuals(problem.model.robot, problem.measurements, problem.machine(x))
    return tuple(float(np.mean(r[c.measurements][:, c.columns] ** 2)) for c in problem.components)


def model_variances(problem: Problem, r: Sequence[Array], redundancies: Sequence[float]) -> tuple[float, ...]:
    """Return the model variance of every component from the residuals (N, d) of every set and degrees of freedom."""
    return tuple(
        model_variance(
            r[c.measurements][:, c.columns].ravel(),
            problem.measurements[c.measurements].sigma[:, c.columns].ravel(),
            redundancy,
        )
        for c, redundancy in zip(problem.components, redundancies, strict=True)
    )


def redundancies_of(problem: Problem, triangles: Sequence[Array], spread: Array) -> tuple[float, ...]:
    """Return the degrees of freedom of every component: its rows less those the parameters have used up.

    ``triangles``: whitened ``[J r]`` (q, p + 1) of each component; ``spread`` (p, all rows): from residuals to values.
    """
    found, start = [], 0
    for component, triangle in zip(problem.components, triangles, strict=True):
        used = float(np.sum(spread[:, start : start + len(triangle)] * triangle[:, :-1].T))
        start += len(triangle)
        found.append(problem.measurements[component.measurements].sigma[:, component.columns].size - used)
    return tuple(found)


def factors_of(problem: Problem, old: Sequence[Array], new: Sequence[Array]) -> tuple[Array, bool]:
    """Return the mean factor new / old of each component's sigmas, and whether it is one and the same for its rows."""
    logs = [np.log(new[c.measurements][:, c.columns] / old[c.measurements][:, c.columns]) for c in problem.components]
    middle = np.array([log.mean() for log in logs])
    spread = max(float(np.max(np.abs(log - m))) for log, m in zip(logs, middle, strict=True))
    return np.exp(middle), spread < NEGLIGIBLE_CHANGE_OF_SIGMA
