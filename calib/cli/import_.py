"""``calib import``: files that are no plain tables, or whose joints and points are apart, as one table."""

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import PREPARE, Telling, command
from calib.cli.options import Json, Quiet
from calib_start import loading


@command("import", PREPARE, "calib import joints.csv tracker.txt -o measured.csv")
def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="One file, or joints and points apart: text, .jsonl, .json, .yaml, .xlsx, .npz.",
            show_default=False,
            readable=False,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The table, to be written.", readable=False)],
    by: Annotated[
        str | None,
        typer.Option("--by", help="Title of the column that names rows, or the word order.", show_default=False),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            metavar="URDF",
            help="FILE is the maker's calibration of this UR arm: write the URDF of this arm.",
            show_default=False,
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make one table from files of other programs.

    Joints and points are joined by the names of their rows, or in order. calib init then says what columns mean.
    Exit codes: 0 good, 1 bad input, 2 wrong usage.
    """
    with loading():
        from calib.foundations.files import refuse_taken, write_new
        from calib.measurement.formats.sheet import joined, read_sheet
        from calib.presentation.console import printable
    refuse_taken(out)
    if robot is not None:
        _own_urdf(files, robot, out, Telling(as_json, quiet))
        return
    sheet, *others = [read_sheet(file) for file in files]
    for other in others:
        sheet = joined(sheet, other, by)
    write_new(out, sheet.csv())
    said = [f"{remark}." for remark in sheet.remarks]
    said.append(f"{len(sheet.rows)} rows of {len(sheet.titles)} columns are in {out}.")
    Telling(as_json, quiet).tell(
        lambda: {"file": str(out), "rows": len(sheet.rows), "columns": list(sheet.titles), "remarks": said[:-1]},
        lambda: map(printable, said),
    )


def _own_urdf(files: list[Path], robot: str, out: Path, telling: Telling) -> None:
    from calib.compensation.controllers.ur_own import with_ur_kinematics
    from calib.foundations.errors import RobotError
    from calib.foundations.files import read_bytes, write_new
    from calib.presentation.console import printable
    from calib.robot.urdf import read_urdf

    if len(files) != 1:
        raise typer.BadParameter("--robot takes one file: kinematics_params, or calibration.conf.")
    text = read_bytes(files[0], RobotError, 1_000_000).decode(errors="replace")
    write_new(out, with_ur_kinematics(read_urdf(robot), text, str(files[0])))
    said = f"{out} is {robot} with the axes of {files[0]}."
    telling.tell(lambda: {"file": str(out)}, lambda: [printable(said)])
