"""Touching and measuring with a simulated machine of known truth: sockets, bars, gauges, planes, balls, indicators.

None of calib's kinematics: :mod:`tests.support.machines` says where the tool is, and Newton's method with
numeric derivatives finds readings at which it touches.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

import calib
from calib.identification.relations import Relation
from calib.identification.targets import Target
from calib.robot.deviation import axis_frame
from tests.support import machines
from tests.support.machines import Array, Machine, Rng, pose

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
POINT = (0.02, 0.03, 0.12)
SIGMA = 1e-5
# Closed to rounding: the truth is to be found to a nanometre.
CLOSED = 1e-13
H = 1e-7

# In the frame of the robot's nominal base, within the reach of a UR10.
SOCKETS = {"a": (0.6, 0.1, 0.3), "b": (0.4, -0.5, 0.2), "c": (-0.3, 0.5, 0.5)}
ANCHOR = (1.2, 0.3, -0.2)
BALL = (0.5, 0.3, 0.4)
RADIUS, PROBE = 0.012, 0.003
NORMALS = {"floor": (0.1, -0.2, 1.0), "left": (1.0, 0.1, 0.15), "front": (0.0, 1.0, 0.3)}
HEIGHTS = {"floor": 0.2, "left": -0.45, "front": -0.4}


def unit(v: Sequence[float] | Array) -> Array:
    """Unit vector along v."""
    return np.asarray(v) / np.linalg.norm(v)


@dataclass(frozen=True)
class Lab:
    """A machine and the robot it should be; what stands around it keeps its place in the frame of ``machine.base``."""

    machine: Machine
    robot: calib.Robot
    rng: Rng
    noise: float = 0.0

    def where(self, q: Array, tool: str | None = None) -> Array:
        """True tool points (n, 3) in the base's frame."""
        chosen = next(iter(self.machine.tools.values())) if tool is None else self.machine.tools[tool]
        return np.asarray((self.machine.arm.tips(q) @ chosen)[:, :3, 3])

    def known(self, *names: str) -> dict[str, Target]:
        """What is known of targets, in the instrument's frame."""
        return {name: Target(self.machine.base @ PLACES[name]) for name in names}

    def draw(self, n: int) -> Array:
        """Random readings (n, k)."""
        return self.machine.arm.draw(self.rng, n)

    def scatter(self, *shape: int) -> Array:
        """Noise of that shape."""
        return self.rng.normal(scale=self.noise, size=shape)

    def touching(
        self, gap: Callable[[Array], Array], away: Array, tool: str | None = None, outside: Array | None = None
    ) -> Array:
        """Random readings (n, k) at which ``gap`` (m, d) of tool points (m, 3) is ``away`` (n, d).

        ``outside`` (3,): the direction in which the tip link must be then.
        """
        n, k = len(away), len(self.machine.arm.ranges)
        low, high = np.transpose(list(self.machine.arm.ranges.values()))
        found = np.full((n, k), np.nan)
        while (open_ := np.flatnonzero(np.isnan(found[:, 0]))).size:
            goal = away[open_]
            q = self.draw(len(goal))
            for _ in range(14):
                all_q = (q + H * np.vstack([np.zeros(k), np.eye(k)])[:, None]).reshape(-1, k)
                g = gap(self.where(all_q, tool)).reshape(k + 1, len(q), -1)
                J = np.moveaxis((g[1:] - g[0]) / H, 0, -1)
                step = -(np.linalg.pinv(J) @ (g[0] - goal)[:, :, None])[:, :, 0]
                q = np.clip(q + step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True)), low, high)
            closed = np.abs(gap(self.where(q, tool)) - goal).max(axis=1) < CLOSED
            if outside is not None:
                closed &= (self.machine.arm.tips(q)[:, :3, 3] - self.where(q, tool)) @ outside > 0.03
            found[open_[closed]] = q[closed]
        return found

    def columns(self, q: Array, **more: object) -> dict[str, object]:
        """The columns of readings and others, whose names end in ``_m`` for lengths."""
        types = {joint.driver: joint.type for joint in self.machine.arm.joints}
        columns: dict[str, object] = {
            f"{name} [{'m' if types[name] == 'prismatic' else 'rad'}]": q[:, k]
            for k, name in enumerate(self.machine.arm.ranges)
        }
        return columns | {f"{n[:-2]} [m]" if n.endswith("_m") else n: values for n, values in more.items()}

    def read(self, q: Array, observes: str, offset: str | None = None, **more: object) -> calib.Measurements:
        """Measurements at readings, with other columns."""
        columns, sigma = self.columns(q, **more), self.noise or SIGMA
        return calib.read_measurements(columns, self.robot, observes, sigma=sigma, offset=offset)

    # ---- one method for each kind

    def positions(self, n: int) -> calib.Measurements:
        """Positions in the instrument's frame."""
        q = self.draw(n)
        seen = self.where(q) + self.scatter(n, 3)
        x, y, z = (seen @ self.machine.base[:3, :3].T + self.machine.base[:3, 3]).T
        return self.read(q, "position", x_m=x, y_m=y, z_m=z)

    def sockets(self, n: int, names: Sequence[str] = ("a", "b", "c"), tool: str | None = None) -> calib.Measurements:
        """Every socket touched n times."""
        names = tuple(names)
        q = [self.touching(lambda x, c=SOCKETS[name]: x - c, self.scatter(n, 3), tool) for name in names]
        point = {} if tool is None else {"tool": [tool] * (n * len(names))}
        return self.read(np.concatenate(q), "socket", target=np.repeat(names, n).tolist(), **point)

    def distances(self, n: int, too_long: float = 0.0, offset: str | None = None) -> calib.Measurements:
        """Lengths of a bar from its anchor, all of them ``too_long``."""
        q = self.draw(n)
        length = np.linalg.norm(self.where(q) - ANCHOR, axis=1) + too_long + self.scatter(n)
        return self.read(q, "distance", offset, length_m=length, target=["anchor"] * n)

    def pairs(self, n: int, too_long: float = 0.0, offset: str | None = None) -> calib.Measurements:
        """Lengths between the ends of n pairs."""
        q = self.draw(2 * n)
        a, b = np.swapaxes(self.where(q).reshape(n, 2, 3), 0, 1)
        length = np.linalg.norm(a - b, axis=1) + too_long + self.scatter(n)
        pair = np.repeat(np.arange(n), 2).astype(str).tolist()
        return self.read(q, "pair_distance", offset, length_m=np.repeat(length, 2), pair=pair)

    def planes(
        self, n: int, names: Sequence[str] = ("floor",), *, ball: float = 0.0, raised: float = 0.0
    ) -> calib.Measurements:
        """Every plane, ``raised`` by so much, touched n times with a ball of that diameter."""
        above = ball / 2 + raised
        q = [
            self.touching(
                lambda x, m=name: (x @ unit(NORMALS[m]) - HEIGHTS[m] - above)[:, None],
                self.scatter(n, 1),
                outside=unit(NORMALS[name]),
            )
            for name in names
        ]
        return self.read(
            np.concatenate(q), "plane", target=np.repeat(names, n).tolist(), ball_m=np.full(n * len(names), ball)
        )

    def sphere(self, n: int, offset: str | None = None) -> calib.Measurements:
        """A ball touched n times with the probe's ball."""
        q = self.touching(
            lambda x: np.linalg.norm(x - BALL, axis=1, keepdims=True) - RADIUS - PROBE, self.scatter(n, 1)
        )
        diameter = {"diameter_m": np.full(n, 2 * RADIUS)} if offset is None else {}
        return self.read(q, "sphere", offset, target=["ball"] * n, ball_m=np.full(n, 2 * PROBE), **diameter)

    def indicator(self, n: int) -> calib.Measurements:
        """What a dial shows along the floor's normal, with its zero at the floor's height."""
        q = self.draw(n)
        shown = self.where(q) @ unit(NORMALS["floor"]) - HEIGHTS["floor"] + self.scatter(n)
        return self.read(q, "indicator", indicated_m=shown, target=["floor"] * n)

    # ---- judging

    def miss(self, fit: calib.Fit, n: int = 300, *, sized: bool = True) -> float:
        """3D rms in m between predicted and true tool points, moved onto each other; scaled too unless ``sized``."""
        q = self.draw(n)
        a, b = machines.predicted(fit, q)[:, :3, 3], self.where(q)
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        U, s, Vt = np.linalg.svd(a.T @ b)
        D = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
        scale = 1.0 if sized else (s @ D) / np.sum(a * a)
        return float(np.sqrt(np.mean(np.sum((b - scale * a @ (U * D) @ Vt) ** 2, axis=1))))


PLACES = {
    "anchor": pose(ANCHOR),
    "ball": pose(BALL),
    **{name: pose(c) for name, c in SOCKETS.items()},
    **{name: axis_frame(unit(n)) @ pose((0.0, 0.0, HEIGHTS[name])) for name, n in NORMALS.items()},
}


def lab(seed: int = 0, *, noise: float = 0.0, arm: tuple[str, str] = UR10, base: Array | None = None) -> Lab:
    """A badly made arm; it stands at the origin unless told otherwise."""
    rng = np.random.default_rng(seed)
    true = machines.arm(*arm).moved(rng)
    tools = {"tool": pose(POINT, (0.3, -0.4, 0.5)), "long": pose((-0.04, 0.02, 0.2))}
    return Lab(Machine(true, np.eye(4) if base is None else base, tools), machines.load(*arm), rng, noise)


def between(kind: str, a: str, b: str, sigma: float = 1e-6) -> Relation:
    """What is true between two sockets or two planes."""
    if kind == "distance":
        return Relation("distance", (a, b), float(np.linalg.norm(np.subtract(SOCKETS[a], SOCKETS[b]))), sigma)
    angle = float(np.arccos(unit(NORMALS[a]) @ unit(NORMALS[b])))
    return Relation("angle", (a, b), angle, sigma)
