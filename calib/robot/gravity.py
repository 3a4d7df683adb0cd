"""What every coordinate holds against gravity: torques, and forces where it slides, at nominal geometry.

The potential energy V of the machine's links is a function of the coordinates u alone: the readings and, where links
give way, the ways in which they do; passive joints of closed loops follow. What coordinate i holds is dV/du_i: by
virtual work ``(dq/du)^T g(q)``, with the gravity torques g of the tree of joints and the rates dq/du at which all
joints, passive ones too, follow the coordinates.
"""

from dataclasses import dataclass

import numpy as np

from calib.foundations.arguments import refuse_fields
from calib.foundations.arrays import Array
from calib.robot.flexures import Mechanism
from calib.robot.kinematics import Frame, Kinematics, Mass
from calib.robot.loops import Closure, passive_joints
from calib.robot.skeleton import Skeleton, end_frame, skeleton

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)


@dataclass(frozen=True, slots=True)
class Payload:
    """What the tip link carries: ``mass`` in kg, its centre ``position`` in m in the tip link's frame."""

    mass: float
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        refuse_fields(self)


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """A nominal machine with masses. ``bodies``: chain joint that carries it, mass in kg, centre (3,) in its link in m.

    ``units``: masses that nobody knows, by name: the chain joint that carries one, and (4,) its first moment in kg m in
    that joint's frame, then its mass in kg. ``gravity`` (3,) in m/s^2, in the base link.
    """

    mechanism: Mechanism
    bodies: tuple[tuple[int, float, Array], ...]
    gravity: Array
    units: tuple[tuple[str, int, Array], ...] = ()


class Holding:
    """Evaluates what coordinates hold, the readings being given and links straight. Not to be shared by threads."""

    def __init__(self, weights: Weights) -> None:
        m = weights.mechanism
        s = skeleton(m.segments, np.zeros((len(m.segments), 6)))
        self._weights, self._passive = weights, passive_joints(m.loops)
        self._closure = Closure(s, m.loops) if m.loops else None
        carried = sorted({joint for _, joint, _ in weights.units})
        self._frames = {joint: k for k, joint in enumerate(carried)}
        self._kinematics = Kinematics(
            s.tree, [_frame(s, int(m.carrying[joint])) for joint in carried], _masses(s, weights)
        )
        self.units = {name: k for k, (name, _, _) in enumerate(weights.units)}

    def __call__(self, readings: Array) -> Array:
        """Return the torques (N, c) in Nm, and forces in N of coordinates that are lengths, at readings (N, nr)."""
        q, follow = self._posed(readings)
        return _by_virtual_work(self._kinematics.holding(q, self._weights.gravity), follow)

    def of_units(self, readings: Array) -> Array:
        """Return what each of the ``units`` alone would have coordinates hold (units, N, c), at readings (N, nr).

        A first moment h in a frame R has the energy -g . R h, and a turn w of the frame in itself changes it by
        -(h x R^T g) . w; a mass m, moved by v, by -m R^T g . v.
        """
        q, follow = self._posed(readings)
        types = self._weights.mechanism.types
        regressors = self._kinematics.regressors(q)
        found = np.empty((len(self._weights.units), len(q), follow.shape[-1]))
        for k, (_, joint, unit) in enumerate(self._weights.units):
            frame = regressors[self._frames[joint]]
            g = self._weights.gravity @ frame.placement[:, :3, :3]
            twists = frame.by_joint(types, range(len(types)))
            slopes = np.concatenate([unit[3] * g, np.cross(unit[:3], g)], axis=1)
            found[k] = _by_virtual_work(-(slopes[:, None] @ twists)[:, 0], follow)
        return found

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


def _frame(s: Skeleton, segment: int) -> Frame:
    """Return the frame that moves with a joint, whose z is its axis."""
    joint, T = end_frame(s, segment)
    return Frame(joint, T @ s.segments[segment].frame)


def _masses(s: Skeleton, weights: Weights) -> list[Mass]:
    frames = [end_frame(s, int(weights.mechanism.carrying[joint])) for joint, _, _ in weights.bodies]
    return [
        Mass(joint, mass, T[:3, :3] @ centre + T[:3, 3])
        for (joint, T), (_, mass, centre) in zip(frames, weights.bodies, strict=True)
    ]
