"""Numbers of a tree of joints at given deviations: placements for the kinematics, and their exact derivatives.

Fixed joints have no place in the kinematics; their placements, and changes of them, are carried on to the next moving
joint, or to the frame at the end, by constant adjoints.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray
from calib.robot.deviation import Motions
from calib.robot.kinematics import Frame, MovingType, Tree, way


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

    ``carried`` (n, 4, 4): the same in the frame of the last moving joint before it. ``twists`` (n, 6, 6): local twists
    of the joints' placements for changes of their deviations.
    """

    outline: "Outline"
    placed: Array
    carried: Array
    twists: Array
    tree: Tree

    @property
    def segments(self) -> tuple[Segment, ...]:
        """The joints, parents before children."""
        return self.outline.segments

    def end_frame(self, joint: int) -> Frame:
        """Return the URDF frame of the link that a joint carries; joint -1 is the base link."""
        if joint < 0:
            return Frame(-1, np.eye(4))
        number, back = self.segments[joint].number, self.outline.back[joint]
        if number is None:
            return Frame(self.outline.carriers[joint], self.carried[joint] @ back)
        return Frame(number, back)


class Path(NamedTuple):
    """The way from the base to a frame: moving joints ``way`` (w), by number, and all ``segments`` (m), by index.

    ``carriers`` (m): which of the carriers of the frame carries each: 0 for the base, k + 1 for joint k of the way. A
    carrier is the base, or a moving joint on the way after its own motion, with all that is fixed to it.
    """

    way: tuple[int, ...]
    segments: IntArray
    carriers: IntArray


class Outline:
    """A tree without deviations: what all its skeletons share.

    ``carriers`` (n): the number of the moving joint before every joint, -1 for the base. Of the joints that move, by
    number: their ``types``, and ``parents``, the moving joint that carries each, -1 for the base.
    """

    def __init__(self, segments: Sequence[Segment]) -> None:
        self.segments = tuple(segments)
        self._placements = np.stack([segment.placement for segment in segments])
        self.back = [rigid.inverse(segment.frame) for segment in segments]
        behind = [i for i, segment in enumerate(segments) if segment.parent >= 0]
        self._fixed = [(i, segments[i].parent) for i in behind if segments[segments[i].parent].number is None]
        self.carriers = [self.moving_at(segment.parent) for segment in segments]
        moving = [i for i, segment in enumerate(segments) if segment.type != "fixed"]
        self._moving = np.array(moving, dtype=np.intp)
        self.types: tuple[MovingType, ...] = tuple(segment.type for segment in segments if segment.type != "fixed")
        self.parents = tuple(self.carriers[i] for i in moving)
        self._paths: dict[int, Path] = {}

    def path(self, joint: int) -> "Path":
        """Return the way from the base to the end of a joint."""
        if joint not in self._paths:
            self._paths[joint] = self._found(joint)
        return self._paths[joint]

    def _found(self, joint: int) -> "Path":
        own = way(self.parents, self.moving_at(joint))
        carrier = {number: k + 1 for k, number in enumerate(own)} | {-1: 0}
        segments = way([segment.parent for segment in self.segments], joint)
        carriers = [carrier[self.carriers[i]] for i in segments]
        return Path(own, np.array(segments, dtype=np.intp), np.array(carriers, dtype=np.intp))

    def moving_at(self, joint: int) -> int:
        """Return the number of the moving joint at or before a joint; -1 for the base."""
        while joint >= 0 and (number := self.segments[joint].number) is None:
            joint = self.segments[joint].parent
        return number if joint >= 0 and number is not None else -1

    def skeleton(self, deviations: Array) -> Skeleton:
        """Return the skeleton with deviations (n, 6)."""
        return self.moved(Motions.of(deviations))

    def moved(self, motions: Motions) -> Skeleton:
        """Return the skeleton with deviations whose n motions are made already."""
        placed = self._placements @ motions.E
        carried = placed.copy() if self._fixed else placed
        for i, parent in self._fixed:
            carried[i] = carried[parent] @ placed[i]
        return Skeleton(self, placed, carried, motions.W, Tree(self.types, self.parents, carried[self._moving]))


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
