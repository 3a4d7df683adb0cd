"""A camera's projection against two other implementations, its derivative against differences, and its refusals."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.foundations.errors import JobError
from calib.measurement.lens import NAMES, Lens
from calib.measurement.projection import by_lens, distort, project, undistort
from tests.support.cameras import BENT, eye, see

EYE = eye("tip")
LENS = EYE.lens


def points(n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.2, 3.0, (n, 1))
    return np.hstack([rng.uniform(-0.6, 0.6, (n, 2)) * depth, depth])


def test_pixels_are_those_of_another_implementation() -> None:
    found = project(LENS, points())
    assert found.in_front.all()
    np.testing.assert_allclose(found.pixels, see(EYE, points()), rtol=0, atol=1e-9)


def test_pixels_are_those_of_opencv() -> None:
    cv2 = pytest.importorskip("cv2")
    K = np.array([[EYE.fx, 0, EYE.cx], [0, EYE.fy, EYE.cy], [0, 0, 1]])
    bent = np.array([EYE.k1, EYE.k2, EYE.p1, EYE.p2, EYE.k3])
    theirs, _ = cv2.projectPoints(points(), np.zeros(3), np.zeros(3), K, bent)
    np.testing.assert_allclose(project(LENS, points()).pixels, theirs[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_derivatives_match_central_differences(side: float) -> None:
    """Also behind the camera, where a solver that strays must find its way back."""
    at, h = points() * (1.0, 1.0, side), 1e-6
    found = project(LENS, at)
    assert (found.in_front == (side > 0)).all()
    for k in range(3):
        step = h * np.eye(3)[k]
        numeric = (project(LENS, at + step).pixels - project(LENS, at - step).pixels) / (2 * h)
        error = np.abs(found.by_point[:, :, k] - numeric)
        assert np.all(error <= 1e-6 * np.maximum(np.abs(numeric), np.abs(found.by_point).max(axis=(1, 2))[:, None]))


def test_derivatives_of_the_distortion_match_central_differences() -> None:
    flat, h = np.random.default_rng(2).uniform(-0.8, 0.8, (50, 2)), 1e-6
    _, J = distort(LENS, flat)
    for k in range(2):
        step = h * np.eye(2)[k]
        numeric = (distort(LENS, flat + step)[0] - distort(LENS, flat - step)[0]) / (2 * h)
        np.testing.assert_allclose(J[:, :, k], numeric, rtol=0, atol=1e-8)


RATIONAL = Lens(*LENS[:9], 0.4, -0.2, 0.05)


@pytest.mark.parametrize("lens", [LENS, RATIONAL])
@pytest.mark.parametrize("name", NAMES)
def test_derivatives_by_the_lens_match_central_differences(lens: Lens, name: str) -> None:
    numbers, k = lens.numbers, NAMES.index(name)
    h = 1e-5 * max(1.0, abs(numbers[k]))
    up, down = (project(Lens(*(numbers + s * h * np.eye(12)[k])), points()) for s in (1.0, -1.0))
    found = by_lens(lens, project(lens, points()).flat)[:, :, k]
    np.testing.assert_allclose(found, (up.pixels - down.pixels) / (2 * h), rtol=2e-7, atol=1e-5)


def test_the_rational_lens_is_that_of_opencv_and_is_undone() -> None:
    cv2 = pytest.importorskip("cv2")
    K = np.array([[RATIONAL.fx, 0, RATIONAL.cx], [0, RATIONAL.fy, RATIONAL.cy], [0, 0, 1]])
    theirs, _ = cv2.projectPoints(points(), np.zeros(3), np.zeros(3), K, np.array(RATIONAL[4:]))
    found = project(RATIONAL, points())
    np.testing.assert_allclose(found.pixels, theirs[:, 0], rtol=0, atol=1e-9)
    flat, seen = undistort(RATIONAL, found.pixels)
    assert seen.all()
    np.testing.assert_allclose(flat, points()[:, :2] / points()[:, 2:], rtol=0, atol=1e-12)


def test_the_derivative_of_the_rational_distortion_matches_central_differences() -> None:
    flat, h = np.random.default_rng(2).uniform(-0.8, 0.8, (50, 2)), 1e-6
    _, J = distort(RATIONAL, flat)
    for k in range(2):
        step = h * np.eye(2)[k]
        numeric = (distort(RATIONAL, flat + step)[0] - distort(RATIONAL, flat - step)[0]) / (2 * h)
        np.testing.assert_allclose(J[:, :, k], numeric, rtol=0, atol=1e-8)


def test_undistorting_undoes_the_lens() -> None:
    flat, found = undistort(LENS, see(EYE, points()))
    assert found.all()
    np.testing.assert_allclose(flat, points()[:, :2] / points()[:, 2:], rtol=0, atol=1e-12)


def test_pixels_beyond_the_fold_of_a_lens_have_no_direction() -> None:
    # r (1 - 2 r^2) is largest at r = 1 / sqrt(6), where it is 0.2722.
    camera = calib.measuring.Camera("tip", 1000.0, 1000.0, 0.0, 0.0, k1=-2.0)
    flat, found = undistort(
        camera.lens, np.array([[0.0, 0.0], [272.0, 0.0], [0.0, -272.0], [273.0, 0.0], [4000.0, 900.0]])
    )
    assert found.tolist() == [True, True, True, False, False]
    assert 0.39 < flat[1, 0] < 1 / np.sqrt(6)


def test_a_mark_in_the_camera_is_finite() -> None:
    found = project(LENS, np.zeros((1, 3)))
    assert np.isfinite(found.pixels).all() and np.isfinite(found.by_point).all() and not found.in_front.any()


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("fx", 0.0, "fx is 0 px; allowed is 1 to 1e\\+06 px"),
        ("fy", float("inf"), "fy is inf"),
        ("cx", float("nan"), "cx is nan px; allowed is -1e\\+06 to 1e\\+06 px"),
        ("k3", float("inf"), "k3 is inf"),
        ("fx", None, "fx is missing; fx, fy, cx, cy are given together"),
        ("free", ("f",), "'f' is not a number of a lens; they are fx, fy"),
        ("size", (0, 10), "size is 0 px; allowed is 16 to 100000 px"),
        ("sigma", -0.1, "sigma is -0.1 px; allowed is 0, or 0.0001 to 10000 px"),
        ("camera_on", "wall", "camera_on: 'wall' is not one of floor, tip"),
    ],
)
def test_impossible_cameras_are_refused(key: str, value: object, says: str) -> None:
    with pytest.raises(JobError, match=says):
        replace(calib.measuring.Camera("tip", **BENT), **{key: value})


def test_a_lens_of_which_nothing_is_known_needs_the_size_of_its_images() -> None:
    with pytest.raises(JobError, match="neither the lens nor the size of its images is given"):
        calib.measuring.Camera("tip", free=NAMES[:9])
    with pytest.raises(JobError, match="cx is neither given nor free"):
        calib.measuring.Camera("tip", free=("fx", "fy", "cy"), size=(640, 480))
    assert calib.measuring.Camera("tip", free=NAMES[:9], size=(641, 481)).lens == Lens(641.0, 641.0, 320.0, 240.0)


@pytest.mark.parametrize("sigma", [1e-4, 2.0, 20.0])
def test_a_camera_may_scatter_by_whole_pixels(sigma: float) -> None:
    """More than one pixel was refused, as more than a radian."""
    robot = calib.load_robot("example:ur_description/urdf/ur5_robot.urdf", tip="tool0")
    columns: dict[str, object] = {f"{reading.name} [rad]": [0.1, 0.2] for reading in robot.readings}
    columns |= {"u [px]": [300.0, 310.0], "v [px]": [200.0, 220.0]}
    data = calib.read_measurements(columns, robot, "pixels", instrument=eye("tip", sigma))
    assert np.all(data.sigma == sigma)
