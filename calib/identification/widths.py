"""How wide are priors? As wide as the data say: the widths of the largest marginal likelihood.

The parameters of one group are taken as drawn from one normal distribution about zero, of unknown width w. Near the fit
all is linear, so that the likelihood of the data, parameters integrated out, is known in closed form. Its slope by the
logarithm of a width is ``sum x^2 / w^2 - gamma``, where ``gamma = n - tr(C) / w^2`` counts how many of the group's n
parameters the data have determined rather than the prior, and C is their posterior covariance (D. J. C. MacKay,
*Bayesian interpolation*, Neural Computation 4, 1992, 4.4). A direction that the data do not see adds nothing to the sum
and nothing to gamma, so that no width is taken from it.

Where little shows, the likelihood is often largest at width zero, and coefficients that are there would be said to be
none with certainty. So the likelihood is multiplied by a power of w for every group, which keeps widths off zero and is
hardly felt elsewhere (Y. Chung, S. Rabe-Hesketh, V. Dorie, A. Gelman, J. Liu, *A nondegenerate penalized likelihood
estimator for variance parameters in multilevel models*, Psychometrika 78, 2013, with the power 1). With w^2 the top is
``w^2 = sum x^2 / (gamma - 2)``. That is the variance of Student's distribution, which what does not show follows if n
directions show of the group: on average of squares it is as far off as w, of however few w is learned.

A group of which too few directions show keeps a usual width u, but is widened where even these few are farther off:
``w^2 = (sum x^2 + u^2) / (gamma + 1)``, and no less than u^2. It is the top if the likelihood is multiplied by
``exp(-u^2 / (2 w^2)) / w``, a gamma distribution of ``1 / w^2`` of mean ``1 / u^2``.

The sigmas of the noise are found together with the widths, as each decides what is left for the other. Parameters
without a learned prior are integrated out as well, which makes this a restricted likelihood.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy

from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.errors import IdentificationError

# From a thousandth to a hundred parameter scales: a coefficient with the narrowest does not show, the widest is no
# prior.
NARROWEST, WIDEST = 1e-3, 1e2
# The power of widths by which the likelihood is multiplied.
POWER = 2.0
# A component's noise may come out so many times larger than the fit has found it, or smaller; by less where a search
# has tried a noise so small that the equations are singular by rounding.
_MOST_NOISE = 1e3
_LESS_NOISE = (_MOST_NOISE, 30.0, 3.0)
_MOST_STEPS = 300
_MOST_TURNS = 20
_SETTLED = 1e-4
# The largest product of a column with itself, beside the widest prior's.
_MOST_INFORMATION = 1e10
# A tenth of the rows moves widths by little.
_FEW_TURNS = 3
# Of equations that are singular by rounding: products of sigmas in them span more than a double's digits.
TOO_UNLIKE = (
    "the sigmas of rows, priors and relations differ by too much to be weighed together where terms are chosen or "
    "widths of priors learned: state none that is far smaller than others."
)
# Where a search ends: SciPy's own.
_ENOUGH = 1e7 * float(np.finfo(float).eps)


class NormalEquations(NamedTuple):
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
    fixed: BoolArray
    group: IntArray

    @classmethod
    def weighed(
        cls, grams: Array, counts: Array, known: Array, least: Array, fixed: BoolArray, group: IntArray
    ) -> "NormalEquations":
        """Return them for rows with no less noise than a double can weigh beside the widest prior.

        Normal equations hold half of its digits. Rows with less noise, a fraction of a micrometre, or none at all, are
        taken to have so much.
        """
        p = len(group)
        finest = np.sqrt(grams[:, range(p), range(p)].max(axis=1) / _MOST_INFORMATION)
        coarser = np.maximum(finest, 1.0)
        least = np.maximum(least, finest) / coarser
        return cls(grams / coarser[:, None, None] ** 2, counts, known, least, fixed, group)


class Likelihood(NamedTuple):
    """-2 log likelihood, its slopes by the logarithms of widths (g,) and factors (c,), and ``gamma`` (g,).

    ``z`` (p,): the likeliest parameters.
    """

    value: float
    by_widths: Array
    by_factors: Array
    gamma: Array
    z: Array


class Widths(NamedTuple):
    """Widths (g,) of the groups, in units of the columns; factors (c,) of the sigmas; ``gamma`` (g,) that taught.

    ``shown`` (g,): whether the data are likelier with the group than without it.
    """

    widths: Array
    factors: Array
    gamma: Array
    shown: BoolArray


class _Held(NamedTuple):
    """What is known of widths beside the data: the likelihood is multiplied by ``w^power exp(-assumed / (2 w^2))``.

    ``power``, ``assumed`` and ``least``, the narrowest: of every group (g,).
    """

    power: Array
    assumed: Array
    least: Array

    @classmethod
    def of(cls, power: float, usual: Array) -> "_Held":
        """Return it for groups of which some keep a ``usual`` width (g,), zero for those that the data teach."""
        return cls(np.where(usual > 0.0, -1.0, power), usual**2, np.where(usual > 0.0, usual, NARROWEST))

    def adds(self, logs: Array) -> tuple[float, Array]:
        """Return what it adds to -2 log likelihood for logarithms of widths (g,), and its slopes (g,)."""
        assumed = self.assumed * np.exp(-2.0 * logs)
        return float(np.sum(assumed - 2.0 * self.power * logs)), -2.0 * (assumed + self.power)

    def turned(self, found: Likelihood, widths: Array) -> Array:
        """Return widths (g,) at which slopes would vanish if the parameters stayed."""
        squares = found.gamma - 0.5 * found.by_widths + self.assumed / widths**2
        left = found.gamma - self.power
        turned = np.where(left > 0.0, widths * np.sqrt(squares / np.maximum(left, 1e-9)), widths)
        return np.asarray(np.clip(turned, self.least, WIDEST))


def likelihood(rows: NormalEquations, widths: Array, factors: Array) -> Likelihood:
    """Return the marginal likelihood for widths (g,) of the groups and factors (c,) of the components' sigmas.

    Raises IdentificationError where the equations are singular.
    """
    p = len(rows.group)
    own = rows.group >= 0
    hold = np.append(widths**-2.0, 0.0)[rows.group]
    gram = rows.known + np.tensordot(factors**-2.0, rows.grams, 1)
    H, b = gram[:p, :p].copy(), gram[:p, p]
    H[range(p), range(p)] += hold
    try:
        lower = scipy.linalg.cholesky(H, lower=True)
    except np.linalg.LinAlgError as e:
        raise IdentificationError(TOO_UNLIKE) from e
    # The lower triangle of the covariance, by rows of its transpose; more of it is not needed, and takes longer.
    C = scipy.linalg.lapack.dpotri(lower, lower=1)[0].T
    diagonal = np.diag(C)
    x = np.append(-scipy.linalg.cho_solve((lower, True), b), 1.0)
    count = np.bincount(rows.group[own], minlength=len(widths))

    def sums(values: Array) -> Array:
        return np.asarray(np.bincount(rows.group[own], weights=(values * hold)[own], minlength=len(widths)))

    gamma = count - sums(diagonal)
    # The sum of squares at its least, in a form that is not negative by rounding: x and what holds it, each by itself.
    value = float(x @ gram @ x + np.sum(x[:p] ** 2 * hold) + 2.0 * np.sum(np.log(np.diag(lower))))
    value += float(2.0 * count @ np.log(widths) + 2.0 * rows.counts @ np.log(factors))
    # Traces of products with the covariance, of which one triangle is there, and the sum of squares: in one pass.
    weights = np.outer(x, x)
    weights[:p, :p] += 2.0 * C
    weights[range(p), range(p)] -= diagonal
    used = rows.grams.reshape(len(rows.grams), -1) @ weights.ravel() / factors**2
    return Likelihood(value, 2.0 * (gamma - sums(x[:p] ** 2)), 2.0 * (rows.counts - used), gamma, x[:p])


def searched(
    rows: NormalEquations,
    start: Array,
    held: Callable[[Array], tuple[float, Array]],
    ftol: float = _ENOUGH,
    least: Array | None = None,
) -> tuple[Array, Array]:
    """Return the likeliest widths (g,), from ``start`` (g,) on, and factors (c,).

    ``held``: what more is known of widths, as a function of their logarithms (g,): what it adds to -2 log likelihood,
    with its slopes (g,). ``least`` (g,): the narrowest. Raises IdentificationError where the equations are singular.
    """
    for times in _LESS_NOISE[:-1]:
        try:
            return _searched(rows, start, held, ftol, least, times)
        except IdentificationError:
            continue
    return _searched(rows, start, held, ftol, least, _LESS_NOISE[-1])


def _searched(
    rows: NormalEquations,
    start: Array,
    held: Callable[[Array], tuple[float, Array]],
    ftol: float,
    least: Array | None,
    times: float,
) -> tuple[Array, Array]:
    """Return what :func:`searched` does, of a noise that is at most so many ``times`` smaller."""
    g = len(start)
    low = np.where(rows.fixed, 1.0, np.clip(rows.least, 1.0 / times, 1.0))
    high = np.where(rows.fixed, 1.0, _MOST_NOISE)

    def cost(theta: Array) -> tuple[float, Array]:
        found, (more, slopes) = likelihood(rows, np.exp(theta[:g]), np.exp(theta[g:])), held(theta[:g])
        return found.value + more, np.concatenate([found.by_widths + slopes, found.by_factors])

    narrowest = np.full(g, NARROWEST) if least is None else least
    of_widths = np.column_stack([narrowest, np.full(g, WIDEST)])
    bounds = np.log(np.concatenate([of_widths, np.column_stack([low, high])]))
    result = scipy.optimize.minimize(
        cost,
        np.clip(np.log(np.concatenate([start, np.ones(len(low))])), bounds[:, 0], bounds[:, 1]),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": _MOST_STEPS, "ftol": ftol, "gtol": 1e-4},
    )
    return np.exp(result.x[:g]), np.exp(result.x[g:])


def likeliest_widths(rows: NormalEquations, start: Array, power: float = POWER, usual: Array | None = None) -> Widths:
    """Return the widths of the largest likelihood times a ``power`` of widths; ``start`` (g,): those to begin with.

    ``usual`` (g,): usual widths of groups of which too little shows, which keep these unless they are farther off; zero
    for others.
    """
    held = _Held.of(power, np.zeros(len(start)) if usual is None else usual)
    widths, factors = searched(rows, start, held.adds, ftol=1e-13, least=held.least)
    found = likelihood(rows, widths, factors)
    # Where there is hardly any noise, rounding in the likelihood ends the search early; its slopes know better.
    for _ in range(_MOST_TURNS):
        turned = held.turned(found, widths)
        change, widths = float(np.max(np.abs(np.log(turned / widths)))), turned
        found = likelihood(rows, widths, factors)
        if change < _SETTLED:
            break
    without = np.where(np.eye(len(start), dtype=bool), NARROWEST, widths)
    shown = np.array([likelihood(rows, narrow, factors).value > found.value for narrow in without], dtype=bool)
    return Widths(widths, factors, found.gamma, shown)


def nearby(rows: NormalEquations, widths: Array, factors: Array, usual: Array) -> Array:
    """Return the parameters (p,) of the likeliest widths (g,) and factors (c,), near those of almost the same rows.

    ``usual`` (g,): as of :func:`likeliest_widths`.
    """
    found, held = likelihood(rows, widths, factors), _Held.of(POWER, usual)
    for _ in range(_FEW_TURNS):
        widths = held.turned(found, widths)
        explained = factors * np.sqrt(np.maximum(1.0 - 0.5 * found.by_factors / rows.counts, 0.0))
        factors = np.where(rows.fixed, 1.0, np.clip(explained, np.minimum(rows.least, 1.0), _MOST_NOISE))
        found = likelihood(rows, widths, factors)
    return found.z
