"""Recordings of ROS 1, ROS 2 and MCAP: what topics they have, and joints, points and poses as tables.

Needs the package rosbags, which is pure Python and asks for no ROS. Times are those of the messages' headers, else
those at which they were recorded, in s since the recording began: tables of one recording have one zero.
"""

import math
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import MeasurementError
from calib.foundations.files import DAMAGED, read_bytes, sentences
from calib.foundations.words import counted, listed, near, shown
from calib.measurement.formats.sheet import Sheet
from calib.measurement.formats.unpacking import limited
from calib.measurement.formats.yaml_events import trouble

SUFFIXES = frozenset((".bag", ".mcap", ".db3"))
# A table of so many rows is hours of a fast controller; cells of text take some hundred bytes each.
_MOST_MESSAGES = 3_000_000
_NANO = 1e-9
# Where a point, and where an orientation, may be in a message, and which numbers it has.
_POINT = (("position", "translation", "point", "vector"), ("x", "y", "z"))
_TURN = (("orientation", "rotation"), ("w", "x", "y", "z"))
_INSIDE = ("pose", "transform")
_TF = "tf2_msgs/msg/TFMessage"
_JOINTS = "sensor_msgs/msg/JointState"
_LARGEST_METADATA = 1_000_000
# Parts of its YAML: topics have some dozens each, and a second of processor time is needed for ten thousand.
_MOST_METADATA = 30_000


class Topic(NamedTuple):
    """A topic of a recording: how many ``messages`` a second, and its longest gap in s; ``of``: what it can be made."""

    name: str
    kind: str
    messages: int
    rate: float
    gap: float
    of: str


def is_recording(path: Path) -> bool:
    """Return whether a path is that of a recording: a file by its ending, or a folder with metadata."""
    return path.suffix.lower() in SUFFIXES or (path / "metadata.yaml").is_file()


def topics(path: Path) -> tuple[Topic, ...]:
    """Return the topics of a recording, in order of their names; of frames in ``/tf`` one each, as ``/tf:flange``.

    Raises MeasurementError when it cannot be read.
    """
    with _opened(path) as reader:
        times: dict[str, list[int]] = {}
        kinds: dict[str, tuple[str, str]] = {}
        for name, kind, time, message in _messages(reader, path, None):
            times.setdefault(name, []).append(time)
            kinds.setdefault(name, (kind, _made_of(kind, message)))
        return tuple(_topic(name, *kinds[name], np.array(times[name])) for name in sorted(times))


def read_topic(path: Path, name: str) -> Sheet:
    """Return the rows of one topic: ``time [s]`` and joints, or ``x [m]`` to ``z [m]`` and a quaternion.

    Raises MeasurementError when there is no such topic, or when it has neither joints nor points.
    """
    with _opened(path) as reader:
        zero, told = int(reader.start_time), []
        for _, kind, time, message in _messages(reader, path, name):
            told.append((_NANO * (_stamp(message, time) - zero), kind, message))
    if not told:
        known = [topic.name for topic in topics(path)]
        if not known:
            raise MeasurementError(f"{path}: has no messages that can be read.")
        close = near(name, known, most=1)
        raise MeasurementError(
            f"{path}: there is no topic {shown(name)}{f'; near is {close[0]!r}' if close else ''}; there are "
            f"{listed(known)}."
        )
    of = _made_of(told[0][1], told[0][2])
    if not of:
        raise MeasurementError(f"{path}: messages of {shown(name)} are {told[0][1]}: neither joints nor points.")
    at = f"{path}: {shown(name)}"
    titles, rows, remarks = _joint_rows(told, at) if of == "joints" else _point_rows(told)
    if not rows:
        raise MeasurementError(f"{path}: no message of {shown(name)} has positions of joints.")
    # So do trackers tell that they have lost their target.
    known_rows = [row for row in rows if all(map(math.isfinite, row))]
    if not known_rows:
        raise MeasurementError(f"{at}: every message has a number that is none (nan or inf).")
    if lost := len(rows) - len(known_rows):
        remarks.append(f"{counted(lost, 'message')} with a number that is none (nan or inf) left out")
    said = f"time 0 is {_NANO * zero:.3f} s of the recording's clock"
    return Sheet(titles, tuple(tuple(map(repr, row)) for row in known_rows), str(path), (said, *remarks))


def _joint_rows(told: list[tuple[float, str, Any]], at: str) -> tuple[tuple[str, ...], list[list[float]], list[str]]:
    """Return titles, rows and remarks of joints: of the messages with the joints that most have, in any order."""
    found = [(time, tuple(message.name), message.position) for time, _, message in told if len(message.position)]
    sets = Counter(tuple(sorted(names)) for _, names, position in found if len(names) == len(position))
    if not sets:
        return (), [], []
    common, many = sets.most_common(1)[0]
    if len(set(common)) < len(common) or not all(name.strip() for name in common):
        raise MeasurementError(f"{at}: has the joints {listed(common)}; each needs a name of its own.")
    names, rows = tuple[str, ...](), []
    for time, own, position in found:
        if len(own) == len(position) and tuple(sorted(own)) == common:
            names = names or own
            rows.append([time, *(float(position[own.index(name)]) for name in names)])
    remarks = ["joints that slide are in m: change the unit of their columns"]
    if many < len(told):
        remarks.append(f"{counted(len(told) - many, 'message')} of other joints, or without positions, left out")
    return ("time [s]", *(f"{name} [rad]" for name in names)), rows, remarks


def _point_rows(told: list[tuple[float, str, Any]]) -> tuple[tuple[str, ...], list[list[float]], list[str]]:
    rows = []
    turned = _within(told[0][2], *_TURN) is not None
    for time, _, message in told:
        p, q = _within(message, *_POINT), _within(message, *_TURN)
        if p is not None:
            rows.append([time, float(p.x), float(p.y), float(p.z), *((q.w, q.x, q.y, q.z) if turned and q else ())])
    titles = ("time [s]", "x [m]", "y [m]", "z [m]")
    rest = [] if len(rows) == len(told) else [f"{counted(len(told) - len(rows), 'message')} without a point left out"]
    return (*titles, "qw", "qx", "qy", "qz") if turned else titles, rows, rest


def _topic(name: str, kind: str, of: str, times: Array) -> Topic:
    seconds = _NANO * np.diff(np.sort(times))
    whole = float(np.sum(seconds))
    rate = len(seconds) / whole if whole > 0.0 else 0.0
    return Topic(name, kind, len(times), rate, float(seconds.max(initial=0.0)), of)


def _made_of(kind: str, message: Any) -> str:
    """Return which table messages can become: "joints", "pose", "point", or none ("")."""
    if kind == _JOINTS:
        return "joints"
    if _within(message, *_POINT) is None:
        return ""
    return "point" if _within(message, *_TURN) is None else "pose"


def _within(message: Any, names: tuple[str, ...], needed: tuple[str, ...]) -> Any:
    """Return the part of a message, or of the pose or transform in it, that has these numbers; None where none has."""
    for name in names:
        part = getattr(message, name, None)
        if part is not None and all(hasattr(part, axis) for axis in needed):
            return part
    # A point by itself is its own place; a quaternion by itself is none.
    if "position" in names and all(hasattr(message, axis) for axis in needed) and not hasattr(message, "w"):
        return message
    for name in _INSIDE:
        part = getattr(message, name, None)
        if part is not None and (found := _within(part, names, needed)) is not None:
            return found
    return None


def _stamp(message: Any, recorded: int) -> int:
    """Return when a message was made, in ns: what its header says, unless that is 0, else when it was recorded."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    made = 0 if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    return made or recorded


def _messages(reader: Any, path: Path, wanted: str | None) -> Iterator[tuple[str, str, int, Any]]:
    """Yield topic, kind, time of recording and message; of transforms every frame by itself."""
    chosen = [one for one in reader.connections if wanted is None or _may_hold(one, wanted)]
    if not chosen:
        return
    seen: set[str] = set()
    for count, (connection, time, raw) in enumerate(reader.messages(connections=chosen)):
        if count >= _MOST_MESSAGES:
            raise MeasurementError(f"{path}: has more than {_MOST_MESSAGES} messages; cut it into parts.")
        name, kind = connection.topic, connection.msgtype
        # To list topics, one message of each tells what it is.
        if wanted is None and name in seen and kind != _TF:
            yield name, kind, time, None
            continue
        seen.add(name)
        message = reader.deserialize(raw, kind)
        if kind != _TF:
            yield name, kind, time, message
            continue
        for transform in message.transforms:
            if wanted is None or wanted == f"{name}:{transform.child_frame_id}":
                yield f"{name}:{transform.child_frame_id}", kind, time, transform


def _may_hold(connection: Any, wanted: str) -> bool:
    """Return whether a topic, or a frame of transforms, of this name is among the messages of a connection."""
    if connection.msgtype == _TF:
        return wanted.startswith(f"{connection.topic}:")
    return bool(connection.topic == wanted)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a recording; whatever its reader says of damage is one sentence."""
    _refuse_irregular(path)
    try:
        from apsw import Error as SqliteError  # noqa: PLC0415 - an extra
        from rosbags.highlevel import AnyReader, AnyReaderError  # noqa: PLC0415
        from rosbags.rosbag1 import ReaderError as Rosbag1Error  # noqa: PLC0415
        from rosbags.rosbag2 import ReaderError as Rosbag2Error  # noqa: PLC0415
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415
        from ruamel.yaml.error import YAMLError  # noqa: PLC0415
    except ImportError as e:
        raise MeasurementError(
            f"{path}: recordings of ROS need the package rosbags: pip install 'urdf-calib[bags]'."
        ) from e
    try:
        _refuse_metadata(path / "metadata.yaml")
        with (
            limited(path, _size(path)),
            AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader,
        ):
            yield reader
    except MeasurementError:
        raise
    except (AnyReaderError, Rosbag1Error, Rosbag2Error, SqliteError, YAMLError, *DAMAGED) as e:
        raise MeasurementError(f"{path}: is no recording that can be read ({type(e).__name__}).") from e


def _size(path: Path) -> int:
    """Return how many bytes a recording has; of a folder all its files."""
    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files)


def _refuse_metadata(file: Path) -> None:
    """Raise MeasurementError where the metadata of a folder would take long to build; rosbags builds what it finds."""
    from ruamel.yaml import YAML  # noqa: PLC0415 - of rosbags

    if file.exists():
        text = read_bytes(file, MeasurementError, _LARGEST_METADATA).decode()
        if wrong := trouble(YAML(typ="safe", pure=True).parse(text), _MOST_METADATA):
            raise MeasurementError(f"{file}: {wrong}.")


def _refuse_irregular(path: Path) -> None:
    """Raise MeasurementError for what is not there, and for pipes and devices, which a reader would wait for."""
    with sentences(path, MeasurementError):
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        for file in files:
            if not file.exists():
                raise MeasurementError(f"{file}: no such file or folder.")
            if not (file.is_file() or (file.is_dir() and file != path)):
                raise MeasurementError(f"{file}: is not a regular file.")
