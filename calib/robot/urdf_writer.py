"""URDF out: the placements of some joints changed, or how they count; every other byte kept.

A user's URDF is a text with a history: comments, gazebo and control blocks, numbers as somebody typed them. Writers
that rebuild the document lose some of it, so this one cuts the new numbers into the old bytes and reads the result
back before anybody else does.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import OutputError, RobotError
from calib.foundations.rigid import placement, rotation_about, rpy_of
from calib.foundations.units import NUMBER
from calib.foundations.words import shown
from calib.foundations.xml_text import Element
from calib.robot.urdf import LARGEST_NUMBER, Mimic, Urdf, UrdfJoint, parse_urdf, read_document

# Largest difference of a placement read back, in metres and in entries of the rotation: rounding of rpy, no more.
ORIGIN_ROUNDING = 1e-12

# These read tags that expat has accepted, so they have to find things, not to judge them.
START_TAG = re.compile(r"""<[^\s/>]+(?P<attributes>(?:\s+[^\s=/>]+\s*=\s*(?:"[^"]*"|'[^']*'))*)""", re.ASCII)
ATTRIBUTE = re.compile(r"""(?P<name>[^\s=]+)\s*=\s*(?P<quote>["'])(?P<value>.*?)(?P=quote)""", re.ASCII | re.DOTALL)


# By joint, a sign, 1 or -1, and an offset in rad or m: the joint of the URDF stands at sign * reading + offset.
CountedZeros = Mapping[str, tuple[float, float]]
# What else of a joint is said in its positions: the ends of ranges.
_IN_POSITIONS = {"limit": ("lower", "upper"), "safety_controller": ("soft_lower_limit", "soft_upper_limit")}


class _Edit(NamedTuple):
    """``text`` in the place of the bytes from ``start`` to ``end``."""

    start: int
    end: int
    text: str


def splice_origins(source: bytes, origins: Mapping[str, Array], where: str = "URDF") -> bytes:
    """Return the URDF with the origins of the named joints replaced and every other byte as it was.

    ``origins`` gives placements (4, 4), frame of the joint in its parent link, by joint name. Numbers are written so
    that they read back exactly; an ``xyz`` or ``rpy`` whose value stays keeps its text, and an ``<origin>`` that is
    missing is inserted. ``where`` names the document in messages.

    Raises RobotError when the document is no URDF or has no such joint, and OutputError when the result does not
    read back as asked, which takes a bug or a placement that is no rigid motion.
    """
    urdf = parse_urdf(source, where)
    edits: list[_Edit] = []
    joints = {e.attributes["name"]: e for e in read_document(source, where).children if e.tag == "joint"}
    for name, origin in origins.items():
        if np.any(np.abs(origin[:3, 3]) > LARGEST_NUMBER):
            raise OutputError(
                f"{where}: joint {shown(name)} would have an <origin> with xyz='{shortest_decimals(origin[:3, 3])}', "
                f"and no URDF that is read has one beyond {LARGEST_NUMBER:g} m."
            )
        edits += _edits(source, joints[urdf.joint(name).name], urdf.joint(name).origin, origin)
    spliced = _applied(source, edits)
    _check(urdf, spliced, {name: replace(urdf.joint(name), origin=origin) for name, origin in origins.items()})
    return spliced


def splice_zeros(source: bytes, zeros: CountedZeros, where: str = "URDF") -> bytes:
    """Return the URDF whose joints count as somebody reads them, and every other byte as it was.

    ``zeros``: by joint name a sign, 1 or -1, and an offset in rad or m: the joint of ``source`` stands at ``sign *
    reading + offset``. The origin takes the offset and the axis the sign; limits, and joints that follow, are put in
    the new numbers. A joint at a reading is where the old one stands there.

    Raises RobotError when the document is no URDF or has no such joint, and OutputError when the result does not read
    back as asked, which takes a bug.
    """
    urdf = parse_urdf(source, where)
    edits: list[_Edit] = []
    asked = {name: urdf.joint(name) for name in zeros}
    joints = {e.attributes["name"]: e for e in read_document(source, where).children if e.tag == "joint"}
    for name, (sign, offset) in zeros.items():
        old, element = asked[name], joints[name]
        asked[name] = _counted_otherwise(old, sign, offset)
        edits += _edits(source, element, old.origin, asked[name].origin)
        if sign < 0.0:
            edits += _attributes(source, element, "axis", {"xyz": shortest_decimals(asked[name].axis)})
        for tag, ends in _IN_POSITIONS.items() if old.type != "continuous" else ():
            child = next((child for child in element.children if child.tag == tag), None)
            if child is not None and all(NUMBER.fullmatch(child.attributes.get(end, "0")) for end in ends):
                lower, upper = (float(child.attributes.get(end, "0")) for end in ends)
                values = shortest_decimals(np.array(_range(lower, upper, sign, offset))).split()
                edits += _attributes(source, element, tag, dict(zip(ends, values, strict=True)))
    for joint in urdf.joints:
        if joint.mimic is not None and joint.mimic.joint in zeros:
            sign, offset = zeros[joint.mimic.joint]
            multiplier = joint.mimic.multiplier
            mimic = Mimic(joint.mimic.joint, sign * multiplier, joint.mimic.offset + multiplier * offset)
            asked[joint.name] = replace(joint, mimic=mimic)
            values = shortest_decimals(np.array([mimic.multiplier, mimic.offset])).split()
            edits += _attributes(
                source, joints[joint.name], "mimic", dict(zip(("multiplier", "offset"), values, strict=True))
            )
    spliced = _applied(source, edits)
    _check(urdf, spliced, asked)
    return spliced


def _counted_otherwise(joint: UrdfJoint, sign: float, offset: float) -> UrdfJoint:
    """Return the joint that is at a reading where ``joint`` is at ``sign * reading + offset``."""
    if joint.type == "prismatic":
        moved = placement(np.eye(3), offset * joint.axis)
    else:
        moved = placement(rotation_about(joint.axis, offset), np.zeros(3))
    lower, upper = joint.lower, joint.upper
    if joint.type != "continuous":
        ends = (-np.inf if lower is None else lower, np.inf if upper is None else upper)
        lower, upper = (None if np.isinf(end) else end for end in _range(*ends, sign, offset))
    origin = read_only(joint.origin @ moved) if offset else joint.origin
    return replace(joint, origin=origin, axis=read_only(sign * joint.axis), lower=lower, upper=upper)


def _range(lower: float, upper: float, sign: float, offset: float) -> tuple[float, float]:
    ends = sorted((sign * (lower - offset), sign * (upper - offset)))
    return ends[0], ends[1]


def _edits(source: bytes, joint: Element, old: Array, new: Array) -> Iterator[_Edit]:
    """Yield the edits that turn the origin of a joint from ``old`` to ``new``; none where they are equal."""
    values = {}
    if not np.array_equal(old[:3, 3], new[:3, 3]):
        values["xyz"] = shortest_decimals(new[:3, 3])
    if not np.array_equal(old[:3, :3], new[:3, :3]):
        values["rpy"] = shortest_decimals(rpy_of(new[:3, :3]))
    if not values:
        return
    yield from _attributes(source, joint, "origin", values)


def _attributes(source: bytes, joint: Element, tag: str, values: Mapping[str, str]) -> Iterator[_Edit]:
    """Yield the edits that give a child of a joint these attributes; one that is missing is inserted."""
    child = next((child for child in joint.children if child.tag == tag), None)
    if child is None:
        # A joint has its <parent> at least, so there is a first child to stand before, indented like it.
        first = joint.children[0].start
        indentation = _indentation(_decoded(source, joint.start, first))
        attributes = "".join(f' {name}="{text}"' for name, text in values.items())
        yield _Edit(first, first, f"<{tag}{attributes}/>{indentation}")
        return
    text = _decoded(source, child.start, child.end)
    match = START_TAG.match(text)
    assert match is not None, "expat found a start tag here"
    present = {a["name"]: a for a in ATTRIBUTE.finditer(text, *match.span("attributes"))}
    quote = next((a["quote"] for a in present.values()), '"')
    for name, value in values.items():
        start, end = present[name].span("value") if name in present else (match.end(), match.end())
        start, end = (child.start + len(encoded_like(source, text[:i])) for i in (start, end))
        yield _Edit(start, end, value if name in present else f" {name}={quote}{value}{quote}")


def _applied(source: bytes, edits: list[_Edit]) -> bytes:
    """Return ``source`` with all edits made; they do not overlap, and those at one place keep their order."""
    pieces, done = [], 0
    for edit in sorted(edits, key=lambda edit: edit.start):
        pieces += [source[done : edit.start], encoded_like(source, edit.text)]
        done = edit.end
    return b"".join([*pieces, source[done:]])


def _indentation(text: str) -> str:
    """Return the white space at the end of ``text`` from its last line break on."""
    line = text.rstrip(" \t")
    line_break = next((end for end in ("\r\n", "\n", "\r") if line.endswith(end)), "")
    return line_break + text[len(line) :]


def shortest_decimals(values: Array) -> str:
    """Return as text the shortest decimals that read back as ``values``, without the minus of a negative zero."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def origin_text(T: Array) -> tuple[str, str]:
    """Return what an ``<origin>`` has as xyz and as rpy for a placement (4, 4)."""
    return shortest_decimals(T[:3, 3]), shortest_decimals(rpy_of(T[:3, :3]))


def codec_of(source: bytes) -> str:
    """Return a codec that finds tags in the bytes: UTF-16 by its mark or its zeros, as expat does, else Latin-1.

    In every other encoding the reader takes, markup and numbers are the bytes of ASCII, and Latin-1 maps the rest to
    something and back.
    """
    head = source[:2]
    if head == b"\xff\xfe" or head[1:] == b"\0":
        return "utf-16-le"
    if head == b"\xfe\xff" or head[:1] == b"\0":
        return "utf-16-be"
    return "latin-1"


def _decoded(source: bytes, start: int, end: int) -> str:
    return source[start:end].decode(codec_of(source), "surrogatepass")


def encoded_like(source: bytes, text: str) -> bytes:
    """Return text as bytes of the document ``source``: by the codec of :func:`codec_of`."""
    return text.encode(codec_of(source), "surrogatepass")


def _check(before: Urdf, spliced: bytes, asked: Mapping[str, UrdfJoint]) -> None:
    """Raise OutputError unless ``spliced`` reads as the robot ``before`` with just these joints as asked for."""
    try:
        after = parse_urdf(spliced, before.where)
    except RobotError as e:
        raise OutputError(f"{before.where}: with what was changed it does not read back ({e}); this is a bug.") from e
    if (after.name, after.root, after.links) != (before.name, before.root, before.links):
        raise OutputError(f"{before.where}: with what was changed its links are different; this is a bug.")
    for old, new in zip(before.joints, after.joints, strict=True):
        error = _difference(asked.get(old.name, old), new)
        if not error <= (ORIGIN_ROUNDING if old.name in asked else 0.0):
            raise OutputError(
                f"{before.where}: joint {shown(old.name)} reads back with an error of {error:.1e}; "
                "this is a bug, or the placement asked for is no rigid motion."
            )


def _difference(a: UrdfJoint, b: UrdfJoint) -> float:
    """Return how far numbers of two joints differ, without end where something else does.

    The line, which something inserted moves, does not count.
    """
    if any(getattr(a, f) != getattr(b, f) for f in ("name", "type", "parent", "child")):
        return np.inf
    numbers = []
    for joint in (a, b):
        ends = [np.nan if end is None else end for end in (joint.lower, joint.upper)]
        follows = (joint.mimic.multiplier, joint.mimic.offset) if joint.mimic else (np.nan, np.nan)
        numbers.append(np.concatenate([joint.origin.ravel(), joint.axis, ends, follows]))
    if (a.mimic and a.mimic.joint) != (b.mimic and b.mimic.joint):
        return np.inf
    one, other = numbers
    if np.any(np.isnan(one) != np.isnan(other)):
        return np.inf
    return float(np.nanmax(np.abs(one - other)))
