"""The tip by pivoting, and the relative base, on placements that scipy's rotations made."""

import tracemalloc

import numpy as np
import pytest
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation

import calib
from calib.positioner.pivot import pivot
from calib.positioner.relative import relative_base
from tests.support import machines
from tests.support.positioners import Array, place, turn

TIP = np.array([0.02, -0.03, 0.25])


def touches(rng: np.random.Generator, rotations: Array, fixed: Array, sigma: float = 0.0) -> Array:
    """Placements (N, 4, 4) of a link whose tip is at ``fixed`` (3,) or (N, 3), give or take the noise."""
    T = np.tile(np.eye(4), (len(rotations), 1, 1))
    T[:, :3, :3] = rotations
    T[:, :3, 3] = fixed - rotations @ TIP + rng.normal(scale=sigma, size=(len(rotations), 3)) * (sigma > 0.0)
    return T


def some(rng: np.random.Generator, n: int, angle: float = 0.6) -> Array:
    return np.asarray(Rotation.from_rotvec(rng.normal(scale=angle, size=(n, 3))).as_matrix())


def test_pivot_is_exact() -> None:
    rng = np.random.default_rng(0)
    fixed = np.array([1.2, -0.4, 0.6])
    found = pivot(touches(rng, some(rng, 6), fixed))
    assert np.abs(found.tool_point - TIP).max() < 1e-14
    assert np.abs(found.fixed_points - fixed).max() < 1e-14
    assert (found.rank, found.null_basis.shape) == (3, (3, 0))
    assert found.rms < 1e-14


def test_pivot_about_several_points() -> None:
    rng = np.random.default_rng(1)
    fixed = rng.normal(size=(3, 3))
    which = np.repeat([0, 1, 2], 4)
    found = pivot(touches(rng, some(rng, 12), fixed[which]), [f"cone {k}" for k in which])
    assert found.targets == ("cone 0", "cone 1", "cone 2")
    assert np.abs(found.tool_point - TIP).max() < 1e-13
    assert np.abs(found.fixed_points - fixed).max() < 1e-13


@pytest.mark.parametrize("axis", [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
def test_turning_about_one_axis_is_told(axis: list[float]) -> None:
    """The link turns about an axis of its own; along it the tip keeps the guess."""
    rng = np.random.default_rng(2)
    turns = turn([0.3, 1.0, -0.4]) @ Rotation.from_rotvec(np.outer(np.linspace(0, 2, 7), axis)).as_matrix()
    guess = np.array([0.0, 0.0, 0.2])
    found = pivot(touches(rng, turns, np.ones(3)), guess=guess)
    assert found.rank == 2
    assert abs(found.null_basis[:, 0] @ axis) == pytest.approx(1.0, abs=1e-12)
    assert np.abs(np.cross(found.tool_point - TIP, axis)).max() < 1e-12
    assert (found.tool_point - guess) @ axis == pytest.approx(0.0, abs=1e-12)
    assert "not determined along" in str(found)
    assert np.array_equal(np.isnan(found.sigmas), np.array(axis) != 0.0)
    still = pivot(touches(rng, np.tile(np.eye(3), (3, 1, 1)), np.ones(3)), guess=guess)
    assert (still.rank, still.tool_point.tolist()) == (0, guess.tolist())
    assert np.isnan(still.sigmas).all()


def test_sigmas_of_pivot_hold() -> None:
    rng = np.random.default_rng(3)
    R, fixed, z = some(rng, 10), np.array([1.0, 0.2, 0.5]), []
    truth = np.concatenate([TIP, fixed])
    for _ in range(1000):
        found = pivot(touches(rng, R, fixed, 1e-4), sigma=1e-4)
        error = np.concatenate([found.tool_point, found.fixed_points[0]]) - truth
        z.append(error / np.sqrt(np.diag(found.covariance)))
        assert found.noise == 1e-4
    assert 0.93 < np.mean(np.abs(z) < 1.96) < 0.97
    estimated = [pivot(touches(rng, R, fixed, 1e-4)).noise ** 2 for _ in range(300)]
    assert np.mean(estimated) == pytest.approx(1e-8, rel=0.06)


def test_pivot_does_not_mind_world_and_order() -> None:
    rng = np.random.default_rng(4)
    T = touches(rng, some(rng, 8), np.ones(3), 1e-3)
    moved = place(turn([1.0, -0.5, 2.0]), [1.0, 2.0, 3.0]) @ T[rng.permutation(8)]
    a, b = pivot(T), pivot(moved)
    assert np.abs(a.tool_point - b.tool_point).max() < 1e-12
    assert a.noise == pytest.approx(b.noise, rel=1e-9)
    np.testing.assert_allclose(a.covariance[:3, :3], b.covariance[:3, :3], rtol=1e-8)


def test_bad_placements_are_refused() -> None:
    with pytest.raises(calib.MeasurementError, match=r"finite \(N, 4, 4\)"):
        pivot(np.eye(4))
    with pytest.raises(calib.MeasurementError, match="must be rigid"):
        pivot(np.stack([np.eye(4), np.diag([2.0, 1.0, 1.0, 1.0])]))
    with pytest.raises(calib.MeasurementError, match="2 placements and 1 targets"):
        pivot(np.stack([np.eye(4)] * 2), ["a"])


# ---- two machines in one cell


def test_relative_base_is_exact() -> None:
    rng = np.random.default_rng(5)
    T, b = place(turn([2.0, -1.0, 0.5]), [1.5, -0.3, 0.2]), rng.uniform(-1.0, 1.0, (3, 3))
    found = relative_base(b @ T[:3, :3].T + T[:3, 3], b)
    assert np.abs(found.T_a_b - T).max() < 1e-14
    assert found.rms < 1e-14


def solve(arm: machines.Arm, target: Array, start: Array) -> OptimizeResult:
    bounds = tuple(np.transpose(list(arm.ranges.values())))
    return least_squares(
        lambda q: arm.tips(q[None])[0, :3, 3] - target, start, bounds=bounds, xtol=1e-12, ftol=1e-12, gtol=1e-12
    )


def test_relative_base_of_two_arms_that_touch_the_same_points() -> None:
    """Joint readings of two arms, solved for the points by scipy, are all that is given."""
    rng = np.random.default_rng(6)
    T, sigma, names = place(turn([0.0, 0.0, 3.0]), [1.3, 0.2, 0.1]), 5e-5, ("negative", "mimic")
    arms = [machines.arm(machines.INLINE[name], "tip") for name in names]
    robots = [machines.load(machines.INLINE[name], "tip") for name in names]
    points = np.column_stack([rng.uniform(0.35, 0.75, (8, 2)) * [1.0, 0.3], rng.uniform(0.5, 0.8, 8)])
    seen = []
    for arm, robot, x in zip(arms, robots, (points, (points - T[:3, 3]) @ T[:3, :3]), strict=True):
        readings = []
        for target in x + rng.normal(scale=sigma, size=x.shape):
            solved = (solve(arm, target, arm.draw(rng, 1)[0]) for _ in range(6))
            readings.append(next(found.x for found in solved if found.cost < 1e-16))
        seen.append(robot.tips(np.array(readings))[:, :3, 3])
    found = relative_base(*seen, sigma_a=sigma, sigma_b=sigma)
    twist = np.linalg.inv(found.T_a_b) @ T
    error = np.concatenate([twist[:3, 3], Rotation.from_matrix(twist[:3, :3]).as_rotvec()])
    assert error @ np.linalg.solve(found.covariance, error) < 22.5  # chi-square of 6, one in a thousand beyond
    assert found.rms == pytest.approx(sigma * np.sqrt(6.0), rel=0.5)


def test_sigmas_of_relative_base_hold() -> None:
    rng = np.random.default_rng(7)
    T, b = place(turn([0.1, 0.2, 3.0]), [1.5, -0.3, 0.2]), rng.uniform(-1.0, 1.0, (10, 3))
    inside, squares = [], []
    far = np.array([[1.5, 1.0, -0.5]])
    for _ in range(1000):
        a = b @ T[:3, :3].T + T[:3, 3] + rng.normal(scale=1e-4, size=b.shape)
        found = relative_base(a, b + rng.normal(scale=1e-4, size=b.shape))
        twist = np.linalg.inv(found.T_a_b) @ T
        error = np.concatenate([twist[:3, 3], Rotation.from_matrix(twist[:3, :3]).as_rotvec()])
        inside.append(np.abs(error) < 1.96 * np.sqrt(np.diag(found.covariance)))
        carried = (found.T_a_b - T) @ np.append(far[0], 1.0)
        squares.append((carried[:3] @ carried[:3], found.sigma_at(far)[0] ** 2))
    assert 0.93 < np.mean(inside) < 0.97
    seen, told = np.sqrt(np.mean(squares, axis=0))
    assert seen == pytest.approx(told, rel=0.06)


def test_points_that_tell_too_little_are_refused() -> None:
    line = np.outer(np.arange(5.0), [1.0, 2.0, 2.0])
    with pytest.raises(calib.IdentificationError, match="5 points lie on a line"):
        relative_base(line, line)
    with pytest.raises(calib.IdentificationError, match="touch three points or more"):
        relative_base(line[:2], line[:2])
    corners = np.eye(3)
    with pytest.raises(calib.IdentificationError, match="3 points lie on a line"):
        relative_base(corners, 1e-300 * corners)  # a singular matrix
    with pytest.raises(calib.MeasurementError, match=r"they are \(5, 3\), \(4, 3\)"):
        relative_base(line, line[:4])


def test_very_many_touches_of_many_cones_take_no_more_memory_than_they_have() -> None:
    """Four tables of 16,000 touches of a hundred cones each took minutes, and gigabytes."""
    count, cones = 20_000, 200
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, random_state=0).as_matrix()
    tracemalloc.start()
    found = pivot(T, [f"c{k % cones}" for k in range(count)], sigma=1e-4)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
    assert found.covariance.shape == (3 + 3 * cones,) * 2
