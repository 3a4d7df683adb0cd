"""CSV for people with spreadsheets: words that these would compute stay words."""

import csv
import io
from collections.abc import Iterable

from calib.foundations.units import NUMBER

# With these a formula begins; "+" and "-" alone are sides of approach.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_SIDES = ("+", "-")


def begins_formula(text: str) -> bool:
    """Tell whether a spreadsheet would take a cell with this text for a formula."""
    return text.startswith(_FORMULA) and text not in _SIDES and NUMBER.fullmatch(text) is None


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as CSV; before a text that would be a formula stands an apostrophe, as spreadsheets mark texts."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows(
        [f"'{cell}" if isinstance(cell, str) and begins_formula(cell) else cell for cell in row] for row in rows
    )
    return text.getvalue()
