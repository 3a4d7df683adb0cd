"""DH tables at random, their robots, and the product of matrices that defines them."""

import numpy as np
from numpy.typing import NDArray

import calib
from calib import dh
from calib.dh import DhRow, DhTable
from calib.robot.urdf import parse_urdf
from tests.support import machines

Array = NDArray[np.float64]

CONVENTIONS = ("standard", "modified")
QUARTER = np.pi / 2


def product(table: DhTable, q: Array) -> Array:
    """Tips (N, 4, 4) of a table at positions (N, moving rows): the definition, written out in sines and cosines."""

    def turn(axis: int, angle: Array | float) -> Array:
        angle = np.asarray(angle, dtype=float)
        T = np.zeros((*angle.shape, 4, 4)) + np.eye(4)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        T[..., i, i] = T[..., j, j] = np.cos(angle)
        T[..., j, i] = np.sin(angle)
        T[..., i, j] = -np.sin(angle)
        return T

    def shift(axis: int, length: Array | float) -> Array:
        length = np.asarray(length, dtype=float)
        T = np.zeros((*length.shape, 4, 4)) + np.eye(4)
        T[..., axis, 3] = length
        return T

    T, column = np.broadcast_to(table.base, (len(q), 4, 4)), 0
    for row in table.rows:
        theta, d = row.theta, row.d
        if row.type != "fixed":
            theta = theta + (q[:, column] if row.type == "revolute" else 0.0)
            d = d + (q[:, column] if row.type == "prismatic" else 0.0)
            column += 1
        along, across = turn(2, theta) @ shift(2, d), turn(0, row.alpha) @ shift(0, row.a) @ turn(1, row.beta)
        T = T @ (along @ across if table.convention == "standard" else across @ along)
    return T @ table.tool


def robot_of(table: DhTable) -> calib.Robot:
    return calib.load_robot(parse_urdf(dh.dh_to_urdf(table), "table"))


def random_table(rng: np.random.Generator, convention: str, *, plain: bool) -> DhTable:
    """Two to eight rows, with parallel, coincident, intersecting, nearly parallel and any other pairs of axes.

    A plain table is one that a URDF cannot blur: no beta but between parallel axes, frame 0 at the base.
    """
    rows = []
    n = int(rng.integers(2, 9))
    for k in range(n):
        kind = rng.choice(["parallel", "opposite", "nearly", "right", "any"])
        alpha = {"parallel": 0.0, "opposite": np.pi, "nearly": rng.uniform(-8e-3, 8e-3), "right": rng.choice((-1, 1))}
        angle = float(alpha.get(kind, rng.uniform(0.05, 3.0))) * (QUARTER if kind == "right" else 1.0)
        beta = float(rng.uniform(-5e-3, 5e-3)) if kind == "nearly" and rng.random() < 0.5 else 0.0
        if not plain and rng.random() < 0.2:
            beta = float(rng.uniform(-1.0, 1.0))
        fixed = not plain and k > 0 and rng.random() < 0.15
        rows.append(
            DhRow(
                f"joint_{k + 1}",
                "fixed" if fixed else rng.choice(["revolute", "prismatic"], p=[0.8, 0.2]),
                float(rng.choice([0.0, rng.uniform(-1.0, 1.0)])),
                float(rng.choice([0.0, rng.uniform(-1.0, 1.0)])),
                angle,
                float(rng.choice([0.0, QUARTER, rng.uniform(-3.1, 3.1)])),
                beta,
            )
        )
    frames = {name: machines.anywhere(rng, 1.0) for name in ("base", "tool") if rng.random() < 0.5 or not plain}
    return DhTable(convention, tuple(rows), **frames)
