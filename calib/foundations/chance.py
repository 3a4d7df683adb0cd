"""How probable squares of normal numbers are: chi-squared, and F where the noise was itself estimated.

By scipy.special: to load scipy.stats takes longer than most commands take for all else.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
import scipy

from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import JobError

# Autocorrelation counts while it is beyond chance by so many standard errors.
_BEYOND_CHANCE = 3.0


def drawing(seed: int) -> np.random.Generator:
    """Return what draws random numbers, the same ones for a seed again. Raises JobError for a negative one."""
    if seed < 0:
        raise JobError(f"seed is {seed}; allowed is 0 or more.")
    return np.random.default_rng(seed)


def exceeded(square: npt.ArrayLike, numbers: IntArray | int, freedom: npt.ArrayLike = np.inf) -> Array:
    """Return how probable it is that so many normal numbers, one or more, have a larger sum of squares.

    Of noise 1, or of a noise that was estimated with ``freedom`` degrees of freedom, infinite where it is known.
    """
    square = np.maximum(square, 0.0)  # rounding
    known = np.isinf(freedom)
    by_estimate = scipy.special.fdtrc(numbers, np.where(known, 1.0, freedom), square / numbers)
    return np.asarray(np.where(known, scipy.special.chdtrc(numbers, square), by_estimate))


def bound(probability: float, numbers: int, freedom: float = np.inf) -> float:
    """Return the sum of squares that so many normal numbers stay below with a probability; else as :func:`exceeded`."""
    if np.isinf(freedom):
        return 2.0 * float(scipy.special.gammaincinv(0.5 * numbers, probability))
    return numbers * float(scipy.special.fdtri(numbers, freedom, probability))


def density(square: float, numbers: int) -> float:
    """Return the density of the sum of squares of so many normal numbers."""
    half = 0.5 * numbers
    return float(
        np.exp((half - 1.0) * np.log(square) - 0.5 * square - scipy.special.gammaln(half) - half * np.log(2.0))
    )


def shown_noise(residuals: Array, spare: int, stated: float | None) -> float:
    """Return the standard deviation of a number: as stated, or as residuals show it with some numbers to ``spare``."""
    if stated is not None:
        return stated
    return float(np.sqrt(np.sum(residuals**2) / spare)) if spare > 0 else float("nan")


def autocorrelations(parts: Sequence[Array], most: int) -> Iterator[float]:
    """Yield how rows of parts (n, d), of mean zero, go with those one, two, ... rows before, below ``most`` rows.

    Nothing where all are zero.
    """
    square = sum(float(np.sum(r * r)) for r in parts)
    if square > 0.0:
        for lag in range(1, most):
            yield sum(float(np.sum(r[lag:] * r[:-lag])) for r in parts if len(r) > lag) / square


def correlation_time(r: Array, longest: int) -> float:
    """Return how many rows (N, d) count as one, 1 where rows err alone: the integrated autocorrelation.

    Up to ``longest`` rows, as far as it is beyond chance.
    """
    (N, d), found = r.shape, 1.0
    for lag, correlation in enumerate(autocorrelations([r], min(longest, N // 4)), 1):
        if correlation < _BEYOND_CHANCE / np.sqrt((N - lag) * d):
            break
        found += 2.0 * correlation
    return found
