"""Joint readings at any time, from a controller's samples."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray, read_only_view
from calib.foundations.brief import brief
from calib.foundations.sealing import sealed
from calib.foundations.units import Dimension

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

# Accelerations are means over so much, in s, to both sides: a motion of 1 Hz loses 1 %, and encoders that jitter by
# 1e-5 rad bring 0.01 rad/s^2.
SPAN = 0.05
# An encoder at rest jitters by less, in rad or m; a motion so small tells a fit nothing of its joint.
AT_REST = 1e-4
# From half of the samples, over twice as much, they differ by this share at most: by a motion of 3 Hz, or by noise.
_ALIKE = 0.2
# A joint that moves more slowly, in rad/s or m/s, does not show how late it is.
_SLOWEST = 1e-3
_TURN = 2.0 * np.pi


class Following(NamedTuple):
    """The following error of a ``joint``, actual minus commanded, in rad or m: its ``rms`` and the ``largest`` one.

    ``late``: by how many s the joint came late, 0 where it hardly moved; ``left``: the rms of what that leaves.
    """

    joint: str
    dimension: Dimension
    rms: float
    largest: float
    late: float
    left: float


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class JointStream:
    """Readings of joints ``names`` at any time, by cubics through samples, which are smooth to the second derivative.

    ``pieces``: one for every run of samples without a gap, with its ``starts`` and ``ends`` (m,) in s by the
    controller's clock. Between pieces nothing is known. ``absent``: joints without a column, which stay at 0;
    ``where``: the file. ``accelerates`` (k,): whether samples show how a joint does.
    ``following``: of joints whose commanded readings are known as well; ``commanded``: whether nothing else is known.

    A cubic misses a motion of the frequency f and the amplitude a by about ``a (2 pi f h)^4 / 400`` for samples h
    apart: 1 Hz at 125 Hz by less than a hundred-thousandth of a per mille (C. de Boor, A Practical Guide to Splines).
    """

    __repr__ = brief

    names: tuple[str, ...]
    pieces: "tuple[BSpline, ...]"
    starts: Array
    ends: Array
    where: str
    absent: tuple[str, ...] = ()
    accelerates: BoolArray | None = None
    following: tuple[Following, ...] = ()
    commanded: bool = False

    def at(self, times: Array) -> Array:
        """Return the readings (N, k) at times (N,) in s; a little beyond its end a piece goes on."""
        return self._evaluated(times, 0)

    def rates(self, times: Array) -> Array:
        """Return the rates (N, k) of the readings, per s, at times (N,): the exact derivative of :meth:`at`."""
        return self._evaluated(times, 1)

    def mean_rates(self, times: Array, span: float = SPAN) -> Array:
        """Return the mean rates (N, k) of the readings, per s, over ``span`` s to each side of times (N,).

        Errors of the readings at a time, which :meth:`rates` follows, have no part in them. Beyond its end a piece is
        left out.
        """
        piece = self._piece(times)
        after = np.minimum(times + span, np.maximum(self.ends[piece], times + 0.1 * span))
        before = np.maximum(times - span, np.minimum(self.starts[piece], times - 0.1 * span))
        return np.asarray((self.at(after) - self.at(before)) / (after - before)[:, None])

    def accelerations(self, times: Array, span: float = SPAN) -> Array:
        """Return accelerations (N, k) per s^2 at times (N,): weighted means over ``span`` s to each side.

        From three readings, ``(q(u + h) - 2 q(u) + q(u - h)) / h^2``: the second derivative of a spline would be that
        of noise. Where one of them is beyond a piece, those nearest stand for them; in a piece too short they are 0.
        """
        piece = self._piece(times)
        low, high = self.starts[piece] + span, self.ends[piece] - span
        middle = np.clip(times, low, np.maximum(low, high))
        found = (self.at(middle + span) - 2.0 * self.at(middle) + self.at(middle - span)) / span**2
        return np.where((low <= high)[:, None], found, 0.0)

    def showing(self, coarser: "JointStream") -> "JointStream":
        """Return the stream with ``accelerates``: where a ``coarser`` one, over twice the span, tells nearly the same.

        It does not where samples are too far apart for the motion, nor where noise is all that changes.
        """
        times = np.arange(coarser.starts[0] + 2.0 * SPAN, coarser.ends[0] - 2.0 * SPAN, SPAN)
        fine, coarse = self.accelerations(times), coarser.accelerations(times, 2.0 * SPAN)
        apart, whole = (np.linalg.norm(x, axis=0) for x in (coarse - fine, fine))
        return replace(self, accelerates=read_only_view((apart <= _ALIKE * whole) & (whole > 0.0)))

    def covers(self, times: Array, margin: float = 0.0) -> BoolArray:
        """Return which times (N,) are within a piece, ``margin`` s from its ends or more."""
        piece = self._piece(times)
        return np.asarray((times >= self.starts[piece] + margin) & (times <= self.ends[piece] - margin))

    def _piece(self, times: Array) -> IntArray:
        """Return the piece (N,) to which each time is nearest."""
        if len(self.pieces) == 1:
            return np.zeros(len(times), dtype=np.intp)
        between = 0.5 * (self.ends[:-1] + self.starts[1:])
        return np.searchsorted(between, times)

    def _evaluated(self, times: Array, derivative: int) -> Array:
        if len(self.pieces) == 1:
            return np.asarray(self.pieces[0](times, nu=derivative))
        piece, found = self._piece(times), np.empty((len(times), len(self.names)))
        for k in np.unique(piece):
            found[piece == k] = self.pieces[k](times[piece == k], nu=derivative)
        return found


def following(joints: Mapping[str, Dimension], actual: Array, commanded: Array, rates: Array) -> tuple[Following, ...]:
    """Return how joints followed, from actual and commanded readings (N, k), and ``rates`` (N, k) of the actual ones.

    A joint that is late by d is behind by d times its rate: d is the slope of a line through all samples.
    """
    found = []
    for (joint, dimension), behind, rate in zip(joints.items(), (actual - commanded).T, rates.T, strict=True):
        # Of angles, one may be told within a turn.
        error = behind - _TURN * np.round(behind / _TURN) if dimension == "angle" else behind
        centred, moving = error - error.mean(), rate - rate.mean()
        power = float(moving @ moving)
        late = -float(moving @ centred) / power if power > len(rate) * _SLOWEST**2 else 0.0
        rms, left = (float(np.sqrt(np.mean(e**2))) for e in (error, centred + late * moving))
        found.append(Following(joint, dimension, rms, float(np.abs(error).max()), late, left))
    return tuple(found)
