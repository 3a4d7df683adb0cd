"""What rows do to a fit: their leverage, how far they are from what the others say, and the fit without them.

With whitened residuals r and Jacobian J of some rows, the covariance C of all parameters and H = J C J^T, leaving the
rows out lowers the sum of squares by ``q = r^T (I - H)^-1 r`` and moves the parameters by ``C J^T (I - H)^-1 r``,
exactly so where the model is linear (R. D. Cook, S. Weisberg, Residuals and Influence in Regression, 1982). In the
place of many rows a triangle of ``[J r]`` says the same.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, IntArray
from calib.foundations.chance import exceeded
from calib.foundations.sealing import sealed
from calib.identification import losses, weights
from calib.identification.arrow import Covariance, Split
from calib.identification.fit import Fit
from calib.identification.parameters import scales
from calib.identification.rates import Block, Rates
from calib.identification.system import Problem
from calib.measurement.kinds import QUANTITIES
from calib.measurement.measurements import Measurements

# Directions that rows determine alone, to this share, cannot be tested.
ALONE = 1e-4
# Effects that follow the rows are judged by the rows of so many targets.
_MOST_TARGETS = 100
# A scatter of a nanometre is rounding.
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Influence:
    """What becomes of the result without some rows, in one linear step.

    ``parameter``: the one that changes most, by ``change`` of its standard deviations. ``prediction``: rms change, in
    m, of what is predicted of all measured lengths and positions; nan where none are measured.
    """

    parameter: str
    change: float
    prediction: float


class WhitenedRows(NamedTuple):
    """Rows of one set: whitened residuals (n, d), Jacobian (n, d, c + a) and weights (n,) given by the set's loss.

    The columns are those of the common parameters, then those of the row's own ``block`` (n,), -1 for none: a target,
    or what else was eliminated (:mod:`calib.identification.elimination`). Where there are none, a is 0.
    """

    measurements: int
    rows: slice
    r: Array
    J: Array
    block: IntArray
    w: Array

    @property
    def weighted(self) -> Array:
        """``[J r]`` (n, d, c + a + 1) as the fit takes it."""
        return np.concatenate([self.J, self.r[:, :, None]], axis=2) * np.sqrt(self.w)[:, None, None]


class Curvature(NamedTuple):
    """J^T J of some rows: of the common parameters, which targets follow, ``common`` (c, c).

    Of what each block does beside that ``own`` (m, a, a), and of both ``across`` (m, a, c).
    """

    common: Array
    own: Array
    across: Array

    @classmethod
    def none(cls, split: Split) -> "Curvature":
        """Return that of no rows, to which rows are added."""
        (m, a), c = split.blocks.shape, len(split.common)
        return cls(np.zeros((c, c)), np.zeros((m, a, a)), np.zeros((m, a, c)))

    def add(self, J: Array, own: Array, block: IntArray, follow: Array) -> Array:
        """Add rows (n, d, c), and what their blocks (n,) do, (n, d, a); return the rows of targets that ``follow``."""
        there, number = block >= 0, block[block >= 0]
        J = J.copy()
        J[there] += own[there] @ follow[number]
        turned = np.swapaxes(own[there], -1, -2)
        np.add.at(self.own, number, turned @ own[there])
        np.add.at(self.across, number, turned @ J[there])
        flat = J.reshape(-1, J.shape[2])
        np.add(self.common, flat.T @ flat, out=self.common)
        return J

    def of_steps(self, dc: Array, e: Array, block: IntArray) -> Array:
        """Return the sums of squares (n,) of steps (n, c), each with one of its ``block`` (n,) beside, (n, a)."""
        found = np.sum(dc @ self.common * dc, axis=1)
        if e.size:
            found += 2.0 * np.einsum("na,nac,nc->n", e, self.across[block], dc)
            found += np.einsum("na,nab,nb->n", e, self.own[block], e)
        return np.asarray(found)


class SquaresOfSet(NamedTuple):
    """The weighted sum of squares of one set, by how a step changes it.

    ``gradient`` (c,) of the common parameters, which targets follow, ``own_gradient`` (m, a) of what each block does
    beside that, and the ``curvature`` of both.
    """

    gradient: Array
    own_gradient: Array
    curvature: Curvature

    @classmethod
    def of(cls, rows: Iterable[WhitenedRows], covariance: Covariance) -> "SquaresOfSet":
        """Sum over the rows of a set."""
        split, c = covariance.split, len(covariance.split.common)
        found = cls(np.zeros(c), np.zeros(split.blocks.shape), Curvature.none(split))
        for some in rows:
            whole = some.weighted
            own, r = whole[:, :, c:-1], whole[:, :, -1]
            J = found.curvature.add(whole[:, :, :c], own, some.block, covariance.follow)
            there = some.block >= 0
            np.add.at(found.own_gradient, some.block[there], np.einsum("nda,nd->na", own[there], r[there]))
            np.add(found.gradient, J.reshape(-1, c).T @ r.ravel(), out=found.gradient)
        return found

    def change(self, steps: Array, block: IntArray, covariance: Covariance) -> Array:
        """Return by how much the sum grows (n,) with steps (n, c) or (n, c + a), of which each moves one block."""
        dc, e = _beside_following(steps, block, covariance)
        along = dc @ self.gradient
        if e.size:
            along += np.sum(e * self.own_gradient[block], axis=1)
        return 2.0 * along + self.curvature.of_steps(dc, e, block)


@dataclass(frozen=True, eq=False)
@sealed
class Residue:
    """A fit as a linear system. Columns of Jacobians are for one parameter scale, as is the ``covariance``.

    ``sigma`` (N, d) and ``w`` (N,) of every set: noise and weights of the loss. ``squares`` and ``freedom``: of every
    set, the whitened sum of squares and the degrees of freedom. ``predicted``: of all numbers in m, unwhitened and
    divided by their number. ``files``: what tables are called, by where they came from.
    """

    fit: Fit
    files: Mapping[str, str]
    problem: Problem
    covariance: Covariance
    sigma: tuple[Array, ...]
    w: tuple[Array, ...]
    squares: Array
    freedom: Array
    predicted: Curvature

    @classmethod
    def of(cls, fit: Fit, files: Mapping[str, str]) -> "Residue":
        """Evaluate a fit where it ended."""
        known = fit.model.relations, fit.losses
        problem = Problem(
            fit.model, fit.parameters, fit.machine.frames, fit.measurements, None, *known, together=fit.together
        )
        plain = weights.sigmas_of(problem, fit.variances)
        weighted = weights.sigmas_of(problem, fit.variances, fit.residuals)
        w = tuple((a[:, 0] / b[:, 0]) ** 2 for a, b in zip(plain, weighted, strict=True))
        squares = [
            float(np.sum(own[:, None] * problem.whitened(i, slice(None), (r / sigma)[:, :, None])[:, :, 0] ** 2))
            / losses.shrinkage(loss, r.shape[1])
            for i, (own, r, sigma, loss) in enumerate(zip(w, fit.residuals, plain, fit.losses, strict=True))
        ]
        freedom = [
            sum(noise.degrees_of_freedom for noise in fit.noise_by_rows if noise.measurements == i)
            for i in range(len(fit.measurements))
        ]
        units = scales(fit.parameters)
        covariance = fit.spread_alone.scaled(1.0 / units)
        return cls(
            fit,
            files,
            problem,
            covariance,
            plain,
            w,
            np.array(squares),
            np.array(freedom),
            _predicted(fit, problem.rates(fit.machine, units, covariance.split), covariance),
        )

    @property
    def split(self) -> Split:
        """Which parameters are common, and which are of one target each."""
        return self.covariance.split

    @cached_property
    def judged(self) -> IntArray:
        """The parameters by which effects are judged: all, or of very many targets those of some, evenly chosen."""
        m = len(self.split.blocks)
        blocks = np.unique(np.linspace(0, m - 1, min(m, _MOST_TARGETS)).astype(np.intp))
        own = self.split.blocks[blocks]
        return np.sort(np.concatenate([self.split.common, own[own >= 0]]))

    @cached_property
    def C(self) -> Array:
        """The covariance (k, k) of the parameters that are ``judged``."""
        return self.covariance.of(self.judged)

    def name(self, data: Measurements) -> str:
        """Return what the table of a set is called."""
        return self.files.get(data.where, data.where)

    @cached_property
    def _rates(self) -> Rates:
        return self.problem.rates(self.fit.machine, scales(self.fit.parameters), self.split)

    def blocks(self, only: int | None = None) -> Iterator[WhitenedRows]:
        """Yield all rows, or those of one set, block by block, as the fit has them."""
        for i in range(len(self.fit.measurements)) if only is None else [only]:
            for block in self._rates.blocks(self.fit.measurements[i]):
                sigma = self.sigma[i][block.rows]
                J, number = _compact(block)
                whole = np.concatenate([J, block.observed.residual[:, :, None]], axis=2) / sigma[:, :, None]
                whole = self.problem.whitened(i, block.rows, whole)
                yield WhitenedRows(i, block.rows, whole[:, :, -1], whole[:, :, :-1], number, self.w[i][block.rows])

    @cached_property
    def whose(self) -> tuple[IntArray, ...]:
        """The block (N,) of every row of every set, -1 for none."""
        return tuple(
            np.full(len(data), -1, dtype=np.intp) if (own := self._rates.whose(data)) is None else own
            for data in self.fit.measurements
        )

    def scatter(self, without: Array | float, freedom: Array | float, i: int | None = None) -> Array:
        """Return the variance, as a share of the fit's, that is seen in set i (or in all) when something is left out.

        ``without`` and ``freedom`` (...): by how much that lowers the sum of squares and the degrees of freedom; nan
        where nothing is left.
        """
        chosen = slice(None) if i is None else slice(i, i + 1)
        left = np.asarray(self.freedom[chosen].sum() - freedom, dtype=np.float64)
        least = max((ROUNDING / float(sigma.min())) ** 2 for sigma in self.sigma[chosen])
        squares = self.squares[chosen].sum() - without
        share = np.divide(squares, left, out=np.full_like(left, np.nan), where=left > 0.0)
        return np.asarray(np.maximum(share, least))

    def probability(self, q: Array | float, d: IntArray | int, i: int | None = None) -> Array:
        """Return how probable a chi-squared of q or more by d numbers is, against the scatter of set i (or of all).

        ``q`` and ``d`` (...); nan where nothing is tested or left.
        """
        chosen = slice(None) if i is None else slice(i, i + 1)
        left = np.asarray(self.freedom[chosen].sum() - d, dtype=np.float64)
        # With d equal to 0 there is nothing to test.
        tested = (np.asarray(d) > 0) & (left > 0.0)
        return np.where(tested, exceeded(q, np.maximum(d, 1), np.where(tested, left, 1.0)), np.nan)

    def influences(self, steps: Array, block: IntArray) -> tuple[IntArray, Array, Array]:
        """Return the influence of rows without which the parameters are off by ``steps`` (n, c) or (n, c + a), scaled.

        These are the common ones, and those of one ``block`` (n,) each; other targets follow. As in :class:`Influence`,
        all (n,): the number of the parameter that changes most, its change, the prediction's.
        """
        dc, e = _beside_following(steps, block, self.covariance)
        common, of_blocks = self._sigmas
        sigmas = np.broadcast_to(common, dc.shape)
        columns = np.broadcast_to(self.split.common, dc.shape)
        squares = self.predicted.of_steps(dc, e, block)
        if e.size:
            sigmas = np.concatenate([sigmas, np.where(block[:, None] >= 0, of_blocks[block], 0.0)], axis=1)
            columns = np.concatenate([columns, self.split.blocks[block]], axis=1)
        by_sigma = np.divide(steps, sigmas, out=np.zeros_like(steps), where=sigmas > 0.0)
        k = np.argmax(np.abs(by_sigma), axis=1)[:, None]
        change = np.take_along_axis(by_sigma, k, axis=1)[:, 0]
        return np.take_along_axis(columns, k, axis=1)[:, 0], change, np.sqrt(np.maximum(squares, 0.0))

    @cached_property
    def _sigmas(self) -> tuple[Array, Array]:
        common, of_blocks = self.split.parts(np.sqrt(np.maximum(self.covariance.variances, 0.0)))
        return common, of_blocks

    def influence(self, step: Array, blocks: IntArray) -> Influence:
        """Return the influence of something without which parameters are off by ``step`` (k,), scaled.

        These are the common ones, and those of ``blocks`` (n,); other targets follow.
        """
        split, c = self.split, len(self.split.common)
        real, dc = split.real[blocks], step[:c]
        own = np.zeros(real.shape)
        own[real] = step[c:]
        e = own - self.covariance.follow[blocks] @ dc
        square = float(dc @ self.predicted.common @ dc)
        square += 2.0 * float(np.einsum("na,nac,c->", e, self.predicted.across[blocks], dc))
        square += float(np.einsum("na,nab,nb->", e, self.predicted.own[blocks], e))
        common, of_blocks = self._sigmas
        sigmas = np.concatenate([common, of_blocks[blocks][real]])
        by_sigma = np.divide(step, sigmas, out=np.zeros_like(step), where=sigmas > 0.0)
        k = int(np.argmax(np.abs(by_sigma)))
        number = np.concatenate([split.common, split.blocks[blocks][real]])[k]
        return Influence(self.fit.parameters[number].name, float(by_sigma[k]), float(np.sqrt(np.maximum(square, 0.0))))


def _compact(block: Block) -> tuple[Array, IntArray]:
    """Return the Jacobian (n, d, c + a) of a block of rows with the columns of each row's own target, and whose."""
    if block.own is None or block.block is None:
        return block.J, np.full(len(block.J), -1, dtype=np.intp)
    return np.concatenate([block.J, block.own], axis=2), block.block


def _beside_following(steps: Array, block: IntArray, covariance: Covariance) -> tuple[Array, Array]:
    """Return steps (n, c) of the common parameters, and what each target moves beside following them, (n, a)."""
    c = len(covariance.split.common)
    dc, own = steps[:, :c], steps[:, c:]
    if not own.size:
        return dc, own
    e = own - (covariance.follow[block] @ dc[:, :, None])[:, :, 0]
    e[block < 0] = 0.0
    return dc, e


def _predicted(fit: Fit, rates: Rates, covariance: Covariance) -> Curvature:
    found, numbers = Curvature.none(covariance.split), 0
    for data in fit.measurements:
        in_m = [k for quantity in QUANTITIES[data.kind] if quantity.unit == "m" for k in _range(quantity.columns)]
        for block in rates.blocks(data):
            J, number = _compact(block)
            c = block.J.shape[2]
            found.add(J[:, in_m, :c], J[:, in_m, c:], number, covariance.follow)
            numbers += len(J) * len(in_m)
    return Curvature(*(part / numbers if numbers else np.full_like(part, np.nan) for part in found))


def _range(columns: slice) -> range:
    return range(columns.start, columns.stop)
