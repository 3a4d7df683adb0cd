"""Recordings of ROS 1, ROS 2 and MCAP: what topics they have, and joints, points and poses as tables.

Needs the package rosbags, which is pure Python and asks for no ROS. Times are those of the messages' headers, else
those at which they were recorded, in s since the recording began: tables of one recording have one zero.
"""

import contextlib
import math
from array import array
from collections import Counter
from collections.abc import Iterator
from itertools import compress
from operator import itemgetter
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import MeasurementError
from calib.foundations.files import DAMAGED, is_there, read_bytes, sentences
from calib.foundations.lazy import needed
from calib.foundations.words import counted, listed, near, shown
from calib.measurement.formats.message_types import Told, Values, told_by
from calib.measurement.formats.sheet import Sheet
from calib.measurement.formats.unpacking import MOST_TOPICS, limited
from calib.measurement.formats.yaml_events import trouble

SUFFIXES = frozenset((".bag", ".mcap", ".db3"))
# A table of so many rows is hours of a fast controller; cells of text take some hundred bytes each.
_MOST_MESSAGES = 3_000_000
_NANO = 1e-9
# So far, in s, messages come behind later ones: what is told of an earlier time after that is of a clock that was set.
_LATEST = 1.0
_TITLES = {
    "point": ("time [s]", "x [m]", "y [m]", "z [m]"),
    "pose": ("time [s]", "x [m]", "y [m]", "z [m]", "qw", "qx", "qy", "qz"),
}
# Of one message: its time in s, and the names and positions of joints.
_Joints = tuple[float, tuple[str, ...], tuple[float, ...]]
# The frame in which a point is told, "" where nobody says, and the numbers of its row.
_Point = tuple[str, list[float]]
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
    """Return whether a path is that of a recording: a file by its ending, or a folder with metadata or such files."""
    if path.suffix.lower() in SUFFIXES or is_there(path / "metadata.yaml", Path.is_file):
        return True
    with contextlib.suppress(OSError):
        return path.is_dir() and bool(_recorded(path))
    return False


def _recorded(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir() if file.suffix.lower() in SUFFIXES)


def topics(path: Path) -> tuple[Topic, ...]:
    """Return the topics of a recording, in order of their names; of frames in ``/tf`` one each, as ``/tf:flange``.

    Raises MeasurementError when it cannot be read.
    """
    with _opened(path) as reader:
        times: dict[str, list[int]] = {}
        kinds: dict[str, tuple[str, str]] = {}
        for name, kind, told, time, _ in _messages(reader, path, None):
            times.setdefault(name, []).append(time)
            if len(times) > MOST_TOPICS:
                raise MeasurementError(f"{path}: has more than {MOST_TOPICS} topics and frames of transforms.")
            # Whoever sends something else under the same name does not hide what can be read.
            if name not in kinds or (told.of and not kinds[name][1]):
                kinds[name] = kind, told.of
    if not times:
        raise MeasurementError(f"{path}: has no messages that can be read.")
    return tuple(_topic(name, *kinds[name], np.array(times[name])) for name in sorted(times))


def read_topic(path: Path, name: str) -> Sheet:
    """Return the rows of one topic: ``time [s]`` and joints, or ``x [m]`` to ``z [m]`` and a quaternion.

    Raises MeasurementError when there is no such topic, or when it has neither joints nor points.
    """
    of, kinds, others = "", list[str](), 0
    joints, points = list[_Joints](), list[_Point]()
    recorded, stamped = array("d"), array("d")
    with _opened(path) as reader:
        zero = int(reader.start_time)
        # Of one file it is counted, and not told.
        stated = sum(one.msgcount for one in reader.connections if one.topic == name) if path.is_dir() else 0
        for _, kind, told, time, message in _messages(reader, path, name):
            kinds.append(kind)
            of = of or told.of
            if told.of != of or not of:
                others += 1
                continue
            seconds = _NANO * (((_stamp(message) if told.stamped else 0) or time) - zero)
            recorded.append(time)
            stamped.append(seconds)
            if of == "joints":
                joints.append((seconds, tuple(message.name), tuple(map(float, message.position))))
            else:
                frame = message.header.frame_id.removeprefix("/") if told.framed else ""
                points.append((frame, [seconds, *_point_of(message, told)]))
    if not kinds:
        known = [topic.name for topic in topics(path)]
        close = near(name, known, most=1)
        raise MeasurementError(
            f"{path}: there is no topic {shown(name)}{f'; near is {close[0]!r}' if close else ''}; there are "
            f"{listed(known)}."
        )
    if not of:
        raise MeasurementError(f"{path}: messages of {shown(name)} are {shown(kinds[0])}: neither joints nor points.")
    at = f"{path}: {shown(name)}"
    _refuse_jump(np.asarray(recorded), np.asarray(stamped), at)
    titles, rows, remarks = _joint_rows(joints, at) if of == "joints" else (_TITLES[of], *_point_rows(points))
    if others:
        remarks.append(f"{counted(others, 'message')} of another type left out")
    if len(kinds) < stated:
        remarks.append(f"metadata.yaml tells of {counted(stated, 'message')}, and {len(kinds)} are there")
    if not rows:
        raise MeasurementError(f"{path}: no message of {shown(name)} has positions of joints.")
    # So do trackers tell that they have lost their target.
    known_rows = [row for row in rows if all(map(math.isfinite, row))]
    if not known_rows:
        raise MeasurementError(f"{at}: every message has a number that is none (nan or inf).")
    if lost := len(rows) - len(known_rows):
        remarks.append(f"{counted(lost, 'message')} with a number that is none (nan or inf) left out")
    told_times = np.array([row[0] for row in known_rows])
    if late := int((told_times < np.maximum.accumulate(told_times)).sum()):
        known_rows.sort(key=itemgetter(0))
        remarks.append(f"{counted(late, 'message')} came behind later ones: rows are in the order of their times")
    said = f"time 0 is {_NANO * zero:.3f} s of the recording's clock"
    return Sheet(titles, tuple(tuple(map(repr, row)) for row in known_rows), str(path), (said, *remarks))


def _refuse_jump(recorded: Array, stamped: Array, at: str) -> None:
    """Raise MeasurementError where the clock of messages was set back: in the order of times, two motions would mix.

    ``recorded`` (n,) and ``stamped`` (n,): when, by the recorder and by the message.
    """
    told = stamped[np.argsort(recorded, kind="stable")]
    back = np.maximum.accumulate(told) - told
    if (back > _LATEST).any():
        k = int(np.argmax(back > _LATEST))
        raise MeasurementError(
            f"{at}: the times that messages tell jump back by {back[k]:.1f} s, to {told[k]:.3f} s, as of a clock that "
            "was set, or of a motion that was played again; cut the recording there."
        )


def _joint_rows(told: list[_Joints], at: str) -> tuple[tuple[str, ...], list[list[float]], list[str]]:
    """Return titles, rows and remarks of joints: of the messages with the joints that most have, in any order."""
    found = [one for one in told if one[2]]
    sets = Counter(tuple(sorted(names)) for _, names, position in found if len(names) == len(position))
    if not sets:
        return (), [], []
    common, many = sets.most_common(1)[0]
    if len(set(common)) < len(common) or not all(name.strip() for name in common):
        raise MeasurementError(f"{at}: has the joints {listed(common)}; each needs a name of its own.")
    times, names, moved = list[float](), tuple[str, ...](), list[list[float]]()
    for time, own, position in found:
        if len(own) == len(position) and tuple(sorted(own)) == common:
            names = names or own
            places = dict(zip(own, position, strict=True))
            times.append(time)
            moved.append([places[name] for name in names])
    remarks = ["joints that slide are in m: change the unit of their columns"]
    # So does ros2_control tell that a joint, such as a wheel, has none.
    told_of = [bool(known) for known in np.any(np.isfinite(moved), axis=0)]
    if unknown := [name for name, known in zip(names, told_of, strict=True) if not known and any(told_of)]:
        what = "has no position in any message, and is" if len(unknown) == 1 else "have no position, and are"
        remarks.append(f"{listed(unknown)} {what} left out")
        names = tuple(compress(names, told_of))
        moved = [list(compress(row, told_of)) for row in moved]
    rows = [[time, *row] for time, row in zip(times, moved, strict=True)]
    if many < len(told):
        remarks.append(f"{counted(len(told) - many, 'message')} of other joints, or without positions, left out")
    return ("time [s]", *(f"{name} [rad]" for name in names)), rows, remarks


def _point_rows(told: list[_Point]) -> tuple[list[list[float]], list[str]]:
    """Return rows and remarks of points: of the frame in which most of them are told, as numbers of others differ."""
    frames = Counter(frame for frame, _ in told)
    common = frames.most_common(1)[0][0]
    others = [frame for frame in frames if frame != common]
    remarks = [
        f"{counted(len(told) - frames[common], 'message')} in {listed(others)} left out: rows are in {shown(common)}"
    ]
    return [row for frame, row in told if frame == common], remarks if others else []


def _point_of(message: Any, told: Told) -> list[float]:
    """Return the numbers of a message with a point or a pose, in the order of its columns."""
    found = []
    for way, axes in ((told.point, "xyz"), (told.turn, "wxyz" if told.turn else "")):
        part = message
        for name in way:
            part = getattr(part, name)
        found += [float(getattr(part, axis)) for axis in axes]
    return found


def _topic(name: str, kind: str, of: str, times: Array) -> Topic:
    seconds = _NANO * np.diff(np.sort(times))
    whole = float(np.sum(seconds))
    rate = len(seconds) / whole if whole > 0.0 else 0.0
    return Topic(name, kind, len(times), rate, float(seconds.max(initial=0.0)), of)


def _stamp(message: Any) -> int:
    """Return when a message was made, in ns: what its header says, which is 0 where nobody has set it."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _messages(reader: Any, path: Path, wanted: str | None) -> Iterator[tuple[str, str, Told, int, Any]]:
    """Yield topic, type, what it can become, time of recording and message; of transforms every frame by itself.

    What can become nothing, and what is only to be listed, is not read: its message is None.
    """
    # A column of SQLite holds what was put there, whatever it says that it holds.
    if not all(isinstance(word, str) for one in reader.connections for word in (one.topic, one.msgtype)):
        raise MeasurementError(f"{path}: has a topic whose name or type is no text.")
    types = reader.typestore.fielddefs
    told = {kind: told_by(types, kind) for kind in {one.msgtype for one in reader.connections}}
    chosen = [one for one in reader.connections if wanted is None or _may_hold(one, told[one.msgtype], wanted)]
    if not chosen:
        return
    values = Values(path, _size(path), types)
    for count, (connection, time, raw) in enumerate(reader.messages(connections=chosen)):
        if count >= _MOST_MESSAGES:
            raise MeasurementError(f"{path}: has more than {_MOST_MESSAGES} messages; cut it into parts.")
        if not isinstance(time, int):
            raise MeasurementError(f"{path}: has a message whose time is no whole number.")
        name, kind = connection.topic, connection.msgtype
        of = told[kind]
        if not of.of or (wanted is None and not of.frames):
            values.pass_by()
            yield name, kind, of, time, None
            continue
        values.read(kind, raw)
        message = reader.deserialize(raw, kind)
        if not of.frames:
            yield name, kind, of, time, message
            continue
        for transform in message.transforms:
            if wanted is None or wanted == f"{name}:{transform.child_frame_id}":
                yield f"{name}:{transform.child_frame_id}", kind, of, time, transform


def _may_hold(connection: Any, told: Told, wanted: str) -> bool:
    """Return whether a topic, or a frame of transforms, of this name is among the messages of a connection."""
    if told.frames:
        return wanted.startswith(f"{connection.topic}:")
    return bool(connection.topic == wanted)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a recording; whatever its reader says of damage is one sentence."""
    _refuse_irregular(path)
    need, absent = f"{path}: recordings of ROS need the package rosbags", ": pip install 'urdf-calib[bags]'"
    with needed(MeasurementError, need, absent):
        from apsw import Error as SqliteError  # noqa: PLC0415 - an extra
        from rosbags.highlevel import AnyReader, AnyReaderError  # noqa: PLC0415
        from rosbags.rosbag1 import ReaderError as Rosbag1Error  # noqa: PLC0415
        from rosbags.rosbag2 import ReaderError as Rosbag2Error  # noqa: PLC0415
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415
        from ruamel.yaml.error import YAMLError  # noqa: PLC0415
    # Those of ROS 1 define all their messages, whose headers are others.
    usual = None if path.suffix == ".bag" else get_typestore(Stores.ROS2_HUMBLE)
    try:
        _refuse_metadata(path / "metadata.yaml")
        with (
            limited(path, _size(path)),
            AnyReader([path], default_typestore=usual) as reader,
        ):
            _define(reader, usual)
            yield reader
    except MeasurementError:
        raise
    except (AnyReaderError, Rosbag1Error, Rosbag2Error) as e:
        # Such as that it has no index, or another profile.
        raise MeasurementError(f"{path}: is no recording that can be read; rosbags says {shown(str(e))}.") from e
    except (SqliteError, YAMLError, *DAMAGED) as e:
        raise MeasurementError(f"{path}: is no recording that can be read ({type(e).__name__}).") from e


def _define(reader: Any, usual: Any) -> None:
    """Give types that a recording does not define their ``usual`` definitions, where there are any."""
    known = reader.typestore.fielddefs
    if usual is not None and any(one.msgtype not in known for one in reader.connections):
        reader.typestore.register({kind: usual.fielddefs[kind] for kind in usual.fielddefs.keys() - known.keys()})


def _size(path: Path) -> int:
    """Return how many bytes a recording has; of a folder all its files."""
    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files)


def _refuse_metadata(file: Path) -> None:
    """Raise MeasurementError where the metadata of a folder would take long to build; rosbags builds what it finds.

    Also where they list a file twice, or not all that are there: messages would be doubled, or missing in silence.
    """
    from ruamel.yaml import YAML  # noqa: PLC0415 - of rosbags

    if not file.exists():
        return
    text = read_bytes(file, MeasurementError, _LARGEST_METADATA).decode()
    if wrong := trouble(YAML(typ="safe", pure=True).parse(text), _MOST_METADATA):
        raise MeasurementError(f"{file}: {wrong}.")
    told = YAML(typ="safe", pure=True).load(text)
    try:
        names = [PurePath(name).name for name in told["rosbag2_bagfile_information"]["relative_file_paths"]]
    except (KeyError, TypeError):
        return  # rosbags says it
    if twice := [name for name, times in Counter(names).items() if times > 1]:
        raise MeasurementError(f"{file}: lists {listed(twice)} more than once.")
    if others := [name for name in _recorded(file.parent) if name not in names]:
        raise MeasurementError(
            f"{file}: does not list {listed(others)}, which is there as well; move it away, or let ros2 bag reindex "
            "write the list anew."
        )


def _refuse_irregular(path: Path) -> None:
    """Raise MeasurementError for what is not there, and for pipes and devices, which a reader would wait for."""
    with sentences(path, MeasurementError):
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        for file in files:
            if not file.exists():
                raise MeasurementError(f"{file}: no such file or folder.")
            if not (file.is_file() or (file.is_dir() and file != path)):
                raise MeasurementError(f"{file}: is not a regular file.")
        if path.is_file() and path.suffix != path.suffix.lower():
            raise MeasurementError(f"{path}: call it {path.suffix.lower()}: rosbags reads no ending in capitals.")
        if path.is_dir() and not (path / "metadata.yaml").exists() and (names := _recorded(path)):
            raise MeasurementError(
                f"{path}: has no metadata.yaml, as the recorder was not closed; give {listed(names)}, or let ros2 bag "
                "reindex make it."
            )
