"""Modules that are loaded when they are first asked for (PEP 562)."""

import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType


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
