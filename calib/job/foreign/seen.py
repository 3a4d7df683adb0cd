"""What is looked at while one table is read, and what has been concluded so far."""

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from calib.foundations.arrays import BoolArray
from calib.foundations.errors import JobError
from calib.foundations.words import shown
from calib.job.chains import Chain, chains
from calib.job.foreign.answers import Answers, run_of
from calib.measurement.columns import KNOWN
from calib.measurement.orientations import ANGLES, MATRIX
from calib.measurement.raw import RawColumn, RawTable
from calib.measurement.roles import Roles, roles
from calib.measurement.table import APPROACH, QUATERNION_COLUMNS, TORQUE, holds_words, nearest
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

# Columns beside joints for which a person may name one of the file's. Of orientations the fit decides, but for the
# scalar of a quaternion: rows of one orientation fit with the first and with the last of four numbers.
SCALAR = QUATERNION_COLUMNS[0]
CHOSEN = KNOWN - {*QUATERNION_COLUMNS}


class Seen:
    """A table, the arms that it may be of, what names say and a person answered, and the ``reasons`` so far.

    ``robot``: the arm that tables before it have shown.
    """

    def __init__(self, document: Urdf, raw: RawTable, answers: Answers, robot: Robot | None) -> None:
        self.document, self.raw, self.answers = document, raw, answers
        self.arms = chains(document, answers.tip)
        self._robots: dict[Chain, Robot] = {}
        # Whether an arm may be one by itself from any of its joints on: not where a job has some follow others, closes
        # loops or measures at other links, so that its readings are not those of the URDF.
        self.has_ends = True
        if robot is not None:
            base = None if robot.base == document.root else robot.base
            arm = Chain(base, robot.tip, _names(robot))
            self.has_ends = _names(load_robot(document, robot.tip, base)) == arm.joints
            self.arms, self._robots = (arm,), {arm: robot}
        self.known = roles(raw) if raw.named else Roles((), (), (), (), None, frozenset())
        self.named = answers.named()
        self.reasons: list[str] = []
        joints = {name for arm in self.arms for name in arm.joints}
        told = {f"{what}{name}" for what in (APPROACH, TORQUE) for name in joints}
        for ours, theirs in self.named.items():
            if ours not in joints | told | CHOSEN | {SCALAR}:
                raise JobError(f"columns: {_not_chosen(ours, sorted({*joints, *told, *CHOSEN}))}")
            if not any(theirs in (column.title, column.name) for column in raw.columns):
                raise JobError(f"columns: {ours} is to be {theirs!r}, which is no column of {raw.where}.")

    def robot(self, arm: Chain) -> Robot:
        """Return the nominal arm."""
        if arm not in self._robots:
            self._robots[arm] = load_robot(self.document, arm.tip, arm.base)
        return self._robots[arm]

    def column(self, title: str) -> int:
        """Return the column with a title, or with a name."""
        return next(k for k, column in enumerate(self.raw.columns) if title in (column.title, column.name))

    def alike(self) -> BoolArray:
        """Return the rows (N) of the set-up and the tool that most rows have; all, where no column tells them."""
        kinds = [self._told(name) for name in ("setup", "tool")]
        told = list(zip(*(words for words in kinds if words is not None), strict=True))
        most = Counter(told).most_common(1)
        return np.array([one == most[0][0] for one in told]) if most else np.ones(len(self.raw.columns[0].words), bool)

    def _told(self, name: str) -> tuple[str, ...] | None:
        """Return the words of a column of ours, by its own name or as answered."""
        if name in self.named:
            return self.raw.columns[self.column(self.named[name])].words
        own = (column for column in self.raw.columns if self.raw.named and column.name == name and is_ours(column))
        return next((column.words for column in own), None)

    def first_rows(self, last: int) -> str:
        """Return the rows up to one of those that are looked at, in words."""
        seen, count = len(self.raw.columns[0].words), self.raw.count
        return f"rows 1 to {last + 1}" if seen == count else f"rows 1 to about {1 + round(last * count / seen)}"

    def named_rows(self, rows: Sequence[int]) -> str:
        """Return rows of those that are looked at, in words."""
        seen, count = len(self.raw.columns[0].words), self.raw.count
        numbers = ", ".join(str(1 + round(row * count / seen)) for row in rows)
        about = "" if seen == count else "about "
        return f"row{'s' * (len(rows) > 1)} {about}{numbers}{' after the header' if self.raw.named else ''}"

    def titles(self, columns: Iterable[int]) -> str:
        """Return the titles of columns, the middle of many left out."""
        return run_of([self.raw.columns[k].title for k in columns])


def _names(robot: Robot) -> tuple[str, ...]:
    return tuple(reading.name for reading in robot.readings)


def _not_chosen(name: str, allowed: Sequence[str]) -> str:
    if name in (*QUATERNION_COLUMNS, *ANGLES, *MATRIX):
        return f"{name!r} is of an orientation, whose columns the fit finds; give orientation where it asks."
    return f"{shown(name)} is neither a joint of the arm nor a known column{nearest(name, allowed)}."


def is_ours(column: RawColumn) -> bool:
    """Return whether a column that has our name is one of ours: words, or numbers with a unit, whole."""
    if not all(column.words):
        return False
    if holds_words(column.name):
        kinds = len(set(column.words))
        few = column.name in ("tool", "target") and kinds > 0.34 * len(column.words)
        # One group of all rows tells nothing, and would leave none to be held out.
        return column.symbol is None and not few and not (column.name == "group" and kinds == 1)
    return column.numbers is not None and column.symbol is not None
