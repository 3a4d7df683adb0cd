"""Measurement tables: named columns with a unit on every dimensional one, from a CSV file, a DataFrame or arrays.

The header decides what a column holds, so the renaming of somebody else's headers happens here too. Numbers are SI from
here on; which joints and tools they belong to is decided in :mod:`calib.measurement.from_table`.
"""

import contextlib
import itertools
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, cast, runtime_checkable

import numpy as np
import numpy.typing as npt

from calib.foundations.arguments import is_masked, own_fields, told
from calib.foundations.arrays import Array, BoolArray, IntArray, in_float64, read_only_view
from calib.foundations.csv_text import without_marks
from calib.foundations.errors import MeasurementError
from calib.foundations.files import read_bytes
from calib.foundations.ranges import OF_DIMENSION, SMALLEST_CELL
from calib.foundations.sealing import sealed
from calib.foundations.units import NO_NUMBER, NUMBER, UNITS, Unit, symbol_of
from calib.foundations.words import near, shortened, shown
from calib.measurement.cells import MOST_COLUMNS, Line, cells, in_bytes, lines, refuse_ragged
from calib.measurement.layout import is_number_of_name, layout, name_and_unit, nameless, with_units
from calib.measurement.orientations import ANGLES, MATRIX, quaternions_of

TEXT_COLUMNS = ("tool", "setup", "target", "group", "pair", "direction")
# The side from which the joint in the name was reached, in words.
APPROACH = "direction_"
# What the drive of the joint in the name held, by its own account.
TORQUE = "tau_"
# Where the joint in the name was told to be.
COMMANDED = "commanded_"
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
# Numbers that need no unit.
UNITLESS = frozenset((*QUATERNION_COLUMNS, *MATRIX))
# What ``calib compensate`` says of its commands, in words.
_OF_COMMANDS = ("reached", "reason")
NO_NAMES: Mapping[str, str] = MappingProxyType({})

_LONGEST_WORD = 200
# Python writes no whole number of more than some thousands of digits.
_MOST_BITS = 1024
_LISTED = 12
# What a plain number is made of; of these, float() takes only plain numbers.
_PLAIN = b"0123456789.+-eE"
# What is in brackets at the end is the unit; names may have brackets too, as `finger[0]`.
_TITLE = re.compile(r"((?:[^\[\]]|\[[^\[\]]*\])*?)(?:\[([^\[\]]*)\])?")
_IN_BRACKETS = re.compile(r"\[([^\[\]]*)\]")


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Column:
    """A named column: N numbers in SI (read-only float64), or N words where ``unit`` is None.

    ``unit`` is the one that was written, kept for its dimension; a quaternion's columns have the unit ``1``. ``title``:
    what stands above it in a table of text, with its unit; of a column by another name, what its table has there.
    """

    name: str
    unit: Unit | None
    values: Array | tuple[str, ...]
    title: str = ""


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Table:
    """Columns of N rows by name, in the order of the table.

    ``lines`` (N) says where each row stands in ``where``: the line of a file, or the position from 0 in a frame.
    ``written``: the columns as they were read, with the angles, or matrix, of which an orientation made a quaternion.
    """

    columns: Mapping[str, Column]
    lines: IntArray
    where: str
    written: tuple[Column, ...]

    def __len__(self) -> int:
        return len(self.lines)

    def __reduce__(self) -> tuple[object, ...]:
        """Go to other processes and into copies, which no read-only view of a mapping does by itself."""
        return _table, (dict(self.columns), self.lines, self.where, self.written)

    def refuse(self, wrong: BoolArray, said: Callable[[int], str]) -> None:
        """Raise MeasurementError for the first row that is wrong (N,), with what is ``said`` of it."""
        if wrong.any():
            row = int(np.argmax(wrong))
            raise MeasurementError(f"{self.where}:{self.lines[row]}: {said(row)}")


def _table(columns: dict[str, Column], numbers: IntArray, where: str, written: tuple[Column, ...]) -> Table:
    return Table(MappingProxyType(columns), numbers, where, written)


@runtime_checkable
class DataFrameLike(Protocol):
    """What is asked of a pandas DataFrame, so that pandas need not be there."""

    @property
    def columns(self) -> Iterable[Any]:
        """The labels of the columns."""

    def __getitem__(self, label: Any, /) -> Any:
        """Return the column with this label; it has ``to_numpy()``."""


class HeaderError(MeasurementError):
    """The header of a table, not its rows, cannot be used; ``unitless``: columns that would need a unit."""

    def __init__(self, said: str, unitless: Sequence[str] = ()) -> None:
        super().__init__(said)
        self.unitless = tuple(unitless)


@dataclass(frozen=True, slots=True)
class Columns:
    """How a table of others is read: our names for its columns, what is passed over, and what its angles mean.

    ``names``: ``{"x": "measurement_x"}`` reads the file's column ``measurement_x`` as ``x``, and
    ``{"x [mm]": "measurement_x"}`` also gives it the unit that the file leaves out. ``ignore``: columns, as the file
    has them, that are not read; of a title that stands twice, the first, and both where it is given twice.
    ``orientation``: what the columns ``rx``, ``ry``, ``rz``, or ``r11`` to ``r33``, are (docs/files_of_others.md); they
    become a quaternion. ``where_present``: columns that a table lacks of these are no error.
    """

    names: Mapping[str, str] = field(default_factory=lambda: NO_NAMES, hash=False)
    ignore: tuple[str, ...] = ()
    orientation: str | None = None
    where_present: bool = False

    def __post_init__(self) -> None:
        own_fields(self)


AS_WRITTEN = Columns()


def as_columns(columns: Mapping[str, str] | Columns) -> Columns:
    """Return columns, of which a mapping is the names."""
    return columns if isinstance(columns, Columns) else Columns(columns)


class _Heading(NamedTuple):
    name: str
    unit: Unit | None
    called: str  # where something is wrong in it: as the file has it
    read: bool = True
    title: str = ""  # of a column that is renamed: as the file has it, with a unit that the file has elsewhere


_Place = Callable[[int], str]  # the place of a row, for the start of a sentence: "panda.csv:12"


def read_table(path: str | Path, columns: Mapping[str, str] | Columns = AS_WRITTEN) -> Table:
    """Read a table of text: a header line, then a line per row; comments and blank lines anywhere.

    Cells are separated by commas, or by semicolons, tabs, bars or blanks; decimals then have commas or points, the same
    in the whole file. The text is UTF-8, UTF-16 with its mark, or cp1252. Memory: the file and its numbers, 8 bytes
    each.

    ``columns``: how it is read where its header is not ours; a mapping of names alone will do.

    Raises MeasurementError with the file, the line, the column, the value and what is allowed.
    """
    where = str(path)
    data = in_bytes(read_bytes(Path(path), MeasurementError), where)
    form = layout(data, where)
    header = _header(form.titles, as_columns(columns), f"{where}:{form.line}", form.units)
    reader = _BlockReader(header, where, form.separator)
    rows = ([line for line in block if line.number > form.last] for block in lines(data, where))
    parts = [reader(block) for block in rows if block]
    if not parts:
        raise MeasurementError(f"{where}: has a header and no rows.")
    del data
    header = [heading for heading in header if heading.read]
    # Column by column, and what is joined is let go: all columns are in memory once, one of them twice.
    values = [_joined([part.values.pop() for part in parts]) for _ in header][::-1]
    return _whole(header, values, np.concatenate([part.numbers for part in parts]), where, as_columns(columns))


def names_in(source: str | Path | Iterable[str]) -> frozenset[str]:
    """Return what the columns of a table of text, or these titles, may be called in ``Columns``: whole, or bare."""
    titles: Iterable[str]
    if isinstance(source, str | Path):
        where = str(source)
        titles = layout(in_bytes(read_bytes(Path(source), MeasurementError), where), where).names
    else:
        titles = source
    found = set()
    for title in titles:
        found.add(title.strip())
        with contextlib.suppress(HeaderError):
            found.add(_split(title)[0])
    return frozenset(found)


class _Part(NamedTuple):
    numbers: IntArray
    values: list[Array | tuple[str, ...]]


class _BlockReader:
    """Makes numbers and words of blocks of lines, and remembers which decimal mark was seen and where."""

    def __init__(self, header: Sequence[_Heading], where: str, separator: str) -> None:
        self._header, self._where, self._separator = header, where, separator
        self._marks: dict[str, str] = {}
        self._known: dict[str, str] = {}

    def __call__(self, block: Sequence[Line]) -> _Part:
        numbers = [line.number for line in block]

        def place(row: int) -> str:
            return f"{self._where}:{numbers[row]}"

        rows = [cells(text, self._separator, f"{self._where}:{number}") for number, text, _ in block]
        refuse_ragged(rows, len(self._header), block, self._where)
        values: list[Array | tuple[str, ...]] = []
        for heading, column in zip(self._header, zip(*rows, strict=True), strict=True):
            name, unit = heading.called, heading.unit
            if not heading.read:
                continue
            if unit is None:
                # Words come again and again: one of each is kept.
                values.append(tuple(self._known.setdefault(word, word) for word in _words(column, name, place)))
            else:
                decimals = self._with_points(column, name, place) if self._separator != "," else column
                values.append(_si(decimals, unit, name, place))
        return _Part(np.array(numbers, dtype=np.intp), values)

    def _with_points(self, column: Sequence[str], name: str, place: _Place) -> Sequence[str]:
        """Return numbers with points; where some have commas and some points, 1.234 may be a thousand."""
        joined = "".join(column)
        for mark, other in ((",", "."), (".", ",")):
            if mark in joined:
                row = next(row for row, cell in enumerate(column) if mark in cell)
                if other in self._marks or other in column[row]:
                    raise MeasurementError(
                        f"{place(row)}: column {name!r}: {shown(column[row])} has a decimal "
                        f"{'comma' if mark == ',' else 'point'}, and {self._marks.get(other, 'the same cell')} has a "
                        f"decimal {'point' if mark == ',' else 'comma'}; use one of them in the whole file, and no "
                        "mark between thousands."
                    )
                self._marks.setdefault(mark, f"{place(row)}, column {name!r},")
        return [cell.replace(",", ".") for cell in column] if "," in joined else column


def _joined(parts: Sequence[Array | tuple[str, ...]]) -> Array | tuple[str, ...]:
    if isinstance(parts[0], tuple):
        return tuple(itertools.chain.from_iterable(cast(Sequence[tuple[str, ...]], parts)))
    return read_only_view(np.concatenate(cast(Sequence[Array], parts)))


def table_from_frame(
    frame: DataFrameLike, where: str = "DataFrame", columns: Mapping[str, str] | Columns = AS_WRITTEN
) -> Table:
    """Return the table of a pandas DataFrame whose labels are written as in a file; ``columns`` renames them.

    Raises MeasurementError as :func:`read_table` does, with the position of the row, counted from 0, as the line.
    """
    labels = list(frame.columns)
    for label in labels:
        if not isinstance(label, str):
            raise MeasurementError(f"{where}: the column label {label!r} is not text.")
        if labels.count(label) > 1:
            raise MeasurementError(f"{where}: column {label!r} appears more than once.")
    return table_from_arrays({label: frame[label].to_numpy() for label in labels}, where, columns)


def table_from_arrays(
    arrays: Mapping[str, npt.ArrayLike], where: str = "arrays", columns: Mapping[str, str] | Columns = AS_WRITTEN
) -> Table:
    """Return the table of equally long one-dimensional arrays, keyed by headers written as in a file.

    Raises MeasurementError as :func:`table_from_frame` does.
    """
    data = [_column(values, f"{where}: column {shown(title)}") for title, values in arrays.items()]
    shapes = {values.shape for values in data}
    if len(shapes) > 1 or any(len(shape) != 1 for shape in shapes):
        listed = ", ".join(f"{title!r} {values.shape}" for title, values in zip(arrays, data, strict=True))
        raise MeasurementError(f"{where}: the columns are not one-dimensional and equally long: {listed}.")
    chosen = as_columns(columns)
    header, rows = _header(list(arrays), chosen, where), np.arange(data[0].size if data else 0)
    if not len(rows):
        raise MeasurementError(f"{where}: has a header and no rows.")

    def place(row: int) -> str:
        return f"{where}:{row}"

    values = [
        _words(column, heading.called, place)
        if heading.unit is None
        else _si(column, heading.unit, heading.called, place)
        for heading, column in zip(header, data, strict=True)
        if heading.read
    ]
    return _whole([heading for heading in header if heading.read], values, rows, where, chosen)


def _column(values: npt.ArrayLike, where: str) -> npt.NDArray[Any]:
    if is_masked(values):  # numbers behind a mask are not told from others
        raise MeasurementError(f"{where} is {told(values)}; leave its rows out, or give them a number.")
    try:
        return np.asarray(values)
    except ValueError as error:  # lists of several lengths
        raise MeasurementError(f"{where} is {told(values)}; needs one value for each row.") from error


def _whole(
    header: Sequence[_Heading],
    values: Sequence[Array | tuple[str, ...]],
    numbers: IntArray,
    where: str,
    chosen: Columns,
) -> Table:
    written = tuple(
        Column(heading.name, heading.unit, column, heading.title or _title(heading.name, heading.unit))
        for heading, column in zip(header, values, strict=True)
    )
    columns = {column.name: column for column in written}
    if chosen.orientation is not None and not (chosen.where_present and _lacking(chosen.orientation, columns)):
        columns = _turned(columns, chosen.orientation, numbers, where)
    return _table(columns, read_only_view(numbers), where, written)


def _titles(orientation: str) -> tuple[str, ...]:
    return MATRIX if orientation == "matrix" else ANGLES


def _lacking(orientation: str, columns: Collection[str]) -> list[str]:
    return [name for name in _titles(orientation) if name not in columns]


def _turned(columns: dict[str, Column], orientation: str, lines: IntArray, where: str) -> dict[str, Column]:
    """Return the columns with a quaternion in the place of the angles, or the matrix, that ``orientation`` names."""
    names = _titles(orientation)
    dimension = "number" if orientation == "matrix" else "angle"
    if missing := _lacking(orientation, columns):
        raise HeaderError(
            f"{where}: orientation is {orientation!r}, and there is no column {', '.join(map(repr, missing))}; a "
            f"column with another title is read as one by columns, or --column '{missing[0]}=TITLE'."
        )
    for name in names:
        unit = columns[name].unit
        if unit is None or unit.dimension != dimension:
            raise HeaderError(f"{where}: column {name!r}: is not of {dimension}s, which an orientation needs.")
    given = np.stack([cast(Array, columns[name].values) for name in names], axis=-1)
    found = quaternions_of(given, orientation, where, lines)
    rest = {name: column for name, column in columns.items() if name not in names}
    if both := [name for name in QUATERNION_COLUMNS if name in rest]:
        raise HeaderError(f"{where}: column {both[0]!r} and column {names[0]!r} say the same thing; keep one.")
    return rest | {
        name: Column(name, UNITS["1"], read_only_view(np.ascontiguousarray(found[:, k])))
        for k, name in enumerate(QUATERNION_COLUMNS)
    }


# ---- header


def _header(titles: Sequence[str], columns: Columns, at: str, units: Sequence[str] = ()) -> list[_Heading]:
    """Return what each title stands for; raise HeaderError with all that is wrong, in one sentence."""
    ours = {theirs: name for name, theirs in columns.names.items()}
    if len(ours) < len(columns.names):
        raise HeaderError(f"{at}: the renaming gives one column two names: {dict(columns.names)}.")
    if len(titles) > MOST_COLUMNS:
        raise HeaderError(f"{at}: has {len(titles)} columns; allowed are {MOST_COLUMNS}.")
    left = Counter(columns.ignore)
    header: list[_Heading] = []
    names: set[str] = set()
    wrong: list[str] = []
    unitless: list[str] = []
    commands: list[str] = []
    for k, title in enumerate(_named_by_place(titles, {*left, *ours})):
        try:
            name, symbol = _split(title, (*left, *ours))
            symbol = symbol or (units[k] if units else None) or None
            if title.strip() in left or name in left:
                left -= Counter([title.strip() if title.strip() in left else name])
                header.append(_Heading(name, None, name, read=False))
                continue
            called, there = name, ""
            if (new := ours.pop(title.strip(), None) or ours.pop(name, None)) is not None:
                called = title.strip()
                (there,) = with_units([called], [units[k] if units else ""])
                written, (name, given) = name, _split(new)
                if symbol and given and symbol != given and not (columns.where_present and name == written):
                    raise HeaderError(f"column {title!r} is renamed to {new!r}, which has another unit")
                symbol = symbol or given
            if name in names:
                raise HeaderError(f"column {name!r} appears more than once")
            names.add(name)
            if not symbol and name in _OF_COMMANDS:
                commands.append(name)
            elif not symbol and not (holds_words(name) or name in UNITLESS):
                unitless.append(name)
            else:
                header.append(_Heading(name, _unit(name, symbol), called, title=there))
        except HeaderError as e:
            wrong.append(str(e))
    if unitless:
        wrong.insert(0, no_unit(unitless))
    if commands:
        listed = " and ".join(map(repr, commands))
        wrong.insert(
            0, f"{listed} are words of commands, as calib compensate writes them; give the table it was made of"
        )
    if not columns.where_present:
        wrong += [
            f"there is no column {theirs!r} to read as {ours[theirs]!r}{nearest(theirs, titles)}" for theirs in ours
        ]
        wrong += [
            f"there is no column {name!r} to ignore{nearest(name, titles)}"
            for name, many in left.items()
            if many == columns.ignore.count(name)
        ]
    if wrong:
        raise HeaderError(f"{at}: {'; '.join(wrong[:_LISTED])}.", unitless)
    return header


def _title(name: str, unit: Unit | None) -> str:
    return name if unit is None or unit.symbol == "1" else f"{name} [{unit.symbol}]"


def _named_by_place(titles: Sequence[str], known: Collection[str]) -> list[str]:
    """Return titles, with the place of a column for its name where it has none and is known by it."""
    return [title if title.strip() or nameless(k) not in known else nameless(k) for k, title in enumerate(titles)]


def no_unit(names: Sequence[str]) -> str:
    """Return the sentence, without its full stop, about columns that have no unit."""
    one, other = ("deg", "mm") if names[0][-1:].isdigit() else ("mm", "deg")
    if names[0] == "time":
        one, other = "s", "ms"
    like = f"write one in brackets, like '{names[0]} [{one}]' or '[{other}]'"
    if len(names) == 1:
        return f"column {names[0]!r} has no unit; {like}"
    listed = ", ".join(map(repr, names[:_LISTED])) + (", ..." if len(names) > _LISTED else "")
    return f"columns {listed} have no unit; {like}"


def nearest(name: str, known: Iterable[str]) -> str:
    """Return the end of a sentence about an unknown name: ``; near is 'x'``, or nothing when no known one is near."""
    found = near(name, known, most=1)
    return f"; near is {found[0]!r}" if found else ""


def _split(title: str, said: Collection[str] = ()) -> tuple[str, str | None]:
    """Return name and unit in a title. One of which it is ``said`` what it means may be anything; it states no unit."""
    try:
        return _read(title)
    except HeaderError:
        if title.strip() not in said:
            raise
        return title.strip(), None


def _read(title: str) -> tuple[str, str | None]:
    match = _TITLE.fullmatch(title.strip())
    # Two units behind one name are one too many; "1", the unit of plain numbers, is rather a number of the name.
    if match is None or any(symbol_of(word) not in (None, "1") for word in _IN_BRACKETS.findall(match[1])):
        raise HeaderError(f"the header {shown(title)} is not a name with a unit, like 'x [mm]'")
    name, unit = match[1].strip(), None if match[2] is None else match[2].strip()
    if not name:
        raise HeaderError("a column has no name (is there a comma too many?)")
    if len(title) > _LONGEST_WORD:
        raise HeaderError(f"the header {shown(title)} is longer than {_LONGEST_WORD} characters")
    if unit is not None and name not in UNITLESS:
        # The name of a joint may end in brackets: with its number, or with anything where no unit may be.
        own_word = name.startswith(APPROACH) and symbol_of(unit) is None
        if own_word or is_number_of_name(match[1], unit):
            name, unit = title.strip(), None
    if unit is None and not holds_words(name):
        return name_and_unit(name)
    return name, unit and (symbol_of(unit) or unit)


def holds_words(name: str) -> bool:
    """Return whether a column of ours with this name holds words, not numbers."""
    return name in TEXT_COLUMNS or name.startswith(APPROACH)


def _unit(name: str, symbol: str | None) -> Unit | None:
    if holds_words(name):
        if symbol is not None:
            raise HeaderError(f"column {name!r} holds words and takes no unit, but has [{symbol}]")
        return None
    symbol = symbol or "1"
    if symbol not in UNITS:
        raise HeaderError(f"column {name!r}: unit {symbol!r} is not known; allowed are {', '.join(UNITS)}")
    return UNITS[symbol]


# ---- values


def _si(values: Sequence[str] | npt.NDArray[Any], unit: Unit, name: str, place: _Place) -> Array:
    if isinstance(values, np.ndarray) and values.dtype.kind in "iuf":
        numbers = in_float64(values)
    else:
        # Objects of a frame pass the same gate as the cells of a file.
        numbers = _parsed(values if isinstance(values, tuple) else [_written(value) for value in values], name, place)
    si = read_only_view(np.asarray(unit.factor * numbers))
    allowed = OF_DIMENSION[unit.dimension]
    low, high = allowed.ends
    lost = (si > -SMALLEST_CELL) & (si < SMALLEST_CELL) & (si != 0.0)
    within = (si >= low) & (si <= high) & ~lost  # false for nan
    if not within.all():
        row = int(np.argmin(within))
        value = shortened(str(values[row]))
        if not np.isfinite(si[row]):
            reason = "not a finite number"
        elif lost[row]:
            reason = f"out of range; what is not 0 has a size of {SMALLEST_CELL:g} or more in SI units"
        else:
            reason = f"out of range; allowed is {allowed}"
        raise MeasurementError(f"{place(row)}: column {name!r}: {value} is {reason}.")
    return si


def _parsed(column: Sequence[str], name: str, place: _Place) -> Array:
    try:
        if not "".join(column).encode().translate(None, _PLAIN):
            return np.array(list(map(float, column)))
    except ValueError:  # which cell it is, is found below; lone halves of a character cannot be encoded either
        pass
    row = next(row for row, cell in enumerate(column) if NUMBER.fullmatch(cell) is None)
    raise MeasurementError(f"{place(row)}: column {name!r}: {_not_a_number(column[row])}.")


def _not_a_number(cell: str) -> str:
    if not cell:
        return "the cell is empty"
    if NUMBER.fullmatch(cell.replace(",", ".")):
        return f"{shown(cell)} has a decimal comma; write a point"
    return f"{shown(cell)} {NO_NUMBER}"


def _written(value: object) -> str:
    return told(value) if _is_huge(value) else str(value)


def _is_huge(value: object) -> bool:
    return isinstance(value, int) and value.bit_length() > _MOST_BITS


def _words(values: Sequence[str] | npt.NDArray[Any], name: str, place: _Place) -> tuple[str, ...]:
    for row, value in enumerate(values):
        # Whole numbers name groups well; a float would read 1 or 1.0, and stands for a missing cell in a frame.
        if not isinstance(value, str | Integral) or _is_huge(value):
            raise MeasurementError(f"{place(row)}: column {name!r}: {told(value)} is not a word.")
        if not str(value).strip():
            raise MeasurementError(f"{place(row)}: column {name!r}: the cell is empty.")
        if len(str(value)) > _LONGEST_WORD:
            raise MeasurementError(
                f"{place(row)}: column {name!r}: {shown(str(value))} is longer than {_LONGEST_WORD} characters."
            )
        if any("\ud800" <= letter <= "\udfff" for letter in str(value)):
            raise MeasurementError(f"{place(row)}: column {name!r}: {shown(str(value))} holds half a character.")
    return tuple(without_marks(str(value).strip()) for value in values)
