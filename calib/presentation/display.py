"""How a fit shows itself: as a table where it is printed, and as HTML in a notebook."""

import html

from calib.identification.fit import Fit
from calib.presentation.report.document import Row, Sheet
from calib.presentation.sheets import noise_sentences, prior_sentences, rank_sentences
from calib.presentation.tables import fit_sheets, table


def attach(kind: type[Fit]) -> None:
    """Let fits be printed, and displayed by a notebook, as this module does it."""
    kind.__str__ = table  # type: ignore[assignment, method-assign]
    kind._repr_html_ = fit_html  # type: ignore[attr-defined]


def fit_html(fit: Fit) -> str:
    """Return a fit as HTML for a notebook: errors before and after on its own data, its parameters and its doubts."""
    sentences = (*noise_sentences(fit), *prior_sentences(fit), *rank_sentences(fit))
    parts = [*map(_sheet, fit_sheets(fit)), *(f"<p>{html.escape(sentence)}</p>" for sentence in sentences)]
    return f"<div>{''.join(parts)}</div>"


def _sheet(sheet: Sheet) -> str:
    head = "".join(_cell("th", name, right=name in sheet.numbers) for name in sheet.columns)
    body = "".join(f"<tr>{_row(sheet, row)}</tr>" for row in sheet.rows)
    note = f" <small>{html.escape(sheet.caption)}</small>" if sheet.caption else ""
    title = f"<p><b>{html.escape(sheet.title)}</b>{note}</p>"
    return f"{title}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _row(sheet: Sheet, row: Row) -> str:
    cells = zip(sheet.columns, row.cells, strict=True)
    return "".join(_cell("td", cell, right=name in sheet.numbers, strong=row.strong) for name, cell in cells)


def _cell(tag: str, text: str, *, right: bool, strong: bool = False) -> str:
    words = f"<b>{html.escape(text)}</b>" if strong else html.escape(text)
    return f'<{tag} style="text-align:{"right" if right else "left"}">{words}</{tag}>'
