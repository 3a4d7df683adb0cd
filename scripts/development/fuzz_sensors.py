"""What sensors and others write, for :mod:`.fuzz_readers`: recordings, logs, photographs, boards, lenses, streams."""

import functools
import shutil
from collections.abc import Iterator
from typing import Any

import numpy as np
import typer

from calib.cli.whole import app
from calib.foundations.arrays import Array
from calib.foundations.errors import CalibError
from calib.job.photographs import import_photographs
from calib.job.read import board_toml, read_board
from calib.measurement.formats.images import detector, marker_bits, opencv, read_image
from calib.measurement.formats.lens_files import read_lens
from calib.measurement.formats.recordings import read_topic, topics
from calib.measurement.formats.sheet import read_sheet
from calib.measurement.prints import Print
from calib.measurement.read import read_stream
from calib.measurement.streams.stream import Clock
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from scripts.development.fuzz_files import ROBOTS, file, packed, scratch, unpacked

# Recordings. -----------------------------------------------------------------------------------------------------

_BAGS = ("one.bag", "one.mcap", "bag")


def recording(data: bytes) -> None:
    """Read a recording, of which the first byte says the kind: topics, and the rows of each."""
    kind = _BAGS[data[0] % len(_BAGS)] if data else _BAGS[0]
    folder = scratch() / "recording"
    shutil.rmtree(folder, ignore_errors=True)
    if kind == "bag":
        for name, contents in unpacked(data[1:]).items():
            if name in ("metadata.yaml", "bag.db3", "bag.mcap"):
                file(f"recording/bag/{name}", contents)
        path = folder / "bag"
    else:
        path = file(f"recording/{kind}", data[1:])
    for topic in topics(path):
        if topic.of:
            sheet = read_topic(path, topic.name)
            assert all(len(row) == len(sheet.titles) for row in sheet.rows), "rows of other lengths"


def _messages(store: Any, ros1: bool) -> Iterator[tuple[str, Any, int]]:
    T = store.types
    header, stamp = T["std_msgs/msg/Header"], T["builtin_interfaces/msg/Time"]
    turn = T["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.6, w=0.8)
    none = np.zeros(0)
    for k in range(3):
        t = 1_700_000_000_000_000_000 + k * 10_000_000
        made = stamp(sec=t // 10**9, nanosec=t % 10**9)
        head = header(seq=0, stamp=made, frame_id="w") if ros1 else header(stamp=made, frame_id="w")
        joints = T["sensor_msgs/msg/JointState"]
        yield "/joints", joints(head, ["a", "b"], np.array([0.1 * k, -1.0]), none, none), t
        point = T["geometry_msgs/msg/Point"](x=0.1 * k, y=2.0, z=-3.0)
        pose = T["geometry_msgs/msg/Pose"](position=point, orientation=turn)
        yield "/tool", T["geometry_msgs/msg/PoseStamped"](header=head, pose=pose), t


def recordings() -> list[bytes]:
    """Return a recording of each kind, as short as they get."""
    from rosbags.rosbag1 import Writer as Writer1  # noqa: PLC0415 - an extra
    from rosbags.rosbag2 import StoragePlugin  # noqa: PLC0415
    from rosbags.rosbag2 import Writer as Writer2  # noqa: PLC0415
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    found = []
    for kind in ("one.bag", "mcap", "bag"):
        ros1 = kind == "one.bag"
        store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        folder = scratch() / "made"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        path = folder / ("one.bag" if ros1 else "bag")
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        with Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin) as writer:
            known: dict[str, Any] = {}
            for topic, message, time in _messages(store, ros1):
                name = message.__msgtype__
                if topic not in known:
                    known[topic] = writer.add_connection(topic, name, typestore=store)
                raw = store.serialize_ros1(message, name) if ros1 else store.serialize_cdr(message, name)
                writer.write(known[topic], time, raw)
        if ros1:
            found.append(b"\0" + path.read_bytes())
            continue
        files = {one.name: one.read_bytes() for one in sorted(path.iterdir())}
        found.append(b"\2" + packed(files))
        if kind == "mcap":
            found.append(b"\1" + files["bag.mcap"])
    return found


# Logs. -----------------------------------------------------------------------------------------------------------

MOTIVE = b"""Format Version,1.23,Take Name,Take 1,Capture Frame Rate,120.0,Rotation Type,Quaternion,Length Units,Meters

,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker
,Name,tool,tool,tool,tool,tool,tool,tool,tool,m1,m1,m1
,ID,1,1,1,1,1,1,1,1,2,2,2
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Error Per Marker,Position,Position,Position
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z
0,0.000000,0,0,0.6,0.8,1.0,2.0,3.0,0.0001,0,0,0
1,0.008333,,,,,,,,,0,0,0
2,0.016667,0,0,0.6,0.8,1.1,2.0,3.0,0.0001,0,0,0
"""


def log(data: bytes) -> None:
    """Read a log of a controller or of motion capture."""
    sheet = read_sheet(file("log.csv", data))
    assert all(len(row) == len(sheet.titles) for row in sheet.rows), "rows of other lengths"


def logs() -> list[bytes]:
    """Return an export of Motive, and logs of UR's RTDE."""
    titles = ["timestamp", *(f"actual_q_{k}" for k in range(6)), "runtime_state"]
    rows = [[str(x) for x in (100.0 + 0.008 * n, *(0.1 * k + n for k in range(6)), 1)] for n in range(4)]
    return [MOTIVE] + [("\n".join(gap.join(row) for row in [titles, *rows]) + "\n").encode() for gap in " ,"]


# Boards, photographs, lenses. ------------------------------------------------------------------------------------

_PRINT = Print("charuco", (5, 4), 0.03, 0.022, "DICT_4X4_50")
_OPTIONS = ("--kind", "--squares", "--square", "--marker", "--dictionary")


def board(data: bytes) -> None:
    """Read a board.toml, and write a board to print by the same number of options, each on its line."""
    files = unpacked(data)
    values = files.get("options", b"").decode(errors="replace").replace("\0", "").split("\n")
    folder = scratch() / "printed"
    shutil.rmtree(folder, ignore_errors=True)
    options = [f"{name}={value}" for name, value in zip(_OPTIONS, values, strict=False)]
    failed = None
    try:
        app(["board", "-o", str(folder), "-q", *options], standalone_mode=False, prog_name="calib")
        assert read_board(folder / "board.toml").marks.size, "a board without marks"
    except (CalibError, typer.BadParameter) as e:
        failed = e
    print_ = read_board(file("board.toml", files.get("board.toml", b"")))
    assert np.isfinite(print_.marks).all(), "a mark nowhere"
    file("again.toml", board_toml(print_).encode())
    assert read_board(scratch() / "again.toml").squares == print_.squares, "a board that does not read back"
    if print_.kind == "charuco":
        marker_bits(print_)
    if isinstance(failed, CalibError):
        raise failed


def boards() -> list[bytes]:
    """Return a board with markers and one without."""
    chess = Print("chessboard", (6, 5), 0.03)
    return [
        packed({"board.toml": board_toml(one).encode(), "options": options})
        for one, options in ((_PRINT, b"charuco\n7x5\n30 mm\n22 mm\nDICT_5X5_50"), (chess, b"chessboard\n6x5\n25 mm"))
    ]


@functools.cache
def _picture(turned: float = 0.3) -> Array:
    """Return a picture (264, 330) of the board, seen askew."""
    cv2 = opencv()
    made = cv2.aruco.CharucoBoard(
        _PRINT.squares, _PRINT.square, _PRINT.marker, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    )
    flat = made.generateImage((500, 400), marginSize=20)
    corners = np.float32([[0, 0], [500, 0], [500, 400], [0, 400]])
    seen = np.float32([[5, 5], [325, 5 + 30 * turned], [315, 250], [10, 260 - 30 * turned]])
    H = cv2.getPerspectiveTransform(corners, seen)
    seen_flat = cv2.warpPerspective(flat, H, (330, 264), flags=cv2.INTER_AREA, borderValue=200)
    return np.asarray(cv2.GaussianBlur(seen_flat, (0, 0), 0.7))


_ENDS = (".png", ".jpg", ".bmp", ".tiff", ".pgm", ".webp")


def photograph(data: bytes) -> None:
    """Read an image, of which the first byte says the kind, and find the board in it."""
    kind = _ENDS[data[0] % len(_ENDS)] if data else _ENDS[0]
    found = _detect()(read_image(file(f"image{kind}", data[1:])))
    assert np.isfinite(found.pixels).all(), "a corner nowhere"
    assert np.isfinite(found.sigma).all(), "a corner of no sigma"


@functools.cache
def _detect() -> Any:
    return detector(_PRINT)


def photographs() -> list[bytes]:
    """Return one small photograph in each format."""
    cv2 = opencv()
    small = [bytes([k]) + bytes(cv2.imencode(kind, _picture())[1]) for k, kind in enumerate(_ENDS)]
    return [one for one in small if len(one) < 60_000]


def session(data: bytes) -> None:
    """Read the readings and the board of a folder of photographs, which are good."""
    folder = scratch() / "photographs"
    if not folder.exists():
        cv2 = opencv()
        for k in range(4):
            file(f"photographs/p{k}.png", bytes(cv2.imencode(".png", _picture(0.2 * k))[1]))
    files = unpacked(data)
    print_ = read_board(file("board.toml", files.get("board.toml", b"")))
    readings = file("readings.csv", files.get("readings.csv", b""))
    orientation = "rpy" if b"rx" in files.get("readings.csv", b"") else None
    found = import_photographs(folder, print_, readings, orientation=orientation)
    found.contents()
    assert found.table().count("\n") > len(found.used), "photographs without corners"


def sessions() -> list[bytes]:
    """Return readings of joints, and poses of the flange in two ways."""
    text = board_toml(_PRINT).encode()
    heads = (
        b"joint_1 [deg],joint_2 [deg]",
        b"x [mm],y [mm],z [mm],qw,qx,qy,qz",
        b"x [m],y [m],z [m],rx [deg],ry [deg],rz [deg]",
    )
    cells = (b"%d,2", b"%d,2,3,1,0,0,0", b"%d,2,3,4,5,6")
    return [
        packed(
            {
                "board.toml": text,
                "readings.csv": b"image,"
                + head
                + b"\n"
                + b"".join(b"p%d.png," % k + cell % k + b"\n" for k in range(4)),
            }
        )
        for head, cell in zip(heads, cells, strict=True)
    ]


# Whole commands. -------------------------------------------------------------------------------------------------

_URDF = "arm.urdf"
_PHOTOGRAPHS = ("images", "photos", "--board", "board.toml", "--readings", "readings.csv")
_IMPORTS: tuple[tuple[str, ...], ...] = (
    ("a.csv",),
    ("a.csv", "b.csv"),
    ("a.csv", "b.csv", "--by", "order"),
    ("a.csv", "b.csv", "--stack", "hole"),
    ("a.json", "b.yaml"),
    ("own.conf", "--robot", "example:ur_description/urdf/ur10_robot.urdf"),
    ("one.mcap", "--topic", "/tool"),
    _PHOTOGRAPHS,
    (*_PHOTOGRAPHS, "--robot", _URDF, "--tip", "probe"),
    (*_PHOTOGRAPHS, "--orientation", "rpy", "--camera-on", "floor"),
    ("a.csv", "--each-point"),
    ("a.csv", "b.csv", "--by", "order", "--each-point"),
)


def importing(data: bytes) -> None:
    """Run ``calib import`` as the first byte says: it writes what it was told to, or says why and writes nothing."""
    folder = scratch() / "importing"
    shutil.rmtree(folder, ignore_errors=True)
    names = {name: contents for name, contents in unpacked(data[1:]).items() if name in _IMPORTED}
    for name, contents in names.items():
        file(f"importing/{name}", contents)
    for k in range(3):
        file(f"importing/photos/p{k}.png", _pictures()[k])
    file(f"importing/{_URDF}", (ROBOTS / "arm_cmm" / "arm_cmm.urdf").read_bytes())
    arguments = _IMPORTS[data[0] % len(_IMPORTS)] if data else _IMPORTS[0]
    before = set(folder.rglob("*"))
    places = [str(folder / word) if word in (*_IMPORTED, _URDF, "photos") else word for word in arguments]
    try:
        app(["import", *places, "-o", str(folder / "table.csv"), "-q"], standalone_mode=False, prog_name="calib")
    except (CalibError, typer.BadParameter) as e:
        assert set(folder.rglob("*")) == before, "something is written although it was refused"
        if isinstance(e, CalibError):
            raise
    else:
        assert (folder / "table.csv").is_file(), "nothing is written"


_IMPORTED = ("a.csv", "b.csv", "a.json", "b.yaml", "own.conf", "one.mcap", "board.toml", "readings.csv")


@functools.cache
def _pictures() -> list[bytes]:
    return [bytes(opencv().imencode(".png", _picture(0.2 * k))[1]) for k in range(3)]


def imports() -> list[bytes]:
    """Return what every import reads."""
    joints = b"name;j1 [deg];j2 [deg]\nP1;1;2\nP2;3;4\n"
    points = b"name,x [mm],y [mm],z [mm]\nP1,1,2,3\nP2,4,5,6\n"
    deltas = "".join(f"delta_{name} = [ 1e-4, 0, -2e-5, 0.0003, 0, 0]\n" for name in ("theta", "a", "d", "alpha"))
    bag = next(one[1:] for one in recordings() if one[:1] == b"\1")
    turns = np.radians(np.arange(8) * 37.0)
    body = np.column_stack([np.cos(turns), np.sin(turns), 1.0 + turns, -np.sin(turns), np.cos(turns), turns])
    several = _csv("x1 [mm],y1 [mm],z1 [mm],x2 [mm],y2 [mm],z2 [mm]", body)
    files = (
        *({"a.csv": joints, "b.csv": points},) * 3,
        {"a.csv": points, "b.csv": points},
        {"a.json": b'[{"name": "P1", "q": [1, 2]}]', "b.yaml": b"'P1': {x: 1, y: 2}\n"},
        {"own.conf": f"[mounting]\n{deltas}joint_checksum = [ 0xb3241580]\n".encode()},
        {"one.mcap": bag},
        *({"board.toml": board_toml(_PRINT).encode(), "readings.csv": readings} for readings in _photographed()),
        {"a.csv": several},
        {"a.csv": several.partition(b"\n")[2], "b.csv": several},
    )
    return [bytes([k]) + packed(own) for k, own in enumerate(files)]


def _photographed() -> list[bytes]:
    names = ",".join(f"joint_{k} [deg]" for k in range(1, 7))
    heads = (f"image,{names}", f"image,{names}", "image,x [mm],y [mm],z [mm],rx [deg],ry [deg],rz [deg]")
    return [
        "\n".join([head, "p0.png,1,2,3,4,5,6", "p1.png,2,3,4,5,6,7", "p2.png,9,8,7,6,5,4", ""]).encode()
        for head in heads
    ]


def lens(data: bytes) -> None:
    """Read a lens of somebody else."""
    found, size = read_lens(file("lens.yaml", data))
    assert np.isfinite([found.fx, found.fy, found.cx, found.cy, found.k1]).all(), "a lens that is none"
    assert size is None or min(size) > 0, "a size that is none"


def lenses() -> list[bytes]:
    """Return a lens as OpenCV, ROS and Kalibr write it."""
    K, D = "[900.0, 0.0, 640.0, 0.0, 901.5, 360.0, 0.0, 0.0, 1.0]", "[-0.1, 0.01, 1e-4, -2e-4, 0.0]"
    return [
        (
            "%YAML:1.0\n---\nimage_width: 1280\nimage_height: 720\ncamera_matrix: !!opencv-matrix\n"
            f"   rows: 3\n   cols: 3\n   dt: d\n   data: {K}\ndistortion_coefficients: !!opencv-matrix\n"
            f"   rows: 1\n   cols: 5\n   dt: d\n   data: {D}\n"
        ).encode(),
        f"image_width: 1280\nimage_height: 720\ncamera_matrix:\n  data: {K}\ndistortion_model: plumb_bob\n"
        f"distortion_coefficients:\n  data: {D}\n".encode(),
        b"cam0:\n  camera_model: pinhole\n  intrinsics: [900.0, 901.0, 640.0, 360.0]\n  distortion_model: radtan\n"
        b"  distortion_coeffs: [-0.1, 0.01, 0.0, 0.0]\n  resolution: [1280, 720]\n",
    ]


# Streams. --------------------------------------------------------------------------------------------------------


@functools.cache
def arm() -> Robot:
    """Return the arm of streams and photographs."""
    return load_robot(ROBOTS / "arm_cmm" / "arm_cmm.urdf", "probe")


def stream(data: bytes) -> None:
    """Read two streams, of which the first byte says what is known of their clocks."""
    clock = (Clock(), Clock("given"), Clock("given", latency=True))[data[0] % 3 if data else 0]
    files = unpacked(data[1:])
    tracker, joints = (file(name, files.get(name, b"")) for name in ("tracker.csv", "joints.csv"))
    found = read_stream(tracker, arm(), joints, clock=clock, sigma=1e-4)
    assert np.isfinite(found.readings).all(), "a joint nowhere"


@functools.cache
def streams(seconds: float = 9.0) -> list[bytes]:
    """Return two short streams for every kind of clock."""
    rates = np.linspace(0.7, 1.9, 6)
    t, u = np.arange(0.5, seconds - 0.5, 0.09), np.arange(0.0, seconds, 0.09)

    def readings(at: Array) -> Array:
        return np.asarray(0.5 * np.sin(np.multiply.outer(at, rates) + rates) + 0.3 * np.sin(at[:, None] ** 1.3))

    points = arm().tips(readings(t))[:, :3, 3]
    names = ",".join(f"{reading.name} [rad]" for reading in arm().readings)
    joints = _csv(f"time [s],{names}", np.column_stack([u, readings(u)]))

    def seen(late: float) -> bytes:
        return _csv("time [s],x [m],y [m],z [m]", np.column_stack([t + late, points]))

    return [bytes([k]) + packed({"tracker.csv": seen(1.3 * (k == 0)), "joints.csv": joints}) for k in range(3)]


def _csv(head: str, rows: Array) -> bytes:
    return (head + "\n" + "".join(",".join(f"{v:.4f}" for v in row) + "\n" for row in rows)).encode()


_STREAM_JOB = b"""schema = 1
[robot]
urdf = "arm_cmm.urdf"
tip = "probe"
[error_model]
offsets = "all"
placements = "none"
tool = "fixed"
[[measurements]]
file = "identification.csv"
readings = "validation.csv"
clock = "free"
sigma = "0.1 mm"
"""

_LENS_JOB = b"""schema = 1
[robot]
urdf = "arm_cmm.urdf"
tip = "probe"
[error_model]
offsets = "none"
placements = "none"
base = "fixed"
tool = "pose"
[instruments.camera]
kind = "camera"
camera_on = "tip"
lens = "free"
size = [1280, 720]
sigma = "0.2 px"
[[measurements]]
file = "identification.csv"
observes = "pixels"
instrument = "camera"
[[measurements]]
file = "validation.csv"
observes = "pixels"
instrument = "camera"
use = "validate"
"""


def jobs(urdf: bytes) -> list[bytes]:
    """Return a job of streams and one of pixels with a free lens, packed as the other commands are."""
    of = unpacked(streams()[0][1:])
    pixels = _pixels()
    return [
        packed(
            {
                "calibration.toml": _STREAM_JOB,
                "arm_cmm.urdf": urdf,
                "identification.csv": of["tracker.csv"],
                "validation.csv": of["joints.csv"],
            }
        ),
        packed(
            {
                "calibration.toml": _LENS_JOB,
                "arm_cmm.urdf": urdf,
                "identification.csv": pixels,
                "validation.csv": pixels,
            }
        ),
    ]


def _pixels() -> bytes:
    """Return what a camera on the probe sees of a board's marks in front of it."""
    chance = np.random.default_rng(0)
    readings = 0.25 * chance.normal(size=(14, len(arm().readings))) + 0.5
    tips = arm().tips(readings)
    middle = tips[:, :3, 3].mean(axis=0) + 0.6 * tips[0, :3, 2]
    marks = np.array([(x, y, 0.0) for x in (0.0, 60.0, 120.0) for y in (0.0, 50.0)])
    rows = []
    for q, T in zip(readings, tips, strict=True):
        p = (middle + 1e-3 * marks - T[:3, 3]) @ T[:3, :3]
        for mark, seen in zip(marks, p, strict=True):
            u, v = 900.0 * seen[:2] / seen[2] + (640.0, 360.0)
            if seen[2] > 0.05 and 0 <= u < 1280 and 0 <= v < 720:
                rows.append([*q, u, v, *mark[:2]])
    names = ",".join(f"{reading.name} [rad]" for reading in arm().readings)
    return _csv(f"{names},u [px],v [px],board_x [mm],board_y [mm]", np.array(rows))
