"""Write the tables of docs/two_arms.md: a robot that a measuring arm touches, and the arm before a tracker.

    python scripts/simulate/two_arms.py [output folder] [--seed 1]

The measuring arm is that of arm_cmm.py, the robot the UR10 of observations.py, and both are off in every frame and
zero. The arm carries a reflector in a ball, which the tracker sees in a few poses, and which sits in a cone on the
robot's flange in others; to judge by, the tracker sees it in the cone without the arm. Its own mathematics, on purpose,
as that of both. The same seed writes the same rows. Lengths in mm, angles in deg in the tables.
"""

import argparse
import itertools
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from scripts.simulate import arm_cmm, observations
from scripts.simulate.arm_cmm import Array

# The robot's base in that of the arm, m, and its turn about z.
PLACE, TURN_DEG = (0.85, -0.35, -0.2), 140.0
# The cone's distance from the robot's base, m: neither too near nor out of reach.
NEAR, FAR = 0.45, 1.1
TRACKED, TOUCHED, JUDGED = 20, 60, 40
SEAT = 0.02e-3  # of a coordinate of the ball in the cone, m
SEEN = arm_cmm.SIGMA * 1e-3  # of a coordinate that the tracker sees, m


class Cell:
    """Both machines as they were made, the tracker, and where everything stands."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.arm = arm_cmm.true_machine(self.rng)
        self.robot = observations.Machine(self.rng)
        self.robot_in_arm = np.eye(4)
        self.robot_in_arm[:3, :3] = arm_cmm.rotation("z", np.radians(TURN_DEG))[:3, :3]
        self.robot_in_arm[:3, 3] = PLACE

    def balls(self, arm_deg: Array) -> Array:
        """Centres (N, 3) of the arm's ball in its base at encoder angles (N, 6), m."""
        arm = replace(self.arm, base=arm_cmm.NOWHERE)
        return 1e-3 * np.array([arm_cmm.tip_position(arm, angles) for angles in arm_deg])

    def cones(self, q: Array) -> Array:
        """Centres (N, 3) of the robot's cone in the arm's base at readings (N, 6) in rad, m."""
        return np.asarray(self.robot.points(q) @ self.robot_in_arm[:3, :3].T + PLACE)

    def to_tracker(self, x: Array) -> Array:
        """Points (N, 3) of the arm's base in the tracker's frame, m."""
        base = self.arm.base.matrix
        return np.asarray(x @ base[:3, :3].T + 1e-3 * base[:3, 3])

    def touches(self, n: int) -> tuple[Array, Array]:
        """Encoder angles (n, 6) of the arm in deg, and readings (n, 6) of the robot in rad, ball in cone."""
        chosen: list[Array] = []
        for angles in arm_cmm.reachable_poses(self.rng):
            in_robot = (self.balls(angles[None])[0] - PLACE) @ self.robot_in_arm[:3, :3]
            if NEAR < np.linalg.norm(in_robot) < FAR:
                chosen.append(angles)
            if len(chosen) == n:
                break
        arm_deg = np.round(chosen, arm_cmm.ENCODER_DECIMALS)
        at = (self.balls(arm_deg) - PLACE) @ self.robot_in_arm[:3, :3] + self.rng.normal(0.0, SEAT, (n, 3))
        return arm_deg, self.robot.touching(lambda x: x, at)

    def tables(self) -> dict[str, list[tuple[str, Array]]]:
        """The columns of every table."""

        def seen(x: Array) -> list[tuple[str, Array]]:
            x = 1e3 * (self.to_tracker(x) + self.rng.normal(0.0, SEEN, x.shape))
            return [(f"{axis} [mm]", x[:, k]) for k, axis in enumerate("xyz")]

        def of_arm(arm_deg: Array) -> list[tuple[str, Array]]:
            return list(zip(arm_cmm.JOINTS, arm_deg.T, strict=True))

        def of_robot(q: Array) -> list[tuple[str, Array]]:
            names = [f"{joint[0]} [deg]" for joint in observations.JOINTS]
            return list(zip(names, np.degrees(q).T, strict=True))

        tracked = np.round(list(itertools.islice(arm_cmm.reachable_poses(self.rng), TRACKED)), arm_cmm.ENCODER_DECIMALS)
        touched, judged = self.touches(TOUCHED), self.robot.draw(JUDGED)
        return {
            "tracked": of_arm(tracked) + seen(self.balls(tracked)),
            "touched": of_arm(touched[0]) + of_robot(touched[1]),
            "judged": of_robot(judged) + seen(self.cones(judged)),
        }


def main() -> None:
    """Write all tables into one folder."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", default=Path("two_arms"))
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    for name, columns in Cell(chosen.seed).tables().items():
        rows = zip(*(values for _, values in columns), strict=True)
        lines = [", ".join(title for title, _ in columns), *(", ".join(f"{v:.4f}" for v in row) for row in rows), ""]
        (chosen.folder / f"{name}.csv").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
