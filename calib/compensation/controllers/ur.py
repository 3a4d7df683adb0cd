"""The kinematics file of Universal Robots' ROS description (``kinematics_params``): six joint origins.

    kinematics: {shoulder: {x, y, z, roll, pitch, yaw}, upper_arm, forearm, wrist_1, wrist_2, wrist_3, hash}

Each origin is that of the joint, at reading zero, in the link before: all turn about z, the first one stands in
``base_link`` turned half about z (``base_link_inertia``), and the last link is ``tool0`` (ur_macro.xacro of
ur_description). Older URDFs have other frames along the same axes. Theirs are turned about and slid along their axes to
the driver's, which the motion of the joints commutes with: as the nominal arm has its axes cross.

Joint offsets are in the origins. The driver compares the hash with that of the maker's calibration of the connected
robot, and says that they differ; so they do.
"""

from collections.abc import Mapping

import numpy as np

from calib.compensation.controllers.export import Export, LeftOut, judged_export, judged_readings, plain_tips, rms
from calib.compensation.controllers.yaml_text import read_yaml, yaml_text
from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array
from calib.foundations.errors import OutputError
from calib.foundations.files import sha256
from calib.machine.calibrated import CalibratedMachine
from calib.machine.urdf import calibrated_urdf
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, parse_urdf

JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
NUMBERS = ("x", "y", "z", "roll", "pitch", "yaw")
_X, _, _Z = np.eye(3)
BASE = rigid.placement(rigid.rotation_about(_Z, np.pi), np.zeros(3))
# At reading zero the driver's frames are turned about the base's x by this many quarters.
_QUARTERS = (0, 1, 1, 1, 2, 1)
# Axes of another arm are elsewhere by a right angle; calibrations by makers move them by milliradians.
_SAME_AXIS = 0.1
# In m and entries of the rotation: URDFs have their angles in twelve digits or so.
_SAME_TOOL = 1e-6


@checked
def export_ur(model: CalibratedMachine) -> Export:
    """Return the YAML for ``kinematics_params`` of a calibrated arm of Universal Robots.

    Raises OutputError for any other arm.
    """
    robot = model.robot
    prefix = _prefix(robot)
    base, tool = f"{prefix}base_link", f"{prefix}tool0"
    wrist = robot.urdf.joint(f"{prefix}{JOINTS[-1]}").child
    for link in (base, tool):
        if link not in robot.urdf.links:
            raise _not_ur(robot, f"has no link {link!r}")
    before, after = _between(robot.urdf, robot.base, base), _between(robot.urdf, tool, robot.tip)
    to_tool = _between(robot.urdf, wrist, tool)
    if before is None or after is None or to_tool is None:
        raise _not_ur(robot, f"has moving joints between {base!r} and its base, or {tool!r} and its tip")
    nominal = load_robot(robot.urdf, wrist, base)
    held = model.geometry
    document = parse_urdf(calibrated_urdf(held.robot, held.deviations), "the calibrated URDF")
    calibrated = load_robot(document, wrist, base)
    slides = slides_of(nominal, to_tool)
    to_driver = nominal.chain[-1].frame @ slides[-1]
    if np.abs(rigid.inverse(to_driver) @ to_tool - np.eye(4)).max() > _SAME_TOOL:
        raise _not_ur(robot, f"has {tool!r} elsewhere than on the axis of its last joint, z along it")
    origins = origins_of(at_zero(calibrated) @ slides)
    text = _text(origins)
    readings = judged_readings(model)
    order = [[reading.name for reading in robot.readings].index(f"{prefix}{joint}") for joint in JOINTS]

    def read_back(readings: Array) -> Array:
        return np.asarray(before @ _tips(read_ur(text), readings[:, order]) @ after)

    expected = before @ calibrated.tips(readings[:, order]) @ to_driver @ after
    cost = rms(expected[:, :3, 3], plain_tips(model, readings)[:, :3, 3])
    more = [LeftOut("placements of fixed joints", cost)] if cost > _SAME_TOOL else []
    return judged_export(model, text, read_back, expected, frozenset({"placements"}), more)


def origins_of(frames: Array) -> Array:
    """Return the six origins (6, 4, 4) of the driver's frames (6, 4, 4) at zero in base_link."""
    placed = np.stack([BASE, *frames])
    return np.asarray(rigid.inverse(placed[:-1]) @ placed[1:])


def read_ur(text: str) -> Array:
    """Return the six joint origins (6, 4, 4) of a kinematics file as :func:`export_ur` writes it."""
    kinematics = read_yaml(text)["kinematics"]
    numbers = np.array([[float(kinematics[link][number]) for number in NUMBERS] for link in LINKS])
    return rigid.placement(rigid.rotation_of_rpy(numbers[:, 3:]), numbers[:, :3])


def _text(origins: Array) -> str:
    rows = np.hstack([origins[:, :3, 3], rigid.rpy_of(origins[:, :3, :3])])
    kinematics: dict[str, Mapping[str, float] | str] = {
        link: dict(zip(NUMBERS, map(float, row), strict=True)) for link, row in zip(LINKS, rows, strict=True)
    }
    # The robot's own hash is a number of 64 bits.
    kinematics["hash"] = f"calib_{int(sha256(rows.tobytes())[:16], 16)}"
    return yaml_text({"kinematics": kinematics})


def _tips(origins: Array, q: Array) -> Array:
    """Return the driver's last frame (N, 4, 4) in the base link at joint positions (N, 6)."""
    T = np.broadcast_to(BASE, (len(q), 4, 4))
    for origin, angle in zip(origins, q.T, strict=True):
        T = T @ origin @ rigid.placement(rigid.rotation_about(_Z, angle), np.zeros(3))
    return T


def _prefix(robot: Robot) -> str:
    """Return what stands before the names of the six joints, or raise OutputError for another arm."""
    moving = [i for i, joint in enumerate(robot.chain) if joint.type != "fixed"]
    names = [robot.chain[i].name for i in moving]
    prefix = names[0].removesuffix(JOINTS[0])
    if names != [f"{prefix}{joint}" for joint in JOINTS] or moving != list(range(moving[0], moving[0] + 6)):
        raise _not_ur(robot, f"moves {', '.join(names)}")
    if robot.loops or robot.couplings or len(robot.readings) != 6:
        raise _not_ur(robot, "has joints that follow others")
    return prefix


def _not_ur(robot: Robot, what: str) -> OutputError:
    return OutputError(
        f"{robot.urdf.where}: {what}; the kinematics file of Universal Robots is for their arms alone, with joints "
        f"{', '.join(JOINTS)} one after the other, between base_link and tool0."
    )


def _between(urdf: Urdf, start: str, end: str) -> Array | None:
    """Return link ``end`` in link ``start`` (4, 4), None where joints between them move."""
    (carrier, a), (other, b) = carried(urdf, start), carried(urdf, end)
    return rigid.inverse(a) @ b if carrier == other else None


def carried(urdf: Urdf, link: str) -> tuple[str, Array]:
    """Return the link that carries another one behind fixed joints, and the pose (4, 4) of that one in it."""
    T = np.eye(4)
    while (joint := urdf.parent_joint(link)) is not None and joint.type == "fixed":
        T, link = joint.origin @ T, joint.parent
    return link, T


def at_zero(robot: Robot) -> Array:
    """Return the frames (6, 4, 4) of the moving joints at readings zero in the base link, z along their axes."""
    frames, T = [], np.eye(4)
    for joint in robot.chain:
        T = T @ joint.placement
        if joint.type != "fixed":
            frames.append(T)
    return np.stack(frames)


def slides_of(nominal: Robot, to_tool: Array) -> Array:
    """Return the motions (6, 4, 4) about and along z that lead from the joints' frames to those of the driver."""
    G = at_zero(nominal)
    turned = np.stack([BASE[:3, :3] @ rigid.rotation_about(_X, k * np.pi / 2.0) for k in _QUARTERS])
    for joint, is_, should in zip(JOINTS, G[:, :3, 2], turned[:, :, 2], strict=True):
        if np.linalg.norm(is_ - should) > _SAME_AXIS:
            raise _not_ur(nominal, f"has the axis of {joint!r} along {np.round(is_, 3).tolist()} at zero")
    turns = all(np.array_equal(joint.frame, np.eye(4)) for joint in nominal.chain)
    if turns and np.abs(to_tool - np.eye(4)).max() < _SAME_TOOL:
        return np.stack([np.eye(4)] * 6)  # the driver's frames already; makers' calibrations slide them far
    p, z = G[:, :3, 3], G[:, :3, 2]
    heights = [_foot(p[k], z[k], p[n], z[n]) for k, n in ((0, 1), (1, 0))]
    second = p[1] + heights[1] * z[1]
    heights += [float((second - p[2]) @ z[2]), *(_foot(p[k], z[k], p[k + 1], z[k + 1]) for k in (3, 4))]
    tool = G[5] @ rigid.inverse(nominal.chain[-1].frame) @ to_tool
    heights.append(float((tool[:3, 3] - p[5]) @ z[5]))
    x = np.swapaxes(G[:, :3, :3], 1, 2) @ turned[:, :, 0, None]
    angles = np.arctan2(x[:, 1, 0], x[:, 0, 0])
    return rigid.placement(rigid.rotation_about(_Z, angles), np.outer(heights, _Z))


def _foot(p: Array, z: Array, other: Array, axis: Array) -> float:
    """Return how far along z from p the line is nearest to another line."""
    return float(np.linalg.lstsq(np.column_stack([z, -axis]), other - p, rcond=None)[0][0])
