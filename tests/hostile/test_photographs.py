"""Photographs in small files that would cost OpenCV the square of what they show, or much memory for each pixel."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from calib.foundations.arrays import Array  # noqa: E402
from calib.foundations.errors import MeasurementError  # noqa: E402
from calib.job.photographs import import_photographs  # noqa: E402
from calib.measurement.formats import images  # noqa: E402
from calib.measurement.formats.images import MOST_OUTLINES, MOST_SEARCHED, detector  # noqa: E402
from calib.measurement.prints import Print  # noqa: E402

CHARUCO = Print("charuco", (7, 5), 0.030, 0.022, "DICT_4X4_50")


def _hollow(side: int, cell: int = 24) -> Array:
    """Return an image full of hollow squares, each of which could be a marker."""
    near = np.minimum(np.arange(side) % cell, cell - 1 - np.arange(side) % cell)
    apart = np.minimum(near, near[:, None])
    return np.where((apart >= 2) & (apart < 5), 0, 255).astype(np.uint8)


def _outlines(grey: Array, least: float) -> int:
    """Return how many outlines OpenCV's detector of markers looks at."""
    dark = [
        cv2.adaptiveThreshold(grey, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, k, 7) for k in (3, 13, 23)
    ]
    found = (cv2.findContours(one, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0] for one in dark)
    return sum(len(outline) >= least for some in found for outline in some)


def _charuco() -> Array:
    board = cv2.aruco.CharucoBoard((7, 5), 0.03, 0.022, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    return np.asarray(
        cv2.copyMakeBorder(board.generateImage((924, 660)), 20, 20, 20, 20, cv2.BORDER_CONSTANT, value=255)
    )


def test_no_more_outlines_are_compared_than_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """And in one thread: in each OpenCV would keep outlines of its own."""
    grey, threads = _hollow(2000), cv2.getNumThreads()
    rates: list[float] = []
    assert _outlines(grey, 0.03 * 2000) > 2 * MOST_OUTLINES
    monkeypatch.setattr(cv2.aruco, "CharucoDetector", lambda _: Spy(rates))
    assert len(detector(CHARUCO)(grey).marks) == 0
    assert _outlines(grey, rates[0] * 2000) <= MOST_OUTLINES
    assert cv2.getNumThreads() == threads


class Spy:
    """Stands for OpenCV's detector; keeps how long outlines have to be."""

    def __init__(self, rates: list[float]) -> None:
        self.rates = rates

    def setDetectorParameters(self, parameters: object) -> None:
        self.rates.append(parameters.minMarkerPerimeterRate)  # type: ignore[attr-defined]

    def detectBoard(self, _: Array) -> tuple[None, None, None, None]:
        assert cv2.getNumThreads() == 1
        return None, None, None, None


def test_a_board_before_thousands_of_squares_is_found() -> None:
    grey = _hollow(2000)
    grey[600:1300, 500:1464] = _charuco()
    assert len(detector(CHARUCO)(grey).marks) == 24


def test_of_few_outlines_all_are_looked_at() -> None:
    parameters = cv2.aruco.DetectorParameters()
    for grey in (_charuco(), _hollow(300), _hollow(2000, 100)):
        least = images._least_outline(cv2, grey, parameters)
        assert least == pytest.approx(0.03 * max(grey.shape))


@pytest.mark.parametrize("kind", ["charuco", "chessboard"])
def test_a_board_in_many_pixels_is_looked_for_in_fewer(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """And its corners are those of all pixels."""
    board = CHARUCO if kind == "charuco" else Print("chessboard", (8, 5), 0.03)
    cells = np.kron((np.indices((5, 8)).sum(axis=0) % 2) * 200 + 20, np.ones((120, 120))).astype(np.uint8)
    drawn = _charuco()[20:-20, 20:-20] if kind == "charuco" else cells
    square = drawn.shape[0] / 5
    image = np.full((3600, 4200), 220, dtype=np.uint8)
    image[1400 : 1400 + drawn.shape[0], 2100 : 2100 + drawn.shape[1]] = drawn
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    sizes: list[int] = []
    make = getattr(images, f"_{kind}")

    def kept(*given: object, **more: object) -> Callable[[Array], object]:
        find = make(*given, **more)

        def finds(grey: Array) -> object:
            sizes.append(grey.size)
            return find(grey)

        return finds

    monkeypatch.setattr(images, f"_{kind}", kept)
    found = detector(board)(image)
    assert image.size > MOST_SEARCHED >= sizes[0]
    assert len(found.marks) == len(board.marks)
    true = np.array([2099.5, 1399.5]) + board.marks[found.marks, :2] / 0.03 * square
    np.testing.assert_allclose(found.pixels, true, atol=0.02)


def test_what_could_be_a_marker_is_compared_with_those_of_the_board_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A dictionary has up to a thousand, each of which is turned four ways."""
    known: list[int] = []
    make = cv2.aruco.CharucoDetector

    def kept(board: object) -> object:
        known.append(len(board.getDictionary().bytesList))  # type: ignore[attr-defined]
        return make(board)

    monkeypatch.setattr(cv2.aruco, "CharucoDetector", kept)
    detector(Print("charuco", (7, 5), 0.030, 0.022, "DICT_7X7_1000"))
    assert known == [17]


def test_names_of_thousands_of_photographs_are_looked_for_once(tmp_path: Path) -> None:
    """Ten thousand, and readings of twenty thousand, took as many looks as the product of both."""
    many = 5000
    (tmp_path / "photos").mkdir()
    for k in range(many):
        (tmp_path / "photos" / f"{k}.png").touch()
    rows = [f"{many + k}.png,0" for k in range(4 * many)]
    (tmp_path / "readings.csv").write_text("\n".join(["image,joint_1 [deg]", *rows]))
    begun = time.process_time()
    with pytest.raises(MeasurementError, match="0 of 5000 photographs can be used"):
        import_photographs(tmp_path / "photos", CHARUCO, tmp_path / "readings.csv")
    assert time.process_time() - begun < 3.0
