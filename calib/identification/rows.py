"""Rows of one set, few at a time: whose they are, which photographs they are of, and what they leave unexplained."""

from collections.abc import Iterator, Sequence

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import PoseError
from calib.identification.machine import Frames
from calib.identification.observations import observe
from calib.identification.observations.seen import Linearised, Seen
from calib.identification.parameters import ParameterKind
from calib.measurement.kinds import WITH_TARGET
from calib.measurement.measurements import Measurements
from calib.measurement.streams.stream import SHIFTS
from calib.robot.kinematics import Regressor

# Measured numbers in a block: so many that a call costs little beside them, few enough that memory does not grow.
BLOCK = 3072
# Photographs with fewer marks, on average, are evaluated mark by mark.
_FEW_MARKS = 3
# Photographs take so much less memory than their rows.
_FOLDED = 4


def row_blocks(data: Measurements, number: IntArray | None = None) -> Iterator[slice]:
    """Yield the rows of a set, few enough at a time; what a camera sees in one photograph is not parted.

    ``number`` (N,): the photograph of each row, where it is known.
    """
    size, start = (BLOCK if number is None else _FOLDED * BLOCK) // data.sigma.shape[1], 0
    parted = data.kind == "pixels" and len(data) > size
    cuts = _between(photograph_numbers(data) if number is None else number) if parted else None
    while start < len(data):
        end = min(start + size, len(data))
        if cuts is not None:
            end = int(
                cuts[max(np.searchsorted(cuts, end, side="right") - 1, np.searchsorted(cuts, start, side="right"))]
            )
        yield slice(start, end)
        start = end


def _between(number: IntArray) -> IntArray:
    """Return the numbers of rows before which no photograph (N,) has begun that goes on, the end being one."""
    last = np.zeros(int(number.max(initial=0)) + 1, dtype=np.intp)
    last[number] = np.arange(len(number))
    until = np.maximum.accumulate(last[number])
    return np.append(np.flatnonzero(until[:-1] < np.arange(1, len(number))) + 1, len(number))


def frame_numbers(data: Measurements, kind: ParameterKind) -> IntArray:
    """Return which base, tool or target (N,) each row is of, by number."""
    return {"base": data.setup, "tool": data.tool, "target": data.target}[kind]


def photograph_numbers(data: Measurements) -> IntArray:
    """Return the photograph (N,) of every row: rows of one target and tool with the same readings."""
    at = np.column_stack([data.readings, data.tool, data.setup, data.target])
    # Most follow each other, and of these the first says all.
    first = np.append(True, np.any(at[1:] != at[:-1], axis=1))[: len(at)]
    number = np.unique(at[first], axis=0, return_inverse=True)[1].ravel()
    return np.asarray(number[np.cumsum(first) - 1], dtype=np.intp)


def photographs_of(data: Measurements) -> IntArray | None:
    """Return the photograph (N,) of every row; None of other kinds, and where rows have little in common."""
    if data.kind != "pixels" or data.stream is not None or data.points is not None or not data.of_boards:
        return None
    number = photograph_numbers(data)
    _, first = np.unique(number, return_index=True)
    if len(number) < _FEW_MARKS * len(first):
        return None
    told = data.conditions.told().values()
    alike = all(np.array_equal(one, one[first[number]], equal_nan=True) for one in told)
    return number if alike else None


def one_or_all(numbers: IntArray, names: Sequence[str]) -> IntArray | int:
    """Return the number that all rows have, or the numbers (n,) of each, where they count so many names."""
    if len(names) == 1:
        return 0
    first = int(numbers[0])
    return numbers if np.count_nonzero(numbers != first) else first


def setups_of(data: Measurements, rows: slice | IntArray) -> IntArray | int:
    """Return the set-ups (n,) of rows, or the one of all; where some look at links, what is seen from is of each."""
    return data.setup[rows] if data.target_links else one_or_all(data.setup[rows], data.setups)


def on_links(data: Measurements, rows: slice | IntArray) -> Iterator[tuple[str, IntArray]]:
    """Yield the links that carry targets of some rows, with the numbers of these among them."""
    if not data.target_links:
        return
    links = [data.link_of(int(t)) for t in data.target[rows]]
    for link in dict.fromkeys(links):
        if link is not None:
            yield link, np.array([n for n, other in enumerate(links) if other == link], dtype=np.intp)


def named(error: PoseError, data: Measurements, rows: slice) -> PoseError:
    """Return what was raised of some rows of a set in which a loop does not close, as of the set, with its line."""
    row = rows.start + error.row
    return PoseError(row, error.reason, [rows.start + row for row in error.rows], f"{data.where}:{data.lines[row]}")


def observed_rows(
    data: Measurements, rows: slice, frames: Frames, base: Array, held: Array, others: Array | None
) -> tuple[Linearised, tuple[Array, ...]]:
    """Return what rows leave unexplained, and where tools and other ends are for who observes them (n, 4, 4).

    ``held`` and ``others``: these in the base. The observer is the floor, in whose frame instruments measure, or the
    link that carries a row's target; the base is at ``base`` there, (n, 4, 4), or (4, 4) for all rows.
    """
    targets = frames.targets[data.target[rows] if data.kind in WITH_TARGET else slice(0)]
    ends = [rigid.product(base, T) for T in (held, others) if T is not None]
    other = ends[1] if others is not None else frames.targets[:0]
    return observe(data.kind, Seen(data, rows, ends[0], other, targets, scalars_of(data, frames))), tuple(ends)


def scalars_of(data: Measurements, frames: Frames) -> dict[str, float]:
    """Return the unknown numbers of a set's instrument, by their roles; those of clocks aside."""
    return {role: float(frames.scalars[k]) for role, k in data.uses.items() if role not in SHIFTS}


def held_at(carried: Regressor, tools: Array, tool: IntArray | int, points: Array | None, rows: slice) -> Array:
    """Return where the points of rows are in the base (n, 4, 4): tools (k, 4, 4), by number, or points in them."""
    if isinstance(tool, int):
        found = carried.behind(carried.end @ tools[tool])
    else:
        found = rigid.product(carried.placement, tools[tool])
    return found if points is None else rigid.product(found, rigid.translation(points[rows]))
