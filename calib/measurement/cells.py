"""From the bytes of a table to its cells, block by block: what is in memory at a time does not grow with the file."""

import csv
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from calib.foundations.errors import MeasurementError

LONGEST_LINE = 100_000
_BLOCK = 1_000_000  # bytes; more than a line takes that is not too long
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_LINE_END = re.compile(rb"\r\n?|\n")


class Line(NamedTuple):
    """A line that is neither blank nor a comment, and its number from 1; ``ended``: by a line end, not the file's."""

    number: int
    text: str
    ended: bool


def lines(data: bytes, where: str) -> Iterator[list[Line]]:
    """Yield the lines of UTF-8 text that are neither blank nor comments, in blocks of one or more.

    Raises MeasurementError where the text is none, or a line is longer than 100 000 characters.
    """
    if data.startswith(_UTF16_MARKS):
        raise MeasurementError(f"{where}: is UTF-16 text; save it as UTF-8.")
    if (nul := data.find(b"\0")) >= 0:
        raise MeasurementError(f"{where}:{_line_at(data, nul)}: has a NUL byte; a table is UTF-8 text.")
    start, number = len(b"\xef\xbb\xbf") if data.startswith(b"\xef\xbb\xbf") else 0, 1
    while start < len(data):
        end = _end_of_block(data, start)
        try:
            text = data[start:end].decode()
        except UnicodeDecodeError as e:
            at = _line_at(data, start + e.start)
            raise MeasurementError(f"{where}:{at}: is not UTF-8 text; save it as UTF-8.") from e
        # splitlines() would also split at form feeds and the like, and number the lines as no editor does.
        every = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        found = [
            Line(number + k, line, k < len(every) - 1)
            for k, line in enumerate(every)
            if line.strip() and not line.lstrip().startswith("#")
        ]
        for k, line, _ in found:
            if len(line) > LONGEST_LINE:
                raise MeasurementError(f"{where}:{k}: is longer than the {LONGEST_LINE} characters that are allowed.")
        if found:
            yield found
        start, number = end, number + len(every) - 1


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


def separator_of(titles: str, at: str) -> str:
    """Return what separates the cells below a header line: commas, or semicolons where a header has no comma."""
    if "\t" in titles and "," not in titles and ";" not in titles:
        raise MeasurementError(f"{at}: the cells are separated by tabs; separate them by commas.")
    return ";" if ";" in titles and "," not in titles else ","


def cells(line: str, separator: str, at: str) -> list[str]:
    """Return the cells of one line. A row never goes over several, so that an open quote is found where it stands."""
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    try:
        (found,) = csv.reader((line,), delimiter=separator, strict=True, skipinitialspace=True)
    except csv.Error as e:
        raise MeasurementError(f"{at}: a quote is not closed, or something follows it.") from e
    return [cell.strip() for cell in found]


def refuse_ragged(rows: Sequence[Sequence[str]], width: int, block: Sequence[Line], where: str) -> None:
    """Raise MeasurementError for a row that has not ``width`` cells."""
    for (number, _, ended), found in zip(block, rows, strict=True):
        if len(found) == width:
            continue
        if len(found) < width and not ended:
            hint = ", and the file ends within this row: it seems truncated"
        elif len(found) > width and found[-1]:
            hint = "; if these are decimal commas, write points, or separate the cells by semicolons"
        else:
            hint = ""
        raise MeasurementError(f"{where}:{number}: the header has {width} cells and this row has {len(found)}{hint}.")
