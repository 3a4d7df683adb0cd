"""``calib check``: what is wrong with a job, and what its poses can see."""

from calib.cli.application import PATH, Telling, command
from calib.cli.options import JobFile, Json, Quiet
from calib_start import loading


@command("check", PATH, "calib check calibration.toml")
def check(job: JobFile, as_json: Json = False, quiet: Quiet = False) -> None:
    """Check a job and what its poses can see, without solving.

    Looks at units, names, limits, duplicates and observability. Exit codes: 0 good, 1 bad input, 2 wrong usage.
    """
    with loading():
        from calib.assessment.advice import null_space_advice
        from calib.identification.observability import observability
        from calib.job.calibrate import STEPS_OF_LOADING
        from calib.job.inputs import load
        from calib.presentation.console import printable, warning
        from calib.presentation.tables import null_space_lines
    telling = Telling(as_json, quiet)
    with telling.progress(STEPS_OF_LOADING + 1) as say:
        inputs = load(job, say)
        say("looking at what the poses can see")
        seen = observability(inputs.model, inputs.identify)
        advised = [a.sentence for a in null_space_advice(inputs.model, inputs.identify, seen.null_space)]
    findings = [finding.sentence for finding in inputs.findings]
    telling.tell(
        lambda: {"findings": findings, **seen.contents(), "advice": advised},
        lambda: [
            *(map(warning, findings) if findings else [printable("Units, names, limits and rows: no findings.")]),
            printable(
                f"{seen.numbers} numbers determine {seen.rank} combinations of {len(seen.parameters)} "
                f"parameters (condition number {seen.condition:.3g})."
            ),
            *null_space_lines(advised),
        ],
    )
