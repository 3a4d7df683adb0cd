"""Closed loops: joints that no encoder reads, found from frames that must coincide.

Loop l asks that the origins of two frames A and B coincide in some directions S of A: ``g = S R_A^T (p_B - p_A) = 0``.
The passive joints are solved by Newton's method from their nominal coupling; their derivatives with respect to anything
follow from the implicit function theorem, ``dq_passive = -(dg/dq_passive)^-1 dg``.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, BoolArray
from calib.foundations.errors import PoseError
from calib.robot.kinematics import Kinematics, Regressor
from calib.robot.skeleton import Skeleton, derivative, end_frame

_MOST_STEPS = 30
# Where a quarter of a micrometre is left, the links cannot reach; rounding leaves a thousandth of a nanometre.
_OPEN = 1e-10
_NEGLIGIBLE = 1e-14
# Smallest singular value of the closure, in m/rad or per unit: below it a pose is at a dead centre.
_SINGULAR = 1e-6


class Loop(NamedTuple):
    """A closed loop. ``ends``: the joints that carry frames A and B; ``closes``: axes of A, of x y z = 0 1 2.

    ``passive``: numbers of the moving joints that the loop determines, as many as directions that close.
    """

    name: str
    ends: tuple[int, int]
    closes: tuple[int, ...]
    passive: tuple[int, ...]


class _Gap(NamedTuple):
    """Gaps (N, m) of one loop, and their change (N, m, 6) with the local twists of its two frames."""

    value: Array
    by_a: Array
    by_b: Array
    a: Regressor
    b: Regressor


def passive_joints(loops: Sequence[Loop]) -> list[int]:
    """Return the numbers of all passive joints, loop by loop."""
    return [j for loop in loops for j in loop.passive]


class Closure:
    """The loops of a tree at given deviations. Not to be shared by threads."""

    def __init__(self, s: Skeleton, loops: Sequence[Loop]) -> None:
        self._loops, self._types, self._passive = tuple(loops), s.tree.types, passive_joints(loops)
        ends = [end for loop in loops for end in loop.ends]
        self._kinematics = Kinematics(s.tree, [end_frame(s, end) for end in ends])
        self._derivatives = [derivative(s, end) for end in ends]

    def close(self, q: Array) -> Array:
        """Return joint positions (N, nj) with the passive joints solved, from q (N, nj) as start.

        Raises RobotError naming the first row whose loop cannot close or is at a dead centre.
        """
        q = q.copy()
        for _ in range(_MOST_STEPS):
            value, slope = self._passive_system(self._gaps(q))
            self._refuse(_smallest_singular_value(slope) < _SINGULAR, "is at a dead centre: its joints may go two ways")
            step = np.linalg.solve(slope, value[:, :, None])[:, :, 0]
            # A step of more than half a radian could leave the branch that the machine was assembled in.
            step *= np.minimum(1.0, 0.5 / np.maximum(np.max(np.abs(step), axis=1, keepdims=True), _NEGLIGIBLE))
            q[:, self._passive] -= step
            if max(np.max(np.abs(step), initial=0.0), np.max(np.abs(value), initial=0.0)) < _NEGLIGIBLE:
                break
        value, _ = self._passive_system(self._gaps(q))
        self._refuse(np.max(np.abs(value), axis=1) > _OPEN, "cannot close: its links do not reach")
        return q

    def rates(self, q: Array, by_position: Array) -> Array:
        """Return how the passive joints follow deviations and active joints, at closed positions q (N, nj).

        (N, k, 6 n + a): per change of the n joints' deviations, then of parameters that move the positions of the
        joints by ``by_position`` (nj, a), where rows of passive joints do not count.
        """
        gaps = self._gaps(q)
        _, slope = self._passive_system(gaps)
        ends = zip(gaps, self._derivatives[::2], self._derivatives[1::2], strict=True)
        by_deviation = np.concatenate(
            [_follow(gap.by_a, gap.a, *of_a) + _follow(gap.by_b, gap.b, *of_b) for gap, of_a, of_b in ends], axis=1
        )
        moving = np.concatenate([self._by_joint(gap, range(len(self._types))) for gap in gaps], axis=1)
        driven = by_position.copy()
        driven[self._passive] = 0.0
        change = np.concatenate([by_deviation, moving @ driven], axis=2)
        return np.asarray(-np.linalg.solve(slope, change))

    def _gaps(self, q: Array) -> list[_Gap]:
        ends = self._kinematics.regressors(q)
        return [_gap(loop, a, b) for loop, a, b in zip(self._loops, ends[::2], ends[1::2], strict=True)]

    def _passive_system(self, gaps: Sequence[_Gap]) -> tuple[Array, Array]:
        """Return all gaps (N, k) and their change (N, k, k) with the passive joints."""
        slope = np.concatenate([self._by_joint(gap, self._passive) for gap in gaps], axis=1)
        return np.concatenate([gap.value for gap in gaps], axis=1), slope

    def _by_joint(self, gap: _Gap, joints: Sequence[int]) -> Array:
        of_a, of_b = (end.by_joint(self._types, joints) for end in (gap.a, gap.b))
        return np.asarray(gap.by_a @ of_a + gap.by_b @ of_b)

    def _refuse(self, rows: BoolArray, why: str) -> None:
        if np.any(rows):
            raise PoseError(int(np.argmax(rows)), f"loop {', '.join(repr(loop.name) for loop in self._loops)} {why}")


def _gap(loop: Loop, a: Regressor, b: Regressor) -> _Gap:
    to_a = np.swapaxes(a.placement[:, :3, :3], -1, -2)
    apart = (to_a @ (b.placement[:, :3, 3] - a.placement[:, :3, 3])[:, :, None])[:, :, 0]
    # dg = S (R_AB v_B - v_A - w_A x gap); the last term matters once a gap stays open in another direction.
    by_a = np.concatenate([np.broadcast_to(-np.eye(3), to_a.shape), rigid.skew(apart)], axis=2)
    by_b = np.concatenate([to_a @ b.placement[:, :3, :3], np.zeros_like(to_a)], axis=2)
    S = list(loop.closes)
    return _Gap(apart[:, S], by_a[:, S], by_b[:, S], a, b)


def _follow(by_twist: Array, end: Regressor, joints: Array, tail: Array) -> Array:
    """Return how gaps follow deviations through one end's twist: (N, m, 6 n)."""
    return np.asarray((by_twist @ end.matrix) @ joints + by_twist @ tail)


def _smallest_singular_value(slope: Array) -> Array:
    return np.asarray(np.linalg.svd(slope, compute_uv=False)[:, -1])
