"""Set-ups: the places where the robot's base stood while it was measured, and what is known of them.

A set-up has a name, and a pose of the base in the instrument's frame. Where instrument and robot never moved against
each other there is one, without a name of its own.
"""

from dataclasses import dataclass

from calib.foundations.arguments import own_fields
from calib.foundations.arrays import Array
from calib.foundations.brief import brief
from calib.foundations.errors import JobError
from calib.foundations.ranges import refuse_beyond, refuse_no_placement
from calib.foundations.sealing import sealed


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class SetUp:
    """What is known of where the robot's base stood: its ``pose`` (4, 4), in m, in the instrument's frame.

    ``length`` (m) and ``angle`` (rad): standard deviations of its three positions and three angles, both or neither;
    without them the base is exactly there.

        known = calib.Known(setups={"left": SetUp(pose, 5e-3, 0.01)})

    Raises JobError when only one of them is given, or one is out of range.
    """

    __repr__ = brief

    pose: Array
    length: float | None = None
    angle: float | None = None

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_no_placement(self.pose, "set-up: pose")
        if (self.length is None) != (self.angle is None):
            raise JobError("set-up: a prior of the base has a length and an angle; give both.")
        if self.length is not None and self.angle is not None:
            refuse_beyond(self.length, "prior.length", "set-up: the prior's length")
            refuse_beyond(self.angle, "prior.angle", "set-up: the prior's angle")

    @property
    def fixed(self) -> bool:
        """Whether the base is exactly there."""
        return self.length is None
