"""The table of expected errors is reproduced, its page holds what the script found, a real positioner gets better."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

from scripts.examples import positioner_camera_job as camera
from scripts.studies import positioner_errors as script
from tests.support.cases import run

ROOT = Path(__file__).resolve().parents[2]
DATASETS = os.environ.get("CALIB_DATASETS")


@pytest.mark.parametrize("k", range(8))
def test_row_of_the_table(k: int) -> None:
    row = script.ROWS[k]
    fitted = row.evaluate is script.fitted
    rms, foretold = script.study(row, 100 if fitted else 300)
    assert rms == pytest.approx(row.published, rel=0.1)
    if fitted:
        assert foretold == pytest.approx(row.published, rel=0.1)


def test_page_holds_a_thousand_trials_a_row() -> None:
    page = (ROOT / "docs" / "positioner.md").read_text(encoding="utf-8")
    assert "1000 simulated" in re.sub(r"\s+", " ", page)
    for row in script.ROWS:
        found = re.search(rf"^\| {re.escape(row.name)} \| ([0-9.]+) \|", page, re.MULTILINE)
        assert found is not None
        assert float(found[1]) == pytest.approx(row.published, rel=0.1)


@pytest.mark.skipif(DATASETS is None, reason="CALIB_DATASETS does not name a folder with positioner_camera")
def test_real_positioner_over_ten_splits() -> None:
    found = script.splits(Path(str(DATASETS)) / "positioner_camera")
    assert found.shape == (10, 4)
    _, _, rms, degrees = found.mean(axis=0)
    assert rms <= 0.43
    assert degrees <= 0.052
    assert np.count_nonzero(found[:, 2] < found[:, 0]) >= 9


@pytest.mark.skipif(DATASETS is None, reason="CALIB_DATASETS does not name a folder with positioner_camera")
def test_job_of_a_real_positioner_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "job"
    monkeypatch.setattr("sys.argv", ["job", str(Path(str(DATASETS)) / "positioner_camera"), str(folder)])
    assert camera.main() == 0
    said = run("calibrate", folder / "calibration.toml", "-o", tmp_path / "out")
    assert (said.code, said.err) == (0, "")


def test_other_folders_are_no_dataset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["job", str(tmp_path), str(tmp_path / "job")])
    assert camera.main() == 1
    assert "it has no measurements.yaml" in capsys.readouterr().err
    (tmp_path / "measurements.yaml").write_text("'1':\n  pose:\n    x: one\n", encoding="utf-8")
    assert camera.main() == 1
    assert "measurements.yaml:3: '    x: one' is not what this script reads" in capsys.readouterr().err
    assert not (tmp_path / "job").exists()
