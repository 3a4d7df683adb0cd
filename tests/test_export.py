"""``calib export`` as a person meets it, and the call of docs/controllers.md as a program does."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib import dh
from tests.support.cases import JOB, copy_case, edit, run, tree

DOCS = (Path(__file__).resolve().parents[1] / "docs" / "controllers.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export")
    copy_case(folder)
    assert run("calibrate", folder / JOB, "-o", folder / "out", "-q").code == 0
    return folder / "out"


@pytest.fixture
def folder(results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "out").symlink_to(results)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_offsets(folder: Path) -> None:
    said = run("export", "out", "--to", "offsets", "-o", "offsets.csv")
    assert (said.code, said.err) == (0, "")
    text = (folder / "offsets.csv").read_text(encoding="utf-8")
    alone = re.search(r"with these offsets alone ([0-9.]+) mm", text)
    assert alone is not None
    words = " ".join(said.out.split())
    assert f"Warning: placements: not in the file; this moves the tip by {alone[1]} mm rms." in words
    assert f"the machine of the file {alone[1]} mm rms." in words
    assert words.endswith("Read back and compared; the file is offsets.csv.")


def test_others_without_a_word(folder: Path) -> None:
    assert run("export", "out", "--to", "dh", "-o", "table.csv", "-q") == (0, "", "")
    assert [row.joint for row in dh.read_dh("table.csv").rows][:2] == ["joint_1", "joint_2"]
    said = run("export", "out", "--to", "ros", "-o", "machine.yaml", "--json")
    contents = json.loads(said.out)
    assert (said.code, contents["file"], [left["part"] for left in contents["left_out"]]) == (
        0,
        "machine.yaml",
        ["placements"],
    )
    assert contents["left_out"][0]["cost"] == pytest.approx(contents["lost"], rel=1e-9)
    assert contents["lost"] < contents["before"]
    read = yaml.safe_load((folder / "machine.yaml").read_text(encoding="utf-8"))
    assert len(read["calibration"]["joints"]) == 6


def test_corrected_table_of_the_results_is_taken(folder: Path) -> None:
    copy_case(folder / "job")
    edit(JOB, ('placements = "all"', 'dh = "all"\ndh_convention = "modified"'))(folder / "job")
    assert run("calibrate", folder / "job" / JOB, "-o", "by_dh", "-q").code == 0
    assert run("export", "by_dh", "--to", "dh", "-o", "table.csv", "-q").code == 0
    assert (folder / "table.csv").read_bytes() == (folder / "by_dh" / "calibrated_dh.csv").read_bytes()
    # A table of another machine beside the model is not handed out.
    table = (folder / "by_dh" / "calibrated_dh.csv").read_text(encoding="utf-8")
    (folder / "by_dh" / "calibrated_dh.csv").write_text(table.replace("a [mm]", "a [cm]"), encoding="utf-8")
    said = run("export", "by_dh", "--to", "dh", "-o", "other.csv")
    assert (said.code, said.out, (folder / "other.csv").exists()) == (1, "", False)
    assert "by_dh: cannot be exported to dh: the file read back differs from the calibrated machine by" in said.err


def test_nothing_is_written_over_or_in_spite_of_an_error(folder: Path, results: Path) -> None:
    before = tree(results)
    for name in ("model.json", "calibrated.urdf"):
        said = run("export", "out", "--to", "offsets", "-o", f"out/{name}")
        assert said == (1, "", f"Error: out/{name}: already exists; choose another name.\n")
    said = run("export", "out", "--to", "ur", "-o", "ur.yaml")
    assert (said.code, said.out) == (1, "")
    assert said.err.startswith("Error: out: cannot be exported to ur: ")
    assert said.err.count("\n") == 1
    assert run("export", "out", "--to", "abb", "-o", "x").code == 2
    assert tree(results) == before
    assert [path.name for path in folder.iterdir()] == ["out"]


def test_the_documented_call(folder: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", DOCS, re.DOTALL)
    names: dict[str, np.ndarray] = {}
    exec(compile(code, "docs/controllers.md", "exec"), names)
    assert np.abs(names["there"] - names["poses"]).max() < 1e-5
    assert np.abs(names["commands"] - names["wanted"]).max() > 1e-3
