"""Forward kinematics and kinematic regressors of a tree of joints, by Pinocchio.

The only module that imports Pinocchio, which has no type stubs: what leaves it is plain arrays.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin

from calib.foundations.arrays import Array

MovingType = Literal["revolute", "prismatic"]


class Tree(NamedTuple):
    """Moving joints, parents before children.

    ``types`` (nj): each joint turns about, or slides along, the z axis of its own frame. ``parents`` (nj): number of
    the joint that carries it, -1 for the root. ``placements`` (nj, 4, 4): in the frame of that joint.
    """

    types: tuple[MovingType, ...]
    parents: tuple[int, ...]
    placements: Array


class Frame(NamedTuple):
    """A frame at ``placement`` (4, 4) in the frame of a joint; joint -1 is the root."""

    joint: int
    placement: Array


class Mass(NamedTuple):
    """A mass in kg whose centre (3,) is at rest, in m, in the frame of a joint; joint -1 is the root.

    ``inertia`` (3, 3): about the centre, along the axes of that frame, in kg m^2.
    """

    joint: int
    mass: float
    centre: Array
    inertia: Array


@dataclass(frozen=True, slots=True, eq=False)
class Regressor:
    """Placements of a frame over N configurations, and how they follow the placements of the joints.

    ``placement`` (N, 4, 4): the frame in the tree's root. ``way``: the w joints that carry it, of ``joints`` in all;
    no other one moves it. ``axes`` (w, 3, 3, N): x, y and z of each, before its own motion, in the root's axes;
    ``origins`` (w, 3, N). Rows come last, so that what is done to all of them is done at once.
    """

    placement: Array
    way: tuple[int, ...]
    joints: int
    axes: Array
    origins: Array

    def through(self, rows: Array, frame: Array) -> Array:
        """Return how numbers follow local twists of the joints' placements, (d, 6 w, N), six for every one of the way.

        ``rows`` (N, d, 6): how they follow local twists of a ``frame`` (N, 4, 4) that moves with this one. A placement
        is perturbed on the right, before the joint's own motion.
        """
        turned, rows = _rows_last(frame[:, :3, :3]), _rows_last(rows)
        shift, turn = rows[:, :3], rows[:, 3:]
        arm = frame[:, :3, 3].T - self.origins
        found = np.empty((len(rows), len(self.way), 6, rows.shape[2]))
        # A shift of the frame by v and a turn by w, about its origin, change a number by a . v + b . w; a turn of
        # something at distance r from that origin by (r x a + b) . w.
        for (by_shift, by_turn), some in _runs(
            [(bool(a.any()), bool(b.any())) for a, b in zip(shift, turn, strict=True)]
        ):
            about = np.zeros((some.stop - some.start, 1, 3, rows.shape[2]))
            if by_turn:
                about = _times(turned, turn[some])[:, None]
            if by_shift:
                a = _times(turned, shift[some])[:, None]
                _along(a, self.axes, found[some, :, :3])
                about = _cross(arm, a) + about if by_turn else _cross(arm, a)
            else:
                found[some, :, :3] = 0.0
            _along(about, self.axes, found[some, :, 3:])
        return found.reshape(len(rows), 6 * len(self.way), rows.shape[2])

    def by_joint(self, types: Sequence[MovingType], joints: Sequence[int]) -> Array:
        """Return the local twists (N, 6, k) of the frame for the positions of some joints.

        A joint's own motion commutes with a change of its position, so these are columns of the regressor.
        """
        found = np.zeros((len(self.placement), 6, len(joints)))
        own = [k for k, j in enumerate(joints) if j in self.way]
        if own:
            at = [self.way.index(joints[k]) for k in own]
            turning = np.array([types[joints[k]] == "revolute" for k in own])[:, None, None]
            z, origins = self.axes[at, 2], self.origins[at]
            arm = np.ascontiguousarray(self.placement[:, :3, 3].T) - origins
            shift, turn = np.where(turning, _cross(z, arm), z), np.where(turning, z, 0.0)
            turned = np.swapaxes(self.placement[:, :3, :3], -1, -2)
            found[:, :3, own], found[:, 3:, own] = turned @ shift.transpose(2, 1, 0), turned @ turn.transpose(2, 1, 0)
        return found

    @property
    def matrix(self) -> Array:
        """The local twists (N, 6, 6 nj) of the frame for local twists of all joints' placements."""
        found = np.zeros((len(self.placement), 6, self.joints, 6))
        every = np.broadcast_to(np.eye(6), (len(found), 6, 6))
        own = self.through(every, self.placement).reshape(6, len(self.way), 6, len(found))
        found[:, :, list(self.way)] = own.transpose(3, 0, 1, 2)
        return found.reshape(len(found), 6, 6 * self.joints)


class Kinematics:
    """Frames of a tree, evaluated at many configurations. Not to be shared by threads: it holds scratch memory.

    ``ways``: of every frame the moving joints that carry it, from the root.
    """

    def __init__(self, tree: Tree, frames: Sequence[Frame]) -> None:
        model = _model(tree)
        # The static regressor is the placements of all joints, each over the mass of all: here 1.
        model.appendBodyToJoint(1, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
        if frames:
            first = pin.Frame("first", frames[0].joint + 1, pin.SE3(frames[0].placement), pin.FrameType.OP_FRAME)
            self._first = model.addFrame(first)
        self._model, self._data = model, model.createData()
        self._tree, self._frames = tree, tuple(frames)
        # None where all joints turn.
        turning = np.array([kind == "revolute" for kind in tree.types])[:, None]
        self._turning = None if turning.all() else turning
        self.ways = tuple(_way(tree, frame.joint) for frame in frames)

    def regressors(self, q: Array) -> tuple[Regressor, ...]:
        """Return the regressor of every frame at N configurations q (N, nj) in rad or m."""
        placed = self._behind(q)
        origins, axes = placed[:, 0], placed[:, 1:]
        # Back to where the joint is before its own motion.
        before, angle = np.empty_like(axes), q.T if self._turning is None else q.T * self._turning
        c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
        before[:, 0], before[:, 1] = c * axes[:, 0] - s * axes[:, 1], s * axes[:, 0] + c * axes[:, 1]
        before[:, 2] = axes[:, 2]
        if self._turning is not None:
            origins = origins - (q.T - angle)[:, None] * axes[:, 2]
        joints = len(self._tree.types)
        return tuple(
            Regressor(placement, way, joints, before, origins)
            if len(way) == joints
            else Regressor(placement, way, joints, before[list(way)], origins[list(way)])
            for placement, way in zip(self._placed(placed), self.ways, strict=True)
        )

    def jacobian(self, q: Array) -> tuple[Array, Array]:
        """Return placements (N, 4, 4) of the first frame, and its local twists (N, 6, nj) for the joints' positions.

        At N configurations q (N, nj): columns of the regressor, without the others.
        """
        model, data, local = self._model, self._data, pin.ReferenceFrame.LOCAL
        placements, jacobians = np.empty((len(q), 4, 4)), np.empty((len(q), 6, model.nv))
        compute, placed = pin.computeFrameJacobian, data.iMf
        for n, q_n in enumerate(np.ascontiguousarray(q)):
            jacobians[n] = compute(model, data, q_n, self._first, local)
            # On its way to the root the computation leaves the frame's placement there.
            placements[n] = placed[0].homogeneous
        return placements, jacobians

    def placements(self, q: Array) -> tuple[Array, ...]:
        """Return the placements (N, 4, 4) of every frame at N configurations q (N, nj)."""
        return self._placed(self._behind(q))

    def _behind(self, q: Array) -> Array:
        """Return where all joints are, after their own motion: origins, and columns of rotations, (nj, 4, 3, N)."""
        # One call a row leaves them all; this loop is most of the cost of large problems.
        model, data, walk = self._model, self._data, pin.computeStaticRegressor
        left, found = memoryview(data.staticRegressor.T), bytearray()
        for q_n in np.ascontiguousarray(q):
            walk(model, data, q_n)
            found += left
        joints = model.njoints - 1
        by_row = np.frombuffer(found).reshape(len(q), 12 * joints)
        return np.ascontiguousarray(by_row.T).reshape(joints, 4, 3, len(q))

    def _placed(self, behind: Array) -> tuple[Array, ...]:
        """Return placements (N, 4, 4) of the frames, where joints are as :meth:`_behind` has them."""
        n = behind.shape[3]
        found = tuple(np.zeros((n, 4, 4)) for _ in self._frames)
        for to, (joint, placement) in zip(found, self._frames, strict=True):
            to[:, 3, 3] = 1.0
            if joint < 0:
                to[:] = placement
            else:
                axes = behind[joint, 1:].reshape(3, 3 * n)
                to[:, :3, :3] = (placement[:3, :3].T @ axes).reshape(3, 3, n).T
                to[:, :3, 3] = (behind[joint, 0] + (placement[:3, 3] @ axes).reshape(3, n)).T
        return found


class Weighed:
    """Masses of a tree, at rest or in motion. Not to be shared by threads: it holds scratch memory."""

    def __init__(self, tree: Tree, masses: Sequence[Mass]) -> None:
        model = _model(tree)
        for body in masses:
            model.appendBodyToJoint(
                body.joint + 1, pin.Inertia(body.mass, body.centre, body.inertia), pin.SE3.Identity()
            )
        self._model, self._data = model, model.createData()

    def holding(self, q: Array, gravity: Array) -> Array:
        """Return what the joints hold (N, nj), in Nm and N, at configurations q (N, nj).

        In ``gravity`` (N, 3) in m/s^2: these are the slopes of the potential energy of the masses.
        """
        model, data, found = self._model, self._data, np.empty((len(q), self._model.nv))
        for n, (q_n, g) in enumerate(zip(np.ascontiguousarray(q), gravity, strict=True)):
            model.gravity.linear = g
            found[n] = pin.computeGeneralizedGravity(model, data, q_n)
        return found

    def driving(self, q: Array, rates: Array, accelerations: Array, gravity: Array) -> Array:
        """Return what the joints hold (N, nj) while they move, in Nm and N, by the recursive Newton-Euler algorithm.

        At configurations q (N, nj), ``rates`` and ``accelerations`` (N, nj) per s and s^2, in ``gravity`` (N, 3).
        """
        model, data, found = self._model, self._data, np.empty((len(q), self._model.nv))
        rows = zip(*map(np.ascontiguousarray, (q, rates, accelerations)), gravity, strict=True)
        for n, (q_n, v, a, g) in enumerate(rows):
            model.gravity.linear = g
            found[n] = pin.rnea(model, data, q_n, v, a)
        return found


def _model(tree: Tree) -> pin.Model:
    model = pin.Model()
    for i, (kind, parent, T) in enumerate(zip(tree.types, tree.parents, tree.placements, strict=True)):
        joint = pin.JointModelRZ() if kind == "revolute" else pin.JointModelPZ()
        model.addJoint(parent + 1, joint, pin.SE3(T), f"joint_{i}")
    return model


def _way(tree: Tree, joint: int) -> tuple[int, ...]:
    """Return the joints from the root to one, itself included."""
    way: list[int] = []
    while joint >= 0:
        way.append(joint)
        joint = tree.parents[joint]
    return tuple(reversed(way))


def _rows_last(values: Array) -> Array:
    """Return values (N, a, b) as (a, b, N)."""
    return np.ascontiguousarray(values.transpose(1, 2, 0))


def _runs(kinds: Sequence[tuple[bool, bool]]) -> Iterator[tuple[tuple[bool, bool], slice]]:
    """Yield kinds that stand in a row, with where they do."""
    start = 0
    for kind, own in itertools.groupby(kinds):
        end = start + sum(1 for _ in own)
        yield kind, slice(start, end)
        start = end


def _times(matrices: Array, vectors: Array) -> Array:
    """Return matrices (3, 3, N) times vectors (d, 3, N)."""
    found = vectors[:, None, 0] * matrices[:, 0]
    found += vectors[:, None, 1] * matrices[:, 1]
    found += vectors[:, None, 2] * matrices[:, 2]
    return np.asarray(found)


def _along(vectors: Array, axes: Array, found: Array) -> None:
    """Write components (d, w, 3, N) of vectors (d, w or 1, 3, N) along axes (w, 3, 3, N)."""
    np.multiply(vectors[:, :, None, 0], axes[:, :, 0], out=found)
    found += vectors[:, :, None, 1] * axes[:, :, 1]
    found += vectors[:, :, None, 2] * axes[:, :, 2]


def _cross(a: Array, b: Array) -> Array:
    """Return cross products of vectors (..., 3, N); numpy's own takes several times as long."""
    found = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[..., j, :], b[..., k, :], out=found[..., i, :])
        found[..., i, :] -= a[..., k, :] * b[..., j, :]
    return found
