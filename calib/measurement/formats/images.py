"""Photographs of a board: which of its corners are where in each, and how sure that is. OpenCV finds the board.

OpenCV (Apache-2.0, extra ``calib[vision]``) tells which corner is which; where it is, :mod:`.corners` fits.
"""

import contextlib
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray, read_only
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.files import read_bytes
from calib.foundations.lazy import needed
from calib.foundations.linear import svd
from calib.foundations.native import heard
from calib.foundations.words import shown
from calib.measurement.formats.corners import LEAST_RADIUS, refine
from calib.measurement.formats.image_bytes import many_passes, pixels_of, unpadded, unturned
from calib.measurement.prints import Print

# What cameras write, by the ends of names.
ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".webp")
LARGEST_IMAGE, MOST_PIXELS, SMALLEST_SIDE = 200_000_000, 160_000_000, 16
# A photograph has some ten pixels for a byte of its file at most; more than thirty, of many, are of a file made to
# swell.
_FEW_PIXELS, _PIXELS_OF_A_BYTE = 20_000_000, 30
# What libjpeg says of data that it had to guess: what follows in the image may stand elsewhere.
_DAMAGED = "Corrupt JPEG data: "
# Pixels looked at around a corner, as a share of the way to what is printed next to it.
_SHARE = 0.85
# OpenCV takes 55 bytes for every pixel in which it looks for a chessboard, and for markers as many as 50: of more, it
# gets a smaller copy.
MOST_SEARCHED = 8_000_000
# OpenCV compares each with each what could be a marker: only the longest outlines are looked at. A board of a thousand
# markers has some ten for each.
MOST_OUTLINES = 15_000
# How near to its horizon a mark of a board may lie, where its middle is at 1.
_HORIZON = 1e-6
# Below so many corners a photograph tells no pose worth having.
LEAST_CORNERS = 6
# So many markers are seen twice where there are two boards with the same ones; one may be a mistake.
_SEEN_TWICE = 2
# Width of a small copy, in px.
_SMALL = 480
# Blur, in px, beyond which a photograph is said to be blurred.
MOST_BLUR = 4.0


class Detection(NamedTuple):
    """What a photograph shows of a board: which ``marks`` (n,), their ``pixels`` (n, 2), ``sigma`` (n,), ``blur`` (n,).

    Pixels as OpenCV counts them: the centre of the first one is 0, 0. ``twice``: no board is found as markers of it are
    seen twice, so that nobody knows which are its own.
    """

    marks: IntArray
    pixels: Array
    sigma: Array
    blur: Array
    twice: bool = False


def opencv() -> Any:
    """Return OpenCV. Raises JobError where it cannot be loaded, or is older than its detector of ChArUco boards."""
    absent = ', which is not installed: python -m pip install "urdf-calib[vision]"'
    with needed(JobError, "photographs need OpenCV", absent):
        cv2 = import_module("cv2")
    # What its readers of damaged images say on the terminal, ours say in a sentence.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    if not hasattr(cv2, "aruco") or not hasattr(cv2.aruco, "CharucoDetector"):
        raise JobError(f"OpenCV {cv2.__version__} is older than 4.7; python -m pip install -U opencv-python-headless.")
    return cv2


def dictionary(name: str, where: str = "board") -> Any:
    """Return OpenCV's dictionary of markers. Raises JobError for a name that it does not know, as of ``where``."""
    cv2 = opencv()
    number = getattr(cv2.aruco, name, None) if name.startswith("DICT_") else None
    if not isinstance(number, int):
        known = sorted(other for other in dir(cv2.aruco) if other.startswith("DICT_"))
        raise JobError(f"{where}: dictionary: {name!r} is none of OpenCV's: {', '.join(known)}.")
    return cv2.aruco.getPredefinedDictionary(number)


def marker_bits(print_: Print, where: str = "board") -> list[BoolArray]:
    """Return the cells of the markers of a board, True where white, in the order of its white squares.

    Raises JobError when the dictionary is not known or has too few, as of the board's file ``where``.
    """
    cv2, of = opencv(), dictionary(print_.dictionary, where)
    across, down = print_.squares
    needed = across * down // 2
    if (has := len(of.bytesList)) < needed:
        raise JobError(
            f"{where}: {across} x {down} squares need {needed} markers, and {print_.dictionary} has {has}; take a "
            "larger dictionary or fewer squares."
        )
    side = int(of.markerSize) + 2
    return [np.asarray(cv2.aruco.generateImageMarker(of, k, side) > 127) for k in range(needed)]


def read_image(file: Path) -> Array:
    """Return an image as grey values (h, w) of 8 bits, as it lies on the sensor: a turn that its file asks for is not.

    Cameras that feel which way is up ask for another turn in each photograph of a moving wrist, and a lens has none.
    Raises MeasurementError for what is no image, and for a damaged one.
    """
    data = read_bytes(file, MeasurementError, LARGEST_IMAGE)
    _look_before(data, file)
    cv2 = opencv()
    way = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION | cv2.IMREAD_ANYDEPTH
    try:
        with heard() as said:
            image = cv2.imdecode(np.frombuffer(unpadded(unturned(data)), np.uint8), way)
    except cv2.error as e:
        raise MeasurementError(f"{file}: OpenCV cannot read this image ({e.err}).") from e
    if image is None:
        raise MeasurementError(f"{file}: is not an image that OpenCV reads.")
    if damage := next((line.removeprefix(_DAMAGED) for line in said if line.startswith(_DAMAGED)), None):
        raise MeasurementError(f"{file}: is damaged ({shown(damage)}); copy it from the camera again.")
    return _of_8_bits(image, file)


def _look_before(data: bytes, file: Path) -> None:
    """Raise MeasurementError for what is no image of the kinds that are read, and for one that would take too much."""
    if (size := pixels_of(data)) is None:
        raise MeasurementError(f"{file}: is not an image that is read: PNG, JPEG, BMP, TIFF, PGM or WebP.")
    width, height = size
    if width * height > MOST_PIXELS:
        raise MeasurementError(f"{file}: has too many pixels; {MOST_PIXELS // 1_000_000} million are allowed.")
    if min(height, width) < SMALLEST_SIDE:
        raise MeasurementError(f"{file}: has {width} x {height} pixels; the smallest side allowed is {SMALLEST_SIDE}.")
    if width * height > max(_FEW_PIXELS, _PIXELS_OF_A_BYTE * len(data)):
        raise MeasurementError(
            f"{file}: has {width} x {height} pixels in {len(data)} bytes, as no photograph has; of more than "
            f"{_FEW_PIXELS // 1_000_000} million, {_PIXELS_OF_A_BYTE} for a byte are allowed."
        )
    if many_passes(data):
        raise MeasurementError(f"{file}: goes over its pixels more often than a photograph does; write it anew.")


def _of_8_bits(image: Any, file: Path) -> Array:
    """Return grey values of 8 bits: of more, the highest that are used, as cameras write 12 bits in 16."""
    if image.dtype == np.uint16:
        bits = max(int(image.max()).bit_length(), 8)
        image = (image >> (bits - 8)).astype(np.uint8)
    elif image.dtype != np.uint8:
        raise MeasurementError(f"{file}: has pixels of the kind {image.dtype}; whole numbers of 8 or 16 bits are read.")
    return np.asarray(image)


def thumbnail(grey: Array) -> bytes:
    """Return a small copy of an image as JPEG."""
    cv2 = opencv()
    h, w = grey.shape
    share = min(1.0, _SMALL / w)
    small = cv2.resize(grey, (max(round(w * share), 1), max(round(h * share), 1)), interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 70])[1])


def may_be_old(print_: Print) -> bool:
    """Return whether OpenCV before 4.6, as makers of boards still do, drew this board with its markers elsewhere."""
    return print_.kind == "charuco" and print_.squares[1] % 2 == 0


def detector(print_: Print, *, old: bool = False) -> Callable[[Array], Detection]:
    """Return a function that finds the corners of a board in an image of grey values (h, w); there may be none.

    ``old``: of a board that :func:`may_be_old`, which then begins with a white square. One that looks the same upside
    down may be found either way up.
    """
    cv2 = opencv()
    find = _charuco(cv2, print_, old=old) if print_.kind == "charuco" else _chessboard(cv2, print_)

    def detect(grey: Array) -> Detection:
        searched = _searched(cv2, grey)
        marks, pixels, twice = find(searched)
        if len(marks) < 4:
            return NOTHING_SEEN._replace(twice=twice)
        # Pixels are counted from the middle of the first one.
        pixels = (pixels + 0.5) * (np.array(grey.shape[::-1]) / searched.shape[::-1]) - 0.5
        along, free = _edges(print_, marks, pixels)
        corners = refine(grey, pixels, along, _SHARE * free)
        good = corners.good & (free * _SHARE >= LEAST_RADIUS * 0.8)
        pixels, sigma, blur = (read_only(a[good]) for a in corners[:3])
        return Detection(marks[good], pixels, sigma, blur)

    return detect


NOTHING_SEEN = Detection(np.zeros(0, dtype=np.intp), np.zeros((0, 2)), np.zeros(0), np.zeros(0))


def _searched(cv2: Any, grey: Array) -> Array:
    """Return an image in which a board is looked for: itself, or a smaller copy of a large one."""
    share = min(1.0, float(np.sqrt(MOST_SEARCHED / grey.size)))
    h, w = (max(int(side * share), 1) for side in grey.shape)
    return grey if share == 1.0 else np.asarray(cv2.resize(grey, (w, h), interpolation=cv2.INTER_AREA))


def _charuco(cv2: Any, print_: Print, *, old: bool) -> Callable[[Array], tuple[IntArray, Array, bool]]:
    used, known = len(marker_bits(print_)), dictionary(print_.dictionary)
    # All that could be a marker is compared with all of these: those of the board alone.
    known = cv2.aruco.Dictionary(known.bytesList[:used], known.markerSize, known.maxCorrectionBits)
    board = cv2.aruco.CharucoBoard(print_.squares, print_.square, print_.marker, known)
    board.setLegacyPattern(old)
    found = cv2.aruco.CharucoDetector(board)

    def find(grey: Array) -> tuple[IntArray, Array, bool]:
        parameters = cv2.aruco.DetectorParameters()
        with _one_thread(cv2):
            parameters.minMarkerPerimeterRate = _least_outline(cv2, grey, parameters) / max(grey.shape)
            found.setDetectorParameters(parameters)
            corners, ids, _, markers = found.detectBoard(grey)
        twice = markers is not None and int((np.bincount(markers.ravel()) > 1).sum()) >= _SEEN_TWICE
        if ids is None or corners is None:
            return NOTHING_SEEN.marks, NOTHING_SEEN.pixels, twice
        return ids.ravel().astype(np.intp), corners.reshape(-1, 2).astype(np.float64), twice

    return find


@contextlib.contextmanager
def _one_thread(cv2: Any) -> Iterator[None]:
    """Let OpenCV work in one thread: each would keep the outlines of one threshold, and pieces several times."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def _least_outline(cv2: Any, grey: Array, parameters: Any) -> float:
    """Return the length, in px, of the shortest outlines that are looked at, so that they are no more than allowed.

    Outlines are those of what is dark, and of holes in it, by the thresholds of OpenCV's detector of markers.
    """
    least = float(parameters.minMarkerPerimeterRate * max(grey.shape))
    first, last = parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax
    darks = [
        cv2.adaptiveThreshold(
            grey, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, window, parameters.adaptiveThreshConstant
        )
        for window in range(first, last + 1, parameters.adaptiveThreshWinSizeStep)
    ]
    # An outline is no longer than the sides of pixels in it, of which each is in one: mostly there is room for few.
    changes = sum(
        int(cv2.countNonZero(cv2.absdiff(a, b)))
        for dark in darks
        for a, b in ((dark[1:], dark[:-1]), (dark[:, 1:], dark[:, :-1]))
    )
    if changes <= MOST_OUTLINES * least:
        return least
    lengths = [_lengths(cv2, dark, 8, 0) for dark in darks] + [_lengths(cv2, 255 - dark, 4, 4) for dark in darks]
    longest = np.sort(np.concatenate([some[some >= least] for some in lengths]))[::-1]
    return least if len(longest) <= MOST_OUTLINES else float(longest[MOST_OUTLINES] + 1)


def _lengths(cv2: Any, part: Array, connected: int, around: int) -> IntArray:
    """Return how long the outlines of the connected pieces of a part of an image are, in px, if they are convex.

    They are no longer than the sides of the rectangle around them; that of a hole lies ``around`` it.
    """
    across_down = cv2.connectedComponentsWithStats(part, connectivity=connected)[2][1:, 2:4]
    return np.asarray(2 * (across_down.sum(axis=1) + around), dtype=np.intp)


def _chessboard(cv2: Any, print_: Print) -> Callable[[Array], tuple[IntArray, Array, bool]]:
    across, down = print_.squares[0] - 1, print_.squares[1] - 1

    def find(grey: Array) -> tuple[IntArray, Array, bool]:
        # As it is, and with its grey values spread evenly: this shows a faint board, and makes noise of a dark room.
        for way in (0, cv2.CALIB_CB_NORMALIZE_IMAGE):
            seen, corners = cv2.findChessboardCornersSB(grey, (across, down), flags=way)
            if seen:
                break
        else:
            return NOTHING_SEEN.marks, NOTHING_SEEN.pixels, False
        pixels = corners.reshape(-1, 2).astype(np.float64)
        grid = pixels.reshape(down, across, 2)
        # Corners have black squares on their outer sides and white ones: the first one's is black.
        first, beside, last = (_outside(grey, grid, i, j) for i, j in ((0, 0), (0, -1), (-1, -1)))
        if across == down and down % 2 and first > beside:
            pixels = np.rot90(grid).reshape(-1, 2)
        elif first > last:
            pixels = pixels[::-1]
        return np.arange(across * down, dtype=np.intp), pixels, False

    return find


def _outside(grey: Array, grid: Array, i: int, j: int) -> float:
    """Return the grey in the middle of the square that lies outside of a corner (0 or -1) of the grid of corners."""
    inwards = [1 + 2 * k for k in (i, j)]
    at = grid[i, j] + 0.5 * (grid[i, j] - grid[i + inwards[0], j]) + 0.5 * (grid[i, j] - grid[i, j + inwards[1]])
    x, y = np.clip(np.rint(at), 0, np.array(grey.shape[::-1]) - 1).astype(int)
    return float(np.median(grey[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]))


def _edges(print_: Print, marks: IntArray, pixels: Array) -> tuple[Array, Array]:
    """Return the unit directions (n, 2, 2) of the two edges at corners, and how far (n,) from them all is plain, in px.

    By the homography of all corners, bent as the image may be: near a corner it is off by little.
    """
    places = print_.marks[marks][:, :2]
    H = _homography(places, pixels)
    y = np.column_stack([places, np.ones(len(places))]) @ H.T
    w = np.maximum(y[:, 2:], _HORIZON)
    J = (H[None, :2, :2] - (y[:, :2] / w)[:, :, None] * H[None, 2:, :2]) / w[:, :, None]
    along = np.swapaxes(J / np.maximum(np.linalg.norm(J, axis=1, keepdims=True), _HORIZON), 1, 2)
    # The next thing printed is the marker's edge, across the diagonal; a chessboard has its next corner.
    plain = 0.5 * (print_.square - print_.marker) * np.sqrt(2.0) if print_.kind == "charuco" else print_.square
    smallest = np.linalg.svd(J, compute_uv=False)[:, -1]
    # Corners that are no board's may lie on its horizon or beyond: they have no room.
    return np.asarray(along), np.asarray(np.where(y[:, 2] > _HORIZON, plain * smallest, 0.0))


def _homography(places: Array, pixels: Array) -> Array:
    """Return the homography (3, 3) from places (n, 2) to pixels (n, 2), by the direct linear transformation."""
    A, p = _normalised(places)
    B, q = _normalised(pixels)
    zero = np.zeros_like(p)
    rows = np.concatenate([np.hstack([p, zero, -q[:, :1] * p]), np.hstack([zero, p, -q[:, 1:2] * p])])
    H = svd(rows, full_matrices=True)[2][-1].reshape(3, 3)
    found = np.linalg.inv(B) @ H @ A
    middle = float(found[2] @ np.append(places.mean(axis=0), 1.0))
    return np.asarray(found / middle if abs(middle) > _HORIZON * np.abs(found[2]).max() else np.zeros((3, 3)))


def _normalised(x: Array) -> tuple[Array, Array]:
    middle = x.mean(axis=0)
    s = 1.0 / max(float(np.abs(x - middle).max()), 1e-12)
    T = np.array([[s, 0.0, -s * middle[0]], [0.0, s, -s * middle[1]], [0.0, 0.0, 1.0]])
    return T, np.column_stack([x, np.ones(len(x))]) @ T.T
