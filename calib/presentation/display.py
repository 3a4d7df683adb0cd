"""How a fit shows itself: as a table where it is printed, and as HTML in a notebook."""

from html import escape

from calib.identification.fit import Fit
from calib.presentation.fit_tables import fit_sentences, fit_sheets, table
from calib.presentation.report.document import Row, Sheet

__all__ = ["html", "table"]


def html(fit: Fit) -> str:
    """Return a fit as HTML for a notebook: errors before and after on its own data, its parameters and its doubts."""
    parts = [*map(_sheet, fit_sheets(fit)), *(f"<p>{escape(sentence)}</p>" for sentence in fit_sentences(fit))]
    return f"<div>{''.join(parts)}</div>"


def _sheet(sheet: Sheet) -> str:
    head = "".join(_cell("th", name, right=name in sheet.numbers) for name in sheet.columns)
    body = "".join(f"<tr>{_row(sheet, row)}</tr>" for row in sheet.rows)
    note = f" <small>{escape(sheet.caption)}</small>" if sheet.caption else ""
    title = f"<p><b>{escape(sheet.title)}</b>{note}</p>"
    return f"{title}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _row(sheet: Sheet, row: Row) -> str:
    cells = zip(sheet.columns, row.cells, strict=True)
    return "".join(_cell("td", cell, right=name in sheet.numbers, strong=row.strong) for name, cell in cells)


def _cell(tag: str, text: str, *, right: bool, strong: bool = False) -> str:
    words = f"<b>{escape(text)}</b>" if strong else escape(text)
    return f'<{tag} style="text-align:{"right" if right else "left"}">{words}</{tag}>'
