"""Geometry from rows in a few places: do learned widths of its priors harm where nothing was measured?

    python scripts/studies/places.py [--machines 100] [--first 3000] [--kind joints|cubes|fixed]

UR10s with uneven gears as in scripts/studies/clusters.py, measured in a few places. Which: "joints": small cubes of
joint space; "cubes": cubes of space, in each of which the tool keeps its orientation; "fixed": the same, and one
orientation for all places but for quarter turns about the vertical, so that nothing tells tool from base. Judged by
95 % quantiles of errors in random cubes of joint space elsewhere, base and tool as they were found, and found anew: of
geometry with learned widths relative to geometry without priors.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Literal

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib
from calib.assessment.validation import neighbourhoods, row_groups
from scripts.studies.clusters import SIGMA, p95, simulated
from tests.support import machines
from tests.support.gears import UR10

Array = NDArray[np.float64]
Kind = Literal["joints", "cubes", "fixed"]

ARM = machines.arm(*UR10)
# By more than this a 95 % quantile is called larger.
WORSE = 1.02


def reached(start: Array, goal: Array) -> Array:
    """Readings (k, 6) near ``start`` (6,) at which the nominal arm's tip is at goals (n, 4, 4), where it gets there."""
    q = np.tile(start, (len(goal), 1))
    for _ in range(30):
        T = ARM.tips(q)
        turned = goal[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
        miss = np.concatenate([goal[:, :3, 3] - T[:, :3, 3], Rotation.from_matrix(turned).as_rotvec()], axis=1)
        J = np.empty((len(q), 6, 6))
        for j, step in enumerate(1e-5 * np.eye(6)):
            moved = ARM.tips(q + step)
            turn = moved[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
            J[:, :3, j] = (moved[:, :3, 3] - T[:, :3, 3]) / 1e-5
            J[:, 3:, j] = Rotation.from_matrix(turn).as_rotvec() / 1e-5
        normal = np.swapaxes(J, 1, 2) @ J + 1e-5 * np.eye(6)
        q = q + np.clip(np.linalg.solve(normal, np.swapaxes(J, 1, 2) @ miss[:, :, None])[:, :, 0], -0.3, 0.3)
    return q[(np.linalg.norm(miss, axis=1) < 1e-4) & (np.abs(q - start).max(axis=1) < 1.5)]


def in_cubes(rng: np.random.Generator, kind: Kind) -> Array:
    """Readings in three to seven cubes of space, the tool's orientation the same in each cube, or in all of them."""
    places, rows, side = int(rng.integers(3, 8)), int(rng.integers(20, 100)), rng.uniform(0.2, 0.8)
    common = ARM.tips(rng.uniform(-2.5, 2.5, (1, 6)))[0]
    found: list[Array] = []
    while len(found) < places:
        start = rng.uniform(-2.5, 2.5, 6)
        goal = ARM.tips(start[None])
        if kind == "fixed":
            goal[:, :3, :3] = Rotation.from_euler("z", 90 * rng.integers(4), degrees=True).as_matrix() @ common[:3, :3]
            there = reached(start, goal)
            if not len(there):
                continue
            start = there[0]
        goal = np.tile(goal, (rows, 1, 1))
        goal[:, :3, 3] += rng.uniform(-side / 2, side / 2, (rows, 3))
        there = reached(start, goal)
        if len(there) >= 10:
            found.append(there)
    return np.concatenate(found)


def anew(fit: calib.Fit, machine: machines.Machine, readings: Array) -> float:
    """The 95 % quantile in mm of a fit's errors with base and tool found anew there."""
    seen = machine.see(readings)
    data = calib.read_measurements(machines.table(ARM, readings, seen, "position"), fit.model.robot, sigma=SIGMA)
    moved = calib.identify(fit.model, data, free=["base.*", "tool.*"], start=fit)
    return p95(moved, machine, readings)


def told(ratios: list[tuple[float, float]]) -> None:
    """Print how many are larger, and by how much."""
    for what, found in zip(("as found", "anew"), np.array(ratios).T, strict=True):
        print(
            f"learned widths, base and tool {what}: {np.sum(found > WORSE)} of {len(found)} larger by more than 2 %, "
            f"{np.exp(np.mean(np.log(found))):.3f} on average, {found.min():.3f} to {found.max():.3f}",
            flush=True,
        )


def main() -> None:
    """Simulate, fit, judge, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--machines", type=int, default=100)
    parser.add_argument("--first", type=int, default=3000)
    parser.add_argument("--kind", choices=("joints", "cubes", "fixed"), default="joints")
    chosen = parser.parse_args()
    robot = machines.load(*UR10)
    model = calib.error_model(robot, offsets="all", placements="all")
    held = replace(model, priors=calib.Priors("learned", "learned"))
    every: list[tuple[float, float]] = []
    for seed in range(chosen.first, chosen.first + chosen.machines):
        data, machine, elsewhere, _ = simulated(seed, 0.0)
        rng = np.random.default_rng([seed, 9])
        if chosen.kind != "joints":
            data = machine.measure(robot, in_cubes(rng, chosen.kind), "position", rng=rng, sigma=SIGMA)
        if not neighbourhoods([data], row_groups([data])).apart:
            continue
        fits = calib.identify(model, data), calib.identify(held, data)
        some = elsewhere[:: max(len(elsewhere) // 100, 1)]
        without, learned = ((p95(fit, machine, elsewhere), anew(fit, machine, some)) for fit in fits)
        every.append((learned[0] / without[0], learned[1] / without[1]))
        print(f"machine {seed}: {every[-1][0]:.3f}, anew {every[-1][1]:.3f}", flush=True)
    told(every)


if __name__ == "__main__":
    main()
