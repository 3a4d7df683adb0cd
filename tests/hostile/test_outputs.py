"""Names made to harm whoever opens the results: pages, terminals, spreadsheets, folders."""

import csv
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from calib.foundations.csv_text import csv_cell, csv_text, has_formula
from calib.foundations.errors import RobotError
from calib.foundations.json_text import document
from calib.job.fleet_summary import summary, summary_csv
from calib.measurement.read import read_measurements
from calib.presentation.fleet_tables import JobLine, fleet_report
from calib.presentation.report.page import render_page
from calib.robot.load import load_robot
from calib.robot.urdf import parse_urdf
from tests.support.cases import CASE, JOB, TABLE, URDF, Said, copy_case, edit, run

SCRIPT = "<script>alert(1)</script><img src=x onerror=alert(2)>"
# The terminal's own codes: red, clear, a link, a title, a line overwritten, text turned round.
TERMINAL = "\x1b[31m\x1b[2J\x1b]8;;http://evil.example\x07\x9b31m\r\u202e"
BEHIND = 'a;=1+1;"=2+2"\t＋3+3'
FORMULA = '=cmd|"/C calc"!A0'
# No control characters in XML, and no quote in an attribute of this one.
IN_XML = "&lt;script>alert(1)&lt;/script>&#x202e;../../x"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Said]:
    """Return the results of a case full of such names, and what the terminal said."""
    folder = tmp_path_factory.mktemp("evil")
    copy_case(folder)
    for name in (TABLE, "validation.csv"):
        path = folder / name
        lines = path.read_text(encoding="utf-8").splitlines()
        header = next(k for k, line in enumerate(lines) if not line.startswith("#"))
        names = (f"{SCRIPT}{TERMINAL}".replace("\r", ""), FORMULA, "../../etc/passwd", BEHIND)
        lines[header] += ",tool"
        for k in range(header + 1, len(lines)):
            lines[k] += ',"' + names[k % 4].replace('"', '""') + '"'
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    edit(URDF, ('<robot name="arm_cmm"', f'<robot name="{IN_XML}"'))(folder)
    evil = "=1+1<b>.csv"
    (folder / "validation.csv").rename(folder / evil)
    edit(JOB, ('"validation.csv"', f'"{evil}"'))(folder)
    return folder / "out", run("calibrate", folder / JOB, "-o", folder / "out")


class Tags(HTMLParser):
    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, list[str]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, [name for name, _ in attrs]))


def test_pages_have_no_element_of_anybody_else(results: tuple[Path, Said]) -> None:
    out, said = results
    assert said.code in (0, 3), said.err
    report = Tags((out / "report.html").read_text(encoding="utf-8"))
    assert not [tag for tag, _ in report.found if tag in ("script", "img", "b")]
    # The script runs in the scene; that of the names does not.
    scene = (out / "scene.html").read_text(encoding="utf-8")
    assert "<script>alert" not in scene
    assert "<img src=x" not in scene
    for page in (report, Tags(scene)):
        assert not [name for _, names in page.found for name in names if name.startswith("on")]


def test_markdown_shows_words(results: tuple[Path, Said]) -> None:
    text = (results[0] / "report.md").read_text(encoding="utf-8")
    assert "<script" not in re.sub(r"\\.", "", text)


def test_reports_read_from_left_to_right(results: tuple[Path, Said]) -> None:
    """A name with an override of the direction would turn round the numbers behind it in a sentence."""
    for name in ("report.html", "report.md", "scene.html"):
        text = (results[0] / name).read_text(encoding="utf-8")
        assert "\\u202e" in text
        assert not re.search("[\u202a-\u202e\u2066-\u2069]", text)


def test_files_to_be_looked_at_command_no_terminal(results: tuple[Path, Said]) -> None:
    """Who shows them in a terminal, by ``cat`` or ``less -r``, would have it obey a name."""
    for name in ("report.html", "report.md", "scene.html", "residuals.csv", "calibrated.urdf"):
        text = (results[0] / name).read_text(encoding="utf-8")
        assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", text), name
    evil = f"jobs/a{TERMINAL}.toml"
    failed = JobLine(evil, evil, "failed", (evil,))
    for text in (summary_csv([failed]), render_page(fleet_report([failed])), document(summary([failed]))):
        assert "x1b[31m" in text or "u001b[31m" in text
        assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]", text)


def test_the_terminal_takes_no_orders(results: tuple[Path, Said]) -> None:
    said = results[1].out + results[1].err
    assert said
    assert not [c for c in said if not c.isprintable() and c != "\n"]


@pytest.mark.parametrize(
    "typed",
    [("{}",), ("check", "{}", "--{}"), ("--{}",), ("check", "a", "-{}"), ("view", "a", "{}"), ("plan", "-n", "{}")],
)
def test_what_is_misspelt_commands_no_terminal(typed: tuple[str, ...]) -> None:
    said = run(*(word.format(f"a{TERMINAL}\u2066b") for word in typed))
    assert said.code == 2
    assert not [c for c in said.err if not c.isprintable() and c != "\n"]


def test_spreadsheets_compute_nothing(results: tuple[Path, Said]) -> None:
    text = (results[0] / "residuals.csv").read_text(encoding="utf-8")
    cells = [cell for row in csv.reader(io.StringIO(text)) for cell in row]
    assert f"'{FORMULA}" in cells
    assert "'=1+1<b>.csv" in cells
    assert not [cell for cell in cells if has_formula(cell)]
    # However a spreadsheet parts the cells.
    parts = re.split(r"[,;|\t\n]", text)
    assert not [part for part in parts if has_formula(part.strip('" '))]


@pytest.mark.parametrize(
    "text",
    [
        "-1\n*HYPERLINK(A1)",
        "-1\t*HYPERLINK(A1)",
        "+\n2*HYPERLINK(A1)",
        "-1,5*HYPERLINK(A1)",
        "-1|HYPERLINK(A1)",
        "-\x0b1+A1",
    ],
)
def test_a_formula_may_begin_with_a_number(text: str) -> None:
    """It goes on behind a line end or a tab, and behind the comma where that is the decimal sign."""
    assert csv_cell(text).lstrip('"').startswith("'")
    assert csv_cell("-1.5e3") == "-1.5e3"
    assert csv_cell("+") == "+"


def test_names_make_no_files(results: tuple[Path, Said]) -> None:
    out, _ = results
    assert {path.parent for path in out.rglob("*")} == {out}
    for name in ("result.json", "model.json", "uncertainty.json", "job.json"):
        text = (out / name).read_text(encoding="utf-8")
        assert text.isascii()
        json.loads(text)


def test_cells() -> None:
    row = ["=1+1", "+1", "-1.5e-3", "-", "+", "+49 30", "-x", "@a", "\tx", "a=b", "", 1.5, "'=1"]
    (found,) = csv.reader(io.StringIO(csv_text([row])))
    assert found == ["'=1+1", "+1", "-1.5e-3", "-", "+", "'+49 30", "'-x", "'@a", "'\tx", "a=b", "", "1.5", "'=1"]


@pytest.mark.parametrize(
    ("word", "written"),
    [
        ("a;=1+1", '"a;\'=1+1"'),
        ("a\t@sum", '"a\t\'@sum"'),
        ("a\n-b", '"a\n\'-b"'),
        ("a|+b", '"a|\'+b"'),
        ('a;"=1+1"', '"a;""\'=1+1"""'),
        ("a; =1;=2", "\"a; '=1;'=2\""),
        ("＝1+1", "'＝1+1"),
        ("＋1", "'＋1"),
        ("a;－1", '"a;\'－1"'),
        ("＠sum", "'＠sum"),
        ("a=b", "a=b"),
        ("1,-2;+3.5", "\"1,'-2;'+3.5\""),
        ("a;b", '"a;b"'),
        ("# a", '"# a"'),
        ("\ufeff=1+1", "\ufeff'=1+1"),  # at the start of a file the mark goes, and leaves a formula
        ("a;\u200b @sum", '"a;\u200b \'@sum"'),
    ],
)
def test_cells_of_other_separators_and_widths(word: str, written: str) -> None:
    assert csv_text([[word, 1]]) == f"{written},1\n"
    ((read, _),) = csv.reader(io.StringIO(csv_text([[word, 1]]), newline=""))
    assert read.replace("'", "") == word


@pytest.mark.parametrize("name", ["=1+1", "@sum", "-j", "+j", "j;=1", "＝j"])
def test_joints_with_names_of_formulas_are_refused(name: str) -> None:
    urdf = f'<robot><link name="a"/><link name="b"/><joint name="{name}" type="revolute"><parent link="a"/>'
    with pytest.raises(RobotError) as caught:
        load_robot(parse_urdf(f'{urdf}<child link="b"/></joint></robot>'.encode(), "arm.urdf"))
    assert str(caught.value) == f"arm.urdf: joint {name!r} has the name of a spreadsheet's formula; rename it."


@pytest.mark.parametrize("tool", ["=1+1", "+B", "x;=2", "a,@b", "\uff1d1", "it's", "o'=x"])
def test_a_name_that_was_marked_is_read_as_it_was(tool: str, tmp_path: Path) -> None:
    """A table that is written and read again has the tools that it had."""
    lines = (CASE / TABLE).read_text(encoding="utf-8").splitlines()
    head, *rows = [line for line in lines if not line.startswith("#")][:3]
    named = [f"{head}, tool", *(f"{row}, {csv_cell(tool)}" for row in rows)]
    (tmp_path / "measured.csv").write_text("\n".join(named) + "\n", encoding="utf-8")
    robot = load_robot(CASE / URDF, tip="probe")
    assert read_measurements(tmp_path / "measured.csv", robot).tools == (tool,)


def test_cells_command_no_terminal() -> None:
    assert csv_text([["\0-b", "a\r=1", "\x9b31m", "\u202ea", "é\tb"]]) == '\\x00-b,a\\x0d=1,\\x9b31m,\\u202ea,"é\tb"\n'


@pytest.mark.parametrize("odd", ["a\x9b31m", "a\x7f", "a\u202eb"])
def test_a_joint_whose_name_commands_is_refused(tmp_path: Path, odd: str) -> None:
    """It would be the title of a column in every table of poses, and the name in files for controllers."""
    copy_case(tmp_path)
    edit(URDF, ('<joint name="joint_2"', f'<joint name="{odd}"'))(tmp_path)
    said = run("plan", tmp_path / URDF, "-o", tmp_path / "poses.csv")
    assert said.code == 1
    escaped = odd.encode("unicode_escape").decode()
    assert f"joint '{escaped}' has a character that commands a terminal or turns text round" in said.err


def test_what_is_imported_commands_no_terminal(tmp_path: Path) -> None:
    """JSON, workbooks and arrays hold as escapes or packed what a table would hold as it is."""
    (tmp_path / "a.json").write_text(json.dumps([{"x\x9b31m": 1.5, "name": TERMINAL}, {"x\x9b31m": 2.5, "name": "b"}]))
    said = run("import", tmp_path / "a.json", "-o", tmp_path / "a.csv")
    assert (said.code, said.err) == (0, "")
    text = (tmp_path / "a.csv").read_text(encoding="utf-8")
    assert "\\x1b[31m" in text
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]", text)
