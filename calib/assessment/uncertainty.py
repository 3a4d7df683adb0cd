"""Doubts about a calibrated machine: how sure is it of where its tool is, at any configuration.

The covariance of the parameters goes to the tool by the exact derivative of its pose: ``J C J^T``. What the data cannot
see has no covariance; how far it would move the tool is told beside it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, BoolArray, read_only
from calib.foundations.chance import bound
from calib.foundations.errors import MeasurementError
from calib.foundations.linear import one_thread
from calib.identification.error_model import ErrorModel
from calib.identification.fit import Fit
from calib.identification.machine import Frames, Layout, Machine
from calib.identification.parameters import Parameter, directions, scales
from calib.identification.system import Problem, blocks
from calib.measurement.kinds import UNIT_OF
from calib.measurement.measurements import Measurements, unmeasured
from calib.robot.conditions import Conditions, ordinary
from calib.robot.robot import Deviations, Robot
from calib.robot.sampling import random_readings
from calib.robot.transmission import lacking

# Directions of the covariance below this share of the largest are rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class NoiseLevel:
    """Noise of one coordinate of a quantity, in m or rad: the model's part, and both parts together.

    ``degrees_of_freedom`` of the estimate: infinite where nothing was estimated, as the instrument explains all.
    """

    model: float
    total: float
    degrees_of_freedom: float


class Shifts(Protocol):
    """What a calibrated machine adds to its positions: a sector grid, a Gaussian process, or another."""

    def shifts(self, base: Array, tips: Array, readings: Array) -> Array:
        """Return vectors (N, 3) in the instrument's axes, finite; ``base`` (4, 4) is there, ``tips`` in the base."""


def shifted(known: Shifts, tips: Array, readings: Array) -> Array:
    """Return the tips (N, 4, 4) in the base link, from those without them, with what a residual model adds."""
    found = np.array(tips)
    found[:, :3, 3] += known.shifts(np.eye(4), tips, readings)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """What is known about a calibrated machine's doubts. Made by :func:`uncertainty_of`, kept in the results' folder.

    All is told in the state of the machine (:mod:`calib.identification.machine`), n numbers for the robot of the URDF,
    its base and its tools; angles of base and tools are small turns of where they are. ``factor`` (n, r): the
    covariance of the state is ``factor @ factor.T``. ``unseen`` (n, k): changes of the state that the data do not see,
    each one ordinary deviation long. ``position`` and ``orientation``: the noise of lengths and of angles, None where
    none was measured. ``identified`` (nr, 2): least and greatest of every reading in the data. ``residual_model``: what
    the machine adds to positions, if anything.
    """

    robot: Robot
    machine: Machine
    tools: tuple[str, ...]
    factor: Array
    unseen: Array
    position: NoiseLevel | None
    orientation: NoiseLevel | None
    identified: Array
    residual_model: Shifts | None = None

    def tips(self, readings: Array, conditions: Conditions | None = None) -> Array:
        """Return where the calibrated machine's tip is (N, 4, 4) in its base link, the residual model included.

        At readings (N, nr), under ``conditions``, the ordinary ones when None. Raises as :meth:`calib.Robot.tips` does.
        """
        tips = self.robot.tips(readings, self.machine.deviations, conditions or ordinary(readings))
        return tips if self.residual_model is None else shifted(self.residual_model, tips, readings)

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom of the covariance: the fewest of what it was estimated from."""
        levels = (self.position, self.orientation)
        return min((level.degrees_of_freedom for level in levels if level is not None), default=float("inf"))


@dataclass(frozen=True, slots=True, eq=False)
class ToolUncertainty:
    """How sure the tool's pose is at N configurations.

    ``covariance`` (N, 6, 6): of the position, in the axes of the instrument (of the base, where the base is left out),
    and of small turns about the tool's axes, in m and rad. ``unseen`` (N, 2): rms of what one ordinary deviation along
    every direction that the data do not see would add to the position, in m, and to the orientation, in rad.
    ``degrees_of_freedom``: as in :class:`Uncertainty`.
    """

    covariance: Array
    unseen: Array
    degrees_of_freedom: float

    @property
    def position(self) -> Array:
        """Standard deviations (N,) of the position, all three coordinates together, in m."""
        return _root_trace(self.covariance[:, :3, :3])

    @property
    def orientation(self) -> Array:
        """Standard deviations (N,) of the orientation, all three turns together, in rad."""
        return _root_trace(self.covariance[:, 3:, 3:])

    @property
    def seen(self) -> BoolArray:
        """Whether (N, 2) position and orientation are known: ordinary unseen deviations add less than sigma."""
        return np.asarray(self.unseen <= np.stack([self.position, self.orientation], axis=1))

    def inside(self, errors: Array, probability: float = 0.95) -> BoolArray:
        """Return which position errors (N, 3) are inside the region (an ellipsoid) of the given probability.

        With estimated noise the bound follows F(3, degrees of freedom), else chi-square.
        """
        distance = np.einsum(
            "ni,ni->n", errors, np.linalg.solve(self.covariance[:, :3, :3], errors[:, :, None])[..., 0]
        )
        return np.asarray(distance <= squared_bound(probability, 3, self.degrees_of_freedom))


def squared_bound(probability: float, dimensions: int, degrees_of_freedom: float) -> float:
    """Return the squared Mahalanobis radius of a region: k F(k, nu) with estimated noise, chi-square(k) without."""
    return bound(probability, dimensions, degrees_of_freedom)


@checked
def uncertainty_of(fit: Fit) -> Uncertainty:
    """Return the doubts about the machine of a fit, in the frames of its URDF."""
    source, machine = Layout(fit.robot), fit.machine
    own = Layout(fit.model.robot)
    # Targets and lengths are no part of the machine, which the results are about.
    to_state = directions(fit.parameters, Layout.of(fit.model.robot, machine.frames).size)
    parts = [to_state[: own.offsets], to_state[own.offsets : own.base]]
    if fit.model.dh is not None:
        parts[0] = fit.model.dh.source_rates(machine.deviations) @ parts[0]
    frames = np.concatenate([machine.frames.base[None], machine.frames.tools])
    twists = np.concatenate([machine.base_twists[None], machine.tool_twists])
    for k, (T, W) in enumerate(zip(frames, twists, strict=True)):
        local = W @ to_state[own.base + 6 * k : own.base + 6 * k + 6]
        parts.append(np.concatenate([T[:3, :3] @ local[:3], local[3:]]))
    state = np.concatenate(parts)
    assert len(state) == source.tools + 6 * len(machine.frames.tools), "one state of the machine, two ways"
    s = scales(fit.parameters)
    readings = np.concatenate([end.readings for data in fit.measurements for end in data.ends])
    return Uncertainty(
        fit.robot,
        placed_machine(fit.deviations, machine.frames),
        fit.measurements[0].tools,
        read_only(state @ _factor(fit.covariance, s)),
        read_only(state @ (fit.unseen * s[:, None])),
        _level(fit, "m"),
        _level(fit, "rad"),
        read_only(np.stack([readings.min(axis=0), readings.max(axis=0)], axis=1)),
    )


@checked
def tool_uncertainty(
    uncertainty: Uncertainty,
    readings: npt.ArrayLike,
    tool: str = "tool",
    *,
    base: bool = True,
    tool_pose: bool = True,
    conditions: Conditions | None = None,
) -> ToolUncertainty:
    """Return how sure the pose of a tool is at readings (N, nr) in rad and m.

    ``base``: of the tool in the instrument's frame, else in the robot's base. ``tool_pose``: with the doubts about the
    tool itself, else those of the arm alone, at the tool's place. ``conditions`` of the rows; when None, reached from
    neither side, at 20 degC, no torque measured. Raises MeasurementError for an unknown tool, readings that are not the
    robot's, or conditions that lack what a joint term needs.
    """
    found = _readings(uncertainty, readings)
    if conditions is not None:
        refuse_lacking(uncertainty.robot, conditions, "the readings")
    J, r = tool_motions(uncertainty, found, tool, base=base, tool_pose=tool_pose, conditions=conditions)
    seen, unseen = J[:, :, :r], J[:, :, r:]
    sizes = np.sqrt(
        np.stack([np.sum(unseen[:, :3] ** 2, axis=(1, 2)), np.sum(unseen[:, 3:] ** 2, axis=(1, 2))], axis=1)
    )
    return ToolUncertainty(read_only(seen @ np.swapaxes(seen, 1, 2)), read_only(sizes), uncertainty.degrees_of_freedom)


def common_errors(uncertainty: Uncertainty, data: Measurements) -> Array:
    """Return a factor (N, 3 or 6, r) of the covariance that the predictions of all rows of ``data`` have together.

    Errors of the parameters are common to all rows: column j is what one standard deviation of them does to every row.
    Raises MeasurementError for a tool that was not identified.
    """
    size = data.sigma.shape[1]
    found = np.zeros((len(data), size, uncertainty.factor.shape[1]))
    for k, tool in enumerate(data.tools):
        rows = np.flatnonzero(data.tool == k)
        if len(rows):
            own = data.conditions.subset(rows)
            J, r = tool_motions(uncertainty, data.readings[rows], tool, conditions=own)
            found[rows] = J[:, :size, :r]
    return found


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyMap:
    """Standard deviations over the workspace, at N random configurations.

    ``readings`` (N, nr); ``positions`` (N, 3) of the tool in the base, in m; ``sigmas`` (N, 2) of position and
    orientation in m and rad; ``unseen`` (N, 2) as in :class:`ToolUncertainty`.
    """

    readings: Array
    positions: Array
    sigmas: Array
    unseen: Array


@checked
def uncertainty_map(
    uncertainty: Uncertainty,
    samples: int = 2000,
    *,
    tool: str = "tool",
    limits: Array | None = None,
    base: bool = True,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda _done, _of: None,
) -> UncertaintyMap:
    """Return a map of the tool's standard deviations, over ``limits`` (nr, 2) or, when None, the joints' limits.

    Joints without limits turn once. ``progress`` is told how many of how many are done.
    """
    readings = random_readings(uncertainty.robot, samples, limits, (uncertainty.machine.deviations,), seed=seed)
    found: list[ToolUncertainty] = []
    for chunk in np.array_split(readings, max(samples // 500, 1)):
        found.append(tool_uncertainty(uncertainty, chunk, tool, base=base))
        progress(sum(len(f.unseen) for f in found), samples)
    k = _tool_number(uncertainty, tool)
    tips = uncertainty.tips(readings) @ uncertainty.machine.frames.tools[k]
    return UncertaintyMap(
        read_only(readings),
        read_only(tips[:, :3, 3]),
        read_only(np.concatenate([np.stack([f.position, f.orientation], axis=1) for f in found])),
        read_only(np.concatenate([f.unseen for f in found])),
    )


def placed_machine(deviations: Deviations, frames: Frames) -> Machine:
    """Return the machine whose base and tools have their angles counted from where they are."""

    def twists(T: Array) -> Array:
        W = np.eye(6)
        W[:3, :3] = T[:3, :3].T
        return W

    tools = np.stack([twists(T) for T in frames.tools])
    return Machine(deviations, Frames(frames.base, frames.tools), twists(frames.base), tools, np.zeros((0, 6, 6)))


def _factor(covariance: Array, s: Array) -> Array:
    """Return F (p, r) with ``F F^T = covariance``, of as many columns as something is known of."""
    values, vectors = np.linalg.eigh(covariance / (s[:, None] * s))
    kept = values > _ROUNDING * max(float(values.max(initial=0.0)), 0.0)
    return np.asarray(s[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


def _level(fit: Fit, unit: str) -> NoiseLevel | None:
    parts = [noise for noise in fit.noise if UNIT_OF[noise.quantity] == unit]
    freedom = np.array([noise.degrees_of_freedom for noise in parts])
    if not parts or freedom.sum() <= 0.0:
        return None
    model, total = (
        float(np.sqrt(np.average([level**2 for level in levels], weights=freedom)))
        for levels in ([noise.model for noise in parts], [noise.total for noise in parts])
    )
    # The estimate of the total has the freedom of the residuals; where nothing had to be added, it is not an estimate.
    return NoiseLevel(model, total, float(freedom.sum()) if model > 0.0 else float("inf"))


def tool_motions(
    uncertainty: Uncertainty,
    readings: Array,
    tool: str,
    *,
    base: bool = True,
    tool_pose: bool = True,
    conditions: Conditions | None = None,
) -> tuple[Array, int]:
    """Return the motions (N, 6, r + k) of the tool for every column of ``factor`` and ``unseen``, and r.

    Arguments and axes as of :func:`tool_uncertainty`.
    """
    robot, machine = uncertainty.robot, uncertainty.machine
    layout, number = Layout(robot), _tool_number(uncertainty, tool)
    columns = np.hstack([uncertainty.factor, uncertainty.unseen])
    if not base:
        columns[layout.base : layout.tools] = 0.0
    if not tool_pose:
        columns[layout.tools :] = 0.0
    parameters = tuple(
        Parameter(f"column {j}", "m", "placement", tuple((int(i), float(column[i])) for i in np.flatnonzero(column)))
        for j, column in enumerate(columns.T)
    )
    model = ErrorModel(robot, (), (), "pose", "pose")
    told = conditions or ordinary(readings)
    placed = machine.frames.base @ robot.tips(readings, machine.deviations, told) @ machine.frames.tools[number]
    data = unmeasured(
        [reading.name for reading in robot.readings],
        readings,
        placed[:, :3, 3],
        placed[:, :3, :3],
        tools=uncertainty.tools,
        tool=number,
        conditions=told,
        where="prediction",
    )
    problem = Problem(model, parameters, machine.frames, (data,))
    with one_thread():
        # Of a residual, measured minus predicted, that is zero: the prediction moves the other way.
        J = -np.concatenate([block.J for block in blocks(problem, data, machine, np.ones(len(parameters)))])
    if not base:
        J[:, :3] = machine.frames.base[:3, :3].T @ J[:, :3]
    return J, uncertainty.factor.shape[1]


def refuse_lacking(robot: Robot, conditions: Conditions, where: str) -> None:
    """Raise MeasurementError where a joint term of the robot needs a condition that rows do not have."""
    if missing := lacking(robot.terms, [reading.name for reading in robot.readings], conditions):
        raise MeasurementError(f"{where}: there is no column {missing[1]!r}, which {missing[0]} needs.")


def _tool_number(uncertainty: Uncertainty, tool: str) -> int:
    if tool not in uncertainty.tools:
        known = ", ".join(map(repr, uncertainty.tools))
        raise MeasurementError(f"there is no tool {tool!r}; the calibrated tools are {known}.")
    return uncertainty.tools.index(tool)


def _readings(uncertainty: Uncertainty, readings: npt.ArrayLike) -> Array:
    found, width = np.asarray(readings, dtype=np.float64), len(uncertainty.robot.readings)
    if found.ndim != 2 or found.shape[1] != width or not len(found) or not np.isfinite(found).all():
        raise MeasurementError(f"readings of shape {found.shape}: needs finite numbers (N, {width}), one row or more.")
    return found


def _root_trace(covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.trace(covariance, axis1=1, axis2=2)))


# ---- the identified set


@checked
def outside_identified(uncertainty: Uncertainty, readings: Array) -> tuple[str, ...]:
    """Return, for every joint whose readings (N, nr) leave the range it was identified in, one sentence.

    Beyond the outermost pose by more than a twentieth of the range; whole turns of a revolute joint do not count. A
    model is only proven where it was measured: outside, the stated sigmas hold if the model is right. Raises
    MeasurementError for readings of another shape.
    """
    readings = _readings(uncertainty, readings)
    said = []
    low, high = uncertainty.identified.T
    slack = 0.05 * (high - low)
    for j, reading in enumerate(uncertainty.robot.readings):
        values = readings[:, j]
        if reading.dimension == "angle":
            middle = 0.5 * (low[j] + high[j])
            values = values - 2.0 * np.pi * np.round((values - middle) / (2.0 * np.pi))
        beyond = np.maximum(low[j] - slack[j] - values, values - high[j] - slack[j])
        if np.any(beyond > 0.0):
            worst = int(np.argmax(beyond))
            factor, unit = {"angle": (180.0 / np.pi, "deg"), "length": (1e3, "mm")}[reading.dimension]
            said.append(
                f"{reading.name} is outside the range it was identified in, {low[j] * factor:.4g} to "
                f"{high[j] * factor:.4g} {unit}, in {np.count_nonzero(beyond > 0.0)} of {len(readings)} rows; "
                f"the farthest is {readings[worst, j] * factor:.4g} {unit}."
            )
    return tuple(said)
