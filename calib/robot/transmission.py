"""What lies between a motor and its joint: gain, harmonics, wind-up; each linear in its amount.

A reading u becomes the joint coordinate ``u + sum_t amount_t basis_t(row)``, which the coupling then carries on to the
joints. The bases depend on the row alone and not on what is identified, so that derivatives by the amounts are exact:

    gain     u                         the reading's scale
    cos_k    cos k u,  sin_k  sin k u  encoder eccentricity (k = 1, 2), gear teeth and wave generators (more)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.foundations.arrays import Array

TermKind = Literal["gain", "cos", "sin"]
TermUnit = Literal["m", "rad", "1"]


@dataclass(frozen=True, slots=True)
class JointTerm:
    """One term of one reading. ``order``: periods of a harmonic in a turn of the reading, 0 for all other kinds."""

    reading: str
    kind: TermKind
    order: int = 0

    @property
    def name(self) -> str:
        """Name of its amount among parameters: ``joint_2.gain``, ``joint_2.cos_1``."""
        return f"{self.reading}.{self.kind}_{self.order}" if self.order else f"{self.reading}.{self.kind}"

    @property
    def unit(self) -> TermUnit:
        """Unit of its amount."""
        return "1" if self.kind == "gain" else "rad"


class Transmission:
    """The terms of a robot with given amounts (nt,)."""

    def __init__(self, terms: Sequence[JointTerm], readings: Sequence[str], amounts: Array) -> None:
        self.reading = np.array([readings.index(term.reading) for term in terms], dtype=np.intp)
        self._amounts = np.zeros((len(terms), len(readings)))
        self._amounts[np.arange(len(terms)), self.reading] = amounts
        self._kinds = np.array([term.kind for term in terms])
        self._orders = np.array([term.order for term in terms], dtype=np.float64)

    def bases(self, readings: Array) -> Array:
        """Return the bases (N, nt) at readings (N, nr), in rad or m per unit of each amount."""
        own = readings[:, self.reading]
        phase = own * self._orders
        return np.asarray(
            np.select(
                [self._kinds == "gain", self._kinds == "cos", self._kinds == "sin"], [own, np.cos(phase), np.sin(phase)]
            )
        )

    def moved(self, readings: Array, bases: Array) -> Array:
        """Return the readings (N, nr) with what the terms add to them."""
        return np.asarray(readings + bases @ self._amounts)

    def slopes(self, readings: Array) -> Array:
        """Return how fast every moved reading follows itself (N, nr): 1 and the slopes of its gain and harmonics."""
        phase = readings[:, self.reading] * self._orders
        slopes = np.select(
            [self._kinds == "gain", self._kinds == "cos", self._kinds == "sin"],
            [np.ones_like(phase), -self._orders * np.sin(phase), self._orders * np.cos(phase)],
        )
        return np.asarray(1.0 + slopes @ self._amounts)
