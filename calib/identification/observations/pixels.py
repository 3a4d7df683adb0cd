"""Observation ``pixels``: a camera saw a mark of a board; one of them is on the tool, the other one is the target."""

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.identification.observations.seen import Linearised, Seen
from calib.measurement.projection import project


def residual(seen: Seen) -> Linearised:
    """Return r = (u, v)_measured - project(Y) (n, 2) in px, with Y = T_camera^-1 T_board p of the mark at p."""
    camera = seen.data.camera
    assert camera is not None, "pixels were seen by a camera"
    value = seen.data.value[seen.rows]
    by_tool = camera.camera_on == "tip"
    cameras, boards = (seen.tools, seen.targets) if by_tool else (seen.targets, seen.tools)
    turn, marks = marks_seen(cameras, boards, value[:, 2:])
    projected = project(camera.lens, marks)
    # The board moved by (v, w): dY = R (v + w x p); the camera: dY = -v - w x Y.
    by_board = -projected.by_point @ np.concatenate([turn, -turn @ rigid.skew(value[:, 2:])], axis=2)
    by_camera = projected.by_point @ np.concatenate(
        [np.broadcast_to(np.eye(3), turn.shape), -rigid.skew(marks)], axis=2
    )
    twist, target = (by_camera, by_board) if by_tool else (by_board, by_camera)
    return Linearised(value[:, :2] - projected.pixels, twist, target=target)


def marks_seen(cameras: Array, boards: Array, places: Array) -> tuple[Array, Array]:
    """Return how boards are turned (n, 3, 3), and their marks (n, 3) in m, in the frames of the cameras.

    ``cameras`` and ``boards`` (n, 4, 4) in one frame; ``places`` (n, 3) of the marks on the boards.
    """
    T = rigid.inverse(cameras) @ boards
    return T[:, :3, :3], (T[:, :3, :3] @ places[:, :, None])[:, :, 0] + T[:, :3, 3]
