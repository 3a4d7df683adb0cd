"""How what is measured follows the parameters at a machine: residuals and Jacobian of every set, block by block."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import PoseError
from calib.identification.machine import Machine
from calib.identification.observations.pixels import Photographed, of_photographs, photographed
from calib.identification.observations.seen import Linearised, Moved, Seen
from calib.identification.rows import (
    held_at,
    named,
    one_or_all,
    row_blocks,
    scalars_of,
)
from calib.identification.selection import NO_FRAME, Selection
from calib.identification.stances import Links, Stances, touches
from calib.measurement.measurements import Measurements
from calib.measurement.streams.stream import SHIFTS
from calib.robot.kinematics import Follow, followed
from calib.robot.robot import Nominals, Robot, TipMotion


class Block(NamedTuple):
    """Rows of one set: residuals with derivatives, and their Jacobian (n, d, c) by common parameters.

    ``readings`` (n, nr): those at which the derivatives are; of touches the tool is at its target there. ``own`` (n, d,
    a): derivatives by the parameters of the row's ``block`` (n,), -1 for none; both are None where all are common.
    ``moved``: the tools, and other ends. ``grounds``: which of the rows are told in which link, None being the floor.
    """

    rows: slice
    readings: Array
    observed: Linearised
    J: Array
    own: Array | None
    block: IntArray | None
    moved: tuple[Moved, ...]
    grounds: tuple[tuple[str | None, IntArray | slice], ...]


class _Clocked(NamedTuple):
    """Rates (n, k) of the readings of rows of a stream, and how the controller's time (n, p) follows the parameters."""

    rates: Array
    by: Array

    def subset(self, rows: IntArray) -> "_Clocked":
        return _Clocked(self.rates[rows], self.by[rows])


# Of some rows, the photograph of each and what was seen: numbers of photographs, as few as say the same.
_Folding = Callable[[slice, IntArray, Photographed], tuple[Array, Array, dict[str, Array]]]


class Rates:
    """How frames follow the parameters at a machine: the same for all sets.

    ``selection``: which parameters move what, in which columns and units.
    """

    def __init__(self, robot: Robot, nominals: Nominals, selection: Selection, at: Machine) -> None:
        self._robot, self._frames, self._selection = robot, at.frames, selection
        self._links = Links(robot, at, nominals)
        self._stances = Stances(at, self._links, robot.reach)
        self._at, self._of_targets = at, selection.of_targets.turned(at.target_twists)
        self._on: dict[str, tuple[Array, Array]] = {}
        self._by: dict[tuple[str, int, int], Array] = {}

    def of_targets(self, numbers: Sequence[int]) -> Array:
        """Return the local twists (n, 6, c) of some targets, by number, for the common parameters."""
        return self._of_targets.written_out(np.asarray(numbers, dtype=np.intp), self._selection.common)

    def whose(self, data: Measurements) -> IntArray | None:
        """Return the blocks (N,) that rows of a set are about, -1 for none; None where there are no blocks at all."""
        selection = self._selection
        return selection.things.blocks_of(selection.block, data) if len(selection.split.blocks) else None

    def seen(self, data: Measurements) -> IntArray:
        """Return the blocks (k,) that rows of a set are about."""
        found = np.unique([] if (whose := self.whose(data)) is None else whose).astype(np.intp)
        return np.asarray(found[found >= 0])

    def photographs(self, data: Measurements, number: IntArray, folded: _Folding) -> Iterator[Block]:
        """Yield the photographs of one set as :meth:`blocks` does rows, what is seen in each ``folded`` into a few.

        ``number`` (N,): the photograph of every row. Where the robot stood is computed once for each.
        """
        frames, tip, whose, c = self._frames, self._links[data.tip], self.whose(data), self._selection.common
        for rows in row_blocks(data, number):
            _, first, own = np.unique(number[rows], return_index=True, return_inverse=True)
            at = np.asarray(first + rows.start, dtype=np.intp)
            tool, target = one_or_all(data.tool[at], data.tools), data.target[at]
            readings, told = data.readings[at], data.conditions.subset(at)
            motion = tip.motion(readings, told)
            base, group, seats = self._stances.observers(data, at, readings, told)
            held = held_at(motion.tip, frames.tools, tool, None, rows)
            tools, targets = rigid.product(base, held), frames.targets[target]
            seen = Seen(data, rows, tools, targets[:0], targets, scalars_of(data, frames))
            observed = of_photographs(seen, *folded(rows, own, photographed(seen, own)))
            in_base = [follow.seen_from(base[..., :3, :3]) for follow in observed.tool]
            J = self._through_robot(data.tip, in_base, motion, held, tool, group)
            for link, on, seat in seats:
                back = [follow.of(on).negative() for follow in in_base]
                J[on] += self._through_robot(link, back, seat, held[on], NO_FRAME, NO_FRAME)
            self._complete(J, data, observed, target)
            by_own, block = (None, None) if whose is None else (J[:, :, c:], whose[at])
            yield Block(rows, readings, observed, J[:, :, :c], by_own, block, (Moved(observed.tool, tools),), ())

    def _complete(self, J: Array, data: Measurements, observed: Linearised, target: IntArray) -> None:
        """Add to derivatives (n, d, c + a) what comes through targets (n,) and scalars."""
        if observed.target is not None:
            self._of_targets.add(observed.target.transpose(2, 1, 0), target, J.transpose(1, 0, 2))
        for role, by_scalar in observed.scalars.items():
            # Hardly any parameter moves a scalar, and a board of free shape has hundreds of these.
            by = self._selection.of_scalars[data.uses[role]]
            for k in np.flatnonzero(by):
                J[:, :, k] += by_scalar * by[k]

    def blocks(self, data: Measurements) -> Iterator[Block]:
        """Yield the rows of one set, block by block; of touches J is that where the tool is at its target."""
        frames, whose, c = self._frames, self.whose(data), self._selection.common
        of_touches = touches(data)
        for rows in row_blocks(data):
            try:
                told = data.conditions_at(frames.scalars, rows, moving=self._robot.weights is not None)
                at = self._stances.at(data, rows, data.readings_at(frames.scalars, rows), told)
                if of_touches:
                    at = self._stances.at_targets(data, rows, at, told)
            except PoseError as e:
                raise named(e, data, rows) from e
            in_base, clock = at.in_base(at.observed.tool), self._clock(data, rows)
            then = None if clock is None else (at.readings, clock)
            tool = one_or_all(data.tool[rows], data.tools)
            J = self._through_robot(data.tip, in_base, at.tip, at.tool, tool, at.group, then)
            if data.other is not None and at.other_tip is not None and at.other_tool is not None:
                other, by_other = one_or_all(data.other.tool[rows], data.tools), at.in_base(at.observed.other)
                J += self._through_robot(data.tip, by_other, at.other_tip, at.other_tool, other, at.group)
            for link, own, seat in at.seats:
                # What is seen from a link that moves, moves the other way.
                back = [follow.of(own).negative() for follow in in_base]
                then = None if clock is None else (at.readings[own], clock.subset(own))
                J[own] += self._through_robot(link, back, seat, at.tool[own], NO_FRAME, NO_FRAME, then)
            self._complete(J, data, at.observed, data.target[rows])
            by_own, block = (None, None) if whose is None else (J[:, :, c:], whose[rows])
            yield Block(rows, at.readings, at.observed, J[:, :, :c], by_own, block, at.moved, at.grounds)

    def _through_robot(
        self,
        link: str,
        follows: Sequence[Follow],
        motion: TipMotion,
        at: Array,
        tool: IntArray | int,
        group: IntArray | int,
        then: "tuple[Array, _Clocked] | None" = None,
    ) -> Array:
        """Return derivatives (n, d, c + a) of numbers that follow a tool on a link, or the link itself, in the base.

        ``at`` (n, 4, 4): where what they follow is in the base. ``tool`` and ``group``, the set-up: numbers (n,) of
        rows, or the one of all; ``NO_FRAME`` where there is none. ``then``: the readings (n,
        nr) of rows of a stream, and how these depend on its clock.
        """
        # By row of the numbers, so that a product leaves all that it makes in one piece.
        d = sum(follow.size for follow in follows)
        found, start = np.empty((d, len(at), self._selection.width)), 0
        for follow in follows:
            own = found[start : (start := start + follow.size)]
            numbers = motion.tip.through(follow, at[:, :3, 3])
            self._by_carriers(link, numbers, tool, group, own)
            J = own.transpose(1, 0, 2)
            if self._robot.loops:
                J += motion.by_passive(numbers) @ (motion.rates @ self._selection.of_robot)
            if self._robot.terms:
                J += _times(motion.through_terms(numbers), self._selection.of_terms)
            if then is not None:
                readings, clock = then
                # The tool moves with the velocity that it has then: minus that is what an offset of the clock does.
                velocity = motion.following(numbers, readings) @ clock.rates[:, :, None]
                J += velocity * clock.by[:, None, :]
        return found.transpose(1, 0, 2)

    def _by_carriers(
        self, link: str, numbers: Array, tool: IntArray | int, group: IntArray | int, found: Array
    ) -> None:
        """Write how numbers follow the parameters (d, n, c + a) through what carries a link, by set-up and tool."""
        if isinstance(group, int) and isinstance(tool, int):
            followed(numbers, self._by_parameters(link, group, tool), found)
            return
        by_robot, tool_twists = self._carrying(link)
        followed(numbers, by_robot, found)
        own, n = self._selection, numbers.shape[-1:]
        own.of_bases.turned(self._at.base_twists).add(numbers[:, 0], np.broadcast_to(group, n), found)
        own.of_tools.turned(tool_twists).add(numbers[:, -1], np.broadcast_to(tool, n), found)

    def _carrying(self, link: str) -> tuple[Array, Array]:
        """Return how local twists of what carries a link follow the robot (6 (w + 1), c + a).

        And the twists (k, 6, 6) that tools have there, in the last of these, for changes of their six values.
        """
        if link not in self._on:
            tip, at = self._links[link], self._at
            tool_twists = rigid.carried(tip.end @ at.frames.tools, at.tool_twists)
            self._on[link] = self._by_parameters(link, NO_FRAME, NO_FRAME), tool_twists
        return self._on[link]

    def _by_parameters(self, link: str, group: int, tool: int) -> Array:
        """Return how local twists of what carries a link follow the parameters (6 (w + 1), c + a).

        With the base of a set-up, none for what is told in another link, and one of the tools, or none.
        """
        key = link, group, tool
        if key not in self._by:
            at, tip = self._at, self._links[link]
            unknowns = self._selection.carried_by(tip.carrying, *key)
            placed = tip.end @ at.frames.tools[tool]
            self._by[key] = tip.follow_with(unknowns, at.base_twists[group], placed, at.tool_twists[tool])
        return self._by[key]

    def _clock(self, data: Measurements, rows: slice) -> "_Clocked | None":
        """Return how the moments of rows follow the parameters, None where they are no stream or no clock is free.

        By mean rates: what rounded readings err by changes from moment to moment, and is least in the middle between
        two samples. By the rates there, a clock would be found that leans to it. Mean rates have no part in these
        errors, as readings at which a tool is at its target have none (:mod:`calib.identification.stances`).
        """
        if data.stream is None or not (roles := [role for role in SHIFTS if role in data.uses]):
            return None
        rates = data.stream.mean_rates(data.shifts(self._frames.scalars), rows)
        by = np.stack([data.stream.by_shift(role, rows) for role in roles], axis=1)
        return _Clocked(rates, by @ self._selection.of_scalars[[data.uses[role] for role in roles]])


def _times(rows: Array, matrix: Array) -> Array:
    """Return rows (n, d, a) times one matrix (a, b) for all, in a single product."""
    return np.asarray((rows.reshape(-1, len(matrix)) @ matrix).reshape(*rows.shape[:2], -1))
