"""What is asked of a kind of joint terms. A kind is one class in one file, and an entry of the registry."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import JobError
from calib.foundations.selection import select
from calib.robot.conditions import Conditions
from calib.robot.flexures import Flexure
from calib.robot.gravity import Holding
from calib.robot.skeleton import Segment
from calib.robot.terms.term import JointTerm

Dimension = Literal["angle", "length"]


class Coefficient(NamedTuple):
    """Unit of a coefficient, and its typical size, in SI units."""

    unit: str
    typical_size: float


class Option(NamedTuple):
    """A key beside that of a kind: its default, which values it may have, and what these are in words."""

    default: object
    holds: Callable[[object], bool]
    what: str


class Shares(NamedTuple):
    """What the terms of one kind add to coordinates, one share after the other; only terms of links have several.

    ``terms``: whose share each one is. ``coordinate``: the coordinate that it moves, and ``reading`` the same among
    readings; of links 0. ``length``: of links, in m.
    """

    terms: tuple[JointTerm, ...]
    coordinate: IntArray
    reading: IntArray
    length: Array


class Rows:
    """Rows at which bases are asked for: readings (N, nr), their conditions, and what is held there."""

    def __init__(self, readings: Array, conditions: Conditions, holding: Holding | None) -> None:
        self.readings, self.conditions, self._holding = readings, conditions, holding

    @property
    def weights(self) -> Holding:
        """What evaluates the masses, of a robot that has them."""
        if self._holding is None:
            raise TypeError("a robot with drives or links that give way has weights")
        return self._holding

    @cached_property
    def held(self) -> Array:
        """What all coordinates hold against gravity (N, c)."""
        return self.weights(self.readings, self.conditions)


# At rows: the bases (N, shares) of a kind, in rad or m per unit of each coefficient. At readings (N, nr): their slopes.
Basis = Callable[[Rows], Array]
Slope = Callable[[Array], Array]


@dataclass(frozen=True, slots=True)
class Parts:
    """What of a robot its terms may be of.

    ``readings``: their dimensions by name. ``links``: by the joint that a link with a length ends in, whether that
    joint moves; ``joints``: all of the chain. ``masses``: names of masses that may be unknown, outwards from the base;
    ``weighed`` asks whether masses are stated, and ``moments`` for the terms of those that are not. ``moving``: joints
    that move, passive ones too, with what they move by; ``lateral_moments``: as ``moments``, of their bearings.
    """

    readings: Mapping[str, Dimension]
    links: Mapping[str, bool]
    joints: tuple[str, ...]
    masses: tuple[str, ...]
    weighed: Callable[[], bool]
    moments: Callable[[], tuple[JointTerm, ...]]
    moving: Mapping[str, Dimension]
    lateral_moments: Callable[[], tuple[JointTerm, ...]]


class Needed(NamedTuple):
    """What terms of a kind follow beside the readings, in a ``column``, named after the reading where it has ``{}``.

    Asked of conditions and the number of a reading: ``lacks``, whether some rows do not tell it; ``shows``, whether its
    values differ so that they could show a term.
    """

    column: str
    lacks: Callable[[Conditions, int], bool]
    shows: Callable[[Conditions, int], bool]


def _unsaid(values: Array | None, reading: int) -> bool:
    """Return whether conditions (N, nr) of readings lack those of one."""
    return values is None or bool(np.isnan(values[:, reading]).any())


def _changes(values: Array | None) -> bool:
    """Return whether conditions (N,) are told of all rows, and not the same for all."""
    return values is not None and float(np.ptp(values)) > 0.0


SIDE = Needed(
    "direction_{}",
    lambda told, reading: _unsaid(told.approach, reading),
    lambda told, reading: told.approach is not None and {-1.0, 1.0} <= set(told.approach[:, reading].tolist()),
)
MEASURED_TORQUE = Needed(
    "tau_{}",
    lambda told, reading: _unsaid(told.torque, reading),
    lambda told, reading: told.torque is not None and _changes(told.torque[:, reading]),
)
TEMPERATURE = Needed(
    "temperature", lambda told, _: told.temperature is None, lambda told, _: _changes(told.temperature)
)


class Kind(ABC):
    """A kind of joint terms, here of readings.

    ``names``: what its terms are called in files and among parameters. ``key``: what chooses them in a job, with other
    ``words`` than "all" and "none", and ``options`` beside it. ``coefficients``: by the dimension of the reading; where
    there is none, ``only`` says of what such terms are. ``shown``: what a millionth of a unit is called in tables;
    lengths and angles are in mm and deg there. ``masses``: which ones its basis asks for. ``needs``: what else of rows
    it follows. ``chosen_by_data``: whether it is offered where data choose; terms of other kinds are for those who know
    that they are there. ``priors``: the field of :class:`calib.Priors`, by the dimension of the reading. ``grows``:
    whether it does with the reading, without end.
    """

    names: ClassVar[tuple[str, ...]]
    key: ClassVar[str]
    words: ClassVar[tuple[str, ...]] = ()
    options: ClassVar[Mapping[str, Option]] = MappingProxyType({})
    coefficients: ClassVar[Mapping[Dimension, Coefficient]]
    shown: ClassVar[Mapping[str, str]] = MappingProxyType({})
    only: ClassVar[str] = ""
    masses: ClassVar[Literal["none", "stated", "unknown"]] = "none"
    needs: ClassVar[tuple[Needed, ...]] = ()
    chosen_by_data: ClassVar[bool] = True
    priors: ClassVar[Mapping[Dimension, str]] = MappingProxyType({})
    of_link: ClassVar[bool] = False
    grows: ClassVar[bool] = False

    # ---- what it does

    @abstractmethod
    def basis(self, shares: Shares) -> Basis:
        """Return what evaluates the bases of these shares."""

    def bases(self, shares: Shares, coefficients: Array) -> tuple[Basis, Basis]:
        """Return what evaluates the bases of these shares, and the derivatives by their coefficients (shares,).

        They are one, but for kinds of which one coefficient shapes what another is multiplied by.
        """
        own = self.basis(shares)
        return own, own

    def slope(self, shares: Shares) -> Slope | None:
        """Return what evaluates how fast the bases follow their own reading; None where that is negligible."""
        return None

    def motions(self, segments: Sequence[Segment], joint: int, term: JointTerm) -> tuple[Flexure, ...]:
        """Return how the link before a joint, or its bearing, gives way; nothing where there is none."""
        return ()

    def lacking(self, term: JointTerm, reading: int, conditions: Conditions) -> str | None:
        """Return the column of conditions that a term of the reading of this number would need, or None."""
        return next((own.column.format(term.reading) for own in self.needs if own.lacks(conditions, reading)), None)

    # ---- what it is of

    def coefficient(self, term: JointTerm, dimension: Dimension) -> Coefficient:
        """Return unit and typical size of the coefficient of a term, for a reading of this dimension."""
        return self.coefficients[dimension]

    def well_formed(self, term: JointTerm) -> bool:
        """Return whether a term has what its kind needs, and nothing else."""
        return term.order == 0 and term.body == ""

    def refusal(self, parts: Parts, name: str) -> str | None:
        """Return why there is no such term of a reading of the robot, or None."""
        if parts.readings[name] in self.coefficients:
            return None
        return f"{name!r} {'slides' if parts.readings[name] == 'length' else 'turns'}, and {self.only}."

    def there(self, parts: Parts, term: JointTerm) -> bool:
        """Return whether a term is of what the robot has."""
        return self.well_formed(term) and term.reading in parts.readings and not self.refusal(parts, term.reading)

    def group(self, term: JointTerm, dimension: Dimension) -> str:
        """Return the name of those terms that are like this one: they may share a learned prior."""
        return self.key

    def said(self, term: JointTerm) -> str:
        """Return what a term is called in tables."""
        return term.kind

    # ---- how it is chosen

    def terms(self, parts: Parts, name: str, options: Mapping[str, object]) -> tuple[JointTerm, ...]:
        """Return the terms of one reading, or of one link."""
        return (JointTerm(name, self.names[0]),)

    def chosen(self, selection: object, parts: Parts, options: Mapping[str, object]) -> tuple[JointTerm, ...]:
        """Return the terms that a job's key chooses. Raises JobError for what it cannot choose."""
        names = self.select(selection, parts)
        return tuple(term for name in names for term in self.terms(parts, name, options))

    def select(self, selection: object, parts: Parts) -> list[str]:
        """Return the chosen readings: "all" are those that can have a term.

        Raises JobError for a name that matches nothing, and where there is no term of a named reading, or of any.
        """
        names = select(selection, list(parts.readings), self.key, *self.words)
        refused = {name: why for name in names if (why := self.refusal(parts, name))}
        if refused and (selection != "all" or len(refused) == len(names)):
            raise JobError(f"{self.key}: {next(iter(refused.values()))}")
        return [name for name in names if name not in refused]

    def offered(
        self, parts: Parts, told: Conditions, options: Mapping[str, object]
    ) -> tuple[tuple[JointTerm, ...], ...]:
        """Return what data may choose: terms that enter together. ``told``: the conditions of all rows."""
        return tuple(
            (term,)
            for k, name in enumerate(parts.readings if self.chosen_by_data else ())
            if not self.refusal(parts, name) and self.shows(parts, told, k)
            for term in self.terms(parts, name, options)
        )

    def shows(self, parts: Parts, told: Conditions, reading: int) -> bool:
        """Return whether rows with these conditions could show such a term of the reading of this number."""
        told_apart = all(own.shows(told, reading) for own in self.needs)
        return told_apart and (self.masses != "stated" or parts.weighed())


class Compliance(Kind):
    """A kind of joint terms by which something gives way to what it holds of stated masses."""

    masses: ClassVar[Literal["none", "stated", "unknown"]] = "stated"

    def basis(self, shares: Shares) -> Basis:
        """Return what is held there, the other way round."""
        return lambda rows: -rows.held[:, shares.coordinate]
