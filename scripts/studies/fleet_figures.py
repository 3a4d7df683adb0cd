"""Calibrate the shipped cases as a fleet, with a job that fails, and make the table and the picture of docs/fleet.md.

python scripts/studies/fleet_figures.py
"""

import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from calib.foundations.files import write_atomically
from calib.job.fleet import PAGE, fleet_jobs, run_fleet
from calib.job.fleet_summary import fleet_lines, write_summary
from calib.presentation.fleet_tables import fleet_sentence, fleet_sheet
from calib.presentation.tables import plain, sheet_table
from scripts.development.browser import browser
from scripts.development.screenshots import picture, save

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / "docs" / "fleet.md"
FIGURE = ROOT / "docs" / "figures" / "fleet.png"
BEGIN, END = "<!-- scripts/studies/fleet_figures.py -->", "<!-- end -->"
SIZE = (1280, 1100)


def main() -> int:
    os.chdir(ROOT)
    jobs = [*sorted(Path("robots").glob("*/calibration*.toml")), Path("robots/ur99/calibration.toml")]
    with TemporaryDirectory() as folder, browser() as page:
        out = Path(folder, "fleet")
        lines = fleet_lines(run_fleet(fleet_jobs(jobs, out)))
        write_summary(lines, out)
        save(picture(page, out / PAGE, SIZE), FIGURE)
        trouble = page.trouble
    text = plain(sheet_table(fleet_sheet(lines))).rstrip()
    why = [f"Warning: {line.name}: {line.word}: {' '.join(line.why)}" for line in lines if line.why]
    shown = [f"    {row}".rstrip() for row in (*text.splitlines(), *why, fleet_sentence(lines))]
    before, _, rest = DOCUMENT.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    write_atomically(DOCUMENT, "\n".join([f"{before}{BEGIN}", "", *shown, "", f"{END}{after}"]))
    print(*trouble, sep="\n", file=sys.stderr)
    return bool(trouble)


if __name__ == "__main__":
    sys.exit(main())
