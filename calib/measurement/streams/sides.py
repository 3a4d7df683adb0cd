"""From which side joints came to where they are, by how they moved in a controller's stream."""

import math
from itertools import pairwise

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray, read_only
from calib.measurement.streams.joints import SPAN, JointStream

# A joint has moved where it did by more than so many standard deviations of its noise: a million samples span less.
_MOVED = 10.0
# Gaps are taken for no wider, in rad or m: a joint that turned and has gone back by less may be between the flanks. Of
# one that goes on where it turned, as after an overshoot, nobody minds less than such a share.
_GAP, _NEAR = 2e-3, 0.25
# Differences of this order leave of a motion next to nothing, and of noise as many times its variance.
_ORDER = 5
_AS_MANY = math.comb(2 * _ORDER, _ORDER)


def sides(joints: JointStream, times: Array) -> Array:
    """Return the side (N, k) from which every joint came at times (N,): +1 growing, -1 falling, 0 before it has moved.

    A joint that turned leaves its side at once, and is at the other one when it has gone back by the widest gap of its
    gears, 2 mrad or 2 mm. Nobody knows when in between: there it is nan. An encoder that jitters at rest changes none.
    """
    # Knots are the samples but the second and the last but one: not a knot.
    knots = [np.unique(piece.t) for piece in joints.pieces]
    samples = [piece(at) for piece, at in zip(joints.pieces, knots, strict=True)]
    t, q = np.concatenate(knots), np.concatenate(samples)
    rough = [np.zeros((1, q.shape[1])), *(np.diff(own[1:-1], _ORDER, axis=0) for own in samples)]
    noise = np.sqrt(np.mean(np.square(np.concatenate(rough)), axis=0) / _AS_MANY)
    found = np.empty((len(times), q.shape[1]))
    for k in range(q.shape[1]):
        jitter = _MOVED * float(noise[k])
        gap = max(_GAP, jitter)
        arrived, side = _turns(q[:, k], gap)
        # Over some time, a joint that rests goes to and fro, and one that has turned goes back.
        steps = np.interp(t + SPAN, t, q[:, k]) - np.interp(t - SPAN, t, q[:, k])
        between = _between(q[:, k], steps, arrived, side, jitter, max(jitter, _NEAR * gap))
        until = np.minimum(np.searchsorted(t, times), len(t) - 1)
        found[:, k] = np.where(between[until], np.nan, side[np.searchsorted(t[arrived], times)])
    return read_only(found)


def _turns(q: Array, width: float) -> tuple[IntArray, Array]:
    """Return after which samples of q (n,) a joint had gone back by more than a ``width``, and all m + 1 sides."""
    steps = np.diff(q)
    # Where it stops or goes back; between two of these samples it goes one way, or rests.
    ends = np.flatnonzero(np.diff(np.sign(steps), prepend=0.0, append=0.0))
    turned: list[int] = []
    found = [0.0]
    low = high = float(q[0])
    for start, end in pairwise(ends):
        there = float(q[end])
        if found[-1] <= 0.0 and there - low > width:
            turned.append(int(start + np.argmax(q[start : end + 1] - low > width)) - 1)
            found.append(1.0)
            high = there
        elif found[-1] >= 0.0 and high - there > width:
            turned.append(int(start + np.argmax(high - q[start : end + 1] > width)) - 1)
            found.append(-1.0)
            low = there
        low, high = min(low, there), max(high, there)
    return np.array(turned, dtype=np.intp), np.array(found)


def _between(q: Array, steps: Array, arrived: IntArray, side: Array, jitter: float, near: float) -> BoolArray:
    """Return until which samples of q (n,) a joint is between two flanks since the sample before.

    It is at a ``side`` (m + 1,) from where it ``arrived`` there (m,) as long as it goes on, but for ``jitter``. Where
    it goes back by more than what is ``near``, or is on its way back at the end, it has left the flank when it stood
    there for the last time, and its ``steps`` (n,) had not turned.
    """
    found, turned = np.zeros(len(q), dtype=np.bool_), set(arrived.tolist())
    for way, (start, end) in zip(side[1:].tolist(), pairwise((*arrived.tolist(), len(q) - 1)), strict=True):
        ahead = way * q[start : end + 1]
        back = np.maximum.accumulate(ahead) - ahead
        there = np.flatnonzero(back <= jitter)
        again = np.append(there[1:], len(ahead))
        gone = np.maximum.reduceat(back, there) > near
        gone[-1] |= end in turned or again[-1] > there[-1] + 1
        goes_on = way * steps[start : end + 1] >= 0.0
        left = np.maximum.accumulate(np.where(goes_on, np.arange(len(ahead)), 0))[there]
        for i in np.flatnonzero(gone).tolist():
            found[start + int(left[i]) + 1 : start + int(again[i])] = True
    return found
