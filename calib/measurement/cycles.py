"""Tables of repeated cycles, as acceptance after ISO 9283 takes them."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only, rows_by_word
from calib.foundations.errors import MeasurementError
from calib.foundations.sealing import sealed
from calib.foundations.units import Dimension
from calib.measurement.columns import POSITION, orientations, refuse_others, stacked, words
from calib.measurement.table import QUATERNION_COLUMNS, Table, read_table

_COMMAND = ("command_x", "command_y", "command_z")
_COMMAND_TURN = ("command_qw", "command_qx", "command_qy", "command_qz")
_WORDS = ("target", "direction")
# The standard takes five poses and three directions; between every two poses there are figures.
_MOST_POSES, _MOST_WAYS = 100, 500


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Cycles:
    """N attained poses. Made by :func:`cycles` and :func:`read_cycles`.

    ``position`` (N, 3) in m, ``turn`` (N, 3, 3) or None; ``commanded`` (N, 3) and ``commanded_turn`` (N, 3, 3), None
    where no command is given. ``target``: the name of the pose, ``direction``: of its approach, None where there is one
    only. ``time`` (N,) in s or None.
    """

    position: Array
    turn: Array | None
    commanded: Array | None
    commanded_turn: Array | None
    target: tuple[str, ...]
    direction: tuple[str, ...] | None
    time: Array | None
    where: str


@checked
def read_cycles(path: str | Path) -> Cycles:
    """Read cycles from a CSV file. Raises MeasurementError as :func:`cycles` does."""
    return cycles(read_table(path))


def cycles(table: Table) -> Cycles:
    """Return the cycles of a table: target, x, y, z; optionally qw to qz, command_x to command_z (and command_qw ...).

    With ``direction`` (words): from where each pose was approached; with ``time``: drift. Raises MeasurementError when
    a column is missing, not known or in a unit of another dimension, when a target has several commands, or when there
    are very many targets or directions.
    """
    columns, where = table.columns, table.where
    known = {*POSITION, *QUATERNION_COLUMNS, *_COMMAND, *_COMMAND_TURN, *_WORDS, "time", "group"}
    refuse_others(table, known, "cycles")
    groups: list[Sequence[str]] = [("target", *POSITION)]
    groups += [some for some in (QUATERNION_COLUMNS, _COMMAND, _COMMAND_TURN) if any(name in columns for name in some)]
    for name in itertools.chain(*groups):
        if name not in columns:
            raise MeasurementError(f"{where}: there is no column {name!r} of the cycles.")
    turn = orientations(table) if "qw" in columns else None
    commanded = stacked(table, dict.fromkeys(_COMMAND, "length")) if "command_x" in columns else None
    commanded_turn = None
    if "command_qw" in columns:
        dimensions: dict[str, Dimension] = dict.fromkeys(_COMMAND_TURN, "number")
        commanded_turn = read_only(rigid.rotation_of_quaternion(stacked(table, dimensions)))
    target, direction = words(table, "target") or (), words(table, "direction")
    _refuse_many(target, direction, where)
    for place, rows in rows_by_word(target).items():
        for given in (commanded, commanded_turn):
            if given is not None and np.abs(given[rows] - given[rows[0]]).max() > 1e-9:
                raise MeasurementError(f"{where}: target {place!r} has several commands; give each its own name.")
    return Cycles(
        stacked(table, dict.fromkeys(POSITION, "length")),
        turn,
        commanded,
        commanded_turn,
        target,
        direction,
        stacked(table, {"time": "time"})[:, 0] if "time" in columns else None,
        where,
    )


def _refuse_many(target: Sequence[str], direction: Sequence[str] | None, where: str) -> None:
    poses = len(set(target))
    if poses > _MOST_POSES:
        raise MeasurementError(f"{where}: column 'target' has {poses} names; allowed are {_MOST_POSES}.")
    ways = poses if direction is None else len(set(zip(target, direction, strict=True)))
    if ways > _MOST_WAYS:
        raise MeasurementError(
            f"{where}: the poses are approached from {ways} directions together; allowed are {_MOST_WAYS}."
        )
