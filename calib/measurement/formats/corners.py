"""Where corners of a chessboard are in an image, to hundredths of a pixel, and how sure that is.

Two edges cross in a corner, and blur makes a step of each: grey is

    I = m + g . d + c erf(n1 . d / (sqrt(2) s)) erf(n2 . d / (sqrt(2) s))

with d the way from the corner, n1 and n2 across the edges, s the blur, c the contrast, m and g the light. The nine
numbers are fitted to the pixels around a corner by Gauss-Newton; what is left is the noise, of which the covariance of
the corner follows. The corner is where the model has its point of symmetry, which blur and angles leave where it is.
"""

from typing import NamedTuple

import numpy as np
import scipy

from calib.foundations.arrays import Array, BoolArray, read_only

_MOST_STEPS, _SETTLED = 25, 1e-4
# Radius of the pixels that are looked at: less is no corner, more is not one corner. In px.
LEAST_RADIUS, MOST_RADIUS = 3.0, 14.0
# What a fit may come to: so far from where it began, blur, contrast over noise.
_FARTHEST, _LEAST_BLUR, _LEAST_CONTRAST = 2.5, 0.15, 4.0
_FIRST_BLUR = 0.8
# Grey that is cut off at 0 or 255 tells less than it seems to.
_ROUNDING = 12.0**-0.5


class Corners(NamedTuple):
    """Pixels (n, 2) of corners, their standard deviations (n,), blur (n,) in px, and which of them (n,) are good."""

    pixels: Array
    sigma: Array
    blur: Array
    good: BoolArray


def refine(grey: Array, pixels: Array, along: Array, radius: Array) -> Corners:
    """Return corners of an image (h, w), from about where they are (n, 2).

    ``along`` (n, 2, 2): unit directions of the two edges; ``radius`` (n,): of the pixels to be looked at.
    """
    n = len(pixels)
    radius = np.clip(radius, LEAST_RADIUS, MOST_RADIUS)
    at, inside = _window(grey, pixels, radius)
    dx, dy, values, weight = at
    z = _begin(pixels - np.rint(pixels), along, values, weight, dx, dy)
    done = np.zeros(n, dtype=np.bool_)
    for _ in range(_MOST_STEPS):
        model, J = _model(z, dx, dy)
        step, _, _ = _solve(J, values - model, weight)
        # Half a radius is farther than a good start is off; angles and blur do not jump either.
        step[:, :2] = np.clip(step[:, :2], -1.0, 1.0)
        step[:, 2:4] = np.clip(step[:, 2:4], -0.3, 0.3)
        step[:, 4] = np.clip(step[:, 4], -0.4, 0.4)
        z = z + np.where(done[:, None], 0.0, step)
        z[:, 4] = np.clip(z[:, 4], np.log(0.05), np.log(MOST_RADIUS))
        done |= np.abs(step[:, :2]).max(axis=1) < _SETTLED
        if done.all():
            break
    model, J = _model(z, dx, dy)
    _, covariance, noise = _solve(J, values - model, weight)
    found = np.rint(pixels) + z[:, :2]
    sigma = np.sqrt(0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1]))
    blur = np.exp(z[:, 4])
    near = np.linalg.norm(found - pixels, axis=1) < _FARTHEST
    sharp = (blur > _LEAST_BLUR) & (blur < 0.6 * radius) & (np.abs(z[:, 5]) > _LEAST_CONTRAST * noise)
    return Corners(
        read_only(found), read_only(sigma), read_only(blur), inside & near & sharp & done & np.isfinite(sigma)
    )


def _window(grey: Array, pixels: Array, radius: Array) -> tuple[tuple[Array, Array, Array, Array], BoolArray]:
    """Return offsets from the nearest pixel (k,), their grey (n, k) and weights (n, k), and which are in the image."""
    h, w = grey.shape
    reach = int(np.ceil(radius.max(initial=LEAST_RADIUS)))
    side = np.arange(-reach, reach + 1)
    dy, dx = (np.ravel(a).astype(np.float64) for a in np.meshgrid(side, side, indexing="ij"))
    centre = np.rint(pixels).astype(np.intp)
    inside = np.all(centre >= np.ceil(radius)[:, None], axis=1) & np.all(
        centre + np.ceil(radius)[:, None] < (w, h), axis=1
    )
    x = np.clip(centre[:, :1] + dx.astype(np.intp), 0, w - 1)
    y = np.clip(centre[:, 1:] + dy.astype(np.intp), 0, h - 1)
    off = (pixels - centre)[:, :, None]
    apart = np.hypot(dx - off[:, 0], dy - off[:, 1])
    return (dx, dy, grey[y, x].astype(np.float64), (apart <= radius[:, None]).astype(np.float64)), inside


def _begin(off: Array, along: Array, values: Array, weight: Array, dx: Array, dy: Array) -> Array:
    """Return the first values (n, 9): place, angles across the edges, log blur, contrast, grey and its slopes."""
    total = weight.sum(axis=1)
    mean = (weight * values).sum(axis=1) / total
    spread = np.sqrt((weight * (values - mean[:, None]) ** 2).sum(axis=1) / total)
    across = np.arctan2(along[:, :, 0], -along[:, :, 1])
    z = np.zeros((len(off), 9))
    z[:, :2], z[:, 2:4], z[:, 4], z[:, 6] = off, across, np.log(_FIRST_BLUR), mean
    d1 = np.cos(across[:, :1]) * (dx - off[:, :1]) + np.sin(across[:, :1]) * (dy - off[:, 1:])
    d2 = np.cos(across[:, 1:]) * (dx - off[:, :1]) + np.sin(across[:, 1:]) * (dy - off[:, 1:])
    sign = np.sign((weight * (values - mean[:, None]) * np.sign(d1) * np.sign(d2)).sum(axis=1))
    z[:, 5] = np.where(sign < 0.0, -1.0, 1.0) * np.maximum(spread, 1.0)
    return z


def _model(z: Array, dx: Array, dy: Array) -> tuple[Array, Array]:
    """Return the grey (n, k) of corners and its derivatives (n, k, 9)."""
    x, y = dx - z[:, :1], dy - z[:, 1:2]
    s = np.sqrt(2.0) * np.exp(z[:, 4:5])
    c1, s1, c2, s2 = np.cos(z[:, 2:3]), np.sin(z[:, 2:3]), np.cos(z[:, 3:4]), np.sin(z[:, 3:4])
    t1, t2 = (c1 * x + s1 * y) / s, (c2 * x + s2 * y) / s
    e1, e2 = scipy.special.erf(t1), scipy.special.erf(t2)
    b1, b2 = (2.0 / np.sqrt(np.pi) * np.exp(-t * t) for t in (t1, t2))
    c, gx, gy = z[:, 5:6], z[:, 7:8], z[:, 8:9]
    model = z[:, 6:7] + gx * x + gy * y + c * e1 * e2
    p1, p2 = c * b1 * e2, c * e1 * b2
    J = np.stack(
        [
            -(p1 * c1 + p2 * c2) / s - gx,
            -(p1 * s1 + p2 * s2) / s - gy,
            p1 * (c1 * y - s1 * x) / s,
            p2 * (c2 * y - s2 * x) / s,
            -(p1 * t1 + p2 * t2),
            e1 * e2,
            np.ones_like(x),
            x,
            y,
        ],
        axis=2,
    )
    return model, J


def _solve(J: Array, residual: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Return the Gauss-Newton step (n, 9), the covariance (n, 9, 9) of the fit, and the noise (n,), a grey value."""
    weighted = J * weight[:, :, None]
    N = np.swapaxes(weighted, 1, 2) @ J
    # Angles and grey values differ by orders of magnitude.
    unit = 1.0 / np.sqrt(np.maximum(np.einsum("nii->ni", N), 1e-12))
    N = N * unit[:, :, None] * unit[:, None, :] + 1e-9 * np.eye(9)
    inverse = np.linalg.inv(N) * unit[:, :, None] * unit[:, None, :]
    right = np.einsum("nki,nk->ni", weighted, residual)
    count = weight.sum(axis=1)
    variance = (weight * residual**2).sum(axis=1) / np.maximum(count - 9.0, 1.0)
    noise = np.sqrt(np.maximum(variance, _ROUNDING**2))
    return np.einsum("nij,nj->ni", inverse, right), inverse * (noise**2)[:, None, None], noise
