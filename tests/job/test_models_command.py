"""``calib models``: a table for a person, a document for a program, one sentence for what is wrong."""

import json
import re
from pathlib import Path

import pytest

from tests.support.cases import CASE, JOB, TABLE, append, copy_case, job, keep_rows, run, tree


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    copy_case(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_table_of_the_arm_cmm_recommends_placements(folder: Path) -> None:
    before = tree(folder)
    code, out, err = run("models", JOB, "--folds", "4")
    assert (code, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    names = re.findall(r"^  (base and tool|offsets|placements|joint terms) +(\d+) +(\d+) ", out, re.M)
    assert names[:3] == [("base and tool", "9", "9"), ("offsets", "15", "13"), ("placements", "45", "27")]
    assert "Recommended: placements (27 directions are determined)" in out
    assert "60 rows in 60 groups, 4 folds" in out
    assert tree(folder) == before


def test_the_document_tells_every_model(folder: Path) -> None:
    append("", ('offsets = "all"', 'offsets = ["joint_1"]'), ('placements = "all"', ""))(folder)
    code, out, err = run("models", JOB, "--folds", "3", "--json")
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert (found["rows"], found["groups"], found["folds"], found["unit"]) == (60, 60, 3, "m")
    models = {m["name"]: m for m in found["models"]}
    assert set(models) == {"base and tool", "offsets", "placements", "joint terms", "as in the job"}
    assert models["as in the job"]["parameters"] == 10
    assert found["recommended"] == "placements"
    assert [m["name"] for m in found["models"] if m["recommended"]] == ["placements"]
    best = min(models.values(), key=lambda m: m["held_out"])
    for m in models.values():
        assert m["rms"]["position"]["rms"] == pytest.approx(m["held_out"])
        assert m["difference"] == pytest.approx(m["held_out"] - best["held_out"])
    assert models["placements"]["held_out"] < 1e-4 < models["offsets"]["held_out"]


def test_terms_that_surely_help_are_recommended() -> None:
    """An arm with encoders a little off centre: each harmonic hardly shows, all of them together do."""
    code, out, _ = run("models", CASE / "calibration_realistic.toml", "--folds", "3")
    assert code == 0
    figures = dict(re.findall(r"^  (placements|joint terms) +\d+ +\d+ +(\S+)", out, re.M))
    assert float(figures["joint terms"]) < 0.95 * float(figures["placements"])
    assert "joint_1.cos_1" in out
    assert "Recommended: joint terms" in out


def test_each_group_by_itself_and_quiet(folder: Path) -> None:
    keep_rows(TABLE, 40)(folder)
    *comments, header = [line for line in lines(TABLE) if line.startswith("#") or "joint_1" in line]
    rows = [f"{line}, {'abc'[k % 3]}" for k, line in enumerate(lines(TABLE)[len(comments) + 1 :])]
    Path(TABLE).write_text("\n".join([*comments, f"{header}, group", *rows, ""]), encoding="utf-8")
    code, out, err = run("models", JOB, "--leave-one-group-out")
    assert (code, err) == (0, "")
    assert "40 rows in 3 groups, 3 folds" in out
    assert run("models", JOB, "--leave-one-group-out", "--quiet") == (0, "", "")


def lines(name: str) -> list[str]:
    return Path(name).read_text(encoding="utf-8").splitlines()


def test_what_cannot_be_identified_is_told(folder: Path) -> None:
    keep_rows(TABLE, 9)(folder)
    code, out, _ = run("models", JOB, "--folds", "3")
    assert code == 0
    assert "Warning: placements: " in out
    assert "Recommended: offsets" in out


def test_wrong_options_are_one_sentence(folder: Path) -> None:
    code, out, err = run("models", JOB, "--folds", "4", "--leave-one-group-out")
    assert (code, out) == (1, "")
    assert err == ("Error: folds: each group is held out by itself; leave out --folds or --leave-one-group-out.\n")
    assert run("models", JOB, "--folds", "1").code == 2
    job(('sigma = "0.02 mm"', 'sigma = "0.02"'))(folder)
    assert run("models", JOB).code == 1
