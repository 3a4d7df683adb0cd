"""The committed page of the two papers is what the script makes."""

import subprocess
import sys
from pathlib import Path

import pytest

from scripts.studies import arm_cmm_tables as script

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts/studies/arm_cmm_tables.py"
PAGE = ROOT / "docs" / "arm_cmm_papers.md"
FIGURE = Path("figures") / "arm_cmm_sensitivity.svg"


def test_page_is_what_the_script_makes(tmp_path: Path) -> None:
    made = tmp_path / PAGE.name
    subprocess.run([sys.executable, str(SCRIPT), "--markdown", str(made)], check=True, capture_output=True)
    assert made.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")
    # The figure's bytes follow the version of matplotlib; what it says does not.
    for folder in (tmp_path, PAGE.parent):
        drawn = (folder / FIGURE).read_text(encoding="utf-8")
        assert all(f">{name}</text>" in drawn for name in ("joint_2.offset", "joint_1.a", "handle_mount.d"))


def test_tables_on_a_terminal_are_whole(capsys: pytest.CaptureFixture[str]) -> None:
    paper = script.read("zero_offsets.toml")
    found = script.simulations(paper, script.arm(paper))
    script.show([script.touched_sheet(found), script.step_sheet(found), script.step_remarks(found)])
    script.show(script.error_model(script.read("error_model.toml")))
    said = capsys.readouterr().out
    for words in ("39.3030", "theta_1 = 0 is missing in print", "joint_6.alpha", "errors of angle are amplified"):
        assert words in said
    assert "…" not in said
