"""Start values of lenses: where nothing is known of one, what photographs of boards say of it by themselves."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.foundations.arrays import evenly
from calib.foundations.errors import MeasurementError
from calib.identification.photographs import Optics, Photograph, found_optics, poses_of
from calib.measurement.instruments import Camera
from calib.measurement.lens import Lens
from calib.measurement.measurements import Measurements
from calib.measurement.optics import lens_scalars

# A board that is seen once says too little of a lens of which nothing is known.
LEAST_PHOTOGRAPHS, LEAST_MARKS = 3, 4
# More of them make no better start.
_ENOUGH = 60


def photographs_of(data: Measurements) -> list[Photograph]:
    """Return the photographs of boards in a set of pixels: rows of one target and tool with the same readings."""
    at = np.column_stack([data.readings, data.tool, data.setup, data.target])
    number = np.unique(at, axis=0, return_inverse=True)[1].ravel()
    # In the order of the table.
    order = np.argsort([int(np.argmax(number == k)) for k in range(int(number.max(initial=-1)) + 1)])
    modes = None if data.board is None or data.mark is None else data.board.modes[data.mark]
    found = []
    for k in order:
        rows = np.flatnonzero(number == k)
        if len(rows) >= LEAST_MARKS:
            sigma = data.sigma[rows]
            found.append(
                Photograph(
                    data.value[rows, :2],
                    data.value[rows, 2:],
                    np.zeros((len(rows), 3, 0)) if modes is None else modes[rows],
                    np.where(sigma > 0.0, sigma, 1.0),
                )
            )
    return found


def legible(photographs: Sequence[Photograph], lens: Lens) -> list[Photograph]:
    """Return the photographs that tell a pose of the board."""
    if not photographs:
        return []
    shape = np.zeros(photographs[0].modes.shape[2])
    _, told = poses_of(photographs, Optics(lens, shape))
    return [photograph for photograph, good in zip(photographs, told, strict=True) if good]


def with_found_lenses(
    sets: Sequence[Measurements], known: Mapping[str, float] | None = None
) -> tuple[Measurements, ...]:
    """Return the sets with lenses to start from, as their cameras and their scalars have them.

    ``known``: values of scalars that another calibration has found, by name.

    Raises MeasurementError where photographs do not tell a lens of which nothing is known.
    """
    begun = dict(known or {})
    lenses: dict[str, Camera] = {}
    for data in sets:
        camera = data.camera
        if camera is None or not camera.free or camera.name in lenses:
            continue
        named = {role: one.name for role, one in lens_scalars(camera).items()}
        if set(named.values()) <= begun.keys():
            lens = camera.lens._replace(**{role: begun[name] for role, name in named.items()})
        elif camera.unknown:
            lens = _found(camera, [other for other in sets if other.camera == camera])
        else:
            continue
        lenses[camera.name] = replace(camera, **lens._asdict())
    return tuple(_with(data, lenses) for data in sets) if lenses else tuple(sets)


def _with(data: Measurements, lenses: Mapping[str, Camera]) -> Measurements:
    starts = {
        one.name: getattr(camera, role) for camera in lenses.values() for role, one in lens_scalars(camera).items()
    }
    # A stated prior stays about what was given with it.
    scalars = tuple(
        one if one.prior is not None else replace(one, start=starts.get(one.name, one.start)) for one in data.scalars
    )
    camera = None if data.camera is None else lenses.get(data.camera.name, data.camera)
    return replace(data, camera=camera, scalars=scalars)


def _found(camera: Camera, sets: Sequence[Measurements]) -> Lens:
    """Return the lens that photographs of flat boards show by themselves."""
    own = [
        photograph._replace(modes=photograph.modes[:, :, :0]) for data in sets for photograph in photographs_of(data)
    ]
    own = legible(own, camera.lens)
    own = own[evenly(len(own), _ENOUGH)]
    found = found_optics(own, camera.free, camera.lens) if len(own) >= LEAST_PHOTOGRAPHS else None
    if found is None:
        raise MeasurementError(
            f"{sets[0].where}: nothing is known of the lens of {camera.name!r}, and {len(own)} photographs of a board "
            f"are too few to find it; needed are {LEAST_PHOTOGRAPHS} with {LEAST_MARKS} marks each, or fx, fy, cx, cy."
        )
    return found.optics.lens
