"""Are errors smaller than before - by more than chance makes them over different poses."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import scipy

from calib.assessment.effects import memory
from calib.assessment.judged import JudgedSet
from calib.foundations.arrays import Array, IntArray
from calib.foundations.chance import bound
from calib.measurement.kinds import QUANTITIES
from calib.measurement.poses import ONE_POSE, both_ends

# A scatter that is rounding, of data without noise: of m, rad and px.
_ROUNDING = 1e-12


class Gain(NamedTuple):
    """By how much errors of one quantity are smaller: their rms ``before`` and ``after``, in its unit.

    ``changed``: the rms by which predictions changed. ``t``: how much of that change is in the larger of both errors,
    over its standard error by chance; below zero where errors have grown. ``freedom``: of so many numbers; 0 of none.
    """

    before: float
    after: float
    changed: float
    t: float
    freedom: int

    def needed(self, probability: float) -> float:
        """Return the t that chance stays below with a probability."""
        return float(scipy.special.stdtrit(self.freedom, probability)) if self.freedom > 0 else float("inf")


def gain(judged: Sequence[JudgedSet], quantity: str, passed_over: float = 0.0) -> Gain:
    """Return how much smaller the errors of a quantity have become in tables, one or more of which have it.

    ``passed_over``: the share of rows that lie farthest off, before as after, and do not count.

    Where errors before are noise alone, what a calibration changed is not in them; where it is, they go along it. Of
    the sizes of errors, row by row, little of that would show, as most of either is the noise that both share.
    """
    rows = list(_rows(judged, quantity, passed_over))
    before, after = (np.concatenate(of) for of in zip(*((b, a) for b, a, _ in rows), strict=True))
    rms = [float(np.sqrt(np.mean(np.sum(r**2, axis=1)))) if len(r) else 0.0 for r in (before, after, after - before)]
    smaller = rms[1] <= rms[0]
    large, small = (before, after) if smaller else (after, before)
    norms = np.linalg.norm(small, axis=1)
    usual = float(np.median(norms)) / np.sqrt(bound(0.5, small.shape[1])) if len(norms) else 0.0
    # What lies off by chance counts as little as what is told there.
    w = 1.0 / np.maximum(norms / np.sqrt(small.shape[1]), max(usual, _ROUNDING)) ** 2
    change = large - small
    along = w * np.sum(change * small, axis=1)
    stretch = _stretches([pose for *_, pose in rows], along)
    found, square = float(np.sum(w * np.sum(change * large, axis=1))), float(np.sum(w * np.sum(change**2, axis=1)))
    noise = float(np.sum(np.bincount(stretch, weights=along) ** 2))
    t = found / float(np.sqrt(max(noise, square))) if square > 0.0 else 0.0
    return Gain(rms[0], rms[1], rms[2], t if smaller else -t, max(len(np.unique(stretch)) - 1, 0))


def _rows(judged: Sequence[JudgedSet], quantity: str, passed_over: float) -> Iterator[tuple[Array, Array, Array]]:
    """Yield errors before and after (n, d) of every table that has the quantity, and its readings (n, k) as cells."""
    for one in judged:
        columns = next((q.columns for q in QUANTITIES[one.data.kind] if q.name == quantity), None)
        if columns is None or not len(one.data):
            continue
        before, after = one.before[:, columns], one.after[:, columns]
        least = np.minimum(np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1))
        kept = least <= np.quantile(least, 1.0 - passed_over)
        yield before[kept], after[kept], np.round(both_ends(one.data)[kept] / ONE_POSE)


def _stretches(tables: Sequence[Array], scores: Array) -> IntArray:
    """Return the number (N,) of every row's stretch of poses, longer than ``scores`` (N,) of rows remember."""
    found: list[IntArray] = []
    start = 0
    for cells in tables:
        _, first, pose = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        rank = np.argsort(np.argsort(first))[pose.reshape(-1)]
        sums = np.asarray(np.bincount(rank, weights=scores[start : start + len(cells)]), dtype=np.float64)
        length = min(1 + int(2.0 * memory([sums[:, None]])), max(len(sums) // 4, 1))
        # The last stretch is no shorter than the others.
        most = max(len(sums) // length - 1, 0)
        found.append(np.asarray(start + np.minimum(rank // length, most), dtype=np.intp))
        start += len(cells)
    return np.concatenate(found)
