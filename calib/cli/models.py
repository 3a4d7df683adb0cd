"""``calib models``: which error model a machine needs."""

from typing import Annotated

import typer

from calib.cli.application import IN_WORDS, PREPARE, Telling, command
from calib.cli.options import JobFile
from calib.foundations.choices import FOLDS
from calib_start import loading


@command("models", PREPARE, "calib models calibration.toml")
def models(
    job: JobFile,
    folds: Annotated[
        int | None,
        typer.Option(
            "--folds",
            metavar="N",
            min=2,
            help="Number of parts, held out in turn.  "
            f"[default: {FOLDS}; 5 of more than 5000 rows, or a hundred targets, tools and set-ups]",
        ),
    ] = None,
    leave_one_group_out: Annotated[
        bool, typer.Option("--leave-one-group-out", help="Hold out every pose, socket or group by itself.")
    ] = False,
    telling: Telling = IN_WORDS,
) -> None:
    """Compare error models by their errors at held-out rows.

    The models are: base and tool alone, joint offsets, placements or DH parameters, joint terms, and what the job
    frees. The simplest that is not significantly worse than the best is recommended. Rows of one pose, one socket or
    one word in the column group stay together. Levels, solver and validation data of the job are not used.
    """
    with loading():
        from calib.assessment.comparison import OWN, TERMS, compare_models, nested_models
        from calib.foundations.errors import IdentificationError, JobError, MeasurementError, naming
        from calib.job.inputs import STEPS_OF_LOADING, load
        from calib.presentation.command_tables import comparison_sentences, comparison_sheet
        from calib.presentation.console import warning
    if folds is not None and leave_one_group_out:
        raise JobError("folds: each group is held out by itself; leave out --folds or --leave-one-group-out.")
    with telling.progress(STEPS_OF_LOADING) as say:

        def told(text: str, left: int) -> None:
            say.expect(left)
            say(text)

        inputs = load(job, say)
        section = inputs.job.error_model
        choose = {TERMS, OWN} if section.terms == "auto" else {TERMS}
        with naming(job, IdentificationError, JobError, MeasurementError):
            nested = nested_models(inputs.model, inputs.identify)
            found = compare_models(
                nested,
                inputs.identify,
                scheme="leave-one-group-out" if leave_one_group_out else folds,
                choose=choose & nested.keys(),
                model_sigmas=[sigma for sigmas in inputs.model_sigmas for sigma in sigmas],
                losses=inputs.losses,
                progress=told,
            )
    telling.tell(
        found.contents,
        lambda: [
            *(warning(f"{name}: {why}") for name, why in found.refused.items()),
            comparison_sheet(found),
            *comparison_sentences(found),
        ],
    )
