"""``calib app``: the way from files to results, on a page of this computer."""

from pathlib import Path
from typing import Annotated

from calib.cli.application import PATH, command
from calib.cli.options import Open, Port, option
from calib.cli.view import run_until_interrupted, shown_at
from calib_start import loading

_FOLDER = "A folder that keeps files and results, new, empty or of an earlier page; else they go at Ctrl-C."


@command("app", PATH, "calib app --open")
def app(
    folder: Annotated[Path | None, option("--folder", "FOLDER", _FOLDER)] = None, port: Port = 0, open_: Open = False
) -> None:
    """Calibrate on a page of this computer, until Ctrl-C.

    Drop a URDF and tables or photographs, see and correct how they are read, check, calibrate, look at the results.
    Nothing leaves this computer. The address holds a secret: whoever has it can use the page.
    """
    with loading():
        from calib.app.server import serve
    run_until_interrupted(lambda: serve(folder, port, shown_at("The page", open_=open_)))
