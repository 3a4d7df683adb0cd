"""Printed boards: a chessboard, or one with markers in its white squares (ChArUco), and the marks that cameras see."""

import re
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from calib.foundations.arguments import own_fields
from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import JobError
from calib.foundations.ranges import refuse_beyond
from calib.foundations.words import shown
from calib.measurement.boards import ONLY_BOARD, SQUARE_SIGMA, Board, BoardShape

PrintKind = Literal["charuco", "chessboard"]
# The shape of the board that is sought, or the one that photographs ask for.
PrintShape = Literal["flat", "quadratic", "free", "auto"]
LEAST_SQUARES, MOST_SQUARES = 3, 100
_DICTIONARY = re.compile(r"DICT_\w+", re.ASCII)
# As large a share of a square may a marker be: its edge needs white beside it.
_LARGEST_MARKER = 0.95


@dataclass(frozen=True, slots=True)
class Print:
    """What is printed: ``squares`` across and down, the side of a ``square`` and of a ``marker`` in m.

    ``dictionary``: OpenCV's name of the markers, which a chessboard has none of. ``square_sigma``: standard deviation
    of the print's scale, a share. ``shape``: what is sought of the print beside its scale; "auto" is what photographs
    ask for.

    Raises JobError when a number cannot be used.
    """

    kind: PrintKind
    squares: tuple[int, int]
    square: float
    marker: float = 0.0
    dictionary: str = ""
    square_sigma: float = SQUARE_SIGMA
    shape: PrintShape = "auto"

    def __post_init__(self) -> None:
        own_fields(self)
        if self.kind not in get_args(PrintKind):
            raise JobError(f"board: kind is {self.kind!r}; allowed are {', '.join(get_args(PrintKind))}.")
        if self.shape not in get_args(PrintShape):
            raise JobError(f"board: shape is {self.shape!r}; allowed are {', '.join(get_args(PrintShape))}.")
        for count in self.squares:
            if not LEAST_SQUARES <= count <= MOST_SQUARES:
                raise JobError(f"board: has {count} squares; allowed are {LEAST_SQUARES} to {MOST_SQUARES}.")
        refuse_beyond(self.square, "square, marker", "board: square")
        if self.kind == "charuco":
            if not self.dictionary:
                raise JobError("board: dictionary is missing; a ChArUco board has markers, like those of DICT_4X4_50.")
            if not _DICTIONARY.fullmatch(self.dictionary):
                raise JobError(f"board: dictionary is {shown(self.dictionary)}; names of OpenCV are like DICT_4X4_50.")
            refuse_beyond(self.marker, "square, marker", "board: marker")
            if self.marker > _LARGEST_MARKER * self.square:
                raise JobError(
                    f"board: a marker of {self.marker:g} m has no white around it in a square of {self.square:g} m; "
                    f"allowed are {_LARGEST_MARKER:g} of it."
                )
        elif self.dictionary or self.marker:
            raise JobError("board: a chessboard has no markers; leave marker and dictionary out.")

    @property
    def half_turn(self) -> Array | None:
        """The half turn (4, 4) about its middle with which the print looks the same; None where it does not."""
        if self.kind != "chessboard" or sum(self.squares) % 2:
            return None
        turn = np.diag([-1.0, -1.0, 1.0, 1.0])
        turn[:2, 3] = self.square * np.array(self.squares)
        return read_only(turn)

    @property
    def four_ways(self) -> bool:
        """Whether the print looks the same from all four sides."""
        return self.half_turn is not None and self.squares[0] == self.squares[1] and self.squares[0] % 2 == 1

    @property
    def marks(self) -> Array:
        """Where the inner corners (m, 3) are, row by row, in m: x along the rows, y down, z into the board."""
        across, down = self.squares
        x, y = np.meshgrid(np.arange(1, across), np.arange(1, down))
        return read_only(self.square * np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))

    def board(self, name: str = ONLY_BOARD) -> Board:
        """Return the board with its marks and what of it is unknown, in the simplest shape."""
        return Board(name, self.marks, self.square_sigma, self.shapes[0])

    @property
    def shapes(self) -> tuple[BoardShape, ...]:
        """The shapes that the board may have, from the simplest on."""
        return get_args(BoardShape) if self.shape == "auto" else (self.shape,)
