"""Files that other programs write, and people type: what their tables have above, below and between the numbers."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.arrays import Array
from calib.measurement.formats.sheet import read_sheet
from tests.support.cases import run
from tests.support.people import UR10, session, text

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
