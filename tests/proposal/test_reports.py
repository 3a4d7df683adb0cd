"""Files of programs whose numbers are no table: what they are is said, and what to do; and layouts that are read."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import calib
from calib.measurement.formats.sheet import read_sheet
from calib.measurement.raw import raw_table
from tests.support.cases import run
from tests.support.people import UR10, session, text

JOB = "/JOB\r\n//NAME CALIB\r\n//POS\r\n///NPOS 2,0,0,0,0,0\r\n///TOOL 0\r\n///POSTYPE {}\r\n///{}\r\n{}END\r\n"
POSITIONS = "C00000=-1094,2014,-3127,42,5,6\r\nC00001=94,1014,-2127,420,5,6\r\n"
DIMENSION = (
    "DIM LOC{0}= LOCATION OF POINT PNT{0}  UNITS=MM ,$\nGRAPH=OFF  TEXT=OFF  MULT=10.00\n"
    "AX    NOMINAL       +TOL       -TOL       MEAS        DEV     OUTTOL\n"
    "X     12.0000     0.0500     0.0500    12.0101     0.0101     0.0000 ----#----\n"
    "Y     22.0000     0.0500     0.0500    22.0101     0.0101     0.0000 ----#----\n"
    "Z     32.0000     0.0500     0.0500    32.0101     0.0101     0.0000 ----#----\n"
    "END OF DIMENSION LOC{0}\n"
)
POLYWORKS = "PolyWorks|Inspector\n\nName\tControl\tNom\tMeas\tTol\tDev\tTest\tOut Tol\n" + "".join(
    f"point {k}\t{axis}\t1.5\t1.6\t\u00b10.1\t0.1\tPass\t\n" for k in (1, 2) for axis in "XYZ"
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "contents", "said"),
    [
        ("a.jbi", JOB.format("PULSE", "PULSE", POSITIONS), "job of Yaskawa, whose positions are pulses of the motors;"),
        ("a.jbi", JOB.format("ROBOT", "RECTAN", POSITIONS), "job of Yaskawa, whose positions are places of the tool"),
        (
            "a.txt",
            "PART NAME : ARM\n\n" + DIMENSION.format(1) + DIMENSION.format(2),
            "; if this is a report with a line for each",
        ),
        ("a.txt", POLYWORKS, "each coordinate of a point, as of PC-DMIS and PolyWorks (from line 4 on), export the"),
    ],
    ids=["pulses", "places", "PC-DMIS", "PolyWorks"],
)
def test_what_is_no_table_says_what_it_is_and_what_to_do(folder: Path, name: str, contents: str, said: str) -> None:
    (folder / name).write_text(contents, newline="")
    for read in (read_sheet, lambda path: raw_table(Path(path).read_bytes(), path)):
        with pytest.raises(calib.MeasurementError) as refused:
            read(name)
        assert said in str(refused.value)


def test_a_table_of_two_lines_of_coordinates_is_no_report(folder: Path) -> None:
    (folder / "a.csv").write_text("axis,value\nX,1\nY,2\nZ,3\nX,1\nY,2\nZ,3\n")
    assert len(read_sheet("a.csv").rows) == 6
    (folder / "joints.csv").write_text("J1,J2\n1,2\n3,4\n")
    said = run("import", "joints.csv", "a.csv", "-o", "b.csv")
    assert "rows belong together; a.csv has a row for each of X, Y and Z, and none for each point." in said.err


def test_a_wrong_row_of_a_table_of_coordinates_is_named(folder: Path) -> None:
    (folder / "a.csv").write_text("point,axis,value\n1,X,1\n1,Y,2\n1,Z\n" + "2,X,1\n2,Y,2\n2,Z,3\n" * 2)
    for read in (read_sheet, lambda path: raw_table(Path(path).read_bytes(), path)):
        with pytest.raises(calib.MeasurementError, match=r"^a\.csv:4: the header has 3 cells and this row has 2; if "):
            read("a.csv")


def test_a_packed_program_of_universal_robots_names_its_script(folder: Path) -> None:
    (folder / "poses.urp").write_bytes(gzip.compress(b"<URProgram/>"))
    with pytest.raises(calib.MeasurementError, match=r"saves it as poses\.script as well"):
        read_sheet("poses.urp")


@pytest.mark.parametrize(
    ("contents", "said"),
    [
        (b"\x02\x50" + bytes(600), "is C3D of motion capture"),
        (b"TDSm\x0e" + bytes(60), "is TDMS of LabVIEW"),
        (b"ARROW1" + bytes(60), "is Arrow"),
        (b"SQLite format 3" + bytes(60), "is a data base"),
        (b"%PDF-1.4\n1 0 obj\n<<>>\nendobj\n", "is PDF"),
    ],
    ids=["C3D", "TDMS", "Arrow", "SQLite", "PDF"],
)
def test_files_of_no_text_say_what_they_are(folder: Path, contents: bytes, said: str) -> None:
    (folder / "a.dat").write_bytes(contents)
    with pytest.raises(calib.MeasurementError, match=said):
        read_sheet("a.dat")


def test_a_minus_of_typesetters_is_one(folder: Path) -> None:
    """Programs write it before numbers in Swedish, Norwegian and Finnish settings."""
    s = session()
    columns = [np.degrees(s.readings), 1e3 * s.position]
    written = text([*(f"J{k}" for k in range(1, 7)), "X\u2212a", "Y\u2212a", "Z\u2212a"], columns, ";", comma=True)
    (folder / "a.csv").write_text(written.replace("-", "\u2212"))
    sheet = read_sheet("a.csv")
    assert sheet.titles[-1] == "Z\u2212a"
    assert np.allclose([float(row[0]) for row in sheet.rows], np.degrees(s.readings[:, 0]), atol=1e-6)
    assert not calib.measuring.propose(UR10, ["a.csv"]).questions


def test_numbers_that_numpy_prints_with_their_kind_are_numbers(folder: Path) -> None:
    q = ", ".join(f"np.float64({k}.5)" for k in range(6))
    (folder / "a.csv").write_text(f'joints,n\n"[{q}]",1\n"[{q}]",2\n')
    assert read_sheet("a.csv").rows[0] == ("0.5", "1.5", "2.5", "3.5", "4.5", "5.5", "1")
    (folder / "b.txt").write_text(f"q=[{q}] p=[np.float32(1e-05), np.int64(-2), np.float64(nan)]\n" * 2)
    assert read_sheet("b.txt").rows[0][:8] == ("0.5", "1.5", "2.5", "3.5", "4.5", "5.5", "1e-05", "-2")


def test_a_table_without_a_number_is_none(folder: Path) -> None:
    """The first line of such a log was its header, and the rows were words."""
    (folder / "a.txt").write_text("".join(f"[{k}] J1: 0.5 rad, J2: 2 rad | X: 1.5 m, Y: {k} m\n" for k in range(4)))
    said = run("import", "a.txt", "-o", "b.csv")
    assert said.code == 1 and not (folder / "b.csv").exists()
    assert "no cell is a number, and the first one is '[1] J1: 0.5 rad" in said.err


def test_a_table_of_words_names_rows_of_another_one(folder: Path) -> None:
    (folder / "points.csv").write_text("name,x [mm]\nP1,1\nP2,2\n")
    (folder / "sockets.csv").write_text("name,socket\nP2,left\nP1,right\n")
    assert run("import", "points.csv", "sockets.csv", "-o", "b.csv").code == 0
    assert (folder / "b.csv").read_text() == "name,x [mm],socket\nP1,1,right\nP2,2,left\n"


def test_waypoints_of_two_kinds_are_told_apart_by_words_that_the_message_names(folder: Path) -> None:
    """The controller writes a place and the joints of each waypoint, whose names have one word."""
    s = session()
    lines = ["def poses():", "  set_tcp(p[0.0,0.0,0.1,0.0,0.0,0.0])"]
    for k, (q, p) in enumerate(zip(s.readings, s.position, strict=True)):
        lines.append(f"  global Waypoint_{k}_p=p[{', '.join(f'{x:.9f}' for x in p)}, .1, .2, .3]")
        lines.append(f"  global Waypoint_{k}_q=[{', '.join(f'{x:.9f}' for x in q)}]")
    (folder / "a.script").write_text("\n".join([*lines, "end", ""]))
    with pytest.raises(calib.MeasurementError, match=r"\(line 4, topic q\)"):
        read_sheet("a.script")
    found = np.array([row[1:] for row in read_sheet("a.script", "q").rows], dtype=float)
    assert np.allclose(found, s.readings, atol=1e-8)
    with pytest.raises(calib.MeasurementError, match=r"line 2, topic set_tcp\)"):
        read_sheet("a.script", "p")


def test_a_struct_of_matlab_is_named(folder: Path) -> None:
    savemat(folder / "a.mat", {"data": {"q": np.ones((5, 6)), "p": np.ones((5, 3))}})
    with pytest.raises(calib.MeasurementError, match=r"writetable\(struct2table\(data\), 'data\.csv'\)"):
        read_sheet("a.mat")
    # Neither a rate nor the matrix of a camera is what was measured.
    for beside in ({"fs": 100.0}, {"K": np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])}):
        savemat(folder / "a.mat", {"data": {"q": np.ones((5, 6))}, **beside})
        with pytest.raises(calib.MeasurementError, match="'data' is a struct of MATLAB, and not read"):
            read_sheet("a.mat")


def test_arrays_with_a_column_for_every_measurement_are_turned(folder: Path) -> None:
    s = session()
    savemat(folder / "a.mat", {"q": s.readings.T, "p": 1e3 * s.position.T, "n": np.arange(6.0)})
    said = run("import", "a.mat", "-o", "a.csv")
    assert "the columns of 'q', 'p' are the rows." in said.out
    assert not calib.measuring.propose(UR10, ["a.csv"]).questions
    np.savez(folder / "b.npz", t=np.arange(len(s.readings)), q=s.readings.T)
    assert len(read_sheet("b.npz").rows) == len(s.readings)
    # As many rows as columns, or as many arrays that have these rows: nothing is turned.
    np.savez(folder / "c.npz", q=np.arange(36.0).reshape(6, 6), p=np.arange(18.0).reshape(3, 6))
    assert len(read_sheet("c.npz").rows) == 6
    np.savez(folder / "d.npz", a=np.ones((20, 30)), b=np.ones((20, 30)))
    assert len(read_sheet("d.npz").rows) == 20
    # Limits and offsets of joints are none of what was measured.
    np.savez(folder / "e.npz", q=s.readings, p=s.position, limits=np.ones((2, 6)), home=np.ones(6), offset=np.ones(6))
    assert read_sheet("e.npz").titles == (*(f"q_{k}" for k in range(6)), "p_x", "p_y", "p_z")
    # Each of two runs has fewer rows than columns.
    np.savez(folder / "f.npz", first=np.ones((8, 9)), second=np.ones((5, 9)))
    assert len(read_sheet("f.npz").rows) == 8


@pytest.mark.parametrize("separator", [" ", ";"])
def test_names_of_rows_that_r_writes_have_no_title(folder: Path, separator: str) -> None:
    s = session()
    titles = [f'"J{k}"' for k in range(1, 7)] + ['"x"', '"y"', '"z"']
    names = np.array([f'"{k + 1}"' for k in range(len(s.readings))])
    columns = [names, np.degrees(s.readings), 1e3 * s.position]
    head, *rows = text(["", *titles], columns, separator, comma=separator == ";").splitlines()
    (folder / "a.csv").write_text("\n".join([head.removeprefix(separator), *rows]) + "\n")
    sheet = read_sheet("a.csv")
    assert sheet.titles == ("column 1", *(title.strip('"') for title in titles))
    assert np.allclose(np.array([row[1] for row in sheet.rows], dtype=float), np.degrees(s.readings[:, 0]), atol=1e-6)
    assert not calib.measuring.propose(UR10, ["a.csv"]).questions
    # What is not quoted may as well lack another title.
    (folder / "b.csv").write_text("\n".join([head.removeprefix(separator), *rows]).replace('"', "") + "\n")
    with pytest.raises(calib.MeasurementError, match=r"9 cells and this row has 10; a title is missing, which R "):
        read_sheet("b.csv")


def test_a_title_that_is_missing_behind_quoted_ones_shifts_no_column(folder: Path) -> None:
    """Names, and numbers below a title that says so, are of points: which title is missing, nothing tells."""
    said = r"a\.csv:2: .* 9 cells and this row has 10; a title is missing, which"
    for first, names in (("Point", "P{}"), ("Point", "{}"), ("J0", "P{}")):
        head = ",".join(f'"{title}"' for title in (first, "J1", "J2", "J3", "J4", "J5", "J6", "x", "y"))
        rows = [",".join([f'"{names.format(k)}"', *(f"{k + j / 7:.4f}" for j in range(9))]) for k in range(1, 9)]
        (folder / "a.csv").write_text("\n".join([head, *rows, ""]))
        for read in (read_sheet, lambda path: raw_table(Path(path).read_bytes(), path)):
            with pytest.raises(calib.MeasurementError, match=said):
                read("a.csv")
    # A column of R that numbers the rows as well, and rows in another order.
    rows = [f'"{k}",{k},' + ",".join(f"{k + j / 7:.4f}" for j in range(8)) for k in (3, 1, 2)]
    (folder / "a.csv").write_text("\n".join([head.replace("J0", "id"), *rows, ""]))
    assert read_sheet("a.csv").titles[:3] == ("column 1", "id", "J1")


@pytest.mark.parametrize("row", ['"{0}","{0}","ok",', '"{0}","{0}","{0}","ok"', '"a",{0},{0},"ok"'])
def test_quoted_cells_are_no_names_of_rows(folder: Path, row: str) -> None:
    """A separator at the end of each row, or a title that is missing elsewhere: R does not write these."""
    (folder / "a.csv").write_text("\n".join(['"J1","x","note"', *(row.format(k) for k in range(3))]) + "\n")
    with pytest.raises(calib.MeasurementError, match="the header has 3 cells and this row has 4"):
        read_sheet("a.csv")


def test_the_number_in_a_title_is_no_unit_beside_a_line_of_units(folder: Path) -> None:
    (folder / "a.csv").write_text("position[0],position[1],x\ndeg,deg,mm\n1,2,3\n4,5,6\n")
    assert read_sheet("a.csv").titles == ("position[0] [deg]", "position[1] [deg]", "x [mm]")
