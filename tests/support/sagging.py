"""Arms and trees whose drives give way to all that hangs behind them, walked by numpy from yourdfpy's reading."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tests.support import machines
from tests.support.gears import UR10
from tests.support.machines import Array, pose

DOWN = (0.0, 0.0, -9.80665)
WALL = (9.80665, 0.0, 0.0)
CENTRE = (0.0, 0.08, 0.12)
SOFT = {"shoulder_lift_joint": 9e-6, "elbow_joint": 1.4e-5, "wrist_1_joint": 3e-5}
BALL = pose((0.05, 0.02, 0.15))


@dataclass(frozen=True)
class Sagging:
    """A tree of revolute and fixed joints; ``compliances`` (rad/Nm) about the axes of joints.

    ``origins``: by what joints are misplaced (4, 4) in their own frames. Torques are moments of weight about where
    joints nominally are.
    """

    urdf: str
    compliances: Mapping[str, float]
    origins: Mapping[str, Array] = field(default_factory=dict)

    def tip(
        self,
        link: str,
        at: Mapping[str, float],
        gravity: tuple[float, float, float] = DOWN,
        payloads: Mapping[str, tuple[float, tuple[float, float, float]]] | None = None,
    ) -> Array:
        """A link (4, 4) in the root at readings ``at``; ``payloads``: mass in kg and centre in m, by link."""
        places = self._places(at)
        wound = dict(at)
        for name, compliance in self.compliances.items():
            wound[name] = at[name] + compliance * self._torque(name, places, gravity, payloads or {})
        return self._places(wound, self.origins)[link]

    def _torque(
        self,
        joint: str,
        places: Mapping[str, Array],
        gravity: tuple[float, float, float],
        payloads: Mapping[str, tuple[float, tuple[float, float, float]]],
    ) -> float:
        document = machines.read(self.urdf)
        child = document.joint_map[joint].child
        P = places[child]
        first = np.zeros(3)  # moment of the masses behind the joint
        for link in self._behind(child):
            inertial = document.link_map[link].inertial
            masses = [] if inertial is None or not inertial.mass else [(inertial.mass, inertial.origin[:3, 3])]
            masses += [payloads[link]] if link in payloads else []
            for mass, centre in masses:
                arm = (places[link] @ [*centre, 1.0])[:3] - P[:3, 3]
                first += mass * arm
        return float((P[:3, :3] @ document.joint_map[joint].axis) @ np.cross(first, gravity))

    def _behind(self, link: str) -> list[str]:
        joints = machines.read(self.urdf).robot.joints
        return [link, *(one for joint in joints if joint.parent == link for one in self._behind(joint.child))]

    def _places(self, at: Mapping[str, float], origins: Mapping[str, Array] | None = None) -> dict[str, Array]:
        document = machines.read(self.urdf)
        children = {joint.child for joint in document.robot.joints}
        found = {link.name: np.eye(4) for link in document.robot.links if link.name not in children}
        left = list(document.robot.joints)
        while left:
            joint = next(one for one in left if one.parent in found)
            left.remove(joint)
            T = found[joint.parent] @ (np.eye(4) if joint.origin is None else joint.origin)
            T = T @ (origins or {}).get(joint.name, np.eye(4))
            if joint.type != "fixed":
                T = T @ pose(rotvec=joint.axis * at.get(joint.name, 0.0))
            found[joint.child] = T
        return found


def arm(rng: np.random.Generator) -> Sagging:
    names = ["shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint"]
    origins = {name: pose(rng.normal(scale=5e-4, size=3), rng.normal(scale=1e-3, size=3)) for name in names}
    return Sagging(UR10[0], SOFT, origins)


def two_arms() -> str:
    """Two arms of two joints on one torso that leans, all of them heavy."""
    links = ["base", "torso", *(f"{side}_{part}" for side in ("left", "right") for part in ("upper", "lower", "hand"))]
    mass = '<inertial><origin xyz="0.1 0.02 0.1"/><mass value="{}"/></inertial>'
    elements = [f'<link name="{name}">{mass.format(3 + k)}</link>' for k, name in enumerate(links)]

    def joint(name: str, kind: str, parent: str, child: str, xyz: str, axis: str) -> str:
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>{machines.LIMIT.get(kind, "")}</joint>'
        )

    elements.append(joint("lean", "revolute", "base", "torso", "0 0 0.5", "0 1 0"))
    for side, y in (("left", 0.3), ("right", -0.3)):
        elements += [
            joint(f"{side}_lift", "revolute", "torso", f"{side}_upper", f"0 {y} 0.6", "0 1 0"),
            joint(f"{side}_bend", "revolute", f"{side}_upper", f"{side}_lower", "0.4 0 0.05", "0 0.6 0.8"),
            joint(f"{side}_mount", "fixed", f"{side}_lower", f"{side}_hand", "0.3 0 0", "0 0 0"),
        ]
    return f'<robot name="two_arms">{"".join(elements)}</robot>'
