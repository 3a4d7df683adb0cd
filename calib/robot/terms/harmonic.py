"""Harmonics: encoder eccentricity (orders 1, 2), gear teeth and wave generators (more). Bases: cos k u, sin k u."""

from collections.abc import Callable, Mapping, Sequence
from typing import cast

import numpy as np

from calib.foundations.arrays import Array
from calib.robot.conditions import Conditions
from calib.robot.terms.kind import Basis, Coefficient, Dimension, Kind, Option, Parts, Shares, Slope
from calib.robot.terms.term import HIGHEST_ORDER, JointTerm

# Offered where data choose: a harmonic drive wobbles up to the fortieth order. On a real UR10 orders above 12 halve
# what is left.
OFFERED = tuple(range(1, 41))
_ORDERS = "harmonic_orders"
# Of orders (n,) and phases (N, n).
_Wave = Callable[[Array, Array], Array]


def _are_orders(value: object) -> bool:
    if not isinstance(value, Sequence) or isinstance(value, str):
        return False
    return all(type(k) is int and 1 <= k <= HIGHEST_ORDER for k in value)


class Harmonic(Kind):
    """Cosine and sine of a multiple of the reading: 20 arc seconds are usual."""

    names = ("cos", "sin")
    key = "harmonics"
    options = {_ORDERS: Option((1, 2), _are_orders, f"a list of whole numbers from 1 to {HIGHEST_ORDER}")}
    coefficients = {"angle": Coefficient("rad", 1e-4)}
    only = "harmonics are of angles"
    priors = {"angle": "harmonics"}

    def basis(self, shares: Shares) -> Basis:
        """Return the waves."""
        waves = _waves(shares)
        return lambda rows: waves(rows.readings, lambda _, phase: np.cos(phase), lambda _, phase: np.sin(phase))

    def slope(self, shares: Shares) -> Slope:
        """Return their slopes."""
        waves = _waves(shares)
        return lambda readings: waves(readings, lambda k, phase: -k * np.sin(phase), lambda k, phase: k * np.cos(phase))

    def well_formed(self, term: JointTerm) -> bool:
        """Return whether it has an order."""
        return 0 < term.order <= HIGHEST_ORDER and term.body == ""

    def group(self, term: JointTerm, dimension: Dimension) -> str:
        """Return the name of the harmonics of one reading."""
        return f"harmonics of {term.reading}"

    def said(self, term: JointTerm) -> str:
        """Return the order: both waves enter together."""
        return f"harmonic {term.order}"

    def terms(self, parts: Parts, name: str, options: Mapping[str, object]) -> tuple[JointTerm, ...]:
        """Return cosine and sine of every order."""
        orders = cast(Sequence[int], options.get(_ORDERS, self.options[_ORDERS].default))
        return tuple(term for order in sorted(set(orders)) for term in harmonic(name, order))

    def offered(
        self, parts: Parts, told: Conditions, options: Mapping[str, object]
    ) -> tuple[tuple[JointTerm, ...], ...]:
        """Return both waves of one order together."""
        orders = cast(Sequence[int], options.get(_ORDERS, OFFERED))
        return tuple(
            harmonic(name, order) for name in parts.readings if not self.refusal(parts, name) for order in orders
        )


def harmonic(reading: str, order: int) -> tuple[JointTerm, JointTerm]:
    """Return cosine and sine of one order of one reading."""
    return JointTerm(reading, "cos", order), JointTerm(reading, "sin", order)


def _waves(shares: Shares) -> Callable[[Array, _Wave, _Wave], Array]:
    """Return what evaluates waves (N, shares) at readings (N, nr), of cosine terms and of sine terms."""
    orders = np.array([term.order for term in shares.terms], dtype=np.float64)
    of_kind = [np.flatnonzero([term.kind == name for term in shares.terms]) for name in Harmonic.names]

    def waves(readings: Array, cosine: _Wave, sine: _Wave) -> Array:
        found = np.empty((len(readings), len(orders)))
        for those, wave in zip(of_kind, (cosine, sine), strict=True):
            k = orders[those]
            found[:, those] = wave(k, readings[:, shares.reading[those]] * k)
        return found

    return waves
