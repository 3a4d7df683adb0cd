"""Numbers of a tree of joints at given deviations: placements for the kinematics, and their exact derivatives.

Fixed joints have no place in the kinematics; their placements, and changes of them, are carried on to the next moving
joint, or to the frame at the end, by constant adjoints.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.robot import deviation
from calib.robot.kinematics import Frame, MovingType, Tree


class Segment(NamedTuple):
    """One joint: its nominal ``placement`` (4, 4) in the frame of joint ``parent`` (-1: the base).

    ``number`` counts the moving joints; None for a fixed one. ``frame`` (4, 4) leads from the URDF's joint frame to the
    frame here, whose z is the joint's axis.
    """

    number: int | None
    type: Literal["revolute", "prismatic", "fixed"]
    parent: int
    placement: Array
    frame: Array


class Skeleton(NamedTuple):
    """A tree with deviations in it. ``placed`` (n, 4, 4): every joint's placement with its deviation.

    ``twists`` (n, 6, 6): local twists of the joints' placements for changes of their deviations.
    """

    segments: tuple[Segment, ...]
    placed: Array
    twists: Array
    tree: Tree


def skeleton(segments: Sequence[Segment], deviations: Array) -> Skeleton:
    """Return the skeleton of joints, parents before children, with deviations (n, 6)."""
    placed = np.stack([segment.placement for segment in segments]) @ deviation.motion(deviations)
    types: list[MovingType] = []
    parents: list[int] = []
    placements: list[Array] = []
    for i, segment in enumerate(segments):
        if segment.type != "fixed":
            carrier, T = _carried(segments, placed, segment.parent)
            types.append(segment.type)
            parents.append(carrier)
            placements.append(T @ placed[i])
    return Skeleton(
        tuple(segments), placed, deviation.twists(deviations), Tree(tuple(types), tuple(parents), np.stack(placements))
    )


def end_frame(s: Skeleton, joint: int) -> Frame:
    """Return the URDF frame of the link that a joint carries; joint -1 is the base link."""
    if joint < 0:
        return Frame(-1, np.eye(4))
    carrier, T = _carried(s.segments, s.placed, joint)
    return Frame(carrier, T @ rigid.inverse(s.segments[joint].frame))


def first_moving(s: Skeleton, joint: int) -> int:
    """Return the number of the first moving joint on the way from the base to the end of a joint; -1 for none."""
    first = -1
    while joint >= 0:
        number = s.segments[joint].number
        first, joint = first if number is None else number, s.segments[joint].parent
    return first


def derivative(s: Skeleton, joint: int) -> tuple[Array, Array]:
    """Return how the frame at the end of a joint follows the deviations: ``joints`` (6 nj, 6 n) and ``tail`` (6, 6 n).

    The local twist of the frame is ``regressor @ joints @ e + tail @ e`` for changes e of the deviations, row by row.
    """
    n_moving = len(s.tree.types)
    rows = np.zeros((n_moving + 1, 6, 6 * len(s.segments)))
    if joint >= 0:
        ahead, target = rigid.inverse(s.segments[joint].frame), n_moving
        while joint >= 0:
            number = s.segments[joint].number
            if number is None:
                rows[target, :, 6 * joint : 6 * joint + 6] = rigid.adjoint(rigid.inverse(ahead)) @ s.twists[joint]
                ahead = s.placed[joint] @ ahead
            else:
                # What is ahead of a moving joint is in its own column of the regressor.
                rows[number, :, 6 * joint : 6 * joint + 6] = s.twists[joint]
                ahead, target = s.placed[joint], number
            joint = s.segments[joint].parent
    return rows[:-1].reshape(6 * n_moving, -1), rows[-1]


def _carried(segments: Sequence[Segment], placed: Array, joint: int) -> tuple[int, Array]:
    """Return the moving joint at or before a joint, -1 for the base, and the joint's frame in it (4, 4)."""
    T = np.eye(4)
    while joint >= 0:
        number = segments[joint].number
        if number is not None:
            return number, T
        T = placed[joint] @ T
        joint = segments[joint].parent
    return -1, T
