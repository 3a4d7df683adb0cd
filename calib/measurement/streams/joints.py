"""Joint readings at any time, from a controller's samples."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.brief import brief


@dataclass(frozen=True, slots=True, eq=False)
class JointStream:
    """Readings of joints ``names`` at any time, by cubics through samples, which are smooth to the second derivative.

    ``pieces``: one for every run of samples without a gap, with its ``starts`` and ``ends`` (m,) in s by the
    controller's clock. Between pieces nothing is known. ``absent``: joints without a column, which stay at 0;
    ``where``: the file.

    A cubic misses a motion of the frequency f and the amplitude a by about ``a (2 pi f h)^4 / 400`` for samples h
    apart: 1 Hz at 125 Hz by less than a hundred-thousandth of a per mille (C. de Boor, A Practical Guide to Splines).
    """

    __repr__ = brief

    names: tuple[str, ...]
    pieces: tuple[BSpline, ...]
    starts: Array
    ends: Array
    where: str
    absent: tuple[str, ...] = ()

    def at(self, times: Array) -> Array:
        """Return the readings (N, k) at times (N,) in s; a little beyond its end a piece goes on."""
        return self._evaluated(times, 0)

    def rates(self, times: Array) -> Array:
        """Return the rates (N, k) of the readings, per s, at times (N,): the exact derivative of :meth:`at`."""
        return self._evaluated(times, 1)

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
