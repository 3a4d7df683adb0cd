"""Which parts of a machine's state the parameters move, and how frames follow them."""

from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, IntArray
from calib.identification.arrow import Split
from calib.identification.elimination import Things
from calib.identification.machine import States
from calib.robot.robot import Carrying, Unknowns

# The number of no base, or no tool: the last of what has one entry more than there are.
NO_FRAME = -1


class FramesFollow(NamedTuple):
    """How frames follow parameters: of each, the derivatives ``by`` (k + 1, 6, w) those of w ``columns`` (k + 1, w).

    No frame follows more than a few, so that its other columns are not written out. Last, where ``NO_FRAME`` points: no
    frame, which follows none.
    """

    columns: IntArray
    by: Array

    @classmethod
    def of(cls, entry: IntArray, column: IntArray, share: Array, frames: int, width: int) -> "FramesFollow":
        """Return it from which of six values of frames, ``entry`` (n,), a column (n,) of ``width`` moves by a share."""
        frame = entry // 6
        moved = np.zeros((frames + 1, width), dtype=np.bool_)
        moved[frame, column] = True
        w = int(moved.sum(axis=1).max(initial=0))
        # Its own columns first; where a frame has fewer than others, some that it does not move.
        columns = np.argsort(~moved, axis=1, kind="stable")[:, :w]
        place = np.argmax(columns[frame] == column[:, None], axis=1) if w else column
        by = np.zeros((frames + 1, 6, w))
        np.add.at(by, (frame, entry % 6, place), share)
        return cls(columns, by)

    def turned(self, twists: Array) -> "FramesFollow":
        """Return how something follows the parameters that follows the frames by matrices (k, 6, 6)."""
        if not self.by.size:
            return self
        by = np.zeros(self.by.shape)
        np.matmul(twists, self.by[:-1], out=by[:-1])
        return FramesFollow(self.columns, by)

    def add(self, numbers: Array, frame: IntArray, found: Array) -> None:
        """Add to ``found`` (d, n, p) how numbers follow the parameters through the frames (n,) of rows.

        ``numbers`` (6, d, n): how they follow these; or (3, d, n), their turns alone.
        """
        by = self.by[frame, 6 - len(numbers) :]
        found[:, np.arange(len(frame))[:, None], self.columns[frame]] += np.einsum("edn,new->dnw", numbers, by)

    def written_out(self, frames: IntArray, width: int) -> Array:
        """Return how some frames follow the first parameters (k, 6, width)."""
        found = np.zeros((len(frames), 6, max(width, int(self.columns.max(initial=-1)) + 1)))
        found[np.arange(len(frames))[:, None], :, self.columns[frames]] = np.swapaxes(self.by[frames], 1, 2)
        return found[:, :, :width]

    @property
    def every(self) -> IntArray:
        """The numbers of all frames, and last that of none."""
        return np.arange(len(self.by))


class Selection:
    """Which of the state the parameters of a split move, for ``units`` (p,) of each.

    Columns are those of the c common parameters, then a that all blocks share: a row is about one block at most.
    ``of_robot``, ``of_terms`` and ``of_scalars``: parts of the state (k, c + a) as they follow them; ``of_bases``,
    ``of_tools`` and ``of_targets``: frames. ``each_base`` and ``each_tool`` (k + 1, 6, c + a): the first two, written
    out, of which there are few, then none. ``block`` (t + 1,): of all ``things``, as
    :meth:`calib.identification.elimination.Things.in_blocks` has it.
    """

    def __init__(self, states: States, units: Array, split: Split | None) -> None:
        layout, split = states.layout, Split.none(len(units)) if split is None else split
        entry, parameter, share = states.entries
        share, column = share * units[parameter], split.columns[parameter]
        self.split, self.common, self.things = split, len(split.common), Things.of(layout)
        self.block = self.things.in_blocks(entry, split.block_of[parameter])
        self.width = self.common + split.blocks.shape[1]

        def followed(start: int, end: int) -> Array:
            S = np.zeros((end - start, self.width))
            k = np.flatnonzero((entry >= start) & (entry < end))
            np.add.at(S, (entry[k] - start, column[k]), share[k])
            return S

        def frames(start: int, end: int) -> FramesFollow:
            k = np.flatnonzero((entry >= start) & (entry < end))
            return FramesFollow.of(entry[k] - start, column[k], share[k], (end - start) // 6, self.width)

        self.of_robot, self.of_terms = followed(0, layout.terms), followed(layout.terms, layout.base)
        self.of_bases, self.of_tools = frames(layout.base, layout.tools), frames(layout.tools, layout.targets)
        self.each_base, self.each_tool = (
            own.written_out(own.every, self.width) for own in (self.of_bases, self.of_tools)
        )
        self.of_targets = frames(layout.targets, layout.scalars)
        self.of_scalars = followed(layout.scalars, layout.size)
        self._carried: dict[tuple[str, int, int], Unknowns] = {}

    def carried_by(self, carrying: Carrying, link: str, group: int, tool: int) -> Unknowns:
        """Return how what carries a link follows the parameters, with the base of a set-up, or none, and a tool."""
        key = link, group, tool
        if key not in self._carried:
            S = np.concatenate([self.of_robot, self.each_base[group], self.each_tool[tool]])
            self._carried[key] = carrying.by(S)
        return self._carried[key]
