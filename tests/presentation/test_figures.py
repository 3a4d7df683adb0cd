"""The pictures of the docs: every shipped case has them, the page shows them, and the script makes them."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from calib.presentation.scene import render_scene
from scripts.benchmarks import first_picture
from scripts.development import screenshots as script
from scripts.development.browser import CHROMIUM
from tests.support.cases import CASE, JOB, ROOT


def test_every_case_has_its_pictures_and_the_page_shows_them() -> None:
    page = (ROOT / "docs" / "seeing.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"\(figures/(\w+\.png)\)", page))
    made = {
        f"{kind}_{script.name_of(job)}.png"
        for job in ROOT.glob("robots/*/calibration*.toml")
        for kind in ("scene", "report", "phone")
    }
    assert shown == made
    pages = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md"))
    assert {file.name for file in (ROOT / "docs/figures").iterdir()} == set(
        re.findall(r"\(figures/(\w+\.\w+)\)", pages)
    )
    assert sum(file.stat().st_size for file in (ROOT / "docs/figures").glob("*.png")) < 3_000_000


def test_a_thousand_poses_of_a_robot_with_meshes_stay_below_fifteen_megabytes() -> None:
    text = render_scene(first_picture.scene(1000))
    assert "1000 points" in text
    assert "not found" not in text.partition('<div id="legend">')[2].partition("<script")[0]
    assert len(text) < first_picture.MOST_BYTES == 15_000_000


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on the path")
def test_script_makes_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image

    monkeypatch.setattr(sys, "argv", ["screenshots", str(CASE / JOB), "--to", str(tmp_path)])
    assert script.main() == 0
    sizes = {}
    for file in sorted(tmp_path.iterdir()):
        with Image.open(file) as image:
            sizes[file.name] = image.size
            assert len(np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)) > 50  # something is drawn
    assert sizes == {
        "phone_arm_cmm.png": (3 * 390 + 48, 844),
        "report_arm_cmm.png": (1280, 1900),
        "scene_arm_cmm.png": (1280, 800),
    }
