"""DH tables as CSV: one row for every joint, a unit in every header, and every double back as it was.

    convention, modified
    base, 0 mm, 0 mm, 100 mm, 0 deg, 0 deg, 30 deg
    joint, type, a [mm], d [mm], alpha [deg], theta [deg]
    joint_1, revolute, 0, 333, 0, 0

Before the header may stand what a DH row cannot hold: the convention, and base and tool as x, y, z, roll, pitch, yaw.
"""

import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import cast, get_args

import numpy as np

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.choices import Convention
from calib.foundations.csv_text import csv_cell, lines_of, refuse_formula
from calib.foundations.errors import RobotError
from calib.foundations.files import read_bytes
from calib.foundations.ranges import OF_DIMENSION, parse_within
from calib.foundations.units import NO_NUMBER, NUMBER, UNITS, Dimension, Unit, unit_of
from calib.foundations.words import refuse_other, shown
from calib.robot.dh.table import NUMBERS, DhRow, DhTable, RowType, check_convention
from calib.robot.urdf import MOST_JOINTS

_LARGEST_FILE = 1_000_000
_TITLE = re.compile(r"([a-z]+)\s*(?:\[([^\[\]]*)\])?")
_DIMENSIONS: dict[str, Dimension] = {
    "a": "length",
    "d": "length",
    "alpha": "angle",
    "theta": "angle",
    "beta": "angle",
}
_REQUIRED = ("a", "d", "alpha", "theta")
_WORDS = ("joint", "type")
_BEFORE = ("convention", "base", "tool")
_POSE = ("x", "y", "z", "roll", "pitch", "yaw")

_Line = tuple[str, list[str]]  # the place for the start of a sentence, and the cells


@checked
def read_dh(path: str | Path, convention: Convention | None = None) -> DhTable:
    """Read a DH table; ``convention`` is for a file that does not state its own, and "standard" where neither does.

    Columns, in any order: ``a [mm]``, ``d [mm]``, ``alpha [deg]``, ``theta [deg]`` in any unit of their dimension;
    optional ``beta [deg]``, ``joint`` (default joint_1, joint_2, ...) and ``type`` (revolute, prismatic or fixed;
    default revolute). ``#`` comments and blank lines may stand anywhere.

    Raises RobotError with the file, the line, the column, the value and what is allowed.
    """
    return parse_dh(read_bytes(Path(path), RobotError, _LARGEST_FILE), str(path), convention)


@checked
def parse_dh(data: bytes, where: str, convention: Convention | None = None) -> DhTable:
    """Return the table of a file's contents, and raise, as :func:`read_dh`. ``where`` names it in sentences."""
    before, header, body = _parts(lines_of(data, where, "a DH table", RobotError), where)
    units = _units(header)
    rows = tuple(_row(line, units, number) for number, line in enumerate(body, start=1))
    stated = _convention(before.get("convention"))
    if None not in (convention, stated) and convention != stated:
        raise RobotError(f"{where}: states the {stated} convention, and was to be read as {convention}.")
    if len(rows) > MOST_JOINTS:
        raise RobotError(f"{where}: has {len(rows)} rows; allowed are {MOST_JOINTS}.")
    base, tool = (_pose(before.get(name)) for name in ("base", "tool"))
    try:
        return DhTable(stated or convention or "standard", rows, base, tool)
    except RobotError as e:
        raise RobotError(f"{where}: {e}") from e


@checked
def write_dh(table: DhTable) -> str:
    """Return the CSV text of a table in mm and deg. Its rows read back equal, base and tool to rounding."""
    lines = [f"convention, {table.convention}"]
    for name, T in (("base", table.base), ("tool", table.tool)):
        if not np.array_equal(T, np.eye(4)):
            values = (*T[:3, 3], *rigid.rpy_of(T[:3, :3]))
            units = [UNITS[symbol] for symbol in ("mm",) * 3 + ("deg",) * 3]
            lines.append(
                f"{name}, "
                + ", ".join(f"{_text(v, unit)} {unit.symbol}" for v, unit in zip(values, units, strict=True))
            )
    numbers = [name for name in NUMBERS if name != "beta" or any(row.beta for row in table.rows)]
    units = [UNITS["mm" if _DIMENSIONS[name] == "length" else "deg"] for name in numbers]
    lines.append(", ".join([*_WORDS, *(f"{n} [{unit.symbol}]" for n, unit in zip(numbers, units, strict=True))]))
    for row in table.rows:
        cells = [_text(getattr(row, name), unit) for name, unit in zip(numbers, units, strict=True)]
        lines.append(", ".join([csv_cell(row.joint), row.type, *cells]))
    return "\n".join(lines) + "\n"


def _si(text: str, unit: Unit) -> float:
    # In decimals: as doubles 350 times 0.001 is not 0.35, and some doubles are no double times 0.001 at all.
    rough = float(text) * unit.factor
    return float(Decimal(text) * Decimal(repr(unit.factor))) if 1e-300 < abs(rough) < 1e300 else rough


def _text(value: float, unit: Unit) -> str:
    """Return the shortest decimals, from 12 digits on, that read back as ``value`` (SI)."""
    if value == 0.0:
        return "0"
    exact = Decimal(float(value)) / Decimal(repr(unit.factor))
    texts = (f"{exact:.{digits}g}" for digits in range(12, 25))
    text = next((text for text in texts if _si(text, unit) == value), repr(value / unit.factor))
    return text if "e" in text or "." not in text else text.rstrip("0").rstrip(".")


def _parts(lines: Sequence[_Line], where: str) -> tuple[dict[str, _Line], _Line, Sequence[_Line]]:
    """Return what stands before the header by its name, the header, and the rows."""
    before: dict[str, _Line] = {}
    for n, (at, cells) in enumerate(lines):
        name = cells[0]
        if name not in _BEFORE:
            if n + 1 == len(lines):
                raise RobotError(f"{where}: has a header and no rows.")
            return before, lines[n], lines[n + 1 :]
        if name in before:
            raise RobotError(f"{at}: {name!r} appears more than once.")
        before[name] = at, cells
    raise RobotError(f"{where}: has no header line, like 'joint, type, a [mm], d [mm], alpha [deg], theta [deg]'.")


def _units(header: _Line) -> dict[str, Unit | None]:
    """Return the unit of every column by its name, in the order of the file; None for words."""
    at, titles = header
    if len(titles) == 1 and (mark := next((mark for mark in ";\t|" if mark in titles[0]), "")):
        raise RobotError(f"{at}: cells of a DH table are separated by commas, and not by {shown(mark)}.")
    units: dict[str, Unit | None] = {}
    for title in titles:
        match = _TITLE.fullmatch(title)
        name, symbol = (match[1], None if match[2] is None else match[2].strip()) if match else (title, None)
        if name not in (*_WORDS, *_DIMENSIONS):
            raise RobotError(f"{at}: column {title!r} is not one of {', '.join((*_WORDS, *_DIMENSIONS))}.")
        if name in units:
            raise RobotError(f"{at}: column {name!r} appears more than once.")
        if name in _WORDS and symbol is not None:
            raise RobotError(f"{at}: column {name!r} holds words and takes no unit, but has [{symbol}].")
        if name in _DIMENSIONS and not symbol:
            example = "mm" if _DIMENSIONS[name] == "length" else "deg"
            raise RobotError(f"{at}: column {name!r} has no unit; write one in brackets, like '{name} [{example}]'.")
        units[name] = (
            None if symbol is None else unit_of(symbol, _DIMENSIONS[name], f"{at}: column {name!r}", RobotError)
        )
    for name in _REQUIRED:
        if name not in units:
            raise RobotError(f"{at}: there is no column {name!r}; a DH table has {', '.join(_REQUIRED)}.")
    return units


def _row(line: _Line, units: dict[str, Unit | None], number: int) -> DhRow:
    at, cells = line
    if len(cells) != len(units):
        raise RobotError(f"{at}: the header has {len(units)} cells and this row has {len(cells)}.")
    words = {"joint": f"joint_{number}", "type": "revolute"}
    values: dict[str, float] = {}
    for (name, unit), cell in zip(units.items(), cells, strict=True):
        if unit is None:
            words[name] = cell
        elif NUMBER.fullmatch(cell) is None:
            raise RobotError(f"{at}: column {name!r}: {shown(cell)} {NO_NUMBER}.")
        else:
            values[name] = _si(cell, unit)
    if not words["joint"]:
        raise RobotError(f"{at}: column 'joint': the cell is empty.")
    if not words["joint"].isprintable():  # written, it would be another name
        raise RobotError(f"{at}: column 'joint': {shown(words['joint'])} has a character that cannot be printed.")
    refuse_formula(words["joint"], at)
    refuse_other(words["type"], get_args(RowType), f"{at}: column 'type'", RobotError)
    try:
        return DhRow(words["joint"], cast(RowType, words["type"]), **values)
    except RobotError as e:
        raise RobotError(f"{at}: {e}") from e


def _convention(line: _Line | None) -> Convention | None:
    if line is None:
        return None
    at, (_, *cells) = line
    if len(cells) != 1:
        raise RobotError(f"{at}: 'convention' needs one word, like 'convention, standard'.")
    try:
        check_convention(cells[0])
    except RobotError as e:
        raise RobotError(f"{at}: {e}") from e
    return cast(Convention, cells[0])


def _pose(line: _Line | None) -> Array:
    if line is None:
        return read_only(np.eye(4))
    at, (name, *cells) = line
    if len(cells) != len(_POSE):
        raise RobotError(f"{at}: {name!r} needs six cells with units, {', '.join(_POSE)}, like '10 mm' and '90 deg'.")
    dimensions: tuple[Dimension, ...] = ("length",) * 3 + ("angle",) * 3
    ranges = [OF_DIMENSION[kind] for kind in dimensions]
    values = np.array(
        [parse_within(cell, of, f"{at}: {name}", RobotError) for cell, of in zip(cells, ranges, strict=True)]
    )
    return read_only(rigid.placement(rigid.rotation_of_rpy(values[3:]), values[:3]))
