"""OpenCV's lens calibration, then its five hand-eye methods, on files of scripts/studies/hand_eye_peers.py.

    python run_opencv_hand_eye.py CASE.npz FOUND.npz

Started by an interpreter with OpenCV 4 (version 5 has no ``calibrateHandEye``); needs nothing of the toolkit. CASE has
``board`` (m, 3), ``corners`` (n, m, 2) in px, ``flanges`` (n, 4, 4) of the nominal robot, and ``size`` of images. FOUND
has ``K`` (3, 3), ``k`` (5,), and of every method in ``methods`` the camera on the flange in ``cameras`` (5, 4, 4).
"""

import sys

import cv2
import numpy as np

METHODS = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")


def main() -> None:
    case = np.load(sys.argv[1])
    board, corners, flanges = case["board"].astype(np.float32), case["corners"].astype(np.float32), case["flanges"]
    size = tuple(int(n) for n in case["size"])
    _, K, k, turns, shifts = cv2.calibrateCamera([board] * len(corners), list(corners), size, None, None)
    marks = [cv2.Rodrigues(turn)[0] for turn in turns]
    cameras = []
    for name in METHODS:
        method = getattr(cv2, f"CALIB_HAND_EYE_{name}")
        R, t = cv2.calibrateHandEye(list(flanges[:, :3, :3]), list(flanges[:, :3, 3]), marks, shifts, method=method)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, t.ravel()
        cameras.append(T)
    np.savez(sys.argv[2], K=K, k=k.ravel()[:5], methods=np.array(METHODS), cameras=np.array(cameras))


if __name__ == "__main__":
    main()
