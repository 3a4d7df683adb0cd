"""The first steps of the command ``calib``, before the package is loaded with its libraries, which takes a while.

Not a part of ``calib``: whatever is imported from there loads all of it first.
"""

import contextlib
import os
import signal
import sys
from types import FrameType

INTERRUPTED = 130


def main() -> None:
    """Load and run the command line; Ctrl-C meanwhile ends it with one line, as later on."""
    _open_streams()
    # Where Ctrl-C is ignored, as by a shell for what it runs in the background, it stays so.
    interruptible = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if interruptible:
        signal.signal(signal.SIGINT, _leave)
    try:
        from calib.cli import main as run  # noqa: PLC0415 - this is what takes a while
    except ImportError as e:
        if not _on_windows():
            raise
        sys.stderr.write(f"Error: {e}\n")
        sys.exit(1)
    if interruptible:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


def _open_streams() -> None:
    """Open what whoever started the command has closed (``>&-``): what is said there is dropped.

    Else the next file that is opened, a result, would take its number, and be what is written to.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
        if getattr(sys, name) is None:
            mode = "r" if number == 0 else "w"
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115 - as long as we run


def _on_windows() -> bool:
    return sys.platform == "win32"


def _leave(_number: int, _frame: FrameType | None) -> None:
    """End at once: an exception would come out of the middle of some library, which may catch it or show it."""
    with contextlib.suppress(OSError):  # nobody may be listening any more
        os.write(2, b"Error: interrupted.\n")
    os._exit(INTERRUPTED)
