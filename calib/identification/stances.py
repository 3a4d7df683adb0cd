"""How a machine stands in the poses of rows, and how it would stand where its tool is at what the rows are about.

Touches of a target measure nothing but readings. That all of them are of one target is what is known; what a model
leaves, ``r``, is an error of the readings ``q``, however the arm came by it. At q the derivatives J err with r, and
``J^T r = 0``, the condition of least squares, is not met by the truth: a machine that is smaller throughout leaves less
of the same errors, and one that is shrunk to a point leaves nothing. Readings q' at which the tool is at its target
have no part in these errors. So J is taken there, and the condition is ``J(q')^T r(q) = 0``, to which errors of the
readings add nothing on the average (W. A. Fuller, *Measurement Error Models*, 1987: q' are instrumental variables). Of
a machine that grows or turns with all that it touches, J(q') says that nothing shows it, as is true.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.errors import PoseError
from calib.identification.machine import Machine
from calib.identification.observations.seen import Linearised, Moved
from calib.identification.rows import held_at, observed_rows, on_links, one_or_all, setups_of
from calib.identification.selection import NO_FRAME
from calib.measurement.kinds import TOUCHES
from calib.measurement.measurements import Measurements
from calib.robot.conditions import Conditions
from calib.robot.kinematics import Follow
from calib.robot.robot import Nominals, Robot, TipModel, TipMotion

# A tool is at its target within this share of a metre, and of its distance: what nothing shows is then zero.
_THERE = 1e-13
# Newton's steps, at most, and how far one may go, in rad or m.
_MOST_STEPS, _FARTHEST = 12, 0.2
# Joints that move the tool by less than this share of the reach, which is some mm, by one rad, hardly lead it.
_HARDLY, _LEAST_REACH = 1e-3, 1e-3


class Links(dict[str, TipModel]):
    """Models of a robot as the one of a machine is, by the link that they look at; "" is the robot's tip."""

    def __init__(self, robot: Robot, at: Machine, nominals: Nominals | None = None) -> None:
        super().__init__()
        self._robot, self._at, self._nominals = robot, at, Nominals() if nominals is None else nominals

    def __missing__(self, link: str) -> TipModel:
        robot = self._robot if link in ("", self._robot.tip) else self._robot.with_tip(link)
        found = TipModel(robot, self._at.deviations, self._nominals[self._robot], self._at.motions)
        self[link] = found
        return found


class Stance(NamedTuple):
    """How a machine stands at ``readings`` (n, nr) of rows, and what is ``observed`` of it there.

    ``tip`` and ``other_tip``, of pairs: motions of the tip; ``tool`` and ``other_tool`` (n, 4, 4): what is observed, in
    the base. ``seats``: links that carry targets of some rows, these, and the link's motion. ``base`` (n, 4, 4), or of
    all: where the base is for who observes, and its ``group`` (n,), or of all: the number of the set-up, or
    ``NO_FRAME``. ``ends``: tools for who observes.
    """

    readings: Array
    tip: TipMotion
    other_tip: TipMotion | None
    tool: Array
    other_tool: Array | None
    seats: tuple[tuple[str, IntArray, TipMotion], ...]
    base: Array
    group: IntArray | int
    observed: Linearised
    ends: tuple[Array, ...]

    @property
    def far(self) -> Array:
        """How far the rows are from where they should be (n,), in m."""
        return np.asarray(np.linalg.norm(self.observed.residual, axis=1))

    @property
    def moved(self) -> tuple[Moved, ...]:
        """The tools, and other ends, for who observes them."""
        return tuple(map(Moved, (self.observed.tool, self.observed.other), self.ends))

    @property
    def grounds(self) -> tuple[tuple[str | None, IntArray | slice], ...]:
        """Which of the rows are told in which link, None being the floor."""
        on_floor: IntArray | slice = np.flatnonzero(self.group != NO_FRAME) if self.seats else slice(None)
        return ((None, on_floor), *((link, own) for link, own, _ in self.seats))

    def in_base(self, follows: Sequence[Follow]) -> list[Follow]:
        """Return how numbers follow something, as who observes it says, in the axes of the base."""
        return [follow.seen_from(self.base[..., :3, :3]) for follow in follows]

    @property
    def by_readings(self) -> Array:
        """Derivatives (n, d, nr) of what is observed by the readings of the tool's end."""
        x, found = self.tool[:, :3, 3], list[Array]()
        for follow in self.in_base(self.observed.tool):
            J = self.tip.following(self.tip.tip.through(follow, x), self.readings)
            for _, own, seat in self.seats:
                # What is seen from a link that moves, moves the other way.
                back = seat.tip.through(follow.of(own).negative(), x[own])
                J[own] += seat.following(back, self.readings[own])
            found.append(J)
        return np.concatenate(found, axis=1)


class Stances:
    """How a machine stands, by readings. ``links``: its models; ``reach`` of the robot, in m."""

    def __init__(self, at: Machine, links: Links, reach: float) -> None:
        self._frames, self._links, self._reach = at.frames, links, reach

    def at(self, data: Measurements, rows: slice, readings: Array, told: Conditions) -> Stance:
        """Return the stance at readings (n, nr) of rows; raises PoseError where a loop does not close."""
        frames, tip, points = self._frames, self._links[data.tip], data.points
        tool, other_tip, other_tool = one_or_all(data.tool[rows], data.tools), None, None
        motion = tip.motion(readings, told)
        if data.other is not None:
            end = data.other
            other_tip = tip.motion(end.readings[rows], end.conditions.subset(rows))
            of_end = one_or_all(end.tool[rows], data.tools)
            other_tool = held_at(other_tip.tip, frames.tools, of_end, end.points, rows)
        base, group, seats = self.observers(data, rows, readings, told)
        held = held_at(motion.tip, frames.tools, tool, points, rows)
        observed, ends = observed_rows(data, rows, frames, base, held, other_tool)
        return Stance(readings, motion, other_tip, held, other_tool, seats, base, group, observed, ends)

    def observers(
        self, data: Measurements, rows: slice | IntArray, readings: Array, told: Conditions
    ) -> tuple[Array, IntArray | int, tuple[tuple[str, IntArray, TipMotion], ...]]:
        """Return ``base``, ``group`` and ``seats`` of a :class:`Stance` at readings (n, nr) of rows.

        Raises PoseError where a loop does not close.
        """
        setups = setups_of(data, rows)
        base, group = np.asarray(self._frames.bases[setups]), setups
        seats = tuple(
            (link, own, self._links[link].motion(readings[own], told.subset(own))) for link, own in on_links(data, rows)
        )
        if seats:
            group = np.array(setups)
            for _, own, seat in seats:
                base[own], group[own] = rigid.inverse(seat.placement), NO_FRAME
        return base, group, seats

    def at_targets(self, data: Measurements, rows: slice, begin: Stance, told: Conditions) -> Stance:
        """Return the stance near ``begin`` in which the tool is at its target; what is left stays that of ``begin``.

        Joints lead it there, or as near as they can: a plane arm does not leave its plane.
        """
        there = _THERE * (1.0 + float(np.abs(begin.ends[0][:, :3, 3]).max(initial=0.0)))
        at, nearest, far = begin, begin.readings, begin.far
        may_move = np.ones(len(far), dtype=np.bool_)
        damping = (_HARDLY * max(self._reach, _LEAST_REACH)) ** 2 * np.eye(begin.observed.residual.shape[1])
        for _ in range(_MOST_STEPS):
            may_move = may_move & (at.far > there)
            if not may_move.any():
                break
            r, J = np.where(may_move[:, None], at.observed.residual, 0.0), at.by_readings
            J_t = np.swapaxes(J, -1, -2)
            step = -(J_t @ np.linalg.solve(J @ J_t + damping, r[:, :, None]))[:, :, 0]
            step /= np.maximum(1.0, np.linalg.norm(step, axis=1, keepdims=True) / _FARTHEST)
            at, may_move = self._closing(data, rows, at.readings + step, told, nearest, may_move)
            nearer = at.far < far
            nearest, far = np.where(nearer[:, None], at.readings, nearest), np.minimum(at.far, far)
            may_move = may_move & nearer
        if not np.array_equal(nearest, at.readings):
            at = self.at(data, rows, nearest, told)
        return at._replace(observed=at.observed._replace(residual=begin.observed.residual))

    def _closing(
        self, data: Measurements, rows: slice, readings: Array, told: Conditions, last: Array, may_move: BoolArray
    ) -> tuple[Stance, BoolArray]:
        """Return the stance at readings (n, nr), rows in which a loop does not close there staying at the ``last``."""
        while True:
            try:
                return self.at(data, rows, readings, told), may_move
            except PoseError as e:
                open_ = list(e.rows)
                if not may_move[open_].any():
                    raise
                readings, may_move = readings.copy(), may_move.copy()
                readings[open_], may_move[open_] = last[open_], False


def touches(data: Measurements) -> bool:
    """Return whether rows of a set have no number of an instrument in them: all are of the same length, or of none."""
    of_lengths = data.kind in ("distance", "pair_distance")
    return data.kind in TOUCHES or (of_lengths and len(data) > 0 and not np.ptp(data.value))
