"""Commands for targets that are visited one after the other: the commands themselves tell the side of approach."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.compensation.corrections import Corrections, replaced
from calib.foundations import rigid
from calib.foundations.arrays import Array, BoolArray, IntArray, read_only_view
from calib.foundations.errors import JobError
from calib.foundations.words import listed
from calib.machine.calibrated import CalibratedMachine
from calib.robot.conditions import Conditions, in_order
from calib.robot.robot import Robot
from calib.robot.terms import kind_of
from calib.robot.terms.kind import SIDE

# The sides of a row settle in two or three rounds; those that still change are not going to.
_ROUNDS = 8
# Digits of readings in rad or m that tell whether one has moved; what differs by less is rounding.
_DIGITS = 9

Correct = Callable[[Conditions, IntArray, Corrections | None], Corrections]


def sided(robot: Robot) -> tuple[int, ...]:
    """Return the numbers of readings that move the tip, and of which joint terms ask from which side they came."""
    asking = {term.reading for term in robot.terms if SIDE in kind_of(term).needs}
    asking &= set(robot.driving((robot.tip,)))
    return tuple(k for k, reading in enumerate(robot.readings) if reading.name in asking)


def with_sides(conditions: Conditions, rows: int, readings: int) -> Conditions:
    """Return the conditions of targets; where their order is to tell the sides, 0 for all as long as it has not.

    Raises JobError where the conditions tell them as well.
    """
    if not conditions.ordered:
        return conditions
    if conditions.approach is not None:
        raise JobError("the side of approach is given twice, by 'approach' and as 'ordered'; keep one.")
    return replace(conditions, approach=np.zeros((rows, readings)))


def by_order(
    model: CalibratedMachine, tools: Array, start: Array | None, conditions: Conditions, correct: Correct
) -> Corrections:
    """Return the commands for N targets of tools (N, 4, 4) in the order of their rows, as these tell their sides.

    ``correct`` finds those of some rows where sides are known, from the conditions of all and what was found so far;
    these ``conditions`` are :func:`with_sides`. ``start`` (N, nr): readings that tell a first guess of the sides, None
    where there is none. Rows that are not reached are not visited either. A reading that nothing has moved yet has no
    side, which is a remark on its row. One of which no side is consistent, as a coefficient above zero may leave it, is
    taken as reached from neither; a remark says so, and the remaining errors have what that misses.
    """
    robot = model.robot
    sides, asking = np.asarray(conditions.approach), np.zeros((1, len(robot.readings)), dtype=np.bool_)
    asking[:, list(sided(robot))] = True
    unsettled = np.zeros(sides.shape, dtype=np.bool_)
    if start is not None:
        sides = _sides(start, np.ones(len(start), dtype=np.bool_))
    found = correct(replace(conditions, approach=sides), np.arange(len(sides)), None)
    first, rounds = -1, 0
    while True:
        told = _sides(found.readings, found.reached)
        settled = np.where(unsettled, 0.0, told)
        changed = (settled != sides) & asking & found.reached[:, None]
        rows = np.flatnonzero(changed.any(axis=1))
        if not len(rows):
            break
        # Rows before the first that changes stand: its sides follow from them, and from what is corrected for these.
        first, rounds = int(rows[0]), rounds + 1 if rows[0] == first else 1
        if rounds > _ROUNDS:
            unsettled[first] |= changed[first]
            first = -1
            continue
        sides = settled
        found = replaced(found, correct(replace(conditions, approach=sides), rows, found), rows)
    unsettled &= found.reached[:, None]
    reasons = list(found.reasons)
    unknown = (told == 0.0) & asking & found.reached[:, None]
    for which, why in (
        (unknown, "from which side {} is reached is not known, as it has not moved before"),
        (unsettled, "from which side {} is reached cannot be told: corrected for one side, it comes from the other"),
    ):
        for row in np.flatnonzero(which.any(axis=1)).tolist():
            names = listed([robot.readings[k].name for k in np.flatnonzero(which[row])])
            reasons[row] = "; ".join(filter(None, [reasons[row], why.format(names)]))
    return _with_missed(replace(found, reasons=tuple(reasons)), model, tools, unsettled, conditions, (sides, told))


def _sides(readings: Array, visited: BoolArray) -> Array:
    """Return the sides (N, nr) that readings tell whose rows are visited one after the other; 0 in the other rows."""
    sides = np.zeros(readings.shape)
    sides[visited] = in_order(np.round(readings[visited], _DIGITS))
    return sides


def _with_missed(
    found: Corrections,
    model: CalibratedMachine,
    tools: Array,
    unsettled: BoolArray,
    conditions: Conditions,
    sides: tuple[Array, Array],
) -> Corrections:
    """Return corrections whose errors have what rows with unsettled sides (N, nr) miss, from those taken to those told.

    ``sides``: the ones taken, and the ones that the commands tell (N, nr).
    """
    rows = np.flatnonzero(unsettled.any(axis=1))
    if not len(rows):
        return found
    taken, told = (
        model.tips(found.readings[rows], replace(conditions, approach=own).subset(rows)) @ tools[rows] for own in sides
    )
    between = rigid.inverse(taken) @ told
    position, orientation = found.position_error.copy(), found.orientation_error.copy()
    lengths, angles = rigid.lengths_and_angles(between)
    position[rows] += lengths
    orientation[rows] += angles
    return replace(found, position_error=read_only_view(position), orientation_error=read_only_view(orientation))
