"""How bodies follow a temperature: late, as if through a first-order lag of an unknown time constant.

A casting at temperature w, beside a sensor that shows T, follows ``dw/dt = (T - w) / tau``. Between rows T changes
evenly, so that every step is exact. How late a row is depends on all rows before it, so that it is told of each row,
for a ladder of time constants; between these a cubic in their logarithm is taken, which is right to 1e-4 of the
changes of the temperature.
"""

import functools
from typing import TYPE_CHECKING

import numpy as np

from calib.foundations.arrays import Array, read_only

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

# In s: what follows faster does so at once, and what follows more slowly stays as it was for days.
FASTEST, SLOWEST = 10.0, 1e6
_RUNGS = 30
_LADDER = np.linspace(np.log(FASTEST), np.log(SLOWEST), _RUNGS)


def lagged(times: Array, temperature: Array) -> Array:
    """Return what bodies (N, rungs) have by times (N,) in s, in any order, of the temperature (N,) in degC.

    Before the first row all of them had its temperature for long.
    """
    taus, order = np.exp(_LADDER), np.argsort(times, kind="stable")
    t, T = times[order], temperature[order]
    found = np.empty((len(t), _RUNGS))
    now = np.full(_RUNGS, T[0] if len(T) else 0.0)
    for n in range(len(t)):
        if n and t[n] > t[n - 1]:
            behind = (T[n] - T[n - 1]) / (t[n] - t[n - 1]) * taus
            now = T[n] - behind + (now - T[n - 1] + behind) * np.exp(-(t[n] - t[n - 1]) / taus)
        found[n] = now
    back = np.empty_like(found)
    back[order] = found
    return read_only(back)


def rungs(tau: Array) -> tuple[Array, Array]:
    """Return the shares (rungs, k) of the ladder that time constants (k,) in s have, and their slopes by log tau.

    Beyond the ladder's ends nothing changes.
    """
    at = np.clip(np.log(tau), _LADDER[0], _LADDER[-1])
    inside = (np.log(tau) > _LADDER[0]) & (np.log(tau) < _LADDER[-1])
    cubic = _cubic()
    return np.asarray(cubic(at)).T, np.asarray(np.where(inside[:, None], cubic(at, nu=1), 0.0)).T


@functools.cache
def _cubic() -> "BSpline":
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - slow to load, and few machines warm up late

    return make_interp_spline(_LADDER, np.eye(_RUNGS))
