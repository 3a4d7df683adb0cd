"""All harmonics of the readings, held by priors of learned widths: the alternative to a choice among them.

Gears and encoders err in many orders at once, each by a little. A choice takes those that stand out and leaves the
others; priors whose widths the data teach take all of them, each as far as the data speak of it. On some arms this
predicts better, at the price of many small coefficients. So it is judged as the choice is, by the same rows held out.

Near the geometric fit all is linear. Products of columns are formed once for every fold; those without its rows are a
difference, and the widths, which each fold learns without its rows, are near those of all rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.assessment.entering import Products
from calib.assessment.validation import HeldOut, held_out, surely_less, unharmed
from calib.foundations.arrays import Array, IntArray
from calib.identification.learned import too_few
from calib.identification.widths import NormalEquations, Widths, likeliest_widths, likelihood, nearby
from calib.robot.terms import JointTerm


@dataclass(frozen=True, slots=True)
class AllHarmonics:
    """All harmonics of some ``readings`` up to an ``order``, with learned widths, and what rows held out say of them.

    ``terms``: they and what else was chosen, but gains of these readings. ``held_out``, ``away``, ``rms`` and
    ``optimism``: as of a step of the choice. ``taken``: whether they predict surely better than what was chosen, and a
    fit converges. ``widths``: those that all rows teach, of every reading that has harmonics.
    """

    readings: tuple[str, ...]
    order: int
    terms: tuple[JointTerm, ...]
    held_out: HeldOut
    away: HeldOut | None
    rms: float
    taken: bool
    widths: tuple[float, ...] = ()
    optimism: tuple[float, ...] = ()

    def record(self) -> dict[str, object]:
        """Return it as plain data, in SI units."""
        return {
            "readings": list(self.readings),
            "order": self.order,
            "coefficients": len(self.terms),
            "held_out": self.held_out.rms,
            "standard_error": self.held_out.standard_error,
            "away": None if self.away is None else self.away.rms,
            "rms": self.rms,
            "taken": self.taken,
        }


class Known(NamedTuple):
    """What is known beside all rows: ``products`` (p + 1, p + 1), of which ``weak`` (p,) are of weak priors.

    ``geometry``: its columns. ``least``: by what factor there can be less noise; ``fixed``: there is as much.
    """

    products: Array
    weak: Array
    geometry: IntArray
    least: float
    fixed: bool


class Offer(NamedTuple):
    """What is offered: harmonics of the ``kept`` readings up to an ``order``.

    ``harmonics`` (readings, orders, 2): the columns of these and of all others. ``start``: widths that all rows teach,
    and ``usual`` (readings,): usual widths of readings of which rows hardly teach them, zero for others.
    """

    known: Known
    harmonics: IntArray
    kept: IntArray
    order: int
    start: Widths
    usual: Array

    @classmethod
    def of(
        cls,
        known: Known,
        harmonics: IntArray,
        products: Products,
        chosen: IntArray,
        most: int,
        begin: Sequence[float] = (),
    ) -> "Offer | None":
        """Return what is offered beside ``chosen`` columns, at most so many with these; None where that is nothing.

        Harmonics of readings of which rows tell too little to teach a width are left out. ``begin``: widths of every
        reading, of more rows of the same machine, near which those of these rows are sought.
        """
        every = np.arange(len(harmonics))
        order = _order(harmonics, every, chosen, most)
        if not order:
            return None
        columns = _columns(harmonics, every, order, chosen)
        few = too_few(_Equations(known, harmonics, products, columns).of(columns, None), len(harmonics))
        kept = np.flatnonzero(~few)
        order = _order(harmonics, kept, chosen, most)
        columns = _columns(harmonics, kept, order, chosen)
        if columns.size == chosen.size:
            return None
        rows = _Equations(known, harmonics, products, columns).of(columns, None)
        widths = np.array(begin) if len(begin) == len(few) else np.ones(len(few))
        usual = np.where(few, 1.0, 0.0)
        start = likeliest_widths(rows, widths, usual=usual)
        return cls(known, harmonics, kept, order, start, usual)

    def columns(self, chosen: IntArray) -> IntArray:
        """Return the columns (k,) of terms, with those that are chosen."""
        return _columns(self.harmonics, self.kept, self.order, chosen)

    def values(self, products: Products, chosen: Sequence[IntArray]) -> Array:
        """Return what is found (folds, p) without the rows of every fold, which has ``chosen`` columns of its own."""
        own = [self.columns(columns) for columns in chosen]
        equations = _Equations(self.known, self.harmonics, products, np.unique(np.concatenate(own)))
        found = np.zeros((len(own), len(self.known.weak)))
        for k, columns in enumerate(own):
            z = nearby(equations.of(columns, k), self.start.widths, self.start.factors, self.usual)
            found[k, np.concatenate([self.known.geometry, columns])] = z
        return found

    def of_all(self, products: Products, chosen: IntArray) -> Array:
        """Return what all rows find (p,) beside ``chosen`` columns."""
        columns, found = self.columns(chosen), np.zeros(len(self.known.weak))
        equations = _Equations(self.known, self.harmonics, products, columns).of(columns, None)
        found[np.concatenate([self.known.geometry, columns])] = likelihood(
            equations, self.start.widths, self.start.factors
        ).z
        return found


def _columns(harmonics: IntArray, kept: IntArray, order: int, chosen: IntArray) -> IntArray:
    return np.union1d(chosen, harmonics[kept, :order])


def _order(harmonics: IntArray, kept: IntArray, chosen: IntArray, most: int) -> int:
    """Return the highest order with which there are at most so many columns, 0 for none."""
    orders = range(harmonics.shape[1] if kept.size else 0, 0, -1)
    return next((k for k in orders if _columns(harmonics, kept, k, chosen).size <= most), 0)


class _Equations:
    """Normal equations of geometry and some terms, with the products of the rows of every fold."""

    def __init__(self, known: Known, harmonics: IntArray, products: Products, terms: IntArray) -> None:
        """Form the products of geometry and ``terms`` (k,), columns of which some may be asked for."""
        self._known, self._products = known, products
        self._columns = np.concatenate([known.geometry, terms, [len(known.weak)]])
        self._grams = products.grams(self._columns)
        self._reading = np.full(len(known.weak), -1)
        self._reading[harmonics] = np.arange(len(harmonics))[:, None, None]

    def of(self, terms: IntArray, without: int | None) -> NormalEquations:
        """Return the equations of geometry and ``terms`` (k,), of all rows or ``without`` those of a fold."""
        known, p = self._known, len(self._known.geometry) + len(terms)
        both = np.concatenate([known.geometry, terms, [len(known.weak)]])
        own = np.flatnonzero(np.isin(self._columns, both))
        place = np.ix_(own, own)
        gram, count = self._grams[-1 if without is None else without][place], self._products.freedom(without)
        reading = self._reading[both[:-1]]
        beside = known.products[np.ix_(both, both)]
        beside[range(p), range(p)] -= np.where(reading >= 0, known.weak[both[:-1]], 0.0)
        least, fixed = np.array([known.least]), np.array([known.fixed])
        return NormalEquations.weighed(gram[None], np.array([count]), beside, least, fixed, reading)


def better(offered: Array, chosen: Array, group: IntArray) -> bool:
    """Return whether squared errors (N,) of rows held out are surely less than as chosen, and no quantile is larger.

    ``group`` (N,): from one to another errors are random.
    """
    harmless = unharmed([held_out(chosen, group), held_out(offered, group)]) == (0, 1)
    return harmless and surely_less(offered, chosen, group)
