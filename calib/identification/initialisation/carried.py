"""Rows with the frames of the robot that they are about, before anything is known of bases and tools."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, BoolArray
from calib.measurement.measurements import Measurements


class Carried(NamedTuple):
    """The rows of a set, ``tips`` (N, 4, 4) in the base link, and the base in every link that carries targets of them.

    ``seats`` (N, 4, 4), by link.
    """

    data: Measurements
    tips: Array
    seats: Mapping[str, Array]

    @property
    def on_links(self) -> BoolArray:
        """Whether (N,) a row is about a target on a link."""
        return np.array([self.data.link_of(int(t)) is not None for t in self.data.target], dtype=np.bool_)

    def seen(self, bases: Array) -> Array:
        """Return the tips (N, 4, 4) in the instrument's frame, by ``bases`` (b, 4, 4), or in the link of the target."""
        placed = bases[self.data.setup]
        for link, seat in self.seats.items():
            own = [t for t, name in enumerate(self.data.targets) if self.data.target_links.get(name) == link]
            rows = np.isin(self.data.target, own)
            placed[rows] = seat[rows]
        return np.asarray(placed @ self.tips)

    def some(self, rows: BoolArray) -> "Carried":
        """Return some rows, by mask (N,)."""
        return Carried(self.data.subset(rows), self.tips[rows], {link: T[rows] for link, T in self.seats.items()})
