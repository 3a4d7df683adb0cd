"""A report as Markdown, for a repository: the same words and tables, pictures by what they show."""

import re
from collections.abc import Iterator

from calib.foundations.words import harmless
from calib.presentation.report.document import Block, Prose, Report, Row, Sheet

# What Markdown or HTML in it would take for its own; an underscore inside a word is a letter.
_SPECIAL = re.compile(r"([\\`*\[\]<>|#]|(?<![0-9A-Za-z])_|_(?![0-9A-Za-z]))")


def render_markdown(report: Report) -> str:
    """Return a report as Markdown."""
    verdict = report.verdict
    parts = [f"# {_plain(report.title)}", f"**{_plain(verdict.headline)}**", *map(_plain, verdict.reasons)]
    if report.about:
        parts.append("\n".join(f"- {_plain(name)}: {_plain(said)}" for name, said in report.about))
    parts += [f"[{_plain(words)}]({url})" for words, url in report.beside]
    parts += [f"Warning: {_plain(warning)}" for warning in verdict.warnings]
    for section in report.sections:
        parts.append(f"## {_plain(section.title)}")
        for block in section.blocks:
            parts += _block(block, section.title)
    return harmless("\n\n".join(parts)) + "\n"


def _block(block: Block, above: str) -> Iterator[str]:
    if isinstance(block, Sheet):
        if block.title != above:
            yield f"**{_plain(block.title)}**"
        rulers = ["--:" if name in block.numbers else "---" for name in block.columns]
        cells = [map(_plain, block.columns), rulers, *(_cells(row) for row in block.rows)]
        yield "\n".join(f"| {' | '.join(row)} |" for row in cells)
        if block.caption:
            yield _plain(block.caption)
    elif not isinstance(block, Prose):
        yield f"*{_plain(block.title)} (drawn in report.html).* {_plain(block.alternative)}"
    elif block.kind == "code":
        # Four blanks, not a fence: no text inside can end it.
        yield "\n".join(f"    {line}" for line in block.sentences)
    elif block.kind == "list":
        yield "\n".join(f"- {_plain(sentence)}" for sentence in block.sentences)
    else:
        yield " ".join(map(_plain, block.sentences))


def _cells(row: Row) -> list[str]:
    cells = [*map(_plain, row.cells)]
    return [f"[{cells[0]}]({row.link})", *cells[1:]] if row.link else cells


def _plain(text: str) -> str:
    """Return text that shows as it stands, on one line."""
    return _SPECIAL.sub(r"\\\1", " ".join(text.split()))
