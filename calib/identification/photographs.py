"""Photographs of a board by themselves: lens and shape of the board, each photograph with a pose of its own.

No robot takes part. What photographs say of lens and board is thus free of its errors: a start where nothing is known
of the lens, and by whole photographs held out a judge of how many numbers lens and board need. The board's scale does
not show.

The focal length begins in closed form from homographies (Z. Zhang, A flexible new technique for camera calibration,
2000), for square pixels and a centre in the middle of the image. Levenberg-Marquardt finds the minimum; the poses are
eliminated photograph by photograph (B. Triggs et al., Bundle adjustment - a modern synthesis, 2000).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.identification.initialisation.resection import camera_poses, rays
from calib.measurement.boards import places_of
from calib.measurement.lens import FOCAL, NAMES, Lens
from calib.measurement.optics import MODE_WIDTH, lens_width
from calib.measurement.projection import by_lens, project, undistort

_MOST_STEPS, _NEGLIGIBLE = 60, 1e-7
_LEAST_DAMPING, _MOST_DAMPING, _TINY = 1e-9, 1e9, 1e-12
# Residuals beyond so many times their robust spread weigh less.
_FAR = 4.0
# Focal lengths of lenses, in widths of the image.
_FOCAL_RANGE = (0.2, 50.0)
# A richer model has to predict photographs better by so many standard errors, and by this share of the mean square.
_CLEARLY, _WORTH_IT = 2.0, 0.03
# No photograph leaves less than this mean square, in px^2: no mark is found better than to a thousandth.
_NO_NOISE = 1e-6


class Photograph(NamedTuple):
    """One photograph of a board: pixels (n, 2), where its marks should be (n, 3), and their modes (n, 3, k).

    ``sigma`` (n, 2): standard deviations of the pixels, all alike where they are not known.
    """

    pixels: Array
    marks: Array
    modes: Array
    sigma: Array


class Optics(NamedTuple):
    """A lens and the shape (k,) of a board's modes, in m."""

    lens: Lens
    shape: Array


class Bundle(NamedTuple):
    """Optics, the poses (m, 4, 4) of the board in the camera, and the residuals (n, 2), in px, of every photograph.

    ``converged``: whether the search has ended by itself.
    """

    optics: Optics
    poses: Array
    residuals: tuple[Array, ...]
    converged: bool

    @property
    def rms(self) -> float:
        """Two-dimensional rms of all residuals, in px."""
        return rms(self.residuals)


def rms(residuals: Sequence[Array]) -> float:
    """Return the two-dimensional rms of residuals (n, 2), in px."""
    return float(np.sqrt(np.mean(np.concatenate([np.sum(r * r, axis=1) for r in residuals]))))


def first_lens(photographs: Sequence[Photograph], lens: Lens) -> Lens:
    """Return a lens with square pixels whose focal length photographs of flat boards tell in closed form.

    ``lens``: whose centre is taken, and whose focal length stays where they tell none.
    """
    a, b = [], []
    for photograph in photographs:
        H = _homography(photograph, np.array([lens.cx, lens.cy]) / lens.fx, lens.fx)
        if H is not None:
            h, g = H[:, 0], H[:, 1]
            a += [h[0] * g[0] + h[1] * g[1], h[0] ** 2 + h[1] ** 2 - g[0] ** 2 - g[1] ** 2]
            b += [h[2] * g[2], h[2] ** 2 - g[2] ** 2]
    # h' diag(w, w, 1) g = 0 and h' diag(w, w, 1) h = g' diag(w, w, 1) g, with w = 1 / f^2 in units of the first one.
    A, right = np.array(a), np.array(b)
    weight = float(A @ A)
    w = -float(A @ right) / weight if weight > 0.0 else 0.0
    low, high = _FOCAL_RANGE
    if not 1.0 / high**2 < w < 1.0 / low**2:
        return lens
    return lens._replace(fx=lens.fx / np.sqrt(w), fy=lens.fx / np.sqrt(w))


def _homography(photograph: Photograph, centre: Array, unit: float) -> Array | None:
    """Return the homography (3, 3) from a plane of marks to pixels, from the centre in units; None of other marks."""
    middle = photograph.marks.mean(axis=0)
    _, spread, axes = linear.svd(photograph.marks - middle, full_matrices=False)
    if len(photograph.marks) < 4 or spread[2] > 1e-6 * spread[0] or spread[1] <= 1e-3 * spread[0]:
        return None
    places = (photograph.marks - middle) @ axes[:2].T
    places = places / np.abs(places).max()
    seen = photograph.pixels / unit - centre
    y = np.column_stack([places, np.ones(len(places))])
    zero = np.zeros_like(y)
    rows = np.concatenate([np.hstack([y, zero, -seen[:, :1] * y]), np.hstack([zero, y, -seen[:, 1:] * y])])
    H = linear.svd(rows, full_matrices=True)[2][-1].reshape(3, 3)
    return np.asarray(H / np.linalg.norm(H))


def poses_of(photographs: Sequence[Photograph], optics: Optics) -> tuple[Array, BoolArray]:
    """Return poses (m, 4, 4) of the board in the camera for given optics, and which photographs (m,) tell one."""
    if not photographs:
        return np.zeros((0, 4, 4)), np.zeros(0, dtype=np.bool_)
    stack = _Stack.of(photographs)
    flat, seen = undistort(optics.lens, stack.pixels)
    marks = places_of(stack.marks, stack.modes, np.concatenate([[0.0], optics.shape]))[0]
    ends = np.cumsum(np.bincount(stack.photograph[seen], minlength=len(photographs)))[:-1]
    cameras, found = camera_poses(np.split(marks[seen], ends), np.split(rays(flat[seen]), ends))
    return rigid.inverse(cameras), found


def fit(
    photographs: Sequence[Photograph], free: Sequence[str], start: Optics, poses: Array, *, shape: bool = True
) -> Bundle:
    """Return the optics that explain photographs best, from a start; ``free``: which numbers of the lens are sought.

    ``shape``: whether the board's is sought, in all its modes. Weak priors about the start hold what photographs do not
    tell; marks that lie off weigh less.
    """
    sought, stack = _Sought.of(free, start, shape=shape), _Stack.of(photographs)
    common, damping, converged = sought.start, 1e-3, False
    seen = _see(stack, start, poses, sought)
    for _ in range(_MOST_STEPS):
        weights = _weights(stack, seen)
        cost = _cost(seen, weights) + sought.cost(common)
        moved = False
        while not moved and damping < _MOST_DAMPING:
            step, twists = _step(stack, seen, weights, sought, common, damping)
            trial = common + step
            turned = poses @ rigid.placement(rigid.exp3(twists[:, 3:]), twists[:, :3])
            again = _see(stack, sought.at(trial), turned, sought)
            lower = _cost(again, weights) + sought.cost(trial)
            moved = lower <= cost
            damping *= 0.1 if moved else 10.0
        if not moved:
            converged = True
            break
        common, poses, seen = trial, turned, again
        damping = max(damping, _LEAST_DAMPING)
        if cost - lower <= _NEGLIGIBLE * cost:
            converged = True
            break
    return Bundle(sought.at(common), poses, stack.apart(seen.residual), converged)


class _Alike(NamedTuple):
    """Photographs (k,) of equally many marks, and their rows (k, n) among those of all."""

    photographs: IntArray
    rows: IntArray


class _Stack(NamedTuple):
    """All photographs as one: pixels, marks, modes and sigmas of N rows, and the ``photograph`` (N,) of each.

    To compute with all of them at once takes a fraction of the time of one photograph after another.
    """

    pixels: Array
    marks: Array
    modes: Array
    sigma: Array
    photograph: IntArray
    alike: tuple[_Alike, ...]

    @classmethod
    def of(cls, photographs: Sequence[Photograph]) -> "_Stack":
        counts = np.array([len(one.marks) for one in photographs], dtype=np.intp)
        starts, which = np.cumsum(counts) - counts, np.arange(len(counts), dtype=np.intp)
        alike = tuple(
            _Alike(those := which[counts == n], starts[those, None] + np.arange(n, dtype=np.intp))
            for n in np.unique(counts).tolist()
        )
        pixels, marks, modes, sigma = (np.concatenate(part) for part in zip(*photographs, strict=True))
        return cls(pixels, marks, modes, sigma, np.repeat(which, counts), alike)

    def apart(self, values: Array) -> tuple[Array, ...]:
        """Return values (N, ...) of the rows, photograph by photograph."""
        return tuple(np.split(values, np.flatnonzero(np.diff(self.photograph)) + 1))


class _Sought(NamedTuple):
    """What is sought of the optics: numbers of the lens (i,), the shape's modes or none; its start and widths (p,)."""

    optics: Optics
    entries: IntArray
    shape: bool
    start: Array
    widths: Array

    @classmethod
    def of(cls, free: Sequence[str], optics: Optics, *, shape: bool) -> "_Sought":
        index = np.array([NAMES.index(name) for name in free], dtype=np.intp)
        modes = optics.shape if shape else optics.shape[:0]
        widths = [lens_width(name, optics.lens) for name in free] + [MODE_WIDTH] * len(modes)
        return cls(optics, index, shape, np.concatenate([optics.lens.numbers[index], modes]), np.array(widths))

    def at(self, common: Array) -> Optics:
        """Return the optics at values (p,)."""
        numbers = self.optics.lens.numbers
        numbers[self.entries] = common[: len(self.entries)]
        return Optics(Lens(*numbers.tolist()), common[len(self.entries) :] if self.shape else self.optics.shape)

    def cost(self, common: Array) -> float:
        """Return the cost of the weak priors."""
        return float(np.sum(((common - self.start) / self.widths) ** 2))


class _Seen(NamedTuple):
    """Residuals (N, 2), and their derivatives by the board's twist (N, 2, 6) and by what is sought (N, 2, p)."""

    residual: Array
    by_pose: Array
    by_common: Array


def _see(stack: _Stack, optics: Optics, poses: Array, sought: _Sought) -> _Seen:
    marks, by_values = places_of(stack.marks, stack.modes, np.concatenate([[0.0], optics.shape]))
    T = poses[stack.photograph]
    R = T[:, :3, :3]
    projected = project(optics.lens, (R @ marks[:, :, None])[:, :, 0] + T[:, :3, 3])
    by_mark = projected.by_point @ R
    common = [by_lens(optics.lens, projected.flat)[:, :, sought.entries]]
    if sought.shape:
        common.append(by_mark @ by_values[:, :, 1:])
    by_pose = np.concatenate([by_mark, -by_mark @ rigid.skew(marks)], axis=2)
    return _Seen(stack.pixels - projected.pixels, -by_pose, -np.concatenate(common, axis=2))


def _weights(stack: _Stack, seen: _Seen) -> Array:
    """Return by how much rows (N, 2) count: 1 over their noise, as it shows, and less where marks lie off."""
    far = np.linalg.norm(seen.residual / stack.sigma, axis=1)
    # The median of a two-dimensional normal error is 1.18 sigma.
    spread = max(float(np.median(far)) / 1.18, 1e-9)
    return np.asarray(
        np.sqrt(np.minimum(1.0, _FAR * spread / np.maximum(far, 1e-12)))[:, None] / (spread * stack.sigma)
    )


def _cost(seen: _Seen, weights: Array) -> float:
    return float(np.sum((weights * seen.residual) ** 2))


def _step(
    stack: _Stack, seen: _Seen, weights: Array, sought: _Sought, common: Array, damping: float
) -> tuple[Array, Array]:
    """Return the damped step of what is sought (p,), and of the poses (m, 6), eliminated one by one."""
    p = len(common)
    rows = [np.column_stack([np.eye(p), (common - sought.start) / sought.widths])]
    w = weights[:, :, None]
    whole = np.concatenate(
        [w * seen.by_pose, w * seen.by_common * sought.widths, w * seen.residual[:, :, None]], axis=2
    )
    of_poses = np.zeros((int(stack.photograph[-1]) + 1, 6, p + 7))
    for alike in stack.alike:
        own = whole[alike.rows].reshape(len(alike.rows), -1, p + 7)
        held = np.zeros((len(own), 6, p + 7))
        held[:, range(6), range(6)] = np.sqrt(damping) * (np.linalg.norm(own[:, :, :6], axis=1) + _TINY)
        # The first six rows are all that has the pose in it.
        turned = linear.triangle(np.concatenate([own, held], axis=1))
        of_poses[alike.photographs] = turned[:, :6]
        rows.append(turned[:, 6:, 6:].reshape(-1, p + 1))
    J = linear.triangle(np.concatenate(rows))
    units = np.linalg.norm(J[:, :p], axis=0)
    damped = np.concatenate([J, np.column_stack([np.diag(np.sqrt(damping) * units), np.zeros(p)])])
    step = -np.linalg.lstsq(damped[:, :p], damped[:, p], rcond=None)[0] if p else np.zeros(0)
    along = of_poses[:, :, -1] + of_poses[:, :, 6:-1] @ step
    return sought.widths * step, np.asarray(-np.linalg.solve(of_poses[:, :, :6], along[:, :, None])[:, :, 0])


def found_optics(photographs: Sequence[Photograph], free: Sequence[str], lens: Lens) -> Bundle | None:
    """Return the best fit from photographs alone, with no guess of the lens but ``lens``; None where one tells no pose.

    Where the focal length is free, it begins where homographies have it.
    """
    modes = photographs[0].modes.shape[2] if photographs else 0
    optics = Optics(first_lens(photographs, lens) if set(FOCAL) <= set(free) else lens, np.zeros(modes))
    poses, told = poses_of(photographs, optics)
    if not len(photographs) or not told.all():
        return None
    # First what is simple: focal length and the middle of the distortion, of a flat board.
    found = fit(photographs, [name for name in free if name in (*FOCAL, "k1", "k2")], optics, poses, shape=False)
    return fit(photographs, free, found.optics, found.poses)


def folds_of(count: int, folds: int) -> IntArray:
    """Return the fold (count,) of every photograph: each one in turn, in order."""
    return (np.arange(count) % folds).astype(np.intp)


def held_out(photographs: Sequence[Photograph], free: Sequence[str], found: Bundle, folds: int = 4) -> Array:
    """Return the mean squares (m,) of the residuals of photographs, each predicted from those of other folds.

    The pose of a photograph held out is found from itself, and nothing else. In px^2, two-dimensional. ``found``: of
    all photographs, where the searches begin.
    """
    fold, squares = folds_of(len(photographs), folds), np.full(len(photographs), np.nan)
    for f in dict.fromkeys(fold.tolist()):
        kept, own = np.flatnonzero(fold != f).tolist(), np.flatnonzero(fold == f).tolist()
        if len(kept):
            others = fit([photographs[k] for k in kept], free, found.optics, found.poses[kept])
            alone = fit([photographs[k] for k in own], (), others.optics, found.poses[own], shape=False)
            squares[own] = [np.mean(np.sum(r * r, axis=1)) for r in alone.residuals]
    return squares


def clearly_better(simple: Array, rich: Array) -> bool:
    """Return whether a richer model predicts photographs (m,) better, by pairs of mean squares.

    By more than chance has it: by ratios, for one photograph unlike the others may have most of all squares. And by
    more than nothing to speak of: of thousands of marks, all is significant.
    """
    both = np.isfinite(simple) & np.isfinite(rich)
    if np.count_nonzero(both) < 2:
        return False
    simple, rich = simple[both], rich[both]
    if float(rich.mean()) >= (1.0 - _WORTH_IT) * float(simple.mean()):
        return False
    gain = np.log(np.maximum(simple, _NO_NOISE) / np.maximum(rich, _NO_NOISE))
    return float(gain.mean()) > _CLEARLY * float(gain.std(ddof=1) / np.sqrt(len(gain)))
