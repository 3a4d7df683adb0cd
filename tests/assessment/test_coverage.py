"""Stated 95 % regions hold the truth as often as they say; the page of docs/ has it in cells, of many sessions each."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from scripts.studies import coverage
from scripts.studies.store import simulate, stored

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    "cell",
    ["ur5 white 60", "panda harmonics_0.15 60", "ur5 wind_up 60", "panda strong_wind_up 60", "ur5 gross 60"],
)
def test_regions_hold_the_truth_where_the_model_leaves_things_out(cell: str) -> None:
    told = [coverage.session(cell, seed) for seed in range(1000, 1006)]
    assert np.mean([one.inside for one in told]) > 0.9
    ratio = np.sqrt(np.sum([one.stated**2 for one in told]) / np.sum([one.true**2 for one in told]))
    assert 0.7 < ratio < 1.8


def test_intervals_of_the_four_bar_hold_with_the_whole_budget_only() -> None:
    held = [coverage.session("irb2400 grid", seed).intervals for seed in range(2)]
    assert all(arm["k1 with the budget"] for arm in held)
    assert not all(arm["k1"] for arm in held)


def test_a_store_is_resumed_and_read_once(tmp_path: Path) -> None:
    store = tmp_path / "sessions.jsonl"
    simulate(store, ["ur5 white 20"], 2, float("inf"), coverage.figures)
    first = store.read_text()
    simulate(store, ["ur5 white 20"], 2, float("inf"), coverage.figures)
    assert store.read_text() == first
    store.write_text(first + first)
    assert [told["seed"] for told in stored(store, coverage.cells())["ur5 white 20"]] == [0, 1]
    refused = json.dumps({"cell": "ur5 white 60", "seed": 0, "refused": "why"})
    store.write_text(f"{first}{refused}\n")
    text = coverage.page(stored(store, coverage.cells()))
    assert "2 simulated sessions in 57 cells" in text
    assert "1 were refused" in text
    assert "| UR5, 60 poses | 0 | | | | | | | not run |" in text


def test_the_page_has_every_cell_and_says_what_holds() -> None:
    text = (ROOT / "docs/coverage.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\w.*?) \| (\d+) \| ([\d.]+) \| ([\d.]+) % \| .* \| (yes|no: .*) \|$", text, re.MULTILINE)
    assert len(rows) == len(coverage.cells())
    for row in rows:
        lacking = float(row[2]) < coverage.LEAST_COVERAGE or float(row[3]) > 100.0 * coverage.MOST_BAD
        assert not (row[4] == "yes" and lacking), row
