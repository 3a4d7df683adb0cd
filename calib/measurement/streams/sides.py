"""From which side joints came to where they are, by how they moved in a controller's stream."""

import math
from itertools import pairwise

import numpy as np

from calib.foundations.arrays import Array, IntArray, read_only
from calib.measurement.streams.joints import JointStream

# A joint has moved where it did by more than so many standard deviations of its noise: a million samples span less.
_MOVED = 10.0
# Gaps are taken for no wider, in rad or m: a joint that turned and has gone back by less may be between the flanks.
_GAP = 2e-3
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
    # On the mean over some time, a joint that rests goes to and fro, and one that has turned goes back.
    rates = joints.mean_rates(t)
    found = np.empty((len(times), q.shape[1]))
    for k in range(q.shape[1]):
        jitter = _MOVED * float(noise[k])
        arrived, side = _turns(q[:, k], max(_GAP, jitter))
        left = _left(q[:, k], rates[:, k], arrived, side, jitter)
        after = np.searchsorted(t[arrived], times)
        between = (np.searchsorted(t[left], times) > after) & (after > 0)
        found[:, k] = np.where(between, np.nan, side[after])
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


def _left(q: Array, rates: Array, arrived: IntArray, side: Array, jitter: float) -> IntArray:
    """Return after which samples (m,) of q (n,) a joint began to go back, to be at its other side after ``arrived``.

    It stood farthest within ``jitter`` for the last time, and before that its mean ``rates`` (n,) had not turned.
    """
    found, before = np.zeros_like(arrived), 0
    for m, (end, way) in enumerate(zip(arrived.tolist(), side[1:].tolist(), strict=True)):
        gone = way * q[before : end + 1]
        last = int(np.flatnonzero(gone <= gone.min() + jitter)[-1])
        still = np.flatnonzero(way * rates[before : before + last + 1] <= 0.0)
        found[m] = before + (int(still[-1]) if len(still) else 0)
        before = end
    return found
