"""Texts whose every line names its own numbers, as loggers print them: there is no header to be taken for one.

    J1=3.2; J2=-10.5; J3=20.25; X=512.3 mm
    J1: 4.2 J2: -11.5 J3: 21.25 X: 522.3

A decimal comma is one, as no number stands there without its name.
"""

import re
from collections.abc import Sequence
from itertools import islice

from calib.foundations.errors import MeasurementError
from calib.foundations.units import symbol_of
from calib.foundations.words import shown
from calib.measurement.cells import Rows, beginning, is_comment, lines

# Fewer are a setting of some program, and no row.
_FEWEST = 3
_PAIR = re.compile(
    r"[\s,;|]*([^\W\d][\w.]*)\s*[=:]\s*([+-]?(?:[0-9]+(?:\.[0-9]*|,[0-9]+)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|(?i:nan)\b)"
    r"(?:\s*([^\W\d_][\w/\u00b0]{0,15}|\u00b0)(?!\w*\s*[=:]))?(?=[\s,;|]|$)"
)
_REST = re.compile(r"[\s,;|]*")


def are_in(data: bytes, where: str) -> bool:
    """Return whether the first lines of a text that are no comments, two if there are, name the same numbers."""
    rows = (line.text for line in beginning(data, where) if not is_comment(line.text))
    first = [_pairs(row) for row in islice(rows, 2)]
    names = [None if pairs is None else [title for title, _ in pairs] for pairs in first]
    return bool(first) and None not in names and names[0] == names[-1]


def from_pairs(data: bytes, where: str) -> Rows | None:
    """Return titles, cells and remarks of lines that name their numbers; None for a text of something else.

    Raises MeasurementError for a line that has other names, or units, than the first one.
    """
    if not are_in(data, where):
        return None
    titles: list[str] = []
    rows = []
    for block in lines(data, where):
        for line in block:
            pairs = _pairs(line.text)
            own = [] if pairs is None else [title for title, _ in pairs]
            titles = titles or own
            if pairs is None or own != titles:
                like = shown(", ".join(titles))
                raise MeasurementError(f"{where}:{line.number}: has not the names of the first line, {like}.")
            rows.append([number for _, number in pairs])
    return titles, rows, ("every line names its numbers",)


def _pairs(line: str) -> Sequence[tuple[str, str]] | None:
    """Return title and number of every pair in a line; None where it holds something else, or too few."""
    found, end = [], 0
    while match := _PAIR.match(line, end):
        name, number, unit = match.groups()
        symbol = None if unit is None else symbol_of(unit)
        if unit is not None and symbol is None:
            return None
        cell = "" if number.lower() == "nan" else number.replace(",", ".")
        found.append((name if symbol is None else f"{name} [{symbol}]", cell))
        end = match.end()
    return found if len(found) >= _FEWEST and _REST.fullmatch(line, end) else None
