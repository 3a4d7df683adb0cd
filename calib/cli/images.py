"""``calib import images``: photographs of a board as a table of pixels, a contact sheet, and a job."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from calib.cli.application import Telling
from calib.cli.options import option
from calib_start import loading

_READINGS = "Of images: a table of the joints, or of the flange's pose, with the column image."


@dataclass(frozen=True, slots=True)
class OfImages:
    """What options say of photographs alone."""

    board: Annotated[Path | None, option("--board", "FILE", "Of images: board.toml.")] = None
    readings: Annotated[Path | None, option("--readings", "FILE", _READINGS)] = None
    tip: Annotated[str | None, typer.Option("--tip", help="Of images: the link of the flange.")] = None
    orientation: Annotated[
        str | None, typer.Option("--orientation", help="Of images: what three angles of the flange mean.")
    ] = None
    camera_on: Annotated[
        str, typer.Option("--camera-on", help="Of images: tip, or floor where the arm carries the board.")
    ] = "tip"


NO_IMAGES = OfImages()


def import_images(folders: Sequence[Path], out: Path, robot: str | None, said: OfImages, telling: Telling) -> None:
    """Write the table ``out``, and beside it its contact sheet and a job, none of which may be there."""
    with loading():
        from calib.foundations.errors import JobError
        from calib.foundations.files import refuse_taken, write_new
        from calib.foundations.words import shown
        from calib.job.photographs import import_photographs
        from calib.job.read import read_board
        from calib.presentation.contact_sheet import Shot, contact_sheet
        from calib.robot.sources import EXAMPLE
    if len(folders) != 1 or said.board is None or said.readings is None:
        raise typer.BadParameter("images takes one folder, --board and --readings.")
    if said.camera_on not in ("tip", "floor"):
        raise JobError(f"--camera-on: {shown(said.camera_on)} is not tip or floor.")
    page, job, urdf = (out.with_name(f"{out.stem}{end}") for end in ("_photographs.html", ".toml", "_flange.urdf"))
    for file in (page, job, urdf):
        refuse_taken(file)
    print_ = read_board(said.board)
    with telling.progress(0, alike=True) as say:
        found = import_photographs(
            folders[0], print_, said.readings, urdf=robot, tip=said.tip, orientation=said.orientation, progress=say
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
        named = os.path.relpath(said.board, out.absolute().parent)
        write_new(job, found.job(model, out.name, named, camera_on=said.camera_on))
        written.append(job)
    _tell(telling, found.contents(), written)


def _tell(telling: Telling, contents: Mapping[str, Any], written: Sequence[Path]) -> None:
    said = [f"{remark}." for remark in contents["remarks"]]
    said += [f"{one['image']} is left out: {one['why']}." for one in contents["left_out"]]
    used, count = contents["used"], contents["used"] + len(contents["left_out"])
    said.append(f"{contents['corners']} corners of {used} of {count} photographs; {contents['sigma']:.3f} px each.")
    said.append(f"Written: {', '.join(map(str, written))}.")
    telling.tell(lambda: {"files": [str(file) for file in written], **contents}, lambda: said)
