"""The command line: ``calib calibrate job.toml -o out/`` and ``calib check job.toml``."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

import calib
from calib.foundations.errors import CalibError
from calib.identification.observability import observability
from calib.job.results import refuse_folder, result, write_results
from calib.job.run import load, run
from calib.presentation.console import progress, show, show_error, warning
from calib.presentation.tables import blind_lines, error_table, verdict

app = typer.Typer(
    help="Calibrate any robot arm described by a URDF.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

BAD_INPUT = 1
NOT_TRUSTED = 3

JobFile = Annotated[Path, typer.Argument(help="The job file (TOML).", show_default=False)]
OutFolder = Annotated[Path, typer.Option("--out", "-o", help="Folder of results; older results there are replaced.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]


@app.command()
def calibrate(job: JobFile, out: OutFolder, as_json: Json = False, quiet: Quiet = False) -> None:
    """Identify what deviates and write the calibrated URDF, the figures and a 3D scene."""
    with progress(shown=not (quiet or as_json)) as say:
        inputs = load(job, say)
        refuse_folder(out, inputs)
        outcome = run(inputs, say)
        write_results(outcome, out, say)
    if as_json:
        typer.echo(json.dumps(result(outcome), indent=2, allow_nan=False))
    elif not quiet:
        show(
            *(warning(finding.sentence) for finding in inputs.findings),
            error_table(outcome.metrics),
            *verdict(outcome.fit, outcome.doubts),
            (f"Results are in {out}: calibrated.urdf, result.json, residuals.csv, scene.html."),
        )
    if outcome.doubts:
        raise typer.Exit(NOT_TRUSTED)


@app.command()
def check(job: JobFile, as_json: Json = False) -> None:
    """Look at a job's units, names, limits, duplicates and what its poses can see, without solving."""
    with progress(shown=not as_json) as say:
        inputs = load(job, say)
        say("looking at what the poses can see")
        seen = observability(inputs.model, inputs.identify)
    if as_json:
        contents = {
            "findings": [finding.sentence for finding in inputs.findings],
            "parameters": [parameter.name for parameter in seen.parameters],
            "measured_numbers": seen.numbers,
            "rank": seen.rank,
            "condition": seen.condition,
            "blind_directions": [str(direction) for direction in seen.blind_directions],
        }
        typer.echo(json.dumps(contents, indent=2))
        return
    show(
        *(warning(finding.sentence) for finding in inputs.findings),
        *([] if inputs.findings else ["Units, names, limits and rows: nothing to remark."]),
        (
            f"{seen.numbers} measured numbers see {seen.rank} of {len(seen.parameters)} parameters "
            f"(condition {seen.condition:.3g})."
        ),
        *([f"{len(seen.blind_directions)} directions are blind:"] if seen.blind_directions else []),
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
