"""How a camera sees: a pinhole with the lens distortion of Brown and Conrady, in OpenCV's convention.

The camera's frame has z forward, x to the right and y down in the image. With x = X / Z, y = Y / Z, r2 = x^2 + y^2:

    radial = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)
    x' = x radial + 2 p1 x y + p2 (r2 + 2 x^2),     u = fx x' + cx
    y' = y radial + p1 (r2 + 2 y^2) + 2 p2 x y,     v = fy y' + cy

(OpenCV, camera calibration and 3D reconstruction; D. C. Brown, Close-range camera calibration, 1971; D. Claus, A. W.
Fitzgibbon, A rational function lens distortion model for general cameras, 2005). The centre of the first pixel is at
u = v = 0.
"""

from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, BoolArray
from calib.measurement.lens import Lens

# Nearer to the camera's own plane than this share of their distance, points are not seen: 89.4 degrees off the axis.
LEAST_DEPTH = 1e-2
_MOST_STEPS = 50
_TINY = 1e-12
# Of an undistorted coordinate, which is of order one.
_TOLERANCE = 1e-13
_FOUND = 1e-9


class Projected(NamedTuple):
    """Pixels (n, 2), their derivatives (n, 2, 3) by the points, and which points (n,) are before the camera.

    Those that are not are taken for points at the edge of sight, so that a solver that strays finds its way back.
    ``flat`` (n, 2): where they are seen without distortion.
    """

    pixels: Array
    by_point: Array
    in_front: BoolArray
    flat: Array


def project(lens: Lens, points: Array) -> Projected:
    """Return where a camera sees points (n, 3), given in m in its frame."""
    distance = np.maximum(np.linalg.norm(points, axis=1), _TINY)
    in_front = points[:, 2] > LEAST_DEPTH * distance
    depth = np.where(in_front, points[:, 2], LEAST_DEPTH * distance)
    by_depth = np.where(in_front[:, None], (0.0, 0.0, 1.0), LEAST_DEPTH * points / distance[:, None])
    flat = points[:, :2] / depth[:, None]
    bent, by_flat = distort(lens, flat)
    f = np.array([lens.fx, lens.fy])
    by_point = (np.eye(2, 3) - flat[:, :, None] * by_depth[:, None, :]) / depth[:, None, None]
    return Projected(bent * f + (lens.cx, lens.cy), f[:, None] * (by_flat @ by_point), in_front, flat)


def by_lens(lens: Lens, flat: Array) -> Array:
    """Return the derivatives (n, 2, 12) of pixels by the numbers of the lens, at undistorted coordinates (n, 2)."""
    x, y = flat.T
    r2 = x * x + y * y
    above, below, _ = _radial(lens, r2)
    found = np.zeros((len(flat), 2, len(lens)))
    bent, _ = distort(lens, flat)
    found[:, 0, 0], found[:, 1, 1] = bent.T
    found[:, 0, 2] = found[:, 1, 3] = 1.0
    # k1, k2, k3 stand above the line of the radial factor, k4, k5, k6 below it.
    powers = r2[:, None] ** np.arange(1, 4)
    found[:, :, [4, 5, 8]] = flat[:, :, None] * (powers / below[:, None])[:, None, :]
    found[:, :, 9:] = flat[:, :, None] * (-powers * (above / below**2)[:, None])[:, None, :]
    found[:, :, 6] = np.stack([2.0 * x * y, r2 + 2.0 * y * y], axis=1)
    found[:, :, 7] = np.stack([r2 + 2.0 * x * x, 2.0 * x * y], axis=1)
    found[:, :, 4:] *= np.array([lens.fx, lens.fy])[:, None]
    return found


def _radial(lens: Lens, r2: Array) -> tuple[Array, Array, Array]:
    """Return what stands above and below the line of the radial factor (n,), and the factor's derivative by r2."""
    above = 1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    below = 1.0 + r2 * (lens.k4 + r2 * (lens.k5 + r2 * lens.k6))
    by_r2 = lens.k1 + r2 * (2.0 * lens.k2 + r2 * 3.0 * lens.k3)
    below_by_r2 = lens.k4 + r2 * (2.0 * lens.k5 + r2 * 3.0 * lens.k6)
    return above, below, (by_r2 - above / below * below_by_r2) / below


def distort(lens: Lens, flat: Array) -> tuple[Array, Array]:
    """Return distorted coordinates (n, 2) of undistorted ones (n, 2), X / Z and Y / Z, and derivatives (n, 2, 2)."""
    p1, p2 = lens.p1, lens.p2
    x, y = flat.T
    r2 = x * x + y * y
    above, below, by_r2 = _radial(lens, r2)
    radial = above / below
    bent = np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=1,
    )
    across = 2.0 * (x * y * by_r2 + p1 * x + p2 * y)
    by_flat = np.empty((len(flat), 2, 2))
    by_flat[:, 0, 0] = radial + 2.0 * x * x * by_r2 + 2.0 * p1 * y + 6.0 * p2 * x
    by_flat[:, 1, 1] = radial + 2.0 * y * y * by_r2 + 6.0 * p1 * y + 2.0 * p2 * x
    by_flat[:, 0, 1] = by_flat[:, 1, 0] = across
    return bent, by_flat


def undistort(lens: Lens, pixels: Array) -> tuple[Array, BoolArray]:
    """Return the undistorted coordinates (n, 2) of pixels (n, 2), and which (n,) could be found.

    Newton's method from the distorted coordinates. A pixel has none where the lens would have to fold the image back on
    the way from its middle: there the distortion is used beyond the image that it was calibrated for.
    """
    wanted = (pixels - (lens.cx, lens.cy)) / (lens.fx, lens.fy)
    # Along the way from the middle to the pixel: a lens that does not fold is followed without leaving its branch.
    flat = np.zeros_like(wanted)
    upright = np.ones(len(wanted), dtype=np.bool_)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for share in (0.25, 0.5, 0.75, 1.0):
            for _ in range(_MOST_STEPS):
                bent, J = distort(lens, flat)
                r = bent - share * wanted
                determinant = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
                step = np.stack(
                    [J[:, 1, 1] * r[:, 0] - J[:, 0, 1] * r[:, 1], J[:, 0, 0] * r[:, 1] - J[:, 1, 0] * r[:, 0]], axis=1
                )
                step = np.where(upright[:, None], step / determinant[:, None], 0.0)
                flat = flat - step
                if not np.any(np.abs(step) > _TOLERANCE):
                    break
            bent, J = distort(lens, flat)
            trace = J[:, 0, 0] + J[:, 1, 1]
            determinant = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
            near = np.all(np.abs(bent - share * wanted) < _FOUND, axis=1)
            upright &= near & (determinant > 0.0) & (trace > 0.0)
    return np.where(upright[:, None], flat, 0.0), upright
