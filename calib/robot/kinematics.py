"""Forward kinematics and kinematic regressor of a serial chain of joints, by Pinocchio.

The only module that imports Pinocchio, which has no type stubs: what leaves it is plain arrays.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin

from calib.foundations.arrays import Array

MovingType = Literal["revolute", "prismatic"]


class Regressor(NamedTuple):
    """Placements of a frame over N configurations, and how they follow the placements of the joints.

    ``rotation`` (N, 3, 3) and ``position`` (N, 3) in m: the frame in the chain's root. ``matrix`` (N, 6, 6 nj): the
    local twist of the frame for local twists of the joint placements (each perturbed on the right, before the joint's
    own motion).
    """

    rotation: Array
    position: Array
    matrix: Array


def regressor(types: Sequence[MovingType], placements: Array, tip: Array, q: Array) -> Regressor:
    """Evaluate a chain at N configurations.

    ``types`` (nj): each joint turns about, or slides along, the z axis of its own frame. ``placements`` (nj, 4, 4): of
    each joint in the one before it. ``tip`` (4, 4): the frame in the last joint. ``q`` (N, nj) in rad or m.
    """
    model, data, frame = _build(types, placements, tip)
    rotation, position, matrix = np.empty((len(q), 3, 3)), np.empty((len(q), 3)), np.empty((len(q), 6, 6 * len(types)))
    # Bound names: this loop is the whole cost of large problems, and attribute look-ups are a fifth of it.
    forward, update, compute = pin.forwardKinematics, pin.updateFramePlacement, pin.computeFrameKinematicRegressor
    local = pin.ReferenceFrame.LOCAL
    for n, q_n in enumerate(np.ascontiguousarray(q)):
        forward(model, data, q_n)
        T = update(model, data, frame)
        rotation[n], position[n] = T.rotation, T.translation
        matrix[n] = compute(model, data, frame, local)
    return Regressor(rotation, position, matrix)


def forward(types: Sequence[MovingType], placements: Array, tip: Array, q: Array) -> Array:
    """Return the placements (N, 4, 4) of the tip; arguments as for :func:`regressor`."""
    model, data, frame = _build(types, placements, tip)
    out = np.empty((len(q), 4, 4))
    for n, q_n in enumerate(np.ascontiguousarray(q)):
        pin.forwardKinematics(model, data, q_n)
        out[n] = pin.updateFramePlacement(model, data, frame).homogeneous
    return out


def _build(types: Sequence[MovingType], placements: Array, tip: Array) -> tuple[pin.Model, pin.Data, int]:
    """Return a model of its own for every call: Pinocchio's data is a scratchpad that threads must not share."""
    model, joint = pin.Model(), 0
    for i, (kind, T) in enumerate(zip(types, placements, strict=True)):
        joint_model = pin.JointModelRZ() if kind == "revolute" else pin.JointModelPZ()
        joint = model.addJoint(joint, joint_model, pin.SE3(T), f"joint_{i}")
    frame = model.addFrame(pin.Frame("tip", joint, pin.SE3(tip), pin.FrameType.OP_FRAME))
    return model, model.createData(), frame
