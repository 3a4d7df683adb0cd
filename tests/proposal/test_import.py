"""``calib import``: joints and points that are apart, records and workbooks, as one table that `calib init` reads."""

import ast
import io
import json
import os
import re
import struct
import time
import zipfile
import zlib
from collections.abc import Callable
from functools import partial, reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

import calib
from calib.measurement.formats import arrays, records, workbook
from calib.measurement.formats import sheet as sheet_
from calib.measurement.formats.sheet import Sheet, joined, read_sheet
from calib.measurement.table import read_table
from tests.support.cases import run
from tests.support.people import UR10, Session, quaternions, session, text

J = [f"J{k}" for k in range(1, 7)]
RECORDS = 'allowed is a list of records, as [{"x": 1, "y": 2}, {"x": 3, "y": 4}]'
PUBLISHED = Path(os.environ.get("CALIB_DATASETS", "")) / "peoples_files"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def understood(file: Path) -> dict[str, str]:
    found = calib.measuring.propose(UR10, [file])
    assert not found.questions, found.questions
    return dict(found.tables[0].columns.names)


def logs(folder: Path) -> None:
    """Joints by a controller; points as SpatialAnalyzer and Leica export them, in another order, some not measured."""
    s, names = session(), [f"P{k}" for k in range(40)]
    (folder / "joints.csv").write_text(text(["Pose", *J], [names, np.degrees(s.readings)]))
    order = np.random.default_rng(5).permutation(40)[:36]
    points = text(None, [["Cell"] * 36, ["G1"] * 36, [f"p{k}" for k in order], 1e3 * s.position[order]])
    (folder / "sa.txt").write_text("// SpatialAnalyzer, mm\nCollection, Group, Point Name, X, Y, Z\n" + points)
    (folder / "in_order.txt").write_text(text(None, [1e3 * s.position], separator=" "))


def test_matrices_of_matlab(folder: Path) -> None:
    s = session()
    T = np.concatenate([s.rotation, s.position[:, :, None]], axis=2)
    T = np.moveaxis(np.concatenate([T, np.tile([[[0.0, 0.0, 0.0, 1.0]]], (40, 1, 1))], axis=1), 0, 2)
    odd = {"rate": 500.0, "note": "warm", "info": {"by": 1}, "time": np.arange(40.0), "log": np.zeros((7, 2))}
    savemat(folder / "m.mat", {"q": np.degrees(s.readings), "T": T, **odd}, do_compression=True)
    savemat(folder / "p.mat", {"p": 1e3 * s.position})
    assert run("import", "m.mat", "-o", "a.csv", "-q") == (0, "", "")
    names = understood(folder / "a.csv")
    assert [names[key] for key in ("shoulder_pan_joint [deg]", "x [m]", "r12")] == ["q_0", "T_0_3", "T_0_1"]
    held = read_sheet(folder / "m.mat")
    assert held.titles[-1] == "time"
    left = "'rate', 'note', 'info', 'log' are no arrays of numbers or words with 40 rows, and left out"
    assert held.remarks == (left,)
    savemat(folder / "q.mat", {"q": np.degrees(s.readings)})
    assert run("import", "q.mat", "p.mat", "-o", "b.csv", "-q") == (0, "", "")
    assert understood(folder / "b.csv")["x [mm]"] == "p_x"
    said = run("init", UR10, "p.mat")
    assert said.err == (
        "Error: p.mat: is of MATLAB, and no text; calib import makes a table of it, where its name ends with .mat.\n"
    )


def placements(s: Session) -> np.ndarray:
    T = np.tile(np.eye(4), (len(s.position), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = s.rotation, 1e3 * s.position
    return T


@pytest.mark.parametrize("form", ["stacked", "labelled", "in a line"])
def test_matrices_in_a_text(folder: Path, form: str) -> None:
    """As loggers of optical trackers write them; joints without names beside."""
    s = session()
    np.savetxt(folder / "joints.txt", np.degrees(s.readings))
    with (folder / "poses.txt").open("w") as file:
        for k, T in enumerate(placements(s)):
            np.savetxt(file, T.reshape(1, 16) if form == "in a line" else T)
            file.write(f"\nDataSet_{k + 2}\n" if form == "labelled" else "")
    said = run("import", "joints.txt", "poses.txt", "-o", "m.csv")
    assert (said.code, said.err) == (0, "")
    assert "40 matrices of placements are a row each." in said.out
    assert ("40 other lines are passed over." in said.out) == (form == "labelled")
    found = calib.measuring.propose(UR10, ["m.csv"])
    names = found.tables[0].columns
    assert names.orientation == "matrix"
    assert [names.names[key] for key in ("wrist_3_joint [deg]", "x [mm]")] == ["column 6", "x"]
    assert names.names.get("r12", "r12") == "r12"


@pytest.mark.parametrize("mark", ["\f", "\v", "\x1c", "\x85", "\u2028"])
def test_a_mark_that_ends_lines_for_python_alone_tears_no_matrix(folder: Path, mark: str) -> None:
    """It was a traceback: a line of four numbers in the beginning, and none of four when it was read."""
    (folder / "m.txt").write_text(f"0 0{mark}0 1\n" * 3)
    assert read_sheet("m.txt").titles == tuple(f"column {k + 1}" for k in range(4))
    (folder / "m.txt").write_text(f"1 0 0 5\n0 1 0{mark}6\n0 0 1 7\n0 0 0 1\n")
    assert read_sheet("m.txt").rows == (("1", "0", "0", "5", "0", "1", "0", "6", "0", "0", "1", "7"),)


def test_a_text_of_matrices_that_are_torn_or_none(folder: Path) -> None:
    T = placements(session())
    np.savetxt(folder / "torn.txt", T.reshape(-1, 4)[1:-1])
    np.savetxt(folder / "ones.txt", np.vstack([np.ones((3, 4)), [0, 0, 0, 1]]))
    assert [len(read_sheet(folder / name).titles) for name in ("torn.txt", "ones.txt")] == [4, 4]
    T[2, 0, 0] += 0.5
    np.savetxt(folder / "wrong.txt", T.reshape(-1, 4))
    said = run("import", "wrong.txt", "-o", "m.csv")
    assert said.code == 1
    assert said.err.startswith("Error: wrong.txt:9: the matrix that begins here is no placement, as others are")
    header = " ".join(f"m{i}{j}" for i in range(4) for j in range(4))
    np.savetxt(folder / "named.txt", placements(session()).reshape(-1, 16), header=header, comments="")
    assert read_sheet(folder / "named.txt").titles[:2] == ("m00", "m01")


def object_of_matlab(name: str, order: str, packed: bool) -> bytes:
    """Return an element as MATLAB writes a table: an object of its class system, which the file's end describes."""

    def text(word: str) -> bytes:
        return struct.pack(f"{order}II", 1, len(word)) + word.encode().ljust(-(-len(word) // 8) * 8, b"\0")

    numbers = struct.pack(f"{order}IIII", 6, 8, 13, 0) + struct.pack(f"{order}IIII", 5, 8, 6, 1)
    numbers += struct.pack(f"{order}HHI" if order == ">" else f"{order}II", *((0, 1, 0) if order == ">" else (1, 0)))
    numbers += struct.pack(f"{order}II6I", 6, 24, 0xDD000000, 2, 1, 1, 1, 1)
    inside = struct.pack(f"{order}IIII", 6, 8, 17, 0) + text(name) + text("MCOS") + text("table")
    inside += struct.pack(f"{order}II", 14, len(numbers)) + numbers
    whole = struct.pack(f"{order}II", 14, len(inside)) + inside
    if not packed:
        return whole
    small = zlib.compress(whole)
    return struct.pack(f"{order}II", 15, len(small)) + small


@pytest.mark.parametrize("packed", [True, False])
def test_an_object_of_matlab_is_named_and_hides_no_matrix(folder: Path, packed: bool) -> None:
    """MATLAB keeps the values of objects in an array without a name, which is no array of the user's."""
    s = session()
    savemat(folder / "m.mat", {"q": s.readings, "p": s.position}, do_compression=packed)
    savemat(folder / "hidden.mat", {"h": np.zeros((1, 999), np.uint8)})
    plain = (folder / "m.mat").read_bytes()
    hidden = (folder / "hidden.mat").read_bytes()[128:].replace(b"\1\0\1\0h\0\0\0", b"\1\0\0\0\0\0\0\0")
    table = object_of_matlab("measured", "<", packed)
    (folder / "both.mat").write_bytes(plain + table + hidden)
    found = read_sheet("both.mat")
    assert found.titles[0] == "q_0" and len(found.rows) == 40
    assert found.remarks == ("'measured' is no array of numbers or words with 40 rows, and left out",)
    (folder / "alone.mat").write_bytes(plain[:128] + table + hidden)
    with pytest.raises(
        calib.MeasurementError, match=r"^alone.mat: 'measured' is an object of MATLAB, such as a table, "
    ):
        read_sheet("alone.mat")


def test_a_file_of_matlab_4_has_no_elements(folder: Path) -> None:
    """Bytes of its numbers were taken for tags of MATLAB 5: here those of a matrix of numbers, stored as no type."""
    matrix = np.array((14, 56, 6, 8, 6, 0, 5, 8, 1, 1, 1, 0, 0, 0, 99, 99), dtype=">u4").tobytes()
    savemat(folder / "old.mat", {"q": np.zeros((60, 6))}, format="4")
    whole = bytearray((folder / "old.mat").read_bytes())
    whole[128 : 128 + len(matrix)] = matrix
    (folder / "old.mat").write_bytes(whole)
    assert len(read_sheet("old.mat").rows) == 60


def test_what_is_wrong_with_a_file_of_matlab_is_said(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    savemat(folder / "m.mat", {"q": np.arange(12.0).reshape(2, 6)})
    whole = (folder / "m.mat").read_bytes()
    savemat(folder / "zeros.mat", {"q": np.zeros((4, 1_000_001))}, do_compression=True)
    savemat(folder / "words.mat", {"n": "a"})
    (folder / "hdf.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM" + bytes(400))
    for cut in (*range(0, 128, 9), *range(128, len(whole) - 8, 7)):
        (folder / "cut.mat").write_bytes(whole[:cut])
        with pytest.raises(calib.MeasurementError, match=r"^cut.mat: (is no file of MATLAB|holds no arrays)"):
            read_sheet("cut.mat")
    for name, says in (
        ("zeros.mat", "has more than 4000000 values."),
        ("words.mat", "holds no arrays of numbers or words, with a row for every measurement."),
        ("hdf.mat", "is of MATLAB 7.3, which is not read; save it there with the option -v7."),
    ):
        with pytest.raises(calib.MeasurementError) as caught:
            read_sheet(name)
        assert str(caught.value) == f"{name}: {says}"
    savemat(folder / "packed.mat", {"q": np.zeros((100, 100))}, do_compression=True)
    monkeypatch.setattr(arrays, "_LARGEST", 10_000)
    with pytest.raises(calib.MeasurementError, match=r"^packed.mat: unpacks to more than 10000 bytes\.$"):
        read_sheet("packed.mat")


def test_points_by_their_names(folder: Path) -> None:
    logs(folder)
    said = run("import", "joints.csv", "sa.txt", "-o", "measured.csv")
    assert (said.code, said.err) == (0, "")
    assert "36 rows joined by 'Pose' and 'Point Name'" in said.out
    assert "4 rows of joints.csv have no partner and are left out" in said.out
    assert understood(folder / "measured.csv")["x [mm]"] == "X"
    assert run("import", "joints.csv", "sa.txt", "-o", "measured.csv").code == 1


def test_arrays(folder: Path) -> None:
    s = session()
    T = np.concatenate([s.rotation, s.position[:, :, None]], axis=2)
    T = np.concatenate([T, np.tile([[[0.0, 0.0, 0.0, 1.0]]], (40, 1, 1))], axis=1)
    odd = {"rate": 500.0, "log": np.zeros(7), "any": np.array([{}] * 40, dtype=object)}
    np.savez(folder / "m.npz", q=s.readings, p=s.position, quat=quaternions(s.rotation), **odd)
    assert run("import", "m.npz", "-o", "a.csv", "-q") == (0, "", "")
    names = understood(folder / "a.csv")
    assert [names[key] for key in ("shoulder_pan_joint [rad]", "x [m]", "qw")] == ["q_0", "p_x", "quat_0"]
    np.savez_compressed(folder / "n.npz", joints=np.degrees(s.readings), T=T)
    assert run("import", "n.npz", "-o", "b.csv", "-q") == (0, "", "")
    names = understood(folder / "b.csv")
    assert [names[key] for key in ("shoulder_pan_joint [deg]", "x [m]", "r12")] == ["joints_0", "T_0_3", "T_0_1"]
    held = read_sheet(folder / "m.npz")
    left = "'rate', 'log', 'any' are no arrays of numbers or words with 40 rows, and left out"
    assert held.remarks == (left,)
    assert float(held.rows[3][held.titles.index("p_y")]) == s.position[3, 1]
    (folder / "cut.npz").write_bytes((folder / "m.npz").read_bytes()[:900])
    said = run("import", "cut.npz", "-o", "c.csv")
    assert (said.code, said.err) == (1, "Error: cut.npz: is no archive of arrays that can be read.\n")
    np.savez(folder / "o.npz", any=odd["any"])
    assert "holds no arrays of numbers or words" in run("import", "o.npz", "-o", "c.csv").err
    assert not (folder / "c.csv").exists()


def test_records_below_other_names_are_no_row(folder: Path) -> None:
    """As of a robot that was measured at several heights: all its poses became one row, or too many columns."""
    poses = [{"id": k, "joint_states": [0.1 * k, 0.2], "prism": [1.0, 2.0 + k, 3.0]} for k in range(3)]
    for found, inside in (
        (
            {"names": ["a", "b"], "heights": {"1.9": {"spaces": {"0": {"points": poses}}}}},
            "heights.1.9.spaces.0.points",
        ),
        ({"heights": {"1.9": {"points": poses}, "2.5": {"points": poses}}}, "heights.1.9.points"),
    ):
        (folder / "m.json").write_text(json.dumps(found))
        said = run("import", "m.json", "-o", "m.csv")
        assert said.code == 1
        assert said.err.startswith(
            f"Error: m.json: {inside!r} is a list of records that lies below other names; allowed"
        )


def test_points_in_order_and_rows_that_do_not_fit(folder: Path) -> None:
    logs(folder)
    assert "40 rows joined in their order" in run("import", "joints.csv", "in_order.txt", "-o", "a.csv").out
    assert understood(folder / "a.csv")["x [mm]"] == "column 1"
    said = run("import", "sa.txt", "in_order.txt", "-o", "b.csv")
    assert (
        said.err == "Error: sa.txt has 36 rows and in_order.txt 40, and no column tells which rows belong together.\n"
    )
    for file, count in (("stream.csv", 30), ("readings.csv", 20)):  # as of a recording
        rows = [f"{0.1 * k:.2f},{0.5 * k + 0.25},2.5,3.5" for k in range(count)]
        (folder / file).write_text("\n".join([f"time [s],{file[0]}1,{file[0]}2,{file[0]}3", *rows, ""]))
    said = run("import", "readings.csv", "stream.csv", "-o", "b.csv")
    assert said.err.endswith(
        'and the joints are the readings, with clock = "free"; if it stood still at each point, keep one row of the '
        "joints for each.\n"
    )
    said = run("import", "joints.csv", "sa.txt", "-o", "b.csv", "--by", "Group")
    assert said.err.startswith("Error: joints.csv, sa.txt: 'Group' does not tell which rows belong together: ")
    said = run("import", "joints.csv", "sa.txt", "-o", "b.csv", "--by", "Point")
    assert said.err.startswith("Error: joints.csv, sa.txt: no column is called 'Point'; they are 'Pose', 'J1', ")
    assert not (folder / "b.csv").exists()


def test_times_are_known_however_they_are_written(folder: Path) -> None:
    (folder / "q.csv").write_text("Time (s),q1_deg\n0.0,1.5\n0.01,2.5\n0.02,3.5\n")
    (folder / "p.csv").write_text("Time[s],X,Y,Z\n0.0,1.2,2.1,3.3\n0.01,2.2,3.1,4.3\n")
    assert (
        "as both have times, a job joins them if the arm moved meanwhile"
        in run("import", "q.csv", "p.csv", "-o", "b.csv").err
    )


def test_files_of_one_row_each_are_not_put_side_by_side(folder: Path) -> None:
    """As programs write them that keep a file for each pose."""
    for k in range(3):
        (folder / f"pose_{k}.json").write_text(json.dumps({"q": [0.1 * k] * 6, "position": [k, 2, 3]}))
    files = [f"pose_{k}.json" for k in range(3)]
    said = run("import", *files, "-o", "a.csv")
    assert said.code == 1
    assert "pose_0.json, pose_1.json: have one row each of the same columns; --stack file puts" in said.err
    assert run("import", *files, "--stack", "file", "-o", "a.csv").code == 0
    assert len(read_sheet(folder / "a.csv").rows) == 3
    assert run("import", *files, "--by", "order", "-o", "b.csv").code == 0


def test_points_in_another_order_are_not_taken_for_measurements(folder: Path) -> None:
    """Joined by order, though their order is another one, the arm does not follow, and that is asked."""
    s = session()
    (folder / "joints.csv").write_text(text(J, [np.degrees(s.readings)]))
    (folder / "points.csv").write_text(text(["X", "Y", "Z"], [1e3 * s.position[::-1]]))
    assert run("import", "joints.csv", "points.csv", "-o", "measured.csv").code == 0
    assert [q.about for q in calib.measuring.propose(UR10, [folder / "measured.csv"]).questions] == ["columns"]


def test_records(folder: Path) -> None:
    s = session()
    names = [reading.name for reading in calib.load_robot(UR10, "tool0").readings]
    turned = quaternions(s.rotation)
    records = [
        {
            "joint_state": {"name": names, "position": list(q), "velocity": []},
            "pose": {"position": dict(zip("xyz", p, strict=True)), "orientation": dict(zip("wxyz", o, strict=True))},
        }
        for q, p, o in zip(s.readings.tolist(), s.position.tolist(), turned.tolist(), strict=True)
    ]
    (folder / "log.jsonl").write_text("\n".join(map(json.dumps, records)))
    (folder / "log.json").write_text(json.dumps({"samples": records}))
    files = ["log.jsonl", "log.json"]
    try:
        import yaml
    except ImportError:
        pass
    else:
        (folder / "log.yaml").write_text(yaml.safe_dump_all(records))
        files.append("log.yaml")
    for file in files:
        assert run("import", file, "-o", f"{file}.csv", "-q") == (0, "", "")
        columns = understood(folder / f"{file}.csv")
        assert columns["elbow_joint [rad]"] == "elbow_joint"
        assert columns["x [m]"] == "pose.position.x"
        assert columns["qw"] == "pose.orientation.w"


def test_entries_of_a_mapping_are_joined_by_their_names(folder: Path) -> None:
    """They were lost, and rows of two files joined in the order in which they stood."""
    (folder / "a.json").write_text('{"p": {"j1": 1}, "q": {"j1": 2}, "r": {"j1": 3}}')
    (folder / "b.json").write_text('{"r": {"x": 30}, "p": {"x": 10}, "q": {"x": 20}}')
    found = joined(read_sheet("a.json"), read_sheet("b.json"))
    assert found.titles == ("record", "j1", "x")
    assert found.rows == (("p", "1", "10"), ("q", "2", "20"), ("r", "3", "30"))
    assert found.remarks == ("3 rows joined by 'record' and 'record'",)
    (folder / "a.json").write_text('{"p": {"record": 1}}')
    assert read_sheet("a.json").titles == ("record_", "record")


@pytest.mark.parametrize("turned", [True, False])
def test_a_hundred_columns_that_may_name_rows_are_tried_quickly(turned: bool) -> None:
    """Two files of 0.8 MB took minutes, and gigabytes."""
    n, each = 1000, 100
    rows = tuple(tuple(str((r + c * turned) % n) for c in range(each)) for r in range(n))
    first, second = (Sheet(tuple(f"{name}{k}" for k in range(each)), rows, name) for name in "ab")
    begun = time.process_time()
    if turned:
        with pytest.raises(calib.MeasurementError, match="rows could be joined by 'a0', 'a1', "):
            joined(first, second)
    else:
        assert len(joined(first, second).rows) == n
    assert time.process_time() - begun < 5.0


def test_of_many_names_fewer_columns_may_name_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two archives of 126 kB, of 100 columns and 40 000 rows, took more than 85 s, and a gigabyte."""
    monkeypatch.setattr(sheet_, "_MOST_NAMES", 1000)
    looked_at: list[int] = []
    partners = sheet_._have_partners

    def counted(first: dict[str, int], second: dict[str, int]) -> bool:
        looked_at.append(1)
        return partners(first, second)

    monkeypatch.setattr(sheet_, "_have_partners", counted)
    n, each = 100, 50
    rows = tuple((str(k),) * each for k in range(n - 1))
    rows = (*rows, tuple(str(n + k) for k in range(each)))
    first, second = (Sheet(tuple(f"{name}{k}" for k in range(each)), rows, name) for name in "ab")
    assert joined(first, second).remarks == (f"{n} rows joined by 'a0' and 'b0'",)
    assert len(looked_at) == 10 * 10
    looked_at.clear()
    # The one that --by names is looked at wherever it stands, and so are all that it may go with.
    assert joined(first, second, "a49").remarks == (f"{n} rows joined by 'a49' and 'b49'",)
    assert len(looked_at) == each


def archive(path: Path, name: str) -> None:
    data = io.BytesIO()
    np.save(data, np.zeros((2, 9)))
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(f"{name}.npy", data.getvalue())


def test_a_name_that_all_numbers_of_a_list_would_have_is_not_too_long(folder: Path) -> None:
    """Names of 900 kB, of a thousand numbers each, took gigabytes and half a minute."""
    long, many = "K" * 9_000, list(range(1000))
    (folder / "a.json").write_text(json.dumps([{long: many}]))
    (folder / "b.yaml").write_text(f"- ? {long}\n  : {many}\n")
    (folder / "c.txt").write_text(f"b {long} = {many}\nb {long} = {many}\n")
    (folder / "d.csv").write_text(f"{long};b\n{many[:100]};{many[:3]}\n{many[:100]};{many[:3]}\n")
    archive(folder / "e.npz", long[:1001])
    for name in ("a.json", "b.yaml", "c.txt", "d.csv", "e.npz"):
        with pytest.raises(
            calib.MeasurementError, match=r"the name 'K+\.\.\.' has \d+ characters; allowed are 1000\.$"
        ):
            read_sheet(name)
    archive(folder / "e.npz", long[:1000])
    assert len(read_sheet("e.npz").titles) == 9


def test_empty_cells_beside_a_long_list_are_no_values_without_end(folder: Path) -> None:
    """A list of 40 000 numbers above 200 000 rows without one took 8 GB."""
    (folder / "a.csv").write_text("a;b\n" + f"[{'1 ' * 600}];[1 2 3]\n" + "0;[1 2 3]\n" + ";\n" * 9000)
    assert len(read_sheet("a.csv").titles) == 4  # a cell that is none leaves all as they are
    (folder / "a.csv").write_text("a;b\n" + f"[{'1 ' * 600}];[1 2 3]\n" + ";1\n" * 9000)
    with pytest.raises(
        calib.MeasurementError,
        match=r"a\.csv: as a table, with a column for each of 600 numbers in 'a', it has more than 5000000 values\.$",
    ):
        read_sheet("a.csv")
    (folder / "a.csv").write_text("a;b\n" + f"[{'1 ' * 600}];[1 2 3]\n" + ";1\n" * 7000)
    assert len(read_sheet("a.csv").titles) == 601


def test_what_stands_beside_records_is_told(folder: Path) -> None:
    (folder / "a.json").write_text('{"unit": "inch", "data": [{"x": 1}]}')
    found = read_sheet("a.json")
    assert found.rows == (("1",),)
    assert found.remarks == ("'data' is read, and not 'unit'",)


def test_a_workbook(folder: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    s = session()
    book = openpyxl.Workbook()
    book.active.append([*J, "X", "Y", "Z"])
    for row in np.hstack([np.degrees(s.readings), 1e3 * s.position]).tolist():
        book.active.append(row)
    book.save(folder / "book.xlsx")
    assert run("import", "book.xlsx", "-o", "measured.csv", "-q") == (0, "", "")
    assert understood(folder / "measured.csv")["x [mm]"] == "X"


def test_rows_that_a_filter_hides_are_read_and_told(folder: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (["X [mm]", "Y [mm]"], [1, 2], [3, 4], [5, 6]):
        book.active.append(row)
    book.save(folder / "book.xlsx")
    assert read_sheet("book.xlsx").remarks == ()
    for row in (2, 3):
        book.active.row_dimensions[row].hidden = True
    book.save(folder / "book.xlsx")
    found = read_sheet("book.xlsx")
    assert found.rows == (("1", "2"), ("3", "4"), ("5", "6"))
    assert found.remarks == ("2 rows are hidden, and read as well",)


@pytest.mark.parametrize(
    "of",
    [
        lambda names, rows: {name: {str(k): row[j] for k, row in enumerate(rows)} for j, name in enumerate(names)},
        lambda names, rows: {name: [row[j] for row in rows] for j, name in enumerate(names)},
        lambda names, rows: {"columns": names, "index": list(range(len(rows))), "data": rows},
        lambda names, rows: {"columns": names, "data": rows},
        lambda names, rows: [dict(zip(names, row, strict=True)) for row in rows],
    ],
    ids=["columns", "list", "split", "tight", "records"],
)
def test_columns_are_read_as_pandas_writes_them(
    folder: Path, of: Callable[[list[str], list[list[float]]], Any]
) -> None:
    """What to_json() writes by itself was read as a row of each column, and lists as one row of all numbers."""
    names, rows = ["j1 [deg]", "x [mm]"], [[k + 0.5, 10.0 * k] for k in range(20)]
    (folder / "a.json").write_text(json.dumps(of(names, rows)))
    found = read_sheet("a.json")
    assert found.titles == ("j1 [deg]", "x [mm]")
    assert found.rows == tuple((str(a), str(b)) for a, b in rows)


def test_names_of_rows_of_columns_stay(folder: Path) -> None:
    """A frame of which rows were taken out has gaps in its numbers; one with names has them beside its columns."""
    (folder / "a.json").write_text('{"x": {"2": 1, "5": 2}, "y": {"2": 3, "5": null}}')
    assert read_sheet("a.json").titles == ("record", "x", "y")
    assert read_sheet("a.json").rows == (("2", "1", "3"), ("5", "2", ""))
    (folder / "b.json").write_text('{"columns": ["x"], "index": ["p", "q"], "data": [[1], [2]]}')
    assert read_sheet("b.json").rows == (("p", "1"), ("q", "2"))


def test_very_many_entries_without_a_common_name_are_refused_quickly(folder: Path) -> None:
    """Each name of the first was looked for in each of the others."""
    records = {"a": {f"n{k}": 1 for k in range(30_000)}} | {f"b{k}": {"y": 1} for k in range(30_000)}
    (folder / "a.json").write_text(json.dumps(records))
    begun = time.process_time()
    with pytest.raises(calib.MeasurementError, match="entries as 'a', 'b0' have no name in common"):
        read_sheet("a.json")
    assert time.process_time() - begun < 5.0


def test_columns_of_arrays_are_read(folder: Path) -> None:
    q, p = [[float(k), 1.0] for k in range(20)], [[1.0, 2.0, float(k)] for k in range(20)]
    (folder / "a.json").write_text(json.dumps({"q": q, "p": p}))
    found = read_sheet("a.json")
    assert found.titles == ("q_0", "q_1", "p_0", "p_1", "p_2")
    assert len(found.rows) == 20


@pytest.mark.parametrize(
    ("name", "contents", "sentence"),
    [
        ("a.jsonl", "{}\n{", "a.jsonl:2: is not JSON."),
        ("a.jsonl", "[1]", f"a.jsonl: record 1 is no mapping of names to values; {RECORDS}."),
        ("a.json", '[["x", "y"], [1, 2]]', f"a.json: record 1 is no mapping of names to values; {RECORDS}."),
        (
            "a.json",
            '{"0": {"0": 1, "1": 2}, "1": {"0": 3, "1": 4}}',
            "a.json: numbers are the names of rows and of columns, so that it tells neither; write a list of records "
            '(in pandas to_json with orient="records").',
        ),
        (
            "a.json",
            '{"joints": {"j1": [1, 2]}, "points": {"x": [3, 4]}}',
            f"a.json: entries as 'joints', 'points' have no name in common, and are not rows; {RECORDS}.",
        ),
        (
            "a.json",
            '{"q": [1, 2, 3, 4, 5, 6], "pose": [1, 2, 3, 4, 5, 6]}',
            f"a.json: has lists of 6 values, and does not tell whether they are rows or one record; {RECORDS}.",
        ),
        ("a.json", '{"columns": ["x", "x"], "data": [[1, 2]]}', "a.json: has two columns of one name."),
        (
            "a.json",
            '{"columns": ["x", "y"], "data": [[1, 2], [3]]}',
            "a.json: row 2 of 'data' is no list of 2 values, as 'columns'.",
        ),
        ("a.jsonl", "", "a.jsonl: has no rows."),
        ("a.json", "[" * 100_000, "a.json: is not JSON."),
        ("a.jsonl", '{"a":' * 12 + "1" + "}" * 12, "a.jsonl: is nested too deep."),
        ("a.xlsx", "no", "a.xlsx: is no workbook that can be read."),
        ("a.yaml", "a: [1", "a.yaml: is no YAML that can be read."),
        ("a.yaml", "a: &x [1]\nb: *x\n", "a.yaml: has anchors and aliases, which are not read."),
        ("a.yaml", "- {a: 1, a: 2}", "a.yaml: is no YAML that can be read: it has 'a' twice in one object."),
        ("a.json", '[{"a":1,"a":2}]', "a.json: is not JSON that can be read: it has 'a' twice in one object."),
        ("a.json", '[{"c.d":3,"c":{"d":4}}]', "a.json: record 1 has two values of the name 'c.d'."),
        ("a.json", "{}", "a.json: has no rows."),
        (
            "arm.urdf",
            '<robot name="a">\n</robot>\n',
            "arm.urdf: is XML, and no table; write the numbers that it holds into one.",
        ),
    ],
)
def test_what_cannot_be_read(folder: Path, name: str, contents: str, sentence: str) -> None:
    if name.endswith((".yaml", ".xlsx")):
        pytest.importorskip("yaml" if name.endswith(".yaml") else "openpyxl")
    (folder / name).write_text(contents)
    with pytest.raises(calib.MeasurementError) as caught:
        read_sheet(name)
    assert str(caught.value) == sentence


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: " + 300_000 * "[", "is nested too deep"),
        (300_000 * "- ", "is nested too deep"),
        ("a: " + 100_000 * "{b: ", "is nested too deep"),
        (40 * "? ", "has a list or a mapping as a name, which is not read"),
        ("a: &-a [1]\nb: *-a\n", "has anchors and aliases, which are not read"),
    ],
)
def test_yaml_that_ends_its_reader_is_refused(folder: Path, text: str, says: str) -> None:
    """PyYAML's builder in C takes a frame of the stack for every level, and ends the process with it."""
    pytest.importorskip("yaml")
    (folder / "a.yaml").write_text(text)
    with pytest.raises(calib.MeasurementError, match=says):
        read_sheet("a.yaml")
    (folder / "b.yaml").write_text("a: 1\n" + 300_000 * "\n")
    begun = time.process_time()
    assert read_sheet("b.yaml").rows == (("1",),)
    assert time.process_time() - begun < 5.0


def test_numbers_of_yaml_are_as_written(folder: Path) -> None:
    """By YAML 1.1 they would be 15, 90 and 1000; what is no number of ours is refused where it is used."""
    pytest.importorskip("yaml")
    (folder / "a.yaml").write_text("- {a: 017, b: 1:30, c: 1_000, d: -2.50, e: null, f: .nan}\n")
    assert read_sheet("a.yaml").rows == (("017", "1:30", "1_000", "-2.50", "", "nan"),)


def test_a_formula_that_was_never_computed_is_no_empty_cell(folder: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (["a", "b"], [1.0, 2.0], [3.0, "=A2+1"]):
        book.active.append(row)
    book.save(folder / "a.xlsx")
    with pytest.raises(calib.MeasurementError, match=r"^a.xlsx: cell B3 has a formula that was never computed; save"):
        read_sheet("a.xlsx")


def test_a_formula_that_shows_no_text_is_an_empty_cell(folder: Path) -> None:
    pytest.importorskip("openpyxl")
    rewritten(folder, '<c r="B3" t="str"><f>IF(A2&gt;0,"","x")</f><v></v></c>')
    assert read_sheet("a.xlsx").rows == (("1", "2"), ("3", ""))


def test_a_formula_that_many_cells_share_is_worked_out_for_none(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A formula of 60 kB in 3000 cells, 17 kB of a file, took more than half a minute.
    translator = pytest.importorskip("openpyxl.formula.translate").Translator
    monkeypatch.delattr(translator, "translate_formula")
    first = '<c r="B3"><f t="shared" ref="B3:B4" si="0">A2+A1</f><v>4</v></c>'
    rewritten(folder, first + '</row><row r="4"><c r="B4"><f t="shared" si="0"/><v>5</v></c>')
    assert read_sheet("a.xlsx").rows == (("1", "2"), ("3", "4"), ("", "5"))


def rewritten(folder: Path, cells: str) -> None:
    """Write a.xlsx with these in place of its cell B3, as other programs write what they have computed."""
    import openpyxl

    book = openpyxl.Workbook()
    for row in (["a", "b"], [1, 2], [3, 4]):
        book.active.append(row)
    book.save(folder / "whole.xlsx")
    with zipfile.ZipFile(folder / "whole.xlsx") as old, zipfile.ZipFile(folder / "a.xlsx", "w") as new:
        for name in old.namelist():
            part = old.read(name).decode()
            if name == "xl/worksheets/sheet1.xml":
                part, found = re.subn(r'<c r="B3".*?</c>', lambda _: cells, part)
                assert found == 1
            new.writestr(name, part)


def test_a_workbook_in_the_place_of_a_table_says_what_to_do(folder: Path) -> None:
    (folder / "m.xlsx").write_bytes(b"PK\x03\x04" + bytes(100))
    said = run("init", UR10, "m.xlsx")
    expected = "Error: m.xlsx: is a workbook, and no text; calib import m.xlsx -o table.csv makes a table.\n"
    assert (said.code, said.err) == (1, expected)
    (folder / "m.xlsx").rename(folder / "m.csv")
    expected = "Error: m.csv: is an archive, and no text; unpack it.\n"
    assert run("import", "m.csv", "-o", "t.csv") == (1, "", expected)
    (folder / "m.csv").write_bytes(b"PK\x03\x04" + bytes(26) + b"[Content_Types].xml" + bytes(100))
    expected = "Error: m.csv: is a workbook, and no text; call it .xlsx, and calib import makes a table of it.\n"
    assert run("import", "m.csv", "-o", "t.csv") == (1, "", expected)


@pytest.mark.parametrize("name", ["m.yaml", "m.yml", "m.json", "m.jsonl"])
@pytest.mark.parametrize("command", ["init", "check"])
def test_records_in_the_place_of_a_table_say_what_to_do(folder: Path, name: str, command: str) -> None:
    s = session()
    rows = [{f"joint_{k + 1}": q for k, q in enumerate(row)} | {"x": 1.0} for row in s.readings.tolist()]
    text_of = json.dumps(rows) if name.endswith("n") else "\n".join(map(json.dumps, rows))
    listed = "\n".join("- " + "\n  ".join(f"{key}: {value}" for key, value in row.items()) for row in rows)
    (folder / name).write_text(listed if "y" in name else text_of, encoding="utf-8")
    expected = f"Error: {name}: is of records, and no table; calib import {name} -o table.csv makes one.\n"
    assert run(command, UR10, name) == (1, "", expected)
    assert run("import", name, "-o", "table.csv").code == 0


def test_arrays_in_the_place_of_a_table_say_what_to_do(folder: Path) -> None:
    np.savez(folder / "m.npz", q=session().readings)
    expected = "Error: m.npz: is an archive of arrays, and no text; calib import m.npz -o table.csv makes a table.\n"
    assert run("init", UR10, "m.npz") == (1, "", expected)


def test_a_workbook_of_a_kind_that_is_not_read_is_to_be_saved_anew(folder: Path) -> None:
    with zipfile.ZipFile(folder / "m.ods", "w") as archive:
        archive.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
    (folder / "m.xls").write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(100))
    for name in ("m.ods", "m.xls"):
        expected = f"Error: {name}: is a document of another program, and no text; save it as .xlsx or as CSV.\n"
        assert run("import", name, "-o", "t.csv") == (1, "", expected)
        assert run("init", UR10, name) == (1, "", expected)


def test_the_sheet_that_is_seen_is_read(folder: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["old"])
    book.active.append([1.0])
    book.active.sheet_state = "hidden"
    seen = book.create_sheet("new")
    for row in (["a", "b", None], [1.0, 0.0], [0.0, 0.0]):
        seen.append(row)
    seen.cell(900_000, 900).number_format = "0.00"
    book.active = 1
    book.save(folder / "a.xlsx")
    begun = time.process_time()
    found = read_sheet("a.xlsx")
    assert (found.titles, [[float(cell) for cell in row] for row in found.rows]) == (("a", "b"), [[1, 0], [0, 0]])
    assert time.process_time() - begun < 10.0


def test_of_several_sheets_the_first_that_is_not_empty_is_read_and_the_others_are_said(folder: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    measured = book.create_sheet("measured")
    measured.append(["a", "b"])
    measured.append([1.0, 2.0])
    book.create_sheet("notes").append(["nothing"])
    book.save(folder / "a.xlsx")
    found = read_sheet("a.xlsx")
    assert (found.titles, found.rows) == (("a", "b"), (("1", "2"),))
    assert found.remarks == ("the sheet 'measured' is read, and not 'Sheet', 'notes'",)


@pytest.mark.parametrize("above", [["Arm 7", None, None, None], ["joints", None, "point", None], ["No", 7, None, None]])
def test_rows_above_the_header_of_a_spreadsheet_are_passed_over(above: list[object], folder: Path) -> None:
    """It fills up every line to the width of the table."""
    openpyxl = pytest.importorskip("openpyxl")
    titles, row = ["J1 [deg]", "J2 [deg]", "X [mm]", "Y [mm]"], ["1,5", 2.5, 3.5, 4.5]  # a number that was pasted
    book = openpyxl.Workbook()
    for cells in (above, titles, row):
        book.active.append(cells)
    book.save(folder / "a.xlsx")
    lines = [";".join("" if cell is None else str(cell).replace(".", ",") for cell in cells) for cells in (above, row)]
    (folder / "a.csv").write_text(f"{lines[0]}\n{';'.join(titles)}\n{lines[1]}\n")
    for name, said in (
        ("a.xlsx", "1 row before the header passed over"),
        ("a.csv", "1 line before the header passed over"),
    ):
        found = read_sheet(name)
        assert (found.titles, found.rows) == (tuple(titles), (("1.5", "2.5", "3.5", "4.5"),))
        assert found.remarks[-1] == said


def test_what_is_merged_downwards_stands_in_every_row(folder: Path) -> None:
    """A pose that was measured three times, below a header of two rows; a row of nothing else is none."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    sheet = book.active
    for cells in (
        ["J1 [deg]", "Point", None, None, None],
        [None, "Nest", "X [mm]", "Y [mm]", "Note"],
        [1.5, "A", 2.5, 3.5, None],
        [None, "B", 4.5, 5.5, "far"],
        [None, "C", 6.5, 7.5, None],
        [8.5, "A", 9.5, 1.5, None],
        [None, None, None, None, None],
    ):
        sheet.append(cells)
    for merged in ("A1:A2", "B1:E1", "A3:A5", "A6:A7", "C6:C7", "E3:E3"):
        sheet.merge_cells(merged)
    book.save(folder / "a.xlsx")
    found = read_sheet("a.xlsx")
    assert found.titles == ("J1 [deg]", "Nest", "X [mm]", "Y [mm]", "Note")
    assert found.rows == (
        ("1.5", "A", "2.5", "3.5", ""),
        ("1.5", "B", "4.5", "5.5", "far"),
        ("1.5", "C", "6.5", "7.5", ""),
        ("8.5", "A", "9.5", "1.5", ""),
    )
    assert found.remarks == (
        "3 cells filled with what is merged with them from above",
        "1 row before the header passed over",
    )


def test_rows_with_few_cells_are_rows(folder: Path) -> None:
    """Points of which an exporter leaves most columns empty, below a line of its own and without a header."""
    rows = "P1,1.5,2.5,3.5,,,,,\nP2,4.5,5.5,6.5,,,,,\n"
    (folder / "a.csv").write_text(f"An instrument\nName,X,Y,Z,A,B,C,Tolerance,Remark\n{rows}")
    (folder / "b.csv").write_text(rows)
    assert read_sheet("a.csv").titles == ("Name", "X", "Y", "Z", "A", "B", "C", "Tolerance", "Remark")
    for name in ("a.csv", "b.csv"):
        assert [row[:2] for row in read_sheet(name).rows] == [("P1", "1.5"), ("P2", "4.5")]


def test_a_row_of_units_in_a_workbook_is_no_row(folder: Path) -> None:
    """Rows that are joined by names would lose it, and files that stand below each other would have it within them."""
    openpyxl = pytest.importorskip("openpyxl")
    for name, rows in (
        ("joints", [["pose", "J1", "J2"], [None, "deg", "°"], ["p", 1.5, 2.5], ["q", 3.5, 4.5]]),
        ("points", [["name", "X", "Y"], [None, "mm", "mm"], ["q", 7.5, 8.5], ["p", 5.5, 6.5]]),
    ):
        book = openpyxl.Workbook()
        for cells in rows:
            book.active.append(cells)
        book.save(folder / f"{name}.xlsx")
    found = joined(read_sheet("joints.xlsx"), read_sheet("points.xlsx"))
    assert found.titles == ("pose", "J1 [deg]", "J2 [deg]", "X [mm]", "Y [mm]")
    assert found.rows == (("p", "1.5", "2.5", "5.5", "6.5"), ("q", "3.5", "4.5", "7.5", "8.5"))
    assert "the row below the header has the units" in found.remarks
    book.active["C1"] = "Y [m]"
    book.save(folder / "points.xlsx")
    with pytest.raises(
        calib.MeasurementError, match=r"^points\.xlsx: column 'Y \[m\]' has the unit m in its title, and mm"
    ):
        read_sheet("points.xlsx")


def test_a_workbook_in_a_language_that_is_not_read_is_to_be_saved_anew(
    folder: Path, recwarn: pytest.WarningsRecorder
) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    openpyxl.Workbook().save(folder / "usual.xlsx")
    with zipfile.ZipFile(folder / "usual.xlsx") as usual, zipfile.ZipFile(folder / "a.xlsx", "w") as strict:
        for name in usual.namelist():
            part = usual.read(name)
            for of in (b"spreadsheetml", b"officeDocument"):
                part = part.replace(
                    b"http://schemas.openxmlformats.org/%b/2006" % of, b"http://purl.oclc.org/ooxml/%b" % of
                )
            strict.writestr(name, part)
    with pytest.raises(
        calib.MeasurementError, match=r"has no sheet that can be read; save it as .xlsx, and not as Strict"
    ):
        read_sheet("a.xlsx")
    assert not recwarn


def test_what_is_too_wide_is_refused_and_not_cut(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    titles = [f"c{k}" for k in range(1001)]
    book = openpyxl.Workbook()
    for row in (titles, range(1001)):
        book.active.append(list(row))
    book.save(folder / "a.xlsx")
    (folder / "a.csv").write_text("\n".join([",".join(titles), ",".join(map(str, range(1001)))]))
    for name in ("a.xlsx", "a.csv"):
        with pytest.raises(calib.MeasurementError, match=rf"^{name}: has (more than 1000|1001) columns"):
            read_sheet(name)
    monkeypatch.setattr(workbook, "MOST_COLUMNS", 2000)
    monkeypatch.setattr(workbook, "_MOST_VALUES", 1500)
    with pytest.raises(calib.MeasurementError, match=r"^a.xlsx: has more than 1500 cells\.$"):
        read_sheet("a.xlsx")


@pytest.mark.parametrize(
    ("cell", "says"),
    [
        ("XFD1048576", "has more than 1000 columns: the last cell of row 1048576 is in column 16384"),
        ("XFD2", "has more than 1000 columns: the last cell of row 2 is in column 16384"),
        ("B300000", ""),
    ],
)
def test_a_cell_far_from_the_others_is_read_or_named(folder: Path, cell: str, says: str) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active["A1"], book.active["A2"], book.active[cell] = "x [mm]", 1, 3
    book.save(folder / "a.xlsx")
    if says:
        with pytest.raises(calib.MeasurementError, match=rf"^a.xlsx: {says}\.$"):
            read_sheet("a.xlsx")
    else:
        assert read_sheet("a.xlsx").rows == (("1", ""), ("", "3"))


def test_empty_cells_without_end_are_not_looked_at(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    monkeypatch.setattr(workbook, "_MOST_LOOKED_AT", 2000)
    book = openpyxl.Workbook()
    for row in range(1, 4):
        book.active.cell(row, 900).number_format = "0.00"
    book.save(folder / "a.xlsx")
    with pytest.raises(calib.MeasurementError, match=r"^a.xlsx: has more than 2000 cells, nearly all of them empty\.$"):
        read_sheet("a.xlsx")


def test_a_formula_far_below_is_no_empty_cell(folder: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active["A1"], book.active["A2"], book.active["A200500"] = "x [mm]", 1, "=A2+1"
    book.save(folder / "a.xlsx")
    with pytest.raises(calib.MeasurementError, match=r"^a.xlsx: cell A200500 has a formula that was never computed"):
        read_sheet("a.xlsx")


@pytest.mark.parametrize(("name", "where"), [("a.json", "a.json"), ("a.jsonl", "a.jsonl:1")])
def test_a_number_of_very_many_digits_is_json(folder: Path, name: str, where: str) -> None:
    (folder / name).write_text('{"x": ' + 900_000 * "1" + "}")
    with pytest.raises(calib.MeasurementError) as caught:
        read_sheet(name)
    assert str(caught.value) == f"{where}: is not JSON that can be read: it has a number of 900000 digits."


def test_an_order_that_was_asked_for_does_not_blame_the_columns(folder: Path) -> None:
    (folder / "a.csv").write_text("Pose,q\n1,0.1\n2,0.2\n3,0.3\n")
    (folder / "b.csv").write_text("Name,x\n2,1.5\n1,2.5\n")
    said = run("import", "a.csv", "b.csv", "--by", "order", "-o", "c.csv")
    assert said == (1, "", "Error: a.csv has 3 rows and b.csv 2, and in order each row needs one beside it.\n")


def test_one_row_is_no_rows(folder: Path) -> None:
    (folder / "a.json").write_text('[{"x": 1}]')
    assert run("import", "a.json", "-o", "a.csv").out == "1 row of 1 column is in a.csv.\n"
    assert run("check", "a.csv").out.startswith("a.csv: 1 row of 1 column.\n")


def test_check_of_a_workbook_says_what_to_do(folder: Path) -> None:
    (folder / "m.xlsx").write_bytes(b"PK\x03\x04" + bytes(100))
    expected = "Error: m.xlsx: is a workbook, and no text; calib import m.xlsx -o table.csv makes a table.\n"
    assert run("check", "m.xlsx") == (1, "", expected)
    assert run("check", UR10, "m.xlsx") == (1, "", expected)


@pytest.mark.parametrize(
    ("part", "contents", "says"),
    [
        ("xl/worksheets/sheet1.xml", b"<row/>" * 1_500_000, "unpacks to more than 4 tags for each of its bytes"),
        ("xl/sharedStrings.xml", b"<si/>" * 1_500_000, "unpacks to more than 4 tags for each of its bytes"),
        ("xl/styles.xml", b"<xf/>" * 250_001, "has more formats, names and texts than a table needs"),
        ("xl/sharedStrings.xml", b"<x:si/>" * 250_001, "has more formats, names and texts than a table needs"),
        ("xl/worksheets/sheet1.xml", b"<is/>" * 250_001, "has more formats, names and texts than a table needs"),
        ("xl/comments1.xml", bytes(60_000_000), "unpacks to more than 50000000 bytes"),
        (
            "xl/styles.xml",
            b"<a b='" + b"x" * 250_000 + b"'/>",
            "'xl/styles.xml' has a tag, a comment or a text of more",
        ),
        ("xl/styles.xml", b"<a><!-- " + b"<b> " * 70_000 + b"--></a>", "'xl/styles.xml' has a tag, a comment or a"),
        (
            "xl/styles.xml",
            b"\xff\xfe <?a " + b"<b> " * 70_000,
            "'xl/styles.xml' has a tag, a comment or a text of more",
        ),
        ("xl/styles.xml", b"<!DOCTYPE a>", "'xl/styles.xml' has a document type, which no workbook needs"),
        ("xl/styles.xml", "<!DOCTYPE a>".encode("utf-16"), "'xl/styles.xml' has a document type, which no"),
    ],
)
def test_a_workbook_that_unpacks_to_too_much_is_refused_before_it_is_parsed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, part: str, contents: bytes, says: str
) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    monkeypatch.setattr(openpyxl, "load_workbook", lambda *_, **__: pytest.fail("was parsed"))
    with zipfile.ZipFile(folder / "a.xlsx", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(part, contents)
    with pytest.raises(calib.MeasurementError, match=rf"^a.xlsx: {says}"):
        read_sheet("a.xlsx")


def test_a_workbook_of_one_word_is_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing that a program writes has more tags for each of its bytes."""
    openpyxl = pytest.importorskip("openpyxl")
    monkeypatch.setattr(workbook, "_LEAST", 0)
    monkeypatch.setattr(workbook, "_LEAST_TAGS", 0)
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet()
    for _ in range(1001):
        sheet.append(["p"] * 10)
    book.save(folder / "a.xlsx")
    assert len(read_sheet("a.xlsx").rows) == 1000


def test_arrays_of_too_many_values_are_refused_before_each_becomes_a_word(folder: Path) -> None:
    np.savez_compressed(folder / "a.npz", q=np.zeros(20_000_000, dtype=np.uint8))
    np.savez_compressed(folder / "b.npz", q=np.zeros((2, 1_000_000)))
    with pytest.raises(calib.MeasurementError, match=r"^a.npz: has 20000000 values; allowed are 4000000\.$"):
        read_sheet("a.npz")
    with pytest.raises(calib.MeasurementError, match=r"^b.npz: has 1000000 columns; allowed are 1000\.$"):
        read_sheet("b.npz")


def test_columns_of_a_record_are_counted_as_they_come(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each has a name of its own: of a MB of lists in a list of a long name these were half a GB."""
    read, cell = list[object](), records._cell
    monkeypatch.setattr(records, "_cell", lambda value: read.append(value) or cell(value))
    (folder / "a.json").write_text(json.dumps([{"n" * 900: [[1] * 500] * 900}]))
    with pytest.raises(calib.MeasurementError, match=r"^a.json: has more than 1000 columns\.$"):
        read_sheet("a.json")
    assert len(read) == 1001


def test_long_headers_of_arrays_are_not_taken_apart(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some thousands of these, of 10,000 characters each, are an archive of 1 MB, and took more than 14 s."""
    np.savez(folder / "m.npz", q=np.arange(10.0).reshape(5, 2))
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (" + b"1," * 4500 + b"), }\n"
    with zipfile.ZipFile(folder / "m.npz", "a") as archive:
        archive.writestr("odd.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
    taken, literal = list[int](), ast.literal_eval
    monkeypatch.setattr(ast, "literal_eval", lambda text: taken.append(len(text)) or literal(text))
    found = read_sheet("m.npz")
    assert (found.titles, len(found.rows)) == (("q_0", "q_1"), 5)
    assert found.remarks == ("'odd' is no array of numbers or words with 5 rows, and left out",)
    assert [length <= 1000 for length in taken] == [True]


def test_words_of_arrays_are_of_characters(folder: Path) -> None:
    words = np.array(["ab", "cd"])
    codes = np.frombuffer(b"\xff" * 16, dtype="<U2")  # which has no characters
    np.savez(folder / "m.npz", own=words.astype(">U2"), codes=codes, none=np.array(["", ""]))
    found = read_sheet("m.npz")
    assert (found.titles, found.rows) == (("own", "none"), (("ab", ""), ("cd", "")))
    assert found.remarks == ("'codes' is no array of numbers or words with 2 rows, and left out",)


def test_what_unpacks_to_too_much_is_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("openpyxl")
    np.savez(folder / "m.npz", q=np.zeros((5, 3)))
    with zipfile.ZipFile(folder / "m.xlsx", "w") as made:
        made.writestr("xl/worksheets/sheet1.xml", bytes(100))
    for name, module in (("m.npz", arrays), ("m.xlsx", workbook)):
        monkeypatch.setattr(module, "_LARGEST", 99)
        with pytest.raises(calib.MeasurementError, match=rf"^{name}: unpacks to more than 99 bytes\.$"):
            read_sheet(name)


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="CALIB_DATASETS names no folder with peoples_files")
@pytest.mark.parametrize(
    ("joints", "points"),
    [("irb120_joints.txt", "irb120_smr.txt"), ("irb120_measured_joints.txt", "irb120_measured_smr.txt")],
)
def test_published_joints_and_points(folder: Path, joints: str, points: str) -> None:
    """An IRB 120 and a FARO tracker, in degrees and millimetres."""
    (folder / "m.csv").write_text(joined(read_sheet(PUBLISHED / joints), read_sheet(PUBLISHED / points)).csv())
    found = calib.measuring.propose(PUBLISHED / "irb120.urdf", [folder / "m.csv"])
    assert not found.questions, found.questions
    assert found.tables[0].columns.names["x [mm]"] == "column 7"
    assert found.tables[0].columns.names["joint_1 [deg]"] == "column 1"


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="CALIB_DATASETS names no folder with peoples_files")
def test_a_published_program_and_points_beside_those_that_were_meant(folder: Path) -> None:
    """A ROKAE robot: joint targets in braces; nominal poses, measured poses and their distance, without a header."""
    units = "alpha [deg], a [mm], d [mm], theta [deg]\n"
    (folder / "dh.csv").write_text(units + (PUBLISHED / "rokae_dh.csv").read_text().partition("\n")[2])
    assert run("dh", "dh.csv", "-o", "arm.urdf", "--convention", "modified", "-q") == (0, "", "")
    (folder / "m.csv").write_text(
        joined(read_sheet(PUBLISHED / "rokae_joints.csv"), read_sheet(PUBLISHED / "rokae_points.csv")).csv()
    )
    (asked,) = calib.measuring.propose("arm.urdf", ["m.csv"]).questions
    assert asked.choices == ("'x=column 2'", "'x=column 8'")
    found = calib.measuring.propose("arm.urdf", ["m.csv"], columns={"x": "column 8"})
    assert not found.questions, found.questions
    names = found.tables[0].columns.names
    assert (names["joint_6 [deg]"], names["z [mm]"], names["rz [deg]"]) == ("j_5", "column 10", "column 13")


def test_files_of_which_each_is_one_target(folder: Path) -> None:
    """As people record a ball in printed sockets: joint angles alone, a file a socket."""
    for name, rows in (("hole_0", 3), ("hole_1", 2)):
        (folder / f"{name}.csv").write_text("".join(f"{k}.5,0.1,-0.2\n" for k in range(rows)))
    said = run("import", "hole_0.csv", "hole_1.csv", "--stack", "target", "-o", "touched.csv")
    assert (said.code, said.err) == (0, "")
    assert "2 files one below the other; 'target' is the name of each." in said.out
    lines = (folder / "touched.csv").read_text().splitlines()
    assert lines[0] == "column 1,column 2,column 3,target"
    assert lines[1:] == [*(f"{k}.5,0.1,-0.2,hole_0" for k in range(3)), *(f"{k}.5,0.1,-0.2,hole_1" for k in range(2))]


def test_files_of_one_name_are_called_by_their_folders(folder: Path) -> None:
    """As a ball in two printed sockets is recorded at several places."""
    files = [f"{place}/hole_{k}.csv" for place in ("left", "far/right") for k in range(2)]
    for k, name in enumerate(files):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"# j1,j2,j3\n{k}.5,0.1,-0.2\n")
    assert run("import", *files, "--stack", "target", "-o", "touched.csv").code == 0
    rows = [line.split(",") for line in (folder / "touched.csv").read_text().splitlines()[1:]]
    names = ["left/hole_0", "left/hole_1", "right/hole_0", "right/hole_1"]
    assert [(row[0], row[3]) for row in rows] == [(f"{k}.5", name) for k, name in enumerate(names)]


def test_names_of_several_lines_are_of_one(folder: Path) -> None:
    """Titles and files' names with a line end made a table that nothing could read again."""
    records = [{"joint_1\n[deg]": 1.5, "x [mm]": k, "tool": "a\nb"} for k in (1, 2)]
    (folder / "records.json").write_text(json.dumps(records), encoding="utf-8")
    assert run("import", "records.json", "-o", "records.csv").code == 0
    assert read_table(folder / "records.csv").columns.keys() == {"joint_1", "x", "tool"}
    for name in ("a\nhole", "b\u2028hole"):
        (folder / f"{name}.csv").write_text("j [deg],x [mm]\n0.5,1\n")
    assert run("import", "a\nhole.csv", "b\u2028hole.csv", "--stack", "target", "-o", "touched.csv").code == 0
    assert read_table(folder / "touched.csv").columns["target"].values == ("a hole", "b hole")


@pytest.mark.parametrize(
    ("second", "title", "sentence"),
    [
        ("1,2\n3,4\n", "target", "hole_0.csv, b.csv: have other columns, 'column 1', 'column 2', 'column 3' and"),
        ("1,2,3\n3,4,5\n", "column 2", "hole_0.csv: has a column 'column 2' already."),
        (None, "target", "hole_0.csv: another file is called 'hole_0' too; give each its own name."),
        ("# j1,j2,j3\n", "target", "b.csv: has comments, and no rows."),
    ],
)
def test_files_that_cannot_stand_below_each_other(folder: Path, second: str | None, title: str, sentence: str) -> None:
    (folder / "hole_0.csv").write_text("1,2,3\n4,5,6\n")
    name = "hole_0.txt" if second is None else "b.csv"
    (folder / name).write_text(second or "1,2,3\n4,5,6\n")
    said = run("import", "hole_0.csv", name, "--stack", title, "-o", "out.csv")
    assert (said.code, said.out) == (1, "")
    assert sentence in said.err
    assert not (folder / "out.csv").exists()
    both = run("import", "hole_0.csv", name, "--stack", title, "--by", "order", "-o", "out.csv")
    assert both.code == 2


def test_cells_of_a_workbook_that_go_back_are_refused(folder: Path) -> None:
    """openpyxl leaves them out without a word."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (("x [mm]", "y [mm]", "z [mm]"), (1, 2, 3)):
        book.active.append(row)
    book.save(folder / "whole.xlsx")
    with zipfile.ZipFile(folder / "whole.xlsx") as whole, zipfile.ZipFile(folder / "a.xlsx", "w") as archive:
        for name in whole.namelist():
            archive.writestr(name, whole.read(name).replace(b'r="C2"', b'r="A2"'))
    said = run("import", "a.xlsx", "-o", "out.csv")
    assert said.code == 1
    assert "a cell of column A stands behind one of column B in row 2; save the workbook again." in said.err
    assert run("import", "whole.xlsx", "-o", "out.csv").code == 0


def changed_workbook(path: Path, change: Callable[[str, bytes], tuple[str, bytes]]) -> None:
    """Write a workbook of a text and two numbers, with its parts and their names changed."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (("x [mm]", "y [mm]"), (1, 2), (3, 4)):
        book.active.append(row)
    book.save(made := io.BytesIO())
    with zipfile.ZipFile(made) as whole, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in whole.namelist():
            archive.writestr(*change(name, whole.read(name).replace(b" />", b"/>")))


@pytest.mark.parametrize("old", [b"<f>", b"<x:f>", b"<f t='shared'>"])
@pytest.mark.parametrize("place", ["xl/worksheets/sheet1.xml", "xl/tables/one.xml"])
def test_formulas_and_the_order_of_cells_are_looked_at_wherever_a_sheet_is(
    folder: Path, place: str, old: bytes
) -> None:
    end = b"</x:f>" if b"x:" in old else b"</f>"
    own = old.replace(b"x:f", b'x:f xmlns:x="http://schemas.openxmlformats.org/spreadsheetml/2006/main"')

    def moved(name: str, part: bytes, cell: bytes, new: bytes) -> tuple[str, bytes]:
        usual = "xl/worksheets/sheet1.xml"
        return place if name == usual else name, part.replace(usual.encode(), place.encode()).replace(cell, new)

    changed_workbook(folder / "a.xlsx", partial(moved, cell=b"<v>3</v>", new=own + b"1+1" + end))
    assert "cell A3 has a formula that was never computed" in run("import", "a.xlsx", "-o", "out.csv").err
    changed_workbook(folder / "a.xlsx", partial(moved, cell=b'r="B3"', new=b'r="A3"'))
    assert "a cell of column A stands behind one of column A in row 3" in run("import", "a.xlsx", "-o", "out.csv").err


def test_one_long_text_in_all_cells_of_a_workbook_is_cut_first() -> None:
    text, begun = "a " * 1_000_000, time.process_time()
    assert {workbook._cell(text) for _ in range(300)} == {"a " * 100}
    assert time.process_time() - begun < 2.0


def test_names_of_cells_in_a_workbook_are_not_taken_apart(folder: Path) -> None:
    """openpyxl looks for areas to print by an expression that takes a time without end."""
    names = b'<definedNames><definedName name="_xlnm.Print_Area" localSheetId="0">%s</definedName></definedNames>'
    quotes = names % (b"'" * 20_000) + b"</workbook>"
    changed_workbook(
        folder / "a.xlsx",
        lambda name, part: (name, part.replace(b"<definedNames/>", b"").replace(b"</workbook>", quotes)),
    )
    begun = time.process_time()
    assert len(read_sheet("a.xlsx").rows) == 2
    assert time.process_time() - begun < 5.0


def test_sheets_of_a_workbook_that_are_one_part_are_refused(folder: Path) -> None:
    more = b"".join(b'<sheet name="a%d" sheetId="1" r:id="rId1" />' % k for k in range(3))
    xmlns = b'<sheets xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/relationships">'
    changed_workbook(
        folder / "a.xlsx",
        lambda name, part: (name, part.replace(b"<sheets>", xmlns).replace(b"</sheets>", more + b"</sheets>")),
    )
    with pytest.raises(calib.MeasurementError, match="has several sheets that are one part of the file"):
        read_sheet("a.xlsx")


@pytest.mark.parametrize("sign", [b"[", b"&#91;"])
def test_formats_of_numbers_that_take_long_are_refused(folder: Path, sign: bytes) -> None:
    code = b'<numFmts><numFmt numFmtId="200" formatCode="%s"/></numFmts>' % (sign * 100_000)
    changed_workbook(folder / "a.xlsx", lambda name, part: (name, part.replace(b'<numFmts count="0"/>', code)))
    with pytest.raises(calib.MeasurementError, match="has formats of numbers that are too long"):
        read_sheet("a.xlsx")


@pytest.mark.parametrize(
    ("number", "says"),
    [
        (b"2", "row 2 stands behind row 2; rows are numbered upwards, to 1048576. Save the workbook again."),
        (
            b"999999999",
            "row 999999999 stands behind row 2; rows are numbered upwards, to 1048576. Save the workbook again",
        ),
    ],
)
def test_rows_of_a_workbook_that_do_not_follow_each_other_are_refused(folder: Path, number: bytes, says: str) -> None:
    """openpyxl leaves out rows that go back, and gives every row before one, be it there or not."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (("x [mm]",), (1,), (2,)):
        book.active.append(row)
    book.save(folder / "whole.xlsx")
    with zipfile.ZipFile(folder / "whole.xlsx") as whole, zipfile.ZipFile(folder / "a.xlsx", "w") as archive:
        for name in whole.namelist():
            part = whole.read(name)
            archive.writestr(
                name, part.replace(b'<row r="3"', b'<row r="%s"' % number).replace(b'"A3"', b'"A%s"' % number)
            )
    with pytest.raises(calib.MeasurementError, match=f"^a.xlsx: {says}"):
        read_sheet("a.xlsx")


def test_the_cells_of_many_files_are_looked_at_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each file is joined to all before it: 2000 of them, 420 kB in all, took 12 s of processor time."""
    looked: list[str] = []
    original = sheet_.is_number

    def is_number(cell: str, decimal: str) -> bool:
        looked.append(cell)
        return original(cell, decimal)

    sheets = []
    for k in range(30):
        rows = "".join(f"P{j}, {j}\n" for j in range(20))
        (folder / f"{k}.csv").write_text(f"name, a{k}\n{rows}", encoding="utf-8")
        sheets.append(read_sheet(folder / f"{k}.csv"))
    sheet_._name.cache_clear()
    monkeypatch.setattr(sheet_, "is_number", is_number)
    whole = reduce(joined, sheets)
    assert (len(whole.rows), len(whole.titles)) == (20, 31)
    assert sorted(looked) == sorted({cell for row in sheets[0].rows for cell in row})
