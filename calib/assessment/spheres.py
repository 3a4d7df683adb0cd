"""Spheres through points: the least-squares one, and the smallest one that holds them all."""

from dataclasses import dataclass

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import MeasurementError
from calib.foundations.sealing import sealed

_MOST_STEPS = 100
_MOST_HALVINGS = 30
# A sum of squares is flat at its minimum: what rounding may add to it there is no reason to refuse a step.
_ROUNDING = 1e-12
# In units of the points' own spread: what rounding leaves of a step, and points that are a plane or a line.
_STEP_TOLERANCE = 1e-14
_FLAT = 1e-9
# A point counts as inside up to rounding, in units of the spread.
_INSIDE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Sphere:
    """A sphere: ``centre`` (3,) and ``radius``, in m."""

    centre: Array
    radius: float

    def distances(self, points: Array) -> Array:
        """Return the distances (N,) in m of points (N, 3) from the surface, positive outside."""
        return np.asarray(np.linalg.norm(points - self.centre, axis=1) - self.radius)


def least_squares_sphere(points: Array) -> Sphere:
    """Return the Gaussian associated sphere of points (N, 3) in m: the least sum of squared distances to its surface.

    Gauss-Newton on r_n = |x_n - c| - R with dr_n = -u_n . dc - dR, u_n the unit vector from the centre to x_n, with
    steps halved where they do not help; started from the algebraic sphere |x|^2 = 2 c . x + (R^2 - |c|^2), which is
    linear. Both are taken about the mean point in units of the spread, so that the place of the world costs no digits.
    After Forbes, "Least-squares best-fit geometric elements" (NPL report DITC 140/89), and ISO 10360-6.

    Raises MeasurementError for fewer than four points and for points in a plane, which are on no one sphere.
    """
    if len(points) < 4:
        raise MeasurementError(f"a sphere needs four points or more, and there are {len(points)}.")
    mean = points.mean(axis=0)
    spread = float(np.sqrt(np.mean((points - mean) ** 2)))
    if spread == 0.0:
        raise MeasurementError("all points of the sphere coincide.")
    x = (points - mean) / spread
    if np.linalg.svd(x, compute_uv=False)[-1] < _FLAT * np.sqrt(len(x)):
        raise MeasurementError("all points of the sphere lie in one plane; touch it all around.")
    *half, k = np.linalg.lstsq(np.column_stack([2.0 * x, np.ones(len(x))]), np.sum(x**2, axis=1))[0]
    c = np.array(half)
    sphere = Sphere(c, float(np.sqrt(k + c @ c)))
    for _ in range(_MOST_STEPS):
        better, length = _step(sphere, x)
        if length < _STEP_TOLERANCE * (1.0 + sphere.radius):
            break
        sphere = better
    return Sphere(read_only(mean + spread * sphere.centre), spread * sphere.radius)


def _step(sphere: Sphere, x: Array) -> tuple[Sphere, float]:
    """Return the sphere after one step, and the step's length."""
    r = sphere.distances(x)
    directions = (x - sphere.centre) / (r + sphere.radius)[:, None]
    step = np.linalg.lstsq(np.column_stack([directions, np.ones(len(x))]), r)[0]
    for _ in range(_MOST_HALVINGS):
        trial = Sphere(sphere.centre + step[:3], float(sphere.radius + step[3]))
        if np.sum(trial.distances(x) ** 2) <= np.sum(r**2) * (1.0 + _ROUNDING):
            return trial, float(np.linalg.norm(step))
        step = 0.5 * step
    return sphere, 0.0


def smallest_enclosing_sphere(points: Array) -> Sphere:
    """Return the minimum circumscribed sphere of points (N, 3) in m, N >= 1: unique, and exact up to rounding.

    Welzl, "Smallest enclosing disks (balls and ellipsoids)" (1991), in the order of the rows: a point outside the
    sphere of those before it lies on the surface of theirs together. At most four points do, so nothing iterates.
    """
    middle = points.mean(axis=0)
    x = points - middle
    tolerance = _INSIDE * float(np.abs(x).max(initial=0.0))
    sphere = _welzl(x, np.zeros((0, 3)), tolerance)
    return Sphere(read_only(middle + sphere.centre), sphere.radius)


def _welzl(points: Array, surface: Array, tolerance: float) -> Sphere:
    """Return the smallest sphere that holds ``points`` and has ``surface`` (up to four of them) on its surface."""
    sphere = _through(surface)
    if len(surface) == 4:
        return sphere
    for n, point in enumerate(points):
        if np.linalg.norm(point - sphere.centre) > sphere.radius + tolerance:
            sphere = _welzl(points[:n], np.vstack([surface, point]), tolerance)
    return sphere


def _through(surface: Array) -> Sphere:
    """Return the smallest sphere through up to four points: its centre is in their point, line, plane or space."""
    if len(surface) == 0:
        return Sphere(np.zeros(3), -1.0)
    # |c - x_n| = |c - x_0| is linear in c; the shortest solution is the one in the span.
    edges = surface[1:] - surface[0]
    to_centre = np.linalg.lstsq(2.0 * edges, np.sum(edges**2, axis=1))[0] if len(edges) else np.zeros(3)
    return Sphere(surface[0] + to_centre, float(np.linalg.norm(to_centre)))
