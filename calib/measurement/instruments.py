"""Instruments and their noise: what the maker promises, as standard deviations."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import JobError

CameraPlace = Literal["floor", "tip"]


@dataclass(frozen=True, slots=True)
class LaserTracker:
    """A laser tracker whose noise grows with distance: sigma + sigma_per_metre * distance.

    Both are one standard deviation of each coordinate, in m and in m per m; ``station`` is where the tracker stands, in
    m, in the frame of its measurements: the origin, unless these were moved to another frame.

    Makers state a maximum permissible error (MPE) instead, of the same form after ISO 10360-10 annex D; the manual of
    the Leica AT500 calls typical results half of it, so the MPE is taken as two standard deviations. The Leica AT901's
    MPE of 15 um + 6 um/m becomes ``LaserTracker(7.5e-6, 3e-6)``. Nothing is said of the direction of the error, so
    all three coordinates have the same; along the beam a real tracker is better.

    Raises JobError when a number is negative or not finite.
    """

    sigma: float
    sigma_per_metre: float
    station: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name, value in (("sigma", self.sigma), ("sigma_per_metre", self.sigma_per_metre)):
            if not (np.isfinite(value) and value >= 0.0):
                raise JobError(f"laser tracker: {name} is {value}; allowed are finite numbers from 0.")
        if not np.isfinite(self.station).all():
            raise JobError(f"laser tracker: station is {self.station}; allowed are three finite numbers.")

    def sigma_at(self, points: Array) -> Array:
        """Return the standard deviation (N), in m, of each coordinate of points (N, 3), in m."""
        distance = np.linalg.norm(points - np.asarray(self.station), axis=-1)
        return np.asarray(self.sigma + self.sigma_per_metre * distance)


@dataclass(frozen=True, slots=True)
class Camera:
    """A calibrated camera in OpenCV's convention (:mod:`calib.measurement.projection`); where it is, is found.

    ``camera_on``: the "floor", seeing a board or a mark on the tool, or the "tip", seeing one that stays.
    ``fx``, ``fy``, ``cx``, ``cy`` in px: the camera matrix; ``k1``, ``k2``, ``p1``, ``p2``, ``k3``: the distortion, in
    OpenCV's order. ``sigma``: one standard deviation of each pixel coordinate, in px; 0 where it is not known.

    Raises JobError when a number cannot be used.
    """

    camera_on: CameraPlace
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    sigma: float = 0.0

    def __post_init__(self) -> None:
        if self.camera_on not in get_args(CameraPlace):
            raise JobError(f"camera: camera_on is {self.camera_on!r}; allowed are {', '.join(get_args(CameraPlace))}.")
        for name in ("fx", "fy"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise JobError(f"camera: {name} is {getattr(self, name)}; allowed are finite numbers above 0.")
        for name in ("cx", "cy", "k1", "k2", "p1", "p2", "k3"):
            if not np.isfinite(getattr(self, name)):
                raise JobError(f"camera: {name} is {getattr(self, name)}; allowed are finite numbers.")
        if not (np.isfinite(self.sigma) and self.sigma >= 0.0):
            raise JobError(f"camera: sigma is {self.sigma}; allowed are finite numbers from 0.")
