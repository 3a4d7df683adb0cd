"""How much does the stated uncertainty depend on the order of the rows, where nothing drifts?

    python scripts/studies/row_order.py [--sessions 20] [--orders 5] [--poses 40]

A UR10 of which every placement and zero is off is measured at random poses, with 0.03 mm of noise. The rows of each
session are put in several orders, and it is identified from each. Printed is by what share of its mean the stated
standard deviation of the tool, rms over 100 other poses, scatters among the orders of a session, and how far apart the
tools of two orders are.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray

import calib
from calib.judging import tool_uncertainty
from tests.support import machines
from tests.support.gears import UR10

Array = NDArray[np.float64]
SIGMA = 3e-5
TOOL = (0.05, 0.02, 0.15)


def stated(seed: int, poses: int, orders: int) -> tuple[Array, float]:
    """What is stated (orders,) in m of one session, and how far apart in m tools of two orders are at most."""
    rng = np.random.default_rng([seed, 1])
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    true = machines.Machine(arm.moved(rng), machines.anywhere(rng), {"tool": machines.pose(TOOL)})
    readings, others = arm.draw(rng, poses), arm.draw(rng, 100)
    measured = true.see(readings)[:, :3, 3] + rng.normal(scale=SIGMA, size=(poses, 3))
    columns = {f"{r.name} [rad]": readings[:, k] for k, r in enumerate(robot.readings)}
    columns |= {f"{axis} [m]": measured[:, k] for k, axis in enumerate("xyz")}
    model = calib.error_model(robot, offsets="all", placements="all")
    found, tools = [], []
    for _ in range(orders):
        order = rng.permutation(poses)
        data = calib.read_measurements({name: column[order] for name, column in columns.items()}, robot, sigma=SIGMA)
        machine = calib.machine_of(calib.identify(model, data))
        found.append(np.sqrt(np.mean(tool_uncertainty(machine, others).position ** 2)))
        tools.append(machine.predict(others)[:, :3, 3])
    return np.array(found), float(np.abs(np.array(tools) - tools[0]).max())


def main() -> None:
    """Simulate, identify, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sessions", type=int, default=20)
    parser.add_argument("--orders", type=int, default=5)
    parser.add_argument("--poses", type=int, default=40)
    chosen = parser.parse_args()
    every = [stated(seed, chosen.poses, chosen.orders) for seed in range(chosen.sessions)]
    scatter = np.array([100.0 * found.std(ddof=1) / found.mean() for found, _ in every])
    spread = np.array([100.0 * np.ptp(found) / found.mean() for found, _ in every])
    print(f"{chosen.poses} poses, {chosen.sessions} sessions, {chosen.orders} orders of each:")
    print(f"standard deviation {np.median(scatter):.1f} % (median), {scatter.max():.1f} % (largest)")
    print(f"from least to most {np.median(spread):.1f} % (median), {spread.max():.1f} % (largest)")
    print(f"tools of two orders are at most {1e9 * max(apart for _, apart in every):.2g} nm apart")


if __name__ == "__main__":
    main()
