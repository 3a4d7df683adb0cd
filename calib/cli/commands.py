"""Commands that check, identify, correct and describe an arm."""

import asyncio
import contextlib
import json
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from calib.assessment.advice import blind_advice
from calib.assessment.performance import before_and_after, read_touches
from calib.assessment.sensitivity import group_study
from calib.assessment.sensitivity import sensitivity as sensitivity_of
from calib.assessment.uncertainty import outside_identified
from calib.cli.options import (
    NOT_TRUSTED,
    CommandFile,
    DhOut,
    DhSource,
    Errors,
    JobFile,
    Json,
    OutFolder,
    PlotFile,
    ProbeFile,
    Quiet,
    ResultFolder,
    TargetFile,
    TouchFiles,
    app,
)
from calib.compensation import targets as targets_of
from calib.compensation.cell import PlacedIn, calibrated_cell
from calib.compensation.commands import PoseFrame, What
from calib.compensation.model_file import load_model
from calib.foundations.errors import JobError
from calib.foundations.files import refuse_taken, write_new
from calib.identification.error_model import with_terms
from calib.identification.observability import observability
from calib.job.calibrate import STEPS_OF_LOADING
from calib.job.calibrate import calibrate as calibrate_job
from calib.job.example import copy_example
from calib.job.inputs import load
from calib.job.report import report_of
from calib.job.results import REPORT_FILE, SCENE_FILE, result_json, robot_errors
from calib.presentation.cell_scene import cell_scene
from calib.presentation.console import brief, literal, progress, sentence, show, warning, write
from calib.presentation.live import serve
from calib.presentation.performance_tables import performance_table
from calib.presentation.plots import figure_bytes, sensitivity_figure
from calib.presentation.scene import render_scene
from calib.presentation.sensitivity_tables import group_table, sensitivity_table, sensitivity_verdict
from calib.presentation.tables import blind_lines
from calib.robot import dh
from calib.robot.dh.table import Convention
from calib.robot.load import load_robot


@app.command()
def calibrate(job: JobFile, out: OutFolder, as_json: Json = False, quiet: Quiet = False) -> None:
    """Identify what deviates and write a folder of results.

    The folder holds the calibrated URDF, the model, the figures, the residuals and a 3D scene. Exit codes: 0 good,
    1 bad input and nothing written, 2 wrong usage, 3 written, but not to be trusted.
    """
    with progress(shown=not (quiet or as_json), steps=STEPS_OF_LOADING) as say:
        outcome = calibrate_job(job, out, say, say.expect)
    if as_json:
        write(result_json(outcome))
    elif not quiet:
        show(
            *brief(report_of(outcome)),
            sentence(f"Results are in {out}: report.html, scene.html, calibrated.urdf, result.json."),
        )
    if outcome.doubts:
        raise typer.Exit(NOT_TRUSTED)


@app.command()
def check(job: JobFile, as_json: Json = False, quiet: Quiet = False) -> None:
    """Check a job and what its poses can see, without solving.

    Looks at units, names, limits, duplicates and observability. Exit codes: 0 good, 1 bad input, 2 wrong usage.
    """
    with progress(shown=not (quiet or as_json), steps=STEPS_OF_LOADING + 1) as say:
        inputs = load(job, say)
        say("looking at what the poses can see")
        seen = observability(inputs.model, inputs.identify)
        advised = [a.sentence for a in blind_advice(inputs.model, inputs.identify, seen.blind_directions)]
    if as_json:
        contents = {
            "schema": 1,
            "findings": [finding.sentence for finding in inputs.findings],
            "parameters": [parameter.name for parameter in seen.parameters],
            "measured_numbers": seen.numbers,
            "rank": seen.rank,
            "condition": seen.condition if seen.rank else None,
            "indices": seen.indices,
            "blind_directions": [str(direction) for direction in seen.blind_directions],
            "advice": advised,
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
            *blind_lines(advised),
        )


@app.command()
def compensate(
    results: ResultFolder,
    targets: TargetFile,
    out: CommandFile,
    tool: Annotated[str, typer.Option("--tool", metavar="NAME", help="The tool that is to reach them.")] = "tool",
    frame: Annotated[PoseFrame, typer.Option("--frame", help="Whose frame poses are in.")] = "base",
    what: Annotated[What, typer.Option("--what", help="What is to be reached.")] = "pose",
    clamp: Annotated[
        bool,
        typer.Option(
            "--clamp",
            help="Outside a residual grid take its nearest edge; far from rows of a Gaussian process, nothing.",
        ),
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Correct commands: joint targets, poses or positions.

    Joint targets are corrected to take the calibrated machine where the nominal one would go; poses (x, y, z, qw, qx,
    qy, qz) and positions are reached in the robot's base frame, or the instrument's. Rows that cannot be reached are
    left empty, with the reason.
    """
    refuse_taken(out)
    with progress(shown=not (quiet or as_json), steps=2) as say:
        say("reading the model and the targets")
        model = load_model(results)
        wanted = targets_of.read_targets(targets, model, tool)
        say("correcting")
        found = targets_of.corrections(model, wanted, what=what, frame=frame, clamp=clamp)
        write_new(out, targets_of.corrected_csv(model, wanted, found))
    if as_json:
        missed_rows = [
            {"row": row + 1, "reason": reason}
            for row, (reached, reason) in enumerate(zip(found.reached, found.reasons, strict=True))
            if not reached
        ]
        contents = {"schema": 1, "file": str(out), "targets": len(found), "not_reached": missed_rows}
        write(json.dumps(contents, indent=2, allow_nan=False) + "\n")
    elif not quiet:
        if model.uncertainty is not None and found.reached.any():
            show(*map(warning, outside_identified(model.uncertainty, found.readings[found.reached])))
        missed = len(found) - int(found.reached.sum())
        said = f"{missed} cannot be reached, and the table says why" if missed else "all can be reached"
        show(sentence(f"{len(found)} targets, {said}. The corrected commands are in {out}."))


@app.command()
def demo(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A folder to be made.", readable=False)] = Path(
        "calib-demo"
    ),
) -> None:
    """Show the whole path on a simulated IRB2400.

    A job and its measurements are put into a folder; then what a person would type is done, and shown.
    """
    job, targets, results = copy_example(folder)
    corrected = folder / "corrected.csv"
    _typed("check", job)
    check(job)
    _typed("calibrate", job, "-o", results)
    calibrate(job, results)
    _typed("compensate", results, targets, "-o", corrected)
    compensate(results, targets, corrected)
    show(
        sentence(f"Open {results / REPORT_FILE} and {results / SCENE_FILE} in a browser, or move the arm yourself:"),
        literal(f"    calib view {results}"),
    )


def _typed(*words: str | Path) -> None:
    """Show a command as a person would type it."""
    show(literal("\n"), sentence("$ calib " + shlex.join(map(str, words))))


@app.command()
def view(
    results: ResultFolder,
    port: Annotated[int, typer.Option("--port", metavar="N", min=0, max=65535, help="0: any that is free.")] = 0,
) -> None:
    """Serve the scene to this machine alone, live.

    Until Ctrl-C. Beside what scene.html shows, joints can be moved by hand, and newer results in the folder show
    themselves.
    """

    def started(address: str) -> None:
        show(sentence(f"The scene of {results} is at {address} until you press Ctrl-C."))

    serving = serve(results, SCENE_FILE, (REPORT_FILE,), port, started)
    # Ctrl-C is how this ends well.
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(serving())


@app.command()
def sensitivity(
    job: JobFile, errors: Errors = None, plot: PlotFile = None, as_json: Json = False, quiet: Quiet = False
) -> None:
    """Show how much every free parameter of a job moves the tip.

    At the poses of the job's measurements, for 1 mm and 1 mrad of each parameter; with --errors also what becomes of
    the tip error when one kind of identified errors is ten times as large, and a tenth.
    """
    if plot is not None:
        refuse_taken(plot)
    with progress(shown=not (quiet or as_json), steps=STEPS_OF_LOADING + 1) as say:
        inputs = load(job, say)
        say("differentiating")
        readings = np.concatenate([end.readings for data in inputs.identify for end in data.ends])
        model = inputs.model
        if errors is not None and inputs.job.error_model.terms == "auto":
            model = with_terms(model, load_model(errors).robot.terms)  # those that were chosen
        found = sensitivity_of(model, readings)
        study = None
        if errors is not None:
            try:
                study = group_study(model, readings, robot_errors(errors))
            except JobError as e:
                raise JobError(f"{errors}: is no result of this job: {e}") from e
    if plot is not None:
        write_new(plot, figure_bytes(sensitivity_figure(found), plot))
    if as_json:
        contents = {"schema": 1, "parameters": found.records(), "groups": [] if study is None else study.records()}
        write(json.dumps(contents, indent=2, allow_nan=False) + "\n")
    elif not quiet:
        show(sensitivity_table(found), *sensitivity_verdict(found), *([] if study is None else [group_table(study)]))


@app.command()
def performance(
    results: ResultFolder, touches: TouchFiles, probe: ProbeFile = None, as_json: Json = False, quiet: Quiet = False
) -> None:
    """Evaluate acceptance tests of an arm CMM.

    Before and after its calibration: single-point articulation, lengths, and spheres, after the methods of
    ASME B89.4.22 and ISO 10360-12. Which test a file is, its columns say.
    """
    with progress(shown=not (quiet or as_json), steps=1) as say:
        say("reading the model and the touches")
        model = load_model(results)
        tests = [read_touches(path, model.robot) for path in touches]
        before, after = before_and_after(model, tests, None if probe is None else read_touches(probe, model.robot))
    if as_json:
        whens = {"before": before, "after": after}
        figures = {when: [asdict(figure) for figure in found.figures] for when, found in whens.items()}
        write(json.dumps({"schema": 1, **figures}, indent=2, allow_nan=False) + "\n")
    elif not quiet:
        show(performance_table(before, after))


@app.command()
def cell(
    arm: Annotated[
        Path, typer.Argument(metavar="ARM", help="Results of the arm, or its URDF.", show_default=False, readable=False)
    ],
    positioner: Annotated[
        Path,
        typer.Argument(metavar="POSITIONER", help="Results of what it touched.", show_default=False, readable=False),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE", help="The cell's URDF, to be written.", readable=False)
    ],
    scene: Annotated[
        Path | None,
        typer.Option("--scene", metavar="FILE", help="Also draw it (HTML).", show_default=False, readable=False),
    ] = None,
    placed_in: Annotated[PlacedIn, typer.Option("--placed-in", help="Whose frame its base was found in.")] = "arm",
    prefix: Annotated[
        str | None, typer.Option("--prefix", metavar="NAME", help="Before names that both use.", show_default=False)
    ] = None,
    mesh_root: Annotated[
        list[Path] | None,
        typer.Option(
            "--mesh-root", metavar="FOLDER", help="May be read for meshes.", show_default=False, readable=False
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Put an arm and the positioner it touched into one URDF.

    The positioner stands at its calibrated place, fixed to the arm's base; of its names only those change that both
    use. It may as well be another arm, a turntable or a track.
    """
    for file in (out, scene):
        if file is not None:
            refuse_taken(file)
    if scene == out:
        raise JobError(f"{out}: cannot be the cell and its scene; choose another name for one of them.")
    found = calibrated_cell(arm, positioner, placed_in, prefix)
    # As in a job: the URDF's own folder, and what is named.
    roots = (arm.parent, *(mesh_root or ()))
    page = None if scene is None else render_scene(cell_scene(found, f"{out.name}: calibrated cell", roots))
    write_new(out, found.cell.document)
    if scene is not None and page is not None:
        write_new(scene, page)
    if not quiet:
        renamed = [new for names in (found.cell.links, found.cell.joints) for old, new in names.items() if old != new]
        changed = f" Renamed, as both use the name: {', '.join(renamed)}." if renamed else ""
        show(sentence(f"The cell is in {out}.{changed}"))


@app.command(name="dh")
def dh_view(
    source: DhSource,
    out: DhOut,
    tip: Annotated[str | None, typer.Option("--tip", metavar="LINK", help="Tip link of a URDF.")] = None,
    base: Annotated[str | None, typer.Option("--base", metavar="LINK", help="Base link of a URDF.")] = None,
    convention: Annotated[Convention | None, typer.Option(help="Convention of the table: standard by default.")] = None,
) -> None:
    """Turn a DH table into a URDF, or a URDF into a table.

    Which way follows from the endings: table.csv to arm.urdf, or the arm of arm.urdf to table.csv.
    """
    kinds = {source.suffix.lower(), out.suffix.lower()}
    if kinds != {".csv", ".urdf"}:
        raise JobError(f"{source} to {out}: one must end in .csv, the DH table, and the other in .urdf.")
    refuse_taken(out)
    if out.suffix.lower() == ".urdf":
        write_new(out, dh.dh_to_urdf(dh.read_dh(source, convention), out.stem))
    else:
        write_new(out, dh.write_dh(dh.dh_of(load_robot(source, tip, base), convention or "standard")))
