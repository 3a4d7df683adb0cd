"""Orientations as controllers and instruments write them, by name.

Capitals are turns about the axes that turn along, small letters about those that stay: ``"ZYX"`` of a, b, c is
Rz(a) Ry(b) Rx(c), ``"xyz"`` is Rz(c) Ry(b) Rx(a).
"""

import itertools

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import MeasurementError

ANGLES = ("rx", "ry", "rz")
MATRIX = tuple(f"r{i}{j}" for i in "123" for j in "123")
EULER: tuple[str, ...] = tuple(
    "".join(axes)
    for letters in ("XYZ", "xyz")
    for axes in itertools.product(letters, repeat=3)
    if axes[0] != axes[1] != axes[2]
)
# What makers call them: A, B, C of KUKA turn about z, y, x; W, P, R of FANUC, roll, pitch, yaw about fixed x, y, z.
MAKERS = {"abc": "ZYX", "wpr": "xyz", "rpy": "xyz"}
ORIENTATIONS: tuple[str, ...] = ("rotation_vector", "matrix", *MAKERS, *EULER)
# As of quaternions: three digits are enough.
_TOLERANCE = 2e-3


def rotations_of(angles: Array, orientation: str) -> Array:
    """Return the rotations (N, 3, 3) of three angles in rad (N, 3), or of nine numbers (N, 9) by rows."""
    if orientation == "matrix":
        return rigid.nearest_rotation(angles.reshape(-1, 3, 3))
    if orientation == "rotation_vector":
        return rigid.exp3(angles)
    order = MAKERS.get(orientation, orientation)
    turns = [rigid.rotation_about(np.eye(3)["XYZ".index(axis.upper())], angles[:, k]) for k, axis in enumerate(order)]
    first, second, third = turns if order.isupper() else turns[::-1]
    return np.asarray(first @ second @ third)


def quaternions_of(given: Array, orientation: str, where: str, lines: IntArray) -> Array:
    """Return unit quaternions (N, 4). Raises MeasurementError for an unknown name, and a matrix that is no rotation."""
    if orientation not in ORIENTATIONS:
        raise MeasurementError(
            f"{where}: orientation {orientation!r} is not known; allowed are {', '.join(ORIENTATIONS[:5])}, "
            "and the order of three turns, like ZYX about the turned axes (intrinsic), or xyz about fixed axes "
            "(extrinsic)."
        )
    if orientation == "matrix":
        matrices = given.reshape(-1, 3, 3)
        off = np.abs(np.swapaxes(matrices, 1, 2) @ matrices - np.eye(3)).max(axis=(1, 2)) > _TOLERANCE
        off |= np.linalg.det(matrices) < 0.0
        if off.any():
            raise MeasurementError(f"{where}:{lines[int(np.argmax(off))]}: r11 to r33 are no rotation.")
    return rigid.quaternion_of(rotations_of(given, orientation))
