"""The terminal: text of at most 80 columns, colours and progress only where a person looks."""

import contextlib
import sys
from collections.abc import Callable, Iterator

from rich.console import Console, Group, RenderableType
from rich.text import Text

from calib.presentation.tables import plain


def show(*renderables: RenderableType) -> None:
    """Print to standard output, in colours on a terminal and as plain text elsewhere."""
    console = Console(highlight=False)
    if console.is_terminal:
        console.print(Group(*renderables))
    else:
        sys.stdout.write(plain(Group(*renderables)))


def warning(sentence: str) -> Text:
    """Return a warning to be shown."""
    return Text(f"Warning: {sentence}", style="yellow")


def show_error(sentence: str) -> None:
    """Print an error to standard error, on one line."""
    Console(stderr=True, highlight=False, soft_wrap=True).print(Text(f"Error: {sentence}", style="red"))


@contextlib.contextmanager
def progress(*, shown: bool) -> Iterator[Callable[[str], None]]:
    """Give a function that says what is going on now; it says it on a terminal only."""
    console = Console(stderr=True)
    if not (shown and console.is_terminal):
        yield _silent
        return
    with console.status("starting") as status:
        yield status.update


def _silent(_: str) -> None:
    pass
