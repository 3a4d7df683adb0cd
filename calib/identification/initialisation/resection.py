"""Resection: where is a camera that saw known points, or a point that moves on known paths, with no guess.

With A = R_camera^T, mark n is seen in the direction of ``X_n = A (t_n + R_n p) + s``: points t_n where p = 0, or a
point p carried along by frames (R_n, t_n). Rotations come in closed form from a homography (Z. Zhang, A flexible new
technique for camera calibration, 2000), where the points lie in a plane, or from the direct linear transformation (Y.
I. Abdel-Aziz, H. M. Karara, 1971), where they do not; where p is unknown, from all around as well. For a rotation,
``b_n x X_n = 0`` is linear in p and s. Levenberg-Marquardt on ``X_n / |X_n| - b_n`` has the last word: unlike pixels,
directions are bounded, and those behind the camera are as far off as can be.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from calib.foundations import rigid
from calib.foundations.arrays import Array, BoolArray, IntArray, read_only
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
# The second pose of a photograph is clearly worse by four standard deviations, squared.
_CLEARLY = 16.0
# Searches for poses end where a step gains less than this share of the cost, or moves by less than that.
_SAME_COST, _SAME_PLACE, _MOST_STEPS = 1e-10, 1e-12, 100
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING, _TINY = 1e-3, 1e-9, 1e9, 1e-15
# Marks of photographs whose poses are sought at once, and how many such searches are remembered.
_AT_ONCE, _REMEMBERED = 20_000, 32


def rays(flat: Array) -> Array:
    """Return unit directions (n, 3) of undistorted coordinates (n, 2)."""
    b = np.column_stack([flat, np.ones(len(flat))])
    return np.asarray(b / np.linalg.norm(b, axis=1, keepdims=True))


def camera_pose(points: Array, b: Array) -> Array | None:
    """Return the pose (4, 4) of a camera that saw points (n, 3) in directions b (n, 3), in the points' frame.

    Marks by far off the others are left out. None where there are too few: four, or six that are not in a plane; or
    where they are on a line.
    """
    poses, found = camera_poses([points], [b])
    return poses[0] if found[0] else None


class Resections(NamedTuple):
    """Poses (m, 4, 4) of a camera in m photographs, which are ``told`` (m,), and the ``others`` that fit second best.

    ``sure`` (m,): where those fit clearly worse. Elsewhere a plane looks the same tilted to the other side.
    """

    poses: Array
    others: Array
    told: BoolArray
    sure: BoolArray

    @classmethod
    def none(cls, m: int) -> "Resections":
        """Return those of photographs that tell nothing yet, to be filled."""
        poses = np.tile(np.eye(4), (m, 1, 1))
        return cls(poses, poses.copy(), np.zeros(m, dtype=np.bool_), np.ones(m, dtype=np.bool_))

    def some(self, photographs: BoolArray) -> "Resections":
        """Return those of some photographs (m,)."""
        poses, others = self.poses[photographs], self.others[photographs]
        return Resections(poses, others, self.told[photographs], self.sure[photographs])

    def put(self, photographs: slice | BoolArray, new: "Resections") -> None:
        """Write ``new`` ones in the place of some photographs."""
        for part, of_new in zip(self, new, strict=True):
            part[photographs] = of_new


def camera_poses(points: Sequence[Array], b: Sequence[Array]) -> tuple[Array, BoolArray]:
    """Return the poses (m, 4, 4) of a camera in m photographs, as :func:`camera_pose` does, and which are told (m,)."""
    found = resections(points, b)
    return found.poses, found.told


def resections(points: Sequence[Array], b: Sequence[Array]) -> Resections:
    """Return the poses of a camera in m photographs, and what they may be taken for.

    All are sought at once: that takes a tenth of the time of one after another.
    """
    found = Resections.none(len(points))
    counts, start = np.array([len(one) for one in points], dtype=np.intp), 0
    ends = np.cumsum(counts)
    while start < len(points):
        end = max(int(np.searchsorted(ends, ends[start] - counts[start] + _AT_ONCE, side="right")), start + 1)
        some = slice(start, end)
        told = [np.ascontiguousarray(np.concatenate(part[some]), dtype=np.float64).tobytes() for part in (points, b)]
        found.put(some, _trimmed_poses(*told, tuple(counts[some].tolist())))
        start = end
    return found


# A search among models or lenses begins with the same photographs again and again.
@lru_cache(maxsize=_REMEMBERED)
def _trimmed_poses(points_of: bytes, b_of: bytes, counts: tuple[int, ...]) -> Resections:
    points, b = (np.frombuffer(data).reshape(-1, 3) for data in (points_of, b_of))
    photograph = np.repeat(np.arange(len(counts)), counts)
    found = _camera_poses(points, b, photograph, len(counts))
    kept, open_ = np.ones(len(points), dtype=np.bool_), found.told.copy()
    for _ in range(_MOST_TRIMS):
        last, rows = kept, np.flatnonzero(open_[photograph])
        kept = last.copy()
        off, own = misses(found.poses[photograph[rows]], points[rows], b[rows]), photograph[rows]
        kept[rows] = off <= _GROSS * np.maximum(medians(off, own, len(counts)), _NEGLIGIBLE)[own]
        open_ &= np.bincount(photograph, kept != last, len(counts)) > 0
        again = np.flatnonzero(open_[photograph] & kept)
        if not open_.any():
            break
        better = _camera_poses(points[again], b[again], photograph[again], len(counts))
        open_ &= better.told
        found.put(open_, better.some(open_))
    return Resections(read_only(found.poses), read_only(found.others), found.told, found.sure)


def medians(values: Array, photograph: IntArray, m: int) -> Array:
    """Return the medians (m,) of values (n,) of photographs, which are in order; nothing of those that have none."""
    ordered = values[np.lexsort((values, photograph))]
    counts = np.bincount(photograph, minlength=m)
    first = np.cumsum(counts) - counts
    found, some = np.zeros(m), counts > 0
    low, high = (first + (counts - 1) // 2)[some], (first + counts // 2)[some]
    found[some] = 0.5 * (ordered[low] + ordered[high])
    return found


def misses(cameras: Array, points: Array, b: Array) -> Array:
    """Return how far directions (n, 3), in rad, are from those of points (n, 3) to cameras at poses (n, 4, 4)."""
    X = (np.swapaxes(cameras[:, :3, :3], 1, 2) @ (points - cameras[:, :3, 3])[:, :, None])[:, :, 0]
    return np.asarray(np.linalg.norm(X / np.maximum(np.linalg.norm(X, axis=1), _TINY)[:, None] - b, axis=1))


def not_outlying(off: Array) -> BoolArray:
    """Return which of n distances from a fit are not by far larger than most of them."""
    return np.asarray(off <= _GROSS * max(float(np.median(off)), _NEGLIGIBLE))


class _Seen(NamedTuple):
    """Points (n, 3) of m photographs seen in directions b (n, 3), and the ``photograph`` (n,) of each, ascending.

    Every photograph has some; those of each begin at ``first`` (m,).
    """

    points: Array
    b: Array
    photograph: IntArray
    first: IntArray

    @classmethod
    def of(cls, points: Array, b: Array, photograph: IntArray) -> "_Seen":
        """Return points of photographs, which are numbered anew where some have none."""
        begins = np.diff(photograph, prepend=-1) > 0
        return cls(points, b, np.cumsum(begins) - 1, np.flatnonzero(begins))

    def some(self, photographs: BoolArray) -> "_Seen":
        """Return some of the photographs (m,)."""
        rows = photographs[self.photograph]
        return _Seen.of(self.points[rows], self.b[rows], self.photograph[rows])

    def sums(self, values: Array) -> Array:
        """Return the sums (m, ...) over each photograph of values (n, ...)."""
        return np.asarray(np.add.reduceat(values, self.first, axis=0))

    def squares(self, rows: Array) -> Array:
        """Return ``J^T J`` (m, k, k) over each photograph of rows J (n, d, k)."""
        ends = np.append(self.first[1:], len(rows)).tolist()
        parts = [rows[i:j].reshape(-1, rows.shape[2]) for i, j in zip(self.first.tolist(), ends, strict=True)]
        return np.array([part.T @ part for part in parts])

    @property
    def counts(self) -> IntArray:
        """How many points each photograph (m,) has."""
        return np.diff(self.first, append=len(self.points))

    @property
    def across(self) -> Array:
        """Projections (n, 3, 3) across the directions."""
        return np.asarray(np.eye(3) - self.b[:, :, None] * self.b[:, None, :])


def _camera_poses(points: Array, b: Array, photograph: IntArray, m: int) -> Resections:
    """Return the poses of all photographs; no mark is left out."""
    every, enough = Resections.none(m), np.bincount(photograph, minlength=m) >= _LEAST_OF_PLANE
    if not enough.any():  # none at all, where a lens bends no ray to the pixels
        return every
    rows = enough[photograph]
    seen = _Seen.of(points[rows], b[rows], photograph[rows])
    middle = seen.sums(seen.points) / seen.counts[:, None]
    # About its middle a board's turn and its place hardly look alike.
    seen = seen._replace(points=seen.points - middle[seen.photograph])
    squares, axes = np.linalg.eigh(seen.squares(seen.points[:, None]))
    spread = np.sqrt(np.maximum(squares[:, ::-1], 0.0))
    flat = spread[:, 2] <= _FLAT * spread[:, 0]
    told = (spread[:, 1] > _STRAIGHT * spread[:, 0]) & (flat | (seen.counts >= _LEAST_OF_SPACE))
    found, sure = np.tile(np.eye(4), (2, len(told), 1, 1)), np.ones(len(told), dtype=np.bool_)
    for those, turns_of in ((told & flat, _of_planes), (told & ~flat, _of_spaces)):
        if those.any():
            own = seen.some(those)
            searched = [_searched(own, turns) for turns in turns_of(own, np.swapaxes(axes[those], 1, 2)[:, ::-1])]
            A, s, cost = (np.stack(part) for part in zip(*searched, strict=True))
            order, number = np.argsort(cost, axis=0, kind="stable")[[0, -1]], np.arange(len(own.first))
            turned, ordered = A[order, number], cost[order, number]
            away = s[order, number] - (turned @ middle[those][:, :, None])[..., 0]
            found[:, those] = rigid.inverse(rigid.placement(turned, away))
            of_one = ordered[0] / np.maximum(2 * own.counts - 6, 1)
            sure[those] = (len(searched) == 1) | (ordered[1] > ordered[0] + _CLEARLY * of_one)
    every.put(enough, Resections(found[0], found[1], told, sure))
    return every


def _searched(seen: _Seen, A: Array) -> tuple[Array, Array, Array]:
    """Return rotations (m, 3, 3), places s (m, 3) and costs (m,) of the best fits from rotations A (m, 3, 3)."""
    known = (A[seen.photograph] @ seen.points[:, :, None])[:, :, 0]
    across = seen.across
    right = seen.sums((across @ known[:, :, None])[:, :, 0])
    s = -(np.linalg.pinv(seen.sums(across), rcond=_NEGLIGIBLE**2, hermitian=True) @ right[:, :, None])[:, :, 0]
    at, A = _squares(seen, A, s), A.copy()
    cost, damping, open_ = at[:, 6, 6].copy(), np.full(len(s), _DAMPING), np.arange(len(s))
    for _ in range(_MOST_STEPS):
        held = damping[open_, None] * np.einsum("mii->mi", at)[:, :6]
        held = (held + _TINY * (1.0 + held.max(axis=1, keepdims=True)))[:, :, None] * np.eye(6)
        step = -np.linalg.solve(at[:, :6, :6] + held, at[:, :6, 6:])[:, :, 0]
        turned, moved = A[open_] @ rigid.exp3(step[:, :3]), s[open_] + step[:, 3:]
        trial = _squares(seen, turned, moved)
        gain = cost[open_] - trial[:, 6, 6]
        lower = gain >= 0.0
        damping[open_] = np.where(lower, np.maximum(0.1 * damping[open_], _LEAST_DAMPING), 10.0 * damping[open_])
        short = np.abs(step).max(axis=1) < _SAME_PLACE * np.maximum(1.0, np.linalg.norm(moved, axis=1))
        left = ~(short | (lower & (gain <= _SAME_COST * cost[open_])) | (damping[open_] > _MOST_DAMPING))
        better = open_[lower]
        A[better], s[better], cost[better] = turned[lower], moved[lower], trial[lower, 6, 6]
        at, seen, open_ = np.where(lower[:, None, None], trial, at)[left], seen.some(left), open_[left]
        if not len(open_):
            break
    return A, s, cost


def _squares(seen: _Seen, A: Array, s: Array) -> Array:
    """Return ``[J r]^T [J r]`` (m, 7, 7) for ``r = X / |X| - b`` by a turn and a shift, at A (m, 3, 3) and s (m, 3)."""
    turned = A[seen.photograph]
    X = (turned @ seen.points[:, :, None])[:, :, 0] + s[seen.photograph]
    length = np.maximum(np.linalg.norm(X, axis=1), _TINY)[:, None]
    u = X / length
    by_point = (np.eye(3) - u[:, :, None] * u[:, None, :]) / length[:, :, None]
    by_turn = -by_point @ turned @ rigid.skew(seen.points)
    return seen.squares(np.concatenate([by_turn, by_point, (u - seen.b)[:, :, None]], axis=2))


def camera_pose_and_point(frames: Array, b: Array) -> tuple[Array, Array] | None:
    """Return the pose (4, 4) of a camera that saw a point carried by frames (n, 4, 4) in directions b, and the point.

    The pose is in the reference of the frames, the point (3,) in the moving ones. None where they are too few.
    """
    if len(frames) < _LEAST_OF_PATHS:
        return None
    t = frames[:, :3, 3]
    seen = _Seen.of(t - t.mean(axis=0), b, np.zeros(len(b), dtype=np.intp))
    return _best(frames, b, np.concatenate([cube_rotations(), *_of_spaces(seen, frames)]))


def crossing(origins: Array, directions: Array) -> Array:
    """Return the point (3,) nearest to all lines through origins (n, 3) along unit directions (n, 3)."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    b = (across @ origins[:, :, None])[:, :, 0]
    return np.asarray(np.linalg.lstsq(across.reshape(-1, 3), b.ravel(), rcond=_NEGLIGIBLE)[0])


def _best(frames: Array, b: Array, turns: Array) -> tuple[Array, Array]:
    """Return the camera's pose and the point that explain directions best, from rotations A (k, 3, 3) to begin with."""
    R, t = frames[:, :3, :3], frames[:, :3, 3]

    def seen(A: Array, s: Array, p: Array) -> tuple[Array, Array, Array]:
        carried = t + R @ p
        X = carried @ A.T + s
        return carried, X, np.linalg.norm(X, axis=1)[:, None]

    def residual(z: Array, A: Array) -> Array:
        _, X, length = seen(A @ rigid.exp3(z[:3]), z[3:6], z[6:])
        return np.asarray((X / length - b).ravel())

    def jacobian(z: Array, A: Array) -> Array:
        turned = A @ rigid.exp3(z[:3])
        carried, X, length = seen(turned, z[3:6], z[6:])
        # exp(w + dw) = exp(w) exp(Jl(-w) dw)
        by_turn = -turned @ rigid.skew(carried) @ np.linalg.inv(rigid.left_jacobian_inverse(-z[:3]))
        columns = [by_turn, np.broadcast_to(np.eye(3), by_turn.shape), turned @ R]
        u = X / length
        across = (np.eye(3) - u[:, :, None] * u[:, None, :]) / length[:, :, None]
        return np.asarray((across @ np.concatenate(columns, axis=2)).reshape(3 * len(b), -1))

    found, C = [], rigid.skew(b)
    for A in turns:
        right = -(C @ (t @ A.T)[:, :, None]).ravel()
        columns = np.concatenate([C, C @ A @ R], axis=2).reshape(len(right), -1)
        z = np.concatenate([np.zeros(3), np.linalg.lstsq(columns, right, rcond=_NEGLIGIBLE)[0]])
        found.append((float(np.sum(residual(z, A) ** 2)), A, z))
    found.sort(key=lambda start: start[0])
    searched = [
        (scipy.optimize.least_squares(residual, z, jacobian, args=(A,), method="lm"), A)
        for _, A, z in found[:_PROMISING]
    ]
    result, A = min(searched, key=lambda one: float(one[0].cost))
    z = np.asarray(result.x)
    return rigid.inverse(rigid.placement(A @ rigid.exp3(z[:3]), z[3:6])), z[6:]


def _of_planes(seen: _Seen, axes: Array) -> list[Array]:
    """Return two rotations A (m, 3, 3) for points near planes: of the homographies, and what they may be taken for.

    ``axes`` (m, 3, 3): the directions in which points, about their middles, spread most first.
    """
    axes = axes.copy()
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    places = (axes[seen.photograph, :2] @ seen.points[:, :, None])[:, :, 0]
    size = np.maximum.reduceat(np.abs(places).max(axis=1), seen.first)
    H = _null(seen, places / size[seen.photograph, None])
    # The middle of the points is before the camera.
    H = H * np.sign(np.sum(H[:, :, 2] * seen.sums(seen.b), axis=1))[:, None, None]
    R = rigid.nearest_rotation(np.stack([H[:, :, 0], H[:, :, 1], np.cross(H[:, :, 0], H[:, :, 1])], axis=2))
    # From far, a plane looks like its mirror image across the line of sight.
    sight = H[:, :, 2] / np.maximum(np.linalg.norm(H[:, :, 2], axis=1), _TINY)[:, None]
    mirrored = R[:, :, :2] - 2.0 * sight[:, :, None] * (sight[:, None] @ R[:, :, :2])
    other = np.stack([mirrored[:, :, 0], mirrored[:, :, 1], np.cross(mirrored[:, :, 0], mirrored[:, :, 1])], axis=2)
    return [R @ axes, other @ axes]


def _of_spaces(seen: _Seen, _: Array) -> list[Array]:
    """Return the rotations A (m, 3, 3) of the direct linear transformation, of points about their middles."""
    size = np.maximum.reduceat(np.abs(seen.points).max(axis=1), seen.first)
    P = _null(seen, seen.points / np.maximum(size, _NEGLIGIBLE)[seen.photograph, None])[:, :, :3]
    return [rigid.nearest_rotation(P * np.sign(np.linalg.det(P))[:, None, None])]


def _null(seen: _Seen, places: Array) -> Array:
    """Return matrices M (m, 3, k + 1) of norm 1 with ``b x M (y, 1)`` nearest to zero, y being places (n, k)."""
    y = np.column_stack([places, np.ones(len(places))])
    k = y.shape[1]
    # The square of b x is 1 - b b^T.
    squares = np.einsum("ij,mkl->mikjl", np.eye(3), seen.squares(y[:, None])).reshape(-1, 3 * k, 3 * k)
    squares -= seen.squares((seen.b[:, :, None] * y[:, None, :]).reshape(len(y), 1, 3 * k))
    return np.asarray(np.linalg.eigh(squares)[1][:, :, 0].reshape(-1, 3, k))
