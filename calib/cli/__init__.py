"""The command line: one command for each thing a person does with an arm; a module for every group of them."""

import sys
import warnings
from typing import Annotated

import typer

import calib
from calib.cli.options import BAD_INPUT, INTERRUPTED, app
from calib.foundations.errors import CalibError
from calib.presentation.console import show_error

# In the order in which the help lists their commands.
from calib.cli import commands as commands  # isort: skip
from calib.cli import fleet as fleet  # isort: skip
from calib.cli import models as models  # isort: skip
from calib.cli import plan as plan  # isort: skip
from calib.cli import acceptance as acceptance  # isort: skip
from calib.cli import export as export  # isort: skip


@app.callback(invoke_without_command=True)
def version(show: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    """Calibrate any robot arm described by a URDF."""
    if show:
        typer.echo(calib.__version__)
        raise typer.Exit


def main() -> None:
    """Run the command line; an error of the user's is one line and exit code 1, a bug shows its traceback."""
    if not sys.warnoptions:  # what a library warns of is for whoever works on this program, and asks for it with -W
        warnings.simplefilter("ignore")
    try:
        app(prog_name="calib")
    except CalibError as error:
        show_error(str(error))
        sys.exit(BAD_INPUT)
    except SystemExit as ending:
        # A command that has more to say of its interruption has said it.
        if ending.code == INTERRUPTED and isinstance(getattr(ending.__context__, "__cause__", None), KeyboardInterrupt):
            show_error("interrupted.")
        raise
