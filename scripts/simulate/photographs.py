"""Render photographs that an arm took of a board: a print that is bent and of the wrong size, a lens, blur and noise.

    python scripts/simulate/photographs.py FOLDER [--seed 3] [--images 24] [--cause none]

Writes images, readings.csv (joints), flange.csv (the flange as the controller states it), board.toml, the nominal URDF
and truth.json. Its own mathematics, on purpose: nothing of calib's projection, boards or kinematics takes part. Lengths
in m, angles in rad, pixels as OpenCV counts them. The same seed writes the same bytes.

``--cause``: what is wrong beyond an ordinary arm, lens and print: lens (its numbers are not those of ``given_lens`` in
truth.json), scale, twist, zero, blur, or none.
"""

import argparse
import csv
import json
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import yourdfpy
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from calib.measurement.formats.images import LEAST_CORNERS, detector
from calib.measurement.prints import Print
from calib.robot.sources import resolve

Array = NDArray[np.float64]
UR5 = "example:ur_description/urdf/ur5_robot.urdf"
TIP = "tool0"
# As many rays each way through a pixel that an edge of the print crosses: with half as many, corners of sharp images
# are moved by more than their noise moves them.
RAYS = 8
# Every so many pixels the ray is followed to the sheet; what is between is interpolated by cubic splines.
STEP = 8
# White paper around what is printed, in m.
MARGIN = 0.025


@dataclass(frozen=True)
class Lens:
    """OpenCV's numbers; ``k``: five of distortion, or the eight of the rational model."""

    fx: float = 905.0
    fy: float = 903.0
    cx: float = 645.0
    cy: float = 355.0
    k: tuple[float, ...] = (-0.06, 0.09, 6e-4, -4e-4, -0.03)
    size: tuple[int, int] = (1280, 720)

    def bend(self, x: Array, y: Array) -> tuple[Array, Array]:
        k1, k2, p1, p2, k3, *rational = self.k
        r2 = x * x + y * y
        f = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        if rational:
            k4, k5, k6 = rational
            f = f / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return x * f + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * f + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y

    def rays(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Where pixels look, X / Z and Y / Z, by a fixed point."""
        a, b = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        x, y = a.copy(), b.copy()
        for _ in range(60):
            p, q = self.bend(x, y)
            x, y = x + a - p, y + b - q
        return x, y

    def see(self, points: Array) -> Array:
        x, y = self.bend(points[..., 0] / points[..., 2], points[..., 1] / points[..., 2])
        return np.stack([self.fx * x + self.cx, self.fy * y + self.cy], axis=-1)


@dataclass(frozen=True)
class Sheet:
    """A ChArUco print: how much too large, aspect and shear in its plane, and its height, bent about the middle."""

    squares: tuple[int, int] = (7, 5)
    square: float = 0.030
    marker: float = 0.022
    dictionary: str = "DICT_4X4_50"
    scale: float = 0.0
    aspect: float = 0.0
    shear: float = 0.0
    bend: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of x^2, y^2, x y, in 1 / m
    wave: float = 0.0  # height of waves, in m, as no quadratic has them

    @property
    def middle(self) -> Array:
        return 0.5 * self.square * np.array(self.squares)

    def stretch(self) -> Array:
        return (1 + self.scale) * np.array([[1 + self.aspect, self.shear], [self.shear, 1 - self.aspect]])

    def place(self, drawn: Array) -> Array:
        """Where points drawn at (..., 2) are (..., 3), in m, from the middle of the sheet."""
        flat = (drawn - self.middle) @ self.stretch().T
        return np.concatenate([flat, self.height(flat)[..., None]], axis=-1)

    def height(self, flat: Array) -> Array:
        x, y = flat[..., 0], flat[..., 1]
        bent = self.bend[0] * x * x + self.bend[1] * y * y + self.bend[2] * x * y
        return bent + self.wave * np.sin(75.0 * x + 1.0) * np.cos(60.0 * y) if self.wave else bent

    def corners(self) -> Array:
        x, y = np.meshgrid(np.arange(1, self.squares[0]), np.arange(1, self.squares[1]))
        return self.square * np.column_stack([x.ravel(), y.ravel()]).astype(float)

    def white(self, drawn: Array) -> Array:
        """1 where the sheet is white at points (..., 2), 0 where it is black."""
        n = np.floor(drawn / self.square).astype(int)
        on = np.all((n >= 0) & (n < self.squares), axis=-1)
        cells = self.cells()
        side = cells.shape[-1]
        of_marker = np.cumsum([(i + j) % 2 for j in range(self.squares[1]) for i in range(self.squares[0])]) - 1
        which = of_marker[np.clip(n[..., 1] * self.squares[0] + n[..., 0], 0, len(of_marker) - 1)]
        inside = (drawn - (n + 0.5) * self.square) / self.marker + 0.5
        cell = np.floor(inside * side).astype(int)
        marked = np.all((cell >= 0) & (cell < side), axis=-1)
        cell = np.clip(cell, 0, side - 1)
        black_square = (n.sum(axis=-1) % 2 == 0) & on
        marker = cells[np.clip(which, 0, len(cells) - 1), cell[..., 1], cell[..., 0]]
        return np.where(black_square, 0.0, np.where(on & marked, marker, 1.0))

    def lines(self) -> list[Array]:
        """Where, across and down, something else may begin: between two of these all is alike."""
        side = self.cells().shape[-1]
        within = 0.5 * (self.square - self.marker) + self.marker * np.arange(side + 1) / side
        starts = [self.square * np.arange(n + 1) for n in self.squares]
        return [
            np.sort(np.concatenate([[-MARGIN, x[-1] + MARGIN], x, (x[:-1, None] + within).ravel()])) for x in starts
        ]

    def cells(self) -> Array:
        of = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        side = of.markerSize + 2
        count = self.squares[0] * self.squares[1] // 2
        return np.array([cv2.aruco.generateImageMarker(of, k, side) > 127 for k in range(count)], dtype=float)


@dataclass(frozen=True)
class Look:
    """What a sensor makes of it: blur in px, noise in grey values, black and white, and light that falls off."""

    blur: float = 0.7
    noise: float = 2.0
    black: float = 35.0
    white: float = 205.0
    falling: tuple[float, float] = (0.1, -0.06)
    ground: float = 120.0


@dataclass
class Renderer:
    """Draws a sheet before a camera."""

    lens: Lens
    sheet: Sheet
    look: Look = field(default_factory=Look)
    rays_each_way: int = RAYS

    def __post_init__(self) -> None:
        self._lines = self.sheet.lines()
        x, y = (np.concatenate([[n[0] - 1.0], 0.5 * (n[1:] + n[:-1]), [n[-1] + 1.0]]) for n in self._lines)
        white = self.sheet.white(np.stack(np.meshgrid(x, y), axis=-1))
        self._grey = np.full(white.shape, self.look.ground)
        inside = (slice(1, -1), slice(1, -1))
        self._grey[inside] = self.look.black + (self.look.white - self.look.black) * white[inside]

    def image(self, T: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
        """The photograph of a sheet whose middle is at T (4, 4) in the camera."""
        return self.exposed(self.light(T), rng)

    def exposed(self, light: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
        """What the sensor makes of light (h, w): its noise, and 8 bit."""
        return np.clip(np.rint(light + rng.normal(scale=self.look.noise, size=light.shape)), 0, 255).astype(np.uint8)

    def light(self, T: Array) -> Array:
        """The light on the sensor (h, w), without its noise."""
        w, h = self.lens.size
        edge = self.sheet.square * np.array(self.sheet.squares)
        border = np.array([[x, y] for x in np.linspace(-0.03, edge[0] + 0.03, 9) for y in (-0.03, edge[1] + 0.03)])
        seen = self.lens.see(self.sheet.place(border) @ T[:3, :3].T + T[:3, 3])
        low = np.clip(np.floor(seen.min(axis=0)).astype(int) - 12, 0, (w - 1, h - 1))
        high = np.clip(np.ceil(seen.max(axis=0)).astype(int) + 12, 1, (w, h))
        patch = self._patch(T, low, high)
        grey = np.full((h, w), self.look.ground)
        # There is nothing but ground within twelve pixels of the patch's sides: blur changes nothing beyond.
        grey[low[1] : high[1], low[0] : high[0]] = (
            gaussian_filter(patch, self.look.blur, mode="nearest") if self.look.blur else patch
        )
        across, down = np.arange(w) / w - 0.5, np.arange(h) / h - 0.5
        return np.asarray(grey * (1 + self.look.falling[0] * across + self.look.falling[1] * down[:, None]))

    def _patch(self, T: Array, low: NDArray[np.int_], high: NDArray[np.int_]) -> Array:
        """The light on pixels from low to high, each (x, y), before it is blurred."""
        at = self._drawn(T, low, high)
        by_u, by_v = np.gradient(at, axis=2), np.gradient(at, axis=1)
        reach = 0.5 * (np.abs(by_u) + np.abs(by_v))
        (x, right), (y, below) = (
            (np.searchsorted(lines, of - far), np.searchsorted(lines, of + far))
            for lines, of, far in zip(self._lines, at, reach, strict=True)
        )
        grey = self._grey[y, x]
        # No line crosses these, or one on both sides of which is the same.
        plain = (right - x <= 1) & (below - y <= 1)
        for rows, columns in ((y, right), (below, x), (below, right)):
            plain &= self._grey[rows, columns] == grey
        mixed = np.flatnonzero(~plain)
        at, by_u, by_v = (a.reshape(2, -1)[:, mixed] for a in (at, by_u, by_v))
        # The middles of rays within a pixel: where they meet the sheet changes evenly over it.
        each = (np.arange(self.rays_each_way) + 0.5) / self.rays_each_way - 0.5
        total = np.zeros(len(mixed))
        for dv in each:
            for du in each:
                x, y = (np.searchsorted(n, of) for n, of in zip(self._lines, at + du * by_u + dv * by_v, strict=True))
                total += self._grey[y, x]
        grey.flat[mixed] = total / len(each) ** 2
        return np.asarray(grey)

    def _drawn(self, T: Array, low: NDArray[np.int_], high: NDArray[np.int_]) -> Array:
        """Where pixels from low to high, each (x, y), look on the sheet as it was drawn (2, h, w)."""
        # At least four nodes each way.
        u, v = (
            STEP * np.arange(a // STEP - 1, -(-b // STEP) + 3).astype(float) for a, b in zip(low, high, strict=True)
        )
        x, y = self.lens.rays(*np.meshgrid(u, v))
        R, t = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
        d = np.stack([x, y, np.ones_like(x)], axis=-1) @ R.T
        z = np.zeros_like(x)
        for _ in range(8):
            s = (z - t[2]) / d[..., 2]
            flat = t[:2] + s[..., None] * d[..., :2]
            z = self.sheet.height(flat)
        nodes = flat @ np.linalg.inv(self.sheet.stretch()).T + self.sheet.middle
        where = (np.arange(low[1], high[1]), np.arange(low[0], high[0]))
        return np.stack([RectBivariateSpline(v, u, nodes[..., k])(*where) for k in (0, 1)])

    def corners(self, T: Array) -> Array:
        """Where the corners truly are (n, 2), in px."""
        return self.lens.see(self.sheet.place(self.sheet.corners()) @ T[:3, :3].T + T[:3, 3])


class Arm:
    """A UR5, or another arm that ends in tool0, whose joint frames are off by small errors, and its nominal self."""

    def __init__(self, rng: np.random.Generator, length: float, angle: float, zero: float, *, urdf: str = UR5) -> None:
        self.urdf = yourdfpy.URDF.load(str(resolve(urdf)), load_meshes=False, build_scene_graph=False)
        joints, link, chain = {j.child: j for j in self.urdf.robot.joints}, TIP, []
        while link in joints:
            chain.insert(0, joints[link])
            link = joints[link].parent
        self.chain = chain
        self.names = [j.name for j in chain if j.type != "fixed"]
        self.errors = {}
        for name in self.names:
            E = np.eye(4)
            E[:3, :3] = Rotation.from_rotvec(rng.normal(scale=angle, size=3)).as_matrix()
            E[:3, 3] = rng.normal(scale=length, size=3)
            self.errors[name] = E
        self.zeros = {name: float(rng.normal(scale=zero)) for name in self.names}

    def tip(self, q: Array, *, nominal: bool = False, link: str = TIP) -> Array:
        """Where the flange, or another link, is in the base (4, 4)."""
        T, at = np.eye(4), dict(zip(self.names, q, strict=True))
        for joint in self.chain[: next(k for k, joint in enumerate(self.chain, 1) if joint.child == link)]:
            T = T @ joint.origin
            if joint.type == "fixed":
                continue
            turn = np.eye(4)
            angle = at[joint.name] + (0.0 if nominal else self.zeros[joint.name])
            turn[:3, :3] = Rotation.from_rotvec(angle * np.asarray(joint.axis)).as_matrix()
            T = T @ (np.eye(4) if nominal else self.errors[joint.name]) @ turn
        return T


@dataclass
class Session:
    """Everything that was there while photographs were taken."""

    arm: Arm
    lens: Lens
    sheet: Sheet
    look: Look
    camera: Array  # on the flange
    board: Array  # the middle of the sheet in the base
    readings: Array


def pose(position: Array, turn: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), position
    return T


def session(seed: int, images: int = 24, cause: str = "none") -> Session:
    """An arm with errors of 0.3 mm and 0.3 mrad, a print 0.4 % too large and slightly bent, and poses that see it."""
    rng = np.random.default_rng(seed)
    arm = Arm(rng, 0.3e-3, 0.3e-3, 0.5e-3)
    sheet = Sheet(scale=0.004, aspect=2e-4, shear=-1.5e-4, bend=(0.06, -0.03, 0.05))
    if cause == "scale":
        sheet = Sheet(scale=0.015)
    elif cause == "twist":
        sheet = Sheet(scale=0.001, bend=(0.05, -0.05, 0.6))
    elif cause == "zero":
        arm.zeros[arm.names[2]] += 0.02
    look = Look(blur=3.0 if cause == "blur" else 0.7)
    camera = pose(np.array([0.005, -0.065, 0.04]) + rng.normal(scale=5e-3, size=3), rng.normal(scale=0.03, size=3))
    board = pose(
        np.array([0.45, -0.05, 0.02]) + rng.normal(scale=0.03, size=3),
        Rotation.from_euler("xyz", (180, 0, 90), degrees=True).as_rotvec() + rng.normal(scale=0.05, size=3),
    )
    found: list[Array] = []
    lens = Lens()
    while len(found) < images:
        q = rng.uniform((-1.2, -2.2, 0.8, -2.6, -2.2, -3.0), (0.6, -0.9, 2.4, -0.6, -0.9, 3.0))
        T = np.linalg.inv(arm.tip(q) @ camera) @ board
        seen = lens.see(sheet.place(sheet.corners()) @ T[:3, :3].T + T[:3, 3])
        facing = T[2, 3] > 0.15 and (T[:3, 2] @ T[:3, 3]) / np.linalg.norm(T[:3, 3]) > 0.55
        if facing and T[2, 3] < 0.7 and np.all((seen > 15) & (seen < np.array(lens.size) - 15)):
            found.append(q)
    return Session(arm, lens, sheet, look, camera, board, np.array(found))


def before_camera(some: Session) -> list[Array]:
    """Where the middle of the sheet is in the camera (4, 4), photograph by photograph."""
    return [np.linalg.inv(some.arm.tip(q) @ some.camera) @ some.board for q in some.readings]


def corners_seen(some: Session, sigma: float, rng: np.random.Generator) -> dict[str, object]:
    """The table of pixels of a session whose corners are found to sigma, in px, without any image."""
    drawn, at = some.sheet.corners(), before_camera(some)
    uv = np.concatenate([some.lens.see(some.sheet.place(drawn) @ T[:3, :3].T + T[:3, 3]) for T in at])
    uv = uv + rng.normal(scale=sigma, size=uv.shape)
    n = len(some.readings)
    return _columns(some, np.repeat(np.arange(n), len(drawn)), np.tile(np.arange(len(drawn)), n), uv)


def corners_found(some: Session, rng: np.random.Generator) -> dict[str, object]:
    """The table of pixels of a session whose photographs are rendered; corners are found as calib finds them.

    Photographs in which no board is found are left out, as ``calib import images`` leaves them out.
    """
    sheet, renderer = some.sheet, Renderer(some.lens, some.sheet, some.look)
    detect = detector(Print("charuco", sheet.squares, sheet.square, sheet.marker, sheet.dictionary))
    photographs, marks, uv, sigma = [], [], [np.zeros((0, 2))], [np.zeros(0)]
    for k, T in enumerate(before_camera(some)):
        found = detect(renderer.image(T, rng))
        if len(found.marks) >= LEAST_CORNERS:
            photographs += [k] * len(found.marks)
            marks += found.marks.tolist()
            uv.append(found.pixels)
            sigma.append(found.sigma)
    columns = _columns(some, np.array(photographs, dtype=np.intp), np.array(marks, dtype=np.intp), np.concatenate(uv))
    return {**columns, "sigma [px]": np.concatenate(sigma)}


def _columns(some: Session, photographs: NDArray[np.intp], marks: NDArray[np.intp], uv: Array) -> dict[str, object]:
    q, (x, y) = some.readings[photographs], some.sheet.corners()[marks].T
    found: dict[str, object] = {f"{name} [rad]": q[:, k] for k, name in enumerate(some.arm.names)}
    found |= {"u [px]": uv[:, 0], "v [px]": uv[:, 1]}
    return found | {"board_x [m]": x, "board_y [m]": y, "board_z [m]": np.zeros(len(x))}


def write(folder: Path, some: Session, seed: int) -> None:
    """Write photographs, readings, poses of the flange, the board and the truth."""
    folder.mkdir(parents=True, exist_ok=True)
    photographs = folder / "photographs"
    photographs.mkdir(exist_ok=True)
    renderer, rng = Renderer(some.lens, some.sheet, some.look), np.random.default_rng(seed + 1000)
    rows, flange = [], []
    for k, q in enumerate(some.readings):
        name = f"image_{k:03d}.png"
        T = np.linalg.inv(some.arm.tip(q) @ some.camera) @ some.board
        cv2.imwrite(str(photographs / name), renderer.image(T, rng))
        rows.append([name, *(f"{v:.9f}" for v in q)])
        at = some.arm.tip(q)
        x, y, z, w = Rotation.from_matrix(at[:3, :3]).as_quat()
        flange.append([name, *(f"{v:.9f}" for v in (*(1e3 * at[:3, 3]), w, x, y, z))])
    for file, titles, table in (
        ("readings.csv", ["image", *(f"{name} [rad]" for name in some.arm.names)], rows),
        ("flange.csv", ["image", "x [mm]", "y [mm]", "z [mm]", "qw", "qx", "qy", "qz"], flange),
    ):
        with (folder / file).open("w", newline="") as out:
            csv.writer(out, lineterminator="\n").writerows([titles, *table])
    sheet = some.sheet
    (folder / "board.toml").write_text(
        f'kind = "charuco"\nsquares = [{sheet.squares[0]}, {sheet.squares[1]}]\nsquare = "{1e3 * sheet.square:g} mm"\n'
        f'marker = "{1e3 * sheet.marker:g} mm"\ndictionary = "{sheet.dictionary}"\n'
    )
    lens = some.lens
    truth = {
        "lens": {"fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy, "k": lens.k, "size": lens.size},
        "board": {"scale": sheet.scale, "bend": sheet.bend},
        "camera": some.camera.tolist(),
        "errors": {name: E.tolist() for name, E in some.arm.errors.items()},
        "zeros": some.arm.zeros,
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=2) + "\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--images", type=int, default=24)
    parser.add_argument("--cause", choices=("none", "scale", "twist", "zero", "blur"), default="none")
    given = parser.parse_args()
    write(given.folder, session(given.seed, given.images, given.cause), given.seed)
