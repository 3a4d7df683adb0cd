"""Which unknowns are eliminated block by block, found from which rows are about what, and by counting.

Bases, tools, targets and numbers of instruments are *things*; a row is about a few of them, and about the robot. What
few rows are about is eliminated (:mod:`calib.identification.arrow`), and for that no row may be about two blocks. So a
block is a set of things that rows join to each other, but to no others; where that makes blocks too wide, what joins
most stays common, of the family that has the fewest unknowns. Where every set-up has targets of its own, it is a block
with these. Where rows cross - every target was seen from every set-up - the smaller family stays common, and the larger
one is eliminated. How wide a block may become, the count of operations decides. Targets are always eliminated; other
things where they have a hundred unknowns or more, and that saves half of all operations.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
import scipy

from calib.foundations.arrays import BoolArray, IntArray
from calib.identification.arrow import Split
from calib.identification.machine import Layout
from calib.identification.parameters import Parameter
from calib.measurement.kinds import WITH_TARGET
from calib.measurement.measurements import Measurements

# Blocks with at most so many columns are tried.
_WIDEST = (3, 6, 9, 12, 24, 48)
# More than targets is eliminated where there is so much of it, and where that takes less than this share of operations.
_MUCH, _WORTH_IT = 100, 0.5
# So many times, roughly, rows that are reduced are solved for each time that they are made, at ten operations a number.
_SOLVED = 50.0
# What is joined by rows of which many are about it in comparison stays common at once.
_MANY = 0.5


class Things(NamedTuple):
    """The things of a set-up by number: bases, tools, targets, scalars; numbers of the first ones of a family.

    ``ends`` (4,): one behind the last of each family.
    """

    layout: Layout
    ends: IntArray

    @classmethod
    def of(cls, layout: Layout) -> "Things":
        """Return the things of a state."""
        frames = [(end - layout.base) // 6 for end in (layout.tools, layout.targets, layout.scalars)]
        return cls(layout, np.array([*frames, frames[-1] + layout.size - layout.scalars], dtype=np.intp))

    @property
    def number(self) -> int:
        """How many there are."""
        return int(self.ends[-1])

    def of_entries(self, entry: IntArray) -> IntArray:
        """Return the things (n,) of entries (n,) of the state, -1 for the robot."""
        layout = self.layout
        of_frame = (entry - layout.base) // 6
        found = np.where(entry < layout.scalars, of_frame, self.ends[2] + entry - layout.scalars)
        return np.asarray(np.where(entry < layout.base, -1, found))

    def of_parameters(self, parameters: Sequence[Parameter]) -> IntArray:
        """Return the thing (p,) of every parameter, -1 for one of the robot, or of several things."""
        first = np.array([parameter.entries[0][0] for parameter in parameters], dtype=np.intp)
        found = self.of_entries(first)
        for k, parameter in enumerate(parameters):
            if len(parameter.entries) > 1:
                own = np.unique(self.of_entries(np.array([entry for entry, _ in parameter.entries], dtype=np.intp)))
                found[k] = own[0] if len(own) == 1 else -1
        return found

    def in_blocks(self, entry: IntArray, block: IntArray) -> IntArray:
        """Return the block (t + 1,) of every thing, of which entries (n,) of the state are in a block (n,); -1: none.

        Last: no thing.
        """
        found = np.full(self.number + 1, -1, dtype=np.intp)
        found[self.of_entries(entry)] = block
        found[-1] = -1
        return found

    def blocks_of(self, block: IntArray, data: Measurements) -> IntArray:
        """Return the blocks (N,) that rows of a set are about, -1 for none, by that (t + 1,) of every thing."""
        return np.asarray(block[self.seen_by(data)].max(axis=1))

    def seen_by(self, data: Measurements) -> IntArray:
        """Return the things (N, k) that every row of a set with common names is about, -1 for none.

        Where a target is on a link, it does not matter where the base is.
        """
        tools, targets, scalars = self.ends[:3]
        on_link = np.zeros(len(data), dtype=np.bool_)
        if data.target_links:
            of_target = [data.link_of(t) is not None for t in range(len(data.targets))]
            on_link = np.array([*of_target, False])[data.target]
        columns = [np.where(on_link, -1, data.setup)]
        columns += [np.where(end.tool < 0, -1, tools + end.tool) for end in data.ends]
        if data.kind in WITH_TARGET:
            columns.append(np.where(data.target < 0, -1, targets + data.target))
        columns += [np.full(len(data), scalars + k) for k in sorted(set(data.uses.values()))]
        return np.stack(columns, axis=1)


def split_of(
    parameters: Sequence[Parameter],
    layout: Layout,
    sets: Sequence[Measurements],
    joined: Collection[int],
    *,
    targets_alone: bool,
) -> Split:
    """Return which parameters are common, and those of every block; ``sets`` have common names.

    ``joined``: numbers of targets whose unknowns are common, as what is known joins them to others. ``targets_alone``:
    whether nothing else is eliminated.
    """
    things = Things.of(layout)
    owner = things.of_parameters(parameters)
    width = np.bincount(owner[owner >= 0], minlength=things.number)
    free = width > 0
    free[things.ends[1] + np.array(sorted(joined), dtype=np.intp)] = False
    of_target = np.zeros(things.number, dtype=np.bool_)
    of_target[things.ends[1] : things.ends[2]] = True
    plain = np.where(free & of_target, np.arange(things.number), -1)
    found = _split(owner, plain)
    if targets_alone or not sets:
        return found
    rows = sum(data.sigma.size for data in sets)
    least = _operations(found, rows)
    if width[free & ~of_target].sum() < _MUCH:
        return found
    seen = [things.seen_by(data) for data in sets]
    for data, own in zip(sets, seen, strict=True):
        if data.times is not None:
            # How rows in time err together is judged by what is common.
            free[own[(own >= 0) & ~of_target[own]]] = False
    incidence = _Incidence.of(seen, width, free, things)
    tried = [_split(owner, incidence.blocks(widest)) for widest in _WIDEST]
    best = min(tried, key=lambda split: _operations(split, rows))
    return best if _operations(best, rows) < _WORTH_IT * least else found


def _split(owner: IntArray, block_of: IntArray) -> Split:
    """Return the split by the thing (p,) of every parameter and the block of every thing, -1 for common ones."""
    number = np.where(owner < 0, -1, np.append(block_of, -1)[owner])
    own = np.flatnonzero(number >= 0)
    order = own[np.argsort(number[own], kind="stable")]
    _, counts = np.unique(number[order], return_counts=True)
    blocks = np.full((len(counts), int(counts.max(initial=0))), -1, dtype=np.intp)
    place = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
    blocks[np.repeat(np.arange(len(counts)), counts), place] = order
    return Split(np.flatnonzero(number < 0), blocks)


def _operations(split: Split, rows: int) -> float:
    """Return about how many operations an evaluation takes, and what is solved with it; ``rows``: measured numbers."""
    (m, a), c = split.blocks.shape, len(split.common)
    return float(rows * (a * (a + c) + c**2) + _SOLVED * (m * a**2 * (a + c) + c**3))


class _Incidence(NamedTuple):
    """Which things rows are about at once: a matrix (u, t) with 1 where one of u different rows is about a thing.

    ``width`` (t,): how many unknowns things have. ``free`` (t,): which may be eliminated. ``family`` (t,): of each.
    """

    about: "scipy.sparse.csr_array"
    width: IntArray
    free: BoolArray
    family: IntArray

    @classmethod
    def of(cls, seen: Sequence[IntArray], width: IntArray, free: BoolArray, things: Things) -> "_Incidence":
        rows, columns, start = [], [], 0
        for own in seen:
            different = np.unique(np.where(free[own] & (own >= 0), own, -1), axis=0)
            row, column = np.nonzero(different >= 0)
            rows.append(start + row)
            columns.append(different[row, column])
            start += len(different)
        row, column = np.concatenate(rows), np.concatenate(columns)
        about = scipy.sparse.csr_array((np.ones(len(row)), (row, column)), shape=(start, things.number))
        family = np.searchsorted(things.ends, np.arange(things.number), side="right")
        return cls(about, width, free, family)

    def blocks(self, widest: int) -> IntArray:
        """Return the block (t,) of every thing, -1 for common ones: none has more than ``widest`` columns."""
        left = self.free & (self.width <= widest)
        while True:
            number = self._joined(left)
            columns = np.bincount(number[left], weights=self.width[left], minlength=int(number.max()) + 1)
            over = left & (columns[number] > widest)
            if not over.any():
                return np.where(left, number, -1)
            left &= ~self._hubs(over)

    def _joined(self, left: BoolArray) -> IntArray:
        """Return a number (t,) for every thing, the same for those that rows join; the others have numbers alone."""
        u, t = self.about.shape
        row, column = self.about.nonzero()
        kept = left[column]
        graph = scipy.sparse.csr_array((np.ones(int(kept.sum())), (row[kept], u + column[kept])), shape=(u + t, u + t))
        return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1][u:], dtype=np.intp)

    def _hubs(self, over: BoolArray) -> BoolArray:
        """Return which (t,) of some things stay common: of the family with the fewest unknowns, what many are about."""
        columns = np.bincount(self.family[over], weights=self.width[over])
        own = over & (self.family == np.argmin(np.where(columns > 0.0, columns, np.inf)))
        rows = np.where(own, self.about.sum(axis=0), 0.0)
        return np.asarray(own & (rows > _MANY * rows.max()))
