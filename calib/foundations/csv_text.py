"""CSV for people with spreadsheets: words that these would compute stay words, and none commands a terminal.

Which of commas, semicolons, tabs and bars part the cells, a spreadsheet decides, by its language or by its user: text
behind any of them may be the beginning of a cell.
"""

import csv
import re
from collections.abc import Iterable

from calib.foundations.errors import CalibError, RobotError
from calib.foundations.units import NUMBER
from calib.foundations.words import harmless, shown

_LONGEST_LINE = 2_000
NOT_UTF8 = "is not UTF-8 text; save it as UTF-8."
OPEN_QUOTE = "a quote is not closed, or something follows it."

# With these a formula begins, also in the widths of East Asian keyboards, of which some spreadsheets make plain signs.
_SIGNS = "=+\\-@\uff1d\uff0b\uff0d\uff20\ufe66\ufe62\ufe63\ufe6b"
_SEPARATORS = ",;|\t\n\r\v\f\x1c-\x1e\x85\u2028\u2029"
# Before it may stand what some spreadsheets take off: spaces, quotes, and what has no width, as the mark of a file.
_BEFORE = r"[\s\"\0\u200b\ufeff]*"
# What may begin a cell.
_BEGINNING = re.compile(rf"((?:^|[{_SEPARATORS}]){_BEFORE})(?=[{_SIGNS}])")
# The apostrophe that stands before it in our own files.
_MARK = re.compile(rf"((?:^|[{_SEPARATORS}]){_BEFORE})'(?=[{_SIGNS}])")
# "#" begins a comment in our own tables.
_TO_QUOTE = re.compile(rf"[\"#{_SEPARATORS}]")
# A row may begin with an error of a spreadsheet, as #N/A, or with a number that it had no room for, ####. Errors are in
# capitals, in the language of the spreadsheet, with ! or ? at their end; those for what is not available have none.
_ERROR = re.compile(r"\s*#(?:(##+)[ ]*[,;|\t]|([^\s#,;|]+)(?:[ ]*[,;|\t]|[ ]+[-+.]?[0-9]))")
_NOT_AVAILABLE = frozenset(("N/A", "N/D", "N/B", "NV", "I/T", "Н/Д", "Δ/Υ", "YOK", "HIÁNYZIK", "GETTING_DATA"))
# "+" and "-" alone are sides of approach.
_SIDES = ("+", "-")


def text_of(data: bytes, where: str, error: type[CalibError]) -> str:
    """Return UTF-8 text without its mark. Raises ``error``, which names ``where`` the text is, for what is none."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        raise error(f"{where}: {NOT_UTF8}") from e


def lines_of(data: bytes, where: str, what: str, error: type[CalibError]) -> list[tuple[str, list[str]]]:
    """Return the lines of a small table, but for comments and blank ones: where each is, and its cells.

    ``where``: the file; ``what`` it is, as "a DH table". Raises ``error`` for what is no text, or no CSV.
    """
    text = text_of(data, where, error)
    if (nul := text.find("\0")) >= 0:
        raise error(f"{where}: has a NUL byte after {nul} characters; {what} is UTF-8 text.")
    lines = []
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1):
        if line.strip() and (not line.lstrip().startswith("#") or begins_with_error(line)):
            at = f"{where}:{number}"
            if len(line) > _LONGEST_LINE:
                raise error(f"{at}: is longer than the {_LONGEST_LINE} characters that are allowed.")
            try:
                (cells,) = csv.reader((line,), strict=True, skipinitialspace=True)
            except csv.Error as e:
                raise error(f"{at}: {OPEN_QUOTE}") from e
            lines.append((at, [cell.strip() for cell in cells]))
    return lines


def begins_with_error(line: str) -> bool:
    """Return whether a row begins with an error of a spreadsheet."""
    found = _ERROR.match(line)
    if found is None or found[1]:
        return found is not None
    word = found[2]
    return (word.isupper() and word.endswith(("!", "?"))) or word.upper() in _NOT_AVAILABLE


def refuse_formula(joint: str, where: str) -> None:
    """Raise RobotError for a joint whose name a spreadsheet would compute: it heads columns of tables."""
    if has_formula(joint):
        raise RobotError(f"{where}: joint {shown(joint)} has the name of a spreadsheet's formula; rename it.")


def has_formula(text: str) -> bool:
    """Tell whether a spreadsheet would take a cell with this text, or a part behind a separator, for a formula."""
    return _defused(text) != text


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as CSV; before a text that would be a formula stands an apostrophe, as spreadsheets mark texts.

    What would command a terminal, or turn round the words behind it, is an escape.
    """
    return "".join(",".join(map(csv_cell, row)) + "\n" for row in rows)


def csv_cell(value: object) -> str:
    """Return one cell of :func:`csv_text`."""
    if isinstance(value, str) and (not value or NUMBER.fullmatch(value)):  # most: no formula, and nothing to quote
        return value
    text = _defused(harmless(value)) if isinstance(value, str) else str(value)
    return '"' + text.replace('"', '""') + '"' if _TO_QUOTE.search(text) or text != text.strip() else text


def without_marks(text: str) -> str:
    """Return a text as it was before :func:`csv_text` put apostrophes into it."""
    return _MARK.sub(r"\1", text) if "'" in text else text


def _defused(text: str) -> str:
    # Of the whole text alone: behind a number and a line end, a tab or a decimal comma, a formula goes on.
    words = text.strip('" ')
    if words in _SIDES or NUMBER.fullmatch(words):
        return text
    marked = _BEGINNING.sub(r"\1'", text)
    # White space that begins a cell is left out by some, and what follows is then a formula or not; nobody needs it.
    return f"'{marked}" if text.startswith(("\t", "\r")) else marked
