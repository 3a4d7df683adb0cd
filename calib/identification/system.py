"""The whitened least-squares system of all measurements, reduced block by block to a small triangle.

For residuals r (m) and Jacobian J (m, p) only ``[J r] = Q [R c; 0 s]`` matters to a least-squares solver: the triangle
has the same cost, gradient and Gauss-Newton matrix as the full system. It is accumulated over blocks of rows, so that
memory does not grow with rows times parameters.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array
from calib.foundations.errors import PoseError
from calib.identification.error_model import ErrorModel
from calib.identification.machine import Frames, Layout, Machine, machine
from calib.identification.observations import Linearised, pose, position
from calib.identification.parameters import Parameter, directions, scales
from calib.measurement.measurements import Measurements
from calib.robot.robot import Deviations, Robot, TipModel

# Measured numbers in a block: few enough that its temporaries stay in the processor's cache.
BLOCK = 768


class Component(NamedTuple):
    """Rows of one physical quantity in one set of measurements, which share a noise model."""

    measurements: int
    quantity: str  # "position" or "orientation"
    columns: slice


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The unknowns, the frames they are relative to, and the measurements that are to be explained.

    ``held``: deviations of the robot where they are not free; zero when None.
    """

    model: ErrorModel
    parameters: tuple[Parameter, ...]
    reference: Frames
    measurements: tuple[Measurements, ...]
    held: Deviations | None = None

    @property
    def components(self) -> tuple[Component, ...]:
        """The groups of residuals that share a noise model."""
        parts = {"position": (("position", slice(0, 3)),), "orientation": (("orientation", slice(3, 6)),)}
        kinds = {"position": parts["position"], "pose": parts["position"] + parts["orientation"]}
        return tuple(
            Component(i, quantity, columns)
            for i, data in enumerate(self.measurements)
            for quantity, columns in kinds[data.kind]
        )

    def machine(self, x: Array) -> Machine:
        """Return the machine at parameter values x (p,)."""
        return machine(self.model.robot, self.parameters, self.reference, x, self.held)


class Evaluation(NamedTuple):
    """Residuals of every set (N, d) in m and rad, and a triangle (q, p + 1) of ``[J r]`` for every component.

    Columns of J are scaled: they are derivatives for one ordinary deviation of each parameter. Rows are whitened by
    the sigmas that were given.
    """

    residuals: tuple[Array, ...]
    triangles: tuple[Array, ...]


def evaluate(problem: Problem, sigmas: Sequence[Array], x: Array) -> Evaluation:
    """Evaluate residuals and reduced Jacobians at parameter values x (p,); ``sigmas``: an (N, d) array for each set."""
    columns = len(problem.parameters) + 1
    triangles = [np.empty((0, columns)) for _ in problem.components]
    found: list[Array] = []
    at = problem.machine(x)
    for i, (data, sigma) in enumerate(zip(problem.measurements, sigmas, strict=True)):
        parts: list[Array] = []
        for rows, observed, J in blocks(problem, data, at, scales(problem.parameters)):
            parts.append(observed.residual)
            whitened = np.concatenate([J, observed.residual[:, :, None]], axis=2) / sigma[rows, :, None]
            for c, component in enumerate(problem.components):
                if component.measurements == i:
                    block = whitened[:, component.columns].reshape(-1, columns)
                    triangles[c] = linear.triangle(np.concatenate([triangles[c], block]))
        found.append(np.concatenate(parts))
    return Evaluation(tuple(found), tuple(triangles))


def jacobian(problem: Problem, x: Array) -> tuple[Array, ...]:
    """Return the unwhitened Jacobians (N, d, p) of the residuals, in m and rad per SI unit of each parameter."""
    at, found = problem.machine(x), []
    for data in problem.measurements:
        J = np.empty((*data.sigma.shape, len(problem.parameters)))
        for rows, _, block in blocks(problem, data, at, np.ones(len(problem.parameters))):
            J[rows] = block
        found.append(J)
    return tuple(found)


def residuals(robot: Robot, measurements: Sequence[Measurements], at: Machine) -> tuple[Array, ...]:
    """Return the residuals (N, 3 or 6) of every set, measured minus predicted, in m and rad, for a machine."""
    return tuple(
        _observe(
            data,
            slice(None),
            at.frames.base @ robot.tips(data.readings, at.deviations) @ at.frames.tools[data.tool],
        ).residual
        for data in measurements
    )


def _observe(data: Measurements, rows: slice, tools: Array) -> Linearised:
    if data.orientation is None:
        return position.residual(data.position[rows], tools)
    return pose.residual(data.position[rows], data.orientation[rows], tools)


def blocks(
    problem: Problem, data: Measurements, at: Machine, units: Array
) -> Iterator[tuple[slice, Linearised, Array]]:
    """Yield rows, residuals and Jacobians (n, d, p) of one set, block by block.

    ``units`` (p,): derivatives are taken for so much of every parameter.
    """
    robot, tools = problem.model.robot, at.frames.tools
    layout = Layout(robot)
    S = directions(problem.parameters, layout.tools + 6 * len(tools)) * units
    of_robot, of_tools = S[: layout.terms], S[layout.tools :].reshape(len(tools), 6, -1)
    tip = TipModel(robot, at.deviations)
    joints = tip.joints @ of_robot
    joints[:6] += tip.base_column @ at.base_twists @ S[layout.base : layout.tools]
    # What moves a tool beside the joints: its own pose, and what lies behind the last joint.
    to_tool = rigid.adjoint(rigid.inverse(tools))
    by_tool = to_tool @ (tip.tail @ of_robot) + at.tool_twists @ of_tools
    size = BLOCK // data.sigma.shape[1]
    for start in range(0, len(data), size):
        rows = slice(start, start + size)
        tool = data.tool[rows] if len(tools) > 1 else 0
        try:
            motion = tip.motion(data.readings[rows])
        except PoseError as e:
            raise PoseError(start + e.row, e.reason) from e
        observed = _observe(data, rows, at.frames.base @ motion.placement @ tools[tool])
        # Residual per local twist of the tip link, then per local twist of every joint placement.
        by_tip = _times(observed.twist, to_tool[tool])
        J = _times(by_tip @ motion.regressor, joints)
        J += _times(observed.twist, by_tool[tool])
        if robot.loops:
            J += (by_tip @ motion.by_passive) @ (motion.rates @ of_robot)
        if robot.terms:
            J += _times(by_tip @ motion.by_terms, S[layout.terms : layout.base])
        yield rows, observed, J


def _times(rows: Array, matrix: Array) -> Array:
    """Return rows (n, d, a) times one matrix (a, b) for all, in a single product, or one for each row (n, a, b)."""
    if matrix.ndim == 2:
        return np.asarray((rows.reshape(-1, len(matrix)) @ matrix).reshape(*rows.shape[:2], -1))
    return np.asarray(rows @ matrix)
