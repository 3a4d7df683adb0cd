"""From a fit to all that is known of its errors: noise, what is not seen, and what the model leaves out.

With whitened rows ``[J B r]`` of the data, B of what no parameter stands for (:mod:`calib.machine.systematic`), and
rows S of the priors, stated and weak, the solution x follows from the data by ``A = C J^T``, ``C = (J^T J + S^T
S)^-1``. Its error is ``C S^T`` times errors of the priors, ``A`` times noise, and ``A B`` times what is left out: a
sandwich of as many columns as parameters and waves, however many rows there are.

Rows that follow each other closely, as those of a stream, err together beyond all that. The autocorrelation of what is
left says how many rows count as one. Rows that repeat a pose are taken apart, into the means of poses, and what rows of
a pose differ by; each of these has a noise of its own, and only the first tells how sure the solution is.

Of waves and wind-up the residuals tell more than sizes. A dominant one is as large as it is, and not as those are that
are alike. So what counts is the expected product of their coefficients given the residuals: that of their likeliest
values, and what is left in doubt of them (bias and variance, as of an effect that is known and not corrected). That
doubt is four fifths as it would be if the errors were just of these functions, and a fifth as if nothing had been seen.
"""

import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import scipy

from calib.foundations.arrays import Array, BoolArray, IntArray, read_only
from calib.foundations.chance import correlation_time
from calib.foundations.linear import ROUNDING, one_thread, svd, triangle
from calib.identification import weights
from calib.identification.arrow import Arrow, Collected, Reduced, Split
from calib.identification.elimination import split_of
from calib.identification.fit import Fit
from calib.identification.identifiability import RANK_TOLERANCE
from calib.identification.losses import weighed_square
from calib.identification.machine import Layout, Machine, values_at
from calib.identification.not_seen import likely_widths
from calib.identification.parameters import Parameter, scales
from calib.identification.relations import related_targets
from calib.identification.repeats import Repeats, by_pose
from calib.identification.system import Problem, related
from calib.identification.widths import NormalEquations, likelihood, searched
from calib.machine.systematic import Systematic, usual_waves
from calib.machine.uncertainty import LeftOut, Waves, WindUp
from calib.machine.winding import ReadingErrors, usual_wind_up
from calib.measurement.poses import poses_of

# Directions that the residuals must see, given sizes that are usual, before they may teach one: else it stays usual.
_FEWEST = 3.0
# Of a robust loss, rows that lie farther off count as ordinary ones.
_FAR = 2.0
# By how much sizes of waves differ, as a logarithm: fourfold is usual, and the more may be, the larger are those that
# chance makes.
_ALIKE = 1.4
# The power of a size by which the likelihood is multiplied, twice.
_OFF_ZERO = 0.5
# Errors of a robot are not quite of the functions that stand for them, so that residuals tell less of coefficients than
# they seem to: of two variances of a coefficient, after and before the residuals are seen, so much is of the former.
_BELIEVED = 0.8
# So many times as many columns as parameters are made short at once.
_AT_ONCE = 4
# Longest lag of it, in rows.
_LONGEST_LAG = 100


class ErrorsByCause(NamedTuple):
    """The error of a solution by its causes: columns (p, k) for errors of size 1, in parameter scales.

    ``instrument``: of noise and drift of the instrument; ``unseen``: of priors, stated and weak; ``scatter``: of what
    the model leaves out and looks like noise; ``of_readings``: of what follows the readings, a column for each of the
    root of ``left_out``.
    ``noise`` (c,): of every component the size of all noise that looks random, as a share of what the fit took it for;
    ``freedom`` (c,): with so many degrees of freedom. ``repeated`` (c,): whether its rows of one pose err together.
    """

    parameters: tuple[Parameter, ...]
    at: Machine
    instrument: Array
    unseen: Array
    scatter: Array
    of_readings: Array
    left_out: LeftOut
    noise: Array
    freedom: Array
    repeated: BoolArray


def errors_by_cause(fit: Fit, identified: Array) -> ErrorsByCause:
    """Return the errors of a fit, at the machine that it found; ``identified`` (nr, 2): least and greatest readings.

    What policy "minimal" held is among what is not seen.
    """
    with one_thread():
        return _errors_by_cause(fit, identified)


def _errors_by_cause(fit: Fit, identified: Array) -> ErrorsByCause:
    every = (*fit.parameters, *fit.held)
    frames, held = fit.machine.frames, fit.machine.deviations
    relations = fit.model.relations
    problem = Problem(fit.model, every, frames, fit.measurements, held, relations, fit.losses, together=fit.together)
    split = _split(fit, problem)
    x = values_at(fit.model.robot, every, frames, held)
    plain = weights.sigmas_of(problem, fit.variances, search=True)
    at, sigmas = problem.machine(x), _sigmas(fit, problem, plain)
    waves, wind_up = usual_waves(fit.robot, identified), usual_wind_up(fit.robot)
    of_readings = ReadingErrors(fit.robot, waves, wind_up)
    systematic = Systematic(problem, at, sigmas, of_readings, scales(every), split)
    parameters = tuple(every[k] for k in split.common)
    p, m, free = len(parameters), systematic.columns, int(np.count_nonzero(split.common < len(fit.parameters)))
    levels = _levels(fit, problem)
    parts = _parts(problem, systematic, split, levels, p + m)
    level, scale = np.array([part.level for part in parts]), np.array([part.scale for part in parts])
    triangles = [part.reduced.rest for part in parts]
    ends = np.cumsum([0, *map(len, triangles)])
    data = np.concatenate(triangles)
    solved = _solved(parameters, related(problem, x, split), data, free)
    from_data = solved.from_data

    def as_one(coefficients: Array) -> Array:
        # What the solution leaves when errors of those sizes are taken off as well.
        found = np.append(coefficients, 1.0)
        taken = np.concatenate([-from_data @ (data[:, p:] @ found), found])
        return _rows_as_one(problem, systematic, split, levels, parts, taken)

    sized = _sized(waves, wind_up)
    drifts = m - of_readings.many
    component = [one.component for one in levels]
    instrument, lessened = _instrument(problem, plain)[component], _lessened(problem)[component]
    taught = _Taught(
        _by_level(data[:, p:] - solved.J @ (from_data @ data[:, p:]), ends, level, scale),
        np.array([max(one.freedom, 1.0) for one in levels]),
        instrument * lessened,
        np.concatenate([sized, np.full(drifts, sized.max() + 1)]),
        drifts > 0,
    )
    learned, rows_as_one = _learned(taught, as_one)
    del taught  # of many tables it takes much memory
    noise = learned.noise / lessened

    of_rows = np.diff(ends)
    seen = np.repeat(np.minimum(instrument[level] / (noise[level] * np.sqrt(scale)), 1.0), of_rows)
    sigma = np.repeat((noise * np.sqrt(rows_as_one))[level] * np.sqrt(scale), of_rows)
    through = from_data * sigma
    hold = np.array([parameter.hold for parameter in parameters])
    z = x[split.common] / scales(parameters)
    weighed = triangle(np.column_stack([solved.J, data[:, -1]]) / sigma[:, None])
    widths = likely_widths(parameters, weighed[:, :-1], weighed[:, -1], z)
    unseen = np.hstack([solved.from_relations, solved.from_priors * (hold * widths)])
    bias = from_data @ data[:, p : p + m]
    root = _short(learned.root[: of_readings.many])
    off = np.zeros(len(every)) if fit.off is None else np.append(fit.off, np.zeros(len(fit.held)))
    off = off[split.common] / scales(parameters)
    return ErrorsByCause(
        parameters,
        at,
        _short(through * seen, bias[:, of_readings.many :] * learned.sizes[of_readings.many :]),
        _short(unseen),
        _short(through * np.sqrt(1.0 - seen**2), off[:, None]),
        bias[:, : of_readings.many] @ root,
        LeftOut(waves, wind_up, read_only(root)),
        *_by_component(levels, noise),
    )


def _sized(waves: Waves, wind_up: WindUp) -> IntArray:
    """Return the number (many,) of the size of every error of a reading.

    Cosine and sine of one order of one reading have one size, and all wind-up of one reading, whose drive it is.
    """
    drives = np.unique([term.reading for term in wind_up.terms], return_inverse=True)[1].reshape(-1)
    return np.concatenate([np.repeat(np.arange(waves.width.size), 2), waves.width.size + drives]).astype(np.intp)


class _Poses(NamedTuple):
    """The pose (N,) of every row of a component, numbered from 0; of the poses how often each was measured (P,).

    ``scale`` (P,): the variance of their means times ``many``, as a share of what it is on average.
    """

    pose: IntArray
    many: IntArray
    scale: Array

    @classmethod
    def of(cls, pose: IntArray, told: Repeats) -> "_Poses":
        """Return it as rows of a pose are told to err."""
        many = np.bincount(pose)
        variance = np.asarray(told.alone**2 + many * told.common**2, dtype=np.float64)
        return cls(pose, many, variance / float(np.mean(variance)))

    def means(self, rows: Array) -> Array:
        """Return the means (P, ...) of rows (N, ...), times roots of ``many``: noise of rows that err alone stays."""
        sums, many = by_pose(rows, self.pose)
        return np.asarray(sums / np.sqrt(many).reshape(-1, *[1] * (rows.ndim - 1)))

    def in_order(self, rows: Array) -> Array:
        """Return the means (P, d) of rows (N, d) in the order in which poses were first measured, all of one noise."""
        order = np.argsort(np.unique(self.pose, return_index=True)[1])
        return np.asarray((self.means(rows) / np.sqrt(self.scale)[:, None])[order])

    def apart(self, rows: Array) -> Array:
        """Return what the rows (n, ...) of repeated poses differ by from their means."""
        again = self.many[self.pose] > 1
        means = self.means(rows) / np.sqrt(self.many).reshape(-1, *[1] * (rows.ndim - 1))
        return np.asarray((rows - means[self.pose])[again])


class _Level(NamedTuple):
    """Rows of a ``component`` that have a noise of their own, of ``freedom``: all of them, where ``poses`` is None.

    Else the means of poses; or, ``within``, what rows of one pose differ by.
    """

    component: int
    freedom: float
    poses: _Poses | None = None
    within: bool = False


class _Part(NamedTuple):
    """Rows of a ``level``, by number, reduced; their variance is ``scale`` times that of the level."""

    level: int
    scale: float
    reduced: Reduced


def _levels(fit: Fit, problem: Problem) -> list[_Level]:
    """Return the levels of all components, in their order."""
    told = {(one.measurements, one.quantity): one for one in fit.repeats}
    found = []
    for c, (component, noise) in enumerate(zip(problem.components, fit.noise_by_rows, strict=True)):
        one = told.get((component.measurements, component.quantity))
        if one is None:
            found.append(_Level(c, noise.degrees_of_freedom))
            continue
        data = problem.measurements[component.measurements]
        poses = _Poses.of(poses_of(data), one)
        # Parameters are determined by the means.
        again = (component.columns.stop - component.columns.start) * (one.rows - one.poses)
        found += [_Level(c, max(noise.degrees_of_freedom - again, 1.0), poses), _Level(c, again, poses, within=True)]
    return found


def _by_level(left: Array, ends: IntArray, level: IntArray, scale: Array) -> Array:
    """Return the grams (c, m + 1, m + 1) of every level, of what is ``left`` (q, m + 1) of its parts."""
    found = np.zeros((int(level.max()) + 1, left.shape[1], left.shape[1]))
    for (a, b), k, s in zip(itertools.pairwise(ends), level, scale, strict=True):
        found[k] += left[a:b].T @ left[a:b] / s
    return found


def _by_component(levels: Sequence[_Level], noise: Array) -> tuple[Array, Array, BoolArray]:
    """Return the noise of a row of every component, its degrees of freedom, and whether rows of a pose err together."""
    found = []
    for k, one in enumerate(levels):
        if one.poses is None:
            found.append((noise[k], one.freedom, False))
        elif not one.within:
            alone = noise[k + 1]
            common = max(noise[k] ** 2 - alone**2, 0.0) / float(np.mean(one.poses.many))
            found.append((np.sqrt(alone**2 + common), one.freedom, True))
    total, freedom, repeated = zip(*found, strict=True)
    return np.array(total), np.array(freedom), np.array(repeated)


def _split(fit: Fit, problem: Problem) -> Split:
    """Return the split in which a target is told apart whose rows all have one noise: those of one set."""
    sets = problem.measurements
    seen = Counter(name for data in sets for name in data.seen_targets)
    held = {parameter.name.removeprefix("target.").rpartition(".")[0] for parameter in fit.held}
    related = related_targets(problem.relations)
    # What has levels of its own is not one noise.
    related |= {name for told in fit.repeats for name in sets[told.measurements].seen_targets}
    joined = {t for t, name in enumerate(sets[0].targets) if seen[name] > 1 or name in held or name in related}
    layout = Layout.of(problem.model.robot, problem.reference)
    return split_of(problem.parameters, layout, sets, joined, targets_alone=True)


def _parts(
    problem: Problem, systematic: Systematic, split: Split, levels: Sequence[_Level], columns: int
) -> list[_Part]:
    """Return the rows ``[J B r]`` of every level, in order, targets eliminated by their own rows alone."""
    m, a = split.blocks.shape
    seen = [systematic.rates.seen(problem.measurements[c.measurements]) for c in problem.components]
    collected = [Collected(own, m, a, columns) for own in seen]
    whole: dict[int, list[Array]] = {one.component: [] for one in levels if one.poses is not None}
    for c, rows, own, block in systematic.rows():
        if c in whole:
            whole[c].append(rows)
        else:
            collected[c].add(rows, own, block)
    found = []
    for k, one in enumerate(levels):
        if one.poses is None:
            found.append(_Part(k, 1.0, _solved_for(split, collected[one.component])))
            continue
        rows = np.concatenate(whole[one.component])
        for scale, own in _alike(one.poses, rows, within=one.within):
            collected[one.component].forget()
            collected[one.component].add(own, None, None)
            found.append(_Part(k, scale, _solved_for(split, collected[one.component])))
    return found


def _alike(poses: _Poses, rows: Array, *, within: bool) -> Iterator[tuple[float, Array]]:
    """Yield rows whose noise is about the same, and its variance: of poses that were measured about as often."""
    if within:
        yield 1.0, poses.apart(rows)
        return
    means, often = poses.means(rows), np.frexp(poses.many)[1]
    for k in np.unique(often):
        yield float(np.mean(poses.scale[often == k])), means[often == k]


def _solved_for(split: Split, rows: Collected) -> Reduced:
    which, heads = rows.heads
    return Arrow(split.of_blocks(which), heads, rows.rest).reduced(RANK_TOLERANCE)


class _Solved(NamedTuple):
    """How the solution (p) follows data, ``from_data`` (p, q), relations (p, l), and priors, ``from_priors`` (p, p).

    ``J`` (q, p): of the data, as the solution sees it.
    """

    J: Array
    from_data: Array
    from_relations: Array
    from_priors: Array


def _solved(parameters: Sequence[Parameter], relations: Array, data: Array, free: int) -> _Solved:
    """Return the solution from ``data`` (q, p + m + 1), whitened triangles ``[J B r]`` of all components.

    ``relations`` (l, p + 1): between targets. Parameters beyond the first ``free`` ones are held; their errors are
    those of their priors, and the others follow.
    """
    p = len(parameters)
    hold = np.array([parameter.hold for parameter in parameters])
    J, between = data[:, :p], relations[:, :free]
    rows = np.concatenate([J[:, :free], between, np.diag(hold[:free])])
    U, s, Vt = svd(rows, full_matrices=False)
    follows = np.pad((Vt.T / np.maximum(s, ROUNDING * s[0])) @ U.T, ((0, p - free), (0, 0)))
    from_data, from_relations, from_priors = np.split(follows, [len(data), len(data) + len(between)], axis=1)
    held = np.vstack([from_data[:free] @ J[:, free:], -np.eye(p - free)]) / hold[free:]
    return _Solved(J, from_data, from_relations, np.hstack([from_priors, held]))


def _instrument(problem: Problem, sigmas: tuple[Array, ...]) -> Array:
    """Return the rms of the instrument's noise (c,) in every component, as a share of what ordinary rows scatter by."""
    shares = [data.sigma / sigma for data, sigma in zip(problem.measurements, sigmas, strict=True)]
    return np.array([np.sqrt(np.mean(shares[c.measurements][:, c.columns] ** 2)) for c in problem.components])


def _lessened(problem: Problem) -> Array:
    """Return as what share of itself (c,) the noise of every component shows in rows that a loss has weighed."""
    which = [c.measurements for c in problem.components]
    return np.sqrt([weighed_square(problem.losses[i], problem.measurements[i].sigma.shape[1]) for i in which])


class _Learned(NamedTuple):
    """The likeliest ``sizes`` (m,) of all that is left out, ``noise`` (c,) and ``coefficients`` (m,).

    ``root`` (m, 2 m + 1): ``root @ root.T`` is the expected product of the coefficients.
    """

    sizes: Array
    noise: Array
    coefficients: Array
    root: Array


class _Taught(NamedTuple):
    """What teaches sizes: ``grams`` (c, m + 1, m + 1) of ``[B r]`` that the solution leaves, of every component.

    ``freedom`` (c,) and ``instrument`` (c,) of the components; ``group`` (m,) of the columns, ``drifts``: whether the
    last of them are.
    """

    grams: Array
    freedom: Array
    instrument: Array
    group: IntArray
    drifts: bool

    def sizes(self, rows_as_one: Array) -> _Learned:
        """Return what the grams teach, where so many rows (c,) are one."""
        grams = self.grams / rows_as_one[:, None, None] if np.any(rows_as_one != 1.0) else self.grams
        m, c = len(self.group), len(grams)
        known, fixed = np.zeros((m + 1, m + 1)), np.zeros(c, dtype=bool)
        rows = NormalEquations(grams, self.freedom / rows_as_one, known, self.instrument, fixed, self.group)
        sizes, noise = _sizes(rows, self.drifts)
        H = np.tensordot(noise**-2.0, grams, 1)
        H[range(m), range(m)] += sizes[self.group] ** -2.0
        lower = scipy.linalg.cholesky(H[:m, :m], lower=True)
        found = -scipy.linalg.cho_solve((lower, True), H[:m, m])
        doubt = scipy.linalg.solve_triangular(lower, np.eye(m), lower=True, trans=1)
        before = np.sqrt(1.0 - _BELIEVED) * np.diag(sizes[self.group])
        return _Learned(sizes[self.group], noise, found, np.column_stack([found, np.sqrt(_BELIEVED) * doubt, before]))


def _learned(taught: _Taught, as_one: Callable[[Array], Array]) -> tuple[_Learned, Array]:
    """Return what is learned, and how many rows of every component (c,) count as one.

    ``as_one``: how many do by the autocorrelation of what coefficients (m,) leave.
    """
    rows_as_one = np.ones(len(taught.freedom))
    learned = taught.sizes(rows_as_one)
    counted = as_one(learned.coefficients)
    return (taught.sizes(counted), counted) if np.any(counted > 1.0) else (learned, rows_as_one)


def _sigmas(fit: Fit, problem: Problem, plain: tuple[Array, ...]) -> tuple[Array, ...]:
    """Return the standard deviations (N, d) of every set, by which no row that lies off tells more than others do.

    ``plain``: those of ordinary rows.
    """
    if not problem.robust:
        return plain
    found = weights.sigmas_of(problem, fit.variances, fit.residuals, search=True)
    far = [np.sqrt(np.mean((r / sigma) ** 2, axis=1)) for r, sigma in zip(fit.residuals, found, strict=True)]
    return tuple(sigma * np.where(t > _FAR, t, 1.0)[:, None] for sigma, t in zip(found, far, strict=True))


def _sizes(rows: NormalEquations, drifts: bool) -> tuple[Array, Array]:
    """Return the likeliest sizes (g,) of what is left out, in usual ones, and of the noise (c,).

    ``rows.group``: number of every wave and wind-up, and one more where an instrument may drift. All but the drift have
    sizes of their own, but are expected to be alike: their logarithms scatter by ``_ALIKE`` about a common one. As in
    :mod:`calib.identification.widths` the likelihood is multiplied by a power of the common size, and of that of the
    drift, so that nothing is said to be zero because it does not show.
    """
    g = int(rows.group.max()) + 1
    usual, ones = np.ones(g), np.ones(len(rows.counts))
    if np.sum(likelihood(rows, usual, ones).gamma) < _FEWEST:
        return usual, ones
    waves = g - 1 if drifts else g

    def held(logs: Array) -> tuple[float, Array]:
        apart = logs[:waves] - np.mean(logs[:waves])
        slopes = np.full(g, -_OFF_ZERO)
        slopes[:waves] = 2.0 * apart / _ALIKE**2 - _OFF_ZERO / waves
        cost = np.sum(apart**2) / _ALIKE**2 - _OFF_ZERO * (np.mean(logs[:waves]) + np.sum(logs[waves:]))
        return float(cost), slopes

    return searched(rows, usual, held)


def _rows_as_one(
    problem: Problem,
    systematic: Systematic,
    split: Split,
    levels: Sequence[_Level],
    parts: Sequence[_Part],
    coefficients: Array,
) -> Array:
    """Return how many rows of every level (c,) count as one, by the autocorrelation of what is left."""
    left: list[list[Array]] = [[] for _ in problem.components]
    m, a = split.blocks.shape
    placed = [np.zeros((m + 1, a)) for _ in problem.components]
    for part in parts:
        level, own = levels[part.level], part.reduced
        # Where rows repeat poses, no target is told apart.
        if level.poses is None:
            which = systematic.rates.seen(problem.measurements[problem.components[level.component].measurements])
            placed[level.component][which] = own.follow @ coefficients[:-1] + own.constant * coefficients[-1]
    for c, rows, by_own, block in systematic.rows():
        after = rows @ coefficients
        if by_own is not None:
            after = after + (by_own @ placed[c][block][:, :, None])[:, :, 0]
        left[c].append(after.ravel())
    found = []
    for level in levels:
        n = len(problem.measurements[problem.components[level.component].measurements])
        r = np.concatenate(left[level.component]).reshape(n, -1)
        if level.poses is not None:
            r = level.poses.in_order(r)
        found.append(1.0 if level.within else correlation_time(r, _LONGEST_LAG))
    return np.array(found)


def _short(*several: Array) -> Array:
    """Return as few columns with the same covariance as ``several`` (p, k) have together, gone through bit by bit."""
    rows = [columns.T for columns in several]
    found, many = np.empty((0, rows[0].shape[1])), _AT_ONCE * max(rows[0].shape[1], 1)
    for some in rows:
        for start in range(0, len(some), many):
            found = triangle(np.concatenate([found, some[start : start + many]]))
    return found.T
