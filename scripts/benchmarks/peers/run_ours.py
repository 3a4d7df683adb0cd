"""calib in the race of scripts/benchmarks/benchmark_peers.py: all placements and offsets, or chosen joint terms, too.

The guesses of base and tool are left unread: to find them is part of what is timed.
"""

from pathlib import Path

import exchange
import numpy as np

# Loaded by a fit when it first needs them; the watch leaves out importing, as of all programs.
import scipy.linalg
import scipy.optimize
import scipy.sparse.csgraph
import scipy.special  # noqa: F401
from exchange import Case, Solved, Stopwatch

import calib
from calib.judging import choose_terms


def solve(case: Case, urdf: Path, setting: str) -> Solved:
    robot = calib.load_robot(urdf, tip=exchange.TIP)
    columns = {f"{reading.name} [rad]": case.readings[:, k] for k, reading in enumerate(robot.readings)}
    columns |= {f"{axis} [m]": case.measured[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"sigma_{axis} [m]": case.sigma[:, k] for k, axis in enumerate("xyz")}
    data = calib.read_measurements(columns, robot, "position")
    model = calib.error_model(robot, offsets="all", placements="all")
    with Stopwatch() as watch:
        if setting == "terms":
            model = choose_terms(model, data).model
        fit = calib.identify(model, data)
    machine = fit.machine
    tips = fit.robot.tips(case.unseen, machine.deviations)
    predicted = (machine.frames.base @ tips @ machine.frames.tools[0])[:, :3, 3]
    said = f"{fit.rank} combinations seen, {fit.numerical_rank} of them well; {fit.evaluations} evaluations"
    if setting == "terms":
        said += f"; {len(model.robot.terms)} coefficients of joint terms chosen"
    return Solved(np.asarray(predicted), watch, len(fit.parameters), fit.converged, said)


if __name__ == "__main__":
    exchange.run(solve, ("urdf-calib", "pin", "numpy", "scipy"))
