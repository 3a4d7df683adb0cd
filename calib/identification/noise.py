"""How large is the noise? The instrument's part is stated, the model's part is estimated from the residuals.

A calibrated model never explains a machine to the last digit, so the scatter of its residuals is more than the
instrument's: ``sigma^2 = instrument^2 + model^2``. The model part is estimated for every component (one quantity in one
set of measurements) by restricted maximum likelihood, so that the parameters the fit has used up are accounted for.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.foundations.arrays import Array

# Newton's steps, as a share of the variance: after one this small nothing is left but rounding.
_LAST_STEP, _MOST_STEPS = 1e-12, 100
# Residuals are clearly more than the instrument's noise when that leaves as many so rarely: not once in as many fits
# as anybody makes.
RARELY = 1e-6


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of one component: rms of the instrument's sigmas and sigma of the model part, in m, rad or px.

    ``chi_square`` is the sum of squared residuals over the instrument's variances alone, per degree of freedom: 1 where
    the instrument explains the residuals; nan where the instrument's noise is not known.
    """

    measurements: int
    quantity: str
    instrument: float
    model: float
    degrees_of_freedom: float
    chi_square: float

    @property
    def total(self) -> float:
        """Standard deviation of one residual component, in m, rad or px."""
        return float(np.hypot(self.instrument, self.model))

    def by_poses(self, alone: float, common: float, again: int) -> "Noise":
        """Return it where rows err by ``alone``, and all rows of a pose by ``common``, in units of the noise.

        ``again``: how many of the numbers are of poses that other rows tell of already.
        """
        whole = alone**2 + common**2
        return replace(
            self,
            model=float(np.sqrt(max(whole - self.instrument**2, 0.0))),
            degrees_of_freedom=max(self.degrees_of_freedom - again, 1.0),
            chi_square=float("nan") if np.isnan(self.chi_square) else whole / self.instrument**2,
        )


def noise_of(
    measurements: int, quantity: str, residuals: Array, instrument: Array, variance: float, degrees_of_freedom: float
) -> Noise:
    """Return the noise of a component from its residuals (n,), instrument sigmas (n,) and model variance."""
    known = bool(np.all(instrument > 0.0)) and degrees_of_freedom > 0.0
    return Noise(
        measurements,
        quantity,
        float(np.sqrt(np.mean(instrument**2))),
        float(np.sqrt(variance)),
        degrees_of_freedom,
        float(np.sum((residuals / instrument) ** 2)) / degrees_of_freedom if known else float("nan"),
    )


def model_variance(residuals: Array, instrument: Array, degrees_of_freedom: float, *, clearly: bool = False) -> float:
    """Return the v >= 0 with ``sum r^2 / (instrument^2 + v) = degrees_of_freedom``, 0 when the instrument suffices.

    ``residuals`` (n,) and ``instrument`` (n,) in the same unit; this is the REML equation for given weights.
    ``clearly``: the instrument suffices, too, where its noise leaves such residuals more than once in a million times.
    """
    squares, variances = residuals**2, instrument**2
    if degrees_of_freedom <= 0.0:
        return 0.0
    mean = float(squares.sum()) / degrees_of_freedom
    if mean == 0.0 or np.all(variances == 0.0):
        return mean
    with np.errstate(divide="ignore", invalid="ignore"):
        at_zero = np.nansum(squares / variances)
    # Far below one degree of freedom nearly all of chi-square is at zero, and its quantile less than its mean.
    if at_zero <= (scipy.special.chdtri(max(degrees_of_freedom, 1.0), RARELY) if clearly else degrees_of_freedom):
        return 0.0
    # The unknown is u = v / mean. 1 / sum grows with u and bends down, so that Newton's steps from below stay below.
    squares, variances, u = squares / mean, variances / mean, 0.0 if np.isfinite(at_zero) else _LAST_STEP
    for _ in range(_MOST_STEPS):
        shares = squares / (variances + u)
        total = float(shares.sum())
        step = (total / degrees_of_freedom - 1.0) * total / float((shares / (variances + u)).sum())
        u += step
        if step <= _LAST_STEP:
            break
    return mean * u
