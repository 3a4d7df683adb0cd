"""What a report says, as plain data: finished texts, tables and drawings, the same for every way of showing them.

Nothing that shows a document computes a number; every number in it is text already, rounded once.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True, slots=True)
class Row:
    """One row of a sheet. ``strong``: what the reader looks for; ``ends_group``: a gap follows.

    ``link``: a page beside this one that the first cell leads to, as a URL.
    """

    cells: tuple[str, ...]
    strong: bool = False
    ends_group: bool = False
    link: str = ""


@dataclass(frozen=True, slots=True)
class Sheet:
    """A table. ``numbers``: the columns that are set to the right. ``brief``: the terminal shows it too.

    ``sortable``: on a page, the head of a column sorts the rows by it. ``told``: whether the last column is of
    sentences, for which a terminal has no room.
    """

    title: str
    columns: tuple[str, ...]
    numbers: frozenset[str]
    rows: tuple[Row, ...]
    caption: str = ""
    brief: bool = False
    sortable: bool = False
    told: bool = False

    @classmethod
    def of(
        cls,
        title: str,
        columns: Iterable[str],
        rows: Iterable[Row | Sequence[str]],
        caption: str = "",
        *,
        brief: bool = False,
        sortable: bool = False,
        told: bool = False,
    ) -> "Sheet":
        """Return a table; the names of columns of numbers begin with ``>``, and a row may be its cells alone."""
        names = tuple(columns)
        numbers = frozenset(name[1:] for name in names if name.startswith(">"))
        whole = tuple(row if isinstance(row, Row) else Row(tuple(row)) for row in rows)
        return cls(
            title, tuple(name.removeprefix(">") for name in names), numbers, whole, caption, brief, sortable, told
        )

    def narrow(self) -> "Sheet":
        """Return the table as a terminal has room for it: without its sentences."""
        if not self.told:
            return self
        rows = tuple(replace(row, cells=row.cells[:-1]) for row in self.rows)
        return replace(self, columns=self.columns[:-1], rows=rows, told=False)


@dataclass(frozen=True, slots=True)
class Picture:
    """A drawing: one ``<svg>`` element, and in words what a reader sees in it."""

    title: str
    svg: str
    alternative: str
    wide: bool = False


@dataclass(frozen=True, slots=True)
class Prose:
    """Sentences: running text, a list with a point for each, or commands to be typed."""

    sentences: tuple[str, ...]
    kind: Literal["text", "list", "code"] = "text"
    brief: bool = False


Block = Sheet | Picture | Prose
_CERTIFIED = ("errors", "budget", "provenance")


@dataclass(frozen=True, slots=True)
class Section:
    """One part of a report. ``key``: its place in the page, a word of lower-case letters."""

    key: str
    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Tile:
    """One figure of the verdict: what it is, and its value with its unit."""

    label: str
    value: str


@dataclass(frozen=True, slots=True)
class Verdict:
    """The answer before all else. ``headline``: better by how much, and on which data; ``reasons``: why (not) trusted.

    ``warnings``: what was doubtful, but usable, in the input.
    """

    trusted: bool
    headline: str
    reasons: tuple[str, ...]
    tiles: tuple[Tile, ...]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Report:
    """A whole report.

    ``about``: names and words of what was calibrated, when and by whom; ``beside``: words and URLs of pages beside it.
    """

    title: str
    verdict: Verdict
    sections: tuple[Section, ...]
    about: tuple[tuple[str, str], ...] = ()
    beside: tuple[tuple[str, str], ...] = ()

    def certificate(self) -> Iterator[Sheet]:
        """Yield what the first page on paper says below the verdict: errors, budget, and the hashes of the inputs."""
        for section in self.sections:
            sheets = [block for block in section.blocks if isinstance(block, Sheet)]
            if section.key in _CERTIFIED and sheets:
                yield sheets[0]

    def brief(self) -> Iterator[Sheet | Prose]:
        """Yield the tables and sentences that a terminal shows."""
        for section in self.sections:
            for block in section.blocks:
                if not isinstance(block, Picture) and block.brief:
                    yield block.narrow() if isinstance(block, Sheet) else block
