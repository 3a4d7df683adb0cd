"""A link's own weight, by integrating the equation of a beam: what the toolkit has in closed form."""

from functools import cache

import numpy as np

Array = np.ndarray
N = 1000


def own_weight(vector: Array, centre: Array) -> tuple[Array, Array, Array]:
    """Shift, turn and twist (3, 3) of the end of a cantilever along ``vector`` for a force (3,), where EI = GJ = 1.

    The force is spread evenly about ``centre``, as far as the nearer end; a centre off the line has a lever to it.
    """
    return _own_weight(tuple(vector), tuple(centre))


@cache
def _own_weight(vector: tuple[float, ...], centre: tuple[float, ...]) -> tuple[Array, Array, Array]:
    L = float(np.linalg.norm(vector))
    e = np.array(vector) / L
    middle = min(max(float(np.dot(centre, e)), 0.0), L)
    half = min(middle, L - middle)
    lever = np.array(centre) - middle * e
    steps = (np.arange(N) + 0.5) / N
    at, x = middle + half * (2.0 * steps - 1.0), L * steps
    behind = at[None] > x[:, None]
    arms = np.mean(np.where(behind, at[None] - x[:, None], 0.0), axis=1)
    share = np.mean(behind, axis=1)
    across = np.eye(3) - np.outer(e, e)
    shift, turn, twist = np.zeros((3, 3, 3))
    for k, force in enumerate(np.eye(3)):
        moment = arms[:, None] * np.cross(e, force) + share[:, None] * np.cross(lever, force)
        bent = np.cumsum(moment @ across, axis=0) * L / N - 0.5 * (moment @ across) * L / N
        shift[:, k] = np.cross(bent, e).sum(axis=0) * L / N
        turn[:, k] = (moment @ across).sum(axis=0) * L / N
        twist[:, k] = (moment @ e).sum() * L / N * e
    return shift, turn, twist


def followed(vector: Array, centre: Array, shift: Array, turn: Array) -> Array:
    """The mean motion (3,) of the same mass where the end shifts and turns (3,): the cubic through both ends."""
    L = float(np.linalg.norm(vector))
    e = vector / L
    middle = min(max(float(np.dot(centre, e)), 0.0), L)
    half = min(middle, L - middle)
    x = (middle + half * (2.0 * (np.arange(N) + 0.5) / N - 1.0))[:, None]
    square, cube = np.linalg.solve([[L**2, L**3], [2.0 * L, 3.0 * L**2]], [shift, np.cross(turn, e)])
    slope = 2.0 * square * x + 3.0 * cube * x**2
    return np.mean(square * x**2 + cube * x**3 + np.cross(np.cross(e, slope), centre - middle * e), axis=0)
