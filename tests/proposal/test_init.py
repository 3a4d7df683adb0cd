"""``calib init``, and ``calib check`` of files before there is a job."""

import json
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.arrays import Array
from calib.robot.sources import resolve
from tests.proposal.twins import TWINS
from tests.support import machines
from tests.support.cases import run
from tests.support.people import PANDA, UR10, Session, quaternions, robot, session, text

UR10_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
OF = {twin.name: twin for twin in TWINS}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def told_of(folder: Path, s: Session, titles: list[str], values: Array) -> tuple[str, dict[str, str]]:
    """What ``calib init`` says of joints, point and other columns, in a line, and which it reads as what."""
    joints = [f"A{k} [deg]" for k in range(1, 7)]
    measured = [np.degrees(s.readings), 1e3 * s.position, values]
    (folder / "measured.csv").write_text(
        text([*joints, "x [mm]", "y [mm]", "z [mm]", *titles], measured), encoding="utf-8"
    )
    said = run("init", UR10, "measured.csv", "--yes")
    assert said.code == 0
    (table,) = tomllib.loads((folder / "calibration.toml").read_text(encoding="utf-8"))["measurements"]
    return " ".join(said.out.split()), table["columns"]


def put(folder: Path, name: str, file: str = "measured.csv") -> str:
    contents = OF[name].contents()
    (folder / file).write_bytes(contents if isinstance(contents, bytes) else contents.encode())
    return file


def test_from_files_to_a_report_in_two_commands(folder: Path) -> None:
    put(folder, "FANUC")
    said = run("init", UR10, "measured.csv", "--yes")
    assert (said.code, said.err) == (0, "")
    assert "in deg: the points are then" in " ".join(said.out.split())
    assert 'orientation = "wpr"' in (folder / "calibration.toml").read_text(encoding="utf-8")
    assert run("calibrate", "calibration.toml", "-o", "out", "-q") == (0, "", "")
    result = json.loads((folder / "out" / "result.json").read_text(encoding="utf-8"))
    assert result["trusted"]
    assert result["metrics"]["validation"]["after"]["position"]["rms"] < 1e-4
    for observes in ((), ("--observes", "pose")):  # of its own titles; positions are asked for where nothing is said
        verified = run("verify", "out", "measured.csv", *observes)
        assert (verified.code, verified.err) == (0, "")
        assert "as calibrated" in verified.out


def test_titles_of_any_characters_are_written_whole(folder: Path) -> None:
    put(folder, "no units")
    text = (folder / "measured.csv").read_text(encoding="utf-8")
    title = 'X "\\\x7f\U0001f916-'
    (folder / "measured.csv").write_text(text.replace("X", title, 1), encoding="utf-8")
    assert run("init", UR10, "measured.csv", "-q").code == 0
    job = tomllib.loads((folder / "calibration.toml").read_text(encoding="utf-8"))
    assert job["measurements"][0]["columns"]["x [mm]"] == title


@pytest.mark.parametrize("numbered", ["position[{}]", "q({})", "axis/{}"])
@pytest.mark.parametrize("first", [0, 1])
def test_numbers_in_brackets_are_of_the_name_and_no_unit(folder: Path, numbered: str, first: int) -> None:
    """As of an array in a message: of ``position[1]`` the 1 was taken for the unit of plain numbers."""
    put(folder, "no units")
    header, rows = (folder / "measured.csv").read_text(encoding="utf-8").split("\n", 1)
    titles = [numbered.format(first + k) for k in range(6)]
    (folder / "measured.csv").write_text(",".join([*titles, *header.split(",")[6:]]) + "\n" + rows, encoding="utf-8")
    assert run("init", UR10, "measured.csv", "-q").code == 0
    job = tomllib.loads((folder / "calibration.toml").read_text(encoding="utf-8"))
    assert list(job["measurements"][0]["columns"].values())[:6] == titles
    assert run("check", "calibration.toml").code == 0


@pytest.mark.parametrize(
    ("urdf", "table", "job"),
    [
        ("arm.urdf", "measured.csv", "link/calibration.toml"),
        ("link/../arm.urdf", "link/measured.csv", "calibration.toml"),
        ("a:b.urdf", "measured.csv", "elsewhere/calibration.toml"),
        ("./example:arm.urdf", "measured.csv", "elsewhere/deep/../deep/calibration.toml"),
    ],
)
def test_a_job_finds_its_files_behind_links_and_whatever_they_are_called(
    folder: Path, urdf: str, table: str, job: str
) -> None:
    (folder / "elsewhere" / "deep").mkdir(parents=True)
    (folder / "link").symlink_to(folder / "elsewhere" / "deep")
    shutil.copyfile(resolve(UR10), urdf)
    put(folder, "FANUC", table)
    assert run("init", urdf, table, "-o", job, "--yes", "-q") == (0, "", "")
    assert run("check", job, "-q") == (0, "", "")


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("測定\u3000１.csv", "測定\u3000１.csv"),
        ("اندازه\u200cها.csv", "اندازه\u200cها.csv"),
        ("v\x9b2J\u202e\u2028.csv", "v\\x9b2J\\u202e\\u2028.csv"),
    ],
)
def test_a_job_names_files_as_they_are_called_and_commands_nothing(folder: Path, name: str, shown: str) -> None:
    put(folder, "FANUC", name)
    assert run("init", UR10, name, "--yes", "-q") == (0, "", "")
    text = (folder / "calibration.toml").read_text(encoding="utf-8")
    assert f"# {shown}: " in text
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u202e]", text)
    assert tomllib.loads(text)["measurements"][0]["file"] == name


def test_a_file_whose_name_is_no_text_is_told(folder: Path) -> None:
    put(folder, "FANUC", "\udcff.csv")
    said = run("init", UR10, "\udcff.csv", "--yes")
    assert said.err == "Error: '\\udcff.csv': is not UTF-8 text, and no job can name it; rename it.\n"
    assert not (folder / "calibration.toml").exists()


def test_a_tracker_that_was_moved_is_told_with_the_row(folder: Path) -> None:
    put(folder, "a tracker that was moved, and nothing says so")
    said = run("init", UR10, "measured.csv", "--yes")
    assert said.code == 1
    assert "rows 1 to 20 and the rows after them fit the arm separately" in " ".join(said.err.split())
    put(folder, "stations under a word of their own")
    said = run("init", UR10, "measured.csv", "--yes")
    assert said.err.endswith("answer by --column 'setup=Station' or --column 'tool=Station'.\n")
    assert run("init", UR10, "measured.csv", "--column", "setup=Station", "-q") == (0, "", "")
    assert run("calibrate", "calibration.toml", "-o", "out", "-q") == (0, "", "")
    result = json.loads((folder / "out" / "result.json").read_text(encoding="utf-8"))
    assert sorted(result["setups"]) == ["7", "8"]


def two_tools(folder: Path, named: bool, moved: float = 0.0) -> None:
    """Write two tables, each of a tool of its own; ``named``: a column calls both the same; ``moved``: the base."""
    arm = machines.arm(UR10, "tool0")
    rng = np.random.default_rng(3)
    for name, at, y in (("light", (0.05, 0.02, 0.15), 0.4), ("heavy", (-0.12, 0.06, 0.03), 0.4 + moved)):
        readings = arm.draw(rng, 40)
        seen = machines.Machine(arm, machines.pose((2.0, y, 0.1), (0.0, 0.0, 1.1)), {"tool": machines.pose(at)})
        columns = machines.table(arm, readings, seen.see(readings), "position")
        rows = [",".join(f"{v:.9f}" for v in row) for row in np.column_stack(list(columns.values()))]
        lines = [",".join(columns), *rows]
        more = ["tool", *["ball"] * len(rows)] if named else []
        lines = [f"{line},{word}" for line, word in zip(lines, more, strict=True)] if named else lines
        (folder / f"{name}.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")


def test_tables_with_a_tool_of_their_own_name_it(folder: Path) -> None:
    two_tools(folder, named=False)
    said = run("init", UR10, "light.csv", "heavy.csv", "--yes")
    assert (said.code, said.err) == (0, "")
    assert "light.csv, heavy.csv: the tool is another one in each: the arm misses" in " ".join(said.out.split())
    job = tomllib.loads((folder / "calibration.toml").read_text(encoding="utf-8"))
    assert [table["tool"] for table in job["measurements"]] == ["light", "heavy"]
    assert run("check", "calibration.toml").code == 0


def test_tables_with_a_tool_and_a_set_up_of_their_own_name_both(folder: Path) -> None:
    """As of a tracker and a tool that are taken away between days: either of the two alone leaves centimetres."""
    two_tools(folder, named=False, moved=0.8)
    said = run("init", UR10, "light.csv", "heavy.csv", "--yes")
    assert (said.code, said.err) == (0, "")
    told = (
        "light.csv, heavy.csv: the tool is another one in each and robot or instrument stood elsewhere in each: the arm"
    )
    assert told in " ".join(said.out.split())
    job = tomllib.loads((folder / "calibration.toml").read_text(encoding="utf-8"))
    for what in ("tool", "setup"):
        assert [table[what] for table in job["measurements"]] == ["light", "heavy"]
    assert run("check", "calibration.toml").code == 0


@pytest.mark.parametrize("strayed", [(17,), (5, 20)])
def test_a_few_rows_that_lie_far_off_are_named(folder: Path, strayed: tuple[int, ...]) -> None:
    """One point of 27 of a real UR5 was of another pose: it was asked whether this was the robot, and no row named."""
    arm = machines.arm(UR10, "tool0")
    readings = arm.draw(np.random.default_rng(3), 30)
    seen = machines.Machine(
        arm, machines.pose((2.0, 0.4, 0.1), (0.0, 0.0, 1.1)), {"tool": machines.pose((0.1, 0, 0.1))}
    )
    columns = machines.table(arm, readings, seen.see(readings), "position")
    rows = np.column_stack(list(columns.values()))
    rows[list(strayed), -3:] += (0.7, -0.8, 0.4)
    lines = ["q1,q2,q3,q4,q5,q6,X,Y,Z", *(",".join(f"{v:.6f}" for v in row) for row in rows), ""]
    (folder / "measured.csv").write_text("\n".join(lines), encoding="utf-8")
    said = run("init", UR10, "measured.csv", "--yes")
    numbers = ", ".join(str(k + 1) for k in strayed)
    assert said.code == 1
    assert f"without row{'s' * (len(strayed) > 1)} {numbers} after the header" in said.err
    (folder / "measured.csv").write_text("\n".join(lines[: 1 + strayed[0]] + lines[22:]), encoding="utf-8")
    assert run("init", UR10, "measured.csv", "--yes").code == 0


def test_a_tool_that_a_column_names_is_named_by_nothing_else(folder: Path) -> None:
    two_tools(folder, named=True)
    said = run("init", UR10, "light.csv", "heavy.csv", "--yes")
    assert said.code == 1
    assert "it looks as if each table has a tool of its own" in said.err
    assert not (folder / "calibration.toml").exists()


def test_nothing_is_written_over_and_nothing_where_something_is_asked(folder: Path) -> None:
    put(folder, "four rows without units, of which two would do")
    said = run("init", UR10, "measured.csv", "--yes")
    assert said.code == 1
    assert said.err.startswith("Error: measured.csv: J1 to J6 have no unit, and rad and deg are both within the limits")
    assert said.err.endswith("answer by --angles rad or --angles deg.\n")
    assert not (folder / "calibration.toml").exists()
    (folder / "calibration.toml").write_text("mine")
    said = run("init", UR10, "measured.csv", "--yes", "--angles", "rad")
    assert (said.code, said.err) == (1, "Error: calibration.toml: already exists; choose another name.\n")
    assert (folder / "calibration.toml").read_text() == "mine"


def test_cells_that_are_no_numbers_and_columns_without_a_name_are_told(folder: Path) -> None:
    titles = [f"{joint}_joint [rad]" for joint in UR10_JOINTS] + ["x [mm]", "y [mm]", "z [mm]"]
    row = ",".join(["\u20130.5"] * len(titles))
    (folder / "a.csv").write_text("\n".join([",".join(titles), row, row]), encoding="utf-8")
    assert run("init", UR10, "a.csv", "-y") == (
        *(1, ""),
        "Error: a.csv: column 'shoulder_pan_joint [rad]' is of a joint, and '\u20130.5' in it is no number, like "
        "12.5 or 1.25e1.\n",
    )
    # One cell of many, in whichever joint: the rest is not taken for a shorter arm.
    for k in range(6):
        row = [f"0.{k}" for k in range(1, len(titles) + 1)]
        damaged = [*row[:k], "0.5 rad", *row[k + 1 :]]
        (folder / "a.csv").write_text("\n".join(",".join(r) for r in [titles, row, row, damaged, row]))
        said = run("init", UR10, "a.csv", "-y")
        assert (said.code, said.out) == (1, "")
        assert f"column '{titles[k]}' is of a joint, and '0.5 rad' in it is no number" in said.err
    damaged = [*row[:6], "1.234,5", *row[7:]]
    (folder / "a.csv").write_text("\n".join(",".join(f'"{c}"' for c in r) for r in [titles, row, row, damaged, row]))
    said = run("init", UR10, "a.csv", "-y")
    assert (said.code, said.out) == (1, "")
    assert "column 'x [mm]' is of a point, and '1.234,5' in it is no number" in said.err


def test_columns_without_a_name_are_called_by_their_place(folder: Path) -> None:
    """A separator at the end of every line makes one, and so do the row numbers that pandas writes."""
    put(folder, "no units")
    lines = (folder / "measured.csv").read_text(encoding="utf-8").splitlines()
    numbers = ["", *map(str, range(len(lines) - 1))]
    rows = [f"{number},{line}," for number, line in zip(numbers, lines, strict=True)]
    (folder / "measured.csv").write_text("\n".join(rows), encoding="utf-8")
    said = run("init", UR10, "measured.csv", "-y")
    assert (said.code, said.err) == (0, "")
    assert "not read: 'column 1', 'column 11'." in " ".join(said.out.split())
    assert run("check", "calibration.toml").code == 0


@pytest.mark.parametrize(
    ("rows", "title", "x", "says"),
    [
        (1, "x", "100", "only one row has numbers in a1 to a6 and x, y, z"),
        (2, "x", "100", "a1 to a6 have no unit, and rad and deg are both within the limits"),
        (2, "x [deg]", "100", "a1 to a6 or the point have units of another quantity"),
        (2, "x", "1e308", "a1 to a6 and x, y, z have numbers that no arm has, beyond 10000 rad or m"),
    ],
)
def test_columns_that_can_be_read_in_no_way_are_told_why(
    folder: Path, rows: int, title: str, x: str, says: str
) -> None:
    table = [f"a1,a2,a3,a4,a5,a6,{title},y,z", f"0.1,0.2,0.3,0.4,0.5,0.6,{x},200,300", "0.2,0,0.3,0,0.5,0,10,20,30"]
    (folder / "few.csv").write_text("\n".join(table[: rows + 1]))
    said = run("init", UR10, "few.csv", "-y")
    assert said.code == 1
    assert says in said.err


def test_files_by_their_names_judge(folder: Path) -> None:
    put(folder, "no units")
    put(folder, "semicolons and decimal commas", "validation.csv")
    assert run("init", UR10, "measured.csv", "validation.csv", "-q").code == 0
    job = (folder / "calibration.toml").read_text(encoding="utf-8")
    assert job.count('use = "validate"') == 1
    assert "hold_out" not in job


def test_check_looks_into_files_and_writes_nothing(folder: Path) -> None:
    put(folder, "no units")
    said = run("check", UR10, "measured.csv", "--json")
    assert said.code == 0
    assert json.loads(said.out)["toml"].startswith("schema = 1\n")
    assert [path.name for path in folder.iterdir()] == ["measured.csv"]
    assert "7 joints from" in run("check", PANDA).out or "joints from" in run("check", PANDA).out
    assert "without a unit" in run("check", "measured.csv").out
    assert run("check", UR10, "measured.csv", "calibration.toml").code == 2


@pytest.mark.parametrize("name", ["measured.log", "measured"])
def test_check_takes_beside_a_robot_what_init_takes(folder: Path, name: str) -> None:
    put(folder, "no units", name)
    found = run("check", UR10, name, "--json")
    assert found.code == 0
    assert run("init", UR10, name, "-q").code == 0
    assert json.loads(found.out)["toml"] == (folder / "calibration.toml").read_text(encoding="utf-8")


def test_a_job_with_a_header_of_others_is_told_what_fits(folder: Path) -> None:
    put(folder, "KUKA")
    run("init", UR10, "measured.csv", "-q")
    job = (folder / "calibration.toml").read_text(encoding="utf-8")
    line = next(line for line in job.splitlines() if line.startswith("columns"))
    kept = [one for one in job.splitlines() if not one.startswith(("columns", "orientation"))]
    (folder / "calibration.toml").write_text("\n".join(kept), encoding="utf-8")
    said = run("check", "calibration.toml")
    assert said.code == 1
    assert "'A1', 'A2', 'A3', 'A4', 'A5', 'A6', 'X', 'Y', 'Z', 'A', 'B', 'C' have no unit" in said.err
    assert line in said.err
    assert 'orientation = "abc"' in said.err


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--angles", "mm"], "angles: 'mm' is not one of rad, mrad, urad, deg."),
        (["--orientation", "upside"], "orientation: 'upside' is not one of rotation_vector, matrix, abc,"),
        (["--column", "x"], "--column: 'x' is not like 'x=X2': our name, and the title in the file."),
        (["--column", "x=A", "--column", "x=B"], "--column: 'x' has two titles, 'A' and 'B'; give it one."),
        (["--column", "x=Q"], "columns: x is to be 'Q', which is no column of measured.csv."),
        (["--tip", "nowhere"], "tip: 'nowhere' is not a link of"),
        (["--observes", "plane"], "observes: 'plane' is not one of position, pose, socket, distance."),
        (["--column", "foo=X"], "columns: 'foo' is neither a joint of the arm nor a known column."),
        (["--column", "rx=X"], "columns: 'rx' is of an orientation, whose columns the fit finds;"),
        (["--column", "qw=X"], "columns: qw is to be 'X', which is no scalar of a quaternion in measured.csv."),
        (["--column", "x=Y"], "measured.csv: its columns cannot be read as answered, 'x=Y'; name"),
        (["--observes", "pose"], "measured.csv: poses are to be read, and no columns are an orientation of the point"),
        (["--orientation", "abc"], "orientation: 'abc' says what three angles or a matrix are, and no table has them;"),
    ],
)
def test_answers_that_are_none(folder: Path, options: list[str], sentence: str) -> None:
    put(folder, "no units")
    said = run("check", UR10, "measured.csv", *options)
    assert said.code == 1
    assert said.err.startswith(f"Error: {sentence}")


@pytest.mark.parametrize(("order", "scalar"), [("wxyz", "Q0"), ("xyzw", "Q3")])
def test_the_scalar_of_a_quaternion_may_be_named_where_the_hand_never_turns(
    folder: Path, order: str, scalar: str
) -> None:
    arm, (pan, lift, elbow) = robot(UR10, "tool0"), np.random.default_rng(2).uniform(-1.0, 1.0, (3, 60))
    flat = np.full(60, 0.4)
    q = np.column_stack([pan, lift - 1.2, elbow + 1.2, -lift - elbow, pan + 0.3, flat])
    tips = arm.tips(q)
    turned = quaternions(tips[:, :3, :3] @ Rotation.from_rotvec([0.4, -0.9, 1.3]).as_matrix(), order)
    tips[:, :3, 3] += 1e-3 * np.sin(3.0 * q[:, :3])
    titles = [*(f"J{k + 1} [deg]" for k in range(6)), "X [mm]", "Y [mm]", "Z [mm]", "Q0", "Q1", "Q2", "Q3"]
    measured = [np.degrees(q), 1e3 * tips[:, :3, 3], turned]
    (folder / "measured.csv").write_text(text(titles, measured), encoding="utf-8")
    asked = run("init", UR10, "measured.csv", "--yes")
    assert asked.code == 1
    assert "Q0, Q1, Q2, Q3 fit equally well as a quaternion with the scalar Q" in asked.err
    assert "--column 'qw=Q0'" in asked.err
    assert "--column 'qw=Q3'" in asked.err
    said = run("init", UR10, "measured.csv", "--yes", "--column", f"qw={scalar}")
    assert said.code == 0, said.err
    columns = tomllib.loads((folder / "calibration.toml").read_text(encoding="utf-8"))["measurements"][0]["columns"]
    assert columns["qw"] == scalar


@pytest.mark.parametrize("named", [False, True])
def test_what_a_controller_computed_is_no_measurement_beside_a_marker(folder: Path, named: bool) -> None:
    s = session()
    axes, numbers = (
        ("x", "y", "z", "rx", "ry", "rz"),
        ("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"),
    )
    titles = [*(f"marker_{axis}" for axis in axes), *numbers, *(f"measured_{axis}" for axis in axes)]
    marker = [s.position, Rotation.from_matrix(s.rotation).as_rotvec()]
    computed = [s.flange[:, :3, 3], Rotation.from_matrix(s.flange[:, :3, :3]).as_rotvec()]
    (folder / "measured.csv").write_text(text(titles, [*marker, s.readings, *computed]), encoding="utf-8")
    answers = [word for axis in "xyz" for word in ("--column", f"{axis}=marker_{axis}")] if named else []
    said = run("init", UR10, "measured.csv", "--yes", *answers)
    assert said.code == 0, said.err
    table = tomllib.loads((folder / "calibration.toml").read_text(encoding="utf-8"))["measurements"][0]
    assert table["orientation"] == "rotation_vector"
    assert {table["columns"][f"{axis} [m]"] for axis in "xyz"} == {"marker_x", "marker_y", "marker_z"}
    assert table["columns"]["rx [rad]"] == "marker_rx"
    computed_is_said = "measured_x, measured_y, measured_z are computed from the joints" in " ".join(said.out.split())
    assert computed_is_said is not named


def test_a_torque_may_be_named(folder: Path) -> None:
    s = session()
    torque = np.cos(s.readings[:, 0])
    titles = [*(f"{reading.name} [deg]" for reading in robot(UR10, "tool0").readings), "x [mm]", "y [mm]", "z [mm]"]
    measured = [np.degrees(s.readings), 1e3 * s.position, torque]
    (folder / "measured.csv").write_text(text([*titles, "load [Nm]"], measured), encoding="utf-8")
    joint = robot(UR10, "tool0").readings[1].name
    said = run("init", UR10, "measured.csv", "--column", f"tau_{joint} [Nm]=load", "-q")
    assert said == (0, "", "")
    assert f'"tau_{joint} [Nm]" = "load [Nm]"' in (folder / "calibration.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("titles", "read"),
    [
        ([f"tau_{k}" for k in range(1, 7)], True),
        ([f"Torque{k} [Nm]" for k in range(1, 7)], True),
        ([f"effort {k} [N]" for k in range(1, 7)], False),
        ([f"tau_{k}" for k in range(1, 6)] + ["other"], False),
        ([f"tau_{k}" for k in range(2, 8)], False),
    ],
)
def test_torques_are_those_of_the_joints_by_their_numbers(folder: Path, titles: list[str], read: bool) -> None:
    s = session()
    torques = np.sin(s.readings + 0.3)
    told, columns = told_of(folder, s, titles, torques)
    assert ("are the torques of" in told) == read
    names = [f"tau_{reading.name} [Nm]" for reading in robot(UR10, "tool0").readings]
    assert [columns.get(name) for name in names] == (titles if read else [None] * 6)
    assert run("check", "calibration.toml").code == 0


@pytest.mark.parametrize(
    ("titles", "size", "zeros", "read"),
    [
        (["std_x", "std_y", "std_z"], 0.02, 0, "mm"),
        (["x_sigma [um]", "y_sigma [um]", "z_sigma [um]"], 20.0, 0, "um"),
        (["std_x [m]", "std_y [m]", "std_z [m]"], 2e-5, 0, "m"),
        (["std_x", "std_y"], 0.02, 0, None),
        (["std_x [s]", "std_y [s]", "std_z [s]"], 0.02, 0, None),
        (["std_a", "std_b", "std_c"], 0.02, 0, None),
        (["std_x", "std_y", "std_z"], 0.02, 1, None),
        (["std_x", "std_y", "std_z"], 20.0, 0, None),
    ],
)
def test_standard_deviations_of_the_point_are_read(
    folder: Path, titles: list[str], size: float, zeros: int, read: str | None
) -> None:
    """Where they are some: a zero, in a row that no look at the table sees, says that they are not."""
    s = session(n=500)
    rng = np.random.default_rng(0)
    sigmas = size * rng.uniform(0.5, 1.5, (500, len(titles)))
    sigmas[1, 0] *= 1 - zeros
    told, columns = told_of(folder, s, titles, sigmas)
    assert ("are the standard deviations of the point" in told) == (read is not None)
    assert ("of the point, taken to be in mm as well." in told) == (read == "mm")
    found = {ours: theirs for ours, theirs in columns.items() if ours.startswith("sigma")}
    assert found == (dict(zip([f"sigma_{axis} [{read}]" for axis in "xyz"], titles, strict=True)) if read else {})
    assert run("check", "calibration.toml").code == 0


def test_no_folder_for_the_job_is_said_at_once(folder: Path) -> None:
    put(folder, "no units")
    said = run("init", UR10, "measured.csv", "-o", "nowhere/calibration.toml")
    assert said == (1, "", "Error: nowhere/calibration.toml: cannot be written (No such file or directory).\n")


@pytest.mark.parametrize(("more", "way"), [((), ""), (("--tip", "tip"), " on the way to 'tip'")], ids=["arm", "tip"])
def test_an_arm_of_fixed_joints_has_nothing_to_calibrate(tmp_path: Path, more: tuple[str, ...], way: str) -> None:
    urdf, table = tmp_path / "fixed.urdf", tmp_path / "measured.csv"
    urdf.write_text(
        '<robot name="r"><link name="base"/><link name="tip"/>'
        '<joint name="j" type="fixed"><parent link="base"/><child link="tip"/></joint></robot>'
    )
    table.write_text("j [deg], x [mm], y [mm], z [mm]\n1, 2, 3, 4\n2, 3, 4, 5\n")
    sentence = f"Error: {urdf}: no joint moves{way}, and there is nothing to calibrate.\n"
    assert run("check", urdf, table, *more) == (1, "", sentence)


def few(n: int, times: int = 1) -> None:
    """Write n poses, each so many times."""
    s, joints = session(n=n, seed=n), [f"A{k} [deg]" for k in range(1, 7)]
    table = [np.repeat(column, times, axis=0) for column in (np.degrees(s.readings), 1e3 * s.position)]
    Path("measured.csv").write_text(text([*joints, "x [mm]", "y [mm]", "z [mm]"], table), encoding="utf-8")


@pytest.mark.parametrize(("n", "placements", "held_out"), [(12, "none", 4), (16, "none", 4), (18, "all", 4)])
def test_few_rows_free_what_they_can_judge(folder: Path, n: int, placements: str, held_out: int) -> None:
    """Of 12 rows a job with link placements was written, which ``calib calibrate`` refused."""
    few(n)
    said = run("init", UR10, "measured.csv", "--yes")
    assert said.code == 0
    job = tomllib.loads((folder / "calibration.toml").read_text(encoding="utf-8"))
    assert job["error_model"]["placements"] == placements
    assert round(job["measurements"][0]["hold_out"] * n) == held_out
    why = f"{n} rows are too few to find link placements, which need about 17: joint offsets alone are free."
    assert (why in " ".join(said.out.split())) == (placements == "none")
    assert "The next step: calib calibrate calibration.toml -o out/" in " ".join(said.out.split())
    assert run("calibrate", "calibration.toml", "-o", "out", "-q").code in (0, 3)
    of = json.loads((folder / "out" / "result.json").read_text(encoding="utf-8"))["checks"]
    assert all(check["passed"] for check in of if check["name"] in ("redundancy", "held-out poses"))


def test_rows_at_the_same_poses_are_as_few_as_their_poses(folder: Path) -> None:
    """Of 12 poses, each measured three times, three were held out and placements were free: nothing could be judged."""
    few(12, times=3)
    said = run("init", UR10, "measured.csv", "--yes")
    assert "4 of its 12 poses are held out" in " ".join(said.out.split())
    assert "36 rows of 12 poses are too few to find link placements, which need about 17" in " ".join(said.out.split())
    assert run("calibrate", "calibration.toml", "-o", "out", "-q").code in (0, 3)
    of = json.loads((folder / "out" / "result.json").read_text(encoding="utf-8"))["checks"]
    assert all(check["passed"] for check in of if check["name"] in ("redundancy", "held-out poses"))


@pytest.mark.parametrize("n", [7, 8, 9, 10, 11, 12, 13])
def test_rows_that_are_too_few_are_said_to_need_more_than_they_are(folder: Path, n: int) -> None:
    """Of 10 poses it was said that they are too few, and that about 9 are needed."""
    s = session(n=n, seed=n)
    Path("poses.csv").write_text(
        text(
            [*(f"A{k} [deg]" for k in range(1, 7)), "x [mm]", "y [mm]", "z [mm]", "qw", "qx", "qy", "qz"],
            [np.degrees(s.readings), 1e3 * s.position, quaternions(s.rotation)],
        ),
        encoding="utf-8",
    )
    said = " ".join(calib.measuring.propose(UR10, ["poses.csv"]).reasons)
    assert ("are too few to find link placements, which need about 11:" in said) == (n < 11)


@pytest.mark.parametrize(("n", "left"), [(8, "none is left to judge a fit by: it is refused"), (10, "5 are left")])
def test_what_rows_cannot_judge_is_told_before_it_is_solved(folder: Path, n: int, left: str) -> None:
    """``calib check`` found nothing, and ``calib calibrate`` refused its job."""
    few(n)
    said = run("init", UR10, "measured.csv", "--yes")
    checked = run("check", "calibration.toml")
    for out in (said.out, checked.out):
        assert f"parameters, and {left}" in " ".join(out.split())
        assert "Measure more poses, or free fewer parameters." in " ".join(out.split())
    assert ("it needs more poses." in said.out) == (n == 8)
    assert run("calibrate", "calibration.toml", "-o", "out", "-q").code == (1 if n == 8 else 3)


def otherwise_read(folder: Path, signs: list[float], zeros: list[float]) -> None:
    """A table of joints that stand at ``signs * reading + zeros`` (deg)."""
    s, joints = session(), [f"A{k}" for k in range(1, 7)]
    read = (np.degrees(s.readings) - np.array(zeros)) * np.array(signs)
    (folder / "measured.csv").write_text(text([*joints, "X", "Y", "Z"], [read, 1e3 * s.position]), encoding="utf-8")


def test_a_mistake_that_explains_why_no_way_fits_is_named(folder: Path) -> None:
    """Only signs and the order of joints were asked for, and how titles are to be read."""
    otherwise_read(folder, [1.0, 1.0, 1.0, -1.0, 1.0, 1.0], [0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
    said = " ".join(run("init", UR10, "measured.csv", "--yes").err.split())
    assert (
        "A1 to A6 in deg: it looks as if the readings have other zeros or signs than the URDF: 'shoulder_lift_joint' "
        "stands at reading - 90 deg, 'elbow_joint' stands at reading + 90 deg, 'wrist_1_joint' stands at -reading:"
    ) in said
    assert said.endswith("; answer by --zeros FILE of calib init, which writes that URDF.")
    assert [path.name for path in folder.iterdir()] == ["measured.csv"]


def test_a_urdf_that_counts_as_the_readings_do_is_written(folder: Path) -> None:
    otherwise_read(folder, [1.0, 1.0, 1.0, -1.0, 1.0, 1.0], [0.0, -90.0, 90.0, 20.0, 0.0, 0.0])
    said = run("init", UR10, "measured.csv", "--zeros", "as_read.urdf", "--yes")
    assert said.code == 0, said.err
    assert "as_read.urdf is example:" in " ".join(said.out.split())
    assert tomllib.loads((folder / "calibration.toml").read_text(encoding="utf-8"))["robot"]["urdf"] == "as_read.urdf"
    assert run("calibrate", "calibration.toml", "-o", "out", "-q").code == 0


def test_no_urdf_is_written_where_none_is_needed_or_no_job_is(folder: Path) -> None:
    s = session()
    titles = [*(f"A{k} [deg]" for k in range(1, 7)), "x [mm]", "y [mm]", "z [mm]"]
    (folder / "measured.csv").write_text(text(titles, [np.degrees(s.readings), 1e3 * s.position]), encoding="utf-8")
    said = run("init", UR10, "measured.csv", "--zeros", "as_read.urdf", "--yes")
    assert (said.code, (folder / "as_read.urdf").exists()) == (0, False)
    assert f"as_read.urdf is not written: the readings have the zeros and signs of {UR10}" in " ".join(said.out.split())
    otherwise_read(folder, [1.0, 1.0, 1.0, -1.0, 1.0, 1.0], [0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
    (folder / "there.urdf").write_text("mine", encoding="utf-8")
    for options, code, sentence in (
        (["--zeros", "there.urdf"], 1, "there.urdf: already exists"),
        (["--zeros", "new.urdf", "-o", "new.urdf"], 2, "new.urdf is to be the job, too; name another file"),
    ):
        said = run("init", UR10, "measured.csv", "-o", "job.toml", *options, "--yes")
        assert (said.code, sentence in " ".join(said.err.split())) == (code, True), said.err
        assert not (folder / "new.urdf").exists() and not (folder / "job.toml").exists()
    assert (folder / "there.urdf").read_text(encoding="utf-8") == "mine"


def test_python_has_the_zeros_and_the_urdf(folder: Path) -> None:
    otherwise_read(folder, [1.0, 1.0, 1.0, -1.0, 1.0, 1.0], [0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
    found = calib.measuring.propose(UR10, ["measured.csv"])
    assert found.questions[0].about == "zeros"
    assert found.zeros is not None
    assert {name: (sense, round(float(np.degrees(offset)), 6)) for name, (sense, offset) in found.zeros.items()} == {
        "shoulder_lift_joint": (1.0, -90.0),
        "elbow_joint": (1.0, 90.0),
        "wrist_1_joint": (-1.0, 0.0),
    }
    (folder / "as_read.urdf").write_bytes(found.urdf_as_read())
    again = calib.measuring.propose(folder / "as_read.urdf", ["measured.csv"])
    assert (again.questions, again.zeros) == ((), None)
    assert again.urdf_as_read() == found.urdf_as_read()


def test_a_job_of_readings_that_count_otherwise_says_what_to_do(folder: Path) -> None:
    otherwise_read(folder, [1.0] * 6, [0.0] * 6)
    assert run("init", UR10, "measured.csv", "--yes").code == 0
    otherwise_read(folder, [1.0, 1.0, -1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 90.0, 0.0, 0.0])
    said = " ".join(run("check", "calibration.toml").err.split())
    assert "'elbow_joint' stands at -reading, 'wrist_1_joint' stands at reading + 90 deg:" in said
    assert said.endswith(
        "Correct the table, or take a URDF whose joints count as it does: calib init, with --zeros FILE, writes it."
    )
