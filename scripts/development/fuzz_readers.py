"""Every reader of the toolkit as a function of bytes, with shipped files to start from: for fuzzing and its tests.

A reader may return anything or raise a CalibError of one short line. Whatever else escapes is a fault, and so is a
warning. Readers of several files take them in one text, each after a line ``%%% name``.
"""

import functools
import io
import json
import random
import re
import shutil
import tomllib
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from scipy.io import savemat

from calib import dh
from calib.assessment.iso9283 import figures
from calib.compensation.controllers.ur_own import with_ur_kinematics
from calib.compensation.targets import targets
from calib.foundations.errors import CalibError
from calib.foundations.json_text import document
from calib.identification.observability import observability
from calib.job.calibrate import calibrate
from calib.job.fleet import Done, FleetJob
from calib.job.fleet_summary import fleet_lines, summary, summary_csv
from calib.job.inputs import load
from calib.job.propose import propose, told
from calib.job.read import parse_job, read_job
from calib.job.run import run
from calib.machine.calibrated import CalibratedMachine
from calib.machine.gaussian import gaussian_bytes, gaussian_from_residuals, load_gaussian
from calib.machine.grid import grid_bytes, grid_from_residuals, load_grid
from calib.machine.model_file import load_machine, model_json
from calib.machine.of_fit import machine_of
from calib.machine.tool_uncertainty import tool_uncertainty
from calib.machine.uncertainty_file import uncertainty_json
from calib.measurement.cycles import cycles
from calib.measurement.formats.sheet import joined, read_sheet
from calib.measurement.from_table import measurements_from_table
from calib.measurement.instruments import Camera
from calib.measurement.kinds import Kind
from calib.measurement.table import read_table
from calib.measurement.touches import touches
from calib.presentation.fleet_tables import fleet_report
from calib.presentation.live import answer, sliders
from calib.presentation.meshes import primitive
from calib.presentation.visuals import visuals
from calib.results.calibration import Calibration
from calib.results.folder import result
from calib.results.result_file import robot_errors
from calib.robot.collision import self_collision
from calib.robot.conditions import ordinary
from calib.robot.load import load_robot
from calib.robot.mesh_files import parse_mesh
from calib.robot.robot import Reading
from calib.robot.urdf import Urdf, inertials, parse_urdf, read_urdf
from calib.robot.urdf_writer import splice_origins
from scripts.development import fuzz_sensors
from scripts.development.fuzz_files import MARK, ROBOTS, Files, file, packed, scratch, shortened, unpacked

LONGEST_SENTENCE = 4000


class Reader(NamedTuple):
    """``read`` takes any bytes; ``seeds`` are good inputs; ``words`` are what a mutation may write into one."""

    read: Callable[[bytes], object]
    seeds: Callable[[], list[bytes]]
    words: tuple[bytes, ...]
    largest: int = 20_000
    seconds: int = 10  # of processor time, of one input; lines that are watched take several times as long


def judge(read: Callable[[bytes], object], data: bytes) -> None:
    """Read ``data``; raise what is a fault, AssertionError for a sentence that is none."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read(data)
        except CalibError as e:
            said = str(e)
            assert said, "an error without a sentence"
            assert "\n" not in said, "a sentence of several lines"
            assert len(said) <= LONGEST_SENTENCE, f"a sentence of {len(said)} characters"


_NUMBER = re.compile(rb"[0-9]+(\.[0-9]+)?")


def mutated(data: bytes, words: tuple[bytes, ...], chance: random.Random) -> bytes:
    """Return ``data`` changed in a few places, as a damaged or a hostile file is."""
    found = bytearray(data)
    for _ in range(chance.randint(1, 5)):
        a = chance.randrange(len(found) + 1)
        b = min(len(found), a + chance.choice((0, 1, 1, 2, 5, 30, 300)))
        match chance.randrange(7):
            case 0:
                found[a:b] = b""
            case 1:
                found[a:b] = chance.choice(words)
            case 2:
                found[a:a] = found[a:b] * chance.choice((1, 2, 50))
            case 3:
                found[a:b] = chance.randbytes(b - a)
            case 4:
                del found[b:]
            case 5:
                # Or one that is there, by another size of it.
                numbers = list(_NUMBER.finditer(found))
                if numbers:
                    which = chance.choice(numbers)
                    found[which.start() : which.end()] = chance.choice(_MAGNITUDES[:9])
            case _:
                # A number by another: between them lie most of the limits.
                found[a:b] = str(chance.choice((0, -1, 1e-300, 1e300, 2**63, 1e7, 0.5, "nan"))).encode()
    return bytes(found)


# Readers. --------------------------------------------------------------------------------------------------------


def _urdf(data: bytes) -> None:
    urdf = parse_urdf(data, "arm.urdf")
    for reader in (inertials, load_robot):
        try:
            found = reader(urdf)
        except CalibError:
            continue
        if reader is load_robot:
            found.tips(np.zeros((1, len(found.readings))))
    if urdf.joints:
        moved = urdf.joints[0].origin.copy()
        moved[:3, 3] += 1e-3
        splice_origins(data, {urdf.joints[0].name: moved}, "arm.urdf")


def _dh(data: bytes) -> None:
    table = dh.parse_dh(data, "table.csv")
    again = dh.parse_dh(dh.write_dh(table).encode(), "table.csv")
    assert again.rows == table.rows, "rows that do not read back"
    dh.dh_to_urdf(table)


_CAMERA = Camera("tip", 1395.2, 1393.8, 648.3, 505.9, -0.1124, 0.1387, 0.00031, -0.00047, -0.0312, 0.2)


def _table(data: bytes) -> None:
    table = read_table(file("table.csv", data))
    readings = [
        Reading(name, "length" if column.unit.dimension == "length" else "angle", None, None)
        for name, column in table.columns.items()
        if column.unit is not None and (name.startswith("joint_") or "_joint" in name)
    ]
    uses: list[Callable[[], object]] = [
        functools.partial(
            measurements_from_table, table, readings, kind, instrument=_CAMERA if kind == "pixels" else None
        )
        for kind in get_args(Kind)
    ]
    uses += [lambda: touches(table, readings), lambda: figures(cycles(table)), lambda: targets(table, _model())]
    for use in uses:
        try:
            use()
        except CalibError as e:
            assert len(str(e)) <= LONGEST_SENTENCE, f"a sentence of {len(str(e))} characters"


def _proposal(data: bytes) -> None:
    path = file("proposed.csv", data)
    found = propose(ROBOTS / "arm_cmm" / "arm_cmm.urdf", [path], tip="probe")
    told(path)
    if not found.questions:
        parse_job(tomllib.loads(found.job(path.parent)), "proposed.toml")
    for question in found.questions:
        assert len(question.sentence) <= LONGEST_SENTENCE, f"a question of {len(question.sentence)} characters"


_SHEETS = (".jsonl", ".json", ".yaml", ".xlsx", ".txt", ".npz")


def _sheet(data: bytes) -> None:
    if data.startswith(b"MATLAB"):
        one = read_sheet(file("sheet.mat", data))
    else:
        kind = _SHEETS[data[0] % len(_SHEETS)] if data else ".jsonl"
        one = read_sheet(file(f"sheet{kind}", data[1:]))
    joined(one, one)
    assert one.csv().count("\n") >= len(one.rows), "rows that are lost"


@functools.cache
def _ur10() -> Urdf:
    return read_urdf("example:ur_description/urdf/ur10_robot.urdf")


def _kinematics(data: bytes) -> None:
    urdf = parse_urdf(with_ur_kinematics(_ur10(), data.decode(errors="replace")), "own.urdf")
    assert np.isfinite(load_robot(urdf, "tool0").tips(np.zeros((1, 6)))).all(), "a tool nowhere"


def _job(data: bytes) -> None:
    read_job(file("job.toml", data))


def _case(data: bytes) -> None:
    files = unpacked(data)
    for name in ("calibration.toml", "arm_cmm.urdf", "identification.csv", "validation.csv"):
        file(name, files.get(name, b""))
    inputs = load(scratch() / "calibration.toml")
    observability(inputs.model, inputs.identify)


def _command(data: bytes) -> None:
    folder = scratch() / "command"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    files = unpacked(data)
    for name in ("calibration.toml", "arm_cmm.urdf", "identification.csv", "validation.csv"):
        (folder / name).write_bytes(files.get(name, b""))
    calibrate(folder / "calibration.toml", folder / "out")
    # Of pixels alone there are no errors of the robot; its machine there is.
    robot_errors(folder / "out")
    load_machine(folder / "out")


def _result(data: bytes) -> None:
    for value in robot_errors(file("result/result.json", data).parent).values():
        assert np.isfinite(value), "an error that is no number"


def _fleet(data: bytes) -> None:
    out = file("fleet/result.json", data).parent
    lines = fleet_lines([Done(FleetJob(Path("job.toml"), "job", out))])
    document(summary(lines))
    summary_csv(lines)
    fleet_report(lines)


def _model_file(data: bytes) -> None:
    file("model/nominal.urdf", _results()["nominal.urdf"])
    model = load_machine(file("model/model.json", data).parent)
    readings = np.zeros((1, len(model.robot.readings)))
    for tool in model.tools:
        assert np.isfinite(model.predict(readings, tool=tool, conditions=ordinary(readings))).all(), "a tool nowhere"


def _uncertainty(data: bytes) -> None:
    for name in ("nominal.urdf", "model.json"):
        file(f"doubts/{name}", _results()[name])
    known = load_machine(file("doubts/uncertainty.json", data).parent)
    tool_uncertainty(known, np.zeros((1, len(known.robot.readings))), next(iter(known.tools)))


def _npz(load_it: Callable[[Path], Any], data: bytes) -> None:
    if data.startswith(MARK):
        text = io.BytesIO()
        with zipfile.ZipFile(text, "w") as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # zipfile's, about names that come twice
            for name, contents in unpacked(data).items():
                archive.writestr(zipfile.ZipInfo(f"{name}.npy"), contents)
        data = text.getvalue()
    known = load_it(file("known.npz", data))
    assert np.isfinite(known.at(np.zeros((1, len(known.readings))), clamp=True)).all(), "an error that is no number"
    known.outside(np.zeros((1, len(known.readings))))


def _live(data: bytes) -> None:
    json.dumps(answer(_model(), data), allow_nan=False)


_LOOKS = b"<!-- looks -->"


@functools.cache
def _looked_at() -> bytes:
    source = _results()["nominal.urdf"]
    for name in (b"base_link", b"link_3"):
        source = source.replace(b'<link name="%s"/>' % name, b'<link name="%s">%s</link>' % (name, _LOOKS))
        source = source.replace(b'<link name="%s">' % name, b'<link name="%s">%s' % (name, _LOOKS))
    assert _LOOKS in source
    return source


def _looks(data: bytes) -> None:
    urdf = parse_urdf(_looked_at().replace(_LOOKS, data), "arm.urdf")
    for shapes in visuals(urdf, (0.5, 0.5, 0.5)).values():
        for shape in shapes:
            if shape is not None and shape.kind != "mesh":
                assert np.isfinite(primitive(shape.kind, shape.sizes, shape.rgb).vertices).all(), "a vertex nowhere"
    robot = load_robot(urdf, "probe")
    self_collision(robot, (), np.zeros((1, len(robot.readings))))


_MESHES = (".stl", ".obj", ".ply", ".off", ".glb", ".dae")


def _mesh(data: bytes) -> None:
    kind = _MESHES[data[0] % len(_MESHES)] if data else ".stl"
    mesh = parse_mesh(data[1:], kind, (0.5, 0.5, 0.5))
    for part in () if mesh is None else mesh.parts:
        assert np.isfinite(part.vertices).all(), "a vertex that is no number"


# Good inputs. ----------------------------------------------------------------------------------------------------


@functools.cache
def _outcome() -> Calibration:
    return run(load(ROBOTS / "arm_cmm" / "calibration.toml"))


def _short_result() -> dict[str, Any]:
    whole = result(_outcome())
    kept = ("trusted", "doubts", "checks", "metrics", "rank", "outliers", "versions", "inputs")
    return {name: whole[name] for name in kept} | {"parameters": whole["parameters"][:2]}


@functools.cache
def _results() -> Files:
    fit = _outcome().fit
    return {
        "nominal.urdf": fit.robot.urdf.source,
        "model.json": model_json(machine_of(fit)).encode(),
        "uncertainty.json": uncertainty_json(machine_of(fit).known_uncertainty, fit.robot).encode(),
        "result.json": json.dumps(_short_result()).encode(),
    }


@functools.cache
def _model() -> CalibratedMachine:
    file("good/nominal.urdf", _results()["nominal.urdf"])
    model = load_machine(file("good/model.json", _results()["model.json"]).parent)
    assert sliders(model)
    return model


def _tables() -> list[bytes]:
    paths = (path for path in sorted(ROBOTS.glob("*/*.csv")) if not path.name.endswith("_truth.csv"))
    return [shortened(path, 9) for path in paths] + [
        b'joint_1 [deg],x [mm],y [mm],z [mm],qw,qx,qy,qz,tool,group\n1,2,3,4,1,0,0,0,"a, b",g\n',
        b"target,x [mm],y [mm],z [mm],command_x [mm],command_y [mm],command_z [mm],direction,time [s]\n"
        b"P1,1,2,3,1,2,3,up,0\nP1,1,2,4,1,2,3,up,1\nP2,1,2,3,1,2,3,down,2\nP2,2,2,4,1,2,3,up,3\n",
        b"joint_1 [deg];x [mm];y [mm];z [mm];direction_joint_1\n1,5;2;3;4;+\n-1,5e1;2;3;4;-\n",
        "\ufeffjoint_1 [deg],u [px],v [px],board_x [mm]\r\n1,700,400,20\r\n".encode(),
        "joint_1 [deg],length [mm],pair\r1,700,a\r2,700,a\r".encode("utf-16"),
    ]


def _foreign() -> list[bytes]:
    """Return tables as other people have them, of the arm CMM."""
    rows = (ROBOTS / "arm_cmm" / "identification.csv").read_text().splitlines()
    numbers = [line for line in rows if line and not line.startswith("#")][1:13]
    head = ",".join(f"J{k}" for k in range(1, 7)) + ",X,Y,Z"
    return [
        "\n".join([head, *numbers]).encode(),
        "\n".join(numbers).replace(",", " ").encode(),
        ("// exported\n" + "\n".join([head, *numbers])).replace(",", ";").replace(".", ",").encode("cp1252"),
        "\n".join(
            [head.replace("J", "A").replace(",X", "_deg,X (mm)"), ",".join(["deg"] * 6 + ["mm"] * 3), *numbers]
        ).encode("utf-16"),
        "\n".join([head + ",A,B,C,target,q1,q2,q3,q4", *(f"{n},1,2,3,a,1,0,0,0" for n in numbers)]).encode(),
    ]


def _sheets() -> list[bytes]:
    """Return files that are no plain tables; the first byte says of which kind."""
    records = [{"name": "P1", "q": [1.5, 2], "pose": {"x": 1, "y": None}}, {"name": "P2", "q": [1, 2e3], "z": True}]
    states = "name: [a, b]\nposition: [1.0, .2]\nvelocity: []\n---\nname: [a, b]\nposition: [1, 2]\n"
    return [
        b"\0" + "\n".join(map(json.dumps, records)).encode(),
        b"\1" + json.dumps(records).encode(),
        b"\1" + json.dumps({"samples": records}).encode(),
        b"\2" + states.encode(),
        b"\2"
        + b"'15':\n  pose: {x: 1, y: 2}\n  joints:\n  - 1\n  - 2\n'16':\n  pose: {x: 1, y: 3}\n  joints: [1, 2]\n",
        b"\4name;x;y\nP1;1,5;2\nP2;1;2\n",
        b"\4MODULE M\n CONST jointtarget p1:=[[1,-2.5,3],[9E9,9E9]];\n CONST jointtarget p2:=[[1,2,3],[9E9,9E9]];\n",
        b'\4P[1:"a"]{\n GP1: UF : 0,\n J1= 1.5 deg, J2= 2 deg,\n J3= 3 deg\n};\nP[2]{\n GP1: UF : 0,\n J1= 1 deg, '
        b"J2= 2 deg,\n J3= 3 deg\n};\n",
        b"\4q = np.array([[1, 2, 3],\n [2, 3, 4],\n [3, 4, 5]])\n",
        b'\4n,q,p\n1,"[1, 2, 3]","(1 2 3)"\n2,"[1, 2, 4]","(1 2 3)"\n',
        b"\4J1=1.5; J2=-2 deg; x=3,25 mm\nJ1=2; J2=-3 deg; x=4 mm\n",
        b"\4P 1\n1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n1 0 0 5\n0 1 0 6\n0 0 1 8\n0 0 0 1\n",
        b"\4Trajectories\n100\n,,arm:a,,,arm:b,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n"
        b"1,0,1,2,3,4,5,6\n2,0,1,2,3,4,5,7\n",
        b"\4NO_OF_FRAMES\t2\nNO_OF_MARKERS\t1\nMARKER_NAMES\ta\na X\ta Y\ta Z\n" + b"1.5\t2\t3\n" * 6,
        b"\4DECL E6POS XP1={X 1.5,Y 2,Z 3,A 4,B 5,C 6,S 2,T 35}\nDECL E6POS XP2={X 1,Y 2,Z 3,A 4,B 5,C 6,S 2,T 35}\n",
        b"\4 movej([0.1, - 1.2, .3], a=1.4, v=1)\n movej([0.1, -1.2, .4], a=1.4, v=1)\n",
        b"\4n  x [mm]  y (mm)\n0  1.5  2\n1  1.0  3\n",
        b'\1{"a": [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17]}',
        b'\1{"columns": ["a", "b"], "index": ["P", "Q"], "data": [[1, 2], [3, null]]}',
        b"\3" + _small_workbook(),
        b"\5" + _small_archive(),
        *map(_matlab, (False, True)),
    ]


def _small_workbook() -> bytes:
    import openpyxl  # noqa: PLC0415 - an extra

    book, held = openpyxl.Workbook(), io.BytesIO()
    for row in (("name", "x [mm]"), ("P1", 1.5), ("P2", "2,5"), (None, 3)):
        book.active.append(row)
    book.active.merge_cells("A3:A4")
    book.save(held)
    return held.getvalue()


def _small_archive() -> bytes:
    held = io.BytesIO()
    np.savez(held, q=np.arange(6.0).reshape(2, 3), n=np.array(["a", "b"]), T=np.ones((2, 4, 4)), k=np.int8([1, 2]))
    return held.getvalue()


def _matlab(packed: bool) -> bytes:
    held = io.BytesIO()
    arrays = {
        "q": np.arange(12.0).reshape(2, 6),
        "T": np.ones((4, 4, 2)),
        "n": "a",
        "c": {"x": 1},
        "k": np.int8([1, 2]),
    }
    savemat(held, arrays, do_compression=packed)
    return held.getvalue()


def _own_kinematics() -> list[bytes]:
    deltas = "".join(f"delta_{name} = [ 1e-4, 0, -2e-5, 0.0003, 0, 0]\n" for name in ("theta", "a", "d", "alpha"))
    return [f"[mounting]\n{deltas}joint_checksum = [ 0xb3241580]\n".encode()]


def _urdfs() -> list[bytes]:
    own = [path.read_bytes() for path in sorted(ROBOTS.glob("*/*.urdf"))]
    small = (
        '<?xml version="1.0" encoding="{}"?>\n<robot name="r\u00e9"><link name="a"/><link name="b"/><link name="c"/>\n'
        '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="1 2 3" rpy="0 .1 0"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="2"/></joint>\n<joint name="k" type="prismatic"><parent link="b"/>'
        '<child link="c"/><mimic joint="j" multiplier="2" offset="-.1"/></joint></robot>'
    )
    return [source for source in own if len(source) < 20_000] + [
        small.format(codec).encode(codec) for codec in ("utf-8", "utf-16", "iso-8859-1", "windows-1252")
    ]


def _dhs() -> list[bytes]:
    return [
        b"convention, modified\nbase, 0 mm, 0 mm, 100 mm, 0 deg, 0 deg, 30 deg\njoint, type, a [mm], d [mm], "
        b"alpha [deg], theta [deg]\njoint_1, revolute, 0, 333, 0, 0\njoint_2, prismatic, 0, 0, -90, 1e1\n",
        b'# a comment\r\na [m],d [m],alpha [rad],theta [rad],beta [deg],joint\r\n0,.1,1.5,0,0.2,"a, b"\r\n',
    ]


def _jobs() -> list[bytes]:
    return [path.read_bytes() for path in sorted(ROBOTS.glob("*/calibration*.toml"))]


def _cases() -> list[bytes]:
    folder = ROBOTS / "arm_cmm"
    files = {name: (folder / name).read_bytes() for name in ("calibration.toml", "arm_cmm.urdf")}
    files |= {name: shortened(folder / name) for name in ("identification.csv", "validation.csv")}
    return [packed(files)]


_MORE = b"""
[instruments.tracker]
kind = "laser_tracker"
sigma = "15 um"
sigma_per_metre = "6 um"
station = ["0 m", "1 m", "2 m"]

[base]
position = ["10 mm", "0 mm", "5 mm"]
quaternion = [1.0, 0.0, 0.0, 0.0]

[tools.tool]
position = ["1 mm", "2 mm", "3 mm"]

[[levels]]
name = "one"
free = ["*offset"]

[[levels]]
name = "two"
free = ["*"]
"""


def _commands() -> list[bytes]:
    """Return the case as it is, and with most of what a job may say; few rows, that many are tried."""
    folder = ROBOTS / "arm_cmm"
    job = (folder / "calibration.toml").read_bytes()
    files = {"arm_cmm.urdf": re.sub(rb"<visual>.*</visual>", b"", (folder / "arm_cmm.urdf").read_bytes())}
    files |= {name: shortened(folder / name, 30) for name in ("identification.csv", "validation.csv")}
    heavy = files["arm_cmm.urdf"].replace(b"</link>", b'<inertial><mass value="2"/></inertial></link>')
    changes: dict[bytes, bytes] = {
        b'tip = "probe"': b'tip = "probe"\ngravity = ["0 m/s2", "0 m/s2", "-9.81 m/s2"]\n'
        b'payload = { mass = "5 kg", position = ["0 m", "10 mm", "0 m"] }',
        b'offsets = "all"': b'offsets = "all"\nelastic = ["joint_2"]\nharmonics = ["joint_1"]\n'
        b'prior = { length = "1 mm", '
        b'angle = "0.3 deg", harmonics = "0.1 mrad", elastic = "10 urad/Nm" }',
        b'sigma = "0.02 mm"': b'sigma = "0.02 mm"\nmodel_sigma = "0.01 mm"\nloss = "huber"',
    }
    full = job
    for old, new in changes.items():
        full = full.replace(old, new, 1)
    fixed = full.replace(b'base = "pose"', b'base = "fixed"').replace(b'tool = "position"', b'tool = "fixed"')
    placed = fixed.replace(b'sigma = "0.02 mm"\nmodel', b'instrument = "tracker"\nmodel') + _MORE
    jobs = ((job, files), (full, files | {"arm_cmm.urdf": heavy}), (placed, files | {"arm_cmm.urdf": heavy}))
    more = fuzz_sensors.jobs(files["arm_cmm.urdf"])
    return [packed({"calibration.toml": text, **others}) for text, others in jobs] + more


def _arrays(data: bytes) -> list[bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return [data, packed({name.removesuffix(".npy"): archive.read(name) for name in archive.namelist()})]


_TWO = functools.partial(Reading, dimension="angle", lower=None, upper=None)
_READINGS = [_TWO("joint_1"), _TWO("joint_2")]
_NODES = np.array([(a, b) for a in (0.0, 0.5, 1.0) for b in (0.0, 0.5)])


def _grids() -> list[bytes]:
    errors = 1e-4 * np.arange(18.0).reshape(6, 3)
    return _arrays(grid_bytes(grid_from_residuals(_NODES, errors, _READINGS, ["joint_1", "joint_2"], "base")))


def _gaussians() -> list[bytes]:
    chance = np.random.default_rng(0)
    points = chance.uniform(-1.0, 1.0, (30, 2))
    errors = 1e-4 * np.sin(points @ np.ones((2, 3))) + 1e-6 * chance.normal(size=(30, 3))
    return _arrays(gaussian_bytes(gaussian_from_residuals(points, errors, _READINGS, None, "base")))


def _shapes() -> list[bytes]:
    return [
        b'<visual><origin xyz="0 0 .1" rpy="0 0 1"/><geometry><%s/></geometry><material name="red"><color '
        b'rgba="1 0 0 1"/></material></visual><collision><geometry><%s/></geometry><origin xyz="1 0 0"/></collision>'
        % (shape, shape)
        for shape in (
            b'box size=".1 .2 .3"',
            b'sphere radius=".1"',
            b'cylinder radius=".1" length=".2"',
            b'capsule radius=".1" length=".2"',
            b'mesh filename="package://a/b.stl" scale="1 1 1e-3"',
        )
    ]


def _meshes() -> list[bytes]:
    import trimesh  # noqa: PLC0415 - slow to load

    ball = trimesh.creation.icosphere(subdivisions=0)
    texts = [ball.export(file_type=kind[1:]) for kind in _MESHES[:-1]]
    dae = (
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>'
        '<unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>'
        '<source id="p"><float_array id="a" count="9">0 0 0 1 0 0 0 1 0</float_array><technique_common><accessor '
        'source="#a" count="3" stride="3"><param name="X" type="float"/><param name="Y" type="float"/><param name="Z" '
        'type="float"/></accessor></technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/>'
        '</vertices><triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>'
        '</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node><instance_geometry '
        'url="#g"/></node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>'
        "</COLLADA>"
    )
    return [bytes([k]) + (text.encode() if isinstance(text, str) else text) for k, text in enumerate([*texts, dae])]


_NUMBERS = (b"1e400", b"-1e308", b"1e-320", b"nan", b"inf", b"-0.0", b"9" * 400, b"1_0", b"0x1p3", b"1,5", b"\xd9\xa1")
_MAGNITUDES = tuple(
    b"%s" % text.encode() for text in ("0", "1e-300", "1e-12", "1e-6", "1e3", "1e6", "1e9", "1e100", "1e300")
)
_MAGNITUDES += (b"1e-6 mm", b"1e3 mm", b"1e-9 m", b"1e4 m", b"-1e4 m", b"1e9 m", b"1e300 m", b"1e-6 mrad", b"1e3 mrad")
_MAGNITUDES += (
    b"100 m/s2",
    b"1e7 m/s2",
    b"1e5 kg",
    b"1e300 kg",
    b"1e-9 urad/Nm",
    b"1e6 urad/Nm",
    b"1000000",
    b"0.5 rad",
)
_REPEATED = (
    b'[[measurements]]\nfile = "identification.csv"\nsigma = "1 mm"\n' * 3,
    b'[[levels]]\nname = "l"\nfree = ["*"]\n' * 3,
)
_REPEATED += (
    b'"all"',
    b'["*"]',
    b'<link name="l"/>' * 3,
    b'terms = "auto"',
    b"harmonic_orders = [1, 2, 3, 4, 5, 6, 7, 8, 9]",
)
_ODD = (b"\0", b"\xef\xbb\xbf", b"\xff\xfe", b"\r", b"\n", b"\x1b[31m", b"\xe2\x80\xae", b"\xc3", b"=1+1", b"../..")
_XML = (b"<", b"/>", b"<!DOCTYPE a [", b"<!ENTITY a 'b'>", b"&a;", b"<![CDATA[", b"]]>", b"<!--", b"&#9;", b"xacro:if")
_XML += (b'<joint name="', b'type="continuous"', b"<mimic ", b"<inertial>", b'<mass value="', b"<axis ", b"<origin ")
_LOOK = (b"<visual>", b"</visual>", b"<collision>", b"<geometry>", b"</geometry>", b"<box ", b'size="', b"<sphere ")
_LOOK += (b'radius="', b"<cylinder ", b'length="', b"<capsule ", b"<mesh ", b'filename="', b'scale="', b"<material ")
_CSV = (b",", b";", b"\t", b'"', b'""', b"#", b" [mm]", b" [deg]", b"qw", b"sigma [mm]", b"group", b"length [mm]")
_CSV += (b"pair", b"target", b"indicated [mm]", b"diameter [mm]", b"ball [mm]", b"tau_joint_1 [Nm]", b"direction")
_TOML = (
    b"[[",
    b"]]",
    b"{",
    b"}",
    b"=",
    b'"""',
    b"'",
    b"2026-01-01",
    b"0x" + b"f" * 5000,
    b"a.a.a.",
    b"\\u0000",
    b"inf",
)
_TOML += (b"true", b'"1 mm"', b'"-1 deg"', b'"all"', b"[relations]", b"position", b"hold_out = 0.2", b"loss", b"terms")
_JSON = (
    b"[",
    b"]",
    b"{",
    b"}",
    b":",
    b"null",
    b"NaN",
    b"Infinity",
    b"-Infinity",
    b"1e999",
    b'"\\ud800"',
    b"true",
    b'"',
)
_BAG = (b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"op=\x02", b"op=\x07", b"topic=", b"type=", b"string[] name\n")
_BAG += (b"float64[99999999] position\n", b"\xff\xff\xff\x7f", b"cdr", b"bz2", b"lz4", b"zstd", b"sqlite3", b"jazzy")
_YAML = (b"%YAML:1.0\n", b"!!opencv-matrix", b"!!python/object:", b"&a", b"*a", b"? ", b"- ", b": ", b"[", b"]", b"|\n")
_YAML += (b"cam0:", b"data: ", b"D: ", b"rational_polynomial", b".inf", b".nan", b"0x10", b"1:30", b"2026-01-01")
_NPY = (b"'descr': ", b"'<f8'", b"'|O'", b"'>i4'", b"'<U9999999'", b"(1000000000000,)", b"True", b"(-1,)", b"(", b"PK")

READERS: dict[str, Reader] = {
    "urdf": Reader(_urdf, _urdfs, _NUMBERS + _ODD + _XML),
    "dh": Reader(_dh, _dhs, _NUMBERS + _ODD + _CSV),
    "table": Reader(_table, _tables, _NUMBERS + _ODD + _CSV),
    "proposal": Reader(_proposal, _foreign, _NUMBERS + _ODD + _CSV),
    "sheet": Reader(_sheet, _sheets, _NUMBERS + _ODD + _CSV + _JSON),
    "kinematics": Reader(_kinematics, _own_kinematics, _NUMBERS + _ODD),
    "job": Reader(_job, _jobs, _NUMBERS + _ODD + _TOML),
    "case": Reader(_case, _cases, _NUMBERS + _ODD + _TOML + _CSV + _XML),
    "command": Reader(_command, _commands, _MAGNITUDES + _REPEATED + _NUMBERS + _ODD + _TOML + _CSV + _XML, 40_000, 60),
    "result": Reader(_result, lambda: [_results()["result.json"]], _NUMBERS + _ODD + _JSON),
    "fleet": Reader(_fleet, lambda: [_results()["result.json"]], _NUMBERS + _ODD + _JSON),
    "model": Reader(_model_file, lambda: [_results()["model.json"]], _NUMBERS + _ODD + _JSON),
    "uncertainty": Reader(
        _uncertainty, lambda: [_results()["uncertainty.json"]], _NUMBERS + _ODD + _JSON, largest=80_000
    ),
    "grid": Reader(functools.partial(_npz, load_grid), _grids, _NUMBERS + _ODD + _NPY),
    "gaussian": Reader(functools.partial(_npz, load_gaussian), _gaussians, _NUMBERS + _ODD + _NPY),
    "live": Reader(_live, lambda: [b'{"readings": [0, 1, 2, 3, 4, 5], "apart": 100.0}'], _NUMBERS + _ODD + _JSON),
    "looks": Reader(_looks, _shapes, _NUMBERS + _ODD + _XML + _LOOK),
    "recording": Reader(fuzz_sensors.recording, fuzz_sensors.recordings, _NUMBERS + _ODD + _BAG, largest=60_000),
    "importing": Reader(
        fuzz_sensors.importing, fuzz_sensors.imports, _NUMBERS + _ODD + _CSV + _TOML + _JSON + _BAG, 60_000, 60
    ),
    "log": Reader(fuzz_sensors.log, fuzz_sensors.logs, _NUMBERS + _ODD + _CSV),
    "photograph": Reader(fuzz_sensors.photograph, fuzz_sensors.photographs, _NUMBERS + _ODD, largest=60_000),
    "session": Reader(fuzz_sensors.session, fuzz_sensors.sessions, _NUMBERS + _ODD + _CSV + _TOML),
    "board": Reader(fuzz_sensors.board, fuzz_sensors.boards, _NUMBERS + _ODD + _TOML),
    "lens": Reader(fuzz_sensors.lens, fuzz_sensors.lenses, _NUMBERS + _ODD + _YAML),
    "stream": Reader(fuzz_sensors.stream, fuzz_sensors.streams, _NUMBERS + _ODD + _CSV),
    "mesh": Reader(_mesh, _meshes, _NUMBERS + _ODD + _XML, largest=4_000),
}
