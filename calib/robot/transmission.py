"""What lies between a motor and its joint, and between two joints.

A reading u becomes the joint coordinate ``u + sum_t a_t basis_t(row)``, which the coupling then carries on to the
joints. The bases depend on the row and, but for the time constant of a memory, not on what is identified; derivatives
by the coefficients are exact. What they are, each kind says for itself: :mod:`calib.robot.terms`. Links give way in
coordinates of their own (:mod:`calib.robot.flexures`), which are zero but for their terms.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, IntArray, as_slice
from calib.foundations.errors import RobotError
from calib.robot.conditions import Conditions
from calib.robot.flexures import Flexure, link_length
from calib.robot.gravity import Holding
from calib.robot.skeleton import Segment
from calib.robot.terms import KINDS, NAMED, JointTerm, Kind, kind_of
from calib.robot.terms.kind import SIDE, Rows, Shares

# Names of terms that may need a condition; of a thousand candidates hardly any does.
_NEEDING = frozenset(name for name, kind in NAMED.items() if kind.needs)
# So many values of bases are made at once, where nobody asks for them: 8000 terms have as many at 125 rows.
_AT_ONCE = 1_000_000


class Flexures(NamedTuple):
    """The flexures that terms of links move: those of term t are ``every[k]`` for k in ``of_term[t]``."""

    every: tuple[Flexure, ...]
    of_term: tuple[tuple[int, ...], ...]


def flexures(terms: Sequence[JointTerm], joints: Sequence[str], segments: Sequence[Segment]) -> Flexures:
    """Return the flexures of a chain, whose ``joints`` are named as its ``segments`` are.

    A link gives way in the order of the kinds, whatever the order of the terms. Terms of one kind that move it alike,
    as a bearing under one mass and another, share a flexure: each is a joint, and memory grows with the cube of these.
    Raises RobotError for a link without a length.
    """
    every: list[Flexure] = []
    of_term: list[tuple[int, ...]] = [()] * len(terms)
    of_links = [(t, term, kind) for t, term in enumerate(terms) if (kind := kind_of(term)).of_link]
    for kind in KINDS:
        numbers: dict[tuple[object, ...], int] = {}
        for t, term, own in of_links:
            if own is kind:
                own_joints = [i for i, name in enumerate(joints) if term.reading in (name, "")]
                moved = [flexure for i in own_joints for flexure in kind.motions(segments, i, term)]
                if not moved:
                    raise RobotError(f"{term.name}: there is no link before {term.reading or 'any'!r}.")
                told = [(one.joint, one.type, one.axis.tobytes(), one.link) for one in moved]
                for what, one in zip(told, moved, strict=True):
                    if numbers.setdefault(what, len(every)) == len(every):
                        every.append(one)
                of_term[t] = tuple(map(numbers.__getitem__, told))
    return Flexures(tuple(every), tuple(of_term))


def lacking(terms: Iterable[JointTerm], readings: Sequence[str], conditions: Conditions) -> tuple[str, str] | None:
    """Return the first term that needs a condition which rows do not have, and the column that would; else None."""
    number = {name: k for k, name in enumerate(readings)}
    for term in terms:
        if term.kind in _NEEDING and (column := kind_of(term).lacking(term, number.get(term.reading, 0), conditions)):
            return term.name, column
    return None


def sided(terms: Iterable[JointTerm]) -> frozenset[str]:
    """Return the readings with a term that follows the side from which they were reached."""
    return frozenset(term.reading for term in terms if SIDE in kind_of(term).needs)


class Bases(NamedTuple):
    """What terms add per unit of their coefficients, and what that changes by each: (N, shares), mostly one."""

    adds: Array
    changes: Array


class TermShares:
    """What the terms of a robot add to which coordinates, whatever their coefficients.

    Coordinates are readings (nr), then flexures. What a term adds to one coordinate is its share; only terms of links
    have several. ``number`` (shares): whose each is; ``first`` (nt): where those of a term begin; ``coordinate``
    (shares): which one moves. ``of_kinds``: columns of shares, and the shares, of every kind that there is.
    """

    def __init__(
        self, terms: Sequence[JointTerm], readings: Sequence[str], moved: Flexures, segments: Sequence[Segment]
    ) -> None:
        kinds = [kind_of(term) for term in terms]
        own = [
            [len(readings) + k for k in moved.of_term[t]] if kinds[t].of_link else [readings.index(term.reading)]
            for t, term in enumerate(terms)
        ]
        self.terms, self.readings = tuple(terms), tuple(readings)
        self.number = np.repeat(np.arange(len(terms)), [len(coordinates) for coordinates in own])
        self.first = np.searchsorted(self.number, np.arange(len(terms)))
        self.coordinate = np.array([k for coordinates in own for k in coordinates], dtype=np.intp)
        self.coordinates = len(readings) + len(moved.every)
        # Of flexures, any reading: what they add does not follow it.
        reading = np.where(self.coordinate < len(readings), self.coordinate, 0)
        lengths = np.array([0.0] * len(readings) + [link_length(segments[flexure.joint]) for flexure in moved.every])
        self.of_kinds: list[tuple[slice | IntArray, Kind, Shares, IntArray]] = []
        of_share = np.array([KINDS.index(kind) for kind in kinds], dtype=np.intp)[self.number]
        for k, kind in enumerate(KINDS):
            those = np.flatnonzero(of_share == k)
            if those.size:
                coordinate, number = self.coordinate[those], self.number[those]
                of_kind = tuple(terms[t] for t in number.tolist())
                shares = Shares(of_kind, coordinate, reading[those], lengths[coordinate])
                self.of_kinds.append((as_slice(those), kind, shares, number))


class Transmission:
    """The terms of a robot with given coefficients (nt,). ``holding``: asked where drives or links give way."""

    def __init__(self, shares: TermShares, coefficients: Array, holding: Holding | None = None) -> None:
        self._shares, self._holding, of_term = shares, holding, np.asarray(coefficients)
        self._coefficients = np.zeros((len(shares.number), shares.coordinates))
        self._coefficients[np.arange(len(shares.number)), shares.coordinate] = of_term[shares.number]
        self._bases_of = [(columns, kind.bases(own, of_term[number])) for columns, kind, own, number in shares.of_kinds]

    def bases(self, readings: Array, conditions: Conditions) -> Bases:
        """Return the bases at readings (N, nr), in rad or m per unit of each coefficient.

        Raises RobotError for a term that needs a condition which the rows do not have, and for those of other rows.
        """
        if missing := lacking(self._shares.terms, self._shares.readings, conditions):
            raise RobotError(f"{missing[0]} needs {missing[1]!r} for every row.")
        conditions.refuse_other_rows(*readings.shape)
        # Shares are made one by one, and used so.
        rows, adds = Rows(readings, conditions, self._holding), np.empty((len(self._shares.number), len(readings))).T
        for columns, (basis, _) in self._bases_of:
            adds[:, columns] = basis(rows)
        if all(basis is change for _, (basis, change) in self._bases_of):
            return Bases(adds, adds)
        changes = adds.copy(order="K")
        for columns, (basis, change) in self._bases_of:
            if change is not basis:
                changes[:, columns] = change(rows)
        return Bases(adds, changes)

    def moved(self, readings: Array, conditions: Conditions, bases: Bases | None = None) -> Array:
        """Return the coordinates (N, c) at readings (N, nr), with what the terms add to them; ``bases``: those there.

        Raises RobotError for a term that needs a condition which the rows do not have, unless all coefficients are
        zero.
        """
        flexures = self._coefficients.shape[1] - readings.shape[1]
        straight = np.pad(readings, ((0, 0), (0, flexures))) if flexures else readings
        if not self._coefficients.any():
            return straight
        at_once = max(1, _AT_ONCE // len(self._coefficients))
        if bases is None and len(readings) > at_once:
            blocks = [slice(k, k + at_once) for k in range(0, len(readings), at_once)]
            return np.concatenate([self.moved(readings[rows], conditions.subset(rows)) for rows in blocks])
        there = self.bases(readings, conditions) if bases is None else bases
        return np.asarray(straight + there.adds @ self._coefficients)

    def by_terms(self, by_coordinate: Array, bases: Bases) -> Array:
        """Return changes (N, d, nt) for the coefficients of the terms, for those by the coordinates (c, d, N)."""
        by_share = by_coordinate[self._shares.coordinate] * bases.changes.T[:, None]
        if len(self._shares.number) > len(self._shares.terms):
            # Shares of one term stand side by side.
            by_share = np.add.reduceat(by_share, self._shares.first, axis=0)
        return np.asarray(by_share.transpose(2, 1, 0))

    def slopes(self, readings: Array) -> Array:
        """Return how fast every moved reading follows itself (N, nr): 1 and the slopes of its terms that have some.

        Without that of wind-up and of links, which change slowly with the pose: by some 1e-3 of the motion where drives
        are soft. A search that these slopes steer takes a step more for it.
        """
        found = np.zeros((len(readings), len(self._shares.number)))
        for columns, kind, own, _ in self._shares.of_kinds:
            if slope := kind.slope(own):
                found[:, columns] = slope(readings)
        return np.asarray(1.0 + found @ self._coefficients[:, : readings.shape[1]])
