"""Which numbers of a robot's DH table are unknown."""

from dataclasses import dataclass
from typing import get_args

from calib.foundations.arguments import own_fields
from calib.foundations.choices import Convention
from calib.foundations.errors import JobError
from calib.foundations.selection import Selection
from calib.foundations.words import refuse_other
from calib.robot.dh.frames import PARALLEL


@dataclass(frozen=True, slots=True)
class Free:
    """DH numbers that are free, in the place of the ``placements`` of :func:`calib.error_model`.

    ``numbers``: "all" numbers of all rows of the robot's DH table, "none", or names and globs of rows (``"joint_3"``)
    or of numbers (``"joint_3.a"``, ``"*.alpha"``). A row is named after its joint and has a, d, alpha, theta, and beta
    in place of d where the next axis is parallel to within ``parallel`` rad. What the joint itself moves (theta of a
    revolute one) is freed, and called, ``joint_3.offset``. ``convention``: "standard" or "modified". ``placements``:
    which are free beside them, of joints whose frames no such number moves.
    """

    numbers: Selection = "all"
    convention: Convention = "standard"
    parallel: float = PARALLEL
    placements: Selection = "none"

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_other(self.convention, get_args(Convention), "dh_convention")
        if not 0.0 <= self.parallel <= 0.5:
            raise JobError(f"dh_parallel: {self.parallel!r} is not an angle between 0 and 0.5 rad.")
