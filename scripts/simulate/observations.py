"""Write a table of every kind of observation: what docs/observations.md calibrates.

    python scripts/simulate/observations.py [output folder] [--seed 8]

A UR10 whose frames and zeros are off touches sockets, planes and a ball, is measured by a bar, gauges, a dial and a
tracker, and stands at the origin of the world. Its own mathematics, on purpose: whoever calibrates this arm cannot
repeat a mistake made here. The same seed writes the same rows. SI units inside, degrees and mm in the tables.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Rows = dict[str, object]

# The joints of ur10_robot.urdf in ur_description: name, origin (m), turn about y of the origin, axis.
JOINTS = (
    ("shoulder_pan_joint", (0.0, 0.0, 0.1273), 0.0, (0, 0, 1)),
    ("shoulder_lift_joint", (0.0, 0.220941, 0.0), np.pi / 2, (0, 1, 0)),
    ("elbow_joint", (0.0, -0.1719, 0.612), 0.0, (0, 1, 0)),
    ("wrist_1_joint", (0.0, 0.0, 0.5723), np.pi / 2, (0, 1, 0)),
    ("wrist_2_joint", (0.0, 0.1149, 0.0), 0.0, (0, 0, 1)),
    ("wrist_3_joint", (0.0, 0.0, 0.1157), 0.0, (0, 1, 0)),
)
FLANGE = ((0.0, 0.0922, 0.0), Rotation.from_euler("x", -np.pi / 2))
# The base in the second place of the tracker: its turn, and where it is, m.
RIGHT = (Rotation.from_rotvec((0.1, -0.05, 1.9)).as_matrix(), np.array((2.1, -0.7, 0.4)))
TOOL = (0.02, 0.03, 0.12)  # of the ball or the reflector on the flange, m

SOCKETS = {"a": (0.6, 0.1, 0.3), "b": (0.4, -0.5, 0.2), "c": (-0.3, 0.5, 0.5)}
ANCHOR, BALL = np.array((1.2, 0.3, -0.2)), np.array((0.5, 0.3, 0.4))
BALL_DIAMETER, PROBE_DIAMETER = 0.024, 0.006
PLANES = {"floor": ((0.1, -0.2, 1.0), 0.2), "left": ((1.0, 0.1, 0.15), -0.45), "front": ((0.0, 1.0, 0.3), -0.4)}
BAR_TOO_LONG = 0.0123  # m
NOISE = 0.03e-3  # of every length and coordinate, m
TURN_NOISE = 0.1e-3  # of every turn, rad
STEP = 1e-6  # of the derivatives by which touching is found, rad


class Machine:
    """A UR10 as it was made and not as it was designed."""

    def __init__(self, rng: np.random.Generator) -> None:
        n = len(JOINTS)
        self.rng = rng
        self.origins = np.array([joint[1] for joint in JOINTS]) + rng.normal(0.0, 0.5e-3, (n, 3))
        self.turns = [
            Rotation.from_euler("y", joint[2]) * Rotation.from_rotvec(rng.normal(0.0, 1e-3, 3)) for joint in JOINTS
        ]
        self.zeros = rng.normal(0.0, 5e-3, n)

    def frames(self, q: Array) -> tuple[Rotation, Array]:
        """Turn and origin (N, 3) of the flange in the base at readings (N, 6)."""
        turn, origin = Rotation.identity(len(q)), np.zeros((len(q), 3))
        for k, (_, _, _, axis) in enumerate(JOINTS):
            origin = origin + turn.apply(self.origins[k])
            turn = turn * self.turns[k] * Rotation.from_rotvec(np.outer(q[:, k] + self.zeros[k], axis))
        return turn * FLANGE[1], origin + turn.apply(FLANGE[0])

    def points(self, q: Array) -> Array:
        """Tool points (N, 3)."""
        turn, origin = self.frames(q)
        return origin + turn.apply(TOOL)

    def draw(self, n: int) -> Array:
        """Readings (n, 6) anywhere."""
        return self.rng.uniform(-np.pi, np.pi, (n, len(JOINTS)))

    def noise(self, *shape: int) -> Array:
        """What instruments and hands add."""
        return self.rng.normal(0.0, NOISE, shape)

    def touching(self, gap: Callable[[Array], Array], away: Array, outside: Array | None = None) -> Array:
        """Readings at which ``gap`` (m, d) of tool points is ``away`` (n, d); the flange is on the side ``outside``."""
        found = np.full((len(away), len(JOINTS)), np.nan)
        while (open_ := np.flatnonzero(np.isnan(found[:, 0]))).size:
            q = self.draw(len(open_))
            for _ in range(20):
                near = q + STEP * np.vstack([np.zeros(6), np.eye(6)])[:, None]
                g = gap(self.points(near.reshape(-1, 6))).reshape(7, len(q), -1)
                J = np.moveaxis((g[1:] - g[0]) / STEP, 0, -1)
                step = -(np.linalg.pinv(J) @ (g[0] - away[open_])[:, :, None])[:, :, 0]
                q = q + step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True))
            q = np.mod(q + np.pi, 2 * np.pi) - np.pi
            closed = np.abs(gap(self.points(q)) - away[open_]).max(axis=1) < 1e-9
            if outside is not None:
                closed &= (self.frames(q)[1] - self.points(q)) @ outside > 0.03
            found[open_[closed]] = q[closed]
        return found


def tables(machine: Machine) -> dict[str, tuple[Array, Rows]]:
    """Readings and the other columns of every table."""
    made: dict[str, tuple[Array, Rows]] = {}

    q = [machine.touching(lambda x, c=c: x - c, machine.noise(15, 3)) for c in SOCKETS.values()]
    made["sockets"] = np.concatenate(q), {"target": np.repeat(list(SOCKETS), 15)}

    at = machine.draw(60)
    lengths = np.linalg.norm(machine.points(at) - ANCHOR, axis=1) + BAR_TOO_LONG + machine.noise(60)
    made["bar"] = at, {"target": ["anchor"] * 60, "length [mm]": 1e3 * lengths}

    at = machine.draw(120)
    ends = machine.points(at).reshape(60, 2, 3)
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) + machine.noise(60)
    made["gauges"] = at, {"pair": np.repeat(np.arange(1, 61), 2), "length [mm]": np.repeat(1e3 * lengths, 2)}

    q = []
    for normal, height in PLANES.values():
        n = np.array(normal) / np.linalg.norm(normal)
        q.append(machine.touching(lambda x, n=n, h=height: (x @ n - h)[:, None], machine.noise(25, 1), n))
    made["planes"] = np.concatenate(q), {"target": np.repeat(list(PLANES), 25)}

    for name, columns in (("ball", {"diameter [mm]": [1e3 * BALL_DIAMETER] * 60}), ("ball_of_unknown_size", {})):
        away = machine.noise(60, 1) + (BALL_DIAMETER + PROBE_DIAMETER) / 2
        q = machine.touching(lambda x: np.linalg.norm(x - BALL, axis=1, keepdims=True), away)
        made[name] = q, {"target": ["ball"] * 60, "ball [mm]": [1e3 * PROBE_DIAMETER] * 60, **columns}

    at = machine.draw(60)
    normal, height = PLANES["floor"]
    shown = machine.points(at) @ np.array(normal) / np.linalg.norm(normal) - height + machine.noise(60)
    made["dial"] = at, {"target": ["floor"] * 60, "indicated [mm]": 1e3 * shown}

    at = machine.draw(30)
    seen = machine.points(at) + machine.noise(30, 3)
    made["tracker"] = at, {f"{axis} [mm]": 1e3 * seen[:, k] for k, axis in enumerate("xyz")}

    at = machine.draw(30)
    turned = machine.frames(at)[0] * Rotation.from_rotvec(machine.rng.normal(0.0, TURN_NOISE, (30, 3)))
    seen = machine.points(at) + machine.noise(30, 3)
    place: Rows = {f"{axis} [mm]": 1e3 * seen[:, k] for k, axis in enumerate("xyz")}
    quaternion = turned.as_quat(scalar_first=True)
    made["poses"] = at, place | {f"q{axis}": np.round(quaternion[:, k], 7).astype(str) for k, axis in enumerate("wxyz")}

    # The tracker from two places: in the second one the base is turned, and farther away.
    for name, count, turn, far in (("left", 40, np.eye(3), np.zeros(3)), ("right", 30, *RIGHT)):
        at = machine.draw(count)
        seen = machine.points(at) @ turn.T + far + machine.noise(count, 3)
        made[name] = at, {f"{axis} [mm]": 1e3 * seen[:, k] for k, axis in enumerate("xyz")}
    return made


def text_of(readings: Array, columns: Rows) -> str:
    """Return a table, numbers with four digits behind the point."""
    cells = [*np.degrees(readings).T, *columns.values()]
    header = ", ".join([*(f"{joint[0]} [deg]" for joint in JOINTS), *columns])
    rows = zip(*cells, strict=True)
    lines = [", ".join(f"{v:.4f}" if isinstance(v, float) else str(v) for v in row) for row in rows]
    return "\n".join([header, *lines]) + "\n"


def main() -> None:
    """Write all tables into one folder."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", default=Path("observations"))
    parser.add_argument("--seed", type=int, default=8)
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    for name, (readings, columns) in tables(Machine(np.random.default_rng(chosen.seed))).items():
        (chosen.folder / f"{name}.csv").write_text(text_of(readings, columns), encoding="utf-8")


if __name__ == "__main__":
    main()
