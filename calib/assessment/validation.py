"""How good is a model at poses that it never saw? Grouped cross-validation and the one-standard-error rule.

Rows that belong together - a pose that was visited twice, or one word in the column ``group`` - never stand on both
sides: a model that learnt one of them by heart would be praised for the other. The folds depend on what the rows say
and not on their order. Poses held out one by one tell how good a model is among those that were measured; whole
neighbourhoods in joint space (D. R. Roberts and others, *Ecography* 40, 2017: blocks), how good it is away from them.

The rule (Breiman, Friedman, Olshen, Stone, *Classification and regression trees*, 1984, 3.4.3): of models of growing
size take the smallest whose held-out error is within one standard error of the least.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, BoolArray, IntArray, number_in_kind, read_only_view
from calib.foundations.brief import brief
from calib.foundations.choices import FOLDS
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.sealing import sealed
from calib.foundations.words import refuse_other
from calib.identification.error_model import ErrorModel
from calib.identification.fit import Fit
from calib.identification.identify import identify, identify_near, residuals_of
from calib.identification.losses import Loss, refuse_losses
from calib.identification.machine import POSE
from calib.identification.weights import refuse_number_of_sigmas
from calib.measurement.kinds import QUANTITIES, Kind
from calib.measurement.measurements import Measurements, as_sets
from calib.measurement.poses import ONE_POSE, both_ends

# Stretches of a stream, in s, and farther than any pose in units of one.
_STRETCH, _FAR = 5.0, 1e9
# A stretch ends so many seconds before the middle of the stream and what is whole stretches from it. Rows of an even
# rate stand right there, and the rounding of their times would tell on which side.
_NO_ROW = 3e-5


# Neighbourhoods with wider gaps between them than this many times the usual distance of a pose to the next lie apart.
_APART = 3.0
# Of k-means, after which little moves.
_ROUNDS = 20
# By so many standard errors a model must be better where whole neighbourhoods are held out.
_SURELY = 2.0
# By a tenth it must be better where neighbourhoods have nothing between them.
_BY = 0.9
# By what share of the 95 % quantile the largest error may grow.
_LARGEST = 0.5
# Poses between places.
_BETWEEN = 200
# Of fewer places that lie apart, each would be judged by too little else.
_FEWEST_PLACES = 3


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Root mean square of errors at rows that were held out, and its standard error over groups.

    ``p95``: what 95 % of the errors are below; ``largest`` of them.
    """

    rms: float
    standard_error: float
    p95: float = math.nan
    largest: float = math.nan


def row_groups(measurements: Sequence[Measurements], *, places: bool = False, known: Collection[str] = ()) -> IntArray:
    """Return the group (N,) of every row of all sets, from 0; rows of one pose or of one ``group`` have one number.

    With ``places`` rows that touch one socket have one number as well: the tool was in one place. Not so where a tool
    that touches it touches no other: without these rows nothing would be known of the tool; nor if the place of the
    socket is ``known``, so that its rows are measured positions, and may be what shows where the base is. Rows of a
    stream go together in stretches of 5 s, longer than noise remembers. Numbered by the poses in them, so that neither
    the order of the rows nor that of the sets matters.
    """
    poses = np.concatenate([_poses(data, k) for k, data in enumerate(measurements)])
    cells, cell = np.unique(poses, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    near = scipy.spatial.cKDTree(cells).query_pairs(1.0, p=np.inf, output_type="ndarray")
    first: dict[tuple[str, str], int] = {}
    said = [
        (first.setdefault((what, word), int(c)), int(c))
        for what, words in (("group", _words(measurements)), ("place", _places(measurements, known) if places else ()))
        for word, c in zip(words, cell, strict=bool(words))
        if word is not None
    ]
    pairs = np.concatenate([near, np.array(said, dtype=np.intp).reshape(-1, 2)])
    links = scipy.sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    _, component = scipy.sparse.csgraph.connected_components(links, directed=False)
    # Cells are sorted, and a component is numbered by its first one.
    _, order = np.unique(component, return_index=True)
    rank = np.empty(len(order), dtype=np.intp)
    rank[np.argsort(order)] = np.arange(len(order))
    return np.asarray(rank[component][cell], dtype=np.intp)


@checked
def hold_out(
    data: Measurements,
    share: float = 0.25,
    *,
    places: Collection[str] | None = None,
    keep: Collection[str] = (),
    known: Collection[str] = (),
) -> tuple[Measurements, Measurements]:
    """Return the rows to identify from, and the held-out rows, which judge the fit.

        some, rest = calib.hold_out(data)                  # a quarter at random, the same ones every time
        some, rest = calib.hold_out(data, places=["left"])  # all that was touched or grouped there

    ``share``: how many of the groups to hold out; rows of one pose, one socket or one ``group`` stay together, and of
    several tools or set-ups none is left with fewer measured numbers than a pose has. Nor is a target that is named in
    ``keep``, as those of relations are: a known length between two sockets says nothing once one of them is held out.
    Rows of sockets in ``known`` places are as good as positions, and do not stay together: without three of these
    nothing may show where the base is.
    ``places``: instead of a share, names of sockets and other targets, or words of the column ``group``. Neither part
    has targets without rows. Raises MeasurementError when a place is not known, or when one part would have no rows;
    JobError for a share that is not between 0 and 1.
    """
    if not 0.0 < share < 1.0:
        raise JobError(f"share: {share!r} is not between 0 and 1.")
    if places is None:
        group = row_groups([data], places=True, known=known)
        number = int(group.max(initial=0)) + 1
        if number < 2:
            raise MeasurementError(f"{data.where}: the rows are of one pose or one group, and none can be held out.")
        out = _at_random(data, group, min(max(round(share * number), 1), number - 1), keep)
        if not out.any():
            raise MeasurementError(
                f"{data.where}: no rows can be held out, as too few of their tools and set-ups, or of targets "
                "to keep, would be left; name places, or measure more with each."
            )
    else:
        words = [{data.targets[t]} if t >= 0 else set() for t in data.target]
        if data.group is not None:
            words = [own | {word} for own, word in zip(words, data.group, strict=True)]
        known = set().union(*words)
        if unknown := [place for place in places if place not in known]:
            there = ", ".join(map(repr, sorted(known))) or "none"
            raise MeasurementError(f"{data.where}: there is no target or group {unknown[0]!r}; there are {there}.")
        out = np.array([not own.isdisjoint(places) for own in words])
        if out.all() or not out.any():
            raise MeasurementError(f"{data.where}: {'all' if out.all() else 'no'} rows are of {', '.join(places)}.")
    return data.subset(~out).with_own_names(), data.subset(out).with_own_names()


def _at_random(data: Measurements, group: IntArray, many: int, keep: Collection[str]) -> BoolArray:
    """Return the rows (N,) of ``many`` groups at random, or of fewer: none that a tool or a set-up needs.

    One of several tools or set-ups needs as many measured numbers as a pose has, and so does a target to ``keep``.
    """
    each = data.sigma.shape[1]
    order = np.random.default_rng(0).permutation(int(group.max()) + 1)
    parts = [own for own in _setups_and_tools(data) if np.unique(own).size > 1]
    kept = np.array([t if t >= 0 and data.targets[t] in keep else -1 for t in data.target], dtype=np.intp)
    if np.any(kept >= 0):
        parts.append(kept)
    if not parts:
        return np.isin(group, order[:many])
    # How many numbers each group has of each tool, set-up and target.
    counted = [
        scipy.sparse.coo_array(
            (np.full(np.count_nonzero(own >= 0), each), (group[own >= 0], own[own >= 0])),
            shape=(len(order), int(own.max()) + 1),
        )
        for own in parts
    ]
    counts = scipy.sparse.hstack(counted, format="csr")
    left = np.asarray(counts.sum(axis=0))
    chosen: list[int] = []
    for k in order:
        own = slice(*counts.indptr[k : k + 2])
        of, lost = counts.indices[own], counts.data[own]
        if len(chosen) < many and (left[of] - lost >= len(POSE)).all():
            left[of] -= lost
            chosen.append(int(k))
    return np.isin(group, chosen)


def _setups_and_tools(data: Measurements) -> tuple[IntArray, ...]:
    """Return the numbers (N,) of the set-up of every row, and of the tool of each of its ends; -1 for none."""
    return data.setup, *(end.tool for end in data.ends)


def _words(measurements: Sequence[Measurements]) -> list[str | None]:
    return [word for data in measurements for word in (data.group or [None] * len(data))]


def _places(measurements: Sequence[Measurements], known: Collection[str]) -> list[str | None]:
    """Return the socket of every row of all sets, None where a row is of none, a known one, or its tool's only one."""
    rows = [
        (data.tools[tool], data.targets[target]) if data.kind == "socket" else (None, None)
        for data in measurements
        for tool, target in zip(data.tool, data.target, strict=True)
    ]
    sockets = {tool: {place for other, place in set(rows) if other == tool} for tool, _ in set(rows)}
    alone = {*known, *(next(iter(places)) for places in sockets.values() if len(places) == 1)}
    return [None if place in alone else place for _, place in rows]


def _poses(data: Measurements, number: int) -> Array:
    """Return the readings (N, 2 k) at both ends of every row, where it has one that twice, in units of one pose.

    Of a stream its stretches, far from all poses and from those of another ``number``.
    """
    both = np.round(both_ends(data) / ONE_POSE)
    if data.stream is not None:
        both[:, 1:] = _FAR * (1.0 + number)
        both[:, 0] = 2.0 * np.floor((data.stream.since + _NO_ROW) / _STRETCH)
    return np.asarray(both)


def folds(group: IntArray, count: int = FOLDS) -> IntArray:
    """Return the fold (N,) of every row, from 0, given its group (N,): a group is in one fold, spread at random.

    The same groups are spread alike every time. Raises MeasurementError when there are fewer than two groups, JobError
    when fewer than two folds are asked for.
    """
    if count < 2:
        raise JobError(f"folds: {count} is not a number from 2.")
    number = int(group.max()) + 1 if len(group) else 0
    if number < 2:
        raise MeasurementError("the rows are of one pose or one group, and none can be held out to judge by.")
    fold = np.empty(number, dtype=np.intp)
    fold[np.random.default_rng(0).permutation(number)] = np.arange(number) % min(count, number)
    return np.asarray(fold[group], dtype=np.intp)


def parts_apart(fold: IntArray, group: IntArray, measurements: Sequence[Measurements]) -> IntArray:
    """Return the folds (N,) of rows so that of each table no tool and no set-up is in one fold alone, by chance.

    Where it has several groups, the first goes on to the next fold: a fit without all its rows would not know it.
    """
    found, number = np.array(fold), int(fold.max()) + 1
    ends = np.cumsum([len(data) for data in measurements])
    for data, rows in zip(measurements, np.split(np.arange(len(fold)), ends[:-1]), strict=True):
        for part in _setups_and_tools(data):
            for own in (rows[part == name] for name in np.unique(part[part >= 0])):
                if group[own].min() < group[own].max() and found[own].min() == found[own].max():
                    found[group == group[own].min()] = (found[own[0]] + 1) % number
    return found


class Neighbourhoods(NamedTuple):
    """In which neighbourhood of joint space every row (N,) is, from 0, and whether nothing lies between these."""

    number: IntArray
    apart: bool


def neighbourhoods(
    measurements: Sequence[Measurements], group: IntArray, count: int = FOLDS, turning: Sequence[bool] = ()
) -> Neighbourhoods:
    """Return the neighbourhoods of rows, given their groups (N,): at most ``count``.

    Groups whose poses are near to each other are in one (k-means). Where poses lie in three places or more with nothing
    between them, such as small cubes, no place is divided: its halves have much the same errors.
    """
    readings = np.concatenate([both_ends(data) for data in measurements])
    cells = ONE_POSE * np.round(readings / ONE_POSE)
    sizes = np.bincount(group)
    centres = np.column_stack([np.bincount(group, weights=column) for column in cells.T]) / sizes[:, None]
    # Sums of rows in another order differ by rounding, and no draw must depend on that.
    centres = 1e-9 * np.round(centres / 1e-9)
    if len(centres) <= count:
        return Neighbourhoods(group, apart=False)
    part = _parts(centres, count)
    around = _around(centres, turning)
    usual = np.median(np.asarray(scipy.spatial.cKDTree(around).query(around, k=2)[0])[:, 1])
    trees = [scipy.spatial.cKDTree(around[part == k]) for k in range(part.max() + 1)]
    touching = [[np.min(a.query(b.data)[0]) <= _APART * usual for a in trees] for b in trees]
    places, place = scipy.sparse.csgraph.connected_components(np.array(touching), directed=False)
    apart = bool(places >= _FEWEST_PLACES)
    return Neighbourhoods(np.asarray((place[part] if apart else part)[group], dtype=np.intp), apart)


def poses_between(measurements: Sequence[Measurements], chosen: BoolArray, place: IntArray) -> Array:
    """Return random readings (n, nr) of poses, each somewhere on the way from a row to one of another place.

    ``chosen`` (N,): which rows of all sets are looked at, and ``place`` of these, from 0, two places at least. The
    same ones every time, whatever the order of the rows. Loops may not close there.
    """
    ends = np.concatenate([both_ends(data) for data in measurements])[chosen]
    order = np.lexsort((*ends.T, place))
    ends, place = ends[order], place[order]
    rng = np.random.default_rng(0)
    a = rng.integers(len(ends), size=_BETWEEN)
    # Rows of one place stand together, so that all others follow its last one, the first after the last again.
    sizes, last = np.bincount(place), np.cumsum(np.bincount(place))
    b = (last[place[a]] + rng.integers(len(ends) - sizes[place[a]])) % len(ends)
    share = rng.uniform(size=(_BETWEEN, 1))
    # Of rows with two ends both are poses; others have the one end twice.
    return np.asarray((share * ends[a] + (1.0 - share) * ends[b]).reshape(2 * _BETWEEN, -1))


def _around(points: Array, turning: Sequence[bool]) -> Array:
    """Return points (n, m) in the place of readings at both ends (n, 2 k), those of turning joints on a circle."""
    turns = np.tile(np.array(turning, dtype=np.bool_), 2) if turning else np.zeros(points.shape[1], dtype=np.bool_)
    return np.hstack([points[:, ~turns], np.cos(points[:, turns]), np.sin(points[:, turns])])


def _parts(points: Array, count: int) -> IntArray:
    """Return in which of ``count`` parts, or fewer, points (n, k) are: k-means, begun at points far from each other.

    (D. Arthur, S. Vassilvitskii, *k-means++*, 2007.)
    """
    rng, centres = np.random.default_rng(0), points[:1]
    while len(centres) < count:
        far = np.asarray(scipy.spatial.cKDTree(centres).query(points)[0]) ** 2
        if not far.any():
            break
        centres = np.concatenate([centres, points[rng.choice(len(points), 1, p=far / far.sum())]])
    part = np.zeros(len(points), dtype=np.intp)
    for _ in range(_ROUNDS):
        part = np.unique(scipy.spatial.cKDTree(centres).query(points)[1], return_inverse=True)[1]
        sizes = np.bincount(part)
        centres = np.column_stack([np.bincount(part, weights=column) for column in points.T]) / sizes[:, None]
    return np.asarray(part, dtype=np.intp)


def some_rows(measurements: Sequence[Measurements], group: IntArray, rows: int) -> BoolArray:
    """Return which rows (N,) of very many are looked at, given their groups (N,): ``rows`` at random, or all.

    Of every group as many as of the others, where it has them: poses tell more than visits of a pose. Which they are
    does not depend on the order of the rows.
    """
    seen = [
        data.value.sum(axis=1) + (0.0 if data.position is None else data.position.sum(axis=1)) for data in measurements
    ]
    readings = np.concatenate([both_ends(data) for data in measurements])
    drawn = np.lexsort((np.concatenate(seen), *readings.T))[np.random.default_rng(0).permutation(len(group))]
    chosen = np.zeros(len(group), dtype=np.bool_)
    chosen[drawn[np.argsort(number_in_kind(group[drawn]), kind="stable")[:rows]]] = True
    return chosen


def held_out(squares: Array, group: IntArray) -> HeldOut:
    """Return the figure of N squared errors of rows held out, which are random from group (N,) to group.

    The standard error is that of a ratio of sums over groups, carried over to the root.
    """
    n = np.bincount(group)
    mean = float(np.mean(squares))
    spread = np.bincount(group, weights=squares) - n * mean
    there = np.count_nonzero(n)
    of_mean = float(np.sqrt(np.sum(spread**2) * there / max(there - 1, 1))) / len(squares)
    rms = float(np.sqrt(mean))
    p95, largest = np.sqrt(np.quantile(squares, (0.95, 1.0)))
    return HeldOut(rms, 0.5 * of_mean / rms if rms else 0.0, float(p95), float(largest))


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class CrossValidation:
    """Made by :func:`cross_validate`. ``residuals`` (N, d) of every set: of each row by a fit without its fold.

    ``kinds``: of every set; ``group`` (all rows): as in :func:`row_groups`.
    """

    __repr__ = brief

    kinds: tuple[Kind, ...]
    residuals: tuple[Array, ...]
    group: IntArray

    @checked
    def figure(self, quantity: str = "position") -> HeldOut:
        """Return the figure of a quantity, in its unit. Raises JobError for one that no set has."""
        refuse_other(quantity, {q.name: None for kind in self.kinds for q in QUANTITIES[kind]}, "quantity")
        squares: list[Array] = []
        group: list[IntArray] = []
        own = np.split(self.group, np.cumsum([len(r) for r in self.residuals])[:-1])
        for kind, r, g in zip(self.kinds, self.residuals, own, strict=True):
            for name, _, columns in QUANTITIES[kind]:
                if name == quantity:
                    squares.append(np.sum(r[:, columns] ** 2, axis=1))
                    group.append(g)
        return held_out(np.concatenate(squares), np.concatenate(group))


@checked
def cross_validate(
    model: ErrorModel,
    measurements: Measurements | Sequence[Measurements],
    *,
    count: int = FOLDS,
    model_sigmas: Sequence[float | None] | None = None,
    losses: Sequence[Loss] | None = None,
) -> CrossValidation:
    """Identify as often as there are folds, each time without the rows of one, and predict these.

    Options as in :func:`calib.identify`. Raises what it raises, and MeasurementError when all rows are of one group.
    """
    sets = as_sets(measurements)
    group = row_groups(sets)
    rows = ChosenRows(sets, model_sigmas, losses)
    fold = parts_apart(folds(group, count), group, sets)
    return predict_held_out(lambda own: own.fit(model), model, rows, group, fold)


@dataclass(frozen=True, slots=True, eq=False)
class ChosenRows:
    """Sets to identify from, with ``model_sigmas`` and ``losses`` as :func:`calib.identify` takes them.

    ``which``: of the sets that they were chosen from, the numbers of those that have rows.
    """

    sets: tuple[Measurements, ...]
    model_sigmas: Sequence[float | None] | None
    losses: Sequence[Loss] | None
    which: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        refuse_losses(self.losses, len(self.sets))
        if self.model_sigmas is not None:  # of too many, each part would take those that its place gives it
            refuse_number_of_sigmas(self.model_sigmas, sum(len(QUANTITIES[data.kind]) for data in self.sets))

    def some(self, chosen: Sequence[BoolArray]) -> "ChosenRows":
        """Return the rows chosen by a mask (N,) of every set.

        Tools and targets without rows are not among their names, so that nothing is known of them.
        """
        which = tuple(i for i, mask in enumerate(chosen) if mask.any())
        ends = np.cumsum([0, *(len(QUANTITIES[data.kind]) for data in self.sets)])
        sigmas, losses = self.model_sigmas, self.losses
        return ChosenRows(
            tuple(self.sets[i].subset(chosen[i]).with_own_names() for i in which),
            None if sigmas is None else [sigma for i in which for sigma in sigmas[ends[i] : ends[i + 1]]],
            None if losses is None else [losses[i] for i in which],
            which,
        )

    def some_of_all(self, chosen: BoolArray) -> "ChosenRows":
        """Return the rows chosen by a mask (N,) of the rows of all sets, as :meth:`some` does."""
        return self.some(np.split(chosen, np.cumsum([len(data) for data in self.sets])[:-1]))

    def fit(self, model: ErrorModel, near: Fit | None = None) -> Fit:
        """Identify a model from them; ``near``: a fit to more rows of that machine, to begin at."""
        find = identify if near is None else partial(identify_near, near)
        return find(model.within(self.sets), self.sets, model_sigmas=self.model_sigmas, losses=self.losses)


def predict_held_out(
    find: Callable[[ChosenRows], Fit], model: ErrorModel, rows: ChosenRows, group: IntArray, fold: IntArray
) -> CrossValidation:
    """Predict the rows of every fold by a fit to all others, which ``find`` makes; ``group``, ``fold``: (N,) of rows.

    What ``model`` knows of targets holds for rows held out; other targets that a fit does not know are found from
    these. Raises what ``find`` raises, and MeasurementError when a tool or a set-up is in no other fold.
    """
    own = np.split(fold, np.cumsum([len(data) for data in rows.sets])[:-1])
    found = tuple(np.empty_like(data.sigma) for data in rows.sets)
    for k in range(int(fold.max()) + 1):
        fit = find(rows.some([f != k for f in own]))
        fit = replace(fit, model=replace(fit.model, targets=model.targets, setups=model.setups))
        left_out = rows.some([f == k for f in own])
        for data in left_out.sets:
            if not fit.knows(data):
                known = (*fit.measurements[0].tools, *fit.measurements[0].setups)
                alien = [name for name in (*data.tools, *data.setups) if name not in known]
                raise MeasurementError(
                    f"{data.where}: {alien[0]!r} has rows in one fold alone, and is unknown without the rows that are "
                    "to judge; leave them out, or measure it in more poses."
                )
        for r, i in zip(residuals_of(fit, left_out.sets, fit.machine), left_out.which, strict=True):
            found[i][own[i] == k] = r
    return CrossValidation(tuple(data.kind for data in rows.sets), tuple(map(read_only_view, found)), group)


def unharmed(figures: Sequence[HeldOut]) -> tuple[int, ...]:
    """Return which of models of growing size are nowhere worse than the first, by which they are judged.

    A model with a larger rms or 95 % quantile is not among them, nor one whose largest error is larger by half of that
    quantile: a row that lies off has on top what a model changes. The first is always among them: it may foretell
    nothing, with errors without end, and then no other is judged.
    """
    first = figures[0]
    limit = first.largest + _LARGEST * first.p95
    return tuple(
        k
        for k, figure in enumerate(figures)
        if k == 0 or (figure.p95 <= first.p95 and figure.largest <= limit and figure.rms <= first.rms)
    )


def smallest_unharmed(figures: Sequence[HeldOut]) -> int:
    """Return which of models of growing size, that harm nowhere, the one-standard-error rule takes."""
    sound = unharmed(figures)
    return sound[one_standard_error([figures[k] for k in sound])]


def largest_unharmed(figures: Sequence[HeldOut], *, apart: bool) -> int:
    """Return the largest of models, that harm nowhere, whose error is within one standard error of the least.

    The first, unless its error is two standard errors above the least: of few neighbourhoods chance says as much. Of
    neighbourhoods with nothing between them, ``apart``, the smallest instead, and the first unless the least is smaller
    by a tenth: what holds in a few places may still be wrong in others.
    """
    sound = unharmed(figures)
    if sound == (0,):
        return 0
    least = min((figures[k] for k in sound), key=lambda figure: figure.rms)
    if figures[0].rms <= least.rms + _SURELY * least.standard_error or (apart and least.rms > _BY * figures[0].rms):
        return 0
    return (min if apart else max)(k for k in sound if figures[k].rms <= least.rms + least.standard_error)


def surely_less(squares: Array, than: Array, group: IntArray) -> bool:
    """Return whether the mean of N squared errors is less than that of others of the same rows by two standard errors.

    The standard error is over groups (N,), of the difference: rows that lie off do so in both.
    """
    difference = than - squares
    n, mean = np.bincount(group), float(np.mean(difference))
    spread = np.bincount(group, weights=difference) - n * mean
    there = np.count_nonzero(n)
    of_mean = float(np.sqrt(np.sum(spread**2) * there / max(there - 1, 1))) / len(squares)
    return mean > _SURELY * of_mean


def one_standard_error(figures: Sequence[HeldOut]) -> int:
    """Return which of models of growing size the one-standard-error rule takes."""
    best = min(figures, key=lambda figure: figure.rms)
    # The best may foretell nothing, with errors without end.
    return next(k for k, figure in enumerate(figures) if figure is best or figure.rms <= best.rms + best.standard_error)
