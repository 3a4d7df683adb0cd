"""Commands that judge a calibrated machine: how sure it is, whether it still is, ISO 9283."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from calib.assessment.acceptance import Judgement, verify
from calib.assessment.candidates import Observed
from calib.assessment.drift import compare
from calib.assessment.iso9283 import figures, read_cycles
from calib.assessment.uncertainty import Uncertainty, outside_identified, tool_uncertainty, uncertainty_map
from calib.cli.options import NOT_TRUSTED, Json, Quiet, ResultFolder, app
from calib.compensation.model_file import CalibratedModel, load_model
from calib.foundations.csv_text import csv_text
from calib.foundations.errors import OutputError
from calib.foundations.files import refuse_taken, write_new
from calib.foundations.ranges import RANGES, parse_within
from calib.measurement.read import read_measurements
from calib.presentation.acceptance_tables import (
    change_table,
    comparison_lines,
    iso_table,
    map_table,
    verification_lines,
    verification_table,
)
from calib.presentation.console import progress, sentence, show, warning, write
from calib.robot.sampling import MOST_POSES

_NEW = typer.Argument(metavar="MEASUREMENTS", help="New measurements (CSV).", show_default=False, readable=False)
_CYCLES = typer.Argument(
    metavar="CYCLES", help="Attained poses of repeated cycles (CSV).", show_default=False, readable=False
)
_OLD = typer.Argument(metavar="OLD", help="Results of the earlier calibration.", show_default=False, readable=False)
_LATER = typer.Argument(metavar="NEW", help="Results of the later calibration.", show_default=False, readable=False)


@app.command(name="verify")
def verify_command(
    results: ResultFolder,
    measurements: Annotated[Path, _NEW],
    observes: Annotated[Observed, typer.Option(help="What was measured.")] = "position",
    sigma: Annotated[str | None, typer.Option("--sigma", metavar="LENGTH", help="The instrument's noise.")] = None,
    limit: Annotated[str | None, typer.Option("--limit", metavar="LENGTH", help="Of every position error.")] = None,
    refit_base: Annotated[bool, typer.Option("--refit-base", help="The instrument was moved: find the base.")] = False,
    in_order: Annotated[
        bool, typer.Option("--in-order", help="Rows stand as they were measured: so joints were reached from a side.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Verify a calibrated machine by new measurements.

    Ten points or more are enough. It passes when every error is within the limit, where one is given, and the errors
    together are no larger than the stated uncertainty explains (chi-square test, 1 %). Exit codes: 0 passed, 1 bad
    input, 2 wrong usage, 3 failed.
    """
    with progress(shown=not (quiet or as_json), steps=2) as say:
        say("reading the model and the measurements")
        model = load_model(results)
        doubts = _doubts(model, results)
        data = read_measurements(
            measurements,
            model.robot,
            observes,
            sigma=None if sigma is None else parse_within(sigma, RANGES["sigma"], "sigma"),
            in_order=in_order,
        )
        say("judging")
        found = verify(
            doubts,
            data,
            limit=None if limit is None else parse_within(limit, RANGES["sigma"], "limit"),
            refit=refit_base,
        )
        outside = outside_identified(doubts, data.readings)
    if as_json:
        contents = {
            "schema": 1,
            "passed": found.passed,
            "limit": found.limit,
            "within_limit": found.within_limit,
            "base_refitted": refit_base,
            "as_calibrated": _plain(found.as_calibrated),
            "with_base_refitted": None if found.base_refitted is None else _plain(found.base_refitted),
            "base_moved": found.base_moved,
            "outside": list(outside),
        }
        write(json.dumps(contents, indent=2, allow_nan=False) + "\n")
    elif not quiet:
        show(*map(warning, outside), verification_table(found), *verification_lines(found))
    if not found.passed:
        raise typer.Exit(NOT_TRUSTED)


def _plain(judgement: Judgement) -> dict[str, Any]:
    return {
        "metrics": {quantity: asdict(m) for quantity, m in judgement.metrics.items()},
        "test": {**asdict(judgement.test), "passed": judgement.test.passed},
    }


@app.command(name="compare")
def compare_command(
    old: Annotated[Path, _OLD], new: Annotated[Path, _LATER], as_json: Json = False, quiet: Quiet = False
) -> None:
    """Compare two calibrations of one machine.

    What has moved by more than chance explains, and what it does at the tip.
    """
    with progress(shown=not (quiet or as_json), steps=2) as say:
        say("reading both models")
        before, after = (_doubts(load_model(folder), folder) for folder in (old, new))
        say("comparing")
        found = compare(before, after)
    if as_json:
        contents = {
            "schema": 1,
            "moved": found.moved,
            "changes": [asdict(change) for change in found.changes],
            "statistic": found.statistic,
            "degrees_of_freedom": found.degrees_of_freedom,
            "probability": found.probability,
            "tip": {"rms": found.tip_rms, "max": found.tip_max, "stated": found.stated},
        }
        write(json.dumps(contents, indent=2, allow_nan=False) + "\n")
    elif not quiet:
        show(*([change_table(found)] if found.changes else []), *comparison_lines(found))


@app.command()
def iso9283(cycles: Annotated[Path, _CYCLES], as_json: Json = False, quiet: Quiet = False) -> None:
    """Evaluate repeated cycles after ISO 9283.

    Pose accuracy and repeatability, of distances too, from several directions, and drift: which of them, the columns
    say (target, x, y, z; command_x, ...; qw, ...; direction; time).
    """
    found = figures(read_cycles(cycles))
    if as_json:
        write(json.dumps({"schema": 1, "figures": [asdict(f) for f in found]}, indent=2, allow_nan=False) + "\n")
    elif not quiet:
        show(iso_table(found))


@app.command()
def uncertainty(
    results: ResultFolder,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="Also write every sampled pose (CSV).", readable=False),
    ] = None,
    samples: Annotated[int, typer.Option("--samples", metavar="N", min=2, max=MOST_POSES, help="Random poses.")] = 2000,
    tool: Annotated[str, typer.Option("--tool", metavar="NAME", help="Whose uncertainty.")] = "tool",
    whole: Annotated[
        bool, typer.Option("--whole", help="Over the joints' limits, not only the identified range.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show how sure a calibrated machine is of its tool.

    Over the range of readings it was identified in, or with --whole over its joints' limits; in the instrument's frame.
    """
    if out is not None:
        refuse_taken(out)
    with progress(shown=not (quiet or as_json), steps=1) as say:
        doubts = _doubts(load_model(results), results)
        found = uncertainty_map(
            doubts,
            samples,
            tool=tool,
            limits=None if whole else doubts.identified,
            progress=lambda done, of: say(f"{done} of {of} poses"),
        )
        near = tool_uncertainty(doubts, found.readings, tool)
    if out is not None:
        units = {"angle": ("deg", 180.0 / np.pi), "length": ("mm", 1e3)}
        readings = doubts.robot.readings
        columns = [*(f"{r.name} [{units[r.dimension][0]}]" for r in readings), "x [mm]", "y [mm]", "z [mm]"]
        header = [*columns, "sigma [mm]", "sigma_angle [deg]", "unseen [mm]", "unseen_angle [deg]"]
        factors = np.array([units[r.dimension][1] for r in readings])
        both = np.array([1e3, 180.0 / np.pi])
        rows = np.hstack([found.readings * factors, found.positions * 1e3, found.sigmas * both, found.unseen * both])
        write_new(out, csv_text([header, *([f"{value:.5f}" for value in row] for row in rows)]))
    if as_json:
        percentiles = {str(p): np.percentile(found.sigmas, p, axis=0).tolist() for p in (5, 50, 95, 100)}
        seen = {name: float(np.mean(near.seen[:, k])) for k, name in enumerate(("position", "orientation"))}
        write(json.dumps({"schema": 1, "sigmas": percentiles, "seen": seen}, indent=2, allow_nan=False) + "\n")
    elif not quiet:
        show(map_table(found, near.seen), *([] if out is None else [sentence(f"Every pose is in {out}.")]))


def _doubts(model: CalibratedModel, folder: Path) -> Uncertainty:
    if model.uncertainty is None:
        raise OutputError(f"{folder}: holds no uncertainty.json; calibrate again with this version.")
    return model.uncertainty
