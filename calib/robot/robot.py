"""A robot arm: the chain of joints from a base link to a tip link of a URDF, with deviations.

The chain is kept in the frames in which deviations are named: z along each joint's axis. Every joint of it, moving or
fixed, carries a deviation; the readings of the encoders become joint positions through a linear coupling.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, cast

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import RobotError
from calib.robot import deviation, kinematics
from calib.robot.kinematics import MovingType
from calib.robot.urdf import Urdf, UrdfJoint, read_urdf


@dataclass(frozen=True, slots=True)
class Reading:
    """One number that the machine reports for every pose: an encoder reading, named after its URDF joint.

    ``lower`` and ``upper`` are the joint's limits in rad or m, None where the URDF sets none.
    """

    name: str
    dimension: Literal["angle", "length"]
    lower: float | None
    upper: float | None


@dataclass(frozen=True, slots=True, eq=False)
class ChainJoint:
    """One joint of the chain. ``placement`` (4, 4): its frame in the frame of the joint before it, nominally.

    ``frame`` (4, 4) is the rotation from the URDF's joint frame to the frame here, whose z is the joint's axis.
    """

    name: str
    type: Literal["revolute", "prismatic", "fixed"]
    placement: Array
    frame: Array


@dataclass(frozen=True, slots=True, eq=False)
class Deviations:
    """How a machine differs from its URDF.

    ``placements`` (number of chain joints, 6): (tx, ty, tz, rx, ry, rz) of each joint's placement, in m and rad.
    ``offsets`` (number of moving joints): added to the joint's position, in rad or m; an offset of a joint that others
    mimic moves these too, as its reading does.
    """

    placements: Array
    offsets: Array


class TipMotion(NamedTuple):
    """Tip placements over N rows, and their exact derivative with respect to every deviation.

    The local twist (N, 6) of the tip for a change ``e`` of the deviations (placements row by row, then offsets) is
    ``regressor @ (joints @ e) + tail @ e``. Only ``regressor`` depends on the row; ``joints`` (6 nj, n) and ``tail``
    (6, n) belong to the deviations at which they were taken.
    """

    rotation: Array
    position: Array
    regressor: Array
    joints: Array
    tail: Array


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """An arm, as its URDF designed it. Made by :func:`load_robot`.

    ``coupling`` (nj, nr) and ``coupling_offset`` (nj): joint positions = coupling @ readings + coupling_offset.
    ``offset_coupling`` (nj, nj): joint positions += offset_coupling @ offsets.
    """

    urdf: Urdf
    base: str
    tip: str
    chain: tuple[ChainJoint, ...]
    readings: tuple[Reading, ...]
    coupling: Array
    coupling_offset: Array
    offset_coupling: Array

    @property
    def moving(self) -> tuple[int, ...]:
        """Indices into ``chain`` of the moving joints."""
        return tuple(i for i, joint in enumerate(self.chain) if joint.type != "fixed")

    @property
    def moving_types(self) -> tuple[MovingType, ...]:
        """Types of the moving joints."""
        return tuple(joint.type for joint in self.chain if joint.type != "fixed")

    @property
    def reach(self) -> float:
        """Upper bound in m of the distance from base to tip, prismatic joints at zero left out of their travel."""
        lengths = sum(float(np.linalg.norm(joint.placement[:3, 3])) for joint in self.chain)
        travel = sum(
            max(abs(reading.lower or 0.0), abs(reading.upper or 0.0))
            for reading in self.readings
            if reading.dimension == "length"
        )
        return lengths + travel

    def no_deviations(self) -> Deviations:
        """Return the deviations of the nominal machine: zeros."""
        return Deviations(read_only(np.zeros((len(self.chain), 6))), read_only(np.zeros(len(self.moving))))

    def joint_positions(self, readings: Array, offsets: Array | None = None) -> Array:
        """Return the positions (N, nj) of the moving joints at readings (N, nr)."""
        q = readings @ self.coupling.T + self.coupling_offset
        return q if offsets is None else q + self.offset_coupling @ offsets

    def tips(self, readings: Array, deviations: Deviations | None = None) -> Array:
        """Return the tip placements (N, 4, 4) in the base link at readings (N, nr)."""
        d = deviations or self.no_deviations()
        frames = _Frames.of(self, d.placements)
        q = self.joint_positions(readings, d.offsets)
        return kinematics.forward(self.moving_types, frames.joint_placements, frames.tip, q)

    def motion(self, readings: Array, deviations: Deviations | None = None) -> TipMotion:
        """Return tip placements and derivatives at readings (N, nr), for a machine with the given deviations."""
        d = deviations or self.no_deviations()
        frames = _Frames.of(self, d.placements)
        q = self.joint_positions(readings, d.offsets)
        rotation, position, matrix = kinematics.regressor(self.moving_types, frames.joint_placements, frames.tip, q)
        joints, tail = _derivative(self, d, frames)
        return TipMotion(rotation, position, matrix, joints, tail)

    def base_column(self, deviations: Deviations) -> Array:
        """Return Ad (6, 6) that carries a local twist of the base link to one of the first moving joint's placement."""
        first = _Frames.of(self, deviations.placements).joint_placements[0]
        return rigid.adjoint(rigid.inverse(first))


def load_robot(urdf: str | Path | Urdf, tip: str | None = None, base: str | None = None) -> Robot:
    """Load the arm from link ``base`` (default: the root link) to link ``tip`` (default: the only leaf link).

    ``urdf`` is a path, or ``"example:panda_description/urdf/panda.urdf"`` for a file of example-robot-data.
    Raises RobotError with one sentence when the file or the arm cannot be used.
    """
    document = urdf if isinstance(urdf, Urdf) else read_urdf(urdf)
    tip = _only_leaf(document) if tip is None else _known_link(document, tip, "tip")
    base = document.root if base is None else _known_link(document, base, "base")
    path = _path(document, base, tip)
    chain = _chain(path)
    moving = [joint for joint in path if joint.type != "fixed"]
    if not moving:
        raise RobotError(f"{document.where}: no joint moves between {base!r} and {tip!r}; choose another tip.")
    readings, coupling, coupling_offset = _couple(document, moving)
    offset_coupling = np.eye(len(moving))
    names = [reading.name for reading in readings]
    for i, joint in enumerate(moving):
        if joint.mimic is None:
            offset_coupling[:, i] = coupling[:, names.index(joint.name)]
    return Robot(
        document,
        base,
        tip,
        chain,
        readings,
        read_only(coupling),
        read_only(coupling_offset),
        read_only(offset_coupling),
    )


def _known_link(document: Urdf, name: str, role: str) -> str:
    if name not in document.links:
        raise RobotError(
            f"{document.where}: {role} {name!r} is not a link of the URDF; its links are {_list(document.links)}."
        )
    return name


def _only_leaf(document: Urdf) -> str:
    parents = {joint.parent for joint in document.joints}
    leaves = [link for link in document.links if link not in parents]
    if len(leaves) != 1:
        raise RobotError(f"{document.where}: which link is the tip? Choose one of {_list(leaves)}.")
    return leaves[0]


def _list(names: Sequence[str], most: int = 12) -> str:
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def _path(document: Urdf, base: str, tip: str) -> tuple[UrdfJoint, ...]:
    path: list[UrdfJoint] = []
    link = tip
    while link != base:
        joint = document.parent_joint(link)
        if joint is None:
            raise RobotError(
                f"{document.where}: base {base!r} does not carry tip {tip!r}: the links are on other branches."
            )
        if joint.type in ("floating", "planar"):
            raise RobotError(
                f"{document.where}:{joint.line}: joint {joint.name!r} between {base!r} and {tip!r} is {joint.type}; "
                "an arm needs revolute, continuous, prismatic or fixed joints, so choose a base behind it."
            )
        path.append(joint)
        link = joint.parent
    return tuple(reversed(path))


def _chain(path: Sequence[UrdfJoint]) -> tuple[ChainJoint, ...]:
    chain: list[ChainJoint] = []
    before = np.eye(4)
    for joint in path:
        frame = np.eye(4) if joint.type == "fixed" else deviation.axis_frame(joint.axis)
        # A continuous joint is a revolute one without limits; Pinocchio would give it two coordinates.
        kind = "revolute" if joint.type == "continuous" else joint.type
        placement = rigid.inverse(before) @ joint.origin @ frame
        chain.append(
            ChainJoint(
                joint.name,
                cast(Literal["revolute", "prismatic", "fixed"], kind),
                read_only(placement),
                read_only(frame),
            )
        )
        before = frame
    return tuple(chain)


def _couple(document: Urdf, moving: Sequence[UrdfJoint]) -> tuple[tuple[Reading, ...], Array, Array]:
    """Return the readings in the order of the chain, and joint positions = coupling @ readings + offset."""
    readings: list[Reading] = []
    rows: list[tuple[str, float, float]] = []
    for joint in moving:
        driver, multiplier, offset = joint, 1.0, 0.0
        while driver.mimic is not None:
            offset += multiplier * driver.mimic.offset
            multiplier *= driver.mimic.multiplier
            driver = document.joint(driver.mimic.joint)
        if driver.type not in ("revolute", "continuous", "prismatic"):
            raise RobotError(
                f"{document.where}:{joint.line}: joint {joint.name!r} mimics {driver.name!r}, which is {driver.type} "
                "and has no reading."
            )
        if driver.name not in (reading.name for reading in readings):
            dimension: Literal["angle", "length"] = "length" if driver.type == "prismatic" else "angle"
            readings.append(Reading(driver.name, dimension, driver.lower, driver.upper))
        rows.append((driver.name, multiplier, offset))
    names = [reading.name for reading in readings]
    coupling = np.zeros((len(moving), len(names)))
    for i, (name, multiplier, _) in enumerate(rows):
        coupling[i, names.index(name)] = multiplier
    return tuple(readings), coupling, np.array([offset for _, _, offset in rows])


class _Frames(NamedTuple):
    """Placements of the moving joints (nj, 4, 4), of the tip in the last one, and of every chain joint towards them."""

    joint_placements: Array
    tip: Array
    onward: Array  # (n, 4, 4): from each chain joint to the next moving joint's placement, or to the tip
    target: tuple[int, ...]  # (n,): number of that moving joint; nj stands for the tip

    @classmethod
    def of(cls, robot: Robot, placements: Array) -> "_Frames":
        segments = np.stack([joint.placement for joint in robot.chain]) @ deviation.motion(placements)
        moving = robot.moving
        onward = np.empty_like(segments)
        target = [0] * len(segments)
        # From the tip inwards. The tip is the last link's own URDF frame, which the last joint's named frame undoes.
        ahead, number = rigid.inverse(robot.chain[-1].frame), len(moving)
        joint_placements = np.empty((len(moving), 4, 4))
        tip = ahead
        for i in range(len(segments) - 1, -1, -1):
            if robot.chain[i].type != "fixed":
                if number == len(moving):
                    tip = ahead
                else:
                    joint_placements[number] = ahead
                number -= 1
                onward[i], target[i] = np.eye(4), number
                ahead = segments[i]
            else:
                onward[i], target[i] = ahead, number
                ahead = segments[i] @ ahead
        joint_placements[0] = ahead
        return cls(joint_placements, tip, onward, tuple(target))


def _derivative(robot: Robot, d: Deviations, frames: _Frames) -> tuple[Array, Array]:
    """Return ``joints`` (6 nj, n) and ``tail`` (6, n) of TipMotion; n = 6 chain joints + moving joints."""
    n_moving, n_chain = len(robot.moving), len(robot.chain)
    rows = np.zeros((n_moving + 1, 6, 6 * n_chain + n_moving))
    blocks = rigid.adjoint(rigid.inverse(frames.onward)) @ deviation.twists(d.placements)
    for i, number in enumerate(frames.target):
        rows[number, :, 6 * i : 6 * i + 6] = blocks[i]
    for j, kind in enumerate(robot.moving_types):
        # A joint's own motion commutes with a change of its position, so this column does not depend on the row.
        rows[j, 5 if kind == "revolute" else 2, 6 * n_chain :] = robot.offset_coupling[j]
    return rows[:-1].reshape(6 * n_moving, -1), rows[-1]
