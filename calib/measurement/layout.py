"""How a table is laid out: what separates its cells, which line is its header, what stands before it and below.

Exporters put lines of their own before a header, spreadsheets choose their separators, and some logs have no header.
"""

import re
import string
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from calib.foundations.errors import MeasurementError
from calib.foundations.units import NUMBER, symbol_of
from calib.foundations.words import counted, shown
from calib.measurement.cells import Line, beginning, by_blanks, cells, is_comment, is_unit_in_brackets

# In the order in which they are taken where several divide as well: a comma may also be a decimal one.
_SEPARATORS = ("\t", ";", "|", ",")
_LOOKED_AT = 200
# Cells of a line above a table that has a name and a number.
_A_SETTING = 2
_LONGEST_NAME = 1000
_NAMES = {"\t": "tabs", ";": "semicolons", "|": "bars", " ": "blanks"}
_MARKS = re.compile(r"^\s*(?:#|//|%)+\s*")
# Units that may stand behind a name without brackets; shorter ones are the ends of too many names.
_SUFFIXES = frozenset(("deg", "rad", "mrad", "mm", "m", "cm", "um", "px", "degc"))
# What lists of joints are called, of which three are no point.
_JOINTS = re.compile(r"q(?![a-z])|joint|angle|theta", re.IGNORECASE)
_APART = "_" + string.whitespace
# No two parts of one pattern take the same characters: headers may be long, and all blanks.
_BEHIND = (
    re.compile(r"(.+)\(([^()]*)\)"),
    re.compile(r"(.+)/\s*([^/\s]+)"),
    re.compile(r"(.+)([\u00b0\u00ba])"),
)
_SUFFIX = re.compile(r"(.+)[_\s]([^\W_]+)")
# A name in quotes, and a cell without.
_NAMED_BY_R = re.compile(r'\s*"(?:[^"]|"")*"[\s,;|]+[^"\s,;|]')
_WHOLE = re.compile(r"[0-9]{1,9}")
# Titles below which rows are numbered: "No.", "Point ID".
_NUMBERING = re.compile(
    r"(?i)(?:(?:n|no|nr|id|idx|index|num|number|row|point|pose|measurement|sample|frame|name|label)(?![a-z])[\s_.#]*|#)+"
)


@dataclass(frozen=True, slots=True)
class Layout:
    """``titles`` of the columns, ``units`` of a line below them ("" for none); rows stand behind line ``last``.

    ``line``: where the header stands, that of the first row where there is none; ``remarks``: what was seen; ``named``:
    there is a header.
    """

    separator: str
    titles: tuple[str, ...]
    units: tuple[str, ...]
    line: int
    last: int
    remarks: tuple[str, ...]
    named: bool = True

    @property
    def names(self) -> tuple[str, ...]:
        """The titles; a column without one is called by its place, as of the row numbers that pandas writes."""
        return tuple(title or nameless(k) for k, title in enumerate(self.titles))


def nameless(k: int) -> str:
    """Return what a column at a place from 0 is called where nothing names it."""
    return f"column {k + 1}"


def layout(data: bytes, where: str) -> Layout:
    """Return how a table is laid out, by its first lines.

    Lines before the header are passed over, and so is a line of nothing but units below it. Columns without a header
    are called ``column 1``, ``column 2``, ... Raises MeasurementError when there is nothing to read.
    """
    first = beginning(data, where)[:_LOOKED_AT]
    plain = [line for line in first if not is_comment(line.text)]
    if not plain:
        if 0 < len(first) < _LOOKED_AT:
            raise MeasurementError(f"{where}: has comments, and no rows.")
        if first:
            raise MeasurementError(
                f"{where}: begins with comments, and no header line is among the first {_LOOKED_AT} lines."
            )
        raise MeasurementError(f"{where}: is empty; a table starts with a header line.")
    separator = _separator([line.text for line in plain])
    remarks = [f"cells are separated by {_NAMES[separator]}"] if separator in _NAMES else []
    rows = [cells(line.text, separator, f"{where}:{line.number}") for line in plain]
    if _are_numbered_by_r([line.text for line in plain], rows, separator):
        said = (*remarks, "the first column has the names of the rows, which R writes without a title")
        nothing = ("",) * len(rows[1])
        return Layout(separator, ("", *rows[0]), nothing, plain[0].number, plain[0].number, said)
    if _first_of_data(rows, separator) == 0:
        return _without_header(first, plain[0], rows[0], separator, remarks)
    if header := header_of(rows, separator):
        remarks.append(f"{counted(header, 'line')} before the header passed over")
    units: tuple[str, ...] = ("",) * len(rows[header])
    last = plain[header].number
    below = header + 1
    if header and len(rows[header - 1]) == len(rows[header]) and (found := units_of(rows[header - 1])):
        units = found
        refuse_two_units(rows[header], units, f"{where}:{last}")
        remarks.append("the line above the header has the units")
    elif below < len(rows) and len(rows[below]) == len(rows[header]) and (found := units_of(rows[below])):
        units, last = found, plain[below].number
        refuse_two_units(rows[header], units, f"{where}:{last}")
        remarks.append("the line below the header has the units")
    return Layout(separator, tuple(rows[header]), units, plain[header].number, last, tuple(remarks))


def _are_numbered_by_r(lines: Sequence[str], rows: Sequence[Sequence[str]], separator: str) -> bool:
    """Return whether a table is as ``write.table`` of R has it: quoted titles, and quoted numbers of rows before more.

    These are not quoted, no two rows have one number, and no row ends with an empty cell. Elsewhere a title that is
    missing may be any: names may be of points, below a title of their own, and so may numbers, below a title that says
    so, unless whole numbers stand beside them.
    """
    if len(rows) < 2 or lines[0].count('"') != 2 * len(rows[0]) or any(is_number(cell, separator) for cell in rows[0]):
        return False
    if len({row[0] for row in rows[1:]}) < len(rows) - 1 or not all(_WHOLE.fullmatch(row[0]) for row in rows[1:]):
        return False
    if _NUMBERING.fullmatch(rows[0][0]) and not all(_WHOLE.fullmatch(row[1]) for row in rows[1:] if len(row) > 1):
        return False
    return all(
        len(row) == len(rows[0]) + 1 and row[-1] and _NAMED_BY_R.match(line) and is_number(row[1], separator)
        for line, row in zip(lines[1:], rows[1:], strict=True)
    )


def refuse_two_units(titles: Sequence[str], units: Sequence[str], at: str) -> None:
    """Raise MeasurementError where a title has one unit, and the line below it, at a place, another."""
    for title, unit in zip(titles, units, strict=True):
        own = _unit_in(title)
        if unit and own not in (None, unit):
            raise MeasurementError(
                f"{at}: column {shown(title)} has the unit {own} in its title, and {unit} below; keep one."
            )


def _unit_in(title: str) -> str | None:
    if not title.endswith("]"):
        return name_and_unit(title)[1]
    name, _, inside = title[:-1].rpartition("[")
    return None if is_number_of_name(name, inside) else symbol_of(inside)


def _without_header(
    first: Sequence[Line], row: Line, values: Sequence[str], separator: str, remarks: Sequence[str]
) -> Layout:
    """Return the layout of a table that begins with numbers: a comment may be its header, as NumPy writes it."""
    nothing = ("",) * len(values)
    for line in reversed([line for line in first if line.number < row.number]):
        titles = cells(_MARKS.sub("", line.text).replace('"', ""), separator, "")
        if len(titles) == len(values) and all(titles) and len(titles) > 1:
            said = (*remarks, "the header is a comment")
            return Layout(separator, tuple(titles), nothing, line.number, row.number - 1, said)
    titles = list(map(nameless, range(len(values))))
    said = (*remarks, "there is no header")
    return Layout(separator, tuple(titles), nothing, row.number, row.number - 1, said, named=False)


def _separator(lines: Sequence[str]) -> str:
    """Return what divides most lines into as many cells; where that is not clear, what the first line has."""
    shares = {}
    for mark in _SEPARATORS:
        count, times = Counter(line.count(mark) for line in lines).most_common(1)[0]
        shares[mark] = times / len(lines) if count else 0.0
    best = max(_SEPARATORS, key=lambda mark: shares[mark])
    if best == "\t" and shares[","] == shares["\t"] and any(part.startswith(",") for part in lines[0].split("\t")):
        best = ","  # tabs beside commas, for the looks of it
    if shares[best] > 0.5 and shares[best] > 1.0 / len(lines):
        return best
    plain = [line for line in lines if not any(mark in line for mark in _SEPARATORS)]
    if len(plain) > 0.8 * len(lines):  # a sentence above a table may have a comma
        # The last row of a log may have been cut off.
        every = list(map(by_blanks, plain))
        whole = every[:-1] if len(every) > 2 else every
        count, times = Counter(map(len, whole)).most_common(1)[0]
        bracket = any(word[0] == "[" and not is_unit_in_brackets(word) for words in every for word in words)
        if count > 1 and times > 0.8 * len(whole) and not bracket and any(_is_data(words, " ") for words in every):
            return " "
    if "\t" in lines[0] and "," not in lines[0] and ";" not in lines[0]:
        return "\t"
    return ";" if ";" in lines[0] and "," not in lines[0] else ","


def header_of(rows: Sequence[Sequence[str]], separator: str) -> int:
    """Return which of the first rows of a table is its header.

    It is the first one that has as many cells as the first row of numbers, most of them filled: a spreadsheet fills up
    every line to the width of the table, those above the header as well. Where none has as many, it is the last
    one without numbers above it.
    """
    data_row = _first_of_data(rows, separator) or 0
    like_data = [i for i in range(data_row) if len(rows[i]) == len(rows[data_row])]
    like_data = [i for i in like_data if i == like_data[-1] or not units_of(rows[i])]  # units may be above
    if not like_data:
        return next((i for i in range(data_row - 1, 0, -1) if not _is_data(rows[i], separator)), 0)
    return next((i for i in like_data if _is_filled(rows[i])), like_data[0])


def with_point(cell: str, separator: str) -> str:
    """Return a number with a point where it has a decimal comma, and other cells as they are."""
    return cell.replace(",", ".") if separator != "," and "," in cell and is_number(cell, separator) else cell


def is_number(cell: str, separator: str) -> bool:
    """Return whether a cell is a number, with a decimal comma where that separates no cells."""
    return NUMBER.fullmatch(cell if separator == "," else cell.replace(",", ".", 1)) is not None


def _is_data(row: Sequence[str], separator: str) -> bool:
    filled = [cell for cell in row if cell]
    return bool(filled) and 2 * sum(is_number(cell, separator) for cell in filled) >= len(filled)


def _first_of_data(rows: Sequence[Sequence[str]], separator: str) -> int | None:
    """Return which row is the first of numbers, as wide as most of these are, and filled if others behind a header are.

    What exporters write above the header may be numbers too: "Number" and 7, or the 100 frames of a second. Without a
    header, a first row that is nearly empty is one of the others.
    """
    found = [i for i, row in enumerate(rows) if _is_data(row, separator)]
    if not found:
        return None
    if len(rows[found[-1]]) > _A_SETTING:  # frames may be fewer than the numbers that are set above them
        found = [i for i in found if len(rows[i]) != _A_SETTING or is_number(rows[i][0], separator)]
    (width, times), *_ = Counter(len(rows[i]) for i in found).most_common(1)
    if 2 * times > len(found):
        found = [i for i in found if len(rows[i]) == width]
    filled = next((i for i in found if _is_filled(rows[i])), found[0])
    has_header = any(len(row) == len(rows[filled]) and not _is_data(row, separator) for row in rows[:filled])
    return filled if has_header else found[0]


def _is_filled(row: Sequence[str]) -> bool:
    return 2 * sum(map(bool, row)) > len(row)


def units_of(row: Sequence[str]) -> tuple[str, ...]:
    """Return the symbols of a row of nothing but units, "" for empty cells; nothing for another row."""
    filled = [cell for cell in row if cell]
    symbols = tuple(symbol_of(cell.strip("[]()")) or "" for cell in row)
    is_of_units = filled and sum(map(bool, symbols)) == len(filled) and not any(map(NUMBER.fullmatch, filled))
    return symbols if is_of_units else ()


def with_units(titles: Sequence[str], units: Sequence[str]) -> list[str]:
    """Return titles with the units that a row below them has."""
    pairs = zip(titles, units, strict=True)
    return [
        f"{title} [{unit}]" if unit and not (_has_unit_of_its_own(title) or _unit_in(title)) else title
        for title, unit in pairs
    ]


def _has_unit_of_its_own(title: str) -> bool:
    """Return whether a title has something in brackets that is not its number: it may be a unit that we do not know."""
    name, _, inside = title.removesuffix("]").rpartition("[")
    return "[" in title and not (title.endswith("]") and is_number_of_name(name, inside))


def is_number_of_name(name: str, inside: str) -> bool:
    """Return whether what stands behind a name, in brackets or after a stroke, is its number, and no unit.

    >>> is_number_of_name("position", "1"), is_number_of_name("qw ", "1"), is_number_of_name("x", "mm")
    (True, False, False)
    """
    return inside.strip().isdigit() and name.rstrip() == name


def refuse_long_name(name: str, where: str) -> None:
    """Raise MeasurementError for a name of which no title is made: every number of a list has it in its own title."""
    if len(name) > _LONGEST_NAME:
        raise MeasurementError(
            f"{where}: the name {shown(name)} has {len(name)} characters; allowed are {_LONGEST_NAME}."
        )


def of_list(name: str, count: int) -> list[str]:
    """Return titles for a list of numbers: those of a point end with x, y, z; others, and three joints, are numbered.

    >>> of_list("q", 2), of_list("p", 3)
    (['q_0', 'q_1'], ['p_x', 'p_y', 'p_z'])
    """
    ends = "xyz" if count == 3 and not _JOINTS.match(name) else map(str, range(count))
    return [f"{name}_{end}" for end in ends]


def name_and_unit(title: str) -> tuple[str, str | None]:
    """Return the name of a title without brackets, and the symbol of the unit that stands behind it, None for none.

    >>> name_and_unit("J1 (deg)"), name_and_unit("x/mm"), name_and_unit("A1_deg"), name_and_unit("joint_1")
    (('J1', 'deg'), ('x', 'mm'), ('A1', 'deg'), ('joint_1', None))
    """
    for pattern in _BEHIND:
        match = pattern.fullmatch(title)
        if match is None or is_number_of_name(match[1], match[2]):
            continue
        if (symbol := symbol_of(match[2].strip())) is not None and (name := match[1].rstrip()):
            return name, symbol
    match = _SUFFIX.fullmatch(title)
    if match is not None and match[2].lower() in _SUFFIXES and (name := match[1].rstrip(_APART)):
        return name, symbol_of(match[2])
    return title, None
