"""Make the recordings of robots/panda_sockets: a Panda with known errors, a ball on its tool, and two printed sockets.

    python scripts/simulate/panda_sockets.py [output folder] [--seed 1]

Its own mathematics, on purpose: whoever calibrates this arm cannot repeat a mistake made here. SI units. The same seed
writes the same bytes. Files are as a robot's controller would give them: <place>/hole_{0,1}.csv, seven joint angles a
row in rad, nothing else.
"""

import argparse
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

# Modified DH parameters a, d, alpha of the rows that end in the seven joints, and limits: Franka Emika, FCI
# documentation, robot and interface specifications.
DH = (
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -np.pi / 2),
    (0.0, 0.316, np.pi / 2),
    (0.0825, 0.0, np.pi / 2),
    (-0.0825, 0.384, -np.pi / 2),
    (0.0, 0.0, np.pi / 2),
    (0.088, 0.0, np.pi / 2),
)
LIMITS = np.array(
    [
        (-2.8973, 2.8973),
        (-1.7628, 1.7628),
        (-2.8973, 2.8973),
        (-3.0718, -0.0698),
        (-2.8973, 2.8973),
        (-0.0175, 3.7525),
        (-2.8973, 2.8973),
    ]
)
READY = np.array([0.0, 0.3, 0.0, -2.0, 0.0, 2.3, 0.785])
# The tool centre point is 0.107 + 0.1034 m beyond joint 7; the ball sits some 30 mm further, not quite in line.
BALL = (0.0011, -0.0008, 0.2419)
# Standard deviations of what is off at every joint, in its own frame: as large as calibrated Pandas show.
LENGTH, ANGLE, ZERO = 0.4e-3, 1.5e-3, 4e-3
# A ball has play in a printed socket, and the arm gives way to the hand: standard deviation per axis at every touch.
PLAY = 0.1e-3
# The sockets are 50 mm apart, as well as a printer knows it.
DISTANCE, PRINTED = 0.05, 0.05e-3
# Middle between the sockets, and direction from hole_0 to hole_1 in the table's plane.
PLACES: dict[str, tuple[tuple[float, float, float], float]] = {
    "front": ((0.52, 0.03, 0.012), 0.3),
    "left": ((0.18, 0.48, 0.012), 1.9),
    "right": ((0.12, -0.5, 0.012), -0.8),
    "raised": ((0.45, -0.18, 0.36), 1.1),
}
ROWS = 20
# Somebody has pushed the tool while the ball was in right/hole_1: after this row, by so much.
PUSHED = ("right", "hole_1", 12)
PUSH = (0.0009, -0.0006, 0.0)
# Tilt of the tool from upright, and the least distance from a joint's limit.
TILT, MARGIN = np.radians(40.0), 0.1
DECIMALS = 9


@dataclass(frozen=True)
class Panda:
    """An arm whose joint frames are moved by ``errors`` (7, 6): translation, then rotation vector; zeros by (7,)."""

    errors: Array
    zeros: Array
    ball_in_joint_7: tuple[float, float, float] = BALL

    def frames(self, q: Array) -> list[Array]:
        """Poses (4, 4) of the joint frames after turning, at angles q (7,)."""
        T, found = np.eye(4), []
        for (a, d, alpha), error, angle in zip(DH, self.errors, q + self.zeros, strict=True):
            # Rot(x, alpha) Trans(x, a) Rot(z, theta) Trans(z, d), the frame moved before it turns.
            T = T @ pose((a, 0.0, 0.0), (alpha, 0.0, 0.0)) @ pose((0.0, 0.0, d)) @ pose(error[:3], error[3:])
            T = T @ pose(rotation=(0.0, 0.0, angle))
            found.append(T)
        return found

    def ball(self, q: Array) -> tuple[Array, Array]:
        """Position (3,) of the ball at angles q (7,), and direction (3,) of the tool."""
        T = self.frames(q)[-1]
        return T[:3, :3] @ np.array(self.ball_in_joint_7) + T[:3, 3], T[:3, 2]

    def touch(self, point: Array, direction: Array, start: Array) -> Array | None:
        """Angles (7,) that hold the ball at a point, the tool along a direction, near ``start``; None where none do.

        Damped Newton steps: 5 equations, 7 unknowns.
        """
        q = start.copy()
        for _ in range(60):
            x, z = self.ball(q)
            across = np.cross(z, direction)
            residual = np.concatenate([point - x, 0.3 * across])
            if np.linalg.norm(residual[:3]) < 1e-13 and np.linalg.norm(across) < 1e-3:
                inside = np.all((q > LIMITS[:, 0] + MARGIN) & (q < LIMITS[:, 1] - MARGIN))
                return q if inside else None
            axes = [(T[:3, 2], T[:3, 3]) for T in self.frames(q)]
            J = np.array([[*np.cross(axis, x - origin), *(0.3 * axis)] for axis, origin in axes]).T
            step = J.T @ np.linalg.solve(J @ J.T + 1e-12 * np.eye(6), residual)
            q += step * min(1.0, 0.3 / float(np.abs(step).max()))
        return None


def pose(
    translation: tuple[float, ...] | Array = (0.0, 0.0, 0.0), rotation: tuple[float, ...] | Array = (0, 0, 0)
) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(rotation).as_matrix(), translation
    return T


def sockets(rng: np.random.Generator) -> dict[str, dict[str, Array]]:
    """Where the sockets of every place are."""
    found = {}
    for place, (middle, angle) in PLACES.items():
        half = 0.5 * (DISTANCE + rng.normal(scale=PRINTED)) * np.array([np.cos(angle), np.sin(angle), 0.0])
        found[place] = {"hole_0": np.array(middle) - half, "hole_1": np.array(middle) + half}
    return found


def recorded(arm: Panda, socket: Array, push: tuple[int, Array] | None, rng: np.random.Generator) -> Array:
    """Joint angles (ROWS, 7) with the ball in a socket, from one posture to the next."""
    rows: list[Array] = []
    q = READY + np.array([np.arctan2(socket[1], socket[0]), 0, 0, 0, 0, 0, 0])
    while len(rows) < ROWS:
        tilt, about = TILT * np.sqrt(rng.uniform()), rng.uniform(-np.pi, np.pi)
        direction = np.array([np.sin(tilt) * np.cos(about), np.sin(tilt) * np.sin(about), -np.cos(tilt)])
        point = socket + rng.normal(scale=PLAY, size=3)
        if push is not None and len(rows) >= push[0]:
            point = point + push[1]
        start = np.clip(q + rng.normal(scale=0.4, size=7), LIMITS[:, 0] + MARGIN, LIMITS[:, 1] - MARGIN)
        found = arm.touch(point, direction, start)
        if found is not None:
            rows.append(found)
    return np.array(rows)


def recordings(seed: int) -> tuple[Panda, dict[str, dict[str, Array]], dict[str, dict[str, Array]]]:
    """The arm, its sockets, and the joint angles of every place and hole."""
    rng = np.random.default_rng(seed)
    errors = rng.normal(scale=np.repeat((LENGTH, ANGLE), 3), size=(7, 6))
    # About the joint's own axis only the zero counts.
    errors[:, 5] = 0.0
    arm = Panda(errors, rng.normal(scale=ZERO, size=7))
    where = sockets(rng)
    pushed = {PUSHED[:2]: (PUSHED[2], np.array(PUSH))}
    rows = {
        place: {hole: recorded(arm, socket, pushed.get((place, hole)), rng) for hole, socket in holes.items()}
        for place, holes in where.items()
    }
    return arm, where, rows


def truth(arm: Panda, where: dict[str, dict[str, Array]], seed: int) -> str:
    """What the simulated arm has: read by the tests, never by a job."""
    lines = [
        f"# Simulated: scripts/simulate/panda_sockets.py, seed {seed}. SI units: m, rad.",
        f"ball = {list(BALL)}  # in the frame of joint 7",
        f"play = {PLAY}",
        f"zeros = {[round(float(v), DECIMALS) for v in arm.zeros]}",
        "# Translation and rotation vector of every joint's frame, in its nominal axes, before the joint turns.",
        "errors = [",
        *(f"    {[round(float(v), DECIMALS) for v in row]}," for row in arm.errors),
        "]",
        f'pushed = {{ place = "{PUSHED[0]}", hole = "{PUSHED[1]}", after = {PUSHED[2]}, by = {list(PUSH)} }}',
    ]
    for place, holes in where.items():
        lines += [f"\n[sockets.{place}]"]
        lines += [f"{hole} = {[round(float(v), DECIMALS) for v in socket]}" for hole, socket in holes.items()]
    text = "\n".join([*lines, ""])
    tomllib.loads(text)
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    home = Path(__file__).resolve().parents[2] / "robots" / "panda_sockets"
    parser.add_argument("output", type=Path, nargs="?", default=home)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    arm, where, rows = recordings(arguments.seed)
    for place, holes in rows.items():
        folder = arguments.output / "recordings" / place
        folder.mkdir(parents=True, exist_ok=True)
        for hole, angles in holes.items():
            text = "".join(",".join(f"{angle:.{DECIMALS}f}" for angle in row) + "\n" for row in angles)
            (folder / f"{hole}.csv").write_text(text, encoding="utf-8", newline="\n")
    (arguments.output / "truth.toml").write_text(truth(arm, where, arguments.seed), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
