"""Recordings of ROS 1, ROS 2 and MCAP, written here, and logs of others, as tables."""

import bz2
import contextlib
import csv
import io
import json
import os
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calib.foundations.errors import MeasurementError
from calib.measurement.formats import message_types, recordings, unpacking
from calib.measurement.formats.recordings import read_topic, topics
from calib.measurement.formats.sheet import Sheet, read_sheet
from scripts.development.fuzz_sensors import MOTIVE as MOTIVE_BYTES
from tests.support.cases import run

MOTIVE = MOTIVE_BYTES.decode()

rosbags = pytest.importorskip("rosbags", reason="needs rosbags: pip install 'urdf-calib[bags]'")
KINDS = ("ros1", "ros2", "mcap")
BEGIN = 1_700_000_000_000_000_000


def messages(store: Any, ros1: bool) -> Iterator[tuple[str, str, int, Any]]:
    """Joints at 100 Hz with a gap, poses at 50 Hz, transforms of two frames, and a text; stamps are 2 ms older."""
    T = store.types
    header, stamp = T["std_msgs/msg/Header"], T["builtin_interfaces/msg/Time"]
    none = np.zeros(0)

    def head(t: int) -> Any:
        made = stamp(sec=t // 10**9, nanosec=t % 10**9)
        return header(seq=0, stamp=made, frame_id="world") if ros1 else header(stamp=made, frame_id="world")

    def point(kind: str, k: int) -> Any:
        return T[f"geometry_msgs/msg/{kind}"](x=0.1 * k, y=2.0, z=-3.0)

    turn = T["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.6, w=0.8)
    for k in range(40):
        t = BEGIN + k * 10_000_000
        if not 10 <= k < 20:
            joints = T["sensor_msgs/msg/JointState"]
            yield (
                "/joint_states",
                joints.__msgtype__,
                t,
                joints(
                    header=head(t - 2_000_000),
                    name=["a", "b"],
                    position=np.array([0.1 * k, -1.0]),
                    velocity=none,
                    effort=none,
                ),
            )
        if k % 2 == 0:
            pose = T["geometry_msgs/msg/PoseStamped"]
            inside = T["geometry_msgs/msg/Pose"](position=point("Point", k), orientation=turn)
            yield "/tracker", pose.__msgtype__, t, pose(header=head(t - 2_000_000), pose=inside)
            bare = T["geometry_msgs/msg/Point"]
            yield "/ball", bare.__msgtype__, t, point("Point", k)
            transforms = [
                T["geometry_msgs/msg/TransformStamped"](
                    header=head(t),
                    child_frame_id=name,
                    transform=T["geometry_msgs/msg/Transform"](translation=point("Vector3", k), rotation=turn),
                )
                for name in ("flange", "camera")
            ]
            many = T["tf2_msgs/msg/TFMessage"]
            yield "/tf", many.__msgtype__, t, many(transforms=transforms)
    text = T["std_msgs/msg/String"]
    yield "/told", text.__msgtype__, BEGIN, text(data="hello")


def recording(folder: Path, kind: str, packed: str = "") -> Path:
    """A recording of a kind, written by rosbags; ``packed``: by this method of ROS 1, or "storage" or "message"."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore
    from rosbags.typesys import get_types_from_msg as types_of

    ros1 = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if "tf2_msgs/msg/TFMessage" not in store.types:
        store.register(types_of("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    path = folder / ("one.bag" if ros1 else kind)
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    made = Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin)
    if packed and ros1:
        made.set_compression(Writer1.CompressionFormat[packed])
    elif packed:
        made.set_compression(CompressionMode[packed], CompressionFormat.ZSTD)
    with made as writer:
        known: dict[str, Any] = {}
        for topic, type_, time, message in messages(store, ros1):
            if topic not in known:
                known[topic] = writer.add_connection(topic, type_, typestore=store)
            raw = store.serialize_ros1(message, type_) if ros1 else store.serialize_cdr(message, type_)
            writer.write(known[topic], time, raw)
    return path


@pytest.fixture(scope="module", params=KINDS)
def recorded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recording(tmp_path_factory.mktemp(request.param), request.param)


def numbers(sheet: Sheet) -> np.ndarray:
    return np.array(sheet.rows, dtype=float)


def test_topics_are_listed_with_rates_and_gaps(recorded: Path) -> None:
    found = {topic.name: topic for topic in topics(recorded)}
    assert {name: topic.of for name, topic in found.items()} == {
        "/ball": "point",
        "/joint_states": "joints",
        "/tf:camera": "pose",
        "/tf:flange": "pose",
        "/told": "",
        "/tracker": "pose",
    }
    joints = found["/joint_states"]
    assert joints.messages == 30
    assert joints.rate == pytest.approx(29 / 0.39)
    assert joints.gap == pytest.approx(0.11)
    assert found["/tracker"].rate == pytest.approx(50.0)


def test_joints_and_poses_become_tables_with_one_zero(recorded: Path) -> None:
    joints, tracker = (read_topic(recorded, name) for name in ("/joint_states", "/tracker"))
    assert joints.titles == ("time [s]", "a [rad]", "b [rad]")
    k = np.array([k for k in range(40) if not 10 <= k < 20])
    np.testing.assert_allclose(numbers(joints), np.column_stack([0.01 * k - 0.002, 0.1 * k, -1.0 + 0 * k]), atol=1e-9)
    assert tracker.titles == ("time [s]", "x [m]", "y [m]", "z [m]", "qw", "qx", "qy", "qz")
    np.testing.assert_allclose(numbers(tracker)[:, 0], 0.02 * np.arange(20) - 0.002, atol=1e-9)
    np.testing.assert_allclose(numbers(tracker)[1], [0.018, 0.2, 2.0, -3.0, 0.8, 0.0, 0.0, 0.6])


def test_points_and_transforms_become_tables_too(recorded: Path) -> None:
    ball, flange = read_topic(recorded, "/ball"), read_topic(recorded, "/tf:flange")
    assert ball.titles == ("time [s]", "x [m]", "y [m]", "z [m]")
    np.testing.assert_allclose(numbers(ball)[2], [0.04, 0.4, 2.0, -3.0], atol=1e-9)
    np.testing.assert_allclose(numbers(flange)[2], [0.04, 0.4, 2.0, -3.0, 0.8, 0.0, 0.0, 0.6], atol=1e-9)


def test_recordings_are_read_alike_in_several_threads(recorded: Path) -> None:
    """While one is read, rosbags has other parts; these belong to the process, and stayed if another one was begun."""
    from rosbags.rosbag2 import storage_mcap

    before = dict(storage_mcap.DECOMPRESSORS)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: read_topic(recorded, "/tracker").rows, range(12)))
    assert found == [read_topic(recorded, "/tracker").rows] * 12
    assert before == storage_mcap.DECOMPRESSORS


def test_other_topics_and_damaged_files_are_refused(recorded: Path, tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match=r"there is no topic '/trackr'; near is '/tracker'; there are"):
        read_topic(recorded, "/trackr")
    with pytest.raises(MeasurementError, match="neither joints nor points"):
        read_topic(recorded, "/told")
    for name in ("bad.bag", "bad.mcap", "bad.db3"):
        (tmp_path / name).write_bytes(b"not a recording")
        with pytest.raises(MeasurementError, match="is no recording that can be read"):
            topics(tmp_path / name)
    with pytest.raises(MeasurementError, match="no such file or folder"):
        topics(tmp_path / "none.bag")


@pytest.mark.parametrize("ending", [".BAG", ".Mcap"])
def test_an_ending_in_capitals_is_to_be_changed(ending: str, tmp_path: Path) -> None:
    (tmp_path / f"a{ending}").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(MeasurementError, match=rf"a{ending}: call it {ending.lower()}: rosbags reads"):
        topics(tmp_path / f"a{ending}")


def test_why_a_recording_cannot_be_read_is_said(tmp_path: Path) -> None:
    path = recording(tmp_path, "ros1")
    data = path.read_bytes()
    at = data.index(b"index_pos=") + len(b"index_pos=")
    path.write_bytes(data[:at] + bytes(8) + data[at + 8 :])  # as it is while it is recorded
    with pytest.raises(
        MeasurementError, match=r"can be read; rosbags says 'Bag is not indexed, reindex before reading\.'"
    ):
        topics(path)
    cut = of_mcap(tmp_path / "cut.mcap", [*range(9)], chunk=True)
    cut.write_bytes(cut.read_bytes()[:-20])
    with pytest.raises(MeasurementError, match=r"can be read; rosbags says 'File end magic is invalid\.'"):
        topics(cut)


def of_joints(
    path: Path, topic: str, told: list[tuple[list[str], list[float]]], stamps: list[float] | None = None
) -> Path:
    """A recording of one topic of joints, with these names and positions; ``stamps``: in s, else a ms apart."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    T, kind = store.types, "sensor_msgs/msg/JointState"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topic, kind, typestore=store)
        for k, (names, position) in enumerate(told):
            late = 1_000_000 * k if stamps is None else round(1e9 * stamps[k])
            told_at = T["builtin_interfaces/msg/Time"](1_700_000_000 + late // 10**9, late % 10**9)
            head = T["std_msgs/msg/Header"](told_at, "")
            message = T[kind](head, names, np.array(position), np.zeros(0), np.zeros(0))
            writer.write(connection, BEGIN + 1_000_000 * k, store.serialize_cdr(message, kind))
    return path


def test_a_clock_that_is_set_back_does_not_mix_two_motions(tmp_path: Path) -> None:
    told = [(["a"], [float(k)]) for k in range(6)]
    late = read_topic(of_joints(tmp_path / "late", "/j", told, [0.0, 0.2, 0.1, 0.15, 0.3, 0.4]), "/j")
    np.testing.assert_allclose(numbers(late)[:, 1], [0.0, 2.0, 3.0, 1.0, 4.0, 5.0])
    assert late.remarks[-1] == "2 messages came behind later ones: rows are in the order of their times"
    again = of_joints(tmp_path / "again", "/j", told, [0.0, 5.0, 10.0, 0.5, 5.5, 10.5])
    with pytest.raises(MeasurementError, match=r"again: '/j': the times that messages tell jump back by 9\.5 s, to "):
        read_topic(again, "/j")


def test_joints_in_another_order_are_the_same_joints(tmp_path: Path) -> None:
    sheet = read_topic(of_joints(tmp_path / "r", "/j", [(["b", "a"], [2.0, 1.0]), (["a", "b"], [3.0, 4.0])]), "/j")
    assert sheet.titles == ("time [s]", "b [rad]", "a [rad]")
    np.testing.assert_allclose(numbers(sheet)[:, 1:], [[2.0, 1.0], [4.0, 3.0]])


def of_poses(path: Path, topic: str, kind: str, told: list[tuple[str, float]]) -> Path:
    """A recording of one topic of stamped poses, or of transforms of a marker: the frame, and x, of each."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    T = store.types
    turn = T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topic, kind, typestore=store)
        for k, (frame, x) in enumerate(told):
            head = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](1_700_000_000, 1_000_000 * k), frame)
            if kind == "tf2_msgs/msg/TFMessage":
                move = T["geometry_msgs/msg/Transform"](T["geometry_msgs/msg/Vector3"](x, 0.0, 0.0), turn)
                message = T[kind]([T["geometry_msgs/msg/TransformStamped"](head, "marker", move)])
            else:
                place = T["geometry_msgs/msg/Pose"](T["geometry_msgs/msg/Point"](x, 0.0, 0.0), turn)
                message = T[kind](head, place)
            writer.write(connection, BEGIN + 1_000_000 * k, store.serialize_cdr(message, kind))
    return path


@pytest.mark.parametrize(
    ("topic", "kind"), [("/tracker", "geometry_msgs/msg/PoseStamped"), ("/tf:marker", "tf2_msgs/msg/TFMessage")]
)
def test_rows_are_of_one_frame_and_others_are_said(topic: str, kind: str, tmp_path: Path) -> None:
    told = [("/one", 1.0), ("two", 7.0), ("one", 2.0)]  # tf once wrote a slash before every frame
    sheet = read_topic(of_poses(tmp_path / "r", topic.partition(":")[0], kind, told), topic)
    np.testing.assert_allclose(numbers(sheet)[:, 1], [1.0, 2.0])
    assert sheet.remarks[-1] == "1 message in 'two' left out: rows are in 'one'"


def test_a_topic_may_have_a_colon(tmp_path: Path) -> None:
    assert len(read_topic(of_joints(tmp_path / "r", "/arm:j", [(["a"], [1.0])]), "/arm:j").rows) == 1


def test_numbers_that_are_none_are_left_out_and_said(tmp_path: Path) -> None:
    sheet = read_topic(of_joints(tmp_path / "r", "/j", [(["a"], [1.0]), (["a"], [np.nan]), (["a"], [np.inf])]), "/j")
    assert len(sheet.rows) == 1
    assert sheet.remarks[-1] == "2 messages with a number that is none (nan or inf) left out"
    with pytest.raises(MeasurementError, match=r"r2: '/j': every message has a number that is none \(nan or inf\)\.$"):
        read_topic(of_joints(tmp_path / "r2", "/j", [(["a"], [np.nan])]), "/j")


def test_joints_without_positions_are_left_out_and_said(tmp_path: Path) -> None:
    told = [(["a", "wheel", "b"], [1.0, np.nan, 3.0]), (["wheel", "a", "b"], [np.nan, 1.5, np.nan])]
    sheet = read_topic(of_joints(tmp_path / "r", "/j", told), "/j")
    assert sheet.titles == ("time [s]", "a [rad]", "b [rad]")
    np.testing.assert_allclose(numbers(sheet)[:, 1:], [[1.0, 3.0]])
    assert "'wheel' has no position in any message, and is left out" in sheet.remarks


@pytest.mark.parametrize("names", [["a", "a"], ["a", " "]])
def test_joints_need_names_of_their_own(names: list[str], tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match=r"r: '/j': has the joints .* each needs a name of its own\.$"):
        read_topic(of_joints(tmp_path / "r", "/j", [(names, [1.0, 2.0])]), "/j")


def test_a_recording_of_nothing(tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match=r"r: has no messages that can be read\.$"):
        read_topic(of_joints(tmp_path / "r", "/j", []), "/j")


def test_a_folder_without_metadata_is_told_what_to_do(tmp_path: Path) -> None:
    path = recording(tmp_path, "mcap")
    (path / "metadata.yaml").unlink()
    said = run("import", path)
    assert (said.code, said.out) == (1, "")
    assert "has no metadata.yaml, as the recorder was not closed; give 'mcap.mcap', or let ros2 bag reindex" in said.err
    assert run("import", path / "mcap.mcap").code == 0
    # Beside photographs, a recording is not meant.
    said = run("import", "images", path, "-o", tmp_path / "t.csv")
    assert said.err.endswith("images takes one folder, --board and --readings.\n")


def test_the_command_lists_and_writes(tmp_path: Path) -> None:
    path = recording(tmp_path, "mcap")
    said = run("import", path, "--json")
    assert said.code == 0
    assert [topic["name"] for topic in json.loads(said.out)["topics"]][:2] == ["/ball", "/joint_states"]
    out = tmp_path / "joints.csv"
    assert run("import", path, "--topic", "/joint_states", "-o", out).code == 0
    rows = list(csv.reader(io.StringIO(out.read_text())))
    assert rows[0] == ["time [s]", "a [rad]", "b [rad]"]
    assert len(rows) == 31
    assert run("import", path, "--topic", "/joint_states").code == 2


def test_a_log_of_rtde_has_time_and_joints(tmp_path: Path) -> None:
    titles = ["timestamp", *(f"target_q_{k}" for k in range(6)), *(f"actual_q_{k}" for k in range(6)), "runtime_state"]
    rows = [[str(x) for x in (100.0 + 0.008 * n, *[9.0] * 6, *(0.1 * k + n for k in range(6)), 1)] for n in range(5)]
    path = tmp_path / "robot_data.csv"
    path.write_text("\n".join(" ".join(row) for row in [titles, *rows]) + "\n")
    sheet = read_sheet(path)
    assert sheet.titles[:2] == ("time [s]", "shoulder_pan_joint [rad]")
    assert sheet.titles[7] == "commanded_shoulder_pan_joint [rad]"
    np.testing.assert_allclose(numbers(sheet)[2], [100.016, 2.0, 2.1, 2.2, 2.3, 2.4, 2.5, *[9.0] * 6])


def test_a_short_log_of_rtde_whose_last_row_is_cut_is_told_so(tmp_path: Path) -> None:
    path = tmp_path / "robot_data.csv"
    titles = ["timestamp", *(f"actual_q_{k}" for k in range(6))]
    path.write_text(" ".join(titles) + "\n1.0 1 2 3 4 5 6\n1.1 1 2 3 4 5 6\n1.2 1 2\n")
    with pytest.raises(MeasurementError, match=r"robot_data.csv:4: .* 7 cells .* 3"):
        read_sheet(path)


def test_an_export_of_motive_has_its_rigid_body(tmp_path: Path) -> None:
    path = tmp_path / "take.csv"
    path.write_text(MOTIVE)
    sheet = read_sheet(path)
    assert sheet.titles == ("time [s]", "x [m]", "y [m]", "z [m]", "qw", "qx", "qy", "qz")
    expected = [[0.0, 1.0, 2.0, 3.0, 0.8, 0, 0, 0.6], [0.016667, 1.1, 2.0, 3.0, 0.8, 0, 0, 0.6]]
    np.testing.assert_allclose(numbers(sheet), expected)
    assert sheet.remarks == ("the rigid body 'tool' of Motive; 1 frame that lost it is left out",)
    with pytest.raises(MeasurementError, match="has no rigid body 'probe'; there are 'tool'"):
        read_sheet(path, "probe")


def test_exports_of_motive_without_their_header_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "take.csv"
    for cut, said in (("Time (Seconds)", "no column 'Time"), (",Name", "lacks the lines of its header")):
        lines = [line for line in MOTIVE.splitlines() if not line.startswith(cut)]
        lines = [line.replace("Time (Seconds)", "") for line in lines]
        if cut == ",Name":
            lines = [line for line in lines if not line.startswith((",ID", ",,Rotation"))]
        path.write_text("\n".join(lines))
        with pytest.raises(MeasurementError, match=said):
            read_sheet(path)


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("2,0.033,0,0", r":\d+: has 4 cells, and its columns are \d+\."),
        ("2,0.033,0,0,0.6,0.8,1.1,2.0,3;0", r":\d+: '3;0' is not a number like 12.5 or 1.25e1\."),
    ],
)
def test_a_row_of_motive_that_is_no_lost_frame_is_not_left_out(tmp_path: Path, row: str, says: str) -> None:
    path = tmp_path / "take.csv"
    path.write_text(f"{MOTIVE.rstrip()}\n{row}\n")
    with pytest.raises(MeasurementError, match=says):
        read_sheet(path)


def test_numbers_units_and_rotations_of_motive_are_those_that_it_states(tmp_path: Path) -> None:
    path = tmp_path / "take.csv"
    path.write_text(MOTIVE.replace("1.1,", "+1.1E+0,"))
    assert len(read_sheet(path).rows) == 2
    path.write_text(MOTIVE.replace("Quaternion", "XYZ"))
    assert read_sheet(path).remarks[0].endswith("; its rotations are 'XYZ', not Quaternion, and left out")
    path.write_text(MOTIVE.replace("Time (Seconds)", "Time (Milliseconds)"))
    with pytest.raises(MeasurementError, match=r"has no column 'Time \(Seconds\)'"):
        read_sheet(path)


def test_a_table_in_degrees_with_the_names_of_rtde_is_no_log_of_it(tmp_path: Path) -> None:
    names = ["timestamp", *(f"actual_q_{k} [deg]" for k in range(6))]
    (tmp_path / "log.csv").write_text(f"{','.join(names)}\n{','.join('0' * 7)}\n")
    assert read_sheet(tmp_path / "log.csv").titles == tuple(names)


def test_a_pipe_is_no_recording_and_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "one.bag")
    folder = tmp_path / "bag"
    folder.mkdir()
    os.mkfifo(folder / "metadata.yaml")
    for path, named in ((tmp_path / "one.bag", "one.bag"), (folder, "metadata.yaml")):
        with pytest.raises(MeasurementError, match=f"{named}: is not a regular file"):
            topics(path)


PACKED = (("ros1", "BZ2"), ("ros1", "LZ4"), ("mcap", "STORAGE"), ("ros2", "MESSAGE"), ("mcap", "MESSAGE"))


_LAUGHS = "".join(f"a{k + 1}: &a{k + 1} [{', '.join([f'*a{k}'] * 9)}]\n" for k in range(9))


def test_what_metadata_say_of_files_and_messages_is_held_against_what_is_there(tmp_path: Path) -> None:
    import sqlite3

    path = recording(tmp_path, "ros2")
    metadata, file = path / "metadata.yaml", path / "ros2.db3"
    text = metadata.read_text()
    with contextlib.closing(sqlite3.connect(file)) as database:
        database.execute("DELETE FROM messages WHERE id % 2 = 0")
        database.commit()
    assert read_topic(path, "/joint_states").remarks[-1] == "metadata.yaml tells of 30 messages, and 16 are there"
    metadata.write_text(text.replace("- ros2.db3\n", "- ros2.db3\n  - x/ros2.db3\n"))
    with pytest.raises(MeasurementError, match=r"metadata\.yaml: lists 'ros2\.db3' more than once\.$"):
        topics(path)
    metadata.write_text(text)
    (path / "ros2_1.db3").write_bytes(file.read_bytes())
    with pytest.raises(
        MeasurementError, match=r"metadata\.yaml: does not list 'ros2_1\.db3', which is there as well; "
    ):
        topics(path)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (f"a0: &a0 [1, 1]\n{_LAUGHS}", "has anchors and aliases, which are not read"),
        ("deep: " + 100_000 * "[", "is nested too deep"),
        ("many: [" + 40_000 * "1," + "1]\n", "has more than 30000 values"),
        ("version: 5\nversion: 6\n", "is no YAML that can be read: it has 'version' twice in one object"),
    ],
)
def test_metadata_that_would_take_long_are_refused(tmp_path: Path, more: str, says: str) -> None:
    """The reader of recordings builds, and walks through, whatever is there."""
    path = recording(tmp_path, "ros2")
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text() + more)
    with pytest.raises(MeasurementError) as caught:
        topics(path)
    assert str(caught.value) == f"{metadata}: {says}."


@pytest.mark.parametrize(("kind", "packed"), PACKED)
def test_packed_recordings_are_read_as_others_and_no_further_than_their_limit(
    kind: str, packed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = recording(tmp_path, kind, packed)
    assert len(read_topic(path, "/joint_states").rows) == 30
    monkeypatch.setattr(unpacking, "LARGEST_CHUNK", 50)
    with pytest.raises(MeasurementError, match="unpacks to more than 50 bytes at once"):
        read_topic(path, "/joint_states")


def test_unpacking_stops_at_what_a_recording_may_hold_in_all(tmp_path: Path) -> None:
    piece = bz2.compress(bytes(100_000_000))
    unpacker = unpacking.Unpacker(tmp_path, 1000)
    for _ in range(2):
        assert len(unpacker.unpacked(bz2.BZ2Decompressor, piece)) == 100_000_000
    with pytest.raises(MeasurementError, match="in all to more than 200 times its size"):
        unpacker.unpacked(bz2.BZ2Decompressor, piece)
    with pytest.raises(ValueError, match="ends too early"):
        unpacking.Unpacker(tmp_path, 1000).unpacked(bz2.BZ2Decompressor, piece[:-8])


def _field(name: bytes, value: bytes) -> bytes:
    return struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value


def _record(op: int, header: bytes, data: bytes) -> bytes:
    header += _field(b"op", bytes([op]))
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def of_ros1(path: Path, inside: bytes, entries: int = 1, *, after: bytes = b"") -> Path:
    """A bag of one chunk that has ``inside`` packed by bz2, to whose beginning so many entries of its index point."""
    packed = bz2.compress(inside) + after
    began = struct.pack("<II", 1, 0)

    def head(index: int) -> bytes:
        counts = _field(b"conn_count", struct.pack("<I", 1)) + _field(b"chunk_count", struct.pack("<I", 1))
        return b"#ROSBAG V2.0\n" + _record(3, _field(b"index_pos", struct.pack("<Q", index)) + counts, b"")

    size = _field(b"compression", b"bz2") + _field(b"size", struct.pack("<I", len(inside)))
    chunk = _record(5, size, packed)
    of_index = [_field(name, struct.pack("<I", n)) for name, n in ((b"ver", 1), (b"conn", 0), (b"count", entries))]
    index = _record(4, b"".join(of_index), entries * struct.pack("<III", 1, 0, 0))
    topic = _field(b"conn", struct.pack("<I", 0)) + _field(b"topic", b"/t")
    definition = _field(b"type", b"geometry_msgs/Point") + _field(b"md5sum", b"4a842b65f413084dc2b10fb484ea7f17")
    connection = _record(7, topic, definition + _field(b"message_definition", b"float64 x\nfloat64 y\nfloat64 z\n"))
    times = _field(b"start_time", began) + _field(b"end_time", began) + _field(b"count", struct.pack("<I", 1))
    place = _field(b"ver", struct.pack("<I", 1)) + _field(b"chunk_pos", struct.pack("<Q", len(head(0))))
    info = _record(6, place + times, struct.pack("<II", 0, entries))
    path.write_bytes(head(len(head(0)) + len(chunk) + len(index)) + chunk + index + connection + info)
    return path


MESSAGE = _record(2, _field(b"conn", bytes(4)) + _field(b"time", struct.pack("<II", 1, 0)), bytes(24))


LARGE = _record(2, _field(b"conn", bytes(4)) + _field(b"time", struct.pack("<II", 1, 0)), bytes(200_000))


@pytest.mark.parametrize(
    ("inside", "entries", "after", "says"),
    [
        # Of a million and 50 entries a file has 7 kB.
        (1000 * _record(7, b"", b"") + MESSAGE, 20, b"", "more records than a recording"),
        (MESSAGE, 1, 10_000 * bz2.compress(b""), "more records than a recording"),
        (_record(2, _field(b"", bytes(6000)), b""), 1, b"", "a header of more than 5000 bytes"),
        (LARGE, 100, b"", "in all to more than 200 times its size"),
    ],
    ids=("records", "streams", "header", "bytes"),
)
def test_what_an_index_of_ros1_points_to_is_read_no_more_often_than_its_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, inside: bytes, entries: int, after: bytes, says: str
) -> None:
    monkeypatch.setattr(unpacking, "LEAST_RECORDS", 5000)
    monkeypatch.setattr(unpacking, "RECORDS_PER_BYTE", 0)
    monkeypatch.setattr(unpacking, "LARGEST_HEADER", 5000)
    monkeypatch.setattr(unpacking, "LEAST_TOTAL", 10_000_000)
    assert [one.messages for one in topics(of_ros1(tmp_path / "good.bag", MESSAGE, 3))] == [3]
    path = of_ros1(tmp_path / "small.bag", inside, entries, after=after)
    with pytest.raises(MeasurementError, match=says):
        topics(path)


def of_mcap(path: Path, order: list[int], *, chunk: bool, index: bool = True) -> Path:
    """A recording of poses in MCAP, written by hand in this order: ``x`` of each is its number, and so are its ms.

    ``index``: a chunk has an index of its messages, which writers may leave out.
    """
    made = of_poses(path.with_suffix(""), "/p", "geometry_msgs/msg/PoseStamped", [("w", float(k)) for k in range(9)])
    inside = (made / f"{made.name}.mcap").read_bytes()
    at = inside.index(b"\x06", 9 + struct.unpack_from("<Q", inside, 9)[0] + 8)
    (length,) = struct.unpack_from("<Q", inside, at + 1)
    head, raw = inside[:at], inside[at + 9 + 40 : at + 9 + length]  # of a chunk that is not packed
    before, messages, place = b"", list[bytes](), 0
    while place < len(raw):
        end = place + 9 + struct.unpack_from("<Q", raw, place + 1)[0]
        if raw[place] == 5:
            messages.append(raw[place:end])
        else:
            before += raw[place:end]
        place = end
    written = b"".join(messages[k] for k in order)

    def record(op: int, data: bytes) -> bytes:
        return struct.pack("<BQ", op, len(data)) + data

    def text(data: bytes) -> bytes:
        return struct.pack("<I", len(data)) + data

    begin, end = BEGIN, BEGIN + 8_000_000
    body, chunks = before + written, b""
    if chunk:
        packed = record(
            6, struct.pack("<QQQI", begin, end, len(body), 0) + text(b"") + struct.pack("<Q", len(body)) + body
        )
        listed, offsets = b"", b""
        if index:
            times = b"".join(struct.pack("<QQ", BEGIN + 1_000_000 * k, 0) for k in order)
            listed = record(7, struct.pack("<H", 1) + text(times))
            offsets = struct.pack("<HQ", 1, len(head) + len(packed))
        chunks = record(
            8,
            struct.pack("<QQQQ", begin, end, len(head), len(packed))
            + text(offsets)
            + struct.pack("<Q", len(listed))
            + text(b"")
            + struct.pack("<QQ", len(body), len(body)),
        )
        body = packed + listed
    told = record(11, struct.pack("<QHIIIIQQ", 9, 1, 1, 0, 0, int(chunk), begin, end) + text(struct.pack("<HQ", 1, 9)))
    last = record(2, struct.pack("<QQI", len(head) + len(body), 0, 0)) + b"\x89MCAP0\r\n"
    path.write_bytes(head + body + before + chunks + told + last)
    return path


@pytest.mark.parametrize(
    ("chunk", "index", "order"),
    [(True, False, [*range(9)]), (False, True, [*range(9)]), (False, True, [0, 1, 3, 2, 4, 5, 8, 6, 7])],
)
def test_mcap_is_read_without_indexes_and_in_any_order(
    chunk: bool, index: bool, order: list[int], tmp_path: Path
) -> None:
    path = of_mcap(tmp_path / "r.mcap", order, chunk=chunk, index=index)
    assert [topic.messages for topic in topics(path)] == [9]
    sheet = read_topic(path, "/p")
    np.testing.assert_allclose(numbers(sheet)[:, :2], [[0.001 * k, k] for k in range(9)], atol=1e-9)
    said = ["3 messages came behind later ones: rows are in the order of their times"]
    assert list(sheet.remarks[1:]) == (said if order != sorted(order) else [])


def of_defined(path: Path, encoding: str, definition: str) -> Path:
    """Joints, defined so, and a topic that nobody here can read, as a database of ROS 2 has them since Iron."""
    import sqlite3

    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    T, kind = store.types, "sensor_msgs/msg/JointState"
    head = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](1_700_000_000, 0), "")
    raw = store.serialize_cdr(T[kind](head, ["a"], np.ones(1), np.zeros(0), np.zeros(0)), kind)
    with sqlite3.connect(path) as database:
        database.executescript(
            """
            CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
            INSERT INTO schema VALUES (4, 'jazzy');
            CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
              serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
              type_description_hash TEXT NOT NULL);
            CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
              data BLOB NOT NULL);
            CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
              encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
            INSERT INTO topics VALUES (1, '/j', 'sensor_msgs/msg/JointState', 'cdr', '', ''),
              (2, '/x', 'some_msgs/msg/Own', 'cdr', '', '');
            INSERT INTO message_definitions VALUES (2, 'std_msgs/msg/String', 'ros2msg', 'string data', '');
            """
        )
        database.execute("INSERT INTO message_definitions VALUES (1, ?, ?, ?, '')", (kind, encoding, definition))
        for topic, encoded, text in (
            (3, "unknown", ""),
            (4, "ros2msg", "wstring<=5 name"),
            (5, "ros2msg", "string name"),
        ):
            own = f"some_msgs/msg/Own{topic}"
            database.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '', '')", (topic, f"/{topic}", own))
            database.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, '')", (topic, own, encoded, text))
        for topic in range(1, 6):
            database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", (topic, BEGIN, raw))
    database.close()
    return path


_HEADER = f"""\
{"=" * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{"=" * 80}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_JOINTS = f"std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n{_HEADER}"
_JOINTS_OMG = f"""\
{"=" * 80}
IDL: sensor_msgs/msg/JointState
// generated from rosidl_adapter/resource/msg.idl.em

#include "std_msgs/msg/Header.idl"

module sensor_msgs {{ module msg {{ struct JointState {{
  std_msgs::msg::Header header; sequence<string> name;
  sequence<double> position; sequence<double> velocity; sequence<double> effort; }}; }}; }};
{"=" * 80}
IDL: std_msgs/msg/Header
#include "builtin_interfaces/msg/Time.idl"
module std_msgs {{ module msg {{ struct Header {{ builtin_interfaces::msg::Time stamp; string frame_id; }}; }}; }};
{"=" * 80}
IDL: builtin_interfaces/msg/Time
module builtin_interfaces {{ module msg {{ struct Time {{ int32 sec; uint32 nanosec; }}; }}; }};
"""


@pytest.mark.parametrize(
    ("encoding", "definition"),
    [
        ("ros2msg", _JOINTS),
        ("ros2msg", _JOINTS.replace("\n", "\r\n")),
        ("ros2idl", _JOINTS_OMG),
        ("unknown", ""),
        ("ros2msg", "wstring<=5 of_somebody_else"),
    ],
    ids=["as usual", "of Windows", "of OMG", "not found", "not parsed"],
)
def test_topics_are_read_beside_others_that_cannot_be(encoding: str, definition: str, tmp_path: Path) -> None:
    path = of_defined(tmp_path / "r.db3", encoding, definition)
    assert [topic.of for topic in topics(path)] == ["", "", "", "joints", ""]
    assert read_topic(path, "/j").titles == ("time [s]", "a [rad]")
    with pytest.raises(MeasurementError, match="neither joints nor points"):
        read_topic(path, "/3")


@pytest.mark.parametrize("end", ["-wal", "-journal"])
def test_a_database_that_was_not_closed_is_not_read_in_part(end: str, tmp_path: Path) -> None:
    path = of_defined(tmp_path / "r.db3", "ros2msg", _JOINTS)
    beside = path.with_name(f"r.db3{end}")
    beside.write_bytes(b"messages")
    with pytest.raises(MeasurementError, match=f"r.db3: was not closed, and r.db3{end} beside it holds what is"):
        read_topic(path, "/j")
    beside.write_bytes(b"")  # as SQLite leaves it
    assert len(read_topic(path, "/j").rows) == 1


def test_a_recording_has_so_many_topics_and_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is a line of a table on the terminal."""
    path = recording(tmp_path, "mcap")
    monkeypatch.setattr(recordings, "MOST_TOPICS", 5)
    with pytest.raises(MeasurementError, match=r"mcap: has more than 5 topics and frames of transforms\.$"):
        topics(path)
    assert len(read_topic(path, "/tf:camera").rows) == 20


@pytest.mark.parametrize("index", [True, False])
def test_chunks_of_mcap_are_not_asked_for_every_topic(index: bool, tmp_path: Path) -> None:
    """A megabyte holds thousands of both."""
    import time

    def record(op: int, data: bytes) -> bytes:
        return struct.pack("<BQ", op, len(data)) + data

    def text(data: bytes) -> bytes:
        return struct.pack("<I", len(data)) + data

    topic_count, chunk_count = 16_000, 4_500
    raw = record(5, struct.pack("<HIQQ", topic_count - 1, 0, BEGIN, BEGIN) + bytes(4))
    begin = b"\x89MCAP0\r\n" + record(1, text(b"ros2") + text(b""))
    chunk = record(6, struct.pack("<QQQI", BEGIN, BEGIN, len(raw), 0) + text(b"") + struct.pack("<Q", len(raw)) + raw)
    at = len(begin) + len(chunk)
    listed = record(7, struct.pack("<H", topic_count - 1) + text(struct.pack("<QQ", BEGIN, 0)))
    offsets = struct.pack("<HQ", topic_count - 1, at) if index else b""
    told = record(
        8,
        struct.pack("<QQQQ", BEGIN, BEGIN, len(begin), len(chunk))
        + text(offsets)
        + struct.pack("<Q", len(listed))
        + text(b"")
        + struct.pack("<QQ", len(raw), len(raw)),
    )
    schema = record(3, struct.pack("<H", 1) + text(b"a/b") + text(b"ros2msg") + text(b"int8 a"))
    channels = b"".join(
        record(4, struct.pack("<HH", k, 1) + text(b"") + text(b"") + text(b"")) for k in range(topic_count)
    )
    last = record(2, struct.pack("<QQI", at + len(listed), 0, 0)) + b"\x89MCAP0\r\n"
    (tmp_path / "a.mcap").write_bytes(begin + chunk + listed + schema + channels + chunk_count * told + last)
    begun = time.process_time()
    assert [topic.messages for topic in topics(tmp_path / "a.mcap")] == [chunk_count]
    assert time.process_time() - begun < 5.0


def test_channels_of_mcap_that_are_not_of_ros_are_passed_over(tmp_path: Path) -> None:
    path = of_mcap(tmp_path / "r.mcap", [*range(9)], chunk=False)
    data = path.read_bytes()

    def text(words: bytes) -> bytes:
        return struct.pack("<I", len(words)) + words

    schema = struct.pack("<H", 7) + text(b"foxglove.Log") + text(b"jsonschema") + text(b"{}")
    channel = struct.pack("<HH", 7, 7) + text(b"/log") + text(b"json") + text(b"")
    at = data.index(b"\x03", 9 + struct.unpack_from("<Q", data, 9)[0] + 8)
    more = b"".join(struct.pack("<BQ", op, len(one)) + one for op, one in ((3, schema), (4, channel)))
    (start,) = struct.unpack_from("<Q", data, len(data) - 28)
    end = data[:-28] + struct.pack("<Q", start + len(more)) + data[-20:]
    path.write_bytes(end[:at] + more + end[at:start] + more + end[start:])
    assert [topic.name for topic in topics(path)] == ["/p"]
    assert len(read_topic(path, "/p").rows) == 9


def test_empty_records_of_mcap_are_counted(tmp_path: Path) -> None:
    """A file of 390 kB had ten million of them, which were gone through four times."""
    unpacker = unpacking.Unpacker(tmp_path, 1000)
    many = bytes(9 * unpacking.LEAST_RECORDS)
    assert unpacker.counted(many) is many
    with pytest.raises(MeasurementError, match="has more records than a recording of its size can have"):
        unpacker.counted(bytes(9))
    # An end that is no whole record is left to the reader.
    assert unpacking.Unpacker(tmp_path, 1000).counted(many + b"12345678")


@pytest.mark.parametrize("packed", ["zstd", "lz4"])
def test_a_damaged_chunk_is_refused(packed: str, tmp_path: Path) -> None:
    def record(kind: int, body: bytes) -> bytes:
        return struct.pack("<BQ", kind, len(body)) + body

    magic, name, data = b"\x89MCAP0\r\n", packed.encode(), b"garbage!!"
    header = record(1, struct.pack("<I4sI", 4, b"ros2", 0))
    length = struct.pack("<I", len(name)) + name + struct.pack("<Q", len(data))
    chunk = record(6, struct.pack("<QQQI", 0, 0, 99, 0) + length + data)
    (tmp_path / "a.mcap").write_bytes(magic + header + chunk + record(2, bytes(20)) + magic)
    with pytest.raises(MeasurementError, match=r"a\.mcap: is no recording that can be read \(\w+\)\.$"):
        topics(tmp_path / "a.mcap")


def test_chunks_of_mcap_are_counted_where_they_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for packed in ("", "STORAGE"):
        path = recording(tmp_path / packed, "mcap", packed)
        assert topics(path)
        with monkeypatch.context() as patch:
            patch.setattr(unpacking, "LEAST_RECORDS", 50)
            patch.setattr(unpacking, "RECORDS_PER_BYTE", 0)
            with pytest.raises(MeasurementError, match="has more records"):
                topics(path)


ENDLESS = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) SELECT k AS id, 1 AS topic_id, "
COMPUTED = {
    "has a view": ("DROP TABLE messages", f"CREATE VIEW messages AS {ENDLESS} k AS timestamp, '' AS data FROM n"),
    "has a virtual table": ("CREATE VIRTUAL TABLE searched USING fts5(text)",),
    "has a computed column": ("ALTER TABLE messages ADD COLUMN more AS (zeroblob(1000000000))",),
    "has a trigger": ("CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM topics; END",),
    "of 1 numbers": (
        "CREATE TABLE other AS SELECT * FROM topics",
        "UPDATE other SET id = 1",
        "DROP TABLE topics",
        "ALTER TABLE other RENAME TO topics",
    ),
    "of 0 numbers": (
        "CREATE TABLE other(id TEXT, name, type, serialization_format, offered_qos_profiles, type_description_hash)",
        "INSERT INTO other SELECT '0' || id, name, type, serialization_format, '', '' FROM topics",
        "DROP TABLE topics",
        "ALTER TABLE other RENAME TO topics",
    ),
    "a column with a default of 203 characters": (f"ALTER TABLE messages ADD COLUMN more DEFAULT x'{'00' * 100}'",),
}


NO_KIND = {
    "a topic whose name or type is no text": (
        "UPDATE topics SET name = x'ff' WHERE id = 1",
        "UPDATE topics SET type = x'ff' WHERE id = 1",
        "CREATE TABLE other AS SELECT id, 5 AS name, type, serialization_format, offered_qos_profiles, "
        "type_description_hash FROM topics; DROP TABLE topics; ALTER TABLE other RENAME TO topics",
    ),
    "a message whose time is no whole number": (
        "UPDATE messages SET timestamp = 9e999 WHERE topic_id = 1",
        "UPDATE messages SET timestamp = 1.5 WHERE topic_id = 1",
    ),
}


def commanded(folder: Path, commands: str) -> Path:
    """The database of a recording after some commands."""
    import sqlite3

    file = next(recording(folder, "ros2").glob("*.db3"))
    database = sqlite3.connect(file)
    database.executescript(commands)
    database.close()
    return file


@pytest.mark.parametrize(("commands", "says"), [(one, says) for says, every in NO_KIND.items() for one in every])
def test_databases_with_values_of_another_kind_are_refused(commands: str, says: str, tmp_path: Path) -> None:
    file = commanded(tmp_path, commands)
    for read in (topics, partial(read_topic, name="/joint_states")):
        with pytest.raises(MeasurementError, match=f"{file.name}: has {says}"):
            read(file)


@pytest.mark.parametrize("said", COMPUTED)
@pytest.mark.parametrize("inside", [True, False])
def test_databases_that_compute_what_is_read_are_refused(said: str, inside: bool, tmp_path: Path) -> None:
    file = commanded(tmp_path, ";".join(COMPUTED[said]))
    path = file.parent
    with pytest.raises(MeasurementError, match=f"{file.name}: .*{said}"):
        topics(path if inside else file)


def test_what_a_database_goes_through_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables that say of themselves that they are small are gone through whole for every topic, without an index."""
    file = commanded(
        tmp_path,
        "ANALYZE; DELETE FROM sqlite_stat1;"
        "INSERT INTO sqlite_stat1 VALUES ('messages', NULL, '1'), ('topics', NULL, '1');"
        "WITH RECURSIVE n(k) AS (SELECT 100 UNION ALL SELECT k + 1 FROM n WHERE k < 1100) INSERT INTO topics "
        "SELECT k, 'more', 'none', 'cdr', '', '' FROM n",
    )
    assert len(read_topic(file, "/joint_states").rows) == 30
    monkeypatch.setattr(unpacking, "LEAST_STEPS", 200_000)
    monkeypatch.setattr(unpacking, "STEPS_PER_BYTE", 0)
    for read in (topics, partial(read_topic, name="/joint_states")):
        with pytest.raises(MeasurementError, match=f"{file.name}: takes longer to read"):
            read(file)
    assert len(read_topic(recording(tmp_path / "good", "ros2"), "/joint_states").rows) == 30


# Each of ten mappings takes in the one before nine times.
LAUGHS = "- &m0 {history: 1}\n" + "".join(f"- &m{k} {{<<: [{', '.join(9 * [f'*m{k - 1}'])}]}}\n" for k in range(1, 11))


@pytest.mark.parametrize("said", ["- 5", "- history: often", LAUGHS], ids=("none", "words", "laughs"))
def test_a_database_is_read_whatever_it_says_of_how_messages_were_sent(said: str, tmp_path: Path) -> None:
    file = commanded(tmp_path, f"UPDATE topics SET offered_qos_profiles = '{said}'")
    for path in (file, file.parent):
        assert len(read_topic(path, "/joint_states").rows) == 30


@pytest.mark.parametrize("kind", ["ros2", "mcap"])
def test_how_messages_were_sent_is_not_read(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is YAML of its own in the metadata, in databases and in channels of MCAP."""
    from rosbags.rosbag2 import reader, storage_mcap, storage_sqlite3

    def never(_: object) -> None:
        raise AssertionError

    path = recording(tmp_path, kind)
    for module in (reader, storage_mcap, storage_sqlite3):
        monkeypatch.setattr(module, "parse_qos", never)
    for one in (path, next(path.glob("*.mcap" if kind == "mcap" else "*.db3"))):
        assert len(topics(one)) == 6
    assert reader.parse_qos is never


def with_shared_pages(file: Path, tree: str) -> None:
    """Put pages above a tree of a database that each point a hundred times to the next: 10^20 times to the last."""
    import sqlite3
    import struct

    # A page of 1 kB; the list of tables has the first page, with the header of the file.
    database = sqlite3.connect(file)
    database.executescript("PRAGMA journal_mode = DELETE; PRAGMA page_size = 1024; VACUUM")
    roots = dict(database.execute("SELECT name, rootpage FROM sqlite_master")) | {"sqlite_master": 1}
    database.close()
    pages = bytearray(file.read_bytes())
    top, count = roots[tree], len(pages) // 1024
    first = (top - 1) * 1024
    chain, begin = [top, *range(count + 1, count + 11)], 100 if top == 1 else 0
    # The old root, where it is a leaf, is what they all lead to; of the list of tables, whose cells stand elsewhere
    # on its page, a leaf of one index that SQLite makes itself.
    if tree == "sqlite_master":
        record = b"\x06\x17\x17\x17\x01\x00" + b"index" + b"index" + b"index" + b"\x00"
        leaf = bytearray(1024)
        cell = bytes([len(record), 1]) + record
        leaf[1024 - len(cell) :] = cell
        leaf[:10] = struct.pack(">BHHHBH", 13, 0, 1, 1024 - len(cell), 0, 1024 - len(cell))
    else:
        leaf = pages[first : first + 1024]
    ends = count + 11
    for page, below in zip(chain, [*chain[1:], ends], strict=True):
        start = begin if page == top else 0
        made = bytearray(1024)
        cells = b"".join(struct.pack(">IB", below, k + 1) for k in range(100))
        made[1024 - len(cells) :] = cells
        places = [1024 - len(cells) + 5 * k for k in range(100)]
        head = struct.pack(">BHHHBI", 5, 0, 100, places[0], 0, below) + struct.pack(">100H", *places)
        made[start : start + len(head)] = head
        if start:
            made[:start] = pages[:start]
        at = (page - 1) * 1024
        pages[at : at + 1024] = made
    pages[(ends - 1) * 1024 : ends * 1024] = leaf
    pages[28:32] = struct.pack(">I", ends)
    file.write_bytes(pages)


@pytest.mark.parametrize("tree", ["messages", "topics", "sqlite_master"])
def test_databases_whose_pages_come_again_and_again_are_refused(tree: str, tmp_path: Path) -> None:
    """SQLite itself would go through them without end."""
    file = next(recording(tmp_path, "ros2").glob("*.db3"))
    with_shared_pages(file, tree)
    for read in (topics, partial(read_topic, name="/joint_states")):
        with pytest.raises(MeasurementError, match=r"is a damaged database|is no recording that can be read"):
            read(file)


def test_conditions_of_a_database_are_not_computed(tmp_path: Path) -> None:
    file = commanded(
        tmp_path,
        "CREATE TABLE more(x CHECK (length(hex(zeroblob(x))) > 0)); PRAGMA ignore_check_constraints = 1;"
        "INSERT INTO more VALUES (400000000), (400000000), (400000000), (400000000), (400000000)",
    )
    assert "/joint_states" in {topic.name for topic in topics(file)}


_NEXT = f"{80 * '='}\nMSG: "
_STRUCT = "module a { module msg { struct B { double x; }; }; };"


def defined(folder: Path, definition: str, told: list[bytes], kind: str = "a/msg/B") -> Path:
    """A recording whose topic /t has these messages, of a type that is defined so."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        store = get_typestore(Stores.ROS2_HUMBLE)
        connection = writer.add_connection("/t", "std_msgs/msg/String", typestore=store)
        # What is written is what the connection says, of which the writer knows no more than the number.
        storage: Any = writer.storage
        storage.schemas[-1] = storage.schemas[-1]._replace(
            name=kind, data=definition, encoding="ros2idl" if definition.startswith("module") else "ros2msg"
        )
        storage.channels[-1] = storage.channels[-1]._replace(schema=kind)
        for k, raw in enumerate(told):
            writer.write(connection, BEGIN + k, b"\0\1\0\0" + raw)
    return folder / f"{folder.name}.mcap"


def test_definitions_of_a_recording_are_its_own(tmp_path: Path) -> None:
    point = np.array([1.0, 2.0, 3.0]).tobytes()
    for name, text in (
        ("msg", "# a point\n\nfloat64 x # to the right\nfloat64 y\nfloat64 z\n"),
        (
            "idl",
            'module a { module msg { // a point\n @verbatim (language="comment", text="(a)" "point") struct B '
            '{ @key double x; double y; /* up */ @unit (value="m") double z; }; }; };',
        ),
    ):
        path = defined(tmp_path / name, text, [point])
        assert topics(path)[0].of == "point"
        np.testing.assert_allclose(numbers(read_topic(path, "/t"))[0, 1:], [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("\n".join(f"bool a{k}" for k in range(2000)), "messages of 'a/msg/B' have more than 1000 fields"),
        ("".join(f"int8 a{k}\n{_NEXT}a/C{k}\n" for k in range(20_000)), "defines too much: its messages have more"),
        (f"int8[] a [{'1,' * 40_000}1]", "defines too much: its messages have more"),
        (_STRUCT.replace("double x", f"double x[{3 * '('}1{3 * ')'}]"), r"computes a number in a definition \('\('\)"),
        (f"module a {{ const long A = 1 << 4000000000; }};{_STRUCT}", "computes a number in a definition"),
        (f"module a {{ {''.join(f'const long A{k} = 1;' for k in range(600))} }};{_STRUCT}", "defines too much"),
    ],
)
def test_definitions_that_take_long_to_parse_are_refused(text: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match=f"{says}.*$"):
        topics(defined(tmp_path / "r", text, [b"\0"]))


@pytest.mark.parametrize(
    "text",
    [
        "string[1000000000] a",
        f"a/C[] a\n{_NEXT}a/C\n",
        "a/C[10] a" + "".join(f"\n{_NEXT}a/{'CDEFGHIJKL'[k]}\na/{'DEFGHIJKLM'[k]}[10] a" for k in range(9)),
        "a/B a",
    ],
    ids=["strings", "empty parts", "laughs", "itself"],
)
def test_messages_that_would_have_values_without_end_are_not_read(text: str, tmp_path: Path) -> None:
    raw = b"\xff\xff\xff\xff" + bytes(100)
    assert topics(defined(tmp_path / "other", text, [raw]))[0].of == ""
    path = defined(tmp_path / "point", f"float64 x\nfloat64 y\nfloat64 z\n{text}", [bytes(24) + raw])
    assert topics(path)[0].of == "point"
    with pytest.raises(MeasurementError, match=r"may have more than|have more than 1000 values|parts without end"):
        read_topic(path, "/t")


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("sensor_msgs/msg/JointState", "int8[] name\nfloat64[] position"),
        ("sensor_msgs/msg/JointState", "string[] name\nstring[] position"),
        ("sensor_msgs/msg/JointState", "int8 a"),
        ("tf2_msgs/msg/TFMessage", "int8 transforms"),
        ("tf2_msgs/msg/TFMessage", f"a/C[] transforms\n{_NEXT}a/C\nfloat64 x\nfloat64 y\nfloat64 z"),
        ("a/msg/B", "string x\nstring y\nstring z"),
        ("a/msg/B", "float64[2] x\nfloat64[2] y\nfloat64[2] z"),
        ("a/msg/B", f"a/C x\na/C y\na/C z\n{_NEXT}a/C\nint8 a"),
        ("a/msg/B", "float64 X=1\nfloat64 Y=1\nfloat64 Z=1\nint8 a"),
    ],
)
def test_what_has_the_names_of_joints_or_points_but_no_numbers_is_neither(kind: str, text: str, tmp_path: Path) -> None:
    path = defined(tmp_path / "r", text, [bytes(64)], kind)
    assert [topic.of for topic in topics(path)] == [""]
    with pytest.raises(MeasurementError, match=f"messages of '/t' are '{kind}': neither joints nor points"):
        read_topic(path, "/t")


def test_a_header_without_a_time_gives_none(tmp_path: Path) -> None:
    text = f"a/H header\nfloat64 x\nfloat64 y\nfloat64 z\n{_NEXT}a/H\nfloat64 stamp"
    sheet = read_topic(defined(tmp_path / "r", text, [bytes(32), bytes(32)]), "/t")
    np.testing.assert_allclose(numbers(sheet)[:, 0], [0.0, 1e-9], atol=1e-12)


def test_more_messages_than_a_small_recording_can_have_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(message_types, "LEAST_VALUES", 1000)
    path = defined(tmp_path / "r", "float64 x\nfloat64 y\nfloat64 z", [bytes(24)] * 40)
    assert len(topics(path)) == 1
    monkeypatch.setattr(message_types, "VALUES_PER_BYTE", 0)
    with pytest.raises(MeasurementError, match="more messages than a recording of its size can have"):
        read_topic(defined(tmp_path / "s", "float64 x\nfloat64 y\nfloat64 z", [bytes(24)] * 50), "/t")


def test_another_type_of_the_same_topic_does_not_hide_its_joints(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore
    from rosbags.typesys import get_types_from_msg as types_of

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(types_of("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    text = store.types["std_msgs/msg/String"]
    with Writer(tmp_path / "one.bag") as writer:
        other = writer.add_connection("/joint_states", text.__msgtype__, typestore=store)
        writer.write(other, BEGIN - 1, store.serialize_ros1(text(data="begins"), text.__msgtype__))
        connection = None
        for topic, kind, time, message in messages(store, ros1=True):
            if topic == "/joint_states":
                connection = connection or writer.add_connection(topic, kind, typestore=store)
                writer.write(connection, time, store.serialize_ros1(message, kind))
    assert topics(tmp_path / "one.bag")[0].of == "joints"
    sheet = read_topic(tmp_path / "one.bag", "/joint_states")
    assert len(sheet.rows) == 30
    assert sheet.remarks[-1] == "1 message of another type left out"


def test_chunks_of_one_index_are_not_read_again_and_again(tmp_path: Path) -> None:
    path = recording(tmp_path, "ros1")
    data = path.read_bytes()
    # The records of connections and of the only chunk end the file; the header says how many chunks there are.
    begin = data.rindex(b"\x04\x00\x00\x00op=\x06") - 4
    many = data.replace(b"chunk_count=\x01\x00", b"chunk_count=\xe8\x03") + 999 * data[begin:]
    path.write_bytes(many)
    with pytest.raises(MeasurementError, match="has indexes that are larger than the file"):
        topics(path)


def test_every_kind_of_message_counts_by_itself() -> None:
    """Of each a class is made: ten thousand of one field, in less than a MB, took more than 10 s."""
    parsers = SimpleNamespace(get_types_from_msg=lambda *_: {}, get_types_from_idl=None, TypesysError=ValueError)
    definitions = message_types.Definitions(Path("a.mcap"), parsers)
    for k in range(2000):
        definitions.of_messages("bool x", f"a/msg/B{k}")
    with pytest.raises(MeasurementError, match=r"^a.mcap: defines too much: .*, or are of too many kinds\.$"):
        definitions.of_messages("bool x", "a/msg/C")
