"""Deviations: six numbers, their motion, and the twists that follow a change of each."""

import numpy as np
import pytest
from scipy.linalg import logm
from scipy.spatial.transform import Rotation

from calib.robot.deviation import Motions, axis_frame, motion, twists


def deviations(n: int, size: float) -> np.ndarray:
    return np.random.default_rng(n).uniform(-size, size, (n, 6))


def test_a_deviation_translates_then_turns_about_its_own_x_y_z() -> None:
    d = deviations(20, 3.0)
    E = motion(d)
    np.testing.assert_array_equal(E[:, :3, 3], d[:, :3])
    np.testing.assert_allclose(E[:, :3, :3], Rotation.from_euler("XYZ", d[:, 3:]).as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(motion(np.zeros(6)), np.eye(4))


def test_motions_are_motion_and_twists_in_one_go() -> None:
    d = deviations(20, 3.0)
    E, W = Motions.of(d)
    np.testing.assert_allclose(E, motion(d), rtol=0, atol=1e-15)
    np.testing.assert_allclose(W, twists(d), rtol=0, atol=1e-15)


@pytest.mark.parametrize("size", [0.0, 0.3, 3.0])
def test_twists_are_the_derivative_of_the_motion(size: float) -> None:
    h = 1e-6
    for d in deviations(5, size):
        W = twists(d)
        for k, step in enumerate(h * np.eye(6)):
            change = logm(np.linalg.solve(motion(d - step), motion(d + step))).real / (2 * h)
            twist = [*change[:3, 3], change[2, 1], change[0, 2], change[1, 0]]
            np.testing.assert_allclose(W[:, k], twist, atol=1e-8)


@pytest.mark.parametrize(
    ("axis", "x", "y"),
    [
        ([1, 0, 0], [0, 1, 0], [0, 0, 1]),
        ([0, 1, 0], [0, 0, 1], [1, 0, 0]),
        ([0, 0, 1], [1, 0, 0], [0, 1, 0]),
        ([-1, 0, 0], [0, 0, 1], [0, 1, 0]),
        ([0, -1, 0], [1, 0, 0], [0, 0, 1]),
        ([0, 0, -1], [1, 0, 0], [0, -1, 0]),
    ],
)
def test_along_a_coordinate_axis_the_frame_keeps_the_axes_of_the_urdf(
    axis: list[int], x: list[int], y: list[int]
) -> None:
    np.testing.assert_array_equal(axis_frame(np.array(axis, dtype=float))[:3, :2].T, [x, y])


@pytest.mark.parametrize("seed", range(10))
def test_the_frame_of_any_axis_is_a_rotation_with_z_along_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3) * 10.0 ** rng.uniform(-8, 0, 3)
    axis /= np.linalg.norm(axis)
    for signed in (axis, -axis):
        P = axis_frame(signed)
        np.testing.assert_allclose(P[:3, 2], signed, atol=1e-15)
        np.testing.assert_allclose(P[:3, :3] @ P[:3, :3].T, np.eye(3), atol=1e-15)
        assert np.linalg.det(P) > 0.0
        assert not P[:3, 3].any()
