"""Are chosen poses better than random ones? By the criterion on a UR10, and by held-out errors of a real one.

    python scripts/studies/pose_choice.py [--dataset <ur10_leica folder>] [--out docs/pose_choice.md]

The real one: Landgraf et al., CASE 2021 (see scripts/examples/ur10_leica_job.py). A third of the rows is held out; of
the others poses are chosen by their readings alone, and what was measured there identifies offsets, placements, base
and tool.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import calib
from calib.assessment.candidates import PlannedMeasurement, random_candidates, rows, working_rows
from calib.assessment.design import choose, random_values, space
from calib.foundations import rigid
from calib.foundations.choices import Criterion
from calib.identification.identify import residuals_of
from calib.identification.initialisation.frames import initial_frames
from calib.identification.machine import Frames

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from scripts.examples import ur10_leica_job

Array = NDArray[np.float64]

SIGMA, MISFIT = 0.05e-3, 0.3e-3
CRITERIA: tuple[Criterion, ...] = ("D", "A", "I")
WAYS: tuple[tuple[str, Criterion, float], ...] = (
    ("I with misfit", "I", MISFIT),
    ("I without misfit", "I", 0.0),
    ("D", "D", 0.0),
    ("A", "A", 0.0),
)


def model_of(robot: calib.Robot) -> calib.ErrorModel:
    return calib.error_model(robot, offsets="all", placements="all")


def simulated(robot: calib.Robot) -> list[str]:
    """30 of 300 against 10 000 random designs, and the time of 60 of 10 000."""
    frames = Frames(np.eye(4)[None], rigid.translation(np.array([0.05, 0.0, 0.05]))[None])
    many = random_candidates(robot, frames, 10_000).readings
    few = many[:300]
    lines = [
        "## By the criterion",
        "",
        "A UR10, its reflector 50 mm off the axis of the flange; 30 of 300 random poses, against 10 000 random sets;",
        "then 60 of 10 000 poses, and how often their Jacobians could have been built in the same time. D: log det",
        "of the information; A: sum of the parameters' variances, in parameter scales; I: rms of the tool, mm.",
        "",
        "| criterion | misfit | chosen | best random | median random | 60 of 10 000, Jacobians |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for misfit in (0.0, MISFIT):
        how, model = PlannedMeasurement(frames, "position", SIGMA, misfit=misfit), model_of(robot)
        began = time.perf_counter()
        all_rows = rows(model, how, many)
        building = time.perf_counter() - began
        for criterion in CRITERIA if misfit == 0.0 else ("I",):
            s = space(rows(model, how, few), criterion, working_rows(model, how, few))
            found, random = choose(s, 30), random_values(s, 30, 10_000)
            best = random.max() if criterion == "D" else random.min()
            large = space(all_rows, criterion, working_rows(model, how, few))
            began = time.perf_counter()
            choose(large, 60)
            ratio = (time.perf_counter() - began) / building
            shown = [found.value, best, float(np.median(random))]
            if criterion == "I":
                shown = [1e3 * np.sqrt(value) for value in shown]
            figures = " | ".join(f"{value:.4f}" for value in shown)
            lines.append(f"| {criterion} | {misfit * 1e3:g} mm | {figures} | {ratio:.0f} |")
    return [*lines, ""]


def errors(model: calib.ErrorModel, data: calib.Measurements, chosen: Array, test: calib.Measurements) -> Array:
    """Mean and largest held-out error in mm."""
    fit = calib.identify(model, data.subset(chosen))
    (r,) = residuals_of(fit, [test], fit.machine)
    norms = np.linalg.norm(r, axis=1)
    return 1e3 * np.array([norms.mean(), norms.max()])


def real(robot: calib.Robot, dataset: Path, splits: int, sets: int) -> list[str]:
    model = model_of(robot)
    data = calib.read_measurements(ur10_leica_job.table_columns(ur10_leica_job.read(dataset), "position"), robot)
    lines = [
        "## On a real UR10",
        "",
        f"{len(data)} positions by a laser tracker; a third held out at random, poses chosen from the others by their",
        f"readings alone. mm, held-out rows; random: medians of {sets} sets. Split 0 is that of",
        "scripts/examples/ur10_leica_job.py. Random sets of 45 have nearly the largest error that all rows leave: the",
        "last column is what could be gained. Where all rows leave 1.7 mm or more, it is one of three rows known as",
        "wrong (534, 856, 857: see scripts/examples/ur10_leica_job.py), and says little about the choice of poses.",
        "",
        "| split | 30 random, mean | 30 chosen, mean | 45 random, max | 30 chosen, max | all rows, max |",
        "|--:|--:|--:|--:|--:|--:|",
    ]
    shares: dict[str, list[Array]] = {name: [] for name, *_ in WAYS}
    shares["all rows"] = []
    for split in range(splits):
        order = np.random.default_rng(split).permutation(len(data))
        pool, test = order[len(order) // 3 :], data.subset(order[: len(order) // 3])
        rng = np.random.default_rng(1000 + split)
        thirty, more = (
            np.median([errors(model, data, rng.permutation(pool)[:n], test) for _ in range(sets)], axis=0)
            for n in (30, 45)
        )
        reference = np.array([thirty[0], more[1]])
        frames = initial_frames(model, [data.subset(pool)])
        for name, criterion, misfit in WAYS:
            how = PlannedMeasurement(frames, "position", SIGMA, misfit=misfit)
            q = data.readings[pool]
            chosen = choose(space(rows(model, how, q), criterion, working_rows(model, how, q)), 30).chosen
            shares[name].append(errors(model, data, pool[list(chosen)], test) / reference)
        shares["all rows"].append(errors(model, data, pool, test) / reference)
        mean, largest = shares["I with misfit"][-1] * reference
        most = (shares["all rows"][-1] * reference)[1]
        lines.append(f"| {split} | {thirty[0]:.3f} | {mean:.3f} | {more[1]:.3f} | {largest:.3f} | {most:.3f} |")
    lines += [
        "",
        "Held-out errors as shares of the random ones, over all splits: the mean of 30 poses by that of 30 random",
        "ones, the largest by that of 45 random ones.",
        "",
        "| poses | mean, on average | mean, worst split | max, on average | splits with max <= 1 |",
        "|---|--:|--:|--:|--:|",
    ]
    for name, found in shares.items():
        r = np.array(found)
        lines.append(
            f"| {name} | {r[:, 0].mean():.3f} | {r[:, 0].max():.3f} | {r[:, 1].mean():.3f} | "
            f"{np.count_nonzero(r[:, 1] <= 1.0)} of {splits} |"
        )
    return [*lines, ""]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", type=Path, help="folder ur10_leica; without it only the simulated part is done")
    parser.add_argument("--out", type=Path, default=Path("docs/pose_choice.md"))
    parser.add_argument("--splits", type=int, default=20)
    parser.add_argument("--sets", type=int, default=100)
    arguments = parser.parse_args()
    robot = calib.load_robot("example:ur_description/urdf/ur10_robot.urdf", tip="tool0")
    lines = ["# Chosen poses against random ones", "", "Made by `python scripts/studies/pose_choice.py`.", ""]
    lines += simulated(robot)
    if arguments.dataset is not None:
        lines += real(robot, arguments.dataset, arguments.splits, arguments.sets)
    text = "\n".join(lines)
    arguments.out.write_text(text, encoding="utf-8", newline="\n")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
