"""What every reading holds against gravity: torques, and forces where it slides, at nominal geometry.

The potential energy V of the machine's links is a function of the readings u alone, passive joints of closed loops
following. What reading i holds is dV/du_i: by virtual work ``(dq/du)^T g(q)``, with the gravity torques g of the tree
of joints and the rates dq/du at which all joints, passive ones too, follow the readings.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.foundations.arrays import Array
from calib.robot.kinematics import Kinematics, Mass
from calib.robot.loops import Closure, Loop, passive_joints
from calib.robot.skeleton import Segment, end_frame, skeleton

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)


@dataclass(frozen=True, slots=True)
class Payload:
    """What the tip link carries: ``mass`` in kg, its centre ``position`` in m in the tip link's frame."""

    mass: float
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """A nominal machine with masses. ``bodies``: chain joint that carries it, mass in kg, centre (3,) in its link in m.

    ``gravity`` (3,) in m/s^2, in the base link. The rest as in :class:`calib.robot.robot.Robot`.
    """

    segments: tuple[Segment, ...]
    loops: tuple[Loop, ...]
    coupling: Array
    coupling_offset: Array
    bodies: tuple[tuple[int, float, Array], ...]
    gravity: Array


class Holding:
    """Evaluates what readings hold. Not to be shared by threads."""

    def __init__(self, weights: Weights) -> None:
        s = skeleton(weights.segments, np.zeros((len(weights.segments), 6)))
        self._weights, self._passive = weights, passive_joints(weights.loops)
        self._closure = Closure(s, weights.loops) if weights.loops else None
        self._kinematics = Kinematics(s.tree, [], _masses(weights, [end_frame(s, i) for i, _, _ in weights.bodies]))

    def __call__(self, readings: Array) -> Array:
        """Return the torques (N, nr) in Nm, and forces in N of readings that are lengths, at readings (N, nr)."""
        coupling = self._weights.coupling
        q = readings @ coupling.T + self._weights.coupling_offset
        if self._closure is None:
            return self._kinematics.holding(q, self._weights.gravity) @ coupling
        q = self._closure.close(q)
        follow = np.repeat(coupling[None], len(q), axis=0)
        follow[:, self._passive] = self._closure.rates(q, coupling)[:, :, -coupling.shape[1] :]
        g = self._kinematics.holding(q, self._weights.gravity)
        return np.asarray(np.einsum("nj,njr->nr", g, follow))


def _masses(weights: Weights, frames: Sequence[tuple[int, Array]]) -> list[Mass]:
    return [
        Mass(joint, mass, T[:3, :3] @ centre + T[:3, 3])
        for (joint, T), (_, mass, centre) in zip(frames, weights.bodies, strict=True)
    ]
