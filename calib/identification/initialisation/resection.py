"""Resection: where is a camera that saw known points, or a point that moves on known paths, with no guess.

With A = R_camera^T, mark n is seen in the direction of ``X_n = A (t_n + R_n p) + s``: points t_n where p = 0, or a
point p carried along by frames (R_n, t_n). Rotations come in closed form from a homography (Z. Zhang, A flexible new
technique for camera calibration, 2000), where the points lie in a plane, or from the direct linear transformation (Y.
I. Abdel-Aziz, H. M. Karara, 1971), where they do not; where p is unknown, from all around as well. For a rotation,
``b_n x X_n = 0`` is linear in p and s. Levenberg-Marquardt on ``X_n / |X_n| - b_n`` has the last word: unlike pixels,
directions are bounded, and those behind the camera are as far off as can be.
"""

from functools import lru_cache

import numpy as np
import scipy

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array, BoolArray, read_only
from calib.identification.initialisation.base_and_tools import cube_rotations

# Points are spread over three dimensions, over two, or over one, by their spread relative to the largest one.
_FLAT = 0.05
_STRAIGHT = 1e-3
_LEAST_OF_PLANE, _LEAST_OF_SPACE, _LEAST_OF_PATHS = 4, 6, 6
# Starts worth a search.
_PROMISING = 6
_NEGLIGIBLE = 1e-10
# So many times the median distance from a fit are an outlier, which has no say in a start.
_GROSS = 5.0
_MOST_TRIMS = 4


def rays(flat: Array) -> Array:
    """Return unit directions (n, 3) of undistorted coordinates (n, 2)."""
    b = np.column_stack([flat, np.ones(len(flat))])
    return np.asarray(b / np.linalg.norm(b, axis=1, keepdims=True))


def camera_pose(points: Array, b: Array) -> Array | None:
    """Return the pose (4, 4) of a camera that saw points (n, 3) in directions b (n, 3), in the points' frame.

    Marks by far off the others are left out. None where there are too few: four, or six that are not in a plane; or
    where they are on a line.
    """
    return _trimmed_pose(np.ascontiguousarray(points).tobytes(), np.ascontiguousarray(b).tobytes())


# A search among models or lenses begins with the same photographs again and again.
@lru_cache(maxsize=512)
def _trimmed_pose(points_of: bytes, b_of: bytes) -> Array | None:
    points, b = (np.frombuffer(data).reshape(-1, 3) for data in (points_of, b_of))
    pose, kept = _camera_pose(points, b), np.ones(len(points), dtype=np.bool_)
    for _ in range(_MOST_TRIMS):
        if pose is None:
            break
        last, kept = kept, not_outlying(misses(pose, points, b))
        if np.array_equal(kept, last) or (better := _camera_pose(points[kept], b[kept])) is None:
            break
        pose = better
    return None if pose is None else read_only(pose)


def misses(camera: Array, points: Array, b: Array) -> Array:
    """Return how far directions (n, 3), in rad, are from those of points (n, 3) to a camera at a pose (4, 4)."""
    X = (points - camera[:3, 3]) @ camera[:3, :3]
    return np.asarray(np.linalg.norm(X / np.linalg.norm(X, axis=1, keepdims=True) - b, axis=1))


def not_outlying(off: Array) -> BoolArray:
    """Return which of n distances from a fit are not by far larger than most of them."""
    return np.asarray(off <= _GROSS * max(float(np.median(off)), _NEGLIGIBLE))


def _camera_pose(points: Array, b: Array) -> Array | None:
    n = len(points)
    if n < _LEAST_OF_PLANE:  # none at all, where a lens bends no ray to the pixels
        return None
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] <= _STRAIGHT * spread[0]:
        return None
    if spread[2] <= _FLAT * spread[0]:
        turns = _of_plane(points, b)
    elif n >= _LEAST_OF_SPACE:
        turns = _of_space(points, b)
    else:
        return None
    return _best(rigid.translation(points), b, turns, np.zeros(3))[0]


def camera_pose_and_point(frames: Array, b: Array) -> tuple[Array, Array] | None:
    """Return the pose (4, 4) of a camera that saw a point carried by frames (n, 4, 4) in directions b, and the point.

    The pose is in the reference of the frames, the point (3,) in the moving ones. None where they are too few.
    """
    if len(frames) < _LEAST_OF_PATHS:
        return None
    return _best(frames, b, np.concatenate([cube_rotations(), _of_space(frames[:, :3, 3], b)]), None)


def crossing(origins: Array, directions: Array) -> Array:
    """Return the point (3,) nearest to all lines through origins (n, 3) along unit directions (n, 3)."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    b = (across @ origins[:, :, None])[:, :, 0]
    return np.asarray(np.linalg.lstsq(across.reshape(-1, 3), b.ravel(), rcond=_NEGLIGIBLE)[0])


def _best(frames: Array, b: Array, turns: Array, point: Array | None) -> tuple[Array, Array]:
    """Return the camera's pose and the point that explain directions best, from rotations A (k, 3, 3) to begin with."""
    R, t = frames[:, :3, :3], frames[:, :3, 3]

    def seen(A: Array, s: Array, p: Array) -> tuple[Array, Array, Array]:
        carried = t + R @ p
        X = carried @ A.T + s
        return carried, X, np.linalg.norm(X, axis=1)[:, None]

    def residual(z: Array, A: Array) -> Array:
        _, X, length = seen(A @ rigid.exp3(z[:3]), z[3:6], z[6:] if point is None else point)
        return np.asarray((X / length - b).ravel())

    def jacobian(z: Array, A: Array) -> Array:
        turned = A @ rigid.exp3(z[:3])
        carried, X, length = seen(turned, z[3:6], z[6:] if point is None else point)
        # exp(w + dw) = exp(w) exp(Jl(-w) dw)
        by_turn = -turned @ rigid.skew(carried) @ np.linalg.inv(rigid.left_jacobian_inverse(-z[:3]))
        columns = [by_turn, np.broadcast_to(np.eye(3), by_turn.shape), *([turned @ R] if point is None else [])]
        u = X / length
        across = (np.eye(3) - u[:, :, None] * u[:, None, :]) / length[:, :, None]
        return np.asarray((across @ np.concatenate(columns, axis=2)).reshape(3 * len(b), -1))

    found = []
    for A in turns:
        C = rigid.skew(b)
        columns = [C, *([C @ A @ R] if point is None else [])]
        known = t if point is None else t + R @ point
        right = -(C @ (known @ A.T)[:, :, None]).ravel()
        s_and_p = np.linalg.lstsq(np.concatenate(columns, axis=2).reshape(len(right), -1), right, rcond=_NEGLIGIBLE)[0]
        z = np.concatenate([np.zeros(3), s_and_p])
        found.append((float(np.sum(residual(z, A) ** 2)), A, z))
    found.sort(key=lambda start: start[0])
    searched = [
        (scipy.optimize.least_squares(residual, z, jacobian, args=(A,), method="lm"), A)
        for _, A, z in found[:_PROMISING]
    ]
    result, A = min(searched, key=lambda one: float(one[0].cost))
    z = np.asarray(result.x)
    pose = rigid.inverse(rigid.placement(A @ rigid.exp3(z[:3]), z[3:6]))
    return pose, z[6:] if point is None else point


def _of_plane(points: Array, b: Array) -> Array:
    """Return rotations A (2, 3, 3) for points near a plane: that of the homography, and the one it may be taken for."""
    middle = points.mean(axis=0)
    axes = linear.svd(points - middle, full_matrices=False)[2]
    axes[2] = np.cross(axes[0], axes[1])
    places = (points - middle) @ axes[:2].T
    H = _null((places / np.abs(places).max(), np.ones((len(places), 1))), b)
    # The middle of the points is before the camera.
    H = H * np.sign(H[:, 2] @ b.mean(axis=0))
    R = rigid.nearest_rotation(np.column_stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])]))
    # From far, a plane looks like its mirror image across the line of sight.
    sight = H[:, 2] / np.linalg.norm(H[:, 2])
    mirrored = R[:, :2] - 2.0 * sight[:, None] * (sight @ R[:, :2])
    other = np.column_stack([mirrored, np.cross(mirrored[:, 0], mirrored[:, 1])])
    return np.asarray(np.stack([R, other]) @ axes)


def _of_space(points: Array, b: Array) -> Array:
    """Return the rotation A (1, 3, 3) of the direct linear transformation."""
    middle = points.mean(axis=0)
    places = points - middle
    P = _null((places / max(float(np.abs(places).max()), _NEGLIGIBLE), np.ones((len(places), 1))), b)
    return np.asarray(rigid.nearest_rotation(P[:, :3] * np.sign(np.linalg.det(P[:, :3])))[None])


def _null(places: tuple[Array, Array], b: Array) -> Array:
    """Return the matrix M (3, k) for which ``b_n x M y_n`` is nearest to zero, of norm 1; y are ``places`` stacked."""
    y = np.column_stack(places)
    rows = (rigid.skew(b)[:, :, :, None] * y[:, None, None, :]).reshape(3 * len(b), -1)
    return np.asarray(linear.svd(linear.triangle(rows), full_matrices=True)[2][-1].reshape(3, -1))
