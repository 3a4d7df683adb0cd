"""``calib check``: what is wrong with a job, and what its poses can see."""

from typing import Annotated

import typer

from calib.cli.application import PATH, Telling, command
from calib.cli.options import JobFile, Json, Quiet
from calib_start import loading

Every = Annotated[bool, typer.Option("--all", help="List all that the data do not determine, one by one.")]


@command("check", PATH, "calib check calibration.toml")
def check(job: JobFile, every: Every = False, as_json: Json = False, quiet: Quiet = False) -> None:
    """Check a job and what its poses can see, without solving.

    Looks at units, names, limits, duplicates and observability. Exit codes: 0 good, 1 bad input, 2 wrong usage.
    """
    with loading():
        from calib.assessment.advice import null_space_advice, told_briefly
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
        told = advised if every else told_briefly(inputs.model, inputs.identify, seen.null_space, advised)
    findings = [finding.sentence for finding in inputs.findings]
    telling.tell(
        lambda: {"findings": findings, **seen.contents(), "advice": advised},
        lambda: [
            *(map(warning, findings) if findings else [printable("Units, names, limits and rows: no findings.")]),
            printable(
                f"{seen.numbers} numbers determine {seen.rank} combinations of {len(seen.parameters)} "
                f"parameters (condition number {seen.condition:.3g})."
            ),
            *null_space_lines(told, directions=len(seen.null_space)),
        ],
    )
