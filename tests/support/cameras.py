"""Simulated cameras with known truth, made without any of calib's projection or kinematics."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib
from calib.measurement.boards import Board
from calib.measurement.optics import seen_by
from tests.support import machines

Array = NDArray[np.float64]
Rng = np.random.Generator

UR5 = "example:ur_description/urdf/ur5_robot.urdf"
TIP = "tool0"
BOARD = np.array([(0.03 * i, 0.03 * j, 0.0) for i in range(5) for j in range(4)])
BLOCK = np.array([(0.05 * i, 0.04 * j, 0.06 * k) for i in range(3) for j in range(2) for k in range(2)])
MARK = np.zeros((1, 3))
LENS = {"fx": 1210.0, "fy": 1190.0, "cx": 655.0, "cy": 508.0}
BENT = LENS | {"k1": -0.21, "k2": 0.09, "p1": 8e-4, "p2": -5e-4, "k3": -0.015}


def eye(camera_on: str, sigma: float = 0.0, lens: dict[str, float] | None = None) -> calib.measuring.Camera:
    return calib.measuring.Camera(camera_on, **(BENT if lens is None else lens), sigma=sigma)


def see(camera: calib.measuring.Camera, points: Array) -> Array:
    """Pixels (..., 2) of points (..., 3) in the camera's frame, by complex numbers: z = x + i y."""
    z = (points[..., 0] + 1j * points[..., 1]) / points[..., 2]
    r2 = np.abs(z) ** 2
    bent = z * np.polyval([camera.k3, camera.k2, camera.k1, 1.0], r2)
    # p2 (r2 + 2 x^2) + 2 p1 x y + i (p1 (r2 + 2 y^2) + 2 p2 x y) = 2 r2 p + conj(p) z^2 for p = p2 + i p1
    p = camera.p2 + 1j * camera.p1
    bent = bent + 2.0 * r2 * p + np.conj(p) * z**2
    return np.stack([camera.fx * bent.real + camera.cx, camera.fy * bent.imag + camera.cy], axis=-1)


def inverse(T: Array) -> Array:
    return np.linalg.inv(T)


@dataclass(frozen=True)
class Scene:
    """An arm at ``base`` with ``tool`` on its tip, and ``target`` on the floor; one is the camera, one the board."""

    arm: machines.Arm
    camera: calib.measuring.Camera
    places: Array
    base: Array
    tool: Array
    target: Array

    def marks(self, readings: Array, off: Array | None = None) -> Array:
        """Where the camera has the marks (N, m, 3), in its frame; ``off`` (N, 4, 4): how far the tool is off."""
        tool = self.base @ self.arm.tips(readings) @ self.tool
        tool = tool if off is None else tool @ off
        on_tip = self.camera.camera_on == "tip"
        T = inverse(tool) @ self.target if on_tip else inverse(self.target) @ tool
        return np.einsum("nij,mj->nmi", T[:, :3, :3], self.places) + T[:, None, :3, 3]

    def visible(self, readings: Array) -> NDArray[np.bool_]:
        marks = self.marks(readings)
        near = np.abs(marks[..., :2]).max(axis=-1) < 0.45 * marks[..., 2]
        return np.all(near & (marks[..., 2] > 0.25) & (marks[..., 2] < 2.0), axis=1)

    def draw(self, rng: Rng, n: int) -> Array:
        """Readings (n, k) at which the whole board is in the image."""
        found = np.zeros((0, len(self.arm.ranges)))
        for _ in range(120):
            some = self.arm.draw(rng, 2000)
            found = np.concatenate([found, some[self.visible(some)]])
            if len(found) >= n:
                return found[:n]
        raise AssertionError(f"only {len(found)} poses are seen")

    def columns(
        self, readings: Array, rng: Rng | None = None, sigma: float = 0.0, off: Array | None = None
    ) -> dict[str, object]:
        """The table of what was seen, an image of m rows for each of N readings."""
        pixels = see(self.camera, self.marks(readings, off))
        if rng is not None:
            pixels = pixels + rng.normal(scale=sigma, size=pixels.shape)
        m, many = len(self.places), np.repeat(readings, len(self.places), axis=0)
        found: dict[str, object] = {f"{name} [rad]": many[:, k] for k, name in enumerate(self.arm.ranges)}
        found |= {f"{name} [px]": pixels[..., k].ravel() for k, name in enumerate("uv")}
        if m > 1:
            places = np.tile(self.places, (len(readings), 1))
            found |= {f"board_{axis} [mm]": 1e3 * places[:, k] for k, axis in enumerate("xyz")}
        return found

    def measure(
        self,
        robot: calib.Robot,
        readings: Array,
        rng: Rng | None = None,
        sigma: float = 0.0,
        off: Array | None = None,
    ) -> calib.Measurements:
        columns = self.columns(readings, rng, sigma, off)
        return calib.read_measurements(columns, robot, "pixels", instrument=self.camera)


def scene(
    rng: Rng, arm: machines.Arm, camera_on: str, places: Array = BOARD, base: Array | None = None, sigma: float = 0.0
) -> Scene:
    """A camera anywhere that sees a board anywhere, turned any way, at one pose of the arm."""
    base = np.eye(4) if base is None else base
    camera = eye(camera_on, sigma)
    tool = machines.pose(rng.uniform(-0.08, 0.08, 3), Rotation.random(rng=rng).as_rotvec())
    while True:
        tip = base @ arm.tips(arm.draw(rng, 1))[0] @ tool
        middle = places.mean(axis=0)
        # The board in the camera: its middle near the line of sight.
        seen = machines.pose(
            (*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.5, 0.9)), Rotation.random(rng=rng).as_rotvec()
        ) @ machines.pose(-middle)
        target = tip @ (seen if camera_on == "tip" else inverse(seen))
        found = Scene(arm, camera, places, base, tool, target)
        if found.visible(arm.draw(rng, 2000)).sum() > 12:
            return found


def photographed(
    robot: calib.Robot,
    true: Scene,
    n: int,
    camera: calib.measuring.Camera,
    board: Board,
    rng: Rng | None = None,
    sigma: float = 0.0,
) -> calib.Measurements:
    """Photographs of a board as it was printed, ``true.places``; marks are said to be where they should, ``BOARD``."""
    readings = true.draw(np.random.default_rng(4) if rng is None else rng, n)
    data = true.measure(robot, readings, rng, sigma)
    value = data.value.copy()
    value[:, 2:] = np.tile(BOARD, (n, 1))
    return seen_by(replace(data, value=value), camera, board)
