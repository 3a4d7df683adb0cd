"""Joint axes from single-axis sweeps: circle point analysis, circles and lines of touched points.

One joint moves, all others rest, and marks that it carries are touched: about a revolute joint every mark runs on a
circle, and all circles have one axis; along a prismatic joint every mark runs on a line, and all lines are parallel.
The fits are orthogonal least squares: a circle's residuals are radial (out of round) and axial (out of plane), a line's
are across. The joint's readings are asked for its sense alone, so that what they say beside is a check.

Source: circle point analysis, B. Mooring, Z. Roth, M. Driels, *Fundamentals of Manipulator Calibration*, 1991, ch. 4.
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.brief import brief
from calib.foundations.chance import shown_noise
from calib.foundations.errors import IdentificationError, MeasurementError
from calib.foundations.linear import svd
from calib.foundations.ranges import finite, refuse_beyond, refuse_sigma
from calib.foundations.sealing import sealed
from calib.measurement.measurements import Measurements

_MOST_STEPS = 100
_NEGLIGIBLE_STEP = 1e-12
# Of the largest singular value: what the points do not determine at all.
_RANK = 1e-10
# Readings of a joint at rest scatter by less: 0.01 mrad, 0.01 mm.
_AT_REST = 1e-5

_NO_READINGS = "the readings of an axis must be finite numbers, in rad or m."


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class RevoluteAxis:
    """Axis of a revolute joint from circles. Made by :func:`circle_axis`.

    ``direction`` (3,): unit vector, right-handed with the joint's positive sense. ``point`` (3,): the axis' point
    nearest to the mean of the points. ``radii`` and ``heights`` (m,): of every mark's circle, the latter along the axis
    from ``point``. ``radial`` and ``axial`` (N,): residuals of the points. ``turning`` (N,): how far each point lies
    along its circle from where the reading says, None without readings. All lengths in m.
    ``covariance`` (4 + 2 m, 4 + 2 m): of two tilts (rad) about, then two shifts (m) along, the columns of ``across``
    (3, 2), then of radii and heights. ``noise``: the standard deviation of a coordinate on which it rests, given or
    estimated.
    """

    __repr__ = brief

    direction: Array
    point: Array
    radii: Array
    heights: Array
    radial: Array
    axial: Array
    turning: Array | None
    across: Array
    covariance: Array
    noise: float

    kind: Literal["revolute"] = "revolute"

    @property
    def sigma_direction(self) -> float:
        """Expected angle in rad (rms) between the direction and the true one."""
        return float(np.sqrt(np.trace(self.covariance[:2, :2])))

    @property
    def sigma_point(self) -> float:
        """Expected distance in m (rms), at ``point``, between the axis and the true one."""
        return float(np.sqrt(np.trace(self.covariance[2:4, 2:4])))

    @property
    def sigma_radii(self) -> Array:
        """Standard deviations (m,) of the radii, in m."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[4 : 4 + len(self.radii)]))

    @checked
    def motion(self, angle: npt.ArrayLike) -> Array:
        """Return what turning by ``angle`` (...) rad does to points: placements (..., 4, 4)."""
        R = rigid.rotation_about(self.direction, finite(angle, None, _NO_READINGS))
        return rigid.placement(R, self.point - R @ self.point)


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class PrismaticAxis:
    """Axis of a prismatic joint from lines. Made by :func:`line_axis`.

    ``direction`` (3,): unit vector in the joint's positive sense; ``point`` (3,): the mean of the points.
    ``straightness`` (N, 2): residuals across, along the columns of ``across`` (3, 2). ``travelling`` (N,): how far each
    point lies along its line from where the reading says, None without readings. All in m. ``covariance`` (2, 2): of
    two tilts of the direction (rad), towards the columns of ``across``. ``noise``: as in :class:`RevoluteAxis`.
    """

    __repr__ = brief

    direction: Array
    point: Array
    straightness: Array
    travelling: Array | None
    across: Array
    covariance: Array
    noise: float

    kind: Literal["prismatic"] = "prismatic"

    @property
    def sigma_direction(self) -> float:
        """Expected angle in rad (rms) between the direction and the true one."""
        return float(np.sqrt(np.trace(self.covariance)))

    @checked
    def motion(self, travel: npt.ArrayLike) -> Array:
        """Return what travelling by ``travel`` (...) m does to points: placements (..., 4, 4)."""
        return rigid.translation(finite(travel, None, _NO_READINGS)[..., None] * self.direction)


Axis = RevoluteAxis | PrismaticAxis


@checked
def circle_axis(
    points: npt.ArrayLike,
    angles: npt.ArrayLike | None = None,
    marks: Sequence[object] | None = None,
    sigma: float | None = None,
) -> RevoluteAxis:
    """Fit the common axis of circles through ``points`` (N, 3), in m, of one or several ``marks`` (N labels).

    ``angles`` (N,): readings of the joint in rad; without them the axis points so that each mark's points, in the order
    given, run the positive way. ``sigma``: standard deviation of a coordinate in m; None estimates it from the
    residuals, and is nan where no point is to spare.

    Raises IdentificationError when the points do not determine an axis, such as points on a line; MeasurementError for
    points, marks or readings that are not as many, or not finite; JobError for a sigma out of range.
    """
    x, mark, q = _checked(points, marks, angles, sigma)
    n = int(mark.max()) + 1
    if 2 * len(x) < 4 + 2 * n:
        raise IdentificationError(f"{len(x)} points on {n} circles do not determine an axis; it takes 3 on one circle.")
    centre = _means(x, mark)
    R, c = _first_circles(x, mark, centre)
    for _ in range(_MOST_STEPS):
        r, J = circle_residuals(x, mark, R, c)
        step = np.linalg.lstsq(J, -r, rcond=None)[0]
        R, c = R @ rigid.exp3(np.array([step[0], step[1], 0.0])), c + R[:, :2] @ step[2:4]
        if np.max(np.abs(step[:4])) < _NEGLIGIBLE_STEP * (1.0 + np.abs(x).max()):
            break
    if _sense(_turns(x, mark, R, c), q, mark, turning=True) < 0.0:
        R = R * np.array([1.0, -1.0, -1.0])
    c = c + R[:, 2] * float((x.mean(axis=0) - c) @ R[:, 2])
    r, J = circle_residuals(x, mark, R, c)
    radial, axial = r[: len(x)], r[len(x) :]
    y = (x - c) @ R
    rho = np.hypot(y[:, 0], y[:, 1])
    noise = shown_noise(r, J.shape[0] - J.shape[1], sigma)
    turning = None
    if q is not None:
        turning = rho * _beside(_turns(x, mark, R, c) - q, mark)
    return RevoluteAxis(
        read_only(R[:, 2]),
        read_only(c),
        read_only(_means(rho[:, None], mark)[:, 0]),
        read_only(_means(y[:, 2:], mark)[:, 0]),
        read_only(radial),
        read_only(axial),
        None if turning is None else read_only(turning),
        read_only(R[:, :2]),
        read_only(noise**2 * _inverse(J)),
        noise,
    )


@checked
def line_axis(
    points: npt.ArrayLike,
    travels: npt.ArrayLike | None = None,
    marks: Sequence[object] | None = None,
    sigma: float | None = None,
) -> PrismaticAxis:
    """Fit the common direction of lines through ``points`` (N, 3), in m, of one or several ``marks`` (N labels).

    ``travels`` (N,): readings of the joint in m; without them the axis points so that each mark's points, in the order
    given, run the positive way. ``sigma``: as in :func:`circle_axis`.

    Raises IdentificationError when the points do not determine a direction; else as :func:`circle_axis`.
    """
    x, mark, q = _checked(points, marks, travels, sigma)
    d = x - _means(x, mark)[mark]
    if len(x) <= mark.max() + 1:
        raise IdentificationError(f"{len(x)} points on {int(mark.max()) + 1} lines do not determine a direction.")
    _, values, Vt = svd(d, full_matrices=False)
    if not values[0] > _RANK * (1.0 + np.abs(x).max()):
        raise IdentificationError("the points of a line are all in one place, and determine no direction.")
    R = _frame(Vt[0])
    if _sense(d @ R[:, 2], q, mark, turning=False) < 0.0:
        R = R * np.array([1.0, -1.0, -1.0])
    y = d @ R
    noise = shown_noise(y[:, :2], 2 * (len(x) - int(mark.max()) - 1) - 2, sigma)
    return PrismaticAxis(
        read_only(R[:, 2]),
        read_only(x.mean(axis=0)),
        read_only(y[:, :2]),
        None if q is None else read_only(_beside(y[:, 2] - q, mark)),
        read_only(R[:, :2]),
        read_only(np.eye(2) * noise**2 / float(np.sum(y[:, 2] ** 2))),
        noise,
    )


@checked
def expected_circle_error(radius: float, angles: npt.ArrayLike, sigma: float) -> float:
    """Return the expected error (rms, rad) of a circle's axis direction, to first order.

    From points at ``angles`` (N,) rad on a circle of ``radius`` m, touched with ``sigma`` m per coordinate: the normal
    of the plane through them. Infinite where they do not determine one, as on one of radius 0. Raises JobError for a
    radius or a sigma out of range.
    """
    a = _row(angles)
    refuse_sigma(sigma, "sigma")
    refuse_beyond(radius, "relations.distance", "radius")
    X = np.stack([np.ones_like(a), radius * np.cos(a), radius * np.sin(a)], axis=-1)
    values = np.linalg.svd(X / np.array([1.0, max(radius, 1e-12), max(radius, 1e-12)]), compute_uv=False)
    if len(a) < 3 or not values[2] > _RANK * values[0] or radius <= 0.0:
        return float("inf")
    return float(sigma * np.sqrt(np.trace(np.linalg.inv(X.T @ X)[1:, 1:])))


@checked
def expected_line_error(travels: npt.ArrayLike, sigma: float) -> float:
    """Return the expected error (rms, rad) of a line's direction from points at ``travels`` (N,) m, to first order."""
    s = _row(travels)
    refuse_sigma(sigma, "sigma")
    spread = float(np.sum((s - s.mean()) ** 2))
    return float(sigma * np.sqrt(2.0 / spread)) if spread > 0.0 else float("inf")


@checked
def circle_point_analysis(
    data: Measurements, kinds: Sequence[Literal["revolute", "prismatic"]], sigma: float | None = None
) -> tuple[Axis, ...]:
    """Return the axis of every joint of a serial machine, where it is while all joints read zero.

    ``kinds``: of the joints, outermost (carried by nothing) first, in the order of the readings of ``data``. Sweeps are
    found in the rows: those of one mark in which one joint alone moves. A joint's circles may be run at several places
    of the others; the axes found before bring its points back to where the joints before it read zero. Axes are in the
    instrument's frame. ``sigma``: as in :func:`circle_axis`, where the data say nothing of it.

    Raises IdentificationError for a joint that is not swept alone, MeasurementError when ``kinds`` do not fit.
    """
    if len(kinds) != len(data.reading_names):
        raise MeasurementError(f"{data.where}: has {len(data.reading_names)} joints, and {len(kinds)} kinds are given.")
    touched = data.position
    if touched is None:
        raise MeasurementError(f"{data.where}: a {data.kind} has no points, of which sweeps are made.")
    if sigma is None and np.all(data.sigma[:, :3] > 0.0):
        sigma = float(np.sqrt(np.mean(data.sigma[:, :3] ** 2)))
    found: list[Axis] = []
    for j, kind in enumerate(kinds):
        sweeps = list(_sweeps(data, j, 3 if kind == "revolute" else 2))
        if not sweeps:
            raise IdentificationError(
                f"{data.where}: joint {data.reading_names[j]!r} is not swept alone: it takes rows of one mark in which "
                "no other joint moves."
            )
        rows = np.concatenate(sweeps)
        back = np.broadcast_to(np.eye(4), (len(rows), 4, 4))
        for k, axis in reversed(list(enumerate(found))):
            back = back @ axis.motion(-data.readings[rows, k])
        x = (back[:, :3, :3] @ touched[rows, :, None])[..., 0] + back[:, :3, 3]
        fit: Callable[..., Axis] = circle_axis if kind == "revolute" else line_axis
        found.append(fit(x, data.readings[rows, j], np.repeat(np.arange(len(sweeps)), list(map(len, sweeps))), sigma))
    return tuple(found)


def _sweeps(data: Measurements, j: int, least: int) -> Iterator[IntArray]:
    """Yield the rows in which joint j alone moves: at least so many places of it, one mark, the others at rest."""
    others = np.delete(np.round(data.readings / _AT_REST), j, axis=1)
    _, group = np.unique(np.column_stack([others, data.tool]), axis=0, return_inverse=True)
    for g in range(int(group.max()) + 1):
        rows = np.flatnonzero(group == g)
        if len(np.unique(np.round(data.readings[rows, j] / _AT_REST))) >= least:
            yield rows


# ---- the circle's own least squares


def circle_residuals(x: Array, mark: IntArray, R: Array, c: Array) -> tuple[Array, Array]:
    """Return residuals (2 N,), radial then axial, of circles about the z axis of R at c, and their Jacobian.

    Radius and height of every mark are its points' means, their best values for a given axis. The columns are two tilts
    ``R exp((w1, w2, 0))``, two shifts of c along the first two columns of R, then radii and heights.
    """
    y = (x - c) @ R
    rho = np.hypot(y[:, 0], y[:, 1])
    n, m = len(x), int(mark.max()) + 1
    unit = y[:, :2] / np.maximum(rho, np.finfo(float).tiny)[:, None]
    of_mark = (mark[:, None] == np.arange(m)).astype(np.float64)
    J = np.zeros((2 * n, 4 + 2 * m))
    # y changes by y x (w1, w2, 0), and by minus the shift.
    J[:n, 0], J[:n, 1] = unit[:, 1] * y[:, 2], -unit[:, 0] * y[:, 2]
    J[n:, 0], J[n:, 1] = -y[:, 1], y[:, 0]
    J[:n, 2:4] = -unit
    J[:n, 4 : 4 + m] = J[n:, 4 + m :] = -of_mark
    values = np.stack([rho, y[:, 2]], axis=-1)
    return (values - _means(values, mark)[mark]).T.ravel(), J


def _first_circles(x: Array, mark: IntArray, centre: Array) -> tuple[Array, Array]:
    """Return an axis to begin from: the plane all circles are parallel to, and in it their common algebraic centre."""
    d = x - centre[mark]
    _, values, Vt = svd(d, full_matrices=False)
    # For points on a line the second value is rounding, of coordinates as large as those of x.
    if not values[1] > _RANK * (values[0] + np.abs(x).max()):
        raise IdentificationError("the points of a circle lie on a line or in one place, and determine no axis.")
    R = _frame(Vt[2])
    # |p - c|^2 is the same for all points of a mark, so |p|^2 = 2 p . c + a constant of the mark: linear.
    p = (x - centre[0]) @ R[:, :2]
    A = np.column_stack([2.0 * p, mark[:, None] == np.arange(len(centre))])
    solution = np.linalg.lstsq(A, np.sum(p**2, axis=1), rcond=None)[0]
    return R, centre[0] + R[:, :2] @ solution[:2]


def _frame(z: Array) -> Array:
    """Return a rotation (3, 3) with the third column along z (3,)."""
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _turns(x: Array, mark: IntArray, R: Array, c: Array) -> Array:
    """Return how far (N,) every point has turned from its mark's first one, between -pi and pi."""
    y = (x - c) @ R
    angle = np.arctan2(y[:, 1], y[:, 0])
    first = np.array([angle[np.argmax(mark == k)] for k in range(int(mark.max()) + 1)])
    return np.asarray(_wrapped(angle - first[mark]))


def _sense(run: Array, q: Array | None, mark: IntArray, *, turning: bool) -> float:
    """Return a number that is negative when the points run against the readings, or else against their order."""
    rows = [np.flatnonzero(mark == k) for k in range(int(mark.max()) + 1)]
    if q is None:
        steps = np.concatenate([np.diff(run[own]) for own in rows])
        return float(np.sum(np.sin(steps) if turning else steps))
    if not turning:
        return float(sum(run[own] @ (q[own] - q[own].mean()) for own in rows))
    # The better the turns follow the readings, the longer the mean of exp(i (turn - reading)).
    along, against = (
        sum(abs(np.exp(1j * (s * run[own] - q[own])).mean()) * len(own) for own in rows) for s in (1.0, -1.0)
    )
    return float(along - against)


def _beside(difference: Array, mark: IntArray) -> Array:
    """Return differences (N,) less their mark's own mean; angles may be whole turns apart."""
    wrapped = difference.copy()
    for k in range(int(mark.max()) + 1):
        own = mark == k
        wrapped[own] = _wrapped(difference[own] - difference[own][0])
    return np.asarray(wrapped - _means(wrapped[:, None], mark)[mark, 0])


def _wrapped(angle: Array) -> Array:
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))


def _means(values: Array, mark: IntArray) -> Array:
    """Return the mean (m, d) of values (N, d) over every mark."""
    return np.stack([values[mark == k].mean(axis=0) for k in range(int(mark.max()) + 1)])


def _inverse(J: Array) -> Array:
    """Return (J^T J)^-1, or raise IdentificationError where the points leave something open."""
    scale = np.linalg.norm(J, axis=0)
    values = np.linalg.svd(J / scale, compute_uv=False) if np.all(scale > 0.0) else np.zeros(1)
    if not values[-1] > _RANK * max(values[0], 1.0):
        raise IdentificationError("the points of the circles do not determine their axis.")
    return np.asarray(np.linalg.inv((J / scale).T @ (J / scale)) / np.outer(scale, scale))


def _checked(
    points: npt.ArrayLike, marks: Sequence[object] | None, readings: npt.ArrayLike | None, sigma: float | None
) -> tuple[Array, IntArray, Array | None]:
    """Return points (N, 3), the number (N,) of each one's mark, and readings (N,), where there are any."""
    x = finite(points, (None, 3), "the points of a sweep must be finite numbers (N, 3), in m.")
    names = [None] * len(x) if marks is None else list(marks)
    if len(names) != len(x):
        raise MeasurementError(f"there are {len(x)} points and {len(names)} marks.")
    if not all(isinstance(name, Hashable) for name in names):
        raise MeasurementError("the marks of a sweep must be names or numbers, one for every point.")
    number = {name: k for k, name in enumerate(dict.fromkeys(names))}
    refuse_sigma(sigma, "sigma")
    each = f"the readings of a sweep must be {len(x)} finite numbers, one for every point."
    q = None if readings is None else finite(readings, (len(x),), each)
    return x, np.array([number[name] for name in names], dtype=np.intp), q


def _row(values: npt.ArrayLike) -> Array:
    return finite(values, (None,), "the readings of a sweep must be finite numbers (N,), one or more.")
