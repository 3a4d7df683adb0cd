"""One whole calibration: from a job file to its folder of results."""

from collections.abc import Callable
from pathlib import Path

from calib.foundations.linear import one_thread
from calib.job.inputs import Progress, load
from calib.job.results import refuse_folder, steps_after_loading, write_results
from calib.job.run import Outcome, run

STEPS_OF_LOADING = 3


def calibrate(
    job: Path, out: Path, progress: Progress = lambda _: None, expect: Callable[[int], None] = lambda _: None
) -> Outcome:
    """Read a job, identify, and write its folder of results; ``expect`` is told how many steps come after loading.

    Linear algebra runs in one thread: sums that several threads share depend on how many they are, and the same job
    gives the same bytes alone, in a fleet, and on a machine of more cores. Raises CalibError with one sentence; the
    folder is then as it was.
    """
    with one_thread():
        inputs = load(job, progress)
        refuse_folder(out, inputs)
        expect(steps_after_loading(inputs))
        outcome = run(inputs, progress)
        write_results(outcome, out, progress)
    return outcome
