"""The least-squares solution of a problem: the minimum first, then what can be said of it.

What is minimised is the cost of the data at the instrument's noise, and of priors: stated ones, and weak ones, which
hold all other parameters at their start (:mod:`calib.identification.parameters`). No direction is closed by a
threshold: where the data speak, a weak prior is negligible, and where they are silent, it decides alone.

Levenberg-Marquardt by SciPy brings the search near the minimum. Gauss-Newton steps do the rest; each is judged, and
damped where it fails. There the noise is estimated, too: where nobody stated it, and where what is stated clearly does
not explain the residuals. Ranks, null space and covariance are those of the solution, with the noise that it shows.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy

from calib.foundations.arrays import Array, BoolArray
from calib.foundations.errors import IdentificationError, PoseError
from calib.foundations.linear import ROUNDING
from calib.identification import identifiability, weights
from calib.identification.arrow import Arrow, Covariance, Inverse, Reduced, Split
from calib.identification.identifiability import Directions, Spectrum
from calib.identification.least_squares import LeastSquares
from calib.identification.parameters import asked_for, scales
from calib.identification.system import Evaluation

_MOST_STEPS, _MANY_STEPS = 60, 20
# A step is small where it lowers the cost by less than this share.
_LITTLE = 0.25
# Weights of rows that lie off settle more slowly than the parameters.
_MOST_ROBUST_STEPS = 160
# A step is negligible in parameter scales, 1e-9 m, if it hardly lowers the cost, too; or by its gain alone, as a
# share of the cost: where a thousand rows fit, a hundredth of a standard deviation.
_NEGLIGIBLE_STEP, _HARDLY_A_GAIN, _NEGLIGIBLE_GAIN = 1e-6, 1e-3, 1e-7
# Values below 1e-13 m or rad are zero: joints that nothing moves keep their exact origins.
_ROUNDING = 1e-10
# Levenberg-Marquardt brings the search near; the last digits are left to Gauss-Newton. Weak priors hold what else would
# be far, and what the data hardly tell is then left to steps that correct themselves.
_ROUGH, _MOST_ROUGH_STEPS, _MOST_WITH_WEAK_PRIORS = 1e-3, 10, 3
# What a choice of the model leaves of the degrees of freedom of a component.
_LEAST_FREEDOM = 1.0
# A whitened residual beyond all others.
_NOWHERE = 1e12
# Costs are the same within rounding; a step is clearly better, or as good in spite of its cost.
_SAME_COST, _CLEARLY_LESS, _HARDLY_MORE, _SHORTER = 1e-9, 0.5, 1.1, 0.7
_LEAST_DAMPING, _MOST_FAILURES = 1.0, 1
# Points that tell how full steps shrink, what counts as quickly, and by how little their weights may differ.
_REMEMBERED, _QUICK, _ALIKE = 5, 0.1, 0.01
# By how much stronger priors hold in a correction, and where their widths are more than can be searched.
_HELD = 10.0
_NARROWER = (1.0, 10.0, 100.0)
# By this share of the cost the data must ask for a place from which narrower priors keep a parameter.
_CLEARLY_HELD = 0.05


class Solution(NamedTuple):
    """A least-squares solution.

    ``x`` (p,): values in SI units; ``spread``: their covariance. ``directions``: what the data determine at x, priors
    left out, and ``spectrum``: how well; ``with_priors``: the same of data and stated priors. ``start``: the data's
    rows at the start point, whitened with the final noise. ``variances`` and ``redundancies``: of every component.
    ``step``: the last one, in parameter scales. ``narrowed``: by how much weak priors were narrower than is usual, for
    the robot at least. ``widened``: groups of parameters that have the wider prior, as they needed it. ``off``
    (p,): by how much x is off the minimum where it was found in another way, in SI units.
    """

    x: Array
    spread: Covariance
    directions: Directions
    spectrum: Spectrum
    with_priors: Spectrum
    start: Arrow
    variances: tuple[float, ...]
    redundancies: tuple[float, ...]
    evaluations: int
    step: float
    converged: bool
    narrowed: float = 1.0
    widened: frozenset[str] = frozenset()
    off: Array | None = None

    @property
    def null_basis(self) -> Array:
        """A basis (p, k), scaled, of what neither data nor stated priors determine well enough."""
        return self.with_priors.undetermined[0]

    @property
    def unidentifiable(self) -> BoolArray:
        """Which parameters (p,) that moves, or are of targets whose own rows are too few."""
        basis, alone = self.with_priors.undetermined
        return identifiability.unidentifiable(basis) | alone

    @property
    def covariance(self) -> Array:
        """The covariance (p, p) of all values."""
        return self.spread.of()


class Near(NamedTuple):
    """What is known of a minimum beforehand: where it nearly is (p,), and the ``variances`` of components there."""

    x: Array
    variances: Sequence[float]


def solve(
    problem: LeastSquares, x0: Array, variances: Sequence[float | None] | None = None, near: Near | None = None
) -> Solution:
    """Solve a problem from x0 (p,); ``variances`` of the model part for every component; None is estimated.

    Where the minimum is nearly known, the search goes on from there; frames are still held where x0 has them. Raises
    IdentificationError when there are no more rows and stated priors than the rank.
    """
    return seek(problem, x0, variances, near).told


def seek(
    problem: LeastSquares,
    x0: Array,
    variances: Sequence[float | None] | None = None,
    near: Near | None = None,
    *,
    roughly: bool = False,
) -> "Sought":
    """Seek the solution of a problem, as :func:`solve` does; what the data tell there is not asked for yet.

    ``roughly``: what is left is judged by its gain alone.
    """
    s = scales(problem.parameters)
    fixed = (None,) * len(problem.components) if variances is None else tuple(variances)
    weights.refuse_number_of_sigmas(fixed, len(problem.components))
    search = _Search(problem, _Evaluator(problem, s), _Prior.of(problem, x0 / s), fixed)
    begin = search.beginning()
    # Of the start only what all rows say together is asked for again.
    first = search.evaluator(x0 / s, begin.sigmas)._replace(residuals=())
    _refuse_too_few(problem, first, search.prior)
    if near is not None:
        end, converged = search.gauss_newton(near.x / s, search.beginning(near.variances), near=True)
        if converged:
            return _ended(search, search.prior, first, end, converged, 1.0)
    return _narrowed(search, first, _levenberg_marquardt(search, begin.sigmas, x0 / s), begin, roughly=roughly)


def _narrowed(search: "_Search", first: Evaluation, z: Array, begin: "_Noise", *, roughly: bool) -> "Sought":
    """Return where a search ends from z (p,) on, with priors as narrow as it needs."""
    prior = search.prior
    for narrowed in _NARROWER:
        search = search._replace(prior=prior.weighed(narrowed))
        end, converged = search.gauss_newton(z, begin, near=roughly)
        if converged:
            break
        z, begin = end.z, end.weighted_by
    return _ended(search, prior, first, end, converged, narrowed)


def _ended(
    search: "_Search", prior: "_Prior", first: Evaluation, end: "_Point", converged: bool, narrowed: float
) -> "Sought":
    """Return where a search ends, from where priors narrower than ``prior`` may have held it."""
    widened, last = frozenset[str](), end
    for held, of in _wider(search.problem, narrowed) if converged else ():
        wider = search._replace(prior=prior.widened(search.problem, of).weighed_for_robot(held))
        ended = wider.released(last)
        if ended is None:
            continue
        last, done = ended
        if done:
            search, end, narrowed, widened = wider, last, held, of
    while converged and (found := _with_terms_widened(search, end, widened)) is not None:
        search, end, group = found
        widened |= {group}
    # What is seen at the start may be less than at the solution.
    _refuse_too_few(search.problem, end.evaluation, search.prior)
    # The last step is applied and not evaluated: each one is about a thousand times smaller than the one before it.
    z = end.z + end.full if converged else end.z
    z = np.where(np.abs(z) < _ROUNDING, 0.0, z)
    noise = search.noise(z, end.evaluation, end.weighted_by, sought=False)
    return Sought(search, first, end, z, noise, converged, narrowed, widened)


def _wider(problem: LeastSquares, narrowed: float) -> Iterator[tuple[float, frozenset[str]]]:
    """Yield in which order priors get wider than those of a search: the factor of the robot's, and groups."""
    tools = frozenset(p.wider.group for p in problem.parameters if p.kind == "tool" and p.wider is not None)
    if narrowed > 1.0:
        yield narrowed, frozenset()
    if tools:
        yield narrowed, tools
    if narrowed > 1.0:
        yield 1.0, tools


def _with_terms_widened(
    search: "_Search", end: "_Point", widened: Collection[str]
) -> tuple["_Search", "_Point", str] | None:
    """Return where a search ends with the wider prior of a group of joint terms, if rows ask for it, and the group.

    None where they ask for that of none but those that are ``widened``.
    """
    for group, count in _terms_to_widen(search.problem, learned=False).items():
        wider = search._replace(prior=search.prior.widened(search.problem, {group}))
        if group in widened or not wider.asked(end, search.prior, count):
            continue
        last, done = wider.gauss_newton(end.z, end.weighted_by)
        if done:
            return wider, last, group
    return None


def _terms_to_widen(problem: LeastSquares, *, learned: bool) -> Counter[str]:
    """Return the groups of joint terms that may get it, with how many are in each; of ``learned`` widths, or not."""
    terms = [p for p in problem.parameters if p.kind == "term" and (p.group is not None) == learned]
    return Counter(p.wider.group for p in terms if p.wider is not None)


class _Prior(NamedTuple):
    """Priors: 1 / standard deviation (p,) and centre (p,), scaled, and which (p,) were stated."""

    hold: Array
    centre: Array
    stated: BoolArray
    of_robot: BoolArray

    @classmethod
    def of(cls, problem: LeastSquares, z0: Array) -> "_Prior":
        # The robot is held at nominal, frames where they start.
        robot = [parameter.of_robot for parameter in problem.parameters]
        stated = [parameter.prior is not None for parameter in problem.parameters]
        hold = np.array([parameter.hold for parameter in problem.parameters])
        told = [np.nan if p.centre is None else p.centre / p.scale for p in problem.parameters]
        centre = np.where(np.isnan(told), np.where(robot, 0.0, z0), told)
        return cls(hold, centre, np.array(stated, dtype=bool), np.array(robot, dtype=bool))

    @property
    def has_weak(self) -> bool:
        """Whether there are weak ones."""
        return bool(np.any(~self.stated & (self.hold > 0.0)))

    def weighed(self, factor: float) -> "_Prior":
        """Return the priors with the weights of weak ones times a factor."""
        return self._replace(hold=np.where(self.stated, 1.0, factor) * self.hold)

    def weighed_for_robot(self, factor: float) -> "_Prior":
        """Return the priors with the weights of weak ones of the robot times a factor; frames keep theirs."""
        return self._replace(hold=np.where(self.stated | ~self.of_robot, 1.0, factor) * self.hold)

    def widened(self, problem: LeastSquares, groups: Collection[str]) -> "_Prior":
        """Return the priors with the wider ones of parameters of these groups."""
        return self._with(
            {p.name: p.wider.prior for p in problem.parameters if p.wider and p.wider.group in groups}, problem
        )

    def unlearned(self, problem: LeastSquares, group: str) -> "_Prior":
        """Return the priors with weak ones of parameters of a group, in the place of those that are learned."""
        return self._with({p.name: p.weak_prior for p in problem.parameters if p.group == group}, problem)

    def _with(self, widths: Mapping[str, float], problem: LeastSquares) -> "_Prior":
        held = zip(problem.parameters, self.hold.tolist(), strict=True)
        return self._replace(
            hold=np.array([p.scale / widths[p.name] if p.name in widths else hold for p, hold in held])
        )

    def beside(self, data: Arrow, z: Array) -> Arrow:
        """Return the rows of the data with those of all priors at z (p,)."""
        return data.held(self.hold, self.hold * (z - self.centre))

    def cost(self, z: Array) -> float:
        """Return the sum of squares of the priors at z (p,)."""
        return float(np.sum((self.hold * (z - self.centre)) ** 2))

    def stated_beside(self, data: Arrow) -> Arrow:
        """Return the rows of the data with derivatives of the stated ones."""
        return data.held(np.where(self.stated, self.hold, 0.0), np.zeros(len(self.hold)))


class _Evaluator:
    """Evaluates a problem at scaled values, remembers the last answer, and counts."""

    def __init__(self, problem: LeastSquares, s: Array) -> None:
        self.count = 0
        self._problem, self._s = problem, s
        self._at: tuple[Array, Sequence[Array]] | None = None
        self._last: Evaluation | None = None

    @property
    def split(self) -> Split:
        """That of the evaluations."""
        assert self._last is not None, "what was evaluated has a split"
        return self._last.split

    def __call__(self, z: Array, sigmas: Sequence[Array]) -> Evaluation:
        known = self._at is not None and self._at[1] is sigmas and np.array_equal(self._at[0], z)
        if not known or self._last is None:
            self._last = self._problem.evaluate(sigmas, z * self._s)
            self._at = (z.copy(), sigmas)
            self.count += 1
        return self._last


class _Noise(NamedTuple):
    """The noise that agrees with the residuals of an evaluation, found without a new one.

    ``variances``: of the model part of every component, with the ``sigmas`` (N, d) of every set. ``factors``: by which
    these are new; ``settled``: apart from such factors, the rows of the evaluation were weighted by them already.
    ``scatter``: rms of the whitened residuals where that is clearly less than 1. ``prior``: as it weighs beside such
    data.
    """

    variances: tuple[float, ...]
    sigmas: tuple[Array, ...]
    factors: Array
    settled: bool
    redundancies: tuple[float, ...]
    scatter: float
    prior: _Prior


class _Solved(NamedTuple):
    """What the ``data`` of an evaluation say, the data and priors as ``rows``, and the ``full`` step (p,) by these."""

    data: Arrow
    rows: Arrow
    full: Array


class _Point(NamedTuple):
    """A point of the search: z (p,), what was evaluated there by which noise, the noise there, the full step (p,).

    ``data`` and ``rows``: what the data say, and the data and priors, weighted by the noise there.
    """

    z: Array
    evaluation: Evaluation
    weighted_by: _Noise
    noise: _Noise
    data: Arrow
    rows: Arrow
    full: Array

    @classmethod
    def of(cls, z: Array, evaluation: Evaluation, weighted_by: _Noise, noise: _Noise) -> "_Point":
        """Return the point with its full step."""
        data = evaluation.reweighted(noise.factors).rows.whole
        rows = noise.prior.beside(data, z)
        return cls(z, evaluation, weighted_by, noise, data, rows, Inverse.of(rows).step)

    @property
    def passed(self) -> "_Passed":
        """What is remembered of it when the search has gone on."""
        return _Passed(self.z, self.full)

    @property
    def length(self) -> float:
        """Length of the full step, in parameter scales."""
        return self.passed.length

    @property
    def gain(self) -> float:
        """By how much the full step should lower the cost."""
        return self.rows.after(self.full, 0.0)

    @property
    def most_gained(self) -> float:
        """The sum of squares of the component of which the full step should take most."""
        none, parts = np.zeros(len(self.z)), self.evaluation.reweighted(self.noise.factors).alone
        before, after = (np.array([own.after(step) for own in parts]) for step in (none, self.full))
        return float(before[np.argmax(before - after)])

    def step(self, damping: float) -> Array:
        """Return the step (p,) of Levenberg and Marquardt, in units of what priors hold."""
        if damping == 0.0:
            return self.full
        units = np.where(self.noise.prior.hold > 0.0, self.noise.prior.hold, self.rows.lengths)
        return Inverse.of(self.rows.held(np.sqrt(damping) * units, np.zeros(len(self.z)))).step

    @property
    def correction(self) -> Array:
        """The step (p,) that the data ask for, what they hardly see staying where it is."""
        return Inverse.of(self.data.held(_HELD * self.noise.prior.hold, np.zeros(len(self.z)))).step


class _Search(NamedTuple):
    """The search for the minimum of a problem; ``fixed``: model variances that are given, of every component."""

    problem: LeastSquares
    evaluator: _Evaluator
    prior: _Prior
    fixed: Sequence[float | None]

    def beginning(self, variances: Sequence[float] | None = None) -> _Noise:
        """Return the noise to begin with: of known variances, or what no residual has to do with."""
        v = _keep(self.fixed, weights.search_variances(self.problem) if variances is None else variances)
        sigmas = weights.sigmas_of(self.problem, v, search=True)
        none = np.ones(len(v))
        return _Noise(v, sigmas, none, True, (0.0,) * len(v), 1.0, self.prior)

    def noise(self, z: Array, evaluation: Evaluation, weighted_by: _Noise, *, sought: bool = True) -> _Noise:
        """Return the noise that agrees with an evaluation at z (p,), or with what a small step from there leaves.

        Weights that are new by one factor for a whole component scale its triangle; if they change from row to row, the
        triangle keeps the mean factor and is not settled until the next evaluation. While a solution is ``sought``,
        nothing is added to a stated noise that may well explain the residuals.
        """
        problem, noise = self.problem, weighted_by._replace(factors=np.ones(len(self.fixed)), settled=True)
        # Far from the minimum the full step does not tell what it will leave; at a given solution none is made.
        foretold = sought
        for k in range(_MOST_STEPS):
            noise, solved = self._inverted(z, evaluation, noise)
            v, r = noise.variances, evaluation.residuals
            if foretold:
                left, gained = self._foretold(evaluation, noise, solved)
                foretold = k > 0 or gained < _LITTLE
                r = left if foretold else r
            if None in self.fixed or problem.robust:
                new = weights.model_variances(problem, r, noise.redundancies, v, search=sought)
                v = _keep(self.fixed, new)
            sigmas = weights.sigmas_of(problem, v, r, search=sought)
            factors, settled = weights.factors_of(problem, weighted_by.sigmas, sigmas)
            scatter = weights.scatter(problem, r, sigmas, noise.redundancies)
            change = np.append(factors / noise.factors, scatter / noise.scatter)
            noise = noise._replace(variances=v, sigmas=sigmas, factors=factors, settled=settled, scatter=scatter)
            if np.max(np.abs(np.log(change))) < weights.NEGLIGIBLE_CHANGE_OF_SIGMA:
                break
        return noise

    def cost(self, at: _Point, noise: _Noise) -> float:
        """Return the sum of squares of data, as their losses count them, and priors at a point, by some noise."""
        data = weights.cost(self.problem, noise.variances, at.evaluation.residuals)
        return data + float(np.sum(at.evaluation.relations[:, -1] ** 2)) + noise.prior.cost(at.z)

    def at_rest(self, at: _Point, *, slowly: bool) -> bool:
        """Whether nothing is left to be done; ``slowly``: where the search has come slowly, nothing of significance."""
        moved = at.length >= _NEGLIGIBLE_STEP or at.gain >= _HARDLY_A_GAIN
        hardly = slowly and at.gain < _NEGLIGIBLE_GAIN * (1.0 + self.cost(at, at.noise))
        return at.noise.settled and (hardly or not moved)

    def _foretold(self, evaluation: Evaluation, noise: _Noise, solved: _Solved) -> tuple[tuple[Array, ...], float]:
        """Return the residuals of every set, as large as the full step leaves them, and its gain (share).

        New weights move the minimum, and that moves the weights: of two kinds of data whose noise nobody stated,
        residuals that wait for the step would need dozens of steps.
        """
        _, rows, step = solved
        cost = rows.sum_of_squares
        found = [np.array(residual) for residual in evaluation.residuals]
        none = np.zeros(len(step))
        alone = evaluation.reweighted(noise.factors).alone
        for c, own in zip(self.problem.components, alone, strict=True):
            before, after = np.sqrt(own.after(none)), np.sqrt(own.after(step))
            found[c.measurements][:, c.columns] *= after / before if before > 0.0 else 1.0
        return tuple(found), rows.after(step, 0.0) / cost if cost > 0.0 else 0.0

    def _inverted(self, z: Array, evaluation: Evaluation, noise: _Noise) -> tuple[_Noise, _Solved]:
        """Return the noise with what the rows of an evaluation at z (p,), weighted by it, make of it, and these."""
        prior = self.prior.weighed(noise.scatter)
        components, whole = evaluation.reweighted(noise.factors).rows
        rows = prior.beside(whole, z)
        inverse = Inverse.of(rows)
        left = [
            self.problem.measurements[c.measurements].sigma[:, c.columns].size - inverse.used(own)
            for c, own in zip(self.problem.components, components, strict=True)
        ]
        redundancies = tuple(
            max(own - spent, min(own, _LEAST_FREEDOM)) for own, spent in zip(left, self.problem.spent, strict=True)
        )
        return noise._replace(prior=prior, redundancies=redundancies), _Solved(whole, rows, inverse.step)

    def released(self, held: _Point) -> tuple[_Point, bool] | None:
        """Return where the search ends from a point that narrower priors held, as :meth:`gauss_newton` does.

        None where they do not cost a clearly worse fit. A tool that is far from the flange is pulled towards it by a
        narrow prior, and the residuals grow by that: those of the rows that it is in, which may be few of all.
        """
        noise = self.noise(held.z, held.evaluation, held.weighted_by)
        begin = _Point.of(held.z, held.evaluation, held.weighted_by, noise)
        clearly = begin.gain >= _CLEARLY_HELD * (begin.most_gained + noise.prior.cost(held.z))
        return self.gauss_newton(held.z, noise) if clearly else None

    def asked(self, held: _Point, narrower: _Prior, count: int) -> bool:
        """Return whether rows ask for these priors, in the place of narrower ones of ``count`` parameters.

        By F: what narrower priors hold back is in their own squares, or, where nothing else explains it, in the rows'.
        """
        noise = self.noise(held.z, held.evaluation, held.weighted_by)
        begin = _Point.of(held.z, held.evaluation, held.weighted_by, noise)
        other = noise._replace(prior=narrower.weighed(noise.scatter))
        less = begin.gain - _Point.of(held.z, held.evaluation, held.weighted_by, other).gain
        gain = less + other.prior.cost(held.z) - noise.prior.cost(held.z)
        left, freedom = self.cost(begin, noise) - begin.gain, sum(noise.redundancies)
        return asked_for(gain, left, count, freedom)

    def gauss_newton(self, z: Array, weighted_by: _Noise, *, near: bool = False) -> tuple[_Point, bool]:
        """Return the last good point from z (p,) on, and whether no more than a negligible step is left from there.

        ``near``: the minimum is at hand, and what is left is judged by its gain alone.

        Full steps come first. What the data cannot tell apart is a curved valley, along which a step raises the cost of
        the data: it is judged after corrections that lead back to the valley's floor, and damped where it fails then.
        """

        def accepted(z: Array, evaluation: Evaluation, weighted_by: _Noise) -> _Point:
            return _Point.of(z, evaluation, weighted_by, self.noise(z, evaluation, weighted_by))

        def slowly(path: Sequence[_Passed], failures: int, steps: int) -> bool:
            return near or (self.prior.has_weak and (failures > 0 or steps > _MANY_STEPS or _slow(path)))

        good = tried = accepted(z, self.evaluator(z, weighted_by.sigmas), weighted_by)
        path, damping, failures = [good.passed], 0.0, 0
        for steps in range(_MOST_ROBUST_STEPS if self.problem.robust else _MOST_STEPS):
            if failures > _MOST_FAILURES or self.at_rest(good, slowly=slowly(path, failures, steps)):
                break
            noise = good.noise
            if tried is not good:
                z = tried.z + (tried.full if tried.length < _SHORTER * good.length else tried.correction)
            else:
                z = good.z + (good.step(damping) if damping else _accelerated(path, noise.prior))
            try:
                evaluation = self.evaluator(z, noise.sigmas)
            except PoseError:  # a step that opens a loop tells nothing of the cost, and a shorter one may
                tried, damping, path = good, max(10.0 * damping, _LEAST_DAMPING), [good.passed]
                continue
            as_before, solved = self._inverted(z, evaluation, noise._replace(factors=np.ones(len(self.fixed))))
            trial = _Point(z, evaluation, noise, as_before, *solved)
            cost, before = self.cost(trial, noise), self.cost(good, noise)
            # Where a motion of the whole set-up is left out of the Jacobian, steps do not follow the cost alone.
            shorter = trial.length < _SHORTER * good.length and cost < _HARDLY_MORE * before
            if cost <= (1.0 + _SAME_COST) * before or shorter or self.at_rest(trial, slowly=False):
                good = tried = accepted(z, evaluation, noise)
                # Steps tell something of each other only while rows are weighted alike.
                alike = np.max(np.abs(np.log(good.noise.factors))) < _ALIKE
                path = [*path[-_REMEMBERED:], good.passed] if alike else [good.passed]
                damping = damping / 10.0 if damping > _LEAST_DAMPING else 0.0
            elif self.problem.robust and tried is good and not damping and _slow(path):
                path = [good.passed]  # what is foretold of weights may fail where a full step does not
            elif tried is good or cost < _CLEARLY_LESS * self.cost(tried, noise):
                tried = trial
            else:
                if not good.noise.settled:  # weighted by what it leaves itself, the point may be the end
                    good = accepted(good.z, self.evaluator(good.z, noise.sigmas), noise)
                tried, failures, damping = good, failures + 1, max(10.0 * damping, _LEAST_DAMPING)
                path = [good.passed]
        # Where nothing lowers the cost, and little is foretold to, the search has come as far as rounding lets it.
        stuck = failures > _MOST_FAILURES and good.noise.settled and good.gain < _HARDLY_A_GAIN
        return good, stuck or self.at_rest(good, slowly=slowly(path, failures, steps))


class _Passed(NamedTuple):
    """What is remembered of a point that was passed, without its rows: z (p,) and the full step (p,) from there."""

    z: Array
    full: Array

    @property
    def length(self) -> float:
        """Length of the full step, in parameter scales."""
        return float(np.max(np.abs(self.full)))


def _slow(path: Sequence[_Passed]) -> bool:
    return len(path) > 2 and path[-1].length > _QUICK * path[-2].length


def _accelerated(path: Sequence[_Passed], prior: _Prior) -> Array:
    """Return the next step (p,): the full one, or where full steps shrink slowly, what the last ones foretell.

    Where residuals bend as much as priors hold, full steps converge slowly along a few directions (D. G. Anderson,
    Iterative procedures for nonlinear integral equations, Journal of the ACM 12, 1965).
    """
    last = path[-1]
    if not _slow(path):
        return last.full
    # Lengths are those of the priors, in which all parameters compare.
    units = np.where(prior.hold > 0.0, prior.hold, 1.0)
    Z, F = (np.diff(np.column_stack([getattr(at, name) for at in path])) for name in ("z", "full"))
    gamma = np.linalg.lstsq(units[:, None] * F, units * last.full, rcond=1e-6)[0]
    return np.asarray(last.full - (Z + F) @ gamma)


def solution_at(problem: LeastSquares, x: Array) -> Solution:
    """Return what the data tell at x (p,), which was found in another way, with the noise that it leaves.

    By how much x is off the minimum is a full step from there.
    """
    s = scales(problem.parameters)
    search = _Search(problem, _Evaluator(problem, s), _Prior.of(problem, x / s), (None,) * len(problem.components))
    noise = search.beginning()
    evaluation = search.evaluator(x / s, noise.sigmas)
    here = search.noise(x / s, evaluation, noise, sought=False)
    off = -s * _Point.of(x / s, evaluation, noise, here).full
    return _solution(search, x / s, evaluation, here, evaluation)._replace(off=off)


class Sought(NamedTuple):
    """Where a search has ended: scaled values z (p,) and the ``noise`` there; ``end``: the point that was seen last.

    ``first``: the evaluation at the start. The others as a :class:`Solution` has them.
    """

    search: _Search
    first: Evaluation
    end: _Point
    z: Array
    noise: _Noise
    converged: bool
    narrowed: float
    widened: frozenset[str]

    @property
    def x(self) -> Array:
        """The values (p,) in SI units."""
        return self.z * scales(self.search.problem.parameters)

    @property
    def evaluation(self) -> Evaluation:
        """That of the rows at the values, weighted by the noise there."""
        return self.search.evaluator(self.z, self.noise.sigmas)

    def again(self, problem: LeastSquares, *, roughly: bool) -> "Sought":
        """Seek from here on the solution of the same problem with priors of other widths; scales stay the same."""
        search = self.search._replace(problem=problem, prior=_Prior.of(problem, self.z))
        return _narrowed(search, self.first, self.z, self.noise, roughly=roughly)

    @property
    def asked(self) -> frozenset[str]:
        """The groups of joint terms with learned widths which rows ask to be larger than weak priors let them be."""
        search, found = self.search, set[str]()
        for group, count in _terms_to_widen(search.problem, learned=True).items():
            weak, wide = search.prior.unlearned(search.problem, group), search.prior.widened(search.problem, {group})
            if search._replace(prior=wide).asked(self.end, weak, count):
                found.add(group)
        return frozenset(found)

    @property
    def told(self) -> Solution:
        """The solution with what the data tell there."""
        found = _solution(self.search, self.z, self.end.evaluation, self.noise, self.first)
        return found._replace(
            step=self.end.length, converged=self.converged, narrowed=self.narrowed, widened=self.widened
        )


def _solution(search: _Search, z: Array, evaluation: Evaluation, noise: _Noise, first: Evaluation) -> Solution:
    """Return the solution z (p,) with what an evaluation near it tells, by the noise there.

    ``first``: the evaluation at the start.
    """
    s = scales(search.problem.parameters)
    data, apart = evaluation.reweighted(noise.factors).rows.whole, search.problem.targets_apart
    beside = search.prior.stated_beside(data)
    factors, _ = weights.factors_of(search.problem, search.beginning().sigmas, noise.sigmas)
    return Solution(
        z * s,
        _spread(search.problem, beside).scaled(s),
        identifiability.directions_of(data.reduced(identifiability.RANK_TOLERANCE)),
        Spectrum(data, apart),
        Spectrum(beside, apart),
        first.reweighted(factors).rows.whole,
        noise.variances,
        noise.redundancies,
        search.evaluator.count,
        0.0,
        True,
    )


class _Followed:
    """The search as one for the common parameters (c,), targets following them: as the last Jacobian says."""

    def __init__(self, search: _Search, sigmas: tuple[Array, ...], z0: Array) -> None:
        self._search, self._sigmas, self._z = search, sigmas, z0
        self._reduced = self._at(z0)

    def _at(self, z: Array) -> Reduced:
        return self._search.prior.beside(self._search.evaluator(z, self._sigmas).rows.whole, z).reduced(ROUNDING)

    def whole(self, common: Array) -> Array:
        """Return all parameters (p,) for common ones."""
        split = self._search.evaluator.split
        before, own = split.parts(self._z)
        return split.whole(common, own + self._reduced.follow @ (common - before) + self._reduced.constant)

    def residual(self, common: Array) -> Array:
        """Return the residuals of all rows, targets eliminated."""
        try:
            return self._at(self.whole(common)).rest[:, -1]
        except PoseError:
            # Where a trial step opens a loop, nothing is nearer.
            return np.full(len(self._reduced.rest), _NOWHERE)

    def jacobian(self, common: Array) -> Array:
        """Return their derivatives (q, c); targets follow them from here on."""
        z = self.whole(common)
        self._z, self._reduced = z, self._at(z)
        return self._reduced.rest[:, :-1]


def _levenberg_marquardt(search: _Search, sigmas: tuple[Array, ...], z0: Array) -> Array:
    followed = _Followed(search, sigmas, z0)
    # lm and not trf: its first step is not held back, which saves half of the evaluations on nearly linear problems.
    # The columns are scaled already; SciPy's own scaling, its default since 1.16, would hold the first step back.
    result = scipy.optimize.least_squares(
        followed.residual,
        search.evaluator.split.parts(z0)[0],
        jac=followed.jacobian,
        method="lm",
        x_scale=1.0,
        ftol=_ROUGH,
        xtol=_ROUGH,
        gtol=_ROUGH,
        max_nfev=_MOST_WITH_WEAK_PRIORS if search.prior.has_weak else _MOST_ROUGH_STEPS,
    )
    return followed.whole(result.x)


def _spread(problem: LeastSquares, beside: Arrow) -> Covariance:
    """Return the covariance of the scaled values, by rows with stated priors, the null space closed."""
    split, rows = beside.split, beside.reduced(identifiability.RANK_TOLERANCE)
    directions = identifiability.directions_of(rows)
    common = directions.null_basis(directions.common_rank(identifiability.NUMERICAL_TOLERANCE))
    # Inner constraints close the null space: full rank by construction.
    constraints = identifiability.inner_constraints(common, [problem.parameters[k] for k in split.common])
    seen = directions.singular_values[: directions.numerical_rank]
    weight = float(np.sqrt(seen[0] * seen[-1])) if len(seen) else 1.0
    spread = np.linalg.pinv(np.concatenate([rows.rest[:, :-1], weight * constraints]), rcond=ROUNDING)
    spread = spread[:, : len(rows.rest)]
    return Covariance(split, spread @ spread.T, rows.follow, rows.root)


def _refuse_too_few(problem: LeastSquares, first: Evaluation, prior: _Prior) -> None:
    count = sum(measured.sigma.size for measured in problem.measurements) + len(first.relations)
    priors = int(np.count_nonzero(prior.stated))
    if count + priors > len(problem.parameters):
        return
    rank = identifiability.directions_of(
        prior.stated_beside(first.rows.whole).reduced(identifiability.RANK_TOLERANCE)
    ).rank
    if count + priors <= rank:
        raise IdentificationError(
            f"{count} measured numbers and {priors} priors determine {rank} unknowns, and no numbers are left to "
            "judge the fit; measure more poses, free fewer parameters, or give priors."
        )


def _keep(fixed: Sequence[float | None], estimated: Sequence[float]) -> tuple[float, ...]:
    return tuple(e if f is None else f for f, e in zip(fixed, estimated, strict=True))
