"""Every reader of files of the checkout that PYTHONPATH names, for :mod:`.compare_readers`: it runs in its process.

Nothing of the project is imported but ``calib``, which is to be that checkout's. Lines of JSON come in, each with a
``file`` and the ``arms`` that it may be of, and a line goes out for each: what every reader makes of the file, as its
kind ("read", "refused", "broken", "slow") and a text. Of numbers that is every digit.
"""

import contextlib
import json
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np

import calib
from calib.compensation.controllers.ur_own import with_ur_kinematics
from calib.dh import dh_to_urdf, parse_dh
from calib.foundations.errors import CalibError, MeasurementError
from calib.foundations.files import read_bytes
from calib.job.chains import chains
from calib.job.propose import propose, told
from calib.job.read import read_board, read_job
from calib.measurement.bodies import a_row_for_each_point
from calib.measurement.formats.lens_files import read_lens
from calib.measurement.formats.recordings import read_topic, topics
from calib.measurement.formats.sheet import read_sheet
from calib.measurement.from_table import measurements_from_table
from calib.measurement.kinds import Kind
from calib.measurement.poses import poses_of
from calib.measurement.raw import raw_table
from calib.measurement.table import read_table
from calib.measurement.touches import touches
from calib.presentation.visuals import visuals
from calib.robot.load import load_robot
from calib.robot.mesh_files import parse_mesh
from calib.robot.robot import Reading
from calib.robot.urdf import inertials, read_urdf

_TEXTS = (".csv", ".txt", ".tsv", ".dat", ".log", ".json", ".jsonl", ".yaml", ".yml", ".xlsx", ".npz", ".mat", "")
_LENSES = (".yaml", ".yml", ".xml", ".json", ".txt", ".ini", ".npz")
_MESHES = (".stl", ".obj", ".ply", ".off", ".glb", ".dae")
_ARMS = (".urdf", ".xacro", ".xml")
_RECORDINGS = (".bag", ".mcap", ".db3")
_IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".svg", ".pdf")
_COLOUR = (0.5, 0.5, 0.5)
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")
_UR10 = "example:ur_description/urdf/ur10_robot.urdf"


class _TooSlowError(BaseException):
    """No reader catches it."""


def plain(value: Any) -> Any:
    """Return a value as JSON has it, every number with all its digits."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value) if field.repr}
    if isinstance(value, np.ndarray):
        return [list(value.shape), plain(value.tolist())]
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if hasattr(value, "_asdict"):
        return plain(value._asdict())
    if isinstance(value, (set, frozenset)):
        return sorted(map(repr, value))
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    if value is None or isinstance(value, (str, int, float)):
        return repr(float(value)) if isinstance(value, float) else value
    if isinstance(value, (bytes, Enum)):
        return repr(value)
    return _ADDRESS.sub("", repr(value))


# Readers: what they return is compared. --------------------------------------------------------------------------


def _sheet(file: Path, _: tuple[str, ...]) -> Any:
    sheet = read_sheet(file)
    return {"titles": sheet.titles, "rows": sheet.rows, "remarks": sheet.remarks, "csv": sheet.csv()}


def _each_point(file: Path, _: tuple[str, ...]) -> Any:
    return a_row_for_each_point(read_sheet(file)).csv()


def _raw(file: Path, _: tuple[str, ...]) -> Any:
    raw = raw_table(read_bytes(file, MeasurementError), str(file))
    columns = [[one.title, one.name, one.symbol, one.dimension, one.numbers, one.words] for one in raw.columns]
    return {"columns": columns, "count": raw.count, "remarks": raw.remarks, "named": raw.named}


def _told(file: Path, _: tuple[str, ...]) -> Any:
    return told(file)


def _table(file: Path, _: tuple[str, ...]) -> Any:
    table = read_table(file)
    return {"columns": table.columns, "lines": table.lines}


def _measurements(file: Path, _: tuple[str, ...]) -> Any:
    """Read a table of our own as every kind of measurement."""
    table = read_table(file)
    readings = [
        Reading(name, "length" if column.unit.dimension == "length" else "angle", None, None)
        for name, column in table.columns.items()
        if column.unit is not None and column.unit.dimension in ("length", "angle")
        if "joint" in name or re.fullmatch("[aAjJq]_?[0-9]+", name)
    ]
    found: dict[str, Any] = {"readings": readings}
    for kind in get_args(Kind):
        try:
            data: Any = measurements_from_table(table, readings, kind)
            found[kind] = [data, poses_of(data)]
        except CalibError as e:
            found[kind] = str(e)
    try:
        found["touches"] = touches(table, readings)
    except CalibError as e:
        found["touches"] = str(e)
    return found


def _proposal(file: Path, arms: tuple[str, ...]) -> Any:
    found: dict[str, Any] = {}
    for arm in arms:
        try:
            one = propose(arm, [file])
            job = None if one.questions else one.job()
            found[arm] = [one.reasons, [question.sentence for question in one.questions], job]
        except CalibError as e:
            found[arm] = str(e)
    return found


def _recording(file: Path, _: tuple[str, ...]) -> Any:
    found: dict[str, Any] = {}
    for topic in topics(file):
        try:
            sheet = read_topic(file, topic.name)
            found[topic.name] = [topic, sheet.titles, sheet.rows, sheet.remarks]
        except CalibError as e:
            found[topic.name] = [topic, str(e)]
    return found


@cache
def _ur10() -> Any:
    return read_urdf(_UR10)


def _kinematics(file: Path, _: tuple[str, ...]) -> Any:
    return with_ur_kinematics(_ur10(), file.read_bytes().decode(errors="replace"), str(file))


def _lens(file: Path, _: tuple[str, ...]) -> Any:
    return read_lens(file)


def _board(file: Path, _: tuple[str, ...]) -> Any:
    return read_board(file)


def _job(file: Path, _: tuple[str, ...]) -> Any:
    return read_job(file).model_dump(mode="python")


def _dh(file: Path, _: tuple[str, ...]) -> Any:
    table = parse_dh(file.read_bytes(), str(file))
    return [table, dh_to_urdf(table)]


def _mesh(file: Path, _: tuple[str, ...]) -> Any:
    mesh = parse_mesh(file.read_bytes(), file.suffix.lower(), _COLOUR)
    return mesh and [[part.vertices, plain(part)] for part in mesh.parts]


def _urdf(file: Path, _: tuple[str, ...]) -> Any:
    """Read a robot, its inertia, its arms and where these are at two poses, and its looks."""
    urdf = read_urdf(file)
    found: dict[str, Any] = {"links": urdf.links, "joints": urdf.joints, "root": urdf.root}
    tips = [None, *(arm.tip for arm in chains(urdf, None))]
    for name, use in (
        ("inertials", inertials),
        ("looks", lambda of: visuals(of, _COLOUR)),
        *((f"arm {tip}", lambda of, tip=tip: _posed(load_robot(of, tip))) for tip in tips),
    ):
        try:
            found[name] = use(urdf)
        except CalibError as e:
            found[name] = str(e)
    return found


def _posed(robot: Any) -> Any:
    at = np.linspace(0.0, 0.3, 2)[:, None] * np.ones(len(robot.readings))
    return [robot.readings, robot.tips(at)]


# By the endings of files.
_READERS: dict[str, tuple[Callable[[Path, tuple[str, ...]], Any], Callable[[str], bool]]] = {
    "sheet": (_sheet, lambda end: end not in (*_MESHES, *_RECORDINGS, *_ARMS, *_IMAGES)),
    "each_point": (_each_point, lambda end: end in _TEXTS),
    "raw": (_raw, lambda end: end not in (*_MESHES, *_RECORDINGS, *_ARMS, *_IMAGES)),
    "told": (_told, lambda end: end in _TEXTS),
    "table": (_table, lambda end: end in _TEXTS),
    "measurements": (_measurements, lambda end: end in _TEXTS),
    "proposal": (_proposal, lambda end: end not in (*_MESHES, *_RECORDINGS, *_ARMS, *_IMAGES)),
    "recording": (_recording, lambda end: end in _RECORDINGS),
    "kinematics": (_kinematics, lambda end: end in (".yaml", ".yml", ".conf")),
    "lens": (_lens, lambda end: end in _LENSES),
    "board": (_board, lambda end: end in (".toml", ".yaml", ".yml", ".json")),
    "job": (_job, lambda end: end == ".toml"),
    "dh": (_dh, lambda end: end in (".csv", ".txt", ".tsv")),
    "mesh": (_mesh, lambda end: end in _MESHES),
    "urdf": (_urdf, lambda end: end in _ARMS),
}
NAMES = tuple(_READERS)


@contextlib.contextmanager
def _limited(seconds: int) -> Iterator[None]:
    """Of processor time, which other processes take none of."""

    def stop(*_: object) -> None:
        raise _TooSlowError

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def outcomes(file: Path, arms: tuple[str, ...], readers: tuple[str, ...], seconds: int) -> dict[str, tuple[str, str]]:
    """Return what each of the readers, if it takes such files, makes of one: how it ended, and what it says."""
    found = {}
    for name in readers:
        read, takes = _READERS[name]
        if not takes(file.suffix.lower()):
            continue
        try:
            with warnings.catch_warnings(), _limited(seconds):
                warnings.simplefilter("error")
                value = json.dumps(plain(read(file, arms)))
            found[name] = ("read", value)
        except CalibError as e:
            found[name] = ("refused", str(e))
        except _TooSlowError:
            found[name] = ("slow", f"more than {seconds} s of processor time")
        except Exception as e:  # noqa: BLE001 - what escapes is told
            found[name] = ("broken", f"{type(e).__name__}: {e}")
    return found


def main(tree: str, readers: str, seconds: str) -> None:
    if Path(calib.__file__).resolve().parents[1] != Path(tree).resolve():
        raise SystemExit(f"{tree}: calib is imported from {calib.__file__}, and not from there.")
    # What readers print is not to be mixed with the answers.
    answers, sys.stdout = sys.stdout, sys.stderr
    for line in sys.stdin:
        asked = json.loads(line)
        found = outcomes(Path(asked["file"]), tuple(asked["arms"]), tuple(readers.split(",")), int(seconds))
        answers.write(json.dumps(found) + "\n")
        answers.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
