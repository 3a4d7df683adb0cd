"""The page of a fleet as a person meets it: sorted by a click, without a network, readable on a phone."""

from pathlib import Path

import pytest

from calib.presentation.fleet_tables import JobLine, QuantityError, fleet_report
from calib.presentation.report.page import render_page
from scripts.development.browser import CHROMIUM, browser

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on the path")

AFTER = {"beta": 2e-4, "gamma": 1e-3, "alpha10": 5e-5, "alpha9": 3e-4}


def line(name: str, after: float) -> JobLine:
    errors = (QuantityError("position", "m", 9, 2e-3, after, 3 * after),)
    return JobLine(name, f"{name}.toml", "trusted", (), "validation", errors, 30, 36, 0, f"{name}/report.html")


def test_a_click_on_a_head_sorts(tmp_path: Path) -> None:
    lines = [line(name, after) for name, after in AFTER.items()]
    lines.append(JobLine("failed one", "x.toml", "failed", ("There is no such file.",)))
    file = tmp_path / "fleet.html"
    file.write_text(render_page(fleet_report(lines)), encoding="utf-8")
    names = "[...document.querySelectorAll('.sortable tbody tr')].map(row => row.cells[0].textContent)"
    with browser() as page:
        page.size(390, 844)
        page.open(file.as_uri())
        assert page.evaluate(names) == [*AFTER, "failed one"]

        def click(head: str) -> list[str]:
            page.evaluate(
                f"[...document.querySelectorAll('.sortable th')].find(h => h.textContent === '{head}')"
                ".querySelector('button').click(), true"
            )
            return list(page.evaluate(names))

        assert click("after [mm]") == ["alpha10", "beta", "alpha9", "gamma", "failed one"]
        assert click("after [mm]") == ["gamma", "alpha9", "beta", "alpha10", "failed one"]
        assert click("job") == ["alpha9", "alpha10", "beta", "failed one", "gamma"]
        assert page.evaluate("document.querySelector('th[aria-sort]').textContent") == "job"
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert page.evaluate("document.querySelector('.sortable a').getAttribute('href')") == "alpha9/report.html"
        assert (page.trouble, page.requests) == ([], [file.as_uri()])
