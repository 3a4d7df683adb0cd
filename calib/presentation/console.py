"""The terminal: text of at most 80 columns, colours and progress only where a person looks."""

import contextlib
import sys
from collections.abc import Callable, Iterator

from rich.console import Console, Group, RenderableType
from rich.text import Text

from calib.presentation.report.document import Prose, Report
from calib.presentation.tables import WIDTH, plain, sheet_table


def show(*renderables: RenderableType) -> None:
    """Print to standard output, in colours on a terminal and as plain text elsewhere."""
    console = Console(highlight=False, markup=False)
    if console.is_terminal:
        console.print(Group(*renderables), width=min(WIDTH, console.width))
    else:
        write(plain(Group(*renderables)))


def write(text: str) -> None:
    """Write text to standard output as it is; what its encoding lacks is written as an escape."""
    encoding = sys.stdout.encoding or "utf-8"
    sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding))


def brief(report: Report) -> list[RenderableType]:
    """Return what of a report belongs on a terminal: its short tables and sentences, and the verdict at the end."""
    shown: list[RenderableType] = [warning(text) for text in report.verdict.warnings]
    for block in report.brief():
        if not isinstance(block, Prose):
            shown.append(sheet_table(block))
        elif block.kind == "code":
            shown.append(literal("\n".join(block.sentences)))
        else:
            shown += map(sentence, block.sentences)
    verdict = report.verdict
    good, bad = ("bold green", "green"), ("bold", "bold red")
    headline, reason = good if verdict.trusted else bad
    shown.append(Text(_printable(verdict.headline), style=headline))
    return [*shown, *(Text(_printable(text), style=reason) for text in verdict.reasons)]


def sentence(text: str) -> Text:
    """Return a sentence to be shown; names in it can neither break the line nor command the terminal."""
    return Text(_printable(text))


def literal(text: str) -> Text:
    """Return text of several lines to be shown as it stands."""
    return Text("\n".join(map(_printable, text.splitlines())), no_wrap=True)


def warning(text: str) -> Text:
    """Return a warning to be shown."""
    return Text(_printable(f"Warning: {text}"), style="yellow")


def show_error(text: str) -> None:
    """Print an error to standard error, on one line."""
    console = Console(stderr=True, highlight=False, markup=False)
    console.print(Text(_printable(f"Error: {text}"), style="red"), soft_wrap=True)


@contextlib.contextmanager
def progress(*, shown: bool) -> Iterator[Callable[[str], None]]:
    """Give a function that says what is going on now; it says it on a terminal only."""
    console = Console(stderr=True)
    if not (shown and console.is_terminal):
        yield _silent
        return
    with console.status("starting") as status:
        yield status.update


def _printable(text: str) -> str:
    """Return text with an escape in the place of every character that does not print: line ends, controls, halves."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _silent(_: str) -> None:
    pass
