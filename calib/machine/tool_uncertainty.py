"""How sure is a calibrated machine of where its tool is, at any configuration: a budget.

Errors of the machine go to the tool by the exact derivative of its pose. What the model leaves out moves the tool
itself as well, and only the difference is an error: small where the machine was fitted to it, full where it was not.
What the data do not show has the width of not knowing.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.errors import JobError
from calib.foundations.linear import one_thread, triangle
from calib.foundations.ranges import finite
from calib.machine.calibrated import CalibratedMachine, readings_of, refuse_unfollowed
from calib.machine.identified import usual_conditions
from calib.machine.residual_model import ResidualModel, axes_of
from calib.machine.tool_motion import jacobian_of
from calib.machine.uncertainty import CAUSES, ToolUncertainty, Uncertainty, UncertaintyMap
from calib.machine.winding import ReadingErrors
from calib.measurement.conditions import refuse_lacking
from calib.measurement.measurements import Measurements
from calib.robot.conditions import Conditions, ordinary
from calib.robot.robot import TipModel, TipMotion
from calib.robot.sampling import random_readings

# Rows whose derivatives are in memory at a time, and numbers of these: moving more to and fro takes twice the time.
_BLOCK, _NUMBERS = 500, 1_000_000


@checked
def tool_uncertainty(
    machine: CalibratedMachine,
    readings: npt.ArrayLike,
    tool: str = "tool",
    *,
    base: bool = True,
    tool_pose: bool = True,
    conditions: Conditions | None = None,
) -> ToolUncertainty:
    """Return how sure the pose of a tool is at readings (N, nr) in rad and m.

    ``base``: if true, in the instrument's frame, else in the robot's base. ``tool_pose``: if true, with the uncertainty
    of the tool's pose on its link, else that of the arm alone, at the tool's place. ``conditions`` of the rows; when
    None, reached from neither side, at 20 degC, no torque measured. Raises MeasurementError for a machine without known
    uncertainty, an unknown tool, readings that are not the robot's, or conditions that lack what a joint term needs.
    """
    found, known = readings_of(machine, readings), machine.known_uncertainty
    if conditions is not None:
        refuse_lacking(machine.robot, conditions, "the readings")
        refuse_unfollowed(machine.robot, conditions)
    told = conditions or ordinary(found)
    view = _View(machine.of(tool), tool, base=base, tool_pose=tool_pose)
    return _blocks(_Errors(view, known), found, told)


@checked
def tool_errors(
    machine: CalibratedMachine, readings: npt.ArrayLike, tool: str = "tool", *, conditions: Conditions | None = None
) -> Array:
    """Return a factor (N, 6, r) of the covariance that the poses of a tool have together, at readings (N, nr).

    Errors of the machine are common to all configurations, and so is what the model leaves out along the readings:
    column j is what one standard deviation of such an error does to every pose, axes as of :class:`ToolUncertainty`.
    Scatter from pose to pose comes on top. Arguments and errors as of :func:`tool_uncertainty`.
    """
    found = readings_of(machine, readings)
    return link_errors(machine, found, tool, tool_pose=True, conditions=conditions or ordinary(found))[0]


def link_errors(
    machine: CalibratedMachine, readings: Array, tool: str, *, tool_pose: bool, conditions: Conditions
) -> tuple[Array, Array]:
    """Return :func:`tool_errors` (N, 6, r), and what every direction of the null space does (N, 6, k).

    ``tool_pose``: if false, of the link that carries the tool, at the tool's place.
    """
    errors = _Errors(_View(machine.of(tool), tool, base=True, tool_pose=tool_pose), machine.known_uncertainty)
    with one_thread(of_scipy=False):
        many = _at_once(machine)
        blocks = [slice(start, start + many) for start in range(0, len(readings), many)]
        found, unseen = zip(*(errors.at(readings[rows], conditions.subset(rows)) for rows in blocks), strict=True)
    return np.concatenate(found), np.concatenate(unseen)


def _at_once(machine: CalibratedMachine) -> int:
    """Return of how many rows the derivatives by the machine's state are made at a time."""
    return max(1, min(_BLOCK, _NUMBERS // (6 * machine.layout.size)))


def common_errors(machine: CalibratedMachine, data: Measurements) -> Array:
    """Return :func:`tool_errors` (N, 3 or 6, r) at the rows of ``data``, each with its own tool and set-up.

    Raises MeasurementError for a tool or a set-up that was not identified.
    """
    size, known = data.sigma.shape[1], machine.known_uncertainty
    found = np.zeros((len(data), size, known.factor.shape[1]))
    for setup, tool, rows in by_pair(data):
        own = data.conditions.subset(rows)
        found[rows] = tool_errors(machine.at(setup), data.readings[rows], tool, conditions=own)[:, :size]
    return found


def row_noise(machine: CalibratedMachine, data: Measurements) -> Array:
    """Return the standard deviations (N, 3 or 6) of the rows of ``data``: the instrument's part and the model's.

    As rows of their set-up and tool scatter; nan where nothing of the kind was measured.
    """
    known, found = machine.known_uncertainty, np.full(data.sigma.shape, np.nan)
    for setup, tool, rows in by_pair(data):
        for q, level in enumerate(known.noise(setup, tool)):
            columns = slice(3 * q, 3 * q + 3)
            if level is not None:
                found[rows, columns] = level.of_rows(data.sigma[rows, columns])
    return found


def row_freedom(machine: CalibratedMachine, data: Measurements) -> Array:
    """Return the degrees of freedom (N,) of the uncertainty of rows of ``data``, in their set-ups with their tools."""
    found = np.full(len(data), np.inf)
    for setup, tool, rows in by_pair(data):
        found[rows] = machine.known_uncertainty.freedom(setup, tool)
    return found


def by_pair(data: Measurements) -> Iterator[tuple[str, str, IntArray]]:
    """Yield every set-up and tool of rows, and the rows (n,) that have both."""
    pairs, number = np.unique(np.column_stack([data.setup, data.tool]), axis=0, return_inverse=True)
    for k, (setup, tool) in enumerate(pairs.tolist()):
        yield data.setups[setup], data.tools[tool], np.flatnonzero(number.reshape(-1) == k)


def residual_errors(machine: CalibratedMachine, data: Measurements) -> Array:
    """Return a factor (N, 3 or 6, r) of the covariance of what a residual model gets wrong at the rows of ``data``.

    It is part of the budget of :func:`tool_uncertainty`, and comes on top of :func:`common_errors`. Without columns
    where there is no residual model. Raises MeasurementError for a set-up that was not identified.
    """
    model, level = machine.residual_model, machine.known_uncertainty.position
    if model is None or level is None:
        return np.zeros((*data.sigma.shape, 0))
    own = model.own_errors(data.readings, level.total)
    if own.shape[1] > len(own):
        # Cells of many joints have many corners.
        own = triangle(own.T).T
    tips = machine.robot.tips(data.readings, machine.deviations, data.conditions)
    axes = axes_of(model.frame, machine.state.frames.bases[data.setup], tips)
    found = np.zeros((*data.sigma.shape, 3 * own.shape[1]))
    found[:, :3] = (axes[:, :, :, None] * own[:, None, None]).reshape(len(data), 3, -1)
    return found


class _View:
    """Whose errors are told, and which of them: as :func:`tool_uncertainty` has it. The machine's tip is the tool's.

    Not to be shared by threads: it holds scratch memory.
    """

    def __init__(self, machine: CalibratedMachine, tool: str, *, base: bool, tool_pose: bool) -> None:
        self.machine, self.tool, self.base, self._tool_pose = machine, tool, base, tool_pose
        self.T_tool, self._number = machine.tools[tool], list(machine.tools).index(tool)
        self._tips = TipModel(machine.robot, machine.deviations)
        self._layout, self._state = machine.layout, machine.state

    def of(self, machine: CalibratedMachine, tool: str) -> "_View":
        """Return the same of another machine, and of another tool."""
        return _View(machine, tool, base=self.base, tool_pose=self._tool_pose)

    def at(self, readings: Array, conditions: Conditions) -> "_Seen":
        """Return how the tip moves at readings (N, nr). Raises as :meth:`Robot.motion` does."""
        return _Seen(self, self._tips.motion(self.machine.robot.own(readings), conditions), readings, conditions)

    def told(self, changes: Array) -> Array:
        """Return changes (n, k) of the state without those that are not told."""
        found, layout = np.array(changes), self._layout
        if not self.base:
            found[layout.base : layout.tools] = 0.0
        if not self._tool_pose:
            found[layout.tools :] = 0.0
        return found

    def jacobian(self, motion: TipMotion) -> Array:
        """Return the derivatives (N, 6, n) of the tool's pose by the state, in the instrument's axes."""
        return jacobian_of(motion, self._layout, self._state, self._number)


class _Seen(NamedTuple):
    """The tool at some readings (N, nr), as a view has it, once for all that is asked of these rows."""

    view: _View
    motion: TipMotion
    readings: Array
    conditions: Conditions

    def motions(self, changes: Sequence[Array]) -> list[Array]:
        """Return the motions (N, 6, k) of the tool for each of several changes (n, k) of the state."""
        J = self.view.jacobian(self.motion)
        flat = J.reshape(-1, J.shape[2])  # one large product takes half the time of many small ones
        found = [(flat @ columns).reshape(len(J), 6, -1) for columns in changes]
        if not self.view.base:
            for moved in found:
                moved[:, :3] = self.view.machine.base[:3, :3].T @ moved[:, :3]
        return found

    def misread(self, errors: ReadingErrors) -> Array:
        """Return what each error of the readings, of its width, does to the tool itself (N, 6, many)."""
        machine, T_tool = self.view.machine, self.view.T_tool
        by_reading = rigid.adjoint(rigid.inverse(T_tool)) @ self.motion.by_readings(self.readings)
        axes = (self.motion.placement @ T_tool)[:, :3, :3]
        by_reading[:, :3] = (machine.base[:3, :3] @ axes if self.view.base else axes) @ by_reading[:, :3]
        return errors.at(self.readings, self.conditions, by_reading)

    def axes(self, model: ResidualModel) -> Array:
        """Return the axes (N, 3, 3) in which a residual model has its errors, seen as the tool's position is."""
        return axes_of(model.frame, self.view.machine.base if self.view.base else np.eye(4), self.motion.placement)


class _Errors:
    """The errors of a tool's pose at any readings, block by block."""

    def __init__(self, view: _View, known: Uncertainty) -> None:
        self.view, self.known = view, known
        self._changes = [view.told(known.factor), view.told(known.null_basis)]
        left_out = known.left_out
        self._of_readings = left_out and ReadingErrors(view.machine.robot, left_out.waves, left_out.wind_up)
        # What a residual model leans on, which neighbours share: of every point, by its bytes, where its errors are.
        self._numbers: dict[bytes, int] = {}
        self._there = np.zeros((0, 3, known.factor.shape[1]))
        # Not itself, where it was measured here: what refers to itself stays until somebody looks for it, with all of a
        # model's scratch memory.
        self._elsewhere = self._measured_elsewhere()

    def at(self, readings: Array, conditions: Conditions) -> tuple[Array, Array]:
        """Return a factor (N, 6, r) of the covariance of the tool's pose, but for scatter, at readings (N, nr).

        And what the null space does to the pose (N, 6, k).
        """
        seen = self.view.at(readings, conditions)
        found, unseen = self._of_kinematics(seen)
        model = self.view.machine.residual_model
        if model is None:
            return found, unseen
        # What a residual model adds are errors that were measured elsewhere: what these have in common is gone.
        # Neighbours lean on the same ones, so that each is looked at once, in the model's own axes.
        lean = model.leaning(readings)
        used = lean.weights != 0.0
        if used.any():
            number = np.zeros(used.shape, dtype=np.intp)
            number[used] = self._leant_on(model, lean.points[used])
            common = np.zeros_like(found[:, :3])
            for c in range(used.shape[1]):
                common += lean.weights[:, c, None, None] * self._there[number[:, c]]
            found[:, :3] -= seen.axes(model) @ common
        if self._elsewhere is None:
            found[:, :3] *= lean.unknown[:, None, None]
        elif (lean.unknown != 1.0).any():
            # What base and load of this set-up, or this tool, err by was not measured with the others.
            there = self._elsewhere.view.at(readings, conditions)
            measured = np.swapaxes(there.axes(model), 1, 2) @ self._elsewhere._of_kinematics(there)[0][:, :3]
            found[:, :3] -= seen.axes(model) @ (measured * (1.0 - lean.unknown)[:, None, None])
        return found, unseen

    def _measured_elsewhere(self) -> "_Errors | None":
        """Return the errors where a residual model was measured, if it was in another set-up or with another tool."""
        machine, tool = self.view.machine, self.view.tool
        model = machine.residual_model
        if model is None:
            return None
        setup = machine.setup if machine.setup in model.setups else next(iter(model.setups), machine.setup)
        there = tool if tool in model.tools else next(iter(model.tools), tool)
        if (setup, there) == (machine.setup, tool) or setup not in machine.bases or there not in machine.tools:
            return None
        other = replace(machine.at(setup), residual_model=None)
        return _Errors(self.view.of(other, there), other.known_uncertainty)

    def _of_kinematics(self, seen: _Seen) -> tuple[Array, Array]:
        found, unseen = seen.motions(self._changes)
        left_out = self.known.left_out
        if left_out is not None and self._of_readings is not None and len(found):
            # The machine has followed them as far as it could, which is less than the tool does.
            found[:, :, -left_out.columns :] -= seen.misread(self._of_readings) @ left_out.root
        return found, unseen

    def _leant_on(self, model: ResidualModel, points: Array) -> IntArray:
        """Return the numbers (k,) in ``_there`` of the errors at points (k, nr), and find those that are new there."""
        at, own = np.unique(points, axis=0, return_inverse=True)
        names = [point.tobytes() for point in at]
        new = [k for k, name in enumerate(names) if name not in self._numbers]
        measured = self._elsewhere or self
        for start in range(0, len(new), _BLOCK):
            rows = at[new[start : start + _BLOCK]]
            seen = measured.view.at(rows, ordinary(rows))
            errors = np.swapaxes(seen.axes(model), 1, 2) @ measured._of_kinematics(seen)[0][:, :3]
            self._there = np.concatenate([self._there, errors])
        self._numbers.update(zip([names[k] for k in new], itertools.count(len(self._numbers)), strict=False))
        return np.array([self._numbers[name] for name in names], dtype=np.intp)[own.reshape(-1)]


def _blocks(errors: _Errors, readings: Array, conditions: Conditions) -> ToolUncertainty:
    """Return how sure the tool's pose is at readings (N, nr), block by block."""
    parts = []
    with one_thread(of_scipy=False):
        for start in range(0, len(readings), many := _at_once(errors.view.machine)):
            rows = slice(start, start + many)
            parts.append(_of_block(errors, readings[rows], conditions.subset(rows)))
    covariance, sizes, squares = (read_only(np.concatenate(part)) for part in zip(*parts, strict=True))
    budget = {cause: read_only(np.sqrt(squares[:, k])) for k, cause in enumerate(CAUSES)}
    return ToolUncertainty(covariance, sizes, budget, errors.known.freedom(errors.view.machine.setup, errors.view.tool))


def _of_block(of: _Errors, readings: Array, conditions: Conditions) -> tuple[Array, Array, Array]:
    """Return covariances (N, 6, 6), what the null space adds (N, 2), and the variances (N, 4, 2) of all causes."""
    known, model = of.known, of.view.machine.residual_model
    errors, unseen = of.at(readings, conditions)
    squares = np.zeros((len(readings), len(CAUSES), 2))
    ends = np.cumsum([0, *known.causes])
    for k, (start, end) in enumerate(itertools.pairwise(ends)):
        squares[:, k] = _by_quantity(errors[:, :, start:end])
    scatter = np.zeros((len(readings), 6))
    for k, level in enumerate(known.noise(of.view.machine.setup, of.view.tool)):
        if level is not None:
            scatter[:, 3 * k : 3 * k + 3] = level.model**2
    squares[:, CAUSES.index("model")] += scatter.reshape(-1, 2, 3).sum(axis=2)
    if model is not None and known.position is not None:
        lean = model.leaning(readings)
        own = lean.sigma**2 + np.sum(lean.weights**2, axis=1) * known.position.total**2
        own += model.scatter(known.position.total) ** 2
        squares[:, CAUSES.index("residual_model"), 0] = 3.0 * own
        scatter[:, :3] += own[:, None]
    covariance = errors @ np.swapaxes(errors, 1, 2)
    covariance[:, range(6), range(6)] += scatter
    return covariance, np.sqrt(_by_quantity(unseen)), squares


def _by_quantity(motions: Array) -> Array:
    """Return the sums of squares (N, 2) of motions (N, 6, k), of positions and of turns."""
    return np.asarray(np.sum(motions**2, axis=2).reshape(-1, 2, 3).sum(axis=2))


@checked
def uncertainty_map(
    machine: CalibratedMachine,
    samples: int = 2000,
    *,
    tool: str = "tool",
    limits: Array | None = None,
    closure_determinant: float | None = None,
    base: bool = True,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda _done, _of: None,
) -> UncertaintyMap:
    """Return a map of the tool's standard deviations, over ``limits`` (nr, 2) or, when None, the joints' limits.

    Joints without limits turn once. Where joint terms follow a temperature it is the middle of those that were
    measured. ``closure_determinant``: how near loops may come to a dead centre, as
    :class:`Uncertainty` has it; all poses in which they close when None. ``progress`` is told how many of how many are
    done. Raises JobError for numbers out of range.
    """
    if closure_determinant is not None:
        said = f"closure_determinant is {closure_determinant}; needs a finite number."
        finite(closure_determinant, (), said, JobError)
    readings = random_readings(
        machine.robot, samples, limits, (machine.deviations, None), determinant=closure_determinant, seed=seed
    )
    view = _View(machine.of(machine.tool_named(tool)), tool, base=base, tool_pose=True)
    errors, done = _Errors(view, machine.known_uncertainty), 0
    parts: list[tuple[Array, ...]] = []
    for chunk in np.array_split(readings, max(samples // _BLOCK, 1)):
        usual = usual_conditions(view.machine, chunk)
        found = _blocks(errors, chunk, usual)
        # Of many poses the covariances, and the placements of all joints, are what takes memory.
        positions = (view.machine.tips(chunk, usual) @ view.T_tool)[:, :3, 3].copy()
        sigmas = np.stack([found.position, found.orientation], axis=1)
        parts.append((positions, sigmas, found.null_space_rms, *(found.budget[cause] for cause in CAUSES)))
        done += len(chunk)
        progress(done, samples)
    positions, sigmas, unseen, *budget = (read_only(np.concatenate(part)) for part in zip(*parts, strict=True))
    return UncertaintyMap(read_only(readings), positions, sigmas, unseen, dict(zip(CAUSES, budget, strict=True)))


def tool_motions(
    machine: CalibratedMachine,
    columns: Array,
    readings: Array,
    tool: str,
    *,
    base: bool = True,
    tool_pose: bool = True,
    conditions: Conditions | None = None,
) -> Array:
    """Return the motions (N, 6, k) of the tool for changes ``columns`` (n, k) of the state, at readings (N, nr).

    Other arguments and axes as of :func:`tool_uncertainty`.
    """
    view, told = _View(machine.of(tool), tool, base=base, tool_pose=tool_pose), conditions or ordinary(readings)
    changes, found = [view.told(columns)], np.empty((len(readings), 6, columns.shape[1]))
    with one_thread(of_scipy=False):
        for start in range(0, len(readings), many := _at_once(machine)):
            rows = slice(start, start + many)
            (found[rows],) = view.at(readings[rows], told.subset(rows)).motions(changes)
    return found


def mean_square_shifts(machine: CalibratedMachine, readings: Array, tool: str, *, conditions: Conditions) -> Array:
    """Return for each entry (n,) of the state the mean square of how far a unit of it moves the tool, in m^2.

    At readings (N, nr). Of thousands of entries a product with the columns of each takes minutes and gigabytes.
    """
    view, found = _View(machine.of(tool), tool, base=True, tool_pose=True), np.zeros(machine.layout.size)
    with one_thread(of_scipy=False):
        for start in range(0, len(readings), many := _at_once(machine)):
            rows = slice(start, start + many)
            shifts = view.jacobian(view.at(readings[rows], conditions.subset(rows)).motion)[:, :3]
            found += np.sum(shifts**2, axis=(0, 1))
    return found / len(readings)
