"""Take the pictures of the page of ``calib app`` that docs/app.md shows, with the simulated recordings of a Panda.

python scripts/development/app_pictures.py [--to docs/figures]
"""

import argparse
import asyncio
import sys
import threading
from pathlib import Path
from queue import Queue
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from PIL import Image

from calib.app.server import serve
from scripts.development.browser import browser
from scripts.development.screenshots import PHONE, ROOT, WIDE, save

RECORDINGS = ROOT / "robots" / "panda_sockets" / "recordings" / "raised"
ROBOT = "example:panda_description/urdf/panda.urdf"
_SETTLED = "state && !state.busy && (state.look || state.sentence)"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--to", type=Path, default=ROOT / "docs" / "figures")
    arguments = parser.parse_args()
    addresses: Queue[str] = Queue()
    serving = threading.Thread(target=lambda: asyncio.run(serve(None, 0, addresses.put)), daemon=True)
    serving.start()
    with TemporaryDirectory() as folder, browser() as page:
        page.size(*WIDE)
        page.open(addresses.get(timeout=60))
        page.drop("#drop", sorted(RECORDINGS.glob("hole_*.csv")))
        for element, value in (("robot", ROBOT), ("stack", "on")):
            page.wait_for(f"{_SETTLED} && document.querySelectorAll('#robot option').length > 5")
            change = f"byId('{element}').{'checked = true' if value == 'on' else f'value = {value!r}'}"
            page.evaluate(
                f"window.before = state, {change}, byId('{element}').dispatchEvent(new Event('change')), true"
            )
            page.wait_for("state !== window.before")
        page.wait_for(f"{_SETTLED} && !byId('calibrate').disabled")
        page.evaluate("byId('calibrate').click(), true")
        page.wait_for("!state.busy && state.results && (document.activeElement.blur(), true)")
        for name, size, scheme in (("app", WIDE, "light"), ("phone_app", PHONE, "dark")):
            page.size(*size)
            page.media(prefers_color_scheme=scheme)
            shot = Path(folder, "shot.png")
            page.screenshot(shot, whole=True)
            save(Image.open(shot).convert("RGB"), arguments.to / f"{name}.png")
        if page.trouble:
            print(*page.trouble, sep="\n", file=sys.stderr)
    return bool(page.trouble)


if __name__ == "__main__":
    sys.exit(main())
