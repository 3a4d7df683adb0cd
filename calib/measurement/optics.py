"""What pixels depend on beside poses: the free numbers of a lens, and the scale and shape of a board, as scalars."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only_view
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.units import MM
from calib.measurement.boards import ONLY_BOARD, Board
from calib.measurement.instruments import ONLY_CAMERA, Camera
from calib.measurement.lens import CENTRE, FOCAL, NAMES, Lens
from calib.measurement.measurements import Measurements
from calib.measurement.scalars import Scalar

SCALE = "scale"
# By how much numbers of a lens are expected to be off, relative to the focal length or by themselves. Weak priors are
# ten times as wide, those of the focal length a hundred times.
_SIZES = {"fx": 0.01, "fy": 0.01, "cx": 0.01, "cy": 0.01, "p1": 0.01, "p2": 0.01, "k1": 0.1, "k4": 0.1}
_WEAK, _WEAK_FOCAL = 10.0, 100.0
# Of the modes of a board's shape, in m rms.
MODE_SIZE, MODE_WIDTH = 1e-4, 1e-2


def lens_size(name: str, lens: Lens) -> float:
    """Return the parameter scale of a number of a lens, in its unit."""
    share = _SIZES.get(name, 1.0)
    return share * lens.fx if name in (*FOCAL, *CENTRE) else share


def lens_width(name: str, lens: Lens) -> float:
    """Return the standard deviation of the weak prior of a number of a lens, in its unit."""
    return (_WEAK_FOCAL if name in FOCAL else _WEAK) * lens_size(name, lens)


def lens_scalars(camera: Camera) -> dict[str, Scalar]:
    """Return the free numbers of a camera's lens."""
    lens, prefix = camera.lens, "lens" if camera.name == ONLY_CAMERA else f"lens.{camera.name}"
    return {
        name: Scalar(
            f"{prefix}.{name}",
            "px" if name in (*FOCAL, *CENTRE) else "1",
            lens_size(name, lens),
            getattr(lens, name),
            camera.lens_sigma.get(name),
            weak_prior=lens_width(name, lens),
        )
        for name in NAMES
        if name in camera.free
    }


def board_scalars(board: Board) -> dict[str, Scalar]:
    """Return the scale of a board, where it is not known, and its shape."""
    prefix = "board" if board.name == ONLY_BOARD else f"board.{board.name}"
    found = {name: Scalar(f"{prefix}.{name}", "m", MODE_SIZE, weak_prior=MODE_WIDTH) for name in board.mode_names}
    sigma = board.scale_sigma
    return ({SCALE: Scalar(f"{prefix}.{SCALE}", "1", sigma, prior=sigma)} if sigma > 0.0 else {}) | found


@checked
def seen_by(data: Measurements, camera: Camera, board: Board | None = None) -> Measurements:
    """Return pixels as seen by another camera, of another board: what is unknown of these is then theirs.

        data = calib.measuring.seen_by(data, data.camera, calib.measuring.Board(scale_sigma=0.0))

    ``board``: a flat one of a scale that is known to half a percent is what pixels are read with; None of known marks.

    Raises JobError where a single mark is to tell a lens of which nothing is known, MeasurementError for a mark that
    is not on the board.
    """
    own = {*NAMES, SCALE, *(() if data.board is None else data.board.mode_names)}
    roles = {role: data.scalars[k] for role, k in data.uses.items() if role not in own} | lens_scalars(camera)
    if not data.of_boards:
        if camera.unknown:
            raise JobError(
                f"{data.where}: an unknown lens can only be found from photographs of boards, and these are of single "
                "marks; give fx, fy, cx, cy."
            )
        board = None
    mark = None
    if board is not None:
        roles |= board_scalars(board)
        # Also of a flat board: the report asks what another shape would change.
        if len(board.marks):
            mark = board.numbers(data.value[:, 2:])
            if (mark < 0).any():
                row = int(np.argmin(mark))
                x, y, z = data.value[row, 2:] / MM
                nearest = board.marks[np.argmin(np.linalg.norm(board.marks - data.value[row, 2:], axis=1))] / MM
                raise MeasurementError(
                    f"{data.where}:{data.lines[row]}: no mark of the board {board.name!r} is at {x:g}, {y:g}, {z:g} "
                    f"mm; the nearest is at {nearest[0]:g}, {nearest[1]:g}, {nearest[2]:g} mm."
                )
            mark = read_only_view(mark) if board.shape != "flat" else None
    return replace(
        data,
        camera=camera,
        board=board,
        mark=mark,
        scalars=tuple(roles.values()),
        uses={role: k for k, role in enumerate(roles)},
    )


def lens_at(camera: Camera, values: Mapping[str, float]) -> Lens:
    """Return the lens of a camera for values of its free numbers, by their names; others are as given."""
    return camera.lens._replace(**{name: values[name] for name in camera.free if name in values})


def shape_at(board: Board, values: Mapping[str, float]) -> Array:
    """Return the scale and shape (1 + k,) of a board for values of its scalars, by their names."""
    return np.array([values.get(name, 0.0) for name in (SCALE, *board.mode_names)])
