"""Circle point analysis against points that scipy's rotations made, and against another parametrisation."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import calib
from calib.foundations import rigid
from calib.positioner import axes
from calib.positioner.axes import circle_axis, circle_point_analysis, expected_circle_error, line_axis
from tests.support import positioners
from tests.support.machines import load
from tests.support.positioners import Array, Machine, place, turn


def circle(rng: np.random.Generator, angles: Array, radius: float = 0.3) -> tuple[Array, Array, Array]:
    """Points (N, 3) of a circle somewhere, its axis and its centre."""
    z = rng.normal(size=3)
    z /= np.linalg.norm(z)
    start = np.cross(z, rng.normal(size=3))
    start *= radius / np.linalg.norm(start)
    centre = rng.uniform(-2.0, 2.0, 3)
    return centre + Rotation.from_rotvec(np.outer(angles, z)).apply(start), z, centre


def from_axis(point: Array, axis: Array, foot: Array) -> float:
    return float(np.linalg.norm(np.cross(point - foot, axis)))


@pytest.mark.parametrize("seed", range(20))
def test_golden_circles(seed: int) -> None:
    """Two marks, a short arc or a long one, no noise: axis, radii and heights to 1e-9 mm."""
    rng = np.random.default_rng(seed)
    q = np.sort(rng.uniform(-1.0, 1.0, 8)) * rng.uniform(0.6, 3.0)
    first, z, centre = circle(rng, q)
    second = centre + 0.2 * z + Rotation.from_rotvec(np.outer(q, z)).apply(1.7 * (first[0] - centre))
    found = circle_axis(np.concatenate([first, second]), np.tile(q, 2), ["a"] * 8 + ["b"] * 8)
    assert np.abs(found.direction - z).max() < 1e-12
    assert from_axis(found.point, z, centre) < 1e-12
    assert found.radii == pytest.approx([0.3, 0.51], abs=1e-12)
    assert found.heights[1] - found.heights[0] == pytest.approx(0.2, abs=1e-12)
    assert max(np.abs(found.radial).max(), np.abs(found.axial).max()) < 1e-12
    assert found.turning is not None
    assert np.abs(found.turning).max() < 1e-12
    # What the axis does to the first point is to bring it to the others.
    moved = found.motion(q - q[0]) @ np.append(first[0], 1.0)
    assert np.abs(moved[:, :3] - first).max() < 1e-12


def test_sense_follows_readings_or_order() -> None:
    rng = np.random.default_rng(1)
    q = np.radians([0.0, 60.0, 120.0, 180.0, -120.0, -60.0])
    x, z, _ = circle(rng, q)
    assert circle_axis(x, q).direction @ z > 0.999
    assert circle_axis(x, -q).direction @ z < -0.999
    assert circle_axis(x).direction @ z > 0.999
    assert circle_axis(x[::-1]).direction @ z < -0.999


def test_circle_is_the_least_squares_one() -> None:
    """The same cost as scipy finds for a circle through its own parameters, and the covariance of its Jacobian."""
    rng = np.random.default_rng(2)
    q = np.radians(np.arange(-70.0, 71.0, 10.0))
    x, _, _ = circle(rng, q)
    x = x + rng.normal(scale=1e-3, size=x.shape)
    found = circle_axis(x, q)

    def residual(p: Array) -> Array:
        n = p[3:6] / np.linalg.norm(p[3:6])
        d = x - p[:3]
        axial = d @ n
        return np.concatenate([np.linalg.norm(d - np.outer(axial, n), axis=1) - p[6], axial])

    p0 = np.concatenate([found.point + 0.01, found.direction + 0.01, [0.25]])
    reference = least_squares(residual, p0, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert found.radial @ found.radial + found.axial @ found.axial == pytest.approx(2.0 * reference.cost, rel=1e-9)
    n = reference.x[3:6] / np.linalg.norm(reference.x[3:6])
    assert np.abs(np.cross(found.direction, n)).max() < 1e-7
    assert found.noise == pytest.approx(np.sqrt(2.0 * reference.cost / (2 * len(x) - 6)), rel=1e-6)


def test_derivative_of_the_residuals() -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        x = rng.normal(size=(12, 3))
        mark = np.arange(12) % 2
        R, c = rigid.exp3(rng.normal(size=3)), rng.normal(size=3)
        _, J = axes.circle_residuals(x, mark, R, c)
        # The residuals hold radius and height at their best, so their derivative is what those columns leave.
        own = J[:, 4:]
        J = J[:, :4] - own @ np.linalg.lstsq(own, J[:, :4], rcond=None)[0]
        for k in range(4):
            d = np.zeros(4)
            d[k] = h = 1e-6
            sides = [
                axes.circle_residuals(
                    x, mark, R @ rigid.exp3(s * np.array([d[0], d[1], 0.0])), c + s * R[:, :2] @ d[2:]
                )[0]
                for s in (1.0, -1.0)
            ]
            np.testing.assert_allclose((sides[0] - sides[1]) / (2 * h), J[:, k], atol=1e-8)


def test_sigmas_hold() -> None:
    """95 % intervals of radii, and the expected errors of direction and point, over many noisy arcs."""
    rng = np.random.default_rng(4)
    q, sigma = np.radians(np.arange(-60.0, 61.0, 20.0)), 1e-4
    inside, direction, point, expected = [], [], [], []
    for _ in range(800):
        x, z, centre = circle(rng, q)
        found = circle_axis(x + rng.normal(scale=sigma, size=x.shape), q, sigma=sigma)
        inside.append(abs(found.radii[0] - 0.3) < 1.96 * found.sigma_radii[0])
        direction.append(np.linalg.norm(np.cross(found.direction, z)))
        # In the plane through the found point: the axis, as seen there.
        point.append(np.linalg.norm(found.point - centre - z * (z @ (found.point - centre))))
        expected.append((found.sigma_direction, found.sigma_point))
    assert 0.93 < np.mean(inside) < 0.97
    rms = np.sqrt(np.mean(np.square([direction, point]), axis=1))
    assert rms == pytest.approx(np.mean(expected, axis=0), rel=0.06)
    assert rms[0] == pytest.approx(expected_circle_error(0.3, q, sigma), rel=0.06)


def test_line() -> None:
    rng = np.random.default_rng(5)
    z = turn(rng.normal(size=3))[:, 2]
    s = np.linspace(-0.4, 0.9, 7)
    starts = rng.uniform(-1.0, 1.0, (2, 3))
    x = (starts[:, None] + s[:, None] * z).reshape(-1, 3)
    exact = line_axis(x, np.tile(s, 2), ["a"] * 7 + ["b"] * 7)
    assert np.abs(exact.direction - z).max() < 1e-14
    assert np.abs(exact.straightness).max() < 1e-14
    assert exact.travelling is not None
    assert np.abs(exact.travelling).max() < 1e-14
    assert line_axis(x, -np.tile(s, 2), ["a"] * 7 + ["b"] * 7).direction @ z < -0.999
    off = [
        line_axis(x + rng.normal(scale=1e-3, size=x.shape), np.tile(s, 2), ["a"] * 7 + ["b"] * 7) for _ in range(400)
    ]
    rms = np.sqrt(np.mean([np.sum(np.cross(found.direction, z) ** 2) for found in off]))
    assert rms == pytest.approx(np.mean([found.sigma_direction for found in off]), rel=0.1)
    one = line_axis(x[:7], s, sigma=1e-3)
    assert axes.expected_line_error(s, 1e-3) == pytest.approx(one.sigma_direction, rel=1e-12)


def test_moving_the_world_and_the_order_change_nothing() -> None:
    rng = np.random.default_rng(6)
    q = np.linspace(-1.0, 1.5, 9)
    x, _, _ = circle(rng, q)
    x = x + rng.normal(scale=1e-3, size=x.shape)
    R, t, order = turn([0.3, -2.0, 0.7]), np.array([1.0, 2.0, -3.0]), rng.permutation(9)
    a, b = circle_axis(x, q), circle_axis(x[order] @ R.T + t, q[order])
    assert np.abs(R @ a.direction - b.direction).max() < 1e-10
    assert np.abs(R @ a.point + t - b.point).max() < 1e-10
    assert a.sigma_direction == pytest.approx(b.sigma_direction, rel=1e-6)


@pytest.mark.parametrize("kinds", ["rr", "r", "p", "rrr", "prr"])
def test_sweeps_find_every_axis_where_all_joints_read_zero(kinds: str) -> None:
    """Turntable, track, two and three axes: exact without noise, wherever the other joints stand in a sweep."""
    rng = np.random.default_rng(7)
    names = tuple(f"axis_{k}" for k in range(len(kinds)))
    frames = tuple(place(turn(rng.normal(size=3)), rng.uniform(-0.5, 0.5, 3).tolist()) for _ in kinds)
    machine = Machine(frames, kinds, names)
    places = np.linspace(-0.9, 1.1, 5)
    q = np.concatenate([np.outer(places, np.eye(len(kinds))[j]) + 0.4 * (np.arange(len(kinds)) != j)
                        for j in range(len(kinds))])  # fmt: skip
    robot = load(positioners.nominal(machine), "table")
    data = machine.touch(robot, q, [np.array([0.3, 0.05, 0.1]), np.array([-0.2, 0.3, 0.2])])
    found = circle_point_analysis(data, ["revolute" if kind == "r" else "prismatic" for kind in kinds])
    T = np.eye(4)
    for axis, frame, kind in zip(found, frames, kinds, strict=True):
        T = T @ frame
        assert np.abs(axis.direction - T[:3, 2]).max() < 1e-12
        if kind == "r":
            assert from_axis(axis.point, T[:3, 2], T[:3, 3]) < 1e-12
    # And as a machine: the axes' lines are all that its own table points need.
    built = calib.positioner.axes_robot(found, names)
    again, zero = rng.uniform(-1.0, 1.0, (20, len(kinds))), np.zeros((1, len(kinds)))
    carried = machine.table(again) @ np.linalg.inv(machine.table(zero))
    assert np.abs(built.tips(again) @ rigid.inverse(built.tips(zero)) - carried).max() < 1e-12


def test_what_is_not_swept_or_not_determined_is_refused() -> None:
    robot = load(positioners.nominal(positioners.TWO_AXES), "table")
    data = positioners.TWO_AXES.touch(robot, positioners.five(60, 60)[:3], [positioners.MARK])
    with pytest.raises(calib.IdentificationError, match="joint 'tilt' is not swept alone"):
        circle_point_analysis(data, ["revolute", "revolute"])
    with pytest.raises(calib.MeasurementError, match="2 joints, and 1 kinds"):
        circle_point_analysis(data, ["revolute"])
    line = np.outer(np.arange(4.0), [1.0, 2.0, 3.0]) + 5.0
    with pytest.raises(calib.IdentificationError, match="on a line"):
        circle_axis(line)
    with pytest.raises(calib.IdentificationError, match="2 points on 1 circles"):
        circle_axis(line[:2])
    with pytest.raises(calib.IdentificationError, match="one place"):
        line_axis(np.ones((3, 3)))
    with pytest.raises(calib.MeasurementError, match=r"finite numbers \(N, 3\)"):
        circle_axis([[0.0, 1.0, np.nan]])
    with pytest.raises(calib.MeasurementError, match="4 points and 2 marks"):
        circle_axis(line, marks=["a", "b"])
    with pytest.raises(calib.MeasurementError, match="marks of a sweep must be names or numbers"):
        circle_axis(line, marks=[[1]] * 4)
