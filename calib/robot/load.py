"""Loading an arm: which joints lie between base and tip, what they read, how they are coupled and closed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal, cast

import numpy as np

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.csv_text import refuse_formula
from calib.foundations.errors import RobotError
from calib.foundations.ranges import MOST_LOOPS
from calib.foundations.words import harmless, shown
from calib.robot import deviation
from calib.robot.gravity import STANDARD_GRAVITY, Load, Payload, checked_gravity, checked_payload
from calib.robot.loops import Loop
from calib.robot.robot import ChainJoint, ClosedLoop, Coupling, Reading, Robot
from calib.robot.urdf import MOST_JOINTS, MOVING, Urdf, UrdfJoint, read_urdf

# As of all numbers in a URDF.
_LARGEST_MULTIPLE = 1e6


@checked
def load_robot(
    urdf: str | Path | Urdf,
    tip: str | None = None,
    base: str | None = None,
    *,
    links: Sequence[str] = (),
    couplings: Sequence[Coupling] = (),
    loops: Sequence[ClosedLoop] = (),
    gravity: Sequence[float] = STANDARD_GRAVITY,
    payload: Payload | None = None,
) -> Robot:
    """Load the arm from link ``base`` to link ``tip``; by default from the root to the only leaf that a joint moves.

        robot = calib.load_robot("humanoid.urdf", "right_hand", links=["left_hand", "head"])

    ``links``: other links whose poses are needed, such as the tips of other arms on the same base. The robot is then
    all that is between the base and any of them, and :meth:`calib.Robot.with_tip` makes one of them the tip. ``urdf``
    is a path, or ``"example:panda_description/urdf/panda.urdf"`` for a file of example-robot-data. ``couplings``
    replace what the URDF says of how a joint mimics others. ``loops`` close chains that a URDF, which is a tree, leaves
    open; the search for the passive joints starts where their ``<mimic>`` puts them. ``gravity`` (3,), in m/s^2 in the
    base link, and ``payload`` are used by terms of wind-up and bending; :meth:`calib.Robot.with_loads` says what they
    are in single set-ups. Raises RobotError with one sentence when the file or the arm cannot be used.
    """
    document = urdf if isinstance(urdf, Urdf) else read_urdf(urdf)
    tip = _only_leaf(document) if tip is None else _known_link(document, tip, "tip")
    base = document.root if base is None else _known_link(document, base, "base")
    path = list(_path(document, base, tip, "tip"))
    if all(joint.type == "fixed" for joint in path):
        raise RobotError(f"{document.where}: no joint moves between {base!r} and {tip!r}; choose another tip.")
    others = [_known_link(document, link, "link") for link in dict.fromkeys(links) if link not in (tip, base)]
    joints = path + [joint for link in others for joint in _path(document, base, link, "link")]
    joints += [
        joint
        for loop in loops
        for link in loop.frames
        for joint in _path(document, base, _known_link(document, link, f"loop {loop.name!r}:"), f"loop {loop.name!r}")
    ]
    joints = list(dict.fromkeys(joints))
    if len(loops) > MOST_LOOPS:
        raise RobotError(f"{document.where}: the arm has {len(loops)} closed loops; allowed are {MOST_LOOPS}.")
    if len(joints) > MOST_JOINTS:
        raise RobotError(
            f"{document.where}: the arm and its loops have {len(joints)} joints; allowed are {MOST_JOINTS}."
        )
    _refuse_names(document, joints)
    chain = _chain(joints)
    moving = [joint for joint in joints if joint.type != "fixed"]
    closed = tuple(_loop(document, loop, joints, moving) for loop in loops)
    _refuse_twice(document, couplings, loops)
    passive = [moving[j].name for loop in closed for j in loop.passive]
    readings, coupling, coupling_offset = _couple(document, moving, passive, {c.joint: c for c in couplings})
    # A joint that is read itself moves, by its offset, all that are coupled to it; a coupled one moves itself.
    names = [reading.name for reading in readings]
    offset_coupling = np.eye(len(moving))
    for i, joint in enumerate(moving):
        if joint.name in names:
            offset_coupling[:, i] = coupling[:, names.index(joint.name)]
    every = tuple(dict.fromkeys((tip, *others, *(link for link in links if link == base))))
    return Robot(
        document,
        base,
        tip,
        chain,
        len(path) - 1,
        readings,
        read_only(coupling),
        read_only(coupling_offset),
        read_only(offset_coupling),
        every,
        closed,
        tuple(couplings),
        tuple(loops),
        gravity=checked_gravity(gravity, document.where),
        payload=checked_payload(payload, every, document.where),
    )


_OWN: Mapping[str, str] = MappingProxyType({})


def with_document(
    robot: Robot, document: Urdf, links: Mapping[str, str] = _OWN, joints: Mapping[str, str] = _OWN
) -> Robot:
    """Return the same arm of another document: same base and tip, couplings and loops. Raises RobotError.

    ``links`` and ``joints``: what they are called there, those that have another name.
    """

    def link(name: str) -> str:
        return links.get(name, name)

    def joint(name: str) -> str:
        return joints.get(name, name)

    # As it was loaded: the first link comes first in the order of readings, whichever is the tip now.
    first = robot.links[0]
    found = load_robot(
        document,
        link(first),
        link(robot.base),
        links=[link(name) for name in robot.links],
        couplings=[
            Coupling(joint(c.joint), {joint(driver): multiple for driver, multiple in c.drivers.items()}, c.offset)
            for c in robot.couplings
        ],
        loops=[
            ClosedLoop(
                loop.name, (link(loop.frames[0]), link(loop.frames[1])), loop.closes, tuple(map(joint, loop.passive))
            )
            for loop in robot.closed_loops
        ],
        gravity=robot.gravity,
        payload=_on(link, robot.payload),
    )
    loads = {name: Load(load.gravity, _on(link, load.payload)) for name, load in robot.loads.items()}
    return replace(found.with_loads(loads).with_tip(link(robot.tip)), setup=robot.setup)


def _refuse_names(document: Urdf, joints: Sequence[UrdfJoint]) -> None:
    """Refuse names that cannot head the columns of tables that are written, and be found there in others."""
    for name in (joint.name for joint in joints):
        refuse_formula(name, document.where)
        if harmless(name) != name:
            raise RobotError(
                f"{document.where}: joint {shown(name)} has a character that commands a terminal or turns text round "
                "in its name; rename it."
            )


def _on(link: Callable[[str], str], payload: Payload | None) -> Payload | None:
    """Return a payload on the link that is called otherwise."""
    return payload if payload is None or not payload.link else replace(payload, link=link(payload.link))


def _known_link(document: Urdf, name: str, role: str) -> str:
    if name not in document.links:
        raise RobotError(
            f"{document.where}: {role} {name!r} is not a link of the URDF; its links are {_list(document.links)}."
        )
    return name


def _only_leaf(document: Urdf) -> str:
    parents = {joint.parent for joint in document.joints}
    leaves = [link for link in document.links if link not in parents]
    # A frame on the base, as ROS-Industrial's `base` or a camera's, is moved by no joint.
    leaves = [link for link in leaves if _is_moved(document, link)] or leaves
    if len(leaves) != 1:
        raise RobotError(f"{document.where}: which link is the tip? Choose one of {_list(leaves)}.")
    return leaves[0]


def _is_moved(document: Urdf, link: str) -> bool:
    """Return whether a joint that is not fixed leads to a link."""
    joint = document.parent_joint(link)
    while joint is not None and joint.type == "fixed":
        joint = document.parent_joint(joint.parent)
    return joint is not None


def _list(names: Sequence[str], most: int = 12) -> str:
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def _path(document: Urdf, base: str, tip: str, role: str) -> tuple[UrdfJoint, ...]:
    path: list[UrdfJoint] = []
    link = tip
    while link != base:
        joint = document.parent_joint(link)
        if joint is None:
            raise RobotError(
                f"{document.where}: base {base!r} does not carry {role} {tip!r}: the links are on other branches."
            )
        if joint.type in ("floating", "planar"):
            raise RobotError(
                f"{document.where}:{joint.line}: joint {joint.name!r} between {base!r} and {tip!r} is {joint.type}; "
                "an arm needs revolute, continuous, prismatic or fixed joints, so choose a base behind it."
            )
        path.append(joint)
        if len(path) > MOST_JOINTS:
            raise RobotError(
                f"{document.where}: between {base!r} and {tip!r} are more than the {MOST_JOINTS} joints that are "
                "allowed."
            )
        link = joint.parent
    return tuple(reversed(path))


def _chain(joints: Sequence[UrdfJoint]) -> tuple[ChainJoint, ...]:
    index = {joint.child: i for i, joint in enumerate(joints)}
    frames = [np.eye(4) if joint.type == "fixed" else deviation.axis_frame(joint.axis) for joint in joints]
    chain: list[ChainJoint] = []
    for joint, frame in zip(joints, frames, strict=True):
        parent = index.get(joint.parent, -1)
        before = np.eye(4) if parent < 0 else frames[parent]
        # A continuous joint is a revolute one without limits; Pinocchio would give it two coordinates.
        kind = cast(Literal["revolute", "prismatic", "fixed"], "revolute" if joint.type == "continuous" else joint.type)
        placement = read_only(rigid.inverse(before) @ joint.origin @ frame)
        chain.append(ChainJoint(joint.name, kind, parent, placement, read_only(frame)))
    return tuple(chain)


def _loop(document: Urdf, loop: ClosedLoop, joints: Sequence[UrdfJoint], moving: Sequence[UrdfJoint]) -> Loop:
    where = f"{document.where}: loop {loop.name!r}"
    index = {joint.child: i for i, joint in enumerate(joints)}
    for axis in loop.closes:
        if axis not in ("x", "y", "z"):
            raise RobotError(f"{where}: closes {axis!r}, which is not one of x, y, z.")
    for what, given in (("closes", loop.closes), ("passive", loop.passive)):
        if len(given) == 0 or len(set(given)) < len(given):
            raise RobotError(f"{where}: {what} {list(given)} must name at least one, and each once.")
    if len(loop.closes) != len(loop.passive):
        raise RobotError(
            f"{where}: closes has {len(loop.closes)} directions and passive has {len(loop.passive)} joints; both need "
            "the same number."
        )
    numbers = {joint.name: j for j, joint in enumerate(moving)}
    for name in loop.passive:
        if name not in numbers:
            raise RobotError(f"{where}: passive joint {name!r} is not one of the moving joints {_list(list(numbers))}.")
    a, b = (index.get(link, -1) for link in loop.frames)
    passive = tuple(numbers[name] for name in loop.passive)
    return Loop(loop.name, (a, b), tuple("xyz".index(axis) for axis in loop.closes), passive)


def _refuse_twice(document: Urdf, couplings: Sequence[Coupling], loops: Sequence[ClosedLoop]) -> None:
    """Raise RobotError where a joint is coupled twice, or is passive in two loops: only one could determine it."""
    coupled: set[str] = set()
    for coupling in couplings:
        if coupling.joint in coupled:
            raise RobotError(
                f"{document.where}: joint {coupling.joint!r} has two couplings; write one with the drivers of both, or "
                "leave one out."
            )
        coupled.add(coupling.joint)
    loop_of: dict[str, str] = {}
    for loop in loops:
        for name in loop.passive:
            if name in loop_of:
                raise RobotError(
                    f"{document.where}: loops {loop_of[name]!r} and {loop.name!r} have one passive joint, {name!r}, "
                    "which only one of them can determine."
                )
            loop_of[name] = loop.name


def _couple(
    document: Urdf, moving: Sequence[UrdfJoint], passive: Sequence[str], couplings: Mapping[str, Coupling]
) -> tuple[tuple[Reading, ...], Array, Array]:
    """Return the readings in the order of the joints, and joint positions = coupling @ readings + offset."""
    for name in couplings:
        if name not in (joint.name for joint in moving):
            raise RobotError(f"{document.where}: coupling of {name!r}, which is not a moving joint of the arm.")
    known: dict[str, tuple[dict[str, float], float]] = {}
    rows = [_drivers(document, joint, couplings, passive, known) for joint in moving]
    readings: list[Reading] = []
    for joint, (multiples, _) in zip(moving, rows, strict=True):
        if joint.name in passive and set(multiples) == {joint.name}:
            # Nobody reads it, and nothing says where it would be: the search for it starts at zero.
            multiples.clear()
        for name in multiples:
            driver = document.joint(name)
            if driver.type not in MOVING:
                raise RobotError(
                    f"{document.where}:{joint.line}: joint {joint.name!r} follows {name!r}, which is {driver.type} "
                    "and has no reading."
                )
            if name not in (reading.name for reading in readings):
                dimension: Literal["angle", "length"] = "length" if driver.type == "prismatic" else "angle"
                readings.append(Reading(name, dimension, driver.lower, driver.upper))
    names = [reading.name for reading in readings]
    coupling = np.zeros((len(moving), len(names)))
    for i, (multiples, _) in enumerate(rows):
        for name, multiple in multiples.items():
            coupling[i, names.index(name)] = multiple
    read = tuple(replace(r, turns=_turns(r, coupling[:, k], moving, passive)) for k, r in enumerate(readings))
    return read, coupling, np.array([offset for _, offset in rows])


def _turns(reading: Reading, multiples: Array, moving: Sequence[UrdfJoint], passive: Sequence[str]) -> bool:
    """Return whether a whole turn of a reading brings back all joints, which follow it by ``multiples`` (nj)."""
    # Passive joints go where their loops close.
    return reading.dimension == "angle" and all(
        joint.name in passive or (multiple == 0.0 if joint.type == "prismatic" else multiple == np.rint(multiple))
        for joint, multiple in zip(moving, multiples, strict=True)
    )


def _drivers(
    document: Urdf,
    joint: UrdfJoint,
    couplings: Mapping[str, Coupling],
    passive: Sequence[str],
    known: dict[str, tuple[dict[str, float], float]],
    depth: int = 0,
) -> tuple[dict[str, float], float]:
    """Return the multiples of readings, and the constant, that a joint's position is; ``known``: those found before."""
    if joint.name in known:
        multiples, constant = known[joint.name]
        return dict(multiples), constant
    if joint.name in couplings:
        coupling = couplings[joint.name]
        if joint.name in coupling.drivers:
            raise RobotError(
                f"{document.where}:{joint.line}: the coupling of joint {joint.name!r} has {joint.name!r} itself among "
                "its drivers; put one more joint where it is into the URDF, which follows the others, and leave it its "
                "own reading."
            )
        drivers, offset = dict(coupling.drivers), coupling.offset
    elif joint.mimic is not None:
        drivers, offset = {joint.mimic.joint: joint.mimic.multiplier}, joint.mimic.offset
    else:
        return {joint.name: 1.0}, 0.0
    if depth > len(document.joints):
        raise RobotError(f"{document.where}: the couplings of joint {joint.name!r} run in a circle.")
    if depth > MOST_JOINTS:
        raise RobotError(
            f"{document.where}:{joint.line}: joint {joint.name!r} follows a joint that follows another one, and so on, "
            f"through more than the {MOST_JOINTS} joints that are allowed."
        )
    found: dict[str, float] = {}
    for name, multiple in drivers.items():
        if name in passive:
            raise RobotError(
                f"{document.where}:{joint.line}: joint {joint.name!r} follows {name!r}, which is passive: a loop "
                "determines it, and it has no reading."
            )
        multiples, constant = _drivers(document, document.joint(name), couplings, passive, known, depth + 1)
        offset += multiple * constant
        for reading, share in multiples.items():
            found[reading] = found.get(reading, 0.0) + multiple * share
    if not max([abs(offset), *map(abs, found.values())]) <= _LARGEST_MULTIPLE:
        raise RobotError(
            f"{document.where}:{joint.line}: joint {joint.name!r} follows its readings with a multiplier or an offset "
            f"above {_LARGEST_MULTIPLE:g}."
        )
    known[joint.name] = dict(found), offset
    return found, offset


def robot_in_urdf(robot: Robot) -> Robot | None:
    """Return the robot that whoever reads the URDF alone has: mimic joints, neither loops nor couplings nor terms.

    None where its joints do not take the same readings.
    """
    plain = load_robot(robot.urdf, robot.tip, robot.base, links=robot.links)
    same = [reading.name for reading in plain.readings] == [reading.name for reading in robot.readings]
    return plain if same else None
