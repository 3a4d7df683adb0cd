"""The parallelogram of a palletiser-like arm in closed form: a planar four-bar, exactly and to first order.

In the plane of the lower arm, angles from x towards y: lower arm ``phi2`` (length L2), crank ``psi`` (b), rod ``gamma``
(c) and rear lever ``phi`` (e), which is rigid with the forearm. With ``u(t) = (cos t, sin t)`` the loop

    L2 u(phi2) + e u(phi) = b u(psi) + c u(gamma)

is nominally a parallelogram: c = L2, e = b, phi = psi. Of all its lengths only two combinations show in phi, to first
order: ``k1 = (dL2 - dc)/r`` and ``k2 = (de - db)/r``, r the nominal crank; beside them ``k0``, which is a zero offset.
Source: Guo, Yin, Ren, Zhu, Yang, Ye: the multilevel calibration of the ABB IRB2400 (2015), derived anew.

Angles in rad, lengths in any one unit; arrays broadcast.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import PoseError

# Below this |sin(alpha)| the links are in line, and phi follows no length.
_DEAD_CENTRE = 1e-9


class FourBarAngles(NamedTuple):
    """Angles (N) of the rear lever, ``phi``, and of the rod, ``gamma``, in rad."""

    phi: Array
    gamma: Array


class FourBarPartials(NamedTuple):
    """Partial derivatives (N) of phi: by the four lengths (rad per unit of length), then by the two driven angles."""

    L2: Array
    b: Array
    c: Array
    e: Array
    psi: Array
    phi2: Array


@dataclass(frozen=True, slots=True, eq=False)
class ParallelogramFit:
    """The linear form ``phi - psi = k0 + k1 csc(alpha) + k2 cot(alpha)`` of measured deviations, in rad.

    ``dx`` and ``dy``: how far the crank's shaft is off that of the lower arm, in the unit of the radius; None where
    they were not asked for. ``sigmas`` (3 or 5): standard deviations, in this order, from the residuals; infinite where
    there are no more rows than numbers. ``rms``: of the residuals, in rad. ``condition``: of the regressor, dx and dy
    counted in radii.
    """

    k0: float
    k1: float
    k2: float
    dx: float | None
    dy: float | None
    sigmas: Array
    rms: float
    condition: float


def four_bar(psi: npt.ArrayLike, phi2: npt.ArrayLike, *, L2: float, b: float, c: float, e: float) -> FourBarAngles:
    """Return the angles of rear lever and rod at crank angles psi (N) and lower arm angles phi2 (N).

    The branch is the parallelogram's, and phi lies within half a turn of psi.
    Raises PoseError naming the first row where the links do not reach or lie in line.
    """
    psi, phi2 = np.broadcast_arrays(np.asarray(psi, dtype=np.float64), np.asarray(phi2, dtype=np.float64))
    x = b * np.cos(psi) - L2 * np.cos(phi2)
    y = b * np.sin(psi) - L2 * np.sin(phi2)
    s = np.hypot(x, y)
    alpha = psi - phi2
    _refuse(np.abs(np.sin(alpha)) < _DEAD_CENTRE, "is at a dead centre: its joints may go two ways")
    # The triangle of rod, rear lever and s = |D|: cos of its angle at the elbow.
    cosine = (s**2 + e**2 - c**2) / (2.0 * e * s)
    _refuse(np.abs(cosine) > 1.0, "cannot close: its links do not reach")
    phi = np.arctan2(y, x) - np.sign(np.sin(alpha)) * np.arccos(cosine)
    phi = psi + _half_turn(phi - psi)
    gamma = np.arctan2(e * np.sin(phi) - y, e * np.cos(phi) - x)
    return FourBarAngles(read_only(phi), read_only(gamma))


def four_bar_partials(
    psi: npt.ArrayLike, phi2: npt.ArrayLike, *, L2: float, b: float, c: float, e: float
) -> FourBarPartials:
    """Return the exact partial derivatives of phi at crank angles psi (N) and lower arm angles phi2 (N).

    Raises PoseError as four_bar does.
    """
    psi, phi2 = np.broadcast_arrays(np.asarray(psi, dtype=np.float64), np.asarray(phi2, dtype=np.float64))
    phi, gamma = four_bar(psi, phi2, L2=L2, b=b, c=c, e=e)
    S = e * np.sin(gamma - phi)
    return FourBarPartials(
        L2=read_only(-np.cos(phi2 - gamma) / S),
        b=read_only(np.cos(psi - gamma) / S),
        c=read_only(1.0 / S),
        e=read_only(-np.cos(phi - gamma) / S),
        psi=read_only(b * np.sin(gamma - psi) / S),
        phi2=read_only(-L2 * np.sin(gamma - phi2) / S),
    )


def parallelogram_regressor(psi: npt.ArrayLike, phi2: npt.ArrayLike, *, radius: float, coaxial: bool = False) -> Array:
    """Return the matrix (N, 3) of ``phi - psi`` per (k0, k1, k2), or (N, 5) per (k0, k1, k2, dx, dy).

    Rows are 1, csc(alpha), cot(alpha) at alpha = psi - phi2, and with ``coaxial`` also the effect of a crank whose
    shaft is (dx, dy) off that of the lower arm: -cos(phi2) and -sin(phi2) over ``radius`` sin(alpha). ``radius`` is the
    nominal length of crank and rear lever, in the unit of dx and dy.
    Raises PoseError naming the first row where the links lie in line.
    """
    psi, phi2 = np.broadcast_arrays(np.asarray(psi, dtype=np.float64), np.asarray(phi2, dtype=np.float64))
    alpha = psi - phi2
    sine = np.sin(alpha)
    _refuse(np.abs(sine) < _DEAD_CENTRE, "is at a dead centre: its joints may go two ways")
    columns = [np.ones_like(sine), 1.0 / sine, np.cos(alpha) / sine]
    if coaxial:
        columns += [-np.cos(phi2) / (radius * sine), -np.sin(phi2) / (radius * sine)]
    return read_only(np.stack(columns, axis=-1))


def fit_parallelogram(
    psi: npt.ArrayLike, phi2: npt.ArrayLike, deviation: npt.ArrayLike, *, radius: float = 1.0, coaxial: bool = False
) -> ParallelogramFit:
    """Fit the linear form to measured deviations phi - psi (N), in rad, at angles psi (N) and phi2 (N).

    Where ``coaxial``, dx and dy come in the unit of ``radius``. Raises ValueError when the rows do not determine the
    numbers, PoseError as parallelogram_regressor does.
    """
    observed = np.atleast_1d(np.asarray(deviation, dtype=np.float64))
    scaled = np.atleast_2d(parallelogram_regressor(psi, phi2, radius=1.0, coaxial=coaxial))
    values, _, rank, singular = np.linalg.lstsq(scaled, observed, rcond=None)
    rows, columns = scaled.shape
    if rank < columns:
        raise ValueError(f"{rows} rows determine {rank} of {columns} numbers; more angles alpha are needed.")
    residual = observed - scaled @ values
    variance = float(residual @ residual) / (rows - columns) if rows > columns else np.inf
    units = np.array([1.0, 1.0, 1.0, radius, radius])[:columns]
    sigmas = units * np.sqrt(variance * np.diag(np.linalg.inv(scaled.T @ scaled)))
    values = units * values
    return ParallelogramFit(
        k0=float(values[0]),
        k1=float(values[1]),
        k2=float(values[2]),
        dx=float(values[3]) if coaxial else None,
        dy=float(values[4]) if coaxial else None,
        sigmas=read_only(sigmas),
        rms=float(np.sqrt(np.mean(residual**2))),
        condition=float(singular[0] / singular[-1]),
    )


def visible_combinations(*, dL2: float, db: float, dc: float, de: float, radius: float) -> tuple[float, float]:
    """Return (k1, k2) = ((dL2 - dc)/r, (de - db)/r): all that errors of the four lengths do to phi, to first order."""
    return (dL2 - dc) / radius, (de - db) / radius


def _half_turn(angle: Array) -> Array:
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))


def _refuse(rows: npt.NDArray[np.bool_], why: str) -> None:
    if np.any(rows):
        raise PoseError(int(np.argmax(rows)), f"the parallelogram {why}")
