"""Do all harmonics with learned widths harm where nothing was measured? Machines with uneven gears, and without.

    python scripts/studies/all_harmonics.py [--machines 40] [--first 0] [--kind none|few|many]

A UR10 is simulated, each time with other errors, and measured at 60 to 600 random poses of a box of joint space,
0.05 mm of noise. Its gears are even (none), uneven in four orders (few), or in all orders up to 40, the less the higher
the order (many). Where the tool takes all harmonics, it is judged by 400 other poses of that box, and by 400 of the
whole joint space: how often is the rms larger than with the terms that it would have chosen without that offer?
"""

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray

import calib
from calib.assessment.choice import Choice, choose_terms
from calib.identification.error_model import with_terms
from tests.support import machines
from tests.support.gears import UR10, geared

Array = NDArray[np.float64]

SIGMA = 5e-5
ORDERS = (1, 1, 2, 2, 3, 4, 5, 7, 10, 17, 25)
UNSEEN = 400


class Simulated(NamedTuple):
    """Rows in a box, the machine that they are of, and readings in this box and in the whole joint space."""

    data: calib.Measurements
    machine: machines.Machine
    within: Array
    elsewhere: Array


def simulated(seed: int, kind: str) -> Simulated:
    """A machine of its own for every seed."""
    rng, plain = np.random.default_rng([seed, 20]), machines.arm(*UR10)
    k = np.arange(1, 41)
    sizes = np.zeros((6, 40))
    if kind == "few":
        for order in rng.choice(ORDERS, 4):
            sizes[rng.integers(6), order - 1] = 10 ** rng.uniform(-4.3, -3.5)
    elif kind == "many":
        sizes = 10 ** rng.uniform(-4.5, -3.5, (6, 1)) * rng.normal(size=(6, 40)) * k ** -rng.uniform(0.0, 1.0)
    phases = rng.uniform(0.0, 2.0 * np.pi, (6, 40))

    def extra(u: Array) -> Array:
        return np.asarray(np.sum(sizes * np.cos(k * u[:, :, None] - phases), axis=2))

    tool = machines.pose((0.05, 0.02, 0.15))
    machine = machines.Machine(geared(plain.moved(rng), extra), machines.anywhere(rng), {"tool": tool})
    centre, half = rng.uniform(-2.0, 2.0, 6), rng.uniform(0.5, 3.0)

    def box(n: int) -> Array:
        return np.clip(centre + rng.uniform(-half, half, (n, 6)), -np.pi, np.pi)

    rows = int(10 ** rng.uniform(np.log10(60.0), np.log10(600.0)))
    data = machine.measure(machines.load(*UR10), box(rows), "position", rng=rng, sigma=SIGMA)
    return Simulated(data, machine, box(UNSEEN), plain.draw(rng, UNSEEN))


def by_steps(choice: Choice) -> calib.ErrorModel:
    """Return the model with the terms that were chosen one by one, without priors."""
    steps = [step.added.terms for step in choice.steps[: choice.taken + 1] if step.added is not None]
    return with_terms(choice.geometric.model, [term for terms in steps for term in terms])


def count(seeds: range, kind: str) -> None:
    """Print how often all harmonics are taken, and harm."""
    model = calib.error_model(machines.load(*UR10), offsets="all", placements="all")
    ratios: dict[str, list[float]] = {"in the box": [], "elsewhere": []}
    given = 0
    for seed in seeds:
        data, machine, *unseen = simulated(seed, kind)
        choice = choose_terms(model, data)
        given += bool(choice.terms)
        if choice.all_harmonics is None or not choice.all_harmonics.taken:
            continue
        alone = calib.identify(by_steps(choice), data)
        found = []
        for own, readings in zip(ratios.values(), unseen, strict=True):
            own.append(machines.miss(choice.fit, machine, readings) / machines.miss(alone, machine, readings))
            found.append(f"{own[-1]:.3f}")
        print(
            f"machine {seed}: {len(data)} rows, {len(alone.model.terms)} terms chosen, {len(choice.terms)} with all "
            f"harmonics up to {choice.all_harmonics.order}: {' and '.join(found)} of the rms of those chosen",
            flush=True,
        )
    taken = len(ratios["elsewhere"])
    print(f"{len(seeds)} machines, {kind}: {given} given terms, {taken} all harmonics")
    for where, own in ratios.items():
        if own:
            mean, worse = np.exp(np.mean(np.log(own))), np.sum(np.array(own) > 1.0)
            print(f"  {where}: larger in {worse}, {mean:.2f} on average, {max(own):.3f} at most")


def main() -> None:
    """Simulate, choose, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--machines", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="the first machine's number (default: 0)")
    parser.add_argument("--kind", choices=("none", "few", "many"), default="many")
    chosen = parser.parse_args()
    count(range(chosen.first, chosen.first + chosen.machines), chosen.kind)


if __name__ == "__main__":
    main()
