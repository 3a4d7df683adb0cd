"""``calib compensate``: commands that take the real machine where it should be."""

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import IN_WORDS, PATH, Telling, command
from calib.cli.options import ResultFolder, SetupName, argument, option, written
from calib.cli.proposing import AS_TITLED, AsTitled
from calib.foundations.choices import PoseFrame, What
from calib_start import loading


@command("compensate", PATH, "calib compensate out/ targets.csv -o corrected.csv")
def compensate(
    results: ResultFolder,
    targets: Annotated[Path, argument("TARGETS", "Joint targets, poses or positions (CSV).")],
    out: Annotated[Path, written("FILE", "The corrected table, to be written.")],
    tool: Annotated[str, option("--tool", "NAME", "The tool that shall reach the targets.")] = "tool",
    setup: SetupName = None,
    frame: Annotated[PoseFrame, typer.Option("--frame", help="In whose frame poses are given.")] = "base",
    what: Annotated[What, typer.Option("--what", help="What of a target is to be reached.")] = "pose",
    clamp: Annotated[
        bool,
        typer.Option(
            "--clamp",
            help="Outside a residual grid use its nearest edge; far from rows of a Gaussian process, what it fades to.",
        ),
    ] = False,
    in_order: Annotated[
        bool, typer.Option("--in-order", help="Targets are visited in their order, which tells the side of approach.")
    ] = False,
    titles: AsTitled = AS_TITLED,
    telling: Telling = IN_WORDS,
) -> None:
    """Correct commands: joint targets, poses or positions.

    Joint targets are corrected to take the calibrated machine where the nominal one would go; poses (x, y, z, qw, qx,
    qy, qz, or rx, ry, rz with --orientation) and positions are reached in the robot's base frame, or the instrument's.
    Rows that cannot be reached are left empty, with the reason. Columns keep their titles, units and angles; those that
    are passed over are left out.
    """
    with loading():
        from calib.compensation import targets as targets_of
        from calib.foundations.errors import MeasurementError
        from calib.foundations.files import refuse_taken, write_new
        from calib.foundations.words import counted
        from calib.machine.identified import outside_identified
        from calib.machine.model_file import load_machine
        from calib.measurement.table import HeaderError
        from calib.presentation.console import warning
        from calib.results.result_file import doubts_of
    refuse_taken(out)
    with telling.progress(steps=2) as say:
        say("reading the model and the targets")
        model = load_machine(results)
        try:
            columns = titles.columns()
            wanted = targets_of.read_targets(targets, model, tool, in_order=in_order, columns=columns)
        except HeaderError as e:
            if not e.unitless:
                raise
            raise MeasurementError(
                f"{str(e).removesuffix('.')}; names of targets belong in the column 'group', --column "
                f"'NAME [UNIT]={e.unitless[0]}' gives a unit, and --ignore {e.unitless[0]!r} passes a column over."
            ) from e
        matters = targets_of.of_set_up(model, wanted, frame=frame)
        model = model.standing(setup, str(results)) if matters else model.at(setup)
        idle = (
            *doubts_of(results),
            *targets_of.in_base(model, wanted, frame=frame),
            *targets_of.idle(model, wanted, frame=frame, clamp=clamp),
        )
        say("correcting")
        found = targets_of.corrections(model, wanted, what=what, frame=frame, clamp=clamp)
        write_new(out, targets_of.corrected_csv(model, wanted, found))
    outside: tuple[str, ...] = ()
    if model.uncertainty is not None and found.reached.any():
        conditions = wanted.conditions.subset(found.reached)
        outside = outside_identified(model, found.readings[found.reached], conditions, tool=wanted.tools)
    missed = len(found) - int(found.reached.sum())
    if remarked := sum(bool(why) for why, there in zip(found.reasons, found.reached, strict=True) if there):
        rows = counted(remarked, "target that can be reached has", "targets that can be reached have")
        idle = (*idle, f"{rows} a remark in the column 'reason'.")
    all_of_it = "it" if len(found) == 1 else "all"
    said = f"{missed} cannot be reached, and the table says why" if missed else f"{all_of_it} can be reached"
    telling.tell(
        lambda: {"file": str(out), **found.contents(), "notes": list(idle)},
        lambda: [
            *map(warning, (*idle, *outside)),
            f"{counted(len(found), 'target')}, {said}. The corrected commands are in {out}.",
        ],
    )
