"""A torso with two arms and a head, made badly as a whole; its forward kinematics is that of :mod:`machines`."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

import calib
from calib.robot.urdf import parse_urdf
from tests.support import machines
from tests.support.machines import LIMIT, Arm, Array, Rng, pose

TIPS = ("right_hand", "left_hand", "head")

_ARM = (
    ("shoulder_pan", "{0} 0.05 0.3", "{1} 0 0", "0 0 1"),
    ("shoulder_lift", "0.05 0 0.1", "0 0 0.2", "0 1 0"),
    ("elbow", "0.02 0.03 0.35", "0.1 0 0", "0 1 0"),
    ("forearm", "0 0 0.2", "0 0 0", "0 0 1"),
    ("wrist", "0 0.02 0.15", "0 0 0.1", "0 1 0"),
    ("twist", "0 0 0.1", "0 0.1 0", "0 0 1"),
)


def _joint(name: str, kind: str, parent: str, child: str, xyz: str, rpy: str, axis: str, more: str = "") -> str:
    return (
        f'<link name="{child}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{more}{LIMIT.get(kind, "")}</joint>'
    )


def urdf(kind: str = "fixed") -> str:
    """Two torso joints, a chest with a joint of a ``kind``, and on it two arms and a head."""
    parts = [
        _joint("waist", "revolute", "base", "waist_link", "0 0 0.4", "0 0 0.1", "0 0 1"),
        _joint("lean", "revolute", "waist_link", "lean_link", "0.02 0 0.1", "0 0 0", "0 1 0"),
        _joint("chest", kind, "lean_link", "chest_link", "0 0 0.3", "0 0.1 0", "0 1 0"),
    ]
    for side, x, roll in (("right", -0.2, -0.4), ("left", 0.2, 0.4)):
        parent = "chest_link"
        for k, (name, xyz, rpy, axis) in enumerate(_ARM):
            child = f"{side}_hand" if k + 1 == len(_ARM) else f"{side}_{name}_link"
            at = xyz.format(x, roll), rpy.format(x, roll)
            parts.append(_joint(f"{side}_{name}", "revolute", parent, child, *at, axis))
            parent = child
    parts.append(_joint("neck", "revolute", "chest_link", "neck_link", "0 0.1 0.4", "0 0 0", "0 0 1"))
    parts.append(_joint("nod", "revolute", "neck_link", "head", "0 0.03 0.1", "0 0 0", "1 0 0"))
    return f'<robot name="tree"><link name="base"/>{"".join(parts)}</robot>'


@dataclass(frozen=True)
class Tree:
    """The robot as calib reads it, and an arm for every tip, with one set of errors."""

    robot: calib.Robot
    arms: Mapping[str, Arm]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(reading.name for reading in self.robot.readings)

    def draw(self, rng: Rng, n: int, size: float = 1.2) -> Array:
        """Readings (n, nr), in the order of the robot's."""
        return rng.uniform(-size, size, (n, len(self.names)))

    def link(self, tip: str, q: Array) -> Array:
        """True placements (n, 4, 4) of a link in the base at readings (n, nr)."""
        arm = self.arms[tip]
        return arm.tips(q[:, [self.names.index(name) for name in arm.ranges]])

    def columns(self, q: Array, tips: tuple[str, ...] = TIPS) -> dict[str, object]:
        """The columns of readings that move some tips."""
        names = {name for tip in tips for name in self.arms[tip].ranges}
        return {f"{name} [rad]": q[:, k] for k, name in enumerate(self.names) if name in names}


def tree(rng: Rng | None = None, *, length: float = 0.5e-3, angle: float = 1e-3, zero: float = 5e-3) -> Tree:
    """A tree, badly made where ``rng`` is given, by standard deviations in m and rad."""
    text = urdf()
    robot = calib.load_robot(parse_urdf(text.encode(), "tree.urdf"), TIPS[0], links=TIPS[1:])
    arms = {tip: machines.arm(text, tip) for tip in TIPS}
    if rng is not None:
        names = dict.fromkeys(joint.name for arm in arms.values() for joint in arm.joints)
        origins = {name: rng.normal(scale=np.repeat((length, angle), 3)) for name in names}
        zeros = {name: rng.normal(scale=zero) for name in names}
        arms = {
            tip: arm.with_errors(np.array([origins[joint.name] for joint in arm.joints]), zeros)
            for tip, arm in arms.items()
        }
    return Tree(robot, arms)


def point(x: float, y: float, z: float) -> Array:
    """The placement of a tool point."""
    return pose((x, y, z))


TOOLS = {"right_hand": point(0.02, 0.03, 0.1), "left_hand": point(-0.03, 0.02, 0.12)}


def gap(made: Tree, q: Array) -> Array:
    """Where the tool of the left hand is in the right hand (n, 3)."""
    right = made.link("right_hand", q)
    return (np.linalg.inv(right) @ made.link("left_hand", q) @ TOOLS["left_hand"])[:, :3, 3]


def touching(made: Tree, rng: Rng, places: Array) -> Array:
    """Readings (n, nr) at which the left tool touches places (n, 3) of the right hand."""
    found = np.full((len(places), len(made.names)), np.nan)
    h = 1e-6
    while (open_ := np.flatnonzero(np.isnan(found[:, 0]))).size:
        q = made.draw(rng, len(open_))
        for _ in range(30):
            near = (q + h * np.vstack([np.zeros(q.shape[1]), np.eye(q.shape[1])])[:, None]).reshape(-1, q.shape[1])
            g = gap(made, near).reshape(q.shape[1] + 1, len(q), 3)
            J = np.moveaxis((g[1:] - g[0]) / h, 0, -1)
            step = -(np.linalg.pinv(J) @ (g[0] - places[open_])[:, :, None])[:, :, 0]
            q = q + step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True))
        good = (np.abs(gap(made, q) - places[open_]).max(axis=1) < 1e-12) & (np.abs(q).max(axis=1) < 2.5)
        found[open_[good]] = q[good]
    return found
