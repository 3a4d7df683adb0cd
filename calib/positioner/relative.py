"""Where one machine stands in another's base: points that both touch.

Two robots, or a robot and whatever else says where a point is, in one cell: point n is at a_n by the one and at b_n by
the other, a_n = R b_n + t. The rigid registration is closed: the rotation nearest to the points' cross-covariance.

Source: S. Umeyama, *Least-squares estimation of transformation parameters between two point patterns*, IEEE PAMI 13(4),
1991, without scale.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.chance import shown_noise
from calib.foundations.errors import IdentificationError, MeasurementError
from calib.foundations.ranges import are_numbers, finite, refuse_sigma
from calib.foundations.sealing import sealed

# Points on a line leave a turn about it open; a width below this share of their length is rounding.
_LINE = 1e-7
# Points that are no farther apart, in m, are one.
_APART = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class RelativeBase:
    """Base b in base a. Made by :func:`relative_base`. ``T_a_b`` (4, 4).

    ``covariance`` (6, 6): of a local twist of T_a_b, (v, w), in m and rad. ``residuals`` (N, 3): a minus predicted, in
    a's axes, in m. ``noise``: standard deviation of a coordinate's difference, given or estimated from the residuals.
    """

    __repr__ = brief

    T_a_b: Array
    covariance: Array
    residuals: Array
    noise: float

    @property
    def rms(self) -> float:
        """3D rms of the residuals, in m."""
        return float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=1))))

    @checked
    def sigma_at(self, points_b: npt.ArrayLike) -> Array:
        """Return the expected 3D error (rms, m) of carrying points (N, 3) from b to a, to first order."""
        x = finite(points_b, (None, 3), "the points to carry must be finite numbers (N, 3), in m.")
        J = np.concatenate([np.broadcast_to(np.eye(3), (len(x), 3, 3)), -rigid.skew(x)], axis=2)
        return np.asarray(np.sqrt(np.einsum("nij,jk,nik->n", J, self.covariance, J)))


@checked
def relative_base(
    points_a: npt.ArrayLike,
    points_b: npt.ArrayLike,
    *,
    sigma_a: float | None = None,
    sigma_b: float | None = None,
) -> RelativeBase:
    """Find base b in base a from N points that both touched: ``points_a``, ``points_b`` (N, 3), in m.

    ``sigma_a``, ``sigma_b``: standard deviations of a coordinate, in m; where either is None the noise of their
    difference is estimated from the residuals. Joint readings become points through a calibrated arm:
    :meth:`calib.CalibratedMachine.predict`.

    Raises MeasurementError when the points do not pair, IdentificationError when they lie on a line.
    """
    a, b = (np.asarray(points, dtype=np.float64) for points in (points_a, points_b))
    if a.ndim != 2 or a.shape != b.shape or a.shape[1:] != (3,) or not (are_numbers(a) and are_numbers(b)):
        raise MeasurementError(f"the points must be two sets of as many finite (N, 3); they are {a.shape}, {b.shape}.")
    refuse_sigma(sigma_a, "sigma_a")
    refuse_sigma(sigma_b, "sigma_b")
    centre_a, centre_b = a.mean(axis=0), b.mean(axis=0)
    spread = [np.linalg.svd(points, compute_uv=False) for points in (a - centre_a, b - centre_b)]
    if len(a) < 3 or any(not values[1] > max(_LINE * values[0], _APART) for values in spread):
        raise IdentificationError(
            f"the {len(a)} points lie on a line, and how the bases are turned about it cannot be told; "
            "touch three points or more that do not."
        )
    R = rigid.nearest_rotation((a - centre_a).T @ (b - centre_b))
    T = rigid.placement(R, centre_a - R @ centre_b)
    residuals = a - (b @ R.T + T[:3, 3])
    stated = None if sigma_a is None or sigma_b is None else float(np.hypot(sigma_a, sigma_b))
    noise = shown_noise(residuals, 3 * len(a) - 6, stated)
    J = np.concatenate([np.broadcast_to(np.eye(3), (len(b), 3, 3)), -rigid.skew(b)], axis=2).reshape(-1, 6)
    return RelativeBase(read_only(T), read_only(noise**2 * np.linalg.inv(J.T @ J)), read_only(residuals), noise)
