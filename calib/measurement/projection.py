"""How a camera sees: a pinhole with the lens distortion of Brown and Conrady, in OpenCV's convention.

The camera's frame has z forward, x to the right and y down in the image. With x = X / Z, y = Y / Z, r2 = x^2 + y^2:

    radial = 1 + k1 r2 + k2 r2^2 + k3 r2^3
    x' = x radial + 2 p1 x y + p2 (r2 + 2 x^2),     u = fx x' + cx
    y' = y radial + p1 (r2 + 2 y^2) + 2 p2 x y,     v = fy y' + cy

(OpenCV, camera calibration and 3D reconstruction; D. C. Brown, Close-range camera calibration, 1971). The centre of the
first pixel is at u = v = 0.
"""

from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, BoolArray
from calib.measurement.instruments import Camera

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
    """

    pixels: Array
    by_point: Array
    in_front: BoolArray


def project(camera: Camera, points: Array) -> Projected:
    """Return where a camera sees points (n, 3), given in m in its frame."""
    distance = np.maximum(np.linalg.norm(points, axis=1), _TINY)
    in_front = points[:, 2] > LEAST_DEPTH * distance
    depth = np.where(in_front, points[:, 2], LEAST_DEPTH * distance)
    by_depth = np.where(in_front[:, None], (0.0, 0.0, 1.0), LEAST_DEPTH * points / distance[:, None])
    flat = points[:, :2] / depth[:, None]
    bent, by_flat = distort(camera, flat)
    f = np.array([camera.fx, camera.fy])
    by_point = (np.eye(2, 3) - flat[:, :, None] * by_depth[:, None, :]) / depth[:, None, None]
    return Projected(bent * f + (camera.cx, camera.cy), f[:, None] * (by_flat @ by_point), in_front)


def distort(camera: Camera, flat: Array) -> tuple[Array, Array]:
    """Return distorted coordinates (n, 2) of undistorted ones (n, 2), X / Z and Y / Z, and derivatives (n, 2, 2)."""
    p1, p2 = camera.p1, camera.p2
    x, y = flat.T
    r2 = x * x + y * y
    radial = 1.0 + r2 * (camera.k1 + r2 * (camera.k2 + r2 * camera.k3))
    by_r2 = camera.k1 + r2 * (2.0 * camera.k2 + r2 * 3.0 * camera.k3)
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


def undistort(camera: Camera, pixels: Array) -> tuple[Array, BoolArray]:
    """Return the undistorted coordinates (n, 2) of pixels (n, 2), and which (n,) could be found.

    Newton's method from the distorted coordinates. A pixel has none where the lens would have to fold the image back on
    the way from its middle: there the distortion is used beyond the image that it was calibrated for.
    """
    wanted = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    # Along the way from the middle to the pixel: a lens that does not fold is followed without leaving its branch.
    flat = np.zeros_like(wanted)
    upright = np.ones(len(wanted), dtype=np.bool_)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for share in (0.25, 0.5, 0.75, 1.0):
            for _ in range(_MOST_STEPS):
                bent, J = distort(camera, flat)
                r = bent - share * wanted
                determinant = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
                step = np.stack(
                    [J[:, 1, 1] * r[:, 0] - J[:, 0, 1] * r[:, 1], J[:, 0, 0] * r[:, 1] - J[:, 1, 0] * r[:, 0]], axis=1
                )
                step = np.where(upright[:, None], step / determinant[:, None], 0.0)
                flat = flat - step
                if not np.any(np.abs(step) > _TOLERANCE):
                    break
            bent, J = distort(camera, flat)
            trace = J[:, 0, 0] + J[:, 1, 1]
            determinant = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
            near = np.all(np.abs(bent - share * wanted) < _FOUND, axis=1)
            upright &= near & (determinant > 0.0) & (trace > 0.0)
    return np.where(upright[:, None], flat, 0.0), upright
