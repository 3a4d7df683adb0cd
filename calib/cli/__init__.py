"""The command line: a module for every command, which is loaded when it is typed, and loads what it needs when it runs.

What this package imports is light, so that ``calib --help`` and completion are there at once.
"""

import errno
import os
import sys
import warnings
from typing import Annotated

import typer

import calib
from calib.cli.application import BAD_INPUT, COMMANDS, INTERRUPTED, app, load
from calib.foundations.errors import LITTLE_MEMORY, CalibError, lacks_memory


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
        # Only the help, completion and what is misspelt need all commands.
        load(*(name for name in sys.argv[1:2] if name in COMMANDS))
        app(prog_name="calib")
    except CalibError as error:
        _say(str(error))
        sys.exit(BAD_INPUT)
    except KeyboardInterrupt:  # while typer makes the command of its options
        _say("interrupted.")
        sys.exit(INTERRUPTED)
    except (MemoryError, ImportError, SystemError) as error:
        if not lacks_memory(error):
            raise
        sys.stderr.write(f"Error: {LITTLE_MEMORY}\n")
        sys.exit(BAD_INPUT)
    except OSError as error:
        # Whose own folder is asked for, and is no more.
        if error.errno == errno.ENOENT and error.filename is None:
            _say("the current folder is gone: it was removed or renamed; go to another one.")
            sys.exit(BAD_INPUT)
        # Of --help and --version, which are written by others.
        if error.errno not in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT) or error.filename is not None:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        # What was misspelt stays so, also where the sentence about it finds no room.
        if (misspelt := getattr(error.__context__, "exit_code", None)) is not None:
            os.dup2(sys.stdout.fileno(), sys.stderr.fileno())
            sys.exit(misspelt)
        _say(f"standard output: cannot be written ({error.strerror}).")
        sys.exit(BAD_INPUT)
    except SystemExit as ending:
        cause = getattr(ending.__context__, "__cause__", None)
        # A library that met the end of a file, or Python in compiled code that a full disk cut off, is no wish to end.
        if isinstance(cause, EOFError):
            raise cause from None
        # A command that has more to say of its interruption has said it.
        if ending.code == INTERRUPTED and isinstance(cause, KeyboardInterrupt):
            _say("interrupted.")
        raise


def _say(error: str) -> None:
    from calib.presentation.console import show_error

    show_error(error)
