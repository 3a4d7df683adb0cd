"""``calib plan``: which poses to measure."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import IN_WORDS, PREPARE, Telling, command
from calib.cli.options import MeshRoots, argument, mesh_folders, option, refuse_idle, written
from calib.foundations.choices import Criterion, Planned
from calib_start import loading

_SIGMA = "0.05 mm"
_SIGMA_ANGLE = "0.1 mrad"
_MISFIT = "0.3 mm"
_TOOL = "50 0 50 mm"
_ACCEPTANCE = "30 deg"
_NEAREST = "0 mm"


@command("plan", PREPARE, "calib plan arm.urdf -n 40 -o poses.csv")
def plan(
    arm: Annotated[str, argument("ARM", "A URDF (.urdf, or example:...) or a job (.toml).")],
    out: Annotated[Path, written("FILE", "The poses, to be written.")],
    count: Annotated[int, typer.Option("--number", "-n", metavar="N", help="How many poses to choose.")] = 40,
    candidates: Annotated[str, option("--candidates", "N|FILE", "Random candidates, or a table of them.")] = "1000",
    measured: Annotated[Path | None, option("--measured", "FILE", "Poses measured already, to be completed.")] = None,
    working: Annotated[Path | None, option("--working", "FILE", "Poses where the tool must be accurate.")] = None,
    tip: Annotated[str | None, option("--tip", "LINK", "Tip link of a URDF, or of a job with several.")] = None,
    observes: Annotated[Planned, typer.Option(help="What is measured; pixels: beside a job's.")] = "position",
    criterion: Annotated[Criterion, typer.Option(help="What is optimised: see docs/assessment.md.")] = "I",
    sigma: Annotated[str, option("--sigma", "LENGTH", "Sigma of one measured coordinate.")] = _SIGMA,
    sigma_angle: Annotated[str, option("--sigma-angle", "ANGLE", "Sigma of one measured angle.")] = _SIGMA_ANGLE,
    misfit: Annotated[str, option("--misfit", "LENGTH", "Rms error that the model leaves out.")] = _MISFIT,
    tool: Annotated[str, option("--tool", "XYZ", "Rough place of the reflector in the tip link.")] = _TOOL,
    tracker: Annotated[str | None, option("--tracker", "XYZ", "Place of the tracker in the base link.")] = None,
    facing: Annotated[str | None, option("--facing", "XYZ", "Where the reflector faces, in the tip link.")] = None,
    acceptance: Annotated[str, option("--acceptance", "ANGLE", "Half the reflector's field of view.")] = _ACCEPTANCE,
    farthest: Annotated[str | None, option("--farthest", "LENGTH", "The tracker's range.")] = None,
    nearest: Annotated[str, option("--nearest", "LENGTH", "The tracker's shortest distance.")] = _NEAREST,
    target: Annotated[str | None, option("--target", "LENGTH", "Say how many poses until more remove less.")] = None,
    mesh_root: MeshRoots = None,
    collisions: Annotated[bool, typer.Option(help="Leave out poses where the arm touches itself.")] = True,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of the random candidates.")] = 0,
    telling: Telling = IN_WORDS,
) -> None:
    """Choose the poses that calibrate an arm best.

    Poses are chosen from random candidates within the joints' limits, or from a table. With --tracker and --facing they
    are poses that the tracker sees. If the URDF has collision shapes, they are free of self-collision.
    Of photographs: calib plan marks.toml --observes pixels -n 12 -o next.csv chooses those to take beside the job's.
    """
    with loading():
        from calib.assessment.candidates import PlannedMeasurement, possible, random_candidates
        from calib.assessment.planning import plan as plan_of
        from calib.assessment.planning import refuse_count
        from calib.cli import plan_inputs as given
        from calib.foundations import rigid
        from calib.foundations.files import refuse_taken, write_new
        from calib.foundations.ranges import RANGES, parse_within
        from calib.identification.machine import Frames
    if not collisions:
        refuse_idle("meshes are read for collisions alone.", {"--mesh-root": mesh_root})
    if not given.is_count(candidates):
        refuse_idle("candidates are drawn at random where --candidates is a number.", {"--seed": seed != 0})
    of_sight = {
        "--facing": facing,
        "--acceptance": acceptance != _ACCEPTANCE,
        "--farthest": farthest,
        "--nearest": nearest != _NEAREST,
    }
    of_noise = {"--sigma": sigma != _SIGMA, "--misfit": misfit != _MISFIT, "--sigma-angle": sigma_angle != _SIGMA_ANGLE}
    of_tables = {"--tracker": tracker, "--measured": measured, "--tip": tip, "--tool": tool != _TOOL}
    _refuse_idle(observes, of_tables, of_sight, of_noise)
    refuse_taken(out)
    refuse_count(count)
    roots = mesh_folders(mesh_root)
    if observes == "pixels":
        given.plan_photographs(
            arm, out, count, candidates, working, criterion, target, collisions, roots, seed, telling
        )
        return
    with telling.progress(steps=4) as say:
        say("reading the arm")
        robot, model, roots, columns = given.arm(arm, tip, observes, roots)
        frames = Frames(given.base(tracker)[None], rigid.translation(given.point(tool, "tool"))[None])
        right = None if working is None else given.table_readings(working, robot, columns)
        done = None if measured is None else given.table_readings(measured, robot, columns)
        noise = (given.parsed(sigma, "sigma"), given.parsed(sigma_angle, "sigma_angle", "angle"))
        measurement = PlannedMeasurement(
            frames, observes, *noise, parse_within(misfit, RANGES["model_sigma"], "misfit"), right
        )
        sight = given.sight(tracker, facing, acceptance, nearest, farthest)
        notes = given.untold(model) + given.without_room(robot)
        for path, readings in ((working, right), (measured, done)):
            if path is not None and readings is not None:
                notes += given.impossible(path, possible(robot, frames, readings))
        if collisions:
            say("reading the collision shapes")
        collision, more = given.collision(robot, roots, wanted=collisions)
        notes += more
        if given.is_count(candidates):
            found = random_candidates(
                robot, frames, given.parsed_count(candidates), sight, collision, seed=seed, progress=given.sampling(say)
            )
        else:
            say("looking at the candidates")
            found = possible(
                robot, frames, given.different_readings(Path(candidates), robot, columns), sight, collision
            )
            given.refuse_few(candidates, count, found)
        planned = plan_of(
            model,
            count,
            candidates=found.readings,
            measurement=measurement,
            criterion=criterion,
            measured=done,
            target=None if target is None else parse_within(target, RANGES["sigma"], "target"),
            progress=given.choosing(say, f"{count} of {len(found.readings)} poses"),
        )
        notes += given.led_beyond(robot, planned.readings)
        write_new(out, given.pose_table(robot, planned.readings))
    given.tell_plan(telling, planned, found, notes, ("candidates", "poses"), out, target, more=measured is not None)


def _refuse_idle(
    observes: Planned, of_tables: Mapping[str, object], of_sight: Mapping[str, object], of_noise: Mapping[str, object]
) -> None:
    """Raise BadParameter where options that have no effect together were given."""
    if observes == "pixels":
        refuse_idle("not of photographs; the job says what there is.", {**of_tables, **of_sight, **of_noise})
    if observes == "position":
        refuse_idle("of angles, which --observes pose measures.", {"--sigma-angle": of_noise["--sigma-angle"]})
    if of_tables["--tracker"] is None:
        refuse_idle("say with --tracker where the tracker is.", of_sight)
    elif of_sight["--facing"] is None:
        refuse_idle("say with --facing where the reflector faces.", {"--acceptance": of_sight["--acceptance"]})
