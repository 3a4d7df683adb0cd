"""Wind-up by what the drive says that it holds. Basis: -tau, as measured."""

from typing import cast

from calib.foundations.arrays import Array
from calib.robot.conditions import Conditions
from calib.robot.terms.kind import Basis, Coefficient, Kind, Parts, Shares, changes, unsaid
from calib.robot.terms.term import JointTerm


class Torque(Kind):
    """A compliance under measured torques, which know of friction and of loads that no URDF does."""

    names = ("torque",)
    key = "torque"
    coefficients = {"angle": Coefficient("rad/Nm", 1e-5)}
    shown = {"rad/Nm": "urad/Nm"}
    only = "torques are of joints that turn"

    def basis(self, shares: Shares) -> Basis:
        """Return the measured torques, the other way round."""
        return lambda rows: -cast(Array, rows.conditions.torque)[:, shares.reading]

    def lacking(self, term: JointTerm, reading: int, conditions: Conditions) -> str | None:
        """Return the column of the reading's torque, where it is not told."""
        return f"tau_{term.reading}" if unsaid(conditions.torque, reading) else None

    def shows(self, parts: Parts, told: Conditions, reading: int) -> bool:
        """Return whether the torque changes."""
        return told.torque is not None and changes(told.torque[:, reading])
