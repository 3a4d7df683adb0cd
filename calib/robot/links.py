"""All links of a robot through many poses, those beside the arm too, as tables of origins and positions of its joints.

A link sits in its parent at ``origin @ motion(position)``: that is all of a URDF's kinematics, and a viewer needs no
library to follow it. Closed loops, couplings and offsets are in the positions already.
"""

from dataclasses import dataclass

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.sealing import sealed
from calib.robot import deviation
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.robot import Deviations, Robot
from calib.robot.urdf import Urdf, UrdfJoint


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Arm:
    """An arm through N poses. ``root`` (4, 4): its root link in the world.

    ``origins`` (J, 4, 4) and ``positions`` (N, J): of the joints in the order of the URDF, in rad or m, 0 where fixed.
    """

    root: Array
    origins: Array
    positions: Array


def arm_of(
    robot: Robot, deviations: Deviations, readings: Array, root: Array, conditions: Conditions = NO_CONDITIONS
) -> Arm:
    """Return an arm at readings (N, nr). Joints beside it follow what they mimic, or rest as near to 0 as limits allow.

    Raises PoseError for a row where a closed loop cannot close, RobotError for a joint term whose ``conditions`` lack.
    """
    urdf = robot.urdf
    column = {joint.name: k for k, joint in enumerate(urdf.joints)}
    origins = np.array([joint.origin for joint in urdf.joints]).reshape(-1, 4, 4)
    for link, d in zip(robot.chain, deviations.placements, strict=True):
        k = column[link.name]
        origins[k] = origins[k] @ link.frame @ deviation.motion(d) @ rigid.inverse(link.frame)
    positions = np.zeros((len(readings), len(urdf.joints)))
    known = [column[robot.chain[i].name] for i in robot.moving]
    of_arm = frozenset(known)
    positions[:, known] = robot.joint_positions(readings, deviations, conditions)
    for k in range(len(urdf.joints)):
        if k not in of_arm:
            positions[:, k] = _following(urdf, k, column, positions, of_arm)
    return Arm(root, origins, positions)


def link_placements(urdf: Urdf, arm: Arm) -> dict[str, Array]:
    """Return the placements (N, 4, 4) of all links of an arm in its root link."""
    n = len(arm.positions)
    found = {urdf.root: np.tile(np.eye(4), (n, 1, 1))}
    waiting = list(range(len(urdf.joints)))
    while waiting:
        ready = [k for k in waiting if urdf.joints[k].parent in found]
        for k in ready:
            joint = urdf.joints[k]
            found[joint.child] = found[joint.parent] @ arm.origins[k] @ motions(joint, arm.positions[:, k])
        waiting = [k for k in waiting if k not in ready]
    return found


def _following(urdf: Urdf, k: int, column: dict[str, int], positions: Array, known: frozenset[int]) -> Array:
    """Return the positions (N,) of a joint that is not on the arm: those of its driver, or at rest."""
    multiple, constant = 1.0, 0.0
    while k not in known and (mimic := urdf.joints[k].mimic) is not None:
        multiple, constant = multiple * mimic.multiplier, constant + multiple * mimic.offset
        k = column[mimic.joint]
    own = positions[:, k] if k in known else np.full(len(positions), _rest(urdf.joints[k]))
    return multiple * own + constant


def _rest(joint: UrdfJoint) -> float:
    """Return the position nearest to 0 that a joint may have."""
    lowest = 0.0 if joint.lower is None else max(0.0, joint.lower)
    return lowest if joint.upper is None else min(lowest, joint.upper)


def motions(joint: UrdfJoint, q: Array) -> Array:
    """Return the motions (..., 4, 4) of a joint at positions q (...), or (4, 4) of one that does not move."""
    if joint.type == "prismatic":
        return rigid.translation(q[..., None] * joint.axis)
    if joint.type in ("revolute", "continuous"):
        return rigid.placement(rigid.rotation_about(joint.axis, q), np.zeros(3))
    return np.eye(4)
