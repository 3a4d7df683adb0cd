"""Tables on the terminal and in plain text, at most 80 columns wide."""

import io
from collections.abc import Sequence

from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from calib.assessment.metrics import metrics
from calib.foundations.arguments import checked
from calib.identification.fit import Fit
from calib.identification.identifiability import NullDirection
from calib.presentation.report.document import Sheet
from calib.presentation.sheets import (
    count,
    error_sheet,
    noise_sentences,
    parameter_sheet,
    prior_sentences,
    rank_sentences,
)

WIDTH = 80


@checked
def table(fit: Fit) -> str:
    """Return the fit as plain text: errors before and after on its own data, its parameters and its doubts."""
    sentences = (*noise_sentences(fit), *prior_sentences(fit), *rank_sentences(fit))
    return plain(Group(*map(sheet_table, fit_sheets(fit)), *map(Text, sentences)))


def fit_sheets(fit: Fit) -> tuple[Sheet, Sheet]:
    """Return the errors of a fit before and after, on its own data, and its parameters."""
    figures = {
        "identification": {
            when: metrics((data.kind, r) for data, r in zip(fit.measurements, residuals, strict=True))
            for when, residuals in (("before", fit.nominal_residuals), ("after", fit.residuals))
        }
    }
    return error_sheet(figures), parameter_sheet(fit)


def plain(renderable: RenderableType) -> str:
    """Return a renderable as text that any file and encoding takes: no colours, no lines of another alphabet.

    At most 80 columns wide, no blanks at the ends of lines.
    """
    text = io.StringIO()
    Console(file=text, width=WIDTH, no_color=True, force_terminal=False, highlight=False, markup=False).print(
        renderable
    )
    return "".join(f"{line.rstrip()}\n" for line in text.getvalue().replace("─", "-").splitlines())


def sheet_table(sheet: Sheet) -> Table:
    """Return a sheet as a table of the terminal."""
    out = Table(
        title=sheet.title,
        caption=sheet.caption or None,
        title_justify="left",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
    )
    for k, name in enumerate(sheet.columns):
        out.add_column(name, justify="right" if name in sheet.numbers else "left", overflow="ellipsis" if k else "fold")
    for row in sheet.rows:
        out.add_row(*row.cells, style="bold" if row.strong else None, end_section=row.ends_group)
    return out


def null_space_lines(
    null_space: Sequence[NullDirection | str], most: int | None = None, *, directions: int | None = None
) -> list[RenderableType]:
    """Return the directions of the null space, under their number; nothing where there are none.

    ``directions``: how many there are, where one line stands for several.
    """
    if not null_space:
        return []
    lines = Table.grid(padding=(0, 1))
    lines.add_column()
    lines.add_column(overflow="fold")
    for direction in null_space[:most]:
        lines.add_row(" -", Text(str(direction)))
    if most is not None and len(null_space) > most:
        lines.add_row(" -", Text(f"and {len(null_space) - most} more"))
    return [Text(f"The null space has {count(directions or len(null_space), 'direction', 'directions')}:"), lines]
