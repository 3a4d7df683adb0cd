"""The rows of geometry and of all candidate joint terms, linearised at the geometric fit.

About the geometric fit everything is linear in the coefficients of joint terms. The whitened Jacobian of geometry and
of all candidates is taken once, and what would be hundreds of fits are eliminations on its Gram matrices, one for every
fold. Targets, and other unknowns that few rows are about, are eliminated first.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from calib.assessment.all_harmonics import Known
from calib.assessment.eliminated import Own
from calib.assessment.entering import Blocks, Products, filled
from calib.assessment.validation import HeldOut, held_out
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.errors import IdentificationError
from calib.foundations.linear import ROUNDING
from calib.foundations.sealing import sealed
from calib.identification.error_model import with_terms
from calib.identification.fit import Fit
from calib.identification.initialisation.problem import initial_problem
from calib.identification.losses import Loss
from calib.identification.machine import values_at
from calib.identification.parameters import asked_for, directions, scales
from calib.identification.system import related
from calib.identification.weights import sigmas_of
from calib.identification.widths import TOO_UNLIKE
from calib.machine.tool_motion import tool_jacobian
from calib.measurement.kinds import QUANTITIES
from calib.robot.conditions import ordinary
from calib.robot.robot import Deviations, Robot
from calib.robot.sampling import closing
from calib.robot.terms import JointTerm, kind_of

# Bytes of derivatives that are kept rather than made again.
_MOST_KEPT = 2**28
# Beside what is eliminated. Of many more, as of tools and set-ups that cross, the products would fill the memory.
_MOST_UNKNOWNS = 2000
# A coefficient that helps by less, in variances of what is left, ends the way: of one that does nothing it is 1.
_BY_CHANCE = 2.0


@dataclass(frozen=True, slots=True)
class Candidate:
    """Terms that enter together: cosine and sine of one order of one reading, or a term alone."""

    terms: tuple[JointTerm, ...]

    @property
    def name(self) -> str:
        """Name for tables."""
        first = self.terms[0]
        return f"{first.owner}: {kind_of(first).said(first)}"


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Way:
    """Candidates in the order in which they entered, and changes (steps + 1, p) of the scaled parameters."""

    order: tuple[int, ...]
    values: Array


class Errors(NamedTuple):
    """Errors of rows held out: mean ``squares`` (steps, N) of rows, and ``by_component`` (steps, c), whitened.

    ``rms`` (steps,): of every quantity, in SI units.
    """

    squares: Array
    by_component: Array
    rms: Mapping[str, Array]


class Judged(NamedTuple):
    """Ways of all folds, each without its rows, and the ``errors`` of these after every step (steps + 1).

    ``group`` (N,): from one to another errors are random. ``figures``: of every step.
    """

    products: Products
    fold: IntArray
    group: IntArray
    ways: tuple[Way, ...]
    errors: Errors
    figures: list[HeldOut]

    @property
    def values(self) -> Array:
        """What is found (folds, steps + 1, p)."""
        return np.stack([way.values for way in self.ways])


class _Rows(NamedTuple):
    """Rows of one set: sigmas (n, d), whitened ``J_r`` (n, d, p + 1) and what they are about of their own."""

    measurements: int
    sigma: Array
    J_r: Array
    own: Own | None


class LinearisedSystem:
    """The linearised rows of geometry and all candidates, at the geometric fit."""

    def __init__(
        self,
        geometric: Fit,
        offered: Sequence[Candidate],
        losses: Sequence[Loss] | None,
        looked_at: BoolArray,
        costs: Array,
        model_sigmas: Sequence[float | None] | None = None,
    ) -> None:
        self._costs = costs
        terms = [term for candidate in offered for term in candidate.terms]
        full = with_terms(geometric.model, terms)
        sets = geometric.measurements
        frames, d = geometric.machine.frames, geometric.machine.deviations
        held = Deviations(d.placements, d.offsets, np.zeros(len(terms)))
        given = None if losses is None else tuple(losses)
        whole = initial_problem(full, sets)
        # Widths that geometry has taught are held to; those of candidates, where learned, would need them all at once.
        known = {parameter.name: parameter.prior for parameter in geometric.parameters}
        parameters = tuple(
            p if (prior := known.get(p.name, p.prior)) == p.prior else replace(p, prior=prior) for p in whole.parameters
        )
        self._problem = replace(whole, parameters=parameters, reference=frames, held=held, given_losses=given)
        # A stated prior pulls towards zero; a weak one holds at the geometric fit.
        stated = np.array([parameter.prior is not None for parameter in parameters])
        self._split = self._problem.of_known_widths.without(stated)
        common = self._split.common
        if (count := sum(parameters[k].kind != "term" for k in common)) > _MOST_UNKNOWNS:
            raise IdentificationError(
                f"terms are chosen beside {_MOST_UNKNOWNS} unknowns of arm, base, tools and targets at most, and here "
                f"are {count}; choose them by some of the targets, or by hand."
            )
        self._x = values_at(full.robot, parameters, frames, held)
        self._sigmas = sigmas_of(
            self._problem, [noise.model**2 for noise in geometric.noise_by_rows], geometric.residuals
        )
        self._kept: tuple[_Rows, ...] | None = None
        self._looked_at = np.split(looked_at, np.cumsum([len(data) for data in sets])[:-1])
        # Known without any row: relations between targets, and priors.
        rows = related(self._problem, self._x, self._split)
        self._known = rows.T @ rows
        priors, self._held = self._split.parts(np.array([parameter.hold for parameter in parameters]) ** 2)
        self._held[~self._split.real] = 1.0
        unknowns = range(len(common))
        self._known[unknowns, unknowns] += priors
        self._known[:-1, -1] += priors * np.where(stated, self._x / scales(parameters), 0.0)[common]
        self._weak = np.where(stated[common], 0.0, priors)
        self._fixed = self._problem.robust or (model_sigmas is not None and None not in model_sigmas)
        self._geometry = [k for k, parameter in enumerate(common) if parameters[parameter].kind != "term"]
        number = {parameters[parameter].name: k for k, parameter in enumerate(common)}
        self._columns = [[number[term.name] for term in candidate.terms] for candidate in offered]
        self._filled = filled(self._columns)
        self._widen_terms()

    def _widen_terms(self) -> None:
        """Give joint terms their wider weak priors where rows ask for it, kind by kind until they ask no more.

        Beside all that is left without them, large terms would seem to be unknown, and their weak priors hold them.
        """
        groups, wider = defaultdict[str, list[int]](list), np.zeros(len(self._split.common))
        for k, parameter in enumerate(self._problem.parameters[p] for p in self._split.common):
            if parameter.kind == "term" and parameter.wider is not None:
                groups[parameter.wider.group].append(k)
                wider[k] = (parameter.scale / parameter.wider.prior) ** 2
        products = self.products(np.zeros(sum(int(own.sum()) for own in self._looked_at), dtype=np.intp))
        beside, asking = list(self._geometry), True
        while asking:
            asking = False
            for group, own in list(groups.items()):
                if self._asked(products, beside, own, wider[own]):
                    self._known[own, own] += wider[own] - self._weak[own]
                    self._weak[own] = wider[own]
                    beside, asking = [*beside, *groups.pop(group)], True

    def _asked(self, products: Products, beside: Sequence[int], own: Sequence[int], wider: Array) -> bool:
        """Return whether rows ask, by F, for ``wider`` weights (k,) of priors of ``own`` columns ``beside`` others."""
        freedom, which = products.freedom(None) - len(beside), np.array([*beside, *own, len(self._weak)])
        if freedom <= 0.0:
            return False
        before = products.grams(which)[-1] + self._known[np.ix_(which, which)]
        after, places = before.copy(), np.arange(len(beside), len(which) - 1)
        after[places, places] += wider - self._weak[own]
        left = _left(after)
        gain = _left(before) - left
        return asked_for(gain, left, len(own), freedom)

    @property
    def robot(self) -> Robot:
        """The robot with the terms of all candidates."""
        return self._problem.model.robot

    @property
    def known(self) -> Known:
        """What is known beside all rows."""
        shares = [np.mean((d.sigma / s) ** 2) for d, s in zip(self._problem.measurements, self._sigmas, strict=True)]
        return Known(self._known, self._weak, np.array(self._geometry), float(np.sqrt(min(shares))), fixed=self._fixed)

    def columns(self, candidates: Sequence[int]) -> IntArray:
        """Return the columns of some candidates."""
        return np.array([column for k in candidates for column in self._columns[k]], dtype=np.intp)

    def _rows(self) -> Iterable[_Rows]:
        """Return all rows, part by part.

        They are asked for again and again, and kept unless they are too many.
        """
        if self._kept is None:
            width = 8 * (len(self._known) + self._split.blocks.shape[1])
            size = sum(width * sigmas.size for sigmas in self._sigmas)
            if size > _MOST_KEPT:
                return self._made()
            self._kept = tuple(self._made())
        return self._kept

    def _made(self) -> Iterable[_Rows]:
        problem = self._problem
        rates = problem.rates(problem.machine(self._x), scales(problem.parameters), self._split)
        sets = zip(problem.measurements, self._sigmas, self._looked_at, strict=True)
        for i, (every, sigmas, own) in enumerate(sets):
            data, sigma = (every, sigmas) if own.all() else (every.subset(own), sigmas[own])
            for block in rates.blocks(data):
                s = sigma[block.rows, :, None]
                whole = np.concatenate([block.J, block.observed.residual[:, :, None]], axis=2) / s
                alone = None if block.own is None or block.block is None else Own(block.own / s, block.block)
                yield _Rows(i, sigma[block.rows], whole, alone)

    def products(self, fold: IntArray) -> Products:
        """Return the products of the columns of ``[J r]`` (p + 1) for rows without those of every fold (N,)."""

        def rows() -> Iterable[tuple[IntArray, Array, Own | None]]:
            start = 0
            for part in self._rows():
                yield fold[start : (start := start + len(part.J_r))], part.J_r, part.own

        numbers = sum(
            data.sigma[own].size for data, own in zip(self._problem.measurements, self._looked_at, strict=True)
        )
        return Products(rows(), int(fold.max()) + 1, numbers, len(self._known), self._filled[0], self._held)

    def judged(
        self,
        fold: IntArray,
        group: IntArray,
        products: Products,
        among: Sequence[int],
        steps: int,
        progress: Callable[[str], None] = lambda _: None,
    ) -> Judged:
        """Return what rows held out say of so many ``steps`` among candidates.

        ``fold`` (N,) and ``group`` (N,), from which errors are random, of rows; ``products``: of every fold.
        """
        ways = list[Way]()
        for k in range(len(products)):
            progress(f"choosing joint terms: fold {k + 1} of {len(products)}")
            ways.append(self.way(products, among, without=k, steps=steps))
        progress("choosing joint terms: judging by what was held out")
        errors = self.errors(products, fold, np.stack([way.values for way in ways]))
        return Judged(products, fold, group, tuple(ways), errors, [held_out(row, group) for row in errors.squares])

    def scatter(self, poses: Array, whole: Array, without: Array) -> Array:
        """Return how far predictions of the tool at poses (n, nr) scatter after every step (steps + 1,), in m.

        ``whole`` (steps + 1, p): what all rows have found; ``without`` (places, steps + 1, p): the same without each of
        the places, for which others may have entered. Rms of the jackknife over places; infinite where no loop closes.
        """
        problem, places = self._problem, len(without)
        machine = problem.machine(self._x)
        at = poses[closing(problem.model.robot, poses, (machine.deviations,))]
        if not len(at):
            return np.full(len(whole), np.inf)
        by_state = tool_jacobian(problem.model.robot, machine, at, ordinary(at))[:, :3]
        J = by_state @ (directions(problem.parameters, by_state.shape[2]) * scales(problem.parameters))
        J = J[:, :, self._split.common]
        change = (without - whole) @ J.reshape(-1, len(self._known) - 1).T
        return np.asarray(np.sqrt((places - 1) / places * np.sum(np.mean(change**2, axis=2) * 3.0, axis=0)))

    def way(
        self,
        products: Products,
        among: Sequence[int],
        *,
        without: int | None = None,
        steps: int | None = None,
        most: int | None = None,
        lasting: bool = False,
    ) -> Way:
        """Return the way that rows with these products go ``among`` candidates, best first, ``without`` a fold.

        At most so many ``steps``, and as ``most`` so many coefficients; ``lasting`` as long as the best
        lowers the sum of squares by more than chance would. Raises IdentificationError where equations are singular.
        """
        p, first = len(self._known) - 1, len(self._geometry)
        # Rows of what entered, as they were then, and solved for their own unknowns; no others are ever needed.
        rows, solved = np.empty((p, p + 1)), np.empty((p, p + 1))
        entered, ends, order = list[int](), [0], list[int]()

        def enter(new: Sequence[int]) -> None:
            start = ends[-1]
            own = slice(start, start + len(new))
            rows[own] = products.rows(new, without) + self._known[new] - rows[:start, new].T @ solved[:start]
            try:
                solved[own] = np.linalg.solve(rows[own, new], rows[own])
            except np.linalg.LinAlgError as e:
                raise IdentificationError(TOO_UNLIKE) from e
            blocks.eliminate(rows[own], solved[own])
            entered.extend(new)
            ends.append(own.stop)

        columns, _ = self._filled
        C, g = products.blocks(without)
        C, g = C + self._known[columns[:, :, None], columns[:, None, :]], g + self._known[columns, -1]
        blocks = Blocks(self._filled, C, g, self._costs, among)
        squares = float(products.rows([p], without)[0, p])
        enter(self._geometry)
        while len(order) < (len(among) if steps is None else min(steps, len(among))):
            best, gain = blocks.take()
            new, terms = self._columns[best], ends[-1] - first
            if (most is not None and terms + len(new) > most) or (
                lasting and gain * (products.freedom(None) - ends[-1]) <= _BY_CHANCE * squares
            ):
                break
            squares -= gain * self._costs[best]
            order.append(best)
            enter(new)
        # They are triangular: the solution after so many steps is the sum of as many columns of the inverse.
        inverse = scipy.linalg.solve_triangular(
            solved[: len(entered), entered], np.eye(len(entered)), unit_diagonal=True
        )
        sums = np.cumsum(inverse * -solved[: len(entered), p], axis=1)
        values = np.zeros((1 + len(order), p))
        values[:, entered] = sums[:, np.array(ends[1:]) - 1].T
        return Way(tuple(order), values)

    def errors(self, products: Products, fold: IntArray, values: Array) -> Errors:
        """Return the errors of rows held out.

        ``products``: of every ``fold`` (N,); ``values`` (folds, steps, p): what each has found without its own rows.
        """
        steps, components = values.shape[1], self._problem.components
        number = {(c.measurements, c.quantity): k for k, c in enumerate(components)}
        squares, counts = np.zeros((steps, len(components))), np.zeros(len(components))
        found: list[Array] = []
        sums: dict[str, Array] = {}
        rows_of: dict[str, int] = {}
        start = 0
        for i, sigma, rows, own in self._rows():
            of = fold[start : (start := start + len(rows))]
            errors = np.empty((steps, *rows.shape[:2]))
            for k in np.unique(of):
                those = of == k
                about = None if own is None else Own(own.by[those], own.block[those])
                here = products.following(rows[those], about, k)
                changes = here[:, :, :-1].reshape(-1, here.shape[2] - 1) @ values[k].T
                errors[:, those] = changes.T.reshape(-1, *here.shape[:2]) + here[:, :, -1]
            found.append(np.mean(errors**2, axis=2))
            for name, _, columns in QUANTITIES[self._problem.measurements[i].kind]:
                part, c = errors[:, :, columns], number[i, name]
                squares[:, c] += np.sum(part**2, axis=(1, 2))
                counts[c] += part[0].size
                sums[name] = sums.get(name, 0.0) + np.sum((part * sigma[:, columns]) ** 2, axis=(1, 2))
                rows_of[name] = rows_of.get(name, 0) + len(rows)
        rms = {name: np.sqrt(total / rows_of[name]) for name, total in sums.items()}
        return Errors(np.concatenate(found, axis=1), squares / np.maximum(counts, 1.0), rms)


def _left(products: Array) -> float:
    """Return the least sum of squares that products (k + 1, k + 1) of the columns of ``[J r]`` leave."""
    found = np.linalg.lstsq(products[:-1, :-1], products[:-1, -1], rcond=ROUNDING)[0]
    return float(products[-1, -1] - products[-1, :-1] @ found)
