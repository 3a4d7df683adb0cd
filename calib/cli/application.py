"""The application: its groups of commands, its exit codes, and the one way in which commands tell what they found."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, is_dataclass
from functools import cache, update_wrapper
from importlib import import_module
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_args

import typer
from typer.core import TyperGroup

from calib.cli.options import Json, Quiet, path_of
from calib.foundations.json_text import document
from calib.foundations.words import printable
from calib_start import loading

if TYPE_CHECKING:
    from calib.presentation.console import Shown, Steps

BAD_INPUT = 1
NOT_TRUSTED = 3
# As a shell has it: 128 and the number of the signal.
INTERRUPTED = 130

# The groups in which the help lists the commands: first the way from measurements to a calibrated machine.
PATH = "Calibrate"
PREPARE = "Prepare"
JUDGE = "Judge"
MORE = "More"

# Where each command is, in the order in which the help lists them.
_MODULES = (
    "init check calibrate view app_ compensate export demo board import_ plan models sensitivity verify compare "
    "uncertainty iso9283 performance fleet dh cell five_point"
)
COMMANDS = {module.rstrip("_").replace("_", "-"): f"calib.cli.{module}" for module in _MODULES.split()}

_Command = TypeVar("_Command", bound=Callable[..., None])


@contextlib.contextmanager
def _quoted() -> Iterator[None]:
    """Let wrong usage in the block be told without the controls, and the marks of direction, that were typed."""
    try:
        yield
    except Exception as error:
        # typer has no public name for all kinds of wrong usage; this is what it tells of each.
        if hasattr(error, "format_message"):
            vars(error)["message"] = printable(str(vars(error)["message"]))
        raise


class _Grouped(TyperGroup):
    """Lists commands in groups also where rich, which is slow to load, does not draw the help.

    What was misspelt is quoted with an escape for every character that does not print.
    """

    def make_context(self, *given: Any, **more: Any) -> Any:
        """Read the options before the command."""
        with _quoted():
            return super().make_context(*given, **more)

    def invoke(self, ctx: Any) -> Any:
        """Read the options of the command, and run it."""
        with _quoted():
            return super().invoke(ctx)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        """Write one list for every group, in the order of their first commands."""
        panels: dict[str, list[tuple[str, str]]] = {}
        room = formatter.width - 6 - max(map(len, self.commands))
        for name, command in self.commands.items():
            panel = str(getattr(command, "rich_help_panel", MORE))
            panels.setdefault(panel, []).append((name, command.get_short_help_str(room)))
        for panel, rows in panels.items():
            with formatter.section(panel):
                formatter.write_dl(rows)


app = typer.Typer(
    cls=_Grouped,
    help="Calibrate any robot arm described by a URDF.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def load(*names: str) -> None:
    """Let the application know some commands, or all if none is named."""
    with loading():
        for name in names or COMMANDS:
            import_module(COMMANDS[name])
    order = list(COMMANDS)
    app.registered_commands.sort(key=lambda known: order.index(str(known.name)))


def command(name: str, group: str, example: str) -> Callable[[_Command], _Command]:
    """Return the decorator of a command, with the group that lists it and the example at the end of its help.

    A parameter whose type is a dataclass of options, such as :class:`Telling`, stands for all of these.
    """
    register = app.command(name, rich_help_panel=group, epilog=f"Example: {example}")

    def decorated(function: _Command) -> _Command:
        register(_spread(function))
        return function

    return decorated


def _spread(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command with single options in the places of those that a parameter bundles."""
    own = signature(function).parameters.values()
    bundles = {one.name: one for one in own if is_dataclass(one.annotation)}

    def run(**given: Any) -> None:
        for name, bundle in bundles.items():
            given[name] = bundle.annotation(**{option.name: given.pop(option.name) for option in _options(bundle)})
        function(**given)

    spread = update_wrapper(run, function)
    vars(spread)["__signature__"] = Signature([option for one in own for option in _options(one)])
    return spread


def _options(one: Parameter) -> list[Parameter]:
    kind: Callable[..., Any] = one.annotation
    return _bundled(kind) if is_dataclass(kind) else [_with_a_name(one).replace(kind=Parameter.KEYWORD_ONLY)]


@cache
def _bundled(kind: Callable[..., Any]) -> list[Parameter]:
    # Each is given by its name: those without a default may follow others.
    every = map(_with_a_name, signature(kind).parameters.values())
    return [option.replace(kind=Parameter.KEYWORD_ONLY) for option in every]


def _with_a_name(option: Parameter) -> Parameter:
    """Return an option that takes no empty text for a path."""
    kind, *details = get_args(option.annotation) or (None,)
    if not details or not _of_paths(kind):
        return option
    info = copy(details[0])
    info.parser = info.parser or path_of
    return option.replace(annotation=Annotated[kind, info])


def _of_paths(kind: object) -> bool:
    return kind is Path or any(map(_of_paths, get_args(kind)))


@dataclass(frozen=True, slots=True)
class Telling:
    """How a command tells what it does and found: for a person, as one JSON document, or not at all."""

    as_json: Json = False
    quiet: Quiet = False

    def progress(self, steps: int, *, alike: bool = False) -> "contextlib.AbstractContextManager[Steps]":
        """Give what is told every step, shown to a person at a terminal. ``steps``: how many, as far as is known.

        ``alike``: they take about as long as each other.
        """
        from calib.presentation.console import progress

        return progress(shown=not (self.quiet or self.as_json), steps=steps, alike=alike)

    def tell(self, contents: Callable[[], Mapping[str, Any]], shown: Callable[[], Iterable["Shown"]]) -> None:
        """Print the document, or what is shown to a person."""
        from calib.presentation.console import show, write

        if self.as_json:
            write(document(contents()))
        elif not self.quiet:
            show(*shown())


IN_WORDS = Telling()
