"""The calibrated URDF: the nominal document with new joint origins, in which joint offsets are folded."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.errors import OutputError
from calib.robot import deviation
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.links import motions
from calib.robot.load import load_robot, with_document
from calib.robot.robot import Deviations, Robot
from calib.robot.sampling import closing, joint_limits
from calib.robot.urdf import UrdfJoint, parse_urdf
from calib.robot.urdf_writer import splice_origins

# Largest difference at the tip, in m and in entries of the rotation, between the machine and its file read back.
ROUNDING_AT_TIP = 1e-9
# At how many readings; where loops close is tried at so many more, and at hardly any they close by rounding alone.
_COMPARED, _TRIED, _BY_ROUNDING = 20, 200, 0.1


def calibrated_origins(robot: Robot, deviations: Deviations) -> Mapping[str, Array]:
    """Return the origins (4, 4), in the parent link, of all joints of the URDF that a calibration moves.

    A joint's deviation and its offset become part of its origin, so that the URDF takes the same readings as before.
    A joint that follows others, on the arm or beside it, takes over its multiples of their offsets.
    """
    moving = [robot.chain[i].name for i in robot.moving]
    own = dict(zip(moving, map(float, deviations.offsets), strict=True))
    of_readings = np.array([own.get(reading.name, 0.0) for reading in robot.readings])
    shifts = dict(zip(moving, map(float, robot.offset_coupling @ deviations.offsets), strict=True))
    followed = dict(zip(moving, map(float, robot.coupling @ of_readings), strict=True))
    on_chain = {joint.name: (joint, d) for joint, d in zip(robot.chain, deviations.placements, strict=True)}
    drivers = {name: (name, 1.0) for name in moving}
    origins: dict[str, Array] = {}
    for joint in robot.urdf.joints:
        if joint.name in shifts:
            shift = shifts[joint.name]
        else:
            driver, multiple = _driver(robot, joint, drivers)
            shift = multiple * followed.get(driver, 0.0)
        motion = motions(joint, np.asarray(shift))
        if joint.name in on_chain:
            link, d = on_chain[joint.name]
            if np.any(d):  # without a deviation a skew frame would leave rounding
                motion = link.frame @ deviation.motion(d) @ rigid.inverse(link.frame) @ motion
        if not np.array_equal(motion, np.eye(4)):
            origins[joint.name] = joint.origin @ motion
    return origins


def calibrated_urdf(robot: Robot, deviations: Deviations) -> bytes:
    """Return the calibrated document: only origins differ from the nominal one, byte for byte.

    Before it is returned it is read back and compared with the calibrated machine, joint terms left out, at its tips,
    where closed loops close; raises OutputError if they differ.
    """
    document = splice_origins(robot.urdf.source, calibrated_origins(robot, deviations), robot.urdf.where)
    again = with_document(robot, parse_urdf(document, "the calibrated URDF"))
    plain = replace(deviations, terms=np.zeros_like(deviations.terms))
    readings = np.random.default_rng(0).uniform(-1.0, 1.0, (_COMPARED, len(robot.readings)))
    if robot.loops:
        readings = _where_loops_close(robot, plain, again, readings)
    difference = max(
        float(np.abs(again.with_tip(link).tips(readings) - robot.with_tip(link).tips(readings, plain)).max(initial=0.0))
        for link in robot.links
    )
    if not difference < ROUNDING_AT_TIP:
        raise OutputError(f"the calibrated URDF read back differs from the calibrated machine by {difference:.3g}.")
    return document


def _where_loops_close(robot: Robot, plain: Deviations, again: Robot, readings: Array) -> Array:
    """Return some of the readings (N, nr), and of others within the joints' limits, at which the machine's loops close.

    Raises OutputError where those of its URDF do not.
    """
    limits = joint_limits(robot)
    more = np.random.default_rng(1).uniform(limits[:, 0], limits[:, 1], (_TRIED, len(limits)))
    readings = np.concatenate([readings, more])
    found = readings[closing(robot, readings, (plain,))]
    there = closing(again, found)
    # At a row more or less they close by rounding.
    if np.count_nonzero(~there) > _BY_ROUNDING * len(found):
        raise OutputError("the calibrated URDF read back has loops that do not close where the machine's do.")
    return found[there][:_COMPARED]


def lost_in_urdf(
    robot: Robot, deviations: Deviations, readings: Array, conditions: Conditions = NO_CONDITIONS
) -> float:
    """Return the rms distance in m at the tip, at readings (N, nr), that the calibrated URDF alone is off.

    A URDF holds neither closed loops nor couplings of several drivers, nor joint terms; whoever reads it follows its
    mimic joints. 0 where it holds all, and nan where its joints do not even take the same readings.
    """
    if not (robot.loops or robot.couplings or robot.terms):
        return 0.0
    plain = load_robot(parse_urdf(calibrated_urdf(robot, deviations), robot.urdf.where), robot.tip, robot.base)
    names = [reading.name for reading in robot.readings]
    if any(reading.name not in names for reading in plain.readings):
        return float("nan")
    taken = readings[:, [names.index(reading.name) for reading in plain.readings]]
    apart = plain.tips(taken)[:, :3, 3] - robot.tips(readings, deviations, conditions)[:, :3, 3]
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1))))


def _driver(robot: Robot, joint: UrdfJoint, known: dict[str, tuple[str, float]]) -> tuple[str, float]:
    """Return the joint that a joint beside the arm mimics, on the arm or the last one, itself if none, and how often.

    ``known``: the answers so far, to which those of all joints on the way are added. It begins with the joints of the
    arm, which are not followed any further: how these are coupled the robot knows.
    """
    followers: list[tuple[str, float]] = []
    while joint.mimic is not None and joint.name not in known:
        followers.append((joint.name, joint.mimic.multiplier))
        joint = robot.urdf.joint(joint.mimic.joint)
    driver, multiple = known.get(joint.name, (joint.name, 1.0))
    for name, times in reversed(followers):
        multiple *= times
        known[name] = driver, multiple
    return driver, multiple
