"""What every coordinate holds: torques, and forces where it slides, at nominal geometry.

Against gravity, and, while the arm moves, against the inertia of its links.

The potential energy V of the machine's links is a function of the coordinates u alone: the readings and, where links
give way, the ways in which they do; passive joints of closed loops follow. What coordinate i holds is dV/du_i: by
virtual work ``(dq/du)^T g(q)``, with the gravity torques g of the tree of joints and the rates dq/du at which all
joints, passive ones too, follow the coordinates. Of rows that tell how joints moved, g(q) gives way to the inverse
dynamics ``M(q) a + C(q, v) v + g(q)`` of the tree (R. Featherstone, *Rigid body dynamics algorithms*, 2008, chapter 5);
where loops close, gravity alone counts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from calib.foundations.arguments import own_fields
from calib.foundations.arrays import Array, BoolArray, read_only_view
from calib.foundations.errors import RobotError
from calib.foundations.ranges import refuse_beyond
from calib.foundations.sealing import sealed
from calib.foundations.words import not_loaded
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.flexures import Mechanism
from calib.robot.kinematics import Frame, Joints, Kinematics, Mass, Regressor, Weighed
from calib.robot.loops import Closure, passive_joints
from calib.robot.skeleton import Outline, Skeleton

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)


@dataclass(frozen=True, slots=True)
class Payload:
    """What a link carries: ``mass`` in kg, its centre ``position`` in m in the link's frame.

    ``link``: one of those that the robot was loaded with; "" is its tip.

    Raises RobotError when a number is out of range.
    """

    mass: float
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    link: str = ""

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_beyond(self.mass, "mass", "payload: mass", RobotError)
        refuse_beyond(self.position, "position, station, point", "payload: position", RobotError)

    @property
    def moments(self) -> tuple[float, float, float, float]:
        """Its first moment in kg m, and its mass in kg: what torques are linear in."""
        x, y, z = self.position
        return self.mass * x, self.mass * y, self.mass * z, self.mass


@dataclass(frozen=True, slots=True)
class Load:
    """What bears on a robot beside its own links: ``gravity`` (m/s^2) in the base link, and a ``payload``, or none.

        on_the_wall = calib.measuring.Load(gravity=(9.80665, 0.0, 0.0), payload=calib.measuring.Payload(2.5))

    Raises RobotError when a number is out of range.
    """

    gravity: tuple[float, float, float] = STANDARD_GRAVITY
    payload: Payload | None = None

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_beyond(self.gravity, "gravity", "load: gravity", RobotError)


def checked_gravity(gravity: Sequence[float], where: str) -> tuple[float, float, float]:
    """Return gravity as it is. Raises RobotError where it is not three numbers, or out of range."""
    if len(gravity) != 3:
        raise RobotError(f"{where}: gravity {tuple(gravity)} is not three numbers in m/s^2.")
    refuse_beyond(gravity, "gravity", f"{where}: gravity", RobotError)
    x, y, z = map(float, gravity)
    return x, y, z


def checked_payload(payload: Payload | None, links: Sequence[str], where: str) -> Payload | None:
    """Return a payload as it is. Raises RobotError where it is on none of the ``links``."""
    if payload is not None and payload.link and payload.link not in links:
        raise RobotError(f"{where}: the payload's link {not_loaded(payload.link, links)}.")
    return payload


class Body(NamedTuple):
    """A mass in kg that a ``joint`` of the chain carries, its ``centre`` (3,) in m in the joint's link.

    ``inertia`` (3, 3): about the centre, along the link's axes, in kg m^2.
    """

    joint: int
    mass: float
    centre: Array
    inertia: Array


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Weights:
    """A nominal machine with masses, ``bodies``.

    ``units``: masses that nobody knows, by name: the chain joint that carries one, and (4,) its first moment in kg m in
    that joint's frame, then its mass in kg. ``gravity`` (3,) in m/s^2, in the base link. ``hands``: the chain joints
    that carry the links on which rows may have another payload than the one among the bodies, -1 for the base;
    ``payload`` (links, 4): the first moment and mass of that one. ``own``: of links that give way, a coordinate, the
    chain joint that carries the link, and in that joint's frame its masses times their motions (3,) within the link, in
    kg m per unit of the coordinate.
    """

    mechanism: Mechanism
    bodies: tuple[Body, ...]
    gravity: Array
    units: tuple[tuple[str, int, Array], ...] = ()
    hands: tuple[int, ...] = ()
    payload: Array = field(default_factory=lambda: np.zeros((0, 4)))
    own: tuple[tuple[int, int, Array], ...] = ()


# Bytes of torques that are kept: a search asks for those of the same rows in every step.
_MOST_KEPT = 2**25


class Holding:
    """Evaluates what coordinates hold, the readings being given and links straight. Not to be shared by threads."""

    def __init__(self, weights: Weights) -> None:
        m = weights.mechanism
        s = Outline(m.segments).skeleton(np.zeros((len(m.segments), 6)))
        self._weights, self._passive = weights, passive_joints(m.loops)
        self._closure = Closure(s, m.loops, m.homes) if m.loops else None
        carried = sorted({joint for _, joint, _ in weights.units})
        self._frames = {joint: k for k, joint in enumerate(carried)}
        joints = Joints(s.tree.types, s.tree.parents)  # once: Pinocchio's memory grows with the cube of how many
        self._kinematics = Kinematics(s.tree, [_frame(s, int(m.carrying[joint])) for joint in carried], joints)
        self._masses = Weighed(s.tree, _masses(s, weights))
        moved = [k for k, joint in enumerate(weights.hands) if joint >= 0]
        self._hands = np.array(moved, dtype=np.intp)
        self._at_hands = Kinematics(s.tree, [s.end_frame(int(m.carrying[weights.hands[k]])) for k in moved], joints)
        self._links = Kinematics(s.tree, [_frame(s, int(m.carrying[joint])) for _, joint, _ in weights.own], joints)
        self.units = {name: k for k, (name, _, _) in enumerate(weights.units)}
        self._kept: dict[tuple[object, ...], Array] = {}

    def __call__(self, readings: Array, told: Conditions = NO_CONDITIONS) -> Array:
        """Return the torques (N, c) in Nm, and forces in N of coordinates that are lengths, at readings (N, nr).

        Under gravity and payloads that are ``told`` of the rows, else those of the robot; rows that moved are told how.
        The inertia of a payload that is the robot's own counts, that of another one does not; nor does that of links in
        how they themselves give way.
        """
        return self._once(self._of_all, readings, told)

    def of_units(self, readings: Array, told: Conditions = NO_CONDITIONS) -> Array:
        """Return what each of the ``units`` alone would have coordinates hold (units, N, c), at readings (N, nr)."""
        return self._once(self._of_units, readings, told)

    def _once(self, made: Callable[[Array, Conditions], Array], readings: Array, told: Conditions) -> Array:
        """Return what is made of rows, which follows nothing else; kept until there is too much of it."""
        key = (made.__name__, readings.tobytes(), *(own if own is None else own.tobytes() for own in told.of_loads))
        if key not in self._kept:
            found = read_only_view(made(readings, told))
            if (1 + len(self._kept)) * (found.nbytes + readings.nbytes) > _MOST_KEPT:
                self._kept.clear()
            self._kept[key] = found
        return self._kept[key]

    def _of_all(self, readings: Array, told: Conditions) -> Array:
        """Return what coordinates hold (N, c) of all masses."""
        q, follow = self._posed(readings)
        gravity = self._gravity(len(q), told)
        found = _by_virtual_work(self._of_bodies(q, gravity, told), follow)
        if self._weights.own:
            placed = self._links.placements(q)
            for (coordinate, _, masses), at in zip(self._weights.own, placed, strict=True):
                found[:, coordinate] -= np.einsum("ni,nij,j->n", gravity, at[:, :3, :3], masses)
        if (other := self._other_payloads(told)) is not None:
            rows, more = other
            found[rows] += self._carried(q[rows], follow[rows] if follow.ndim == 3 else follow, gravity[rows], more)
        return found

    def _of_bodies(self, q: Array, gravity: Array, told: Conditions) -> Array:
        """Return what the joints of the tree hold (N, nj)."""
        if told.motion is None or self._closure is not None:
            return self._masses.holding(q, gravity)
        own = self._weights.mechanism.coupling[:, : told.motion.shape[2]]
        rates, accelerations = np.moveaxis(told.motion @ own.T, 1, 0)
        return self._masses.driving(q, rates, accelerations, gravity)

    def _of_units(self, readings: Array, told: Conditions) -> Array:
        """Return what coordinates hold (units, N, c) of each unit alone."""
        q, follow = self._posed(readings)
        regressors, gravity = self._kinematics.regressors(q), self._gravity(len(q), told)
        found = np.empty((len(self._weights.units), len(q), follow.shape[-1]))
        for joint, frame in self._frames.items():
            those = [k for k, (_, carrier, _) in enumerate(self._weights.units) if carrier == joint]
            units = np.array([self._weights.units[k][2] for k in those])
            found[those] = self._of_moments(regressors[frame], units[:, None], gravity, follow)
        return found

    def _of_moments(self, frame: Regressor, moments: Array, gravity: Array, follow: Array) -> Array:
        """Return what coordinates hold (..., N, c) of first moments and masses (..., N, 4) in a frame, N or 1 of each.

        A first moment h in a frame R has the energy -g . R h, and a turn w of the frame in itself changes it by
        -(h x R^T g) . w; a mass m, moved by v, by -m R^T g . v.
        """
        types = self._weights.mechanism.types
        g = np.einsum("ni,nij->nj", gravity, frame.placement[:, :3, :3])
        slopes = np.concatenate([moments[..., 3:] * g, np.cross(moments[..., :3], g)], axis=-1)
        twists = frame.by_joint(types, range(len(types)))
        return _by_virtual_work(-np.einsum("...ni,nij->...nj", slopes, twists), follow)

    def _gravity(self, rows: int, told: Conditions) -> Array:
        """Return gravity (N, 3) of rows."""
        own = np.broadcast_to(self._weights.gravity, (rows, 3))
        return own if told.gravity is None else np.where(np.isnan(told.gravity), own, told.gravity)

    def _other_payloads(self, told: Conditions) -> tuple[BoolArray, Array] | None:
        """Return the rows (N,) that carry something else than the robot's own payload, and by how much more (n, L, 4).

        None where there are none.
        """
        if told.payload is None or not self._hands.size:
            return None
        more = (told.payload - self._weights.payload)[:, self._hands]
        more = np.where(np.isnan(more), 0.0, more)
        rows = np.any(more, axis=(1, 2))
        return (rows, more[rows]) if rows.any() else None

    def _carried(self, q: Array, follow: Array, gravity: Array, payloads: Array) -> Array:
        """Return what coordinates hold (N, c) of payloads (N, L, 4) on the hands alone, at q (N, nj)."""
        frames = self._at_hands.regressors(q)
        of_each = [self._of_moments(frame, payloads[:, k], gravity, follow) for k, frame in enumerate(frames)]
        return np.asarray(np.sum(of_each, axis=0))

    def closes(self, readings: Array) -> BoolArray:
        """Return at which readings (N, nr) the loops close; what coordinates hold at others raises PoseError."""
        if self._closure is None:
            return np.ones(len(readings), dtype=bool)
        return self._closure.closes(self._straight(readings))

    def _straight(self, readings: Array) -> Array:
        """Return joint positions (N, nj) with nothing that gives way, passive ones where their search starts."""
        m = self._weights.mechanism
        return np.asarray(readings @ m.coupling[:, : readings.shape[1]].T + m.coupling_offset)

    def _posed(self, readings: Array) -> tuple[Array, Array]:
        """Return joint positions (N, nj), and the rates (nj, c) or (N, nj, c) at which they follow the coordinates."""
        m, q = self._weights.mechanism, self._straight(readings)
        if self._closure is None:
            return q, m.coupling
        q = self._closure.close(q)
        follow = np.repeat(m.coupling[None], len(q), axis=0)
        follow[:, self._passive] = self._closure.rates(q, m.coupling)[:, :, -m.coupling.shape[1] :]
        return q, follow


def _by_virtual_work(g: Array, follow: Array) -> Array:
    return np.asarray(g @ follow if follow.ndim == 2 else np.einsum("...nj,njr->...nr", g, follow))


def _frame(s: Skeleton, segment: int) -> Frame:
    """Return the frame that moves with a joint, whose z is its axis."""
    joint, T = s.end_frame(segment)
    return Frame(joint, T @ s.segments[segment].frame)


def _masses(s: Skeleton, weights: Weights) -> list[Mass]:
    frames = [s.end_frame(int(weights.mechanism.carrying[body.joint])) for body in weights.bodies]
    return [
        Mass(joint, body.mass, T[:3, :3] @ body.centre + T[:3, 3], T[:3, :3] @ body.inertia @ T[:3, :3].T)
        for (joint, T), body in zip(frames, weights.bodies, strict=True)
    ]
