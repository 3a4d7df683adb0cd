"""How long a scene takes to its first picture, compared with an empty scene of meshcat in the same browser.

    python scripts/benchmarks/first_picture.py [--poses 1000] [--times 7]

Prints the shortest times and their ratio, how many pictures a second can be drawn of the whole scene, and how many are
drawn while it is turned or played: a machine without a graphics card then draws less. Other work on the machine slows
this down, so the processor time of a picture is told as well, and that of a picture of the empty scene. Exits with 1
where the ratio is above 3 or the page above 15 MB.
"""

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import meshcat
import numpy as np
import psutil

from calib.presentation.scene import Scene, render_scene
from calib.robot.links import arm_of
from calib.robot.load import load_robot
from calib.robot.sources import examples_folder
from scripts.development.browser import Page, browser

MOST_RATIO = 3.0
MOST_BYTES = 15_000_000
# What meshcat's own static_html() writes around its commands, without any.
EMPTY = """<!DOCTYPE html><html><head><meta charset=utf-8><title>MeshCat</title></head><body>
<div id="meshcat-pane"></div><script>{viewer}</script>
<script>var viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));</script>
<style>body {{margin: 0; }} #meshcat-pane {{ width: 100vw; height: 100vh; overflow: hidden; }}</style></body></html>"""
# The frame after loading has a picture of the right size; reading a pixel waits until WebGL has drawn it.
DRAWN = """addEventListener("load", () => requestAnimationFrame(() => {
  const gl = viewer.renderer.getContext(), pixel = new Uint8Array(4);
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  window.drawn = viewer.renderer.info.render.frame > 0 && performance.now();
}));"""
# Every picture from another side; reading a pixel waits until it is drawn. The median of some, in ms.
TURNED = """new Promise(done => {
  const gl = viewer.renderer.getContext(), pixel = new Uint8Array(4), times = [];
  for (let k = 0; k < 30; k++) {
    const start = performance.now(), a = k / 5;
    camera.position.copy(viewer.controls.target).add(new THREE.Vector3(3 * Math.cos(a), 1.5, 3 * Math.sin(a)));
    camera.lookAt(viewer.controls.target);
    viewer.render();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    times.push(performance.now() - start);
  }
  done(times.sort((a, b) => a - b)[15]);
})"""

# As it is turned by hand, a step a picture; the pictures and the seconds, once all are drawn.
MOVED = """new Promise(done => {
  const { camera, renderer } = viewer, { Vector3 } = MeshCat.THREE, begun = performance.now();
  const gl = renderer.getContext(), first = renderer.info.render.frame;
  let a = 0;
  requestAnimationFrame(function turn(now) {
    a += 0.05;
    camera.position.copy(viewer.controls.target).add(new Vector3(3 * Math.cos(a), 1.5, 3 * Math.sin(a)));
    viewer.controls.update();
    viewer.set_dirty();
    if (now - begun < %d) { requestAnimationFrame(turn); return; }
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    done([renderer.info.render.frame - first, (performance.now() - begun) / 1000]);
  });
})"""
# The same of the poses one after the other.
PLAYED = """new Promise(done => {
  const begun = performance.now(), gl = viewer.renderer.getContext(), first = viewer.renderer.info.render.frame;
  if (!playing) play.click();
  requestAnimationFrame(function wait(now) {
    if (now - begun < %d) { requestAnimationFrame(wait); return; }
    play.click();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    done([viewer.renderer.info.render.frame - first, (performance.now() - begun) / 1000]);
  });
})"""


def scene(poses: int) -> Scene:
    """Return a Panda with its meshes at random poses, with random errors."""
    rng = np.random.default_rng(0)
    robot = load_robot("example:panda_description/urdf/panda.urdf", "panda_link8")
    low, high = (np.array([getattr(reading, end) for reading in robot.readings]) for end in ("lower", "upper"))
    arm = arm_of(robot, robot.no_deviations(), rng.uniform(low, high, (poses, len(low))), np.eye(4))
    measured = rng.uniform(-0.8, 0.8, (poses, 3))
    before, after = (measured + rng.normal(scale=s, size=(poses, 3)) for s in (2e-3, 1e-4))
    rows = tuple(f"poses.csv line {n}" for n in range(poses))
    roots = (examples_folder().parents[1],)
    return Scene(
        *("Panda", robot.urdf, roots, arm, arm, 20.0, {"tool": np.array([0.0, 0.0, 0.1])}, "panda_link8"),
        *(rows, measured, before, after, (20.0, 500.0)),
    )


def first_picture(page: Page, address: str) -> float:
    """Return the ms from the navigation to the first picture."""
    page.ask("Page.navigate", url=address)
    page.wait_for(f"location.href === {address!r} && window.drawn > 0")
    return float(page.evaluate("window.drawn"))


def drawn(page: Page, script: str, times: int) -> tuple[float, float]:
    """Return pictures a second, and the shortest processor time of one in ms, of a scene that moves."""
    page.evaluate(script % 3000)  # it learns how fast it is
    found = []
    for _ in range(times):
        before = _processor()
        pictures, seconds = page.evaluate(script % 2000)
        found.append((pictures / seconds, 1e3 * (_processor() - before) / pictures))
    return max(rate for rate, _ in found), min(cost for _, cost in found)


def _processor() -> float:
    """Return the processor time of the browser with its processes, in s."""
    family = psutil.Process().children(recursive=True)
    return sum(sum(member.cpu_times()[:2]) for member in family if member.status() != psutil.STATUS_ZOMBIE)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--times", type=int, default=7)
    arguments = parser.parse_args()
    viewer = Path(meshcat.__file__).parent / "viewer/dist/main.min.js"
    with TemporaryDirectory() as folder, browser() as page:
        empty, full = Path(folder, "empty.html"), Path(folder, "full.html")
        empty.write_text(EMPTY.format(viewer=viewer.read_text(encoding="utf-8")), encoding="utf-8")
        full.write_text(render_scene(scene(arguments.poses)), encoding="utf-8")
        size = full.stat().st_size
        page.size(1280, 800)
        page.ask("Page.addScriptToEvaluateOnNewDocument", source=DRAWN)
        pairs = [[first_picture(page, file.as_uri()) for file in (empty, full)] for _ in range(arguments.times)]
        turned = float(page.evaluate(TURNED))
        moving = {"turned": drawn(page, MOVED, arguments.times), "played": drawn(page, PLAYED, arguments.times)}
        first_picture(page, empty.as_uri())
        nothing = drawn(page, MOVED, arguments.times)
        assert page.trouble == []
    # Other work on the machine only ever adds.
    times = [min(column) for column in zip(*pairs, strict=True)]
    ratio = times[1] / times[0]
    print(f"{arguments.poses} poses: {size / 1e6:.1f} MB; first picture after {times[1]:.0f} ms,", end=" ")
    print(f"of an empty meshcat scene after {times[0]:.0f} ms: {ratio:.2f} times.")
    print(f"The whole of it is drawn {1e3 / turned:.0f} times a second.")
    for how, (rate, cost) in moving.items():
        ratio_to = f"{cost / nothing[1]:.2f} times that of the empty scene, which is drawn {nothing[0]:.0f} times"
        print(f"While it is {how}: {rate:.0f} times; a picture takes {cost:.0f} ms of the processor, {ratio_to}.")
    return int(ratio > MOST_RATIO or size > MOST_BYTES)


if __name__ == "__main__":
    sys.exit(main())
