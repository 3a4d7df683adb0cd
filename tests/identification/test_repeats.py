"""Rows that repeat a pose err together: how much, and what it does to covariance and regions."""

import numpy as np
import pytest
import scipy

import calib
from calib.identification.identify import with_values
from calib.identification.repeats import beyond_alone, repeated
from calib.machine.of_fit import machine_of
from calib.machine.tool_uncertainty import tool_uncertainty
from calib.measurement.poses import ONE_POSE, poses_of
from tests.support import machines
from tests.support.machines import Array, Machine, anywhere, pose
from tests.support.touching import Lab, lab

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
SIGMA, W0, W1 = 5e-5, 0.3, 1.1


def rows(seed: int, many: Array, p: int = 12, w1: float = W1) -> tuple[Array, Array, Array, Array]:
    """Poses (N,), residuals (N, 3) of a fit, its derivatives (N, 3, p), and the covariance (p, p) of parameters."""
    rng = np.random.default_rng(seed)
    number = np.repeat(np.arange(len(many)), many)
    J = rng.normal(size=(len(many), 3, p))[number]
    e = np.sqrt(W0) * rng.normal(size=(len(number), 3)) + np.sqrt(w1) * rng.normal(size=(len(many), 3))[number]
    order = rng.permutation(len(number))
    number, J, e = number[order], J[order], e[order]
    flat = J.reshape(-1, p)
    C = np.linalg.inv(flat.T @ flat)
    return number, e - (flat @ (C @ (flat.T @ e.ravel()))).reshape(e.shape), J, C


def covariance(number: Array, w0: float, w1: float) -> Array:
    same = np.repeat(number, 3)[:, None] == np.repeat(number, 3)
    coordinate = np.tile(np.arange(3), len(number))
    return w0 * np.eye(len(coordinate)) + w1 * (same & (coordinate[:, None] == coordinate))


def by_likelihood(number: Array, r: Array, J: Array) -> Array:
    """The likeliest w_0 and w_1, all parameters integrated out, by matrices of N x N."""
    flat = J.reshape(-1, J.shape[2])
    left = scipy.linalg.null_space(flat.T)
    z = left.T @ r.ravel()

    def cost(logs: Array) -> float:
        V = left.T @ covariance(number, *np.exp(logs)) @ left
        return float(np.linalg.slogdet(V)[1] + z @ np.linalg.solve(V, z))

    return np.exp(scipy.optimize.minimize(cost, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-7}).x)


def test_of_poses_measured_equally_often_both_parts_are_the_likeliest_ones() -> None:
    number, r, J, C = rows(0, np.full(15, 4))
    found = repeated(number, r, J, C)
    assert found is not None
    np.testing.assert_allclose(found, by_likelihood(number, r, J), rtol=1e-4)


def test_of_any_poses_planted_parts_are_found_on_average() -> None:
    many = np.array([1] * 8 + [2] * 8 + [7] * 8)
    found = np.array([repeated(*rows(seed, many)) for seed in range(60)])
    np.testing.assert_allclose(found.mean(axis=0), [W0, W1], rtol=0.08)


def test_what_it_adds_is_that_of_the_whole_matrix() -> None:
    number, _, J, _ = rows(1, np.array([1, 3, 5]), p=4)
    flat = J.reshape(-1, 4)
    whole = flat.T @ (covariance(number, W0, W1) - np.eye(len(flat))) @ flat
    np.testing.assert_allclose(beyond_alone(W0, W1, number, J), whole, rtol=1e-12)


def test_noise_of_rows_alone_is_no_noise_of_poses() -> None:
    told = [repeated(*rows(seed, np.full(14, 5), w1=0.0)) for seed in range(200)]
    assert sum(one is not None for one in told) <= 6


def test_copies_of_rows_are_no_repeated_measurements() -> None:
    number, r, J, C = rows(2, np.full(20, 1))
    twice = (np.concatenate([x, x]) for x in (number, r, J))
    assert repeated(*twice, C / 2.0) is None


# ---- which rows are of one pose


def table(readings: Array, seen: Array | None = None) -> calib.Measurements:
    robot = machines.load(*UR10)
    position = np.zeros((len(readings), 3)) if seen is None else seen
    return calib.positions(robot, readings, position, sigma=SIGMA)


def test_poses_are_told_by_readings_whatever_their_order() -> None:
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.0, 1.0, (30, 6))
    number = np.concatenate([np.repeat(np.arange(30), 3), [30]])
    # As servos come back, also across where readings would be rounded.
    again = np.concatenate([q[number[:-1]] + rng.uniform(-0.4, 0.4, (90, 6)) * ONE_POSE, [q[0] + 2.0 * ONE_POSE]])
    order = rng.permutation(len(again))
    found = poses_of(table(again[order]))
    assert len(np.unique(found)) == 31
    assert len(np.unique(np.column_stack([found, number[order]]), axis=0)) == 31


def test_a_slow_path_is_no_pose() -> None:
    path = np.linspace(0.0, 1.0, 2001)[:, None] * np.ones(6)
    np.testing.assert_array_equal(poses_of(table(path)), np.arange(2001))


# ---- whole fits


def measured(
    seed: int, poses: int, again: int, *, waves: float = 0.0, scatter: float = 0.0
) -> tuple[calib.Measurements, Array, Array]:
    """Poses measured again and again, with errors that stay in each; new readings, and what is true there."""
    rng = np.random.default_rng(seed)
    arm = machines.arm(*UR10)
    true = Machine(arm.moved(rng), anywhere(rng), {"tool": pose((0.05, 0.02, 0.15), (0.3, -0.2, 0.4))})

    def points(q: Array) -> Array:
        wobbling = q + waves * np.cos(2.0 * q + np.arange(6))
        return true.see(wobbling)[:, :3, 3] + scatter * rng.standard_normal((len(q), 3))

    q, new = arm.draw(rng, poses), arm.draw(rng, 200)
    number = np.repeat(np.arange(poses), again)
    seen = points(q)[number] + SIGMA * rng.standard_normal((len(number), 3))
    return table(q[number], seen), new, points(new)


def fitted(data: calib.Measurements) -> calib.Fit:
    chosen = {"offsets": "all", "placements": "all", "tool": "position"}
    return calib.identify(machines.model(machines.load(*UR10), **chosen), data)


def test_gears_that_wobble_make_the_sigmas_of_repeated_poses_larger() -> None:
    data, new, true = measured(4, 16, 5, waves=4e-4)
    fit = fitted(data)
    (told,) = fit.repeats
    assert told.alone == pytest.approx(SIGMA, rel=0.15)
    assert told.common > 2.0 * SIGMA
    assert (told.rows, told.poses) == (80, 16)
    alone = np.sqrt(fit.spread_alone.variances)
    known = ~fit.unidentifiable
    assert np.median(fit.sigmas[known] / alone[known]) > 2.0
    machine = machine_of(fit)
    found = tool_uncertainty(machine, new)
    # Of 16 poses as many numbers are left as if each had been measured once.
    assert found.degrees_of_freedom == pytest.approx(fit.noise_by_rows[0].degrees_of_freedom - 3 * 64)
    assert np.mean(found.inside(machine.predict(new)[:, :3, 3] - true)) > 0.9
    # The noise of a row, as poses tell it: what all of a pose have in common is not averaged away.
    (noise,) = fit.noise
    assert noise.total == pytest.approx(np.hypot(told.alone, told.common))
    assert noise.total > 1.2 * fit.noise_by_rows[0].total
    assert noise.degrees_of_freedom == pytest.approx(found.degrees_of_freedom)
    assert noise.chi_square == pytest.approx((noise.total / SIGMA) ** 2)
    # By which rows are weighed has not changed: what is not repeated is as before, to the bit.
    once = fitted(measured(4, 60, 1, waves=4e-4)[0])
    assert once.noise == once.noise_by_rows


def test_values_found_in_another_way_err_together_as_well() -> None:
    fit = fitted(measured(4, 16, 5, waves=4e-4)[0])
    again = with_values(fit, fit.values, fit.machine)
    (one,), (other,) = fit.repeats, again.repeats
    assert (other.alone, other.common) == pytest.approx((one.alone, one.common), rel=1e-3)
    known = ~fit.unidentifiable
    assert again.sigmas[known] == pytest.approx(fit.sigmas[known], rel=0.01)


def test_a_path_is_cut_into_pieces_as_wide_as_a_pose() -> None:
    path = np.linspace(0.0, 1.0, 2001)[:, None] * np.ones(6)
    number = poses_of(table(path), pieces=True)
    assert 900 < number.max() < 1100
    assert np.all(np.diff(number) >= 0)


def test_the_noise_of_a_row_is_what_many_poses_would_tell() -> None:
    by_rows, by_poses = (
        np.sqrt(np.mean([noise.total**2 for noise in of]))
        for of in zip(
            *(
                (fit.noise_by_rows[0], fit.noise[0])
                for fit in (fitted(measured(seed, 14, 5, waves=4e-4)[0]) for seed in range(8))
            ),
            strict=True,
        )
    )
    many = np.sqrt(np.mean([fitted(measured(seed, 300, 1, waves=4e-4)[0]).noise[0].total ** 2 for seed in range(2)]))
    assert by_poses == pytest.approx(many, rel=0.2)
    assert by_rows < 0.8 * many


def test_scatter_from_pose_to_pose_is_found_although_rows_of_a_pose_agree() -> None:
    scatter = 3e-4
    data, new, true = measured(5, 30, 5, scatter=scatter)
    machine = machine_of(fitted(data))
    level = machine.known_uncertainty.position
    assert level is not None
    assert level.model == pytest.approx(scatter, rel=0.25)
    found, errors = tool_uncertainty(machine, new), machine.predict(new)[:, :3, 3] - true
    assert np.mean(found.inside(errors)) > 0.9
    assert np.sqrt(np.mean(found.position**2)) < 1.5 * np.sqrt(np.mean(np.sum(errors**2, axis=1)))


def test_the_order_of_rows_does_not_matter() -> None:
    data, _, _ = measured(6, 20, 3, scatter=2e-4)
    fits = [fitted(rows) for rows in (data, data.subset(np.random.default_rng(0).permutation(len(data))))]
    one, other = (fit.repeats[0] for fit in fits)
    np.testing.assert_allclose((one.alone, one.common), (other.alone, other.common), rtol=1e-5)
    np.testing.assert_allclose(fits[0].sigmas, fits[1].sigmas, rtol=1e-5)


def test_rows_that_err_alone_have_the_covariance_of_rows_that_err_alone() -> None:
    again, once = fitted(measured(7, 20, 5)[0]), fitted(measured(7, 40, 1, waves=4e-4)[0])
    for fit in (again, once):
        assert not fit.repeats
        np.testing.assert_array_equal(fit.covariance, fit.covariance_alone)


def test_sockets_touched_again_and_again() -> None:
    here: Lab = lab(3, noise=2e-4)
    data = here.sockets(20)
    rng = np.random.default_rng(8)
    columns = here.columns(np.repeat(data.readings, 4, axis=0) + rng.normal(scale=1e-5, size=(240, 6)))
    columns["target"] = np.repeat([data.targets[t] for t in data.target], 4).tolist()
    again = calib.read_measurements(columns, here.robot, "socket", sigma=1e-5)
    fit = calib.identify(machines.model(here.robot, offsets="all", tool="position"), again)
    (told,) = fit.repeats
    assert told.poses == 60
    level = machine_of(fit).known_uncertainty.position
    assert level is not None
    assert 0.0 < level.model < 1.5 * told.common
