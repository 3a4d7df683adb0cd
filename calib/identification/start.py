"""Start values of base and tool for any mixture of measurements."""

from collections.abc import Sequence

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.identification.alignment import align_poses, align_positions
from calib.identification.error_model import ErrorModel
from calib.identification.machine import Frames
from calib.measurement.measurements import Measurements


def start_frames(model: ErrorModel, sets: Sequence[Measurements]) -> Frames:
    """Return base and tools that explain the measurements best with the nominal robot; what is fixed stays as given.

    Poses, where there are any, place the base and the tools they saw; positions place the rest.
    """
    tools = sets[0].tools
    given = model.given_frames(tools)
    base = given.base if model.base == "fixed" else None
    points = given.tools[:, :3, 3] if model.tool == "fixed" else None
    rotations = None if model.tool == "pose" else given.tools[:, :3, :3]
    tips = [model.robot.tips(data.readings) for data in sets]
    poses = [i for i, data in enumerate(sets) if data.orientation is not None]
    placed = given.tools.copy()
    seen = np.zeros(len(tools), dtype=bool)
    if poses:
        tool = np.concatenate([sets[i].tool for i in poses])
        measured = np.concatenate([_poses(sets[i]) for i in poses])
        base, found = align_poses(
            np.concatenate([tips[i] for i in poses]), measured, tool, len(tools), base, rotations, points
        )
        seen[tool] = True
        placed[seen] = found[seen]
    positions = [i for i, data in enumerate(sets) if data.orientation is None]
    if positions:
        tool = np.concatenate([sets[i].tool for i in positions])
        measured = np.concatenate([sets[i].position for i in positions])
        base, found = align_positions(
            np.concatenate([tips[i] for i in positions]), measured, tool, len(tools), base, points
        )
        placed[~seen, :3, 3] = found[~seen]
    return Frames(given.base if base is None else base, placed)


def _poses(data: Measurements) -> Array:
    if data.orientation is None:
        raise TypeError("positions have no orientation")
    return rigid.placement(data.orientation, data.position)
