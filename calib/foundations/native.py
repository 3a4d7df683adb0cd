"""What libraries written in C say on the terminal, where they return no error: it is heard, and not shown."""

import contextlib
import os
from collections.abc import Iterator

_STDERR = 2
_MOST = 10_000


@contextlib.contextmanager
def heard() -> Iterator[list[str]]:
    """Give a list that holds, after the block, the lines that were written to standard error in it; none is shown.

    By the descriptor, which is of the whole process: the block should be one call of a library. What does not fit into
    a pipe is lost, and nothing waits for it.
    """
    said: list[str] = []
    reading, writing = os.pipe()
    try:
        for end in (reading, writing):
            os.set_blocking(end, False)
        try:
            kept: int | None = os.dup(_STDERR)
        except OSError:  # a process may have been started without one
            kept = None
        os.dup2(writing, _STDERR, inheritable=False)
        try:
            yield said
        finally:
            if kept is None:
                os.close(_STDERR)
            else:
                os.dup2(kept, _STDERR)
                os.close(kept)
        with contextlib.suppress(BlockingIOError):  # nothing was written
            said += os.read(reading, _MOST).decode(errors="replace").splitlines()
    finally:
        os.close(reading)
        os.close(writing)
