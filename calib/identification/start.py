"""Start values of base and tool for any mixture of measurements."""

from collections.abc import Sequence

import numpy as np

from calib.foundations.arrays import Array
from calib.identification.alignment import Known, Rows, align
from calib.identification.error_model import ErrorModel
from calib.identification.machine import Frames
from calib.measurement.measurements import Measurements


def start_frames(model: ErrorModel, sets: Sequence[Measurements]) -> Frames:
    """Return base and tools that explain the measurements best with the nominal robot; what is fixed stays as given."""
    given = model.given_frames(sets[0].tools)
    rows = Rows(
        np.concatenate([model.robot.tips(data.readings) for data in sets]),
        np.concatenate([data.position for data in sets]),
        np.concatenate([_orientation(data) for data in sets]),
        np.concatenate([data.tool for data in sets]),
    )
    known = Known(
        given.base if model.base == "fixed" else None,
        given.tools[:, :3, 3] if model.tool == "fixed" else None,
        None if model.tool == "pose" else given.tools[:, :3, :3],
    )
    return Frames(*align(rows, known, given.tools))


def _orientation(data: Measurements) -> Array:
    return np.full((len(data), 3, 3), np.nan) if data.orientation is None else data.orientation
