"""What a person said, what is asked, and what is tried of a table."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from calib.foundations.arrays import Array, IntArray
from calib.foundations.sealing import sealed
from calib.foundations.units import MM
from calib.identification.followed import Followed
from calib.job.chains import Chain
from calib.job.proposal import About, Question
from calib.measurement.kinds import Kind
from calib.measurement.raw import RawColumn, split_title
from calib.measurement.roles import Joints, Orientation, Point
from calib.measurement.table import Columns
from calib.robot.robot import Robot
from calib.robot.urdf_writer import CountedZeros


@dataclass(frozen=True, slots=True)
class Answers:
    """What a person said: every field is None, or empty, where nothing was."""

    tip: str | None = None
    angles: str | None = None
    lengths: str | None = None
    orientation: str | None = None
    observes: Kind | None = None
    columns: Mapping[str, str] | None = None

    def named(self) -> dict[str, str]:
        """Return the columns of the file by our names without units."""
        return {split_title(ours)[0]: theirs for ours, theirs in (self.columns or {}).items()}


class AskedError(Exception):
    """A question stops the reading of a table; ``zeros``: how the joints count, where that is what is asked."""

    def __init__(self, question: Question, zeros: CountedZeros | None = None) -> None:
        super().__init__(question.text)
        self.question, self.zeros = question, zeros


def off_arm(miss: float, share: float) -> str:
    """Return how far points are off the nominal arm: rms in m, and as a share of their spread."""
    return f"{miss / MM:.3g} mm rms off the nominal arm, {share:.2%} of their spread"


def ask(about: About, text: str, choices: Iterable[str] = (), option: str | None = None) -> AskedError:
    """Return a question to raise; without ``option`` it is answered by the option of its name."""
    return AskedError(Question(about, text, tuple(choices), option or f"--{about}"))


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """How one table is read, and why."""

    robot: Robot
    observes: Kind
    columns: Columns
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Pick:
    """Columns that may be the joints of an arm and, where the file has one, a point.

    ``target``: the column of a table without a header that may name what was touched.
    """

    arm: Chain
    joints: Joints
    point: Point | None
    turned: tuple[Orientation, ...]
    target: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Trial:
    """A pick in units: how well the arm follows it, from ``tips`` (N, 4, 4) to ``position`` (N, 3) in m.

    ``units``: of angles, of joints that slide, of the point; ``rows`` (N): of the table, that were tried.
    """

    pick: Pick
    units: tuple[str, str, str]
    tips: Array
    position: Array
    rows: IntArray
    fit: Followed

    @property
    def point(self) -> Point:
        """The point of the pick: nothing is tried without one."""
        assert self.pick.point is not None
        return self.pick.point


def run_of(names: Sequence[str]) -> str:
    """Return a row of names, the middle of a long one left out."""
    if len(names) > 4:
        return f"{names[0]} to {names[-1]}"
    return ", ".join(names)


def values_of(column: RawColumn) -> Array:
    """Return the numbers (N,) of a column that has a role."""
    assert column.numbers is not None, "roles have columns of numbers"
    return column.numbers


def of_dimension(columns: Sequence[RawColumn], dimension: Literal["angle", "length"]) -> bool:
    """Return whether columns are in units of a dimension, or have none."""
    return all(column.dimension in (None, dimension) for column in columns)
