"""From an empty folder to a report: six robots of six makers, each with a file as its users have it.

    python scripts/examples/six_makers.py FOLDER

Simulated sessions (60 poses, errors of 1 mm and 2 mrad, an instrument of 0.02 mm) are written in the dialect of every
maker; then what the README tells to type is typed, and counted.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from calib.job.chains import chains
from calib.robot.urdf import read_urdf


def session(robot, n=60, seed=4):  # type: ignore[no-untyped-def]
    chance = np.random.default_rng(seed)
    low = np.array([max(-2.5 if r.lower is None else r.lower, -2.5) for r in robot.readings])
    high = np.array([min(2.5 if r.upper is None else r.upper, 2.5) for r in robot.readings])
    q = chance.uniform(0.9 * low + 0.05 * (high + low), 0.9 * high + 0.05 * (high + low), (n, len(low)))
    errors = calib.Deviations(
        1e-3 * chance.standard_normal((len(robot.chain), 6)), 2e-3 * chance.standard_normal(len(robot.moving))
    )
    tool, base = np.eye(4), np.eye(4)
    tool[:3, :3], tool[:3, 3] = Rotation.from_rotvec([0.2, 0.7, -0.4]).as_matrix(), (0.03, 0.02, 0.09)
    base[:3, :3], base[:3, 3] = Rotation.from_rotvec([0.1, -0.2, 1.4]).as_matrix(), (1.8, 0.7, 0.4)
    T = base @ robot.tips(q, errors) @ tool
    return q, T[:, :3, 3] + 2e-5 * chance.standard_normal((n, 3)), T[:, :3, :3]


def written(path, titles, columns, separator=",", comma=False, encoding="utf-8", before=""):  # type: ignore[no-untyped-def]
    rows = [separator.join(titles)] if titles else []
    rows += [
        separator.join(f"{v:.7g}".replace(".", "," if comma else ".") for v in row) for row in np.column_stack(columns)
    ]
    path.write_text(before + "\n".join(rows) + "\n", encoding=encoding)


def ur(path, q, p, R):  # type: ignore[no-untyped-def]
    titles = [f"actual_q_{k}" for k in range(6)] + [f"measured_pose_{k}" for k in range(6)]
    written(path, titles, [q, p, Rotation.from_matrix(R).as_rotvec()], " ")


def franka(path, q, p, R):  # type: ignore[no-untyped-def] # noqa: ARG001
    titles = [f"panda_joint{k}_position" for k in range(1, 8)] + ["x", "y", "z"]
    written(path, titles, [q, p])


def ufactory(path, q, p, R):  # type: ignore[no-untyped-def]
    titles = [f"J{k} (deg)" for k in range(1, 8)] + ["X (mm)", "Y (mm)", "Z (mm)", "roll", "pitch", "yaw"]
    rpy = Rotation.from_matrix(R).as_euler("xyz", degrees=True)
    written(path, titles, [np.degrees(q), 1e3 * p, rpy], ";", comma=True, encoding="cp1252")


def kinova(path, q, p, R):  # type: ignore[no-untyped-def]
    titles = [f"q{k}" for k in range(1, q.shape[1] + 1)] + [
        "pos_x",
        "pos_y",
        "pos_z",
        "quat_x",
        "quat_y",
        "quat_z",
        "quat_w",
    ]
    written(path, titles, [q, p, Rotation.from_matrix(R).as_quat()], "\t", encoding="utf-16")


def unitree(path, q, p, R):  # type: ignore[no-untyped-def] # noqa: ARG001
    written(path, None, [np.degrees(q), 1e3 * p])


def rethink(path, q, p, R):  # type: ignore[no-untyped-def]
    titles = [f"left_{joint}" for joint in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")]
    poses = [f"pose.{what}" for what in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    written(
        path, [*titles, *poses], [q, p, Rotation.from_matrix(R).as_quat()], before="# rosbag of 3 May\n# left arm\n"
    )


ROBOTS = [
    ("Universal Robots UR10", "example:ur_description/urdf/ur10_robot.urdf", "tool0", ur),
    ("Franka Emika Panda", "example:panda_description/urdf/panda.urdf", "panda_hand_tcp", franka),
    ("UFACTORY xArm7", "example:xarm_description/urdf/xarm7.urdf", None, ufactory),
    ("Kinova", "example:kinova_description/robots/kinova.urdf", None, kinova),
    ("Unitree Z1", "example:z1_description/urdf/z1.urdf", None, unitree),
    ("Rethink Baxter", "example:baxter_description/urdf/baxter.urdf", "left_gripper", rethink),
]

README = Path(__file__).parents[2] / "README.md"


def commands() -> list[list[str]]:
    """Return what the README tells to type between an empty folder and a report, without the comments."""
    block = README.read_text(encoding="utf-8").partition("## Calibrate your robot\n")[2].split("\n\n")[1]
    return [line.partition("#")[0].split() for line in block.splitlines()]


def walked(folder: Path, urdf: str, tip: str | None, write, command: Callable[[list[str]], int]) -> list[int]:  # type: ignore[no-untyped-def]
    """Write the file of a session into a folder, type there what the README says, and return the exit codes.

    The install is not typed: what runs this is installed.
    """
    write(folder / "measured.csv", *session(calib.load_robot(urdf, tip or tip_of(urdf))))
    typed = [line for line in commands() if line[0] == "calib"]
    return [command([urdf if word == "arm.urdf" else word for word in line[1:]]) for line in typed]


def main(folder: Path) -> None:
    print("| robot | commands | exit codes | held out before, after (mm) | seconds |")
    print("|---|--:|---|--:|--:|")
    for name, urdf, tip, write in ROBOTS:
        here = folder / name.split()[0]
        here.mkdir(parents=True)
        start = time.perf_counter()

        def command(words: list[str], here: Path = here) -> int:
            typed = [sys.executable, "-c", "from calib.cli import main; main()", *words]
            done = subprocess.run(typed, cwd=here, stdin=subprocess.DEVNULL, capture_output=True, check=False)
            print(done.stderr.decode(), end="", file=sys.stderr)
            return done.returncode

        codes = walked(here, urdf, tip, write, command)
        found = errors(here / "out")
        seconds = time.perf_counter() - start
        print(f"| {name} | {len(codes)} | {', '.join(map(str, codes))} | {found} | {seconds:.0f} |")


def errors(out: Path) -> str:
    metrics = json.loads((out / "result.json").read_text(encoding="utf-8"))["metrics"]["validation"]
    return ", ".join(f"{1e3 * metrics[when]['position']['rms']:.3f}" for when in ("before", "after"))


def tip_of(arm: str) -> str:
    # The arm without its fingers: the joints that the names of a maker's log would give.
    arms = [one for one in chains(read_urdf(arm)) if len(one.joints) in (6, 7)]
    return arms[0].tip


if __name__ == "__main__":
    main(Path(sys.argv[1]))
