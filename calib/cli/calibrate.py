"""``calib calibrate``: from a job to a folder of results."""

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import IN_WORDS, NOT_TRUSTED, PATH, Telling, command
from calib.cli.options import JobFile, written
from calib_start import loading

OutFolder = Annotated[Path, written("FOLDER", "Folder of results; older results there are replaced.")]


@command("calibrate", PATH, "calib calibrate calibration.toml -o out/")
def calibrate(job: JobFile, out: OutFolder, telling: Telling = IN_WORDS) -> None:
    """Identify what deviates and write a folder of results.

    The folder holds the calibrated URDF, the model, the figures, the residuals and a 3D scene. Exit codes: 0 good,
    1 bad input and nothing written, 2 wrong usage, 3 written, but not to be trusted.
    """
    with loading():
        import scipy.linalg  # with all else that is loaded, as every fit asks for it
        import scipy.sparse.csgraph
        import scipy.special  # noqa: F401

        from calib.job.calibrate import calibrated
        from calib.job.inputs import STEPS_OF_LOADING
        from calib.presentation.console import short_report
        from calib.results.folder import result
    with telling.progress(STEPS_OF_LOADING) as say:
        outcome, report = calibrated(job, out, say, say.expect)
    where = f"Results are in {out}: report.html, scene.html, calibrated.urdf, result.json."
    telling.tell(lambda: result(outcome), lambda: [*short_report(report), where])
    if outcome.doubts:
        raise typer.Exit(NOT_TRUSTED)
