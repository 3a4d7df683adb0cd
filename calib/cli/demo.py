"""``calib demo``: the whole path on a simulated robot."""

import shlex
from pathlib import Path
from typing import Annotated

from calib.cli.application import PATH, command
from calib.cli.calibrate import calibrate
from calib.cli.check import check
from calib.cli.compensate import compensate
from calib.cli.options import argument
from calib_start import loading


@command("demo", PATH, "calib demo")
def demo(
    folder: Annotated[Path, argument("FOLDER", "A folder to be made.")] = Path("calib-demo"),
) -> None:
    """Show the whole path on a simulated IRB2400.

    Puts a job and its measurements into a folder, runs the commands that a user would type, and shows them.
    """
    with loading():
        from calib.job.example import copy_example
        from calib.presentation.console import literal, show
        from calib.results.folder import REPORT_FILE, SCENE_FILE
    job, targets, results = copy_example(folder)
    corrected = folder / "corrected.csv"

    def typed(*words: str | Path) -> None:
        show(literal("\n"), "$ calib " + shlex.join(map(str, words)))

    typed("check", job)
    check([str(job)])
    typed("calibrate", job, "-o", results)
    calibrate(job, results)
    typed("compensate", results, targets, "-o", corrected)
    compensate(results, targets, corrected)
    show(
        f"Open {results / REPORT_FILE} and {results / SCENE_FILE} in a browser, or move the arm yourself:",
        literal(f"    calib view {shlex.quote(str(results))}"),
    )
