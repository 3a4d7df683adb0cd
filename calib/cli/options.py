"""Arguments and options that commands share."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from calib.foundations.errors import JobError
from calib.foundations.files import is_there
from calib.foundations.words import shown


def argument(metavar: str, help_: str) -> Any:
    """Return an argument; what is no readable file is bad input and no wrong usage, and whoever opens it says so."""
    return typer.Argument(metavar=metavar, help=help_, readable=False)


def option(name: str, metavar: str, help_: str) -> Any:
    """Return an option with a value, as :func:`argument` does."""
    return typer.Option(name, metavar=metavar, help=help_, readable=False)


def written(metavar: Literal["FILE", "FOLDER"], help_: str, *names: str) -> Any:
    """Return an option, ``--out`` unless it has other ``names``: a file or a folder to be written."""
    parser = _file if metavar == "FILE" else path_of
    return typer.Option(*(names or ("--out", "-o")), metavar=metavar, help=help_, readable=False, parser=parser)


def path_of(text: str | Path) -> Path:
    """Return a path; no empty text is one: of a shell's variable that is not set, it would be ``.``."""
    if text == "":
        raise typer.BadParameter("is empty; name a file or a folder.")
    return Path(text)


def _file(text: str | Path) -> Path:
    """Return the path of a file to be written: of ``name/`` a path keeps the name alone."""
    if text == "-":
        raise typer.BadParameter("'-' would be a file of this name, and not standard output; name a file.")
    if str(text) and os.path.basename(text) in ("", "."):  # noqa: PTH119 - a path has lost what is asked for
        raise typer.BadParameter(f"{shown(str(text))} is a folder; name a file.")
    return path_of(text)


def refuse_idle(why: str, given: Mapping[str, object]) -> None:
    """Raise BadParameter where one of some options was given that have no effect here, and no other says so.

    ``given``: by its name, what is true, or not empty, if it was given.
    """
    if idle := [name for name, value in given.items() if value is not None and value is not False]:
        raise typer.BadParameter(f"{', '.join(idle)}: {why}")


def mesh_folders(roots: Sequence[Path] | None) -> tuple[Path, ...]:
    """Return what ``--mesh-root`` names; raise JobError where one is no folder."""
    for root in roots or ():
        if not is_there(root, Path.is_dir):
            raise JobError(f"--mesh-root: {shown(str(root))} is not a folder.")
    return tuple(roots or ())


JobFile = Annotated[Path, argument("JOB", "The job file (TOML).")]
ResultFolder = Annotated[Path, argument("FOLDER", "A folder of results of calib calibrate.")]
SetupName = Annotated[str | None, option("--setup", "NAME", "Which set-up, where the calibration had several.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Port = Annotated[int, typer.Option("--port", metavar="N", min=0, max=65535, help="Port; 0 takes a free one.")]
Open = Annotated[bool, typer.Option("--open", help="Open it in the browser.")]
MeshRoots = Annotated[list[Path] | None, option("--mesh-root", "FOLDER", "A folder to read meshes from.")]
