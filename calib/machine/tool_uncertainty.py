"""How sure is a calibrated machine of where its tool is, at any configuration.

The covariance of the parameters goes to the tool by the exact derivative of its pose: ``J C J^T``. What the data cannot
see has no covariance; how far it would move the tool is told beside it.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import MeasurementError
from calib.foundations.linear import one_thread
from calib.machine.calibrated import CalibratedMachine
from calib.machine.uncertainty import ToolUncertainty, UncertaintyMap
from calib.measurement.conditions import refuse_lacking
from calib.measurement.measurements import Measurements
from calib.robot.conditions import Conditions, ordinary
from calib.robot.sampling import random_readings

# Rows whose derivatives are in memory at a time.
_BLOCK = 500


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

    ``base``: of the tool in the instrument's frame, else in the robot's base. ``tool_pose``: with the doubts about the
    tool itself, else those of the arm alone, at the tool's place. ``conditions`` of the rows; when None, reached from
    neither side, at 20 degC, no torque measured. Raises MeasurementError for a machine without known uncertainty, an
    unknown tool, readings that are not the robot's, or conditions that lack what a joint term needs.
    """
    found, known = _readings(machine, readings), machine.known_uncertainty
    if conditions is not None:
        refuse_lacking(machine.robot, conditions, "the readings")
    columns = np.hstack([known.factor, known.null_basis])
    J = tool_motions(machine, columns, found, tool, base=base, tool_pose=tool_pose, conditions=conditions)
    determined, other = np.split(J, [known.factor.shape[1]], axis=2)
    sizes = np.sqrt(np.stack([np.sum(other[:, :3] ** 2, axis=(1, 2)), np.sum(other[:, 3:] ** 2, axis=(1, 2))], axis=1))
    return ToolUncertainty(
        read_only(determined @ np.swapaxes(determined, 1, 2)), read_only(sizes), known.degrees_of_freedom
    )


def common_errors(machine: CalibratedMachine, data: Measurements) -> Array:
    """Return a factor (N, 3 or 6, r) of the covariance that the predictions of all rows of ``data`` have together.

    Errors of the parameters are common to all rows: column j is what one standard deviation of them does to every row.
    Raises MeasurementError for a tool or a set-up that was not identified.
    """
    size, factor = data.sigma.shape[1], machine.known_uncertainty.factor
    found = np.zeros((len(data), size, factor.shape[1]))
    for s, setup in enumerate(data.setups):
        there = machine.at(setup) if np.any(data.setup == s) else machine
        for k, tool in enumerate(data.tools):
            rows = np.flatnonzero((data.tool == k) & (data.setup == s))
            if len(rows):
                own = data.conditions.subset(rows)
                columns = there.known_uncertainty.factor
                found[rows] = tool_motions(there, columns, data.readings[rows], tool, conditions=own)[:, :size]
    return found


@checked
def uncertainty_map(
    machine: CalibratedMachine,
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
    readings = random_readings(machine.robot, samples, limits, (machine.deviations,), seed=seed)
    T_tool = machine.tools[machine.tool_named(tool)]
    found: list[ToolUncertainty] = []
    for chunk in np.array_split(readings, max(samples // _BLOCK, 1)):
        found.append(tool_uncertainty(machine, chunk, tool, base=base))
        progress(sum(len(f.null_space_rms) for f in found), samples)
    return UncertaintyMap(
        read_only(readings),
        read_only((machine.tips(readings, ordinary(readings)) @ T_tool)[:, :3, 3]),
        read_only(np.concatenate([np.stack([f.position, f.orientation], axis=1) for f in found])),
        read_only(np.concatenate([f.null_space_rms for f in found])),
    )


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
    layout, changes = machine.layout, np.array(columns)
    if not base:
        changes[layout.base : layout.tools] = 0.0
    if not tool_pose:
        changes[layout.tools :] = 0.0
    told = conditions or ordinary(readings)
    found = np.empty((len(readings), 6, changes.shape[1]))
    with one_thread():
        for start in range(0, len(readings), _BLOCK):
            rows = slice(start, start + _BLOCK)
            own = told.subset(rows)
            found[rows] = machine.tool_jacobian(readings[rows], tool=tool, conditions=own) @ changes
    if not base:
        found[:, :3] = machine.base[:3, :3].T @ found[:, :3]
    return found


def _readings(machine: CalibratedMachine, readings: npt.ArrayLike) -> Array:
    found, width = np.asarray(readings, dtype=np.float64), len(machine.robot.readings)
    if found.ndim != 2 or found.shape[1] != width or not len(found) or not np.isfinite(found).all():
        raise MeasurementError(f"readings of shape {found.shape}: needs finite numbers (N, {width}), one row or more.")
    return found


# ---- the identified set


@checked
def outside_identified(machine: CalibratedMachine, readings: Array) -> tuple[str, ...]:
    """Return, for every joint whose readings (N, nr) leave the range it was identified in, one sentence.

    Beyond the outermost pose by more than a twentieth of the range; whole turns of a revolute joint do not count. A
    model is only proven where it was measured: outside, the stated sigmas hold if the model is right. Raises
    MeasurementError for readings of another shape.
    """
    said = []
    readings = _readings(machine, readings)
    low, high = machine.known_uncertainty.identified.T
    slack = 0.05 * (high - low)
    for j, reading in enumerate(machine.robot.readings):
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
