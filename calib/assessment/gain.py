"""Are errors smaller than before - by more than chance makes them over different poses."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from calib.assessment.effects import memory
from calib.assessment.judged import JudgedSet
from calib.assessment.metrics import error_norms, metrics
from calib.foundations.arrays import Array
from calib.measurement.poses import ONE_POSE, both_ends


class Gain(NamedTuple):
    """By how much errors of one quantity are smaller: their rms ``before`` and ``after``, in its unit.

    ``t``: the mean logarithm of the ratio over its standard error, of so many degrees of ``freedom``; 0 of none.
    """

    before: float
    after: float
    t: float
    freedom: int

    def needed(self, probability: float) -> float:
        """Return the t that chance stays below with a probability."""
        return float(scipy.special.stdtrit(self.freedom, probability)) if self.freedom > 0 else float("inf")


def gain(judged: Sequence[JudgedSet], quantity: str) -> Gain:
    """Return how much smaller the errors of a quantity have become in tables, one or more of which have it.

    Ratios: where errors were large before, they have most to lose, and their mean would say less surely that they did.
    They are taken over stretches of rows that go together.
    """
    sets = [one for one in judged if len(one.data) and quantity in error_norms(one.data.kind, one.before)]
    before = metrics((one.data.kind, one.before) for one in sets)[quantity].rms
    after = metrics((one.data.kind, one.after) for one in sets)[quantity].rms
    x = np.concatenate([_ratios(one, quantity) for one in sets])
    if len(x) < 2:
        return Gain(before, after, 0.0, 0)
    t = float(np.mean(x)) / max(float(np.std(x, ddof=1)) / np.sqrt(len(x)), 1e-15)
    return Gain(before, after, t, len(x) - 1)


def _ratios(one: JudgedSet, quantity: str) -> Array:
    """Return logarithms of errors before over those after, means of stretches of poses in order of their rows."""
    before, after = (error_norms(one.data.kind, r)[quantity] for r in (one.before, one.after))
    cells = np.round(both_ends(one.data) / ONE_POSE)
    _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    squares = [np.bincount(cell.reshape(-1), weights=r**2)[order] for r in (before, after)]
    x = 0.5 * np.log(np.maximum(squares[0], 1e-24) / np.maximum(squares[1], 1e-24))
    length = min(1 + int(2.0 * memory([(x - x.mean())[:, None]])), max(len(x) // 4, 1))
    starts = np.arange(0, len(x) - length + 1, length)
    return np.asarray(np.add.reduceat(x[: starts[-1] + length], starts) / length)
