"""A camera's projection against two other implementations, its derivative against differences, and its refusals."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.foundations.errors import JobError
from calib.measurement.projection import distort, project, undistort
from tests.support.cameras import BENT, eye, see

CAMERA = eye("tip")


def points(n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.2, 3.0, (n, 1))
    return np.hstack([rng.uniform(-0.6, 0.6, (n, 2)) * depth, depth])


def test_pixels_are_those_of_another_implementation() -> None:
    found = project(CAMERA, points())
    assert found.in_front.all()
    np.testing.assert_allclose(found.pixels, see(CAMERA, points()), rtol=0, atol=1e-9)


def test_pixels_are_those_of_opencv() -> None:
    cv2 = pytest.importorskip("cv2")
    K = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1]])
    bent = np.array([CAMERA.k1, CAMERA.k2, CAMERA.p1, CAMERA.p2, CAMERA.k3])
    theirs, _ = cv2.projectPoints(points(), np.zeros(3), np.zeros(3), K, bent)
    np.testing.assert_allclose(project(CAMERA, points()).pixels, theirs[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_derivatives_match_central_differences(side: float) -> None:
    """Also behind the camera, where a solver that strays must find its way back."""
    at, h = points() * (1.0, 1.0, side), 1e-6
    found = project(CAMERA, at)
    assert (found.in_front == (side > 0)).all()
    for k in range(3):
        step = h * np.eye(3)[k]
        numeric = (project(CAMERA, at + step).pixels - project(CAMERA, at - step).pixels) / (2 * h)
        error = np.abs(found.by_point[:, :, k] - numeric)
        assert np.all(error <= 1e-6 * np.maximum(np.abs(numeric), np.abs(found.by_point).max(axis=(1, 2))[:, None]))


def test_derivatives_of_the_distortion_match_central_differences() -> None:
    flat, h = np.random.default_rng(2).uniform(-0.8, 0.8, (50, 2)), 1e-6
    _, J = distort(CAMERA, flat)
    for k in range(2):
        step = h * np.eye(2)[k]
        numeric = (distort(CAMERA, flat + step)[0] - distort(CAMERA, flat - step)[0]) / (2 * h)
        np.testing.assert_allclose(J[:, :, k], numeric, rtol=0, atol=1e-8)


def test_undistorting_undoes_the_lens() -> None:
    flat, found = undistort(CAMERA, see(CAMERA, points()))
    assert found.all()
    np.testing.assert_allclose(flat, points()[:, :2] / points()[:, 2:], rtol=0, atol=1e-12)


def test_pixels_beyond_the_fold_of_a_lens_have_no_direction() -> None:
    # r (1 - 2 r^2) is largest at r = 1 / sqrt(6), where it is 0.2722.
    camera = calib.measuring.Camera("tip", 1000.0, 1000.0, 0.0, 0.0, k1=-2.0)
    flat, found = undistort(camera, np.array([[0.0, 0.0], [272.0, 0.0], [0.0, -272.0], [273.0, 0.0], [4000.0, 900.0]]))
    assert found.tolist() == [True, True, True, False, False]
    assert 0.39 < flat[1, 0] < 1 / np.sqrt(6)


def test_a_mark_in_the_camera_is_finite() -> None:
    found = project(CAMERA, np.zeros((1, 3)))
    assert np.isfinite(found.pixels).all() and np.isfinite(found.by_point).all() and not found.in_front.any()


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("fx", 0.0, "fx is 0 px; allowed is 1 to 1e\\+06 px"),
        ("fy", float("inf"), "fy is inf"),
        ("cx", float("nan"), "cx is nan px; allowed is -1e\\+06 to 1e\\+06 px"),
        ("k3", float("inf"), "k3 is inf"),
        ("sigma", -0.1, "sigma is -0.1 px; allowed is 0, or 0.0001 to 10000 px"),
        ("camera_on", "wall", "camera_on is 'wall'; allowed are floor, tip"),
    ],
)
def test_impossible_cameras_are_refused(key: str, value: object, says: str) -> None:
    with pytest.raises(JobError, match=says):
        replace(calib.measuring.Camera("tip", **BENT), **{key: value})
