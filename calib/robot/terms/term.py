"""A joint term: what one effect is called, and of what it is."""

from dataclasses import dataclass

from calib.foundations.arguments import own_fields
from calib.foundations.errors import JobError

WHOLE_ARM = "arm"
# Of harmonics; and of all terms, a time constant of days in s.
HIGHEST_ORDER, LARGEST = 1000, 1_000_000


@dataclass(frozen=True, slots=True)
class JointTerm:
    """One term of one reading; of links and bearings: of those before the joint that ``reading`` names.

    ``kind``: a name of ``calib.robot.terms.NAMED``. ``order``: periods of a harmonic in a turn of the reading, or the
    nominal time constant of a memory in s; 0 for all other kinds. ``body``: of a moment, the joint that carries it and
    its axis in the joint's frame, as ``joint_4_x``, or ``joint_4_mass``; "" for all other kinds.
    """

    reading: str
    kind: str
    order: int = 0
    body: str = ""

    def __post_init__(self) -> None:
        own_fields(self)
        if not 0 <= self.order <= LARGEST:
            raise JobError(f"joint term of {self.reading!r}: order is {self.order}; allowed are 0 to {LARGEST}.")

    @property
    def owner(self) -> str:
        """What it is of, in words: the reading, the joint after the link, or the whole arm."""
        return self.reading or WHOLE_ARM

    @property
    def name(self) -> str:
        """Name of its coefficient as a parameter: ``joint_2.gain``, ``joint_2.cos_1``, ``joint_2.moment_joint_4_x``."""
        what = self.order or self.body
        return f"{self.owner}.{self.kind}_{what}" if what else f"{self.owner}.{self.kind}"
