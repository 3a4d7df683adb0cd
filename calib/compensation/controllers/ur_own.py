"""The maker's calibration of an arm of Universal Robots as a nominal robot: a URDF with that arm's own axes.

Two files hold one. ``kinematics_params`` of the ROS description (``default_kinematics.yaml``, or what
``ur_calibration`` extracts) has six origins. ``calibration.conf`` of the controller has what is added to the DH numbers
of the model, angles in rad and lengths in m (issue 357 of ros-industrial/universal_robot, issue 179 of
ur_modern_driver), with

    T_k = Rz(q + theta) Tz(d) Tx(a) Rx(alpha)

from the frame ``base``, half a turn about z from ``base_link``. Its frames lie up to hundreds of metres away, as nearly
parallel axes have no near common normal; here frames stay on their axes, as near to the URDF's own as may be.
"""

import re

import numpy as np

from calib.compensation.controllers import ur
from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array
from calib.foundations.errors import OutputError, RobotError
from calib.foundations.units import NUMBER
from calib.robot.load import load_robot
from calib.robot.urdf import Urdf
from calib.robot.urdf_writer import splice_origins

_DELTA = re.compile(r"(?m)^[ \t]*delta_(theta|a|d|alpha)[ \t]*=[ \t]*\[([^\[\]=]*)\]")
_LINK = re.compile(r"^\s*(shoulder|upper_arm|forearm|wrist_1|wrist_2|wrist_3)\s*:\s*$")
_VALUE = re.compile(rf"^\s*(x|y|z|roll|pitch|yaw)\s*:\s*({NUMBER.pattern})\s*$")
_ALPHA = (0.5 * np.pi, 0.0, 0.0, 0.5 * np.pi, -0.5 * np.pi, 0.0)
# An axis that is farther from the model's, as a share of the arm's length and in rad, is another model's: the wrists of
# UR3 and UR3e, of half a metre both, differ by 19 mm.
_FARTHEST, _MOST_TURNED = 0.03, 0.1
_LARGEST = 1e6


@checked
def with_ur_kinematics(nominal: Urdf, text: str, where: str = "kinematics") -> bytes:
    """Return the URDF of an arm of Universal Robots with the axes that a file of its maker's calibration states.

    ``nominal``: of the same model; every byte but the origins of the six joints and of ``tool0`` is kept. ``text``:
    ``kinematics_params`` in YAML, or ``calibration.conf``. Raises RobotError when it is none, or of another model.
    """
    prefix = next((j.name.removesuffix(ur.JOINTS[0]) for j in nominal.joints if j.name.endswith(ur.JOINTS[0])), None)
    links = {f"{prefix}base_link", f"{prefix}tool0"}
    if prefix is None or not links <= set(nominal.links):
        raise RobotError(f"{nominal.where}: is no arm of Universal Robots with base_link, tool0 and its six joints.")
    arm = load_robot(nominal, f"{prefix}tool0", f"{prefix}base_link")
    if [reading.name for reading in arm.readings] != [f"{prefix}{joint}" for joint in ur.JOINTS]:
        raise RobotError(f"{nominal.where}: its joints between base_link and tool0 are not those of this maker's arms.")
    zero = ur.at_zero(arm)
    tool = arm.tips(np.zeros((1, 6)))[0]
    wrist = load_robot(nominal, nominal.joint(f"{prefix}{ur.JOINTS[-1]}").child, f"{prefix}base_link")
    after = rigid.inverse(wrist.tips(np.zeros((1, 6)))[0]) @ tool
    try:
        slides = ur.slides_of(wrist, after)
    except OutputError as e:
        raise RobotError(str(e)) from e
    frames = _of_conf(text, ur.origins_of(zero @ slides), where) if _DELTA.search(text) else _of_yaml(text, where)
    farthest = _FARTHEST * float(np.linalg.norm(tool[:3, 3]))
    own = np.stack([_on_axis(old, new) for old, new in zip(zero, frames[:-1], strict=True)])
    for joint, old, new in zip(ur.JOINTS, zero, own, strict=True):
        turned = float(np.linalg.norm(np.cross(old[:3, 2], new[:3, 2])))
        if np.linalg.norm(old[:3, 3] - new[:3, 3]) > farthest or turned > _MOST_TURNED or old[:3, 2] @ new[:3, 2] < 0:
            raise RobotError(f"{where}: the axis of {joint} is not near that of {nominal.where}; is it of this model?")
    if np.linalg.norm(tool[:3, 3] - frames[-1][:3, 3]) > farthest:
        raise RobotError(f"{where}: the tool is not near that of {nominal.where}; is it of this model?")
    return splice_origins(nominal.source, _origins(nominal, prefix, own, frames[-1]), nominal.where)


def _of_yaml(text: str, where: str) -> Array:
    """Return the frames (7, 4, 4) of the joints and the tool at zero in base_link."""
    found: dict[str, dict[str, float]] = {}
    link = ""
    for line in text.splitlines():
        if head := _LINK.match(line):
            link = head[1]
        elif (value := _VALUE.match(line)) and link:
            own = found.setdefault(link, {})
            if value[1] in own:
                raise RobotError(f"{where}: {link!r} has {value[1]} twice.")
            own[value[1]] = _number(value[2], where)
    missing = [link for link in ur.LINKS if len(found.get(link, {})) != 6]
    if missing:
        raise RobotError(f"{where}: {missing[0]!r} has not x, y, z, roll, pitch and yaw; is it kinematics_params?")
    numbers = np.array([[found[link][number] for number in ur.NUMBERS] for link in ur.LINKS])
    T, frames = ur.BASE, []
    for origin in rigid.placement(rigid.rotation_of_rpy(numbers[:, 3:]), numbers[:, :3]):
        T = T @ origin
        frames.append(T)
    return np.stack([*frames, frames[-1]])


def _of_conf(text: str, nominal: Array, where: str) -> Array:
    """Return the same from ``calibration.conf``; ``nominal``: the driver's origins (6, 4, 4) of the model."""
    deltas: dict[str, list[float]] = {}
    for name, numbers in _DELTA.findall(text):
        if name in deltas:
            raise RobotError(f"{where}: has delta_{name} twice.")
        deltas[name] = [_number(word, where) for word in numbers.split(",")]
    if len(deltas) < 4 or any(len(numbers) != 6 for numbers in deltas.values()):
        raise RobotError(f"{where}: has not six numbers each in delta_theta, delta_a, delta_d and delta_alpha.")
    p = nominal[:, :3, 3]
    d = np.array([p[0, 2], 0.0, 0.0, p[3, 2], -p[4, 1], p[5, 1]]) + deltas["d"]
    a = np.array([0.0, p[2, 0], p[3, 0], 0.0, 0.0, 0.0]) + deltas["a"]
    alpha = np.array(_ALPHA) + deltas["alpha"]
    T, frames = ur.BASE, []
    x, _, z = np.eye(3)
    for k in range(6):
        frames.append(T)
        turn = rigid.placement(rigid.rotation_about(z, deltas["theta"][k]), np.array([0.0, 0.0, d[k]]))
        T = T @ turn @ rigid.placement(rigid.rotation_about(x, alpha[k]), np.array([a[k], 0.0, 0.0]))
    return np.stack([*frames, T])


def _number(text: str, where: str) -> float:
    # Python's ``float`` leaves out fewer characters at the ends than ``strip``.
    digits = text.strip()
    if NUMBER.fullmatch(digits) is None or abs(float(digits)) > _LARGEST:
        raise RobotError(f"{where}: {digits[:60]!r} is not a number of a calibration.")
    return float(digits)


def _on_axis(old: Array, new: Array) -> Array:
    """Return the frame nearest to ``old`` whose z is the axis of ``new``: the turn about it and along is free."""
    z, p = new[:3, 2], new[:3, 3]
    axis = np.cross(old[:3, 2], z)
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, float(old[:3, 2] @ z))
    turn = rigid.exp3(axis / sine * angle) if sine > 0.0 else np.eye(3)
    return rigid.placement(turn @ old[:3, :3], p + z * float((old[:3, 3] - p) @ z))


def _origins(nominal: Urdf, prefix: str, own: Array, tool: Array) -> dict[str, Array]:
    """Return the origins of the six joints, and of the one behind them on the way to tool0, by name."""
    arm = load_robot(nominal, f"{prefix}tool0", f"{prefix}base_link")
    chain = {joint.name: joint for joint in arm.chain}
    at: dict[str, Array] = {f"{prefix}base_link": np.eye(4)}
    origins: dict[str, Array] = {}
    for joint, frame in zip(ur.JOINTS, own, strict=True):
        urdf = nominal.joint(f"{prefix}{joint}")
        carrier, before = ur.carried(nominal, urdf.parent)
        if carrier not in at:
            # Links before base_link: the way from there is fixed.
            carrier, before = f"{prefix}base_link", rigid.inverse(ur.carried(nominal, f"{prefix}base_link")[1]) @ before
        at[urdf.child] = frame @ rigid.inverse(chain[urdf.name].frame)
        origins[urdf.name] = rigid.inverse(at[carrier] @ before) @ at[urdf.child]
    wrist = nominal.joint(f"{prefix}{ur.JOINTS[-1]}").child
    rest, link = np.eye(4), f"{prefix}tool0"
    while (joint_before := nominal.parent_joint(link)) is not None and joint_before.parent != wrist:
        rest, link = joint_before.origin @ rest, joint_before.parent
    if joint_before is not None:
        origins[joint_before.name] = rigid.inverse(at[wrist]) @ tool @ rigid.inverse(rest)
    return origins
