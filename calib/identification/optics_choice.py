"""How many numbers a lens and a board need: whole photographs held out say so, before any robot takes part."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.foundations.arrays import Array, evenly
from calib.foundations.linear import spread
from calib.identification.initialisation.lenses import LEAST_PHOTOGRAPHS, legible, photographs_of
from calib.identification.photographs import Bundle, clearly_better, found_optics, held_out
from calib.measurement.boards import Board, BoardShape
from calib.measurement.instruments import Camera
from calib.measurement.lens import BENT, RATIONAL
from calib.measurement.measurements import Measurements
from calib.measurement.optics import seen_by

# Fewer photographs cannot spare one; more do not make a better choice.
_LEAST, _MOST = LEAST_PHOTOGRAPHS + 1, 60
# Of the spread of all pixels: what leaves more is no board that is bent, but other marks.
_NO_BOARD = 0.25


@dataclass(frozen=True, slots=True)
class Candidate:
    """One model of a lens and a board: the board's shape, and how many numbers of distortion are sought.

    ``rms`` of its own photographs and of those ``held_out``, in px, two-dimensional; None where they are too few.
    """

    shape: BoardShape
    distortion: int
    rms: float
    held_out: float | None


@dataclass(frozen=True, slots=True)
class OpticsChoice:
    """The models of a camera and its board that were compared on photographs alone; ``chosen``: by position."""

    camera: str
    board: str
    photographs: int
    candidates: tuple[Candidate, ...]
    chosen: int


def choose_optics(
    sets: Sequence[Measurements], shapes: Sequence[BoardShape], *, rational: bool
) -> tuple[Camera, Board, OpticsChoice] | None:
    """Return the camera and the board of sets of one of each, with as many numbers as photographs ask for.

    ``shapes``: that the board may have, from the simplest on; ``rational``: whether the distortion may have eight
    numbers. A richer model is taken where it foretells photographs held out clearly better, and not tried where the
    search for the simplest one has no end, or leaves nearly all: no camera has seen such marks. Numbers of a lens
    that nobody gave are then those that photographs alone have found. None where there are not enough of them.
    """
    camera, board = sets[0].camera, sets[0].board
    assert camera is not None and board is not None, "photographs are of a board by a camera"
    taken: _Fitted | None = None
    tried: list[_Fitted] = []
    for shape in shapes:
        new = _fit(sets, camera, replace(board, shape=shape))
        if new is None:
            return None
        tried.append(new)
        taken = new if taken is None or new.better_than(taken) else taken
        if tried[0].lost:
            break
    if rational and taken is not None and not tried[0].lost and set(BENT) <= set(camera.free):
        new = _fit(sets, replace(camera, free=(*camera.free, *RATIONAL)), taken.board)
        if new is not None:
            tried.append(new)
            taken = new if new.better_than(taken) else taken
    if taken is None:
        return None
    lens = taken.bundle.optics.lens._asdict() | {"found": True} if camera.unknown else {}
    choice = OpticsChoice(
        camera.name,
        board.name,
        len(taken.bundle.residuals),
        tuple(fitted.candidate for fitted in tried),
        tried.index(taken),
    )
    return replace(taken.camera, **lens), taken.board, choice


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """A model of camera and board fitted to photographs; mean ``squares`` (m,) of each where it is held out."""

    camera: Camera
    board: Board
    bundle: Bundle
    squares: Array | None
    spread: float

    @property
    def lost(self) -> bool:
        """Whether its search has found no end, or leaves nearly all of the ``spread`` of all pixels, in px."""
        return not self.bundle.converged or self.bundle.rms > _NO_BOARD * self.spread

    def better_than(self, other: "_Fitted") -> bool:
        return self.squares is not None and other.squares is not None and clearly_better(other.squares, self.squares)

    @property
    def candidate(self) -> Candidate:
        weights = [len(r) for r in self.bundle.residuals]
        rms = None if self.squares is None else float(np.sqrt(np.average(self.squares, weights=weights)))
        return Candidate(self.board.shape, sum(k in self.camera.free for k in BENT + RATIONAL), self.bundle.rms, rms)


def _fit(sets: Sequence[Measurements], camera: Camera, board: Board) -> _Fitted | None:
    some = [one for data in sets for one in photographs_of(seen_by(data, camera, board))]
    some = legible(some, camera.lens)
    some = some[evenly(len(some), _MOST)]
    bundle = found_optics(some, camera.free, camera.lens) if len(some) >= LEAST_PHOTOGRAPHS else None
    if bundle is None:
        return None
    squares = held_out(some, camera.free, bundle) if len(some) >= _LEAST else None
    return _Fitted(camera, board, bundle, squares, spread(np.concatenate([one.pixels for one in some])))
