"""Observation ``pixels``: a camera saw a mark of a board; one of them is on the tool, the other one is the target."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray
from calib.identification.observations.seen import Linearised, Seen, by_twist
from calib.measurement.boards import places_of
from calib.measurement.lens import NAMES
from calib.measurement.optics import SCALE, lens_at, shape_at
from calib.measurement.projection import by_lens, project


class Photographed(NamedTuple):
    """Residuals r = (u, v)_measured - project(Y) (n, 2) in px, with Y = T_camera^-1 T_board p of the mark at p.

    ``by_camera`` (n, 2, 6): by the local twist of the camera; ``scalars`` (n, 2) each: by what is unknown of the lens,
    and of the board's scale and shape. ``by_place`` (n, 2, 3): by the mark on the board, at ``places`` (n, 3).
    """

    residual: Array
    by_camera: Array
    scalars: dict[str, Array]
    by_place: Array
    places: Array


def photographed(seen: Seen, photograph: IntArray | None = None) -> Photographed:
    """Return what marks leave unexplained, and how that follows the camera, lens and board.

    ``photograph`` (n,): of each row, where tools and targets of ``seen`` are those of photographs.
    """
    data, camera = seen.data, seen.data.camera
    assert camera is not None, "pixels were seen by a camera"
    value, lens = data.value[seen.rows], lens_at(camera, seen.scalars)
    places, by_shape, shaped = _places(seen)
    turn, marks = marks_seen(*_in_order(seen), places, photograph)
    projected = project(lens, marks)
    by_place = -projected.by_point @ turn
    # dY = -v - w x Y.
    by_camera = np.concatenate([projected.by_point, -projected.by_point @ rigid.skew(marks)], axis=2)
    # Of a board of free shape there are hundreds of columns: all at once.
    by_values = by_place @ by_shape
    scalars = {role: by_values[:, :, k] for k, role in enumerate(shaped)}
    if camera.free:
        by_number = by_lens(lens, projected.flat)
        scalars |= {name: -by_number[:, :, NAMES.index(name)] for name in camera.free if name in seen.scalars}
    return Photographed(value[:, :2] - projected.pixels, by_camera, scalars, by_place, places)


def residual(seen: Seen) -> Linearised:
    """Return the residuals of :func:`photographed`, and how they follow tool and target."""
    found = photographed(seen)
    # The board moved by (v, w): dY = R (v + w x p).
    by_board = np.concatenate([found.by_place, -found.by_place @ rigid.skew(found.places)], axis=2)
    return _linearised(seen, found.residual, found.by_camera, by_board, found.scalars)


def of_photographs(seen: Seen, residual: Array, by_camera: Array, scalars: Mapping[str, Array]) -> Linearised:
    """Return numbers (m, k) of photographs, and how they follow tool and target; arrays as in :class:`Photographed`.

    ``seen``: where these are for each photograph. The board moves in the camera as this one does the other way, so
    that all marks of a photograph follow it alike.
    """
    cameras, boards = _in_order(seen)
    by_board = -by_camera @ rigid.adjoint(rigid.inverse(cameras) @ boards)
    return _linearised(seen, residual, by_camera, by_board, scalars)


def _in_order(seen: Seen) -> tuple[Array, Array]:
    """Return where cameras and boards are (n, 4, 4)."""
    assert seen.data.camera is not None, "pixels were seen by a camera"
    return (seen.tools, seen.targets) if seen.data.camera.camera_on == "tip" else (seen.targets, seen.tools)


def _linearised(
    seen: Seen, residual: Array, by_camera: Array, by_board: Array, scalars: Mapping[str, Array]
) -> Linearised:
    assert seen.data.camera is not None, "pixels were seen by a camera"
    on_tip = seen.data.camera.camera_on == "tip"
    twist, target = (by_camera, by_board) if on_tip else (by_board, by_camera)
    return Linearised(residual, (by_twist(twist, seen.tools),), target=target, scalars=scalars)


def _places(seen: Seen) -> tuple[Array, Array, tuple[str, ...]]:
    """Return where marks (n, 3) are on their board, how they move (n, 3, k) with its unknowns, and what these are."""
    data, places = seen.data, seen.data.value[seen.rows, 2:]
    if data.board is None:
        return places, np.zeros((len(places), 3, 0)), ()
    modes = data.board.modes[data.mark[seen.rows]] if data.mark is not None else np.zeros((len(places), 3, 0))
    found, by_values = places_of(places, modes, shape_at(data.board, seen.scalars))
    known = {role: k for k, role in enumerate((SCALE, *data.board.mode_names)) if role in seen.scalars}
    return found, by_values[:, :, list(known.values())], tuple(known)


def marks_seen(cameras: Array, boards: Array, places: Array, photograph: IntArray | None = None) -> tuple[Array, Array]:
    """Return how boards are turned (n, 3, 3), and their marks (n, 3) in m, in the frames of the cameras.

    ``cameras`` and ``boards`` (n, 4, 4) in one frame, or those of photographs, by the ``photograph`` (n,) of each row;
    ``places`` (n, 3) of the marks on the boards.
    """
    T = rigid.inverse(cameras) @ boards
    T = T if photograph is None else T[photograph]
    return T[:, :3, :3], (T[:, :3, :3] @ places[:, :, None])[:, :, 0] + T[:, :3, 3]
