"""OpenCV's own way from photographs to hand-eye: corners, lens, a pose a photograph, and each of its five methods.

    python run_opencv.py <case folder> <poses.csv> <out.json>

The case folder is one of scripts/simulate/photographs.py; ``poses.csv`` has the pose of the flange at the photographs
to identify from. Needs OpenCV 4.7 to 4.x: calibrateHandEye is not in OpenCV 5. easy_handeye2 calls the same function.
"""

import csv
import json
import sys
import tomllib
from pathlib import Path

import cv2
import numpy as np

METHODS = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")


def main() -> int:
    folder, poses, out = map(Path, sys.argv[1:4])
    if not hasattr(cv2, "calibrateHandEye"):
        print(f"OpenCV {cv2.__version__} has no calibrateHandEye; it needs version 4.", file=sys.stderr)
        return 1
    board = tomllib.loads((folder / "board.toml").read_text())
    square, marker = (1e-3 * float(board[key].removesuffix(" mm")) for key in ("square", "marker"))
    of = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board["dictionary"]))
    printed = cv2.aruco.CharucoBoard(tuple(board["squares"]), square, marker, of)
    detector = cv2.aruco.CharucoDetector(printed)
    marks = printed.getChessboardCorners().astype(np.float32)
    rows = [row for row in csv.DictReader(poses.open()) if row["image"]]
    places, pixels, flange = [], [], []
    for row in rows:
        image = cv2.imread(str(folder / "photographs" / row["image"]), cv2.IMREAD_GRAYSCALE)
        corners, ids, _, _ = detector.detectBoard(image)
        if ids is None or len(ids) < 6:
            continue
        places.append(marks[ids.ravel()])
        pixels.append(corners.astype(np.float32))
        flange.append(np.array([[float(row[f"m{i}{j}"]) for j in range(4)] for i in range(4)]))
    rms, K, bent, turns, moves = cv2.calibrateCamera(places, pixels, image.shape[::-1], None, None)
    R, t = [T[:3, :3] for T in flange], [T[:3, 3] for T in flange]
    found = {}
    for name in METHODS:
        method = getattr(cv2, f"CALIB_HAND_EYE_{name}")
        X = np.eye(4)
        X[:3, :3], X[:3, 3:] = cv2.calibrateHandEye(R, t, [cv2.Rodrigues(r)[0] for r in turns], moves, method=method)
        found[name] = X.tolist()
    boards = [np.vstack([np.hstack([cv2.Rodrigues(r)[0], m]), [0, 0, 0, 1]]) for r, m in zip(turns, moves, strict=True)]
    out.write_text(
        json.dumps(
            {
                "version": cv2.__version__,
                "rms": rms,
                "K": K.tolist(),
                "bent": bent.ravel().tolist(),
                "flange": [T.tolist() for T in flange],
                "boards": [T.tolist() for T in boards],
                "hand_eye": found,
            }
        )
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
