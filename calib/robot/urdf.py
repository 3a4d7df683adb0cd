"""URDF in: a strict reader that refuses what it cannot read with certainty.

Only direct children of ``<robot>``, and direct children of its joints, count: ``<transmission>``, ``<gazebo>`` and
``<ros2_control>`` have joints and links of their own that mean something else. What does not bear on kinematics
(meshes, unknown elements, and inertia until it is asked for) is passed over; what does is read exactly or refused in
one sentence.
"""

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple, cast, get_args

import numpy as np

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.errors import RobotError
from calib.foundations.files import read_bytes
from calib.foundations.rigid import placement, rotation_of_rpy
from calib.foundations.sealing import sealed
from calib.foundations.units import NUMBER
from calib.foundations.words import listed, near, shortened, shown
from calib.foundations.xml_text import NOT_EXPANDED, Element, NotXmlError, read_xml
from calib.robot.sources import resolve

JointType = Literal["revolute", "continuous", "prismatic", "fixed", "floating", "planar"]

# Joints with one position, a number, which a reading tells: they have an axis, may mimic and may be mimicked.
MOVING = ("revolute", "continuous", "prismatic")

# Fifty times the largest URDF we know; bounds time and memory on any input.
LARGEST_URDF = 10_000_000
# Of an arm with its loops: ten times those of the longest; time and memory grow with the square.
MOST_JOINTS = 200
# Of the whole document, and as many joints: a cell with all its fixed frames has some hundreds.
MOST_LINKS = 2000
_LONGEST_NAME = 200
# What makes the kinematics of a joint, and with which attributes.
_OF_JOINT = ("parent", "child", "origin", "axis", "limit", "mimic")
_ATTRIBUTES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"origin": ("xyz", "rpy"), "axis": ("xyz",), "mimic": ("joint", "multiplier", "offset")}
)
# So alike is a name that was meant to be another.
_MISSPELT = 0.8
# Of xacro before it had a prefix: links and joints that are elsewhere, or there under a condition.
_BARE_XACRO = ("include", "macro", "if", "unless")
# Beyond any robot in metres or radians: a wrong unit or a slipped exponent.
LARGEST_NUMBER = 1e6
# A shorter axis is a zero with rounding noise and has no direction.
_SHORTEST_AXIS = 1e-6


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint that follows another: position = multiplier * position of ``joint`` + offset (SI)."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class UrdfJoint:
    """A joint as the file states it.

    ``origin`` (4, 4) is the frame of the joint in its parent link, ``axis`` (3,) a unit vector in that frame; both
    read-only. ``lower`` and ``upper`` are in rad or m, None where unlimited. ``line`` is where the joint starts.
    """

    name: str
    type: JointType
    parent: str
    child: str
    origin: Array
    axis: Array
    lower: float | None
    upper: float | None
    mimic: Mimic | None
    line: int


@dataclass(frozen=True, slots=True, eq=False)
class Urdf:
    """A robot description that holds together: one tree of links, unique names, mimics that end at a driver.

    Links and joints are in document order; ``where`` is the name of the file in messages.
    """

    __repr__ = brief

    name: str
    root: str
    links: tuple[str, ...]
    joints: tuple[UrdfJoint, ...]
    source: bytes
    where: str
    _by_name: Mapping[str, UrdfJoint] = field(init=False, repr=False)
    _by_child: Mapping[str, UrdfJoint] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_by_name", {joint.name: joint for joint in self.joints})
        object.__setattr__(self, "_by_child", {joint.child: joint for joint in self.joints})

    @checked
    def joint(self, name: str) -> UrdfJoint:
        """Return the joint called ``name``, or raise RobotError with the names that are near."""
        if name in self._by_name:
            return self._by_name[name]
        raise RobotError(f"{self.where}: there is no joint {shown(name)}{_hint(name, [j.name for j in self.joints])}")

    @checked
    def parent_joint(self, link: str) -> UrdfJoint | None:
        """Return the joint that carries ``link``, None for the root; raise RobotError when there is no such link."""
        if link != self.root and link not in self._by_child:
            raise RobotError(f"{self.where}: there is no link {shown(link)}{_hint(link, self.links)}")
        return self._by_child.get(link)


class Inertial(NamedTuple):
    """Mass in kg of a link, its centre (3,) in m in the link's frame, and its inertia (3, 3) in kg m^2.

    The inertia is about the centre, along the link's axes; zero where none is stated.
    """

    mass: float
    centre: Array
    inertia: Array


def inertials(urdf: Urdf) -> Mapping[str, Inertial]:
    """Return mass, centre of mass and inertia of every link that states them, by its name.

    They bear on no placement, so that only who needs them is refused what is wrong with them: raises RobotError.
    """
    found: dict[str, Inertial] = {}
    for name, link in _unique("link", read_document(urdf.source, urdf.where, generations=3), urdf.where).items():
        at = f"{urdf.where}:{link.line}: link {shown(name)}"
        stated = link.all("inertial")
        if not stated:
            continue
        if len(stated) > 1:
            raise RobotError(f"{at} has a second <inertial>; the first is in line {stated[0].line}.")
        parts = {child.tag: child for child in stated[0].children}
        if "mass" not in parts:
            raise RobotError(f"{at}: <inertial> has no <mass>.")
        mass = numbers_of(parts["mass"], "value", at, count=1)[0]
        if mass < 0.0:
            raise RobotError(f"{at}: the mass {mass:g} kg is negative.")
        T = origin_of(parts["origin"], at) if "origin" in parts else np.eye(4)
        inertia = _inertia(parts["inertia"], at) if "inertia" in parts else np.zeros((3, 3))
        found[name] = Inertial(mass, read_only(T[:3, 3]), read_only(T[:3, :3] @ inertia @ T[:3, :3].T))
    return found


def _inertia(element: Element, at: str) -> Array:
    xx, xy, xz, yy, yz, zz = (
        numbers_of(element, name, at, count=1)[0] if name in element.attributes else 0.0
        for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def read_urdf(path: str | Path) -> Urdf:
    """Read a URDF file, or an ``example:...`` of example-robot-data.

    Raises RobotError when it cannot be read or is not one robot whose kinematics is certain.
    """
    return parse_urdf(read_bytes(resolve(path), RobotError, LARGEST_URDF), str(path))


def parse_urdf(source: bytes, where: str) -> Urdf:
    """Read a URDF from its bytes; ``where`` names it in messages. Raises RobotError."""
    robot = read_document(source, where)
    if robot.tag != "robot":
        raise RobotError(
            f"{where}:{robot.line}: the outermost element is <{shortened(robot.tag)}>; a URDF has <robot>."
        )
    if bare := next((child for child in robot.children if child.tag in _BARE_XACRO), None):
        raise RobotError(f"{where}:{bare.line}: <{bare.tag}> {NOT_EXPANDED}")
    for child in robot.children:
        _refuse_capitals(child, ("link", "joint"), where)
    for tag in ("link", "joint"):
        if (many := len(robot.all(tag))) > MOST_LINKS:
            raise RobotError(f"{where}: has {many} {tag}s; allowed are {MOST_LINKS}.")
    links = tuple(_unique("link", robot, where))
    if not links:
        raise RobotError(f"{where}:{robot.line}: the robot has no link.")
    joints = tuple(_joint(name, element, where) for name, element in _unique("joint", robot, where).items())
    root = _root(links, joints, where)
    _check_mimics(joints, where)
    return Urdf(_text(robot, "name", f"{where}:{robot.line}: the robot") or "", root, links, joints, source, where)


# The document. ---------------------------------------------------------------------------------------------------


def read_document(source: bytes, where: str, generations: int = 2) -> Element:
    """Return the outermost element of a URDF with so many ``generations`` below it; ``where`` names it in messages.

    Raises RobotError for what is too large, and for what :func:`calib.foundations.xml_text.read_xml` refuses.
    """
    if len(source) > LARGEST_URDF:
        raise RobotError(f"{where}: is larger than {LARGEST_URDF} bytes.")
    try:
        return read_xml(source, generations)
    except NotXmlError as e:
        raise RobotError(f"{where}:{e.line}: {e}") from e


# Elements to joints. ---------------------------------------------------------------------------------------------


def _unique(tag: str, robot: Element, where: str) -> dict[str, Element]:
    """Return the children ``tag`` of the robot by name, in document order; two of one name are refused."""
    found: dict[str, Element] = {}
    for element in robot.all(tag):
        name = _required(element, "name", f"{where}:{element.line}: <{tag}>")
        if name in found:
            first = found[name].line
            raise RobotError(f"{where}:{element.line}: {tag} {shown(name)} is declared already in line {first}.")
        found[name] = element
    return found


def _joint(name: str, element: Element, where: str) -> UrdfJoint:
    at = f"{where}:{element.line}: joint {shown(name)}"
    type_ = _required(element, "type", at)
    if type_ not in get_args(JointType):
        raise RobotError(f"{at} has type {shown(type_)}; allowed are {', '.join(get_args(JointType))}.")
    parts = _parts(name, element, where)
    ends = {}
    for tag in ("parent", "child"):
        if tag not in parts:
            raise RobotError(f"{at} has no <{tag}>.")
        ends[tag] = _required(parts[tag][0], "link", f"{parts[tag][1]}: <{tag}>")
    one_position = type_ in MOVING
    lower, upper = _limits(*parts["limit"]) if type_ in ("revolute", "prismatic") and "limit" in parts else (None, None)
    return UrdfJoint(
        name=name,
        type=cast(JointType, type_),
        parent=ends["parent"],
        child=ends["child"],
        origin=origin_of(*parts["origin"]) if "origin" in parts else read_only(np.eye(4)),
        # Exporters write axis 0 0 0 and limits on fixed joints, where neither means anything.
        axis=_axis(*parts["axis"]) if "axis" in parts and (one_position or type_ == "planar") else read_only([1, 0, 0]),
        lower=lower,
        upper=upper,
        mimic=_mimic(*parts["mimic"]) if "mimic" in parts and one_position else None,
        line=element.line,
    )


def _parts(name: str, joint: Element, where: str) -> dict[str, tuple[Element, str]]:
    """Return the children of a joint that make its kinematics by tag, each with its place for messages."""
    parts: dict[str, tuple[Element, str]] = {}
    for child in joint.children:
        _refuse_capitals(child, _OF_JOINT, where)
        if child.tag in _OF_JOINT:
            at = f"{where}:{child.line}: joint {shown(name)}"
            if child.tag in parts:
                raise RobotError(f"{at} has a second <{child.tag}>; the first is in line {parts[child.tag][0].line}.")
            parts[child.tag] = child, at
    return parts


def _refuse_capitals(element: Element, known: Collection[str], where: str) -> None:
    """Raise RobotError for a tag in other letters than URDF has it: it would be passed over as an unknown one."""
    if element.tag not in known and element.tag.lower() in known:
        raise RobotError(
            f"{where}:{element.line}: <{element.tag}> is written <{element.tag.lower()}>; else it is not read."
        )


def _refuse_unread(element: Element, at: str) -> None:
    """Raise RobotError for attributes that would make another arm: misspelt ones, and ``quat_xyzw`` of a newer URDF."""
    known = _ATTRIBUTES[element.tag]
    for name in element.attributes:
        if name not in known and (name.startswith("quat") or near(name.lower(), known, 1, _MISSPELT)):
            raise RobotError(
                f"{at}: <{element.tag}> has {shown(name)}, which is not read; read are {', '.join(known)}."
            )


def origin_of(element: Element, at: str) -> Array:
    """Return the placement (4, 4) that an ``<origin>`` states; ``at`` begins a message. Raises RobotError."""
    _refuse_unread(element, at)
    xyz, rpy = (
        np.array(numbers_of(element, name, at, count=3)) if name in element.attributes else np.zeros(3)
        for name in ("xyz", "rpy")
    )
    return read_only(placement(rotation_of_rpy(rpy), xyz))


def _axis(element: Element, at: str) -> Array:
    _refuse_unread(element, at)
    axis = numbers_of(element, "xyz", at, count=3)
    length = math.hypot(*axis)
    if length < _SHORTEST_AXIS:
        raise RobotError(f"{at}: <axis> xyz={shown(element.attributes['xyz'])} has no direction.")
    return read_only(np.array(axis) / length)


def _limits(element: Element, at: str) -> tuple[float | None, float | None]:
    """Return lower and upper, 0 where omitted as URDF has it, None where a file says unlimited by a huge number."""
    lower, upper = (_number(element, name, at, 0.0, largest=math.inf) for name in ("lower", "upper"))
    if lower > upper:
        raise RobotError(f"{at}: <limit> lower={lower:g} is above upper={upper:g}.")
    return None if lower < -LARGEST_NUMBER else lower, None if upper > LARGEST_NUMBER else upper


def _mimic(element: Element, at: str) -> Mimic:
    _refuse_unread(element, at)
    driver = _required(element, "joint", f"{at}: <mimic>")
    multiplier = _number(element, "multiplier", at, 1.0)
    if multiplier == 0.0:
        raise RobotError(f"{at}: <mimic> multiplier is zero, so the joint does not follow {shown(driver)}.")
    return Mimic(driver, multiplier, _number(element, "offset", at, 0.0))


# Attributes. -----------------------------------------------------------------------------------------------------


def _text(element: Element, attribute: str, at: str) -> str | None:
    text = element.attributes.get(attribute)
    if text is not None and ("${" in text or "$(" in text):
        raise RobotError(f"{at}: {attribute}={shown(text)} {NOT_EXPANDED}")
    return text


def _required(element: Element, attribute: str, at: str) -> str:
    text = _text(element, attribute, at)
    if not text:
        raise RobotError(f"{at} has no {attribute}.")
    if len(text) > _LONGEST_NAME:
        raise RobotError(f"{at}: {attribute}={shown(text)} is longer than {_LONGEST_NAME} characters.")
    return text


def _number(element: Element, attribute: str, at: str, default: float, largest: float = LARGEST_NUMBER) -> float:
    """Return the plain decimal number of an attribute, or ``default`` where it is omitted."""
    if attribute not in element.attributes:
        return default
    return numbers_of(element, attribute, at, count=1, largest=largest)[0]


def numbers_of(
    element: Element, attribute: str, at: str, *, count: int, largest: float = LARGEST_NUMBER
) -> tuple[float, ...]:
    """Return the ``count`` plain decimal numbers of an attribute that must be there. Raises RobotError."""
    at = f"{at}: <{element.tag}>"
    text = _text(element, attribute, at)
    if text is None:
        raise RobotError(f"{at} has no {attribute}.")
    # XML's white space only: str.split() would also take the no-break space, which other readers choke on.
    words = [word for word in re.split(r"[ \t\r\n]+", text) if word]
    if len(words) != count or not all(map(NUMBER.fullmatch, words)):
        allowed = "a plain decimal number" if count == 1 else f"{count} plain decimal numbers"
        raise RobotError(f"{at} {attribute}={shown(text)} is not {allowed}.")
    values = tuple(map(float, words))
    if max(map(abs, values)) > largest:
        raise RobotError(f"{at} {attribute}={shown(text)} is beyond {largest:g}, in SI units.")
    return values


# The robot as a whole. -------------------------------------------------------------------------------------------


def _root(links: tuple[str, ...], joints: tuple[UrdfJoint, ...], where: str) -> str:
    """Return the root link of the tree that the joints make of the links, or raise RobotError where they make none."""
    known = frozenset(links)
    carrier: dict[str, UrdfJoint] = {}
    for joint in joints:
        at = f"{where}:{joint.line}: joint {shown(joint.name)}"
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in known:
                raise RobotError(f"{at} has the {role} link {shown(link)}, which does not exist{_hint(link, links)}")
        if joint.child == joint.parent:
            raise RobotError(f"{at} carries link {shown(joint.child)} on itself.")
        if joint.child in carrier:
            first = carrier[joint.child]
            raise RobotError(
                f"{at} carries link {shown(joint.child)}, which joint {shown(first.name)} in line {first.line} "
                "carries already; a link has one parent."
            )
        carrier[joint.child] = joint
    if loop := _cycle({joint.child: joint.parent for joint in joints}):
        at = f"{where}:{carrier[loop[0]].line}"
        raise RobotError(f"{at}: the links {listed(loop, 8)} carry each other in a circle; a URDF is a tree.")
    roots = [link for link in links if link not in carrier]
    if len(roots) > 1:
        raise RobotError(f"{where}: the links {listed(roots, 8)} have no parent joint; a robot has one root.")
    return roots[0]


def _check_mimics(joints: tuple[UrdfJoint, ...], where: str) -> None:
    """Raise RobotError unless every mimic leads to a joint that has a position of its own."""
    by_name = {joint.name: joint for joint in joints}
    followed: dict[str, str] = {}
    for joint in joints:
        if joint.mimic is None:
            continue
        at = f"{where}:{joint.line}: joint {shown(joint.name)} mimics"
        wanted = joint.mimic.joint
        driver = by_name.get(wanted)
        if driver is None:
            raise RobotError(f"{at} {shown(wanted)}, which does not exist{_hint(wanted, by_name)}")
        if driver is joint:
            raise RobotError(f"{at} itself.")
        if driver.type not in MOVING:
            raise RobotError(f"{at} {shown(driver.name)}, which is {driver.type} and has no position to follow.")
        followed[joint.name] = driver.name
    if loop := _cycle(followed):
        raise RobotError(f"{where}:{by_name[loop[0]].line}: the joints {listed(loop, 8)} mimic each other in a circle.")
    known: dict[str, tuple[float, float]] = {}
    for name in followed:
        way = [name]
        while (last := followed.get(way[-1])) is not None and way[-1] not in known:
            way.append(last)
        multiple, offset = known.get(way[-1], (1.0, 0.0))
        for joint in (by_name[step] for step in reversed(way) if step in followed and step not in known):
            mimic = cast(Mimic, joint.mimic)
            multiple, offset = mimic.multiplier * multiple, mimic.multiplier * offset + mimic.offset
            if not max(abs(multiple), abs(offset)) <= LARGEST_NUMBER:
                raise RobotError(
                    f"{where}:{joint.line}: joint {shown(joint.name)} mimics through other joints, and the multiplier "
                    f"or the offset of them all is above {LARGEST_NUMBER:g}."
                )
            known[joint.name] = multiple, offset


def _cycle(successor: Mapping[str, str]) -> list[str] | None:
    """Return the nodes of one cycle of a graph where each node has at most one successor, None without a cycle."""
    done: set[str] = set()
    for start in successor:
        path: dict[str, None] = {}
        node = start
        while node in successor and node not in done:
            if node in path:
                walked = list(path)
                return walked[walked.index(node) :]
            path[node] = None
            node = successor[node]
        done.update(path)
    return None


# Words in messages. ----------------------------------------------------------------------------------------------


def _hint(name: str, known: Collection[str]) -> str:
    """Return the end of the sentence: the names near ``name``, or else all of them."""
    if likest := near(name, known):
        return f"; did you mean {' or '.join(map(shown, likest))}?"
    return f"; there are {listed(known, 8)}." if known else "; there are none."
