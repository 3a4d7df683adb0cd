"""From which side joints came to where they are, by how they moved in a controller's stream."""

import math
from itertools import pairwise

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.measurement.streams.joints import JointStream

# A joint has moved where it did by more than so many standard deviations of its noise: a million samples span less.
_MOVED = 10.0
# Differences of this order leave of a motion next to nothing, and of noise as many times its variance.
_ORDER = 5
_AS_MANY = math.comb(2 * _ORDER, _ORDER)


def sides(joints: JointStream, times: Array) -> Array:
    """Return the side (N, k) from which every joint came at times (N,): +1 growing, -1 falling, 0 before it has moved.

    It changes where the joint's own samples go back, be it between two rows, and not where an encoder jitters at rest.
    """
    # Knots are the samples but the second and the last but one: not a knot.
    knots = [np.unique(piece.t) for piece in joints.pieces]
    samples = [piece(at) for piece, at in zip(joints.pieces, knots, strict=True)]
    t, q = np.concatenate(knots), np.concatenate(samples)
    rough = [np.zeros((1, q.shape[1])), *(np.diff(own[1:-1], _ORDER, axis=0) for own in samples)]
    noise = np.sqrt(np.mean(np.square(np.concatenate(rough)), axis=0) / _AS_MANY)
    found = np.empty((len(times), q.shape[1]))
    for k in range(q.shape[1]):
        turned, side = _turns(q[:, k], _MOVED * float(noise[k]))
        found[:, k] = side[np.searchsorted(t[turned], times)]
    return read_only(found)


def _turns(q: Array, width: float) -> tuple[list[int], Array]:
    """Return after which samples of q (n,) a joint went another way, by more than a ``width``, and all m + 1 sides."""
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
    return turned, np.array(found)
