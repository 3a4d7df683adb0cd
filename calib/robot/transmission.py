"""What lies between a motor and its joint, and between two joints; each linear in its amount.

A reading u becomes the joint coordinate ``u + sum_t amount_t basis_t(row)``, which the coupling then carries on to the
joints. The bases depend on the row alone and not on what is identified, so that derivatives by the amounts are exact:

    gain     u                         the reading's scale
    cos_k    cos k u,  sin_k  sin k u  encoder eccentricity (k = 1, 2), gear teeth and wave generators (more)
    elastic  -tau                      the drive gives way to what it holds against gravity, at nominal geometry
    moment   -tau of 1 kg m of a link  the same where masses are not known: compliance times first moment of mass
    torque   -tau, as measured         the same by what the drive says that it holds
    backlash the side of approach      half the gap of the gears, on which side the reading was reached from
    thermal  T - 20 degC               the zero wanders as the machine warms up

Links give way in coordinates of their own (:mod:`calib.robot.flexures`), which are zero but for their terms:

    bending   the beam's motions under -tau of these coordinates
    expansion length times (T - 20 degC), of one link or, where the reading has no name, of all
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import RobotError
from calib.robot.conditions import REFERENCE_TEMPERATURE, Conditions
from calib.robot.flexures import Flexure, beam, bending, expanding, length
from calib.robot.gravity import Holding
from calib.robot.skeleton import Segment

TermKind = Literal["gain", "cos", "sin", "elastic", "moment", "torque", "backlash", "thermal", "bending", "expansion"]
TermUnit = Literal[
    "rad", "m", "1", "rad/Nm", "m/N", "kg rad/Nm", "kg m rad/Nm", "kg m/N", "kg m2/N", "rad/K", "m/K", "1/K"
]

WHOLE_ARM = "arm"


@dataclass(frozen=True, slots=True)
class JointTerm:
    """One term of one reading; of bending and expansion: of the link before the joint that ``reading`` names.

    ``order``: periods of a harmonic in a turn of the reading, 0 for all other kinds. ``body``: of a moment, the joint
    that carries it and its axis in the joint's frame, as ``joint_4_x``, or ``joint_4_mass``; "" for all other kinds.
    """

    reading: str
    kind: TermKind
    order: int = 0
    body: str = ""

    @property
    def name(self) -> str:
        """Name of its amount among parameters: ``joint_2.gain``, ``joint_2.cos_1``, ``joint_2.moment_joint_4_x``."""
        what = self.order or self.body
        return f"{self.reading or WHOLE_ARM}.{self.kind}_{what}" if what else f"{self.reading or WHOLE_ARM}.{self.kind}"

    @property
    def of_link(self) -> bool:
        """Whether a link gives way, and not a drive."""
        return self.kind in ("bending", "expansion")

    def unit(self, dimension: Literal["angle", "length"]) -> TermUnit:
        """Return the unit of its amount, for a reading of this dimension; terms of links have but one."""
        angle = dimension == "angle"
        if self.kind in ("elastic", "torque", "bending"):
            return "rad/Nm" if angle or self.of_link else "m/N"
        if self.kind == "moment":
            if self.body.endswith("_mass"):
                return "kg rad/Nm" if angle else "kg m/N"
            return "kg m rad/Nm" if angle else "kg m2/N"
        if self.kind == "expansion":
            return "1/K"
        if self.kind == "thermal":
            return "rad/K" if angle else "m/K"
        return "1" if self.kind == "gain" else "rad" if angle else "m"


class Flexures(NamedTuple):
    """The flexures that terms of links move: those of term t are ``every[k]`` for k in ``of_term[t]``."""

    every: tuple[Flexure, ...]
    of_term: tuple[range, ...]


def flexures(terms: Sequence[JointTerm], joints: Sequence[str], segments: Sequence[Segment]) -> Flexures:
    """Return the flexures of a chain, whose ``joints`` are named as its ``segments`` are.

    A link expands before it bends, whatever the order of the terms. Raises RobotError for a link without a length.
    """
    every: list[Flexure] = []
    of_term = [range(0)] * len(terms)
    for kind, motions in (("expansion", expanding), ("bending", bending)):
        for t, term in enumerate(terms):
            if term.kind == kind:
                start = len(every)
                for i, name in enumerate(joints):
                    if term.reading in (name, "") and length(segments[i]):
                        every += motions(segments, i)
                if len(every) == start:
                    raise RobotError(f"{term.name}: there is no link before {term.reading or 'any'!r}.")
                of_term[t] = range(start, len(every))
    return Flexures(tuple(every), tuple(of_term))


def lacking(terms: Iterable[JointTerm], readings: Sequence[str], conditions: Conditions) -> tuple[str, str] | None:
    """Return the first term that needs a condition which rows do not have, and the column that would; else None."""
    number = {name: k for k, name in enumerate(readings)}
    of_readings = {"backlash": ("direction", conditions.approach), "torque": ("tau", conditions.torque)}
    for term in terms:
        if term.kind in ("thermal", "expansion") and conditions.temperature is None:
            return term.name, "temperature"
        if term.kind in of_readings:
            column, values = of_readings[term.kind]
            if values is None or np.isnan(values[:, number[term.reading]]).any():
                return term.name, f"{column}_{term.reading}"
    return None


class Transmission:
    """The terms of a robot with given amounts (nt,).

    Coordinates are readings (nr), then flexures. What a term adds to one coordinate is its share; only terms of links
    have several. ``holding``: asked where drives or links give way.
    """

    def __init__(
        self,
        terms: Sequence[JointTerm],
        readings: Sequence[str],
        amounts: Array,
        moved: Flexures,
        segments: Sequence[Segment],
        holding: Holding | None = None,
    ) -> None:
        own = [
            [len(readings) + k for k in moved.of_term[t]] if term.of_link else [readings.index(term.reading)]
            for t, term in enumerate(terms)
        ]
        number = np.repeat(np.arange(len(terms)), [len(coordinates) for coordinates in own])
        shares = [terms[t] for t in number.tolist()]
        self._coordinate = np.array([k for coordinates in own for k in coordinates], dtype=np.intp)
        # Of flexures, any reading: what they add does not follow it.
        self._reading = np.where(self._coordinate < len(readings), self._coordinate, 0)
        self._to_terms = (number[:, None] == np.arange(len(terms))).astype(np.float64)
        self._amounts = np.zeros((len(shares), len(readings) + len(moved.every)))
        self._amounts[np.arange(len(shares)), self._coordinate] = np.asarray(amounts)[number]
        self._orders = np.array([term.order for term in shares], dtype=np.float64)
        self._of = {kind: np.array([term.kind == kind for term in shares]) for kind in get_args(TermKind)}
        lengths = np.array([length(segments[flexure.joint]) for flexure in moved.every])
        self._lengths = lengths[self._coordinate[self._of["expansion"]] - len(readings)]
        self._beams = [
            (np.flatnonzero(number == t), beam(lengths[moved.of_term[t][0]]))
            for t, term in enumerate(terms)
            if term.kind == "bending"
        ]
        self._terms, self._readings = tuple(terms), tuple(readings)
        self._holding = holding
        self._units = np.array(
            [holding.units[term.body] for term in shares if term.kind == "moment" and holding is not None],
            dtype=np.intp,
        )

    def _bases(self, readings: Array, conditions: Conditions) -> Array:
        """Return the bases (N, shares) at readings (N, nr), in rad or m per unit of each amount."""
        if missing := lacking(self._terms, self._readings, conditions):
            raise RobotError(f"{missing[0]} needs to be told {missing[1]!r} of every row.")
        found = readings[:, self._reading]
        phase = found * self._orders
        cos, sin, elastic, moment = (self._of[kind] for kind in ("cos", "sin", "elastic", "moment"))
        found[:, cos], found[:, sin] = np.cos(phase[:, cos]), np.sin(phase[:, sin])
        if elastic.any() or self._beams:
            tau = self._weighed()(readings)
            found[:, elastic] = -tau[:, self._coordinate[elastic]]
            for own, compliance in self._beams:
                found[:, own] = -tau[:, self._coordinate[own]] @ compliance
        if moment.any():
            each = self._weighed().of_units(readings)
            found[:, moment] = -each[self._units, :, self._coordinate[moment]].T
        if conditions.approach is not None:
            found[:, self._of["backlash"]] = conditions.approach[:, self._reading[self._of["backlash"]]]
        if conditions.torque is not None:
            found[:, self._of["torque"]] = -conditions.torque[:, self._reading[self._of["torque"]]]
        if conditions.temperature is not None:
            above = (conditions.temperature - REFERENCE_TEMPERATURE)[:, None]
            found[:, self._of["thermal"]] = above
            found[:, self._of["expansion"]] = above * self._lengths
        return found

    def moved(self, readings: Array, conditions: Conditions) -> Array:
        """Return the coordinates (N, c) at readings (N, nr), with what the terms add to them.

        Raises RobotError for a term that needs a condition which the rows do not have, unless all amounts are zero.
        """
        flexures = self._amounts.shape[1] - readings.shape[1]
        straight = np.pad(readings, ((0, 0), (0, flexures))) if flexures else readings
        if not self._amounts.any():
            return straight
        return np.asarray(straight + self._bases(readings, conditions) @ self._amounts)

    def by_terms(self, by_coordinate: Array, readings: Array, conditions: Conditions) -> Array:
        """Return changes (N, d, nt) for the amounts of the terms, for those by the coordinates (N, d, c).

        At readings (N, nr). Raises RobotError for a term that needs a condition which the rows do not have.
        """
        by_share = by_coordinate[:, :, self._coordinate] * self._bases(readings, conditions)[:, None]
        return by_share if len(self._coordinate) == len(self._terms) else np.asarray(by_share @ self._to_terms)

    def slopes(self, readings: Array) -> Array:
        """Return how fast every moved reading follows itself (N, nr): 1 and the slopes of its gain and harmonics.

        Without that of wind-up and of links, which change slowly with the pose: by some 1e-3 of the motion where drives
        are soft. A search that these slopes steer takes a step more for it.
        """
        phase = readings[:, self._reading] * self._orders
        found = np.zeros_like(phase)
        cos, sin = self._of["cos"], self._of["sin"]
        found[:, self._of["gain"]] = 1.0
        found[:, cos] = -self._orders[cos] * np.sin(phase[:, cos])
        found[:, sin] = self._orders[sin] * np.cos(phase[:, sin])
        return np.asarray(1.0 + found @ self._amounts[:, : readings.shape[1]])

    def _weighed(self) -> Holding:
        if self._holding is None:
            raise TypeError("a robot with drives or links that give way has weights")
        return self._holding
