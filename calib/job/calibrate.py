"""One whole calibration: from a job file to its folder of results."""

from collections.abc import Callable
from pathlib import Path

from calib.foundations.arguments import checked
from calib.foundations.folders import real_folder
from calib.foundations.linear import one_thread
from calib.job.inputs import Inputs, load
from calib.job.read import Progress
from calib.job.run import run
from calib.presentation.report.document import Report
from calib.results.calibration import Calibration
from calib.results.folder import STEPS_OF_WRITING, refuse_folder, write_results


@checked
def calibrate(
    job: str | Path,
    out: str | Path,
    progress: Progress = lambda _: None,
    expect: Callable[[int], None] = lambda _: None,
) -> Calibration:
    """Read a job, identify, and write its folder of results, as ``calib calibrate`` does.

        found = calib.calibrate("calibration.toml", "results")

    ``progress`` is told each step, ``expect`` is told how many steps come after loading.

    Linear algebra runs in one thread: sums that several threads share depend on how many they are, and the same job
    gives the same bytes alone, in a fleet, and on a machine of more cores. Raises CalibError with one sentence; the
    folder is then as it was.
    """
    return calibrated(Path(job), Path(out), progress, expect)[0]


def calibrated(
    job: Path, out: Path, progress: Progress, expect: Callable[[int], None], *, meant: Path | None = None
) -> tuple[Calibration, Report]:
    """Do what :func:`calibrate` does; return the report that was written as well.

    ``meant``: the only folder that ``out`` may lead to; else the one that it leads to now.
    """
    with one_thread():
        meant = real_folder(out) if meant is None else meant
        inputs = load(job, progress)
        refuse_folder(meant, inputs.files)
        expect(steps_after_loading(inputs))
        found = run(inputs, progress)
        return found, write_results(found, out, progress, meant=meant)


def steps_after_loading(inputs: Inputs) -> int:
    """Return how many steps a calibration tells of once its inputs are read, up to the written results."""
    fits = sum(level.residual_model is None for level in inputs.job.levels) or 1
    followed = inputs.job.solver.kind == "total_differential"
    residual = inputs.job.levels[-1].residual_model if inputs.job.levels else None
    learned = residual is not None and residual.kind == "gaussian_process"
    # Validating comes after the fits.
    return fits + learned + followed + 1 + STEPS_OF_WRITING
