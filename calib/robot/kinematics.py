"""Forward kinematics and kinematic regressors of a tree of joints, by Pinocchio.

The only module that imports Pinocchio, which has no type stubs: what leaves it is plain arrays.
"""

from collections.abc import Sequence
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


class Regressor(NamedTuple):
    """Placements of a frame over N configurations, and how they follow the placements of the joints.

    ``placement`` (N, 4, 4): the frame in the tree's root. ``matrix`` (N, 6, 6 nj): the local twist of the frame for
    local twists of the joint placements (each perturbed on the right, before the joint's own motion).
    """

    placement: Array
    matrix: Array

    def by_joint(self, types: Sequence[MovingType], joints: Sequence[int]) -> Array:
        """Return the local twists (N, 6, k) of the frame for the positions of some joints.

        A joint's own motion commutes with a change of its position, so these are columns of the regressor.
        """
        return self.matrix[:, :, [6 * j + (5 if types[j] == "revolute" else 2) for j in joints]]


class Kinematics:
    """Frames of a tree, evaluated at many configurations. Not to be shared by threads: it holds scratch memory."""

    def __init__(self, tree: Tree, frames: Sequence[Frame], masses: Sequence[Mass] = ()) -> None:
        model = pin.Model()
        for i, (kind, parent, T) in enumerate(zip(tree.types, tree.parents, tree.placements, strict=True)):
            joint = pin.JointModelRZ() if kind == "revolute" else pin.JointModelPZ()
            model.addJoint(parent + 1, joint, pin.SE3(T), f"joint_{i}")
        self._frames = tuple(
            model.addFrame(pin.Frame(f"frame_{k}", frame.joint + 1, pin.SE3(frame.placement), pin.FrameType.OP_FRAME))
            for k, frame in enumerate(frames)
        )
        for body in masses:
            model.appendBodyToJoint(
                body.joint + 1, pin.Inertia(body.mass, body.centre, body.inertia), pin.SE3.Identity()
            )
        self._model, self._data = model, model.createData()

    def regressors(self, q: Array) -> tuple[Regressor, ...]:
        """Return the regressor of every frame at N configurations q (N, nj) in rad or m."""
        # Bound names, and one conversion at the end: this loop is the whole cost of large problems.
        model, data, local = self._model, self._data, pin.ReferenceFrame.LOCAL
        forward, update, compute = pin.forwardKinematics, pin.updateFramePlacement, pin.computeFrameKinematicRegressor
        placements: tuple[list[Array], ...] = tuple([] for _ in self._frames)
        matrices: tuple[list[Array], ...] = tuple([] for _ in self._frames)
        targets = tuple(zip(self._frames, placements, matrices, strict=True))
        for q_n in np.ascontiguousarray(q):
            forward(model, data, q_n)
            for frame, to_placements, to_matrices in targets:
                to_placements.append(update(model, data, frame).homogeneous)
                to_matrices.append(compute(model, data, frame, local))
        size = 6 * (model.njoints - 1)
        return tuple(
            Regressor(np.array(T).reshape(-1, 4, 4), np.array(M).reshape(-1, 6, size))
            for T, M in zip(placements, matrices, strict=True)
        )

    def jacobian(self, q: Array) -> tuple[Array, Array]:
        """Return placements (N, 4, 4) of the first frame, and its local twists (N, 6, nj) for the joints' positions.

        At N configurations q (N, nj): columns of the regressor, without the others.
        """
        model, data, local, frame = self._model, self._data, pin.ReferenceFrame.LOCAL, self._frames[0]
        placements, jacobians = np.empty((len(q), 4, 4)), np.empty((len(q), 6, model.nv))
        compute, placed = pin.computeFrameJacobian, data.iMf
        for n, q_n in enumerate(np.ascontiguousarray(q)):
            jacobians[n] = compute(model, data, q_n, frame, local)
            # On its way to the root the computation leaves the frame's placement there.
            placements[n] = placed[0].homogeneous
        return placements, jacobians

    def placements(self, q: Array) -> tuple[Array, ...]:
        """Return the placements (N, 4, 4) of every frame at N configurations q (N, nj)."""
        model, data = self._model, self._data
        found = tuple(np.empty((len(q), 4, 4)) for _ in self._frames)
        for n, q_n in enumerate(np.ascontiguousarray(q)):
            pin.forwardKinematics(model, data, q_n)
            for frame, to in zip(self._frames, found, strict=True):
                to[n] = pin.updateFramePlacement(model, data, frame).homogeneous
        return found

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
