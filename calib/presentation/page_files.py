"""The files that pages are made of: scripts, and templates, each read and compiled once."""

from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

from calib.foundations.words import harmless

if TYPE_CHECKING:
    from jinja2 import Template


@cache
def page_file(name: str) -> str:
    """Return a file of ``pages/``."""
    return files("calib.presentation").joinpath("pages", name).read_text(encoding="utf-8")


@cache
def template(name: str) -> "Template":
    """Return a template of ``pages/``: it escapes what it is given, and fails where something is not given.

    Also what turns round the words after it, or commands a terminal, unless it is said to be safe.
    """
    from jinja2 import Environment, StrictUndefined  # noqa: PLC0415 - calib must not load it on import

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: harmless(value) if type(value) is str else value,
    )
    return environment.from_string(page_file(name))
