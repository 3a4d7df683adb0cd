"""Stated 95 % regions hold the truth as often as they say; the page of docs/ has it with a thousand calibrations."""

import re
from pathlib import Path

import numpy as np
import pytest

from scripts.studies import coverage

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("number", range(4))
def test_regions_hold_the_truth(number: int) -> None:
    counts = coverage.cover(coverage.KINDS[number], 60, seed=5)
    # Parameters of one calibration err together: 60 of them see the share to about two in a hundred.
    assert 0.92 < counts.parameters / counts.of_parameters < 0.98
    assert 0.90 < counts.poses / counts.of_poses < 0.99


def test_the_page_is_what_the_script_writes_and_within_bounds() -> None:
    text = (ROOT / "docs/coverage.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.*?) \| ([\d.]+) % \| ([\d.]+) % \|$", text, re.MULTILINE)
    assert [row[0] for row in rows] == [kind.title for kind in coverage.KINDS]
    shares = np.array([[float(share) for share in row[1:]] for row in rows])
    assert np.all((shares > 93.0) & (shares < 97.0))
    assert text.startswith("# Do stated regions hold the truth?\n\n1000 simulated calibrations")
