"""Effects that no parameter of a fit stands for, sought in its residuals: how large each would be, and how sure.

An effect is a direction d in the space of all measured numbers: what one unit of it would do to them. With whitened
residuals r, Jacobian J and covariance C of the parameters, those take up ``J C J^T d`` of it and leave l, the rest. The
size of the effect is

    a = -(l^T r) / (l^T l)

a score test (C. R. Rao, 1948): nothing is fitted anew. With l in place of d, what r still has along the parameters, as
weak priors keep it, is no effect: of a large d that the parameters nearly take up, little of it would be a multiple.
Neighbouring rows go together - a gear that wobbles errs alike in all of them -, so that N rows say less than N
independent ones: the standard error of ``a`` is that of sums over blocks of neighbours, each longer than residuals
remember (W. K. Newey, K. D. West, Econometrica 55, 1987, with blocks).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, takewhile
from typing import NamedTuple, TypeVar

import numpy as np

from calib.assessment.stretches import Stretch, as_means
from calib.foundations.arrays import Array, IntArray
from calib.foundations.chance import autocorrelations, exceeded
from calib.measurement.checks import resolutions
from calib.measurement.measurements import numbered
from calib.measurement.poses import ONE_POSE
from calib.measurement.streams.sides import sides
from calib.robot.robot import Robot

# Fewer blocks than these give no standard error.
_LEAST_BLOCKS = 8
# A correlation below this is none.
_FORGOTTEN = 0.1
# Directions of whose square the parameters leave less than this share are theirs.
_TAKEN = 1e-7
# The same of axes of unequal length. Points nearly in a plane leave 1e-5 of those across it: by a machine that leaves
# something out, these then seem unequal by any amount. Where axes can be told they left about 1e-3 or more.
_AXES_TAKEN = 1e-4
# Rows that remember more than so many others are a smooth path; rows beside a place that show a change there, and what
# share of it; how much of all rows parameters take up at most then.
_SMOOTH, _FEW_ROWS, _AT_ONCE, _LITTLE = 1.0, 4, 0.75, 0.1
# No motion that is fitted enlarges the whitened sum of squares; priors let it grow by less than this.
_GROWN = 1.0
_MOST_SPLITS = 60
# Rows of a stream that are farther apart, in steps, are no neighbours. Accelerations are over so long a time, in s.
_GAP, _LONGER = 2.5, 0.25
# Rows on either side of a jump; and which share of either is on its own side of one reading, where a joint parts them.
_LEAST_ROWS = 3
_PARTED = 0.9
# Kinds whose targets are measured from anywhere, and those that an arm touches.
_FROM_ANYWHERE, _TOUCHED = ("distance", "indicator"), ("socket", "plane", "sphere")
# The instrument's noise explains what remains where it leaves as much more often than this.
_EXPLAINED = 1e-3
# Rows at one place touch it in orientations that are too alike where their mean axes are longer than this, squared.
_ALIKE = 0.3
# A joint hardly moves below such a share of its rms rate.
_HARDLY = 0.05
# What drifts where an arm warms up.
LENGTHS = "length of the arm"
_Found = TypeVar("_Found")


@dataclass(frozen=True, slots=True)
class Effect:
    """How large an effect is: ``value`` with its standard error ``sigma``, in the effect's own unit.

    ``size``: what it does to a row, over the standard deviation of what remains of one number without it. Nan where the
    parameters could stand for it, or where rows are too few. ``freedom``: degrees of freedom of the standard error.
    """

    value: float
    sigma: float
    size: float
    freedom: float = np.inf

    @property
    def t(self) -> float:
        """The value over its standard error; 0 where nothing is known."""
        return self.value / self.sigma if self.sigma > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class Step:
    """The likeliest change between two rows: of ``what``, after row ``line`` of ``file``.

    ``size``: what it does to a row, over the standard deviation of what remains of one number. ``chance``: of one such
    change anywhere, neighbouring rows taken for as many as they are worth. ``parted``: the joint, if there is one, that
    stood elsewhere in the rows before than in those after, so that errors of the arm there look like the change.
    ``photographed``: whether rows are marks in photographs.
    """

    what: str
    file: str
    line: int
    size: float
    chance: float
    parted: str = ""
    photographed: bool = False


NO_EFFECT = Effect(float("nan"), float("nan"), float("nan"))


def effect(
    parts: Sequence[Stretch], directions: Sequence[Array], C: Array, runs: Sequence[IntArray] | None = None
) -> Effect:
    """Return how large an effect is that would change the whitened numbers of every part by ``directions`` (n, d).

    ``runs`` (n,), by number from 0: rows that err together too, for however long. Where each has a sign of its own,
    as many numbers as there are runs tell the effect, and its standard error.
    """
    if not parts:
        return NO_EFFECT
    r, d = (np.concatenate([x.ravel() for x in xs]) for xs in ([part.r for part in parts], directions))
    both = [(part.J.reshape(-1, len(C)), own.ravel()) for part, own in zip(parts, directions, strict=True)]
    taken = C @ np.sum([J.T @ own for J, own in both], axis=0)
    left = np.concatenate([own - J @ taken for J, own in both])
    M = float(left @ left)
    if not _TAKEN * float(d @ d) < M:
        return NO_EFFECT
    value = -float(left @ r) / M
    rest = r + left * value
    lengths = [len(part.r) for part in parts]
    ends = np.cumsum([part.r.size for part in parts])[:-1]
    scores = [
        (own * what).reshape(n, -1).sum(axis=1)
        for own, what, n in zip(np.split(left, ends), np.split(rest, ends), lengths, strict=True)
    ]
    after = [x.reshape(n, -1) for x, n in zip(np.split(rest, ends), lengths, strict=True)]
    length = 1 + int(np.ceil(2.0 * memory(after)))
    sums = np.concatenate([np.add.reduceat(score, np.arange(0, len(score), length)) for score in scores if len(score)])
    if len(sums) < _LEAST_BLOCKS:
        return NO_EFFECT
    # Of numbers the parameters have taken some.
    free = max(len(r) - sum(part.used for part in parts), 0.05 * len(r), 1.0)
    variance = max(float(rest @ rest) / free, *(part.least for part in parts))
    squares, freedom = float(sums @ sums) * len(r) / free, np.inf
    if runs is not None:
        of_runs = np.concatenate([np.bincount(run, score) for run, score in zip(runs, scores, strict=True)])
        freedom = float(np.count_nonzero(of_runs) - 1)
        if freedom < 1.0:
            return NO_EFFECT
        squares = max(squares, float(of_runs @ of_runs) * (1.0 + 1.0 / freedom))
    sigma = np.sqrt(max(squares, M * variance)) / M
    size = float(np.sqrt(value**2 * M / sum(lengths) / variance))
    return Effect(value, float(sigma), size, freedom)


def memory(parts: Sequence[Array]) -> float:
    """Return how many rows residuals (n, d) remember: the sum of their autocorrelations until one is small."""
    most = max((len(r) for r in parts), default=0) // 6
    return sum(takewhile(lambda rho: rho >= _FORGOTTEN, autocorrelations(parts, most)))


def gains(parts: Sequence[Stretch], C: Array) -> dict[str, Effect]:
    """Return for every joint by which share more than it says it would move; its zero may be elsewhere too."""
    return {
        name: _gain(parts, [part.by_joint[:, :, j] for part in parts], [part.values[:, j] for part in parts], C)
        for j, name in enumerate(parts[0].joints if parts else ())
    }


def ratios(parts: Sequence[Stretch], C: Array) -> dict[tuple[str, str], Effect]:
    """Return for every joint, and reading of another that it follows, by which share more it would follow that one."""
    return {
        tie: _gain(parts, [part.by_follower[:, :, j] for part in parts], [part.followed[:, j] for part in parts], C)
        for j, tie in enumerate(parts[0].followers if parts else ())
    }


def _gain(parts: Sequence[Stretch], turned: Sequence[Array], motions: Sequence[Array], C: Array) -> Effect:
    """Return by which share more a joint would move than by ``motions`` (n,); ``turned`` (n, d): what its turn does."""
    within, own = _besides(parts, [Z[:, :, None] for Z in turned], C)
    every = zip(within, turned, motions, strict=True)
    usable = [(part, Z * motion[:, None]) for part, Z, motion in every if part.data.other is None]
    return effect([part for part, _ in usable], [d for _, d in usable], own)


def _besides(parts: Sequence[Stretch], motions: Sequence[Array], C: Array) -> tuple[tuple[Stretch, ...], Array]:
    """Return parts and covariance as of a fit that had sought ``motions`` (n, d, k) of all rows of every part too.

    Where the fit has parameters for them, nothing changes. Where it has none, what is elsewhere in all rows would look
    like a step that leaves out but a few of them.
    """
    both = list(zip(motions, parts, strict=True))
    A = np.sum([np.tensordot(Z, Z, ((0, 1), (0, 1))) for Z in motions], axis=0)
    S = np.sum([np.tensordot(Z, part.J, ((0, 1), (0, 1))) for Z, part in both], axis=0)
    g = np.sum([np.einsum("ndk,nd->k", Z, part.r) for Z, part in both], axis=0)
    values, V = np.linalg.eigh(A - S @ C @ S.T)
    kept = values > _TAKEN * np.trace(A) / len(A)
    values, V = values[kept], V[:, kept]
    sizes = -(V.T @ g) / values
    # What the parameters leave of it: so the covariance has no terms of both.
    taken = C @ S.T @ V
    left = [Z @ V - (part.J.reshape(-1, len(C)) @ taken).reshape(*Z.shape[:2], -1) for Z, part in both]
    # A fit that ended a hair early leaves some along its parameters, and that is no motion they nearly take up.
    kept = np.sum([_grown(part.r, L, sizes) for L, part in zip(left, parts, strict=True)], axis=0) < _GROWN
    if not kept.any():
        return tuple(parts), C
    values, sizes = values[kept], sizes[kept]
    found = []
    for whole, part in zip(left, parts, strict=True):
        L = whole[:, :, kept]
        r, J = part.r + L @ sizes, np.concatenate([part.J, L], axis=2)
        found.append(replace(part, r=r, J=J, used=part.used + float(np.sum(L**2 / values))))
    p = len(C)
    covariance = np.zeros((p + len(values), p + len(values)))
    covariance[:p, :p], covariance[p:, p:] = C, np.diag(1.0 / values)
    return tuple(found), covariance


def _grown(r: Array, left: Array, sizes: Array) -> Array:
    """Return by how much each of the directions ``left`` (n, d, k), ``sizes`` (k,) of it, enlarges the sum of r^2."""
    return np.asarray(sizes * (2.0 * np.einsum("ndk,nd->k", left, r) + sizes * np.sum(left**2, axis=(0, 1))))


def delay(parts: Sequence[Stretch], C: Array) -> tuple[Effect, float]:
    """Return by how much what was measured is later than the readings beside it: residuals that follow the speed.

    In seconds, and the seconds between rows, where all rows have times as streams have them. Else in rows, in their
    order, and nan. No effect for kinds with two ends.
    """
    usable = [part for part in parts if part.data.other is None]
    step = float(np.mean([part.step for part in usable])) if usable else float("nan")
    # Where some tables have times, and others have none, rows are what they have in common.
    units = [1.0 if np.isfinite(step) or not np.isfinite(part.step) else part.step for part in usable]
    moved = [
        np.einsum("ndk,nk->nd", part.by_joint, -part.rates * unit) for part, unit in zip(usable, units, strict=True)
    ]
    return effect(usable, moved, C), step


class Timing(NamedTuple):
    """How readings of a stream keep time among themselves.

    ``by_joint``: by how many s what was measured is later than the readings of each joint alone. ``smoothed``, in s^2:
    half the variance of the times over which readings are means, that of the others alike taken for delay. ``ahead``:
    by how many rad or m each joint is ahead of where it is read on the way that it goes; by backlash it is below zero,
    half of the gap. ``step``: s between rows; nan where not all rows have times, and nothing is said.
    """

    by_joint: Mapping[str, Effect]
    smoothed: Effect
    ahead: Mapping[str, Effect]
    step: float


def timing(parts: Sequence[Stretch], C: Array, scalars: Array) -> Timing:
    """Return whether some joint is late by itself, and whether readings are means over a time, as filters make them.

    To second order a mean over times of variance v is ``q - delay q' + v/2 q''``. ``scalars``: what was found of
    clocks. A joint keeps the side from which it came also while it rests, and what rows leave from one turn to the next
    is told by one number.
    """
    usable = [part for part in parts if part.data.other is None]
    step = float(np.mean([part.step for part in usable])) if usable else float("nan")
    if not np.isfinite(step):
        return Timing({}, NO_EFFECT, {}, step)

    def each(ways: Sequence[Array], *, by_turns: bool = False) -> dict[str, Effect]:
        both = list(zip(usable, ways, strict=True))
        return {
            name: effect(
                usable,
                [part.by_joint[:, :, j] * way[:, None, j] for part, way in both],
                C,
                [_runs(way[:, j]) for way in ways] if by_turns else None,
            )
            for j, name in enumerate(usable[0].joints)
        }

    by_joint = each([-part.rates for part in usable])
    ahead = each([_ways(part, scalars) for part in usable], by_turns=True)
    moved = [-np.einsum("ndk,nk->nd", part.by_joint, _accelerations(part)) for part in usable]
    return Timing(by_joint, effect(usable, moved, C), ahead, step)


def _ways(part: Stretch, scalars: Array) -> Array:
    """Return the ways (n, k) that joints came to where they are, +1 or -1, 0 where nobody knows.

    Where no stream tells, those of the rates, but where a joint hardly moves: there they are those of jitter.
    """
    data = part.data
    if data.stream is None:
        moving = np.abs(part.rates) > _HARDLY * np.sqrt(np.mean(part.rates**2, axis=0))
        return np.where(moving, np.sign(part.rates), 0.0)
    read = [data.reading_names.index(name) for name in part.joints]
    rows = part.row.astype(np.intp)
    return np.nan_to_num(sides(data.stream.joints, data.stream.times(data.shifts(scalars), rows))[:, read])


def _runs(way: Array) -> IntArray:
    """Return the number (n,) of the run of every row, in which a joint went one ``way`` (n,), or rested."""
    known = np.flatnonzero(way)
    turned = np.zeros(len(way), dtype=np.intp)
    turned[known[1:][way[known[1:]] != way[known[:-1]]]] = 1
    return np.cumsum(turned)


def _accelerations(part: Stretch) -> Array:
    """Return how fast the rates (n, k) change, in a second, over a quarter of one or a row; 0 beside gaps.

    Of readings that are rounded, or jitter, what changes from row to row is their error, and what rows leave goes with
    that whatever the arm does. Over longer times it is the motion.
    """
    assert part.data.times is not None
    times = part.data.times[part.row.astype(np.intp)]
    if len(times) < 2:
        return np.zeros_like(part.rates)
    apart, steps = max(_LONGER, part.step), np.diff(times)
    means = 0.5 * (part.rates[1:] + part.rates[:-1]) * steps[:, None]
    ways = np.concatenate([np.zeros((1, part.rates.shape[1])), np.cumsum(means, axis=0)])
    gaps = np.concatenate([[0], np.cumsum(~((steps > 0.0) & (steps < _GAP * part.step)))])
    order = np.argsort(times, kind="stable")
    before, after = (
        [np.interp(times + by, times[order], column[order]) for column in (*ways.T, gaps)] for by in (-apart, apart)
    )
    known = (np.abs(before[-1] - after[-1]) == 0.0) & (times - apart >= times.min()) & (times + apart <= times.max())
    found = (np.array(before[:-1]) + np.array(after[:-1]) - 2.0 * ways.T) / apart**2
    return np.asarray(np.where(known, found, 0.0).T)


def unsettled(parts: Sequence[Stretch], C: Array) -> Effect:
    """Return how far joints had still to go when they were read, in rad or m of the one that moved most.

    Drives brake together and come to rest at once: what is left is in proportion to how far each has come since the
    pose before, and of the farthest it is alike from pose to pose. Below zero where they were read at rest, and the
    instrument measured before. No effect of rows that are neighbours in no table, of streams, of kinds with two ends;
    nor where the sides from which joints came explain more, as gaps of gears do, or a delay.
    """
    usable = [part for part in parts if part.data.other is None and not np.isfinite(part.step)]
    moves = [_moves(part) for part in usable]
    farthest = [np.max(np.abs(move), axis=1, keepdims=True, initial=0.0) for move in moves]
    shares = [move / np.where(far > 0.0, far, 1.0) for move, far in zip(moves, farthest, strict=True)]
    left = [part.by_joint * share[:, None, :] for part, share in zip(usable, shares, strict=True)]
    sides = [part.by_joint * np.sign(move)[:, None, :] for part, move in zip(usable, moves, strict=True)]
    together = [motion.sum(axis=2) for motion in left]
    late = [np.einsum("ndk,nk->nd", part.by_joint, part.rates)[:, :, None] for part in usable]
    gained = [_gained(usable, motions, C) for motions in ([own[:, :, None] for own in together], sides, late) if usable]
    return effect(usable, together, C) if gained and gained[0] > max(gained[1:]) else NO_EFFECT


def _gained(parts: Sequence[Stretch], motions: Sequence[Array], C: Array) -> float:
    """Return by how much ``motions`` (n, d, k) of all rows of every part would lower the sum of squares."""
    D = np.concatenate([motion.reshape(-1, motion.shape[2]) for motion in motions])
    J = np.concatenate([part.J.reshape(-1, len(C)) for part in parts])
    return float(score_test(D.T @ D, D.T @ J, D.T @ np.concatenate([part.r.ravel() for part in parts]), C).gain)


def _moves(part: Stretch) -> Array:
    """Return how far the readings (n, k) of rows have come from the pose before; 0 where that is in no line before."""
    lines = part.data.lines[part.row.astype(np.intp)]
    new = np.concatenate([[True], np.any(np.abs(np.diff(part.values, axis=0)) > ONE_POSE, axis=1)])
    first = np.maximum.accumulate(np.where(new, np.arange(len(new)), 0))
    follows = (first > 0) & (lines[first] - lines[first - 1] == 1)
    return np.asarray(np.where(follows[:, None], part.values[first] - part.values[first - 1], 0.0))


class Score(NamedTuple):
    """What directions gain, taken together: chi-squared ``gain`` (...) of so many ``numbers`` (...).

    ``sizes`` (..., k): by what directions would have to be multiplied.
    """

    gain: Array
    numbers: IntArray
    sizes: Array


def score_test(A: Array, S: Array, g: Array, C: Array, *, taken: float = _TAKEN) -> Score:
    """Return the score test of directions D: of A = D^T D (..., k, k), S = D^T J (..., k, p) and g = D^T r (..., k).

    Directions of whose square the parameters leave less than the share ``taken`` are theirs.
    """
    values, V = np.linalg.eigh(A - S @ C @ np.swapaxes(S, -1, -2))
    kept = values > taken * np.trace(A, axis1=-2, axis2=-1)[..., None] / A.shape[-1]
    u = np.einsum("...ij,...i->...j", V, g)
    weighed = np.where(kept, u / np.where(kept, values, 1.0), 0.0)
    return Score(
        np.sum(u * weighed, axis=-1), np.count_nonzero(kept, axis=-1), -np.einsum("...ij,...j->...i", V, weighed)
    )


def _score_of(D: Array, part: Stretch, C: Array, *, taken: float = _TAKEN) -> tuple[Score, Array]:
    """Return the score test of directions D (n d, k) of a part alone, and what they change in it (n, d)."""
    J = part.J.reshape(part.r.size, -1)
    S = D.T @ J
    score = score_test(D.T @ D, S, D.T @ part.r.ravel(), C, taken=taken)
    return score, ((D - J @ (C @ S.T)) @ score.sizes).reshape(part.r.shape)


class Drift(NamedTuple):
    """How far ``what`` seems to move the tool in the course of a ``file``: ``size``, rms over its rows, in m.

    ``scatter``: the standard deviation of what remains of one number without it, in m. ``gain``: by how much, in
    chi-squared, the rows fit better than with as many numbers of chance. ``chance``: of it.
    """

    what: str
    file: str
    size: float
    scatter: float
    gain: float
    chance: float


def drifts(parts: Sequence[Stretch], C: Array) -> tuple[Drift, ...]:
    """Return what seems to wander in order of the rows: base, tool, a joint, or the arm's lengths; the likeliest first.

    Up to the third order. None of sets whose rows are too few.
    """
    things = [*_things(parts), (LENGTHS, [part.by_growth[:, :, None] for part in parts])] if parts else []
    return tuple(sorted(_of_each(things, parts, C, _drift_of), key=lambda drift: (-drift.gain, drift.what)))


def _drift_of(what: str, part: Stretch, Z: Array, C: Array, things: int) -> Drift | None:
    n = len(part.r)
    if n < 4 * _LEAST_BLOCKS or part.data.position is None or not Z.any():
        return None
    t = np.linspace(-1.0, 1.0, n)
    shapes = np.stack([t, 1.5 * t**2 - 0.5, 2.5 * t**3 - 1.5 * t], axis=1)
    D = np.einsum("ndk,ns->ndks", Z, shapes).reshape(part.r.size, -1)
    score, shift = _score_of(D, part, C)
    rest = part.r + shift
    chance = min(1.0, things * _chance(score, rest, part))
    variance = _scatter(rest, part, int(score.numbers))
    size, scatter = np.sqrt((np.mean(np.sum(shift**2, axis=1)), variance)) / per_metre([part])
    gain = float(score.gain) / variance - int(score.numbers)
    return Drift(what, part.data.where, float(size), float(scatter), gain, chance)


class Rounding(NamedTuple):
    """What rounded readings of a ``file`` do: rms at the tool in m; ``share``: that over the rms of what remains."""

    file: str
    distance: float
    share: float


def rounding(parts: Sequence[Stretch], robot: Robot) -> tuple[Rounding, ...]:
    """Return what coarse steps of readings do, in every set that has them."""
    found = []
    for part in parts:
        data = part.data
        read = [data.reading_names.index(name) for name in part.joints]
        steps = resolutions(
            np.concatenate([end.readings[:, read] for end in data.ends]), [robot.readings[k] for k in read]
        )
        if not steps.any():
            continue
        # Either end of a pair is rounded by itself.
        square = float(np.sum((part.by_joint * steps) ** 2)) / 12.0 * len(data.ends)
        n, free = len(part.r), max(1.0 - part.used / part.r.size, 0.05)
        rest = max(float(np.sum(part.r**2)), part.least * part.r.size)
        found.append(
            Rounding(data.where, float(np.sqrt(square / n)) / per_metre([part]), float(np.sqrt(square * free / rest)))
        )
    return tuple(sorted(found, key=lambda one: (-one.distance, one.file)))


class Strain(NamedTuple):
    """How much longer one axis of an instrument seems to be than another: ``share``, 0 where nothing says so.

    ``size``: what it does to a row, over the standard deviation of what remains of one number. ``chance``: of it.
    """

    file: str
    share: float
    size: float
    chance: float


# Axes of unequal length, and those that are not at right angles. All of one length the links' lengths may be.
_STRAINS = np.array(
    [
        np.diag([1.0, -1.0, 0.0]),
        np.diag([-1.0, -1.0, 2.0]),
        [[0, 1.0, 0], [1.0, 0, 0], [0, 0, 0]],
        [[0, 0, 1.0], [0, 0, 0], [1.0, 0, 0]],
        [[0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]],
    ]
)


def strains(parts: Sequence[Stretch], C: Array) -> tuple[Strain, ...]:
    """Return how unequal the axes of the instrument seem to be in every set that has positions."""
    found = []
    for part in parts:
        rows = part.row.astype(np.intp)
        if part.data.position is None or len(rows) < 4 * _LEAST_ROWS:
            continue
        x = part.data.position[rows]
        moved = np.einsum("sij,nj->nis", _STRAINS, x - x.mean(axis=0))
        D = (part.by_base[:, :, :3] @ moved).reshape(part.r.size, -1)
        score, shift = _score_of(D, part, C, taken=_AXES_TAKEN)
        rest = part.r + shift
        variance = _scatter(rest, part)
        lengths = np.linalg.eigvalsh(np.einsum("sij,s->ij", _STRAINS, score.sizes))
        size = float(np.sqrt(float(score.gain) / variance / len(rows)))
        chance = min(1.0, len(parts) * _chance(score, rest, part))
        found.append(Strain(part.data.where, float(np.ptp(lengths)), size, chance))
    return tuple(sorted(found, key=lambda one: (-one.share, one.file)))


def per_metre(parts: Sequence[Stretch]) -> float:
    """Return by how much the whitened numbers of a row (rms of their norms) follow a metre by which base or tool move.

    Of the two that which shows more: where only the way from one pose to another is measured, the base shows nothing.
    """
    squares = [
        sum(float(np.sum(by[:, :, :3] ** 2)) / 3.0 for by in every)
        for every in ([part.by_base for part in parts], [part.by_tool for part in parts])
    ]
    return max(float(np.sqrt(max(squares) / sum(len(part.r) for part in parts))), 1e-12)


def _scatter(rest: Array, part: Stretch, taken: int = 0) -> float:
    """Return the variance of what remains (n, d), of which the parameters, and so many directions, take up some."""
    return max(float(np.sum(rest**2)) / max(rest.size - part.used - taken, 1.0), part.least)


def _chance(found: Score, rest: Array, part: Stretch, along: Array | None = None) -> float:
    """Return how probable a gain is, against what remains (n, d), of rows that remember each other: by F.

    Of what remains, parameters take up some numbers and the directions some more; 1 where they leave none. ``along``
    (n, d): what the effect does to rows that have it, where what remains is judged by what it is in that direction.
    """
    numbers = int(found.numbers)
    freedom = rest.size - part.used - numbers
    if numbers < 1 or freedom < 1.0:
        return 1.0
    variance, inflation = _scatter(rest, part, numbers), 1.0 + 2.0 * memory([rest])
    more = inflation if along is None else inflation * _more_along(rest, along, variance)
    return float(exceeded(float(found.gain) / variance / more, numbers, max(freedom / inflation, 1.0)))


class Asked(NamedTuple):
    """How surely rows ask for a change: ``sizes`` (k,) of its directions, and the ``chance`` of that much.

    ``follows`` (p,): by how much parameters follow such a change, in their scales; nothing of directions that they take
    up whole. ``left``: what it leaves of the squares of the rows, as a share.
    """

    sizes: Array
    follows: Array
    chance: float
    left: float


def asked(parts: Sequence[Stretch], directions: Sequence[Array], C: Array) -> Asked:
    """Return how surely rows ask for a change of their numbers along ``directions`` (n, d, k) of every part."""
    both = list(zip(parts, directions, strict=True))
    A = np.sum([np.tensordot(D, D, ((0, 1), (0, 1))) for _, D in both], axis=0)
    S = np.sum([np.tensordot(D, part.J, ((0, 1), (0, 1))) for part, D in both], axis=0)
    g = np.sum([np.einsum("ndk,nd->k", D, part.r) for part, D in both], axis=0)
    score = score_test(A, S, g, C)
    numbers, follows = int(score.numbers), -C @ (S.T @ score.sizes)
    along = [(D @ score.sizes).ravel()[:, None] for _, D in both]
    rest = np.concatenate(
        [
            part.r.ravel()[:, None] + D + (part.J @ follows).ravel()[:, None]
            for D, (part, _) in zip(along, both, strict=True)
        ]
    )
    freedom = rest.size - sum(part.used for part in parts) - numbers
    if numbers < 1 or freedom < 1.0:
        return Asked(score.sizes, follows, 1.0, 1.0)
    variance = max(float(np.sum(rest**2)) / freedom, *(part.least for part in parts))
    more = _more_along(rest, np.concatenate(along), variance)
    chance = float(exceeded(float(score.gain) / variance / more, numbers, freedom))
    return Asked(score.sizes, follows, chance, float(np.sum(rest**2)) / sum(float(np.sum(part.r**2)) for part in parts))


def _more_along(rest: Array, along: Array, variance: float) -> float:
    """Return how many times the variance of all numbers that of what remains is ``along`` a motion (n, d), at least 1.

    What a model leaves out of a joint turns that joint: it is all in one direction of a row, and largest in the rows
    that a turn moves most. Of the mean over three rows it makes far more than as much noise in all directions.
    """
    weights = float(np.sum(along**2)) * variance
    return max(float(np.sum(np.sum(along * rest, axis=1) ** 2)) / weights, 1.0) if weights > 0.0 else 1.0


def steps(parts: Sequence[Stretch], C: Array) -> tuple[Step, ...]:
    """Return the likeliest change of base, tool and every joint in the course of every set, the largest size first."""
    things = _things(parts) if parts else []
    return tuple(sorted(_of_each(things, parts, C, _step_of), key=lambda step: (-step.size, step.what)))


def _of_each(
    things: Sequence[tuple[str, list[Array]]],
    parts: Sequence[Stretch],
    C: Array,
    of: Callable[[str, Stretch, Array, Array, int], _Found | None],
) -> Iterator[_Found]:
    """Yield what is found ``of`` each thing in each part, by a fit that had sought its motions of all rows too.

    Of several parts, also those of the part alone: what differs from table to table is no change in the course of one.
    Each thing in each part is one that may be found by chance.
    """
    for what, motions in things:
        within, known = _besides(parts, motions, C)
        for part, Z in zip(within, motions, strict=True):
            (alone,), own = _besides([part], [Z], known) if len(parts) > 1 else ((part,), known)
            one = of(what, alone, Z, own, len(things) * len(parts))
            if one is not None:
                yield one


def _things(parts: Sequence[Stretch]) -> list[tuple[str, list[Array]]]:
    """Return what may move, with what its motions do to every part (n, d, k)."""
    return [
        ("base", [part.by_base for part in parts]),
        ("tool", [part.by_tool for part in parts]),
        *((name, [part.by_joint[:, :, j : j + 1] for part in parts]) for j, name in enumerate(parts[0].joints)),
    ]


def apart(parts: Sequence[Stretch], C: Array) -> tuple[Step, ...]:
    """Return which set would best have a base or a tool of its own, the largest size first; ``line`` is 0."""
    found: list[Step] = []
    for what in ("base", "tool") if len(parts) > 1 else ():
        motions = [part.by_base if what == "base" else part.by_tool for part in parts]
        within, own = _besides(parts, motions, C)
        found += [
            _apart(what, part, Z, np.arange(len(part.r)), within, own, 2 * len(parts))
            for part, Z in zip(within, motions, strict=True)
        ]
    return tuple(sorted(found, key=lambda step: (-step.size, step.what)))


def elsewhere(parts: Sequence[Stretch], C: Array) -> tuple[Step, ...]:
    """Return which target of which set would best be elsewhere, as by a motion of the base for its rows alone.

    What the fit has for a target it is, so this is about what was stated of targets. ``what`` is the target, ``line``
    is 0; the largest size first. Rows of one pose are one: what the model leaves at a pose is no other place. What an
    arm touches it touches in one place, where errors of the arm look like those of the place: such a target is told
    where in another place it leaves no more than the stated noise of the instrument.
    """
    poses = [as_means(part, part.pose) for part in parts]
    motions = [part.by_base for part in poses]
    within, own = _besides(poses, motions, C)
    rows_of = [
        (part, Z, part.data.targets[t], rows)
        for part, Z in zip(within, motions, strict=True)
        if part.data.kind in (*_FROM_ANYWHERE, *_TOUCHED)
        for t, rows in numbered(part.data.target[part.row.astype(np.intp)])
        if part.data.kind in _FROM_ANYWHERE or _explains(part, Z, rows, own)
    ]
    found = [_apart(name, part, Z, rows, within, own, len(rows_of)) for part, Z, name, rows in rows_of]
    return tuple(sorted(found, key=lambda step: (-step.size, step.what, step.file)))


def _explains(part: Stretch, Z: Array, rows: IntArray, C: Array) -> bool:
    """Return whether a motion Z (n, d, k) of ``rows`` leaves of a part what its instrument's noise leaves."""
    turned = part.by_tool[rows, :, :3]
    if np.sum(np.mean(turned, axis=0) ** 2) > _ALIKE * np.mean(np.sum(turned**2, axis=(1, 2))):
        return False
    moved = np.zeros_like(Z)
    moved[rows] = Z[rows]
    score, shift = _score_of(moved.reshape(part.r.size, -1), part, C)
    freedom = part.r.size - part.used - float(score.numbers)
    left = float(np.sum((part.r + shift) ** 2)) / max(part.instrument**2, part.least)
    return freedom >= 1.0 and float(exceeded(left, round(freedom))) > _EXPLAINED


def _apart(
    what: str, whole: Stretch, Z: Array, rows: IntArray, parts: Sequence[Stretch], C: Array, things: int
) -> Step:
    """Return how surely ``rows`` of a part ask for a motion Z (n, d, k) that the other rows do not have."""
    r, J = whole.r[rows], whole.J[rows]
    part = replace(whole, r=r, J=J, used=float(np.sum((J @ C) * J)))
    score, shift = _score_of(Z[rows].reshape(r.size, -1), part, C)
    # Judged by what remains in these rows: their noise may have been estimated with the change in it.
    rest = r + shift
    variance = _scatter(rest, part, int(score.numbers))
    n = len(rows)
    others = sum(len(one.r) for one in parts) - n
    size = float(np.sqrt(float(score.gain) / variance / (n * others / (n + others)))) if others else 0.0
    return Step(what, whole.data.where, 0, size, min(1.0, things * _chance(score, rest, part)))


def _summed(Z: Array, of: Array, places: IntArray) -> Array:
    """Return the sums (s, k, p) of ``Z^T of`` over the rows before each place, of Z (n, d, k) and ``of`` (n, d, p)."""
    runs = pairwise((0, *places.tolist()))
    return np.cumsum([np.tensordot(Z[a:b], of[a:b], ((0, 1), (0, 1))) for a, b in runs], axis=0)


def _step_of(what: str, part: Stretch, Z: Array, C: Array, things: int) -> Step | None:
    n, d = part.r.shape
    if n < 4 * _LEAST_ROWS:
        return None
    places = np.unique(np.linspace(_LEAST_ROWS, n - _LEAST_ROWS, _MOST_SPLITS).astype(np.intp))
    J = part.J.reshape(n * d, -1)
    S, g, A = (_summed(Z, of, places) for of in (part.J, part.r[:, :, None], Z))
    scores = score_test(A, S, g[:, :, 0], C)
    best = int(np.argmax(scores.gain))
    score, place = Score(*(of[best] for of in scores)), int(places[best])
    if score.gain <= 0.0:
        return None
    D = np.concatenate([Z[:place], np.zeros_like(Z[place:])]) @ score.sizes
    rest = part.r + D - (J @ (C @ (J.T @ D.ravel()))).reshape(n, d)
    size = float(np.sqrt(float(score.gain) / _scatter(rest, part) / (place * (n - place) / n)))
    # Of positions what comes little by little is a drift, which is judged as one. Of few rows it does not show:
    # parameters take up much of a change.
    smooth = part.data.position is not None and part.used < _LITTLE * part.r.size and memory([part.r]) > _SMOOTH
    if smooth and not _at_once(part.r, Z @ score.sizes, place, int(np.diff(places).max(initial=1))):
        return None
    chance = min(1.0, _chance(score, rest, part, Z @ score.sizes) * len(places) * things)
    # The rows were thinned, maybe: their numbers are those of the whole set.
    line = int(part.data.lines[int(part.row[place - 1])])
    return Step(what, part.data.where, line, size, chance, _parted(part, place), part.data.kind == "pixels")


def _at_once(r: Array, D: Array, place: int, unsure: int) -> bool:
    """Return whether rows r (n, d) change by D (n, d) from one row to the next near a place, not little by little.

    Along a smooth path, what gears do to the last rows is like a change, but comes in the course of many. ``unsure``:
    by how many rows the place may be off.
    """
    few = max(_FEW_ROWS, unsure // 2)
    along, of = (np.append(0.0, np.cumsum(np.sum(A * D, axis=1))) for A in (-r, D))
    middle = np.arange(max(place - unsure, few), min(place + unsure, len(r) - few) + 1)
    # Rows that nothing of it moves tell nothing.
    least = max(float(of[-1]), 1.0) * np.finfo(np.float64).eps
    before, after = (
        (along[middle + b] - along[middle + a]) / np.maximum(of[middle + b] - of[middle + a], least)
        for a, b in ((-few, 0), (0, few))
    )
    return bool(np.max(before - after, initial=0.0) > _AT_ONCE)


def _parted(part: Stretch, place: int) -> str:
    """Return the joint of which one reading parts the rows before a place from the others; empty where none does."""
    best, most = "", _PARTED
    for joint, values in zip(part.joints, part.values.T, strict=True):
        order = np.argsort(values, kind="stable")
        low = np.cumsum(order < place)[:-1] / place
        lower = np.cumsum(order >= place)[:-1] / (len(values) - place)
        shares = np.maximum(np.minimum(low, 1.0 - lower), np.minimum(1.0 - low, lower))
        # No reading lies between equal ones.
        share = float(np.max(shares, initial=0.0, where=np.diff(values[order]) > 0.0))
        if share >= most:
            best, most = joint, share
    return best
