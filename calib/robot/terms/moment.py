"""Wind-up where masses are not known: compliance times first moment of mass. Basis: -tau of 1 kg m of one link."""

from collections.abc import Mapping
from typing import ClassVar, Literal

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import JobError
from calib.robot.conditions import Conditions
from calib.robot.terms.kind import Basis, Coefficient, Dimension, Kind, Parts, Rows, Shares
from calib.robot.terms.term import JointTerm

_WITHOUT_METRES = {"kg m rad/Nm": "kg rad/Nm", "kg m2/N": "kg m/N"}


class OfMasses(Kind):
    """Compliance times a mass, or first moment of mass, that nobody states: a coefficient for each link."""

    masses: ClassVar[Literal["none", "stated", "unknown"]] = "unknown"

    def basis(self, shares: Shares) -> Basis:
        """Return what each mass alone would have the joint hold, the other way round."""

        def found(rows: Rows) -> Array:
            units = np.array([rows.weights.units[term.body] for term in shares.terms], dtype=np.intp)
            return -rows.weights.of_units(rows.readings, rows.conditions)[units, :, shares.coordinate].T

        return found

    def coefficient(self, term: JointTerm, dimension: Dimension) -> Coefficient:
        """Return unit and size: of a mass that slides there are no metres."""
        own = super().coefficient(term, dimension)
        return own._replace(unit=_WITHOUT_METRES[own.unit]) if term.body.endswith("_mass") else own

    def well_formed(self, term: JointTerm) -> bool:
        """Return whether it names a mass."""
        return term.order == 0 and term.body != ""

    def chosen(self, selection: object, parts: Parts, options: Mapping[str, object]) -> tuple[JointTerm, ...]:
        """Return those of the chosen joints. Raises JobError where none of them would ever hold a mass."""
        names, found = self.select(selection, parts), super().chosen(selection, parts, options)
        if names and not found:
            raise JobError(f"{self.key}: {names[0]!r} is never loaded by gravity; leave it out.")
        return found


class Moment(OfMasses):
    """Ten kilograms, or kilogram metres, on a drive as soft as an ordinary one."""

    names = ("moment",)
    key = "moments"
    coefficients = {"angle": Coefficient("kg m rad/Nm", 1e-4), "length": Coefficient("kg m2/N", 1e-6)}
    shown = {
        "kg rad/Nm": "kg urad/Nm",
        "kg m rad/Nm": "kg m urad/Nm",
        "kg m/N": "kg um/N",
        "kg m2/N": "kg m um/N",
    }

    def there(self, parts: Parts, term: JointTerm) -> bool:
        """Return whether the robot has that mass."""
        return super().there(parts, term) and term.body in parts.masses

    def said(self, term: JointTerm) -> str:
        """Return it with its mass."""
        return f"moment {term.body}"

    def terms(self, parts: Parts, name: str, options: Mapping[str, object]) -> tuple[JointTerm, ...]:
        """Return the fewest that make up whatever masses there are."""
        return tuple(term for term in parts.moments() if term.reading == name)

    def shows(self, parts: Parts, told: Conditions, reading: int) -> bool:
        """Return whether masses are not stated, and stay the same: else compliances say it with fewer coefficients."""
        same = told.payload is None or np.array_equal(told.payload[1:], told.payload[:-1], equal_nan=True)
        return same and not parts.weighed()
