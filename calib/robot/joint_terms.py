"""A robot with joint terms, and with the masses that some of them need."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import RobotError
from calib.robot.gravity import Weights
from calib.robot.robot import Robot, segments
from calib.robot.transmission import JointTerm
from calib.robot.urdf import UrdfJoint, inertials


def with_joint_terms(robot: Robot, terms: Sequence[JointTerm]) -> Robot:
    """Return the robot with these terms in the place of its own. ``robot`` is in the frames of its URDF.

    Raises RobotError when a term needs masses that the URDF does not state, or says in a way that cannot be used.
    """
    weights = weights_of(robot) if any(term.kind == "elastic" for term in terms) else None
    return replace(robot, terms=tuple(terms), weights=weights)


def weights_of(robot: Robot) -> Weights:
    """Return the masses of all links that the base link carries, and of the payload, at the joints of the chain.

    What hangs on joints that belong to no reading, as the fingers of a gripper do, is taken where these are at zero.
    Raises RobotError when no link states a mass, or one moves with a reading but not with the chain.
    """
    index = {robot.urdf.joint(joint.name).child: i for i, joint in enumerate(robot.chain)}
    bodies: list[tuple[int, float, Array]] = []
    for link, (mass, centre) in inertials(robot.urdf).items():
        if mass > 0.0 and (place := _place(robot, link, index)) is not None:
            joint, T = place
            bodies.append((joint, mass, read_only(T[:3, :3] @ centre + T[:3, 3])))
    if not bodies:
        raise RobotError(
            f"{robot.urdf.where}: no link that {robot.base!r} carries states its mass, which wind-up under gravity "
            "needs; give every <link> an <inertial>."
        )
    if robot.payload is not None:
        bodies.append((robot.tip_joint, robot.payload.mass, read_only(robot.payload.position)))
    return Weights(
        tuple(segments(robot)),
        robot.loops,
        robot.coupling,
        robot.coupling_offset,
        tuple(bodies),
        read_only(robot.gravity),
    )


def _place(robot: Robot, link: str, index: dict[str, int]) -> tuple[int, Array] | None:
    """Return the joint of the chain that carries a link, and the link (4, 4) in its; None where the base carries it."""
    T, at = np.eye(4), link
    while at not in index:
        joint = robot.urdf.parent_joint(at)
        if joint is None or at == robot.base:
            return None
        if joint.type != "fixed" and _reading(robot, joint) is not None:
            raise RobotError(
                f"{robot.urdf.where}:{joint.line}: link {link!r} moves with the reading {_reading(robot, joint)!r} but "
                "not on the way to the tip, and what it weighs there is not known; close its loop."
            )
        T, at = joint.origin @ T, joint.parent
    return index[at], T


def _reading(robot: Robot, joint: UrdfJoint) -> str | None:
    """Return the reading that moves a joint, or None."""
    while joint.mimic is not None:
        joint = robot.urdf.joint(joint.mimic.joint)
    return joint.name if any(reading.name == joint.name for reading in robot.readings) else None
