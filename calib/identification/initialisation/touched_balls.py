"""Tool points that only touches of balls, or lengths, tell: the probe's place on the tip, on the side it touched from.

About a ball that is touched with the probe towards its middle, the tip turns as about a socket in the middle: what
stays is not the probe but a point a radius before it. A search from there, where all touches are at the middle of the
ball, ends on a side that chance chose. So the probe is sought a radius off that point in every direction, each time
with the balls where these touches put them, and the place that fits clearly best is taken.

So it is with lengths to anchors where the tip is on the axis about which it turns, as on a table: it stays where it is
while they change, nothing says to which side the tool is, and a search that begins there stays there.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, IntArray, evenly, read_only
from calib.identification.initialisation.target_poses import centre
from calib.measurement.measurements import Measurements, numbered

# Another place fits clearly better with a sum of squares below this share.
_CLEARLY = 0.5
_STEPS, _NO_STEP = 30, 1e-7
# More touches of a ball, and more balls, do not tell the side better.
_ENOUGH, _ENOUGH_BALLS = 100, 10
# Directions to all sides: to the faces, edges and corners of a cube.
_SIDES = read_only(np.array([np.array(d) / np.linalg.norm(d) for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)]))


class _Touches(NamedTuple):
    """Touches of one ball, or lengths to one anchor: tips (n, 4, 4) at the rows' points, radii or lengths (n,).

    ``known``: its middle (3,) where that is known.
    """

    data: Measurements
    tips: Array
    radius: Array
    known: Array | None

    @property
    def turned(self) -> float:
        """By how much the tip turned between the touches, which is what tells the point: a sum of squares."""
        R = self.tips[:, :3, :3]
        return float(np.sum((R - R.mean(axis=0)) ** 2))

    def seen(self, point: Array) -> Array:
        """Return where touches (n, 3) are with the tool at ``point``."""
        return np.asarray(self.tips[:, :3, :3] @ point + self.tips[:, :3, 3])


class _End(NamedTuple):
    """Where a search for a point (3,) has led, with the sum of squares there."""

    point: Array
    squares: float


def touched_with(
    sets: Sequence[Measurements],
    tips: Sequence[Array],
    tools: Array,
    sought: IntArray,
    known: Sequence[Sequence[Array | None]],
) -> Array:
    """Return tools (k, 4, 4) with those ``sought`` where touches of balls or lengths alone put them; others as before.

    ``tips`` (N, 4, 4) of every set at the rows' points, as their targets see them; ``known``: where the target of each
    row is, None where that is to be found.
    """
    found = tools.copy()
    for k in sought:
        own = [one for one in zip(sets, tips, known, strict=True) if np.any(one[0].tool == k)]
        if any(data.kind not in ("sphere", "distance") or data.uses for data, *_ in own):
            continue
        balls = [ball for data, T, there in own for ball in _balls(data, T, there, int(k))]
        if balls:
            found[k, :3, 3] = _best(balls, tools[k, :3, 3])
    return found


def _balls(data: Measurements, tips: Array, known: Sequence[Array | None], tool: int) -> list[_Touches]:
    rows = np.flatnonzero(data.tool == tool)
    # The same ball is elsewhere in the base of another set-up, which may not be known yet.
    both = data.target[rows] * (1 + len(data.setups)) + data.setup[rows]
    found = []
    for _, own in numbered(both):
        some = rows[own[evenly(len(own), _ENOUGH)]]
        found.append(_Touches(data.subset(some), tips[some], data.value[some, 0], known[some[0]]))
    return sorted(found, key=lambda ball: -ball.turned)[:_ENOUGH_BALLS]


def _best(balls: Sequence[_Touches], start: Array) -> Array:
    """Return the point (3,) of the tool that fits best of all that are so far off a start; the start if none does.

    That is a radius; of lengths half of what they change by, where a tool at the start explains none of it.
    """
    best = _sought(balls, start, held=True)
    radii = [ball.radius for ball in balls if ball.data.kind == "sphere"]
    if not radii and best.squares < _CLEARLY * sum(len(ball.radius) * np.var(ball.radius) for ball in balls):
        return start
    size = float(np.mean(np.concatenate(radii))) if radii else max(0.5 * float(np.ptp(b.radius)) for b in balls)
    ends = [_sought(balls, start + size * side) for side in (np.zeros(3), *_SIDES)]
    for end in (ends[0], min(ends, key=lambda end: end.squares)):
        best = end if end.squares < _CLEARLY * best.squares else best
    return best.point


def _sought(balls: Sequence[_Touches], start: Array, *, held: bool = False) -> _End:
    """Return the point (3,) to which a search leads that begins at a start, or stays there where it is ``held``."""
    middles = [
        centre([(b.data, b.seen(start), b.data.value)]) if b.known is None else np.asarray(b.known) for b in balls
    ]
    x = np.concatenate([start, *middles])
    free = np.repeat([not held, *(b.known is None for b in balls)], 3)
    tips, radius = (np.concatenate(parts) for parts in zip(*((b.tips, b.radius) for b in balls), strict=True))
    ball = np.repeat(np.arange(len(balls)), [len(b.radius) for b in balls])
    damping = 1e-3
    r, J = _missed(tips, radius, ball, x)
    for _ in range(_STEPS):
        own = J[:, free]
        A = own.T @ own
        step = np.zeros(len(x))
        step[free] = -np.linalg.solve(A + damping * np.diag(np.diag(A) + 1e-9), own.T @ r)
        there = _missed(tips, radius, ball, x + step)
        if there[0] @ there[0] < r @ r:
            x, (r, J), damping = x + step, there, max(0.1 * damping, 1e-9)
        else:
            damping *= 10.0
        if np.abs(step).max() < _NO_STEP:
            break
    return _End(x[:3], float(r @ r))


def _missed(tips: Array, radius: Array, ball: IntArray, x: Array) -> tuple[Array, Array]:
    """Return by how much touches (n,) miss their balls, and the derivatives (n, p) by x (p,): point, then middles."""
    off = tips[:, :3, :3] @ x[:3] + tips[:, :3, 3] - x[3:].reshape(-1, 3)[ball]
    far = np.maximum(np.linalg.norm(off, axis=1), 1e-9)
    n = off / far[:, None]
    J = np.zeros((len(off), len(x)))
    J[:, :3] = np.einsum("ni,nij->nj", n, tips[:, :3, :3])
    np.put_along_axis(J, 3 + 3 * ball[:, None] + np.arange(3), -n, axis=1)
    return far - radius, J
