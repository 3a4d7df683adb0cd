"""``calib import``: files that are no plain tables, or whose joints and points are apart, as one table."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.application import IN_WORDS, PREPARE, Telling, command
from calib.cli.options import argument, option, refuse_idle, written
from calib.foundations.words import counted
from calib_start import loading

if TYPE_CHECKING:
    from calib.measurement.formats.sheet import Sheet
    from calib.measurement.instruments import CameraPlace

# The first word for photographs.
_IMAGES = "images"
_FILES = "One file, or joints and points apart: text, records, .xlsx, .npz, .mat; a ROS recording; or images FOLDER."
_STACK = "Put the files one below the other; a column TITLE has their names."
_EACH_POINT = "Of several points of one body in a row make a row for each; a column tool has their names."
_ROBOT = "FILE is the maker's calibration of this UR arm: write its URDF. Of images: the arm, and write a job."


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

    def given(self) -> dict[str, object]:
        """Return them by their names; None where they say nothing."""
        return {
            "--board": self.board,
            "--readings": self.readings,
            "--tip": self.tip,
            "--orientation": self.orientation,
            "--camera-on": None if self.camera_on == "tip" else self.camera_on,
        }


NO_IMAGES = OfImages()


@dataclass(frozen=True, slots=True)
class Arranged:
    """What options say of the rows of several files, or of several points."""

    by: Annotated[str | None, typer.Option("--by", help="Title of the column that names rows, or the word order.")] = (
        None
    )
    stack: Annotated[str | None, option("--stack", "TITLE", _STACK)] = None
    each_point: Annotated[bool, typer.Option("--each-point", help=_EACH_POINT)] = False

    def given(self) -> dict[str, object]:
        """Return them by their names; None, or false, where they say nothing."""
        return {"--by": self.by, "--stack": self.stack, "--each-point": self.each_point}


AS_THEY_ARE = Arranged()


@command("import", PREPARE, "calib import joints.csv tracker.txt -o measured.csv")
def import_(
    files: Annotated[list[Path], argument("FILE...", _FILES)],
    out: Annotated[Path | None, written("FILE", "The table, to be written.")] = None,
    arranged: Arranged = AS_THEY_ARE,
    robot: Annotated[str | None, option("--robot", "URDF", _ROBOT)] = None,
    topic: Annotated[
        str | None,
        option("--topic", "NAME", "Of a recording: the topic, or rigid body or marker, or kind of lines, to be read."),
    ] = None,
    of_images: OfImages = NO_IMAGES,
    telling: Telling = IN_WORDS,
) -> None:
    """Make one table from files of other programs.

    Joints and points are joined by the names of their rows, or in order. calib init then says what columns mean. Files
    of which each is one socket or point that was touched: calib import hole_*.csv --stack target -o touched.csv. Rows
    with several reflectors each: calib import tracker.csv --each-point -o rows.csv. Of a recording of ROS 1, ROS 2 or
    MCAP the topics are listed; --topic with -o makes a table of one of them.
    Photographs of a board: calib import images photos/ --board board.toml --readings readings.csv -o marks.csv.
    Exit codes: 0 good, 1 bad input, 2 wrong usage.
    """
    with loading():
        from calib.foundations.files import refuse_taken, write_new
        from calib.measurement.bodies import a_row_for_each_point
        from calib.measurement.formats.recordings import is_recording
        from calib.measurement.formats.sheet import joined, read_sheet, refuse_words, stacked
    images = str(files[0]) == _IMAGES and len(files) > 1
    by, stack = arranged.by, arranged.stack
    if not images:
        refuse_idle("of photographs alone: calib import images FOLDER ...", of_images.given())
    if not images and any(is_recording(file) for file in files):
        refuse_idle("not of a recording, of which --topic makes a table.", {**arranged.given(), "--robot": robot})
        _recording(files, topic, out, telling)
        return
    if out is None:
        raise typer.BadParameter("-o FILE is missing: the table, to be written.")
    refuse_taken(out)
    if images:
        refuse_idle("not of photographs.", {**arranged.given(), "--topic": topic})
        _images(files[1:], out, robot, of_images, telling)
        return
    if robot is not None:
        refuse_idle("not with --robot, which takes one file of the maker's.", {**arranged.given(), "--topic": topic})
        _own_urdf(files, robot, out, telling)
        return
    if stack is not None and by is not None:
        raise typer.BadParameter("--stack puts rows one below the other, and --by joins them; take one.")
    if len(files) == 1:
        refuse_idle("joins two files, and this is one.", {"--by": by})
    sheets = [read_sheet(file, topic) for file in files]
    if not any(sheet.of_part for sheet in sheets):
        refuse_idle(
            "of a recording, a log of rigid bodies, or lines with numbers in brackets, which none of these has.",
            {"--topic": topic},
        )
    sheet = sheets[0] if stack is None else stacked(sheets, stack)
    for other in sheets[1:] if stack is None else ():
        sheet = joined(sheet, other, by)
    refuse_words(sheet)
    if arranged.each_point:
        sheet = a_row_for_each_point(sheet)
    write_new(out, sheet.csv())
    _tell(sheet, counted(len(sheet.titles), "column"), out, telling)


def _recording(files: list[Path], topic: str | None, out: Path | None, telling: Telling) -> None:
    """List the topics of a recording, or write one of them."""
    from calib.foundations.files import refuse_taken, write_new
    from calib.measurement.formats.recordings import read_topic, topics
    from calib.presentation.command_tables import topic_sheet

    if len(files) != 1 or (topic is None) != (out is None):
        raise typer.BadParameter(
            "a recording is one file or folder; --topic and -o go together, and without both its topics are listed."
        )
    if topic is None or out is None:
        found = topics(files[0])
        telling.tell(lambda: {"topics": [one._asdict() for one in found]}, lambda: [topic_sheet(found)])
        return
    refuse_taken(out)
    sheet = read_topic(files[0], topic)
    write_new(out, sheet.csv())
    _tell(sheet, topic, out, telling)


def _tell(sheet: "Sheet", of: str, out: Path, telling: Telling) -> None:
    remarks = [f"{remark}." for remark in sheet.remarks]
    telling.tell(
        lambda: {"file": str(out), "rows": len(sheet.rows), "columns": list(sheet.titles), "remarks": remarks},
        lambda: [*remarks, f"{counted(len(sheet.rows), f'row of {of} is', f'rows of {of} are')} in {out}."],
    )


def _own_urdf(files: list[Path], robot: str, out: Path, telling: Telling) -> None:
    from calib.compensation.controllers.ur_own import with_ur_kinematics
    from calib.foundations.errors import RobotError
    from calib.foundations.files import read_bytes, write_new
    from calib.robot.urdf import read_urdf

    if len(files) != 1:
        raise typer.BadParameter("--robot takes one file: kinematics_params, or calibration.conf.")
    text = read_bytes(files[0], RobotError, 1_000_000).decode(errors="replace")
    write_new(out, with_ur_kinematics(read_urdf(robot), text, str(files[0])))
    said = f"{out} is {robot} with the axes of {files[0]}."
    telling.tell(lambda: {"file": str(out)}, lambda: [said])


def _images(folders: Sequence[Path], out: Path, robot: str | None, said: OfImages, telling: Telling) -> None:
    """Write the table ``out``, and beside it its contact sheet and a job, none of which may be there."""
    with loading():
        from calib.foundations.errors import JobError
        from calib.foundations.files import refuse_taken, write_together
        from calib.foundations.words import shown
        from calib.job.photographs import import_photographs, read_photographed_board
        from calib.job.toml_text import seen_from
        from calib.presentation.contact_sheet import Shot, contact_sheet
    if len(folders) != 1 or said.board is None or said.readings is None:
        raise typer.BadParameter("images takes one folder, --board and --readings.")
    camera_on: CameraPlace = "floor" if said.camera_on == "floor" else "tip"
    if said.camera_on != camera_on:
        raise JobError(f"--camera-on: {shown(said.camera_on)} is not tip or floor.")
    page, job, urdf = (out.with_name(f"{out.stem}{end}") for end in ("_photographs.html", ".toml", "_flange.urdf"))
    if job == out:
        raise JobError(
            f"{out}: is the name of the job that is written beside the table; call the table {out.stem}.csv."
        )
    refuse_taken(page, job, urdf)
    print_ = read_photographed_board(said.board)
    with telling.progress(0, alike=True) as say:
        found = import_photographs(
            folders[0],
            print_,
            said.readings,
            urdf=robot,
            tip=said.tip,
            orientation=said.orientation,
            camera_on=camera_on,
            progress=say,
        )
    folder = out.absolute().parent
    model = urdf.name if found.urdf else None if robot is None else seen_from(folder, robot)
    shots = [
        Shot(one.name, one.size, one.small, one.found.pixels, one.found.sigma, one.left_out)
        for one in found.photographs
    ]
    texts = {out: found.table(), page: contact_sheet(f"Photographs of {folders[0].name}", shots)}
    if found.urdf:
        texts[urdf] = found.urdf
    if model is not None:
        texts[job] = found.job(model, out.name, seen_from(folder, said.board), camera_on=camera_on)
    write_together(texts)
    without = [] if job in texts else ["No job is written, as no arm is named (--robot)."]
    telling.tell(
        lambda: {"files": list(map(str, texts)), **found.contents()},
        lambda: [*found.sentences, *without, f"Written: {', '.join(map(str, texts))}."],
    )
