"""The command line: ``calib calibrate job.toml -o out/`` and ``calib check job.toml``."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

import calib
from calib.foundations.errors import CalibError
from calib.identification.observability import observability
from calib.job.results import refuse_folder, result_json, write_results
from calib.job.run import load, run
from calib.presentation.console import progress, sentence, show, show_error, warning, write
from calib.presentation.tables import blind_lines, error_table, verdict

app = typer.Typer(
    help="Calibrate any robot arm described by a URDF.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

BAD_INPUT = 1
NOT_TRUSTED = 3

JobFile = Annotated[Path, typer.Argument(metavar="JOB", help="The job file (TOML).", show_default=False)]
OutFolder = Annotated[
    Path,
    typer.Option("--out", "-o", metavar="FOLDER", help="Folder of results; older results there are replaced."),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]


@app.command()
def calibrate(job: JobFile, out: OutFolder, as_json: Json = False, quiet: Quiet = False) -> None:
    """Identify what deviates and write a folder of results.

    The folder holds the calibrated URDF, the model, the figures, the residuals and a 3D scene. Exit codes: 0 good,
    1 bad input and nothing written, 2 wrong usage, 3 written, but not to be trusted.
    """
    with progress(shown=not (quiet or as_json)) as say:
        inputs = load(job, say)
        refuse_folder(out, inputs)
        outcome = run(inputs, say)
        write_results(outcome, out, say)
    if as_json:
        write(result_json(outcome))
    elif not quiet:
        show(
            *(warning(finding.sentence) for finding in inputs.findings),
            error_table(outcome.metrics),
            *verdict(outcome.fit, outcome.doubts),
            sentence(f"Results are in {out}: calibrated.urdf, result.json, residuals.csv, scene.html."),
        )
    if outcome.doubts:
        raise typer.Exit(NOT_TRUSTED)


@app.command()
def check(job: JobFile, as_json: Json = False, quiet: Quiet = False) -> None:
    """Check a job and what its poses can see, without solving.

    Looks at units, names, limits, duplicates and observability. Exit codes: 0 good, 1 bad input, 2 wrong usage.
    """
    with progress(shown=not (quiet or as_json)) as say:
        inputs = load(job, say)
        say("looking at what the poses can see")
        seen = observability(inputs.model, inputs.identify)
    if as_json:
        contents = {
            "schema": 1,
            "findings": [finding.sentence for finding in inputs.findings],
            "parameters": [parameter.name for parameter in seen.parameters],
            "measured_numbers": seen.numbers,
            "rank": seen.rank,
            "condition": seen.condition if seen.rank else None,
            "blind_directions": [str(direction) for direction in seen.blind_directions],
        }
        write(json.dumps(contents, indent=2, allow_nan=False) + "\n")
    elif not quiet:
        show(
            *(warning(finding.sentence) for finding in inputs.findings),
            *([] if inputs.findings else [sentence("Units, names, limits and rows: nothing to remark.")]),
            sentence(
                f"{seen.numbers} measured numbers see {seen.rank} of {len(seen.parameters)} parameters "
                f"(condition {seen.condition:.3g})."
            ),
            *blind_lines(seen.blind_directions),
        )


@app.callback(invoke_without_command=True)
def version(show: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    """Calibrate any robot arm described by a URDF."""
    if show:
        typer.echo(calib.__version__)
        raise typer.Exit


def main() -> None:
    """Run the command line; an error of the user's is one line and exit code 1, a bug shows its traceback."""
    try:
        app()
    except CalibError as error:
        show_error(str(error))
        sys.exit(BAD_INPUT)
