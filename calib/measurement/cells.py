"""From the bytes of a table to its cells, block by block: what is in memory at a time does not grow with the file."""

import csv
import re
import shlex
import string
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from calib.foundations.csv_text import NOT_UTF8, OPEN_QUOTE, begins_with_error
from calib.foundations.errors import MeasurementError
from calib.foundations.units import symbol_of

LONGEST_LINE = 100_000
MOST_COLUMNS = 1000
_BLOCK = 1_000_000  # bytes; more than a line takes that is not too long
_ARCHIVE = b"PK\x03\x04"
# A member that every workbook has; the names of members are not packed.
_PARTS_OF_WORKBOOK = b"[Content_Types].xml"
# The sign of typesetters, which programs write before a number in Swedish, Norwegian, Finnish and other settings.
_MINUS = re.compile("\u2212(?=[0-9.,])")
# Names of files of which calib import makes a table.
_URP = ".urp"
_ARRAYS, _WORKBOOK, _RECORDS = ".npz", ".xlsx", (".json", ".jsonl", ".ndjson", ".yaml", ".yml")
# What .xls begins with, and the name of the first member of an .ods, at its place.
_OLE, _OPEN_DOCUMENT = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", (30, b"mimetype")
_MATLAB = "is of MATLAB, and no text; calib import makes a table of it, where its name ends with .mat."
_GZIP = b"\x1f\x8b"
# In a list of scalars, since NumPy 2.
_WITH_KIND = re.compile(rb"\bnp\.(?:float|int|uint)[0-9]+\(([-+.0-9a-z]*)\)")
# What other programs pack or write, by its first bytes, and what to do.
_OTHERS = {
    b"MATLAB 5.0 MAT-file": _MATLAB,
    b"MATLAB 7.3 MAT-file": _MATLAB,
    b"\x89HDF": "is HDF5, and no text; numpy.savez writes an .npz, of which calib import makes a table.",
    b"PAR1\x15": "is Parquet, and no text; write it as CSV, as DataFrame.to_csv() of pandas does.",
    **dict.fromkeys(
        (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05"),
        "is a pickle of Python, which may run code and is not read; numpy.savez writes an .npz, of which calib import "
        "makes a table.",
    ),
    _GZIP: "is packed by gzip, and no text; unpack it: gzip -d.",
    b"\x02\x50": "is C3D of motion capture, and no text; export its points there as text.",
    b"TDSm": "is TDMS of LabVIEW, and no text; save it as .xlsx or as CSV.",
    b"ARROW1": "is Arrow, and no text; write it as CSV, as DataFrame.to_csv() of pandas does.",
    b"SQLite format 3\0": "is a data base, and no text; of a recording of ROS, calib import lists the topics.",
    b"%PDF-": "is PDF, and no text; export the numbers as .xlsx or as CSV where it was made.",
    b"\x93NUMPY": "is an array of NumPy, and no text; numpy.savez writes an .npz, of which calib import makes a table.",
}
_XML = (b"<?xml", b"<!--", b"<robot")
_HTML = (b"<html", b"<!doctype html", b"<table")
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
# What exporters write before a line that is no row; behind a percent sign a name may stand, as rostopic has it: %time.
_COMMENT = re.compile(r"\s*(?:#|//|%(?:$|[\s%=-]))")
_LINE_END = re.compile(rb"\r\n?|\n")
# What separates cells beside decimal commas.
_PARTED = re.compile("[;|\t]")
# Of these a spreadsheet makes the line of a row without anything in it.
_BLANK = string.whitespace + ",;|"


# Titles, cells and remarks: what files of all formats become.
Rows = tuple[Sequence[str], Sequence[Sequence[str]], tuple[str, ...]]


class Line(NamedTuple):
    """A line that is neither blank, as one of separators alone is, nor a comment, and its number from 1.

    ``ended``: by a line end, not the file's.
    """

    number: int
    text: str
    ended: bool


def lines(data: bytes, where: str) -> Iterator[list[Line]]:
    """Yield the lines of a text that are neither blank nor comments, in blocks of one or more.

    ``data`` is what :func:`in_bytes` returned. Raises MeasurementError where the text is none, or a line is longer than
    100 000 characters.
    """
    for every in _blocks(data, where):
        if found := [line for line in every if not is_comment(line.text)]:
            yield found


def is_comment(line: str) -> bool:
    """Return whether a line is a comment: it begins with ``#`` or, as exporters have it, with ``//`` or ``%``."""
    return _COMMENT.match(line) is not None and not begins_with_error(line)


def in_bytes(data: bytes, where: str) -> bytes:
    """Return a text in bytes of which a line end is one: UTF-16 with its mark as UTF-8, all else as it is.

    Numbers that NumPy prints with their kind, as ``np.float64(0.5)``, are numbers. Raises MeasurementError for UTF-16
    that is not whole.
    """
    if data.startswith(_UTF16_MARKS):
        try:
            data = data.decode("utf-16").encode()
        except UnicodeError as e:
            raise MeasurementError(f"{where}: is not whole UTF-16 text; save it as UTF-8.") from e
    return _WITH_KIND.sub(rb"\1", data) if b"np." in data else data


def whole_text(data: bytes, where: str) -> str:
    """Return what :func:`in_bytes` returned as text, without its mark, its line ends as one each.

    Raises MeasurementError where it is none.
    """
    text = _decoded(data, data, 0, where).removeprefix("\ufeff")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def beginning(data: bytes, where: str) -> list[Line]:
    """Return the first lines, comments among them, that are not blank: those of the first block that has any."""
    return next(_blocks(data, where), [])


def _blocks(data: bytes, where: str) -> Iterator[list[Line]]:
    at, member = _OPEN_DOCUMENT
    if where.lower().endswith(_RECORDS):
        raise MeasurementError(f"{where}: is of records, and no table; {to_import(where)} -o table.csv makes one.")
    if data.startswith(_OLE) or (data.startswith(_ARCHIVE) and data.startswith(member, at)):
        raise MeasurementError(f"{where}: is a document of another program, and no text; save it as .xlsx or as CSV.")
    if data.startswith(_ARCHIVE):
        raise MeasurementError(f"{where}: {_of_archive(data, where)}")
    if data.startswith(_GZIP) and where.lower().endswith(_URP):
        raise MeasurementError(
            f"{where}: is a program of Universal Robots, packed; the controller saves it as {where[: -len(_URP)]}"
            ".script as well, of which calib import makes a table."
        )
    for begin, said in _OTHERS.items():
        if data.startswith(begin):
            raise MeasurementError(f"{where}: {said}")
    begins = data[:1000].removeprefix(b"\xef\xbb\xbf").lstrip()
    if begins.lower().startswith(_HTML):
        raise MeasurementError(
            f"{where}: is HTML, and no text; open it in a spreadsheet, and save it as .xlsx or as CSV."
        )
    if begins.startswith(_XML):
        raise MeasurementError(f"{where}: is XML, and no table; write the numbers that it holds into one.")
    if (nul := data.find(b"\0")) >= 0:
        raise MeasurementError(f"{where}:{_line_at(data, nul)}: has a NUL byte; a table is UTF-8 text.")
    start, number = len(b"\xef\xbb\xbf") if data.startswith(b"\xef\xbb\xbf") else 0, 1
    while start < len(data):
        end = _end_of_block(data, start)
        text = _decoded(data[start:end], data, start, where)
        # splitlines() would also split at form feeds and the like, and number the lines as no editor does.
        every = _MINUS.sub("-", text).replace("\r\n", "\n").replace("\r", "\n").split("\n")
        found = [
            Line(number + k, line, k < len(every) - 1) for k, line in enumerate(every) if line.strip().strip(_BLANK)
        ]
        for k, line, _ in found:
            if len(line) > LONGEST_LINE:
                raise MeasurementError(f"{where}:{k}: is longer than the {LONGEST_LINE} characters that are allowed.")
        if found:
            yield found
        start, number = end, number + len(every) - 1


def to_import(where: str) -> str:
    """Return the command that makes a table of a file, so that it can be typed as it stands."""
    return f"calib import {shlex.quote(where)}"


def _of_archive(data: bytes, where: str) -> str:
    """Return what an archive is, and what to do: one of arrays, a workbook, or some other."""
    named = where.lower().endswith((_ARRAYS, _WORKBOOK))
    if not named and _PARTS_OF_WORKBOOK not in data:
        return "is an archive, and no text; unpack it."
    to_do = (
        f"{to_import(where)} -o table.csv makes a table."
        if named
        else "call it .xlsx, and calib import makes a table of it."
    )
    kind = "an archive of arrays" if where.lower().endswith(_ARRAYS) else "a workbook"
    return f"is {kind}, and no text; {to_do}"


def _decoded(block: bytes, data: bytes, start: int, where: str) -> str:
    """Return UTF-8 text; or, where a block is none, what a spreadsheet of western Europe writes (cp1252)."""
    try:
        return block.decode()
    except UnicodeDecodeError as e:
        try:
            return block.decode("cp1252")
        except UnicodeDecodeError:
            at = _line_at(data, start + e.start)
            raise MeasurementError(f"{where}:{at}: {NOT_UTF8}") from e


def _end_of_block(data: bytes, start: int) -> int:
    """Return where the last line ends that begins a block of bytes; a longer line is a block by itself."""
    limit = start + _BLOCK
    if limit >= len(data):
        return len(data)
    if (end := max(data.rfind(b"\n", start, limit), data.rfind(b"\r", start, limit)) + 1) <= start:
        match = _LINE_END.search(data, limit)
        return len(data) if match is None else match.end()
    return end + 1 if data[end - 1 : end + 1] == b"\r\n" else end


def _line_at(data: bytes, offset: int) -> int:
    # Only the ends are counted: text before the offset may be as long as the file.
    return data.count(b"\n", 0, offset) + data.count(b"\r", 0, offset) - data.count(b"\r\n", 0, offset) + 1


def cells(line: str, separator: str, at: str) -> list[str]:
    """Return the cells of one line. A row never goes over several, so that an open quote is found where it stands.

    Where a blank is the separator, several of them, and tabs, are one; a unit in brackets is part of its title. Raises
    MeasurementError for an open quote.
    """
    if '"' not in line:
        return by_blanks(line) if separator == " " else [cell.strip() for cell in line.split(separator)]
    try:
        (found,) = csv.reader((line,), delimiter=separator, strict=True, skipinitialspace=True)
    except csv.Error as e:
        raise MeasurementError(f"{at}: {OPEN_QUOTE}") from e
    return [cell.strip() for cell in found]


def by_blanks(line: str) -> list[str]:
    """Return what blanks divide; a unit in brackets stays with what stands before it, unless that is a unit as well.

    >>> by_blanks("n  J1 [deg] x (mm) [1]"), by_blanks("(deg) (mm)")
    (['n', 'J1 [deg]', 'x (mm)', '[1]'], ['(deg)', '(mm)'])
    """
    if "[" not in line and "(" not in line:
        return line.split()
    found: list[str] = []
    behind_unit = True
    for word in line.split():
        is_unit = is_unit_in_brackets(word)
        if is_unit and not behind_unit:
            found[-1] += f" {word}"
        else:
            found.append(word)
        behind_unit = is_unit
    return found


def is_unit_in_brackets(word: str) -> bool:
    """Return whether a word is a unit in brackets, as ``[mm]``; numbers are none."""
    return word[0] in "[(" and word[-1] in "])" and symbol_of(word[1:-1]) not in (None, "1")


def refuse_ragged(rows: Sequence[Sequence[str]], width: int, block: Sequence[Line], where: str) -> None:
    """Raise MeasurementError for a row that has not ``width`` cells."""
    for (number, text, ended), found in zip(block, rows, strict=True):
        if len(found) == width:
            continue
        by_commas = text.count(",") >= len(found) - 1 and not _PARTED.search(text)
        one_more = len(rows) > 1 and all(len(row) == width + 1 and row[-1] for row in rows)
        if len(found) < width and not ended:
            hint = ", and the file ends within this row: it seems truncated"
        elif len(found) > width and found[-1] and by_commas and not (one_more and "." in text):
            hint = "; if these are decimal commas, write points, or separate the cells by semicolons"
        elif one_more:
            hint = "; a title is missing, which R gives the names of rows by write.table(..., col.names = NA)"
        else:
            hint = ""
        raise MeasurementError(f"{where}:{number}: the header has {width} cells and this row has {len(found)}{hint}.")
