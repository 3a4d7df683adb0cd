"""Wind-up while the arm moves: torques of a textbook's arm of two links, and its compliances from streams."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.identification import system
from calib.identification.initialisation.problem import initial_problem
from calib.identification.machine import values_at
from calib.robot.conditions import Conditions, joined
from calib.robot.gravity import Holding
from calib.robot.joint_terms import weights_of
from calib.robot.urdf import parse_urdf

Array = np.ndarray
# Lengths and centres in m, masses in kg, inertias about the centres in kg m^2, gravity in m/s^2.
L1, C1, C2 = 0.6, 0.25, 0.3
M1, M2, I1, I2, G = 12.0, 7.0, 0.4, 0.15, 9.80665
TOOL = 0.5
STIFF = np.array([4e-5, 9e-5])
# The second inertial has axes of its own, turned about the joint's: what it is about that axis stays.
ARM = f"""<robot name="two_links">
<link name="base"/>
<link name="upper"><inertial><origin xyz="{C1} 0 0"/><mass value="{M1}"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="{I1}" iyz="0" izz="0.4"/></inertial></link>
<link name="fore"><inertial><origin xyz="{C2} 0 0" rpy="1.5707963267948966 0 0"/><mass value="{M2}"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.15" iyz="0" izz="{I2}"/></inertial></link>
<link name="tip"/>
<joint name="first" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="second" type="revolute"><origin xyz="{L1} 0 0"/><parent link="upper"/><child link="fore"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="end" type="fixed"><origin xyz="{TOOL} 0 0"/><parent link="fore"/><child link="tip"/></joint>
</robot>"""


def torques(q: Array, v: Array, a: Array) -> Array:
    """What the drives hold (N, 2): J. J. Craig, Introduction to robotics, chapter 6, turns downwards being positive."""
    (q1, q2), (v1, v2), (a1, a2) = q.T, v.T, a.T
    m12 = M2 * (C2**2 + L1 * C2 * np.cos(q2)) + I2
    m22 = M2 * C2**2 + I2
    m11 = M1 * C1**2 + I1 + M2 * (L1**2 + C2**2 + 2.0 * L1 * C2 * np.cos(q2)) + I2
    h = M2 * L1 * C2 * np.sin(q2)
    g2 = -G * M2 * C2 * np.cos(q1 + q2)
    g1 = -G * (M1 * C1 + M2 * L1) * np.cos(q1) + g2
    return np.column_stack(
        [m11 * a1 + m12 * a2 - h * (2.0 * v1 * v2 + v2**2) + g1, m12 * a1 + m22 * a2 + h * v1**2 + g2]
    )


def points(q: Array) -> Array:
    """Where the tool is (N, 3), at joint positions (N, 2)."""
    q1, q12 = q[:, 0], q.sum(axis=1)
    x, z = L1 * np.cos(q1) + (TOOL + 0.1) * np.cos(q12), -L1 * np.sin(q1) - (TOOL + 0.1) * np.sin(q12)
    return np.column_stack([x, np.zeros_like(x), z])


def moved(t: Array, derivative: int = 0) -> Array:
    """Readings (N, 2), or a derivative of them."""
    rates, phases = np.array([[1.3, 3.1, 5.3], [1.7, 3.7, 6.1]]), np.array([[0.1, 1.0, 2.0], [0.6, 2.2, 4.0]])
    waves = rates**derivative * np.sin(np.multiply.outer(t, rates) + phases + 0.5 * np.pi * derivative)
    return np.asarray(0.2 * waves.sum(axis=-1) + (np.array([0.3, -0.9]) if derivative == 0 else 0.0))


def streams(rate: float = 125.0, sigma: float = 2e-5) -> calib.Measurements:
    rng = np.random.default_rng(5)
    u, t = np.arange(0.0, 40.0, 1.0 / rate), np.arange(1.0, 39.0, 1.0 / 60.0)
    q = moved(t)
    x = points(q - STIFF * torques(q, moved(t, 1), moved(t, 2))) + sigma * rng.normal(size=(len(t), 3))
    joints = {"time [s]": u} | {f"{n} [rad]": moved(u)[:, k] for k, n in enumerate(("first", "second"))}
    seen = {"time [s]": t + 3.0} | {f"{a} [m]": x[:, k] for k, a in enumerate("xyz")}
    return calib.measuring.read_stream(seen, robot(), joints, sigma=sigma)


def robot() -> calib.Robot:
    return calib.load_robot(parse_urdf(ARM.encode(), "two_links.urdf"), "tip")


def model() -> calib.ErrorModel:
    return calib.error_model(robot(), offsets=["second"], terms={"elastic": "all"})


def test_torques_are_those_of_a_textbook() -> None:
    rng = np.random.default_rng(1)
    q, v, a = rng.uniform(-3.0, 3.0, (3, 20, 2)) * np.array([1.0, 2.0, 10.0])[:, None, None]
    held = Holding(weights_of(robot()))
    at_rest = np.zeros_like(q)
    np.testing.assert_allclose(held(q), torques(q, at_rest, at_rest), atol=1e-10)
    np.testing.assert_allclose(held(q, Conditions(motion=np.stack([v, a], axis=1))), torques(q, v, a), atol=1e-10)
    resting = Conditions(motion=np.zeros((20, 2, 2)))
    np.testing.assert_allclose(held(q, resting), held(q), atol=1e-12)


def test_compliances_are_found_while_the_arm_moves_and_gravity_alone_would_find_others() -> None:
    data = streams()
    fit = calib.identify(model(), data)
    found, sigma = ([values[k] for k in _elastic(fit)] for values in (fit.values, fit.sigmas))
    np.testing.assert_allclose(found, STIFF, atol=5.0 * max(sigma))
    assert max(sigma) < 5e-7
    assert fit.value("clock.offset") == pytest.approx(3.0, abs=1e-4)
    # What three samples make of an acceleration is left: 40 um/s^2 a rad.
    assert np.sqrt(np.mean(fit.residuals[0] ** 2)) < 4e-5
    assert data.stream is not None
    joints = replace(data.stream.joints, accelerates=None)
    still = calib.identify(model(), replace(data, stream=replace(data.stream, joints=joints)))
    assert np.sqrt(np.mean(still.residuals[0] ** 2)) > 3e-4


def _elastic(fit: calib.Fit) -> list[int]:
    return [k for k, parameter in enumerate(fit.parameters) if parameter.name.endswith(".elastic")]


def test_derivatives_by_compliances_are_exact_and_by_the_clock_as_near_as_they_are_said_to_be() -> None:
    data = streams().subset(np.arange(0, 2000, 97))
    problem = initial_problem(model(), (data,))
    x = values_at(problem.model.robot, problem.parameters, problem.reference)
    x = x + np.random.default_rng(2).uniform(-1.0, 1.0, len(x)) * [
        {"rad/Nm": 1e-4, "rad": 0.3, "m": 0.3}.get(parameter.unit, 1e-4) for parameter in problem.parameters
    ]
    (J,) = system.jacobian(problem, x)
    for k, parameter in enumerate(problem.parameters):
        h = 1e-6 * (np.arange(len(x)) == k)
        after, before = (problem.residuals(x + s)[0] for s in (h, -h))
        numeric = (after - before) / 2e-6
        tolerance = 2e-2 if parameter.name.startswith("clock") else 1e-6
        np.testing.assert_allclose(J[:, :, k], numeric, atol=tolerance * np.abs(numeric).max(), err_msg=parameter.name)


@pytest.mark.parametrize(("rate", "shown"), [(125.0, True), (40.0, True), (2.5, False)])
def test_samples_too_far_apart_show_no_acceleration(rate: float, shown: bool) -> None:
    u = np.arange(0.0, 40.0, 1.0 / rate)
    joints = {"time [s]": u} | {f"{n} [rad]": moved(u)[:, k] for k, n in enumerate(("first", "second"))}
    t = np.arange(1.0, 39.0, 0.1)
    seen = {"time [s]": t} | {f"{a} [m]": points(moved(t))[:, k] for k, a in enumerate("xyz")}
    clock = calib.measuring.Clock("given", gap=1.0)
    data = calib.measuring.read_stream(seen, robot(), joints, clock=clock, sigma=1e-4)
    assert data.stream is not None
    found = data.stream.motion({})
    if shown:
        inner = slice(5, -5)
        np.testing.assert_allclose(found[inner, 0], moved(t, 1)[inner], atol=1e-3)
        np.testing.assert_allclose(found[inner, 1], moved(t, 2)[inner], atol=0.01 * np.abs(moved(t, 2)).max())
    else:
        np.testing.assert_array_equal(found, 0.0)


def test_a_joint_that_only_jitters_does_not_accelerate() -> None:
    u, rng = np.arange(0.0, 40.0, 0.008), np.random.default_rng(3)
    q = moved(u) + 1e-5 * rng.normal(size=(len(u), 2))
    q[:, 1] = 0.4 + 2e-4 * rng.normal(size=len(u))
    joints = {"time [s]": u, "first [rad]": q[:, 0], "second [rad]": q[:, 1]}
    t = np.arange(1.0, 39.0, 0.1)
    seen = {"time [s]": t} | {f"{a} [m]": points(moved(t))[:, k] for k, a in enumerate("xyz")}
    data = calib.measuring.read_stream(seen, robot(), joints, clock="given", sigma=1e-4)
    assert data.stream is not None
    assert data.stream.joints.accelerates is not None
    assert data.stream.joints.accelerates.tolist() == [True, False]


def test_rows_that_do_not_say_how_they_moved_rest() -> None:
    told = Conditions(motion=np.ones((2, 2, 3)))
    both = joined([(2, told), (1, Conditions())])
    assert both.motion is not None
    np.testing.assert_array_equal(both.motion[:, 0, 0], [1.0, 1.0, 0.0])
    assert both.subset(slice(1, 3)).motion.shape == (2, 2, 3)  # type: ignore[union-attr]
