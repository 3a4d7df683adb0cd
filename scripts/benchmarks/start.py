"""What does a start cost? Processor time of whole processes, as multiples of what no program of this kind can go below.

    python scripts/benchmarks/start.py [repeats]

Compared are ``calib --help`` with ``import numpy``, and a calibration of a UR10 from 100 rows, from the command line to
its folder of results, with ``import scipy.optimize``: with the meshes of its scene kept in the cache from a run before,
and without. All are run in turn, several times; the table has medians and their ratios.
"""

import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

import calib
from calib.foundations import rigid

CALIB = "from calib_start import main; main()"
URDF = "example:ur_description/urdf/ur10_robot.urdf"
JOB = f"""schema = 1
[robot]
urdf = "{URDF}"
tip = "tool0"
[error_model]
offsets = "all"
placements = "all"
base = "pose"
tool = "position"
[[measurements]]
file = "identification.csv"
observes = "position"
sigma = "0.02 mm"
"""


def simulated(rows: int = 100) -> str:
    """Return a table of positions of a UR10 that is off by some tenths of a millimetre and milliradians."""
    robot = calib.load_robot(URDF, tip="tool0")
    chance = np.random.default_rng(0)
    exact = robot.no_deviations()
    off = calib.Deviations(
        chance.normal(scale=3e-4, size=exact.placements.shape),
        chance.normal(scale=2e-3, size=exact.offsets.shape),
        exact.terms,
    )
    base = rigid.placement(rigid.exp3(np.array([0.0, 0.0, 0.4])), np.array([1.2, -0.3, 0.1]))
    readings = chance.uniform(-1.5, 1.5, (rows, len(robot.readings)))
    tips = base @ robot.tips(readings, off) @ rigid.translation(np.array([0.05, 0.0, 0.05]))
    points = 1e3 * (tips[:, :3, 3] + chance.normal(scale=2e-5, size=(rows, 3)))
    lines = [", ".join([*(f"{reading.name} [rad]" for reading in robot.readings), "x [mm]", "y [mm]", "z [mm]"])]
    lines += [", ".join(f"{value:.6f}" for value in row) for row in np.hstack([readings, points])]
    return "\n".join(lines) + "\n"


def seconds(*command: str, **environment: str) -> float:
    """Return the processor time of a process and its children."""
    # Where nothing may be compiled beforehand, every process compiles all of the project.
    settings: Mapping[str, str] = {
        **os.environ,
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONDONTWRITEBYTECODE": "",
        **environment,
    }
    before = os.times()
    subprocess.run([sys.executable, "-c", *command], env=settings, stdout=subprocess.DEVNULL, check=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def main(repeats: int) -> None:
    """Measure, and print the table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "identification.csv").write_text(simulated(), encoding="utf-8")
        (folder / "calibration.toml").write_text(JOB, encoding="utf-8")
        job = (CALIB, "calibrate", str(folder / "calibration.toml"), "-o", str(folder / "out"))
        kept, off = str(folder / "cache"), "off"
        runs = {
            "import numpy": lambda: seconds("import numpy"),
            "calib --help": lambda: seconds(CALIB, "--help"),
            "import scipy.optimize": lambda: seconds("import scipy.optimize"),
            "UR10, 100 rows": lambda: seconds(*job, CALIB_CACHE=kept),
            "UR10, 100 rows, no cache": lambda: seconds(*job, CALIB_CACHE=off),
        }
        for run in runs.values():  # compiles what was never imported, fills the cache
            run()
        times: dict[str, list[float]] = {what: [] for what in runs}
        for _ in range(repeats):
            for what, run in runs.items():
                times[what].append(run())
    found = {what: statistics.median(every) for what, every in times.items()}
    print("| | s | times | as much as |\n|---|---|---|---|")
    for what, unit in (
        ("calib --help", "import numpy"),
        ("UR10, 100 rows", "import scipy.optimize"),
        ("UR10, 100 rows, no cache", "import scipy.optimize"),
    ):
        print(f"| {what} | {found[what]:.2f} | {found[what] / found[unit]:.2f} | `{unit}`, {found[unit]:.2f} s |")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 7)
