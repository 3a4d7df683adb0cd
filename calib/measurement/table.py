"""Measurement tables: named columns with a unit on every dimensional one, from a CSV file, a DataFrame or arrays.

The header decides what a column holds, so the renaming of somebody else's headers happens here too. Numbers are SI from
here on; which joints and tools they belong to is decided in :mod:`calib.measurement.measurements`.
"""

import csv
import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from calib.foundations.arrays import Array, IntArray, read_only, read_only_view
from calib.foundations.errors import MeasurementError
from calib.foundations.files import read_bytes
from calib.foundations.units import NUMBER, UNITS, Unit

TEXT_COLUMNS = ("point", "target", "group", "pair", "direction")
# The side from which the joint in the name was reached, in words.
APPROACH = "direction_"
# What the drive of the joint in the name held, by its own account.
TORQUE = "tau_"
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
AS_WRITTEN: Mapping[str, str] = MappingProxyType({})

_LONGEST_LINE = 100_000
_TITLE = re.compile(r"\s*([^\[\]]*?)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*")
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """A named column: N numbers in SI (read-only float64), or N words where ``unit`` is None.

    ``unit`` is the one that was written, kept for its dimension; a quaternion's columns have the unit ``1``.
    """

    name: str
    unit: Unit | None
    values: Array | tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Columns of N rows by name, in the order of the table.

    ``lines`` (N) says where each row stands in ``where``: the line of a file, or the position from 0 in a frame.
    """

    columns: Mapping[str, Column]
    lines: IntArray
    where: str

    def __len__(self) -> int:
        return len(self.lines)


class Frame(Protocol):
    """What is asked of a pandas DataFrame, so that pandas need not be there."""

    @property
    def columns(self) -> Iterable[Any]:
        """The labels of the columns."""

    def __getitem__(self, label: Any, /) -> Any:
        """Return the column with this label; it has ``to_numpy()``."""


class _Heading(NamedTuple):
    name: str
    unit: Unit | None


_Place = Callable[[int], str]  # the place of a row, for the start of a sentence: "panda.csv:12"


def read_table(path: str | Path, columns: Mapping[str, str] = AS_WRITTEN) -> Table:
    """Read a comma-separated UTF-8 table: a header line, then a line per row; ``#`` comments and blank lines anywhere.

    ``columns`` renames: ``{"x": "measurement_x"}`` reads the file's column ``measurement_x`` as ``x``, and
    ``{"x [mm]": "measurement_x"}`` also gives it the unit that the file leaves out.

    Raises MeasurementError with the file, the line, the column, the value and what is allowed.
    """
    where = str(path)
    text = _decode(read_bytes(Path(path), MeasurementError), where)
    numbered = _lines(text)
    if not numbered:
        raise MeasurementError(f"{where}: is empty; a table starts with a header line.")
    (header_line, titles), *body = numbered
    at_header = f"{where}:{header_line}"
    _refuse_other_separators(titles, at_header)
    header = _header(_cells(titles, at_header), columns, at_header)
    rows = [_cells(line, f"{where}:{number}") for number, line in body]
    _refuse_ragged(rows, len(header), [number for number, _ in body], where, complete=text.endswith(("\n", "\r")))
    data = zip(*rows, strict=True) if rows else ((),) * len(header)
    return _table(header, data, [number for number, _ in body], where)


def table_from_frame(frame: Frame, where: str = "DataFrame", columns: Mapping[str, str] = AS_WRITTEN) -> Table:
    """Return the table of a pandas DataFrame whose labels are written as in a file; ``columns`` renames them.

    Raises MeasurementError as :func:`read_table` does, with the position of the row, counted from 0, as the line.
    """
    labels = list(frame.columns)
    for label in labels:
        if not isinstance(label, str):
            raise MeasurementError(f"{where}: the column label {label!r} is not text.")
        if labels.count(label) > 1:
            raise MeasurementError(f"{where}: column {label!r} is there more than once.")
    return table_from_arrays({label: frame[label].to_numpy() for label in labels}, where, columns)


def table_from_arrays(
    arrays: Mapping[str, npt.ArrayLike], where: str = "arrays", columns: Mapping[str, str] = AS_WRITTEN
) -> Table:
    """Return the table of equally long one-dimensional arrays, keyed by headers written as in a file.

    Raises MeasurementError as :func:`table_from_frame` does.
    """
    data = [np.asarray(values) for values in arrays.values()]
    shapes = {values.shape for values in data}
    if len(shapes) > 1 or any(len(shape) != 1 for shape in shapes):
        listed = ", ".join(f"{title!r} {values.shape}" for title, values in zip(arrays, data, strict=True))
        raise MeasurementError(f"{where}: the columns are not one-dimensional and equally long: {listed}.")
    return _table(_header(list(arrays), columns, where), data, range(data[0].size if data else 0), where)


def _table(
    header: Sequence[_Heading],
    data: Iterable[Sequence[str] | npt.NDArray[Any]],
    lines: Sequence[int],
    where: str,
) -> Table:
    if not lines:
        raise MeasurementError(f"{where}: has a header and no rows.")

    def place(row: int) -> str:
        return f"{where}:{lines[row]}"

    columns = {
        name: Column(name, unit, _words(values, name, place) if unit is None else _si(values, unit, name, place))
        for (name, unit), values in zip(header, data, strict=True)
    }
    return Table(MappingProxyType(columns), read_only_view(np.array(lines, dtype=np.intp)), where)


# ---- header


def _header(titles: Sequence[str], columns: Mapping[str, str], at: str) -> list[_Heading]:
    ours = {theirs: name for name, theirs in columns.items()}
    if len(ours) < len(columns):
        raise MeasurementError(f"{at}: the renaming gives one column two names: {dict(columns)}.")
    header: dict[str, _Heading] = {}
    for title in titles:
        name, symbol = _split(title, at)
        if (new := ours.pop(title.strip(), None) or ours.pop(name, None)) is not None:
            name, given = _split(new, at)
            if symbol and given and symbol != given:
                raise MeasurementError(f"{at}: column {title!r} is renamed to {new!r}, which has another unit.")
            symbol = given or symbol
        if name in header:
            raise MeasurementError(f"{at}: column {name!r} is there more than once.")
        header[name] = _Heading(name, _unit(name, symbol, at))
    for theirs, name in ours.items():
        raise MeasurementError(f"{at}: there is no column {theirs!r} to read as {name!r}{nearest(theirs, titles)}.")
    return list(header.values())


def nearest(name: str, known: Iterable[str]) -> str:
    """Return the end of a sentence about an unknown name: ``; near is 'x'``, or nothing when no known one is near."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f"; near is {near[0]!r}" if near else ""


def _split(title: str, at: str) -> tuple[str, str | None]:
    match = _TITLE.fullmatch(title)
    if match is None:
        raise MeasurementError(f"{at}: the header {title!r} is not a name with a unit, like 'x [mm]'.")
    if not match[1]:
        raise MeasurementError(f"{at}: a column has no name (is there a comma too many?).")
    return match[1], match[2]


def _unit(name: str, symbol: str | None, at: str) -> Unit | None:
    if name in TEXT_COLUMNS or name.startswith(APPROACH):
        if symbol is not None:
            raise MeasurementError(f"{at}: column {name!r} holds words and takes no unit, but has [{symbol}].")
        return None
    if name in QUATERNION_COLUMNS and symbol is None:
        return UNITS["1"]
    if not symbol:
        raise MeasurementError(
            f"{at}: column {name!r} has no unit; write one in brackets, like '{name} [mm]': {', '.join(UNITS)}."
        )
    if symbol not in UNITS:
        raise MeasurementError(f"{at}: column {name!r}: unit {symbol!r} is not known; allowed are {', '.join(UNITS)}.")
    return UNITS[symbol]


# ---- values


def _si(values: Sequence[str] | npt.NDArray[Any], unit: Unit, name: str, place: _Place) -> Array:
    if isinstance(values, np.ndarray) and values.dtype.kind in "iuf":
        numbers = values.astype(np.float64)
    else:
        # Objects of a frame pass the same gate as the cells of a file.
        numbers = _parsed([str(value) for value in values], name, place)
    si = read_only(unit.factor * numbers)
    finite = np.isfinite(si)
    if not finite.all():
        row = int(np.argmin(finite))
        raise MeasurementError(f"{place(row)}: column {name!r}: {values[row]} is not a finite number.")
    return si


def _parsed(cells: Sequence[str], name: str, place: _Place) -> Array:
    for row, cell in enumerate(cells):
        if NUMBER.fullmatch(cell) is None:
            raise MeasurementError(f"{place(row)}: column {name!r}: {_not_a_number(cell)}.")
    return np.fromiter(map(float, cells), dtype=np.float64, count=len(cells))


def _not_a_number(cell: str) -> str:
    if not cell:
        return "the cell is empty"
    if NUMBER.fullmatch(cell.replace(",", ".")):
        return f"{cell!r} has a decimal comma; write a point"
    return f"{cell!r} is not a number like 12.5 or 1.25e1"


def _words(values: Sequence[str] | npt.NDArray[Any], name: str, place: _Place) -> tuple[str, ...]:
    for row, value in enumerate(values):
        # Whole numbers name groups well; a float would read 1 or 1.0, and stands for a missing cell in a frame.
        if not isinstance(value, str | Integral):
            raise MeasurementError(f"{place(row)}: column {name!r}: {value} is not a word.")
        if not str(value).strip():
            raise MeasurementError(f"{place(row)}: column {name!r}: the cell is empty.")
    return tuple(str(value).strip() for value in values)


# ---- from bytes to cells


def _decode(data: bytes, where: str) -> str:
    if data.startswith(_UTF16_MARKS):
        raise MeasurementError(f"{where}: is UTF-16 text; save it as UTF-8.")
    if (nul := data.find(b"\0")) >= 0:
        raise MeasurementError(f"{_at_offset(data, nul, where)}: has a NUL byte; a table is UTF-8 text.")
    try:
        return data.removeprefix(b"\xef\xbb\xbf").decode()
    except UnicodeDecodeError as e:
        raise MeasurementError(f"{_at_offset(e.object, e.start, where)}: is not UTF-8 text; save it as UTF-8.") from e


def _at_offset(data: bytes, offset: int, where: str) -> str:
    before = data[:offset].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    line = before.count(b"\n") + 1
    return f"{where}:{line}"


def _lines(text: str) -> list[tuple[int, str]]:
    """Return the lines that are neither blank nor comments, with their numbers from 1."""
    # splitlines() would also split at form feeds and the like, and number the lines as no editor does.
    lines = enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1)
    return [(number, line) for number, line in lines if line.strip() and not line.lstrip().startswith("#")]


def _refuse_other_separators(titles: str, at: str) -> None:
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if separator in titles and "," not in titles:
            raise MeasurementError(f"{at}: the cells are separated by {name}; separate them by commas.")


def _cells(line: str, at: str) -> list[str]:
    """Return the cells of one line. A row never goes over several, so that an open quote is found where it stands."""
    if len(line) > _LONGEST_LINE:
        raise MeasurementError(f"{at}: is {len(line)} characters long; allowed are {_LONGEST_LINE}.")
    try:
        (cells,) = csv.reader((line,), strict=True, skipinitialspace=True)
    except csv.Error as e:
        raise MeasurementError(f"{at}: a quote is not closed, or something follows it.") from e
    return [cell.strip() for cell in cells]


def _refuse_ragged(
    rows: Sequence[Sequence[str]], width: int, lines: Sequence[int], where: str, *, complete: bool
) -> None:
    for row, (line, cells) in enumerate(zip(lines, rows, strict=True), start=1):
        if len(cells) == width:
            continue
        if len(cells) < width and row == len(rows) and not complete:
            hint = ", and the file ends within this row: it seems truncated"
        elif len(cells) > width and cells[-1]:
            hint = "; if these are decimal commas, write points"
        else:
            hint = ""
        raise MeasurementError(f"{where}:{line}: the header has {width} cells and this row has {len(cells)}{hint}.")
