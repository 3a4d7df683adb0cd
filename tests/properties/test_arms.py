"""Any serial arm: where it is, what its deviations do, its calibrated document, and the commands for it."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import calib
from calib.compensation import commands
from calib.machine.urdf import calibrated_urdf
from calib.robot.sampling import joint_limits
from tests.properties.strategies import arms
from tests.support import machines
from tests.support.jacobians import check, problem
from tests.support.machines import Array, Rng
from tests.support.reach import apart, well_posed

MANY = settings(max_examples=25)
seeds = st.integers(0, 1000).map(np.random.default_rng)


def deviations(robot: calib.Robot, rng: Rng, size: float) -> calib.Deviations:
    return calib.Deviations(size * rng.normal(size=(len(robot.chain), 6)), size * rng.normal(size=len(robot.moving)))


def in_order(robot: calib.Robot, arm: machines.Arm, readings: Array) -> Array:
    """Readings of the robot in the order of the arm's drivers."""
    names = [reading.name for reading in robot.readings]
    return readings[:, [names.index(name) for name in arm.ranges]]


@MANY
@given(arms(far=100.0), seeds)
def test_the_tip_is_where_the_text_of_the_urdf_puts_it(text: str, rng: Rng) -> None:
    robot, arm = machines.load(text, "tip"), machines.arm(text, "tip")
    readings = arm.draw(rng, 5)
    np.testing.assert_allclose(robot.tips(readings), arm.tips(readings), rtol=0, atol=2e-13)


@MANY
@given(arms(far=20.0), seeds, st.sampled_from((1e-6, 5e-3, 0.3)))
def test_a_calibrated_urdf_is_the_calibrated_machine_in_every_reader(text: str, rng: Rng, size: float) -> None:
    robot = machines.load(text, "tip")
    d = deviations(robot, rng, size)
    again = calibrated_urdf(robot, d).decode()
    again = again[again.index("<robot") :]
    arm = machines.arm(again, "tip")
    readings = rng.uniform(-2.0, 2.0, (5, len(robot.readings)))
    expected = robot.tips(readings, d)
    np.testing.assert_allclose(machines.load(again, "tip").tips(readings), expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(arm.tips(in_order(robot, arm, readings)), expected, rtol=0, atol=1e-11)


@MANY
@given(arms(), seeds, st.sampled_from((0.0, 5e-3, 0.3)))
def test_deviations_move_the_tip_as_its_derivative_says(text: str, rng: Rng, size: float) -> None:
    robot = machines.load(text, "tip")
    d = deviations(robot, rng, size)
    readings = rng.uniform(-2.0, 2.0, (2, len(robot.readings)))
    motion, h = robot.motion(readings, d), 1e-6
    flat = np.concatenate([d.placements.ravel(), d.offsets])

    def tips(x: Array) -> Array:
        n = d.placements.size
        return robot.tips(readings, calib.Deviations(x[:n].reshape(-1, 6), x[n:]))

    e = rng.normal(size=len(flat))
    ahead, behind = tips(flat + h * e), tips(flat - h * e)
    R_t = np.swapaxes(motion.placement[:, :3, :3], 1, 2)
    v = (R_t @ (ahead - behind)[:, :3, 3, None])[:, :, 0]
    w = Rotation.from_matrix(np.swapaxes(behind[:, :3, :3], 1, 2) @ ahead[:, :3, :3]).as_rotvec()
    expected = np.hstack([v, w]) / (2 * h)
    found = motion.by_deviations @ e
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-7 * np.abs(expected).max())


@given(arms(most=5), st.sampled_from(("position", "pose")))
def test_columns_of_the_jacobian_match_central_differences(text: str, observes: str) -> None:
    check(*problem(text, "tip", observes, "pose", rows=2))


@given(arms(least=6), seeds)
def test_commands_take_the_calibrated_machine_where_the_nominal_one_would_be(text: str, rng: Rng) -> None:
    robot = machines.load(text, "tip")
    model = calib.CalibratedMachine(
        robot, deviations(robot, rng, 5e-4), np.eye(4), {"tool": machines.pose((0, 0.1, 0.1))}
    )
    low, high = joint_limits(robot).T
    # Away from the limits, which commands keep.
    readings = (low + high) / 2 + rng.uniform(-0.45, 0.45, (20, len(low))) * (high - low)
    readings = well_posed(model, readings)
    assume(len(readings) > 0)
    found = commands.for_joint_targets(model, readings)
    wanted = robot.tips(readings) @ model.tools["tool"]
    reached = robot.tips(found.readings, model.deviations) @ model.tools["tool"]
    assert found.reached.all(), found.reasons
    assert max(apart(reached, wanted)) < 1e-9
