"""Do chosen joint terms harm where nothing was measured? Machines that were measured in a few small cubes alone.

    python scripts/studies/clusters.py [--machines 100] [--first 0] [--unmodelled 0] [--known] [--dataset REPOSITORY]

A UR10 is simulated, each time with other errors and four uneven gears, and measured in four to eight small cubes of
joint space, 0.05 mm of noise. Judged are twenty cubes elsewhere: how often is their 95 % quantile larger with the terms
that the tool chose than with geometry alone? ``--unmodelled``: amplitude in rad of an error of every joint that depends
on all of them, which no joint term can describe. ``--known``: how often
the terms that the simulated arm has would harm, fitted to the same rows. ``--dataset``: a clone of
https://github.com/christianlandgraf/ipa-robot-accuracy (MIT), whose series D is a real UR10 in five cubes (ISO 9283):
a random third of the rows is held out; its random poses elsewhere, series C, are judged with base and tool found anew.
"""

import argparse
import csv
import io
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray

import calib
from calib.assessment.choice import choose_terms
from calib.identification.error_model import with_terms
from calib.identification.identify import residuals_of
from calib.robot.terms.harmonic import harmonic
from scripts.examples.ur10_leica_job import JOINTS, number
from tests.support import machines
from tests.support.gears import UR10, geared

Array = NDArray[np.float64]

SIGMA = 5e-5
ORDERS = (1, 1, 2, 2, 3, 4, 5, 7, 10, 17, 25)
CUBES, ELSEWHERE = "Series_D/measurements_iso_cubes.csv", "Series_C/measurements_random_poses.csv"


class Simulated(NamedTuple):
    """Rows in a few cubes, the machine that they are of, readings in other cubes, and orders of waves by joint."""

    data: calib.Measurements
    machine: machines.Machine
    elsewhere: Array
    waves: Sequence[tuple[int, int]]


def simulated(seed: int, unmodelled: float) -> Simulated:
    """A machine of its own for every seed."""
    rng, plain = np.random.default_rng([seed, 5]), machines.arm(*UR10)
    waves = {(int(rng.integers(6)), int(k)): 10 ** rng.uniform(-4.3, -3.5) for k in rng.choice(ORDERS, 4)}
    phases = rng.uniform(0.0, 2.0 * np.pi, len(waves))
    slopes, starts = rng.normal(size=(6, 40, 6)), rng.uniform(0.0, 2.0 * np.pi, (6, 40))
    sizes = unmodelled * rng.normal(size=(6, 40)) / np.sqrt(20.0)

    def extra(u: Array) -> Array:
        found = np.column_stack([np.cos(u @ slopes[j].T + starts[j]) @ sizes[j] for j in range(6)])
        for phase, ((joint, order), amplitude) in zip(phases, waves.items(), strict=True):
            found[:, joint] += amplitude * np.cos(order * u[:, joint] - phase)
        return found

    tool = machines.pose((0.05, 0.02, 0.15))
    machine = machines.Machine(geared(plain.moved(rng), extra), machines.anywhere(rng), {"tool": tool})
    places, width, rows = int(rng.integers(4, 9)), rng.uniform(0.1, 0.5), int(rng.integers(20, 80))

    def cubes(many: int) -> Array:
        return np.concatenate([c + rng.uniform(-width, width, (rows, 6)) for c in rng.uniform(-2.5, 2.5, (many, 6))])

    data = machine.measure(machines.load(*UR10), cubes(places), "position", rng=rng, sigma=SIGMA)
    return Simulated(data, machine, cubes(20), sorted(waves))


def p95(fit: calib.Fit, machine: machines.Machine, readings: Array) -> float:
    missed = machines.predicted(fit, readings)[:, :3, 3] - machine.see(readings)[:, :3, 3]
    return 1e3 * float(np.quantile(np.linalg.norm(missed, axis=1), 0.95))


def count(seeds: range, unmodelled: float, *, known: bool) -> None:
    """Print how often terms harm, and what they bring."""
    model = calib.error_model(machines.load(*UR10), offsets="all", placements="all")
    joints = [reading.name for reading in model.robot.readings]
    chosen, there = dict.fromkeys(seeds, 1.0), dict[int, float]()
    taken = 0
    for seed in seeds:
        data, machine, elsewhere, waves = simulated(seed, unmodelled)
        choice = choose_terms(model, data)
        alone = p95(choice.geometric, machine, elsewhere)
        if choice.taken:
            taken += 1
            chosen[seed] = p95(choice.fit, machine, elsewhere) / alone
            if chosen[seed] > 1.0:
                print(f"machine {seed}: {chosen[seed]:.3f} of geometry, {choice.taken} steps", flush=True)
        if known:
            own = with_terms(model, [term for joint, order in waves for term in harmonic(joints[joint], order)])
            there[seed] = p95(calib.identify(own, data), machine, elsewhere) / alone
    print(f"{len(seeds)} machines, {taken} given terms: {told(chosen)}")
    if known:
        print(f"given those that are there: {told(there)}")


def told(ratios: dict[int, float]) -> str:
    found = np.array(list(ratios.values()))
    return (
        f"p95 elsewhere is larger in {np.sum(found > 1.0)}; of geometry's it is "
        f"{np.exp(np.mean(np.log(found))):.2f} on average, {found.max():.3f} at most"
    )


def series(repository: Path, path: str, robot: calib.Robot) -> calib.Measurements:
    """Positions of one series of the repository."""
    git = repository if (repository / "HEAD").is_file() else repository / ".git"
    source = subprocess.run(
        ["git", f"--git-dir={git}", "show", f"HEAD:{path}"], check=True, stdout=subprocess.PIPE
    ).stdout.decode("utf-8-sig")
    rows = list(csv.DictReader(io.StringIO(source), delimiter=";"))
    columns = {f"{name} [rad]": np.array([number(row[name], name) for row in rows]) for name in JOINTS}
    columns |= {f"{axis} [mm]": np.array([number(row[f"measurement_{axis}"], axis) for row in rows]) for axis in "xyz"}
    return calib.read_measurements(columns, robot)


def real(repository: Path, splits: int = 2) -> None:
    """Print rms, p95 and largest error in mm of rows held out and of poses elsewhere, of a real UR10 in five cubes."""
    robot = machines.load(*UR10)
    data, elsewhere = (series(repository, path, robot) for path in (CUBES, ELSEWHERE))
    for seed in range(splits):
        order = np.random.default_rng(seed).permutation(len(data))
        test, seen = data.subset(order[: len(order) // 3]), data.subset(order[len(order) // 3 :])
        plain = calib.error_model(robot, offsets="all", placements="all")
        choice = choose_terms(plain, seen)
        learning = choose_terms(replace(plain, priors=calib.Priors("learned", "learned", "learned", "learned")), seen)
        fits = {
            "geometry": choice.geometric,
            "geometry, widths learned": learning.geometric,
            f"{len(choice.terms)} terms": choice.fit,
            f"{len(learning.terms)} terms, all widths learned": learning.fit,
        }
        for name, fit in fits.items():
            print(f"split {seed}, {len(seen)} rows, {name}: converged: {fit.converged}")
            print(f"  held out: {figures(fit, test)}")
            moved = calib.identify(fit.model, elsewhere, free=["base.*", "tool.*"], start=fit)
            print(f"  elsewhere: {figures(moved, elsewhere)}", flush=True)


def figures(fit: calib.Fit, data: calib.Measurements) -> str:
    (r,) = residuals_of(fit, [data], fit.machine)
    error = 1e3 * np.linalg.norm(r, axis=1)
    return f"rms {np.sqrt(np.mean(error**2)):.3f}, p95 {np.quantile(error, 0.95):.3f}, largest {error.max():.3f} mm"


def main() -> None:
    """Simulate or read, choose, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--machines", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="the first machine's number (default: 0)")
    parser.add_argument("--unmodelled", type=float, default=0.0)
    parser.add_argument("--known", action="store_true", help="judge the terms that are there as well")
    parser.add_argument("--dataset", type=Path)
    chosen = parser.parse_args()
    if chosen.dataset is not None:
        real(chosen.dataset)
    if chosen.machines:
        count(range(chosen.first, chosen.first + chosen.machines), chosen.unmodelled, known=chosen.known)


if __name__ == "__main__":
    main()
