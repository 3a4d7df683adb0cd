"""Commands for targets that are visited one after the other: the commands themselves tell the side of approach."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.compensation.corrections import Corrections, replaced
from calib.foundations.arrays import Array, BoolArray, IntArray, read_only_view
from calib.foundations.errors import JobError
from calib.foundations.words import listed
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


def by_order(robot: Robot, start: Array | None, conditions: Conditions, correct: Correct) -> Corrections:
    """Return the commands for N targets in the order of their rows, each reached from the side that they tell.

    ``correct`` finds those of some rows where sides are known, from the conditions of all and what was found so far;
    these ``conditions`` are :func:`with_sides`. ``start`` (N, nr): readings that tell a first guess of the sides, None
    where there is none. Rows that are not reached are not visited either. A reading that nothing has moved yet has no
    side, which is a remark on its row. Rows that have no consistent side, as a coefficient of the other sign may leave
    them, are not reached.
    """
    sides, asking = np.asarray(conditions.approach), np.zeros((1, len(robot.readings)), dtype=np.bool_)
    asking[:, list(sided(robot))] = True
    unsettled = np.zeros(sides.shape, dtype=np.bool_)
    if start is not None:
        sides = _sides(start, np.ones(len(start), dtype=np.bool_))
    found = correct(replace(conditions, approach=sides), np.arange(len(sides)), None)
    first, rounds = -1, 0
    while True:
        visited = found.reached & ~unsettled.any(axis=1)
        told = _sides(found.readings, visited)
        changed = (told != sides) & asking & visited[:, None]
        rows = np.flatnonzero(changed.any(axis=1))
        if not len(rows):
            break
        # Rows before the first that changes stand: its sides follow from them, and from what is corrected for these.
        first, rounds = int(rows[0]), rounds + 1 if rows[0] == first else 1
        if rounds > _ROUNDS:
            unsettled[first] = changed[first]
            continue
        sides = told
        found = replaced(found, correct(replace(conditions, approach=sides), rows, found), rows)
    return _told(found, robot, unsettled, (sides == 0.0) & asking & visited[:, None])


def _sides(readings: Array, visited: BoolArray) -> Array:
    """Return the sides (N, nr) that readings tell whose rows are visited one after the other; 0 in the other rows."""
    sides = np.zeros(readings.shape)
    sides[visited] = in_order(np.round(readings[visited], _DIGITS))
    return sides


def _told(found: Corrections, robot: Robot, unsettled: BoolArray, unknown: BoolArray) -> Corrections:
    """Return corrections without rows of unsettled sides (N, nr), and with a remark where sides are not known."""
    reasons = list(found.reasons)
    for row, names in _named(robot, unknown):
        said = f"from which side {names} is reached is not known, as it has not moved before"
        reasons[row] = "; ".join(filter(None, [reasons[row], said]))
    for row, names in _named(robot, unsettled):
        reasons[row] = (
            f"from which side {names} is reached cannot be told: corrected for one side, it comes from the other"
        )
    lost: BoolArray = np.asarray(unsettled.any(axis=1))
    if not lost.any():
        return replace(found, reasons=tuple(reasons))
    readings, change = (np.where(lost[:, None], np.nan, values) for values in (found.readings, found.change))
    reached = found.reached & ~lost
    arrays = {"readings": readings, "change": change, "reached": reached}
    return replace(found, reasons=tuple(reasons), **{name: read_only_view(own) for name, own in arrays.items()})


def _named(robot: Robot, which: BoolArray) -> list[tuple[int, str]]:
    """Return the rows that have some of the readings (N, nr), and these in words."""
    rows = np.flatnonzero(which.any(axis=1)).tolist()
    return [(row, listed([robot.readings[k].name for k in np.flatnonzero(which[row])])) for row in rows]
