"""From a fit to all that is known of its doubts: noise, what is not seen, and what the model leaves out.

With whitened rows ``[J B r]`` of the data, B of what no parameter stands for (:mod:`calib.machine.systematic`), and
rows S of the priors, stated and weak, the solution x follows from the data by ``A = C J^T``, ``C = (J^T J + S^T
S)^-1``. Its error is ``C S^T`` times errors of the priors, ``A`` times noise, and ``A B`` times what is left out: a
sandwich of as many columns as parameters and waves, however many rows there are.

Rows that follow each other closely, as those of a stream, err together beyond all that. The autocorrelation of what is
left says how many rows count as one.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from calib.foundations.arrays import Array
from calib.foundations.linear import one_thread, triangle
from calib.identification import weights
from calib.identification.fit import Fit
from calib.identification.machine import Machine, values_at
from calib.identification.parameters import Parameter, scales
from calib.identification.set_up_motions import without
from calib.identification.system import Problem
from calib.identification.widths import NARROWEST, WIDEST, Rows, likelihood
from calib.machine.systematic import Systematic, usual_waves
from calib.machine.uncertainty import Waves

# Directions that the residuals must see, given sizes that are usual, before they may teach one: else it stays usual.
_FEWEST = 3.0
# Of a robust loss, rows that lie farther off count as ordinary ones.
_FAR = 2.0
# By how much sizes of waves differ, as a logarithm; how far they are sought, as noise is.
_ALIKE, _MOST_NOISE, _MOST_STEPS = 2.0, 1e3, 300
_OFF_ZERO = 0.5
# Autocorrelation counts while it is beyond chance by so many standard errors.
_BEYOND_CHANCE = 3.0
# Longest lag of it, in rows.
_LONGEST_LAG = 100
# Singular values below this share of the largest are rounding.
_SINGULAR = 1e-14


class Doubts(NamedTuple):
    """The error of a solution by its causes: columns (p, k) for errors of size 1, in parameter scales.

    ``instrument``: of noise and drift of the instrument; ``unseen``: of priors, stated and weak; ``scatter``: of what
    the model leaves out and looks like noise; ``waves``: of what follows the readings, as :class:`Waves` has it.
    ``noise`` (c,): of every component the size of all noise that looks random, as a share of what the fit took it for.
    """

    parameters: tuple[Parameter, ...]
    at: Machine
    instrument: Array
    unseen: Array
    scatter: Array
    waves: Array
    left_out: Waves
    noise: Array


def doubts_of(fit: Fit, identified: Array) -> Doubts:
    """Return the doubts of a fit, at the machine that it found; ``identified`` (nr, 2): least and greatest readings.

    What policy "minimal" held is among what is not seen.
    """
    with one_thread():
        return _doubts_of(fit, identified)


def _doubts_of(fit: Fit, identified: Array) -> Doubts:
    parameters = (*fit.parameters, *fit.held)
    problem = Problem(
        fit.model,
        parameters,
        fit.machine.frames,
        fit.measurements,
        fit.machine.deviations,
        fit.model.relations,
        fit.losses,
    )
    x = values_at(fit.model.robot, parameters, fit.machine.frames, fit.machine.deviations)
    at, units = problem.machine(x), scales(parameters)
    sigmas = _sigmas(fit, problem)
    evaluation = problem.evaluate(sigmas, x)
    waves = usual_waves(fit.model.robot, identified)
    systematic = Systematic(problem, at, sigmas, waves, units)
    p, m = len(parameters), systematic.count

    triangles = [np.zeros((0, p + m + 1)) for _ in problem.components]
    for c, rows in systematic.rows():
        triangles[c] = triangle(np.concatenate([triangles[c], rows]))
    lengths = np.cumsum([0, *map(len, triangles)])
    data = np.concatenate(triangles)
    known = np.concatenate([evaluation.relations[:, :p], np.diag([parameter.hold for parameter in parameters])])
    J = np.concatenate([data[:, :p], known])
    if evaluation.set_up_motions.size:
        J = without(J, evaluation.set_up_motions)
        J[len(data) :] = known
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    by_rows = (Vt.T / np.maximum(s, _SINGULAR * s[0])) @ U.T
    from_data, unseen = by_rows[:, : len(data)], by_rows[:, len(data) :]
    left = data[:, p:] - J[: len(data)] @ (from_data @ data[:, p:])

    # Cosine and sine of one order of one reading have one size; drifts have one.
    pairs = waves.width.size
    group = np.concatenate([np.repeat(np.arange(pairs), 2), np.full(m - waves.count, pairs)])
    instrument = np.array(
        [
            np.sqrt(np.mean((problem.measurements[c.measurements].sigma[:, c.columns] / sigmas[c.measurements][:, c.columns]) ** 2))
            for c in problem.components
        ]
    )
    parts = [slice(a, b) for a, b in zip(lengths, lengths[1:], strict=False)]
    freedom = np.array([max(noise.degrees_of_freedom, 1.0) for noise in fit.noise])

    def taught(rows_as_one: Array) -> tuple[Array, Array, Array]:
        """Return sizes (g,) and noise (c,), and the likeliest coefficients (m,)."""
        grams = np.stack([left[part].T @ left[part] for part in parts]) / rows_as_one[:, None, None]
        rows = Rows(
            grams,
            freedom / rows_as_one,
            np.zeros((m + 1, m + 1)),
            instrument,
            np.zeros(len(parts), dtype=bool),
            group.astype(np.intp),
        )
        sizes, noise = _sizes(rows, m > waves.count)
        hold = np.append(sizes[group] ** -2.0, 0.0)
        H = np.diag(hold) + np.tensordot(noise**-2.0, grams, 1)
        return sizes, noise, -np.linalg.solve(H[:m, :m], H[:m, m])

    rows_as_one = np.ones(len(parts))
    sizes, noise, found = taught(rows_as_one)
    # What the solution leaves when those errors are taken off: w, then x.
    coefficients = np.concatenate([-from_data @ (data[:, p:] @ np.append(found, 1.0)), found, [1.0]])
    counted = _rows_as_one(problem, systematic, coefficients)
    if np.any(counted > 1.0):
        rows_as_one = counted
        sizes, noise, _ = taught(rows_as_one)

    seen = np.minimum(instrument / noise, 1.0)
    bias = from_data @ data[:, p : p + m] * sizes[group]
    size = np.repeat(noise * np.sqrt(rows_as_one), np.diff(lengths))
    of_instrument = np.repeat(seen, np.diff(lengths))
    return Doubts(
        parameters,
        at,
        _short(np.hstack([from_data * size * of_instrument, bias[:, waves.count :]])),
        _short(unseen),
        _short(from_data * size * np.sqrt(1.0 - of_instrument**2)),
        bias[:, : waves.count],
        waves._replace(width=waves.width * sizes[:pairs].reshape(waves.width.shape)),
        noise,
    )


def _sigmas(fit: Fit, problem: Problem) -> tuple[Array, ...]:
    """Return the standard deviations (N, d) of every set, by which no row that lies off tells more than others do."""
    found = weights.sigmas_of(problem, [noise.model**2 for noise in fit.noise], fit.residuals, search=True)
    if not problem.robust:
        return found
    far = [np.sqrt(np.mean((r / sigma) ** 2, axis=1)) for r, sigma in zip(fit.residuals, found, strict=True)]
    return tuple(sigma * np.where(t > _FAR, t, 1.0)[:, None] for sigma, t in zip(found, far, strict=True))


def _sizes(rows: Rows, drifts: bool) -> tuple[Array, Array]:
    """Return the likeliest sizes (g,) of what is left out, in usual ones, and of the noise (c,).

    ``rows.group``: number of every wave, and one more where an instrument may drift. Waves have sizes of their own, but
    are expected to be alike: their logarithms scatter by ``_ALIKE`` about a common one. As in
    :mod:`calib.identification.widths` the likelihood is multiplied by the common size, and by that of the drift, so
    that nothing is said to be zero because it does not show.
    """
    g, c = int(rows.group.max()) + 1, len(rows.counts)
    usual, ones = np.ones(g), np.ones(c)
    if np.sum(likelihood(rows, usual, ones).gamma) < _FEWEST:
        return usual, ones
    waves = g - 1 if drifts else g

    def cost(theta: Array) -> tuple[float, Array]:
        found = likelihood(rows, np.exp(theta[:g]), np.exp(theta[g:]))
        slopes = np.concatenate([found.by_widths, found.by_factors])
        apart = theta[:waves] - np.mean(theta[:waves])
        slopes[:waves] += 2.0 * apart / _ALIKE**2 - _OFF_ZERO / waves
        slopes[waves:g] -= _OFF_ZERO
        held = np.sum(apart**2) / _ALIKE**2 - _OFF_ZERO * (np.mean(theta[:waves]) + np.sum(theta[waves:g]))
        return found.value + float(held), slopes

    low = np.clip(rows.least, 1.0 / _MOST_NOISE, 1.0)
    bounds = np.log(np.concatenate([np.tile([[NARROWEST, WIDEST]], (g, 1)), np.column_stack([low, np.full(c, _MOST_NOISE)])]))
    result = minimize(
        cost, np.zeros(g + c), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": _MOST_STEPS, "gtol": 1e-4}
    )
    return np.exp(result.x[:g]), np.exp(result.x[g:])


def _rows_as_one(problem: Problem, systematic: Systematic, coefficients: Array) -> Array:
    """Return how many rows of every component (c,) count as one, by the autocorrelation of what is left."""
    left: list[list[Array]] = [[] for _ in problem.components]
    for c, rows in systematic.rows():
        columns = problem.components[c].columns
        left[c].append((rows @ coefficients).reshape(-1, len(range(*columns.indices(problem.measurements[problem.components[c].measurements].sigma.shape[1])))))
    return np.array([_correlation_time(np.concatenate(blocks)) for blocks in left])


def _correlation_time(r: Array) -> float:
    """Return the integrated autocorrelation of rows (N, d): 1 where rows err alone."""
    N, power = len(r), float(np.sum(r**2))
    found = 1.0
    if power > 0.0:
        for lag in range(1, min(_LONGEST_LAG, N // 4)):
            correlation = float(np.sum(r[lag:] * r[:-lag])) / power
            if correlation < _BEYOND_CHANCE / np.sqrt((N - lag) * r.shape[1]):
                break
            found += 2.0 * correlation
    return found


def _short(columns: Array) -> Array:
    """Return as few columns with the same covariance."""
    return triangle(columns.T).T
