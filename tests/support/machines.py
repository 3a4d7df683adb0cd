"""Simulated machines with known truth, made without any of calib's kinematics.

An arm is read by yourdfpy and walked by numpy and scipy's rotations: a second opinion on every number. Its errors are
moved origins in the URDF's own joint frames and shifted zeros, whichever way calib may name them.
"""

import functools
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import yourdfpy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib
from calib.identification.parameters import directions
from calib.robot.sources import resolve
from calib.robot.terms import KINDS
from calib.robot.urdf import parse_urdf

Array = NDArray[np.float64]
Rng = np.random.Generator


def pose(xyz: Sequence[float] | Array = (0, 0, 0), rotvec: Sequence[float] | Array = (0, 0, 0)) -> Array:
    """Placement(s) (..., 4, 4) of translations (..., 3) and rotation vectors (..., 3)."""
    rotvec = np.asarray(rotvec, dtype=float)
    T = np.zeros((*np.broadcast_shapes(np.shape(xyz)[:-1], rotvec.shape[:-1]), 4, 4))
    T[..., :3, :3] = Rotation.from_rotvec(np.array(rotvec)).as_matrix()
    T[..., :3, 3], T[..., 3, 3] = xyz, 1.0
    return T


def anywhere(rng: Rng, distance: float = 3.0) -> Array:
    """A pose with a uniformly random rotation."""
    return pose(rng.uniform(-distance, distance, 3), Rotation.random(rng=rng).as_rotvec())


_TERM_KEYS = [key for kind in KINDS for key in (kind.key, *kind.options)]


def model(robot: calib.Robot, **keys: Any) -> calib.ErrorModel:
    """The error model of keys as a job has them, all on one level and in SI units."""

    def taken(names: dict[str, str]) -> dict[str, Any]:
        return {name: keys.pop(key) for key, name in names.items() if key in keys}

    terms = taken({key: key for key in _TERM_KEYS})
    priors = calib.Priors(**taken({f"prior_{field.name}": field.name for field in fields(calib.Priors)}))
    names = {"base_pose": "base", "tool_poses": "tools", "targets": "targets", "relations": "relations"}
    known = calib.Known(**taken(names))
    if "dh" in keys:
        names = {"dh": "numbers", "dh_convention": "convention", "dh_parallel": "parallel", "placements": "placements"}
        keys["placements"] = calib.dh.Free(**taken(names))
    return calib.error_model(robot, **({"terms": terms, "priors": priors, "known": known} | keys))


@dataclass(frozen=True)
class Joint:
    """A joint of the path; its position is ``multiplier`` times the driver's reading, plus ``shift``."""

    name: str
    type: str
    origin: Array
    axis: Array
    driver: str
    multiplier: float
    shift: float


@dataclass(frozen=True)
class Arm:
    """A path of joints; ``ranges``: where the readings of its drivers are drawn from."""

    joints: tuple[Joint, ...]
    ranges: Mapping[str, tuple[float, float]]

    def tips(self, readings: Array) -> Array:
        """Tip placements (N, 4, 4) in the base link at readings (N, k)."""
        column = {name: readings[:, k, None] for k, name in enumerate(self.ranges)}
        T = np.broadcast_to(np.eye(4), (len(readings), 4, 4))
        for joint in self.joints:
            T = T @ joint.origin
            if joint.type != "fixed":
                travel = (column[joint.driver] * joint.multiplier + joint.shift) * joint.axis
                T = T @ (pose(travel) if joint.type == "prismatic" else pose(rotvec=travel))
        return T

    def draw(self, rng: Rng, n: int) -> Array:
        """Random readings (n, k) within the ranges."""
        low, high = np.transpose(list(self.ranges.values()))
        return rng.uniform(low, high, (n, len(low)))

    def moved(self, rng: Rng, *, length: float = 0.5e-3, angle: float = 1e-3, zero: float = 5e-3) -> "Arm":
        """The same arm badly made: every origin and every zero is off, by these standard deviations in m and rad."""
        return self.with_errors(
            rng.normal(scale=np.repeat((length, angle), 3), size=(len(self.joints), 6)),
            {
                name: rng.normal(scale=length if joint.type == "prismatic" else zero)
                for name, joint in ((joint.driver, joint) for joint in self.joints if joint.type != "fixed")
            },
        )

    def with_errors(self, origins: Array, zeros: Mapping[str, float]) -> "Arm":
        """Move origins (joints, 6) by translations and rotation vectors in the joint frames, and the drivers' zeros."""
        return replace(
            self,
            joints=tuple(
                replace(
                    joint,
                    origin=joint.origin @ pose(error[:3], error[3:]),
                    shift=joint.shift + joint.multiplier * zeros.get(joint.driver, 0.0),
                )
                for joint, error in zip(self.joints, origins, strict=True)
            ),
        )


@functools.cache
def read(urdf: str) -> yourdfpy.URDF:
    """yourdfpy's reading of ``example:...``, a file, or the text of a URDF."""
    source = io.BytesIO(urdf.encode()) if urdf.startswith("<") else str(resolve(urdf))
    return yourdfpy.URDF.load(source, build_scene_graph=False, load_meshes=False)


def arm(urdf: str, tip: str, base: str | None = None) -> Arm:
    """The path from ``base`` (default: the root) to ``tip``."""
    by_child = {joint.child: joint for joint in read(urdf).robot.joints}
    by_name = read(urdf).joint_map
    path: list[Joint] = []
    ranges: dict[str, tuple[float, float]] = {}
    link = tip
    while link != base and link in by_child:
        joint = driver = by_child[link]
        multiplier, shift = 1.0, 0.0
        while driver.mimic is not None:
            shift += multiplier * (driver.mimic.offset or 0.0)
            multiplier *= 1.0 if driver.mimic.multiplier is None else driver.mimic.multiplier
            driver = by_name[driver.mimic.joint]
        origin = np.eye(4) if joint.origin is None else joint.origin
        kind = "revolute" if joint.type == "continuous" else joint.type
        axis = np.zeros(3) if kind == "fixed" else joint.axis / np.linalg.norm(joint.axis)
        path.append(Joint(joint.name, kind, origin, axis, driver.name, multiplier, shift))
        link = joint.parent
    path.reverse()
    for joint in path:
        if joint.type != "fixed":
            limit = by_name[joint.driver].limit
            low, high = (-np.pi, np.pi) if limit is None else (limit.lower or 0.0, limit.upper or 0.0)
            free = by_name[joint.driver].type == "continuous" or low == high
            ranges[joint.driver] = (-np.pi, np.pi) if free else (max(low, -np.pi), min(high, np.pi))
    return Arm(tuple(path), ranges)


def load(urdf: str, tip: str, base: str | None = None) -> calib.Robot:
    """The same arm as calib reads it."""
    return calib.load_robot(parse_urdf(urdf.encode(), "inline.urdf") if urdf.startswith("<") else urdf, tip, base)


def table(arm: Arm, readings: Array, poses: Array, observes: str) -> dict[str, object]:
    """The columns of a measurement table in SI units."""
    prismatic = {joint.name for joint in arm.joints if joint.type == "prismatic"}
    columns: dict[str, object] = {
        f"{name} [{'m' if name in prismatic else 'rad'}]": readings[:, k] for k, name in enumerate(arm.ranges)
    }
    columns |= {f"{axis} [m]": poses[:, k, 3] for k, axis in enumerate("xyz")}
    if observes == "pose":
        x, y, z, w = Rotation.from_matrix(poses[:, :3, :3]).as_quat().T
        columns |= {"qw": w, "qx": x, "qy": y, "qz": z}
    return columns


@dataclass(frozen=True)
class Machine:
    """An arm that stands at ``base`` in the instrument's frame and carries ``tools`` on its tip."""

    arm: Arm
    base: Array
    tools: Mapping[str, Array]

    def see(self, readings: Array, points: Sequence[str] | None = None) -> Array:
        """True poses (N, 4, 4) of the tools in the instrument's frame."""
        tool = next(iter(self.tools.values())) if points is None else np.stack([self.tools[p] for p in points])
        return self.base @ self.arm.tips(readings) @ tool

    def measure(
        self,
        robot: calib.Robot,
        readings: Array,
        observes: str = "position",
        *,
        points: Sequence[str] | None = None,
        rng: Rng | None = None,
        sigma: float = 0.0,
        sigma_angle: float = 0.0,
        stated: tuple[float, float] | None = None,
    ) -> calib.Measurements:
        """Measurements with noise from ``rng``; ``stated`` sigmas (m, rad) are what the table says of it."""
        poses = self.see(readings, points)
        if rng is not None:
            poses = poses.copy()
            poses[:, :3, 3] += rng.normal(scale=sigma, size=(len(poses), 3))
            turns = Rotation.from_rotvec(rng.normal(scale=sigma_angle, size=(len(poses), 3))).as_matrix()
            poses[:, :3, :3] = poses[:, :3, :3] @ turns
        columns = table(self.arm, readings, poses, observes) | ({} if points is None else {"tool": points})
        s, a = stated or (sigma, sigma_angle)
        return calib.read_measurements(columns, robot, observes, sigma=(s, a if observes == "pose" else None))


def predicted(fit: calib.Fit, readings: Array, tool: int = 0) -> Array:
    """Tool poses (N, 4, 4) that a fit predicts in the instrument's frame."""
    frames = fit.machine.frames
    return frames.base @ fit.model.robot.tips(readings, fit.machine.deviations) @ frames.tools[tool]


def miss(fit: calib.Fit, machine: Machine, readings: Array) -> float:
    """3D rms in m between the predicted and the true tool points."""
    d = predicted(fit, readings)[:, :3, 3] - machine.see(readings)[:, :3, 3]
    return float(np.sqrt(np.mean(np.sum(d**2, axis=1))))


LIMIT = {
    "revolute": '<limit lower="-2.6" upper="2.8" effort="1" velocity="1"/>',
    "prismatic": '<limit lower="-0.1" upper="0.7" effort="1" velocity="1"/>',
}


def urdf(*joints: tuple[str, ...]) -> str:
    """A serial arm from link ``base`` to link ``tip``: name, type, xyz, rpy, axis and more elements of every joint."""
    links = ["base", *(f"link_{name}" for name, *_ in joints[:-1]), "tip"]
    elements = [f'<link name="{link}"/>' for link in links]
    for (name, kind, xyz, rpy, axis, *more), parent, child in zip(joints, links, links[1:], strict=False):
        elements.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{"".join(more)}{LIMIT.get(kind, "")}</joint>'
        )
    return f'<robot name="inline">{"".join(elements)}</robot>'


# Arms that no file of example-robot-data resembles.
INLINE = {
    "scara": urdf(
        ("shoulder", "revolute", "0 0 0.4", "0 0 0", "0 0 1"),
        ("elbow", "revolute", "0.35 0 0.05", "0 0 0", "0 0 1"),
        ("quill", "prismatic", "0.3 0 0", "0 0 0", "0 0 -1"),
        ("spin", "continuous", "0 0 -0.1", "0 0 0", "0 0 -1"),
    ),
    "gantry": urdf(
        ("column", "fixed", "0.1 0.2 1.5", "0 0 0.3", "0 0 0"),
        ("bridge", "prismatic", "0 0 0", "0 0 0", "1 0 0"),
        ("carriage", "prismatic", "0 0.1 0", "0 0 0", "0 1 0"),
        ("ram", "prismatic", "0 0 -0.2", "0 0 0", "0 0 1"),
        ("c", "continuous", "0 0 -0.1", "3.141592653589793 0 0", "0 0 1"),
        ("a", "revolute", "0 0 0.12", "0 0 0", "1 0 0"),
        ("b", "revolute", "0 0.08 0", "0 0 0", "0 1 0"),
        ("probe", "fixed", "0 0 0.1", "0 0 0.7", "0 0 0"),
    ),
    # Two bars of a parallelogram keep the forearm's base level: the third joint undoes the second.
    "mimic": urdf(
        ("swing", "revolute", "0 0 0.5", "0 0 0", "0 0 1"),
        ("lift", "revolute", "0.2 0 0", "0 0 0", "0 1 0"),
        ("level", "revolute", "0 0 0.6", "0 0 0", "0 1 0", '<mimic joint="lift" multiplier="-1" offset="0.1"/>'),
        ("reach", "revolute", "0.05 0 0", "0 0 0", "0 1 0"),
        ("roll", "revolute", "0.5 0 0", "0 0 0", "1 0 0"),
        ("bend", "revolute", "0.1 0 0", "0 0 0", "0 1 0"),
        ("turn", "revolute", "0.1 0 0", "0 0 0", "1 0 0"),
    ),
    "skew": urdf(
        ("j1", "revolute", "0 0 0.3", "0.1 0.2 0.3", "1 2 -2"),
        ("j2", "revolute", "0.1 0.2 0.3", "0 -0.4 0", "-1 -1 -1"),
        ("j3", "revolute", "0.4 0 0.1", "0 0 1", "0.6 0 0.8"),
        ("j4", "prismatic", "0 0.1 0.2", "-1 0 0", "3 -4 0.5"),
        ("j5", "revolute", "0.2 -0.1 0", "0 0 0", "0 1 -1e-3"),
        ("j6", "revolute", "0.1 0 0.1", "0 2 0", "1e-4 0 -1"),
    ),
    "negative": urdf(
        ("j1", "revolute", "0 0 0.3", "0 0 0", "0 0 -1"),
        ("j2", "revolute", "0.1 0 0.1", "0 0 0", "0 -1 0"),
        ("j3", "revolute", "0 0 0.5", "0 0 0", "0 -1 0"),
        ("j4", "revolute", "0.1 0 0.1", "0 0 0", "-1 0 0"),
        ("j5", "revolute", "0.4 0 0", "0 0 0", "0 -1 0"),
        ("j6", "revolute", "0.1 0 0", "0 0 0", "-1 0 0"),
    ),
}


def scatter_of_positions(fit: calib.Fit, readings: Array) -> Array:
    """Standard deviation (N,) of the tool's position by the covariance of the parameters alone."""
    J = calib.machine_of(fit).tool_jacobian(readings)[:, :3]
    J = J @ directions(fit.parameters, J.shape[2])
    return np.sqrt(np.einsum("nip,pq,niq->n", J, fit.covariance, J))
