"""What is looked at while one table is read, and what has been concluded so far."""

from collections.abc import Iterable

from calib.foundations.errors import JobError
from calib.job.chains import Chain, chains
from calib.job.foreign.answers import Answers, run_of
from calib.measurement.raw import RawTable
from calib.measurement.roles import Roles, roles
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf


class Seen:
    """A table, the arms that it may be of, what names say and a person answered, and the ``reasons`` so far.

    ``robot``: the arm that tables before it have shown.
    """

    def __init__(self, document: Urdf, raw: RawTable, answers: Answers, robot: Robot | None) -> None:
        self.document, self.raw, self.answers = document, raw, answers
        self.arms = chains(document, answers.tip)
        self._robots: dict[Chain, Robot] = {}
        if robot is not None:
            base = None if robot.base == document.root else robot.base
            arm = Chain(base, robot.tip, tuple(reading.name for reading in robot.readings))
            self.arms, self._robots = (arm,), {arm: robot}
        self.known = roles(raw) if raw.named else Roles((), (), (), (), None, frozenset())
        self.named = answers.named()
        self.reasons: list[str] = []
        for ours, theirs in self.named.items():
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

    def titles(self, columns: Iterable[int]) -> str:
        """Return the titles of columns, the middle of many left out."""
        return run_of([self.raw.columns[k].title for k in columns])
