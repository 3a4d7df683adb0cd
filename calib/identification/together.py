"""Rows of one photograph err together: an arm that does not repeat moves all marks of a photograph at once.

The marks of a board are found to hundredths of a pixel, and a small arm comes back to a tenth of a millimetre: a pixel
or less, but the same for all marks of a photograph. As noise of each mark by itself it would count as if the mean over
the marks were free of it, and parameters would follow it. So the tool is off by a small twist in every photograph, of
unknown standard deviations, one of its lengths and one of its angles:

    C = sigma^2 + U diag(a^2, a^2, a^2, b^2, b^2, b^2) U^T

with U the derivatives of a photograph's rows by the tool's local twist. Sigma, a and b are the likeliest ones, all
parameters integrated out (restricted maximum likelihood: H. D. Patterson, R. Thompson, Recovery of inter-block
information when block sizes are unequal, Biometrika 58, 1971). Rows are then whitened by C: of what they have in common
a share is taken off, and every row stays its own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import chdtri

from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.brief import brief
from calib.foundations.linear import triangle

# That much likelier by chance: not once in as many fits as anybody makes.
_RARELY = 1e-6
# Where the search for a and b begins, in m and rad, and within which factors of that it looks.
_LENGTH, _ANGLE, _RANGE = 1e-4, 3e-4, 1e3
# Sets of fewer photographs tell nothing of it.
FEWEST = 6


@dataclass(frozen=True, slots=True, eq=False)
class Together:
    """How the rows of one set err together, photograph by photograph.

    ``length`` and ``angle``: a in m and b in rad; ``variance``: beyond the instrument's, of every row by itself;
    ``common``: that of one number, in px^2, as the twists have it on average. ``number`` (N,): the photograph of every
    row. ``directions`` (N, d, 6) and ``share`` (m, 6): of the whitened rows of a photograph, what they have in common,
    and what is taken off it.
    """

    __repr__ = brief

    length: float
    angle: float
    variance: float
    common: float
    number: IntArray
    directions: Array
    share: Array

    @classmethod
    def of(
        cls, length: float, angle: float, variance: float, number: IntArray, by_twist: Array, sigma: Array
    ) -> "Together":
        """Return it from derivatives by the tool's twist (N, d, 6) and sigmas (N, d) of the rows by themselves."""
        widths = np.repeat([length, angle], 3)
        moved = by_twist * widths
        directions, share = np.zeros_like(moved), np.zeros((int(number.max()) + 1, 6))
        for k, rows in _photographs(number):
            U, s, _ = np.linalg.svd((moved[rows] / sigma[rows][:, :, None]).reshape(-1, 6), full_matrices=False)
            # A photograph of one or two marks has fewer numbers than a twist.
            directions[rows, :, : len(s)] = U.reshape(len(rows), -1, len(s))
            share[k, : len(s)] = 1.0 - 1.0 / np.sqrt(1.0 + s**2)
        common = float(np.mean(np.sum(moved**2, axis=2)))
        return cls(length, angle, variance, common, number, read_only(directions), read_only(share))

    def less(self, whitened: Array, rows: slice = slice(None)) -> Array:
        """Return whitened rows (n, d, k) of whole photographs without the share of what they have in common."""
        found, U = whitened.copy(), self.directions[rows]
        for k, own in _photographs(self.number[rows]):
            V = U[own].reshape(-1, 6)
            of = whitened[own].reshape(len(V), -1)
            found[own] -= (V @ (self.share[k][:, None] * (V.T @ of))).reshape(len(own), *whitened.shape[1:])
        return found

    def by_photograph(self, whitened: Array) -> Array:
        """Return of whitened rows (n, d, k), or of what :meth:`less` makes of them, what rows have in common (m, 6, k).

        These are six numbers of each photograph, each of its own noise.
        """
        found = np.zeros((len(self.share), 6, whitened.shape[2]))
        np.add.at(found, self.number, np.einsum("ndj,ndk->njk", self.directions, whitened))
        return found

    def drawn(self, rows: IntArray, draw: IntArray) -> "Together":
        """Return it for rows (n,) of whole photographs, by the ``draw`` (n,) of each: drawn twice, they are two."""
        kinds, number = np.unique(np.column_stack([draw, self.number[rows]]), axis=0, return_inverse=True)
        return replace(
            self,
            number=np.asarray(number.ravel(), dtype=np.intp),
            directions=read_only(self.directions[rows]),
            share=read_only(self.share[kinds[:, 1]]),
        )


def _photographs(number: IntArray) -> Iterator[tuple[int, IntArray]]:
    """Yield the number of each photograph, and its rows."""
    order = np.argsort(number, kind="stable")
    kinds, starts = np.unique(number[order], return_index=True)
    yield from zip(kinds.tolist(), np.split(order, starts[1:]), strict=True)


class _Heads(NamedTuple):
    """Of all photographs the rows that a twist moves: ``R`` (m, 6, 6) by it, ``B`` (m, 6, p + 1) ``[J r]``; the rest.

    ``rest`` (q, p + 1): a triangle of what no twist moves.
    """

    R: Array
    B: Array
    rest: Array


def likeliest(
    number: IntArray, by_twist: Array, J: Array, r: Array, instrument: Array, known: Array
) -> tuple[float, float, float] | None:
    """Return a in m, b in rad and the variance of rows beyond the instrument's, None where nothing errs together.

    ``J`` (N, d, p), scaled, ``r`` (N, d), at a solution, and ``instrument`` (N, d) of the rows; ``known`` (l, p + 1):
    ``[J r]`` of all that is known beside them, whitened.
    """
    variance = 0.0
    for _ in range(3):
        sigma = np.sqrt(instrument**2 + variance)
        if not np.all(sigma > 0.0):
            sigma = np.full_like(sigma, float(np.sqrt(np.mean(r**2))) or 1.0)
        heads, count = _heads(number, by_twist, J, r, sigma)
        if not count:  # no photograph has more numbers than a twist
            return None
        found = _widths(heads, known)
        if found is None:
            return None
        a, b, left, used = found
        freedom = count - used
        if freedom <= 0.0:
            return None
        # Of what no twist moves: as large as its own degrees of freedom.
        factor = left / freedom
        variance = max(float(np.mean(sigma**2)) * factor - float(np.mean(instrument**2)), 0.0)
    return a, b, variance


def _heads(number: IntArray, by_twist: Array, J: Array, r: Array, sigma: Array) -> tuple[_Heads, int]:
    Rs, Bs, rest, count = [], [], np.zeros((0, J.shape[2] + 1)), 0
    for _, rows in _photographs(number):
        s = sigma[rows][:, :, None]
        U = (by_twist[rows] / s).reshape(-1, 6)
        of = np.concatenate([J[rows], r[rows][:, :, None]], axis=2) / s
        of = of.reshape(len(U), -1)
        if len(U) <= 6:
            continue
        Q, R = np.linalg.qr(U, mode="complete")
        turned = Q.T @ of
        Rs.append(R[:6])
        Bs.append(turned[:6])
        rest = triangle(np.concatenate([rest, turned[6:]]))
        count += len(U) - 6
    return _Heads(np.array(Rs), np.array(Bs), rest), count


def _widths(heads: _Heads, known: Array) -> tuple[float, float, float, float] | None:
    """Return the likeliest a and b, the square of what is left of the rest there, and how much of it is used up."""
    p = known.shape[1] - 1
    fixed = heads.rest.T @ heads.rest + known.T @ known
    ridge = 1e-12 * np.trace(fixed[:p, :p]) / max(p, 1)

    def system(a: float, b: float) -> tuple[float, Array, Array]:
        widths = np.repeat([a, b], 3)
        moved = heads.R * widths
        lower = np.linalg.cholesky(np.eye(6) + moved @ np.swapaxes(moved, 1, 2))
        whitened = np.linalg.solve(lower, heads.B).reshape(-1, p + 1)
        gram = fixed + whitened.T @ whitened
        H = gram[:p, :p] + ridge * np.eye(p)
        x = -np.linalg.solve(H, gram[:p, p])
        logs = 2.0 * float(np.sum(np.log(np.diagonal(lower, axis1=1, axis2=2)))) + float(np.linalg.slogdet(H)[1])
        return logs + float(gram[p, p] + gram[:p, p] @ x), H, x

    def cost(theta: Array) -> float:
        return system(_LENGTH * float(np.exp(theta[0])), _ANGLE * float(np.exp(theta[1])))[0]

    limit = float(np.log(_RANGE))
    start = min((cost(np.array(at)), at) for at in ((-5.0, -5.0), (-2.0, -2.0), (0.0, 0.0), (1.0, 1.0)))[1]
    best = minimize(cost, np.array(start), method="L-BFGS-B", bounds=[(-limit, limit)] * 2)
    if cost(np.array([-30.0, -30.0])) - float(best.fun) < float(chdtri(2.0, _RARELY)):
        return None
    a, b = _LENGTH * float(np.exp(best.x[0])), _ANGLE * float(np.exp(best.x[1]))
    _, H, x = system(a, b)
    left = heads.rest @ np.append(x, 1.0)
    used = float(np.trace(np.linalg.solve(H, heads.rest[:, :p].T @ heads.rest[:, :p])))
    return a, b, float(left @ left), used


def variances_of(models: Sequence[float], sets: Sequence[int], found: Sequence["Together | None"]) -> list[float]:
    """Return the variance of rows by themselves beyond the instrument's, of every component, of the model's sigmas.

    ``sets``: the set of every component.
    """
    return [
        model**2 if not found or (own := found[i]) is None else own.variance
        for model, i in zip(models, sets, strict=True)
    ]
