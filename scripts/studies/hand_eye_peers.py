"""Hand-eye of simulated photographs by OpenCV's five methods, and by one solve with lens, print and arm.

    python scripts/studies/hand_eye_peers.py --opencv PYTHON [--jobs 30] [--markdown docs/cameras.md]

PYTHON is an interpreter with numpy and OpenCV 4 (``opencv-python-headless<5``). Everybody is told the corners, the
drawn board, the nominal robot and the size of the images. The truth is of scripts/simulate/photographs.py: a UR5 with
errors of 0.3 mm and 0.3 mrad, corners found to 0.1 px, and a print as it was drawn, or one 0.4 % too large
and bent by a fraction of a millimetre.
"""

import argparse
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import calib
from calib.foundations.linear import one_thread
from calib.identification.identify import residuals_of
from calib.identification.parameters import Priors
from calib.measurement.boards import Board
from calib.measurement.lens import NAMES
from scripts.simulate import photographs as simulation
from scripts.studies.blame import write

RUNNER = Path(__file__).parents[1] / "benchmarks" / "peers" / "run_opencv_hand_eye.py"
BEGIN, END = "<!-- peers: by scripts/studies/hand_eye_peers.py -->", "<!-- peers: end -->"
SIGMA, IMAGES, HELD_OUT = 0.1, 24, 12
OURS = "one solve, here"
Array = simulation.Array


def by_opencv(python: Path, some: simulation.Session, corners: Array) -> dict[str, tuple[Array, float]]:
    """Return the camera on the flange (4, 4), and px at other photographs, by every method."""
    drawn = some.sheet.corners()
    board = np.column_stack([drawn, np.zeros(len(drawn))])
    flanges = np.stack([some.arm.tip(q, nominal=True) for q in some.readings])
    with tempfile.TemporaryDirectory() as folder:
        case, out = Path(folder) / "case.npz", Path(folder) / "found.npz"
        n = IMAGES
        np.savez(case, board=board, corners=corners[:n], flanges=flanges[:n], size=np.array(some.lens.size))
        subprocess.run([str(python), str(RUNNER), str(case), str(out)], check=True)
        found = dict(np.load(out))
    fx, fy, cx, cy = found["K"][0, 0], found["K"][1, 1], found["K"][0, 2], found["K"][1, 2]
    lens = simulation.Lens(fx, fy, cx, cy, tuple(found["k"]), some.lens.size)

    def missed(camera: Array, at: Array, rows: slice) -> Array:
        T = np.linalg.inv(flanges[rows] @ camera) @ simulation.pose(at[:3], at[3:])
        seen = np.stack([lens.see(board @ one[:3, :3].T + one[:3, 3]) for one in T])
        return (seen - corners[rows]).ravel()

    start = np.concatenate([some.board[:3, 3], simulation.Rotation.from_matrix(some.board[:3, :3]).as_rotvec()])
    told = {}
    for name, camera in zip(found["methods"], found["cameras"], strict=True):
        # Where the board is, nobody tells: it is what fits the same photographs best.
        at = least_squares(lambda x, camera=camera: missed(camera, x, slice(n)), start, x_scale="jac").x
        told[f"OpenCV, {str(name).capitalize()}"] = (camera, rms(missed(camera, at, slice(n, None))))
    return told


def rms(misses: Array) -> float:
    """Root mean square of two-dimensional misses, given by coordinate."""
    return float(np.sqrt(np.mean(misses**2) * 2.0))


def here(some: simulation.Session, table: dict[str, object], count: int) -> tuple[Array, float]:
    """Return the camera on the flange (4, 4), and px at other photographs, by one solve of everything."""
    robot = calib.load_robot(simulation.UR5, simulation.TIP)
    camera = calib.measuring.Camera("tip", free=NAMES[:9], size=some.lens.size, sigma=SIGMA)
    marks = np.column_stack([some.sheet.corners(), np.zeros(len(some.sheet.corners()))])
    data = calib.read_measurements(table, robot, "pixels", instrument=camera)
    data = calib.measuring.seen_by(data, camera, Board(marks=marks, shape="quadratic"))
    rows = np.arange(len(data))
    model = calib.error_model(
        robot, offsets="all", placements="all", base="fixed", tool="pose", priors=Priors(1e-3, 1e-3)
    )
    fit = calib.identify(model, data.subset(rows[: count * IMAGES]))
    (misses,) = residuals_of(fit, [data.subset(rows[count * IMAGES :])], fit.machine)
    return fit.machine.frames.tools[0], rms(misses.ravel())


def job(seed: int, python: Path, *, as_drawn: bool) -> dict[str, tuple[float, float, float]]:
    """Return how far every hand-eye is off, in mm and mrad, and px at photographs that nobody used."""
    some = simulation.session(seed, IMAGES + HELD_OUT)
    if as_drawn:
        some = replace(some, sheet=simulation.Sheet())
    rng = np.random.default_rng([seed, 7])
    table, count = simulation.corners_seen(some, SIGMA, rng), len(some.sheet.corners())
    corners = np.column_stack([table["u [px]"], table["v [px]"]]).reshape(-1, count, 2)
    found = by_opencv(python, some, corners) | {OURS: here(some, table, count)}
    true = some.camera
    return {
        name: (
            1e3 * float(np.linalg.norm(T[:3, 3] - true[:3, 3])),
            1e3 * float(simulation.Rotation.from_matrix(T[:3, :3].T @ true[:3, :3]).magnitude()),
            px,
        )
        for name, (T, px) in found.items()
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--opencv", type=Path, required=True, help="an interpreter with OpenCV 4")
    parser.add_argument("--jobs", type=int, default=30)
    parser.add_argument("--first", type=int, default=500, help="the first seed")
    parser.add_argument("--markdown", type=Path, help="the page of the table")
    given = parser.parse_args()
    lines = [
        f"| {given.jobs} jobs each | print | off [mm] | largest | turned [mrad] | held out [px] |",
        "|---|---|--:|--:|--:|--:|",
    ]
    seeds = range(given.first, given.first + given.jobs)
    for paper, as_drawn in (("as drawn", True), ("too large, bent", False)):
        with one_thread():
            found = [job(seed, given.opencv, as_drawn=as_drawn) for seed in seeds]
        for name in found[0]:
            off, turned, px = np.array([one[name] for one in found]).T
            told = (np.median(off), off.max(), np.median(turned), np.median(px))
            lines.append(f"| {name} | {paper} | {' | '.join(f'{number:.2f}' for number in told)} |")
    print("\n".join(lines))
    if given.markdown is not None:
        write(given.markdown, "\n".join(lines), BEGIN, END)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
