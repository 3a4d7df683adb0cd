"""The whitened least-squares system of all measurements, reduced block by block to a small triangle.

For residuals r (m) and Jacobian J (m, p) only ``[J r] = Q [R c; 0 s]`` matters to a least-squares solver: the triangle
has the same cost, gradient and Gauss-Newton matrix as the full system. It is accumulated over blocks of rows, so that
memory does not grow with rows times parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import PoseError
from calib.identification.arrow import Arrow, Collected, Heads, Part, Split, alike, gathered
from calib.identification.elimination import split_of
from calib.identification.error_model import ErrorModel
from calib.identification.losses import Loss
from calib.identification.machine import Frames, Layout, Machine, States
from calib.identification.observations.pixels import Photographed
from calib.identification.parameters import Parameter, scales
from calib.identification.rates import Rates
from calib.identification.relations import Relation, relate, related_targets
from calib.identification.rows import (
    held_at,
    named,
    observed_rows,
    on_links,
    one_or_all,
    photographs_of,
    row_blocks,
    setups_of,
)
from calib.identification.selection import Selection
from calib.identification.stances import Links
from calib.identification.together import PhotographRows, Together
from calib.measurement.kinds import QUANTITIES
from calib.measurement.measurements import Measurements
from calib.robot.robot import Deviations, Nominals, Robot


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
    ``spent_before``: as :attr:`spent`; nothing where it is empty.
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
    spent_before: tuple[float, ...] = ()

    @property
    def spent(self) -> tuple[float, ...]:
        """Degrees of freedom of every component that a choice of the model by the same rows has spent."""
        return self.spent_before or (0.0,) * len(self.components)

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
    def photographs(self) -> tuple[IntArray | None, ...]:
        """The photograph (N,) of every row of each set; None where rows have to be evaluated one by one."""
        if self.model.robot.loops:
            return (None,) * len(self.measurements)
        return tuple(photographs_of(data) for data in self.measurements)

    @cached_property
    def split(self) -> Split:
        """Which parameters are common, and which those of blocks: of many rows or of a few.

        Where widths are learned, the noise of every component is found with them, in equations without the blocks. So
        these are of one component each then, and nothing but rows tells where they are.
        """
        split = self.of_known_widths
        if not len(split.blocks) or all(parameter.group is None for parameter in self.parameters):
            return split
        told = np.array([p.prior is not None or p.group is not None for p in self.parameters])
        selection, components = self.selection(scales(self.parameters), split), np.zeros(len(split.blocks))
        for data in self.measurements:
            seen = np.unique(selection.things.blocks_of(selection.block, data))
            components[seen[seen >= 0]] += len(QUANTITIES[data.kind])
        several = split.blocks[components > 1]
        told[several[several >= 0]] = True
        return split.without(told)

    @cached_property
    def of_known_widths(self) -> Split:
        """The same where no width is to be learned. Known relations join targets to each other."""
        return self._by_what_is_known(targets_alone=False)

    @cached_property
    def targets_apart(self) -> Split:
        """The unknowns of every target that no relation joins to others, apart from all others."""
        return self._by_what_is_known(targets_alone=True)

    def _by_what_is_known(self, *, targets_alone: bool) -> Split:
        names = self.measurements[0].targets if self.measurements else ()
        related = related_targets(self.relations)
        joined = {t for t, name in enumerate(names) if name in related}
        layout = Layout.of(self.model.robot, self.reference)
        return split_of(self.parameters, layout, self.measurements, joined, targets_alone=targets_alone)

    def machine(self, x: Array) -> Machine:
        """Return the machine at parameter values x (p,)."""
        return self.states.machine(x)

    def selection(self, units: Array, split: Split | None = None) -> Selection:
        """Return what of the state the parameters move, for ``units`` (p,) of each; without a split all are common."""
        # Of a search it is always the same one.
        key = split, units.tobytes()
        if key not in self._selections:
            self._selections[key] = Selection(self.states, units, split)
        return self._selections[key]

    @cached_property
    def _selections(self) -> dict[tuple[Split | None, bytes], Selection]:
        return {}

    def rates(self, at: Machine, units: Array, split: Split | None = None) -> Rates:
        """Return how all follows the parameters at a machine, for ``units`` (p,) of each; all are common when None."""
        return Rates(self.model.robot, self.nominals, self.selection(units, split), at)

    def residuals(self, x: Array) -> tuple[Array, ...]:
        """Return the residuals (N, d) of every set at parameter values x (p,)."""
        return self.residuals_of(self.machine(x))

    def residuals_of(self, at: Machine) -> tuple[Array, ...]:
        """Return the residuals (N, d) of every set for a machine."""
        return residuals(self.model.robot, self.measurements, at, self.nominals)

    def evaluate(self, sigmas: Sequence[Array], x: Array) -> "Evaluation":
        """Return :func:`evaluate` of this problem, targets told apart."""
        return evaluate(self, sigmas, x)


class Rows(NamedTuple):
    """All that data say: of every component its heads and the rest, and the ``whole``, with relations of targets."""

    components: tuple[Part, ...]
    whole: Arrow


class Evaluation(NamedTuple):
    """Residuals of every set (N, d) in m and rad, and ``[J r]`` of every component, reduced.

    That is a triangle (q, c + 1) by the common parameters of the ``split``, and ``heads`` of blocks, by these and by
    their own. Without a split all are common. Columns of J are scaled: they are derivatives for a change of each
    parameter by its scale. Rows are whitened by the sigmas that were given. ``relations`` (k, c + 1): ``[J r]`` of what
    is known between targets, whitened.
    """

    residuals: tuple[Array, ...]
    triangles: tuple[Array, ...]
    relations: Array
    heads: tuple[Heads, ...] = ()
    given_split: Split | None = None

    @property
    def split(self) -> Split:
        """Which parameters are common, and which are of one block each."""
        return Split.none(self.relations.shape[1] - 1) if self.given_split is None else self.given_split

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
        return Rows(parts, gathered(split, [own.heads for own in parts], [*self.triangles, self.relations]))


def evaluate(problem: Problem, sigmas: Sequence[Array], x: Array, given: Split | None = None) -> Evaluation:
    """Evaluate residuals and reduced Jacobians at parameter values x (p,); ``sigmas``: an (N, d) array for each set.

    ``given``: another split than the problem's own.
    """
    split, at = problem.split if given is None else given, problem.machine(x)
    rates = problem.rates(at, scales(problem.parameters), split)
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
            for own, columns in of_set:
                turned = None if block.own is None else problem.whitened(i, block.rows, block.own / s)[:, columns]
                own.add(whitened[:, columns], turned, block.block)
        found.append(left)
    triangles, heads = tuple(own.rest for own in collected), tuple(own.heads for own in collected)
    return Evaluation(tuple(found), triangles, _related(problem, rates, at), heads, split)


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


def related(problem: Problem, x: Array, split: Split | None = None) -> Array:
    """Return the relations (k, c + 1) of an :class:`Evaluation` at ``x``; all parameters are common unless split."""
    at = problem.machine(x)
    return _related(problem, problem.rates(at, scales(problem.parameters), split), at)


def _related(problem: Problem, rates: Rates, at: Machine) -> Array:
    numbers, J, r = _relations(problem, at)
    return np.column_stack([np.tensordot(J, rates.of_targets(numbers), axes=2), r])


def _relations(problem: Problem, at: Machine) -> tuple[list[int], Array, Array]:
    """Return numbers (n,) of related targets, and derivatives (k, n, 6) and residuals (k,) of what is known of them."""
    names = problem.measurements[0].targets if problem.measurements else ()
    numbers = sorted(map(names.index, related_targets(problem.relations)))
    return numbers, *relate(problem.relations, [names[t] for t in numbers], at.frames.targets[numbers])


def jacobian(problem: Problem, x: Array) -> tuple[Array, ...]:
    """Return the unwhitened Jacobians (N, d, p) of the residuals, in m and rad per SI unit of each parameter."""
    rates, found = problem.rates(problem.machine(x), np.ones(len(problem.parameters))), []
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
    for part in problem.rates(at, units, split).blocks(data):
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
    links, found = Links(robot, at, nominals), []
    for data in measurements:
        residual = np.empty(data.sigma.shape)
        for rows in row_blocks(data):
            tools, others = at.frames.tools, None
            try:
                readings = data.readings_at(at.frames.scalars, rows)
                told = data.conditions_at(at.frames.scalars, rows, moving=robot.weights is not None)
                carried = links[data.tip].carried(readings, told)
                if data.other is not None:
                    there = links[data.tip].carried(data.other.readings[rows], data.other.conditions.subset(rows))
                    others = held_at(
                        there, tools, one_or_all(data.other.tool[rows], data.tools), data.other.points, rows
                    )
                base = np.asarray(at.frames.bases[setups_of(data, rows)])
                for link, own in on_links(data, rows):
                    base[own] = rigid.inverse(links[link].carried(readings[own], told.subset(own)).placement)
            except PoseError as e:
                raise named(e, data, rows) from e
            # In the order of operations in which the Jacobian's rows are made: both give the same bits.
            held = held_at(carried, tools, one_or_all(data.tool[rows], data.tools), data.points, rows)
            residual[rows] = observed_rows(data, rows, at.frames, base, held, others)[0].residual
        found.append(residual)
    return tuple(found)
