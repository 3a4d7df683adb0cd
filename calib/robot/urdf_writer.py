"""URDF out: the placements of some joints changed, every other byte kept.

A user's URDF is a text with a history: comments, gazebo and control blocks, numbers as somebody typed them. Writers
that rebuild the document lose some of it, so this one cuts the new numbers into the old bytes and reads the result
back before anybody else does.
"""

import re
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import OutputError, RobotError
from calib.foundations.rigid import rpy_of
from calib.foundations.words import shown
from calib.foundations.xml_text import Element
from calib.robot.urdf import LARGEST_NUMBER, Urdf, UrdfJoint, parse_urdf, read_document

# Largest difference of a placement read back, in metres and in entries of the rotation: rounding of rpy, no more.
ORIGIN_ROUNDING = 1e-12

# These read tags that expat has accepted, so they have to find things, not to judge them.
START_TAG = re.compile(r"""<[^\s/>]+(?P<attributes>(?:\s+[^\s=/>]+\s*=\s*(?:"[^"]*"|'[^']*'))*)""", re.ASCII)
ATTRIBUTE = re.compile(r"""(?P<name>[^\s=]+)\s*=\s*(?P<quote>["'])(?P<value>.*?)(?P=quote)""", re.ASCII | re.DOTALL)


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
    _check(urdf, spliced, origins)
    return spliced


def _edits(source: bytes, joint: Element, old: Array, new: Array) -> Iterator[_Edit]:
    """Yield the edits that turn the origin of a joint from ``old`` to ``new``; none where they are equal."""
    values = {}
    if not np.array_equal(old[:3, 3], new[:3, 3]):
        values["xyz"] = shortest_decimals(new[:3, 3])
    if not np.array_equal(old[:3, :3], new[:3, :3]):
        values["rpy"] = shortest_decimals(rpy_of(new[:3, :3]))
    if not values:
        return
    origin = next((child for child in joint.children if child.tag == "origin"), None)
    if origin is None:
        # A joint has its <parent> at least, so there is a first child to stand before, indented like it.
        first = joint.children[0].start
        indentation = _indentation(_decoded(source, joint.start, first))
        attributes = "".join(f' {name}="{text}"' for name, text in values.items())
        yield _Edit(first, first, f"<origin{attributes}/>{indentation}")
        return
    tag = _decoded(source, origin.start, origin.end)
    match = START_TAG.match(tag)
    assert match is not None, "expat found a start tag here"
    present = {a["name"]: a for a in ATTRIBUTE.finditer(tag, *match.span("attributes"))}
    quote = next((a["quote"] for a in present.values()), '"')
    for name, text in values.items():
        start, end = present[name].span("value") if name in present else (match.end(), match.end())
        start, end = (origin.start + len(encoded_like(source, tag[:i])) for i in (start, end))
        yield _Edit(start, end, text if name in present else f" {name}={quote}{text}{quote}")


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


def _check(before: Urdf, spliced: bytes, origins: Mapping[str, Array]) -> None:
    """Raise OutputError unless ``spliced`` reads as the robot ``before`` with just these origins changed."""
    try:
        after = parse_urdf(spliced, before.where)
    except RobotError as e:
        raise OutputError(f"{before.where}: with the new origins it does not read back ({e}); this is a bug.") from e
    if (after.name, after.root, after.links) != (before.name, before.root, before.links):
        raise OutputError(f"{before.where}: with the new origins its links are different; this is a bug.")
    for old, new in zip(before.joints, after.joints, strict=True):
        asked = origins.get(old.name, old.origin)
        tolerance = ORIGIN_ROUNDING if old.name in origins else 0.0
        error = float(np.abs(new.origin - asked).max())
        if not (_same_otherwise(old, new) and error <= tolerance):
            raise OutputError(
                f"{before.where}: joint {shown(old.name)} reads back with an origin off by {error:.1e}; "
                "this is a bug, or the placement asked for is no rigid motion."
            )


def _same_otherwise(a: UrdfJoint, b: UrdfJoint) -> bool:
    """Tell whether two joints agree in all but the origin and the line, which an inserted origin moves."""
    fields = ("name", "type", "parent", "child", "lower", "upper", "mimic")
    return all(getattr(a, f) == getattr(b, f) for f in fields) and np.array_equal(a.axis, b.axis)
