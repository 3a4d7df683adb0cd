"""The whitened least-squares system of all measurements, reduced block by block to a small triangle.

For residuals r (m) and Jacobian J (m, p) only ``[J r] = Q [R c; 0 s]`` matters to a least-squares solver: the triangle
has the same cost, gradient and Gauss-Newton matrix as the full system. It is accumulated over blocks of rows, so that
memory does not grow with rows times parameters.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import PoseError
from calib.identification.error_model import ErrorModel
from calib.identification.losses import Loss
from calib.identification.machine import Frames, Layout, Machine, machine
from calib.identification.observations import observe
from calib.identification.observations.seen import Linearised, Seen
from calib.identification.parameters import Parameter, directions, scales
from calib.identification.relations import Relation, relate
from calib.identification.set_up_motions import Motions, SetUpMotions, motions, without
from calib.measurement.kinds import QUANTITIES, WITH_TARGET
from calib.measurement.measurements import Measurements
from calib.robot.conditions import Conditions
from calib.robot.robot import Deviations, Robot, TipModel, TipMotion

_Found = TypeVar("_Found")
# Measured numbers in a block: few enough that its temporaries stay in the processor's cache.
BLOCK = 384


class Component(NamedTuple):
    """Rows of one physical quantity in one set of measurements, which share a noise model."""

    measurements: int
    quantity: str  # as in calib.measurement.kinds
    columns: slice


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The unknowns, the frames they are relative to, and the measurements that are to be explained.

    ``held``: deviations of the robot where they are not free; zero when None. ``relations``: what is known between
    targets. ``given_losses``: one for each set; least squares for all when None.
    """

    model: ErrorModel
    parameters: tuple[Parameter, ...]
    reference: Frames
    measurements: tuple[Measurements, ...]
    held: Deviations | None = None
    relations: tuple[Relation, ...] = ()
    given_losses: tuple[Loss, ...] | None = None

    @property
    def losses(self) -> tuple[Loss, ...]:
        """The loss of every set."""
        linear: Loss = "linear"
        return (linear,) * len(self.measurements) if self.given_losses is None else self.given_losses

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

    def machine(self, x: Array) -> Machine:
        """Return the machine at parameter values x (p,)."""
        return machine(self.model.robot, self.parameters, self.reference, x, self.held)

    def residuals(self, x: Array) -> tuple[Array, ...]:
        """Return the residuals (N, d) of every set at parameter values x (p,)."""
        return residuals(self.model.robot, self.measurements, self.machine(x))

    def evaluate(self, sigmas: Sequence[Array], x: Array) -> "Evaluation":
        """Return :func:`evaluate` of this problem."""
        return evaluate(self, sigmas, x)


class Block(NamedTuple):
    """Rows of one set: residuals with derivatives by twists, and their Jacobian (n, d, p).

    ``moved``: derivatives by the local twist (n, d, 6) and placements (n, 4, 4) of the tools, and of other ends.
    """

    rows: slice
    observed: Linearised
    J: Array
    moved: tuple[tuple[Array, Array], ...]


class Evaluation(NamedTuple):
    """Residuals of every set (N, d) in m and rad, and a triangle (q, p + 1) of ``[J r]`` for every component.

    Columns of J are scaled: they are derivatives for a change of each parameter by its scale. Rows are whitened by
    the sigmas that were given. ``relations`` (k, p + 1): ``[J r]`` of what is known between targets, whitened.
    ``set_up_motions`` (p, k): unit directions in which the whole set-up turns, and grows, unmeasured; zeros are none.
    """

    residuals: tuple[Array, ...]
    triangles: tuple[Array, ...]
    relations: Array
    set_up_motions: Array

    def reweighted(self, factors: Sequence[float] | Array) -> "Evaluation":
        """Return what it is with sigmas that are new by one factor for every component."""
        triangles = tuple(triangle / f for triangle, f in zip(self.triangles, factors, strict=True))
        return self._replace(triangles=triangles)

    @property
    def rows(self) -> Array:
        """All that the data say, (q, p + 1): the triangles, then the relations; nothing of motions they cannot see."""
        rows = np.concatenate([*self.triangles, self.relations])
        if self.set_up_motions.size:
            rows[:, :-1] = without(rows[:, :-1], self.set_up_motions)
        return rows


def evaluate(problem: Problem, sigmas: Sequence[Array], x: Array) -> Evaluation:
    """Evaluate residuals and reduced Jacobians at parameter values x (p,); ``sigmas``: an (N, d) array for each set."""
    columns = len(problem.parameters) + 1
    triangles = [np.empty((0, columns)) for _ in problem.components]
    found: list[Array] = []
    at = problem.machine(x)
    moving = problem.motions
    whole = None if moving is None else SetUpMotions(problem.parameters, moving, problem.model.robot.reach)
    components = list(enumerate(problem.components))
    rates = Rates(problem, at, scales(problem.parameters))
    for i, (data, sigma) in enumerate(zip(problem.measurements, sigmas, strict=True)):
        left = np.empty(data.sigma.shape)
        own = [(c, component.columns) for c, component in components if component.measurements == i]
        for block in rates.blocks(data):
            residual = block.observed.residual
            left[block.rows] = residual
            whitened = np.concatenate([block.J, residual[:, :, None]], axis=2) / sigma[block.rows, :, None]
            if whole is not None:
                whole.add(block.J, block.moved, sigma[block.rows])
            for c, of_quantity in own:
                rows = whitened[:, of_quantity].reshape(-1, columns)
                triangles[c] = linear.triangle(np.concatenate([triangles[c], rows]))
        found.append(left)
    J, r = relate(problem.relations, problem.measurements[0].targets, at.frames.targets)
    layout = Layout.of(problem.model.robot, at.frames)
    S = directions(problem.parameters, layout.size) * scales(problem.parameters)
    by_targets = at.target_twists @ S[layout.targets : layout.lengths].reshape(len(at.frames.targets), 6, len(x))
    related = np.column_stack([np.einsum("kmi,mip->kp", J, by_targets), r])
    set_up_motions = np.zeros((len(x), 0))
    if whole is not None:
        set_up_motions = whole.directions(problem.measurements, at, by_targets, S[layout.lengths :])
    return Evaluation(tuple(found), tuple(triangles), related, set_up_motions)


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
    tip, found = TipModel(robot, at.deviations), []
    for data in measurements:
        residual = np.empty(data.sigma.shape)
        for rows, tips, others in _block_by_block(tip.tips, data):
            placed = at.frames.bases[data.setup[rows]] @ tips @ at.frames.tools[data.tool[rows]]
            residual[rows] = _observe(data, rows, at.frames, placed, others).residual
        found.append(residual)
    return tuple(found)


def _block_by_block(
    evaluate: Callable[[Array, Conditions], _Found], data: Measurements
) -> Iterator[tuple[slice, _Found, _Found | None]]:
    """Yield some rows after others: what is found there, and at their other ends where they have one."""
    size, other = BLOCK // data.sigma.shape[1], data.other
    for start in range(0, len(data), size):
        rows = slice(start, start + size)
        try:
            own = evaluate(data.readings[rows], data.conditions.subset(rows))
            end = None if other is None else evaluate(other.readings[rows], other.conditions.subset(rows))
        except PoseError as e:
            row = start + e.row
            line = f"{data.where}:{data.lines[row]}"
            raise PoseError(row, e.reason, [start + row for row in e.rows], line) from e
        yield rows, own, end


def _observe(data: Measurements, rows: slice, frames: Frames, tools: Array, others: Array | None) -> Linearised:
    """Return what rows leave unexplained: tools (n, 4, 4) in the instrument's frame, other ends' tips in the base."""
    targets = frames.targets[data.target[rows] if data.kind in WITH_TARGET else slice(0)]
    ends = frames.targets[:0]
    if data.other is not None and others is not None:
        ends = frames.bases[data.setup[rows]] @ others @ frames.tools[data.other.tool[rows]]
    length = float(frames.lengths[data.offset]) if data.offset >= 0 else 0.0
    return observe(data.kind, Seen(data, rows, tools, ends, targets, length))


def blocks(problem: Problem, data: Measurements, at: Machine, units: Array) -> Iterator[Block]:
    """Yield the rows of one set, block by block; derivatives are taken for ``units`` (p,) of every parameter."""
    yield from Rates(problem, at, units).blocks(data)


class Rates:
    """How tools and targets follow the parameters at a machine, for ``units`` (p,) of each: the same for all sets."""

    def __init__(self, problem: Problem, at: Machine, units: Array) -> None:
        frames = at.frames
        layout = Layout.of(problem.model.robot, frames)
        S = directions(problem.parameters, layout.size) * units
        self._robot, self._frames, self._tip = problem.model.robot, frames, TipModel(problem.model.robot, at.deviations)
        self._of_robot, self._of_terms = S[: layout.terms], S[layout.terms : layout.base]
        self._of_lengths = S[layout.lengths :]
        of_tools = S[layout.tools : layout.targets].reshape(len(frames.tools), 6, len(units))
        of_bases = S[layout.base : layout.tools].reshape(len(frames.bases), 6, len(units))
        # Of every set-up: how the joints' placements follow the parameters, the first one with the base.
        self._joints = np.repeat((self._tip.joints @ self._of_robot)[None], len(frames.bases), axis=0)
        self._joints[:, :6] += self._tip.base_column @ at.base_twists @ of_bases
        # What moves a tool beside the joints: its own pose, and what lies behind the last joint.
        self._to_tool = rigid.adjoint(rigid.inverse(frames.tools))
        self._by_tool = self._to_tool @ (self._tip.tail @ self._of_robot) + at.tool_twists @ of_tools
        of_targets = S[layout.targets : layout.lengths].reshape(len(frames.targets), 6, len(units))
        self._by_target = at.target_twists @ of_targets

    def blocks(self, data: Measurements) -> Iterator[Block]:
        """Yield the rows of one set, block by block."""
        frames = self._frames
        for rows, motion, other in _block_by_block(self._tip.motion, data):
            tool, setup = self._tool(data.tool[rows]), data.setup[rows]
            placed = frames.bases[setup] @ motion.placement @ frames.tools[tool]
            observed = _observe(data, rows, frames, placed, None if other is None else other.placement)
            J = self._through_robot(observed.twist, motion, tool, setup)
            moved = [(observed.twist, placed)]
            if data.other is not None and other is not None and observed.other is not None:
                tool = self._tool(data.other.tool[rows])
                moved.append((observed.other, frames.bases[setup] @ other.placement @ frames.tools[tool]))
                J += self._through_robot(observed.other, other, tool, setup)
            if observed.target is not None:
                J += observed.target @ self._by_target[data.target[rows]]
            if data.offset >= 0:
                J -= self._of_lengths[data.offset]
            yield Block(rows, observed, J, tuple(moved))

    def _through_robot(self, twist: Array, motion: TipMotion, tool: IntArray | int, setup: IntArray) -> Array:
        # Residual per local twist of the tip link, then per local twist of every joint placement.
        by_tip = _times(twist, self._to_tool[tool])
        J = _group_by_group(by_tip @ motion.regressor, self._joints, setup)
        J += _times(twist, self._by_tool[tool])
        if self._robot.loops:
            J += (by_tip @ motion.by_passive) @ (motion.rates @ self._of_robot)
        if self._robot.terms:
            J += _times(by_tip @ motion.by_terms, self._of_terms)
        return J

    def _tool(self, numbers: IntArray) -> IntArray | int:
        return numbers if len(self._frames.tools) > 1 else 0


def _group_by_group(rows: Array, matrices: Array, group: IntArray) -> Array:
    """Return rows (n, d, a) times that of the matrices (k, a, b) that is of their group (n,)."""
    used = np.unique(group)
    if len(used) == 1:
        return _times(rows, matrices[used[0]])
    found = np.empty((*rows.shape[:2], matrices.shape[2]))
    for k in used:
        found[group == k] = _times(rows[group == k], matrices[k])
    return found


def _times(rows: Array, matrix: Array) -> Array:
    """Return rows (n, d, a) times one matrix (a, b) for all, in a single product, or one for each row (n, a, b)."""
    if matrix.ndim == 2:
        return np.asarray((rows.reshape(-1, len(matrix)) @ matrix).reshape(*rows.shape[:2], -1))
    return np.asarray(rows @ matrix)
