"""The script that compares what two checkouts read: a difference is told, and numbers that are not those written."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from scripts.development.compare_readers import main, other_numbers
from scripts.development.made_tables import Made, made
from tests.support.cases import ROOT


@pytest.fixture
def other(tmp_path: Path) -> Path:
    """A checkout in which one sentence is another."""
    tree = tmp_path / "other"
    shutil.copytree(ROOT / "calib", tree / "calib", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "calib_start", tree / "calib_start", ignore=shutil.ignore_patterns("__pycache__"))
    sheet = tree / "calib" / "measurement" / "formats" / "sheet.py"
    text = sheet.read_text(encoding="utf-8")
    assert "has a header and no rows" in text
    sheet.write_text(text.replace("has a header and no rows", "is all header"), encoding="utf-8")
    return tree


def test_two_checkouts_are_compared_file_by_file(
    other: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = tmp_path / "files"
    files.mkdir()
    (files / "none.csv").write_text("J1,J2\n")
    (files / "some.csv").write_text("J1,J2\n1,2\n")
    only = ["--only", "sheet,raw,table", "--made", "3"]
    assert main([str(ROOT), str(other), str(files), *only]) == 1
    said = capsys.readouterr().out
    assert f"sheet: refused, and now refused: 1\n  {files / 'none.csv'}\n" in said
    assert "is all header" in said
    assert "5 files; 1 outcomes differ" in said
    assert main([str(ROOT), str(ROOT), str(files), *only]) == 0


def test_a_made_table_is_the_same_every_time_and_its_numbers_are_known() -> None:
    assert made(7).data == made(7).data
    one = Made("a.csv", b"", np.arange(18.0).reshape(2, 9))
    rows = ",".join(str([str(float(k + 9 * i)) for k in range(9)]).replace("'", '"') for i in range(2))
    assert other_numbers(one, ("read", f'{{"rows": [{rows}]}}')) is None
    assert other_numbers(one, ("refused", "no")) is None
    wrong = rows.replace("17.0", "1.70")
    assert "column 9" in str(other_numbers(one, ("read", f'{{"rows": [{wrong}]}}')))
