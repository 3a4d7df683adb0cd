"""Error by model, held out, on real arms: base and tool alone, geometry, joint terms that are named, those chosen.

    python scripts/studies/terms_by_model.py <folder of datasets> [--figure docs/figures/joint_terms.svg]

Of a UR10 (ur10_leica) a random third of the rows is held out, and errors are rms; of two Pandas and an iiwa (sockets)
all places but one are, and errors are mean distances of the ball from the middle of its socket. Prints a table.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import calib
from calib.assessment.choice import choose_terms
from calib.foundations.errors import RobotError
from calib.identification.error_model import with_terms
from calib.identification.identify import residuals_of
from calib.identification.machine import Machine
from scripts.examples.sockets_leave_out import error_model, judged, load
from scripts.examples.ur10_leica_job import read, table_columns
from scripts.studies.sockets_figures import CASES

UR10 = "example:ur_description/urdf/ur10_robot.urdf"
ALL_ORDERS = tuple(range(1, 41))
# What is free beside geometry, as a job has it.
GIVEN: dict[str, dict[str, object]] = {
    "geometry": {},
    "wind-up": {"elastic": "all"},
    "harmonics 1, 2": {"harmonics": "all", "harmonic_orders": (1, 2)},
}
NAMES = ("base and tool", *GIVEN, "chosen", "all orders, widths learned")
Errors = dict[str, float]


def errors(model: calib.ErrorModel, data: calib.Measurements, error: Callable[[calib.Fit], float]) -> Errors:
    """Held-out error by model, in m; of arms whose URDF states no masses there is none for wind-up."""
    robot = model.urdf_robot
    found: Errors = {}
    for name, terms in GIVEN.items():
        try:
            chosen = calib.error_model(robot, terms=terms).robot.terms
        except RobotError as refusal:
            print(f"{data.where}, {name}: {refusal}")
            continue
        found[name] = error(calib.identify(with_terms(model, chosen), data))
    choice = choose_terms(model, data)
    print(f"{data.where}: {len(choice.terms)} terms chosen", flush=True)
    found["chosen"] = error(choice.fit)
    return found


def ur10(folder: Path) -> Errors:
    """A UR10, first third of a random order held out."""
    robot = calib.load_robot(UR10, tip="tool0")
    data = calib.read_measurements(table_columns(read(folder), "position"), robot)
    order = np.random.default_rng(0).permutation(len(data))
    test, seen = data.subset(order[: len(order) // 3]), data.subset(order[len(order) // 3 :])

    def rms(machine: Machine, fit: calib.Fit) -> float:
        (r,) = residuals_of(fit, [test], machine)
        return float(np.sqrt(np.mean(np.sum(r**2, axis=1))))

    model = calib.error_model(robot, offsets="all", placements="all")
    plain = calib.identify(model, seen)
    found = {"base and tool": rms(plain.nominal, plain)} | errors(model, seen, lambda fit: rms(fit.machine, fit))
    waves = {"harmonics": "all", "harmonic_orders": ALL_ORDERS}
    free = {"offsets": "all", "placements": "all"}
    learning = calib.error_model(robot, **free, terms=waves, priors=calib.Priors(harmonics="learned"))
    fit = calib.identify(learning, seen)
    return found | {"all orders, widths learned": rms(fit.machine, fit)}


def socket(folder: Path, arm: str, place: str) -> Errors:
    """An arm that was calibrated at one place, at all others."""
    robot, sets = load(folder, arm)
    others = [data for name, data in sets.items() if name != place]
    # Each table names its place as a group, and one group has no folds: here poses are held out.
    sets = {name: replace(data, group=None) for name, data in sets.items()}
    model = error_model(robot, [place], elastic=False)
    before = judged(calib.identify(model, sets[place]), others).before
    return {"base and tool": before} | errors(model, sets[place], lambda fit: judged(fit, others).after)


def draw(found: dict[str, Errors], path: Path) -> None:
    """Write a picture: one group of bars for every arm."""
    with rc_context({"svg.hashsalt": "joint terms", "svg.fonttype": "none"}):
        figure = Figure(figsize=(7.5, 3.6), layout="constrained")
        axes = figure.subplots()
        width = 0.8 / len(NAMES)
        for k, name in enumerate(NAMES):
            there = [(n, 1e3 * one[name]) for n, one in enumerate(found.values()) if name in one]
            at, values = zip(*there, strict=True)
            axes.bar(np.array(at) + (k - (len(NAMES) - 1) / 2) * width, values, width, label=name)
        axes.set(yscale="log", ylabel="error held out [mm]")
        axes.set_xticks(range(len(found)), list(found))
        axes.legend(ncols=2, fontsize="small")
        figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Identify, choose, print, draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("datasets", type=Path)
    parser.add_argument("--figure", type=Path)
    chosen = parser.parse_args()
    found = {"UR10": ur10(chosen.datasets / "ur10_leica")}
    for case in CASES:
        found[case.name] = socket(chosen.datasets / "sockets" / case.name, case.arm, case.place)
    print(f"| arm | {' | '.join(f'{name} [mm]' for name in NAMES)} |")
    print(f"|---{'|--:' * len(NAMES)}|")
    for arm, one in found.items():
        print(f"| {arm} | {' | '.join(f'{1e3 * one[name]:.3f}' if name in one else '-' for name in NAMES)} |")
    if chosen.figure is not None:
        draw(found, chosen.figure)


if __name__ == "__main__":
    main()
