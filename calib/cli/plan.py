"""``calib plan``: which poses to measure."""

import json
import re
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from calib.assessment.candidates import Setup, Sight, possible, random_candidates
from calib.assessment.design import Criterion
from calib.assessment.planning import Plan
from calib.assessment.planning import plan as plan_of
from calib.cli.options import Json, Quiet, app
from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.csv_text import csv_text
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.files import refuse_taken, write_new
from calib.foundations.ranges import OF_DIMENSION, RANGES, parse_within
from calib.foundations.units import Dimension
from calib.foundations.words import shown
from calib.identification.error_model import ErrorModel, error_model
from calib.identification.machine import Frames
from calib.job.inputs import load_arm
from calib.measurement.columns import stacked
from calib.measurement.table import read_table
from calib.presentation.console import progress, sentence, show, warning, write
from calib.presentation.plan_tables import forecast_table, index_table
from calib.robot.collision import self_collision
from calib.robot.conditions import NO_CONDITIONS
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.sampling import MOST_POSES
from calib.robot.sources import EXAMPLE, examples_folder
from calib.robot.transmission import lacking

Source = Annotated[
    str, typer.Argument(metavar="ARM", help="A URDF (.urdf, or example:...) or a job (.toml).", show_default=False)
]
_NUMBER = re.compile(r"[+-]?[0-9]+", re.ASCII)

PoseFile = Annotated[
    Path, typer.Option("--out", "-o", metavar="FILE", help="The poses, to be written.", readable=False)
]


def _option(name: str, metavar: str, help_: str) -> typer.models.OptionInfo:
    option: typer.models.OptionInfo = typer.Option(name, metavar=metavar, help=help_, readable=False)
    return option


@app.command()
def plan(
    arm: Source,
    out: PoseFile,
    count: Annotated[int, typer.Option("--number", "-n", metavar="N", help="How many poses to choose.")] = 40,
    candidates: Annotated[str, _option("--candidates", "N|FILE", "Random candidates, or a table of them.")] = "1000",
    measured: Annotated[Path | None, _option("--measured", "FILE", "Poses measured already, to be completed.")] = None,
    working: Annotated[Path | None, _option("--working", "FILE", "Poses where the tool shall be right.")] = None,
    tip: Annotated[str | None, _option("--tip", "LINK", "Tip link of a URDF.")] = None,
    observes: Annotated[Literal["position", "pose"], typer.Option(help="What is measured.")] = "position",
    criterion: Annotated[Criterion, typer.Option(help="What is optimised: see the documentation.")] = "I",
    sigma: Annotated[str, _option("--sigma", "LENGTH", "Scatter of one measured coordinate.")] = "0.05 mm",
    sigma_angle: Annotated[str, _option("--sigma-angle", "ANGLE", "Scatter of one measured turn.")] = "0.1 mrad",
    misfit: Annotated[str, _option("--misfit", "LENGTH", "What the model will not explain, rms.")] = "0.3 mm",
    tool: Annotated[str, _option("--tool", "XYZ", "Roughly where the reflector is in the tip link.")] = "50 0 50 mm",
    tracker: Annotated[str | None, _option("--tracker", "XYZ", "Where the tracker is in the robot's base.")] = None,
    facing: Annotated[str | None, _option("--facing", "XYZ", "Where the reflector looks, in the tip link.")] = None,
    acceptance: Annotated[str, _option("--acceptance", "ANGLE", "Half the reflector's field of view.")] = "30 deg",
    farthest: Annotated[str | None, _option("--farthest", "LENGTH", "The tracker's range.")] = None,
    nearest: Annotated[str, _option("--nearest", "LENGTH", "The tracker's least distance.")] = "0 mm",
    target: Annotated[str | None, _option("--target", "LENGTH", "Say how many poses keep the error below.")] = None,
    mesh_root: Annotated[list[Path] | None, _option("--mesh-root", "FOLDER", "A folder to read meshes from.")] = None,
    collisions: Annotated[bool, typer.Option(help="Leave out poses where the arm touches itself.")] = True,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Of the random candidates.")] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Choose the poses that calibrate an arm best.

    From random candidates within the joints' limits or a table of them; seen by the tracker where --tracker and
    --facing say where it is and where the reflector looks; without self-collision where the URDF has collision shapes.
    """
    refuse_taken(out)
    with progress(shown=not (quiet or as_json), steps=4) as say:
        say("reading the arm")
        robot, model, roots = _arm(arm, tip, observes, tuple(mesh_root or ()))
        frames = Frames(_base(tracker), rigid.translation(_point(tool, "tool"))[None])
        noise = (_length(sigma, "sigma"), _angle(sigma_angle, "sigma_angle"))
        setup = Setup(frames, observes, *noise, parse_within(misfit, RANGES["model_sigma"], "misfit"))
        sight = _sight(tracker, facing, acceptance, nearest, farthest)
        notes = _untold(model)
        collision = None
        if collisions and b"<collision" in robot.urdf.source:
            say("reading the collision shapes")
            collision = self_collision(robot, roots)
            notes += (
                ["None of the URDF's collision shapes can be read; --mesh-root may help."] if collision is None else []
            )
            notes += [] if collision is None else list(collision.notes)
        say("sampling candidates")
        if _NUMBER.fullmatch(candidates):
            found = random_candidates(robot, frames, _count(candidates), sight, collision, seed=seed)
        else:
            found = possible(robot, frames, _table(Path(candidates), robot), sight, collision)
        say(f"choosing {count} of {len(found.readings)} poses")
        planned = plan_of(
            model,
            setup,
            found.readings,
            count,
            criterion=criterion,
            working=None if working is None else _table(working, robot),
            measured=None if measured is None else _table(measured, robot),
            target=None if target is None else _length(target, "target"),
        )
        write_new(out, pose_table(robot, planned.readings))
    if as_json:
        contents = {
            "schema": 1,
            "rank": planned.rank,
            "parameters": planned.parameters,
            "forecasts": [asdict(forecast) for forecast in planned.forecasts],
            "floor": planned.floor,
            "enough": planned.enough,
            "indices": {"chosen": planned.indices, "random": planned.random_indices},
            "rejected": dict(found.rejected),
            "notes": notes,
        }
        write(json.dumps(contents, indent=2, allow_nan=False) + "\n")
    elif not quiet:
        rejected = ", ".join(f"{n} {reason}" for reason, n in found.rejected.items())
        show(
            *map(warning, notes),
            sentence(f"{len(found.readings)} candidates of {found.tried} poses{': ' + rejected if rejected else ''}."),
            sentence(f"They see {planned.rank} of {planned.parameters} parameters."),
            forecast_table(planned),
            index_table(planned),
            *([] if target is None else [sentence(_enough(planned, target, more=measured is not None))]),
            sentence(f"{len(planned.readings)} poses are in {out}."),
        )


def _enough(planned: Plan, target: str, *, more: bool) -> str:
    if planned.enough is None:
        return f"No number of these candidates keeps the error below {target}."
    return f"{planned.enough}{' more' if more else ''} of the best poses keep the error below {target}."


def pose_table(robot: Robot, readings: Array) -> str:
    """Return poses (N, nr) as the beginning of a measurement table: joints in degrees and mm."""
    unit = {"angle": ("deg", 180.0 / np.pi), "length": ("mm", 1e3)}
    header = [f"{reading.name} [{unit[reading.dimension][0]}]" for reading in robot.readings]
    factors = [unit[reading.dimension][1] for reading in robot.readings]
    return csv_text([header, *([f"{value:.4f}" for value in row] for row in readings * factors)])


def _arm(
    source: str, tip: str | None, observes: Literal["position", "pose"], roots: tuple[Path, ...]
) -> tuple[Robot, ErrorModel, tuple[Path, ...]]:
    if source.endswith(".toml"):
        arm = load_arm(Path(source))
        if tip is not None and tip != arm.robot.tip:
            raise JobError(f"{source}: the job's tip is {arm.robot.tip!r}; leave --tip out.")
        return arm.robot, arm.model, (*arm.mesh_roots, *roots)
    robot = load_robot(source, tip)
    model = error_model(robot, offsets="all", placements="all", tool="pose" if observes == "pose" else "position")
    own = (examples_folder().parents[1],) if source.startswith(EXAMPLE) else (Path(source).parent,)
    return robot, model, (*own, *roots)


def _untold(model: ErrorModel) -> list[str]:
    """Return what is to be said of joint terms that depend on more than the pose."""
    names = [reading.name for reading in model.robot.readings]
    free = [term for term in model.robot.terms if term.name in model.terms]
    untold = [term.name for term in free if lacking([term], names, NO_CONDITIONS)]
    if not untold:
        return []
    return [
        f"{', '.join(untold)}: depend on sides of approach, temperatures or torques and not on the poses alone; the "
        "plan is for the other parameters."
    ]


def _count(text: str) -> int:
    # A number of thousands of digits is none for Python.
    if not 1 <= float(text) <= MOST_POSES:
        raise JobError(f"candidates: {shown(text)} is not a number from 1 to {MOST_POSES}, nor a file.")
    return int(text)


def _base(tracker: str | None) -> Array:
    """Return the base in the instrument's frame, whose axes are taken to be the base's."""
    return np.eye(4) if tracker is None else rigid.translation(-_point(tracker, "tracker"))


def _sight(
    tracker: str | None, facing: str | None, acceptance: str, nearest: str, farthest: str | None
) -> Sight | None:
    if tracker is None:
        if facing is not None or farthest is not None:
            raise JobError("facing, farthest: say with --tracker where the tracker is.")
        return None
    x, y, z = (0.0, 0.0, 1.0) if facing is None else map(float, _three(facing, "facing"))
    return Sight(
        facing=None if facing is None else (x, y, z),
        acceptance=_angle(acceptance, "acceptance"),
        nearest=_length(nearest, "nearest"),
        farthest=float("inf") if farthest is None else _length(farthest, "farthest"),
    )


def _table(path: Path, robot: Robot) -> Array:
    """Return the readings (N, nr) of a table, whatever else is in it."""
    table = read_table(path)
    dimensions: dict[str, Dimension] = {reading.name: reading.dimension for reading in robot.readings}
    if missing := [name for name in dimensions if name not in table.columns]:
        raise MeasurementError(f"{path}: there is no column {', '.join(map(repr, missing))} of a joint.")
    return stacked(table, dimensions)


def _point(text: str, what: str) -> Array:
    """Return a point (3,) in m of a text like ``50 0 50 mm``."""
    *numbers, unit = text.split() or [""]
    return np.array([_length(f"{number} {unit}", what) for number in _words(numbers, text, what)])


def _three(text: str, what: str) -> list[float]:
    return [parse_within(f"{number} rad", OF_DIMENSION["angle"], what) for number in _words(text.split(), text, what)]


def _words(numbers: list[str], text: str, what: str) -> list[str]:
    if len(numbers) != 3:
        example = "0 0 1" if what == "facing" else "50 0 50 mm"
        raise JobError(f"{what}: {text!r} is not three numbers, like {example!r}.")
    return numbers


def _length(text: str, what: str) -> float:
    return parse_within(text, RANGES.get(what, OF_DIMENSION["length"]), what)


def _angle(text: str, what: str) -> float:
    return parse_within(text, RANGES.get(what, OF_DIMENSION["angle"]), what)
