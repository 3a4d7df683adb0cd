"""Do intervals of hand-eye, lens and tool hold the truth? Simulated jobs of photographs: a table of docs/cameras.md.

    python scripts/studies/photographs_coverage.py --store coverage.jsonl [--jobs 100] [--rendered]
        [--markdown docs/cameras.md]

Every job is one line of the store; what is there already is not simulated again. A job is as ``calib import images``
writes it: a UR5, everything free with learned priors, lens and scale and shape of the board unknown. Its
truth is drawn anew: the arm by 1 mm and 1 mrad, the print's scale to 0.5 %, its shape, the lens, where camera and board
are, 16 to 30 poses, and corners that are found to 0.05 to 0.5 px, which is stated. With ``--rendered``, photographs of
640 x 360 pixels are rendered, with blur of 0.5 to 1 px and noise of 1 to 6 grey values, and corners are found in them,
with sigmas of their own. The simulation shares no mathematics with the toolkit.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import calib
from calib.foundations.linear import one_thread
from calib.identification.parameters import Priors
from calib.machine.of_fit import machine_of
from calib.machine.tool_uncertainty import tool_uncertainty
from calib.measurement.boards import Board
from calib.measurement.lens import NAMES
from scripts.simulate import photographs as simulation
from scripts.studies.blame import write

# A standard normal number is within this with 95 %, the length of three of them within that.
NORMAL, REGION = 1.959964, 2.795483
GROUPS = ("hand-eye", "lens", "scale", "tool")
BEGIN, END = "<!-- coverage: by scripts/studies/photographs_coverage.py -->", "<!-- coverage: end -->"
RENDERED = "<!-- coverage of rendered photographs: by scripts/studies/photographs_coverage.py -->"
RENDERED_END = "<!-- coverage of rendered photographs: end -->"


def job(seed: int, *, rendered: bool = False) -> dict[str, list[bool]]:
    """Return which intervals of one job hold, by what they are of; of the tool, regions at 40 other poses."""
    rng = np.random.default_rng([seed, 22])
    some = simulation.session(seed, int(rng.integers(16, 31)) + 40)
    arm = simulation.Arm(rng, 1e-3, 1e-3, 0.0)
    k = tuple(np.array(some.lens.k) * rng.uniform(0.0, 2.0, 5))
    f = some.lens.fx * rng.uniform(0.97, 1.03)
    lens = replace(some.lens, fx=f, fy=f * rng.uniform(0.995, 1.005), cx=640 + rng.normal(scale=8.0), k=k)
    if rendered:  # by a quarter of the pixels, of the same view
        half = {"fx": 0.5 * lens.fx, "fy": 0.5 * lens.fy, "cx": 0.5 * lens.cx - 0.25, "cy": 0.5 * lens.cy - 0.25}
        lens = replace(lens, **half, size=(lens.size[0] // 2, lens.size[1] // 2))
    sheet = replace(
        some.sheet,
        scale=rng.normal(scale=0.005),
        aspect=rng.normal(scale=2e-4),
        shear=rng.normal(scale=2e-4),
        bend=tuple(rng.normal(scale=0.05, size=3)),
    )
    sigma, elsewhere = float(np.exp(rng.uniform(*np.log([0.05, 0.5])))), some.readings[-40:]
    some = replace(some, arm=arm, lens=lens, sheet=sheet, readings=some.readings[:-40])
    robot = calib.load_robot(simulation.UR5, simulation.TIP)
    if rendered:
        look = replace(some.look, blur=rng.uniform(0.5, 1.0), noise=rng.uniform(1.0, 6.0))
        columns = simulation.corners_found(replace(some, look=look), rng)
    else:
        columns = simulation.corners_seen(some, sigma, rng)
    camera = calib.measuring.Camera("tip", free=NAMES[:9], size=lens.size, sigma=0.0 if rendered else sigma)
    marks = np.column_stack([sheet.corners(), np.zeros(len(sheet.corners()))])
    data = calib.read_measurements(columns, robot, "pixels", instrument=camera)
    data = calib.measuring.seen_by(data, camera, Board(marks=marks, shape="quadratic"))
    model = calib.error_model(
        robot, offsets="all", placements="all", base="fixed", tool="pose", priors=Priors("learned", "learned")
    )
    fit = calib.identify(model, data)
    names, true = (
        [p.name for p in fit.parameters],
        dict(zip(NAMES, (lens.fx, lens.fy, lens.cx, lens.cy, *k), strict=False)),
    )
    sigmas = dict(zip(names, np.sqrt(np.diag(fit.covariance)), strict=True))

    def holds(name: str, value: float) -> bool:
        return bool(abs(fit.value(name) - value) <= NORMAL * sigmas[name])

    seen = fit.machine.frames.tools[0]
    turn = simulation.Rotation.from_matrix(seen[:3, :3].T @ some.camera[:3, :3]).as_rotvec()
    machine = machine_of(fit)
    told = tool_uncertainty(machine, elsewhere, "tool").covariance[:, :3, :3]
    off = np.stack([(arm.tip(q) @ some.camera)[:3, 3] for q in elsewhere]) - machine.predict(elsewhere)[:, :3, 3]
    far = np.sqrt(np.sum(off[:, :, None] * np.linalg.solve(told, off[:, :, None]), axis=(1, 2)))
    return {
        "hand-eye": [holds(f"tool.{axis}", some.camera[i, 3]) for i, axis in enumerate("xyz")]
        + [bool(abs(turn[i]) <= NORMAL * sigmas[f"tool.r{axis}"]) for i, axis in enumerate("xyz")],
        "lens": [holds(f"lens.{name}", value) for name, value in true.items()],
        "scale": [holds("board.scale", sheet.scale)],
        "tool": (far <= REGION).tolist(),
    }


def table(found: list[dict[str, list[bool]]]) -> str:
    """Return how many intervals hold, by what they are of."""
    rows = [f"| {name} | {np.mean([x for one in found for x in one[name]]):.3f} |" for name in GROUPS]
    return "\n".join([f"| of {len(found)} jobs | 95 % intervals that hold |", "|---|--:|", *rows])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=100)
    parser.add_argument("--first", type=int, default=100, help="the first seed")
    parser.add_argument("--rendered", action="store_true", help="corners are found in rendered photographs")
    parser.add_argument("--markdown", type=Path, help="the page of the table")
    given = parser.parse_args()
    given.store.touch()
    lines = [json.loads(line) for line in given.store.read_text().splitlines()]
    done = {one["seed"]: one["holds"] for one in lines if one.get("rendered", False) == given.rendered}
    with one_thread():
        for seed in range(given.first, given.first + given.jobs):
            if seed not in done:
                done[seed] = job(seed, rendered=given.rendered)
                with given.store.open("a") as out:
                    out.write(json.dumps({"seed": seed, "rendered": given.rendered, "holds": done[seed]}) + "\n")
    found = table([done[seed] for seed in range(given.first, given.first + given.jobs)])
    print(found)
    if given.markdown is not None:
        write(given.markdown, found, *((RENDERED, RENDERED_END) if given.rendered else (BEGIN, END)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
