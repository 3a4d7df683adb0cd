"""Temperature with memory: the zero wanders as a casting warms up, later than the sensor. Basis: w - 20 degC.

w follows the temperature through a first-order lag (:mod:`calib.robot.warming`) whose time constant is a coefficient
of its own: in decades, about a nominal one. It shapes what the other is multiplied by, and adds nothing by itself.
"""

from collections.abc import Mapping
from typing import ClassVar, cast

import numpy as np

from calib.foundations.arrays import Array
from calib.robot.conditions import REFERENCE_TEMPERATURE, Conditions
from calib.robot.terms.kind import TEMPERATURE, Basis, Coefficient, Dimension, Kind, Needed, Parts, Rows, Shares
from calib.robot.terms.term import JointTerm
from calib.robot.warming import FASTEST, SLOWEST, rungs

# From where a search for a time constant begins, in s; where data choose, it may begin at others.
USUAL = 1800
OFFERED = (150, 300, 600, 1200, 2400, 4800, 9600)


class Warming(Kind):
    """Ten kelvin move a zero by a tenth of a milliradian, or of a millimetre, within half an hour or so."""

    names: ClassVar[tuple[str, ...]] = ("warming", "warming_time")
    key = "warming"
    coefficients = {"angle": Coefficient("rad/K", 1e-5), "length": Coefficient("m/K", 1e-5)}
    shown = {"rad/K": "urad/K", "m/K": "um/K"}
    needs: ClassVar[tuple[Needed, ...]] = (
        TEMPERATURE._replace(lacks=lambda told, _: told.temperature is None and told.lagged is None),
        Needed("time", lambda told, _: told.lagged is None, lambda told, _: told.lagged is not None),
    )

    def basis(self, shares: Shares) -> Basis:
        """Return how warm what lags by nominal time constants is."""
        return self.bases(shares, np.zeros(len(shares.terms)))[0]

    def bases(self, shares: Shares, coefficients: Array) -> tuple[Basis, Basis]:
        """Return how warm what lags is, and the same with what a decade more of a time constant would change."""
        number = {(term.reading, term.order, term.kind): k for k, term in enumerate(shares.terms)}
        size, log_tau, slopes = len(shares.terms), np.empty(len(shares.terms)), np.zeros(len(shares.terms))
        is_time = np.array([term.kind == "warming_time" for term in shares.terms])
        for k, term in enumerate(shares.terms):
            time = number.get((term.reading, term.order, "warming_time"))
            warms = number.get((term.reading, term.order, "warming"))
            log_tau[k] = np.log(term.order) + (0.0 if time is None else np.log(10.0) * coefficients[time])
            slopes[k] = 0.0 if warms is None else np.log(10.0) * coefficients[warms]
        value, slope = rungs(np.exp(np.clip(log_tau, np.log(FASTEST) - 1.0, np.log(SLOWEST) + 1.0)))

        def adds(rows: Rows) -> Array:
            return np.where(is_time, 0.0, _lagged(rows) @ value - REFERENCE_TEMPERATURE)

        def changing(rows: Rows) -> Array:
            warm = _lagged(rows)
            return np.where(is_time, (warm @ slope) * slopes, warm @ value - REFERENCE_TEMPERATURE)

        return (adds, changing) if size else (adds, adds)

    def coefficient(self, term: JointTerm, dimension: Dimension) -> Coefficient:
        """Return unit and size; of a time constant decades."""
        return Coefficient("decade", 0.15) if term.kind == "warming_time" else self.coefficients[dimension]

    def well_formed(self, term: JointTerm) -> bool:
        """Return whether it has a nominal time constant."""
        return FASTEST <= term.order <= SLOWEST and term.body == ""

    def said(self, term: JointTerm) -> str:
        """Return it with its nominal time constant."""
        return f"{term.kind.replace('_', ' ')}, {term.order} s"

    def terms(self, parts: Parts, name: str, options: Mapping[str, object]) -> tuple[JointTerm, ...]:
        """Return the coefficient and the time constant of one reading."""
        return warming(name, USUAL)

    def offered(
        self, parts: Parts, told: Conditions, options: Mapping[str, object]
    ) -> tuple[tuple[JointTerm, ...], ...]:
        """Return both coefficients together, of several nominal time constants."""
        if not self.shows(parts, told, 0):
            return ()
        return tuple(warming(name, tau) for name in parts.readings for tau in OFFERED)


def warming(reading: str, tau: int) -> tuple[JointTerm, JointTerm]:
    """Return the terms of one reading that begin with a time constant in s."""
    return JointTerm(reading, "warming", tau), JointTerm(reading, "warming_time", tau)


def _lagged(rows: Rows) -> Array:
    return cast(Array, rows.conditions.lagged)
