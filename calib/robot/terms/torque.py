"""Wind-up by what the drive says that it holds. Basis: b - tau, with tau as measured, and an offset b of the sensor.

The offset, where it is free, is a coefficient of its own, in Nm: by how much all torques are too large. It shapes what
the compliance is multiplied by, and adds nothing by itself. Beside a free offset of the joint it cannot be told.
"""

from collections.abc import Mapping
from typing import ClassVar, cast

import numpy as np

from calib.foundations.arrays import Array
from calib.robot.terms.kind import MEASURED_TORQUE, Basis, Coefficient, Dimension, Kind, Option, Parts, Rows, Shares
from calib.robot.terms.term import JointTerm

_OFFSETS = "torque_offsets"


class Torque(Kind):
    """A compliance under measured torques, which know of friction and of loads that no URDF does."""

    names: ClassVar[tuple[str, ...]] = ("torque", "torque_offset")
    key = "torque"
    options = {_OFFSETS: Option("given", lambda value: value in ("given", "free"), '"given" or "free"')}
    coefficients = {"angle": Coefficient("rad/Nm", 1e-5)}
    shown = {"rad/Nm": "urad/Nm"}
    only = "torques are of joints that turn"
    needs = (MEASURED_TORQUE,)

    def basis(self, shares: Shares) -> Basis:
        """Return the measured torques, the other way round."""
        return self.bases(shares, np.zeros(len(shares.terms)))[0]

    def bases(self, shares: Shares, coefficients: Array) -> tuple[Basis, Basis]:
        """Return the measured torques less their offsets, the other way round, and what an offset does."""
        of = {(term.reading, term.kind): a for term, a in zip(shares.terms, coefficients.tolist(), strict=True)}
        offsets = np.array([of.get((term.reading, "torque_offset"), 0.0) for term in shares.terms])
        compliances = np.array([of.get((term.reading, "torque"), 0.0) for term in shares.terms])
        is_offset = np.array([term.kind == "torque_offset" for term in shares.terms])

        def winds(rows: Rows) -> Array:
            return offsets - cast(Array, rows.conditions.torque)[:, shares.reading]

        return (
            lambda rows: np.where(is_offset, 0.0, winds(rows)),
            lambda rows: np.where(is_offset, compliances, winds(rows)),
        )

    def coefficient(self, term: JointTerm, dimension: Dimension) -> Coefficient:
        """Return unit and size; of an offset Nm."""
        return Coefficient("Nm", 3.0) if term.kind == "torque_offset" else self.coefficients[dimension]

    def said(self, term: JointTerm) -> str:
        """Return what it is called in tables."""
        return term.kind.replace("_", " ")

    def terms(self, parts: Parts, name: str, options: Mapping[str, object]) -> tuple[JointTerm, ...]:
        """Return the compliance, and the offset where that is free."""
        free = options.get(_OFFSETS) == "free"
        return tuple(JointTerm(name, kind) for kind in self.names[: 2 if free else 1])
