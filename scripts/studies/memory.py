"""Temperature with memory and wind-up by friction: are they found where they are, and only there?

    python scripts/studies/memory.py [--machines 100] [--first 0] [--none 100]

A UR10 works and rests by turns while it is measured in 400 random poses, 0.05 mm of noise, for four hours: one drive
lags behind the temperature with a time constant between 5 minutes and an hour, and two rub by a fifth to a half of
their compliances. Printed is how far coefficients are off that the job frees; then, of machines with no joint term at
all, how many were given one by `terms = "auto"`, offered these among all others.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray

import calib
from calib.assessment.choice import choose_terms
from calib.robot.terms.warming import USUAL
from tests.support import machines, slow
from tests.support.gears import UR10

Array = NDArray[np.float64]


def off(seed: int) -> dict[str, float]:
    """How far coefficients of one machine are off, as a share of what they are."""
    rng = np.random.default_rng([seed, 3])
    warm, tau = slow.LIFT[int(rng.integers(2))], float(np.exp(rng.uniform(np.log(300.0), np.log(3600.0))))
    winds = dict(zip(slow.LIFT, (9e-6, 1.4e-5), strict=False))
    rubs = {name: compliance * rng.uniform(0.2, 0.5) for name, compliance in winds.items()}
    truth = slow.Slow(seed, {warm: (rng.choice([-1.0, 1.0]) * rng.uniform(6e-5, 1.2e-4), tau)}, rubs, winds)
    terms = {"warming": [warm], "hysteresis": list(rubs), "elastic": list(rubs)}
    model = machines.model(machines.load(*UR10), offsets="all", placements="all", **terms)
    fit = calib.identify(model, truth.measured(400)[0])
    found = {
        "warming": fit.value(f"{warm}.warming_{USUAL}") / truth.warms[warm][0],
        "time constant": USUAL * 10.0 ** fit.value(f"{warm}.warming_time_{USUAL}") / tau,
    }
    found |= {f"hysteresis, {name}": fit.value(f"{name}.hysteresis") / value for name, value in rubs.items()}
    return {name: abs(ratio - 1.0) for name, ratio in found.items()}


def main() -> None:
    """Simulate, identify, choose, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--machines", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="the first machine's number (default: 0)")
    parser.add_argument("--none", type=int, default=100, help="machines without joint terms")
    chosen = parser.parse_args()
    every = [off(seed) for seed in range(chosen.first, chosen.first + chosen.machines)]
    for name in every[0] if every else ():
        shares = np.array([one[name] for one in every])
        print(
            f"{name}: off by {100.0 * np.median(shares):.1f} % (median), {100.0 * shares.max():.1f} % (largest), "
            f"within 10 % in {np.sum(shares < 0.1)} of {len(shares)}",
            flush=True,
        )
    model = calib.error_model(machines.load(*UR10), offsets="all", placements="all")
    given = []
    for seed in range(chosen.first, chosen.first + chosen.none):
        terms = choose_terms(model, slow.Slow(seed, {}, {}, {}).measured()[0]).terms
        given += [f"machine {seed}: {', '.join(term.name for term in terms)}"] if terms else []
    print(f"of {chosen.none} machines without joint terms {len(given)} were given some")
    print("\n".join(given))


if __name__ == "__main__":
    main()
