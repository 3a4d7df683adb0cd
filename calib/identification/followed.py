"""How well the nominal arm follows rows, with base and tool where they explain most."""

from typing import NamedTuple

import numpy as np

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array, IntArray
from calib.identification.initialisation.base_and_tools import KnownFrames, TipObservations, base_and_tools

# Base and tool point: nine unknowns, of three numbers a row.
_UNKNOWNS = 9
FEWEST_ROWS = 8


class Followed(NamedTuple):
    """What the best base (4, 4) and tool leave of positions: ``miss``, rms in m, and its ``share`` of their spread."""

    miss: float
    share: float
    base: Array


def followed(tips: Array, position: Array) -> Followed:
    """Return how well an arm whose tip was at ``tips`` (N, 4, 4) explains positions (N, 3) in m of an instrument.

    A share near 0 is an arm that moved as was measured; of readings in a wrong unit or order it is near 1 or above.
    """
    return _followed(tips, position)[0]


def strays(tips: Array, position: Array, most: int, share: float) -> tuple[IntArray, Followed] | None:
    """Return the few rows, at most so many, without which an arm leaves less than a share of the spread; else None.

    One after the other the row that lies farthest off is left out. ``tips`` and ``position``: as of :func:`followed`.
    """
    every = kept = np.arange(len(tips))
    for _ in range(most + 1):
        fit, left = _followed(tips[kept], position[kept])
        if fit.share < share:
            return np.setdiff1d(every, kept), fit
        kept = np.delete(kept, int(np.argmax((left * left).sum(axis=1))))
    return None


def _followed(tips: Array, position: Array) -> tuple[Followed, Array]:
    """Return how well an arm explains positions, and what it leaves of each (N, 3)."""
    n = len(tips)
    nothing = np.full((n, 3, 3), np.nan)
    with linear.one_thread(of_scipy=False):
        found = base_and_tools(
            TipObservations(tips, position, nothing, np.zeros(n, dtype=np.intp)),
            KnownFrames(None, None, None),
            np.eye(4)[None],
        )
    T = found.base @ tips @ found.tools[0]
    left = position - T[:, :3, 3]
    miss = float(np.sqrt((left * left).sum() / max(3 * n - _UNKNOWNS, 1) * 3.0))
    spread = float(np.sqrt(((position - position.mean(axis=0)) ** 2).sum() / n))
    return Followed(miss, miss / spread if spread > 0.0 else np.inf, found.base), left


def turned_along(tips: Array, base: Array, rotation: Array) -> float:
    """Return the rms angle in rad that the best turn of the tool leaves of measured rotations (N, 3, 3)."""
    by_tool = np.swapaxes(tips[:, :3, :3], -1, -2) @ base[:3, :3].T @ rotation
    mean = rigid.nearest_rotation(by_tool.sum(axis=0))
    angle = np.linalg.norm(rigid.log3(mean.T @ by_tool), axis=-1)
    return float(np.sqrt((angle * angle).mean()))


def pivots(tips: Array, target: Array) -> float:
    """Return the share that the best tool point leaves of the tip's spread, if rows of one target touch one point."""
    n, k = len(tips), int(target.max()) + 1
    left = np.concatenate([tips[:, :3, :3].reshape(-1, 3), -np.kron(np.eye(k)[target], np.eye(3))], axis=1)
    right = -tips[:, :3, 3].reshape(-1)
    found = np.linalg.lstsq(left, right, rcond=None)[0]
    off = left @ found - right
    spread = tips[:, :3, 3] - tips[:, :3, 3].mean(axis=0)
    free = max(3 * n - 3 - 3 * k, 1)
    size = float(np.sqrt((spread * spread).sum() / n))
    return float(np.sqrt((off * off).sum() / free * 3.0)) / size if size > 0.0 else np.inf
