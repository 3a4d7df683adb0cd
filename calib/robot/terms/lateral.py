"""Lateral compliance: a joint's bearing turns under the torque about each axis that its drive does not hold.

Of a joint that turns these are the axes x and y across its own, of one that slides all three. The bearing stands where
the joint is placed, and does not turn with it. Basis: -tau about the axis, at nominal geometry.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar

from calib.foundations.selection import select
from calib.robot.flexures import Flexure, tilting
from calib.robot.skeleton import Segment
from calib.robot.terms.kind import Coefficient, Compliance, Dimension, Parts
from calib.robot.terms.moment import OfMasses
from calib.robot.terms.term import JointTerm

_AXES = "xyz"


class Lateral(Compliance):
    """The tilt of a bearing: 100 Nm tilt it by a milliradian."""

    names: ClassVar[tuple[str, ...]] = tuple(f"lateral_{axis}" for axis in _AXES)
    key = "lateral"
    coefficients = {"angle": Coefficient("rad/Nm", 1e-5)}
    shown = {"rad/Nm": "urad/Nm"}
    of_link = True
    chosen_by_data = False

    def motions(self, segments: Sequence[Segment], joint: int, term: JointTerm) -> tuple[Flexure, ...]:
        """Return the turn about the term's axis."""
        return tilting(segments, joint, _axis(term))

    def coefficient(self, term: JointTerm, dimension: Dimension) -> Coefficient:
        """Return unit and typical size of the coefficient, whatever the joint does."""
        return self.coefficients["angle"]

    def there(self, parts: Parts, term: JointTerm) -> bool:
        """Return whether the joint moves, and not about that axis."""
        return self.well_formed(term) and term in self._axes(parts, term.reading)

    def said(self, term: JointTerm) -> str:
        """Return what it is, with its axis."""
        return f"lateral compliance, {_AXES[_axis(term)]}"

    def terms(self, parts: Parts, name: str, options: Mapping[str, object]) -> tuple[JointTerm, ...]:
        """Return those of one joint."""
        return self._axes(parts, name)

    def select(self, selection: object, parts: Parts) -> list[str]:
        """Return the chosen joints, of those that move."""
        return select(selection, list(parts.moving), self.key)

    def _axes(self, parts: Parts, name: str) -> tuple[JointTerm, ...]:
        if name not in parts.moving:
            return ()
        return tuple(JointTerm(name, kind) for kind in self.names[: 3 if parts.moving[name] == "length" else 2])


class LateralMoment(OfMasses, Lateral):
    """The same where masses are not known: compliance times mass, or first moment of mass, of each link."""

    names: ClassVar[tuple[str, ...]] = tuple(f"lateral_moment_{axis}" for axis in _AXES)
    key = "lateral_moments"
    coefficients = {"angle": Coefficient("kg m rad/Nm", 1e-4)}
    shown = {"kg m rad/Nm": "kg m urad/Nm", "kg rad/Nm": "kg urad/Nm"}

    def there(self, parts: Parts, term: JointTerm) -> bool:
        """Return whether the robot has that mass, and the joint that axis."""
        bare = JointTerm(term.reading, term.kind)
        return self.well_formed(term) and term.body in parts.masses and bare in self._axes(parts, term.reading)

    def said(self, term: JointTerm) -> str:
        """Return it with its axis and its mass."""
        return f"lateral moment, {_AXES[_axis(term)]}, {term.body}"

    def terms(self, parts: Parts, name: str, options: Mapping[str, object]) -> tuple[JointTerm, ...]:
        """Return the fewest that make up whatever masses there are."""
        return tuple(term for term in parts.lateral_moments() if term.reading == name)


def _axis(term: JointTerm) -> int:
    return _AXES.index(term.kind[-1])
