"""The first steps of the command ``calib``, before the package is loaded: streams, and how Ctrl-C ends what loads."""

import atexit
import contextlib
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

INTERRUPTED = 130
# How long a command that was told to end may take to tidy up, in s; then Ctrl-C ends it at once.
_PATIENCE = 5.0
# Digits of a terminal's size.
_LONGEST_WIDTH = 9


def main() -> None:
    """Load and run the command line; Ctrl-C meanwhile ends it with one line, as later on."""
    try:
        with loading():
            _prepare()
            from calib.cli import main as run  # noqa: PLC0415 - see above
    except ImportError as e:
        if e.name != "calib.foundations.system":  # which says where this runs
            raise
        sys.stderr.write(f"Error: {e}\n")
        sys.exit(1)
    with _heeded_once():
        run()


def _prepare() -> None:
    _open_streams()
    try:
        os.getcwd()  # noqa: PTH109 - pathlib is slow to load
    except FileNotFoundError:
        sys.stderr.write("Error: the folder in which calib was started is not there any more.\n")
        sys.exit(1)
    # rich takes digits of any script for a number, and ends at those of which Python makes none.
    for name in ("COLUMNS", "LINES"):
        if not os.environ.get(name, "").isascii() or len(os.environ.get(name, "")) > _LONGEST_WIDTH:
            del os.environ[name]
    # Almost nothing that is loaded refers to itself; to look for that every 700 objects takes a tenth of a start.
    gc.set_threshold(50_000)
    # At the end all memory goes back anyway; to look for what refers to itself first takes another tenth.
    atexit.register(gc.freeze)
    # Else pydantic reads what every installed package says of itself, to find plugins of its.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")


@contextlib.contextmanager
def loading() -> Iterator[None]:
    """Let Ctrl-C end the process at once while the block loads libraries, which takes a while.

    Where it is ignored, as by a shell for what it runs in the background, or handled by others, it stays so. What is
    loaded stays: nobody looks meanwhile, nor later, whether it could be freed.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        with _ended_at_once():
            yield
    finally:
        gc.freeze()
        if collects:
            gc.enable()


@contextlib.contextmanager
def _ended_at_once() -> Iterator[None]:
    before = _handler()
    if before not in (signal.default_int_handler, _press):
        yield
        return
    signal.signal(signal.SIGINT, _leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def _heeded_once() -> Iterator[None]:
    """Let Ctrl-C end the block, but not what it then does to end: that would be half done, and told by a traceback.

    After the block it changes nothing either: all is done, and Python's own end would show where it was met.
    """
    if _handler() is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, _press)
    try:
        yield
    finally:
        _let_it_end()


@contextlib.contextmanager
def heeded_by(end: Callable[[], object]) -> Iterator[None]:
    """Let Ctrl-C in the block call ``end``, in the place of an exception out of whatever runs then.

    A loop of events that is left in its midst loses what it was about to do, and then waits for that without end.
    """
    before = _handler()
    if before not in (signal.default_int_handler, _press):
        yield
        return

    def press(_number: int, _frame: FrameType | None) -> None:
        _let_it_end()
        end()

    signal.signal(signal.SIGINT, press)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _handler() -> object:
    """Return what handles Ctrl-C, where this thread may change that; else nothing."""
    return signal.getsignal(signal.SIGINT) if threading.current_thread() is threading.main_thread() else None


def _press(_number: int, _frame: FrameType | None) -> None:
    _let_it_end()
    raise KeyboardInterrupt


def _let_it_end() -> None:
    """Let Ctrl-C change nothing for a while, in which the process is to have ended; then it ends it at once."""
    since = time.monotonic()

    def pressed(number: int, frame: FrameType | None) -> None:
        if time.monotonic() > since + _PATIENCE:
            _leave(number, frame)

    signal.signal(signal.SIGINT, pressed)


def _open_streams() -> None:
    """Open what whoever started the command has closed (``>&-``): what is said there is dropped.

    Else the next file that is opened, a result, would take its number, and be what is written to.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            # The lowest number that is free; handed on to processes of ours, as a stream is.
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        if getattr(sys, name) is None:
            mode = "r" if number == 0 else "w"
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115 - as long as we run


def _leave(_number: int, _frame: FrameType | None) -> None:
    """End at once: an exception would come out of the middle of some library, which may catch it or show it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is told once
    with contextlib.suppress(OSError):  # nobody may be listening any more
        os.write(2, b"Error: interrupted.\n")
    os._exit(INTERRUPTED)
