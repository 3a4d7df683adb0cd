"""Links that give way: every way in which one does is a joint that nobody drives, at the placement that it moves.

A link stands between the frames of two joints, along the vector of the placement from one to the other. At its far end
it may

    bend      as a slender beam (Euler, Bernoulli) of round section that the load at its end bends: sideways by
              k (L^2/3 F + L/2 M x e) and in turns by k (M + L/2 e x F), with its length L, its direction e, force F
              and moment M across it, and the coefficient k = L/EI: the turn of its end for a moment there, in rad/Nm
    expand    along itself, by L times a strain
    twist     about itself, by a coefficient times the torque about it

and the bearing of the joint there may tilt, about axes that the joint does not turn about.

(S. Timoshenko, *Strength of materials*, 1940, part I, chapter V.) What such a joint holds against gravity is the slope
of the potential energy by its motion, as of any other joint: loops that follow are accounted for.

The link itself is fixed at its near end, and follows the motion of its far end by the curve of a beam that is loaded
there alone, a cubic. Virtual work then makes of weight between the ends the load at the far end that moves it alike
(J. S. Przemieniecki, *Theory of matrix structural analysis*, 1968, chapter 5). A weight W that is spread evenly counts
as W/2 at 5/6 of the length, rigidly behind the end, and so moves the end by W L^3/8EI and turns it by W L^2/6EI.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray
from calib.robot.deviation import Motions, axis_frame
from calib.robot.kinematics import MovingType
from calib.robot.loops import Loop
from calib.robot.skeleton import Segment

# Frames nearer to each other than this, in m, are at one place, with no link between them.
SHORTEST = 1e-6


class Flexure(NamedTuple):
    """One motion of the far end of the link before joint ``joint`` of the chain, at that joint's placement.

    Along, or about, ``axis`` (3,) in the joint's frame. ``link``: whether the link gives way and follows, or the
    bearing behind it.
    """

    joint: int
    type: MovingType
    axis: Array
    link: bool = True


class Mechanism(NamedTuple):
    """What kinematics need of a robot: its joints, and one more for every flexure.

    Coordinates are the readings, then the flexures: c in all; m joints move. ``coupling`` (m, c), ``coupling_offset``
    (m) and ``offset_coupling`` (m, nj): as in :class:`calib.robot.robot.Robot`. ``homes`` (k, m): positions at some
    readings, at one of which passive joints stand best where the coupling puts them. ``placed`` (n): which segment has
    the deviation of every joint of the chain; ``carrying`` (n): which carries what the joint carries; ``own`` (nj):
    numbers of the joints that move in the robot itself.
    """

    segments: tuple[Segment, ...]
    loops: tuple[Loop, ...]
    coupling: Array
    coupling_offset: Array
    offset_coupling: Array
    homes: Array
    placed: IntArray
    carrying: IntArray
    own: IntArray

    @property
    def types(self) -> tuple[MovingType, ...]:
        """Types of the joints that move."""
        return tuple(segment.type for segment in self.segments if segment.type != "fixed")

    @property
    def rigid(self) -> bool:
        """Whether it has no flexures."""
        return len(self.own) == len(self.coupling)

    def of_segments(self, motions: Motions) -> Motions:
        """Return the motions of all segments for those of the n joints of the chain: the others stay."""
        if self.rigid:
            return motions
        found = Motions.of(np.zeros((len(self.segments), 6)))
        found.E[self.placed], found.W[self.placed] = motions
        return found

    def of_chain(self, columns: Array) -> Array:
        """Return those columns (..., 6 n + a) that belong to the chain, of all (..., 6 segments + a)."""
        if self.rigid:
            return columns
        behind = 6 * len(self.segments)
        kept = (6 * self.placed[:, None] + np.arange(6)).ravel()
        return np.asarray(columns[..., np.concatenate([kept, np.arange(behind, columns.shape[-1])])])


def mechanism(
    segments: Sequence[Segment],
    loops: Sequence[Loop],
    coupling: Array,
    coupling_offset: Array,
    offset_coupling: Array,
    flexures: Sequence[Flexure],
    homes: Array,
) -> Mechanism:
    """Return the mechanism of a chain with flexures; its ``coupling`` is (nj, nr), ``homes`` are readings (k, nr)."""
    every = np.arange(len(segments))
    if not flexures:
        own = np.arange(len(coupling))
        at = homes @ coupling.T + coupling_offset
        return Mechanism(
            tuple(segments), tuple(loops), coupling, coupling_offset, offset_coupling, at, every, every.copy(), own
        )
    found: list[Segment] = []
    placed, carrying = np.zeros_like(every), np.zeros_like(every)
    numbers: list[int] = []
    driven: list[tuple[int, int]] = []
    moving = 0
    for i, segment in enumerate(segments):
        parent = _of(carrying, segment.parent)
        back, mine = segment.placement, [k for k, flexure in enumerate(flexures) if flexure.joint == i]
        placed[i] = len(found)
        if mine:
            # The placement with its deviation comes first; what gives way does so in the frame that it leads to.
            found.append(Segment(None, "fixed", parent, segment.placement, np.eye(4)))
            back = np.eye(4)
        for k in mine:
            along = axis_frame(flexures[k].axis)
            found.append(Segment(moving, flexures[k].type, len(found) - 1, back @ along, np.eye(4)))
            driven.append((moving, coupling.shape[1] + k))
            back, moving = rigid.inverse(along), moving + 1
        carrying[i] = len(found)
        number = None if segment.type == "fixed" else moving
        found.append(Segment(number, segment.type, len(found) - 1 if mine else parent, back, segment.frame))
        if number is not None:
            numbers.append(number)
            moving += 1
    own = np.array(numbers, dtype=np.intp)
    wider, offset = np.zeros((moving, coupling.shape[1] + len(flexures))), np.zeros(moving)
    wider[own, : coupling.shape[1]], offset[own] = coupling, coupling_offset
    wider[tuple(np.transpose(driven))] = 1.0
    by_offset = np.zeros((moving, offset_coupling.shape[1]))
    by_offset[own] = offset_coupling
    return Mechanism(
        tuple(found),
        tuple(
            loop._replace(
                ends=(_of(carrying, loop.ends[0]), _of(carrying, loop.ends[1])),
                passive=tuple(numbers[j] for j in loop.passive),
            )
            for loop in loops
        ),
        wider,
        offset,
        by_offset,
        homes @ wider[:, : coupling.shape[1]].T + offset,
        placed,
        carrying,
        own,
    )


def link_length(segment: Segment) -> float:
    """Return the length in m of the link before a joint, nominally; 0 where both frames are at one place."""
    found = float(np.linalg.norm(segment.placement[:3, 3]))
    return found if found > SHORTEST else 0.0


def expanding(segments: Sequence[Segment], joint: int) -> tuple[Flexure, ...]:
    """Return the motion of a link that expands: of none without a length."""
    along = _along(segments[joint])
    return (Flexure(joint, "prismatic", along),) if link_length(segments[joint]) else ()


def bending(segments: Sequence[Segment], joint: int) -> tuple[Flexure, ...]:
    """Return the motions of a link that bends: along x and y across it, then about x and y; none without a length."""
    if not link_length(segments[joint]):
        return ()
    x, y = axis_frame(_along(segments[joint]))[:3, :2].T
    return tuple(Flexure(joint, kind, axis) for kind in ("prismatic", "revolute") for axis in (x, y))


def twisting(segments: Sequence[Segment], joint: int) -> tuple[Flexure, ...]:
    """Return the motion of a link that twists: of none without a length."""
    return (Flexure(joint, "revolute", _along(segments[joint])),) if link_length(segments[joint]) else ()


def tilting(segments: Sequence[Segment], joint: int, axis: int) -> tuple[Flexure, ...]:
    """Return the turn of a joint's bearing about x, y or z (0, 1, 2), z along the joint's axis: of none that is fixed.

    A bearing stands where its joint is placed, whether there is a link before it or not.
    """
    return () if segments[joint].type == "fixed" else (Flexure(joint, "revolute", np.eye(3)[axis], link=False),)


def beam(length: float) -> Array:
    """Return the motions (4, 4) of a beam's end, as :func:`bending` has them, for forces and moments there, and k = 1.

    The length is in m.
    """
    sideways, both = length * length / 3.0, length / 2.0
    return np.array(
        [[sideways, 0.0, 0.0, both], [0.0, sideways, -both, 0.0], [0.0, -both, 1.0, 0.0], [both, 0.0, 0.0, 1.0]]
    )


def followed(flexure: Flexure, segment: Segment, centre: Array) -> Array:
    """Return how the mass of the link before a joint follows a flexure: its centre's motion (3,) per unit of that.

    ``segment``: of the joint; ``centre`` (3,) of the mass in m: both in the frame that the link starts from, as is what
    is returned. A mass is spread evenly along the link, about its centre, as far as the nearer end; what lies before
    the near end stays, and what lies behind the far end moves with it.
    """
    length, vector = link_length(segment), segment.placement[:3, 3]
    if not (flexure.link and length):
        return np.zeros(3)
    e, axis = vector / length, segment.placement[:3, :3] @ flexure.axis
    middle = float(np.clip(centre @ e / length, 0.0, 1.0))
    beside = centre - middle * vector
    along = (axis @ e) * e
    found = np.zeros(3)
    # Gauss' two points: exact for cubics.
    for x in middle + min(middle, 1.0 - middle) / np.sqrt(3.0) * np.array([-1.0, 1.0]):
        if flexure.type == "prismatic":
            shift = x * along + x**2 * (3.0 - 2.0 * x) * (axis - along)
            turn = 6.0 * x * (1.0 - x) / length * np.cross(e, axis)
        else:
            shift = x**2 * (x - 1.0) * length * np.cross(axis, e)
            turn = x * along + x * (3.0 * x - 2.0) * (axis - along)
        found += 0.5 * (shift + np.cross(turn, beside))
    return found


def _along(segment: Segment) -> Array:
    """Return the direction (3,) of a link in the frame of the joint at its far end."""
    vector = segment.placement[:3, 3]
    return np.asarray(segment.placement[:3, :3].T @ vector / max(float(np.linalg.norm(vector)), SHORTEST))


def _of(carrying: IntArray, joint: int) -> int:
    return int(carrying[joint]) if joint >= 0 else -1
