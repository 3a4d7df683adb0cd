"""The first sheet of a workbook (.xlsx) that is not hidden. Needs the package openpyxl."""

import functools
import io
import re
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO
from xml.etree.ElementTree import Element, iterparse

from calib.foundations.errors import MeasurementError
from calib.foundations.files import DAMAGED
from calib.foundations.lazy import needed
from calib.foundations.words import counted, listed, shown
from calib.measurement.cells import MOST_COLUMNS, Rows
from calib.measurement.layout import header_of, is_number, refuse_two_units, units_of, with_point, with_units

# Of the archive unpacked; a workbook of a million cells has some 50 MB.
_LARGEST = 200_000_000
# For each byte of the file, beyond what is always allowed: a workbook of one word again and again has 22 bytes and 2.7
# tags. openpyxl takes a time that grows with the tags of all parts, of which a small archive may hold tens of millions.
_MOST_PER_BYTE, _LEAST = 50, 50_000_000
_MOST_TAGS_PER_BYTE, _LEAST_TAGS = 4, 500_000
# Of tags other than those of rows, numbers and formulas openpyxl makes objects, in 20 us each: formats, fonts, names.
_TAG = re.compile(rb"<(?:\w+:)?\w")
_PLAIN_TAG = re.compile(rb"<(?:\w+:)?(?:c|f|row|t|v)[\s/>]")
_LEAST_OBJECTS, _BYTES_OF_AN_OBJECT = 250_000, 4
_MOST_ROWS, _MOST_VALUES = 200_000, 5_000_000
# The last row that a workbook can have; the rows before one are walked through, be they there or not.
_LAST_ROW = 1_048_576
# The reader of XML begins a tag or a comment again for every piece of it that comes.
_LONGEST_TAG = 250_000
_BEGINS_XML = re.compile(rb"(?:\xef\xbb\xbf|\xff\xfe|\xfe\xff)?\s*<")
_APART = re.compile(rb"<!--.*?(?:-->|\Z)|<\?.*?(?:\?>|\Z)", re.DOTALL)
# Rows by their number, and cells by their column.
_PLACE = re.compile(
    rb"""<(?:\w+:)?(?:row\s(?:[^<>]*?\s)?r=["'](\d{1,20})|c\s(?:[^<>]*?\s)?r=["']([A-Z]{1,3})\d{1,20})["']"""
)
_HIDDEN = re.compile(rb"""<(?:\w+:)?row\s(?:[^<>]*?\s)?hidden=["'](?:1|true)["']""")
_MERGED = re.compile(rb"""<(?:\w+:)?mergeCell\s(?:[^<>]*?\s)?ref=["']([A-Z]{1,3})(\d{1,7}):[A-Z]{1,3}(\d{1,7})["']""")
_FILLED = re.compile(rb"<(?:\w+:)?(?:f|is|v)[\s/>]")
_FORMULA = re.compile(rb"<(?:\w+:)?f[\s/>]")
# openpyxl looks for dates in the format of every style, in a time that grows with the square of its length.
_FORMAT = re.compile(rb"""formatCode\s*=\s*["']([^"'<]*)""")
_MOST_OF_FORMATS = 2_000_000_000
# A cell is cut to the first number, but for white space beyond the second: one text may be that of all cells.
_LONGEST_CELL, _LONGEST_TEXT = 200, 1000
# Rows among which the header is looked for.
_LOOKED_AT = 200
# With the empty cells before the last one of a row. A file may leave them out; written out they have 10 bytes each.
_MOST_LOOKED_AT = 20_000_000


def from_xlsx(data: bytes, where: str) -> Rows:
    """Return titles and cells of the first sheet that is not hidden and not empty, and what is not read.

    A first row of numbers is no header; rows before a header are passed over. Formulas are as shown. Raises
    MeasurementError where the package openpyxl is not there, and for what is no workbook, is too large, or is empty.
    """
    with needed(MeasurementError, f"{where}: needs the package openpyxl", ": pip install 'urdf-calib[formats]'"):
        import openpyxl  # noqa: F401, PLC0415 - an extra
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            _refuse_bombs(archive, len(data), where)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of styles and extensions that are not needed
                sheets = [archive.read(name).replace(b"\0", b"") for name in _sheets(data, where)]  # UTF-16 as well
        for sheet in sheets:
            _refuse_order(sheet, where)
        formulas = any(map(_FORMULA.search, sheets))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            book = _opened(data)
            seen = [sheet for sheet in book.worksheets if sheet.sheet_state == "visible"] or book.worksheets[:1]
            first = next(filter(_is_filled, seen), seen[0])
            rows, merged = _rows(first, where)
            # Not by openpyxl, which works out a shared formula for every cell that has it, however long it is.
            with first._get_source() as part:
                uncomputed = _uncomputed(part) if formulas else ""
            with first._get_source() as part:
                hidden = len(_HIDDEN.findall(part.read().replace(b"\0", b"")))
            book.close()
    except MeasurementError:
        raise
    except (zipfile.BadZipFile, *DAMAGED) as e:
        raise MeasurementError(f"{where}: is no workbook that can be read.") from e
    if uncomputed:
        raise MeasurementError(
            f"{where}: cell {uncomputed} has a formula that was never computed; save the workbook in the program that "
            "computes it."
        )
    width = max(map(len, rows), default=0)
    rows = [row + [""] * (width - len(row)) for row in rows]
    if not rows:
        raise MeasurementError(f"{where}: has no rows.")
    others = [sheet.title for sheet in seen if sheet is not first]
    remarks = [f"the sheet {shown(first.title)} is read, and not {listed(others)}"] if others else []
    if hidden:  # a filter hides rows as well
        remarks.append(counted(hidden, "row is hidden, and read as well", "rows are hidden, and read as well"))
    if merged:
        remarks.append(f"{counted(merged, 'cell')} filled with what is merged with them from above")
    if all(is_number(cell, ",") for cell in rows[0] if cell):
        return [f"column {k + 1}" for k in range(width)], rows, tuple(remarks)
    if header := header_of(rows[:_LOOKED_AT], ";"):
        remarks.append(f"{counted(header, 'row')} before the header passed over")
    titles = [title or f"column {k + 1}" for k, title in enumerate(rows[header])]
    rows = rows[header + 1 :]
    if rows and (units := units_of(rows[0])):
        refuse_two_units(titles, units, where)
        titles, rows = with_units(titles, units), rows[1:]
        remarks.append("the row below the header has the units")
    return titles, rows, tuple(remarks)


def _refuse_bombs(archive: zipfile.ZipFile, size: int, where: str) -> None:
    """Raise MeasurementError where ``size`` bytes of an archive unpack to more than any program makes of tables."""
    most = min(_LARGEST, max(_LEAST, _MOST_PER_BYTE * size))
    if sum(member.file_size for member in archive.infolist()) > most:
        raise MeasurementError(f"{where}: unpacks to more than {most} bytes.")
    tags = objects = 0
    for member in archive.infolist():
        part = archive.read(member).replace(b"\0", b"")
        if b"<!DOCTYPE" in part:  # whose entities stand for tags that are not counted
            raise MeasurementError(f"{where}: {shown(member.filename)} has a document type, which no workbook needs.")
        longest = max(map(len, _FORMAT.findall(part)), default=0)
        if longest**2 * part.count(b"x") > _MOST_OF_FORMATS:
            raise MeasurementError(f"{where}: {shown(member.filename)} has formats of numbers that are too long.")
        tags += part.count(b"<")
        if tags > max(_LEAST_TAGS, _MOST_TAGS_PER_BYTE * size):
            raise MeasurementError(f"{where}: unpacks to more than {_MOST_TAGS_PER_BYTE} tags for each of its bytes.")
        if _BEGINS_XML.match(part) and max(map(len, [*part.split(b"<"), *_APART.findall(part)])) > _LONGEST_TAG:
            raise MeasurementError(
                f"{where}: {shown(member.filename)} has a tag, a comment or a text of more than {_LONGEST_TAG} bytes."
            )
        objects += len(_TAG.findall(part)) - len(_PLAIN_TAG.findall(part))
        if objects > max(_LEAST_OBJECTS, size // _BYTES_OF_AN_OBJECT):
            raise MeasurementError(
                f"{where}: has more formats, names and texts than a table needs; copy the table into a new workbook."
            )


def _sheets(data: bytes, where: str) -> list[str]:
    """Return the parts of a workbook that are its sheets, which may be anywhere in the archive.

    Raises MeasurementError where one part is several sheets: openpyxl reads it for each of them.
    """
    reader = _begun(data)
    known = set(reader.valid_files)
    found = [rel.target for _, rel in reader.parser.find_sheets() if rel.target in known]
    if not found:
        raise MeasurementError(f"{where}: has no sheet that can be read; save it as .xlsx, and not as Strict Open XML.")
    if len(set(found)) < len(found):
        raise MeasurementError(f"{where}: has several sheets that are one part of the file; save the workbook again.")
    return found


def _opened(data: bytes) -> Any:
    """Return a workbook of openpyxl with texts, formats and sheets, and nothing else.

    Its load_workbook also takes names of cells apart, by expressions that can take a time without end.
    """
    from openpyxl.styles.stylesheet import apply_stylesheet  # noqa: PLC0415 - an extra

    reader = _begun(data)
    reader.read_strings()
    apply_stylesheet(reader.archive, reader.wb)
    reader.read_worksheets()
    return reader.wb


def _begun(data: bytes) -> Any:
    """Return a reader of openpyxl that knows what is in a workbook."""
    from openpyxl.reader.excel import ExcelReader  # noqa: PLC0415 - an extra

    reader = ExcelReader(io.BytesIO(data), read_only=True, data_only=True, keep_links=False)
    reader.read_manifest()
    reader.read_workbook()
    return reader


def _is_filled(sheet: Any) -> bool:
    with sheet._get_source() as part:
        return _FILLED.search(part.read().replace(b"\0", b"")) is not None


def _refuse_order(part: bytes, where: str) -> None:
    """Raise MeasurementError where rows or cells of a sheet go back: openpyxl leaves such rows and cells out."""
    before, last = 0, b""
    for row, column in _PLACE.findall(part):
        if column:
            if (len(column), column) <= (len(last), last):
                raise MeasurementError(
                    f"{where}: a cell of column {column.decode()} stands behind one of column {last.decode()} in row "
                    f"{before}; save the workbook again."
                )
            last = column
            continue
        number, last = int(row), b""
        if not before < number <= _LAST_ROW:
            raise MeasurementError(
                f"{where}: row {number} stands behind row {before}; rows are numbered upwards, to {_LAST_ROW}. Save "
                "the workbook again."
            )
        before = number


def _rows(sheet: Any, where: str) -> tuple[list[list[str]], int]:
    """Return the rows of a sheet that are not empty, each up to its last cell that is not.

    A cell that is merged with those below stands in each of their rows; how many it fills is told.
    """
    rows: list[list[str]] = []
    width = looked_at = filled = 0
    below = _Below.of(sheet)
    sheet.reset_dimensions()  # what a file says of its size may be less than it holds, or far more
    for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        if number > _LAST_ROW:
            raise MeasurementError(f"{where}: has a row {number}; the last that a workbook can have is {_LAST_ROW}.")
        looked_at += len(row)
        if looked_at > _MOST_LOOKED_AT:
            raise MeasurementError(f"{where}: has more than {_MOST_LOOKED_AT} cells, nearly all of them empty.")
        if row.count(None) == len(row):  # of rows that are left out there may be many
            continue
        cells = [_cell(value) for value in row]
        while cells and not cells[-1]:
            cells.pop()
        if cells:
            filled += below.fill(cells, number)
            rows.append(cells)
            width = max(width, len(cells))
        if width > MOST_COLUMNS:
            raise MeasurementError(
                f"{where}: has more than {MOST_COLUMNS} columns: the last cell of row {number} is in column {width}."
            )
        if len(rows) > _MOST_ROWS:
            raise MeasurementError(f"{where}: has more than {_MOST_ROWS} rows.")
        if width * len(rows) > _MOST_VALUES:
            raise MeasurementError(f"{where}: has more than {_MOST_VALUES} cells.")
    return rows, filled


class _Below:
    """Cells that are merged with those below: ``starts``, by row, their columns and last rows; ``now``, as walked."""

    def __init__(self, starts: Mapping[int, Sequence[tuple[int, int]]]) -> None:
        self._starts = starts
        self._now: dict[int, tuple[int, str]] = {}

    @classmethod
    def of(cls, sheet: Any) -> "_Below":
        """Return those of a sheet of openpyxl, which tells none of them where it only reads."""
        starts: dict[int, list[tuple[int, int]]] = {}
        with sheet._get_source() as part:
            for column, first, last in _MERGED.findall(part.read().replace(b"\0", b"")):
                k = functools.reduce(lambda k, letter: 26 * k + letter - ord("A") + 1, column, 0) - 1
                if int(last) > int(first) and k < MOST_COLUMNS:
                    starts.setdefault(int(first), []).append((k, int(last)))
        return cls(starts)

    def fill(self, cells: list[str], number: int) -> int:
        """Fill empty cells of a row, by its number; rows come in their order. Return how many."""
        self._now = {k: (last, text) for k, (last, text) in self._now.items() if number <= last}
        filled = 0
        for k, (_, text) in self._now.items():
            cells += [""] * (k + 1 - len(cells))
            if not cells[k]:
                cells[k] = text
                filled += 1
        for k, last in self._starts.get(number, ()):
            if k < len(cells) and cells[k]:
                self._now[k] = last, cells[k]
        return filled


def _uncomputed(part: BinaryIO) -> str:
    """Return the first cell of a sheet with a formula and no value, "" where there is none.

    What was computed may be an empty text.
    """
    for _, element in iterparse(part):  # noqa: S314 - without a document type
        name = _local(element)
        if name == "c":
            inside = {_local(child): child for child in element}
            computed = "v" in inside and (inside["v"].text or element.get("t") == "str")
            if "f" in inside and not computed:
                return element.get("r", "?")
        if name == "row":
            element.clear()
    return ""


def _local(element: Element) -> str:
    return element.tag.rpartition("}")[2]


def _cell(value: object) -> str:
    if value is None:
        return ""
    text = repr(value) if isinstance(value, float) else str(value)[:_LONGEST_TEXT]
    # No comma separates the cells of a workbook: one of text has a decimal one, as where texts were pasted.
    return with_point(" ".join(text.split())[:_LONGEST_CELL], ";")
