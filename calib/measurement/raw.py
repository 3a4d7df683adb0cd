"""A table of somebody else as it is: titles, units where they are written, and the numbers of rows spread over it."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import MeasurementError
from calib.foundations.sealing import sealed
from calib.foundations.units import UNITS, symbol_of
from calib.foundations.words import shown
from calib.measurement.cells import MOST_COLUMNS, beginning, cells, in_bytes, lines, refuse_ragged, to_import
from calib.measurement.formats import pairs
from calib.measurement.formats.logs import is_motive
from calib.measurement.formats.reports import of_report
from calib.measurement.formats.statements import are_alike, are_in, are_torn, opens_list
from calib.measurement.layout import Layout, is_number, is_number_of_name, layout, name_and_unit

# Enough to tell a unit from another; a table may have a million rows.
_MOST_ROWS = 400
# A unit that we do not know; numbers in brackets are none.
_BRACKETED = re.compile(r"\[\s*[^\W\d][^\[\]]*\]$")


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class RawColumn:
    """One column: its ``title`` as the file has it, ``name`` without the unit, the unit's ``symbol``, or None.

    ``numbers`` (N): as written, nan where a cell is empty; None where some cell is none. ``words``: the cells.
    """

    title: str
    name: str
    symbol: str | None
    numbers: Array | None
    words: tuple[str, ...]

    @property
    def dimension(self) -> str | None:
        """What the unit is one of; None where no unit is written, ``"unknown"`` where it is none of ours."""
        if self.symbol is None:
            return "unknown" if _BRACKETED.search(self.title) else None
        return UNITS[self.symbol].dimension


@dataclass(frozen=True, slots=True, eq=False)
class RawTable:
    """Columns of N rows that are spread over the ``count`` rows of ``where``; ``remarks``: how the text was read.

    ``named``: the file has a header; without one columns are called ``column 1``, ``column 2``, ...
    ``data``: the whole text, laid out as ``form``.
    """

    where: str
    columns: tuple[RawColumn, ...]
    count: int
    remarks: tuple[str, ...]
    named: bool
    data: bytes
    form: Layout

    def all_numbers(self, columns: Sequence[int]) -> list[Array | None]:
        """Return the numbers (count,) of columns, of all rows; None for one of which some cell is none."""
        rows = (
            cells(line.text, self.form.separator, f"{self.where}:{line.number}")
            for block in lines(self.data, self.where)
            for line in block
            if line.number > self.form.last
        )
        words = zip(*([row[k] for k in columns] for row in rows), strict=True)
        return [_column("", "", own, self.form.separator).numbers for own in words]


def raw_table(data: bytes, where: str) -> RawTable:
    """Return a table as it is. Raises MeasurementError when it is no table of text with rows of as many cells."""
    data = in_bytes(data, where)
    beginning(data, where)  # what is no text says so
    if is_motive(data[:1000].decode("utf-8", errors="replace")):
        raise MeasurementError(
            f"{where}: is an export of Motive; {to_import(where)} -o table.csv makes a table of a body in it."
        )
    if pairs.are_in(data, where):
        raise MeasurementError(
            f"{where}: has no header, as every line names its numbers; {to_import(where)} -o table.csv makes a table."
        )
    try:
        return _whole(data, where)
    except MeasurementError as e:
        raise (of_lists(where) if are_in(data) else of_report(data, where, e)) from e


def becomes_table(data: bytes, where: str) -> bool:
    """Return whether a text is no table as it is, but becomes one: its lines name their numbers, or have lists of such.

    Raises MeasurementError for what is no text.
    """
    data = in_bytes(data, where)
    return pairs.are_in(data, where) or are_in(data)


def of_lists(where: str) -> MeasurementError:
    """Return what to raise for a text whose numbers stand in lists: no table, but one can be made of it."""
    return MeasurementError(
        f"{where}: has lists of numbers in brackets; {to_import(where)} -o table.csv makes a table of them."
    )


def _whole(data: bytes, where: str) -> RawTable:
    form = layout(data, where)
    if len(form.titles) > MOST_COLUMNS:
        raise MeasurementError(f"{where}:{form.line}: has {len(form.titles)} columns; allowed are {MOST_COLUMNS}.")
    if again := next((name for name, times in Counter(form.names).items() if times > 1), None):
        raise MeasurementError(
            f"{where}:{form.line}: several columns are called {shown(again)}; {to_import(where)} -o table.csv tells "
            "them apart."
        )
    count = sum(sum(line.number > form.last for line in block) for block in lines(data, where))
    if not count:
        raise MeasurementError(f"{where}: has a header and no rows.")
    chosen = set(np.linspace(0, count - 1, min(count, _MOST_ROWS)).astype(int).tolist())
    picked, k = [], 0
    for block in lines(data, where):
        for line in block:
            if line.number > form.last:
                if k in chosen:
                    picked.append(line)
                k += 1
    rows = [cells(line.text, form.separator, f"{where}:{line.number}") for line in picked]
    refuse_ragged(rows, len(form.titles), picked, where)
    torn = any(all(map(opens_list, words)) for words in zip(*rows, strict=True)) or all(map(are_torn, rows))
    if torn or are_alike(form.names, rows[0]):
        raise of_lists(where)
    columns = [
        _column(title, unit, words, form.separator)
        for title, unit, words in zip(form.names, form.units, zip(*rows, strict=True), strict=True)
    ]
    return RawTable(where, tuple(columns), count, form.remarks, form.named, data, form)


def _column(title: str, unit: str, words: tuple[str, ...], separator: str) -> RawColumn:
    name, symbol = split_title(title)
    filled = [word for word in words if word]
    numbers = None
    if filled and all(is_number(word, separator) for word in filled):
        values = [float(word.replace(",", ".")) if word else np.nan for word in words]
        numbers = read_only(np.where(np.isinf(values), np.nan, values))
    return RawColumn(title, name, symbol or unit or None, numbers, words)


def split_title(title: str) -> tuple[str, str | None]:
    """Return the name of a title and the symbol of the unit that it has, None where it has none that is known."""
    if title.endswith("]") and "[" in title:
        name, _, inside = title[:-1].rpartition("[")
        if name.strip() and not is_number_of_name(name, inside):
            return name.strip(), symbol_of(inside)
    return name_and_unit(title)
