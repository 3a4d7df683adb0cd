"""What priors with learned widths bring on a real UR10: for joint terms, and for geometry from few poses.

    python scripts/studies/ur10_priors.py <ur10_leica folder> [--splits 4] [--draws 10] [--jobs 1] [--markdown FILE]

Data: as scripts/examples/ur10_leica_job.py reads them. A random third of the rows is held out, the first third of
numpy's default_rng(seed).permutation; errors are of these. Split 0 is that of the README.
"""

import argparse
import functools
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray

import calib
from calib.assessment.choice import choose_terms
from calib.assessment.gaussian_choice import bought
from calib.assessment.validation import row_groups
from calib.identification.identify import residuals_of
from calib.machine.gaussian import gaussian_from_residuals
from calib.presentation.sheets import prior_sentences
from scripts.examples.ur10_leica_job import NotTheDatasetError, read, table_columns
from scripts.studies.all_harmonics import by_steps

Array = NDArray[np.float64]

ROBOT = "example:ur_description/urdf/ur10_robot.urdf"
FEW = (10, 15, 20, 30, 60)
HARMONICS = 1e-4
LENGTH, ANGLE = 1e-3, 1e-3
WITHIN = 1.959964  # standard deviations on both sides that hold 95 % of a normal distribution

PAGE = """# Priors with learned widths on a real UR10

Made by `python scripts/studies/ur10_priors.py <ur10_leica folder> --markdown docs/ur10_priors.md`.

A UR10 measured with a Leica T-Mac ([ur10_leica_job.py](../scripts/examples/ur10_leica_job.py) says where the data are),
positions; errors (rms) of a third of the rows that is held out. How a width is learned: [theory.md](theory.md). It is
learned from the rows to identify from alone.

## Joint terms

Two thirds of the rows to identify, {splits} random splits, the same for all columns; split 0 is that of the README.

* **chosen**: joint terms that the tool chooses one by one, by what rows held out of the other two thirds say of each of
  them ([joint_terms.md](joint_terms.md)); then without a prior, and without its offer of all harmonics.
* **stated**: harmonics 1 to 40 of every joint, none left out, with a prior of 0.1 mrad, the typical size.
* **wide**: a prior of 1 mrad, ten times as wide, which is what somebody might state who does not know.
* **learned**: the same harmonics, with one learned width for those of each joint.
* **and the rest**: with gains and compliances, which the tool may choose as well, the compliances' width learned.

Within: the share of coordinates held out whose error is within the stated 95 % interval, which has the doubts of the
parameters and the noise of the fit.
"""

FEW_POSES = """
## Geometry from few poses

So many random poses out of the two thirds, {draws} draws each, rms over all of the last third; means over the draws.
All placements and joint offsets are free. **None**: no prior, the machine nearest to the nominal one in the null
space. **Stated**: 1 mm and 1 mrad, parameter scales. **Learned**: a learned width for link translations, link
rotations and joint offsets each, or a usual width where the data determine too few of them.
"""

PROCESS = """
## And a Gaussian process of what is left

As in [ur10_residuals.md](ur10_residuals.md): a Gaussian process of the residuals, here after harmonics 1 to 40 with
learned widths, gains and compliances. The guard's columns are of the rows to identify from alone.
"""


class Judged(NamedTuple):
    """A fit, its rms in mm on rows held out, and the share of their coordinates within 95 % intervals."""

    fit: calib.Fit
    rms: float
    within: float


def judged(fit: calib.Fit, test: calib.Measurements) -> Judged:
    (r,) = residuals_of(fit, [test], fit.machine)
    tool = calib.judging.tool_uncertainty(calib.machine_of(fit), test.readings)
    spread = np.sqrt(tool.covariance[:, range(3), range(3)] + fit.noise[0].total ** 2)
    return Judged(fit, rms(r), float(np.mean(np.abs(r) < WITHIN * spread)))


def rms(r: Array) -> float:
    return 1e3 * float(np.sqrt(np.mean(np.sum(r**2, axis=1))))


def divided(data: calib.Measurements, seed: int) -> tuple[calib.Measurements, calib.Measurements]:
    """Return the rows to identify from and those held out."""
    order = np.random.default_rng(seed).permutation(len(data))
    return data.subset(order[len(order) // 3 :]), data.subset(order[: len(order) // 3])


@functools.cache
def loaded(dataset: Path) -> tuple[calib.Robot, calib.Measurements]:
    robot = calib.load_robot(ROBOT, tip="tool0")
    return robot, calib.read_measurements(table_columns(read(dataset), "position"), robot)


def of_terms(dataset: Path, seed: int) -> dict[str, Judged]:
    robot, data = loaded(dataset)
    seen, test = divided(data, seed)
    geometry = {"offsets": "all", "placements": "all"}
    waves = {"harmonics": "all", "harmonic_orders": range(1, 41)}
    every = {**geometry, "terms": waves}
    rest = {**geometry, "terms": {**waves, "gain": "all", "elastic": "all"}}
    models = {
        "chosen": by_steps(choose_terms(calib.error_model(robot, **geometry), seen)),
        "stated": calib.error_model(robot, **every, priors=calib.Priors(harmonics=HARMONICS)),
        "wide": calib.error_model(robot, **every, priors=calib.Priors(harmonics=10 * HARMONICS)),
        "learned": calib.error_model(robot, **every, priors=calib.Priors(harmonics="learned")),
        "and the rest": calib.error_model(robot, **rest, priors=calib.Priors(harmonics="learned", elastic="learned")),
    }
    return {name: judged(calib.identify(model, seen), test) for name, model in models.items()}


def of_few(dataset: Path, seed: int) -> list[dict[str, Judged]]:
    return [of_geometry(dataset, seed, count) for count in FEW]


def of_geometry(dataset: Path, seed: int, count: int) -> dict[str, Judged]:
    robot, data = loaded(dataset)
    seen, test = divided(data, seed)
    some = seen.subset(np.arange(count))
    found = {}
    for name, length, angle in (
        ("none", None, None),
        ("stated", LENGTH, ANGLE),
        ("learned", "learned", "learned"),
    ):
        model = calib.error_model(robot, offsets="all", placements="all", priors=calib.Priors(length, angle))
        found[name] = judged(calib.identify(model, some), test)
    return found


def table(first: str, labels: list[str], found: list[dict[str, Judged]], mean: bool) -> list[str]:
    """Rows of a table: rms in mm, then shares within the intervals."""
    names = list(found[0])
    lines = [
        f"| {first} | {' | '.join(f'{name} [mm]' for name in names)} | {' | '.join(f'within: {n}' for n in names)} |",
        f"|--:|{'--:|' * 2 * len(names)}",
    ]
    rows = [[*(one[n].rms for n in names), *(100 * one[n].within for n in names)] for one in found]
    if mean:
        rows.append(np.mean(rows, axis=0).tolist())
        labels = [*labels, "mean"]
    for label, row in zip(labels, rows, strict=True):
        cells = [f"{v:.3f}" for v in row[: len(names)]] + [f"{v:.1f} %" for v in row[len(names) :]]
        lines.append(f"| {label} | {' | '.join(cells)} |")
    return lines


def paired(found: list[dict[str, Judged]], one: str, other: str) -> tuple[float, float, int]:
    """Return the mean of rms differences in mm, its standard error, and how often the one is worse."""
    d = np.array([f[one].rms - f[other].rms for f in found])
    return float(d.mean()), float(d.std(ddof=1) / np.sqrt(len(d))), int(np.count_nonzero(d > 0.0))


def compared(found: list[dict[str, Judged]], one: str, other: str) -> str:
    difference, error, worse = paired(found, one, other)
    return (
        f"{one.capitalize()} less {other}, on the same rows: {difference:+.4f} mm (standard error {error:.4f} mm), "
        f"worse in {worse} of {len(found)}."
    )


def mean_of(found: list[dict[str, Judged]]) -> dict[str, Judged]:
    def mean(name: str) -> Judged:
        own = [one[name] for one in found]
        return Judged(own[0].fit, float(np.mean([o.rms for o in own])), float(np.mean([o.within for o in own])))

    return {name: mean(name) for name in found[0]}


def of_process(dataset: Path, seed: int, fit: calib.Fit) -> tuple[float, ...]:
    """Return rms in mm without and with a process, of rows held out, and the guard's two and its standard error."""
    seen, test = divided(loaded(dataset)[1], seed)
    base = fit.machine.frames.base
    errors = fit.residuals[0] @ base[:3, :3]
    known = gaussian_from_residuals(seen.readings, errors, fit.robot.readings)
    (r,) = residuals_of(fit, [test], fit.machine)
    left = r - known.shifts(base, fit.robot.tips(test.readings, fit.deviations), test.readings)
    gain = bought(known, seen.readings, errors, row_groups([seen]))
    held = gain.held_out
    return rms(r), rms(left), 1e3 * gain.without.rms, 1e3 * held.rms, 1e3 * held.standard_error, float(gain.enters)


def process_table(rows: list[tuple[float, ...]]) -> list[str]:
    lines = [
        "| split | without [mm] | with [mm] | guard: without [mm] | with [mm] | standard error [mm] | enters |",
        "|--:|--:|--:|--:|--:|--:|---|",
    ]
    for k, row in enumerate(rows):
        cells = " | ".join(f"{v:.3f}" for v in row[:-1])
        lines.append(f"| {k} | {cells} | {'yes' if row[-1] else 'no'} |")
    return [*lines, f"| mean | {' | '.join(f'{v:.3f}' for v in np.mean(rows, axis=0)[:-1])} | |"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, help="folder of the UR10's measurements")
    parser.add_argument("--splits", type=int, default=4, help="random splits (default: 4)")
    parser.add_argument("--draws", type=int, default=10, help="draws of few poses (default: 10)")
    parser.add_argument("--jobs", type=int, default=1, help="processes that share the work (default: 1)")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the page")
    arguments = parser.parse_args()
    try:
        loaded(arguments.dataset)
    except NotTheDatasetError as problem:
        print(problem, file=sys.stderr)
        return 1
    with ProcessPoolExecutor(arguments.jobs) as pool:
        splits, draws = range(arguments.splits), range(arguments.draws)
        of_splits = [pool.submit(of_terms, arguments.dataset, seed) for seed in splits]
        of_draws = [pool.submit(of_few, arguments.dataset, seed) for seed in draws]
        terms = [found.result() for found in of_splits]
        fits = [found["and the rest"].fit for found in terms]
        of_fits = [pool.submit(of_process, arguments.dataset, *pair) for pair in enumerate(fits)]
        few = dict(zip(FEW, zip(*(found.result() for found in of_draws), strict=True), strict=True))
        processes = [found.result() for found in of_fits]
    lines = [PAGE.format(splits=arguments.splits).rstrip(), ""]
    lines += [*table("split", [str(k) for k in range(len(terms))], terms, mean=True), ""]
    lines += [f"* {compared(terms, one, 'chosen')}" for one in ("stated", "wide", "learned", "and the rest")]
    lines += ["", "What was learned on split 0, with the rest:", ""]
    lines += [f"* {said}" for said in prior_sentences(terms[0]["and the rest"].fit)]
    lines += [FEW_POSES.format(draws=arguments.draws)]
    lines += [*table("poses", [str(n) for n in FEW], [mean_of(list(found)) for found in few.values()], mean=False), ""]
    lines += [f"* {n} poses. {compared(list(found), 'learned', 'stated')}" for n, found in few.items()]
    lines += [PROCESS, *process_table(processes), ""]
    print("\n".join(lines))
    if arguments.markdown is not None:
        arguments.markdown.write_text("\n".join(lines), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
