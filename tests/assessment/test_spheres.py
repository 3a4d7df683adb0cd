"""Spheres against constructions of their own: known spheres, brute force, and what may not change them."""

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from calib.assessment.spheres import least_squares_sphere, smallest_enclosing_sphere
from calib.foundations.errors import MeasurementError

Array = NDArray[np.float64]

CENTRE, RADIUS = np.array([0.42, -0.61, 0.23]), 0.0155


def on_sphere(rng: np.random.Generator, count: int, least_cosine: float = -1.0) -> Array:
    """Points on the known sphere, on the cap about +z where the cosine of the polar angle is large enough."""
    cosine, azimuth = rng.uniform(least_cosine, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    sine = np.sqrt(1.0 - cosine**2)
    return CENTRE + RADIUS * np.column_stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine])


@pytest.mark.parametrize("least_cosine", [-1.0, 0.0, 0.5, 0.8])
@pytest.mark.parametrize("count", [4, 5, 25, 400])
def test_known_sphere_and_caps_of_it(count: int, least_cosine: float) -> None:
    points = on_sphere(np.random.default_rng(count), count, least_cosine)
    sphere = least_squares_sphere(points)
    assert np.abs(sphere.centre - CENTRE).max() < 1e-12
    assert abs(sphere.radius - RADIUS) < 1e-12
    assert np.abs(sphere.distances(points)).max() < 1e-13


@pytest.mark.parametrize("least_cosine", [-1.0, 0.0, 0.7])
def test_least_squares_is_least(least_cosine: float) -> None:
    rng = np.random.default_rng(7)
    points = on_sphere(rng, 25, least_cosine) + 0.3e-3 * rng.standard_normal((25, 3))
    sphere = least_squares_sphere(points)

    def cost(p: Array) -> float:
        return float(np.sum((np.linalg.norm(points - CENTRE - 1e-2 * p[:3], axis=1) - 1e-2 * p[3]) ** 2) * 1e6)

    found = minimize(
        cost, np.array([0.0, 0.0, 0.0, 1.5]), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13}
    )
    mine = np.append(sphere.centre - CENTRE, sphere.radius) * 1e2
    assert cost(mine) <= found.fun * (1.0 + 1e-9)
    assert np.abs(mine - found.x).max() < 1e-5
    # Stationary: neither a shift nor a growth helps.
    r = sphere.distances(points)
    u = (points - sphere.centre) / np.linalg.norm(points - sphere.centre, axis=1)[:, None]
    assert np.abs(np.append(u.T @ r, r.sum())).max() < 1e-13


def test_neither_place_nor_order_nor_scale_matter() -> None:
    rng = np.random.default_rng(3)
    points = on_sphere(rng, 25, 0.2) + 2e-5 * rng.standard_normal((25, 3))
    R, t = Rotation.from_rotvec([0.3, -2.0, 1.1]).as_matrix(), np.array([3.0, -1.0, 0.5])
    for fit in (least_squares_sphere, smallest_enclosing_sphere):
        sphere = fit(points)
        moved = fit(points @ R.T + t)
        assert np.abs(moved.centre - (R @ sphere.centre + t)).max() < 1e-13
        assert abs(moved.radius - sphere.radius) < 1e-13
        shuffled = fit(rng.permutation(points))
        assert np.abs(shuffled.centre - sphere.centre).max() < 1e-13
        scaled = fit(1000.0 * points)
        assert abs(scaled.radius - 1000.0 * sphere.radius) < 1e-10


def test_four_points_are_met_exactly() -> None:
    points = np.random.default_rng(5).uniform(-0.1, 0.1, (4, 3))
    assert np.abs(least_squares_sphere(points).distances(points)).max() < 1e-13


@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        (np.eye(3), "four points"),
        (np.zeros((6, 3)), "coincide"),
        (np.array([[np.cos(a), np.sin(a), 0.3] for a in range(9)]), "one plane"),
        (np.outer(np.arange(5.0), [1.0, 2.0, 3.0]), "one plane"),
    ],
    ids=["three", "coincident", "circle", "line"],
)
def test_points_on_no_one_sphere(points: Array, sentence: str) -> None:
    with pytest.raises(MeasurementError, match=sentence):
        least_squares_sphere(points)


def brute_force(points: Array) -> tuple[Array, float]:
    """The smallest of all circumscribed spheres of two, three and four points that holds the rest."""
    best = (points[0], np.inf)
    for size in (1, 2, 3, 4):
        for chosen in itertools.combinations(points, size):
            p = np.array(chosen)
            # Barycentric: centre = sum w_i p_i, sum w = 1, equal distances, by Lagrange.
            G = 2.0 * p @ p.T
            system = np.block([[G, np.ones((size, 1))], [np.ones((1, size)), np.zeros((1, 1))]])
            if np.linalg.matrix_rank(system, tol=1e-10) < size + 1:
                continue
            w = np.linalg.solve(system, np.append(np.sum(p**2, axis=1), 1.0))[:size]
            centre = w @ p
            radius = float(np.linalg.norm(p[0] - centre))
            if radius < best[1] and np.linalg.norm(points - centre, axis=1).max() <= radius + 1e-11:
                best = (centre, radius)
    return best


@pytest.mark.parametrize("seed", range(60))
def test_smallest_enclosing_sphere_is_the_brute_force_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (rng.integers(2, 9), 3)) * [1.0, 1.0, (0.0, 1.0, 0.05)[seed % 3]]
    centre, radius = brute_force(points)
    sphere = smallest_enclosing_sphere(points)
    assert sphere.radius == pytest.approx(radius, abs=1e-10)
    assert np.abs(sphere.centre - centre).max() < 1e-8
    assert sphere.distances(points).max() < 1e-11


@pytest.mark.parametrize(
    ("points", "radius"),
    [
        ([[1.0, 2.0, 3.0]], 0.0),
        ([[1.0, 2.0, 3.0]] * 4, 0.0),
        ([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 0.0, 0.0]], 1.0),
        ([[0.0, 0.0, 0.0], [6.0, 0.0, 0.0], [0.0, 8.0, 0.0]], 5.0),
        (list(itertools.product((-1.0, 1.0), repeat=3)), np.sqrt(3.0)),
        ([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]], np.sqrt(3.0)),
    ],
    ids=["point", "same point", "line", "right triangle", "cube", "tetrahedron"],
)
def test_smallest_enclosing_sphere_of_known_bodies(points: list[list[float]], radius: float) -> None:
    sphere = smallest_enclosing_sphere(np.array(points))
    assert sphere.radius == pytest.approx(radius, abs=1e-14)
    assert sphere.distances(np.array(points)).max() < 1e-12


def test_many_points() -> None:
    points = on_sphere(np.random.default_rng(1), 500)
    sphere = smallest_enclosing_sphere(points)
    assert sphere.radius == pytest.approx(RADIUS, abs=1e-12)
