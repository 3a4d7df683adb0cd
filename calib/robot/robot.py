"""A robot arm: the joints between a base link and a tip link of a URDF, with deviations.

Joints are kept in the frames in which deviations are named: z along each joint's axis. Every joint, moving or fixed,
carries a deviation; the readings of the encoders become joint positions through a linear coupling, and passive joints
follow from closed loops.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arguments import checked, own_fields
from calib.foundations.arrays import Array, BoolArray, IntArray, as_slice, read_only
from calib.foundations.brief import brief
from calib.foundations.errors import RobotError
from calib.foundations.ranges import refuse_beyond, refuse_shape
from calib.foundations.sealing import sealed
from calib.foundations.words import counted, listed, not_loaded, shown
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.deviation import Motions
from calib.robot.flexures import Mechanism, mechanism
from calib.robot.gravity import STANDARD_GRAVITY, Holding, Load, Payload, Weights, checked_gravity, checked_payload
from calib.robot.kinematics import Joints, Kinematics, MovingType, Regressor, followed
from calib.robot.loops import Closure, Loop, passive_joints, together
from calib.robot.skeleton import Outline, Segment
from calib.robot.terms import JointTerm, kind_of
from calib.robot.transmission import Bases, Flexures, TermShares, Transmission, flexures
from calib.robot.urdf import Urdf

# In rad and m. Degrees taken for radians, and millimetres for metres, are still within.
LARGEST_READING = 1e8
# Where the base is in the first carrier, and the twists of a frame that follows nothing.
_AT_BASE, _NOTHING = read_only(np.eye(4)[None]), read_only(np.zeros((6, 6)))


@dataclass(frozen=True, slots=True)
class Reading:
    """One number that the machine reports for every pose: an encoder reading, named after its URDF joint.

    ``lower`` and ``upper`` are the joint's limits in rad or m, None where the URDF sets none. ``turns``: whether one
    whole turn more brings every joint that follows it back to where it was.
    """

    name: str
    dimension: Literal["angle", "length"]
    lower: float | None
    upper: float | None
    turns: bool = False


@dataclass(frozen=True, slots=True)
class Coupling:
    """A joint whose position is a sum of multiples of other joints' positions, plus ``offset`` (rad or m)."""

    joint: str
    drivers: Mapping[str, float] = field(hash=False)
    offset: float = 0.0

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_beyond(list(self.drivers.values()), "coupling.drivers", f"coupling of {self.joint!r}", RobotError)
        # Whether it is an angle or a length, the joint says; that of a length has the wider range.
        key = "coupling.offset of what slides"
        refuse_beyond(self.offset, key, f"coupling of {self.joint!r}: offset", RobotError)


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """Two links whose origins coincide, in the directions ``closes`` ("x", "y", "z") of the first one's frame.

    ``passive``: the joints that follow, as many as directions; no encoder reads them.
    """

    name: str
    frames: tuple[str, str]
    closes: tuple[Literal["x", "y", "z"], ...]
    passive: tuple[str, ...]

    def __post_init__(self) -> None:
        own_fields(self)
        if alien := next((word for word in self.closes if word not in ("x", "y", "z")), None):
            raise RobotError(f"loop {self.name!r}: closes {alien!r}; allowed are 'x', 'y' and 'z'.")


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class ChainJoint:
    """One joint of the arm. ``placement`` (4, 4): its frame in the frame of joint ``parent`` (-1: base), nominally.

    ``frame`` (4, 4) leads from the URDF's joint frame to the frame here, whose z is the joint's axis.
    """

    name: str
    type: Literal["revolute", "prismatic", "fixed"]
    parent: int
    placement: Array
    frame: Array


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Deviations:
    """How a machine differs from its URDF.

    ``placements`` (number of chain joints, 6): (tx, ty, tz, rx, ry, rz) of each joint's placement, in m and rad.
    ``offsets`` (number of moving joints): added to the joint's position, in rad or m; an offset of a joint that others
    mimic moves these too, as its reading does.
    ``terms`` (number of the robot's terms): their coefficients, in SI units.
    """

    __repr__ = brief

    placements: Array
    offsets: Array
    terms: Array = field(default_factory=lambda: read_only(np.zeros(0)))

    def __post_init__(self) -> None:
        own_fields(self)
        for name, shape in (("placements", (None, 6)), ("offsets", (None,)), ("terms", (None,))):
            refuse_shape(getattr(self, name), shape, f"deviations: {name}", RobotError)

    @classmethod
    def trusted(cls, placements: Array, offsets: Array, terms: Array) -> "Deviations":
        """Return deviations that are known to be right, of arrays that nobody changes: nothing is looked at."""
        made = object.__new__(cls)
        object.__setattr__(made, "placements", placements)
        object.__setattr__(made, "offsets", offsets)
        object.__setattr__(made, "terms", terms)
        return made


class TipMotion(NamedTuple):
    """Tip placements over N rows, and what follows how the robot deviates, with exact derivatives.

    ``tip``: where it is, and how it follows its carriers: the base, and the moving joints on its way. The local twists
    of these follow the deviations as ``model.follow`` says, the same for all rows; the ways in which links give way are
    joints as well. ``rates`` (N, k, n): how passive joints of closed loops follow deviations; k is 0 without loops.
    ``bases``: what terms add per unit of their coefficients; None without terms.
    """

    tip: Regressor
    rates: Array
    bases: Bases | None
    model: "TipModel"
    positions: Array

    @property
    def placement(self) -> Array:
        """Tip placements (N, 4, 4) in the base link."""
        return self.tip.placement

    @property
    def by_deviations(self) -> Array:
        """The local twists (N, 6, n) of the tip for placements row by row, then offsets."""
        numbers = self.tip.through(*self.tip.local)
        found = np.empty((6, len(self.rates), self.model.follow.shape[1]))
        followed(numbers, self.model.follow, found)
        return np.asarray(found.transpose(1, 0, 2) + self.by_passive(numbers) @ self.rates)

    @property
    def by_terms(self) -> Array:
        """The local twists (N, 6, nt) of the tip for the coefficients of the robot's terms."""
        return self.through_terms(self.tip.through(*self.tip.local))

    def by_readings(self, readings: Array) -> Array:
        """Return the local twists (N, 6, nr) of the tip for the readings (N, nr), at which the motion is."""
        return self.following(self.tip.through(*self.tip.local), readings)

    def by_passive(self, numbers: Array) -> Array:
        """Return how numbers follow the passive joints (N, d, k), from what ``tip.through`` makes of them."""
        return self._by_joint(numbers)[self.model.passive].transpose(2, 1, 0)

    def through_terms(self, numbers: Array) -> Array:
        """Return how numbers follow the coefficients of the terms (N, d, nt), as :meth:`by_passive`."""
        if self.bases is None:
            return np.zeros((numbers.shape[3], numbers.shape[2], 0))
        return self.model.by_terms(self.positions, self._by_joint(numbers), self.bases)

    def following(self, numbers: Array, readings: Array) -> Array:
        """Return how numbers follow the readings (N, d, nr), at which the motion is, as :meth:`by_passive`."""
        return self.model.by_reading(self.positions, self._by_joint(numbers), readings)

    def _by_joint(self, numbers: Array) -> Array:
        return self.tip.by_position(numbers, self.model.types)


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Robot:
    """An arm, or several on one base, as the URDF designed them. Made by :func:`calib.load_robot`.

    ``chain``: the joints, parents first: those from base to tip, then the branches that other links and loops need.
    ``tip_joint``: index of the last one before the tip. ``links``: the tip, and other links whose places are told;
    :meth:`with_tip` looks at one of these. ``coupling`` (nj, nr) and ``coupling_offset`` (nj): positions of the moving
    joints = coupling @ readings + coupling_offset; for the passive joints of ``loops`` that is where the search starts.
    ``offset_coupling`` (nj, nj): positions += offset_coupling @ offsets. ``couplings`` and ``closed_loops``: as given.
    ``terms``: what the readings go through before they are coupled; ``weights``: the masses, where these need them.
    ``gravity`` (m/s^2) in the base link, and ``payload``, are those of set-ups of which ``loads`` say nothing.
    ``setup``: the one in which it stands; :attr:`load` is what bears on it there.
    """

    urdf: Urdf
    base: str
    tip: str
    chain: tuple[ChainJoint, ...]
    tip_joint: int
    readings: tuple[Reading, ...]
    coupling: Array
    coupling_offset: Array
    offset_coupling: Array
    links: tuple[str, ...]
    loops: tuple[Loop, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    closed_loops: tuple[ClosedLoop, ...] = ()
    terms: tuple[JointTerm, ...] = ()
    weights: Weights | None = None
    gravity: tuple[float, float, float] = STANDARD_GRAVITY
    payload: Payload | None = None
    loads: Mapping[str, Load] = field(default_factory=dict)
    setup: str = ""

    def __repr__(self) -> str:
        beside = [counted(len(self.terms), "joint term")] if self.terms else []
        beside += [counted(len(self.loops), "closed loop")] if self.loops else []
        joints = listed([reading.name for reading in self.readings])
        said = "; ".join([f"{counted(len(self.readings), 'joint')} {joints}", *beside])
        return f"<Robot {self.urdf.where} from {self.base!r} to {self.tip!r}: {said}>"

    @checked
    def with_loads(self, loads: Mapping[str, Load]) -> "Robot":
        """Return the same robot, with what bears on it in single set-ups, by name.

            robot = calib.load_robot("arm.urdf").with_loads({"wall": calib.measuring.Load((9.81, 0.0, 0.0))})

        Say so before error model or terms are made of it. Raises RobotError for a payload on none of its ``links``.
        """
        where = self.urdf.where
        return replace(
            self,
            loads={
                name: Load(checked_gravity(load.gravity, where), checked_payload(load.payload, self.links, where))
                for name, load in loads.items()
            },
        )

    @property
    def load(self) -> Load:
        """What bears on the robot where it stands."""
        return self.load_in(self.setup)

    @checked
    def load_in(self, setup: str) -> Load:
        """Return what bears on the robot in a set-up."""
        return self.loads.get(setup, Load(self.gravity, self.payload))

    @checked
    def moments(self, payload: Payload | None) -> Array:
        """Return first moments in kg m, and masses in kg, of a payload (links, 4) on one of the robot's ``links``."""
        found = np.zeros((len(self.links), 4))
        if payload is not None:
            found[self.links.index(payload.link or self.links[0])] = payload.moments
        return found

    @checked
    def with_tip(self, link: str) -> "Robot":
        """Return the same robot with another one of its ``links`` as the tip.

            left = robot.with_tip("left_hand")

        Raises RobotError for any other link.
        """
        if link == self.tip:
            return self
        if link not in self.links:
            raise RobotError(f"{self.urdf.where}: {not_loaded(link, self.links)}.")
        return replace(self, tip=link, tip_joint=self.carrier(link))

    @checked
    def driving(self, links: Iterable[str]) -> tuple[str, ...]:
        """Return the names of the readings that say where links are; those of closed loops always do.

        Raises RobotError as :meth:`carrier` does.
        """
        looped = [link for loop in self.closed_loops for link in loop.frames]
        return self._read(self._ways((*looped, *links)))

    @checked
    def bearing_on(self, links: Iterable[str]) -> tuple[str, ...]:
        """Return the names of the readings that bear on where links are.

        Those that move them and, of joints that give way to masses, those of all that hangs on the same joint: of two
        arms on a soft torso both, on a stiff one none of the other arm's. Raises RobotError as :meth:`carrier` does.
        """
        asked = tuple(links)
        if self.weights is not None:
            soft = {term.reading for term in self.terms if kind_of(term).masses != "none"}
            if self.loops:  # by which any joint of one may load any other
                soft |= {self.chain[i].name for i in self.moving}

            def loading(of: Iterable[str]) -> set[str]:
                ways = self._ways(of)
                # Joints that follow one reading load its drive, whichever links they carry.
                return soft & {*ways, *self._read(ways)}

            own = loading(asked)
            asked += tuple(link for link in self.links if not own.isdisjoint(loading((link,))))
        return self.driving(asked)

    def _ways(self, links: Iterable[str]) -> set[str]:
        """Return the names of the joints between these links and the base."""
        return {joint.name for link in links for joint in self._path(link)}

    def _read(self, joints: Collection[str]) -> tuple[str, ...]:
        """Return the names of the readings that move some of these joints."""
        moving = [self.chain[i].name in joints for i in self.moving]
        used = np.any(self.coupling[moving] != 0.0, axis=0)
        return tuple(reading.name for reading, is_used in zip(self.readings, used, strict=True) if is_used)

    def _path(self, link: str) -> Iterator[ChainJoint]:
        """Yield the joints from a link back to the base."""
        joint = self.tip_joint if link == self.tip else self.carrier(link)
        while joint >= 0:
            yield self.chain[joint]
            joint = self.chain[joint].parent

    @checked
    def carrier(self, link: str) -> int:
        """Return the index of the joint that carries a link of the URDF, -1 for the base link.

        Raises RobotError for a link that the robot's joints do not carry.
        """
        if link == self.base:
            return -1
        # Frames of a DH table may stand in two steps, the first of which is no joint of the URDF.
        child = {joint.name: joint.child for joint in self.urdf.joints}
        carriers = {child[joint.name]: i for i, joint in enumerate(self.chain) if joint.name in child}
        if link not in carriers:
            raise RobotError(f"there is no link {shown(link)} of the robot; its joints carry {listed(carriers)}.")
        return carriers[link]

    @property
    def moving(self) -> tuple[int, ...]:
        """Indices into ``chain`` of the moving joints."""
        return tuple(i for i, joint in enumerate(self.chain) if joint.type != "fixed")

    @property
    def passive(self) -> tuple[int, ...]:
        """Numbers, among the moving joints, of those that loops determine."""
        return tuple(passive_joints(self.loops))

    @property
    def loops_together(self) -> list[int]:
        """How many loops are solved at once, for each group of loops that move each other."""
        m = self.mechanism
        return [len(own) for own in together(Outline(m.segments).skeleton(np.zeros((len(m.segments), 6))), m.loops)]

    @property
    def flexures(self) -> Flexures:
        """The ways in which links give way: those that terms need."""
        return flexures(self.terms, [joint.name for joint in self.chain], segments(self))

    @property
    def mechanism(self) -> Mechanism:
        """The joints, with one more for every flexure."""
        parts = self.coupling, self.coupling_offset, self.offset_coupling, self.flexures.every
        # As the URDF draws it, and with all joints in the middle of their limits.
        middles = [0.5 * ((reading.lower or 0.0) + (reading.upper or 0.0)) for reading in self.readings]
        return mechanism(segments(self), self.loops, *parts, np.array([[0.0] * len(middles), middles]))

    @property
    def moving_types(self) -> tuple[MovingType, ...]:
        """Types of the moving joints."""
        return tuple(joint.type for joint in self.chain if joint.type != "fixed")

    @property
    def reach(self) -> float:
        """Upper bound in m of the distance from base to tip, within the limits of the joints."""
        return self._lengths + sum(
            max(abs(reading.lower or 0.0), abs(reading.upper or 0.0)) for reading in self._slides.values()
        )

    @checked
    def reach_at(self, readings: Array) -> float:
        """Return an upper bound in m of the distance from base to tip at readings (N, nr).

        Slides count by how far they are out: their limits in a URDF are often numbers that stand for none.
        """
        return self._lengths + float(np.sum(np.abs(self.own(readings)[:, [*self._slides]]).max(axis=0, initial=0.0)))

    @property
    def _slides(self) -> dict[int, Reading]:
        return {k: reading for k, reading in enumerate(self.readings) if reading.dimension == "length"}

    @property
    def _lengths(self) -> float:
        joint, lengths = self.tip_joint, 0.0
        while joint >= 0:
            lengths += float(np.linalg.norm(self.chain[joint].placement[:3, 3]))
            joint = self.chain[joint].parent
        return lengths

    @property
    def root_in_base(self) -> Array:
        """The root link of the URDF (4, 4) in the arm's base link, with joints between them at zero."""
        T, link = np.eye(4), self.base
        while (joint := self.urdf.parent_joint(link)) is not None:
            T, link = joint.origin @ T, joint.parent
        return rigid.inverse(T)

    def no_deviations(self) -> Deviations:
        """Return the deviations of the nominal machine: zeros."""
        return Deviations(
            read_only(np.zeros((len(self.chain), 6))),
            read_only(np.zeros(len(self.moving))),
            read_only(np.zeros(len(self.terms))),
        )

    @checked
    def joint_positions(
        self, readings: Array, deviations: Deviations | None = None, conditions: Conditions = NO_CONDITIONS
    ) -> Array:
        """Return the positions (N, nj) of the moving joints at readings (N, nr), loops closed.

        Raises PoseError for a row where a loop cannot close, RobotError for readings of another shape, or a term that
        needs ``conditions`` which the rows do not have.
        """
        return TipModel(self, deviations).joint_positions(self.own(readings), conditions)

    @checked
    def tips(
        self, readings: Array, deviations: Deviations | None = None, conditions: Conditions = NO_CONDITIONS
    ) -> Array:
        """Return the tip placements (N, 4, 4) in the base link at readings (N, nr). Raises as joint_positions does."""
        return TipModel(self, deviations).tips(self.own(readings), conditions)

    @checked
    def motion(
        self, readings: Array, deviations: Deviations | None = None, conditions: Conditions = NO_CONDITIONS
    ) -> TipMotion:
        """Return tip placements and derivatives at readings (N, nr). Raises as joint_positions does."""
        return TipModel(self, deviations).motion(self.own(readings), conditions)

    @checked
    def own(self, readings: npt.ArrayLike) -> Array:
        """Return readings (N, nr) as they are, in double precision.

        Raises RobotError when they have not a column for each of this robot's, or one is not a number up to
        ``LARGEST_READING``.
        """
        found = np.asarray(readings, dtype=np.float64)
        if found.ndim != 2 or found.shape[1] != len(self.readings):
            names = ", ".join(reading.name for reading in self.readings)
            raise RobotError(
                f"readings of shape {found.shape}: needs (N, {len(self.readings)}), a column for each of {names}."
            )
        for k, reading in enumerate(self.readings):
            # A comparison with nan is false.
            within = np.abs(found[:, k]) <= LARGEST_READING
            if not within.all():
                row, unit = int(np.argmin(within)), "rad" if reading.dimension == "angle" else "m"
                raise RobotError(
                    f"readings: row {row + 1} of {reading.name!r} is {found[row, k]:g}; allowed is "
                    f"{-LARGEST_READING:g} to {LARGEST_READING:g} {unit}."
                )
        return found


class TipModel:
    """A robot with given deviations, ready to be evaluated at many readings. Not to be shared by threads.

    ``types`` of all joints that move and ``passive``, numbers of those that loops determine; ``end`` (4, 4): the tip in
    the last joint that carries it. ``nominal``: that of the robot, or of the same one with another tip, where it is
    made once for many deviations. ``motions``: of the placements of these, where they are made already.
    """

    def __init__(
        self,
        robot: Robot,
        deviations: Deviations | None = None,
        nominal: "Nominal | None" = None,
        motions: Motions | None = None,
    ) -> None:
        d = deviations or robot.no_deviations()
        self._nominal = nominal = nominal or Nominal(robot)
        m = nominal.mechanism
        if motions is None:
            refuse_other_deviations(robot, d)
            motions = Motions.of(d.placements)
        self._skeleton = nominal.outline.moved(m.of_segments(motions))
        self._tip = int(m.carrying[robot.tip_joint]) if robot.tip_joint >= 0 else -1
        self._mechanism, self._offsets = m, m.coupling_offset + m.offset_coupling @ d.offsets
        self.types, self.passive = nominal.outline.types, nominal.passive
        frame = self._skeleton.end_frame(self._tip)
        self.end = frame.placement
        self._kinematics = Kinematics(self._skeleton.tree, [frame], nominal.joints)
        homes = m.homes + m.offset_coupling @ d.offsets
        self._closure = Closure(self._skeleton, m.loops, homes) if m.loops else None
        self._terms = None if nominal.terms is None else Transmission(nominal.terms, d.terms, nominal.holding)
        self._rates: tuple[Array, tuple[Array, Array]] | None = None

    @cached_property
    def follow(self) -> Array:
        """How local twists of the tip's carriers follow the deviations (6 (w + 1), n), component by component.

        Deviations are placements row by row, then offsets.
        """
        return self.follow_with(self._nominal.deviations(self._tip), _NOTHING, self.end, _NOTHING)

    @property
    def carrying(self) -> "Carrying":
        """What is the same of any machine in how the tip's carriers follow."""
        return self._nominal.carrying(self._tip)

    def follow_with(self, unknowns: "Unknowns", base_twists: Array, tool: Array, tool_twists: Array) -> Array:
        """Return how local twists of the tip's carriers follow c ``unknowns`` (6 (w + 1), c), by :attr:`carrying`.

        The base link has ``base_twists`` (6, 6) for changes of six values of its own; so has a tool, which is at
        ``tool`` (4, 4) in the last carrier.
        """
        s, own = self._skeleton, self.carrying.segments
        placed = np.concatenate([s.carried[own], _AT_BASE, tool[None]])
        twists = np.concatenate([s.twists[own], base_twists[None], tool_twists[None]])
        return unknowns.followed(rigid.carried(placed, twists))

    def joint_positions(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return the positions (N, nj) of the moving joints at readings (N, nr), loops closed."""
        q = self._positions(readings, conditions)
        return q if self._mechanism.rigid else np.asarray(q[:, self._mechanism.own])

    def closes(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> BoolArray:
        """Return at which readings (N, nr) the loops close; :meth:`joint_positions` raises PoseError at the others."""
        found = np.ones(len(readings), dtype=bool)
        if self._closure is not None:
            rows = self._weighable(readings)
            found[~rows] = False
            found[rows] = self._closure.closes(self._coupled(readings[rows], conditions.subset(rows)))
        return found

    def determinants(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> Array | None:
        """Return the determinants of closure (N,) at readings (N, nr), as :meth:`Closure.determinants`.

        None where there is no loop; nan at readings where loops do not close.
        """
        if self._closure is None:
            return None
        found, rows = np.full(len(readings), np.nan), self._weighable(readings)
        found[rows] = self._closure.determinants(self._coupled(readings[rows], conditions.subset(rows)))
        return found

    def _weighable(self, readings: Array) -> BoolArray:
        """Return at which readings (N, nr) what terms ask for is known: where the nominal loops close that weigh."""
        holding = self._nominal.holding
        return np.ones(len(readings), dtype=bool) if holding is None else holding.closes(readings)

    def tips(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return the tip placements (N, 4, 4) in the base link at readings (N, nr)."""
        return self._kinematics.placements(self._positions(readings, conditions))[0]

    def carried(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> Regressor:
        """Return what carries the tip, and so where it is, at readings (N, nr)."""
        return self._kinematics.regressors(self._positions(readings, conditions))[0]

    def motion(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> TipMotion:
        """Return tip placements and derivatives at readings (N, nr)."""
        bases = None if self._terms is None else self._terms.bases(readings, conditions)
        q = self._positions(readings, conditions, bases)
        if self._closure is None:
            rates = np.zeros((len(q), 0, self._nominal.unknowns))
        else:
            rates = self._mechanism.of_chain(self._passive_rates(q)[0])
        return TipMotion(self._kinematics.regressors(q)[0], rates, bases, self, q)

    def driven(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> tuple[Array, Array]:
        """Return tip placements (N, 4, 4) and the local twists (N, 6, nr) of the tip per change of the readings.

        At readings (N, nr): joints move by their coupling, passive ones as their loops make them follow. Raises as
        joint_positions does.
        """
        q = self._positions(readings, conditions)
        placement, by_joint = self._kinematics.jacobian(q)
        return placement, self.by_reading(q, by_joint.transpose(2, 1, 0), readings)

    def by_reading(self, q: Array, by_joint: Array, readings: Array) -> Array:
        """Return how numbers follow the readings (N, d, nr), at which the joints are at q (N, nj).

        ``by_joint`` (nj, d, N): how they follow the joints.
        """
        by_reading = self._by_coordinate(q, by_joint)[: readings.shape[1]].transpose(2, 1, 0)
        if self._terms is not None:
            by_reading = by_reading * self._terms.slopes(readings)[:, None]
        return by_reading

    def by_terms(self, q: Array, by_joint: Array, bases: Bases) -> Array:
        """Return how numbers follow the coefficients of the terms (N, d, nt); the rest as in :meth:`by_reading`."""
        assert self._terms is not None, "a model that has bases has terms"
        return self._terms.by_terms(self._by_coordinate(q, by_joint), bases)

    def _positions(self, readings: Array, conditions: Conditions, bases: Bases | None = None) -> Array:
        """Return the positions (N, nj) of all joints of the mechanism at readings (N, nr), loops closed."""
        q = self._coupled(readings, conditions, bases)
        return q if self._closure is None else self._closure.close(q)

    def _coupled(self, readings: Array, conditions: Conditions, bases: Bases | None = None) -> Array:
        """Return the positions (N, nj) of all joints of the mechanism, passive ones where their search starts."""
        moved = readings if self._terms is None else self._terms.moved(readings, conditions, bases)
        q = moved @ self._mechanism.coupling.T
        q += self._offsets
        return q

    def _by_coordinate(self, q: Array, by_joint: Array) -> Array:
        """Return how numbers follow what is coupled to the joints (c, d, N), at q (N, nj); ``by_joint`` as above."""
        coupling, passive = self._mechanism.coupling, self.passive
        _, d, n = by_joint.shape
        active = coupling.copy()
        active[passive] = 0.0
        found = (active.T @ by_joint.reshape(len(active), d * n)).reshape(active.shape[1], d, n)
        if self._closure is not None:
            found += np.einsum("kdn,nkc->cdn", by_joint[passive], self._passive_rates(q)[1])
        return found

    def _passive_rates(self, q: Array) -> tuple[Array, Array]:
        """Return how passive joints follow deviations and offsets, and what is coupled, at q (N, nj): asked for twice.

        The last answer is kept.
        """
        if self._rates is None or self._rates[0] is not q:
            assert self._closure is not None, "a model with passive joints has loops"
            offsets, coupling = self._mechanism.offset_coupling, self._mechanism.coupling
            every, ends = self._closure.rates(q, np.hstack([offsets, coupling])), coupling.shape[1]
            self._rates = q, (every[:, :, :-ends], every[:, :, -ends:])
        return self._rates[1]


class Unknowns(NamedTuple):
    """How local twists of the carriers of a frame follow c unknowns, whatever the machine.

    Local twists of all that moves by six values, (m, 6, 6) in its carriers, are all that differs: of ``entry`` (k,) of
    these a ``share`` (k,) is at ``place`` (k,) of the matrix (6 (w + 1), c) that is asked for. ``rest`` (6 (w + 1), c)
    is added: what joint offsets do.
    """

    entry: IntArray
    share: Array
    place: IntArray
    rest: Array

    def followed(self, twists: Array) -> Array:
        """Return the matrix for local twists in the carriers."""
        found = np.bincount(self.place, self.share * twists.reshape(-1)[self.entry], self.rest.size)
        return np.asarray(found.reshape(self.rest.shape) + self.rest)


class Carrying(NamedTuple):
    """What is the same of any machine in how the carriers of a frame follow deviations, base and a tool.

    ``segments`` (m): those on the way to the frame that have deviations. ``carriers`` (m + 2): which of s carriers has
    the local twists of each, of the base and of the tool; ``columns`` (m + 2): the first of six of theirs, of n + 12.
    ``offsets`` (6 s, n + 12): how carriers follow joint offsets.
    """

    segments: slice | IntArray
    carriers: IntArray
    columns: IntArray
    offsets: Array

    def by(self, S: Array) -> Unknowns:
        """Return how carriers follow c unknowns, where deviations, base and tool follow these by ``S`` (n + 12, c)."""
        # Of each of six values of what moves, the unknowns that it follows: six numbers of its twist follow them.
        what, value, unknown = np.nonzero(S[self.columns[:, None] + np.arange(6)])
        number, s = np.arange(6)[:, None], len(self.offsets) // 6
        return Unknowns(
            (36 * what + 6 * number + value).ravel(),
            np.tile(S[self.columns[what] + value, unknown], 6),
            (S.shape[1] * (s * number + self.carriers[what]) + unknown).ravel(),
            self.offsets @ S,
        )


class Nominal:
    """What models of a robot share, whatever its tip and deviations. Not to be shared by threads.

    ``unknowns``: how many deviations of placements, and offsets of joints, there are.
    """

    def __init__(self, robot: Robot) -> None:
        self.mechanism, flexures, of_chain = robot.mechanism, robot.flexures, segments(robot)
        self.outline, self.passive = Outline(self.mechanism.segments), passive_joints(self.mechanism.loops)
        self.joints = Joints(self.outline.types, self.outline.parents)
        self.holding = None if robot.weights is None or not robot.terms else Holding(robot.weights)
        names = [reading.name for reading in robot.readings]
        self.terms = TermShares(robot.terms, names, flexures, of_chain) if robot.terms else None
        self.unknowns = 6 * len(self.mechanism.placed) + self.mechanism.offset_coupling.shape[1]
        self._carrying: dict[int, Carrying] = {}
        self._deviations: dict[int, Unknowns] = {}

    def carrying(self, joint: int) -> Carrying:
        """Return how what carries the end of a joint follows any machine."""
        if joint not in self._carrying:
            self._carrying[joint] = self._carried(joint)
        return self._carrying[joint]

    def deviations(self, joint: int) -> Unknowns:
        """Return how it follows the deviations, placements row by row, then offsets."""
        if joint not in self._deviations:
            self._deviations[joint] = self.carrying(joint).by(np.eye(self.unknowns + 12)[:, :-12])
        return self._deviations[joint]

    def _carried(self, joint: int) -> Carrying:
        m, path = self.mechanism, self.outline.path(joint)
        s, n = len(path.way) + 1, self.unknowns
        offsets = np.zeros((6, s, n + 12))
        for k, j in enumerate(path.way):
            if j not in self.passive:
                # A joint's own motion commutes with a change of its position: the same for all rows.
                component = 5 if self.outline.types[j] == "revolute" else 2
                offsets[component, k + 1, 6 * len(m.placed) : n] = m.offset_coupling[j]
        # Of the segments, those that are none of the chain's give way, and do not deviate.
        _, of_chain, on_way = np.intersect1d(m.placed, path.segments, return_indices=True)
        carriers = np.array([*path.carriers[on_way], 0, s - 1])
        columns = np.array([*(6 * of_chain), n, n + 6])
        return Carrying(as_slice(path.segments[on_way]), carriers, columns, offsets.reshape(6 * s, -1))


class Nominals(dict[Robot, Nominal]):
    """What models of robots share, made when first asked for. Not to be shared by threads."""

    def __missing__(self, robot: Robot) -> Nominal:
        """Make that of a robot."""
        self[robot] = Nominal(robot)
        return self[robot]

    def __reduce__(self) -> tuple[type["Nominals"], tuple[()]]:
        """Leave out what is made again when it is asked for."""
        return type(self), ()


def refuse_other_deviations(robot: Robot, d: Deviations) -> None:
    """Raise RobotError for deviations of another arm: there is one for each of what this one has."""
    for name, found, needed in (
        ("placements", d.placements.shape, (len(robot.chain), 6)),
        ("offsets", d.offsets.shape, (len(robot.moving),)),
        ("terms", d.terms.shape, (len(robot.terms),)),
    ):
        if found != needed:
            raise RobotError(f"deviations: {name} has the shape {found}; of this arm it is {needed}.")


def segments(robot: Robot) -> list[Segment]:
    """Return the chain as segments of a skeleton."""
    numbers = {i: j for j, i in enumerate(robot.moving)}
    return [
        Segment(numbers.get(i), joint.type, joint.parent, joint.placement, joint.frame)
        for i, joint in enumerate(robot.chain)
    ]
