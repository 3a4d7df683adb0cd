"""What was measured of one robot: readings, what was seen of the tool there, and its noise."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, BoolArray, IntArray, read_only_view
from calib.foundations.errors import JobError, MeasurementError, naming_rows
from calib.foundations.ranges import refuse_shape
from calib.foundations.sealing import sealed
from calib.foundations.units import MM
from calib.foundations.words import counted, listed, not_loaded
from calib.measurement.boards import Board
from calib.measurement.instruments import Camera
from calib.measurement.kinds import Kind
from calib.measurement.scalars import Scalar
from calib.measurement.streams.stream import LATENCY, OFFSET, SHIFTS, SKEW, OneClock, Stream
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.gravity import Payload
from calib.robot.robot import Deviations, Robot

# What the only tool of the robot's tip is called, and the only place where the robot stood.
ONLY_TOOL, ONLY_SETUP = "tool", "base"


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class End:
    """One end of every row; some kinds have two. ``readings`` (N, k), ``tool`` (N) and ``conditions`` there.

    ``points`` (N, 3): where in the tool's frame each row's point is; None where all are its origin.
    """

    readings: Array
    tool: IntArray
    conditions: Conditions = NO_CONDITIONS
    points: Array | None = None

    def subset(self, rows: IntArray) -> "End":
        """Return the end of some rows."""
        return _of_rows(self, rows)


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Measurements:
    """N measured rows of one robot; every array is read-only and SI.

    ``readings`` (N, k): rad or m, in the order of ``reading_names``.
    ``position`` (N, 3): the measured point in m, in the instrument's frame; None where none is.
    ``orientation`` (N, 3, 3): the measured rotation in the instrument's frame, of poses only.
    ``value`` (N, v): what other kinds measure, in m: the length of a ``distance`` or ``pair_distance``, the radius at
    which a ``sphere`` is touched, the height above a ``plane``, what an ``indicator`` shows. A ``socket`` has none;
    ``pixels`` have u and v in px, then where the mark is on its board (x, y, z).
    ``sigma`` (N, d), with d numbers in a row's residual: the instrument's standard deviations, 0 where unknown, to be
    estimated from the residuals.
    ``tool`` (N): which of ``tools``, the tools on the tip link that were measured, in order of appearance.
    ``setup`` (N): which of ``setups``, the places where the robot's base stood.
    ``target`` (N): which of ``targets``, the sockets, anchors, planes, balls, or what is on the floor of camera and
    board; -1 in kinds that have none.
    ``other``: the second end of a ``pair_distance``. ``uses``: which of ``scalars``, unknown numbers beside poses, the
    rows depend on, by what it is to them: the ``offset`` of lengths, the ``radius`` of a ball.
    ``group``: N words, None where the table has no such column.
    ``conditions``: what else the rows carry.
    ``points`` (N, 3): where in the tool's frame each row's point is, in m, as a scanner or a depth camera on the robot
    saw it; None where all are the tool's own.
    ``lines`` (N): where a row stands in ``where``, as in :class:`calib.measurement.table.Table`.
    ``camera``: by which ``pixels`` were seen, ``board``: of what, where that is a board of which something is unknown;
    ``mark`` (N): which of its marks, where its shape is not flat.
    ``tip``: the link that carries the tools; the robot's own where it is empty. ``target_links``: links of the robot
    that carry targets, by the targets' names; others stand on the floor. ``absent``: readings that no column tells,
    since they do not move the tip; they are 0. ``unused``: joints whose columns nothing needs.
    ``unreached``: how many rows were left out, of which the order of rows tells no side.
    ``times`` (N,): when rows were measured, in s, None where no column says. ``stream``: of rows whose readings another
    stream has, by its own clock; ``readings`` are then those by the clock as it is known so far.
    """

    kind: Kind
    reading_names: tuple[str, ...]
    readings: Array
    position: Array | None
    orientation: Array | None
    value: Array
    sigma: Array
    tools: tuple[str, ...]
    tool: IntArray
    setups: tuple[str, ...]
    setup: IntArray
    targets: tuple[str, ...]
    target: IntArray
    other: End | None
    scalars: tuple[Scalar, ...]
    uses: Mapping[str, int]
    group: tuple[str, ...] | None
    where: str
    lines: IntArray
    conditions: Conditions = NO_CONDITIONS
    camera: Camera | None = None
    board: Board | None = None
    mark: IntArray | None = None
    tip: str = ""
    target_links: Mapping[str, str] = field(default_factory=dict)
    absent: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()
    unreached: int = 0
    points: Array | None = None
    times: Array | None = None
    stream: Stream | None = None

    def __len__(self) -> int:
        return len(self.lines)

    def __repr__(self) -> str:
        known = "stated" if np.isfinite(self.sigma).all() else "not stated"
        beside = {"tools": self.tools, "set-ups": self.setups, "targets": self.targets}
        said = [f"{what} {listed(names, most=4)}" for what, names in beside.items() if names]
        rows = f"{counted(len(self), 'row')} of {self.kind} at {counted(len(self.reading_names), 'joint')}"
        return f"<Measurements {self.where}: {rows}; {'; '.join(said)}; sigma {known}>"

    @checked
    def shifts(self, scalars: Array) -> dict[str, float]:
        """Return what the scalars (s,) make of the clock of a stream."""
        return {role: float(scalars[self.uses[role]]) for role in SHIFTS if role in self.uses}

    @property
    def clock(self) -> OneClock:
        """The free clock of a stream, for another stream that goes by it. Raises JobError where there is none."""
        if self.stream is None or SKEW not in self.uses or LATENCY in self.uses:
            raise JobError(f"{self.where}: has no free clock of its own, by which another stream could go.")
        offset, skew = (self.scalars[self.uses[role]] for role in (OFFSET, SKEW))
        return OneClock(self.stream.middle, offset, skew, self.where)

    @checked
    def readings_at(self, scalars: Array, rows: slice = slice(None)) -> Array:
        """Return the readings (n, k) of rows where scalars (s,) have these values: those of a stream follow them."""
        if self.stream is None:
            return self.readings[rows]
        return self.stream.readings(self.shifts(scalars), rows)

    @checked
    def conditions_at(self, scalars: Array, rows: slice = slice(None), *, moving: bool = True) -> Conditions:
        """Return the conditions of rows where scalars (s,) have these values; ``moving``: with how the joints moved."""
        told = self.conditions.subset(rows)
        if self.stream is None or not moving:
            return told
        return replace(told, motion=self.stream.motion(self.shifts(scalars), rows))

    @checked
    def at_clock(self, scalars: Array) -> "Measurements":
        """Return the rows with the readings that they have where scalars (s,) have these values."""
        if self.stream is None:
            return self
        return replace(self, readings=read_only_view(self.readings_at(scalars)))

    def at_readings(self) -> "Measurements":
        """Return the rows as a table that has their readings beside them, with no clock to be found."""
        if self.stream is None:
            return self
        return replace(self, stream=None, uses={role: k for role, k in self.uses.items() if role not in SHIFTS})

    @property
    def ends(self) -> tuple[End, ...]:
        """Where the robot was: the one end of every row, and the other one in kinds that have two."""
        own = End(self.readings, self.tool, self.conditions, self.points)
        return (own,) if self.other is None else (own, self.other)

    @checked
    def tips(self, robot: Robot, deviations: Deviations | None = None) -> Array:
        """Return the placements (N, 4, 4) of the link with the tools in the base link, under the rows' conditions.

        Raises as :meth:`calib.Robot.tips` does.
        """
        with naming_rows(self.where, self.lines):
            own = self.loaded(robot).conditions
            return robot.with_tip(self.tip or robot.tip).tips(self.readings, deviations, own)

    @checked
    def reach(self, robot: Robot) -> float:
        """Return an upper bound in m of how far the tip was from the base; 1 mm of a robot that goes nowhere."""
        return max(robot.reach_at(self.readings), 1.0 * MM)

    @checked
    def links_about(self, robot: Robot) -> frozenset[str]:
        """Return the links that rows are about: the one with the tools, and those of the targets that are seen."""
        of_targets = (self.target_links[name] for name in self.seen_targets if name in self.target_links)
        return frozenset((self.tip or robot.tip, *of_targets))

    @checked
    def carrying(self, robot: Robot, payload: Payload) -> "Measurements":
        """Return the rows as measured with a payload: on the link that it names, else on the one with the tools.

            heavy = calib.read_measurements("heavy.csv", robot).carrying(robot, calib.measuring.Payload(2.5))

        Raises MeasurementError where the robot was not loaded with that link.
        """
        link = payload.link or self.tip or robot.links[0]
        if link not in robot.links:
            raise MeasurementError(f"{self.where}: the payload's link {not_loaded(link, robot.links)}.")
        moments = robot.moments(replace(payload, link=link))
        moments[[other != link for other in robot.links]] = np.nan
        every = np.tile(moments, (len(self), 1, 1))
        return self._told(lambda told: replace(told, payload=_where_unsaid(told.payload, every)))

    @checked
    def loaded(self, robot: Robot) -> "Measurements":
        """Return the rows under gravity and payload of their set-ups, where nothing else is told of them."""
        if not robot.loads:
            return self
        loads = [robot.load_in(name) for name in self.setups]
        gravity = np.array([load.gravity for load in loads])[self.setup]
        payload = np.array([robot.moments(load.payload) for load in loads])[self.setup]

        def under(told: Conditions) -> Conditions:
            return replace(
                told, gravity=_where_unsaid(told.gravity, gravity), payload=_where_unsaid(told.payload, payload)
            )

        return self._told(under)

    def _told(self, more: Callable[[Conditions], Conditions]) -> "Measurements":
        """Return the rows with more told of both ends."""
        other = self.other
        return replace(
            self,
            conditions=more(self.conditions),
            other=None if other is None else replace(other, conditions=more(other.conditions)),
        )

    @checked
    def placed_by(self, tools: Array) -> Array:
        """Return the placements (N, 4, 4) of the rows' points in the link that carries them, by its tools (k, 4, 4).

        Raises MeasurementError for tools of another shape.
        """
        refuse_shape(tools, (len(self.tools), 4, 4), f"{self.where}: tools", MeasurementError)
        placed = tools[self.tool]
        return placed if self.points is None else np.asarray(placed @ rigid.translation(self.points))

    @checked
    def link_of(self, target: int) -> str | None:
        """Return the link that carries a target, by its number; None where it stands on the floor.

        Raises MeasurementError where there is no such target.
        """
        try:  # it is asked for every row
            return self.target_links.get(self.targets[target]) if target >= 0 else None
        except (IndexError, TypeError) as e:
            raise MeasurementError(f"{self.where}: there is no such target among {len(self.targets)} ({e}).") from e

    @property
    def seen_targets(self) -> tuple[str, ...]:
        """Those of ``targets`` that some row is about."""
        return tuple(self.targets[t] for t in np.unique(self.target) if t >= 0)

    @property
    def of_boards(self) -> bool:
        """Whether pixels tell more than where one point is: marks stand at known places of a board."""
        return bool(self.camera is not None and self.value[:, 2:].any())

    @checked
    def named(
        self, *, tool: str | None = None, setup: str | None = None, on: Mapping[str, str] | None = None
    ) -> "Measurements":
        """Return the rows as measured with one named tool, with the robot in one named place, of targets on links.

            left = calib.read_measurements("from_the_left.csv", robot).named(setup="left")
            touched = calib.read_measurements("touched.csv", robot, "socket").named(on={"cone": "right_hand"})

        ``on``: links of the robot that carry targets. Raises MeasurementError when columns of the table say tool or
        set-up already, and for a target on the link that carries the tool.
        """
        links = {**self.target_links, **{name: link for name, link in (on or {}).items() if name in self.targets}}
        for target, carrier in links.items():
            if carrier == self.tip:
                raise MeasurementError(
                    f"{self.where}: the target {target!r} is on {carrier!r}, which carries the tool as well: a row "
                    "needs two frames that move relative to each other."
                )
        for what, name, own, only in (
            ("tool", tool, self.tools, self.tools[0] if self.tools == (self.tip,) else ONLY_TOOL),
            ("setup", setup, self.setups, ONLY_SETUP),
        ):
            if name is not None and own != (only,):
                raise MeasurementError(
                    f"{self.where}: the {what} is given twice, as {name!r} and by column {what!r}; keep one."
                )
        return replace(
            self,
            tools=self.tools if tool is None else (tool,),
            setups=self.setups if setup is None else (setup,),
            target_links=links,
        )

    @checked
    def at(self, setup: str) -> "Measurements":
        """Return the rows of one set-up, as if there were no other; there may be none."""
        rows = np.isin(self.setup, [k for k, name in enumerate(self.setups) if name == setup])
        found = self.subset(rows)
        return replace(found, setups=(ONLY_SETUP,), setup=read_only_view(np.zeros(len(found), dtype=np.intp)))

    def with_own_names(self) -> "Measurements":
        """Return the measurements with those of ``tools``, ``setups`` and ``targets`` alone that some row has.

        Nothing is then known, or looked for, of the others.
        """
        tools, number = _used(self.tools, *(end.tool for end in self.ends))
        setups, setup = _used(self.setups, self.setup)
        targets, target = _used(self.targets, self.target)
        other = self.other
        return replace(
            self,
            tools=tools,
            tool=read_only_view(number[self.tool]),
            setups=setups,
            setup=read_only_view(setup[self.setup]),
            targets=targets,
            target=read_only_view(target[self.target]),
            other=None if other is None else replace(other, tool=read_only_view(number[other.tool])),
        )

    @checked
    def subset(self, rows: IntArray | BoolArray | Sequence[int]) -> "Measurements":
        """Return the measurements of some rows, by position or by mask (N); the names stay.

        Raises MeasurementError when there are no such rows.
        """
        if np.ndim(rows) != 1:
            raise MeasurementError(
                f"{self.where}: rows are a list of numbers, or a mask, and no {np.ndim(rows)}-d array."
            )
        try:
            index = np.arange(len(self))[np.asarray(rows, dtype=None if len(rows) else np.intp)]
        except IndexError as e:
            raise MeasurementError(f"{self.where}: there are no such rows among {len(self)} ({e}).") from e
        group = None if self.group is None else tuple(self.group[i] for i in index)
        return replace(_of_rows(self, index), group=group)


def as_sets(measurements: Measurements | Sequence[Measurements]) -> tuple[Measurements, ...]:
    """Return one or several sets of measurements as several. Raises MeasurementError when there is none."""
    sets = (measurements,) if isinstance(measurements, Measurements) else tuple(measurements)
    if not sets:
        raise MeasurementError("there are no measurements to identify from.")
    return sets


def refuse_absent(robot: Robot, data: Measurements) -> None:
    """Raise MeasurementError for rows whose table lacks the readings of joints that bear on what they are about."""
    # What hangs on a joint that moves a link pulls at it, wherever that is.
    bearing = robot.bearing_on(data.links_about(robot)) if data.absent else ()
    if missing := [name for name in data.absent if name in bearing]:
        raise MeasurementError(
            f"{data.where}: there is no column {', '.join(map(repr, missing))} of a joint, which is needed for "
            f"{'loads on joints that give way' if robot.weights is not None else 'the places of targets'}."
        )


_Rows = TypeVar("_Rows", "End", "Measurements")


def reach_of(robot: Robot, sets: Iterable[Measurements]) -> float:
    """Return an upper bound in m of how far the tip was from the base in several sets."""
    return max((data.reach(robot) for data in sets), default=0.0)


def _of_rows(whole: _Rows, rows: IntArray) -> _Rows:
    """Return some rows of a record whose arrays, and records inside, have a row for each of its own."""
    taken: dict[str, Any] = {}
    for name in (one.name for one in fields(whole)):
        value = getattr(whole, name)
        if isinstance(value, np.ndarray):
            taken[name] = read_only_view(value[rows])
        elif isinstance(value, End | Conditions | Stream):
            taken[name] = value.subset(rows)
    return replace(whole, **taken)


def numbered(numbers: IntArray) -> Iterator[tuple[int, IntArray]]:
    """Yield every number of rows (N,), the least first, with the rows that have it."""
    order = np.argsort(numbers, kind="stable")
    there, starts = np.unique(numbers[order], return_index=True)
    yield from zip(there.tolist(), np.split(order, starts[1:]), strict=len(order) > 0)


def _where_unsaid(told: Array | None, otherwise: Array) -> Array:
    """Return what is told of rows, and something else where that is NaN."""
    return read_only_view(otherwise if told is None else np.where(np.isnan(told), otherwise, told))


def _used(names: Sequence[str], *numbers: IntArray) -> tuple[tuple[str, ...], IntArray]:
    """Return the names that some row has, and the new number of every old one; -1 stays what it is: none."""
    there = np.unique(np.concatenate(numbers))
    there = there[there >= 0]
    new = np.full(len(names) + 1, -1, dtype=np.intp)
    new[there] = np.arange(len(there))
    return tuple(names[k] for k in there), new
