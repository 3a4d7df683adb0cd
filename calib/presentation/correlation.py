"""How the uncertainties of parameters go together."""

import numpy as np

from calib.foundations.arrays import Array, IntArray
from calib.identification.fit import Fit


def correlation(fit: Fit) -> tuple[IntArray, Array]:
    """Return which parameters (k,) are identifiable, by index, and the correlations (k, k) of their uncertainties."""
    seen = np.flatnonzero(~fit.unidentifiable & (np.diag(fit.covariance) > 0.0))
    C = fit.covariance[np.ix_(seen, seen)]
    sigma = np.sqrt(np.diag(C))
    return seen, np.asarray(C / np.outer(sigma, sigma))
