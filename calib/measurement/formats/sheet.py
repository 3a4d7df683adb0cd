"""A sheet of cells, from whatever file holds one, and what joins two of them."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from calib.foundations.csv_text import csv_text
from calib.foundations.errors import MeasurementError
from calib.foundations.files import read_bytes
from calib.foundations.words import counted, listed, shown
from calib.measurement.cells import MOST_COLUMNS, Rows, beginning, cells, in_bytes, lines, refuse_ragged
from calib.measurement.formats import arrays, logs, matrices, pairs, records, statements, workbook
from calib.measurement.formats.reports import of_report
from calib.measurement.layout import is_number, layout, name_and_unit, with_point, with_units

# Files other than plain tables are held as cells of text: some hundred bytes each.
_LARGEST = 200_000_000
# Of what comes of cells in several columns or rows, or one for each byte where that is more.
_MOST_VALUES = 5_000_000
# Columns that may name rows: no sheet names its rows so often. Each is compared with each of another sheet, name by
# name, so that of many names there are fewer.
_MOST_NAMING, _FEWEST_NAMING, _MOST_NAMES = 100, 3, 1_000_000
# Where many files are joined, the columns of all before are looked at again for each.
_MOST_REMEMBERED = 100_000


@dataclass(frozen=True, slots=True)
class Sheet:
    """Cells of text below ``titles``; ``remarks``: how they were had; ``of_part``: of one of several parts of a log.

    ``size``: bytes of the files that they are from. ``again``: names that their file gives to several columns, of which
    the later ones are numbered here.
    Titles, whatever names they are made of, are of one line: a table has a row in a line.
    """

    titles: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    where: str
    remarks: tuple[str, ...] = ()
    of_part: bool = False
    size: int = 0
    again: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "titles", tuple(map(_of_one_line, self.titles)))

    @property
    def names(self) -> list[str]:
        """The titles without units, also such as are unknown."""
        return list(map(_bare, self.titles))

    def csv(self) -> str:
        """Return the sheet as a comma-separated table; one without names has no header."""
        named = self.titles != tuple(f"column {k + 1}" for k in range(len(self.titles)))
        return csv_text([self.titles, *self.rows] if named else self.rows)


def _bare(title: str) -> str:
    return name_and_unit(title)[0].strip().split("[")[0].strip()


def _of_one_line(name: str) -> str:
    return " ".join(name.split())


def read_sheet(path: str | Path, part: str | None = None) -> Sheet:
    """Return the sheet of a file: text, records (.jsonl, YAML, JSON), a workbook (.xlsx), arrays (.npz, .mat).

    Logs of UR's RTDE and of Motive become tables with ``time [s]``. ``part``: the rigid body of these, or a word of the
    lines that are meant where numbers stand in brackets. Raises MeasurementError when it cannot be read, or holds no
    rows.
    """
    path, where = Path(path), str(path)
    # Each gives titles, cells and remarks.
    readers: Mapping[str, Callable[[bytes, str], Rows]] = {
        ".jsonl": records.from_json_lines,
        ".ndjson": records.from_json_lines,
        ".json": records.from_json,
        ".yaml": records.from_yaml,
        ".yml": records.from_yaml,
        ".xlsx": workbook.from_xlsx,
        ".npz": arrays.from_npz,
        ".mat": arrays.from_mat,
    }
    data = read_bytes(path, MeasurementError, _LARGEST)
    reader = readers.get(path.suffix.lower())
    if reader is None:
        try:
            return _checked(_of_log(data, where, part) or _of_text(data, where, part), data)
        except MeasurementError as e:
            raise of_report(in_bytes(data, where), where, e) from e
    titles, rows, said = reader(data, where)
    if not rows or not titles:
        raise MeasurementError(f"{where}: has no rows.")
    return _checked(Sheet(tuple(titles), tuple(map(tuple, rows)), where, said), data)


def most_values(size: int) -> int:
    """Return how many values may come of files of so many bytes, in more columns or rows than they have."""
    return max(_MOST_VALUES, size)


def _checked(sheet: Sheet, data: bytes) -> Sheet:
    if len(sheet.titles) > MOST_COLUMNS:
        raise MeasurementError(f"{sheet.where}: has {len(sheet.titles)} columns; allowed are {MOST_COLUMNS}.")
    titles = _told_apart(sheet.titles)
    again = {new: _bare(title) for new, title in zip(titles, sheet.titles, strict=True) if new != title}
    said = (f"columns of one title are numbered: {listed(again)}",) if again else ()
    names = tuple(dict.fromkeys(again.values()))
    return replace(sheet, titles=titles, remarks=(*sheet.remarks, *said), size=len(data), again=names)


def _told_apart(titles: Sequence[str]) -> tuple[str, ...]:
    """Return titles of which each comes once: ``X [mm]`` becomes ``X 2 [mm]`` where it comes again."""
    taken = set(titles)
    seen: set[str] = set()
    found = []
    for title in titles:
        name, _, unit = title.partition("[")
        number, new = 1, title
        while new in seen or (number > 1 and new in taken):
            number += 1
            new = f"{name.strip()} {number}{' [' if unit else ''}{unit}"
        seen.add(new)
        found.append(new)
    return tuple(found)


def _of_log(data: bytes, where: str, part: str | None) -> Sheet | None:
    """Return the sheet of a log that is no plain table, None for others."""
    text = in_bytes(data, where).decode("utf-8", errors="replace")
    if not logs.is_motive(text):
        return None
    titles, rows, said = logs.of_motive(text, where, part)
    if not rows:
        raise MeasurementError(f"{where}: has a header and no rows.")
    return Sheet(tuple(titles), tuple(map(tuple, rows)), where, (said,), of_part=True)


def _with_names_of_log(sheet: Sheet) -> Sheet:
    """Return a sheet with our names, where its titles are those of a known log."""
    found = logs.of_rtde(sheet.titles, sheet.rows)
    if found is None:
        return sheet
    titles, rows, said = found
    return Sheet(tuple(titles), tuple(map(tuple, rows)), sheet.where, (*sheet.remarks, said))


def _of_text(data: bytes, where: str, part: str | None) -> Sheet:
    """Return the sheet of a table, or of statements with lists of numbers where a table would tear these apart."""
    data = in_bytes(data, where)
    beginning(data, where)  # what is no text says so
    if (found := matrices.from_matrices(data, where) or pairs.from_pairs(data, where)) is not None:
        return Sheet(tuple(found[0]), tuple(map(tuple, found[1])), where, found[2])
    if not statements.are_in(data):
        return _with_names_of_log(_of_table(data, where))
    refused = sheet = None
    try:
        sheet = _of_table(data, where)
    except MeasurementError as e:
        refused = e
    if sheet is not None and _is_whole(sheet):
        titles, rows, said = statements.expanded(sheet.titles, sheet.rows, where, most_values(len(data)))
        return _with_names_of_log(Sheet(tuple(titles), tuple(map(tuple, rows)), where, (*sheet.remarks, *said)))
    found = statements.from_statements(data, where, part)
    if found is not None:
        return Sheet(tuple(found[0]), tuple(map(tuple, found[1])), where, found[2], of_part=part is not None)
    if sheet is None:
        raise refused or MeasurementError(f"{where}: is no table.")
    return _with_names_of_log(sheet)


def _is_whole(sheet: Sheet) -> bool:
    """Return whether a table has not torn lists apart, nor taken the first one for its header."""
    if any(any(map(statements.opens_list, row)) or statements.are_torn(row) for row in sheet.rows):
        return False
    return not any(map(statements.list_of, sheet.titles)) and not statements.are_alike(sheet.titles, sheet.rows[0])


def _of_table(data: bytes, where: str) -> Sheet:
    form = layout(data, where)
    titles = with_units(form.names, form.units)
    rows: list[tuple[str, ...]] = []
    for block in lines(data, where):
        found = [line for line in block if line.number > form.last]
        split = [cells(line.text, form.separator, f"{where}:{line.number}") for line in found]
        refuse_ragged(split, len(titles), found, where)
        rows += [tuple(with_point(cell, form.separator) for cell in row) for row in split]
    if not rows:
        raise MeasurementError(f"{where}: has a header and no rows.")
    return Sheet(tuple(titles), tuple(rows), where, form.remarks)


def refuse_words(sheet: Sheet) -> None:
    """Raise MeasurementError where no cell is a number, as where lines of a log were taken for rows.

    A sheet of words alone may name the rows of another one that it is joined with.
    """
    if not any(is_number(cell, ";") for row in sheet.rows for cell in row):
        first = next(filter(None, sheet.rows[0]), "")
        raise MeasurementError(
            f"{sheet.where}: no cell is a number, and the first one is {shown(first)}; is it a table?"
        )


def joined(first: Sheet, second: Sheet, by: str | None = None) -> Sheet:
    """Return two sheets as one: rows of one name belong together, or, where no column names them, rows in order.

    ``by``: the title of the column that names them, or ``"order"``. Without it a column of each is taken whose words
    come once and are those of the other; more than one such way, or none and other numbers of rows, is refused.
    """
    if by == "order":
        return _in_order(first, second, "in order each row needs one beside it")
    if by is None and len(first.rows) == len(second.rows) == 1 and first.titles == second.titles:
        raise MeasurementError(
            f"{first.where}, {second.where}: have one row each of the same columns; --stack file puts such files "
            "one below the other, --by order side by side."
        )
    own, other = _naming(first, by), _naming(second, by)
    ways = [
        (a, b)
        for a, words in own.items()
        for b, others in other.items()
        if by in (None, first.titles[a], second.titles[b]) and _have_partners(words, others)
    ]
    pairs = _partners(own[ways[0][0]], other[ways[0][1]]) if ways else []
    # One by one, and no more than the first that differs: a hundred columns of each are ten thousand ways. Columns of
    # the same names are one object, and are looked at once.
    more = {(id(own[a]), id(other[b])): (own[a], other[b]) for a, b in ways[1:]}
    if any(_partners(words, others) != pairs for words, others in more.values()):
        naming = dict.fromkeys(first.titles[a] for a, _ in ways)
        raise MeasurementError(
            f"{first.where}, {second.where}: rows could be joined by {listed(naming)}; say by which, or by order: --by."
        )
    if not ways:
        if by is not None:
            raise MeasurementError(f"{first.where}, {second.where}: {_names_nothing(first, second, by)}.")
        refused = "no column tells which rows belong together"
        if _timed(first) and _timed(second):
            refused += (
                "; as both have times, a job joins them if the arm moved meanwhile: of a table of [[measurements]], "
                'the points are the file, and the joints are the readings, with clock = "free"; if it stood still at '
                "each point, keep one row of the joints for each"
            )
        return _in_order(first, second, refused)
    a, b = ways[0]
    rest = [k for k in range(len(second.titles)) if k != b]
    rows = tuple((*first.rows[i], *(second.rows[j][k] for k in rest)) for i, j in pairs)
    said = [f"{counted(len(rows), 'row')} joined by {first.titles[a]!r} and {second.titles[b]!r}"]
    said += [
        counted(
            len(sheet.rows) - len(rows),
            f"row of {sheet.where} has no partner and is left out",
            f"rows of {sheet.where} have no partner and are left out",
        )
        for sheet in (first, second)
        if len(sheet.rows) > len(rows)
    ]
    titles = _apart(first.titles, [second.titles[k] for k in rest])
    remarks = (*first.remarks, *second.remarks, *said)
    return Sheet(titles, rows, first.where, remarks, size=first.size + second.size)


def _names_nothing(first: Sheet, second: Sheet, by: str) -> str:
    """Return why the title ``by`` does not tell which rows belong together."""
    if by not in (*first.titles, *second.titles):
        return f"no column is called {shown(by)}; they are {listed([*first.titles, *second.titles], most=20)}"
    return (
        f"{shown(by)} does not tell which rows belong together: for that its cells are words or whole numbers, each "
        "once, of which all of one table are in a column of the other"
    )


def _timed(sheet: Sheet) -> bool:
    return any(name.lower() == "time" for name in sheet.names)


def _in_order(first: Sheet, second: Sheet, refused: str) -> Sheet:
    if len(first.rows) != len(second.rows):
        left = [f"; {remark}" for sheet in (first, second) for remark in sheet.remarks if "left out" in remark]
        left += [
            f"; {sheet.where} has a row for each of X, Y and Z, and none for each point"
            for sheet in (first, second)
            if _has_a_row_for_each_coordinate(sheet)
        ]
        raise MeasurementError(
            f"{first.where} has {counted(len(first.rows), 'row')} and {second.where} {len(second.rows)}, and {refused}"
            f"{''.join(left)}."
        )
    rows = tuple((*a, *b) for a, b in zip(first.rows, second.rows, strict=True))
    said = f"{counted(len(rows), 'row')} joined in their order"
    remarks = (*first.remarks, *second.remarks, said)
    return Sheet(_apart(first.titles, second.titles), rows, first.where, remarks, size=first.size + second.size)


def _has_a_row_for_each_coordinate(sheet: Sheet) -> bool:
    """Return whether the words of a column are X, Y and Z in turn."""
    turn = ("x", "y", "z")
    columns = zip(*sheet.rows, strict=True)
    return len(sheet.rows) % 3 == 0 and any(
        all(word.lower() == turn[k % 3] for k, word in enumerate(column)) for column in columns
    )


def stacked(sheets: Sequence[Sheet], title: str) -> Sheet:
    """Return sheets of the same columns one below the other; a last column ``title`` has the name of each row's file.

    For files of which each belongs to one target: what was touched, its name says, with the folder where files of
    several have the same one. Raises MeasurementError where the columns differ, two files have the same name, or
    ``title`` is one of the columns.
    """
    first = sheets[0]
    if not title.strip():
        raise MeasurementError("stack: a column without a title cannot be read again; give it one.")
    for sheet in sheets:
        if sheet.titles != first.titles:
            raise MeasurementError(
                f"{first.where}, {sheet.where}: have other columns, {listed(first.titles)} and {listed(sheet.titles)}."
            )
        if title in sheet.titles:
            raise MeasurementError(f"{sheet.where}: has a column {shown(title)} already.")
    names = _names_of_files([Path(sheet.where) for sheet in sheets])
    taken = Counter(names)
    for sheet, name in zip(sheets, names, strict=True):
        if taken[name] > 1:
            raise MeasurementError(f"{sheet.where}: another file is called {shown(name)} too; give each its own name.")
    rows = tuple((*row, name) for sheet, name in zip(sheets, names, strict=True) for row in sheet.rows)
    said = f"{counted(len(sheets), 'file')} one below the other; {title!r} is the name of each"
    remarks = [remark for sheet in sheets for remark in sheet.remarks]
    size = sum(sheet.size for sheet in sheets)
    return Sheet((*first.titles, title), rows, first.where, (*dict.fromkeys(remarks), said), size=size)


def _names_of_files(paths: Sequence[Path]) -> list[str]:
    """Return the names of files without their endings, behind as few folders as tell them apart, if any do."""
    parts = [[*path.parent.parts, path.stem] for path in paths]
    deepest = max(map(len, parts))
    tried = ([_of_one_line("/".join(one[-count:])) for one in parts] for count in range(1, deepest + 1))
    plain = next(tried)
    return next((names for names in (plain, *tried) if len(set(names)) == len(names)), plain)


def _naming(sheet: Sheet, by: str | None) -> dict[int, dict[str, int]]:
    """Return the rows of the names in columns that may name rows, by number: two or more, each once; no decimals.

    Those with the title ``by`` are the first; where another sheet has it, one column is compared with all of this.
    """
    found: dict[int, dict[str, int]] = {}
    alike: dict[tuple[str, ...], dict[str, int]] = {}
    most = _MOST_NAMING
    if by is None or by in sheet.titles:
        most = min(most, max(_FEWEST_NAMING, _MOST_NAMES // max(1, len(sheet.rows))))
    for k in sorted(range(len(sheet.titles)), key=lambda k: sheet.titles[k] != by):
        rows = {_name(row[k]): number for number, row in enumerate(sheet.rows)}
        if len(rows) > 1 and "" not in rows and len(rows) == len(sheet.rows):
            found[k] = alike.setdefault(tuple(rows), rows)
            if len(found) == most:
                break
    return found


@lru_cache(_MOST_REMEMBERED)
def _name(cell: str) -> str:
    """Return a cell as a name: 7 and 7.0 are one, 7.25 is none."""
    if is_number(cell, ","):
        value = float(cell)
        return str(int(value)) if math.isfinite(value) and value == int(value) else ""
    return cell.strip().lower()


def _have_partners(first: Mapping[str, int], second: Mapping[str, int]) -> bool:
    """Return whether all names of one are among those of the other."""
    few, many = sorted((first, second), key=len)
    return few is many or few.keys() <= many.keys()


def _partners(first: Mapping[str, int], second: Mapping[str, int]) -> list[tuple[int, int]]:
    return [(i, second[name]) for name, i in first.items() if name in second]


def _apart(first: Sequence[str], second: Sequence[str]) -> tuple[str, ...]:
    """Return the titles of both, those of the second that are there already, or have no name of their own, apart."""
    if all(title.startswith("column ") for title in (*first, *second)):
        return tuple(f"column {k + 1}" for k in range(len(first) + len(second)))
    return (*first, *(title if title not in first else f"{title} second" for title in second))
