"""What every coordinate holds against gravity: torques, and forces where it slides, at nominal geometry.

The potential energy V of the machine's links is a function of the coordinates u alone: the readings and, where links
give way, the ways in which they do; passive joints of closed loops follow. What coordinate i holds is dV/du_i: by
virtual work ``(dq/du)^T g(q)``, with the gravity torques g of the tree of joints and the rates dq/du at which all
joints, passive ones too, follow the coordinates.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.foundations.arrays import Array
from calib.robot.flexures import Mechanism
from calib.robot.kinematics import Kinematics, Mass
from calib.robot.loops import Closure, passive_joints
from calib.robot.skeleton import Skeleton, end_frame, skeleton

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)


@dataclass(frozen=True, slots=True)
class Payload:
    """What the tip link carries: ``mass`` in kg, its centre ``position`` in m in the tip link's frame."""

    mass: float
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """A nominal machine with masses. ``bodies``: chain joint that carries it, mass in kg, centre (3,) in its link in m.

    ``points``: names of places where a mass may be, with the chain joint that carries each and the place (3,) in its
    link in m. ``gravity`` (3,) in m/s^2, in the base link.
    """

    mechanism: Mechanism
    bodies: tuple[tuple[int, float, Array], ...]
    gravity: Array
    points: tuple[tuple[str, int, Array], ...] = ()


class Holding:
    """Evaluates what coordinates hold, the readings being given and links straight. Not to be shared by threads."""

    def __init__(self, weights: Weights) -> None:
        m = weights.mechanism
        s = skeleton(m.segments, np.zeros((len(m.segments), 6)))
        self._weights, self._passive = weights, passive_joints(m.loops)
        self._closure = Closure(s, m.loops) if m.loops else None
        self._machine = _tree(s, weights, weights.bodies)
        self._units = [_tree(s, weights, [(joint, 1.0, place)]) for _, joint, place in weights.points]
        self.points = {name: k for k, (name, _, _) in enumerate(weights.points)}

    def __call__(self, readings: Array) -> Array:
        """Return the torques (N, c) in Nm, and forces in N of coordinates that are lengths, at readings (N, nr)."""
        q, follow = self._posed(readings)
        return _by_virtual_work(self._machine.holding(q, self._weights.gravity), follow)

    def of_points(self, readings: Array) -> Array:
        """Return what a kilogram at each of the ``points`` alone would have coordinates hold (points, N, c)."""
        q, follow = self._posed(readings)
        found = [_by_virtual_work(unit.holding(q, self._weights.gravity), follow) for unit in self._units]
        return np.array(found).reshape(len(found), len(q), follow.shape[-1])

    def _posed(self, readings: Array) -> tuple[Array, Array]:
        """Return joint positions (N, nj), and the rates (nj, c) or (N, nj, c) at which they follow the coordinates."""
        m = self._weights.mechanism
        q = readings @ m.coupling[:, : readings.shape[1]].T + m.coupling_offset
        if self._closure is None:
            return q, m.coupling
        q = self._closure.close(q)
        follow = np.repeat(m.coupling[None], len(q), axis=0)
        follow[:, self._passive] = self._closure.rates(q, m.coupling)[:, :, -m.coupling.shape[1] :]
        return q, follow


def _by_virtual_work(g: Array, follow: Array) -> Array:
    return np.asarray(g @ follow if follow.ndim == 2 else np.einsum("nj,njr->nr", g, follow))


def _tree(s: Skeleton, weights: Weights, bodies: Sequence[tuple[int, float, Array]]) -> Kinematics:
    """Return the tree of joints with bodies on it."""
    carrying = weights.mechanism.carrying
    frames = [end_frame(s, int(carrying[joint])) for joint, _, _ in bodies]
    masses = [
        Mass(joint, mass, T[:3, :3] @ centre + T[:3, 3])
        for (joint, T), (_, mass, centre) in zip(frames, bodies, strict=True)
    ]
    return Kinematics(s.tree, [], masses)
