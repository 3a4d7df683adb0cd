"""Make the measurements of robots/hand_eye: a UR5 with a camera on its flange that looks at a ChArUco board.

    python scripts/simulate/hand_eye.py [output folder] [--seed 3]

Its own mathematics, on purpose: whoever calibrates this robot cannot repeat a mistake made here. Lengths in m, angles
in rad, pixels as OpenCV counts them. The same seed writes the same bytes; another seed is another robot.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yourdfpy
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.robot.sources import resolve

Array = NDArray[np.float64]
Rng = np.random.Generator

SEED = 3
UR5 = "example:ur_description/urdf/ur5_robot.urdf"
TIP = "tool0"

# One standard deviation of the errors of every joint frame's origin, and of every zero.
LENGTH_ERROR, ANGLE_ERROR, ZERO_ERROR = 0.3e-3, 0.5e-3, 2e-3

# A camera of 1.3 megapixels, as a calibration with OpenCV would print it.
WIDTH, HEIGHT = 1280, 1024
FX, FY, CX, CY = 1395.2, 1393.8, 648.3, 505.9
K1, K2, P1, P2, K3 = -0.1124, 0.1387, 0.00031, -0.00047, -0.0312
PIXEL_NOISE = 0.2

# Inner corners of 7 x 5 squares of 30 mm; the board's z points into it, as OpenCV has it.
COLUMNS, ROWS, SQUARE = 6, 4, 0.030
SEEN = 0.9  # a corner is found that often
IMAGES = {"identification": 40, "validation": 20}

# Nominally: the camera looks along the flange's axis, the board lies on the table in front of the robot.
CAMERA = ((0.0, -0.065, 0.040), (0.0, 0.0, 0.0))
BOARD = ((0.45, -0.05, 0.02), (180.0, 0.0, 90.0))
# How far camera and board are from there: nobody knows better than this.
MOUNTING, LAYING = (5e-3, 0.03), (30e-3, 0.1)


def pose(position: ArrayLike, rotation: Rotation) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), position
    return T


def near(rng: Rng, nominal: tuple[tuple[float, ...], tuple[float, ...]], scale: tuple[float, float]) -> Array:
    """A pose that is off a nominal one (m, deg) by normal errors of these sizes (m, rad)."""
    position, degrees = nominal
    return pose(position, Rotation.from_euler("xyz", degrees, degrees=True)) @ pose(
        rng.normal(scale=scale[0], size=3), Rotation.from_rotvec(rng.normal(scale=scale[1], size=3))
    )


@dataclass(frozen=True)
class Truth:
    """The machine as it is: joints by name with their true origins and axes, zeros, the camera and the board."""

    joints: tuple[tuple[str, Array, Array], ...]
    zeros: Array
    flange_camera: Array
    base_board: Array

    @property
    def moving(self) -> tuple[str, ...]:
        return tuple(name for name, _, axis in self.joints if axis.any())

    def flange(self, readings: Array) -> Array:
        """Flange (N, 4, 4) in the base link."""
        T = np.broadcast_to(np.eye(4), (len(readings), 4, 4))
        angles = iter((readings + self.zeros).T)
        for _, origin, axis in self.joints:
            T = T @ origin
            if axis.any():
                turn = np.tile(np.eye(4), (len(readings), 1, 1))
                turn[:, :3, :3] = Rotation.from_rotvec(next(angles)[:, None] * axis).as_matrix()
                T = T @ turn
        return T

    def corners(self, readings: Array) -> Array:
        """The board's corners (N, m, 3) in the camera's frame."""
        T = np.linalg.inv(self.flange(readings) @ self.flange_camera) @ self.base_board
        return np.einsum("nij,mj->nmi", T[:, :3, :3], board()) + T[:, None, :3, 3]

    def images(self, rng: Rng, n: int) -> Array:
        """Readings (n, 6), as displayed, at which the camera sees the whole board from above and sharply."""
        found = np.zeros((0, 6))
        while len(found) < n:
            some = np.radians(np.round(np.degrees(rng.uniform(-np.pi, np.pi, (50_000, 6))), 4))
            # Few of these see the board at all.
            some = some[(self.corners(some)[:, [0, -1], 2] > 0.25).all(axis=1)]
            corners = self.corners(some)
            u, v = np.moveaxis(pixels(corners), -1, 0)
            inside = (u > 0) & (u < WIDTH - 1) & (v > 0) & (v < HEIGHT - 1)
            depth = corners[:, :, 2]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, COLUMNS] - corners[:, 0]) / SQUARE**2
            sight = corners.mean(axis=1)
            facing = np.sum(normal * sight, axis=1) > 0.6 * np.linalg.norm(sight, axis=1)
            # The whole wrist above the table.
            high = self.flange(some)[:, 2, 3] > 0.15
            found = np.concatenate([found, some[(inside & (depth > 0.25) & (depth < 0.8)).all(axis=1) & facing & high]])
        return found[:n]


def board() -> Array:
    return np.array([(SQUARE * i, SQUARE * j, 0.0) for j in range(ROWS) for i in range(COLUMNS)])


def pixels(points: Array) -> Array:
    """Pixels (..., 2) of points (..., 3) in the camera's frame."""
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    r2 = x**2 + y**2
    radial = 1 + K1 * r2 + K2 * r2**2 + K3 * r2**3
    return np.stack(
        [
            FX * (x * radial + 2 * P1 * x * y + P2 * (r2 + 2 * x**2)) + CX,
            FY * (y * radial + P1 * (r2 + 2 * y**2) + 2 * P2 * x * y) + CY,
        ],
        axis=-1,
    )


def truth(rng: Rng) -> Truth:
    by_child = {joint.child: joint for joint in yourdfpy.URDF.load(str(resolve(UR5)), load_meshes=False).robot.joints}
    joints, link = [], TIP
    while link in by_child:
        joint = by_child[link]
        error = pose(
            rng.normal(scale=LENGTH_ERROR, size=3), Rotation.from_rotvec(rng.normal(scale=ANGLE_ERROR, size=3))
        )
        moving = joint.type != "fixed"
        joints.append((joint.name, joint.origin @ error, joint.axis if moving else np.zeros(3)))
        link = joint.parent
    return Truth(
        tuple(reversed(joints)),
        rng.normal(scale=ZERO_ERROR, size=6),
        near(rng, CAMERA, MOUNTING),
        near(rng, BOARD, LAYING),
    )


def table(machine: Truth, rng: Rng, n: int) -> str:
    readings = machine.images(rng, n)
    seen = pixels(machine.corners(readings))
    seen = seen + rng.normal(scale=PIXEL_NOISE, size=seen.shape)
    lines = [
        ", ".join(
            [
                *(f"{name} [deg]" for name in machine.moving),
                "u [px]",
                "v [px]",
                "board_x [mm]",
                "board_y [mm]",
                "target",
            ]
        )
    ]
    for q, image in zip(np.degrees(readings), seen, strict=True):
        joints = ", ".join(f"{angle:.4f}" for angle in q)
        lines += [
            f"{joints}, {u:.3f}, {v:.3f}, {1e3 * x:.0f}, {1e3 * y:.0f}, board"
            for (u, v), (x, y, _) in zip(image, board(), strict=True)
            if rng.uniform() < SEEN
        ]
    return "\n".join(lines) + "\n"


def truth_file(machine: Truth, seed: int) -> str:
    def shown(T: Array) -> str:
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
        position = ", ".join(f"{1e3 * value:.6f}" for value in T[:3, 3])
        return f"position_mm = [{position}]\nquaternion_wxyz = [{w:.10f}, {x:.10f}, {y:.10f}, {z:.10f}]\n"

    zeros = ", ".join(f"{1e3 * zero:.6f}" for zero in machine.zeros)
    return (
        f"# The simulated machine: scripts/simulate/hand_eye.py, seed {seed}. For judging only.\n"
        f"seed = {seed}\nzeros_mrad = [{zeros}]\n\n"
        f"# The camera in the flange (tool0), z forward.\n[camera]\n{shown(machine.flange_camera)}\n"
        f"# The board in the robot's base.\n[board]\n{shown(machine.base_board)}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("robots/hand_eye"))
    parser.add_argument("--seed", type=int, default=SEED)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    machine = truth(rng)
    options.folder.mkdir(parents=True, exist_ok=True)
    head = f"# Simulated: scripts/simulate/hand_eye.py, seed {options.seed}. Board corners in images from the flange.\n"
    for name, n in IMAGES.items():
        (options.folder / f"{name}.csv").write_text(head + table(machine, rng, n), encoding="utf-8")
    (options.folder / "truth.toml").write_text(truth_file(machine, options.seed), encoding="utf-8")


if __name__ == "__main__":
    main()
