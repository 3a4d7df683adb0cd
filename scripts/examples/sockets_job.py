"""Turn recordings of a ball in two printed sockets into a job folder: no instrument, joint angles alone.

    python scripts/examples/sockets_job.py <recordings> <output folder> --robot panda --identify front
    calib calibrate <output folder>/calibration.toml -o out/

Recordings are <place>/hole_0.csv and <place>/hole_1.csv: seven joint angles in rad a row and no header; in all rows of
a file the ball on the tool sat in the same socket, and the two sockets of a place are 50 mm apart. So they were
published by Franzese et al., MUKCa, github.com/platonics-delft/kinematics_calibration, for Pandas and a KUKA iiwa 14.

The places named by --identify are those to calibrate at; all others validate. Of these only the scatter about each
socket's mean is judged by calib calibrate, as nobody knows where they are.

With --wind-up joints give way under gravity, by masses of the URDF, as much as the data and a prior say.

The robot: example-robot-data's Panda with tip panda_hand_tcp, or an iiwa 14 that this script writes.
"""

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HOLES = ("hole_0", "hole_1")
# The printed tool has its sockets 50 mm apart, as well as a printer knows it.
DISTANCE, SIGMA_OF_DISTANCE = "50 mm", "0.1 mm"
# A printed ball has play in a printed socket, and the arm gives way under the hand that guides it.
SIGMA = "0.5 mm"
# Wind-up of joints 2 to 6: 30 Nm turn a joint by 3 mrad at one standard deviation, either way.
ELASTIC_JOINTS, PRIOR_ELASTIC = (1, 2, 3, 4, 5), "0.1 mrad/Nm"

# KUKA LBR iiwa 14 R820. Heights of the axes above the base in m: KUKA's data sheet (360, 420 and 400 mm apart, flange
# 126 mm beyond the last). Masses in kg and centres in m in the base frame, all joints at zero: documentation of
# Exp[licit] (explicit-robotics.github.io, Kuka LBR iiwa14). They matter where joints give way under gravity.
HEIGHTS = (0.1525, 0.36, 0.36 + 0.2325, 0.78, 0.78 + 0.2045, 1.18, 1.18)
FLANGE = 1.306
AXES = ("0 0 1", "0 1 0", "0 0 1", "0 -1 0", "0 0 1", "0 1 0", "0 0 1")
LIMITS = (170, 120, 170, 120, 170, 120, 175)
MASSES = (6.404, 7.89, 2.54, 4.82, 1.76, 2.5, 0.42)
CENTRES = (
    (0.0, -0.014, 0.2545),
    (0.0, 0.003, 0.424),
    (0.0, 0.019, 0.6905),
    (0.0, -0.009, 0.866),
    (0.0, -0.013, 1.0585),
    (0.0, -0.002, 1.196),
    (0.0, 0.0, 1.2706),
)


@dataclass(frozen=True)
class Arm:
    """What a job says of an arm."""

    urdf: str
    tip: str
    joints: tuple[str, ...]


ARMS = {
    "panda": Arm(
        "example:panda_description/urdf/panda.urdf", "panda_hand_tcp", tuple(f"panda_joint{k}" for k in range(1, 8))
    ),
    "iiwa14": Arm("iiwa14.urdf", "flange", tuple(f"joint_{k}" for k in range(1, 8))),
}


class NotRecordingsError(Exception):
    """The folder does not hold what this script reads."""


def read(folder: Path) -> dict[str, dict[str, Array]]:
    """The joint angles (N, 7) of every place and hole."""
    found: dict[str, dict[str, Array]] = {}
    for place in sorted(path.parent for path in folder.glob(f"*/{HOLES[0]}.csv")):
        found[place.name] = {hole: angles(place / f"{hole}.csv") for hole in HOLES}
    if not found:
        raise NotRecordingsError(f"{folder} has no recordings: <place>/{HOLES[0]}.csv and <place>/{HOLES[1]}.csv.")
    return found


def angles(path: Path) -> Array:
    if not path.is_file():
        raise NotRecordingsError(f"{path} is missing.")
    rows = []
    for n, line in enumerate(path.read_text(encoding="utf-8-sig").splitlines(), 1):
        try:
            row = [float(word) for word in line.split(",")]
        except ValueError:
            row = []
        if len(row) != 7 or not np.all(np.isfinite(row)):
            raise NotRecordingsError(f"{path}:{n}: is not seven joint angles in rad.")
        rows.append(row)
    if not rows:
        raise NotRecordingsError(f"{path} has no rows.")
    return np.array(rows)


def table(arm: Arm, place: str, holes: dict[str, Array]) -> str:
    lines = [", ".join([*(f"{joint} [rad]" for joint in arm.joints), "target", "group"])]
    for hole, rows in holes.items():
        lines += [", ".join([*(repr(float(angle)) for angle in row), f"{place}/{hole}", place]) for row in rows]
    return "\n".join([*lines, ""])


def job(arm: Arm, places: list[str], identify: list[str], wind_up: bool = False) -> str:
    elastic = f"elastic = {json.dumps([arm.joints[k] for k in ELASTIC_JOINTS])}\n" if wind_up else ""
    softness = f', elastic = "{PRIOR_ELASTIC}"' if wind_up else ""
    sections = [
        f"""\
# Joint angles with a ball in printed sockets: scripts/examples/sockets_job.py. Nothing else was measured. The distance
# of the two sockets of each place tells the size of the arm; without it, a smaller arm would fit as well.
schema = 1

[robot]
urdf = "{arm.urdf}"
tip = "{arm.tip}"

[error_model]
offsets = "all"
placements = "all"
base = "fixed"
tool = "position"
{elastic}prior = {{ length = "1 mm", angle = "5 mrad"{softness} }}
"""
    ]
    for place in places:
        use = "" if place in identify else 'use = "validate"\n'
        sections.append(f'[[measurements]]\nfile = "{place}.csv"\nobserves = "socket"\nsigma = "{SIGMA}"\n{use}')
    for place in identify:
        targets = json.dumps([f"{place}/{hole}" for hole in HOLES])
        sections.append(f'[[relations]]\ntargets = {targets}\ndistance = "{DISTANCE}"\nsigma = "{SIGMA_OF_DISTANCE}"\n')
    return "\n".join(sections)


def iiwa14() -> str:
    """The arm at zero stands upright; all frames are parallel to the base."""
    lines = ['<?xml version="1.0"?>', "<!-- KUKA LBR iiwa 14 R820, no meshes: scripts/examples/sockets_job.py -->"]
    lines += ['<robot name="iiwa14">', '  <link name="base"/>']
    parent, below = "base", 0.0
    for k, (height, axis, limit) in enumerate(zip(HEIGHTS, AXES, LIMITS, strict=True), 1):
        x, y, z = CENTRES[k - 1]
        lines += [
            f'  <link name="link_{k}"><inertial><origin xyz="{x} {y} {z - height:.4f}"/>'
            f'<mass value="{MASSES[k - 1]}"/>'
            '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>',
            f'  <joint name="joint_{k}" type="revolute"><parent link="{parent}"/><child link="link_{k}"/>',
            f'    <origin xyz="0 0 {height - below:.4f}"/><axis xyz="{axis}"/>',
            f'    <limit lower="{-np.radians(limit):.6f}" upper="{np.radians(limit):.6f}" effort="0" velocity="0"/>',
            "  </joint>",
        ]
        parent, below = f"link_{k}", height
    lines += [
        '  <link name="flange"/>',
        f'  <joint name="flange" type="fixed"><parent link="{parent}"/><child link="flange"/>',
        f'    <origin xyz="0 0 {FLANGE - below:.4f}"/>',
        "  </joint>",
        "</robot>",
        "",
    ]
    return "\n".join(lines)


def folder(recordings: Path, robot: str, identify: list[str], wind_up: bool = False) -> dict[str, str]:
    """The files of a job folder, by name."""
    places, arm = read(recordings), ARMS[robot]
    for place in identify:
        if place not in places:
            raise NotRecordingsError(f"--identify: there is no place {place!r}; there are {', '.join(places)}.")
    texts = {f"{place}.csv": table(arm, place, holes) for place, holes in places.items()}
    texts["calibration.toml"] = job(arm, list(places), identify, wind_up)
    return texts | ({"iiwa14.urdf": iiwa14()} if robot == "iiwa14" else {})


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, help="folder with <place>/hole_{0,1}.csv")
    parser.add_argument("output", type=Path, help="job folder to write")
    parser.add_argument("--robot", choices=tuple(ARMS), required=True)
    parser.add_argument("--identify", nargs="+", required=True, metavar="PLACE", help="places to calibrate at")
    parser.add_argument("--wind-up", action="store_true", help="joints 2 to 6 may give way under gravity")
    arguments = parser.parse_args()
    try:
        texts = folder(arguments.recordings, arguments.robot, arguments.identify, arguments.wind_up)
    except NotRecordingsError as problem:
        print(problem, file=sys.stderr)
        return 1
    arguments.output.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (arguments.output / name).write_text(text, encoding="utf-8", newline="\n")
        print(arguments.output / name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
