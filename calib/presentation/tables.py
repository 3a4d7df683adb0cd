"""Tables on the terminal and in plain text, at most 80 columns wide."""

import io
import re
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from rich import box
from rich.cells import cell_len
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from calib.foundations.words import counted, printable
from calib.presentation.report.document import Row, Sheet

if TYPE_CHECKING:
    from calib.identification.identifiability import NullDirection

WIDTH = 80
# A first column narrower than this is no help: such a table is then wider than the terminal.
_LEAST = 8


def plain(renderable: RenderableType) -> str:
    """Return a renderable as text that any file and encoding takes: no colours, no lines of another alphabet.

    At most 80 columns wide, no blanks at the ends of lines.
    """
    text = io.StringIO()
    console = Console(
        file=text, width=WIDTH, no_color=True, force_terminal=False, highlight=False, markup=False, emoji=False
    )
    console.print(renderable)
    return "".join(f"{line.rstrip()}\n" for line in text.getvalue().replace("─", "-").splitlines())


def sheet_table(sheet: Sheet) -> Table:
    """Return a sheet as a table of the terminal."""
    out = Table(
        title=printable(sheet.title),
        caption=printable(sheet.caption) or None,
        title_justify="left",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
    )
    return filled(out, sheet.columns, sheet.numbers, sheet.rows)


def filled(out: Table, columns: Sequence[str], numbers: Collection[str], rows: Sequence[Row]) -> Table:
    """Return a table with these columns and rows, in which no number is cut and no name is broken within a word.

    Where there is no room, first the gaps get narrower, then the first cells go on in another line after a dot, an
    underscore, a slash or a blank.
    """
    cells = [tuple(map(printable, row.cells)) for row in rows]
    columns = tuple(map(printable, columns))
    heads = [max(map(len, name.split()), default=0) for name in columns]
    needed = [max([head, *(cell_len(row[k]) for row in cells)]) for k, head in enumerate(heads)]
    n = len(columns)
    room = WIDTH - (3 * n + 1) - sum(needed[1:])
    if room < needed[0]:
        out.padding = (0, 1, 0, 0)
        room = WIDTH - (2 * n + 1) - sum(needed[1:])
    room = max(room, heads[0], _LEAST)
    first = [broken(row[0], room) for row in cells]
    width = max(map(cell_len, [columns[0], *(line for text in first for line in text.split("\n"))]))
    tight = width + sum(map(max, needed[1:], map(len, columns[1:]))) > WIDTH - (3 * n + 1)
    for k, name in enumerate(columns):
        out.add_column(
            name,
            justify="right" if name in numbers else "left",
            overflow="ellipsis" if k else "fold",
            width=(needed[k] if k else min(width, room)) if tight else None,
        )
    for text, own, row in zip(first, cells, rows, strict=True):
        out.add_row(text, *own[1:], style="bold" if row.strong else None, end_section=row.ends_group)
    return out


def broken(name: str, room: int) -> str:
    """Return a name in lines of at most ``room`` letters, broken after dots, underscores, slashes and blanks only.

    A part that is longer than that stays whole.
    """
    lines = [""]
    for part in re.findall(r"[^._/ ]+[._/ ]?|[._/ ]", name):
        if lines[-1] and len(lines[-1]) + len(part.rstrip()) > room:
            lines.append("")
        lines[-1] += part
    return "\n".join(line.rstrip() for line in lines)


def null_space_lines(
    null_space: "Sequence[NullDirection | str]", *, directions: int | None = None
) -> list[RenderableType]:
    """Return the directions of the null space, under their number; nothing where there are none.

    ``directions``: how many there are, where one line stands for several.
    """
    if not null_space:
        return []
    lines = Table.grid(padding=(0, 1))
    lines.add_column()
    lines.add_column(overflow="fold")
    for direction in null_space:
        lines.add_row(" -", Text(printable(str(direction))))
    return [
        Text(f"The null space has {counted(directions or len(null_space), 'direction')}:"),
        lines,
    ]
