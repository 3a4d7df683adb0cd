"""``calib import images``: photographs of a board as a table of pixels, a contact sheet, and a job."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from calib.cli.application import Telling
from calib_start import loading


def import_images(
    folders: Sequence[Path],
    board: Path | None,
    readings: Path | None,
    out: Path,
    robot: str | None,
    tip: str | None,
    orientation: str | None,
    camera_on: str,
    telling: Telling,
) -> None:
    """Write the table ``out``, and beside it its contact sheet and a job, none of which may be there."""
    with loading():
        from calib.foundations.errors import JobError
        from calib.foundations.files import refuse_taken, write_new
        from calib.foundations.words import shown
        from calib.job.photographs import import_photographs
        from calib.job.read import read_board
        from calib.presentation.contact_sheet import Shot, contact_sheet
        from calib.robot.sources import EXAMPLE
    if len(folders) != 1 or board is None or readings is None:
        raise typer.BadParameter("images takes one folder, --board and --readings.")
    if camera_on not in ("tip", "floor"):
        raise JobError(f"--camera-on: {shown(camera_on)} is not tip or floor.")
    page, job, urdf = (out.with_name(f"{out.stem}{end}") for end in ("_photographs.html", ".toml", "_flange.urdf"))
    for file in (page, job, urdf):
        refuse_taken(file)
    print_ = read_board(board)
    with telling.progress(0, alike=True) as say:
        found = import_photographs(
            folders[0], print_, readings, urdf=robot, tip=tip, orientation=orientation, progress=say
        )
    write_new(out, found.table())
    shots = [
        Shot(one.name, one.size, one.small, one.found.pixels, one.found.sigma, one.left_out)
        for one in found.photographs
    ]
    write_new(page, contact_sheet(f"Photographs of {folders[0].name}", shots))
    written = [out, page]
    model = urdf.name if found.urdf else robot
    if found.urdf:
        write_new(urdf, found.urdf)
        written.append(urdf)
    if model is not None:
        if not (found.urdf or model.startswith(EXAMPLE)):
            model = os.path.relpath(model, out.absolute().parent)
        named = os.path.relpath(board, out.absolute().parent)
        write_new(job, found.job(model, out.name, named, camera_on=camera_on))
        written.append(job)
    _tell(telling, found.contents(), written)


def _tell(telling: Telling, contents: Mapping[str, Any], written: Sequence[Path]) -> None:

    said = [f"{remark}." for remark in contents["remarks"]]
    said += [f"{one['image']} is left out: {one['why']}." for one in contents["left_out"]]
    used, count = contents["used"], contents["used"] + len(contents["left_out"])
    said.append(f"{contents['corners']} corners of {used} of {count} photographs; {contents['sigma']:.3f} px each.")
    said.append(f"Written: {', '.join(map(str, written))}.")
    telling.tell(lambda: {"files": [str(file) for file in written], **contents}, lambda: said)
