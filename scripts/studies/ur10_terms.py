"""What joint terms bring on a real UR10: wind-up, bending links, harmonics 1 to 6, and those that the tool chooses.

    python scripts/studies/ur10_terms.py <ur10_leica folder> [--splits 10] [--machines 100] [--markdown FILE]

Data: as scripts/examples/ur10_leica_job.py reads them. A random third of the rows is held out, the first third of
numpy's default_rng(seed).permutation; errors are of these. Then simulated machines without any joint term, to count how
often the tool chooses one all the same.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import calib
from calib.assessment.choice import Choice, choose_terms
from calib.identification.identify import residuals_of
from calib.presentation.sheets import choice_sheet
from scripts.examples.ur10_leica_job import JOINTS, NotTheDatasetError, read, table_columns

Array = NDArray[np.float64]

ROBOT = "example:ur_description/urdf/ur10_robot.urdf"
ORDERS = range(1, 7)
SIGMA = 5e-5
# Columns of the table: what was free beside geometry, and where it is kept.
TITLES = {
    "geometry": "geometry",
    "wind-up": "wound",
    "and bending": "bent",
    "harmonics 1 to 6": "given",
    "chosen by the tool": "chosen",
}

PAGE = """# Joint terms on a real UR10

Made by `python scripts/studies/ur10_terms.py <ur10_leica folder> --machines {machines} --markdown docs/ur10_terms.md`.

A UR10 measured with a Leica T-Mac ([ur10_leica_job.py](../scripts/examples/ur10_leica_job.py) says where the data are).
Two thirds of the rows to identify, errors of the last third, {splits} random splits; positions. What a joint term is
and how the tool chooses: [joint_terms.md](joint_terms.md). Many poses were visited twice; the choice keeps both visits
on one side of its folds.
"""


class Split(NamedTuple):
    """Rms (mm) on rows held out, with these terms, and with the tool's choice; its cost in geometric fits."""

    geometry: float
    wound: float
    bent: float
    given: float
    chosen: float
    choice: Choice
    fits: float


def rms(fit: calib.Fit, test: calib.Measurements) -> float:
    (r,) = residuals_of(fit, [test], fit.machine)
    return 1e3 * float(np.sqrt(np.mean(np.sum(r**2, axis=1))))


def split(robot: calib.Robot, data: calib.Measurements, seed: int) -> Split:
    order = np.random.default_rng(seed).permutation(len(data))
    test, seen = data.subset(order[: len(order) // 3]), data.subset(order[len(order) // 3 :])
    free = {"offsets": "all", "placements": "all"}
    plain = calib.error_model(robot, **free)
    start = time.process_time()
    geometry = calib.identify(plain, seen)
    one = time.process_time() - start
    start = time.process_time()
    choice = choose_terms(plain, seen)
    cost = (time.process_time() - start) / one
    wound = calib.identify(calib.error_model(robot, **free, terms={"elastic": "all"}), seen)
    bent = calib.identify(calib.error_model(robot, **free, terms={"elastic": "all", "bending": "all"}), seen)
    waves = {"harmonics": "all", "harmonic_orders": ORDERS}
    given = calib.identify(calib.error_model(robot, **free, terms=waves), seen)
    chosen = calib.identify(choice.model, seen)
    return Split(*(rms(fit, test) for fit in (geometry, wound, bent, given, chosen)), choice, cost)


def chosen_in_vain(robot: calib.Robot, data: calib.Measurements, machines: int, rows: int) -> int:
    """Return how many of simulated machines without joint terms are given some: the data's own poses, other errors."""
    model = calib.error_model(robot, offsets="all", placements="all")
    found = 0
    for seed in range(machines):
        rng = np.random.default_rng([seed, rows])
        true = calib.Deviations(
            rng.normal(scale=np.repeat((5e-4, 1e-3), 3), size=(len(robot.chain), 6)), rng.normal(scale=5e-3, size=6)
        )
        readings = data.readings[rng.choice(len(data), rows, replace=False)]
        points = robot.tips(readings, true) @ np.array([0.05, 0.02, 0.15, 1.0])
        columns = {f"{name} [rad]": readings[:, k] for k, name in enumerate(JOINTS)}
        columns |= {f"{x} [m]": points[:, k] + SIGMA * rng.standard_normal(rows) for k, x in enumerate("xyz")}
        found += bool(choose_terms(model, calib.read_measurements(columns, robot)).terms)
    return found


def evidence(choice: Choice) -> list[str]:
    """Rows of a table: what entered at every step, and what it brought at rows held out."""
    return [
        "| step | enters | held out, of geometry alone | standard error | rms [mm] | taken |",
        "|--:|---|--:|--:|--:|---|",
        *(f"| {' | '.join(row.cells)} |" for row in choice_sheet(choice).rows),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, help="folder of the UR10's measurements")
    parser.add_argument("--splits", type=int, default=10, help="random splits (default: 10)")
    parser.add_argument("--machines", type=int, default=100, help="machines without joint terms (default: 100)")
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
    shown = Table(title="Rms of positions held out [mm]")
    for title in ("split", *TITLES, "terms"):
        shown.add_column(title, justify="right")
    rows = [
        (str(k), *(f"{getattr(s, name):.3f}" for name in TITLES.values()), str(len(s.choice.terms)))
        for k, s in enumerate(splits)
    ]
    means = [float(np.mean([getattr(s, name) for s in splits])) for name in TITLES.values()]
    terms = float(np.mean([len(s.choice.terms) for s in splits]))
    rows.append(("mean", *(f"{value:.3f}" for value in means), f"{terms:.0f}"))
    for row in rows:
        shown.add_row(*row)
    Console().print(shown)
    less = 1e3 * np.array([s.wound - s.bent for s in splits])
    gained = np.array([s.geometry - s.chosen for s in splits])
    said = [
        f"Bending links are worth {less.mean():.1f} um beside wind-up on average, and {less.min():.1f} to "
        f"{less.max():.1f} um in single splits.",
        f"The choice is better than geometry alone by {gained.mean():.3f} mm on average, and by {gained.min():.3f} to "
        f"{gained.max():.3f} mm in single splits.",
        f"It costs as much processor time as {max(s.fits for s in splits):.0f} geometric fits at most.",
    ]
    for count in (60, 300):
        wrong = chosen_in_vain(robot, data, arguments.machines, count)
        said.append(
            f"Of {arguments.machines} simulated machines without joint terms, at {count} of these poses and "
            f"{1e3 * SIGMA:g} mm of noise, {wrong} were given some."
        )
    print("\n".join(said))
    if arguments.markdown is not None:
        table = [
            f"| split | {' | '.join(f'{title} [mm]' for title in TITLES)} | terms |",
            f"|{'--:|' * (len(TITLES) + 2)}",
        ]
        table += [f"| {' | '.join(row)} |" for row in rows]
        text = [
            PAGE.format(splits=len(splits), machines=arguments.machines),
            *table,
            "",
            *said,
            "",
            "## The evidence",
            "",
            "Of the first split:",
            "",
        ]
        arguments.markdown.write_text("\n".join([*text, *evidence(splits[0].choice), ""]), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
