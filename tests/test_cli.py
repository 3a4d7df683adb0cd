"""The command line as a person and as a program meet it."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import calib
from tests.support.cases import CASE, JOB, TABLE, by_another_machine, copy_case, edit, job, run, tree

MAIN = "from calib.cli import main; main()"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    copy_case(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def process(*arguments: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run the command in a process of its own, in the current folder."""
    plain = {k: v for k, v in os.environ.items() if k not in ("FORCE_COLOR", "GITHUB_ACTIONS", "TTY_COMPATIBLE")}
    command = [sys.executable, "-W", "error", "-c", MAIN, *arguments]
    return subprocess.run(command, env={**plain, **environment}, capture_output=True, check=False)


def assert_plain(text: str) -> None:
    assert "\x1b" not in text
    assert max(map(len, text.splitlines())) <= 80
    assert all(line == line.rstrip() for line in text.splitlines())


def test_calibrate_in_a_process_of_its_own(folder: Path) -> None:
    done = process("calibrate", JOB, "-o", "out")
    assert (done.returncode, done.stderr) == (0, b"")
    text = done.stdout.decode("ascii")
    assert_plain(text)
    assert re.search(r"validation +before +30 +29\.5289 +31\.0533 +45\.5182 +51\.2962 +mm", text)
    assert "The data determine 27 combinations of 45 parameters. The null space has 18\ndirections: among" in text
    assert text.endswith("Results are in out: report.html, scene.html, calibrated.urdf, result.json.\n")


def test_error_in_a_process_of_its_own(folder: Path) -> None:
    done = process("calibrate", "no.toml", "-o", "out")
    assert (done.returncode, done.stdout, done.stderr) == (1, b"", b"Error: no.toml: there is no such file.\n")
    assert not (folder / "out").exists()


def test_a_current_folder_that_is_removed(folder: Path) -> None:
    """Of a path that leads out of it, nothing can say any more where it ends."""
    gone = "import os; os.mkdir('gone'); os.chdir('gone'); os.rmdir(os.getcwd()); "
    done = subprocess.run(
        [sys.executable, "-c", gone + MAIN, "check", f"../{JOB}"], cwd=folder, capture_output=True, check=False
    )
    assert (done.returncode, done.stdout) == (1, b"")
    assert done.stderr == b"Error: the current folder is gone: it was removed or renamed; go to another one.\n"


def test_an_error_is_told_to_a_terminal_that_says_it_has_no_width(folder: Path) -> None:
    done = process("check", "no.toml", COLUMNS="0")
    assert (done.returncode, done.stderr) == (1, b"Error: no.toml: there is no such file.\n")


def test_names_of_any_kind_on_an_ascii_terminal(folder: Path) -> None:
    done = process("calibrate", JOB, "-o", "Gelenk-ä-[red]关节", PYTHONIOENCODING="ascii", COLUMNS="40")
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"Results are in Gelenk-\\xe4-[red]\\u5173\\u8282: report.html" in done.stdout.replace(b"\n", b" ")
    assert (folder / "Gelenk-ä-[red]关节" / "result.json").is_file()


def test_json_is_the_result_file_and_nothing_else(folder: Path) -> None:
    said = run("calibrate", JOB, "-o", "out", "--json")
    assert (said.code, said.err) == (0, "")
    assert said.out == (folder / "out" / "result.json").read_text(encoding="utf-8")
    assert json.loads(said.out)["metrics"]["validation"]["after"]["position"]["n"] == 30


def test_quiet(folder: Path) -> None:
    assert run("calibrate", JOB, "-o", "out", "--quiet") == (0, "", "")
    assert (folder / "out" / "result.json").is_file()
    assert run("check", JOB, "-q") == (0, "", "")


def test_version() -> None:
    assert run("--version") == (0, f"{calib.__version__}\n", "")


@pytest.mark.parametrize("arguments", [("--help",), ("-h",), ("calibrate", "--help"), ("view", "-h")], ids=" ".join)
def test_help(arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    said = run(*arguments)
    assert (said.code, said.err) == (0, "")
    assert_plain(said.out)
    assert "..." not in said.out.replace("[ARGS]...", "")


WRONG_USE = [
    (),
    ("calibrate",),
    ("calibrate", JOB),
    ("calibrat", JOB),
    ("check", JOB, "--fast"),
    ("check", JOB, "more"),
]


@pytest.mark.parametrize("arguments", WRONG_USE, ids=lambda a: " ".join(a) or "nothing")
def test_wrong_usage(folder: Path, arguments: tuple[str, ...]) -> None:
    before = tree(folder)
    said = run(*arguments)
    assert said.code == 2
    assert (said.out + said.err).startswith("Usage: calib")
    assert tree(folder) == before


# What is typed and has no effect. ---------------------------------------------------------------------------------


IDLE = [
    ("plan --facing '0 0 1'", "--facing: say with --tracker"),
    ("plan --nearest '1 m' --acceptance '20 deg'", "--acceptance, --nearest: say with --tracker"),
    ("plan --tracker '2 0 0 m' --acceptance '20 deg'", "--acceptance: say with --facing"),
    ("plan --sigma-angle '1 deg'", "--sigma-angle: of angles, which --observes pose measures."),
    ("plan --no-collisions --mesh-root .", "--mesh-root: meshes are read for collisions alone."),
    ("plan --candidates validation.csv --seed 3", "--seed: candidates are drawn at random"),
    ("plan --observes pixels --tool '1 2 3 mm' --misfit '1 mm'", "--tool, --misfit: not of photographs;"),
    ("board --kind chessboard --squares 7x6 --marker '10 mm'", "--marker: a chessboard has no markers."),
    ("import validation.csv --topic x", "--topic: of a recording, a log of rigid bodies, or lines with"),
    ("import validation.csv --by order", "--by: joins two files, and this is one."),
    ("import validation.csv --tip a --camera-on floor", "--tip, --camera-on: of photographs alone:"),
    ("import validation.csv --robot arm_cmm.urdf --stack a", "--stack: not with --robot,"),
    ("import images photos --topic x", "--topic: not of photographs."),
    ("check arm_cmm.urdf --all", "--all: needs a job, or a URDF and tables."),
    ("check validation.csv --angles deg", "--angles: needs a job, or a URDF and tables."),
    ("check calibration.toml --angles deg --column x=X", "--angles, --column: a job says this itself."),
    ("cell arm_cmm.urdf out --mesh-root .", "--mesh-root: meshes are read for --scene alone."),
]


@pytest.mark.parametrize(("typed", "sentence"), IDLE, ids=[typed for typed, _ in IDLE])
def test_options_without_effect_are_refused(folder: Path, typed: str, sentence: str) -> None:
    before = tree(folder)
    name, *options = shlex.split(typed)
    more = {"plan": [JOB, "-o", "new.csv"], "check": [], "board": ["-o", "new"]}.get(name, ["-o", "new.csv"])
    said = run(name, *more, *options)
    assert (said.code, said.out) == (2, "")
    assert sentence in " ".join(said.err.split())
    assert tree(folder) == before


EMPTY = [
    (("fleet", JOB, "-o", ""), "--out"),
    (("calibrate", JOB, "--out="), "--out"),
    (("calibrate", ""), "JOB"),
    (("init", "arm_cmm.urdf", ""), "DATA..."),
    (("init", "arm_cmm.urdf", "validation.csv", "--output", ""), "--output"),
    (("plan", JOB, "-o", "new.csv", "--mesh-root", ""), "--mesh-root"),
    (("view", ""), "FOLDER"),
]


@pytest.mark.parametrize(("typed", "what"), EMPTY, ids=[f"{typed[0]} {what}" for typed, what in EMPTY])
def test_an_empty_text_is_not_the_current_folder(folder: Path, typed: tuple[str, ...], what: str) -> None:
    before = tree(folder)
    said = run(*typed)
    assert (said.code, said.out) == (2, "")
    assert f"Invalid value for '{what}'" in said.err
    assert said.err.endswith(": is empty; name a file or a folder.\n")
    assert tree(folder) == before


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("new.csv/", "'new.csv/' is a folder; name a file."),
        ("new.csv/.", "'new.csv/.' is a folder; name a file."),
        ("-", "'-' would be a file of this name, and not standard output; name a file."),
    ],
)
def test_a_file_to_be_written_has_the_name_of_one(folder: Path, name: str, why: str) -> None:
    """``new.csv/`` wrote new.csv, and ``-`` a file of this name."""
    before = tree(folder)
    for typed in (("dh", "arm_cmm.urdf", "-o"), ("init", "arm_cmm.urdf", TABLE, "-o"), ("sensitivity", JOB, "--plot")):
        said = run(*typed, name)
        assert (said.code, said.out) == (2, "")
        assert said.err.endswith(f": {why}\n")
    assert tree(folder) == before


def test_folders_of_meshes_that_are_none(folder: Path) -> None:
    said = run("plan", JOB, "-o", "new.csv", "--mesh-root", "nowhere")
    assert said == (1, "", "Error: --mesh-root: 'nowhere' is not a folder.\n")


def test_a_stack_without_a_title(folder: Path) -> None:
    said = run("import", "validation.csv", "identification.csv", "--stack", " ", "-o", "new.csv")
    assert said == (1, "", "Error: stack: a column without a title cannot be read again; give it one.\n")


def test_wishes_of_compensate_without_effect_are_told(folder: Path) -> None:
    assert run("calibrate", JOB, "-o", "out", "-q").code == 0
    lines = (folder / "validation.csv").read_text(encoding="utf-8").splitlines()
    joints = [line.rsplit(",", 3)[0] for line in lines if not line.startswith("#")]
    (folder / "targets.csv").write_text("\n".join(joints[:4]) + "\n", encoding="utf-8")
    wishes = ("--frame", "instrument", "--clamp", "--in-order")
    said = run("compensate", "out", "targets.csv", "-o", "sent.csv", *wishes, "--json")
    notes = json.loads(said.out)["notes"]
    assert "frame 'instrument' has no effect" in notes[0]
    assert "clamp has no effect" in notes[1]
    assert "in_order has no effect" in notes[2]
    assert json.loads(run("compensate", "out", "targets.csv", "-o", "again.csv", "--json").out)["notes"] == []


def test_names_of_targets_and_touches_that_are_not_verified(folder: Path) -> None:
    """A column of names was told to have a unit, and a table of touches to have x, y, z."""
    assert run("calibrate", JOB, "-o", "out", "-q").code == 0
    lines = (folder / "validation.csv").read_text(encoding="utf-8").splitlines()
    joints = [line.rsplit(",", 3)[0] for line in lines if not line.startswith("#")][:4]
    for title in ("name", "group", "target"):
        rows = [f"{cells},{title if k == 0 else f'P {k}'}" for k, cells in enumerate(joints)]
        (folder / f"{title}.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    said = run("compensate", "out", "name.csv", "-o", "sent.csv")
    assert said.code == 1
    assert "like 'name [mm]' or '[deg]'; names of targets belong in the column 'group', " in said.err
    assert run("compensate", "out", "name.csv", "-o", "renamed.csv", "--column", "group=name").code == 0
    assert ",name,remaining_error [mm]" in (folder / "renamed.csv").read_text(encoding="utf-8")
    assert run("compensate", "out", "group.csv", "-o", "sent.csv").code == 0
    assert ",P 1," in (folder / "sent.csv").read_text(encoding="utf-8")
    said = run("verify", "out", "target.csv")
    assert said.code == 1
    assert said.err.startswith("Error: target.csv: touches of targets are not verified; name this table in a [[mea")


def test_targets_of_a_controller_are_corrected_in_its_own_columns(folder: Path) -> None:
    assert run("calibrate", JOB, "-o", "out", "-q").code == 0
    (folder / "krl.csv").write_text(
        "X,Y,Z,A,B,C,S\n400,-300,600,-150,90,30,2\n-110,-9,829,93,-72,-44,2\n", encoding="utf-8"
    )
    said = run("compensate", "out", "krl.csv", "-o", "sent.csv")
    assert (said.code, said.err.count("\n")) == (1, 1)
    assert said.err.endswith("--column 'NAME [UNIT]=X' gives a unit, and --ignore 'X' passes a column over.\n")
    ours = [
        f"{ours}={theirs}"
        for ours, theirs in zip(
            ["x [mm]", "y [mm]", "z [mm]", "rx [deg]", "ry [deg]", "rz [deg]"], "XYZABC", strict=True
        )
    ]
    options = [word for pair in ours for word in ("--column", pair)] + ["--orientation", "abc", "--ignore", "S"]
    said = run("compensate", "out", "krl.csv", "-o", "sent.csv", *options, "--json")
    assert (said.code, json.loads(said.out)["targets"]) == (0, 2)
    head, *rows = (folder / "sent.csv").read_text(encoding="utf-8").splitlines()
    assert "joint_6 [deg],X,Y,Z,A,B,C,remaining_error [mm]" in head
    assert [row.split(",")[6:12] for row in rows] == [
        ["400", "-300", "600", "-150", "90", "30"],
        ["-110", "-9", "829", "93", "-72", "-44"],
    ]


def test_tables_of_others_are_read_by_the_same_options() -> None:
    """What the options are said to do is the same wherever they are."""
    helps = []
    for command in ("verify", "compensate"):
        lines = run(command, "--help").out.split("Options:")[1]
        words = " ".join(lines.split())
        helps.append(words[words.index("--orientation") : words.index("--json")])
    assert helps[0] == helps[1]


def test_in_order_tells_rows_of_which_no_side_is_known(folder: Path) -> None:
    """An arm that rests at its first pose lost those rows in silence when it was verified."""
    order = tuple((f'file = "{name}"\n', f'file = "{name}"\nin_order = true\n') for name in (TABLE, "validation.csv"))
    edit(JOB, ('offsets = "all"', 'offsets = "all"\nbacklash = "all"'), *order)(folder)
    assert run("calibrate", JOB, "-o", "out", "-q").code == 0
    lines = (folder / "validation.csv").read_text(encoding="utf-8").splitlines()
    head, *rows = [line for line in lines if not line.startswith("#")]
    (folder / "rested.csv").write_text("\n".join([head, *([rows[0]] * 4), *rows]) + "\n", encoding="utf-8")
    said = run("verify", "out", "rested.csv", "--in-order", "--json")
    assert json.loads(said.out)["notes"] == [
        "rested.csv: in_order leaves out 5 rows, before every joint has moved: nothing tells from which side it was "
        "reached; begin with a motion of all joints."
    ]
    assert "Warning: rested.csv: in_order leaves out 5 rows" in run("verify", "out", "rested.csv", "--in-order").out
    joints = [line.rsplit(",", 3)[0] for line in (head, *([rows[0]] * 2), rows[1])]
    (folder / "targets.csv").write_text("\n".join(joints) + "\n", encoding="utf-8")
    said = run("compensate", "out", "targets.csv", "-o", "sent.csv", "--in-order", "--json")
    assert json.loads(said.out)["notes"] == ["2 targets that can be reached have a remark in the column 'reason'."]


# Check. -----------------------------------------------------------------------------------------------------------


def test_check_writes_nothing_and_solves_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calib.identification.identify.solve", None)
    before = tree(folder)
    said = run("check", JOB)
    assert (said.code, said.err) == (0, "")
    assert_plain(said.out)
    first, second, third, *directions = said.out.splitlines()
    assert first == "Units, names, limits and rows: no findings."
    assert second.startswith("180 numbers determine 27 combinations of 45 parameters (condition number ")
    assert third == "The null space has 18 directions:"
    assert directions[0].startswith(" - 18 combinations that no position determines: normal for six revolute joints")
    assert sum(line.startswith(" - ") for line in directions) == 1
    every = run("check", JOB, "--all").out.splitlines()[3:]
    assert sum(line.startswith(" - ") for line in every) == 18
    assert tree(folder) == before


def test_check_as_json(folder: Path) -> None:
    said = run("check", JOB, "--json")
    contents = json.loads(said.out)
    assert (said.code, said.err) == (0, "")
    assert (contents["rank"], contents["measured_numbers"], contents["findings"]) == (27, 180, [])
    assert len(contents["undetermined"]) == len(contents["parameters"]) - contents["rank"] == 18


def test_everything_seen_has_no_null_space(folder: Path) -> None:
    job(('placements = "all"', ""), ('offsets = "all"', 'offsets = ["joint_2", "joint_3"]'))(folder)
    said = run("check", JOB)
    assert said.code == 0
    assert "determine 11 combinations of 11 parameters" in said.out
    assert "null space" not in said.out


# Warnings. --------------------------------------------------------------------------------------------------------


def doubled(folder: Path) -> None:
    path = folder / TABLE
    text = path.read_text(encoding="utf-8")
    path.write_text(text + text.splitlines()[-1] + "\n", encoding="utf-8")


DOUBLED = f"{TABLE}: 1 of 61 rows repeat an earlier one to the last digit, at line 66."


def test_the_same_table_twice_is_refused(folder: Path) -> None:
    """By its own name, and as a copy of another: no job is written, and none is calibrated."""
    for name in (TABLE, "copy.csv"):
        (folder / name).write_bytes((folder / TABLE).read_bytes())
        said = run("init", folder / "arm_cmm.urdf", folder / TABLE, folder / name, "-o", folder / "n.toml", "--yes")
        assert (said.code, (folder / "n.toml").exists()) == (1, False)
        assert said.err.rstrip().endswith("; leave out the copies."), said.err


def test_assumed_errors_are_a_file_of_any_name(folder: Path) -> None:
    """What is said of one that is no table of them is said of the file, not of a model.json below it."""
    (folder / "errors.txt").write_text("parameter;error\n")
    said = run("sensitivity", JOB, "--errors", "errors.txt", "-q")
    assert (said.code, said.err.startswith("Error: errors.txt: begins with the columns")) == (1, True), said.err


def test_errors_of_another_machine_are_refused(folder: Path) -> None:
    """Joints of the same names are not enough; nor is it this job when the URDF was changed after the calibration."""
    assert run("calibrate", JOB, "-o", "out", "-q").code in (0, 3)
    assert run("sensitivity", JOB, "--errors", "out", "-q").code == 0
    urdf = folder / "arm_cmm.urdf"
    other = re.sub(r'(<joint name="joint_3".*?<origin xyz=")\S+', r"\g<1>0.123", urdf.read_text(), flags=re.DOTALL)
    urdf.write_text(other)
    said = run("sensitivity", JOB, "--errors", "out", "-q")
    assert (said.code, said.err) == (1, "Error: out: is no result of this job: their nominal URDFs differ.\n")


def test_duplicate_rows_warn(folder: Path) -> None:
    doubled(folder)
    said = run("calibrate", JOB, "-o", "out")
    assert (said.code, said.err) == (0, "")
    assert said.out.replace("\n", " ").startswith(f"Warning: {DOUBLED}")
    assert_plain(said.out)
    assert json.loads((folder / "out/result.json").read_text(encoding="utf-8"))["findings"] == [DOUBLED]
    assert json.loads(run("check", JOB, "--json").out)["findings"] == [DOUBLED]
    assert "no findings" not in run("check", JOB).out


def test_validation_by_the_same_rows_warns(folder: Path) -> None:
    (folder / "copy.csv").write_bytes((folder / TABLE).read_bytes())
    job(("validation.csv", "copy.csv"))(folder)
    said = run("check", JOB)
    assert said.code == 0
    assert said.out.replace("\n", " ").startswith(
        f"Warning: {JOB}: measurements[1].file: 'copy.csv' is '{TABLE}' again, from which the parameters are "
        "identified; a validation with the same rows proves nothing."
    )


# Finished, and not to be trusted. ---------------------------------------------------------------------------------


def test_validation_by_another_machine_is_not_trusted(folder: Path) -> None:
    by_another_machine(folder)
    doubt = "On held-out data the position error is no smaller than before calibration."
    said = run("calibrate", JOB, "-o", "out")
    assert (said.code, said.err) == (3, "")
    assert doubt in said.out.replace("\n", " ")
    result = json.loads((folder / "out/result.json").read_text(encoding="utf-8"))
    # Three more say in other words that the rows are of another machine.
    assert (result["trusted"], result["doubts"][1], len(result["doubts"])) == (False, doubt, 4)
    failed = [check["name"] for check in result["checks"] if not check["passed"]]
    assert failed == ["explained", "improvement", "prediction", "regions"]
    again = run("calibrate", JOB, "-o", "out", "--json")
    assert (again.code, json.loads(again.out)["doubts"]) == (3, result["doubts"])
    assert run("calibrate", JOB, "-o", "out", "--quiet") == (3, "", "")


def test_long_names_stay_within_the_page(folder: Path) -> None:
    long = "the_first_joint_of_the_articulated_arm_as_somebody_in_a_hurry_has_named_it_once"
    for name in ("arm_cmm.urdf", TABLE, "validation.csv"):
        edit(name, ("joint_1", long), everywhere=True)(folder)
    for arguments in (("check", JOB), ("calibrate", JOB, "-o", "out")):
        said = run(*arguments)
        assert said.code == 0
        assert_plain(said.out)
        assert said.out.isascii()
    robot = calib.load_robot("arm_cmm.urdf", tip="probe")
    data = calib.read_measurements(TABLE, robot, sigma=0.02e-3)
    text = calib.table(calib.identify(calib.error_model(robot, offsets="all", placements="all"), data))
    assert_plain(text)
    assert long[:20] in text


def test_case_in_the_repository_is_what_was_copied(folder: Path) -> None:
    assert (folder / JOB).read_bytes() == (CASE / JOB).read_bytes()


# Help and completion. ---------------------------------------------------------------------------------------------


def commands() -> dict[str, str]:
    """Return the help of every command."""
    listed = re.findall(r"^  ([a-z0-9]+) ", run("--help").out.partition("Calibrate:")[2], re.MULTILINE)
    return {name: run(name, "--help").out for name in listed}


def test_help_begins_with_the_way_to_a_calibrated_machine() -> None:
    text = run("--help").out
    assert re.findall(r"^([A-Z][a-z]+):$", text, re.MULTILINE) == ["Options", "Calibrate", "Prepare", "Judge", "More"]
    path = text.partition("Calibrate:")[2].partition("Prepare:")[0]
    assert re.findall(r"^  ([a-z]+) ", path, re.MULTILINE)[:4] == ["init", "check", "calibrate", "view"]


def test_every_command_has_an_example_that_it_takes() -> None:
    found = commands()
    assert len(found) == 21
    for name, text in found.items():
        (example,) = re.findall(r"^  Example: (.*)", text, re.MULTILINE)
        program, command, *arguments = shlex.split(example)
        assert (program, command) == ("calib", name)
        said = run("--help") if name == "demo" else run(command, *arguments, "--help")
        assert said.code == 0
        known = {word.rstrip(",") for word in text.split() if word.startswith("-")}
        assert {word for word in arguments if word.startswith("-")} <= known, name


def test_every_command_that_says_something_says_it_as_json_too() -> None:
    for name, text in commands().items():
        assert ("--json" in text) == (name not in ("demo", "view", "app")), name


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("calib comp", ["compare", "compensate"]),
        ("calib dh --conv", ["--convention"]),
        ("calib export --to o", ["offsets"]),
    ],
)
def test_shells_complete(words: str, offered: list[str]) -> None:
    said = process(_CALIB_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=str(len(words.split()) - 1))
    assert said.returncode == 0
    assert sorted(said.stdout.decode().split()) == offered


def test_dh_as_json(folder: Path) -> None:
    said = run("dh", "arm_cmm.urdf", "--tip", "probe", "-o", "table.csv", "--json")
    contents = json.loads(said.out)
    assert (said.code, contents["schema"], contents["file"], contents["convention"]) == (0, 1, "table.csv", "standard")
    back = run("dh", "table.csv", "-o", "back.urdf", "--json")
    again = json.loads(back.out)
    assert [row["joint"] for row in again["rows"]] == [row["joint"] for row in contents["rows"]]
    assert run("dh", "table.csv", "-o", "more.urdf").out == "7 rows, standard convention; the file is more.urdf.\n"
    assert run("dh", "table.csv", "-o", "quiet.urdf", "-q") == (0, "", "")
    left_out = "table.csv: a DH table names no links, so that --tip and --base are left out."
    assert run("dh", "table.csv", "-o", "tip.urdf", "--tip", "probe") == (1, "", f"Error: {left_out}\n")


def test_cell_as_json(folder: Path) -> None:
    assert run("calibrate", JOB, "-o", "out", "-q").code == 0
    said = run("cell", "arm_cmm.urdf", "out", "-o", "no.urdf", "--placed-in", "arm")
    assert (said.code, said.err) == (
        1,
        "Error: out: its base was found in an instrument's frame, and not in the base of an arm that touched it: "
        "placed_in 'arm' is wrong here.\n",
    )
    said = run("cell", "out", "out", "-o", "cell.urdf", "--json")
    contents = json.loads(said.out)
    assert contents["placed_in"] == "instrument"
    assert (said.code, contents["file"], contents["scene"]) == (0, "cell.urdf", None)
    assert contents["joints"]["joint_1"] != "joint_1"
    assert np.array(contents["placement"]).shape == (4, 4)
