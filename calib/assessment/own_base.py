"""Does a table ask for a base of its own? Robot or instrument may have been moved before it was measured.

A base that is one for all, where there were two, leaves what a rigid motion of the measured points explains. Where they
are far apart, that tells it from an arm that is not as it was modelled: what a model leaves is a rigid motion locally.
"""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.chance import exceeded

# Sound tables, also of dense paths whose model error is common to neighbours, lose up to a third of their error when
# they are moved as a whole; where a base was moved, it was several times what is left.
_SMALLER = 0.5
# By chance in one of so many tables.
_HARDLY = 1e-6
# What nobody needs to correct, in m rms.
_FINE = 1e-6
_UNKNOWN = 6


class OwnBase(NamedTuple):
    """A table that asks for a base of its own: its position error as it is, and with one, in m rms.

    ``spread``: rms distance of its points from their middle, in m.
    """

    file: str
    error: float
    moved: float
    spread: float

    @property
    def sentence(self) -> str:
        """What to do about it."""
        return (
            f"{self.file} asks for a base of its own: moved as a whole, it would be predicted within "
            f"{self.moved * 1e3:.3g} mm rms in the place of {self.error * 1e3:.3g} mm. If robot or instrument was "
            'moved before it was measured, name its set-up (setup = "second").'
        )


def own_bases(tables: Iterable[tuple[str, Array, Array]]) -> Iterator[OwnBase]:
    """Yield the tables that ask for a base of their own, of files, measured positions (N, 3) and residuals (N, 3)."""
    for file, measured, residuals in tables:
        freedom = measured.size - _UNKNOWN
        if freedom <= _UNKNOWN:
            continue
        predicted = measured - residuals
        left = predicted - _moved(measured, predicted)
        before, after = float(np.sum(residuals**2)), float(np.sum(left**2))
        error, moved = np.sqrt(3.0 * before / measured.size), np.sqrt(3.0 * after / freedom)
        # F-distributed times its freedom, where nothing was moved.
        gained = (before - after) / max(after / freedom, np.finfo(float).tiny)
        if error > _FINE and moved < _SMALLER * error and float(exceeded(gained, _UNKNOWN, freedom)) < _HARDLY:
            spread = float(np.sqrt(np.mean(np.sum((measured - measured.mean(axis=0)) ** 2, axis=1))))
            yield OwnBase(file, float(error), float(moved), spread)


def _moved(x: Array, y: Array) -> Array:
    """Return points x (N, 3), moved as a whole to be nearest to y (N, 3)."""
    a, b = x - x.mean(axis=0), y - y.mean(axis=0)
    return np.asarray(a @ rigid.nearest_rotation(b.T @ a).T + y.mean(axis=0))
