"""Rows that repeat a pose err together: what a model leaves out there is the same in all of them.

The whitened residuals of one number have the covariance ``S = w_0 I + w_1 Z``: Z is 1 for two rows of one pose and
0 for others. Squares within poses tell w_0, those of the means of poses w_1, with what the parameters have taken
of them counted in (C. R. Henderson, Estimation of variance and covariance components, Biometrics 9, 1953). Derivatives
hardly differ within a pose, so that nothing of N x N numbers is needed.
"""

from dataclasses import dataclass

import numpy as np

from calib.foundations.arrays import Array, IntArray
from calib.foundations.brief import brief
from calib.foundations.chance import exceeded

# Means of poses scatter more than rows of one pose let expect: less often by chance.
_BY_CHANCE = 0.01
# Of more rows, repeats are not looked at.
MOST_ROWS = 12000
# Rows of a pose that scatter less than this share of all noise are copies.
_COPIES = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """How rows of one pose err, of one quantity of one set: standard deviations of one number, in m or rad.

    ``alone``: of a row by itself; ``common``: of what all rows of a pose have in common. There are so many ``rows``, of
    so many ``poses``.
    """

    __repr__ = brief

    measurements: int
    quantity: str
    alone: float
    common: float
    rows: int
    poses: int


def by_pose(rows: Array, pose: IntArray) -> tuple[Array, IntArray]:
    """Return the sums (P, ...) of rows (N, ...) of each ``pose`` (N,), numbered from 0, and how many these are (P,)."""
    order = np.argsort(pose, kind="stable")
    many = np.bincount(pose)
    return np.asarray(np.add.reduceat(rows[order], np.cumsum(many) - many, axis=0)), many


def repeated(pose: IntArray, r: Array, J: Array, C: Array) -> tuple[float, float] | None:
    """Return w_0 and w_1 of residuals (N, d) with derivatives J (N, d, p), None where poses show no more than rows.

    ``pose`` (N,): numbers from 0. ``C`` (p, p): the covariance of the parameters, all being whitened.
    """
    (n, d), p = r.shape, J.shape[2]
    sums, many = by_pose(r, pose)
    again = d * (n - len(many))
    if not again:
        return None
    within = float(np.sum((r - (sums / many[:, None])[pose]) ** 2))
    between = float(np.sum(sums**2 / many[:, None]))
    if within <= _COPIES * (within + between):
        return None
    w0 = within / again
    means = (by_pose(J, pose)[0] / np.sqrt(many)[:, None, None]).reshape(-1, p)
    weighed = means * np.sqrt(np.repeat(many, d))[:, None]
    H, HK = C @ (means.T @ means), C @ (weighed.T @ weighed)
    # Of H, the hat matrix of the means: its trace, and that of its square; what is left of the noise of other rows and
    # of priors is the difference.
    used, twice = float(np.trace(H)), float(np.sum(H * H.T))
    left = d * len(many) - used
    if left < 1.0 or exceeded(between / w0, round(left), again) > _BY_CHANCE:
        return None
    alone = w0 * (left - used + twice) + used - twice
    common = d * n - 2.0 * float(np.trace(HK)) + float(np.sum(HK * H.T))
    w1 = (between - alone) / common
    return (w0, w1) if w1 > 0.0 else None


def beyond_alone(w0: float, w1: float, pose: IntArray, J: Array) -> Array:
    """Return ``J^T (S - I) J`` (p, p) of derivatives (N, d, p)."""
    p = J.shape[2]
    flat, sums = J.reshape(-1, p), by_pose(J, pose)[0].reshape(-1, p)
    return np.asarray((w0 - 1.0) * (flat.T @ flat) + w1 * (sums.T @ sums))
