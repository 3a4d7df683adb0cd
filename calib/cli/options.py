"""What the commands share: the application, exit codes, arguments and options."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    help="Calibrate any robot arm described by a URDF.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

BAD_INPUT = 1
NOT_TRUSTED = 3
# As a shell has it: 128 and the number of the signal.
INTERRUPTED = 130

# What cannot be read is bad input and no wrong usage, and whoever opens it says so: hence readable=False of all paths.
JobFile = Annotated[
    Path, typer.Argument(metavar="JOB", help="The job file (TOML).", show_default=False, readable=False)
]
OutFolder = Annotated[
    Path,
    typer.Option(
        "--out", "-o", metavar="FOLDER", help="Folder of results; older results there are replaced.", readable=False
    ),
]
Errors = Annotated[
    Path | None,
    typer.Option(
        "--errors", metavar="FOLDER", help="Results of calib calibrate on this job.", show_default=False, readable=False
    ),
]
TargetFile = Annotated[
    Path,
    typer.Argument(
        metavar="TARGETS", help="Joint targets, poses or positions (CSV).", show_default=False, readable=False
    ),
]
CommandFile = Annotated[
    Path, typer.Option("--out", "-o", metavar="FILE", help="The corrected table, to be written.", readable=False)
]
DhSource = Annotated[
    Path,
    typer.Argument(metavar="FILE", help="A DH table (.csv) or a URDF (.urdf).", show_default=False, readable=False),
]
DhOut = Annotated[
    Path, typer.Option("--out", "-o", metavar="FILE", help="The other one, to be written.", readable=False)
]
PlotFile = Annotated[
    Path | None,
    typer.Option(
        "--plot", metavar="FILE", help="Also draw it, as .svg, .png or .pdf.", show_default=False, readable=False
    ),
]
ResultFolder = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER", help="A folder of results of calib calibrate.", show_default=False, readable=False
    ),
]
TouchFiles = Annotated[
    list[Path], typer.Argument(metavar="TOUCHES...", help="Touched points (CSV).", show_default=False, readable=False)
]
ProbeFile = Annotated[
    Path | None,
    typer.Option(
        "--probe", metavar="FILE", help="A cone touched to find the probe point.", show_default=False, readable=False
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
