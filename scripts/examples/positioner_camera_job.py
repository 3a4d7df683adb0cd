"""Turn the public measurements of a two-axis positioner before a camera into a job folder.

    python scripts/examples/positioner_camera_job.py <positioner_camera folder> <output folder> [--seed 0]
    calib calibrate <output folder>/calibration.toml -o out/

Data: ROS-Industrial, github.com/ros-industrial/industrial_calibration (Apache-2.0), examples/data/
kinematic_calibration: a fixed camera saw the pose of a target on the table of a part positioner at 205 pairs of joint
values. A random quarter of the rows is held out: the first quarter of numpy's default_rng(seed).permutation. The
nominal machine is the authors' DH table, Rz(q + theta) Tz(d) Tx(a) Rx(alpha): (d 0, theta 0, a 0, alpha -90 deg), (d
-0.475, theta -90 deg, a 0, alpha 0). Their file is YAML of the plainest kind and is read line by line.
"""

import argparse
import re
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FILE = "measurements.yaml"
JOINTS = ("joint_1", "joint_2")
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
_NUMBER = r"(-?[0-9]+(?:\.[0-9]*)?(?:e[+-]?[0-9]+)?)"
_RECORD = re.compile(r"'?[0-9]+'?:")
_VALUE = re.compile(rf"    (\w+): {_NUMBER}")
_JOINT = re.compile(rf"  - {_NUMBER}")
_SECTION = re.compile(r"  (camera_joints|pose|target_joints):(?: \[\])?")

URDF = """\
<?xml version="1.0"?>
<!-- A part positioner, after the DH table of its authors: scripts/examples/positioner_camera_job.py. -->
<robot name="part_positioner">
  <link name="base"/>
  <link name="cradle"/>
  <link name="table"/>
  <link name="target_mount"/>
  <joint name="joint_1" type="revolute">
    <parent link="base"/>
    <child link="cradle"/>
    <axis xyz="0 0 1"/>
    <limit lower="-3.2" upper="3.2" effort="0" velocity="0"/>
  </joint>
  <joint name="joint_2" type="continuous">
    <parent link="cradle"/>
    <child link="table"/>
    <origin xyz="0 0 0" rpy="-1.5707963267948966 0 0"/>
    <axis xyz="0 0 1"/>
  </joint>
  <joint name="target_mount" type="fixed">
    <parent link="table"/>
    <child link="target_mount"/>
    <origin xyz="0 0 -0.475" rpy="0 0 -1.5707963267948966"/>
  </joint>
</robot>
"""

JOB = """\
# A positioner and a camera: scripts/examples/positioner_camera_job.py. Nobody stated the camera's noise; it is
# estimated.
schema = 1

[robot]
urdf = "positioner.urdf"
tip = "target_mount"

[error_model]
placements = ["joint_2"]    # how the second axis lies to the first; where the first is, the base says
base = "pose"
tool = "pose"

[[measurements]]
file = "identification.csv"
observes = "pose"

[[measurements]]
file = "validation.csv"
observes = "pose"
use = "validate"
"""


class NotTheDatasetError(Exception):
    """The folder does not hold the data this script reads."""


def read(folder: Path) -> dict[str, Array]:
    """Return the columns of a measurement table, all rows."""
    path = folder / FILE
    if not path.is_file():
        raise NotTheDatasetError(f"{folder} is not the positioner_camera dataset: it has no {FILE}.")
    records: list[dict[str, float]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if _RECORD.fullmatch(line):
            records.append({})
        elif records and (value := _VALUE.fullmatch(line)):
            records[-1][value[1]] = float(value[2])
        elif records and (value := _JOINT.fullmatch(line)):
            joint = sum(name in records[-1] for name in JOINTS)
            records[-1][JOINTS[joint] if joint < len(JOINTS) else "a third joint"] = float(value[1])
        elif not (records and _SECTION.fullmatch(line)):
            raise NotTheDatasetError(f"{path}:{number}: {line!r} is not what this script reads.")
    for k, record in enumerate(records):
        if sorted(record) != sorted((*JOINTS, *POSE)):
            raise NotTheDatasetError(f"{path}: record {k + 1} has {', '.join(sorted(record))}.")
    if not records:
        raise NotTheDatasetError(f"{path} has no records.")
    columns = {f"{joint} [rad]": joint for joint in JOINTS} | {f"{axis} [m]": axis for axis in POSE[:3]}
    columns |= {name: name for name in POSE[3:]}
    return {title: np.array([record[name] for record in records]) for title, name in columns.items()}


def split(n: int, seed: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows to identify from and rows held out, three to one."""
    order = np.random.default_rng(seed).permutation(n)
    return order[n // 4 :], order[: n // 4]


def table(columns: dict[str, Array], rows: NDArray[np.intp], seed: int) -> str:
    total = len(next(iter(columns.values())))
    lines = [
        "# A part positioner before a camera; ros-industrial/industrial_calibration (Apache-2.0).",
        f"# {len(rows)} of {total} records of {FILE}, shuffled, seed {seed}: scripts/examples/positioner_camera_job.py",
        ", ".join(columns),
    ]
    lines += [", ".join(repr(float(values[row])) for values in columns.values()) for row in rows]
    return "\n".join([*lines, ""])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, help=f"folder with {FILE}")
    parser.add_argument("output", type=Path, help="job folder to write")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    try:
        columns = read(arguments.dataset)
    except NotTheDatasetError as problem:
        print(problem, file=sys.stderr)
        return 1
    identified, held_out = split(len(columns["x [m]"]), arguments.seed)
    texts = {
        "identification.csv": table(columns, identified, arguments.seed),
        "validation.csv": table(columns, held_out, arguments.seed),
        "positioner.urdf": URDF,
        "calibration.toml": JOB,
    }
    arguments.output.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (arguments.output / name).write_text(text, encoding="utf-8", newline="\n")
        print(arguments.output / name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
