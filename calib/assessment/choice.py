"""Which joint terms a machine needs: forward selection, stopped by what it says of poses that it never saw.

About the geometric fit everything is linear in the coefficients of joint terms. So the whitened Jacobian of geometry
and of all candidates is taken once, there, and what would be hundreds of fits are eliminations on its Gram matrices,
one for every fold. Step by step the candidate enters that lowers the sum of squares most for each of its coefficients,
geometry being fitted again. Each fold goes its own way without having seen the rows it is judged by (T. Hastie, R.
Tibshirani, J. Friedman, *The elements of statistical learning*, 2009, 7.10.2), and the one-standard-error rule says how
many steps all rows then take.

A parameter without a prior of its own is held by its weak one, at the geometric fit. Of very many rows the choice looks
at some, whole groups at random: the figures that it goes by are those of ten thousand rows to a percent. Fits, before
and after it, take them all.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from calib.assessment.validation import HeldOut, folds, groups, held_out, one_standard_error
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.brief import brief
from calib.foundations.choices import FOLDS
from calib.foundations.linear import one_thread
from calib.identification.error_model import ErrorModel, with_terms
from calib.identification.fit import Fit
from calib.identification.identifiability import NUMERICAL_TOLERANCE
from calib.identification.identify import identify
from calib.identification.initialisation.problem import initial_problem
from calib.identification.losses import Loss
from calib.identification.machine import values_at
from calib.identification.parameters import scales
from calib.identification.system import Rates, without_rows
from calib.identification.weights import sigmas_of
from calib.measurement.kinds import QUANTITIES
from calib.measurement.measurements import Measurements
from calib.robot.conditions import joined
from calib.robot.joint_terms import ordered, parts
from calib.robot.robot import Deviations, Robot
from calib.robot.terms import KINDS, JointTerm, kind_of

_AS_OFFERED: Mapping[str, object] = MappingProxyType({})
# Rows that a choice looks at; their groups are whole, so that the last one may add some.
_ENOUGH_ROWS = 10_000


@dataclass(frozen=True, slots=True)
class Candidate:
    """Terms that enter together: cosine and sine of one order of one reading, or a term alone."""

    terms: tuple[JointTerm, ...]

    @property
    def name(self) -> str:
        """Name for tables."""
        first = self.terms[0]
        return f"{first.owner}: {kind_of(first).said(first)}"


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the selection: the candidate that enters, and what is said of rows held out from then on.

    ``added`` is None for the first, geometry alone. ``held_out``: in standard deviations of the noise that the
    geometric fit shows, rows that lie off weighing less where a loss says so; ``rms``: of every quantity, in SI units.
    """

    added: Candidate | None
    held_out: HeldOut
    rms: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """Made by :func:`choose_terms`. ``taken``: how many of the ``steps`` after the first are taken.

    ``geometric``: the fit without terms from which they start. ``rows``: how many of its rows the choice used.
    """

    __repr__ = brief

    steps: tuple[Step, ...]
    taken: int
    geometric: Fit
    rows: int

    @property
    def model(self) -> ErrorModel:
        """The error model with the chosen terms."""
        return with_terms(self.geometric.model, self.terms)

    @property
    def terms(self) -> tuple[JointTerm, ...]:
        """The chosen terms, in the order of the robot's readings; those of links come last."""
        entered = [step.added for step in self.steps[: self.taken + 1] if step.added is not None]
        return ordered(self.geometric.robot, (term for candidate in entered for term in candidate.terms))

    def records(self) -> list[dict[str, object]]:
        """Return one plain record for every step, in SI units."""
        return [
            {
                "added": [] if step.added is None else [term.name for term in step.added.terms],
                "held_out": step.held_out.rms,
                "standard_error": step.held_out.standard_error,
                "rms": dict(step.rms),
                "taken": k <= self.taken,
            }
            for k, step in enumerate(self.steps)
        ]


def candidates(
    robot: Robot, measurements: Sequence[Measurements] = (), options: Mapping[str, object] = _AS_OFFERED
) -> tuple[Candidate, ...]:
    """Return what may enter, reading by reading, then what is of links: all that each kind of terms offers.

    They need what rows of ``measurements`` say, or masses: a kind that these could not show is not offered. Masses that
    the URDF states in a way that cannot be used are as good as none. ``options`` as a job has them, such as
    ``harmonic_orders``.
    """
    told, of = joined([end.conditions for data in measurements for end in data.ends]), parts(robot)
    offered = {group[0]: group for kind in KINDS for group in kind.offered(of, told, options)}
    return tuple(Candidate(offered[first]) for first in ordered(robot, offered))


@checked
def choose_terms(
    model: ErrorModel,
    measurements: Measurements | Sequence[Measurements],
    *,
    offered: Sequence[Candidate] | None = None,
    count: int = FOLDS,
    model_sigmas: Sequence[float | None] | None = None,
    losses: Sequence[Loss] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Choice:
    """Choose joint terms for the geometry of ``model`` by grouped cross-validation over ``count`` folds.

    Of more than 10 000 rows, about 10 000 are used, of groups taken at random, the same ones every time.
    ``offered``: those to choose from, by default :func:`candidates` of the robot, for a DH table but those of links.
    ``model_sigmas`` and ``losses`` as in :func:`calib.identify`, whose errors this raises, and MeasurementError when
    all rows are of one group.
    """
    with one_thread():
        progress("choosing joint terms: fitting geometry")
        geometric = identify(with_terms(model, ()), measurements, model_sigmas=model_sigmas, losses=losses)
        group = groups(geometric.measurements)
        looked_at = _some(group, count)
        group = group[looked_at]
        fold = folds(np.unique(group, return_inverse=True)[1], count)
        chosen_from = _offered(model, geometric.measurements) if offered is None else tuple(offered)
        system = _System(geometric, chosen_from, losses, looked_at)
        progress("choosing joint terms: linearising")
        grams = system.grams(fold)
        total = np.sum(grams, axis=0)
        ways = []
        for k, gram in enumerate(grams):
            progress(f"choosing joint terms: fold {k + 1} of {len(grams)}")
            ways.append(system.way(total - gram).values)
        progress("choosing joint terms: judging by what was held out")
        squares, rms = system.squares(fold, np.stack(ways))
        figures = [held_out(row, group) for row in squares]
        entered = system.way(total).order
    steps = tuple(
        Step(None if k == 0 else chosen_from[entered[k - 1]], figure, {name: float(v[k]) for name, v in rms.items()})
        for k, figure in enumerate(figures)
    )
    return Choice(steps, one_standard_error(figures), geometric, len(group))


def _some(group: IntArray, count: int) -> BoolArray:
    """Return which rows (N,) are looked at, given their groups (N,): all, or those of enough groups, ``count`` or more.

    Groups are numbered by their poses: which are taken does not depend on the order of the rows.
    """
    sizes = np.bincount(group)
    order = np.random.default_rng(0).permutation(len(sizes))
    before = np.cumsum(sizes[order]) - sizes[order]
    return np.isin(group, order[(before < _ENOUGH_ROWS) | (np.arange(len(order)) < count)])


def _offered(model: ErrorModel, measurements: Sequence[Measurements]) -> tuple[Candidate, ...]:
    """Return all candidates for a model: links do not give way in frames of a DH table."""
    every = candidates(model.urdf_robot, measurements)
    return every if model.dh is None else tuple(one for one in every if not kind_of(one.terms[0]).of_link)


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """Candidates in the order in which they entered, and changes (steps + 1, p) of the scaled parameters."""

    order: tuple[int, ...]
    values: Array


class _System:
    """The linearised rows of geometry and all candidates, at the geometric fit."""

    def __init__(
        self, geometric: Fit, offered: Sequence[Candidate], losses: Sequence[Loss] | None, looked_at: BoolArray
    ) -> None:
        terms = [term for candidate in offered for term in candidate.terms]
        full = with_terms(geometric.model, terms)
        sets = geometric.measurements
        frames, d = geometric.machine.frames, geometric.machine.deviations
        held = Deviations(d.placements, d.offsets, np.zeros(len(terms)))
        given = None if losses is None else tuple(losses)
        whole = initial_problem(full, sets)
        # Widths that geometry has taught are held to; those of candidates, where learned, would need them all at once.
        known = {parameter.name: parameter.prior for parameter in geometric.parameters}
        parameters = tuple(replace(p, prior=known.get(p.name, p.prior)) for p in whole.parameters)
        self._problem = replace(whole, parameters=parameters, reference=frames, held=held, given_losses=given)
        names = [parameter.name for parameter in parameters]
        self._x = values_at(full.robot, parameters, frames, held)
        self._sigmas = sigmas_of(self._problem, [noise.model**2 for noise in geometric.noise], geometric.residuals)
        self._looked_at = np.split(looked_at, np.cumsum([len(data) for data in sets])[:-1])
        # What is known without any row: relations between targets, and that turns and a size which nothing tells stay.
        related, moving = without_rows(self._problem, self._sigmas, self._x)
        rows = np.concatenate([related, np.pad(moving.T / NUMERICAL_TOLERANCE, ((0, 0), (0, 1)))])
        self._known = rows.T @ rows
        self._geometry = [k for k, parameter in enumerate(parameters) if parameter.kind != "term"]
        self._columns = [[names.index(term.name) for term in candidate.terms] for candidate in offered]
        self._priors = np.array([parameter.hold for parameter in parameters]) ** 2
        # A stated prior pulls towards zero; a weak one holds at the geometric fit.
        stated = np.array([parameter.prior is not None for parameter in parameters])
        self._pull = np.where(stated, self._x / scales(parameters), 0.0)

    def _rows(self) -> Iterable[tuple[int, slice, Array, Array]]:
        """Yield set, rows, sigmas (n, d) and whitened ``[J r]`` (n, d, p + 1), block by block."""
        problem = self._problem
        rates = Rates(problem, problem.machine(self._x), scales(problem.parameters))
        sets = zip(problem.measurements, self._sigmas, self._looked_at, strict=True)
        for i, (every, sigmas, own) in enumerate(sets):
            data, sigma = (every, sigmas) if own.all() else (every.subset(own), sigmas[own])
            for block in rates.blocks(data):
                whole = np.concatenate([block.J, block.observed.residual[:, :, None]], axis=2)
                yield i, block.rows, sigma[block.rows], whole / sigma[block.rows, :, None]

    def grams(self, fold: IntArray) -> Array:
        """Return the Gram matrix of ``[J r]`` (p + 1, p + 1) of the rows of every fold."""
        size = len(self._problem.parameters) + 1
        found, start = np.zeros((int(fold.max()) + 1, size, size)), 0
        for _, _, _, rows in self._rows():
            own = fold[start : (start := start + len(rows))]
            for k in np.unique(own):
                flat = rows[own == k].reshape(-1, size)
                found[k] += flat.T @ flat
        return found

    def way(self, gram: Array) -> _Way:
        """Return the way that rows with this Gram matrix (p + 1, p + 1) go: all candidates, the most helpful first."""
        p = len(gram) - 1
        tableau = gram[:p] + self._known[:p]
        tableau[range(p), range(p)] += self._priors
        tableau[:, p] += self._priors * self._pull
        _pivot(tableau, self._geometry)
        left, order = list(range(len(self._columns))), list[int]()
        entered = list(self._geometry)
        values = np.zeros((len(left) + 1, p))
        values[0, entered] = -tableau[entered, p]
        while left:
            best = left.pop(int(np.argmax(_gains(tableau, [self._columns[c] for c in left]))))
            order.append(best)
            _pivot(tableau, self._columns[best])
            entered += self._columns[best]
            values[len(order), entered] = -tableau[entered, p]
        return _Way(tuple(order), values)

    def squares(self, fold: IntArray, values: Array) -> tuple[Array, Mapping[str, Array]]:
        """Return mean squared whitened errors (steps, N) of rows held out, and the rms (steps,) of every quantity.

        ``values`` (folds, steps, p): what every fold has found without its own rows.
        """
        found: list[Array] = []
        sums: dict[str, Array] = {}
        counts: dict[str, int] = {}
        start = 0
        for i, _, sigma, rows in self._rows():
            own = fold[start : (start := start + len(rows))]
            errors = np.empty((values.shape[1], *rows.shape[:2]))
            for k in np.unique(own):
                here = rows[own == k]
                changes = here[:, :, :-1].reshape(-1, here.shape[2] - 1) @ values[k].T
                errors[:, own == k] = changes.T.reshape(-1, *here.shape[:2]) + here[:, :, -1]
            found.append(np.mean(errors**2, axis=2))
            for name, _, columns in QUANTITIES[self._problem.measurements[i].kind]:
                more = np.sum((errors[:, :, columns] * sigma[:, columns]) ** 2, axis=(1, 2))
                sums[name] = sums.get(name, 0.0) + more
                counts[name] = counts.get(name, 0) + len(rows)
        return np.concatenate(found, axis=1), {name: np.sqrt(total / counts[name]) for name, total in sums.items()}


def _pivot(tableau: Array, block: Sequence[int]) -> None:
    """Eliminate a block of unknowns from a tableau (p, p + 1) of normal equations, in place."""
    columns = np.array(block, dtype=np.intp)
    own = np.linalg.solve(tableau[columns[:, None], columns], tableau[columns])
    tableau -= tableau[:, columns] @ own
    tableau[columns] = own


def _gains(tableau: Array, left: Sequence[Sequence[int]]) -> Array:
    """Return how much each block (one or two unknowns) would lower the sum of squares, for each of its unknowns."""
    gains = np.empty(len(left))
    for size in {len(block) for block in left}:
        which = [k for k, block in enumerate(left) if len(block) == size]
        columns = np.array([left[k] for k in which])
        C = tableau[columns[:, :, None], columns[:, None, :]]
        g = tableau[columns, -1]
        gains[which] = np.einsum("ni,ni->n", g, np.linalg.solve(C, g[:, :, None])[:, :, 0]) / size
    return gains
