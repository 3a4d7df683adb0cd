"""Instruments and their noise: what the maker promises, as standard deviations."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from calib.foundations.arguments import checked, own_fields
from calib.foundations.arrays import Array
from calib.foundations.brief import brief
from calib.foundations.errors import JobError
from calib.foundations.ranges import refuse_beyond, refuse_shape
from calib.foundations.units import DEG
from calib.foundations.words import refuse_other
from calib.measurement.lens import CENTRE, FOCAL, NAMES, Lens

CameraPlace = Literal["floor", "tip"]
ONLY_CAMERA = "camera"


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
        own_fields(self)
        refuse_beyond(self.sigma, "instruments.sigma", "laser tracker: sigma")
        refuse_beyond(self.sigma_per_metre, "sigma_per_metre", "laser tracker: sigma_per_metre")
        refuse_beyond(self.station, "position, station, point", "laser tracker: station")

    @checked
    def sigma_at(self, points: Array) -> Array:
        """Return the standard deviation (N), in m, of each coordinate of points (N, 3), in m. Raises JobError."""
        refuse_shape(points, (None, 3), "points")
        distance = np.linalg.norm(points - np.asarray(self.station), axis=-1)
        return np.asarray(self.sigma + self.sigma_per_metre * distance)


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera in OpenCV's convention (:mod:`calib.measurement.projection`); where it is, is found.

    ``camera_on``: the "floor", seeing a board or a mark on the tool, or the "tip", seeing one that stays.
    ``fx``, ``fy``, ``cx``, ``cy`` in px: the camera matrix; ``k1``, ``k2``, ``p1``, ``p2``, ``k3``, ``k4``, ``k5``,
    ``k6``: the distortion, in OpenCV's order. ``sigma``: one standard deviation of each pixel coordinate, in px; 0
    where it is not known. ``free``: which of these numbers are to be found, from what is given or, where nothing is,
    from the ``size`` of the images in px and what they show. ``lens_sigma``: by name, the standard deviations that free
    numbers are expected to have about those given, where something is known of that. ``name``: tables of one name are
    of one camera. ``found``: whether its numbers are what photographs have shown at first, and nobody gave them.

        calib.measuring.Camera("tip", free=("fx", "fy", "cx", "cy", "k1", "k2"), size=(1920, 1080))

    Raises JobError when a number cannot be used.
    """

    __repr__ = brief

    camera_on: CameraPlace
    fx: float | None = None
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    sigma: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    free: tuple[str, ...] = ()
    size: tuple[int, int] | None = None
    name: str = ONLY_CAMERA
    found: bool = False
    lens_sigma: Mapping[str, float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_other(self.camera_on, get_args(CameraPlace), "camera: camera_on")
        for name in NAMES:
            if (value := getattr(self, name)) is not None:
                refuse_beyond(value, next(group for group in _GROUPS if name in group.split(", ")), f"camera: {name}")
        refuse_beyond(self.sigma, "instruments.sigma of a camera", "camera: sigma")
        if alien := next((name for name in self.free if name not in NAMES), None):
            raise JobError(f"camera: {alien!r} is not a number of a lens; they are {', '.join(NAMES)}.")
        for length in self.size or ():
            refuse_beyond(length, "size", "camera: size")
        missing = [name for name in (*FOCAL, *CENTRE) if getattr(self, name) is None]
        if missing and not self.unknown:
            raise JobError(f"camera: {missing[0]} is missing; fx, fy, cx, cy are given together.")
        if held := [name for name in missing if name not in self.free]:
            raise JobError(f"camera: {held[0]} is neither given nor free.")
        for name, sigma in self.lens_sigma.items():
            if name not in self.free:
                raise JobError(f"camera: lens_sigma: {name!r} is not a free number of the lens.")
            if missing:
                raise JobError(
                    f"camera: lens_sigma: {name!r} is expected near a given value, and fx, fy, cx, cy are not given; "
                    "give them, or leave lens_sigma out."
                )
            of = "lens_sigma" if name in (*FOCAL, *CENTRE) else "lens_sigma of distortion"
            refuse_beyond(sigma, of, f"camera: lens_sigma of {name}")
        if missing and self.size is None:
            raise JobError(
                "camera: neither the lens nor the size of its images is given; give fx, fy, cx, cy, or the size, from "
                "which the search for the lens begins."
            )

    @property
    def unknown(self) -> bool:
        """Whether nothing is known of the lens."""
        return self.fx is None and self.fy is None and self.cx is None and self.cy is None

    @property
    def lens(self) -> Lens:
        """The lens as given; where nothing is, a wide one that looks at the middle of the images."""
        if self.fx is None or self.fy is None or self.cx is None or self.cy is None:
            width, height = self.size or (1, 1)
            return Lens(float(width), float(width), 0.5 * (width - 1), 0.5 * (height - 1))
        bent = (self.k1, self.k2, self.p1, self.p2, self.k3, self.k4, self.k5, self.k6)
        return Lens(self.fx, self.fy, self.cx, self.cy, *bent)


# The ranges of the numbers of a lens are told under these names.
_GROUPS = ("fx, fy", "cx, cy", "k1, k2, p1, p2, k3, k4, k5, k6")

# Focal lengths in longer sides of an image. No lens of this model sees as much, or as little, as beyond these.
_LEAST_FOCAL, _MOST_FOCAL = 0.1, 100.0


def refuse_other_focal_lengths(camera: Camera, where: str) -> None:
    """Raise JobError for focal lengths in another unit, as mm or thousands of px, where the size of images tells."""
    longest = max(camera.size or (0,))
    for name in FOCAL:
        value = getattr(camera, name)
        if longest and value is not None and not _LEAST_FOCAL * longest <= value <= _MOST_FOCAL * longest:
            view = 2.0 * np.arctan(0.5 * longest / value) / DEG
            raise JobError(
                f"{where}.{name}: {value:.7g} px would see {view:.3g} deg in images of {longest} px; allowed are "
                f"{_LEAST_FOCAL:g} to {_MOST_FOCAL:g} times their longer side."
            )
