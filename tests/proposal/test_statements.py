"""Joints in brackets, as controllers' programs, logs and prints of lists have them, and a tracker's points apart."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.foundations.arrays import Array
from calib.measurement.formats.sheet import Sheet, read_sheet
from calib.measurement.raw import raw_table
from tests.support.cases import run
from tests.support.people import UR10, session, text


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def made(folder: Path, contents: str, part: str | None = None) -> Sheet:
    (folder / "a.txt").write_text(contents)
    return read_sheet("a.txt", part)


def row(values: Array, separator: str = ",") -> str:
    return separator.join(f"{value:.6f}" for value in values)


def rapid(q: Array) -> str:
    none = ",".join(["9E+09"] * 6)
    lines = [f"  CONST jointtarget p{k}:=[[{row(one)}],[{none}]];" for k, one in enumerate(q)]
    return (
        "MODULE Points\n  ! [[0,0,0],[0,0,0]] is home\n" + "\n".join(lines) + "\n  PROC main()\n  ENDPROC\nENDMODULE\n"
    )


def krl(q: Array) -> str:
    axes = (",".join(f"A{n} {value:.6f}" for n, value in enumerate(one, start=1)) for one in q)
    lines = [f"DECL E6AXIS XP{k}={{{one},E1 0.0,E2 0.0}}" for k, one in enumerate(axes)]
    return "DEFDAT POINTS\n;FOLD {A1 0, A2 0, A3 0}\n" + "\n".join(lines) + "\nENDDAT\n"


def fanuc(q: Array) -> str:
    def point(k: int, one: Array) -> str:
        parts = [f"J{n}={value:12.6f} deg" for n, value in enumerate(one, start=1)]
        comment = ':"above (the) part"' if k % 3 == 1 else ""
        halves = ",\n\t".join((",\t".join(parts[:3]), ",\t".join(parts[3:])))
        return f"P[{k}{comment}]{{\n   GP1:\n\tUF : 0, UT : 1,\n\t{halves}\n}};\n"

    return "/PROG POINTS\n/MN\n   1:J P[0] 100% FINE ;\n/POS\n" + "".join(map(point, range(len(q)), q)) + "/END\n"


def rokae(q: Array) -> str:
    lines = (f"LOCAL VAR jointtarget j{k} = j:{{{row(one)}\t ,0\t}}\t{{EJ 0,0,0,0,0,0}}" for k, one in enumerate(q))
    return "\n".join(lines)


def script(q: Array) -> str:
    return (
        "def program():\n" + "".join(f"  movej([{row(np.radians(one), ', ')}], a=1.4, v=1.05)\n" for one in q) + "end\n"
    )


def log(q: Array) -> str:
    return "".join(f"[INFO] [17.{k:03d}] pose {k}: q=[{row(np.radians(one), ', ')}]\n" for k, one in enumerate(q))


def literal(q: Array) -> str:
    return "import numpy as np\n\njoints = np.array([\n" + "".join(f"    [{row(one)}],\n" for one in q) + "])\n"


def printed(q: Array) -> str:
    return "joints:\n" + np.array2string(q, threshold=10**6, max_line_width=60) + "\n"


def cells(q: Array) -> str:
    return "nr,joints\n" + "".join(f'{k},"[{row(one, " ")}]"\n' for k, one in enumerate(q))


@pytest.mark.parametrize("written", [rapid, krl, fanuc, rokae, script, log, literal, printed, cells])
def test_joints_in_brackets_and_points_of_a_tracker_become_a_job(folder: Path, written: Callable[[Array], str]) -> None:
    seen = session()
    q = np.degrees(seen.readings)
    (folder / "joints.txt").write_text(written(q))
    (folder / "points.csv").write_text(text(["X", "Y", "Z"], [1e3 * seen.position]))
    said = run("check", UR10, "joints.txt")
    assert said.code == 1
    assert said.err == (
        "Error: joints.txt: has lists of numbers in brackets; calib import joints.txt -o table.csv makes a table of "
        "them.\n"
    )
    assert (said := run("import", "joints.txt", "points.csv", "-o", "m.csv")).code == 0, said.err
    found = calib.measuring.propose(UR10, ["m.csv"])
    assert not found.questions, found.questions
    names = found.tables[0].columns.names
    unit = "rad" if written in (script, log) else "deg"
    joints = [names[f"{reading.name} [{unit}]"] for reading in found.robot.readings]
    sheet = read_sheet("m.csv")
    numbers = np.array([[float(one[sheet.titles.index(title)]) for title in joints] for one in sheet.rows])
    np.testing.assert_allclose(np.degrees(numbers) if unit == "rad" else numbers, q, atol=1e-4)
    assert names["x [mm]"] == "X"


def test_titles_are_the_words_before_numbers(folder: Path) -> None:
    sheet = made(
        folder, "[W] P1: q=[1, -2.5, .3], p=(4, 5, 6) t=7 deg\n[W] P2: q=[1e1, -2.5, 3.], p=(4, 5, 6) t=8 deg\n"
    )
    assert sheet.titles == ("name", "q_0", "q_1", "q_2", "p_x", "p_y", "p_z", "t [deg]")
    assert sheet.rows == (
        ("P1", "1", "-2.5", ".3", "4", "5", "6", "7"),
        ("P2", "1e1", "-2.5", "3.", "4", "5", "6", "8"),
    )
    assert sheet.remarks == ("2 rows as '[ W ] P1 : q = [ 1 , -2.5 ,' (line 1)",)
    assert made(folder, "q=[1 deg, 2 deg, 3 deg]\n" * 2).titles == ("q_0 [deg]", "q_1 [deg]", "q_2 [deg]")
    sheet = made(folder, "begin\nP1 [1, 2, 3]\nP2 [1, 2]\nP3 [1, 2, 3]\n")
    assert sheet.remarks == ("2 rows as 'P1 [ 1 , 2 , 3 ]' (line 2)", "2 other lines are passed over")


def test_what_was_measured_and_what_was_meant_are_two_kinds(folder: Path) -> None:
    lines = "".join(f"target [1, 2, {k}]\nactual [1.1, 2.1, {k}.1]\n" for k in range(3))
    with pytest.raises(calib.MeasurementError) as caught:
        made(folder, lines)
    assert str(caught.value) == (
        "a.txt: has several kinds of lines with numbers in brackets: 3 rows as 'target [ 1 , 2 , 0 ]' (line 1, topic "
        "target); 3 rows as 'actual [ 1.1 , 2.1 , 0.1 ]' (line 2, topic actual); say by topic which are "
        "meant, a word that the others do not have, or keep only these."
    )
    assert [one[2] for one in made(folder, lines, "actual").rows] == ["0.1", "1.1", "2.1"]
    assert run("import", "a.txt", "--topic", "actual", "-o", "b.csv").code == 0
    with pytest.raises(
        calib.MeasurementError, match=r"^a.txt: no line with numbers in brackets has the word 'other'\.$"
    ):
        made(folder, lines, "other")


def test_lists_of_a_program_are_told_apart_by_their_names(folder: Path) -> None:
    program = 'data = {\n"q": [[1, 2, 3, 4], [2, 3, 4, 5], [3, 4, 5, 6]],\n"p": [[1, 2, 3], [4, 5, 6], [7, 8, 9]]}\n'
    with pytest.raises(calib.MeasurementError, match="several kinds of lines"):
        made(folder, program)
    assert made(folder, program, "q").titles == ("q_0", "q_1", "q_2", "q_3")
    assert made(folder, program, "p").rows[2] == ("7", "8", "9")
    alike = program.replace(", 4]", "]").replace(", 5]", "]").replace("5, 6]]", "5]]")
    with pytest.raises(calib.MeasurementError, match="several kinds of lines"):
        made(folder, alike)
    assert made(folder, alike, "p").rows[2] == ("7", "8", "9")


@pytest.mark.parametrize(
    ("contents", "says"),
    [
        ("a [1, 2, 3]\nb [1, 2, 3\nc [1, 2, 3]\n", "a.txt:2: a bracket [ is opened and not closed."),
        ("a1 [1, 2, 3]\na2 [1, 2]\na3 [1, 2, 3, 4]\n", "several kinds of lines"),
        ("a1 [1, 2, 3]\n" + "a2 " + "[" * 17 + "1, 2, 3" + "]" * 17, "a.txt:2: has brackets in more than 16 others."),
        ("n;q\n1;[1 2 3]\n2;[1 2]\n3;[4 5 6]\n", "a.txt: row 2 has 2 numbers in 'q', and others have 3."),
    ],
)
def test_a_number_that_is_missing_is_said(folder: Path, contents: str, says: str) -> None:
    with pytest.raises(calib.MeasurementError) as caught:
        made(folder, contents)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("line", "titles"),
    [
        ("DECL E6AXIS XP{0}={{A1 {0}.5,A2 -41.4,A3 8.6}}", ("name", "A1", "A2", "A3")),
        ("P[{0}]{{J1= {0}.5 deg, J2= -41.4 deg, J3= 8.6 deg}};", ("P", "J1 [deg]", "J2 [deg]", "J3 [deg]")),
        ("p{0} = dict(a={0}.5, b=-41.4, c=8.6)", ("name", "a", "b", "c")),
        ("P{0};[a {0}.5; b -41.4; c 8.6]", ("name", "a", "b", "c")),
    ],
)
def test_lines_of_a_program_alone_are_no_table(folder: Path, line: str, titles: tuple[str, ...]) -> None:
    """Numbers with words before them were torn apart, in silence, and the first line was taken for a header."""
    found = made(folder, "".join(f"{line.format(k)}\n" for k in range(5)))
    assert found.titles == titles
    assert [row[1] for row in found.rows] == [f"{k}.5" for k in range(5)]
    with pytest.raises(calib.MeasurementError, match=r"^a\.txt: has lists of numbers in brackets; calib import a\.txt"):
        raw_table(Path("a.txt").read_bytes(), "a.txt")


@pytest.mark.parametrize("mark", ["!", "#", "//", "%"])
def test_brackets_that_a_comment_opens_join_no_statements(folder: Path, mark: str) -> None:
    """Two statements became one in silence, and a point was lost."""
    lines = [f"p{k} = [{k}.5, -41.4, 8.6]" for k in range(6)]
    lines[1] += f"  {mark} left (of"
    lines[2] += f"  {mark} the table)"
    found = made(folder, "\n".join(lines))
    assert [row[1] for row in found.rows] == [f"{k}.5" for k in range(6)]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_a_program_is_read_in_each_encoding_of_a_table(folder: Path, encoding: str) -> None:
    """One that was written in Germany was refused: it was to be UTF-8."""
    lines = [f"DECL E6AXIS XP{k}={{A1 {k}.5,A2 -41.4,A3 8.6}}" for k in range(3)]
    (folder / "a.src").write_bytes("\r\n".join(["; Prüfprogramm für Müller", *lines, ""]).encode(encoding))
    found = read_sheet("a.src")
    assert (found.titles, found.rows[2]) == (("name", "A1", "A2", "A3"), ("XP2", "2.5", "-41.4", "8.6"))
    (folder / "a.src").write_bytes("\n".join([*lines, "; \x81 \xfc"]).encode("latin-1"))
    with pytest.raises(calib.MeasurementError, match=r"^a\.src:4: is not UTF-8 text; save it as UTF-8\.$"):
        read_sheet("a.src")


def test_a_table_with_brackets_in_notes_stays_a_table(folder: Path) -> None:
    sheet = made(
        folder, "n,x,note\n1,2.5,in the box (1, 2, 3)\n2,3.5,\n3,4.5,see [4 5 6] of (7 8 9)\n".replace(", ", " ")
    )
    assert sheet.titles == ("n", "x", "note")
    assert sheet.rows[0] == ("1", "2.5", "in the box (1 2 3)")


def test_cells_that_only_close_a_bracket_are_no_torn_lists(folder: Path) -> None:
    seen = session()
    names = [f"{k})" for k in range(40)]
    file = folder / "t.csv"
    file.write_text(text(["Nr", *(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"], [
        names, np.degrees(seen.readings), 1e3 * seen.position
    ]))  # fmt: skip
    found = calib.measuring.propose(UR10, [file])
    assert not found.questions, found.questions
    assert found.tables[0].columns.names["x [mm]"] == "X"
    assert made(folder, "nr,q\n1),[1 2 3]\n2),[1 2 4]\n").titles == ("nr", "q_0", "q_1", "q_2")


def test_numbers_beyond_floats_are_none_that_change(folder: Path) -> None:
    file = folder / "t.csv"
    file.write_text("q0,q1,q2,q3,q4,q5,q6,x,y,z\n" + "1e999,1,2,3,4,5,6,7,8,9\n" * 3)
    with pytest.raises(calib.CalibError):
        calib.measuring.propose(UR10, [file]).job()


@pytest.mark.parametrize(
    "contents",
    [
        "DECL E6AXIS XP1={A1 3,2173,A2 122,5959,A3 -96,8437}\nDECL E6AXIS XP2={A1 4,5,A2 12,75,A3 6,125}\n",
        "q=[3,2173; 122,5959; -96,8437]\nq=[4,5; 12,75; 6,125]\n",
        "q=[3,2173, 122,5959, -96,8437]\nq=[4,5, 12,75, 6,125]\n",
    ],
)
def test_decimal_commas_are_refused_and_no_decimals_are_lost(folder: Path, contents: str) -> None:
    with pytest.raises(
        calib.MeasurementError, match=r"^a\.txt:1: '3,2173' seems to have a decimal comma; write a point,"
    ):
        made(folder, contents)


@pytest.mark.parametrize(
    "contents",
    [
        "p=[3,21,122]\np=[4,5,12]\n",
        "p=[3, 2173; 122, 5959]\np=[4, 5; 12, 75]\n",
        "p [(320,240) (321,24) (32,24) (1 2 3)]\np [(32,24) (31,4) (3,2) (4 5 6)]\n",
        "p=[3,-4; 12,-5; 7,-8]\np=[3,-4; 12,-5; 7,-8]\n",
    ],
)
def test_whole_numbers_that_commas_part_stay_numbers(folder: Path, contents: str) -> None:
    assert len(made(folder, contents).rows) == 2


@pytest.mark.parametrize("form", ["q[{}] = {{{}}};", "q({},:) = [{}];", "q[{}] := ({})"])
def test_a_list_in_a_list_of_its_own_number_keeps_the_name(folder: Path, form: str) -> None:
    sheet = made(folder, "".join(form.format(k, row(np.array((k, 2.0, -3.0, 4.5)), ", ")) + "\n" for k in range(3)))
    assert sheet.titles == ("q", "q_0", "q_1", "q_2", "q_3")
    assert sheet.rows[2] == ("2", "2.000000", "2.000000", "-3.000000", "4.500000")


def test_numbers_that_are_called_otherwise_are_another_kind(folder: Path) -> None:
    """The one AXIS of a program became a row of its frames, which have as many numbers."""
    frames = "".join(f"DECL FRAME F{k}={{X {k}.5,Y 2.5,Z 3.5,A 4.5,B 5.5,C 6.5}}\n" for k in range(3))
    axis = "DECL AXIS H={A1 1.5,A2 2.5,A3 3.5,A4 4.5,A5 5.5,A6 6.5}\n"
    with pytest.raises(calib.MeasurementError, match=r"1 row as 'DECL AXIS .*topic AXIS\); 3 rows .*topic FRAME\)"):
        made(folder, axis + frames)
    assert made(folder, axis + frames, "AXIS").titles == ("A1", "A2", "A3", "A4", "A5", "A6")
    assert made(folder, axis + frames, "FRAME").titles == ("name", "X", "Y", "Z", "A", "B", "C")
    # Their numbers make no kinds.
    assert len(made(folder, "(x1=1, y1=2, z1=3)\n(x2=1, y2=2, z2=3)\n").rows) == 2


COMMENTED = {
    "krl": ("DECL AXIS P{0}={{A1 {0},A2 2.5,A3 3.5}}", " ; {}"),
    "rapid": ("CONST robtarget p{0}:=[[{0},2.5,3.5]];", " ! {}"),
    "python": ("p{0} = [{0}, 2.5, 3.5]", "  # {}"),
    "c": ("double p{0}[] = {{{0}, 2.5, 3.5}};", " // {}"),
    "matlab": ("p{0} = [{0}, 2.5, 3.5];", " % {}"),
}


@pytest.mark.parametrize("language", COMMENTED)
def test_comments_behind_statements_make_no_kinds(folder: Path, language: str) -> None:
    line, mark = COMMENTED[language]
    said = {2: "home", 4: "above the table (left), 300 mm", 5: "it's here"}
    lines = [line.format(k) + (mark.format(said[k]) if k in said else "") for k in range(8)]
    sheet = made(folder, "\n".join([*lines, ""]))
    assert [[float(cell) for cell in row[-3:]] for row in sheet.rows] == [[k, 2.5, 3.5] for k in range(8)]
    assert sheet.remarks[-1] == "3 comments are passed over, the first one in line 3"


def test_comments_in_a_list_tear_it_no_more(folder: Path) -> None:
    contents = "joints = np.array([\n [1, 2, 3],  # home\n [2, 3, 4],\n [3, 4, 5],  # above, 300 mm\n])\n"
    sheet = made(folder, contents)
    assert sheet.titles == ("joints_0", "joints_1", "joints_2")
    assert sheet.rows == (("1", "2", "3"), ("2", "3", "4"), ("3", "4", "5"))


@pytest.mark.parametrize("behind", ["  # {}", "; ! {} {k}", " ; {}"])
def test_words_behind_lines_that_come_again_tell_kinds(folder: Path, behind: str) -> None:
    words = ["target", "actual", "target", "actual"]
    lines = "".join(f"q = [{k}.5, 2.5, 3.5]{behind.format(word, k=k)}\n" for k, word in enumerate(words))
    lines += "q = [9.5, 2.5, 3.5] # the last one\n"
    with pytest.raises(calib.MeasurementError, match=r"2 rows as .*topic target\); 2 rows as .*topic actual\)"):
        made(folder, lines)


@pytest.mark.parametrize("mark", ["# ", "// ", "! ", "; "])
def test_names_beside_words_that_tell_kinds_leave_them_told(folder: Path, mark: str) -> None:
    """Of ``target a`` and ``target b`` each comes once: targets became rows among what was reached."""
    words = ["target a", "actual b", "target c", "actual d"]
    lines = "".join(f"q = [{k}.5, 2.5, 3.5] {mark}{word}\n" for k, word in enumerate(words))
    with pytest.raises(calib.MeasurementError, match=r"2 rows as .*topic target\); 2 rows as .*topic actual\)"):
        made(folder, lines)
    with pytest.raises(calib.MeasurementError, match=r"2 rows as .*; 2 rows as .*topic actual\)"):
        made(folder, lines.replace(f"{mark}target a", "").replace(f"{mark}target c", ""))


def test_a_point_in_comments_is_not_passed_over(folder: Path) -> None:
    """Where one was lost, the others were passed over as well."""
    lines = [f"q=[{k}, 2, 3] # P{k} {k}.5 2.5 3.5\n" for k in range(4)]
    assert len(made(folder, "".join(lines)).titles) == 7
    with pytest.raises(calib.MeasurementError, match=r"4 rows as .*; 1 row as "):
        made(folder, "".join([*lines, "q=[9, 2, 3] # P9 lost\n"]))


def test_a_word_in_all_comments_of_a_list_tells_no_kinds(folder: Path) -> None:
    lines = "".join(f" [{k}, 2, 3],  # pose {word}\n" for k, word in enumerate("abcd"))
    assert len(made(folder, f"joints = np.array([\n{lines}])\n").rows) == 4


def test_what_is_no_comment_stays(folder: Path) -> None:
    """Of lines of one kind nothing is passed over, nor a share, nor numbers that are set behind a sign."""
    shares = "".join(f"q=[{k}, 2, 3] at 100% speed x={k}\n" for k in range(3))
    assert made(folder, shares).titles == ("q_0", "q_1", "q_2", "at", "x")
    numbered = "".join(f"q=[{k}, 2, 3] # pose {k}\n" for k in range(3))
    assert made(folder, numbered).titles == ("q_0", "q_1", "q_2", "pose")
    with pytest.raises(calib.MeasurementError, match="has several kinds of lines"):
        made(folder, "q=[1, 2, 3] # was [2, 2, 2]\nq=[1, 2, 3]\n")


@pytest.mark.parametrize("minus", ["-", "\u2212", "- ", "\u2212 ", "-\t"])
def test_a_minus_that_stands_apart_or_is_of_typesetters_is_one(folder: Path, minus: str) -> None:
    rows = (f"pose-{k}: q=[{minus}0.5, 2.5, {minus}{k}.25] r=({minus}1 2 3)\n" for k in range(3))
    (folder / "a.txt").write_text("".join(rows), encoding="utf-8")
    sheet = read_sheet("a.txt")
    assert sheet.rows[2][1:] == ("-0.5", "2.5", "-2.25", "-1", "2", "3")


def test_a_difference_is_no_number_below_zero(folder: Path) -> None:
    assert made(folder, "q=[1 - 2, 3, 4]\nq=[2 - 3, 3, 4]\n").rows[0] == ("1", "2", "3", "4")
