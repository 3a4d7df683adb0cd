"""How readings and measurements go together in time: delays, joints that are late or behind, and arms not at rest."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calib.assessment.effects import NO_EFFECT, Effect, effect
from calib.assessment.scores import score_test
from calib.assessment.stretches import Stretch
from calib.foundations.arrays import Array, IntArray
from calib.measurement.poses import ONE_POSE
from calib.measurement.streams.sides import sides

# Rows of a stream that are farther apart, in steps, are no neighbours. Accelerations are over so long a time, in s.
_GAP, _LONGER = 2.5, 0.25
# A joint hardly moves below such a share of its rms rate.
_HARDLY = 0.05


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
    nor where the sides from which joints came explain more, as gaps of gears do, or a delay, or joints that move by
    more or less than they read: their errors go with the readings, and so in part with the way from the pose before.
    """
    usable = [part for part in parts if part.data.other is None and not np.isfinite(part.step)]
    moves = [_moves(part) for part in usable]
    farthest = [np.max(np.abs(move), axis=1, keepdims=True, initial=0.0) for move in moves]
    shares = [move / np.where(far > 0.0, far, 1.0) for move, far in zip(moves, farthest, strict=True)]
    left = [part.by_joint * share[:, None, :] for part, share in zip(usable, shares, strict=True)]
    sides = [part.by_joint * np.sign(move)[:, None, :] for part, move in zip(usable, moves, strict=True)]
    together = [motion.sum(axis=2) for motion in left]
    late = [np.einsum("ndk,nk->nd", part.by_joint, part.rates)[:, :, None] for part in usable]
    gains = [part.by_joint * part.values[:, None, :] for part in usable]
    causes = ([own[:, :, None] for own in together], sides, late, gains)
    gained = [_gained(usable, motions, C) for motions in causes if usable]
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
