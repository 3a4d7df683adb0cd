"""Robust losses: rows that lie far off weigh less, as iteratively reweighted least squares.

A row counts as a whole: its distance is t = |r / sigma| / sqrt(d) over its d numbers, 1 for an ordinary row. The tuning
constants give 95 % of the efficiency of least squares for one normal number (P. J. Huber, Robust Statistics, 1981; for
Cauchy R. A. Maronna, R. D. Martin, V. J. Yohai, Robust Statistics, 2006; for soft L1 by quadrature, in the tests); for
more numbers they give more.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Literal, get_args

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.chance import density
from calib.foundations.errors import JobError
from calib.foundations.words import refuse_other

Loss = Literal["linear", "huber", "soft_l1", "cauchy"]
_TUNING = {"huber": 1.345, "soft_l1": 1.287, "cauchy": 2.385}


def refuse_losses(losses: Sequence[Loss] | None, sets: int) -> None:
    """Raise JobError for losses that are not one for each of the sets of measurements, or none that there is."""
    if losses is None:
        return
    if len(losses) != sets:
        raise JobError(f"{len(losses)} losses are given for {sets} sets of measurements.")
    for loss in losses:
        refuse_other(loss, get_args(Loss), "losses")


def weight(loss: Loss, t: Array) -> Array:
    """Return the weights, from 0 to 1, of rows at distances t >= 0."""
    if loss == "linear":
        return np.ones_like(t)
    u = t / _TUNING[loss]
    if loss == "huber":
        return np.asarray(1.0 / np.maximum(u, 1.0))
    return np.asarray(1.0 / np.sqrt(1.0 + u * u) if loss == "soft_l1" else 1.0 / (1.0 + u * u))


def squares(loss: Loss, t: Array) -> Array:
    """Return what rows at distances t >= 0 count as in the sum that is minimised, as t^2 does for an ordinary one.

    It is 2 times the integral of w(s) s from 0 to t.
    """
    if loss == "linear":
        return np.asarray(t * t)
    c = _TUNING[loss]
    u = t / c
    if loss == "huber":
        return np.asarray(c * c * np.where(u < 1.0, u * u, 2.0 * u - 1.0))
    return np.asarray(c * c * (2.0 * (np.sqrt(1.0 + u * u) - 1.0) if loss == "soft_l1" else np.log1p(u * u)))


def scatter_weight(loss: Loss, t: Array) -> Array:
    """Return the weights of squares in the estimate of the noise: no row adds more than a few ordinary ones do.

    Huber's second proposal: the squares of what the rows pull with, (w t)^2. For Cauchy rows that lie off pull less and
    less, so that a noise of nothing would explain them as well; w t^2 keeps growing, to a bound.
    """
    w = weight(loss, t)
    return w if loss == "cauchy" else w * w


@cache
def shrinkage(loss: Loss, d: int) -> float:
    """Return by how much these weights lessen the mean square of ordinary rows of d normal numbers."""
    return _mean_square(loss, d, scatter_weight)


@cache
def weighed_square(loss: Loss, d: int) -> float:
    """Return the mean square of ordinary rows of d normal numbers, as a fit weighs them: less than 1."""
    return _mean_square(loss, d, weight)


def _mean_square(loss: Loss, d: int, share: Callable[[Loss, Array], Array]) -> float:
    if loss == "linear":
        return 1.0

    from scipy import integrate  # noqa: PLC0415 - slow to load, and needed for robust losses alone

    def integrand(square: float) -> float:
        return float(share(loss, np.array(np.sqrt(square / d))) * square / d * density(square, d))

    return float(integrate.quad(integrand, 0.0, np.inf)[0])
