"""Numbers in the order of time: how long they remember."""

import numpy as np

from calib.foundations.arrays import Array

# Autocorrelation counts while it is beyond chance by so many standard errors.
_BEYOND_CHANCE = 3.0


def correlation_time(r: Array, longest: int) -> float:
    """Return how many rows count as one: the integrated autocorrelation of rows (N, d), 1 where rows err alone.

    Up to ``longest`` rows, as far as it is beyond chance.
    """
    N, power = len(r), float(np.sum(r**2))
    found = 1.0
    if power > 0.0:
        for lag in range(1, min(longest, N // 4)):
            correlation = float(np.sum(r[lag:] * r[:-lag])) / power
            if correlation < _BEYOND_CHANCE / np.sqrt((N - lag) * r.shape[1]):
                break
            found += 2.0 * correlation
    return found
