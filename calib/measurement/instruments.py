"""Instruments and their noise: what the maker promises, as standard deviations."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from calib.foundations.arguments import refuse_fields
from calib.foundations.arrays import Array
from calib.foundations.brief import brief
from calib.foundations.errors import JobError
from calib.foundations.ranges import refuse_beyond

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

    Raises JobError when a number is out of range.
    """

    sigma: float
    sigma_per_metre: float
    station: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        refuse_fields(self)
        refuse_beyond(self.sigma, "instruments.sigma", "laser tracker: sigma")
        refuse_beyond(self.sigma_per_metre, "sigma_per_metre", "laser tracker: sigma_per_metre")
        refuse_beyond(self.station, "position, station, point", "laser tracker: station")

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

    __repr__ = brief

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
        refuse_fields(self)
        if self.camera_on not in get_args(CameraPlace):
            raise JobError(f"camera: camera_on is {self.camera_on!r}; allowed are {', '.join(get_args(CameraPlace))}.")
        for names in ("fx, fy", "cx, cy", "k1, k2, p1, p2, k3"):
            for name in names.split(", "):
                refuse_beyond(getattr(self, name), names, f"camera: {name}")
        refuse_beyond(self.sigma, "instruments.sigma of a camera", "camera: sigma")
