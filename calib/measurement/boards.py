"""Boards that cameras see: where their marks should be, and what of the print may be otherwise.

A mark is at ``p = s (m + sum_k c_k d_k)``, with m its place as it was to be printed, s = 1 + ``scale`` and d_k the
*modes* of the board's shape. They hold no motion of the whole board and no change of its size, which its pose and scale
are for. The first five are those of a sheet that bends and of a printer that is not quite square: x^2, y^2 and xy out
of its plane, aspect and shear in it. With all of them, each mark is where it likes.

Pixels alone do not tell the scale, nor does a robot whose lengths are to be found: it has a prior.
"""

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from calib.foundations.arguments import checked, own_fields
from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.brief import brief
from calib.foundations.errors import JobError
from calib.foundations.linear import svd
from calib.foundations.ranges import refuse_beyond, refuse_shape
from calib.foundations.sealing import sealed
from calib.foundations.words import refuse_other

BoardShape = Literal["flat", "quadratic", "free"]
# Printers and paper are right to so much: half a percent.
SQUARE_SIGMA = 0.005
ONLY_BOARD = "board"
_QUADRATIC = ("bend_x", "bend_y", "twist", "aspect", "shear")
# Marks are told by their places; what is nearer than this, in m, is one place.
_ONE_PLACE = 1e-6
_FLAT = 1e-9
# Places and marks that are compared at a time: 24 MB.
_PAIRS = 1_000_000
# A shape takes the places of so many marks.
_LEAST_MARKS = 6


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Board:
    """A board, or several of one print, and what of it is unknown.

    ``marks`` (m, 3): where its marks should be, in m; needed where its ``shape`` is not flat. ``scale_sigma``: standard
    deviation of its scale, a share; 0 where its size is known. ``name``: tables of one name are of one board.
    ``modes`` (m, 3, k): of its shape, each moving marks by 1 m rms.

    Raises JobError when a number cannot be used, or the marks cannot have that shape.
    """

    __repr__ = brief

    name: str = ONLY_BOARD
    marks: Array = field(default_factory=lambda: read_only(np.zeros((0, 3))))
    scale_sigma: float = SQUARE_SIGMA
    shape: BoardShape = "flat"
    modes: Array = field(init=False, default_factory=lambda: read_only(np.zeros((0, 3, 0))))

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_shape(self.marks, (None, 3), "board: marks")
        refuse_beyond(self.marks, "position, station, point", "board: marks")
        refuse_beyond(self.scale_sigma, "square_sigma", "board: square_sigma")
        refuse_other(self.shape, get_args(BoardShape), "board: shape")
        if self.shape != "flat" and len(self.marks) < _LEAST_MARKS:
            raise JobError(f"board: a {self.shape} shape needs the places of six marks or more; write a board.toml.")
        if self.shape == "quadratic" and not can_be_bent(self.marks):
            raise JobError("board: its marks are not in a plane, so its shape cannot be quadratic.")
        object.__setattr__(self, "modes", shape_modes(self.marks, self.shape))

    @property
    def mode_names(self) -> tuple[str, ...]:
        """What the modes (k,) are called."""
        count = self.modes.shape[2]
        return (*_QUADRATIC[:count], *(f"shape_{k + 1}" for k in range(len(_QUADRATIC), count)))

    @checked
    def same_as(self, other: "Board | None") -> bool:
        """Return whether another board is this one."""
        return other is not None and (
            (self.name, self.scale_sigma, self.shape) == (other.name, other.scale_sigma, other.shape)
            and np.array_equal(self.marks, other.marks)
        )

    @checked
    def numbers(self, places: Array) -> IntArray:
        """Return which of the marks (n,) are at places (n, 3); -1 for none. Raises JobError for other shapes."""
        refuse_shape(places, (None, 3), "places")
        found = np.full(len(places), -1, dtype=np.intp)
        step = max(_PAIRS // max(len(self.marks), 1), 1)
        for start in range(0, len(places), step):
            some = places[start : start + step]
            apart = np.linalg.norm(some[:, None] - self.marks[None], axis=2)
            nearest = np.argmin(apart, axis=1)
            near = apart[np.arange(len(some)), nearest] < _ONE_PLACE
            found[start : start + step] = np.where(near, nearest, -1)
        return found


def shape_modes(marks: Array, shape: BoardShape) -> Array:
    """Return the modes (m, 3, k) of a shape: without motions and growth of all marks, each of size 1 m rms."""
    n = len(marks)
    if shape == "flat":
        return np.zeros((n, 3, 0))
    x = marks - marks.mean(axis=0)
    x = x / np.sqrt((x * x).sum(axis=1).mean())
    whole = np.zeros((n, 3, 7))
    whole[:, :, :3] = np.eye(3)
    for k in range(3):
        whole[:, :, 3 + k] = np.cross(np.eye(3)[k], x)
    whole[:, :, 6] = x
    u, v = x[:, 0], x[:, 1]
    bent = np.zeros((n, 3, 5))
    bent[:, 2, :3] = np.stack([u * u, v * v, u * v], axis=1)
    bent[:, 0, 3:], bent[:, 1, 3:] = np.stack([u, v], axis=1), np.stack([-v, u], axis=1)
    whole_basis = np.linalg.qr(whole.reshape(3 * n, 7))[0]
    own = bent.reshape(3 * n, 5)
    own = own - whole_basis @ (whole_basis.T @ own)
    own = own / np.linalg.norm(own, axis=0)
    if shape == "free":
        taken = np.column_stack([whole_basis, np.linalg.qr(own)[0]])
        # What is orthogonal to all of these: a mark by itself moves in all of it, so that the order has no meaning.
        rest = svd(taken, full_matrices=True)[0][:, taken.shape[1] :]
        own = np.column_stack([own, rest])
    return read_only(np.sqrt(n) * own.reshape(n, 3, -1))


def can_be_bent(marks: Array) -> bool:
    """Return whether marks (m, 3) are enough, and in a plane, so that their board can have a quadratic shape."""
    return len(marks) >= _LEAST_MARKS and float(np.ptp(marks[:, 2])) <= _FLAT


def places_of(marks: Array, modes: Array, values: Array) -> tuple[Array, Array]:
    """Return where marks (n, 3) with their modes (n, 3, k) are for values (1 + k,), and derivatives (n, 3, 1 + k).

    The first value is the scale, by how much the board is larger than it should be; the others are its shape's, in m.
    """
    shaped = marks + modes @ values[1:]
    s = 1.0 + values[0]
    return s * shaped, np.concatenate([shaped[:, :, None], s * modes], axis=2)
