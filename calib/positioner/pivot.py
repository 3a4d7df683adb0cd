"""Where the tip of a tool is: one fixed point touched in several orientations.

A tool point p on a link at placement (R_n, t_n) stays at a fixed point c while the link turns about it:

    R_n p + t_n = c,        linear in p and c.

Several fixed points, each touched in several orientations, add up. Nothing but the placements is known, so a length
that all of them get wrong goes into p.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.brief import brief
from calib.foundations.chance import shown_noise
from calib.foundations.errors import MeasurementError
from calib.foundations.linear import svd
from calib.foundations.ranges import finite, refuse_sigma
from calib.foundations.sealing import sealed
from calib.foundations.units import MM

# A direction of p in which the link turns by less than this (rms, rad) is not determined: readings scatter by as much.
_SEEN = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Pivot:
    """A tool point found by pivoting. Made by :func:`pivot`. Lengths in m.

    ``tool_point`` (3,): on the link. ``fixed_points`` (m, 3): by ``targets``, in the frame of the placements.
    ``residuals`` (N, 3): touched minus fixed point. ``covariance`` (3 + 3 m, 3 + 3 m): of the tool point, then of the
    fixed points, in the seen directions. ``rank``: 3 where the tool point is seen in all directions, 2 where all
    orientations turn about one axis, 0 where there is but one; ``null_basis`` (3, 3 - rank): directions on the link
    along which the tool point keeps the value of the guess. ``noise``: standard deviation of a coordinate, given or
    from the residuals.
    """

    __repr__ = brief

    tool_point: Array
    fixed_points: Array
    targets: tuple[str, ...]
    residuals: Array
    covariance: Array
    rank: int
    null_basis: Array
    noise: float

    @property
    def sigmas(self) -> Array:
        """Standard deviations (3,) of the tool point; nan for a coordinate that a direction of the null space moves."""
        unidentifiable = np.any(np.abs(self.null_basis) > 1e-6, axis=1)
        return np.where(unidentifiable, np.nan, np.sqrt(np.diag(self.covariance)[:3]))

    @property
    def rms(self) -> float:
        """3D rms of the residuals."""
        return float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=1))))

    def __str__(self) -> str:
        x, y, z = self.tool_point / MM
        text = f"Tool point ({x:.4f}, {y:.4f}, {z:.4f}) mm, rms {self.rms / MM:.4f} mm"
        if self.rank < 3:
            axes = " and ".join("({:.3f}, {:.3f}, {:.3f})".format(*direction) for direction in self.null_basis.T)
            text += f"; not determined along {axes} of the link: tilt the tool about other axes as well"
        return f"{text}."


@checked
def pivot(
    placements: npt.ArrayLike,
    targets: Sequence[str] | None = None,
    *,
    sigma: float | None = None,
    guess: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> Pivot:
    """Find the tool point of a link that touched a fixed point, or several ``targets`` (N names), in N placements.

    ``placements`` (N, 4, 4): of the link, from joint readings through an arm that is calibrated. ``sigma``: standard
    deviation of a coordinate of a touch in m; None estimates it from the residuals, nan where none is to spare.
    ``guess`` (3,): the tool point, in m, in directions that are not determined.

    Raises MeasurementError when the placements are none. Too few orientations are told by the rank.
    """
    T, names = _checked(placements, targets)
    refuse_sigma(sigma, "sigma")
    kept = tuple(dict.fromkeys(names))
    number = {target: k for k, target in enumerate(kept)}
    which = np.array([number[name] for name in names], dtype=np.intp)
    counts = np.bincount(which)
    p0 = finite(guess, (3,), "the guess of a tool point must be three finite numbers, in m.")
    # Taking out every target's mean removes its fixed point.
    R, t = T[:, :3, :3], T[:, :3, 3]
    R_mean, t_mean = _means(R, which, counts), _means(t, which, counts)
    A = (R - R_mean[which]).reshape(-1, 3)
    b = -((t - t_mean[which]) + (R - R_mean[which]) @ p0).ravel()
    U, values, Vt = svd(A, full_matrices=False)
    rank = int(np.count_nonzero(values > _SEEN * np.sqrt(len(T))))
    inverse = Vt[:rank].T / values[:rank] @ U[:, :rank].T
    p = p0 + inverse @ b
    c = R_mean @ p + t_mean
    residuals = (R @ p + t) - c[which]
    sigma = shown_noise(residuals, 3 * len(T) - rank - 3 * len(kept), sigma)
    # Both are linear in the touches: p through the centred rows, c = mean(touch) + R_mean p, and these means do not
    # correlate with what is centred about them.
    of_p = inverse @ inverse.T
    by_p = np.concatenate([np.eye(3), R_mean.reshape(-1, 3)])
    covariance = by_p @ of_p @ by_p.T
    covariance[3:, 3:] += np.diag(np.repeat(1.0 / counts, 3))
    return Pivot(
        read_only(p),
        read_only(c),
        kept,
        read_only(residuals),
        read_only(sigma**2 * covariance),
        rank,
        read_only(Vt[rank:].T),
        sigma,
    )


def _means(values: Array, which: IntArray, counts: IntArray) -> Array:
    """Return the mean of the values (N, ...) of every target, of which there are ``counts`` (m,)."""
    sums = np.zeros((len(counts), *values.shape[1:]))
    np.add.at(sums, which, values)
    return sums / counts.reshape(-1, *(1,) * (values.ndim - 1))


def _checked(placements: npt.ArrayLike, targets: Sequence[str] | None) -> tuple[Array, tuple[str, ...]]:
    T = finite(placements, (None, 4, 4), "the placements of a pivot must be finite (N, 4, 4).")
    if not np.allclose(rigid.inverse(T) @ T, np.eye(4), atol=1e-6):
        raise MeasurementError("the placements of a pivot must be rigid.")
    names = ("point",) * len(T) if targets is None else tuple(targets)
    if len(names) != len(T):
        raise MeasurementError(f"there are {len(T)} placements and {len(names)} targets.")
    return T, names
