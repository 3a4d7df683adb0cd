"""What rows do to a fit: their leverage, how far they are from what the others say, and the fit without them.

With whitened residuals r and Jacobian J of some rows, the covariance C of all parameters and H = J C J^T, leaving the
rows out lowers the sum of squares by ``q = r^T (I - H)^-1 r`` and moves the parameters by ``C J^T (I - H)^-1 r``,
exactly so where the model is linear (R. D. Cook, S. Weisberg, Residuals and Influence in Regression, 1982). In the
place of many rows a triangle of ``[J r]`` says the same.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, IntArray
from calib.foundations.chance import exceeded
from calib.identification import losses, weights
from calib.identification.fit import Fit
from calib.identification.parameters import scales
from calib.identification.system import Problem, Rates
from calib.measurement.kinds import QUANTITIES
from calib.measurement.measurements import Measurements

# Directions that rows determine alone, to this share, cannot be tested.
ALONE = 1e-4
# A scatter of a nanometre is rounding.
_ROUNDING = 1e-9


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
    """Rows of one set: whitened residuals (n, d), Jacobian (n, d, p) and weights (n,) given by the set's loss."""

    measurements: int
    rows: slice
    r: Array
    J: Array
    w: Array

    @property
    def weighted(self) -> Array:
        """``[J r]`` (n, d, p + 1) as the fit takes it."""
        return np.concatenate([self.J, self.r[:, :, None]], axis=2) * np.sqrt(self.w)[:, None, None]


@dataclass(frozen=True, slots=True, eq=False)
class Residue:
    """A fit as a linear system. Columns of Jacobians are for one parameter scale, as is ``C`` (p, p).

    ``sigma`` (N, d) and ``w`` (N,) of every set: noise and weights of the loss. ``squares`` and ``freedom``: of every
    set, the whitened sum of squares and the degrees of freedom. ``predicted`` (p, p): J^T J of all numbers in m,
    unwhitened and divided by their number. ``files``: what tables are called, by where they came from.
    """

    fit: Fit
    files: Mapping[str, str]
    problem: Problem
    C: Array
    sigma: tuple[Array, ...]
    w: tuple[Array, ...]
    squares: Array
    freedom: Array
    predicted: Array

    @classmethod
    def of(cls, fit: Fit, files: Mapping[str, str]) -> "Residue":
        """Evaluate a fit where it ended."""
        problem = Problem(
            fit.model,
            fit.parameters,
            fit.machine.frames,
            fit.measurements,
            relations=fit.model.relations,
            given_losses=fit.losses,
        )
        variances = [noise.model**2 for noise in fit.noise]
        plain = weights.sigmas_of(problem, variances)
        weighted = weights.sigmas_of(problem, variances, fit.residuals)
        w = tuple((a[:, 0] / b[:, 0]) ** 2 for a, b in zip(plain, weighted, strict=True))
        squares = [
            float(np.sum(own[:, None] * (r / sigma) ** 2)) / losses.shrinkage(loss, r.shape[1])
            for own, r, sigma, loss in zip(w, fit.residuals, plain, fit.losses, strict=True)
        ]
        freedom = [
            sum(noise.degrees_of_freedom for noise in fit.noise if noise.measurements == i)
            for i in range(len(fit.measurements))
        ]
        units = scales(fit.parameters)
        predicted, numbers = np.zeros((len(units), len(units))), 0
        rates = Rates(problem, fit.machine, units)
        for data in fit.measurements:
            in_m = [k for quantity in QUANTITIES[data.kind] if quantity.unit == "m" for k in _range(quantity.columns)]
            for block in rates.blocks(data):
                J = block.J[:, in_m].reshape(-1, len(units))
                predicted += J.T @ J
                numbers += len(J)
        return cls(
            fit,
            files,
            problem,
            fit.covariance_alone / units[:, None] / units,
            plain,
            w,
            np.array(squares),
            np.array(freedom),
            predicted / numbers if numbers else np.full_like(predicted, np.nan),
        )

    def name(self, data: Measurements) -> str:
        """Return what the table of a set is called."""
        return self.files.get(data.where, data.where)

    def blocks(self) -> Iterator[WhitenedRows]:
        """Yield all rows, block by block."""
        rates = Rates(self.problem, self.fit.machine, scales(self.fit.parameters))
        for i, data in enumerate(self.fit.measurements):
            for block in rates.blocks(data):
                sigma = self.sigma[i][block.rows]
                yield WhitenedRows(
                    i, block.rows, block.observed.residual / sigma, block.J / sigma[:, :, None], self.w[i][block.rows]
                )

    def scatter(self, without: Array | float, freedom: Array | float, i: int | None = None) -> Array:
        """Return the variance, as a share of the fit's, that is seen in set i (or in all) when something is left out.

        ``without`` and ``freedom`` (...): by how much that lowers the sum of squares and the degrees of freedom; nan
        where nothing is left.
        """
        chosen = slice(None) if i is None else slice(i, i + 1)
        left = np.asarray(self.freedom[chosen].sum() - freedom, dtype=np.float64)
        least = max((_ROUNDING / float(sigma.min())) ** 2 for sigma in self.sigma[chosen])
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

    def influences(self, steps: Array) -> tuple[IntArray, Array, Array]:
        """Return the influence of rows without which the parameters are off by ``steps`` (n, p), scaled.

        As in :class:`Influence`, all (n,): the number of the parameter that changes most, its change, the prediction's.
        """
        sigmas = np.sqrt(np.maximum(np.diag(self.C), 0.0))
        by_sigma = np.divide(steps, sigmas, out=np.zeros_like(steps), where=sigmas > 0.0)
        k = np.argmax(np.abs(by_sigma), axis=1)
        predicted = np.sqrt(np.maximum(np.sum(steps @ self.predicted * steps, axis=1), 0.0))
        return k, np.take_along_axis(by_sigma, k[:, None], axis=1)[:, 0], predicted

    def influence(self, step: Array) -> Influence:
        """Return the influence of something without which the parameters (p,) are off by ``step``, scaled."""
        (k,), (change,), (prediction,) = self.influences(step[None])
        return Influence(self.fit.parameters[k].name, float(change), float(prediction))


def _range(columns: slice) -> range:
    return range(columns.start, columns.stop)
