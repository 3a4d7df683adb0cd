"""Arguments and options that commands share."""

from pathlib import Path
from typing import Annotated

import typer

# What cannot be read is bad input and no wrong usage, and whoever opens it says so: hence readable=False of all paths.
JobFile = Annotated[
    Path, typer.Argument(metavar="JOB", help="The job file (TOML).", show_default=False, readable=False)
]
ResultFolder = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER", help="A folder of results of calib calibrate.", show_default=False, readable=False
    ),
]
SetupName = Annotated[
    str | None, typer.Option("--setup", metavar="NAME", help="Which set-up, where the calibration had several.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
