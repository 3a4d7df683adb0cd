"""What a Gaussian process of the residuals brings on a real UR10, after harmonics 1 to 6 and after chosen joint terms.

    python scripts/studies/ur10_residuals.py <ur10_leica folder> [--splits 4] [--markdown FILE]

Data: as scripts/examples/ur10_leica_job.py reads them. A random third of the rows is held out, the first third of
numpy's default_rng(seed).permutation; errors are of these. Split 0 is that of the README.
"""

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray

import calib
from calib.assessment.choice import candidates, choose_terms
from calib.assessment.gaussian_choice import Bought, bought
from calib.assessment.validation import row_groups
from calib.identification.identify import residuals_of
from calib.machine.gaussian import GaussianResiduals, gaussian_from_residuals
from scripts.examples.ur10_leica_job import NotTheDatasetError, read, table_columns

Array = NDArray[np.float64]

ROBOT = "example:ur_description/urdf/ur10_robot.urdf"
GIVEN = tuple(range(1, 7))
OFFERED = range(1, 41)
STAGES = ("harmonics 1 to 6", "chosen joint terms")

PAGE = """# A Gaussian process of the residuals of a real UR10

Made by `python scripts/studies/ur10_residuals.py <ur10_leica folder> --markdown docs/ur10_residuals.md`.

A UR10 measured with a Leica T-Mac ([ur10_leica_job.py](../scripts/examples/ur10_leica_job.py) says where the data are).
Two thirds of the rows to identify, position errors (rms) of the last third; split 0 is that of the README. First
geometry with harmonics 1 to 6 of every joint, or with joint terms that the tool chooses one by one of all candidates,
harmonics up to order {largest} among them, but without its offer of all harmonics at once, taken on this arm, which
leaves less ([joint_terms.md](joint_terms.md), [ur10_terms.md](ur10_terms.md)); then the Gaussian process of what is
left (`residual_model = {{ kind = "gaussian_process" }}` of the last level), in the axes of the base, over all six
joints.

Many poses were visited twice, and a random split puts twins on both sides. The columns "new poses" count only the rows
held out whose pose is in no row to identify from. The guard's columns are of the rows to identify from alone, by
grouped cross-validation, twins on one side and length scales from rows of other folds; it lets the process enter where
it is better by more than one standard error, and needs none of the rows held out here. Where it says no, the tool
leaves the process out.
"""


class Stage(NamedTuple):
    """Rms in mm of rows held out, of all and of those at new poses, without and with the process; and its evidence."""

    without: float
    held: float
    without_new: float
    held_new: float
    terms: int
    bought: Bought
    known: GaussianResiduals


def rms(r: Array) -> float:
    return 1e3 * float(np.sqrt(np.mean(np.sum(r**2, axis=1))))


def stage(model: calib.ErrorModel, seen: calib.Measurements, test: calib.Measurements) -> Stage:
    fit = calib.identify(model, seen)
    base = fit.machine.frames.base
    errors = fit.residuals[0] @ base[:3, :3]
    known = gaussian_from_residuals(seen.readings, errors, fit.robot.readings)
    (r,) = residuals_of(fit, [test], fit.machine)
    tips = fit.robot.tips(test.readings, fit.deviations)
    left = r - known.shifts(base, tips, test.readings)
    group = row_groups([seen, test])
    new = ~np.isin(group[len(seen) :], group[: len(seen)])
    gain = bought(known, seen.readings, errors, row_groups([seen]))
    return Stage(rms(r), rms(left), rms(r[new]), rms(left[new]), len(model.robot.terms), gain, known)


def split(robot: calib.Robot, data: calib.Measurements, seed: int) -> tuple[Stage, Stage]:
    order = np.random.default_rng(seed).permutation(len(data))
    test, seen = data.subset(order[: len(order) // 3]), data.subset(order[len(order) // 3 :])
    plain = calib.error_model(robot, offsets="all", placements="all")
    waves = {"harmonics": "all", "harmonic_orders": GIVEN}
    given = calib.error_model(robot, offsets="all", placements="all", terms=waves)
    chosen = choose_terms(plain, seen, offered=candidates(robot, [seen], {"harmonic_orders": OFFERED})).model
    return stage(given, seen, test), stage(chosen, seen, test)


def table(stages: list[Stage]) -> list[str]:
    lines = [
        "| split | terms | without [mm] | with [mm] | new poses: without [mm] | with [mm] | guard: without [mm] | "
        "with [mm] | standard error [mm] | enters |",
        "|--:|--:|--:|--:|--:|--:|--:|--:|--:|---|",
    ]
    rows = []
    for s in stages:
        without, held = s.bought
        rows.append((s.terms, *s[:4], 1e3 * without.rms, 1e3 * held.rms, 1e3 * held.standard_error))
    for k, s in enumerate(stages):
        lines.append(f"| {k} | {shown(rows[k])} | {'yes' if s.bought.enters else 'no'} |")
    return [*lines, f"| mean | {shown(np.mean(rows, axis=0))} | |"]


def shown(row: Array | tuple[float, ...]) -> str:
    return " | ".join([f"{row[0]:.0f}", *(f"{value:.3f}" for value in row[1:])])


def scales(s: Stage, robot: calib.Robot) -> str:
    kernel = s.known.kernel
    said = ", ".join(f"{r.name} {scale:.3g}" for r, scale in zip(robot.readings, kernel.scales, strict=True))
    return (
        f"Length scales of split 0 in rad: {said}; standard deviation of a component {1e3 * kernel.amplitude:.3f} mm, "
        f"of its noise {1e3 * kernel.noise:.3f} mm."
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, help="folder of the UR10's measurements")
    parser.add_argument("--splits", type=int, default=4, help="random splits (default: 4)")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the page")
    arguments = parser.parse_args()
    try:
        columns = table_columns(read(arguments.dataset), "position")
    except NotTheDatasetError as problem:
        print(problem, file=sys.stderr)
        return 1
    robot = calib.load_robot(ROBOT, tip="tool0")
    data = calib.read_measurements(columns, robot)
    splits = [split(robot, data, seed) for seed in range(arguments.splits)]
    lines = []
    for title, stages in zip(STAGES, zip(*splits, strict=True), strict=True):
        lines += ["", f"## After {title}", "", *table(list(stages)), "", scales(stages[0], robot)]
    print("\n".join(lines))
    if arguments.markdown is not None:
        text = "\n".join([PAGE.format(largest=max(OFFERED)).rstrip(), *lines, ""])
        arguments.markdown.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
