"""A look at dropped files, or a calibration, in a process of its own: a request on standard input, lines of JSON back.

Every line is a step (``step``, ``done``, ``of``); the last one has what was ``found``, or the ``sentence`` that says
why nothing was. The folder of the page is the current one. What is done here is what ``calib import``, ``init``,
``check`` and ``calibrate`` do, by the same functions.
"""

import json
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from calib_start import loading

with loading():
    from calib.app.folder import (
        JOB,
        MADE,
        PHOTOGRAPHS,
        RESULT,
        RESULTS,
        TEXTS,
        gather,
        refuse_links,
        refuse_other_files,
    )
    from calib.foundations.errors import LITTLE_MEMORY, CalibError, JobError, OutputError
    from calib.foundations.files import read_bytes, sentences, write_atomically
    from calib.foundations.words import shown
    from calib.job.calibrate import calibrated
    from calib.job.inputs import STEPS_OF_LOADING, load
    from calib.job.looking import NO_FINDINGS, looked_at
    from calib.job.photographs import import_photographs, read_photographed_board
    from calib.job.proposal import Proposal
    from calib.job.propose import propose
    from calib.job.read import read_job, read_toml
    from calib.job.schema import named_files
    from calib.measurement.bodies import a_row_for_each_point
    from calib.measurement.formats.sheet import Sheet, read_sheet, stacked
    from calib.measurement.raw import becomes_table, raw_table, split_title
    from calib.presentation.console import Steps
    from calib.robot.sources import EXAMPLE, mesh_uris

_TOUCHED, _OF_POINTS, _MARKS, _FLANGE = "touched.csv", "{}_rows.csv", "marks.csv", "flange.urdf"
_SHOWN_VALUES = 3


def look(asked: Mapping[str, Any], say: Steps) -> dict[str, Any]:
    """Return how the dropped files are read, and what a check says of the job that they make."""
    jobs, boards = _settings(asked["settings"])
    if jobs:
        if jobs[0] != JOB:
            write_atomically(Path(JOB), read_bytes(Path(jobs[0]), JobError))
        return {"reasons": [f"{jobs[0]}: says how the tables are read."], "tables": [], **check(asked, say)}
    if not asked["robot"] and not (asked["photographs"] and boards):
        raise JobError("There is no robot yet; drop its URDF, or choose an example.")
    tables = _as_texts(asked["tables"])
    robot, reasons = _with_meshes(asked["robot"], asked["meshes"])
    asked = {**asked, "robot": robot}
    if asked["photographs"]:
        of_board = _photographed(asked, tables, boards, say)
        return {**of_board, "reasons": [*reasons, *of_board["reasons"]]}
    made: list[tuple[str, Sheet]] = []
    if asked["stack"] and tables:
        made = [(_TOUCHED, stacked([read_sheet(table) for table in tables], "target"))]
    elif asked["each_point"]:
        made = [(_OF_POINTS.format(Path(table).stem), a_row_for_each_point(read_sheet(table))) for table in tables]
    if made:
        tables = [_made(name, sheet.csv()) for name, sheet in made]
        reasons += [f"{t}: {remark}." for t, (_, sheet) in zip(tables, made, strict=True) for remark in sheet.remarks]
    say("reading the tables")
    found = propose(asked["robot"], tables, **asked["answers"])
    told: dict[str, Any] = {
        "reasons": [*reasons, *found.reasons],
        "tables": _grid(found, tables),
        "links": list(found.robot.urdf.links),
        "tip": found.robot.tip,
    }
    if found.questions:
        question = found.questions[0]
        choices = [{"text": choice, "answers": question.answered(choice)} for choice in question.choices]
        of = {"about": question.about, "text": question.text, "option": question.option, "choices": choices}
        return {**told, "question": of}
    write_atomically(Path(JOB), found.job(Path.cwd()))
    return {**told, **check(asked, say)}


def check(asked: Mapping[str, Any], say: Steps) -> dict[str, Any]:  # noqa: ARG001 - as the others
    """Return what ``calib check`` says of the job."""
    _refuse_outside()
    seen = looked_at(load(Path(JOB), say), say)
    return {
        "job": Path(JOB).read_text(encoding="utf-8-sig"),
        "findings": seen.findings or [NO_FINDINGS],
        "sound": not seen.findings,
        "determined": seen.sentence,
        "directions": len(seen.seen.undetermined),
        "unseen": list(seen.brief),
    }


def run(asked: Mapping[str, Any], say: Steps) -> dict[str, Any]:  # noqa: ARG001 - as the others
    """Calibrate, and return the verdict of the report."""
    _refuse_outside()
    refuse_links(Path(), [Path(RESULT)])
    _, report = calibrated(Path(JOB), Path(RESULTS), say, say.expect)
    verdict = report.verdict
    tiles = [{"label": tile.label, "value": tile.value} for tile in verdict.tiles]
    return {"trusted": verdict.trusted, "headline": verdict.headline, "reasons": list(verdict.reasons), "tiles": tiles}


VERBS = {"look": look, "check": check, "calibrate": run}


def _settings(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return which TOML files are jobs and which are boards. A job that was made here is none that was dropped."""
    jobs = [name for name in names if "robot" in read_toml(Path(name))]
    if len(jobs) > 1:
        raise JobError(f"{' and '.join(map(shown, jobs[:2]))} are both jobs; remove one.")
    boards = [name for name in names if name not in jobs]
    if JOB in boards:
        raise JobError(f"{JOB}: has no [robot], and this name is kept for the job; rename the file.")
    return jobs, boards


def _with_meshes(robot: str, meshes: Sequence[str]) -> tuple[str, list[str]]:
    """Return the robot beside the meshes that were dropped for it, and what there is to say of them."""
    if not robot or not meshes or robot.startswith(EXAMPLE):
        return robot, []
    source = read_bytes(Path(robot), JobError)
    path, lost = gather(Path.cwd(), robot, mesh_uris(source), meshes)
    # What collisions are found with is not shown.
    seen = mesh_uris(source, ("visual",))
    missing = [uri for uri in lost if uri in seen]
    if not missing:
        return path, [f"{robot}: its {len(seen)} meshes were found among those that were dropped."]
    return path, [
        f"{robot}: {len(missing)} of its {len(seen)} meshes are not among those that were dropped, such as "
        f"{shown(missing[0].rpartition('/')[2])}; the scene shows sticks in their place, and nothing else needs them."
    ]


def _as_texts(names: Sequence[str]) -> list[str]:
    """Return the tables of text that files are, or that are made of their records, cells or arrays."""
    texts = {
        name
        for name in names
        if name.lower().endswith(TEXTS) and not becomes_table(read_bytes(Path(name), JobError), name)
    }
    own = [Path(name).stem.lower() for name in names if name not in texts]
    found = []
    for name in names:
        if name in texts:
            found.append(name)
            continue
        # Of poses.json and poses.xlsx neither takes the other's place.
        plain = Path(name).stem if own.count(Path(name).stem.lower()) == 1 else name
        found.append(_made(f"{plain}.csv", read_sheet(name).csv()))
    return found


def _made(name: str, text: str) -> str:
    made = f"{MADE}/{name}"
    refuse_other_files(Path.cwd(), [made])
    with sentences(MADE, OutputError, "cannot be made"):
        Path(MADE).mkdir(mode=0o700, exist_ok=True)
    write_atomically(Path(made), text)
    return made


def _photographed(asked: Mapping[str, Any], tables: Sequence[str], boards: Sequence[str], say: Steps) -> dict[str, Any]:
    if len(boards) != 1 or len(tables) != 1:
        raise JobError(
            "Photographs need one board.toml, which says what is printed on the board, and one table of the joints, or "
            "of the flange's pose, with the column image."
        )
    print_ = read_photographed_board(Path(boards[0]))
    answers, robot = asked["answers"], asked["robot"]
    found = import_photographs(
        Path(PHOTOGRAPHS),
        print_,
        Path(tables[0]),
        urdf=robot or None,
        tip=answers.get("tip"),
        orientation=answers.get("orientation"),
        camera_on=asked["camera_on"],
        progress=say,
    )
    if not (found.urdf or robot):
        raise JobError(f"{found.remarks[0]}, and there is no robot yet; drop its URDF, or choose an example.")
    table = _made(_MARKS, found.table())
    model = _made(_FLANGE, found.urdf) if found.urdf else robot
    write_atomically(Path(JOB), found.job(model, table, boards[0], camera_on=asked["camera_on"]))
    return {"reasons": found.sentences, "tables": [], **check(asked, say)}


def _grid(found: Proposal, tables: Sequence[str]) -> list[dict[str, Any]]:
    """Return the columns of every table: as the file has them, and what those that are read are."""
    known = {table.file: table for table in found.tables}
    grids = []
    for file in tables:
        raw = raw_table(read_bytes(Path(file), JobError), file)
        columns = {c.title: {"values": list(c.words[:_SHOWN_VALUES]), "unit": c.symbol} for c in raw.columns}
        table = known.get(file)
        names = {} if table is None else table.columns.names
        read = [
            dict(zip(("name", "unit"), split_title(ours), strict=True), title=theirs) for ours, theirs in names.items()
        ]
        grids.append(
            {
                "file": file,
                "rows": raw.count,
                "columns": columns,
                "read": read,
                "observes": None if table is None else table.observes,
                "orientation": None if table is None else table.columns.orientation,
            }
        )
    return grids


def _refuse_outside() -> None:
    """Raise JobError for a job that names files elsewhere: a stranger's job reads what was dropped beside it alone."""
    for key, name in named_files(read_job(Path(JOB))):
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise JobError(f"{JOB}: {key}: {shown(name)} is not in the folder of this page; drop the file.")


def tell(contents: Mapping[str, Any]) -> None:
    """Write one line."""
    sys.stdout.write(json.dumps(contents) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Do what is asked on standard input."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # what is half written is removed
    asked = json.load(sys.stdin)
    say = Steps(lambda text, done, of: tell({"step": text, "done": done, "of": of}), STEPS_OF_LOADING + 1)
    try:
        tell({"found": VERBS[asked["verb"]](asked, say)})
    except CalibError as e:
        tell({"sentence": str(e)})
    except MemoryError:
        tell({"sentence": LITTLE_MEMORY})
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
