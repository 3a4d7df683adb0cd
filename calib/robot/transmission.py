"""What lies between a motor and its joint: gain, harmonics, wind-up; each linear in its amount.

A reading u becomes the joint coordinate ``u + sum_t amount_t basis_t(row)``, which the coupling then carries on to the
joints. The bases depend on the row alone and not on what is identified, so that derivatives by the amounts are exact:

    gain     u                         the reading's scale
    cos_k    cos k u,  sin_k  sin k u  encoder eccentricity (k = 1, 2), gear teeth and wave generators (more)
    elastic  -tau                      the drive gives way to what it holds against gravity, at nominal geometry
    torque   -tau, as measured         the same by what the drive says that it holds
    backlash the side of approach      half the gap of the gears, on which side the reading was reached from
    thermal  T - 20 degC               the zero wanders as the machine warms up
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import RobotError
from calib.robot.conditions import REFERENCE_TEMPERATURE, Conditions

TermKind = Literal["gain", "cos", "sin", "elastic", "torque", "backlash", "thermal"]
TermUnit = Literal["rad", "m", "1", "rad/Nm", "m/N", "rad/K", "m/K"]


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
        angle = dimension == "angle"
        if self.kind in ("elastic", "torque"):
            return "rad/Nm" if angle else "m/N"
        if self.kind == "thermal":
            return "rad/K" if angle else "m/K"
        return "1" if self.kind == "gain" else "rad" if angle else "m"


def lacking(terms: Iterable[JointTerm], readings: Sequence[str], conditions: Conditions) -> tuple[str, str] | None:
    """Return the first term that needs a condition which rows do not have, and the column that would; else None."""
    number = {name: k for k, name in enumerate(readings)}
    of_readings = {"backlash": ("direction", conditions.approach), "torque": ("tau", conditions.torque)}
    for term in terms:
        if term.kind == "thermal" and conditions.temperature is None:
            return term.name, "temperature"
        column, values = of_readings.get(term.kind, ("", np.zeros((0, len(number)))))
        if values is None or np.isnan(values[:, number[term.reading]]).any():
            return term.name, f"{column}_{term.reading}"
    return None


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
        self._of = {kind: np.array([term.kind == kind for term in terms]) for kind in get_args(TermKind)}
        self._terms, self._readings = tuple(terms), tuple(readings)
        self._holding = holding

    def bases(self, readings: Array, conditions: Conditions) -> Array:
        """Return the bases (N, nt) at readings (N, nr), in rad or m per unit of each amount.

        Raises RobotError for a term that needs a condition which the rows do not have.
        """
        if missing := lacking(self._terms, self._readings, conditions):
            raise RobotError(f"{missing[0]} needs to be told {missing[1]!r} of every row.")
        found = readings[:, self.reading]
        phase = found * self._orders
        cos, sin, elastic = self._of["cos"], self._of["sin"], self._of["elastic"]
        found[:, cos], found[:, sin] = np.cos(phase[:, cos]), np.sin(phase[:, sin])
        if elastic.any():
            if self._holding is None:
                raise TypeError("a robot with joints that give way has weights")
            found[:, elastic] = -self._holding(readings)[:, self.reading[elastic]]
        if conditions.approach is not None:
            found[:, self._of["backlash"]] = conditions.approach[:, self.reading[self._of["backlash"]]]
        if conditions.torque is not None:
            found[:, self._of["torque"]] = -conditions.torque[:, self.reading[self._of["torque"]]]
        if conditions.temperature is not None:
            found[:, self._of["thermal"]] = (conditions.temperature - REFERENCE_TEMPERATURE)[:, None]
        return found

    def moved(self, readings: Array, conditions: Conditions) -> Array:
        """Return the readings (N, nr) with what the terms add to them. Raises as bases does, unless all is zero."""
        if not self._amounts.any():
            return readings
        return np.asarray(readings + self.bases(readings, conditions) @ self._amounts)

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
