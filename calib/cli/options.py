"""Arguments and options that commands share."""

from pathlib import Path
from typing import Annotated, Any

import typer


def argument(metavar: str, help_: str) -> Any:
    """Return an argument; what is no readable file is bad input and no wrong usage, and whoever opens it says so."""
    return typer.Argument(metavar=metavar, help=help_, readable=False)


def option(name: str, metavar: str, help_: str) -> Any:
    """Return an option with a value, as :func:`argument` does."""
    return typer.Option(name, metavar=metavar, help=help_, readable=False)


def written(metavar: str, help_: str) -> Any:
    """Return the option ``--out``: a file or a folder to be written."""
    return typer.Option("--out", "-o", metavar=metavar, help=help_, readable=False)


JobFile = Annotated[Path, argument("JOB", "The job file (TOML).")]
ResultFolder = Annotated[Path, argument("FOLDER", "A folder of results of calib calibrate.")]
SetupName = Annotated[str | None, option("--setup", "NAME", "Which set-up, where the calibration had several.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Port = Annotated[int, typer.Option("--port", metavar="N", min=0, max=65535, help="Port; 0 takes a free one.")]
Open = Annotated[bool, typer.Option("--open", help="Open it in the browser.")]
MeshRoots = Annotated[list[Path] | None, option("--mesh-root", "FOLDER", "A folder to read meshes from.")]
