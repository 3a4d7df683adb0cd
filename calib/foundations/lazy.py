"""Modules that are loaded when they are first asked for (PEP 562), and libraries that must be loaded in one go."""

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.util import find_spec
from types import FrameType, ModuleType

from calib.foundations.errors import LITTLE_MEMORY, CalibError, lacks_memory


def submodules_of(package: str) -> Callable[[str], ModuleType]:
    """Return the ``__getattr__`` of a package whose modules need no import of their own: ``calib.robot.load``."""

    def submodule(name: str) -> ModuleType:
        if name.startswith("_") or find_spec(f"{package}.{name}") is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return import_module(f"{package}.{name}")

    return submodule


def modules_on_use(package: str) -> None:
    """Load the modules of a package when they are first asked for; type checkers know them by their files alone."""
    vars(sys.modules[package])["__getattr__"] = submodules_of(package)


@contextlib.contextmanager
def needed(error: type[CalibError], need: str, absent: str) -> Iterator[None]:
    """Let the block load packages that not everybody has installed.

    Raises ``error``: ``need`` and ``absent``, together a sentence, where one is not there. One that is there and cannot
    be loaded, as for want of a library of the system or of memory, is not to be installed again: it is told why.
    """
    try:
        yield
    except ModuleNotFoundError as e:
        raise error(f"{need}{absent}.") from e
    except ImportError as e:
        if lacks_memory(e):
            raise error(LITTLE_MEMORY) from e
        why = str(e).strip().partition("\n")[0]
        raise error(f"{need}, which is installed and cannot be loaded: {why}.") from e


@contextlib.contextmanager
def loaded_in_one_go() -> Iterator[None]:
    """Let Ctrl-C wait until the block has loaded a library that would take it for a part of its own that is missing.

    Such a library goes on, and fails later where it needs that part. What the system does by itself, or ignores, stays.
    """
    handler = signal.getsignal(signal.SIGINT) if threading.current_thread() is threading.main_thread() else None
    if not callable(handler):
        yield
        return
    pressed: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: pressed.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
    if pressed:
        handler(*pressed[0])
