"""The whitened least-squares system of all measurements, reduced block by block to a small triangle.

For residuals r (m) and Jacobian J (m, p) only ``[J r] = Q [R c; 0 s]`` matters to a least-squares solver: the triangle
has the same cost, gradient and Gauss-Newton matrix as the full system. It is accumulated over blocks of rows, so that
memory does not grow with rows times parameters.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import PoseError
from calib.identification.arrow import Arrow, Collected, Heads, Part, Split, gathered
from calib.identification.error_model import ErrorModel
from calib.identification.identifiability import RANK_TOLERANCE
from calib.identification.losses import Loss
from calib.identification.machine import Frames, Layout, Machine, machine
from calib.identification.observations import observe
from calib.identification.observations.seen import Linearised, Seen
from calib.identification.parameters import Entries, Parameter, scales
from calib.identification.relations import Relation, relate
from calib.identification.set_up_motions import Motions, SetUpMotions, TargetsFollowed, motions, taken_out
from calib.identification.targets import split_of
from calib.identification.together import Together
from calib.measurement.kinds import QUANTITIES, WITH_TARGET
from calib.measurement.measurements import Measurements
from calib.measurement.streams.stream import SHIFTS
from calib.robot.conditions import Conditions
from calib.robot.robot import Deviations, Nominals, Robot, TipModel, TipMotion

# Measured numbers in a block: so many that a call costs little beside them, few enough that memory does not grow.
BLOCK = 3072


class Component(NamedTuple):
    """Rows of one physical quantity in one set of measurements, which share a noise model."""

    measurements: int
    quantity: str  # as in calib.measurement.kinds
    columns: slice


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The unknowns, the frames they are relative to, and the measurements that are to be explained.

    ``held``: deviations of the robot where they are not free; zero when None. ``relations``: what is known between
    targets. ``given_losses``: one for each set; least squares for all when None. ``nominals``: what does not follow the
    unknowns, made once. ``together``: of every set, how rows of a photograph err together; none do where it is empty.
    """

    model: ErrorModel
    parameters: tuple[Parameter, ...]
    reference: Frames
    measurements: tuple[Measurements, ...]
    held: Deviations | None = None
    relations: tuple[Relation, ...] = ()
    given_losses: tuple[Loss, ...] | None = None
    nominals: Nominals = field(default_factory=Nominals)
    together: tuple[Together | None, ...] = ()

    @property
    def losses(self) -> tuple[Loss, ...]:
        """The loss of every set."""
        linear: Loss = "linear"
        return (linear,) * len(self.measurements) if self.given_losses is None else self.given_losses

    def whitened(self, i: int, rows: slice, whitened: Array) -> Array:
        """Return rows (n, d, k) of set i over their sigmas, less what those of a photograph have in common."""
        together = self.together[i] if self.together else None
        return whitened if together is None else together.less(whitened, rows)

    @property
    def robust(self) -> bool:
        """Whether rows that lie off weigh less."""
        return any(loss != "linear" for loss in self.losses)

    @property
    def components(self) -> tuple[Component, ...]:
        """The groups of residuals that share a noise model."""
        return tuple(
            Component(i, quantity.name, quantity.columns)
            for i, data in enumerate(self.measurements)
            for quantity in QUANTITIES[data.kind]
        )

    @property
    def motions(self) -> Motions | None:
        """How the whole set-up may move with no effect on what is measured."""
        return motions(self.measurements, self.model.targets, self.relations, self.reference.base[:3, 3])

    @property
    def split(self) -> Split:
        """Which parameters are common, and which those of a target: of many rows or of a few.

        Known relations join targets to each other. A width that is to be learned is judged by all that is unknown.
        """
        if any(parameter.group is not None for parameter in self.parameters):
            return Split.none(len(self.parameters))
        names = self.measurements[0].targets if self.measurements else ()
        related = {name for relation in self.relations for name in relation.targets}
        joined = {t for t, name in enumerate(names) if name in related}
        return split_of(self.parameters, Layout.of(self.model.robot, self.reference), joined)

    def machine(self, x: Array) -> Machine:
        """Return the machine at parameter values x (p,)."""
        return machine(self.model.robot, self.parameters, self.reference, x, self.held)

    def residuals(self, x: Array) -> tuple[Array, ...]:
        """Return the residuals (N, d) of every set at parameter values x (p,)."""
        return residuals(self.model.robot, self.measurements, self.machine(x))

    def evaluate(self, sigmas: Sequence[Array], x: Array) -> "Evaluation":
        """Return :func:`evaluate` of this problem, targets told apart."""
        return evaluate(self, sigmas, x)


class Block(NamedTuple):
    """Rows of one set: residuals with derivatives by twists, and their Jacobian (n, d, c) by common parameters.

    ``own`` (n, d, a): their derivatives by the parameters of the row's target, of a ``block`` (n,); both are None where
    all are common. ``moved``: derivatives by the local twist (n, d, 6) and placements (n, 4, 4) of the tools, and of
    other ends. ``grounds``: which of the rows are told in which link, None being the floor.
    """

    rows: slice
    observed: Linearised
    J: Array
    own: Array | None
    block: IntArray | None
    moved: tuple[tuple[Array, Array], ...]
    grounds: tuple[tuple[str | None, IntArray | slice], ...]


class Rows(NamedTuple):
    """All that data say, nothing of motions that they cannot see: of every component its heads and the rest, and all.

    ``whole``: the components, and the relations between targets.
    """

    components: tuple[Part, ...]
    whole: Arrow


class Evaluation(NamedTuple):
    """Residuals of every set (N, d) in m and rad, and ``[J r]`` of every component, reduced.

    That is a triangle (q, c + 1) by the common parameters of the ``split``, and ``heads`` of blocks, by these and by
    their own. Without a split all are common. Columns of J are scaled: they are derivatives for a change of each
    parameter by its scale. Rows are whitened by the sigmas that were given. ``relations`` (k, c + 1): ``[J r]`` of what
    is known between targets, whitened. ``set_up_motions`` (c, k): unit directions in which the whole set-up turns, and
    grows, unmeasured, the blocks following; zeros are none.
    """

    residuals: tuple[Array, ...]
    triangles: tuple[Array, ...]
    relations: Array
    set_up_motions: Array
    heads: tuple[Heads, ...] = ()
    given_split: Split | None = None

    @property
    def split(self) -> Split:
        """Which parameters are common, and which are of one target each."""
        return Split.none(len(self.set_up_motions)) if self.given_split is None else self.given_split

    def reweighted(self, factors: Sequence[float] | Array) -> "Evaluation":
        """Return what it is with sigmas that are new by one factor for every component."""
        triangles = tuple(triangle / f for triangle, f in zip(self.triangles, factors, strict=True))
        heads = tuple(own._replace(rows=own.rows / f) for own, f in zip(self.heads, factors, strict=False))
        return self._replace(triangles=triangles, heads=heads)

    @property
    def alone(self) -> tuple[Part, ...]:
        """The rows of every component."""
        (_, a), c = self.split.blocks.shape, len(self.split.common)
        none = Heads(np.zeros(0, dtype=np.intp), np.zeros((0, a, a + c + 1)))
        heads = self.heads or (none,) * len(self.triangles)
        return tuple(Part(self.split, *parts) for parts in zip(heads, self.triangles, strict=True))

    @property
    def rows(self) -> Rows:
        """All that the data say: of every component, and of all with the relations."""
        split, parts = self.split, self.alone
        whole = gathered(split, [own.heads for own in parts], [*self.triangles, self.relations])
        if not self.set_up_motions.size:
            return Rows(parts, whole)
        reduced = whole.reduced(RANK_TOLERANCE)
        follow, Q = reduced.follow, taken_out(reduced.rest[:, :-1], self.set_up_motions)
        return Rows(tuple(own.without(follow, Q) for own in parts), whole.without(follow, Q))


def evaluate(problem: Problem, sigmas: Sequence[Array], x: Array, given: Split | None = None) -> Evaluation:
    """Evaluate residuals and reduced Jacobians at parameter values x (p,); ``sigmas``: an (N, d) array for each set.

    ``given``: another split than the problem's own.
    """
    split, at = problem.split if given is None else given, problem.machine(x)
    whole = _set_up_motions(problem, split)
    rates = Rates(problem, at, scales(problem.parameters), split)
    a, c = split.blocks.shape[1], len(split.common)
    components = list(enumerate(problem.components))
    collected = [
        Collected(rates.seen(problem.measurements[component.measurements]), len(split.blocks), a, c)
        for _, component in components
    ]
    found: list[Array] = []
    for i, (data, sigma) in enumerate(zip(problem.measurements, sigmas, strict=True)):
        left = np.empty(data.sigma.shape)
        of_set = [(collected[k], component.columns) for k, component in components if component.measurements == i]
        for block in rates.blocks(data):
            residual, s = block.observed.residual, sigma[block.rows, :, None]
            whitened = problem.whitened(i, block.rows, np.concatenate([block.J, residual[:, :, None]], axis=2) / s)
            left[block.rows] = whitened[:, :, -1] * s[:, :, 0] if problem.together else residual
            if whole is not None:
                whole.add(block.J, block.moved, sigma[block.rows], block.grounds)
            for own, columns in of_set:
                turned = None if block.own is None else problem.whitened(i, block.rows, block.own / s)[:, columns]
                own.add(whitened[:, columns], turned, block.block)
        found.append(left)
    related, set_up_motions = _of_the_whole(problem, rates, at, whole)
    triangles, heads = tuple(own.rest for own in collected), tuple(own.heads for own in collected)
    return Evaluation(tuple(found), triangles, related, set_up_motions, heads, split)


def without_rows(problem: Problem, sigmas: Sequence[Array], x: Array) -> tuple[Array, Array]:
    """Return the relations (k, p + 1) and set-up motions (p, k) of an :class:`Evaluation`, which no row is needed for.

    Rows are looked at only where the set-up may move, which they tell how to weigh. All parameters are common.
    """
    at, split = problem.machine(x), Split.none(len(problem.parameters))
    whole = _set_up_motions(problem, split)
    rates = Rates(problem, at, scales(problem.parameters))
    if whole is not None:
        for data, sigma in zip(problem.measurements, sigmas, strict=True):
            for block in rates.blocks(data):
                whole.add(block.J, block.moved, sigma[block.rows], block.grounds)
    return _of_the_whole(problem, rates, at, whole)


def _set_up_motions(problem: Problem, split: Split) -> SetUpMotions | None:
    moving, parameters = problem.motions, [problem.parameters[k] for k in split.common]
    return None if moving is None else SetUpMotions(parameters, moving, problem.model.robot.reach)


def _of_the_whole(problem: Problem, rates: "Rates", at: Machine, whole: SetUpMotions | None) -> tuple[Array, Array]:
    """Return what is known between targets (k, c + 1), and directions (c, k) in which the whole set-up moves."""
    names = problem.measurements[0].targets if problem.measurements else ()
    numbers = sorted({names.index(name) for relation in problem.relations for name in relation.targets})
    J, r = relate(problem.relations, [names[t] for t in numbers], at.frames.targets[numbers])
    related = np.column_stack([np.einsum("kmi,mic->kc", J, rates.of_targets.twists(numbers)), r])
    if whole is None:
        return related, np.zeros((related.shape[1] - 1, 0))
    return related, whole.directions(problem.measurements, at, rates.of_targets, rates.of_scalars)


def jacobian(problem: Problem, x: Array) -> tuple[Array, ...]:
    """Return the unwhitened Jacobians (N, d, p) of the residuals, in m and rad per SI unit of each parameter."""
    rates, found = Rates(problem, problem.machine(x), np.ones(len(problem.parameters))), []
    for data in problem.measurements:
        J = np.empty((*data.sigma.shape, len(problem.parameters)))
        for block in rates.blocks(data):
            J[block.rows] = block.J
        found.append(J)
    return tuple(found)


def residuals(robot: Robot, measurements: Sequence[Measurements], at: Machine) -> tuple[Array, ...]:
    """Return the residuals (N, d) of every set, measured minus predicted, in SI units, for a machine."""
    links, found = _Links(robot, at.deviations), []
    for data in measurements:
        residual = np.empty(data.sigma.shape)
        for rows in _blocks(data):
            with _naming(data, rows):
                readings = data.readings_at(at.frames.scalars, rows)
                told = data.conditions_at(at.frames.scalars, rows, moving=robot.weights is not None)
                tips = links[data.tip].tips(readings, told)
                others = None
                if data.other is not None:
                    others = links[data.tip].tips(data.other.readings[rows], data.other.conditions.subset(rows))
                base = _bases(at.frames, data, rows)
                for link, own in _on_links(data, rows):
                    base[own] = rigid.inverse(links[link].tips(readings[own], told.subset(own)))
            # In the order of operations in which the Jacobian's rows are made: both give the same bits.
            placed = base @ (tips @ at.frames.tools[data.tool[rows]])
            placed = _shifted(placed, data.points, rows)
            residual[rows] = _observe(data, rows, at.frames, placed, base, others).residual
        found.append(residual)
    return tuple(found)


class _Links(dict[str, TipModel]):
    """Models of a robot with deviations, by the link that they look at; "" is the robot's tip."""

    def __init__(self, robot: Robot, deviations: Deviations, nominals: Nominals | None = None) -> None:
        super().__init__()
        self._robot, self._deviations, self._nominals = robot, deviations, Nominals() if nominals is None else nominals

    def __missing__(self, link: str) -> TipModel:
        found = TipModel(self._robot.with_tip(link or self._robot.tip), self._deviations, self._nominals[self._robot])
        self[link] = found
        return found


def _blocks(data: Measurements) -> Iterator[slice]:
    """Yield the rows of a set, few enough at a time; what a camera sees in one photograph is not parted."""
    size, start = BLOCK // data.sigma.shape[1], 0
    cuts = _between_photographs(data) if data.kind == "pixels" and len(data) > size else None
    while start < len(data):
        end = min(start + size, len(data))
        if cuts is not None:
            end = int(
                cuts[max(np.searchsorted(cuts, end, side="right") - 1, np.searchsorted(cuts, start, side="right"))]
            )
        yield slice(start, end)
        start = end


def _between_photographs(data: Measurements) -> IntArray:
    """Return the numbers of rows before which no photograph has begun that goes on, the end being one."""
    number = photograph_numbers(data)
    last = np.zeros(int(number.max(initial=0)) + 1, dtype=np.intp)
    last[number] = np.arange(len(number))
    until = np.maximum.accumulate(last[number])
    return np.append(np.flatnonzero(until[:-1] < np.arange(1, len(number))) + 1, len(number))


def photograph_numbers(data: Measurements) -> IntArray:
    """Return the photograph (N,) of every row: rows of one target and tool with the same readings."""
    at = np.column_stack([data.readings, data.tool, data.setup, data.target])
    return np.asarray(np.unique(at, axis=0, return_inverse=True)[1].ravel(), dtype=np.intp)


def _bases(frames: Frames, data: Measurements, rows: slice) -> Array:
    """Return the bases (n, 4, 4) of some rows, or the only one (4, 4)."""
    if len(frames.bases) == 1 and not data.target_links:
        return np.asarray(frames.bases[0])
    return np.asarray(frames.bases[data.setup[rows]])


def _on_links(data: Measurements, rows: slice) -> Iterator[tuple[str, IntArray]]:
    """Yield the links that carry targets of some rows, with the numbers of these among them."""
    if not data.target_links:
        return
    links = [data.link_of(int(t)) for t in data.target[rows]]
    for link in dict.fromkeys(links):
        if link is not None:
            yield link, np.array([n for n, other in enumerate(links) if other == link], dtype=np.intp)


@contextmanager
def _naming(data: Measurements, rows: slice) -> Iterator[None]:
    """Name the row of a set in which a loop does not close."""
    try:
        yield
    except PoseError as e:
        row = rows.start + e.row
        line = f"{data.where}:{data.lines[row]}"
        raise PoseError(row, e.reason, [rows.start + row for row in e.rows], line) from e


def _observe(
    data: Measurements, rows: slice, frames: Frames, tools: Array, base: Array, others: Array | None
) -> Linearised:
    """Return what rows leave unexplained: tools and the base (n, 4, 4) in the observer, other ends' tips in the base.

    The observer is the floor, in whose frame instruments measure, or the link that carries a row's target.
    """
    targets = frames.targets[data.target[rows] if data.kind in WITH_TARGET else slice(0)]
    ends = frames.targets[:0]
    if data.other is not None and others is not None:
        ends = base @ others @ _shifted(frames.tools[data.other.tool[rows]], data.other.points, rows)
    scalars = {role: float(frames.scalars[k]) for role, k in data.uses.items() if role not in SHIFTS}
    return observe(data.kind, Seen(data, rows, tools, ends, targets, scalars))


def _shifted(frames: Array, points: Array | None, rows: slice) -> Array:
    """Return frames (n, 4, 4) moved to some rows' points in them, turned as they are."""
    return frames if points is None else np.asarray(frames @ rigid.translation(points[rows]))


def _as_tool(twist: Array, points: Array | None, rows: slice) -> Array:
    """Return derivatives (n, d, 6) by the tool's local twist from those by that of a frame at the row's point."""
    return twist if points is None else np.asarray(twist @ rigid.adjoint(rigid.translation(-points[rows])))


def blocks(problem: Problem, data: Measurements, at: Machine, units: Array) -> Iterator[Block]:
    """Yield the rows of one set, block by block; derivatives are taken for ``units`` (p,) of every parameter."""
    yield from Rates(problem, at, units).blocks(data)


class _Carried(NamedTuple):
    """How frames on one link follow the parameters: the tools there, and the link itself.

    ``joints`` (b + 1, 6 w, p): local twists of the placements of joints on the way, those of the base in every set-up
    with them, and last without a base, for what is told in another link. ``tools`` and ``link`` (6, p): what lies
    behind the last joint, and of tools their own poses.
    """

    joints: Array
    tools: Array
    link: Array


class _Clocked(NamedTuple):
    """Rates (n, k) of the readings of rows of a stream, and how the controller's time (n, p) follows the parameters."""

    rates: Array
    by: Array

    def subset(self, rows: IntArray) -> "_Clocked":
        return _Clocked(self.rates[rows], self.by[rows])


class Rates:
    """How tools and targets follow the parameters at a machine, for ``units`` (p,) of each: the same for all sets.

    ``split``: parameters of blocks are told apart, in columns of their own; all are common when None.
    """

    def __init__(self, problem: Problem, at: Machine, units: Array, split: Split | None = None) -> None:
        frames, robot = at.frames, problem.model.robot
        layout = Layout.of(robot, frames)
        split = Split.none(len(units)) if split is None else split
        every = Entries.of(problem.parameters)
        every = every._replace(share=every.share * units[every.parameter])
        column = np.full(len(units), -1, dtype=np.intp)
        column[split.common] = np.arange(len(split.common))

        def by_common(start: int, end: int) -> Array:
            """Return how a part of the state (end - start, c) follows the common parameters."""
            S = np.zeros((end - start, len(split.common)))
            k = np.flatnonzero((every.entry >= start) & (every.entry < end) & (column[every.parameter] >= 0))
            S[every.entry[k] - start, column[every.parameter[k]]] = every.share[k]
            return S

        self._robot, self._frames, self._links = robot, frames, _Links(robot, at.deviations, problem.nominals)
        self._of_robot, self._of_terms = by_common(0, layout.terms), by_common(layout.terms, layout.base)
        self.of_scalars = by_common(layout.scalars, layout.size)
        c = len(split.common)
        self._of_tools = at.tool_twists @ by_common(layout.tools, layout.targets).reshape(len(frames.tools), 6, c)
        self._of_bases = at.base_twists @ by_common(layout.base, layout.tools).reshape(len(frames.bases), 6, c)
        self._to_tool = rigid.adjoint(rigid.inverse(frames.tools))
        self.of_targets, self._by_own = _targets_followed(every, column, split, layout, at)
        # Of every target its number among those that follow common parameters, and its block; -1 for none.
        self._common = np.full(len(frames.targets) + 1, -1, dtype=np.intp)
        self._common[self.of_targets.numbers] = np.arange(len(self.of_targets.numbers))
        self._block = np.full(len(frames.targets) + 1, -1, dtype=np.intp)
        if split.blocks.size:
            first = every.entry[np.searchsorted(every.parameter, split.blocks[:, 0])]
            self._block[(first - layout.targets) // 6] = np.arange(len(split.blocks))
        self._carried: dict[str, _Carried] = {}

    def seen(self, data: Measurements) -> IntArray:
        """Return the blocks (k,) that rows of a set are about."""
        found = np.unique(self._block[data.target]) if data.kind in WITH_TARGET else np.zeros(0, dtype=np.intp)
        return np.asarray(found[found >= 0])

    def blocks(self, data: Measurements) -> Iterator[Block]:
        """Yield the rows of one set, block by block."""
        frames, tip, none = self._frames, self._links[data.tip], len(self._frames.bases)
        for rows in _blocks(data):
            base, group, others = _bases(frames, data, rows), data.setup[rows], None
            with _naming(data, rows):
                told = data.conditions_at(frames.scalars, rows, moving=self._robot.weights is not None)
                readings = data.readings_at(frames.scalars, rows)
                motion = tip.motion(readings, told)
                if data.other is not None:
                    others = tip.motion(data.other.readings[rows], data.other.conditions.subset(rows))
                seats = [
                    (link, own, self._links[link].motion(readings[own], told.subset(own)))
                    for link, own in _on_links(data, rows)
                ]
            for _, own, seat in seats:
                base[own] = rigid.inverse(seat.placement)
                group = np.array(group)
                group[own] = none
            tool = self._tool(data.tool[rows])
            at_tool = motion.placement @ frames.tools[tool]
            placed = base @ at_tool
            other_ends = None if others is None else others.placement
            observed = _observe(data, rows, frames, _shifted(placed, data.points, rows), base, other_ends)
            # A point that is fixed to the tool moves with it.
            observed = observed._replace(twist=_as_tool(observed.twist, data.points, rows))
            J = self._through_robot(data.tip, observed.twist, motion, at_tool, tool, group)
            clock = self._clock(data, rows)
            if clock is not None:
                J += self._through_time(data.tip, observed.twist, motion, tool, readings, told, clock)
            moved = [(observed.twist, placed)]
            if data.other is not None and others is not None and observed.other is not None:
                tool, by_other = self._tool(data.other.tool[rows]), _as_tool(observed.other, data.other.points, rows)
                at_tool = others.placement @ frames.tools[tool]
                moved.append((by_other, base @ at_tool))
                J += self._through_robot(data.tip, by_other, others, at_tool, tool, group)
            for link, own, seat in seats:
                # The observer moved by xi: what is seen from it moves by -Ad(T^-1) xi.
                by_seat = -observed.twist[own] @ rigid.adjoint(rigid.inverse(placed[own]))
                J[own] += self._through_robot(link, by_seat, seat, seat.placement, None, group[own])
                if clock is not None:
                    then = readings[own], told.subset(own), clock.subset(own)
                    J[own] += self._through_time(link, by_seat, seat, None, *then)
            by_own, whose = None, None
            if observed.target is not None:
                number = self._common[data.target[rows]]
                some = number >= 0
                if some.any():
                    J[some] += observed.target[some] @ self.of_targets.by_twist[number[some]]
                if len(self._by_own):
                    whose = self._block[data.target[rows]]
                    by_own = np.where(whose[:, None, None] >= 0, observed.target @ self._by_own[whose], 0.0)
            for role, by_scalar in observed.scalars.items():
                J += by_scalar[:, :, None] * self.of_scalars[data.uses[role]]
            on_floor: IntArray | slice = np.flatnonzero(group < none) if seats else slice(None)
            grounds = ((None, on_floor), *((link, these) for link, these, _ in seats))
            yield Block(rows, observed, J, by_own, whose, tuple(moved), grounds)

    def _through_robot(
        self,
        link: str,
        twist: Array,
        motion: TipMotion,
        frame: Array,
        tool: IntArray | int | None,
        group: IntArray,
    ) -> Array:
        """Return derivatives (n, d, p) from those by the local twist of a tool on a link, or of the link itself.

        ``frame`` (n, 4, 4): where that is in the base link.
        """
        by = self._on(link)
        # Residual per local twist of every joint placement.
        J = _group_by_group(motion.tip.through(twist, frame), by.joints, group)
        J += _times(twist, by.link if tool is None else by.tools[tool])
        if self._robot.loops or self._robot.terms:
            by_link = twist if tool is None else _times(twist, self._to_tool[tool])
            if self._robot.loops:
                J += (by_link @ motion.by_passive) @ (motion.rates @ self._of_robot)
            if self._robot.terms:
                J += _times(by_link @ motion.by_terms, self._of_terms)
        return J

    def _clock(self, data: Measurements, rows: slice) -> "_Clocked | None":
        """Return how the moments of rows follow the parameters, None where they are no stream or no clock is free."""
        roles = [role for role in SHIFTS if role in data.uses]
        if data.stream is None or not roles:
            return None
        rates = data.stream.rates(data.shifts(self._frames.scalars), rows)
        by = np.stack([data.stream.by_shift(role, rows) for role in roles], axis=1)
        return _Clocked(rates, by @ self.of_scalars[[data.uses[role] for role in roles]])

    def _through_time(
        self,
        link: str,
        twist: Array,
        motion: TipMotion,
        tool: IntArray | int | None,
        readings: Array,
        told: Conditions,
        clock: "_Clocked",
    ) -> Array:
        """Return derivatives (n, d, p) as :meth:`_through_robot`, by the moment at which the robot is looked at.

        The tool moves with the velocity that it has then: minus that is what an offset of the clock does.
        """
        by_link = twist if tool is None else _times(twist, self._to_tool[tool])
        velocity = self._links[link].following(motion, readings, told) @ clock.rates[:, :, None]
        return np.asarray((by_link @ velocity) * clock.by[:, None, :])

    def _on(self, link: str) -> _Carried:
        """Return how frames on a link follow the parameters."""
        if link not in self._carried:
            tip = self._links[link]
            joints = np.repeat((tip.joints @ self._of_robot)[None], len(self._frames.bases) + 1, axis=0)
            if tip.first >= 0:
                joints[:-1, 6 * tip.first : 6 * tip.first + 6] += tip.base_column @ self._of_bases
            joints = joints[:, [6 * j + k for j in tip.way for k in range(6)]]
            behind = tip.tail @ self._of_robot
            self._carried[link] = _Carried(joints, self._to_tool @ behind + self._of_tools, behind)
        return self._carried[link]

    def _tool(self, numbers: IntArray) -> IntArray | int:
        return numbers if len(self._frames.tools) > 1 else 0


def _targets_followed(
    every: Entries, column: IntArray, split: Split, layout: Layout, at: Machine
) -> tuple[TargetsFollowed, Array]:
    """Return how targets follow common parameters, and how those of blocks (m, 6, a) follow their own.

    ``every``: what the parameters move, scaled; ``column`` (p,): of common ones.
    """
    k = np.flatnonzero((every.entry >= layout.targets) & (every.entry < layout.scalars))
    target, entry = np.divmod(every.entry[k] - layout.targets, 6)
    own, share = every.parameter[k], every.share[k]
    common = column[own] >= 0
    numbers = np.unique(target[common])
    S = np.zeros((len(numbers), 6, len(split.common)))
    S[np.searchsorted(numbers, target[common]), entry[common], column[own[common]]] = share[common]
    m, a = split.blocks.shape
    block, place = np.full(len(column), -1, dtype=np.intp), np.zeros(len(column), dtype=np.intp)
    which, where = np.nonzero(split.real)
    block[split.blocks[split.real]], place[split.blocks[split.real]] = which, where
    by_own, carrier = np.zeros((m, 6, a)), np.zeros(m, dtype=np.intp)
    by_own[block[own[~common]], entry[~common], place[own[~common]]] = share[~common]
    carrier[block[own[~common]]] = target[~common]
    return TargetsFollowed(numbers, at.target_twists[numbers] @ S), at.target_twists[carrier] @ by_own


def _group_by_group(numbers: Array, matrices: Array, group: IntArray) -> Array:
    """Return numbers (d, a, n) times that of the matrices (k, a, b) that is of their group (n,): (n, d, b)."""
    d, _, n = numbers.shape
    found = np.empty((n, d, matrices.shape[2]))
    one = (group == group[0]).all()
    for k in group[:1] if one else np.unique(group):
        rows = slice(None) if one else np.flatnonzero(group == k)
        for i in range(d):
            found[rows, i] = numbers[i][:, rows].T @ matrices[k]
    return found


def _times(rows: Array, matrix: Array) -> Array:
    """Return rows (n, d, a) times one matrix (a, b) for all, in a single product, or one for each row (n, a, b)."""
    if matrix.ndim == 2:
        return np.asarray((rows.reshape(-1, len(matrix)) @ matrix).reshape(*rows.shape[:2], -1))
    return np.asarray(rows @ matrix)
