"""The terminal: text of at most 80 columns, colours and progress only where a person looks."""

import contextlib
import errno
import os
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO, cast

from rich.console import Console, Group, RenderableType
from rich.text import Text

from calib.foundations.errors import OutputError
from calib.foundations.units import MINUTE
from calib.foundations.words import apart, printable
from calib.presentation.report.document import Prose, Report, Sheet
from calib.presentation.tables import WIDTH, plain, sheet_table

# What a command may show: sentences, tables, and text in a style of its own.
Shown = str | Sheet | RenderableType


def show(*shown: Shown) -> None:
    """Print to standard output, in colours on a terminal and as plain text elsewhere."""
    console = _console()
    if console.is_terminal:
        console.print(Group(*map(drawn, shown)), width=min(WIDTH, console.width))
    else:
        write(plain(Group(*map(drawn, shown))))


@contextlib.contextmanager
def _as_if_read(stream: TextIO) -> Iterator[None]:
    """Drop from now on what is written to a stream where nobody is left to read it: a pipe, or a terminal, is closed.

    What a command does, and its exit code, are then as if all had been read.
    """
    try:
        yield
    except OSError as e:
        handle = stream.fileno()
        terminal = stat.S_ISCHR(os.fstat(handle).st_mode)
        # What is still to be written is dropped, or the interpreter would try, and fail, once more as it ends.
        with Path(os.devnull).open("wb") as nobody:
            os.dup2(nobody.fileno(), handle)
        if not (isinstance(e, BrokenPipeError) or (e.errno == errno.EIO and terminal)):
            raise


class _Stream:
    """A stream of text that rich writes to, each time as if it were read."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with _as_if_read(self._stream):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with _as_if_read(self._stream):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _console(*, stderr: bool = False) -> Console:
    stream = cast("TextIO", _Stream(sys.stderr if stderr else sys.stdout))
    console = Console(file=stream, highlight=False, markup=False, emoji=False)
    if console.width < 1:  # COLUMNS=0, as some terminals have it that do not know: rich would print nothing at all
        console.width = WIDTH
    return console


def drawn(shown: Shown) -> RenderableType:
    """Return what is shown as the terminal draws it."""
    if isinstance(shown, Sheet):
        return sheet_table(shown)
    return Text(printable(shown)) if isinstance(shown, str) else shown


def write(text: str) -> None:
    """Write text to standard output as it is; what its encoding lacks is written as an escape.

    Where whoever was reading has had enough, as ``head`` has, or has closed the terminal, the rest is dropped. Raises
    OutputError when it cannot be written, such as to a file on a full disk.
    """
    encoding = sys.stdout.encoding or "utf-8"
    try:
        with _as_if_read(sys.stdout):
            sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding))
            sys.stdout.flush()
    except OSError as e:
        raise OutputError(f"standard output: cannot be written ({e.strerror}).") from e


def short_report(report: Report) -> list[Shown]:
    """Return what of a report belongs on a terminal: its short tables and sentences, and the verdict at the end."""
    shown: list[Shown] = [warning(text) for text in report.verdict.warnings]
    for block in report.brief():
        if not isinstance(block, Prose):
            shown.append(block)
        elif block.kind == "code":
            shown.append(literal("\n".join(block.sentences)))
        else:
            shown += block.sentences
    verdict = report.verdict
    good, bad = ("bold green", "green"), ("bold", "bold red")
    headline, reason = good if verdict.trusted else bad
    shown.append(strong(verdict.headline, headline))
    return [*shown, *(strong(text, reason) for text in verdict.reasons)]


def strong(text: str, style: str = "bold") -> Text:
    """Return a sentence to be shown in a style."""
    return Text(printable(text), style=style)


def literal(text: str) -> Text:
    """Return text of several lines to be shown as it stands."""
    return Text("\n".join(map(printable, text.splitlines())), no_wrap=True)


def warning(text: str) -> Text:
    """Return a warning to be shown."""
    return strong(f"Warning: {text}", "yellow")


def show_error(text: str) -> None:
    """Print an error to standard error, on one line."""
    console = _console(stderr=True)
    console.print(strong(f"Error: {apart(text)}", "red"), soft_wrap=True)


class Steps:
    """Takes what is going on now, step by step, and tells it with the time that is left."""

    def __init__(self, tell: Callable[[str, int, int], None], total: int) -> None:
        self._tell, self._begun, self._total = tell, 0, total

    def __call__(self, text: str) -> None:
        """Say that the next step begins."""
        self._begun += 1
        self._tell(text, self._begun - 1, max(self._total, self._begun))

    def expect(self, more: int) -> None:
        """Say how many steps are still to begin."""
        self._total = self._begun + more


@contextlib.contextmanager
def progress(*, shown: bool, steps: int, alike: bool = False) -> Iterator[Steps]:
    """Give what is told every step; it shows the step and the time, on a terminal only, while the block runs.

    ``steps``: how many there will be, as far as is known. ``alike``: they take about as long as each other, and the
    time left is told; else that of three quick steps says nothing of a long one, and the time taken is told.
    """
    console = _console(stderr=True)
    if not (shown and console.is_terminal):
        yield Steps(lambda _text, _done, _total: None, steps)
        return
    from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn  # noqa: PLC0415

    class Left(ProgressColumn):
        def render(self, task: Task) -> Text:
            elapsed, done, total = task.elapsed or 0.0, task.completed, task.total or 1.0
            return Text(time_left(elapsed, done, total) if alike else time_taken(elapsed, done, total))

    with Progress(TextColumn("{task.description}"), BarColumn(), Left(), console=console, transient=True) as bar:
        task = bar.add_task("starting")

        def tell(text: str, done: int, total: int) -> None:
            bar.update(task, description=printable(text), completed=done, total=total)

        yield Steps(tell, steps)


def time_left(elapsed: float, done: float, total: float) -> str:
    """Return about how long the rest of steps will take, in words; nothing before one is done."""
    if done <= 0.0:
        return ""
    seconds = elapsed * (total - done) / done
    return f"about {seconds:.0f} s left" if seconds < 100.0 else f"about {seconds / MINUTE:.0f} min left"


def time_taken(elapsed: float, done: float, total: float) -> str:
    """Return which step is under way, of how many, and how long all have taken."""
    return f"step {min(done + 1.0, total):.0f} of {total:.0f}, {elapsed:.0f} s"
