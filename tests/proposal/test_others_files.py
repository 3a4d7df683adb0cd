"""Files that other programs write, and people type: what their tables have above, below and between the numbers."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.arrays import Array
from calib.measurement.formats.sheet import read_sheet
from calib.robot.sources import resolve
from tests.support.cases import run
from tests.support.people import UR10, quaternions, session, text

JOINTS = [f"J{k}" for k in range(1, 7)]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def degrees() -> Array:
    return np.degrees(session().readings)


def mm() -> Array:
    return 1e3 * session().position


def rows(columns: Sequence[Array], separator: str = ",") -> list[str]:
    return text(None, columns, separator).splitlines()


def joined(folder: Path, tracker: str) -> calib.measuring.Proposal:
    """Return what is found in the joints and in a file of the tracker that stands beside them."""
    (folder / "joints.csv").write_text(text(JOINTS, [degrees()]))
    (folder / "tracker.csv").write_text(tracker)
    said = run("import", "joints.csv", "tracker.csv", "-o", "both.csv")
    assert said.code == 0, said.err
    found = calib.measuring.propose(UR10, ["both.csv"])
    assert not found.questions, found.questions
    return found


def test_lines_of_numbers_above_the_header_are_no_rows(folder: Path) -> None:
    """Vicon writes the rate of its frames there, Qualisys counts them, both with as many cells as they need."""
    head = "Trajectories\n100\n,,robot:tool\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n"
    frames = [np.arange(40.0), np.zeros(40)]
    vicon = head + "\n".join(rows([*frames, mm()]))
    names = joined(folder, vicon).tables[0].columns.names
    assert [names[f"{axis} [mm]"] for axis in "xyz"] == ["X [mm]", "Y [mm]", "Z [mm]"]
    (folder / "both.csv").unlink()
    head = "NO_OF_FRAMES\t40\nFREQUENCY\t100\nTIME_STAMP\t2024-05-03\t11.2\nFrame\tTime\ttool X\ttool Y\ttool Z\n"
    qualisys = head + "\n".join(rows([*frames, mm()], "\t"))
    names = joined(folder, qualisys).tables[0].columns.names
    assert [names[f"{axis} [mm]"] for axis in "xyz"] == ["tool X", "tool Y", "tool Z"]


@pytest.mark.parametrize("count", [1, 5, 7])
def test_few_frames_below_many_settings_are_the_rows(folder: Path, count: int) -> None:
    above = [f"{name}\t{k}" for k, name in enumerate(("NO_OF_FRAMES", "CAMERAS", "MARKERS", "RATE", "ANALOG", "F"))]
    above += ["TIME_STAMP\t2021-03-04, 12:00:00\t123.4", "MARKER_NAMES\tA\tB"]
    titles = "\t".join(["Frame", *(f"{name} {axis}" for name in "AB" for axis in "XYZ")])
    frames = ["\t".join(f"{k}.{j}" for j in range(7)) for k in range(count)]
    (folder / "a.tsv").write_text("\n".join([*above, titles, *frames, ""]))
    sheet = read_sheet("a.tsv")
    assert (sheet.titles, len(sheet.rows)) == (tuple(titles.split("\t")), count)
    # Without titles, the line above the frames is named.
    (folder / "a.tsv").write_text("\n".join([*above, *frames, ""]))
    with pytest.raises(calib.MeasurementError, match=r"^a\.tsv:9: the header has 3 cells and this row has 7\.$"):
        read_sheet("a.tsv")


def test_lines_that_a_spreadsheet_fills_up_are_no_rows_either(folder: Path) -> None:
    lines = ["Objects,,,,,,,", "100,,,,,,,", ",,tool:tool,,,,,", "Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ"]
    lines.append(",,rad,rad,rad,mm,mm,mm")
    vector = Rotation.from_matrix(session().rotation).as_rotvec()
    found = joined(folder, "\n".join([*lines, *rows([np.arange(40.0), np.zeros(40), vector, mm()])]))
    assert found.tables[0].columns.orientation == "rotation_vector"


def test_rows_of_separators_alone_are_blank_lines(folder: Path) -> None:
    lines = rows([degrees(), mm()])
    lines[10:10], lines[20:20] = [",,,,,,,,"], [", ,,,,,,,"]
    (folder / "measured.csv").write_text("\n".join([",".join([*JOINTS, "X", "Y", "Z"]), *lines]))
    assert run("init", UR10, "measured.csv", "-y").code == 0
    assert run("check", "calibration.toml").code == 0
    lines[10] = ",,,,,,,,7"
    (folder / "measured.csv").write_text("\n".join([",".join([*JOINTS, "X", "Y", "Z"]), *lines]))
    said = run("check", "calibration.toml")
    assert said.err == "Error: measured.csv:12: column 'J1': the cell is empty.\n"


def test_a_column_is_called_as_the_file_has_it_where_its_cells_are_wrong(folder: Path) -> None:
    T = np.zeros((40, 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = session().rotation, mm(), 1.0
    titles = [*(f"J{k} (deg)" for k in range(1, 7)), *(f"T_{i}_{j}" for i in range(4) for j in range(4))]
    whole = text(titles, [degrees(), T.reshape(40, -1)])
    (folder / "measured.csv").write_text(whole)
    assert run("init", UR10, "measured.csv", "-y").code == 0
    lines = [line.split(",") for line in whole.splitlines()]
    for k, title in ((0, "J1 (deg)"), (6, "T_0_0"), (9, "T_0_3")):
        torn = [[*line[:k], "", *line[k + 1 :]] if n == 8 else line for n, line in enumerate(lines)]
        (folder / "measured.csv").write_text("\n".join(map(",".join, torn)))
        said = run("check", "calibration.toml")
        assert said.err == f"Error: measured.csv:9: column '{title}': the cell is empty.\n"
    torn = [[*line[:6], "", *line[7:]] if n == 8 else line for n, line in enumerate(lines)]
    (folder / "measured.csv").write_text("\n".join(map(",".join, torn)))
    found = calib.measuring.propose(UR10, ["measured.csv"])
    assert "T_0_0 to T_2_2 are left out: cells of theirs are empty" in " ".join(found.reasons)


def test_columns_of_one_title_are_told_apart(folder: Path) -> None:
    """Nominal and measured coordinates stand below two titles of groups, that nobody reads."""
    nominal = 1e3 * session().flange[:, :3, 3]
    table = text([*JOINTS, *"XYZ", *"XYZ"], [degrees(), nominal, mm()])
    (folder / "measured.csv").write_text(table)
    said = run("init", UR10, "measured.csv", "-y")
    assert said.err == (
        "Error: measured.csv:1: several columns are called 'X'; calib import measured.csv -o table.csv tells them "
        "apart.\n"
    )
    assert run("import", "measured.csv", "-o", "table.csv").code == 0
    found = calib.measuring.propose(UR10, ["table.csv"])
    assert found.tables[0].columns.names["x [mm]"] == "X 2"
    (folder / "units.csv").write_text("X [mm],X [mm],X 2 [mm],X [mm]\n1,2,3,4\n")
    assert read_sheet("units.csv").titles == ("X [mm]", "X 3 [mm]", "X 2 [mm]", "X 4 [mm]")


def test_rows_with_numbers_that_no_arm_has_are_named(folder: Path) -> None:
    """NDI writes such numbers where it sees nothing."""
    points = mm()
    points[[7, 23]] = -3.697314e28
    (folder / "measured.csv").write_text(text([*JOINTS, "Tx", "Ty", "Tz"], [degrees(), points]))
    said = run("init", UR10, "measured.csv", "-y")
    assert "beyond 10000 rad or m, in rows 8, 24 after the header;" in said.err


def test_decimal_commas_are_suspected_only_where_commas_part_the_cells(folder: Path) -> None:
    (folder / "a.csv").write_text("a;b\n1;2\n1;2;3\n")
    with pytest.raises(calib.MeasurementError, match=r"the header has 2 cells and this row has 3\.$"):
        read_sheet("a.csv")
    (folder / "a.csv").write_text("a,b\n1,2\n1,2,3\n")
    with pytest.raises(calib.MeasurementError, match="if these are decimal commas"):
        read_sheet("a.csv")


@pytest.mark.parametrize("cell", ["{:.4f}°", "{:.4f} deg"])
def test_cells_with_a_unit_are_named_by_the_joint_that_they_would_be(folder: Path, cell: str) -> None:
    lines = [[cell.format(abs(value)) for value in row] for row in degrees().tolist()]
    points = rows([mm()])
    table = [",".join([*joints, point]) for joints, point in zip(lines, points, strict=True)]
    (folder / "measured.csv").write_text("\n".join([",".join([*JOINTS, "X", "Y", "Z"]), *table]), encoding="utf-8")
    said = run("init", UR10, "measured.csv", "-y")
    assert said.err == (
        f"Error: measured.csv: column 'J1' is of a joint, and '{lines[0][0]}' in it is no number, like 12.5 or "
        "1.25e1.\n"
    )


def test_one_word_among_a_joints_numbers_is_named_and_no_shorter_arm_is_taken(folder: Path) -> None:
    lines = [",".join([*JOINTS, "X", "Y", "Z"]), *rows([degrees(), mm()]), ",,,,,Mean:,1,2,3"]
    (folder / "measured.csv").write_text("\n".join(lines))
    said = run("init", UR10, "measured.csv", "-y")
    assert "column 'J6' is of a joint, and 'Mean:' in it is no number" in said.err
    lines[-1] = lines[0]  # the header again
    (folder / "measured.csv").write_text("\n".join(lines))
    said = run("init", UR10, "measured.csv", "-y")
    assert "column 'J1' is of a joint, and 'J1' in it is no number" in said.err


@pytest.mark.parametrize(
    ("contents", "says"),
    [
        (b"PAR1\x15\x04", "is Parquet, and no text; write it as CSV, as DataFrame.to_csv() of pandas does."),
        (b"\x80\x04\x95\0", "is a pickle of Python, which may run code and is not read;"),
        (b'\xef\xbb\xbf<?xml version="1.0"?>\n<Database/>\n', "is XML, and no table; write the numbers"),
        (
            b"Format Version,1.23,Take Name,a\n\n,Type\n",
            "is an export of Motive; calib import a.bin -o table.csv",
        ),
    ],
)
def test_what_is_no_table_says_what_to_do(folder: Path, contents: bytes, says: str) -> None:
    (folder / "a.bin").write_bytes(contents)
    said = run("init", UR10, "a.bin", "-y")
    assert said.code == 1
    assert said.err.startswith(f"Error: a.bin: {says}")


def test_a_command_that_is_told_can_be_typed_as_it_stands(folder: Path) -> None:
    """Motive calls its exports "Take 2026-05-06 10.22.33 AM.csv"."""
    (folder / "Take 1 AM.csv").write_bytes(b"Format Version,1.23,Take Name,a\n\n,Type\n")
    said = run("init", UR10, "Take 1 AM.csv", "-y")
    assert "Error: Take 1 AM.csv: is an export of Motive; calib import 'Take 1 AM.csv' -o table.csv" in said.err


def test_yaml_of_opencv_is_told_from_broken_yaml(folder: Path) -> None:
    (folder / "a.yaml").write_text("%YAML:1.0\n---\nT: !!opencv-matrix\n   rows: 1\n")
    with pytest.raises(calib.MeasurementError, match=r"^a\.yaml: is of OpenCV, whose YAML is not read;"):
        read_sheet("a.yaml")


def test_a_lens_in_an_archive_is_no_pose(folder: Path) -> None:
    K, bent = np.array([[900.0, 0.0, 640.0], [0.0, 901.0, 360.0], [0.0, 0.0, 1.0]]), np.zeros((1, 5))
    pose = {"tvec": np.ones((3, 1)), "rvec": np.full((3, 1), 0.1)}
    for name, arrays in (("a", {"mtx": K, "dist": bent}), ("b", {"K": K}), ("c", {"K": K, "D": bent[0], "rms": [0.2]})):
        np.savez(f"{name}.npz", **arrays)
        code, _, said = run("import", f"{name}.npz", "-o", f"{name}.csv")
        assert (code, "is the matrix of a camera, with nothing that was measured beside it" in said) == (1, True)
    R = Rotation.from_rotvec([0.1, -0.4, 0.3]).as_matrix()
    of_a_pose = ({"R": R, "t": np.ones((3, 1))}, {"R": R, "t": np.ones(3)}, {"R": R.astype(np.float32), "p": R[0]})
    for name, arrays in zip("defg", (pose | {"mtx": K, "dist": bent}, *of_a_pose), strict=True):
        np.savez(f"{name}.npz", **arrays)
        assert "1 row" in run("import", f"{name}.npz", "-o", f"{name}.csv").out
    # Three rows of a point and of something else.
    np.savez("h.npz", p=R + 0.01, t=np.ones(3))
    assert "3 rows" in run("import", "h.npz", "-o", "h.csv").out


def test_vectors_in_archives_stand_lie_or_are_one_pose(folder: Path) -> None:
    seen = session()
    vector = Rotation.from_matrix(seen.rotation).as_rotvec()
    np.savez("many.npz", q=seen.readings, tvec=seen.position[:, :, None], rvec=vector[:, None, :])
    assert run("import", "many.npz", "-o", "many.csv").code == 0
    found = calib.measuring.propose(UR10, ["many.csv"])
    assert found.tables[0].columns.names["x [m]"] == "tvec_x"
    assert found.tables[0].columns.orientation == "rotation_vector"
    for k in range(40):
        np.savez(f"pose_{k}.npz", q=seen.readings[k], tvec=seen.position[k][:, None], rvec=vector[k][:, None])
    said = run("import", *(f"pose_{k}.npz" for k in range(40)), "--stack", "image", "-o", "poses.csv")
    assert said.code == 0
    assert "the arrays are those of one pose, and one row." in said.out
    found = calib.measuring.propose(UR10, ["poses.csv"])
    assert not found.questions
    assert found.tables[0].columns.orientation == "rotation_vector"


@pytest.mark.parametrize(
    ("shapes", "rows_"),
    [
        ({"rvec": (3, 1), "tvec": (3, 1)}, 1),  # as OpenCV's solvePnP gives them
        ({"R": (3, 3), "t": (3, 1)}, 1),
        ({"q": (6,), "T": (4, 4)}, 1),
        ({"q": (6, 6), "p": (6, 3)}, 6),
        ({"x": (9,), "y": (9,), "z": (9,), "K": (3, 3)}, 9),
        ({"q": (3, 6), "p": (3, 3)}, 3),
    ],
)
def test_small_arrays_are_one_row_where_they_are_no_columns(
    folder: Path, shapes: dict[str, tuple[int, ...]], rows_: int
) -> None:
    rng = np.random.default_rng(1)
    np.savez("a.npz", **{name: rng.uniform(size=shape) for name, shape in shapes.items()})
    assert len(read_sheet("a.npz").rows) == rows_


@pytest.mark.parametrize(("names", "positions"), [("joints", "positions"), ("joint_names", "joint_positions")])
def test_lists_of_names_and_of_readings_are_columns_of_these_names(folder: Path, names: str, positions: str) -> None:
    order = [f"joint_{k}" for k in (3, 1, 2)]
    records = [{names: order, positions: [0.3, 0.1, k], "features": ["a", "b"]} for k in range(3)]
    (folder / "a.json").write_text(json.dumps(records))
    (folder / "a.yaml").write_text(json.dumps(records))
    for file in ("a.json", "a.yaml"):
        sheet = read_sheet(file)
        assert sheet.titles == (*order, "features_0", "features_1")
        assert sheet.rows[2][:3] == ("0.3", "0.1", "2")


@pytest.mark.parametrize("moves", [False, True])
def test_a_gripper_that_the_log_has_as_well_is_no_joint_of_the_arm(folder: Path, moves: bool) -> None:
    """Joint states of a Panda name its fingers, too; the reflector is on the hand, whatever they do."""
    arm = "example:panda_description/urdf/panda.urdf"
    seen = session(arm, "panda_hand")
    finger = np.tile([0.0, 0.04], 20) if moves else np.full(40, 0.02)
    joints = [f"panda_joint{k}" for k in range(1, 8)]
    fingers = ["panda_finger_joint1 [m]", "panda_finger_joint2 [m]"]
    columns = [seen.readings, finger, finger, 1e3 * seen.position]
    (folder / "measured.csv").write_text(
        text([*(f"{j} [rad]" for j in joints), *fingers, "x [mm]", "y [mm]", "z [mm]"], columns)
    )
    found = calib.measuring.propose(arm, ["measured.csv"])
    assert found.robot is not None
    assert [reading.name for reading in found.robot.readings] == joints
    assert found.tables[0].columns.ignore == tuple(fingers)


def test_a_gripper_in_percent_is_no_joint_where_sockets_are_touched_either(folder: Path) -> None:
    arm = "example:so_arm_description/urdf/so101.urdf"
    nominal, rng = calib.load_robot(arm, "gripper_frame_link"), np.random.default_rng(1)
    place = np.array([[0.2, -0.1, 0.1], [0.25, 0.1, 0.15], [0.2, 0.0, 0.2]])
    q, c = rng.uniform(-0.6, 0.6, (300, 5)), np.tile(place, (100, 1))
    for _ in range(20):  # Newton's steps to the sockets
        x = nominal.tips(q)[:, :3, 3]
        J = np.stack([(nominal.tips(q + 1e-6 * one)[:, :3, 3] - x) / 1e-6 for one in np.eye(5)], axis=2)
        q += np.clip(np.einsum("nij,nj->ni", np.linalg.pinv(J, rcond=1e-3), c - x), -0.3, 0.3)
    there = np.flatnonzero((np.linalg.norm(nominal.tips(q)[:, :3, 3] - c, axis=1) < 1e-6) & (np.abs(q).max(axis=1) < 2))
    q, sockets = q[there] + rng.normal(0.0, 1e-3, (len(there), 5)), [f"hole {k % 3}" for k in there]
    titles = [f"{joint}.pos" for joint in ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")]
    percent = rng.uniform(0.0, 100.0, len(q))
    (folder / "touches.csv").write_text(text([*titles, "gripper.pos", "socket"], [np.degrees(q), percent, sockets]))
    found = calib.measuring.propose(arm, ["touches.csv"])
    assert not found.questions, found.questions
    assert found.tables[0].observes == "socket" and found.tables[0].columns.ignore == ("gripper.pos",)


@pytest.mark.parametrize("seed", range(2))
def test_fingers_that_jitter_are_left_out_whatever_chance_says(folder: Path, seed: int) -> None:
    """Their readings make the fit a little better in one log and a little worse in the next, in mm as in m."""
    arm = "example:panda_description/urdf/panda.urdf"
    seen = session(arm, "panda_hand")
    finger = 0.035 + 1e-5 * np.random.default_rng(seed).standard_normal(40)
    joints = [f"panda_joint{k}" for k in range(1, 8)]
    titles = [*joints, "panda_finger_joint1", "panda_finger_joint2", "x", "y", "z"]
    (folder / "states.csv").write_text(text(titles, [seen.readings, finger, finger, seen.position]))
    found = calib.measuring.propose(arm, ["states.csv"])
    assert not found.questions and found.robot is not None
    assert [reading.name for reading in found.robot.readings] == joints


@pytest.mark.parametrize("carries", [False, True])
def test_a_point_on_a_finger_that_slides_moves_with_it(folder: Path, carries: bool) -> None:
    arm = "example:panda_description/urdf/panda.urdf"
    seen = session(arm, "panda_hand")
    finger = np.random.default_rng(2).uniform(0.0, 0.04, 40)
    hand = seen.rotation @ Rotation.from_rotvec([0.4, -0.9, 1.3]).inv().as_matrix()
    position = seen.position + (finger[:, None] * hand[:, :, 1] if carries else 0.0)
    joints = [f"panda_joint{k}" for k in range(1, 8)]
    titles = [*joints, "panda_finger_joint1", "x", "y", "z"]
    (folder / "states.csv").write_text(text(titles, [seen.readings, finger, position]))
    found = calib.measuring.propose(arm, ["states.csv"])
    assert not found.questions and found.robot is not None
    assert ("panda_finger_joint1" in [reading.name for reading in found.robot.readings]) == carries


@pytest.mark.parametrize("posed", [False, True])
def test_a_last_joint_that_is_called_like_a_gripper_is_one_of_the_arm(folder: Path, posed: bool) -> None:
    """A point on its axis, as of a flange, moves with it as without it: only the orientation would tell."""
    document = resolve(UR10).read_text(encoding="utf-8").replace("wrist_3_joint", "gripper_yaw")
    (folder / "arm.urdf").write_text(document)
    seen = session(UR10)
    on_axis = seen.flange[:, :3, 3] + 1e-3 * np.random.default_rng(3).standard_normal((40, 3))
    columns = [seen.readings, 1e3 * on_axis, *([quaternions(seen.flange[:, :3, :3], "xyzw")] if posed else [])]
    joints = [joint.name for joint in calib.load_robot("arm.urdf", "tool0").readings]
    titles = [*(f"{joint} [rad]" for joint in joints), "x [mm]", "y [mm]", "z [mm]"]
    (folder / "measured.csv").write_text(text([*titles, *(["qx", "qy", "qz", "qw"] if posed else [])], columns))
    found = calib.measuring.propose("arm.urdf", ["measured.csv"])
    assert found.robot is not None
    assert [reading.name for reading in found.robot.readings] == joints
    assert found.tables[0].observes == ("pose" if posed else "position")


def test_a_gripper_in_percent_is_no_joint_of_the_arm(folder: Path) -> None:
    """LeRobot records it with the arm's joints, and its URDF has another tip beside the jaw."""
    arm = "example:so_arm_description/urdf/so101.urdf"
    seen = session(arm, "gripper_frame_link")
    titles = [f"{joint}.pos" for joint in ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")]
    columns = [np.degrees(seen.readings), np.linspace(0.0, 100.0, 40), 1e3 * seen.position]
    for joints in ([*titles, "gripper.pos"], [f"observation.state_{k}" for k in range(6)]):
        (folder / "measured.csv").write_text(text([*joints, "x [mm]", "y [mm]", "z [mm]"], columns))
        found = calib.measuring.propose(arm, ["measured.csv"])
        assert found.robot.tip == "gripper_frame_link"
        assert found.tables[0].columns.ignore == (joints[5],)
    low, high = (np.degrees([getattr(r, end) for r in found.robot.readings]) for end in ("lower", "upper"))
    columns[0] = 200.0 * (columns[0] - low) / (high - low) - 100.0  # of its range, as it does by default
    (folder / "measured.csv").write_text(text([*joints, "x [mm]", "y [mm]", "z [mm]"], columns))
    assert "no way to read the columns fits the arm" in run("init", arm, "measured.csv", "-y").err


@pytest.mark.parametrize(("point", "turn", "w"), [("ee_pos", "ee_orn", 3), ("marker.pos", "marker.quat", 0)])
def test_quaternions_in_lists_are_orientations(folder: Path, point: str, turn: str, w: int) -> None:
    xyzw = Rotation.from_matrix(session().rotation).as_quat()
    titles = [*JOINTS, *(f"{point}_{k}" for k in range(3)), *(f"{turn}_{k}" for k in range(4)), "ctrl_0"]
    columns = [degrees(), mm(), np.roll(xyzw, 0 if w == 3 else 1, axis=1), degrees()[:, 0]]
    (folder / "measured.csv").write_text(text(titles, columns))
    found = calib.measuring.propose(UR10, ["measured.csv"])
    assert found.tables[0].columns.names["qw"] == f"{turn}_{w}"


def test_readings_that_were_only_commanded_are_told_by_the_words_of_simulators(folder: Path) -> None:
    titles = [*(f"qpos_{k}" for k in range(6)), *(f"ctrl_{k}" for k in range(6)), "x", "y", "z"]
    commanded = degrees() + 0.01 * np.random.default_rng(1).standard_normal((40, 6))
    (folder / "measured.csv").write_text(text(titles, [degrees(), commanded, mm()]))
    found = calib.measuring.propose(UR10, ["measured.csv"])
    assert found.tables[0].columns.names["shoulder_pan_joint [deg]"] == "qpos_0"


def test_frames_that_were_lost_are_said_where_joints_have_more_rows(folder: Path) -> None:
    head = "Format Version,1.23,Take Name,a,Rotation Type,Quaternion,Length Units,Meters\n\n"
    head += ",Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body\n"
    head += ",Name" + 7 * ",tool" + "\n,ID" + 7 * ",1" + "\n,,Rotation,Rotation,Rotation,Rotation"
    head += ",Position,Position,Position\nFrame,Time (Seconds),X,Y,Z,W,X,Y,Z\n"
    (folder / "a.csv").write_text(head + "0,0.0,0,0,0,1,1,2,3\n1,0.1,,,,,,,\n2,0.2,0,0,0,1,1,2,4\n")
    (folder / "joints.csv").write_text("J1,J2\n1,2\n3,4\n5,6\n")
    said = run("import", "joints.csv", "a.csv", "-o", "both.csv")
    assert said.err.endswith("; the rigid body 'tool' of Motive; 1 frame that lost it is left out.\n")


def test_one_group_of_all_rows_holds_nothing_back(folder: Path) -> None:
    words = {"group": "A", "tool": "tool0", "setup": "cell"}
    columns = [degrees(), mm(), *(np.full(40, word) for word in words.values())]
    (folder / "measured.csv").write_text(text([*JOINTS, *"XYZ", *words], columns))
    assert calib.measuring.propose(UR10, ["measured.csv"]).tables[0].columns.ignore == ("group",)
    assert run("init", UR10, "measured.csv", "-y").code == 0


def test_a_unit_that_is_not_known_is_said(folder: Path) -> None:
    titles = [*(f"J{k} [gon]" for k in range(1, 7)), *"XYZ"]
    (folder / "measured.csv").write_text(text(titles, [degrees() / 0.9, mm()]))
    said = run("init", UR10, "measured.csv", "-y")
    assert said.err.startswith(
        "Error: measured.csv: column 'J1 [gon]' has a unit that is not known; answer by --column"
    )


def test_columns_that_may_be_the_joints_are_named(folder: Path) -> None:
    rng = np.random.default_rng(1)
    titles = [*(f"{word}_{k}" for word in ("first", "second") for k in range(6)), *"XYZ"]
    (folder / "measured.csv").write_text(text(titles, [rng.uniform(-90.0, 90.0, (40, 12)), mm()]))
    said = run("init", UR10, "measured.csv", "-y")
    assert "several columns may be the joints, first_0 to first_5 or second_0 to second_5, and the rows do" in said.err


def test_a_marker_of_motive_is_a_point_where_no_rigid_body_was_made(folder: Path) -> None:
    head = "Format Version,1.22,Take Name,a,Rotation Type,Quaternion,Length Units,Meters\n\n"

    def export(*names: str) -> str:
        columns = [[kind] * 3 for kind in names]
        lines = (
            ["", "Type", *["Marker"] * 3 * len(names)],
            ["", "Name", *(f'"{name}"' for three in columns for name in three)],
            ["", "", *["Position"] * 3 * len(names)],
            ["Frame", "Time (Seconds)", *"XYZ" * len(names)],
        )
        points = [session().position + k for k in range(len(names))]
        rows_ = rows([np.arange(40.0), np.arange(40.0) / 120.0, *points])
        return head + "\n".join([",".join(line) for line in lines] + rows_) + "\n"

    names = joined(folder, export("SMR")).tables[0].columns.names
    assert names["x [m]"] == "x [m]"
    (folder / "two.csv").write_text(export("SMR", "Base:Marker1"))
    said = run("import", "two.csv", "-o", "point.csv")
    assert said.err == (
        "Error: two.csv: has several markers; say which one by topic; there are 'SMR', 'Base:Marker1'.\n"
    )
    said = run("import", "two.csv", "--topic", "Base:Marker1", "-o", "point.csv")
    assert "the marker 'Base:Marker1' of Motive; 0 frames that lost it are left out." in " ".join(said.out.split())
    (folder / "none.csv").write_text(export("SMR").replace("Marker", "Bone"))
    assert run("import", "none.csv", "-o", "b.csv").err == "Error: none.csv: has no rigid bodies, and no markers.\n"


@pytest.mark.parametrize(
    "head",
    [
        "Angles in degrees, lengths in mm\n\n J1  J2  J3  J4 J5 J6    X  Y  Z",
        "J1 [deg]  J2 [deg]  J3 [deg] J4 [deg] J5 (deg)  J6 (deg)  X [mm]  Y [mm]  Z [mm]",
    ],
)
def test_blanks_divide_columns_below_a_sentence_and_with_units(folder: Path, head: str) -> None:
    (folder / "measured.txt").write_text("\n".join([head, *rows([degrees(), mm()], "   ")]))
    assert run("init", UR10, "measured.txt", "-y").code == 0
    assert run("check", "calibration.toml").code == 0


def test_units_may_stand_above_the_header(folder: Path) -> None:
    units = ",".join(["(deg)"] * 6 + ["[m]"] * 3)
    (folder / "a.csv").write_text("\n".join([units, ",".join([*JOINTS, *"XYZ"]), *rows([degrees(), 1e-3 * mm()])]))
    sheet = read_sheet("a.csv")
    assert sheet.titles == (*(f"{joint} [deg]" for joint in JOINTS), "X [m]", "Y [m]", "Z [m]")
    assert len(sheet.rows) == 40
    assert calib.measuring.propose(UR10, ["a.csv"]).tables[0].columns.names["x [m]"] == "X"


@pytest.mark.parametrize("units", ["(deg) (deg) (deg) (deg) (deg) (deg) (mm) (mm) (mm)", "[deg] " * 6 + "[mm] " * 3])
def test_a_line_of_units_in_brackets_is_divided_by_blanks(folder: Path, units: str) -> None:
    head = [" ".join([*JOINTS, *"XYZ"]), units]
    (folder / "measured.txt").write_text("\n".join([*head, *rows([degrees(), mm()], " ")]))
    sheet = read_sheet("measured.txt")
    assert sheet.titles == (*(f"{joint} [deg]" for joint in JOINTS), "X [mm]", "Y [mm]", "Z [mm]")
    assert len(sheet.rows) == 40


def test_a_first_row_that_is_nearly_empty_is_no_header(folder: Path) -> None:
    numbers = rows([degrees(), mm(), mm(), mm()])
    first = ",".join(numbers[0].split(",")[:6]) + 9 * ","
    (folder / "measured.csv").write_text("\n".join([first, *numbers[1:]]))
    sheet = read_sheet("measured.csv")
    assert sheet.titles[:2] == ("column 1", "column 2")
    assert len(sheet.rows) == 40


def test_a_title_may_begin_as_parquet_does(folder: Path) -> None:
    (folder / "measured.csv").write_text("PAR1,PAR2,PAR3\n1,2,3\n")
    assert read_sheet("measured.csv").titles == ("PAR1", "PAR2", "PAR3")


@pytest.mark.parametrize("point", [[1.5, 2.5, 3.5], {"x": 1.5, "y": 2.5, "z": 3.5}])
@pytest.mark.parametrize("count", [3, 6])
def test_the_point_beside_named_joints_is_kept(folder: Path, point: object, count: int) -> None:
    """Only of a joint state is ``position`` that of the joints; what else stands beside these has its own column."""
    record = {"name": "P1", "joint_names": JOINTS[:count], "joint_positions": [0.5] * count, "position": point}
    (folder / "a.json").write_text(json.dumps([record]))
    row = dict(zip(read_sheet("a.json").titles, read_sheet("a.json").rows[0], strict=True))
    ends = [".x", ".y", ".z"] if isinstance(point, dict) else ["_0", "_1", "_2"]
    assert row == dict.fromkeys(JOINTS[:count], "0.5") | {"name": "P1"} | dict(
        zip([f"position{end}" for end in ends], ["1.5", "2.5", "3.5"], strict=True)
    )


def test_one_row_below_titles_and_units_between_blanks_is_one(folder: Path) -> None:
    (folder / "measured.txt").write_text("J1 J2 x\ndeg deg mm\n1 2 3\n")
    assert read_sheet("measured.txt").titles == ("J1 [deg]", "J2 [deg]", "x [mm]")
    assert read_sheet("measured.txt").rows == (("1", "2", "3"),)


@pytest.mark.parametrize("form", ["field.{}{}", "/arm/joint_states/{}[{}]", "{}_{}"])
def test_positions_have_the_names_that_stand_beside_them(folder: Path, form: str) -> None:
    """As rostopic echo -p writes the states of joints, which drivers have in an order of their own."""
    s = session()
    names = [reading.name for reading in calib.load_robot(UR10, tip="tool0").readings]
    order = [2, 1, 0, 3, 4, 5]
    titles = [form.format(what, k) for what in ("name", "position", "velocity") for k in range(6)]
    words = np.tile(np.array(names)[order], (len(s.readings), 1))
    columns = [words, s.readings[:, order], np.zeros((len(s.readings), 6)), s.position]
    (folder / "a.csv").write_text(text([*titles, "x", "y", "z"], columns))
    found = calib.measuring.propose(UR10, ["a.csv"])
    assert not found.questions, found.questions
    read = found.tables[0].columns.names
    assert [read[f"{name} [rad]"] for name in names] == [form.format("position", order.index(k)) for k in range(6)]
    # Columns that have the names themselves go before.
    table = text([*titles, *names, "x", "y", "z"], [*columns[:3], s.readings, s.position])
    (folder / "a.csv").write_text(table)
    found = calib.measuring.propose(UR10, ["a.csv"])
    assert [found.tables[0].columns.names[f"{name} [rad]"] for name in names] == names
    # Other names are those of another robot, or of nothing: the numbers of the columns count.
    (folder / "a.csv").write_text(text([*titles, "x", "y", "z"], [np.char.add(words, "_x"), s.readings, *columns[2:]]))
    found = calib.measuring.propose(UR10, ["a.csv"])
    assert not found.questions, found.questions
    assert [found.tables[0].columns.names[f"{name} [rad]"] for name in names] == titles[6:12]


@pytest.mark.parametrize(
    ("angle", "length"), [("Grad", "mm"), ("degr\u00e9s", "Millim\u00e8tre"), ("\u5ea6", "\u6beb\u7c73")]
)
def test_units_in_other_languages(folder: Path, angle: str, length: str) -> None:
    s = session()
    titles = [*(f"A{k} [{angle}]" for k in range(1, 7)), *(f"{axis} [{length}]" for axis in "XYZ")]
    (folder / "a.csv").write_text(text(titles, [np.degrees(s.readings), 1e3 * s.position]))
    found = calib.measuring.propose(UR10, ["a.csv"])
    assert not found.questions, found.questions
    read = found.tables[0].columns.names
    assert read["x [mm]"] == f"X [{length}]"
    assert sum(name.endswith(" [deg]") for name in read) == 6


def test_a_letter_behind_an_axis_makes_no_moment_of_it(folder: Path) -> None:
    """Xm beside the X that the controller computed was not seen, and so X was taken for measured."""
    s = session()
    computed = s.flange[:, :3, 3]
    titles = [*(f"A{k}" for k in range(1, 7)), *"XYZ", "Xm", "Ym", "Zm", "Mx", "My", "Mz"]
    columns = [np.degrees(s.readings), 1e3 * computed, 1e3 * s.position, 1e3 * s.position]
    (folder / "a.csv").write_text(text(titles, columns))
    found = calib.measuring.propose(UR10, ["a.csv"])
    assert not found.questions, found.questions
    assert found.tables[0].columns.names["x [mm]"] == "Xm"
