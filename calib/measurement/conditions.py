"""What a table says of its rows beside readings: sides of approach, temperatures and torques."""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import MeasurementError
from calib.measurement.columns import filled, numbers, stacked, words
from calib.measurement.table import APPROACH, TORQUE, Table
from calib.robot.conditions import Conditions
from calib.robot.conditions import in_order as sides_in_order
from calib.robot.robot import Reading, Robot
from calib.robot.transmission import lacking

_SIDES = {"+": 1.0, "-": -1.0, "0": 0.0, "1": 1.0, "-1": -1.0}


def conditions(
    table: Table, readings: Sequence[Reading], *, in_order: bool = False, absent: Collection[str] = ()
) -> Conditions:
    """Return what a table says beside readings.

    In columns ``temperature`` (and ``time``, by which what is slow remembers it), ``tau_<joint>`` and ``sigma_tau``,
    ``direction`` or ``direction_<joint>``; ``in_order``: the order of the rows says it instead of the latter.
    ``absent``: readings that move nothing which the table is about and have no column; they rest, without torque.
    Raises MeasurementError for a word that is no side, a unit of another dimension, and where sides are given twice.
    """
    own = {reading.name: f"{APPROACH}{reading.name}" for reading in readings}
    said = sided_columns(table, readings, in_order=in_order)
    approach = None
    if in_order:
        approach = sides_in_order(filled(table, {reading.name: reading.dimension for reading in readings}))
    elif said or absent:
        columns = {name: _sides(table, name) for name in said}
        unsaid = {name: np.full(len(table), 0.0 if name in absent else np.nan) for name in own}
        sides = [columns.get("direction", columns.get(column, unsaid[name])) for name, column in own.items()]
        approach = read_only(np.array(sides).reshape(len(own), len(table)).T)
    temperature = None
    if "temperature" in table.columns:
        temperature = stacked(table, {"temperature": "temperature"})[:, 0]
    torque = np.full((len(table), len(readings)), np.nan)
    for k, reading in enumerate(readings):
        if f"{TORQUE}{reading.name}" in table.columns:
            torque[:, k] = numbers(table, f"{TORQUE}{reading.name}", "torque")
        elif reading.name in absent:
            torque[:, k] = 0.0
    told = Conditions(approach, temperature, None if np.isnan(torque).all() else read_only(torque))
    if "sigma_tau" in table.columns:
        sigma = numbers(table, "sigma_tau", "torque")
        table.refuse(
            sigma < 0.0,
            lambda row: f"column 'sigma_tau': {sigma[row]:g} is not a standard deviation; allowed is 0 Nm or more.",
        )
        told = replace(told, torque_sigma=read_only(sigma))
    if temperature is None or "time" not in table.columns:
        return told
    return told.in_time(numbers(table, "time", "time"))


def sided_columns(table: Table, readings: Sequence[Reading], *, in_order: bool = False) -> list[str]:
    """Return the columns of a table that tell sides of approach. Raises MeasurementError where they are given twice."""
    own = [f"{APPROACH}{reading.name}" for reading in readings]
    said = [name for name in ("direction", *own) if name in table.columns]
    sources = [*(["the order of the rows"] if in_order else []), *said]
    if len(sources) > 1 and (in_order or "direction" in said):
        raise MeasurementError(
            f"{table.where}: the side of approach is given twice, by {sources[0]} and by {sources[1]}; keep one."
        )
    return said


def _sides(table: Table, name: str) -> Array:
    said = words(table, name) or ()
    table.refuse(
        np.array([word not in _SIDES for word in said]),
        lambda row: f"column {name!r}: {said[row]!r} is not a side of approach; allowed are {', '.join(_SIDES)}.",
    )
    return np.array([_SIDES[word] for word in said])


def refuse_lacking(robot: Robot, conditions: Conditions, where: str, otherwise: str = "") -> None:
    """Raise MeasurementError where a joint term of the robot needs a condition that rows do not have.

    ``otherwise``: what else than columns may tell the side of approach of these rows.
    """
    if missing := lacking(robot.terms, [reading.name for reading in robot.readings], conditions):
        needs = f"there is no column {missing[1]!r}, which {missing[0]} needs"
        raise MeasurementError(f"{where}: {needs}{otherwise if APPROACH in missing[1] else ''}.")
