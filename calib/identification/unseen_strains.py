"""What of an arm's size and proportions measurements would not show, before anything is solved.

An arm that is larger throughout, or longer along some of its axes alone, is a strained one: its tool is elsewhere by
``S x``, where x is its place and S is symmetric. Where parameters imitate that, by what weak priors hold least, rows
tell of it, targets following as they do best, or they leave it to the priors.
"""

from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array, read_only
from calib.identification.identifiability import RANK_TOLERANCE
from calib.identification.machine import values_at
from calib.identification.parameters import scales
from calib.identification.stances import touches
from calib.identification.system import Problem, evaluate
from calib.identification.tool_motions import as_positions
from calib.identification.weights import search_variances, sigmas_of
from calib.measurement.kinds import IN_INSTRUMENT_FRAME

# A strain is not seen to which priors contribute more than this share of what is known of it.
_UNSEEN = 0.25
# A strain is imitated of which less than this share is left. A metre of what is left counts as much as so many numbers.
_IMITATED, _STRICTLY = 0.1, 1e6
# Strains are dependent when one is shorter than this share of another: of an arm all of whose poses are in a plane.
_DEPENDENT = 1e-3
# An orthonormal basis of strains: growing, and five that change no volume.
_STRAINS = read_only(
    np.array(
        [
            np.eye(3) / np.sqrt(3.0),
            np.diag([1.0, 1.0, -2.0]) / np.sqrt(6.0),
            np.diag([1.0, -1.0, 0.0]) / np.sqrt(2.0),
            *(np.sqrt(0.5) * (np.outer(a, b) + np.outer(b, a)) for a, b in combinations(np.eye(3), 2)),
        ]
    )
)


class UnseenStrains(NamedTuple):
    """Whether the ``size`` of the arm, or some of its ``proportions``, do not show, where these are free."""

    size: bool
    proportions: bool


def unseen_strains(problem: Problem) -> UnseenStrains:
    """Return which strains of the arm the rows of a problem would not show, at its start.

    Where an instrument sees the tool, or all rows have lengths, all of them show.
    """
    sets = problem.measurements
    placed = any(data.kind in IN_INSTRUMENT_FRAME for data in sets)
    without_lengths = any(touches(data) or (data.kind == "pixels" and not data.of_boards) for data in sets)
    if placed or not without_lengths:
        return UnseenStrains(size=False, proportions=False)
    by_common, strained = _moved(problem)
    if not strained.any():
        return UnseenStrains(size=False, proportions=False)
    hold = np.array([problem.parameters[k].hold for k in problem.split.common])
    sigmas = sigmas_of(problem, search_variances(problem), search=True)
    x = values_at(problem.model.robot, problem.parameters, problem.reference)
    rows = evaluate(problem, sigmas, x).rows.whole.reduced(RANK_TOLERANCE).rest[:, :-1]
    none = np.zeros((len(rows) + len(hold), 6))
    told = np.concatenate([_STRICTLY * by_common, rows, np.diag(hold)])
    Z = np.linalg.lstsq(told, np.concatenate([_STRICTLY * strained, none]), rcond=linear.ROUNDING)[0]
    left, seen, held = by_common @ Z - strained, rows @ Z, hold[:, None] * Z

    def count(V: Array) -> int:
        """Return how many of the strains V (6, j) parameters imitate, and priors alone hold."""
        _, sizes, W = linear.svd(strained @ V, full_matrices=False)
        some = sizes > _DEPENDENT * sizes[0]
        V = V @ (W[some].T / sizes[some])
        _, misses, W = linear.svd(left @ V, full_matrices=False)
        V = V @ W[misses < _IMITATED].T
        # Of what both say of these strains, priors say shares.
        Q = np.linalg.qr(np.concatenate([held @ V, seen @ V]))[0]
        return int(np.count_nonzero(np.linalg.svd(Q[: len(held)], compute_uv=False) ** 2 > _UNSEEN))

    size = count(np.eye(6)[:, :1])
    return UnseenStrains(bool(size), count(np.eye(6)) > size)


def _moved(problem: Problem) -> tuple[Array, Array]:
    """Return how tools move over the poses of all rows (q, c) by common parameters, and (q, 6) by strains of the arm.

    Both are without rigid motions of all.
    """
    frames = replace(problem.reference, bases=np.broadcast_to(np.eye(4), problem.reference.bases.shape))
    parameters, split = problem.parameters, problem.split
    machine = replace(problem, reference=frames).machine(values_at(problem.model.robot, parameters, frames))
    rates = problem.rates(machine, scales(parameters), split)
    of_arm = np.array([parameters[k].of_robot or parameters[k].kind == "tool" for k in split.common])
    moved = linear.Gathered(12 + len(split.common))
    for data in problem.measurements:
        for block in rates.blocks(as_positions(data)):
            x = block.moved[0].placed[:, :3, 3]
            rigidly = [-rigid.skew(x), np.broadcast_to(np.eye(3), (len(x), 3, 3))]
            by_common = np.where(of_arm, -block.J, 0.0)
            moved.add(np.concatenate([*rigidly, np.moveaxis(x @ _STRAINS, 0, -1), by_common], axis=2))
    rows = moved.triangle[6:] / np.sqrt(sum(map(len, problem.measurements)))
    return rows[:, 12:], rows[:, 6:12]
