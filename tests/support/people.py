"""Files as people have them, of simulated sessions: the headers, units and conventions of others, known numbers."""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from calib.foundations.arrays import Array
from calib.robot.load import load_robot
from calib.robot.robot import Deviations, Robot

UR10 = "example:ur_description/urdf/ur10_robot.urdf"
PANDA = "example:panda_description/urdf/panda.urdf"


class Session(NamedTuple):
    """N poses of an arm: readings in rad, positions in m and rotations in the frame of an instrument."""

    readings: Array
    position: Array
    rotation: Array
    flange: Array


@cache
def robot(urdf: str, tip: str) -> Robot:
    """Return the nominal arm."""
    return load_robot(urdf, tip)


@cache
def session(urdf: str = UR10, tip: str = "tool0", n: int = 40, seed: int = 1, still: bool = False) -> Session:
    """Return what an instrument saw of an arm with errors of a millimetre; ``still``: it hardly turns."""
    arm, chance = robot(urdf, tip), np.random.default_rng(seed)
    low = np.array([max(r.lower or -2.5, -2.5) for r in arm.readings])
    high = np.array([min(r.upper or 2.5, 2.5) for r in arm.readings])
    q = chance.uniform(0.95 * low, 0.95 * high, (n, len(low)))
    if still:
        q = 0.5 * (low + high) + chance.uniform(-0.02, 0.02, q.shape)
    errors = Deviations(
        1e-3 * chance.standard_normal((len(arm.chain), 6)), 2e-3 * chance.standard_normal(len(arm.moving))
    )
    tool = np.eye(4)
    tool[:3, :3] = Rotation.from_rotvec([0.4, -0.9, 1.3]).as_matrix()
    tool[:3, 3] = (0.03, -0.05, 0.12)
    base = np.eye(4)
    base[:3, :3] = Rotation.from_rotvec([0.3, 0.5, 2.0]).as_matrix()
    base[:3, 3] = (2.1, -1.3, 0.4)
    T = base @ arm.tips(q, errors) @ tool
    noise = 2e-5 * chance.standard_normal((n, 3))
    return Session(q, T[:, :3, 3] + noise, T[:, :3, :3], arm.tips(q))


def angles(rotation: Array, convention: str) -> Array:
    """Return rotations (N, 3, 3) as three numbers in degrees, by the code of others: SciPy's."""
    found = Rotation.from_matrix(rotation)
    if convention == "rotation_vector":
        return np.degrees(found.as_rotvec())
    if convention in ("rpy", "wpr"):
        return found.as_euler("xyz", degrees=True)
    if convention == "abc":
        return found.as_euler("ZYX", degrees=True)
    return found.as_euler(convention, degrees=True)


def quaternions(rotation: Array, order: str = "wxyz") -> Array:
    """Return unit quaternions (N, 4)."""
    return Rotation.from_matrix(rotation).as_quat()[:, ["xyzw".index(letter) for letter in order]]


def text(
    titles: Sequence[str] | None, columns: Sequence[object], separator: str = ",", comma: bool = False, before: str = ""
) -> str:
    """Return a table; ``columns``: arrays (N,), (N, k), or lists of words."""
    parts: list[list[str]] = []
    for column in columns:
        values = np.asarray(column)
        for one in values.T if values.ndim == 2 else [values]:
            written = [str(v) if values.dtype.kind == "U" else f"{v:.9g}" for v in one]
            parts.append([w.replace(".", ",") for w in written] if comma and values.dtype.kind != "U" else written)
    rows = list(zip(*parts, strict=True))
    head = [] if titles is None else [list(titles)]
    return before + "".join(separator.join(row) + "\n" for row in [*head, *rows])
