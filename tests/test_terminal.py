"""What a person sees on a terminal, and a script in its place: the demo, progress, colours, --json and --quiet."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from rich.console import Group

from calib.foundations.errors import OutputError
from calib.job import example
from calib.job.calibrate import steps_after_loading
from calib.job.inputs import load
from calib.job.run import run as identify
from calib.presentation.console import Steps, progress, show, show_error, time_left, time_taken
from calib.presentation.report.document import Row, Sheet
from calib.presentation.tables import broken, null_space_lines, plain, sheet_table
from calib.results.folder import write_results
from tests.support.cases import CASE, JOB, ROOT, copy_case, run, tree

MAIN = "from calib.cli import main; main()"
IRB = CASE.parent / "irb2400"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


# The demo. --------------------------------------------------------------------------------------------------------


def test_demo_shows_the_whole_path_and_leaves_it_to_be_walked_again(folder: Path) -> None:
    said = run("demo", "a b")
    assert (said.code, said.err) == (0, "")
    assert max(map(len, said.out.splitlines())) <= 80
    plain = " ".join(said.out.split())
    for command in ("check", "calibrate", "compensate"):
        assert f"$ calib {command} 'a b/" in plain
    result = json.loads((folder / "a b/out/result.json").read_text(encoding="utf-8"))
    after = result["metrics"]["validation"]["after"]["position"]
    assert f"{1e3 * after['rms']:.4f}" in plain
    assert "20 targets, all can be reached" in plain
    assert (folder / "a b/out/report.html").is_file()
    assert len((folder / "a b/corrected.csv").read_text(encoding="utf-8").splitlines()) >= 21
    again = run("calibrate", "a b/calibration.toml", "-o", "again", "--json")
    assert json.loads(again.out)["metrics"] == result["metrics"]


def test_the_example_is_taken_up_where_a_run_was_ended_and_nowhere_else(tmp_path: Path) -> None:
    from calib.job.example import copy_example

    demo = tmp_path / "demo"
    paths = copy_example(demo)
    before = tree(demo)
    assert copy_example(demo) == paths
    assert tree(demo) == before
    (demo / "test.csv").write_text("mine")
    with pytest.raises(OutputError, match="demo: already exists; choose another name"):
        copy_example(demo)
    assert (demo / "test.csv").read_text() == "mine"


def test_demo_never_writes_where_something_is(folder: Path) -> None:
    (folder / "calib-demo").mkdir()
    (folder / "calib-demo/mine.txt").write_text("mine")
    before = tree(folder)
    assert run("demo") == (1, "", "Error: calib-demo: already exists; choose another name.\n")
    assert tree(folder) == before


def test_example_is_packed_as_it_is_shipped() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packed = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    source = example.example_folder()
    assert {Path(a).name: Path(b).parent for a, b in packed.items()} == dict.fromkeys(
        example._FILES, Path("calib/examples/irb2400")
    )
    for name in packed:
        assert (ROOT / name).read_bytes() == (source / Path(name).name).read_bytes()


def test_a_package_without_its_example_says_so(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(example, "_FILES", ("no-such-file",))
    said = run("demo")
    assert (said.code, said.out) == (1, "")
    assert said.err.startswith("Error: The example is not installed")
    assert tree(folder) == {}


# Progress and colours. --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("elapsed", "done", "total", "said"),
    [(0.4, 0, 9, ""), (3.0, 1, 4, "about 9 s left"), (30.0, 1, 21, "about 10 min left"), (2.0, 4, 4, "about 0 s left")],
)
def test_time_left_is_what_the_steps_so_far_have_taken(elapsed: float, done: int, total: int, said: str) -> None:
    assert time_left(elapsed, done, total) == said


def test_time_taken_tells_the_step_that_is_under_way() -> None:
    assert time_taken(12.4, 3, 9) == "step 4 of 9, 12 s"
    assert time_taken(2.0, 9, 9) == "step 9 of 9, 2 s"


def test_no_word_and_no_number_of_a_table_is_broken() -> None:
    numbers = ("old", "new", "change", "sigma", "at the tip")
    names = ("joint_1.tx", "rear_lever_length.tx", "a_name_that_somebody_made_much_too_long.offset")
    rows = tuple(Row((name, *(f"+{k}23.4567" for k in range(5)), "mm")) for name in names)
    sheet = Sheet("Changes", ("parameter", *numbers, "unit"), frozenset(numbers), rows)
    text = plain(sheet_table(sheet))
    assert max(map(len, text.splitlines())) <= 80
    for k in range(5):
        assert text.count(f"+{k}23.4567") == 3
    words = {word for name in names for word in re.findall(r"[^._]+[._]?", name)}
    first = [line[1:22].split()[0] for line in text.splitlines() if line.startswith(" ") and line[1] not in " -"]
    assert "".join(first[1:]) == "".join(names)
    assert all(any(piece.endswith(word) for word in words) for piece in first[1:])
    assert broken("one/two three.four", 7) == "one/two\nthree.\nfour"
    assert broken("indivisible", 4) == "indivisible"


def test_names_in_tables_cannot_command_the_terminal() -> None:
    evil = "a\x1b[31m\x9b2J\u202eb\u2028c"
    sheet = Sheet.of(evil, ("name", ">n", evil), [(evil, "1", evil)], caption=evil)
    shown = (plain(sheet_table(sheet)), plain(Group(*null_space_lines([evil]))))
    for text in shown:
        assert all(letter.isprintable() for line in text.split("\n") for letter in line)
        assert r"a\x1b[31m\x9b2J\u202eb\u2028c" in text


def test_names_in_tables_stay_as_they_are() -> None:
    name = "a:car:[red]b"
    sheet = Sheet.of(name, ("name", ">n", name), [(name, "1", name)], caption=name)
    assert plain(sheet_table(sheet)).count(name) == 5
    assert name in plain(Group(*null_space_lines([name])))


def test_steps_count_what_is_done_and_never_run_over() -> None:
    told: list[tuple[str, int, int]] = []
    steps = Steps(lambda *what: told.append(what), 2)
    steps("a")
    steps.expect(1)
    steps("b")
    steps("c")
    assert told == [("a", 0, 2), ("b", 1, 2), ("c", 2, 3)]


@pytest.mark.parametrize("job", [CASE / JOB, IRB / JOB], ids=lambda path: path.parent.name)
def test_every_step_of_a_calibration_is_expected(job: Path, tmp_path: Path) -> None:
    told: list[str] = []
    inputs = load(job, told.append)
    assert len(told) == 3
    write_results(identify(inputs, told.append), tmp_path / "out", told.append)
    assert len(told) == 3 + steps_after_loading(inputs)


def test_nothing_is_told_where_nobody_looks(capsys: pytest.CaptureFixture[str]) -> None:
    with progress(shown=True, steps=1) as say:
        say("working")
    assert capsys.readouterr() == ("", "")


def test_a_terminal_that_is_closed_does_not_end_what_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a command that goes on, as after ``disown``, the work is kept and what is said is dropped."""
    monkeypatch.setenv("TERM", "xterm")
    person, terminal = os.openpty()
    with os.fdopen(terminal, "w") as err, os.fdopen(os.dup(terminal), "w") as out:
        monkeypatch.setattr(sys, "stderr", err)
        monkeypatch.setattr(sys, "stdout", out)
        with progress(shown=True, steps=2) as say:
            say("one")
            os.close(person)
            say("two")
        show("a row", Group("more"))
        show_error("nothing is read")


def test_an_error_that_nobody_reads_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever says that it was interrupted ends with the exit code for that."""
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as err:
        monkeypatch.setattr(sys, "stderr", err)
        show_error("interrupted.")


def colours(folder: Path, *arguments: str, **environment: str) -> tuple[int, str, str]:
    copy_case(folder)
    plain = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE")}
    command = [sys.executable, "-W", "error", "-c", MAIN, "calibrate", JOB, "-o", "out", *arguments]
    done = subprocess.run(
        command, env={**plain, "TERM": "xterm", **environment}, capture_output=True, text=True, check=False, cwd=folder
    )
    return done.returncode, done.stdout, done.stderr


def test_a_terminal_gets_colours_and_progress_where_they_are_wanted(folder: Path) -> None:
    code, out, err = colours(folder, FORCE_COLOR="1")
    assert code == 0
    assert "\x1b[1;32m" in out  # the verdict, green
    assert "drawing the scene" in err
    assert re.search(r"step \d+ of \d+, \d+ s", err)
    assert " left" not in err  # quick steps say nothing of slow ones
    assert colours(folder, "--quiet", FORCE_COLOR="1") == (0, "", "")
    code, out, err = colours(folder, "--json", FORCE_COLOR="1")
    assert (code, err) == (0, "")
    assert out == (folder / "out/result.json").read_text(encoding="utf-8")


# For scripts. -----------------------------------------------------------------------------------------------------


def test_compensate_as_json_names_the_rows_that_are_not_reached(folder: Path) -> None:
    assert run("calibrate", copy_case(folder), "-o", "out", "-q").code == 0
    rows = ["x [mm], y [mm], z [mm]", "300, 200, 100", "90000, 0, 0"]
    (folder / "targets.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    said = run("compensate", "out", "targets.csv", "-o", "corrected.csv", "--json")
    assert (said.code, said.err) == (0, "")
    told = json.loads(said.out)
    assert (told["targets"], told["file"]) == (2, "corrected.csv")
    (missed,) = told["not_reached"]
    assert missed["row"] == 2
    assert missed["reason"]
    assert missed["reason"] in (folder / "corrected.csv").read_text(encoding="utf-8")


def test_a_file_that_ends_too_soon_is_no_wish_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As compiled code of Python that a full disk cut off: click takes the end of a file for that of a terminal."""

    def cut_off(*_: object, **__: object) -> None:
        raise EOFError("marshal data too short")

    monkeypatch.setattr("calib.job.read.board_toml", cut_off)
    with pytest.raises(EOFError, match="marshal data too short"):
        run("board", "-o", tmp_path / "board")
    assert list(tmp_path.iterdir()) == []


def test_commands_that_are_told_can_be_typed_as_they_stand(folder: Path) -> None:
    """A name may have spaces, or be made to be a command."""
    job = copy_case(folder).rename(folder / "my $(job).toml")
    assert run("calibrate", job, "-o", "out", "-q").code == 0
    assert "\n    calib calibrate 'my $(job).toml' -o out\n" in (folder / "out/report.md").read_text(encoding="utf-8")
    said = run("init", CASE / "arm_cmm.urdf", folder / "identification.csv", "-y", "-o", "an other.toml")
    assert "The next step: calib calibrate 'an other.toml' -o out/" in " ".join(said.out.split())
