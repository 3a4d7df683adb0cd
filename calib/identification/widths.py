"""How wide are priors? As wide as the data say: the widths of the largest marginal likelihood.

The parameters of one group are taken as drawn from one normal distribution about zero, of unknown width w. Near the fit
all is linear, so that the likelihood of the data, parameters integrated out, is known in closed form. Its slope by the
logarithm of a width is ``sum x^2 / w^2 - gamma``, where ``gamma = n - tr(C) / w^2`` counts how many of the group's n
parameters the data have determined rather than the prior, and C is their posterior covariance (D. J. C. MacKay,
*Bayesian interpolation*, Neural Computation 4, 1992, 4.4): at its top ``w^2 = sum x^2 / gamma``. A direction that the
data do not see adds nothing to the sum and nothing to gamma, so that no width is taken from it.

The sigmas of the noise are found together with the widths, as each decides what is left for the other. Parameters
without a learned prior are integrated out as well, which makes this a restricted likelihood.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from calib.foundations.arrays import Array, IntArray

# From a thousandth to a thousand ordinary deviations: an amount of the one shows nowhere, the other holds nothing.
NARROWEST, WIDEST = 1e-3, 1e3
# A component's noise may come out so many times larger than the fit has found it, or smaller.
_MOST_NOISE = 1e3
# Normal equations hold half of a double's digits: noise below this share of the best seen parameter does not count.
_LARGEST_INFORMATION = 1e13
_MOST_STEPS = 300


class Rows(NamedTuple):
    """Linear equations ``r + J z`` of all data, about z = 0, where learned priors have their means.

    ``grams`` (c, p + 1, p + 1): of ``[J r]`` of every component, whitened; ``counts`` (c,): its rows. ``known`` (p + 1,
    p + 1): of all that is known beside these. ``least`` (c,): factors below which a component's sigmas cannot fall, as
    the instrument has that noise; ``fixed`` (c,): its sigmas are given. ``group`` (p,): number of the group whose width
    is learned, -1 for none.
    """

    grams: Array
    counts: Array
    known: Array
    least: Array
    fixed: Array
    group: IntArray


class Likelihood(NamedTuple):
    """-2 log likelihood, its slopes by the logarithms of widths (g,) and factors (c,), and ``gamma`` (g,)."""

    value: float
    by_widths: Array
    by_factors: Array
    gamma: Array


def likelihood(rows: Rows, widths: Array, factors: Array) -> Likelihood:
    """Return the marginal likelihood for widths (g,) of the groups and factors (c,) of the components' sigmas."""
    p = len(rows.group)
    own = rows.group >= 0
    hold = np.append(widths**-2.0, 0.0)[rows.group]
    gram = rows.known + np.tensordot(factors**-2.0, rows.grams, 1)
    H, b = gram[:p, :p].copy(), gram[:p, p]
    H[range(p), range(p)] += hold
    lower = cho_factor(H, lower=True)
    C = cho_solve(lower, np.eye(p))
    x = np.append(-C @ b, 1.0)
    count = np.bincount(rows.group[own], minlength=len(widths))

    def sums(values: Array) -> Array:
        return np.asarray(np.bincount(rows.group[own], weights=(values * hold)[own], minlength=len(widths)))

    gamma = count - sums(np.diag(C))
    # The sum of squares at its least, in a form that is not negative by rounding: x and what holds it, each by itself.
    value = float(x @ gram @ x + np.sum(x[:p] ** 2 * hold) + 2.0 * np.sum(np.log(np.diag(lower[0]))))
    value += float(2.0 * count @ np.log(widths) + 2.0 * rows.counts @ np.log(factors))
    used = np.array([(np.sum(C * g[:p, :p]) + x @ g @ x) for g in rows.grams]) / factors**2
    return Likelihood(value, 2.0 * (gamma - sums(x[:p] ** 2)), 2.0 * (rows.counts - used), gamma)


def likeliest(rows: Rows, start: Array) -> tuple[Array, Array, Array]:
    """Return widths (g,) and factors (c,) of the largest likelihood, and gamma (g,); ``start`` (g,): widths to begin.

    In units of the columns of the rows; widths lie within ``NARROWEST`` and ``WIDEST``.
    """
    g, p = len(start), len(rows.group)
    informed = rows.grams[:, range(p), range(p)].max(axis=1)
    least = np.maximum(rows.least, np.sqrt(informed / _LARGEST_INFORMATION))
    low = np.where(rows.fixed, 1.0, np.minimum(np.maximum(least, 1.0 / _MOST_NOISE), _MOST_NOISE))
    high = np.where(rows.fixed, 1.0, _MOST_NOISE)

    def cost(theta: Array) -> tuple[float, Array]:
        found = likelihood(rows, np.exp(theta[:g]), np.exp(theta[g:]))
        return found.value, np.concatenate([found.by_widths, found.by_factors])

    bounds = np.log(np.concatenate([np.tile([[NARROWEST, WIDEST]], (g, 1)), np.column_stack([low, high])]))
    result = minimize(
        cost,
        np.clip(np.log(np.concatenate([start, np.ones(len(low))])), bounds[:, 0], bounds[:, 1]),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": _MOST_STEPS, "ftol": 1e-13, "gtol": 1e-4},
    )
    widths, factors = np.exp(result.x[:g]), np.exp(result.x[g:])
    return widths, factors, likelihood(rows, widths, factors).gamma
