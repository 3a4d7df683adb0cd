"""Turn the public UR10 / Leica T-Mac measurements into a job folder.

    python scripts/examples/ur10_leica_job.py <ur10_leica folder> <output folder> [--observes position|pose] [--seed 0]
    calib calibrate <output folder>/calibration.toml -o out/

Data: Landgraf et al., CASE 2021, github.com/christianlandgraf/ipa-robot-accuracy (MIT), file series_b.csv. A random
third of the rows is held out: the first third of numpy's default_rng(seed).permutation.

All rows are taken as published. Worth knowing: 293 poses were visited twice and repeat to 0.08 mm, except at lines 534
and 1065 (measurement copied from the line before) and 856 and 857 (2 mm off their twins).
"""

import argparse
import csv
import sys
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Observed = Literal["position", "pose"]

FILE = "series_b.csv"
JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
AXES = ("x", "y", "z")
TURNS = ("rx", "ry", "rz")


class NotTheDatasetError(Exception):
    """The folder does not hold the data this script reads."""


def read(folder: Path) -> dict[str, Array]:
    """Read the columns that are used, by name: `;` separates, the decimal mark is a comma."""
    path = folder / FILE
    if not path.is_file():
        raise NotTheDatasetError(f"{folder} is not the ur10_leica dataset: it has no {FILE}.")
    needed = [*JOINTS, *(f"measurement_{kind}{axis}" for kind in ("", "std_") for axis in (*AXES, *TURNS))]
    with path.open(encoding="utf-8-sig", newline="") as stream:
        reader = csv.DictReader(stream, delimiter=";")
        missing = [name for name in needed if name not in (reader.fieldnames or ())]
        if missing:
            raise NotTheDatasetError(f"{path} is not the ur10_leica dataset: column {missing[0]!r} is missing.")
        columns: dict[str, list[float]] = {name: [] for name in needed}
        for row in reader:
            for name, values in columns.items():
                values.append(number(row[name], f"{path}:{reader.line_num}: {name}"))
    if not columns[JOINTS[0]]:
        raise NotTheDatasetError(f"{path} has no rows.")
    data = {name: np.array(values) for name, values in columns.items()}
    for name in needed:
        if "_std_" in name and np.any(data[name] <= 0.0):
            line = int(np.argmax(data[name] <= 0.0)) + 2
            raise NotTheDatasetError(f"{path}:{line}: {name} is not positive.")
    return data


def number(text: str | None, where: str) -> float:
    try:
        value = float((text or "").replace(",", "."))
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise NotTheDatasetError(f"{where}: {text!r} is not a number.")
    return value


def table_columns(data: dict[str, Array], observes: Observed) -> dict[str, Array]:
    """The columns of a measurement table, all rows, in the order they are written."""
    columns = {f"{joint} [rad]": data[joint] for joint in JOINTS}
    columns |= {f"{axis} [mm]": data[f"measurement_{axis}"] for axis in AXES}
    if observes == "pose":
        # Capitals: each turn is about the axis the turns before have left (intrinsic).
        turns = np.column_stack([data[f"measurement_{turn}"] for turn in TURNS])
        quaternions = Rotation.from_euler("XYZ", turns, degrees=True).as_quat(canonical=True)
        columns |= {name: quaternions[:, k] for name, k in (("qw", 3), ("qx", 0), ("qy", 1), ("qz", 2))}
    columns |= {f"sigma_{axis} [mm]": data[f"measurement_std_{axis}"] for axis in AXES}
    if observes == "pose":
        columns |= {f"sigma_{turn} [deg]": data[f"measurement_std_{turn}"] for turn in TURNS}
    return columns


def table(columns: dict[str, Array], rows: NDArray[np.intp], seed: int) -> str:
    total = len(next(iter(columns.values())))
    lines = [
        "# UR10 measured with a Leica T-Mac; Landgraf et al., CASE 2021, christianlandgraf/ipa-robot-accuracy (MIT).",
        f"# {len(rows)} of {total} rows of {FILE}, shuffled: scripts/examples/ur10_leica_job.py, seed {seed}.",
        ", ".join(columns),
    ]
    lines += [", ".join(repr(float(values[row])) for values in columns.values()) for row in rows]
    return "\n".join([*lines, ""])


def job(observes: Observed) -> str:
    return f"""\
# UR10 and laser tracker: scripts/examples/ur10_leica_job.py. Every row has its own standard deviations (columns
# sigma_*): the scatter of the tracker while the robot stood still. How well the robot itself repeats is not in them.
schema = 1

[robot]
urdf = "example:ur_description/urdf/ur10_robot.urdf"
tip = "tool0"

[error_model]
offsets = "all"
placements = "all"
base = "pose"
tool = "{observes}"

[[measurements]]
file = "identification.csv"
observes = "{observes}"

[[measurements]]
file = "validation.csv"
observes = "{observes}"
use = "validate"
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, help=f"folder with {FILE}")
    parser.add_argument("output", type=Path, help="job folder to write")
    parser.add_argument("--observes", choices=("position", "pose"), default="position")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    try:
        columns = table_columns(read(arguments.dataset), arguments.observes)
    except NotTheDatasetError as problem:
        print(problem, file=sys.stderr)
        return 1
    order = np.random.default_rng(arguments.seed).permutation(len(next(iter(columns.values()))))
    held_out = len(order) // 3
    texts = {
        "validation.csv": table(columns, order[:held_out], arguments.seed),
        "identification.csv": table(columns, order[held_out:], arguments.seed),
        "calibration.toml": job(arguments.observes),
    }
    arguments.output.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (arguments.output / name).write_text(text, encoding="utf-8", newline="\n")
        print(arguments.output / name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
