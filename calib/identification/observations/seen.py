"""What an observation is told of its rows, and what it answers."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.measurement.measurements import Measurements
from calib.robot.kinematics import Follow

_MINUS = read_only(-np.eye(3)[:, :, None])


class Seen(NamedTuple):
    """Rows of one set as a machine predicts them.

    ``tools`` (n, 4, 4): tool placements in the instrument's frame; ``others``: those at the other ends, ``targets``:
    what each row is about, both empty where the kind has none. ``scalars``: unknown numbers that the rows depend on, by
    what they are to them.
    """

    data: Measurements
    rows: slice
    tools: Array
    others: Array
    targets: Array
    scalars: Mapping[str, float]


class Linearised(NamedTuple):
    """Residuals (n, d), measured minus predicted, and how they follow each ``tool``, in the observer's axes.

    ``tool``: of consecutive numbers, of all d together; ``other``: by the other end, empty where the kind has none.
    ``target`` (n, d, 6): their change with the local twist of the target; None where there is none. ``scalars`` (n, d)
    each: their change with one unit of every scalar of ``Seen``.
    """

    residual: Array
    tool: tuple[Follow, ...]
    other: tuple[Follow, ...] = ()
    target: Array | None = None
    scalars: Mapping[str, Array] = MappingProxyType({})


class Moved(NamedTuple):
    """How consecutive numbers of rows ``follow`` something that is ``placed`` (n, 4, 4), both for who observes it."""

    follow: tuple[Follow, ...]
    placed: Array

    @property
    def by_motion(self) -> tuple[Array, Array]:
        """Derivatives of all numbers by a shift, and by a turn (n, d, 3)."""
        parts = [(own.shift, own.turn, (own.size, 3, len(self.placed))) for own in self.follow]
        shift, turn = (
            np.concatenate([np.zeros(shape) if rows is None else np.broadcast_to(rows, shape) for rows, shape in every])
            for every in ([(a, shape) for a, _, shape in parts], [(b, shape) for _, b, shape in parts])
        )
        return shift.transpose(2, 0, 1), turn.transpose(2, 0, 1)


def minus_position() -> Follow:
    """Return how numbers (n, 3) follow a frame that are something else minus its position."""
    return Follow(_MINUS, None)


def by_point(rows: Array) -> Follow:
    """Return how numbers follow a frame of which the origin alone matters; ``rows`` (n, d, 3): derivatives by that."""
    return Follow(rows.transpose(1, 2, 0), None)


def by_twist(rows: Array, frames: Array) -> Follow:
    """Return how numbers follow frames (n, 4, 4); ``rows`` (n, d, 6): their derivatives by the local twist of these."""
    shift, turn = (part @ np.swapaxes(frames[:, :3, :3], -1, -2) for part in (rows[:, :, :3], rows[:, :, 3:]))
    return Follow(shift.transpose(1, 2, 0), turn.transpose(1, 2, 0))


def point_columns(rows: Array, frames: Array) -> Array:
    """Return derivatives (n, d, 6) by the local twist of frames (n, 4, 4), of what depends on their origins alone.

    ``rows`` (n, d, 3): derivatives by the origin's position.
    """
    found = np.zeros((*rows.shape[:2], 6))
    found[:, :, :3] = rows @ frames[:, :3, :3]
    return found
