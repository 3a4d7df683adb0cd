"""Who shows results: a room above those that make them. The front door names it; it is loaded when first asked."""

from importlib import import_module
from typing import Any

_module = ""


def shown_by(module: str) -> None:
    """Say which module shows results: its functions ``table`` and ``html`` take one."""
    global _module  # noqa: PLW0603 - said once, by the package itself
    _module = module


def shower() -> Any:
    """Return that module."""
    return import_module(_module)
