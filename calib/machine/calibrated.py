"""The calibrated machine: what an identification has found, whole, for all that judges or uses it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import JobError, MeasurementError
from calib.identification.fit import Fit
from calib.identification.machine import Frames, Layout, Machine
from calib.identification.parameters import Parameter, directions, scales
from calib.identification.system import residuals
from calib.machine.budget import doubts_of
from calib.machine.residual_model import ResidualModel, shifted
from calib.machine.tool_motion import tool_jacobian
from calib.machine.uncertainty import NoiseLevel, Uncertainty
from calib.measurement.kinds import UNIT_OF
from calib.measurement.measurements import Measurements
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.robot import Deviations, Robot

# Directions of the covariance below this share of the largest are rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CalibratedMachine:
    """A calibrated machine. Made by :func:`machine_of` from a fit, or read by :func:`calib.load_machine`.

    ``robot`` and ``deviations``: in the frames of its URDF. ``base`` (4, 4): the robot's base in the instrument's
    frame; ``tools``: poses (4, 4) in the tip link, by name. ``residual_model``: errors of tool positions that the rest
    leaves, over joint space, or None. ``uncertainty``: how sure all of it is, or None where that is not known.
    ``in_urdf``: the best machine that its URDF can hold, with base and tools of its own, where that is another one.

        machine = calib.machine_of(fit)
        machine.predict(readings)  # (N, 4, 4), tool in the instrument's frame, m
    """

    robot: Robot
    deviations: Deviations
    base: Array
    tools: Mapping[str, Array]
    residual_model: ResidualModel | None = None
    uncertainty: Uncertainty | None = None
    in_urdf: "CalibratedMachine | None" = None

    @checked
    def tips(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return the placements (N, 4, 4) of the tip link in the base link at readings (N, nr), in rad and m.

        Positions with what the residual model adds, which is nothing where it knows nothing. Raises RobotError for
        readings of another shape and for a joint term that needs ``conditions`` which are not given, PoseError for a
        row where a loop cannot close.
        """
        return shifted(self.residual_model, self.robot.tips(readings, self.deviations, conditions), readings)

    @checked
    def predict(self, readings: Array, *, tool: str = "tool", conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return the placements (N, 4, 4) of a tool in the instrument's frame at readings (N, nr), in rad and m.

        Raises MeasurementError for an unknown tool, and as :meth:`tips` does.
        """
        return np.asarray(self.base @ self.tips(readings, conditions) @ self.tools[self.tool_named(tool)])

    @checked
    def tool_jacobian(self, readings: Array, *, tool: str = "tool", conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return how the tool's pose follows the state of the machine (N, 6, n), at readings (N, nr).

        Rows: position in the instrument's axes, in m, and small turns about the tool's axes, in rad. Columns: as the
        rows of :attr:`Uncertainty.factor`. Without the residual model, which changes too slowly to count.
        """
        number = list(self.tools).index(self.tool_named(tool))
        return tool_jacobian(self.robot, self.state, readings, conditions, number)

    @checked
    def residuals(self, data: Measurements) -> Array:
        """Return measured minus predicted (N, 3 or 6) of positions or poses, in m and rad.

        Positions in the instrument's axes, turns in the tool's. Raises MeasurementError for other kinds of data.
        """
        if data.position is None:
            raise MeasurementError(f"{data.where}: a machine by itself predicts positions and poses, not {data.kind}.")
        (r,) = residuals(self.robot, [self.with_own_tools(data)], self.state)
        return self.less_shifts(r, data)

    def less_shifts(self, residuals: Array, data: Measurements) -> Array:
        """Return residuals (N, 3 or 6) of positions or poses less what the residual model adds to the prediction."""
        if self.residual_model is None:
            return residuals
        found = np.array(residuals)
        found[:, :3] -= self.residual_model.shifts(self.base, data.tips(self.robot, self.deviations), data.readings)
        return found

    def with_own_tools(self, data: Measurements) -> Measurements:
        """Return the data with their tools numbered as the machine's. Raises MeasurementError for others."""
        own = tuple(self.tools)
        for tool in data.tools:
            if tool not in own:
                known = ", ".join(map(repr, own))
                raise MeasurementError(f"{data.where}: tool point {tool!r} was not identified; known are {known}.")
        number = np.array([own.index(tool) for tool in data.tools], dtype=np.intp)
        return replace(data, tools=own, tool=number[data.tool])

    @property
    def state(self) -> Machine:
        """The machine as identification has it; angles of base and tools are counted from where they are."""

        def twists(T: Array) -> Array:
            W = np.eye(6)
            W[:3, :3] = T[:3, :3].T
            return W

        tools = np.array(list(self.tools.values())).reshape(-1, 4, 4)
        by_tool = np.array([twists(T) for T in tools]).reshape(-1, 6, 6)
        return Machine(self.deviations, Frames(self.base, tools), twists(self.base), by_tool, np.zeros((0, 6, 6)))

    @property
    def geometry(self) -> "CalibratedMachine":
        """What a format that has no place for joint terms or loops can hold best: ``in_urdf``, or else the machine."""
        return self if self.in_urdf is None else self.in_urdf

    @property
    def known_uncertainty(self) -> Uncertainty:
        """The uncertainty. Raises MeasurementError where it is not known."""
        if self.uncertainty is None:
            raise MeasurementError(
                f"{self.robot.urdf.where}: the machine's uncertainty is not known; calibrate it again, or load the "
                "whole folder of its results."
            )
        return self.uncertainty

    def tool_named(self, tool: str) -> str:
        """Return the name of a tool. Raises MeasurementError when there is none of this name."""
        if tool not in self.tools:
            known = ", ".join(map(repr, self.tools)) or "none"
            raise MeasurementError(f"there is no tool {tool!r}; the calibrated tools are {known}.")
        return tool

    def __repr__(self) -> str:
        joints = len(self.robot.readings)
        beside = "" if self.residual_model is None else ", with a residual model"
        said = "not known" if self.uncertainty is None else "known"
        return (
            f"<CalibratedMachine {self.robot.urdf.where} to {self.robot.tip!r}: {joints} joints, tools "
            f"{', '.join(self.tools)}{beside}; its uncertainty is {said}>"
        )


@checked
def machine_of(fit: Fit, residual_model: ResidualModel | None = None) -> CalibratedMachine:
    """Return the calibrated machine of a fit, in the frames of its URDF, with its uncertainty.

        machine = calib.machine_of(calib.identify(model, data))

    ``residual_model``: what it adds to positions. Raises JobError when the fit has no tool.
    """
    frames = fit.machine.frames
    names = fit.measurements[0].tools
    if not names:
        raise JobError("the fit has no tool: a machine has one or more.")
    tools = {name: read_only(T) for name, T in zip(names, frames.tools, strict=True)}
    return CalibratedMachine(
        fit.robot, fit.deviations, read_only(frames.base), tools, residual_model, _uncertainty(fit)
    )


def _uncertainty(fit: Fit) -> Uncertainty:
    readings = np.concatenate([end.readings for data in fit.measurements for end in data.ends])
    identified = np.stack([readings.min(axis=0), readings.max(axis=0)], axis=1)
    doubts = doubts_of(fit, identified)
    state = _to_state(fit, doubts.parameters, doubts.at) * scales(doubts.parameters)
    parts = (doubts.instrument, doubts.unseen, doubts.scatter, doubts.waves)
    null_basis = _to_state(fit, fit.parameters, fit.machine) @ (fit.null_basis * scales(fit.parameters)[:, None])
    return Uncertainty(
        read_only(np.hstack([state @ part for part in parts])),
        (parts[0].shape[1], parts[1].shape[1], parts[2].shape[1] + parts[3].shape[1]),
        doubts.left_out,
        read_only(null_basis),
        _level(fit, doubts.noise, "m"),
        _level(fit, doubts.noise, "rad"),
        read_only(identified),
    )


def measured_factor(fit: Fit) -> Array:
    """Return a factor (n, r) of the covariance of the machine's state by noise alone, null space left out."""
    return np.asarray(_to_state(fit, fit.parameters, fit.machine) @ _factor(fit.covariance, scales(fit.parameters)))


def _to_state(fit: Fit, parameters: Sequence[Parameter], machine: Machine) -> Array:
    """Return how the state (n, p) of the machine in the frames of its URDF follows parameters, in SI units."""
    own = Layout(fit.model.robot)
    # Targets and lengths are no part of the machine, which the results are about.
    to_state = directions(parameters, Layout.of(fit.model.robot, machine.frames).size)
    parts = [to_state[: own.offsets], to_state[own.offsets : own.base]]
    if fit.model.dh is not None:
        parts[0] = fit.model.dh.source_rates(machine.deviations) @ parts[0]
    frames = np.concatenate([machine.frames.base[None], machine.frames.tools])
    twists = np.concatenate([machine.base_twists[None], machine.tool_twists])
    for k, (T, W) in enumerate(zip(frames, twists, strict=True)):
        local = W @ to_state[own.base + 6 * k : own.base + 6 * k + 6]
        parts.append(np.concatenate([T[:3, :3] @ local[:3], local[3:]]))
    state = np.concatenate(parts)
    assert len(state) == Layout(fit.robot, len(machine.frames.tools)).size, "one state of the machine, two ways"
    return state


def _factor(covariance: Array, s: Array) -> Array:
    """Return F (p, r) with ``F F^T = covariance``, of as many columns as something is known of."""
    values, vectors = np.linalg.eigh(covariance / (s[:, None] * s))
    kept = values > _ROUNDING * max(float(values.max(initial=0.0)), 0.0)
    return np.asarray(s[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


def _level(fit: Fit, shares: Array, unit: str) -> NoiseLevel | None:
    parts = [(noise, share) for noise, share in zip(fit.noise, shares, strict=True) if UNIT_OF[noise.quantity] == unit]
    freedom = np.array([noise.degrees_of_freedom for noise, _ in parts])
    if not parts or freedom.sum() <= 0.0:
        return None

    def mean(squares: Sequence[float]) -> float:
        return float(np.sqrt(np.average(squares, weights=freedom)))

    total = mean([(share * noise.total) ** 2 for noise, share in parts])
    model = mean([max((share * noise.total) ** 2 - noise.instrument**2, 0.0) for noise, share in parts])
    estimated = any(noise.model > 0.0 for noise, _ in parts)
    # The estimate of the total has the freedom of the residuals; where nothing had to be added, it is not an estimate.
    return NoiseLevel(model, total, float(freedom.sum()) if estimated else float("inf"))
