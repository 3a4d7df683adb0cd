"""Calibrate every shipped case and take the pictures of its scene and its report that docs/seeing.md shows.

    python scripts/development/screenshots.py [--to docs/figures] [CASE ...]

A case is a job file below robots/, such as robots/irb2400/calibration.toml; all of them where none is named.
"""

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from PIL import Image

from calib.job.inputs import load
from calib.job.run import run
from calib.results.folder import REPORT_FILE, SCENE_FILE, write_results
from scripts.development.browser import Page, browser

ROOT = Path(__file__).resolve().parents[2]
WIDE, LONG, PHONE = (1280, 800), (1280, 1900), (390, 844)
_GAP = 24


def name_of(job: Path) -> str:
    """Return the name of a case in file names: its folder, and what its job is called beyond "calibration"."""
    return "_".join([job.parent.name, *filter(None, [job.stem.removeprefix("calibration").strip("_")])])


def picture(page: Page, file: Path, size: tuple[int, int], *, dark: bool = False, ready: str = "true") -> Image.Image:
    """Return what a page shows in a window of a size."""
    with TemporaryDirectory() as folder:
        shot = Path(folder, "shot.png")
        page.size(*size)
        page.media(prefers_color_scheme="dark" if dark else "light")
        page.open(file.as_uri())
        page.evaluate(ready)
        page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))")
        page.screenshot(shot)
        return Image.open(shot).convert("RGB")


def beside(pictures: list[Image.Image]) -> Image.Image:
    """Return pictures of one height next to each other."""
    width = sum(p.width for p in pictures) + _GAP * (len(pictures) - 1)
    out = Image.new("RGB", (width, pictures[0].height), "white")
    left = 0
    for p in pictures:
        out.paste(p, (left, 0))
        left += p.width + _GAP
    return out


def save(image: Image.Image, file: Path, *, exact: bool = False) -> None:
    """Write a picture in 256 colours, a third of the bytes, or ``exact``: few colours of a scene are what it means."""
    (image if exact else image.quantize(256, dither=Image.Dither.NONE)).save(file, optimize=True)
    print(f"{file.name}: {file.stat().st_size // 1000} kB")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", type=Path, metavar="CASE")
    parser.add_argument("--to", type=Path, default=ROOT / "docs" / "figures")
    arguments = parser.parse_args()
    jobs = arguments.cases or sorted(ROOT.glob("robots/*/calibration*.toml"))
    with TemporaryDirectory() as folder, browser() as page:
        for job in jobs:
            name, out = name_of(job), Path(folder, name_of(job))
            write_results(run(load(job)), out)
            save(picture(page, out / SCENE_FILE, WIDE), arguments.to / f"scene_{name}.png", exact=True)
            save(picture(page, out / REPORT_FILE, LONG), arguments.to / f"report_{name}.png")
            phone = [
                picture(page, out / REPORT_FILE, PHONE),
                picture(page, out / REPORT_FILE, PHONE, dark=True, ready="distribution.scrollIntoView(), true"),
                picture(page, out / SCENE_FILE, PHONE),
            ]
            save(beside(phone), arguments.to / f"phone_{name}.png")
        if page.trouble:
            print(*page.trouble, sep="\n", file=sys.stderr)
    return bool(page.trouble)


if __name__ == "__main__":
    sys.exit(main())
