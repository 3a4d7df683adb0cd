"""The whitened least-squares system of all measurements, reduced block by block to a small triangle.

For residuals r (m) and Jacobian J (m, p) only ``[J r] = Q [R c; 0 s]`` matters to a least-squares solver: the triangle
has the same cost, gradient and Gauss-Newton matrix as the full system. It is accumulated over blocks of rows, so that
memory does not grow with rows times parameters.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import PoseError
from calib.identification.arrow import Arrow, Collected, Heads, Part, Split, alike, gathered
from calib.identification.elimination import Things, split_of
from calib.identification.error_model import ErrorModel
from calib.identification.identifiability import RANK_TOLERANCE
from calib.identification.losses import Loss
from calib.identification.machine import Frames, Layout, Machine, States
from calib.identification.observations import observe
from calib.identification.observations.pixels import Photographed, of_photographs, photographed
from calib.identification.observations.seen import Linearised, Moved, Seen
from calib.identification.parameters import Parameter, scales
from calib.identification.relations import Relation, relate
from calib.identification.set_up_motions import Motions, SetUpMotions, TargetsFollowed, motions, taken_out
from calib.identification.together import PhotographRows, Together
from calib.measurement.kinds import QUANTITIES, WITH_TARGET
from calib.measurement.measurements import Measurements
from calib.measurement.streams.stream import SHIFTS
from calib.robot.kinematics import Follow, Regressor, followed
from calib.robot.robot import Deviations, Nominals, Robot, TipModel, TipMotion

# Measured numbers in a block: so many that a call costs little beside them, few enough that memory does not grow.
BLOCK = 3072
# Photographs with fewer marks, on average, are evaluated mark by mark.
_FEW_MARKS = 3
# Photographs take so much less memory than their rows.
_FOLDED = 4


class Component(NamedTuple):
    """Rows of one physical quantity in one set of measurements, which share a noise model."""

    measurements: int
    quantity: str  # as in calib.measurement.kinds
    columns: slice


@dataclass(frozen=True, eq=False)
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

    @cached_property
    def states(self) -> States:
        """How the machine follows the parameters."""
        return States(self.model.robot, self.parameters, self.reference, self.held)

    @cached_property
    def motions(self) -> Motions | None:
        """How the whole set-up may move with no effect on what is measured."""
        return motions(self.measurements, self.model.targets, self.relations, self.reference.base[:3, 3])

    @cached_property
    def photographs(self) -> tuple[IntArray | None, ...]:
        """The photograph (N,) of every row of each set; None where rows have to be evaluated one by one."""
        if self.motions is not None or self.model.robot.loops:
            return (None,) * len(self.measurements)
        return tuple(_photographs(data) for data in self.measurements)

    @cached_property
    def split(self) -> Split:
        """Which parameters are common, and which those of blocks: of many rows or of a few.

        Known relations join targets to each other. What the whole set-up's motions are imitated by is seen together,
        targets aside; and a width that is to be learned is judged by all that is unknown.
        """
        if any(parameter.group is not None for parameter in self.parameters):
            return Split.none(len(self.parameters))
        return self._by_what_is_known(targets_alone=self.motions is not None)

    @cached_property
    def targets_apart(self) -> Split:
        """The unknowns of every target that no relation joins to others, apart from all others."""
        return self._by_what_is_known(targets_alone=True)

    def _by_what_is_known(self, *, targets_alone: bool) -> Split:
        names = self.measurements[0].targets if self.measurements else ()
        related = {name for relation in self.relations for name in relation.targets}
        joined = {t for t, name in enumerate(names) if name in related}
        layout = Layout.of(self.model.robot, self.reference)
        return split_of(self.parameters, layout, self.measurements, joined, targets_alone=targets_alone)

    def machine(self, x: Array) -> Machine:
        """Return the machine at parameter values x (p,)."""
        return self.states.machine(x)

    def selection(self, units: Array, split: Split | None = None) -> "Selection":
        """Return what of the state the parameters move, for ``units`` (p,) of each; without a split all are common."""
        # Of a search it is always the same one.
        key = split, units.tobytes()
        if key not in self._selections:
            self._selections[key] = Selection(self.states, units, split)
        return self._selections[key]

    @cached_property
    def _selections(self) -> "dict[tuple[Split | None, bytes], Selection]":
        return {}

    def residuals(self, x: Array) -> tuple[Array, ...]:
        """Return the residuals (N, d) of every set at parameter values x (p,)."""
        return self.residuals_of(self.machine(x))

    def residuals_of(self, at: Machine) -> tuple[Array, ...]:
        """Return the residuals (N, d) of every set for a machine."""
        return residuals(self.model.robot, self.measurements, at, self.nominals)

    def evaluate(self, sigmas: Sequence[Array], x: Array) -> "Evaluation":
        """Return :func:`evaluate` of this problem, targets told apart."""
        return evaluate(self, sigmas, x)


class Block(NamedTuple):
    """Rows of one set: residuals with derivatives, and their Jacobian (n, d, c) by common parameters.

    ``own`` (n, d, a): their derivatives by the parameters of the row's ``block`` (n,), -1 for none; both are None where
    all are common. ``moved``: the tools, and other ends. ``grounds``: which of the rows are told in which link, None
    being the floor.
    """

    rows: slice
    observed: Linearised
    J: Array
    own: Array | None
    block: IntArray | None
    moved: tuple[Moved, ...]
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
        """Which parameters are common, and which are of one block each."""
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
        number, folded = problem.photographs[i], partial(_folded, problem, i, sigma, left)
        for block in () if number is None else rates.photographs(data, number, folded):
            rows = np.concatenate([block.J, block.observed.residual[:, :, None]], axis=2)
            for own, _ in of_set:  # of pixels there is one
                own.add(rows, block.own, block.block)
        for block in rates.blocks(data) if number is None else ():
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


def _folded(
    problem: Problem, i: int, sigma: Array, left: Array, rows: slice, number: IntArray, seen: Photographed
) -> tuple[Array, Array, dict[str, Array]]:
    """Return rows of set i, whitened by ``sigma`` (N, d), as so few numbers of each photograph as say the same.

    All marks of a photograph follow one motion of the camera to the board, and the scalars: of their rows, turned by
    an orthogonal matrix, only as many see anything. ``number`` (n,): the photograph of each. Residuals (m, k), and
    derivatives by the camera (m, k, 6) and by scalars (m, k) each are returned. Into ``left`` (N, d) go residuals, as
    :class:`Evaluation` has them.
    """
    s, count = sigma[rows, :, None], len(seen.scalars)
    columns = [
        seen.by_camera,
        *(by_scalar[:, :, None] for by_scalar in seen.scalars.values()),
        seen.residual[:, :, None],
    ]
    whitened = problem.whitened(i, rows, np.concatenate(columns, axis=2) / s)
    left[rows] = whitened[:, :, -1] * s[:, :, 0] if problem.together else seen.residual
    marks = np.bincount(number)
    found = np.zeros((len(marks), min(7 + count, 2 * int(marks.max())), 7 + count))
    for those, of in alike(number):
        own = whitened[of]
        own[of < 0] = 0.0
        turned = linear.triangle(own.reshape(len(those), -1, 7 + count))
        found[those, : turned.shape[1]] = turned
    return found[:, :, -1], found[:, :, :6], {role: found[:, :, 6 + k] for k, role in enumerate(seen.scalars)}


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


def with_twists(
    problem: Problem, at: Machine, data: Measurements, units: Array, split: Split | None = None
) -> PhotographRows:
    """Return the rows of one set for ``units`` (p,), unknowns and the tool's twist; without a split all are common."""
    split = Split.none(len(units)) if split is None else split
    c, a = len(split.common), split.blocks.shape[1]
    J, own, block = np.empty((*data.sigma.shape, c)), np.zeros((*data.sigma.shape, a)), np.full(len(data), -1)
    by_twist, r = np.empty((*data.sigma.shape, 6)), np.empty(data.sigma.shape)
    for part in Rates(problem, at, units, split).blocks(data):
        J[part.rows], r[part.rows] = part.J, part.observed.residual
        by_twist[part.rows] = np.concatenate(part.moved[0].by_motion, axis=2)
        if part.own is not None and part.block is not None:
            own[part.rows], block[part.rows] = part.own, part.block
    return PhotographRows(J, own, block, by_twist, r)


def residuals(
    robot: Robot, measurements: Sequence[Measurements], at: Machine, nominals: Nominals | None = None
) -> tuple[Array, ...]:
    """Return the residuals (N, d) of every set, measured minus predicted, in SI units, for a machine.

    ``nominals``: where they are made already.
    """
    links, found = _Links(robot, at, nominals), []
    for data in measurements:
        residual = np.empty(data.sigma.shape)
        for rows in _blocks(data):
            tools, others = at.frames.tools, None
            with _naming(data, rows):
                readings = data.readings_at(at.frames.scalars, rows)
                told = data.conditions_at(at.frames.scalars, rows, moving=robot.weights is not None)
                carried = links[data.tip].carried(readings, told)
                if data.other is not None:
                    there = links[data.tip].carried(data.other.readings[rows], data.other.conditions.subset(rows))
                    others = _held(
                        there, tools, _one_or_all(data.other.tool[rows], data.tools), data.other.points, rows
                    )
                base = np.asarray(at.frames.bases[_setups(data, rows)])
                for link, own in _on_links(data, rows):
                    base[own] = rigid.inverse(links[link].carried(readings[own], told.subset(own)).placement)
            # In the order of operations in which the Jacobian's rows are made: both give the same bits.
            held = _held(carried, tools, _one_or_all(data.tool[rows], data.tools), data.points, rows)
            residual[rows] = _observe(data, rows, at.frames, base, held, others)[0].residual
        found.append(residual)
    return tuple(found)


class _Links(dict[str, TipModel]):
    """Models of a robot as the one of a machine is, by the link that they look at; "" is the robot's tip."""

    def __init__(self, robot: Robot, at: Machine, nominals: Nominals | None = None) -> None:
        super().__init__()
        self._robot, self._at, self._nominals = robot, at, Nominals() if nominals is None else nominals

    def __missing__(self, link: str) -> TipModel:
        robot = self._robot if link in ("", self._robot.tip) else self._robot.with_tip(link)
        found = TipModel(robot, self._at.deviations, self._nominals[self._robot], self._at.motions)
        self[link] = found
        return found


def _blocks(data: Measurements, number: IntArray | None = None) -> Iterator[slice]:
    """Yield the rows of a set, few enough at a time; what a camera sees in one photograph is not parted.

    ``number`` (N,): the photograph of each row, where it is known.
    """
    size, start = (BLOCK if number is None else _FOLDED * BLOCK) // data.sigma.shape[1], 0
    parted = data.kind == "pixels" and len(data) > size
    cuts = _between(photograph_numbers(data) if number is None else number) if parted else None
    while start < len(data):
        end = min(start + size, len(data))
        if cuts is not None:
            end = int(
                cuts[max(np.searchsorted(cuts, end, side="right") - 1, np.searchsorted(cuts, start, side="right"))]
            )
        yield slice(start, end)
        start = end


def _between(number: IntArray) -> IntArray:
    """Return the numbers of rows before which no photograph (N,) has begun that goes on, the end being one."""
    last = np.zeros(int(number.max(initial=0)) + 1, dtype=np.intp)
    last[number] = np.arange(len(number))
    until = np.maximum.accumulate(last[number])
    return np.append(np.flatnonzero(until[:-1] < np.arange(1, len(number))) + 1, len(number))


def photograph_numbers(data: Measurements) -> IntArray:
    """Return the photograph (N,) of every row: rows of one target and tool with the same readings."""
    at = np.column_stack([data.readings, data.tool, data.setup, data.target])
    # Most follow each other, and of these the first says all.
    first = np.append(True, np.any(at[1:] != at[:-1], axis=1))[: len(at)]
    number = np.unique(at[first], axis=0, return_inverse=True)[1].ravel()
    return np.asarray(number[np.cumsum(first) - 1], dtype=np.intp)


def _photographs(data: Measurements) -> IntArray | None:
    """Return the photograph (N,) of every row; None of other kinds, and where rows have little in common."""
    if data.kind != "pixels" or data.stream is not None or data.points is not None or not data.of_boards:
        return None
    number = photograph_numbers(data)
    _, first = np.unique(number, return_index=True)
    if len(number) < _FEW_MARKS * len(first):
        return None
    told = [getattr(data.conditions, one.name) for one in fields(data.conditions)]
    alike = all(one is None or np.array_equal(one, one[first[number]], equal_nan=True) for one in told)
    return number if alike else None


def _one_or_all(numbers: IntArray, names: Sequence[str]) -> IntArray | int:
    """Return the number that all rows have, or the numbers (n,) of each, where they count so many names."""
    if len(names) == 1:
        return 0
    first = int(numbers[0])
    return numbers if np.count_nonzero(numbers != first) else first


def _setups(data: Measurements, rows: slice | IntArray) -> IntArray | int:
    """Return the set-ups (n,) of rows, or the one of all; where some look at links, what is seen from is of each."""
    return data.setup[rows] if data.target_links else _one_or_all(data.setup[rows], data.setups)


def _on_links(data: Measurements, rows: slice | IntArray) -> Iterator[tuple[str, IntArray]]:
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
    data: Measurements, rows: slice, frames: Frames, base: Array, held: Array, others: Array | None
) -> tuple[Linearised, tuple[Array, ...]]:
    """Return what rows leave unexplained, and where tools and other ends are for who observes them (n, 4, 4).

    ``held`` and ``others``: these in the base. The observer is the floor, in whose frame instruments measure, or the
    link that carries a row's target; the base is at ``base`` there, (n, 4, 4), or (4, 4) for all rows.
    """
    targets = frames.targets[data.target[rows] if data.kind in WITH_TARGET else slice(0)]
    ends = [rigid.product(base, T) for T in (held, others) if T is not None]
    other = ends[1] if others is not None else frames.targets[:0]
    return observe(data.kind, Seen(data, rows, ends[0], other, targets, _scalars(data, frames))), tuple(ends)


def _scalars(data: Measurements, frames: Frames) -> dict[str, float]:
    return {role: float(frames.scalars[k]) for role, k in data.uses.items() if role not in SHIFTS}


def _held(carried: Regressor, tools: Array, tool: IntArray | int, points: Array | None, rows: slice) -> Array:
    """Return where the points of rows are in the base (n, 4, 4): tools (k, 4, 4), by number, or points in them."""
    if isinstance(tool, int):
        found = carried.behind(carried.end @ tools[tool])
    else:
        found = rigid.product(carried.placement, tools[tool])
    return found if points is None else rigid.product(found, rigid.translation(points[rows]))


class _Clocked(NamedTuple):
    """Rates (n, k) of the readings of rows of a stream, and how the controller's time (n, p) follows the parameters."""

    rates: Array
    by: Array

    def subset(self, rows: IntArray) -> "_Clocked":
        return _Clocked(self.rates[rows], self.by[rows])


class FramesFollow(NamedTuple):
    """How frames follow parameters: of each, the derivatives ``by`` (k + 1, 6, w) those of w ``columns`` (k + 1, w).

    No frame follows more than a few, so that its other columns are not written out. Last: no frame, which follows none.
    """

    columns: IntArray
    by: Array

    @classmethod
    def of(cls, entry: IntArray, column: IntArray, share: Array, frames: int, width: int) -> "FramesFollow":
        """Return it from which of six values of frames, ``entry`` (n,), a column (n,) of ``width`` moves by a share."""
        frame = entry // 6
        moved = np.zeros((frames + 1, width), dtype=np.bool_)
        moved[frame, column] = True
        w = int(moved.sum(axis=1).max(initial=0))
        # Its own columns first; where a frame has fewer than others, some that it does not move.
        columns = np.argsort(~moved, axis=1, kind="stable")[:, :w]
        place = np.argmax(columns[frame] == column[:, None], axis=1) if w else column
        by = np.zeros((frames + 1, 6, w))
        np.add.at(by, (frame, entry % 6, place), share)
        return cls(columns, by)

    def turned(self, twists: Array) -> "FramesFollow":
        """Return how something follows the parameters that follows the frames by matrices (k, 6, 6)."""
        if not self.by.size:
            return self
        by = np.zeros(self.by.shape)
        np.matmul(twists, self.by[:-1], out=by[:-1])
        return FramesFollow(self.columns, by)

    def add(self, numbers: Array, frame: IntArray, found: Array) -> None:
        """Add to ``found`` (d, n, p) how numbers follow the parameters through the frames (n,) of rows.

        ``numbers`` (6, d, n): how they follow these; or (3, d, n), their turns alone.
        """
        by = self.by[frame, 6 - len(numbers) :]
        found[:, np.arange(len(frame))[:, None], self.columns[frame]] += np.einsum("edn,new->dnw", numbers, by)

    def written_out(self, frames: IntArray, width: int) -> Array:
        """Return how some frames follow the first parameters (k, 6, width)."""
        found = np.zeros((len(frames), 6, max(width, int(self.columns.max(initial=-1)) + 1)))
        found[np.arange(len(frames))[:, None], :, self.columns[frames]] = np.swapaxes(self.by[frames], 1, 2)
        return found[:, :, :width]

    @property
    def every(self) -> IntArray:
        """The numbers of all frames."""
        return np.arange(len(self.by) - 1)

    def following(self, width: int) -> IntArray:
        """Return which frames follow some of the first parameters."""
        return np.flatnonzero((self.by.any(axis=1) & (self.columns < width)).any(axis=1))


class Selection:
    """Which of the state the parameters of a split move, for ``units`` (p,) of each.

    Columns are those of the c common parameters, then a that all blocks share: a row is about one block at most.
    ``of_robot``, ``of_terms`` and ``of_scalars``: parts of the state (k, c + a) as they follow them; ``of_bases``,
    ``of_tools`` and ``of_targets``: frames. ``each_base`` and ``each_tool`` (k, 6, c + a): the first two, written out,
    of which there are few. ``block`` (t + 1,): of all ``things``, as
    :meth:`calib.identification.elimination.Things.in_blocks` has it.
    """

    def __init__(self, states: States, units: Array, split: Split | None) -> None:
        layout, split = states.layout, Split.none(len(units)) if split is None else split
        entry, parameter, share = states.entries
        share, column = share * units[parameter], split.columns[parameter]
        self.split, self.common, self.things = split, len(split.common), Things.of(layout)
        self.block = self.things.in_blocks(entry, split.block_of[parameter])
        self.width = self.common + split.blocks.shape[1]

        def followed(start: int, end: int) -> Array:
            S = np.zeros((end - start, self.width))
            k = np.flatnonzero((entry >= start) & (entry < end))
            np.add.at(S, (entry[k] - start, column[k]), share[k])
            return S

        def frames(start: int, end: int) -> FramesFollow:
            k = np.flatnonzero((entry >= start) & (entry < end))
            return FramesFollow.of(entry[k] - start, column[k], share[k], (end - start) // 6, self.width)

        self.of_robot, self.of_terms = followed(0, layout.terms), followed(layout.terms, layout.base)
        self.of_bases, self.of_tools = frames(layout.base, layout.tools), frames(layout.tools, layout.targets)
        self.each_base, self.each_tool = (
            own.written_out(own.every, self.width) for own in (self.of_bases, self.of_tools)
        )
        self.of_targets = frames(layout.targets, layout.scalars)
        self.of_scalars = followed(layout.scalars, layout.size)


# Of some rows, the photograph of each and what was seen: numbers of photographs, as few as say the same.
_Folding = Callable[[slice, IntArray, Photographed], tuple[Array, Array, dict[str, Array]]]


class Rates:
    """How frames follow the parameters at a machine, for ``units`` (p,) of each: the same for all sets.

    ``split``: parameters of blocks are told apart, in columns of their own; all are common when None.
    """

    def __init__(self, problem: Problem, at: Machine, units: Array, split: Split | None = None) -> None:
        self._robot, self._frames = problem.model.robot, at.frames
        self._selection = own = problem.selection(units, split)
        self._links = _Links(self._robot, at, problem.nominals)
        self._at, self._of_targets = at, own.of_targets.turned(at.target_twists)
        self._on: dict[str, tuple[Array, Array]] = {}
        self._by: dict[tuple[str, int, int], Array] = {}

    @property
    def of_targets(self) -> TargetsFollowed:
        """How targets follow common parameters."""
        c = self._selection.common
        numbers = self._of_targets.following(c)
        return TargetsFollowed(numbers, self._of_targets.written_out(numbers, c))

    @property
    def of_scalars(self) -> Array:
        """How scalars (s, c) follow common parameters."""
        return self._selection.of_scalars[:, : self._selection.common]

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
        for rows in _blocks(data, number):
            _, first, own = np.unique(number[rows], return_index=True, return_inverse=True)
            at = np.asarray(first + rows.start, dtype=np.intp)
            setups, tool, target = _setups(data, at), _one_or_all(data.tool[at], data.tools), data.target[at]
            base, group, told = np.asarray(frames.bases[setups]), setups, data.conditions.subset(at)
            motion = tip.motion(data.readings[at], told)
            seats = [
                (link, on, self._links[link].motion(data.readings[at[on]], told.subset(on)))
                for link, on in _on_links(data, at)
            ]
            if seats:
                group = np.array(setups)
                for _, on, seat in seats:
                    base[on], group[on] = rigid.inverse(seat.placement), len(frames.bases)
            held = _held(motion.tip, frames.tools, tool, None, rows)
            tools, targets = rigid.product(base, held), frames.targets[target]
            seen = Seen(data, rows, tools, targets[:0], targets, _scalars(data, frames))
            observed = of_photographs(seen, *folded(rows, own, photographed(seen, own)))
            in_base = [follow.seen_from(base[..., :3, :3]) for follow in observed.tool]
            J = self._through_robot(data.tip, in_base, motion, held, tool, group)
            for link, on, seat in seats:
                back = [follow.of(on).negative() for follow in in_base]
                J[on] += self._through_robot(link, back, seat, held[on], -1, len(frames.bases))
            self._complete(J, data, observed, target)
            by_own, block = (None, None) if whose is None else (J[:, :, c:], whose[at])
            yield Block(rows, observed, J[:, :, :c], by_own, block, (Moved(observed.tool, tools),), ())

    def _complete(self, J: Array, data: Measurements, observed: Linearised, target: IntArray) -> None:
        """Add to derivatives (n, d, c + a) what comes through targets (n,) and scalars."""
        if observed.target is not None:
            self._of_targets.add(observed.target.transpose(2, 1, 0), target, J.transpose(1, 0, 2))
        for role, by_scalar in observed.scalars.items():
            J += by_scalar[:, :, None] * self._selection.of_scalars[data.uses[role]]

    def blocks(self, data: Measurements) -> Iterator[Block]:
        """Yield the rows of one set, block by block."""
        frames, tip, none = self._frames, self._links[data.tip], len(self._frames.bases)
        c, whose = self._selection.common, self.whose(data)
        for rows in _blocks(data):
            setups, tool, others, there = _setups(data, rows), _one_or_all(data.tool[rows], data.tools), None, None
            base, group = np.asarray(frames.bases[setups]), setups
            with _naming(data, rows):
                told = data.conditions_at(frames.scalars, rows, moving=self._robot.weights is not None)
                readings = data.readings_at(frames.scalars, rows)
                motion = tip.motion(readings, told)
                if data.other is not None:
                    other = _one_or_all(data.other.tool[rows], data.tools)
                    there = tip.motion(data.other.readings[rows], data.other.conditions.subset(rows))
                    others = _held(there.tip, frames.tools, other, data.other.points, rows)
                seats = [
                    (link, own, self._links[link].motion(readings[own], told.subset(own)))
                    for link, own in _on_links(data, rows)
                ]
            if seats:
                group = np.array(setups)
                for _, own, seat in seats:
                    base[own], group[own] = rigid.inverse(seat.placement), none
            held = _held(motion.tip, frames.tools, tool, data.points, rows)
            observed, ends = _observe(data, rows, frames, base, held, others)
            moved = [Moved(observed.tool, ends[0])]
            clock, turned = self._clock(data, rows), base[..., :3, :3]
            then = None if clock is None else (readings, clock)
            in_base = [follow.seen_from(turned) for follow in observed.tool]
            J = self._through_robot(data.tip, in_base, motion, held, tool, group, then)
            if data.other is not None and there is not None and others is not None:
                moved.append(Moved(observed.other, ends[1]))
                by_other = [follow.seen_from(turned) for follow in observed.other]
                J += self._through_robot(data.tip, by_other, there, others, other, group)
            for link, own, seat in seats:
                # What is seen from a link that moves, moves the other way.
                back = [follow.of(own).negative() for follow in in_base]
                then = None if clock is None else (readings[own], clock.subset(own))
                J[own] += self._through_robot(link, back, seat, held[own], -1, none, then)
            self._complete(J, data, observed, data.target[rows])
            on_floor: IntArray | slice = np.flatnonzero(group < none) if seats else slice(None)
            grounds = ((None, on_floor), *((link, these) for link, these, _ in seats))
            by_own, block = (None, None) if whose is None else (J[:, :, c:], whose[rows])
            yield Block(rows, observed, J[:, :, :c], by_own, block, tuple(moved), grounds)

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
        rows, or the one of all; the last frame, which follows nothing, where there is none. ``then``: the readings (n,
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
            self._on[link] = tip.follow @ self._selection.of_robot, tool_twists
        return self._on[link]

    def _by_parameters(self, link: str, group: int, tool: int) -> Array:
        """Return how local twists of what carries a link follow the parameters (6 (w + 1), c + a).

        With the base of a set-up, or none for what is told in another link, and one of the tools, or -1 for none.
        """
        key = link, group, tool
        if key not in self._by:
            by_robot, tool_twists = self._carrying(link)
            own, base_twists, found = self._selection, self._at.base_twists, by_robot.copy()
            by_carrier = found.reshape(6, -1, own.width)
            if group < len(base_twists):
                by_carrier[:, 0] += base_twists[group] @ own.each_base[group]
            if tool >= 0:
                by_carrier[:, -1] += tool_twists[tool] @ own.each_tool[tool]
            self._by[key] = found
        return self._by[key]

    def _clock(self, data: Measurements, rows: slice) -> "_Clocked | None":
        """Return how the moments of rows follow the parameters, None where they are no stream or no clock is free."""
        roles = [role for role in SHIFTS if role in data.uses]
        if data.stream is None or not roles:
            return None
        rates = data.stream.rates(data.shifts(self._frames.scalars), rows)
        by = np.stack([data.stream.by_shift(role, rows) for role in roles], axis=1)
        return _Clocked(rates, by @ self._selection.of_scalars[[data.uses[role] for role in roles]])


def _times(rows: Array, matrix: Array) -> Array:
    """Return rows (n, d, a) times one matrix (a, b) for all, in a single product."""
    return np.asarray((rows.reshape(-1, len(matrix)) @ matrix).reshape(*rows.shape[:2], -1))
