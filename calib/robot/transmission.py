"""What lies between a motor and its joint: gain, harmonics, wind-up; each linear in its amount.

A reading u becomes the joint coordinate ``u + sum_t amount_t basis_t(row)``, which the coupling then carries on to the
joints. The bases depend on the row alone and not on what is identified, so that derivatives by the amounts are exact:

    gain     u                         the reading's scale
    cos_k    cos k u,  sin_k  sin k u  encoder eccentricity (k = 1, 2), gear teeth and wave generators (more)
    elastic  -tau                      the drive gives way to what it holds against gravity, at nominal geometry
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.foundations.arrays import Array

TermKind = Literal["gain", "cos", "sin", "elastic"]
TermUnit = Literal["rad", "1", "rad/Nm", "m/N"]


@dataclass(frozen=True, slots=True)
class JointTerm:
    """One term of one reading. ``order``: periods of a harmonic in a turn of the reading, 0 for all other kinds."""

    reading: str
    kind: TermKind
    order: int = 0

    @property
    def name(self) -> str:
        """Name of its amount among parameters: ``joint_2.gain``, ``joint_2.cos_1``, ``joint_2.elastic``."""
        return f"{self.reading}.{self.kind}_{self.order}" if self.order else f"{self.reading}.{self.kind}"

    def unit(self, dimension: Literal["angle", "length"]) -> TermUnit:
        """Return the unit of its amount, for a reading of this dimension."""
        if self.kind == "elastic":
            return "rad/Nm" if dimension == "angle" else "m/N"
        return "1" if self.kind == "gain" else "rad"


class Transmission:
    """The terms of a robot with given amounts (nt,).

    ``holding``: what readings (N, nr) hold against gravity (N, nr); asked where a joint gives way.
    """

    def __init__(
        self,
        terms: Sequence[JointTerm],
        readings: Sequence[str],
        amounts: Array,
        holding: Callable[[Array], Array] | None = None,
    ) -> None:
        self.reading = np.array([readings.index(term.reading) for term in terms], dtype=np.intp)
        self._amounts = np.zeros((len(terms), len(readings)))
        self._amounts[np.arange(len(terms)), self.reading] = amounts
        self._orders = np.array([term.order for term in terms], dtype=np.float64)
        self._of = {kind: np.array([term.kind == kind for term in terms]) for kind in ("gain", "cos", "sin", "elastic")}
        self._holding = holding

    def bases(self, readings: Array) -> Array:
        """Return the bases (N, nt) at readings (N, nr), in rad or m per unit of each amount."""
        found = readings[:, self.reading]
        phase = found * self._orders
        cos, sin, elastic = self._of["cos"], self._of["sin"], self._of["elastic"]
        found[:, cos], found[:, sin] = np.cos(phase[:, cos]), np.sin(phase[:, sin])
        if elastic.any():
            if self._holding is None:
                raise TypeError("a robot with joints that give way has weights")
            found[:, elastic] = -self._holding(readings)[:, self.reading[elastic]]
        return found

    def moved(self, readings: Array) -> Array:
        """Return the readings (N, nr) with what the terms add to them."""
        return np.asarray(readings + self.bases(readings) @ self._amounts) if self._amounts.any() else readings

    def slopes(self, readings: Array) -> Array:
        """Return how fast every moved reading follows itself (N, nr): 1 and the slopes of its gain and harmonics.

        Without that of wind-up, which changes slowly with the pose: by some 1e-3 of the motion where drives are soft. A
        search that these slopes steer takes a step more for it.
        """
        phase = readings[:, self.reading] * self._orders
        found = np.zeros_like(phase)
        cos, sin = self._of["cos"], self._of["sin"]
        found[:, self._of["gain"]] = 1.0
        found[:, cos] = -self._orders[cos] * np.sin(phase[:, cos])
        found[:, sin] = self._orders[sin] * np.cos(phase[:, sin])
        return np.asarray(1.0 + found @ self._amounts)
