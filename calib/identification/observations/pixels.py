"""Observation ``pixels``: a camera saw a mark of a board; one of them is on the tool, the other one is the target."""

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.identification.observations.seen import Linearised, Seen, by_twist
from calib.measurement.boards import places_of
from calib.measurement.lens import NAMES
from calib.measurement.optics import SCALE, lens_at, shape_at
from calib.measurement.projection import by_lens, project


def residual(seen: Seen) -> Linearised:
    """Return r = (u, v)_measured - project(Y) (n, 2) in px, with Y = T_camera^-1 T_board p of the mark at p.

    What is unknown of the lens, and of the board's scale and shape, is what ``seen.scalars`` say.
    """
    data, camera = seen.data, seen.data.camera
    assert camera is not None, "pixels were seen by a camera"
    value, lens = data.value[seen.rows], lens_at(camera, seen.scalars)
    by_tool = camera.camera_on == "tip"
    cameras, boards = (seen.tools, seen.targets) if by_tool else (seen.targets, seen.tools)
    places, by_shape = _places(seen)
    turn, marks = marks_seen(cameras, boards, places)
    projected = project(lens, marks)
    by_place = -projected.by_point @ turn
    # The board moved by (v, w): dY = R (v + w x p); the camera: dY = -v - w x Y.
    by_board = np.concatenate([by_place, -by_place @ rigid.skew(places)], axis=2)
    by_camera = projected.by_point @ np.concatenate(
        [np.broadcast_to(np.eye(3), turn.shape), -rigid.skew(marks)], axis=2
    )
    twist, target = (by_camera, by_board) if by_tool else (by_board, by_camera)
    scalars = {role: (by_place @ column[:, :, None])[:, :, 0] for role, column in by_shape.items()}
    if camera.free:
        by_number = by_lens(lens, projected.flat)
        scalars |= {name: -by_number[:, :, NAMES.index(name)] for name in camera.free if name in seen.scalars}
    tool = (by_twist(twist, seen.tools),)
    return Linearised(value[:, :2] - projected.pixels, tool, target=target, scalars=scalars)


def _places(seen: Seen) -> tuple[Array, dict[str, Array]]:
    """Return where marks (n, 3) are on their board, and how they move (n, 3) with each unknown of it."""
    data, places = seen.data, seen.data.value[seen.rows, 2:]
    if data.board is None:
        return places, {}
    modes = data.board.modes[data.mark[seen.rows]] if data.mark is not None else np.zeros((len(places), 3, 0))
    found, by_values = places_of(places, modes, shape_at(data.board, seen.scalars))
    roles = (SCALE, *data.board.mode_names)
    return found, {role: by_values[:, :, k] for k, role in enumerate(roles) if role in seen.scalars}


def marks_seen(cameras: Array, boards: Array, places: Array) -> tuple[Array, Array]:
    """Return how boards are turned (n, 3, 3), and their marks (n, 3) in m, in the frames of the cameras.

    ``cameras`` and ``boards`` (n, 4, 4) in one frame; ``places`` (n, 3) of the marks on the boards.
    """
    T = rigid.inverse(cameras) @ boards
    return T[:, :3, :3], (T[:, :3, :3] @ places[:, :, None])[:, :, 0] + T[:, :3, 3]
