"""Lenses as OpenCV, ROS and Kalibr write them, and files that hold none."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from calib.foundations.errors import JobError
from calib.measurement.formats.lens_files import read_lens
from calib.measurement.lens import Lens

LENS = Lens(900.5, 901.5, 640.25, 360.75, -0.1, 0.02, 1e-4, -2e-4, 0.003)
ROS = """
image_width: 1280
image_height: 720
camera_name: eye
camera_matrix:
  rows: 3
  cols: 3
  data: [900.5, 0, 640.25, 0, 901.5, 360.75, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.1, 0.02, 0.0001, -0.0002, 0.003]
"""
KALIBR = """
cam0:
  camera_model: pinhole
  intrinsics: [900.5, 901.5, 640.25, 360.75]
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.02, 0.0001, -0.0002]
  resolution: [1280, 720]
"""


def read(folder: Path, text: str) -> tuple[Lens, tuple[int, int] | None]:
    (folder / "lens.yaml").write_text(text)
    return read_lens(folder / "lens.yaml")


def test_ros(tmp_path: Path) -> None:
    assert read(tmp_path, ROS) == (LENS, (1280, 720))


@pytest.mark.parametrize("names", [("camera_matrix", "dist_coeffs"), ("mtx", "dist"), ("K", "D")])
@pytest.mark.parametrize("shape", [(5,), (1, 5), (5, 1)])
def test_an_archive_of_numpy(tmp_path: Path, names: tuple[str, str], shape: tuple[int, ...]) -> None:
    K = np.array([[900.5, 0.0, 640.25], [0.0, 901.5, 360.75], [0.0, 0.0, 1.0]])
    bent = np.array([-0.1, 0.02, 1e-4, -2e-4, 0.003]).reshape(shape)
    arrays = dict(zip(names, (K, bent), strict=True))
    np.savez(tmp_path / "lens.npz", **arrays, rms=0.2, tvecs=np.ones((7, 3, 1)))
    assert read_lens(tmp_path / "lens.npz") == (LENS, None)
    np.savez(tmp_path / "lens.npz", **arrays, image_width=1280, image_height=720)
    assert read_lens(tmp_path / "lens.npz") == (LENS, (1280, 720))


def test_four_numbers_in_an_archive_may_be_of_a_fisheye(tmp_path: Path) -> None:
    """So cv2.fisheye.calibrate returns them, and nothing beside them says so; it was read as another lens."""
    path = tmp_path / "lens.npz"
    K, bent = np.array([[900.5, 0.0, 640.25], [0.0, 901.5, 360.75], [0.0, 0.0, 1.0]]), np.full((4, 1), 0.01)
    np.savez(path, K=K, D=bent, DIM=[1280, 720])
    with pytest.raises(JobError, match=r"lens\.npz: the distortion has 4 numbers, as a fisheye's has"):
        read_lens(path)
    lens = Lens(900.5, 901.5, 640.25, 360.75, k1=0.01, k2=0.01, p1=0.01, p2=0.01)
    np.savez(path, K=K, D=[*bent.ravel(), 0.0])
    assert read_lens(path) == (lens, None)
    np.savez(path, K=K, D=bent, distortion_model="plumb_bob")
    assert read_lens(path) == (lens, None)
    np.savez(path, K=K, D=np.zeros(4), dist=np.arange(5.0))  # of distances
    assert read_lens(path) == (Lens(900.5, 901.5, 640.25, 360.75), None)


def test_what_an_archive_has_beside_a_lens_may_be_large(tmp_path: Path) -> None:
    """An archive of 185 kB with 190 MB of zeros beside a lens took 12 s, and all of 4 GB, before it was refused."""
    K, bent = np.array([[900.5, 0.0, 640.25], [0.0, 901.5, 360.75], [0.0, 0.0, 1.0]]), [-0.1, 0.02, 1e-4, -2e-4, 0.003]
    np.savez_compressed(tmp_path / "lens.npz", mtx=K, dist=bent, mask=np.zeros(1_000_000, np.uint8))
    tracemalloc.start()
    assert read_lens(tmp_path / "lens.npz") == (LENS, None)
    largest = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert largest < 20_000_000


def test_an_archive_without_a_lens(tmp_path: Path) -> None:
    path = tmp_path / "lens.npz"
    np.savez(path, K=np.diag([900.0, 900.0, 1.0]))
    with pytest.raises(JobError, match=r"lens\.npz: states no distortion;"):
        read_lens(path)
    np.savez(path, p=np.ones(3))
    with pytest.raises(JobError, match=r"lens\.npz: holds no lens"):
        read_lens(path)
    path.write_bytes(b"PK")
    with pytest.raises(JobError, match=r"lens\.npz: is no archive of arrays that can be read\.$"):
        read_lens(path)


def test_a_message_as_rostopic_echo_prints_it(tmp_path: Path) -> None:
    message = """header:
  seq: 7
  frame_id: eye
height: 720
width: 1280
distortion_model: plumb_bob
D: [-0.1, 0.02, 0.0001, -0.0002, 0.003]
K: [900.5, 0, 640.25, 0, 901.5, 360.75, 0, 0, 1]
binning_x: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}
---
"""
    assert read(tmp_path, message) == (LENS, (1280, 720))
    with pytest.raises(JobError, match=r"has 2 documents, with --- between them; keep one\.$"):
        read(tmp_path, 2 * message)
    with pytest.raises(JobError, match="it is no mapping of names"):
        read(tmp_path, "---\n")


def test_names_as_the_example_of_opencv_writes_them(tmp_path: Path) -> None:
    text = ROS.replace("camera_matrix", "Camera_Matrix").replace("distortion_coeff", "Distortion_Coeff")
    assert read(tmp_path, text) == (LENS, (1280, 720))
    assert read(tmp_path, text.replace("image_w", "image_W").replace("image_h", "image_H")) == (LENS, (1280, 720))


def test_numbers_as_cpp_writes_them_are_no_texts(tmp_path: Path) -> None:
    assert read(tmp_path, ROS.replace("0.0001", "1e-4").replace("0.003", "3E-03")) == (LENS, (1280, 720))
    for wrong in ("1e999", "9" * 400, "one", ".nan", "2026-01-01"):
        with pytest.raises(JobError, match=r"the distortion is not a list of numbers\.$"):
            read(tmp_path, ROS.replace("0.003", wrong))


@pytest.mark.parametrize(
    "matrix",
    [
        "[900.5, 0, 0, 0, 901.5, 0, 640.25, 360.75, 1]",
        "[900.5, 3, 640.25, 0, 901.5, 360.75, 0, 0, 1]",
        "[900.5, 0, 640.25, 0, 901.5, 360.75, 0, 0, 2]",
    ],
)
def test_a_camera_matrix_by_columns_with_skew_or_scaled_is_refused(tmp_path: Path, matrix: str) -> None:
    with pytest.raises(JobError, match="read is fx, 0, cx, 0, fy, cy, 0, 0, 1, row by row"):
        read(tmp_path, ROS.replace("[900.5, 0, 640.25, 0, 901.5, 360.75, 0, 0, 1]", matrix))


def test_what_a_maker_calls_a_camera_is_no_model_of_its_lens(tmp_path: Path) -> None:
    assert read(tmp_path, ROS + "model: Blackfly S\n") == read(tmp_path, ROS)
    assert read(tmp_path, ROS + "camera_model: OmniVision OV9281\n") == read(tmp_path, ROS)
    assert read(tmp_path, ROS + "camera: fisheye_left\n") == read(tmp_path, ROS)


def test_a_number_with_a_zero_in_front_is_decimal(tmp_path: Path) -> None:
    assert read(tmp_path, ROS.replace("[900.5,", "[0900,"))[0].fx == 900.0
    assert read(tmp_path, ROS.replace("[900.5,", "[0240,"))[0].fx == 240.0


def test_kalibr(tmp_path: Path) -> None:
    assert read(tmp_path, KALIBR) == (LENS._replace(k3=0.0), (1280, 720))


def test_a_camera_info_as_ros2_topic_echo_prints_it(tmp_path: Path) -> None:
    text = "height: 720\nwidth: 1280\ndistortion_model: plumb_bob\nd: [-0.1, 0.02, 0.0001, -0.0002, 0.003]\n"
    text += "k: [900.5, 0, 640.25, 0, 901.5, 360.75, 0, 0, 1]\nbinning_x: 1\nbinning_y: 0\n"
    assert read(tmp_path, text + "roi: {x_offset: 0, y_offset: 0, height: 0, width: 0}\n") == (LENS, (1280, 720))


def test_opencv(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    storage = cv2.FileStorage(str(tmp_path / "own.yaml"), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", np.array([[900.5, 0, 640.25], [0, 901.5, 360.75], [0, 0, 1]]))
    storage.write("distortion_coefficients", np.array([[*LENS[4:9], 0.1, 0.2, 0.3]]))
    storage.release()
    lens, size = read_lens(tmp_path / "own.yaml")
    assert size is None
    np.testing.assert_allclose(lens, [*LENS[:9], 0.1, 0.2, 0.3], rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "it is no mapping of names"),
        ("a: 1", "neither camera_matrix of OpenCV or ROS, nor cam0 of Kalibr"),
        ("a: [", "is no YAML that can be read"),
        ("a: &x 1\nb: *x", "has anchors and aliases, which are not read"),
        ("a: &-x 1\nb: *-x", "has anchors and aliases, which are not read"),
        ("K: 1\nK: 2", "it has 'K' twice in one object"),
        ("K: " + 101 * "[", "is nested too deep"),
        ("K: " + 300_000 * "[", "is nested too deep"),
        (300_000 * "- ", "is nested too deep"),
        (ROS.replace("plumb_bob", "equidistant"), "'equidistant' is not one of plumb_bob"),
        (ROS.replace("0, 0, 1]", "0, 1]"), "the camera matrix has 8 numbers"),
        (ROS.replace("-0.0002", "x"), "the distortion is not a list of numbers"),
        (ROS.replace("-0.0002", "10:00"), "the distortion is not a list of numbers"),
        (KALIBR.replace("radtan", "equidistant"), "cam0 is of the models 'pinhole' and 'equidistant'"),
        (KALIBR.replace("900.5, ", ""), "intrinsics has 3 numbers"),
        (ROS.replace("1280", "-1280"), "image_width is '-1280'; allowed are whole numbers of pixels from 1"),
        (ROS.replace("720", "[720]"), "image_height is no number; allowed are whole numbers of pixels from 1"),
        (KALIBR.replace("[1280, ", "["), "resolution is no list of two numbers"),
        (KALIBR.replace("1280", "0"), "the width of resolution is '0'; allowed are whole numbers"),
        (ROS.replace("distortion_coefficients", "distortion_coefficient"), "states no distortion; it is called"),
        (ROS.partition("distortion_model")[0], "states no distortion; it is called"),
        (
            ROS.replace(", -0.0002, 0.003", "").replace("cols: 5", "cols: 3"),
            "the distortion has 3 numbers; allowed are",
        ),
        (ROS.replace(", 0.003", ""), "the distortion has 4 numbers, and says that it has 1 x 5"),
        (
            ROS.replace("0.003]", "0.003, 0, 0, 1]").replace("cols: 5", "cols: 8"),
            "the distortion has 8 numbers; read are",
        ),
        (ROS.replace("plumb_bob", "[plumb_bob]"), "is not one of plumb_bob"),
        (ROS + "fisheye_model: 1\n", "the lens is a fisheye"),
        (ROS + "camera_model: fisheye\n", "'camera_model' is 'fisheye', whose distortion is another"),
        (ROS + "model_type: KANNALA_BRANDT\n", "'model_type' is 'KANNALA_BRANDT', whose distortion is another"),
        (ROS + "binning_x: 2\nbinning_y: 2\n", "binning_x is '2': the numbers are of the whole sensor"),
        (ROS + "roi: {x_offset: 8, y_offset: 0}\n", "roi.x_offset is '8': the numbers are of the whole sensor"),
        ("K: [[1, 0, 2, 0], [1, 2], [0, 0, 1]]\nD: []", "the camera matrix has rows that are not equally long"),
        (KALIBR.replace("radtan", "none"), "the distortion has 4 numbers; read are none"),
        (KALIBR.replace("0.0001,", "0.0001, 0, 0, 1,"), "the distortion has 7 numbers; read are k1, k2, p1, p2"),
    ],
)
def test_what_is_no_lens_is_refused(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(JobError, match=says):
        read(tmp_path, text)
