"""The two-axis positioner of document 4, and other external axes, made without any of calib's kinematics."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib

Array = NDArray[np.float64]
Rng = np.random.Generator

# Q of document 4: the tilt axis lies in the table's x; seen from it the rotary axis stands up.
Q = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def turn(rotvec: Sequence[float] | Array) -> Array:
    return np.asarray(Rotation.from_rotvec(rotvec).as_matrix())


def place(R: Array, t: Sequence[float]) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


@dataclass(frozen=True)
class Machine:
    """Serial axes: ``frames`` (4, 4), each in the one before; every joint turns about, or travels along, its z."""

    frames: tuple[Array, ...]
    kinds: str  # one letter for a joint: r or p
    names: tuple[str, ...]

    def table(self, q: Array) -> Array:
        """The table (N, 4, 4) in the instrument's frame at readings (N, k)."""
        T = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        for j, (frame, kind) in enumerate(zip(self.frames, self.kinds, strict=True)):
            moved = np.tile(np.eye(4), (len(q), 1, 1))
            if kind == "r":
                moved[:, :3, :3] = Rotation.from_rotvec(np.outer(q[:, j], [0.0, 0.0, 1.0])).as_matrix()
            else:
                moved[:, 2, 3] = q[:, j]
            T = T @ frame @ moved
        return T

    def see(self, q: Array, mark: Array) -> Array:
        """Points (N, 3) of marks (3,) or (N, 3) given in the table's frame."""
        m = np.broadcast_to(mark, (len(q), 3))
        T = self.table(q)
        return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], m) + T[:, :3, 3])

    def touch(
        self,
        robot: calib.Robot,
        q: Array,
        marks: Sequence[Array],
        rng: Rng | None = None,
        sigma: float = 0.0,
        stated: float | None = None,
    ) -> calib.Measurements:
        """Every mark touched at every row of q, with noise from ``rng``."""
        rows = np.tile(q, (len(marks), 1))
        x = np.concatenate([self.see(q, mark) for mark in marks])
        x = x if rng is None else x + rng.normal(scale=sigma, size=x.shape)
        columns: dict[str, object] = {
            f"{name} [{'rad' if kind == 'r' else 'm'}]": rows[:, j]
            for j, (name, kind) in enumerate(zip(self.names, self.kinds, strict=True))
        }
        columns |= {f"{axis} [m]": x[:, k] for k, axis in enumerate("xyz")}
        columns["tool"] = [f"mark {k}" for k in range(len(marks)) for _ in range(len(q))]
        return calib.read_measurements(columns, robot, sigma=stated or sigma or 1e-6)


TWO_AXES = Machine(
    (place(turn([0.02, -0.03, 0.4]) @ Q, [1.5, -0.2, 0.6]), place(Q @ turn([0.004, -0.003, 0.0]), [0.06, 0.0, 0.015])),
    "rr",
    ("tilt", "rotary"),
)
MARK = np.array([0.3, 0.0, 0.08])

# Twenty mixed poses of document 4, (tilt, rotary) in deg.
TWENTY = np.radians(
    [(0, r) for r in (0, 60, 120, 180, -120, -60)]
    + [(t, 0) for t in (90, 45, -45, -90)]
    + [(60, 90), (60, -90), (-60, 90), (-60, -90), (30, 180), (-30, 180), (90, 45), (-90, 45), (80, 150), (-80, -150)]
).astype(float)


def five(rotary: float, tilt: float) -> Array:
    """Readings (5, 2) in rad of the five points."""
    return np.radians([(0, 0), (0, rotary), (0, -rotary), (tilt, 0), (-tilt, 0)]).astype(float)


def nominal(machine: Machine, rng: Rng | None = None, length: float = 0.0, angle: float = 0.0) -> str:
    """A URDF of a machine's axes, each somewhat off where it stands in the one before; the base is anywhere."""
    lines = ['<link name="base"/>']
    parent = "base"
    for k, (frame, kind, name) in enumerate(zip(machine.frames, machine.kinds, machine.names, strict=True)):
        R, t = (np.eye(3), np.zeros(3)) if k == 0 else (frame[:3, :3], frame[:3, 3])
        if rng is not None:
            R, t = R @ turn(rng.normal(scale=angle, size=3)), t + rng.normal(scale=length, size=3)
        xyz, rpy = (" ".join(map(repr, map(float, v))) for v in (t, Rotation.from_matrix(R).as_euler("xyz")))
        child = "table" if k == len(machine.frames) - 1 else f"{name}_link"
        lines.append(
            f'<link name="{child}"/><joint name="{name}" type="{"revolute" if kind == "r" else "prismatic"}">'
            f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
            '<limit lower="-6.3" upper="6.3" effort="1" velocity="1"/></joint>'
        )
        parent = child
    return f'<robot name="axes">{"".join(lines)}</robot>'


def envelope(rng: Rng, n: int) -> tuple[Array, Array]:
    """Table points (n, 3) in the table's frame and readings (n, 2): the envelope of document 4's table."""
    points = np.column_stack([rng.uniform(-0.5, 0.5, (n, 2)), rng.uniform(0.0, 0.3, n)])
    return points, np.column_stack([rng.uniform(-np.pi / 2, np.pi / 2, n), rng.uniform(-np.pi, np.pi, n)])
