"""``calib export``: what controllers take."""

import math
from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import IN_WORDS, PATH, Telling, command
from calib.cli.options import ResultFolder, SetupName, option, written
from calib.foundations.choices import Target
from calib.foundations.units import MM
from calib_start import loading

_WORSE = (
    "The file alone is worse than no correction: what it leaves out was fitted together with what it holds. For this "
    "controller, calibrate without those parts."
)


@command("export", PATH, "calib export out/ --to ur -o kinematics.yaml")
def export(
    results: ResultFolder,
    to: Annotated[Target, typer.Option("--to", help="Universal Robots, offsets, a DH table, YAML for ROS or xacro.")],
    out: Annotated[Path, written("FILE", "The file, to be written.")],
    tool: Annotated[str | None, option("--tool", "NAME", "Whose arm, where the robot has several.")] = None,
    setup: SetupName = None,
    telling: Telling = IN_WORDS,
) -> None:
    """Write a calibrated machine in the format of a controller.

    The file is read back and compared before it is written. No such file holds all that model.json does: what it
    cannot hold is named, with the error at the tip that this causes.
    """
    with loading():
        from calib.compensation.controllers import exported
        from calib.foundations.errors import CalibError, OutputError
        from calib.foundations.files import refuse_taken, write_new
        from calib.foundations.folders import reading_folder
        from calib.machine.model_file import load_machine
        from calib.presentation.console import warning
        from calib.results.folder import DH_FILE
        from calib.results.result_file import doubts_of
        from calib.robot.dh.files import read_dh
    refuse_taken(out)
    with reading_folder(results):
        model = load_machine(results)
        # A document for ROS has all set-ups, and what other files leave out may cost another distance in each.
        one_is_meant = model.sags_by_set_up and to != "ros"
        model = model.standing(setup, str(results)) if one_is_meant else model.at(setup)
        model = model if tool is None else model.of(tool)
        corrected = results / DH_FILE
        doubts = doubts_of(results)
        table = read_dh(corrected) if to == "dh" and corrected.is_file() else None
    try:
        found = exported(model, to, table)
    except CalibError as e:
        raise OutputError(f"{results}: cannot be exported to {to}: {e}") from e
    write_new(out, found.text)
    where = "within the joints' limits" if model.uncertainty is None else "of the identified range"
    machine = "the nominal URDF with this file alone" if to == "ros" else "the machine of the file"
    telling.tell(
        lambda: {"file": str(out), **found.contents(), "notes": doubts},
        lambda: [
            *map(warning, doubts),
            *(
                warning(f"{part.part}: not in the file; this moves the tip by {_said(part.cost)}.")
                for part in found.left_out
            ),
            f"Distance of the tip from that of the calibrated machine, over random poses {where}: the nominal "
            f"machine {_said(found.before)}, {machine} {_said(found.lost)}.",
            *([warning(_WORSE)] if found.lost > found.before else []),
            f"Read back and compared; the file is {out}.",
        ],
    )


def _said(cost: float) -> str:
    return "an unknown distance, as other joints are read" if math.isnan(cost) else f"{cost / MM:.4f} mm rms"
