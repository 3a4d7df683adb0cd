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
import scipy

from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.brief import brief
from calib.foundations.linear import svd, triangle
from calib.foundations.sealing import sealed
from calib.identification.arrow import Arrow, Collected, Heads, Inverse, Part, Split, gathered

# That much likelier by chance: not once in as many fits as anybody makes.
_RARELY = 1e-6
# Where the search for a and b begins, in m and rad, and within which factors of that it looks.
_LENGTH, _ANGLE, _RANGE = 1e-4, 3e-4, 1e3
# No arm comes back as badly as that, in m and rad: its readings are not those of the photographs, and weights by such
# twists would let go of all that photographs say.
_MOST_LENGTH, _MOST_ANGLE = 0.01, 0.1
# Costs are the same within rounding, where a search ends; or where it is level.
_SAME, _LEVEL, _MOST_STEPS = 1e-14, 1e-5, 300
# What nothing tells is held by this share of what rows tell.
_RIDGE = 1e-6
# Sets of fewer photographs tell nothing of it.
FEWEST = 6


@dataclass(frozen=True, slots=True, eq=False)
@sealed
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
            U, s, _ = svd((moved[rows] / sigma[rows][:, :, None]).reshape(-1, 6), full_matrices=False)
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


class PhotographRows(NamedTuple):
    """Rows of one set: derivatives ``J`` (N, d, c) by common parameters, scaled, and by the tool's twist (N, d, 6).

    ``own`` (N, d, a): derivatives by the parameters of the row's ``block`` (N,), -1 for none. ``residual`` (N, d).
    """

    J: Array
    own: Array
    block: IntArray
    by_twist: Array
    residual: Array


class _Heads(NamedTuple):
    """Of all photographs the rows that a twist moves, and the rest.

    ``R`` (m, 6, 6) by the twist; ``rows`` (m, 6, a + c + 1) ``[B C r]``, and the ``block`` (m,) that each is about.
    ``rest``: what no twist moves.
    """

    R: Array
    rows: Array
    block: IntArray
    rest: Part

    def part(self, rows: Array) -> Part:
        """Return some rows (m, k, a + c + 1) of the photographs, not reduced."""
        a, seen = self.rest.split.blocks.shape[1], self.block >= 0
        left = rows[~seen, :, a:]
        return Part(self.rest.split, Heads(self.block[seen], rows[seen]), left.reshape(-1, left.shape[2]))


def likeliest(
    number: IntArray, rows: PhotographRows, instrument: Array, known: Arrow
) -> tuple[float, float, float] | None:
    """Return a in m, b in rad and the variance of rows beyond the instrument's, None where nothing errs together.

    ``rows`` at a solution, of photographs by ``number`` (N,), with the sigmas of the ``instrument`` (N, d); ``known``:
    all that is known beside them, whitened. All of one photograph are about one block at most. What takes time and
    memory grows with rows and blocks, not with all that is unknown.
    """
    variance = 0.0
    for _ in range(3):
        sigma = np.sqrt(instrument**2 + variance)
        if not np.all(sigma > 0.0):
            sigma = np.full_like(sigma, float(np.sqrt(np.mean(rows.residual**2))) or 1.0)
        heads, count = _heads(number, rows, sigma, known.split)
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
        before, variance = variance, max(float(np.mean(sigma**2)) * factor - float(np.mean(instrument**2)), 0.0)
        if variance == before:
            break
    return a, b, variance


def _heads(number: IntArray, rows: PhotographRows, sigma: Array, split: Split) -> tuple[_Heads, int]:
    """Return the heads of photographs with more numbers than a twist, and how many numbers no twist moves."""
    Rs, heads, blocks, rest, count = [], [], [], [], 0
    for _, own in _photographs(number):
        s = sigma[own][:, :, None]
        columns = [rows.by_twist[own], rows.own[own], rows.J[own], rows.residual[own][:, :, None]]
        whole = (np.concatenate(columns, axis=2) / s).reshape(s.size, -1)
        if len(whole) <= 6:
            continue
        turned = triangle(whole)
        Rs.append(turned[:6, :6])
        heads.append(turned[:6, 6:])
        blocks.append(rows.block[own[0]])
        rest.append(turned[6:, 6:])
        count += len(whole) - 6
    block = np.array(blocks, dtype=np.intp)
    if not Rs:
        return _Heads(np.zeros((0, 6, 6)), np.zeros((0, 6, 0)), block, _reduced(split, [], block)), 0
    return _Heads(np.array(Rs), np.array(heads), block, _reduced(split, rest, block)), count


def _reduced(split: Split, rows: Sequence[Array], block: IntArray) -> Part:
    """Return rows (n, a + c + 1) of photographs, each about its block, reduced."""
    (m, a), c = split.blocks.shape, len(split.common)
    found = Collected(np.arange(m), m, a, c)
    if len(rows):
        whole = np.concatenate(rows)[:, None]
        found.add(whole[:, :, a:], whole[:, :, :a] if m else None, np.repeat(block, [len(own) for own in rows]))
    return Part(split, found.heads, found.rest)


def _widths(heads: _Heads, known: Arrow) -> tuple[float, float, float, float] | None:
    """Return the likeliest a and b, the square of what is left of the rest there, and how much of it is used up."""
    criterion = _Criterion.of(heads, known)
    limit = float(np.log(_RANGE))
    start = min((criterion(np.array(at))[0], at) for at in ((-5.0, -5.0), (-2.0, -2.0), (0.0, 0.0), (1.0, 1.0)))[1]

    def cost(theta: Array) -> tuple[float, Array]:
        return criterion(theta)

    best = scipy.optimize.minimize(
        cost,
        np.array(start, dtype=np.float64),
        jac=True,
        method="L-BFGS-B",
        bounds=[(-limit, limit)] * 2,
        options={"maxiter": _MOST_STEPS, "ftol": _SAME, "gtol": _LEVEL},
    )
    if criterion(np.array([-30.0, -30.0]))[0] - float(best.fun) < float(scipy.special.chdtri(2.0, _RARELY)):
        return None
    a, b = _sizes(best.x)
    if a > _MOST_LENGTH or b > _MOST_ANGLE:
        return None
    inverse = criterion.at(a, b)[0]
    return a, b, heads.rest.after(inverse.step), inverse.used(heads.rest)


def _sizes(theta: Array) -> tuple[float, float]:
    return _LENGTH * float(np.exp(theta[0])), _ANGLE * float(np.exp(theta[1]))


class _Criterion(NamedTuple):
    """Twice the negative logarithm of the restricted likelihood of a and b, but for a constant, with its gradient.

    ``fixed``: what no twist moves, with all that is known, and a ridge that keeps what nothing tells finite.
    """

    heads: _Heads
    fixed: Arrow

    @classmethod
    def of(cls, heads: _Heads, known: Arrow) -> "_Criterion":
        """Return it with a ridge that is negligible beside the rows."""
        split = known.split
        fixed = _with(known, heads.rest)
        ridge = np.full(split.size, _RIDGE * float(np.sqrt(np.mean(fixed.lengths**2))) if split.size else 0.0)
        held = Arrow.empty(split).held(ridge, np.zeros(split.size))
        fixed = _with(fixed, Part(split, Heads(np.arange(len(held.heads)), held.heads), held.rest))
        return cls(heads, Arrow(split, fixed.heads, triangle(fixed.rest)))

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Return the criterion and its gradient (2,) by logarithms of a and b, in the sizes that searches begin at."""
        a, b = _sizes(theta)
        inverse, whitened, moved, logs = self.at(a, b)
        # Of V = I + R diag(a^2, b^2) R^T, whitened by its triangle L: dV = 2 a^2 R E R^T dlog(a).
        by_twist = np.swapaxes(moved, 1, 2) @ whitened
        slope = []
        for size, axes in ((a, slice(0, 3)), (b, slice(3, 6))):
            part = self.heads.part(by_twist[:, axes])
            taken = inverse.used(part) + part.after(inverse.step)
            slope.append(2.0 * size**2 * (float(np.sum(moved[:, :, axes] ** 2)) - taken))
        reduced, c = inverse.reduced, len(inverse.split.common)
        rest = triangle(reduced.rest)
        own = reduced.singular_values[np.isfinite(reduced.singular_values)]
        logs += 2.0 * float(np.sum(np.log(own)) + np.sum(np.log(np.abs(np.diag(rest[:, :c])))))
        left = rest @ np.append(inverse.step[inverse.split.common], 1.0)
        return logs + float(left @ left), np.array(slope)

    def at(self, a: float, b: float) -> tuple[Inverse, Array, Array, float]:
        """Return the solution with photographs weighed by a and b; their rows, and R, so whitened; and log det V."""
        widths = np.repeat([a, b], 3)
        R, rows = self.heads.R, self.heads.rows
        # The triangle of V, without forming it: of marks at a camera's own plane it would not be positive in numbers.
        eye = np.broadcast_to(np.eye(6), R.shape)
        upper = triangle(np.concatenate([eye, np.swapaxes(R * widths, 1, 2)], axis=1))
        lower = np.swapaxes(upper, 1, 2)
        both = np.linalg.solve(lower, np.concatenate([R, rows], axis=2))
        moved, whitened = both[:, :, :6], both[:, :, 6:]
        whole = _with(self.fixed, _reduced(self.fixed.split, list(whitened), self.heads.block))
        logs = 2.0 * float(np.sum(np.log(np.abs(np.diagonal(lower, axis1=1, axis2=2)))))
        return Inverse.of(whole), whitened, moved, logs


def _with(rows: Arrow, more: Part) -> Arrow:
    """Return rows, as many of each block as it has columns, with more of them."""
    heads = [Heads(np.arange(len(rows.heads)), rows.heads), more.heads]
    return gathered(rows.split, heads, [rows.rest, more.rest])


def variances_of(models: Sequence[float], sets: Sequence[int], found: Sequence["Together | None"]) -> list[float]:
    """Return the variance of rows by themselves beyond the instrument's, of every component, of the model's sigmas.

    ``sets``: the set of every component.
    """
    return [
        model**2 if not found or (own := found[i]) is None else own.variance
        for model, i in zip(models, sets, strict=True)
    ]
