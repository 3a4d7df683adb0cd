"""A DH table as a URDF: the same constants as joint origins, and plain cylinders to look at."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType

import numpy as np

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array
from calib.foundations.xml_text import quoted
from calib.robot.dh.table import DhTable
from calib.robot.urdf import parse_urdf
from calib.robot.urdf_writer import origin_text, shortest_decimals

# Where nobody gives limits: a turn each way, or a metre.
_LIMITS = {"revolute": (-2.0 * float(np.pi), 2.0 * float(np.pi)), "prismatic": (-1.0, 1.0)}
_NO_LIMITS: Mapping[str, tuple[float, float]] = MappingProxyType({})
# Parts of the arm's length: thin enough to see the axes, and shorter links are not drawn.
_RADIUS, _SHORTEST = 0.02, 1e-3


@checked
def dh_to_urdf(table: DhTable, name: str = "arm", limits: Mapping[str, tuple[float, float]] = _NO_LIMITS) -> bytes:
    """Return a URDF whose joints are the rows of the table, all about or along z, and whose tip link is ``tip``.

    The joint of a row stands where the row's own motion begins, so an origin is the constant rest of one row (standard)
    or the end of one row and the start of the next (modified); ``flange_mount`` closes the last row. Fixed joints
    ``base_mount`` and ``tool_mount`` are there where base or tool are not the identity. ``limits``: (lower, upper) in
    rad or m by joint; default +-2 pi or +-1 m.

    Raises RobotError when the names of the joints make no URDF.
    """
    joints = list(_joints(table))
    links = ["base_link", *(f"link_{n}" for n in range(1, len(joints))), "tip"]
    radius = _RADIUS * (sum(float(np.hypot(row.a, row.d)) for row in table.rows) or 1.0)
    lines = ['<?xml version="1.0"?>', f"<robot name={quoted(name)}>", f'  <link name="{links[0]}"/>']
    steps = [origin for _, _, origin in joints[1:]] + [np.eye(4)]
    for (joint, kind, origin), parent, child, ahead in zip(joints, links, links[1:], steps, strict=False):
        xyz, rpy = origin_text(origin)
        lines += [
            f'  <joint name={quoted(joint)} type="{kind}">',
            f'    <parent link="{parent}"/><child link="{child}"/>',
            f'    <origin xyz="{xyz}" rpy="{rpy}"/>',
        ]
        if kind != "fixed":
            lower, upper = limits.get(joint, _LIMITS[kind])
            lines += [
                '    <axis xyz="0 0 1"/>',
                f'    <limit lower="{lower!r}" upper="{upper!r}" effort="1" velocity="1"/>',
            ]
        lines += ["  </joint>", f'  <link name="{child}">', *_visuals(ahead[:3, 3], radius), "  </link>"]
    source = ("\n".join([*lines, "</robot>"]) + "\n").encode(errors="surrogatepass")
    parse_urdf(source, f"the URDF of DH table {name!r}")
    return source


def _joints(table: DhTable) -> Iterator[tuple[str, str, Array]]:
    """Yield name, type and origin (4, 4) of every joint from base to tip."""
    modified = table.convention == "modified"
    if not np.array_equal(table.base, np.eye(4)):
        yield "base_mount", "fixed", table.base
    ahead = np.eye(4)
    for row in table.rows:
        yield row.joint, row.type, ahead @ row.across if modified else ahead
        ahead = row.along if modified else row.along @ row.across
    yield "flange_mount", "fixed", ahead
    if not np.array_equal(table.tool, np.eye(4)):
        yield "tool_mount", "fixed", table.tool


def _visuals(ahead: Array, radius: float) -> list[str]:
    """Return a cylinder along z and one from there to the next joint, at ``ahead`` (3,) in m; short ones left out."""
    x, y, d = map(float, ahead)
    a, yaw = float(np.hypot(x, y)), float(np.arctan2(y, x))
    cylinders = (
        (abs(d), (0.0, 0.0, d / 2), (0.0, 0.0, 0.0)),
        (a, (x / 2, y / 2, d), (0.0, float(np.pi) / 2, yaw)),
    )
    return [
        f'    <visual><origin xyz="{shortest_decimals(np.array(xyz))}" rpy="{shortest_decimals(np.array(rpy))}"/>'
        f'<geometry><cylinder radius="{radius:.4g}" length="{length:.6g}"/></geometry></visual>'
        for length, xyz, rpy in cylinders
        if length > _SHORTEST * radius / _RADIUS
    ]
