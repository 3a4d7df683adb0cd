"""From where the readings of an arm count, and which way, where the URDF says otherwise: sought in all joints at once.

A home-made arm, an encoder that was never set, a maker whose zero is an arm stretched out: its readings differ from the
joint positions of the URDF by an angle and a sign for every joint, and one after the other none of them helps. They
are sought together, over all signs and a grid of angles; what is best is then made finer.

An arm whose readings each move one joint after the other is a product of turns about axes fixed in space (Brockett
1984): the first half of them times the second half gives all combinations. Base and tool are free, and for a
combination that is a linear fit (:func:`calib.identification.sanity.signatures` has the equation), of which only four
columns change: hundreds of thousands take a second.

What base or tool absorbs is not sought: the zeros of the first and the last joint. They are chosen by the limits.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, IntArray, evenly_spread
from calib.foundations.errors import PoseError
from calib.foundations.rigid import inverse, rotation_about
from calib.foundations.sealing import sealed
from calib.foundations.units import DEG
from calib.foundations.words import shown
from calib.measurement.measurements import Measurements
from calib.robot.robot import Reading, Robot
from calib.robot.urdf_writer import CountedZeros

# Distances between the angles that are tried, the finest that gives no more than so many combinations; an arm of more
# joints is not searched.
_STEPS, _MOST_COMBINATIONS = (45.0 * DEG, 60.0 * DEG, 90.0 * DEG), 1_100_000
# Rows that are looked at, at first, at most and at least: a linear fit has 15 unknowns, of three numbers a row.
_FEW_ROWS, _MOST_ROWS, _FEWEST_ROWS = 12, 24, 10
# Combinations that few rows leave, that are made finer, and how many of these stay, until a step is as small as this.
_PROMISING, _KEPT, _LEFT, _FINE = 3000, 30, 6, 0.5 * DEG
_FOUND = 3
# Joints that are moved at a time: zeros of parallel joints go together.
_AT_A_TIME = 2
# Combinations computed at once: 20 MB.
_AT_ONCE = 8000
# What leaves up to so many times as much is taken to be alike; combinations that are given, at most.
_AS_WELL, _MOST = 1.1, 16
# Share of a volume by which A is a mirror; of positions in a plane it is none.
_MIRRORED = 1e-3
# An angle this near to a quarter turn, in deg, is one, and so are all where none is further off: the rest is an
# ordinary joint offset.
_NEAR, _ORDINARY = 3.0, 8.0
_QUARTER = 90.0
_QUARTERS = (0.0, _QUARTER * DEG, -_QUARTER * DEG, 2.0 * _QUARTER * DEG)
# What tells axes and arms from rounding.
_NEGLIGIBLE = 1e-9
_TRUE_TO = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Zeros:
    """How readings count: the joint of reading k stands at ``signs[k] * reading + offsets[k]``.

    ``signs`` (nr,) are 1 and -1, ``offsets`` (nr,) in rad or m.
    """

    signs: Array
    offsets: Array

    @property
    def changed(self) -> int:
        """How many signs and offsets are not those of the URDF."""
        return int(np.count_nonzero(self.signs < 0.0) + np.count_nonzero(self.offsets))

    def by_name(self, readings: Sequence[Reading]) -> CountedZeros:
        """Return sign and offset of the readings that count otherwise, by their names."""
        each = zip(readings, self.signs.tolist(), self.offsets.tolist(), strict=True)
        return {reading.name: (sign, offset) for reading, sign, offset in each if sign < 0.0 or offset}


def told(counted: CountedZeros) -> str:
    """Return in words where joints stand that count otherwise: sign and offset by name, of :meth:`Zeros.by_name`."""
    said = []
    for name, (sign, offset) in counted.items():
        moved = f" {'-' if offset < 0.0 else '+'} {abs(offset) / DEG:.0f} deg" if offset else ""
        said.append(f"{shown(name)} stands at {'-' if sign < 0.0 else ''}reading{moved}")
    return ", ".join(said)


def other_zeros(robot: Robot, sets: Sequence[Measurements], *, at_base: bool, at_tool: bool) -> tuple[Zeros, ...]:
    """Return the zeros and signs by which an arm follows positions best, the simplest of those that do so alike first.

    ``at_base`` and ``at_tool``: whether base and tool absorb the zeros of the outer joints; else quarter turns of these
    are given as well. Empty where rows are too few, the arm has more than eight joints, or a reading moves several.
    Nothing says that the arm follows well.
    """
    data = max(sets, key=len)
    of_one = data.tool + len(data.tools) * data.setup
    mine = np.flatnonzero(of_one == np.bincount(of_one).argmax())
    assert data.position is not None, "zeros are sought in positions"
    rows = mine[evenly_spread(len(mine), _MOST_ROWS)]
    if len(rows) < _FEWEST_ROWS:
        return ()
    axes = _axes(robot)
    if axes is None:
        return ()
    search = _Search(axes, data.readings[rows], data.position[rows])
    steps = [step for step in _STEPS if search.combinations(step) <= _MOST_COMBINATIONS]
    if not steps or len(search.joints) < 2:
        return ()
    few = rows[evenly_spread(len(rows), _FEW_ROWS)]
    coarse = _Search(axes, data.readings[few], data.position[few])
    # Quarter turns are the likeliest of all, and a grid of thirds has none of them.
    near = _joined([coarse.grid(step) for step in dict.fromkeys((steps[0], steps[-1]))])
    found = _simplest(coarse.alike(search.refined(near, steps[0])))
    ends = [(k, free) for k, free in ((search.joints[0], at_base), (search.joints[-1], at_tool)) if axes.turning[k]]
    known, absorbed = ([k for k, free in ends if free is which] for which in (False, True))
    each = [
        _in_limits(robot.readings, data.readings, zeros, dict(zip(known, turns, strict=True)), absorbed)
        for zeros in found
        for turns in product(_QUARTERS, repeat=len(known))
    ]
    # Of those that positions do not tell apart, limits tell which ones the arm can have.
    return tuple(zeros for zeros, _ in sorted(each, key=itemgetter(1)))


def _in_limits(
    readings: Sequence[Reading], rows: Array, zeros: Zeros, turned: Mapping[int, float], absorbed: Sequence[int]
) -> tuple[Zeros, int]:
    """Return zeros with those of some joints set, and how many numbers of ``rows`` are beyond limits then.

    A whole turn is added where fewer are, and to the zeros that base or tool absorb what brings all within.
    """
    offsets, beyond = zeros.offsets.copy(), 0
    offsets[list(turned)] = list(turned.values())
    for k, reading in enumerate(readings):
        if reading.lower is None or reading.upper is None:
            continue
        stands = zeros.signs[k] * rows[:, k, None]
        ways = offsets[k] + 2.0 * np.pi * np.array([0.0, -1.0, 1.0] if offsets[k] else [0.0])
        if k in absorbed:
            middle = (reading.lower - stands.min() + reading.upper - stands.max()) / 2.0
            ways = np.array([*ways, *_QUARTERS, round(middle / DEG) * DEG])
        out = np.sum((stands + ways < reading.lower) | (stands + ways > reading.upper), axis=0)
        offsets[k], beyond = ways[out.argmin()], beyond + int(out.min())
    return Zeros(zeros.signs, offsets), beyond


# ---- the arm as a product of turns


class _Axes(NamedTuple):
    """The axes of readings at zero, in the base: unit vectors (nr, 3), points on them (nr, 3), kinds; the tip there."""

    directions: Array
    points: Array
    turning: tuple[bool, ...]
    moving: tuple[bool, ...]
    tip: Array


def _axes(robot: Robot) -> _Axes | None:
    """Return the axes of an arm each of whose readings moves one joint, the first nearest to the base; else None."""
    nr = len(robot.readings)
    quarter = 0.5 * np.pi
    try:
        tips = robot.tips(np.vstack([np.zeros(nr), quarter * np.eye(nr)]))
        moved = tips[1:] @ inverse(tips[0])
        turns = moved[:, :3, :3] - moved[:, :3, :3].mT
        sines = np.column_stack([turns[:, 2, 1], turns[:, 0, 2], turns[:, 1, 0]]) / 2.0
        turning = np.linalg.norm(sines, axis=1) > _NEGLIGIBLE
        along = np.where(turning[:, None], sines, moved[:, :3, 3])
        lengths = np.linalg.norm(along, axis=1)
        directions = along / np.maximum(lengths, _NEGLIGIBLE)[:, None]
        points = np.array([np.linalg.lstsq(np.eye(3) - T[:3, :3], T[:3, 3], rcond=_NEGLIGIBLE)[0] for T in moved])
        axes = _Axes(directions, points, tuple(turning.tolist()), tuple((lengths > _NEGLIGIBLE).tolist()), tips[0])
        # Somewhere else, where every joint turns another way, the product must be the arm.
        there = np.linspace(0.3, 1.1, 2 * nr).reshape(2, nr) * np.where(np.arange(nr) % 2, -1.0, 1.0)
        seen, made = robot.tips(there)[:, :3], _chain(axes, there, range(nr))
    except PoseError:
        return None
    reach = float(np.abs(seen[..., 3]).max()) + _NEGLIGIBLE
    return axes if float(np.abs(_times(made, axes.tip[:3]) - seen).max()) < _TRUE_TO * max(1.0, reach) else None


def _chain(axes: _Axes, positions: Array, which: Sequence[int]) -> Array:
    """Return the product of the motions of the joints ``which`` at ``positions`` (..., nr): (..., 3, 4)."""
    T = np.broadcast_to(np.eye(3, 4), (*positions.shape[:-1], 3, 4))
    for k in which:
        if axes.moving[k]:
            T = _times(T, _motion(axes, k, positions[..., k]))
    return T


def _motion(axes: _Axes, k: int, position: Array) -> Array:
    """Return the motion of joint k, (...,) to (..., 3, 4)."""
    w, p = axes.directions[k], axes.points[k]
    if not axes.turning[k]:
        T = np.broadcast_to(np.eye(3, 4), (*position.shape, 3, 4)).copy()
        T[..., 3] = position[..., None] * w
        return T
    R = rotation_about(w, position)
    return np.concatenate([R, (p - R @ p)[..., None]], axis=-1)


def _times(A: Array, B: Array) -> Array:
    """Return the product of motions (..., 3, 4)."""
    return np.concatenate([A[..., :3] @ B[..., :3], A[..., :3] @ B[..., 3:] + A[..., 3:]], axis=-1)


# ---- the search


class _Some(NamedTuple):
    """Combinations: signs (C, nr), offsets (C, nr)."""

    signs: Array
    offsets: Array

    def at(self, which: IntArray) -> "_Some":
        """Return the chosen ones."""
        return _Some(self.signs[which], self.offsets[which])


def _joined(some: Sequence[_Some]) -> _Some:
    return _Some(*(np.concatenate(values) for values in zip(*some, strict=True)))


class _Search:
    """What combinations leave of rows: readings (N, nr), positions (N, 3)."""

    def __init__(self, axes: _Axes, readings: Array, positions: Array) -> None:
        self.axes, self.readings, self.rows = axes, readings, len(readings)
        self.joints = [k for k, moving in enumerate(axes.moving) if moving]
        self.inner = [k for k in self.joints[1:-1] if axes.turning[k]]
        y = positions - positions.mean(axis=0)
        size = max(float(np.abs(y).max()), _NEGLIGIBLE)
        X = np.einsum("ni,jk->njki", y / size, np.eye(3)).reshape(-1, 9)
        # The unknowns that all combinations have in common; positions in a plane leave some of them open.
        Q, s, V = np.linalg.svd(np.column_stack([X, np.tile(np.eye(3), (self.rows, 1))]), full_matrices=False)
        shown = s > _NEGLIGIBLE * s[0]
        self.Q, self.to_A = Q[:, shown], (V[shown].T / s[shown])[:9] / size

    def combinations(self, step: float) -> int:
        """Return how many there are at a distance of angles."""
        return int(2 ** len(self.joints) * round(2.0 * np.pi / step) ** len(self.inner))

    def refined(self, some: _Some, step: float) -> _Some:
        """Return the best of combinations a step apart, made finer."""
        some = some.at(np.argsort(self._left_of(some), kind="stable")[:_KEPT])
        around = np.array(list(product((0.0, -1.0, 1.0), repeat=len(self.inner))))
        around = around[np.count_nonzero(around, axis=1) <= _AT_A_TIME]
        while (step := step / 2.0) > _FINE and self.inner:
            fewer = max(_LEFT, len(some.signs) // 2)
            for stay in (len(some.signs), fewer, fewer):
                near = self._moved(some, step * around)
                left = self._left_of(near).reshape(-1, len(around))
                order = np.argsort(left.min(axis=1), kind="stable")[:stay]
                some = near.at(order * len(around) + left.argmin(axis=1)[order])
        return _Some(some.signs[:_FOUND], _rounded(some.offsets[:_FOUND]))

    def grid(self, step: float) -> _Some:
        """Return the best combinations of all signs, and of angles a step apart."""
        half = len(self.joints) // 2
        first, last = (self._every(which, step) for which in (self.joints[:half], self.joints[half:]))
        before = self._placed(first, self.joints[:half])
        after = _times(self._placed(last, self.joints[half:]), self.axes.tip[:3])
        count = len(after)
        after = np.ascontiguousarray(after.transpose(1, 2, 0, 3)).reshape(self.rows, 3, 4 * count)
        left = []
        for at in range(0, len(before), max(1, _AT_ONCE // count)):
            part = before[at : at + max(1, _AT_ONCE // count)]
            turned = np.ascontiguousarray(part[..., :3].transpose(1, 2, 0, 3)).reshape(self.rows, -1, 3) @ after
            tips = turned.reshape(self.rows, 3, len(part), count, 4)
            tips[..., 3] += part[..., 3].transpose(1, 2, 0)[..., None]
            left.append(self._left(tips.reshape(3 * self.rows, -1, 4)))
        kept = np.argsort(np.concatenate(left), kind="stable")[:_PROMISING]
        one, other = first.at(kept // count), last.at(kept % count)
        return _Some(one.signs * other.signs, one.offsets + other.offsets)

    def _every(self, which: Sequence[int], step: float) -> _Some:
        """Return all signs, and all angles at a distance, of some joints."""
        angles = step * np.arange(round(2.0 * np.pi / step))
        ways = [list(product((1.0, -1.0), angles if k in self.inner else (0.0,))) for k in which]
        chosen = np.array(list(product(*ways)))
        some = _Some(np.ones((len(chosen), len(self.axes.moving))), np.zeros((len(chosen), len(self.axes.moving))))
        some.signs[:, which], some.offsets[:, which] = chosen[..., 0], chosen[..., 1]
        return some

    def _moved(self, some: _Some, steps: Array) -> _Some:
        """Return combinations with inner joints moved by steps (S, inner), one after the other."""
        offsets = np.repeat(some.offsets, len(steps), axis=0)
        offsets[:, self.inner] += np.tile(steps, (len(some.offsets), 1))
        return _Some(np.repeat(some.signs, len(steps), axis=0), offsets)

    def alike(self, some: _Some) -> _Some:
        """Return of combinations, and of these with joints turned back or by half a turn, those that leave no more."""
        flips = np.ones((2 ** len(self.joints), some.signs.shape[1]))
        flips[:, self.joints] = list(product((1.0, -1.0), repeat=len(self.joints)))
        halves = np.array(list(product((0.0, np.pi), repeat=len(self.inner))))
        every = [self._moved(_Some(flips * s, flips * o), halves) for s, o in zip(*some, strict=True)]
        tried = _joined(every)
        left = self._left_of(tried)
        return tried.at(np.flatnonzero(left <= _AS_WELL * left.min() + _NEGLIGIBLE))

    def _placed(self, some: _Some, which: Sequence[int]) -> Array:
        """Return the product of the motions of some joints (C, N, 3, 4)."""
        return _chain(self.axes, some.signs[:, None] * self.readings + some.offsets[:, None], which)

    def _left_of(self, some: _Some) -> Array:
        """Return :meth:`_left` (C,) of combinations."""
        left = []
        for at in range(0, len(some.signs), _AT_ONCE):
            part = _Some(some.signs[at : at + _AT_ONCE], some.offsets[at : at + _AT_ONCE])
            tips = _times(self._placed(part, self.joints), self.axes.tip[:3])
            left.append(self._left(np.ascontiguousarray(tips.transpose(1, 2, 0, 3)).reshape(3 * self.rows, -1, 4)))
        return np.concatenate(left)

    def _left(self, tips: Array) -> Array:
        """Return the rms in m (C,) that the best base and tool leave of tips (3 N, C, 4), without end where mirrored.

        ``A y + s - R p = t`` with any matrix A, as in :mod:`calib.identification.sanity`, its norm made a rotation's.
        """
        count = tips.shape[1]
        F = (self.Q.T @ tips.reshape(len(tips), -1)).reshape(-1, count, 4)
        G = np.ascontiguousarray(F.transpose(1, 2, 0))
        gram = -(G @ G.mT)
        gram[:, :, 3] += np.einsum("kci,kc->ci", tips, tips[..., 3])
        # The columns of rotations are unit vectors; a point on the last axis leaves a direction open.
        gram[:, range(3), range(3)] += (1.0 + _NEGLIGIBLE) * self.rows
        p = np.linalg.solve(gram[:, :3, :3], gram[:, :3, 3:])[..., 0]
        squares = gram[:, 3, 3] - np.einsum("ci,ci->c", gram[:, :3, 3], p)
        A = (self.to_A @ (F[..., 3] - np.einsum("kci,ci->kc", F[..., :3], p))).T.reshape(-1, 3, 3)
        norm = np.maximum(np.linalg.norm(A, axis=(1, 2)), _NEGLIGIBLE)
        mirrored = np.linalg.det(A) < -_MIRRORED * norm**3
        left = np.sqrt(np.maximum(squares, 0.0) / self.rows) * float(np.sqrt(3.0)) / norm
        return np.where(mirrored, np.inf, left)


def _rounded(offsets: Array) -> Array:
    """Return offsets (..., nr) from -180 to 180 deg: quarter turns where they are near to these, else whole degrees."""
    degrees = offsets / DEG
    quarters = _QUARTER * np.round(degrees / _QUARTER)
    off = np.abs(degrees - quarters)
    quarter = (off < _NEAR) | np.all(off < _ORDINARY, axis=-1, keepdims=True)
    whole = np.remainder(np.where(quarter, quarters, np.round(degrees)), 4.0 * _QUARTER)
    return np.asarray(np.where(whole > 2.0 * _QUARTER, whole - 4.0 * _QUARTER, whole) * DEG)


def _simplest(some: _Some) -> list[Zeros]:
    """Return combinations, each once, those first that change least."""
    pairs = zip(some.signs, _rounded(some.offsets), strict=True)
    each = {(tuple(s), tuple(o)): Zeros(s, o) for s, o in pairs}
    return sorted(each.values(), key=lambda zeros: (zeros.changed, float(np.abs(zeros.offsets).sum())))[:_MOST]
