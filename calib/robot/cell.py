"""A cell: one URDF that carries two machines, the second placed in the first.

The first document is kept byte for byte; before its end tag stand a fixed joint and all that the second one holds. Of
the second, only names change that both use, wherever they are referred to.
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from xml.sax.saxutils import unescape

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import JobError, OutputError
from calib.foundations.xml_text import quoted
from calib.robot.urdf import Urdf, UrdfJoint, parse_urdf, read_document
from calib.robot.urdf_writer import ATTRIBUTE, ORIGIN_ROUNDING, START_TAG, codec_of, encoded_like, origin_text

_PASSED_OVER = r"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>"
_TAG = re.compile(rf"{_PASSED_OVER}|(?P<tag>{START_TAG.pattern})", re.ASCII | re.DOTALL)
_DECLARED = re.compile(r"""<\?xml[^>]*?encoding\s*=\s*["']([A-Za-z0-9._-]+)""", re.ASCII)
# Which attribute of which element names what: also inside <transmission>, <gazebo> and <ros2_control>.
_LINKS = {"link": "name", "parent": "link", "child": "link"}
_JOINTS = {"joint": "name", "mimic": "joint"}
_MATERIALS = {"material": "name"}
_EITHER = {"gazebo": "reference"}


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """A URDF of two machines. ``links`` and ``joints``: names of the second machine's, by what they were there."""

    document: bytes
    links: Mapping[str, str]
    joints: Mapping[str, str]

    @property
    def renamed(self) -> list[str]:
        """The new names of those of the second machine that the first one uses as well."""
        return [new for names in (self.links, self.joints) for old, new in names.items() if old != new]


def compose(first: Urdf, second: Urdf, parent: str, placement: Array, prefix: str | None = None) -> Cell:
    """Return the cell in which the root link of ``second`` is fixed to link ``parent`` of ``first``.

    ``placement`` (4, 4): of that root link in ``parent``. Links, joints and materials of the second machine whose names
    the first one uses get ``prefix_`` before them; the prefix is the second robot's name unless it is given.

    The document is read back and compared, joint by joint. Raises RobotError when ``parent`` is no link of the first,
    JobError for a prefix that is none, OutputError when the cell does not read back as asked.
    """
    first.parent_joint(parent)
    prefix = prefix or re.sub(r"[^A-Za-z0-9]+", "_", second.name).strip("_") or "second"
    if not re.fullmatch(r"[A-Za-z0-9_.-]+", prefix, re.ASCII):
        raise JobError(f"prefix: {prefix!r} is not made of the letters a to z, digits, dots, dashes and underscores.")
    joints_of_first = [joint.name for joint in first.joints]
    links = _renamed(second.links, first.links, prefix)
    joints = _renamed([joint.name for joint in second.joints], joints_of_first, prefix)
    known = _materials(_inner(first))
    inner = _inner(second)
    materials = _renamed(sorted(_materials(inner)), known, prefix)
    mount = f"{links[second.root]}_mount"
    while mount in joints_of_first or mount in joints.values():
        mount = f"{prefix}_{mount}"
    xyz, rpy = origin_text(placement)
    fixed = (
        f'\n  <joint name={quoted(mount)} type="fixed">'
        f"\n    <parent link={quoted(parent)}/>"
        f"\n    <child link={quoted(links[second.root])}/>"
        f'\n    <origin xyz="{xyz}" rpy="{rpy}"/>'
        "\n  </joint>"
    )
    added = fixed + _rename(inner, links, joints, materials).rstrip() + "\n"
    end = read_document(first.source, first.where).end
    document = first.source[:end] + encoded_like(first.source, _ascii(added)) + first.source[end:]
    _check(document, first, second, mount, placement, links, joints)
    return Cell(document, links, joints)


def _renamed(names: Collection[str], taken: Collection[str], prefix: str) -> dict[str, str]:
    """Return a name for each of ``names``, its own where nobody has it yet."""
    found: dict[str, str] = {}
    used, own = frozenset(taken), frozenset(names)
    for name in names:
        new = name
        while new in used or (new != name and new in own):
            new = f"{prefix}_{new}"
        found[name] = new
    return found


def _ascii(text: str) -> str:
    """Return text with every character beyond ASCII as a reference, which is the same in all encodings."""
    return text.encode("ascii", "xmlcharrefreplace").decode("ascii")


def _inner(urdf: Urdf) -> str:
    """Return what stands between the tags of <robot>, by the encoding that the document declares."""
    root = read_document(urdf.source, urdf.where)
    codec = codec_of(urdf.source)
    if codec == "latin-1":
        declared = _DECLARED.search(urdf.source[:200].decode(codec))
        codec = declared[1] if declared else "utf-8"
    text = urdf.source[root.start : root.end].decode(codec)
    match = START_TAG.match(text)
    assert match is not None, "expat found a start tag here"
    return text[text.index(">", match.end()) + 1 :]


def _materials(text: str) -> set[str]:
    """Return the names of all materials of a document."""
    found = set()
    for tag in _TAG.finditer(text):
        if tag["tag"] and tag["tag"][1:].split(None, 1)[0] == "material":
            found |= {unescape(a["value"]) for a in ATTRIBUTE.finditer(tag["attributes"]) if a["name"] == "name"}
    return found


def _rename(text: str, links: Mapping[str, str], joints: Mapping[str, str], materials: Mapping[str, str]) -> str:
    """Return the text with new names wherever a start tag refers to a link, a joint or a material."""
    kinds = ((_LINKS, links), (_JOINTS, joints), (_MATERIALS, materials), (_EITHER, {**joints, **links}))
    pieces, done = [], 0
    for tag in _TAG.finditer(text):
        if not tag["tag"]:
            continue
        name = re.split(r"\s", tag["tag"][1:], maxsplit=1)[0]
        for attributes, new in kinds:
            for a in ATTRIBUTE.finditer(text, *tag.span("attributes")):
                value = unescape(a["value"], {"&quot;": '"', "&apos;": "'"})
                if a["name"] == attributes.get(name) and new.get(value, value) != value:
                    # A new name is a prefix before the old one, whatever that needed to be quoted.
                    added = new[value][: len(new[value]) - len(value)]
                    pieces += [text[done : a.start("value")], added]
                    done = a.start("value")
    return "".join([*pieces, text[done:]])


def _check(
    document: bytes,
    first: Urdf,
    second: Urdf,
    mount: str,
    placement: Array,
    links: Mapping[str, str],
    joints: Mapping[str, str],
) -> None:
    """Raise OutputError unless the cell reads as both machines and the fixed joint between them."""
    cell = parse_urdf(document, "the cell")
    if cell.links != (*first.links, *(links[link] for link in second.links)) or cell.root != first.root:
        raise OutputError("the cell's links are not those of both machines; this is a bug.")
    expected = [joint.name for joint in first.joints] + [mount] + [joints[joint.name] for joint in second.joints]
    if [joint.name for joint in cell.joints] != expected:
        raise OutputError("the cell's joints are not those of both machines; this is a bug.")
    n = len(first.joints)
    same = all(_same(a, b, {}, {}) for a, b in zip(first.joints, cell.joints[:n], strict=True)) and all(
        _same(a, b, links, joints) for a, b in zip(second.joints, cell.joints[n + 1 :], strict=True)
    )
    error = float(np.abs(cell.joints[n].origin - placement).max())
    if not (same and error < ORIGIN_ROUNDING):
        raise OutputError(f"the cell reads back otherwise, its placement off by {error:.1e}; this is a bug.")


def _same(a: UrdfJoint, b: UrdfJoint, links: Mapping[str, str], joints: Mapping[str, str]) -> bool:
    """Tell whether joint b of the cell is joint a with names changed."""
    ends = (links.get(a.parent, a.parent), links.get(a.child, a.child)) == (b.parent, b.child)
    numbers_ = np.array_equal(a.origin, b.origin) and np.array_equal(a.axis, b.axis)
    followed = None if a.mimic is None else joints.get(a.mimic.joint, a.mimic.joint)
    mimics = followed == (None if b.mimic is None else b.mimic.joint)
    return ends and numbers_ and mimics and (a.type, a.lower, a.upper) == (b.type, b.lower, b.upper)
