"""Do stated regions hold the truth where terms were chosen? Simulated machines: a table of docs/assessment.md.

    python scripts/studies/chosen_regions.py [--machines 40] [--markdown docs/assessment.md]
    python scripts/studies/chosen_regions.py --machines 20 --dataset <ur10_leica folder> [--markdown docs/assessment.md]

A UR10 is simulated, each time with other errors, and measured at random poses of a box of joint space; 0.05 mm of noise
are stated. Its gears are uneven in four orders (few), in eight orders of every joint (low), or in all orders up to 40
(many). Joint terms are chosen by ``calib.judging.choose_terms``. At 300 other poses of that box the true position is
compared with the stated 95 % region: by the fit of the choice, and by one with the same terms to the same rows that
counts them as if nobody had chosen them. The simulation shares no mathematics with the toolkit.

With ``--dataset`` the rows are some of those of a real UR10, taken at random, and 300 others take the place of the
truth: positions that a laser tracker measured.
"""

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray

import calib
from calib.assessment.choice import choose_terms
from calib.foundations.chance import bound
from calib.foundations.linear import one_thread
from scripts.examples.ur10_leica_job import read, table_columns
from scripts.studies.blame import write
from tests.support import machines
from tests.support.gears import UR10, geared

Array = NDArray[np.float64]

KINDS, ROWS, SIGMA, UNSEEN = ("few", "low", "many"), (60, 100, 200, 400), 5e-5, 300
REAL, REAL_END = "<!-- chosen, a UR10: by scripts/studies/chosen_regions.py -->", "<!-- chosen, a UR10: end -->"
BEGIN, END = "<!-- chosen: by scripts/studies/chosen_regions.py -->", "<!-- chosen: end -->"


class Told(NamedTuple):
    """Of one machine: coefficients chosen, shares of regions that hold, and stated over true errors."""

    terms: int
    as_given: float
    as_chosen: float
    ratio_as_given: float
    ratio_as_chosen: float


def amplitudes(rng: np.random.Generator, kind: str) -> Array:
    """What every joint errs by in every order (6, 40), in rad."""
    sizes, orders = np.zeros((6, 40)), np.arange(1, 41)
    if kind == "few":
        for order in rng.choice((1, 1, 2, 2, 3, 4, 5, 7, 10, 17, 25), 4):
            sizes[rng.integers(6), order - 1] = 10 ** rng.uniform(-4.3, -3.5)
    elif kind == "low":
        sizes[:, :8] = 10 ** rng.uniform(-4.6, -3.7, (6, 8))
    else:
        sizes = 10 ** rng.uniform(-4.5, -3.5, (6, 1)) * rng.normal(size=(6, 40)) * orders ** -rng.uniform(0.0, 1.0)
    return sizes


def machine(seed: int, kind: str, rows: int) -> Told:
    """One machine: its rows, the choice, and what regions say elsewhere in the box."""
    rng, plain, robot = np.random.default_rng([seed, rows, *kind.encode()]), machines.arm(*UR10), machines.load(*UR10)
    sizes, phases, orders = amplitudes(rng, kind), rng.uniform(0.0, 2.0 * np.pi, (6, 40)), np.arange(1, 41)

    def extra(u: Array) -> Array:
        return np.asarray(np.sum(sizes * np.cos(orders * u[:, :, None] - phases), axis=2))

    arm = geared(plain.moved(rng), extra)
    true = machines.Machine(arm, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    centre, half = rng.uniform(-1.0, 1.0, 6), rng.uniform(0.8, 3.0)

    def box(n: int) -> Array:
        return np.asarray(np.clip(centre + rng.uniform(-half, half, (n, 6)), -np.pi, np.pi))

    data, elsewhere = true.measure(robot, box(rows), "position", rng=rng, sigma=SIGMA), box(UNSEEN)
    return told(robot, data, elsewhere, true.see(elsewhere)[:, :3, 3])


def measured(folder: Path) -> calib.Measurements:
    """Return the positions of the real arm."""
    return calib.read_measurements(table_columns(read(folder), "position"), machines.load(*UR10))


def some_of(data: calib.Measurements, seed: int, _kind: str, rows: int) -> Told:
    """Some rows of the real arm, the choice, and what regions say of others."""
    order = np.random.default_rng([seed, rows]).permutation(len(data))
    rest = data.subset(order[rows : rows + UNSEEN])
    assert rest.position is not None, "a laser tracker measures positions"
    return told(machines.load(*UR10), data.subset(order[:rows]), rest.readings, rest.position)


def told(robot: calib.Robot, data: calib.Measurements, readings: Array, positions: Array) -> Told:
    """Return what regions of a choice say at readings (N, 6), where positions (N, 3) are known."""
    choice = choose_terms(calib.error_model(robot, offsets="all", placements="all"), data)
    given = regions(calib.identify(choice.model, data), readings, positions)
    chosen = regions(choice.fit, readings, positions)
    return Told(len(choice.terms), given[0], chosen[0], given[1], chosen[1])


def regions(fit: calib.Fit, readings: Array, positions: Array) -> tuple[float, float]:
    """Return the share of 95 % regions that hold the true position, and stated over true errors."""
    found = calib.judging.tool_uncertainty(calib.machine_of(fit), readings)
    covariance = found.covariance[:, :3, :3]
    off = machines.predicted(fit, readings)[:, :3, 3] - positions
    squares = np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off[:, :, None])[..., 0])
    stated = np.mean(np.trace(covariance, axis1=1, axis2=2))
    holds = squares <= bound(0.95, 3, found.degrees_of_freedom)
    return float(np.mean(holds)), float(np.sqrt(stated / np.mean(np.sum(off**2, axis=1))))


def table(found: dict[tuple[str, int], list[Told]]) -> str:
    """Return a line for every kind and number of rows."""
    lines = [
        "| gears | rows | coefficients | regions that hold, counted as chosen | below 0.75 | ratio "
        "| as given: regions that hold | below 0.75 | ratio |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for (kind, rows), told in found.items():
        figures = [f"| {kind} | {rows} | {np.median([one.terms for one in told]):.0f} "]
        for holds, ratio in (("as_chosen", "ratio_as_chosen"), ("as_given", "ratio_as_given")):
            shares = np.array([getattr(one, holds) for one in told])
            middle = np.median([getattr(one, ratio) for one in told])
            figures.append(f"| {np.mean(shares):.3f} | {np.mean(shares < 0.75):.2f} | {middle:.2f} ")
        lines.append("".join(figures) + "|")
    return "\n".join(lines)


def main() -> int:
    """Simulate, print, and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--machines", type=int, default=40, help="of every kind and number of rows")
    parser.add_argument("--dataset", type=Path, help="folder of the measurements of a real UR10")
    parser.add_argument("--markdown", type=Path, help="the page of the table")
    given = parser.parse_args()
    find, kinds, marks = machine, KINDS, (BEGIN, END)
    if given.dataset is not None:
        find, kinds, marks = partial(some_of, measured(given.dataset)), ("of a real UR10",), (REAL, REAL_END)
    found: dict[tuple[str, int], list[Told]] = {}
    with one_thread():
        for kind in kinds:
            for rows in ROWS:
                found[kind, rows] = [find(seed, kind, rows) for seed in range(given.machines)]
                print(table({(kind, rows): found[kind, rows]}).splitlines()[-1], flush=True)
    if given.markdown is not None:
        write(given.markdown, table(found), *marks)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
