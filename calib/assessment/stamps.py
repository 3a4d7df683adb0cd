"""Time stamps of streams that are not exact: rounded, as a file shows, or with jitter, as residuals show.

A stamp that is off by dt moves a row along its velocity v by ``v dt``. Whatever the machine leaves out does not grow
with the speed, so the variance of whitened residuals along the velocity, beyond that across it, is a line over v^2,

    E[(r^T v / |v|)^2 - |r across v|^2 / (d - 1)] = a + tau^2 v^2

whose slope is the variance of dt. Its standard error is that of sums over blocks of neighbours, as for effects.
Nothing else in a fit tells such noise from errors of the machine, whose stated uncertainty has it as one of its own.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import NamedTuple

import numpy as np

from calib.assessment.effects import memory, per_metre
from calib.assessment.judged import Check
from calib.assessment.stretches import Stretch
from calib.foundations.arrays import Array
from calib.foundations.units import MM, MS

# Standard errors by which stamps jitter, and the share of what remains that is then theirs, as a variance.
_SURE, _SHARE = 6.0, 0.25
# Checks to which rows that are off by their speed look like something else.
_ALIKE = frozenset({"jump", "outliers", "drift", "one machine"})
# Fewer blocks give no standard error.
_LEAST_BLOCKS = 8
# Times are compared in whole steps of so much, in s; their distances are multiples of the usual one but for this share.
# Longer ones than so many are pauses.
_FINEST, _OFF, _PAUSE = 1e-6, 0.05, 2.5


class Stamps(NamedTuple):
    """How stamps of a ``file`` are off: by ``off`` s (rms), which moves the tool by ``distance`` m (rms).

    ``share``: of the variance of what remains. ``step``, in s: to which they are rounded; 0 where they jitter.
    """

    file: str
    off: float
    distance: float
    share: float
    step: float

    @property
    def what(self) -> str:
        """What they are, without a full stop."""
        if self.step:
            return f"{self.file}: time stamps are rounded to {self.step / MS:.2g} ms"
        return f"{self.file}: time stamps, of measurements or readings, seem to jitter by {self.off / MS:.2g} ms"

    @property
    def sentence(self) -> str:
        """What a user should know of it."""
        cure = (
            "write more of their digits" if self.step else "take those that instrument and controller give themselves"
        )
        return (
            f"{self.what}, which puts the tool {self.distance / MM:.2g} mm off (rms) in motion: a good part of what "
            f"remains. The stated uncertainty has it as an error of the machine, which it is not: {cure}."
        )

    def named_in(self, check: Check) -> Check:
        """Return a check with the stamps in its sentence, where these may be what it found."""
        if check.passed or check.name not in _ALIKE:
            return check
        return replace(check, sentence=f"{check.sentence} But {self.what}, and that may be all there is to it.")


def stamps(parts: Sequence[Stretch], scalars: Array) -> tuple[Stamps, ...]:
    """Return the streams of which inexact stamps are a good part of what remains.

    ``scalars``: what was found of clocks. Velocities are means over some time: those of the moment are of readings
    whose stamps jitter.
    """
    found = []
    for part in parts:
        data = part.data
        if data.stream is None or not len(part.r):
            continue
        read = [data.reading_names.index(name) for name in part.joints]
        rates = data.stream.mean_rates(data.shifts(scalars), part.row.astype(np.intp))[:, read]
        by_rate = part.by_joint * rates[:, None, :]
        moved = by_rate.sum(axis=2)
        squares = np.sum(moved**2, axis=1)
        rest = max(float(np.mean(np.sum(part.r**2, axis=1))), part.least)
        joints = np.concatenate([np.unique(piece.t) for piece in data.stream.joints.pieces])
        # Only the tables of a fit are called as its job calls them.
        steps = [(PurePath(data.stream.joints.where).name, step_of(joints)), (data.where, step_of(data.stream.since))]
        told = [(file, step / np.sqrt(12.0), step) for file, step in steps if step > 0.0]
        for file, off, step in told or [(data.where, jitter(_in_time(part.r, by_rate), moved), 0.0)]:
            own = off**2 * float(np.mean(squares))
            distance = np.sqrt(own) / per_metre([part])
            found.append(Stamps(file, float(off), float(distance), own / rest, step))
    return tuple(one for one in found if one.share >= _SHARE)


def _in_time(r: Array, by_rate: Array) -> Array:
    """Return rows (n, d) less what is explained by each joint being late; ``by_rate`` (n, d, k): what it does in 1 s.

    A delay is no jitter, and another check names it.
    """
    D = by_rate.reshape(r.size, -1)
    return np.asarray(r - (D @ np.linalg.lstsq(D, r.ravel(), rcond=None)[0]).reshape(r.shape))


def jitter(r: Array, moved: Array) -> float:
    """Return by how many s (rms) stamps of rows r (n, d) jitter, ``moved`` (n, d) in a second; 0 where nothing says so.

    Both whitened.
    """
    d = r.shape[1]
    squares = np.sum(moved**2, axis=1)
    rows = np.flatnonzero(squares > 0.0)
    if d < 2 or len(rows) < _LEAST_BLOCKS:
        return 0.0
    r, moved, squares = r[rows], moved[rows], squares[rows]
    along = np.sum(r * moved, axis=1) ** 2 / squares
    more = along - (np.sum(r**2, axis=1) - along) / (d - 1)
    x = squares - squares.mean()
    if not x.any():
        return 0.0
    slope = float(x @ more) / float(x @ x)
    rest = more - more.mean() - slope * x
    length = 1 + int(np.ceil(2.0 * max(memory([r]), memory([rest[:, None]]))))
    sums = np.add.reduceat(x * rest, np.arange(0, len(rest), length))
    if len(sums) < _LEAST_BLOCKS:
        return 0.0
    sigma = float(np.sqrt(sums @ sums)) / float(x @ x)
    return float(np.sqrt(slope)) if slope > _SURE * sigma else 0.0


def step_of(times: Array) -> float:
    """Return the step in s to which times (n,) are rounded; 0 of a clock that ticks exactly, and of fine stamps."""
    apart = np.diff(np.rint((times - times[0]) / _FINEST).astype(np.int64))
    apart = apart[apart > 0]
    if not len(apart):
        return 0.0
    step, usual = int(np.gcd.reduce(apart)), float(np.median(apart))
    # Samples that were lost leave multiples of the usual distance, and a pause is as long as it is.
    multiple = apart[apart < _PAUSE * usual] / usual
    irregular = np.abs(multiple - np.rint(multiple)) > _OFF
    return step * _FINEST if step > _OFF * usual and np.count_nonzero(irregular) > 1 else 0.0
