"""Which is to blame? Jobs with one planted cause, and what the tool names: the confusion matrix of docs/cameras.md.

    python scripts/studies/blame.py [--jobs 40]

Corners are simulated, not rendered, by the mathematics of scripts/simulate/photographs.py: a UR5 with errors of 0.1 mm
and 0.1 mrad, 24 photographs, a lens that is given and free, and one thing wrong: the lens that is given (1.5 % of its
focal length, no distortion), the print 1.5 % too large, the print bent by millimetres, a joint's zero by 5 mrad, or
corners that are found to 0.7 px. A quarter of the photographs is held out.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import calib
from calib.assessment.blame import blame
from calib.assessment.judged import JudgedSet, Use
from calib.foundations.linear import one_thread
from calib.identification.identify import residuals_of
from calib.identification.parameters import Priors
from calib.measurement.boards import Board
from calib.measurement.lens import NAMES
from scripts.simulate import photographs as simulation

CAUSES = ("lens", "scale", "shape", "arm", "corners")
ANSWERS = (*CAUSES, "cannot tell")
SIGMA = {"corners": 0.7}


def job(seed: int, cause: str) -> str:
    """What is named for one planted cause."""
    rng = np.random.default_rng([seed, CAUSES.index(cause)])
    some = simulation.session(seed, 24)
    arm = simulation.Arm(rng, 0.1e-3, 0.1e-3, 0.1e-3)
    sheet = replace(some.sheet, scale=rng.normal(scale=1e-3), aspect=0.0, shear=0.0, bend=(0.0, 0.0, 0.0))
    given = {"fx": some.lens.fx, "fy": some.lens.fy, "cx": some.lens.cx, "cy": some.lens.cy}
    given |= dict(zip(("k1", "k2", "p1", "p2", "k3"), some.lens.k, strict=True))
    sign = rng.choice((-1.0, 1.0))
    if cause == "lens":
        given |= {"fx": given["fx"] * (1 + 0.015 * sign), "fy": given["fy"] * (1 + 0.015 * sign), "k1": 0.0, "k2": 0.0}
    elif cause == "scale":
        sheet = replace(sheet, scale=0.015 * sign)
    elif cause == "shape":
        sheet = replace(sheet, bend=tuple(rng.uniform(0.2, 0.4, 3) * rng.choice((-1.0, 1.0), 3)))
    elif cause == "arm":
        arm.zeros[arm.names[int(rng.integers(1, 5))]] += 5e-3 * sign
    sigma, board = SIGMA.get(cause, 0.05), np.column_stack([sheet.corners(), np.zeros(len(sheet.corners()))])
    rows: dict[str, list[np.ndarray]] = {"q": [], "uv": [], "p": []}
    for q in some.readings:
        T = np.linalg.inv(arm.tip(q) @ some.camera) @ some.board
        rows["uv"].append(some.lens.see(sheet.place(sheet.corners()) @ T[:3, :3].T + T[:3, 3]))
        rows["q"].append(np.tile(q, (len(board), 1)))
        rows["p"].append(board)
    q, uv, p = (np.concatenate(values) for values in rows.values())
    uv = uv + rng.normal(scale=sigma, size=uv.shape)
    columns: dict[str, object] = {f"{name} [rad]": q[:, k] for k, name in enumerate(arm.names)}
    columns |= {"u [px]": uv[:, 0], "v [px]": uv[:, 1]}
    columns |= {f"board_{axis} [m]": p[:, k] for k, axis in enumerate("xyz")}
    robot = calib.load_robot(simulation.UR5, simulation.TIP)
    camera = calib.measuring.Camera("tip", **given, free=NAMES[:9], size=some.lens.size)
    data = calib.read_measurements(columns, robot, "pixels", instrument=camera)
    data = calib.measuring.seen_by(data, camera, Board(marks=board, shape="quadratic"))
    kept, held_out = calib.hold_out(data, 0.25)
    model = calib.error_model(
        robot,
        offsets="all",
        placements="all",
        base="fixed",
        tool="pose",
        priors=Priors(1e-3, 1e-3),
    )
    fit = calib.identify(model, kept)
    found = blame(fit, _judged(fit, kept, held_out))
    return (found.named if found is not None else None) or "cannot tell"


def _judged(fit: calib.Fit, kept: calib.Measurements, held_out: calib.Measurements) -> list[JudgedSet]:
    uses: list[tuple[Use, calib.Measurements]] = [("identification", kept), ("validation", held_out)]
    return [
        JudgedSet(use, use, data, *(residuals_of(fit, [data], machine)[0] for machine in (fit.nominal, fit.machine)))
        for use, data in uses
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=40, help="of every cause")
    given_ = parser.parse_args()
    print("| planted | " + " | ".join(ANSWERS) + " |")
    print("|---|" + "---|" * len(ANSWERS))
    with one_thread():
        for planted in CAUSES:
            named = [job(seed, planted) for seed in range(given_.jobs)]
            print(f"| {planted} | " + " | ".join(str(named.count(answer)) for answer in ANSWERS) + " |", flush=True)
