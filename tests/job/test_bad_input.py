"""Bad input: one clear sentence on standard error, exit code 1, nothing written, no input touched."""

import os
from pathlib import Path

import pytest

from tests.support.cases import (
    CASE,
    JOB,
    TABLE,
    URDF,
    Edit,
    append,
    copy_case,
    cut,
    edit,
    job,
    keep_rows,
    run,
    tree,
    write,
)

ENTITY_BOMB = (
    '<?xml version="1.0"?><!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;">]>'
    "<robot name='&c;'><link name='base'/></robot>"
)
TRACKER = '[instruments.leica]\nkind = "laser_tracker"\n'
BASE = '[base]\nposition = ["0 m", "0 m", "0 m"]\n'
FIXED_BASE = ('"pose" ', '"fixed"')
FIXED_TOOL = ('tool = "position"', 'tool = "fixed"')
SINGLE = 'schema = 1\n[robot]\nurdf = "arm_cmm.urdf"\n[measurements]\nfile = "identification.csv"\n'
FIRST = next(line for line in (CASE / TABLE).read_text(encoding="utf-8").splitlines() if line[0] in "-0123456789")
FIRST_NUMBER = FIRST.split(",")[0]
QUATERNION = "qw, qx, qy, qz"


def test_a_key_that_belongs_at_the_top_and_in_sections(folder: Path) -> None:
    """Every place is named in words: the top of the file has no header."""
    for key, places in (
        ("schema", "at the top of the file"),
        ("base", "at the top of the file or in [robot] or [error_model]"),
        ("prior", "in [error_model] or [setups.NAME]"),
    ):
        write(JOB, f'schema = 1\n[[measurements]]\n{key} = "x"\n')(folder)
        said = run("check", JOB)
        assert said == (1, "", f"Error: {JOB}: measurements[0].{key}: is not a known key; it belongs {places}.\n")


def together(*edits: Edit) -> Edit:
    def apply(folder: Path) -> None:
        for one in edits:
            one(folder)

    return apply


def with_columns(names: str, cells: str) -> Edit:
    """Return an edit that adds cells to every row of the table."""

    def apply(folder: Path) -> None:
        lines = (folder / TABLE).read_text(encoding="utf-8").splitlines()
        rows = [line if line.startswith("#") else f"{line}, {cells}" for line in lines]
        header = next(i for i, line in enumerate(lines) if not line.startswith("#"))
        rows[header] = f"{lines[header]}, {names}"
        (folder / TABLE).write_text("\n".join(rows) + "\n", encoding="utf-8")

    return apply


CASES: dict[str, Edit] = {
    "unit missing": edit(TABLE, ("x [mm]", "x")),
    "unit unknown": edit(TABLE, ("x [mm]", "x [furlong]")),
    "unit of another dimension": edit(TABLE, ("x [mm]", "x [deg]")),
    "unknown joint column": edit(TABLE, ("joint_2 [deg]", "joint_7 [deg]")),
    "quaternion norm": together(
        job(('observes = "position"', 'observes = "pose"')), with_columns(QUATERNION, "2, 0, 0, 0")
    ),
    "NaN": edit(TABLE, (FIRST_NUMBER, "nan")),
    "word for a number": edit(TABLE, (FIRST_NUMBER, "12.5x")),
    "degrees as radians": edit(TABLE, ("[deg]", "[rad]"), everywhere=True),
    "millimetres as metres": edit(TABLE, ("[mm]", "[m]"), everywhere=True),
    "row cut off": cut(TABLE, -12),
    "table empty": write(TABLE, ""),
    "table without rows": keep_rows(TABLE, 0),
    "table binary": write(TABLE, b"\x00\x01\xff"),
    "table missing": job(("identification.csv", "identificaton.csv")),
    "table a folder": job(("identification.csv", ".")),
    "as many rows as unknowns": keep_rows(TABLE, 9),
    "tip not a link": job(('"probe"', '"prob"')),
    "base not a link": job(('tip = "probe"', 'tip = "probe"\nbase = "base"')),
    "base behind the tip": job(('tip = "probe"', 'tip = "link_1"\nbase = "link_2"')),
    "zero axis": edit(URDF, ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>')),
    "NaN in the URDF": edit(URDF, ('<origin xyz="0 0 0.1" rpy="-1.57', '<origin xyz="0 nan 0.1" rpy="-1.57')),
    "entity bomb": write(URDF, ENTITY_BOMB),
    "URDF cut off": cut(URDF, 3000),
    "URDF empty": write(URDF, ""),
    "URDF missing": job(("arm_cmm.urdf", "arm.urdf")),
    "unknown example": job(("arm_cmm.urdf", "example:ur10_description/urdf/ur10_robot.urdf")),
    "job empty": write(JOB, ""),
    "job not TOML": write(JOB, "schema: 1\n"),
    "job binary": write(JOB, b"\x7fELF\xff\xfe"),
    "job nested without end": write(JOB, "x = " + "[" * 5000),
    "job with an endless number": write(JOB, "schema = " + "1" * 5000),
    "schema of the future": job(("schema = 1", "schema = 2"), ("[robot]", "[machine]")),
    "schema a truth value": job(("schema = 1", "schema = true")),
    "schema missing": job(("schema = 1", "")),
    "section missing": write(JOB, 'schema = 1\n[[measurements]]\nfile = "identification.csv"\n'),
    "measurements missing": edit(JOB, ("[[measurements]]", "[[measurement]]"), everywhere=True),
    "measurements a single section": write(JOB, SINGLE),
    "robot a list": job(("[robot]", "[[robot]]")),
    "robot a text": write(JOB, 'schema = 1\nrobot = "arm.urdf"\n[[measurements]]\nfile = "a.csv"\n'),
    "unknown key": job(("offsets =", "ofsets =")),
    "unknown section": job(("[error_model]", "[eror_model]")),
    "key in the wrong section": job(('tip = "probe"', 'tip = "probe"\noffsets = "all"')),
    "key of a section at the top": job(("schema = 1", 'schema = 1\ntip = "probe"')),
    "misspelt key at the top": job(("schema = 1", 'schema = 1\nplacement = "all"')),
    "key of the top in a section": append('instruments = "leica"\n'),
    "key unlike any other": job(("schema = 1", "schema = 1\nvolume = 11")),
    "key with a line end": job(("schema = 1", 'schema = 1\n"a\\nb" = 11')),
    "wrong type for a selection": job(('offsets = "all"', "offsets = 3")),
    "wrong word for a selection": job(('offsets = "all"', 'offsets = "al"')),
    "list in a list": job(('offsets = "all"', 'offsets = ["joint_1", ["joint_2"]]')),
    "unknown joint": job(('offsets = "all"', 'offsets = ["joint_9"]')),
    "joint called base": together(
        edit(URDF, ('"joint_1"', '"base"'), everywhere=True), edit(TABLE, ("joint_1 [deg]", "base [deg]"))
    ),
    "unknown component": job(('placements = "all"', 'placements = ["joint_3.rq"]')),
    "wrong type for a word": job(('base = "pose"', "base = true")),
    "wrong word": job(('base = "pose"', 'base = "poes"')),
    "sigma without quotes": job(('"0.02 mm"', "0.02")),
    "sigma without unit": job(('"0.02 mm"', '"0.02"')),
    "sigma in degrees": job(('"0.02 mm"', '"0.02 deg"')),
    "sigma negative": job(('"0.02 mm"', '"-0.02 mm"')),
    "sigma zero": job(('"0.02 mm"', '"0 mm"')),
    "sigma infinite": job(('"0.02 mm"', '"1e999 mm"')),
    "sigma a list": job(('"0.02 mm"', '["0.02 mm", "0.03 mm", "0.04 mm"]')),
    "angles of positions": job(('"0.02 mm"', '"0.02 mm"\nsigma_angle = "1 deg"')),
    "model part of held-out data": append('model_sigma = "1 mm"\n'),
    "no noise at all": job(('sigma = "0.02 mm"', 'model_sigma = "0 mm"')),
    "harmonics of order zero": job(('base = "pose"', 'base = "pose"\nharmonics = "all"\nharmonic_orders = [0]')),
    "harmonics of no order": job(('base = "pose"', 'base = "pose"\nharmonics = "all"\nharmonic_orders = []')),
    "harmonics of an unknown joint": job(('base = "pose"', 'base = "pose"\nharmonics = ["joint_9"]')),
    "terms chosen twice": job(('base = "pose"', 'base = "pose"\nterms = "auto"\ngain = ["joint_2"]')),
    "terms misspelt": job(('base = "pose"', 'base = "pose"\nterms = "automatic"')),
    "backlash without sides": job(('base = "pose"', 'base = "pose"\nbacklash = ["joint_2"]')),
    "bending without masses": job(('base = "pose"', 'base = "pose"\nbending = "all"')),
    "bending of no link": job(('base = "pose"', 'base = "pose"\nbending = ["joint_1"]')),
    "expansion of a word": job(('base = "pose"', 'base = "pose"\nexpansion = "links"')),
    "expansion without temperature": job(('base = "pose"', 'base = "pose"\nexpansion = "arm"')),
    "expansion without temperature of held-out rows": together(
        job(('base = "pose"', 'base = "pose"\nexpansion = "arm"')), with_columns("temperature [degC]", "21.5")
    ),
    "expansion in a DH table": job(('placements = "all"', 'dh = "all"\nexpansion = "arm"')),
    "moments of what lifts nothing": job(('base = "pose"', 'base = "pose"\nmoments = ["joint_1"]')),
    "wind-up without masses": job(('base = "pose"', 'base = "pose"\nelastic = "all"')),
    "gravity without unit": job(('tip = "probe"', 'tip = "probe"\ngravity = ["0 m/s2", "0 m/s2", "-9.81"]')),
    "gravity of two numbers": job(('tip = "probe"', 'tip = "probe"\ngravity = ["0 m/s2", "-9.81 m/s2"]')),
    "payload of a link that is not there": job(
        ('tip = "probe"', 'tip = "probe"\npayload = { mass = "1 kg", link = "hand" }')
    ),
    "payload of a table without mass": job(('sigma = "0.02 mm"', 'sigma = "0.02 mm"\npayload = { link = "probe" }')),
    "quaternion of a set-up without a position": append("\n[setups.wall]\nquaternion = [1.0, 0.0, 0.0, 0.0]\n"),
    "gravity of a set-up without unit": append('\n[setups.wall]\ngravity = ["0 m/s2", "0 m/s2", "9.81"]\n'),
    "payload too light": job(('tip = "probe"', 'tip = "probe"\npayload = { mass = "-1 kg" }')),
    "order of rows misspelt": job(('sigma = "0.02 mm"', 'sigma = "0.02 mm"\nin_order = "yes"')),
    "gain misspelt": job(('base = "pose"', 'base = "pose"\ngains = "all"')),
    "prior negative": job(('tool = "position"', 'prior = { length = "-1 mm" }\ntool = "position"')),
    "prior misspelt": job(('tool = "position"', 'prior = { lenght = "1 mm" }\ntool = "position"')),
    "prior of wind-up in degrees": job(('tool = "position"', 'prior = { elastic = "1 deg" }\ntool = "position"')),
    "prior of wind-up a number": job(('tool = "position"', 'prior = { elastic = 1e-5 }\ntool = "position"')),
    "prior of wind-up negative": job(('tool = "position"', 'prior = { elastic = "-1 um/N" }\ntool = "position"')),
    "prior of wind-up that slides": job(('tool = "position"', 'prior = { elastic = "1 um/N" }\ntool = "position"')),
    "prior learnt": job(('tool = "position"', 'prior = { angle = "learnt" }\ntool = "position"')),
    "prior a number": job(('tool = "position"', 'prior = 3\ntool = "position"')),
    "nothing free": job(('offsets = "all"', ""), ('placements = "all"', ""), FIXED_BASE, FIXED_TOOL),
    "nothing to identify from": job(('observes = "position"', 'observes = "position"\nuse = "validate"')),
    "instrument not declared": job(('sigma = "0.02 mm"', 'instrument = "leica"')),
    "instrument of no kind": append('[instruments.leica]\nkind = "ruler"\nsigma = "1 mm"\n'),
    "instrument with a negative sigma": append(TRACKER + 'sigma = "-1 mm"\n'),
    "instrument at half a station": append(TRACKER + 'sigma = "1 mm"\nstation = ["1 m"]\n'),
    "noise given twice": append(TRACKER + 'sigma = "1 mm"\n', ("sigma =", 'instrument = "leica"\nsigma =')),
    "base given and free": append(BASE),
    "base without unit": append("[base]\nposition = [0, 0, 0]\n", FIXED_BASE),
    "base quaternion": append(BASE + "quaternion = [1, 1, 0, 0]\n", FIXED_BASE),
    "base quaternion NaN": append(BASE + "quaternion = [nan, 1, 0, 0]\n", FIXED_BASE),
    "tool given and free": append('[tools.tool]\nposition = ["0 m", "0 m", "0 m"]\n'),
    "tool without a point": append('[tools."left ball"]\nposition = ["0 m", "0 m", "0 m"]\n', FIXED_TOOL),
    "tool position a text": append('[tools."left ball"]\nposition = "0 m"\n', FIXED_TOOL),
    "column to nowhere": job(('sigma = "0.02 mm"', 'columns = { x = "X" }')),
    "column renamed to a number": job(('sigma = "0.02 mm"', "columns = { x = 3 }")),
    "mesh folder missing": job(('tip = "probe"', 'tip = "probe"\nmesh_roots = ["meshes"]')),
    "mesh folder a text": job(('tip = "probe"', 'tip = "probe"\nmesh_roots = "meshes"')),
    "pose without quaternions": job(('observes = "position"', 'observes = "pose"')),
    "null space refused": job(('offsets = "all"', 'offsets = "all"\nnull_space = "refuse"')),
}

# What is said to each case, one line each: read them as a user would.
SENTENCES = dict(
    line.split(" | ") for line in Path(__file__).with_name("sentences.txt").read_text(encoding="utf-8").splitlines()
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    copy_case(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", CASES)
def test_sentence(folder: Path, name: str) -> None:
    CASES[name](folder)
    before = tree(folder)
    said = run("calibrate", JOB, "-o", "out")
    assert said == (1, "", f"Error: {SENTENCES[name]}\n")
    assert tree(folder) == before


def test_every_sentence_is_said() -> None:
    assert list(SENTENCES) == list(CASES)


def test_what_check_says_is_what_calibrate_says(folder: Path) -> None:
    write(URDF, ENTITY_BOMB)(folder)
    assert run("check", JOB) == run("calibrate", JOB, "-o", "out") == run("check", JOB, "--json")


def test_error_is_said_in_spite_of_quiet_and_json(folder: Path) -> None:
    said = run("calibrate", "nothing.toml", "-o", "out", "--quiet", "--json")
    assert said == (1, "", "Error: nothing.toml: there is no such file.\n")


def test_job_is_a_folder(folder: Path) -> None:
    assert run("check", ".") == (1, "", "Error: .: is not a regular file.\n")


def test_job_of_endless_name(folder: Path) -> None:
    said = run("check", "x" * 5000)
    assert (said.code, said.out) == (1, "")
    assert said.err.endswith(": cannot be read (File name too long).\n")


def test_job_larger_than_any(folder: Path) -> None:
    write(JOB, b"#" * 1_000_001)(folder)
    assert run("check", JOB).err == "Error: calibration.toml: is larger than 1000000 bytes.\n"


def test_name_cannot_command_the_terminal(folder: Path) -> None:
    said = run("check", "\x1b[2J\r\n[bold]\udcff.toml")
    assert said == (1, "", "Error: \\x1b[2J\\r\\n[bold]\\udcff.toml: there is no such file.\n")


# The folder of results. -------------------------------------------------------------------------------------------


def refused(folder: Path, out: str, why: str) -> None:
    before = tree(folder)
    assert run("calibrate", JOB, "-o", out) == (1, "", f"Error: {why}\n")
    assert tree(folder) == before


def test_out_holds_the_inputs(folder: Path) -> None:
    copy_case(folder / "case")
    before = tree(folder)
    said = run("calibrate", f"case/{JOB}", "-o", "case")
    why = f"{folder}/case: holds the input 'calibration.toml', which results never replace; choose another."
    assert said == (1, "", f"Error: {why}\n")
    assert tree(folder) == before


def test_out_holds_an_input_behind_a_link(folder: Path) -> None:
    (folder / "real").mkdir()
    (folder / URDF).rename(folder / "real" / URDF)
    (folder / URDF).symlink_to(folder / "real" / URDF)
    why = f"{folder}/real: holds the input 'arm_cmm.urdf', which results never replace; choose another."
    refused(folder, "real", why)


def test_out_holds_an_input_that_is_called_otherwise(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a mount, or in other capitals where these count for nothing: no name of both is the same then."""
    assert run("calibrate", JOB, "-o", "out").code == 0
    (folder / TABLE).rename(folder / "out" / "residuals.csv")
    job((f'"{TABLE}"', '"mounted/residuals.csv"'))(folder)
    (folder / "mounted").symlink_to("out")
    monkeypatch.setattr(Path, "resolve", Path.absolute)  # as of what is no link
    why = f"{folder}/out: holds the input 'residuals.csv', which results never replace; choose another."
    refused(folder, "out", why)


def test_out_is_an_input(folder: Path) -> None:
    refused(folder, TABLE, f"{folder}/{TABLE}: holds the input '{TABLE}', which results never replace; choose another.")


def test_out_is_a_file(folder: Path) -> None:
    write("out", "mine")(folder)
    refused(folder, "out", f"{folder}/out: is a file, and the results need a folder.")


def test_out_below_a_file(folder: Path) -> None:
    write("file", "mine")(folder)
    refused(folder, "file/a/out", f"{folder}/file/a/out: cannot be made, as {folder}/file is a file.")


def test_out_is_somebody_elses(folder: Path) -> None:
    (folder / "out").mkdir()
    write("out/thesis.tex", "mine")(folder)
    refused(
        folder,
        "out",
        f"{folder}/out: holds 'thesis.tex', which is no result of this toolkit, and results replace the whole folder; "
        "choose another.",
    )


def test_out_is_a_folder_of_another_tool(folder: Path) -> None:
    (folder / "out").mkdir()
    write("out/result.json", "{}")(folder)
    why = f"{folder}/out: is not empty and holds no whole results of this toolkit; choose another folder."
    refused(folder, "out", why)
    for model in ('{"weights": [1, 2]}', "[]", "mine"):
        write("out/model.json", model)(folder)
        refused(folder, "out", why)
        assert (folder / "out/model.json").read_text(encoding="utf-8") == model


@pytest.mark.parametrize("kind", ["link", "folder", "pipe"])
def test_out_holds_what_is_called_as_a_result_and_is_none(folder: Path, kind: str) -> None:
    write("thesis.tex", "mine")(folder)
    (folder / "out").mkdir()
    for name in ("result.json", "model.json"):
        write(f"out/{name}", "{}")(folder)
    match kind:
        case "link":
            (folder / "out" / "report.md").symlink_to(folder / "thesis.tex")
        case "folder":
            (folder / "out" / "report.md").mkdir()
        case _:
            os.mkfifo(folder / "out" / "report.md")
    refused(
        folder,
        "out",
        f"{folder}/out: holds 'report.md', which is no result of this toolkit, and results replace the whole folder; "
        "choose another.",
    )


def test_out_is_where_the_user_stands(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "out").mkdir()
    monkeypatch.chdir(folder / "out")
    said = run("calibrate", f"../{JOB}", "-o", ".")
    why = f"{folder}/out: is the current folder or holds it, and is replaced as a whole; choose another."
    assert said == (1, "", f"Error: {why}\n")


def test_out_in_a_circle_of_links(folder: Path) -> None:
    (folder / "out").symlink_to("out")
    said = run("calibrate", JOB, "-o", "out")
    assert (said.code, said.out) == (1, "")
    assert said.err.startswith("Error: ")
    assert said.err.count("\n") == 1


def test_out_of_endless_name(folder: Path) -> None:
    said = run("calibrate", JOB, "-o", "x" * 300)
    assert (said.code, said.out) == (1, "")
    assert said.err.endswith(": cannot hold the results (File name too long).\n")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_out_in_a_read_only_folder(folder: Path) -> None:
    (folder / "closed").mkdir(mode=0o500)
    refused(folder, "closed/out", f"{folder}/closed/out: cannot be written, as {folder}/closed is read-only.")


def test_out_of_another_user_where_nobody_else_may_replace_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = folder / "shared" / "out"
    out.mkdir(parents=True)
    out.parent.chmod(0o1777)
    monkeypatch.setattr(os, "geteuid", lambda: out.stat().st_uid + 1)
    why = f"belongs to another user, and in {out.parent} (sticky) nobody else may replace it; choose another folder."
    refused(folder, "shared/out", f"{out}: {why}")


def test_out_with_files_of_another_user_that_nobody_else_may_remove(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They would have stayed for ever in a hidden folder that their user cannot enter."""
    out = folder / "out"
    out.mkdir(mode=0o777)
    out.chmod(0o1777)
    (out / "result.json").write_text("{}")
    monkeypatch.setattr(os, "geteuid", lambda: out.stat().st_uid + 1)
    why = "of another user, and in it (sticky) nobody else may replace that; choose another folder."
    refused(folder, "out", f"{out}: holds 'result.json' {why}")


def test_out_where_the_system_says_read_only(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != folder)
    refused(folder, "a/out", f"{folder}/a/out: cannot be written, as {folder} is read-only.")
