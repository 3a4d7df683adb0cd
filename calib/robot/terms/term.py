"""A joint term: what one effect is called, and of what it is."""

from dataclasses import dataclass

WHOLE_ARM = "arm"


@dataclass(frozen=True, slots=True)
class JointTerm:
    """One term of one reading; of links and bearings: of those before the joint that ``reading`` names.

    ``kind``: a name of ``calib.robot.terms.NAMED``. ``order``: periods of a harmonic in a turn of the reading, 0
    for all other kinds. ``body``: of a moment, the joint that carries it and its axis in the joint's frame, as
    ``joint_4_x``, or ``joint_4_mass``; "" for all other kinds.
    """

    reading: str
    kind: str
    order: int = 0
    body: str = ""

    @property
    def owner(self) -> str:
        """What it is of, in words: the reading, the joint after the link, or the whole arm."""
        return self.reading or WHOLE_ARM

    @property
    def name(self) -> str:
        """Name of its coefficient as a parameter: ``joint_2.gain``, ``joint_2.cos_1``, ``joint_2.moment_joint_4_x``."""
        what = self.order or self.body
        return f"{self.owner}.{self.kind}_{what}" if what else f"{self.owner}.{self.kind}"
