"""What changes in the course of the rows, or from set to set: drifts, jumps, and targets that are elsewhere."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from calib.assessment.effects import LEAST_BLOCKS, besides, memory, per_metre
from calib.assessment.scores import Score, chance_of, score_of, score_test, variance_of
from calib.assessment.stretches import Stretch, as_means
from calib.foundations.arrays import Array, IntArray
from calib.foundations.chance import exceeded
from calib.measurement.measurements import numbered

# Rows that remember more than so many others are a smooth path; rows beside a place that show a change there, and what
# share of it; how much of all rows parameters take up at most then.
_SMOOTH, _FEW_ROWS, _AT_ONCE, _LITTLE = 1.0, 4, 0.75, 0.1
_MOST_SPLITS = 60
# Rows on either side of a jump; and which share of either is on its own side of one reading, where a joint parts them.
_LEAST_ROWS = 3
_PARTED = 0.9
# Kinds whose targets are measured from anywhere, and those that an arm touches.
_FROM_ANYWHERE, _TOUCHED = ("distance", "indicator"), ("socket", "plane", "sphere")
# The instrument's noise explains what remains where it leaves as much more often than this.
_EXPLAINED = 1e-3
# Rows at one place touch it in orientations that are too alike where their mean axes are longer than this, squared.
_ALIKE = 0.3
# What drifts where an arm warms up.
LENGTHS = "length of the arm"
_Found = TypeVar("_Found")


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
    if n < 4 * LEAST_BLOCKS or part.data.position is None or not Z.any():
        return None
    t = np.linspace(-1.0, 1.0, n)
    shapes = np.stack([t, 1.5 * t**2 - 0.5, 2.5 * t**3 - 1.5 * t], axis=1)
    D = np.einsum("ndk,ns->ndks", Z, shapes).reshape(part.r.size, -1)
    score, shift = score_of(D, part, C)
    rest = part.r + shift
    chance = min(1.0, things * chance_of(score, rest, part))
    variance = variance_of(rest, part, int(score.numbers))
    size, scatter = np.sqrt((np.mean(np.sum(shift**2, axis=1)), variance)) / per_metre([part])
    gain = float(score.gain) / variance - int(score.numbers)
    return Drift(what, part.data.where, float(size), float(scatter), gain, chance)


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
        within, known = besides(parts, motions, C)
        for whole, Z in zip(within, motions, strict=True):
            part, C_own = _by_what_it_follows(whole, known)
            (alone,), own = besides([part], [Z], C_own) if len(parts) > 1 else ((part,), C_own)
            one = of(what, alone, Z, own, len(things) * len(parts))
            if one is not None:
                yield one


def _by_what_it_follows(part: Stretch, C: Array) -> tuple[Stretch, Array]:
    """Return a part by those parameters alone that its rows follow, and their covariance: by no bases of others."""
    seen = np.any(part.J, axis=(0, 1))
    if seen.all():
        return part, C
    columns = part.columns[seen[: len(part.columns)]]
    return replace(part, J=part.J[:, :, seen], columns=columns), C[np.ix_(seen, seen)]


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
        within, own = besides(parts, motions, C)
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
    within, own = besides(poses, motions, C)
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
    score, shift = score_of(moved.reshape(part.r.size, -1), part, C)
    freedom = part.r.size - part.used - float(score.numbers)
    left = float(np.sum((part.r + shift) ** 2)) / max(part.instrument**2, part.least)
    return freedom >= 1.0 and float(exceeded(left, round(freedom))) > _EXPLAINED


def _apart(
    what: str, whole: Stretch, Z: Array, rows: IntArray, parts: Sequence[Stretch], C: Array, things: int
) -> Step:
    """Return how surely ``rows`` of a part ask for a motion Z (n, d, k) that the other rows do not have."""
    r = whole.r[rows]
    part, C = _by_what_it_follows(replace(whole, r=r, J=whole.J[rows]), C)
    part = replace(part, used=float(np.sum((part.J @ C) * part.J)))
    score, shift = score_of(Z[rows].reshape(r.size, -1), part, C)
    # Judged by what remains in these rows: their noise may have been estimated with the change in it.
    rest = r + shift
    variance = variance_of(rest, part, int(score.numbers))
    n = len(rows)
    others = sum(len(one.r) for one in parts) - n
    size = float(np.sqrt(float(score.gain) / variance / (n * others / (n + others)))) if others else 0.0
    return Step(what, whole.data.where, 0, size, min(1.0, things * chance_of(score, rest, part)))


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
    size = float(np.sqrt(float(score.gain) / variance_of(rest, part) / (place * (n - place) / n)))
    # Of positions what comes little by little is a drift, which is judged as one. Of few rows it does not show:
    # parameters take up much of a change.
    smooth = part.data.position is not None and part.used < _LITTLE * part.r.size and memory([part.r]) > _SMOOTH
    if smooth and not _at_once(part.r, Z @ score.sizes, place, int(np.diff(places).max(initial=1))):
        return None
    chance = min(1.0, chance_of(score, rest, part, Z @ score.sizes) * len(places) * things)
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
