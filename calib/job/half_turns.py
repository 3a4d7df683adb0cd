"""Which way up a board was in photographs, where it looks the same upside down: by how far it and the flange turn.

Between two photographs, board and camera turn against each other by the same angle as flange and base do, wherever the
camera is. A half turn of one of them about the board's normal makes this angle another one, unless both turn by a
quarter about it. So pairs of photographs tell whether one of the two is to be turned; a half turn of all only gives the
marks other names.
"""

from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray, evenly

# Angles, in rad, that agree, and such as surely do not: an arm and photographs of a board are right to a few degrees.
AGREE, _DIFFER = 0.05, 0.2
# As many photographs are compared with all others.
_MOST = 60
# A photograph is told by so large a share of the others at least, and so many of these have to say the same.
_TOLD_BY, _ALIKE = 0.4, 0.8
_MOST_ROUNDS = 20


class HalfTurns(NamedTuple):
    """Which photographs (n,) are to be turned, of which this is ``told``, and which ``contradict`` the others."""

    turned: BoolArray
    told: BoolArray
    contradict: BoolArray


class _Votes(NamedTuple):
    """What pairs (n, k) say: 1 that both are the same way up, -1 that they are not, 0 nothing; and which fit no way."""

    sign: Array
    unfit: BoolArray


def half_turns(boards: Array, tips: Array) -> HalfTurns:
    """Return which poses (n, 4, 4) of a board in the camera are to be turned about its normal, by those of a flange.

    What is told holds among those that are: all of them might be the other way up.
    """
    boards, tips = boards[:, :3, :3], tips[:, :3, :3]
    some = np.arange(len(boards), dtype=np.intp)[evenly(len(boards), _MOST)]
    votes = _votes(boards, tips, some)
    votes.sign[some, np.arange(len(some))] = 0.0
    among = votes.sign[some]
    known = np.zeros(len(some))
    if len(some):
        known[int(np.argmax(np.abs(among).sum(axis=1)))] = 1.0
    # One after the other joins those that tell it, the surest first: what nothing joins to them is not told.
    for _ in range(len(some)):
        sum_, told = _told(among, known)
        joining = np.where(told & (known == 0.0), np.abs(sum_), 0.0)
        if not joining.any():
            break
        k = int(np.argmax(joining))
        known[k] = np.sign(sum_[k])
    for _ in range(_MOST_ROUNDS):
        sum_, told = _told(among, known)
        again = np.where(told, np.sign(sum_), 0.0)
        if np.array_equal(again, known):
            break
        known = again
    sum_, told = _told(votes.sign, known)
    unfit = (votes.unfit & (known != 0.0)).sum(axis=1) > 0.5 * np.count_nonzero(known)
    return HalfTurns(sum_ < 0.0, told, unfit)


def _told(sign: Array, known: Array) -> tuple[Array, BoolArray]:
    """Return what votes (n, k) of those that are ``known`` (k,), 1 or -1, come to, and where they tell something."""
    sum_, count = sign @ known, np.abs(sign) @ np.abs(known)
    others = np.count_nonzero(known)
    enough = (count > 0.0) & (count >= _TOLD_BY * (others - 1))
    return sum_, np.asarray(enough & (np.abs(sum_) >= _ALIKE * count))


def _votes(boards: Array, tips: Array, some: IntArray) -> _Votes:
    # The diagonals of the turns between boards: a half turn changes the signs of the first two.
    diagonal = np.einsum("ird,jrd->ijd", boards, boards[some])
    across, along = diagonal[..., 0] + diagonal[..., 1], diagonal[..., 2]
    angle = _angle(np.einsum("ird,jrd->ij", tips, tips[some]))
    same, other = np.abs(_angle(along + across) - angle), np.abs(_angle(along - across) - angle)
    sign = ((same < AGREE) & (other > _DIFFER)).astype(float) - ((other < AGREE) & (same > _DIFFER))
    return _Votes(sign, np.minimum(same, other) > AGREE)


def _angle(trace: Array) -> Array:
    return np.asarray(np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0)))
