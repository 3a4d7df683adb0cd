"""What data leave open of a machine: what is beyond the identified range, and where its tools are on their links.

A model is only proven where it was measured.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array
from calib.foundations.linear import svd
from calib.foundations.units import DISPLAY_OF
from calib.identification.machine import POSE
from calib.identification.parameters import DEFAULT_SIGMA
from calib.machine.calibrated import CalibratedMachine, readings_of
from calib.machine.turns import turned_towards
from calib.measurement.measurements import End
from calib.robot.conditions import NO_CONDITIONS, Conditions, ordinary
from calib.robot.robot import Robot
from calib.robot.terms import kind_of
from calib.robot.terms.kind import TEMPERATURE

# A value is outside if it is beyond the outermost of the data by more than this share of their range.
_SLACK, _ROUNDING = 0.05, 1e-9
# The units in which conditions are told; the same ones are kept.
_UNITS = {"temperature": "degC", "payload": "kg"}
# In m, for deviations of one millimetre and milliradian: a tool point that the null space moves by more on its link has
# no place in the base link, as the height of a tool that turned about the vertical alone. Of others it is a millimetre.
_NOT_PLACED = 0.03


def condition_ranges(robot: Robot, ends: Iterable[End]) -> dict[str, tuple[float, float]]:
    """Return the least and the greatest of what the terms of a robot follow: temperature in degC, payload in kg.

    Of ends of rows under the loads of their set-ups (:meth:`calib.measuring.Measurements.loaded`).
    """
    found: dict[str, tuple[float, float]] = {}
    for end in ends:
        for name, values in _followed(robot, end.conditions, len(end.readings)):
            low, high = found.get(name, (np.inf, -np.inf))
            found[name] = min(low, float(values.min())), max(high, float(values.max()))
    return found


def _followed(robot: Robot, conditions: Conditions, rows: int) -> Iterator[tuple[str, Array]]:
    """Yield what terms of a robot follow beside its readings, by name, and its values (rows,) where they are told."""
    kinds = [kind_of(term) for term in robot.terms]
    warms = any(need.column == TEMPERATURE.column for kind in kinds for need in kind.needs)
    if warms and rows and conditions.temperature is not None:
        yield "temperature", conditions.temperature
    if rows and any(kind.masses == "stated" for kind in kinds):
        own = robot.moments(robot.load.payload)[:, 3].sum()
        told = np.full(rows, own) if conditions.payload is None else conditions.payload[:, :, 3].sum(axis=1)
        yield "payload", np.where(np.isnan(told), own, told)


def usual_conditions(machine: CalibratedMachine, readings: Array) -> Conditions:
    """Return the conditions of readings (N, nr) of which nothing is said: those at which the machine was measured.

    Reached from neither side, no torque measured, and for long in the middle of the temperatures that were measured
    where joint terms follow them: at the reference temperature these do nothing.
    """
    usual, known = ordinary(readings), machine.uncertainty
    measured = None if known is None else known.conditions.get("temperature")
    if measured is None:
        return usual
    warm = replace(usual, temperature=np.full(len(readings), np.mean(measured)))
    return warm.in_time(np.zeros(len(readings)))


@checked
def outside_identified(
    machine: CalibratedMachine,
    readings: Array,
    conditions: Conditions = NO_CONDITIONS,
    *,
    tool: str | Sequence[str] | None = None,
) -> tuple[str, ...]:
    """Return, for every joint whose readings (N, nr) leave the range it was identified in, one sentence.

    And one for a temperature, and for a payload, of ``conditions`` or of the set-up, that the machine's terms follow. A
    value leaves the range if it is beyond the outermost one by more than a twentieth of the range; whole turns do not
    count where they bring back all that follows the reading. A model is only proven where it was measured: outside, the
    stated sigmas hold only if the model is right. ``tool``: only of joints that bear on it, or on one of several, so
    not of another arm's. Raises MeasurementError for readings of another shape and for an unknown tool.
    """
    found = readings_of(machine, readings)
    said: list[str] = []
    known = machine.known_uncertainty
    names = None if tool is None else dict.fromkeys((tool,) if isinstance(tool, str) else tool)
    bearing = None if names is None else machine.robot.bearing_on([machine.of(name).robot.tip for name in names])
    for j, (reading, (low, high)) in enumerate(zip(machine.robot.readings, known.identified, strict=True)):
        if bearing is not None and reading.name not in bearing:
            continue
        values = turned_towards(found[:, j], low, high, reading.turns)
        factor, unit = DISPLAY_OF[reading.dimension]
        ends = low * factor, high * factor
        said += _outside(reading.name, values * factor, ends, found[:, j] * factor, unit)
    for name, values in _followed(machine.robot, conditions, len(found)):
        if name in known.conditions:
            said += _outside(f"The {name}", values, known.conditions[name], values, _UNITS[name])
    return tuple(said)


def _outside(name: str, values: Array, ends: tuple[float, float], told: Array, unit: str) -> Iterator[str]:
    """Yield a sentence where values (N,) are beyond the ends; ``told``: as they were given, in whatever turn."""
    low, high = ends
    slack = _SLACK * (high - low) + _ROUNDING * max(abs(low), abs(high))
    beyond = np.maximum(low - slack - values, values - high - slack)
    if not np.any(beyond > 0.0):
        return
    worst = int(np.nanargmax(beyond))  # of some rows a temperature may not be told
    span = f"{low:.4g} to {high:.4g}" if high > low else f"{low:.4g}"
    yield (
        f"{name} is outside the range it was identified in, {span} {unit}, in {np.count_nonzero(beyond > 0.0)} of "
        f"{len(values)} rows; the farthest is {told[worst]:.4g} {unit}."
    )


@checked
def not_placed(machine: CalibratedMachine, tool: str | Sequence[str] = "tool") -> tuple[str, ...]:
    """Return a sentence for every one of these tools whose place on its link the data leave open.

    As the height of a tool that only turned about the vertical. The base took up what that is off, so that predictions
    hold in the instrument's frame, and poses and positions in the base link are missed by it. Nothing is said of a
    machine without an uncertainty. Raises MeasurementError when there is no tool of a name.
    """
    wanted = set(map(machine.tool_named, dict.fromkeys((tool,) if isinstance(tool, str) else tool)))
    if machine.uncertainty is None:
        return ()
    layout, basis, said = machine.layout, machine.uncertainty.null_basis, []
    _, small, Vt = svd(basis[: layout.base] / DEFAULT_SIGMA)
    least = Vt.T / np.maximum(small, DEFAULT_SIGMA**2)
    for k, name in enumerate(machine.tools):
        first = layout.tools + len(POSE) * k
        axes, far, _ = svd(basis[first : first + 3] @ least)
        if name in wanted and far.max(initial=0.0) > _NOT_PLACED:
            along = np.round(axes[:, 0] * np.sign(axes[np.argmax(np.abs(axes[:, 0])), 0]), 2) + 0.0
            listed = ", ".join(f"{x:g}" for x in along)
            said.append(
                f"What was measured does not tell where {name!r} is on its link along ({listed}): by what it is off "
                'there, targets in the base link are missed. State the tool in the job (tool = "fixed") and calibrate '
                'again, or give targets in the frame of the instrument (frame = "instrument", --frame instrument).'
            )
    return tuple(said)
