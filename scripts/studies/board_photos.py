"""What a printed board is like: photographs of one by themselves, judged by photographs held out.

    python scripts/studies/board_photos.py <board_photos folder> [--markdown FILE]

Four folds of whole photographs; the pose of each one held out is found from itself. Corners are those of this project,
and beside them those of OpenCV's own detector.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from calib.foundations.linear import one_thread
from calib.identification.photographs import Photograph, found_optics, held_out
from calib.measurement.formats.images import Detection, detector, read_image
from calib.measurement.lens import BENT, CENTRE, FOCAL, RATIONAL, Lens
from calib.measurement.prints import Print

PRINT = Print("charuco", (7, 5), 0.030, 0.022, "DICT_4X4_50")
FIVE = (*FOCAL, *CENTRE, *BENT)


def opencv(grey: np.ndarray) -> Detection:
    """The corners that OpenCV finds, all alike."""
    of = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard((7, 5), 0.030, 0.022, of)).detectBoard(grey)
    n = len(ids)
    return Detection(ids.ravel().astype(np.intp), corners.reshape(-1, 2).astype(float), np.ones(n), np.ones(n))


def figure(seen: list[Detection], shape: str, free: tuple[str, ...], size: tuple[int, int]) -> float:
    """Two-dimensional rms of the photographs held out, in px."""
    board = Print("charuco", (7, 5), 0.030, 0.022, "DICT_4X4_50", shape=shape).board()
    some = [
        Photograph(d.pixels, board.marks[d.marks], board.modes[d.marks], np.repeat(d.sigma[:, None], 2, axis=1))
        for d in seen
    ]
    start = Lens(float(size[0]), float(size[0]), 0.5 * (size[0] - 1), 0.5 * (size[1] - 1))
    found = found_optics(some, free, start)
    assert found is not None
    return float(np.sqrt(np.average(held_out(some, free, found), weights=[len(d.marks) for d in seen])))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--markdown", type=Path)
    given = parser.parse_args()
    images = [read_image(file) for file in sorted(given.folder.glob("*.jpg"))]
    height, width = images[0].shape
    ours, theirs = [detector(PRINT)(image) for image in images], [opencv(image) for image in images]
    lines = ["| board | corners of OpenCV | corners fitted | and eight numbers of distortion |", "|---|---|---|---|"]
    with one_thread():
        for shape in ("flat", "quadratic", "free"):
            figures = [
                figure(seen, shape, free, (width, height))
                for seen, free in ((theirs, FIVE), (ours, FIVE), (ours, (*FIVE, *RATIONAL)))
            ]
            lines.append(f"| {shape} | " + " | ".join(f"{value:.3f}" for value in figures) + " |")
    table = "\n".join(lines) + "\n"
    print(table)
    if given.markdown is not None:
        given.markdown.write_text(table, encoding="utf-8")
