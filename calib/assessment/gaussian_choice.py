"""Does a Gaussian process of residuals earn its place? By rows held out, as every model part must."""

from typing import NamedTuple

import numpy as np
import scipy

from calib.assessment.validation import HeldOut, folds, held_out, one_standard_error
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.linear import one_thread
from calib.machine.gaussian import GaussianResiduals, Kernel, in_row_order, likeliest_kernel

# Of more rows so many are looked at: what it costs to judge them grows with the third power of their number.
MOST_JUDGED = 2500


class Bought(NamedTuple):
    """Errors at rows held out, in m: as they are, and less what a process made of the other rows predicts."""

    without: HeldOut
    held_out: HeldOut

    @property
    def enters(self) -> bool:
        """Whether they are smaller by more than one standard error."""
        return one_standard_error([self.without, self.held_out]) == 1


def bought(known: GaussianResiduals, readings: Array, errors: Array, group: IntArray) -> Bought:
    """Return what a process brings, by grouped cross-validation of the rows that it was made of.

    ``readings`` (N, nr), ``errors`` (N, 3), ``group`` (N,): as in :func:`calib.assessment.validation.row_groups`.
    Amplitude, length scales and noise are not learnt anew for every fold: those with which the even folds are judged
    come from the odd ones, and the other way round. Those of all rows would have seen what they are judged by, and
    praise noise. Of more than 2500 rows as many are looked at, the same ones every time: fewer neighbours than the
    process has, so that it seems worse than it is rather than better.

    Raises MeasurementError when all rows are of one group.
    """
    readings, errors = np.asarray(readings, dtype=np.float64), np.asarray(errors, dtype=np.float64)
    points = readings[:, list(known.joints)]
    if len(points) > MOST_JUDGED:
        in_order = np.lexsort(np.column_stack([errors, points]).T)
        some = in_order[np.random.default_rng(0).permutation(len(points))[:MOST_JUDGED]]
        points, errors, group = points[some], errors[some], np.unique(group[some], return_inverse=True)[1]
    fold = folds(group)
    left = np.empty_like(errors)
    for half in (0, 1):
        judged = fold % 2 == half
        with one_thread():
            kernel = likeliest_kernel(*in_row_order(points[~judged], errors[~judged]))
        left[judged] = held_out_errors(kernel, points, errors, fold, judged)
    without, held = (np.sum(np.asarray(rows) ** 2, axis=1) for rows in (errors, left))
    return Bought(held_out(without, group), held_out(held, group))


def held_out_errors(kernel: Kernel, points: Array, errors: Array, fold: IntArray, judged: BoolArray) -> Array:
    """Return what is left (n, 3) of errors in m at points (N, k), less the prediction from rows of other folds.

    Of rows that are ``judged`` (N,), whole folds, in their order. Of one factor: with K of all rows, what is left in
    fold f is ``(K^-1)_ff^-1 (K^-1 y)_f`` (5.10 to 5.12 of Rasmussen and Williams, for more rows than one). With these
    rows last, their part of the inverse is the inverse of their own part of the factor's square.
    """
    order = np.argsort(judged, kind="stable")
    points, errors, fold, first = points[order], errors[order], fold[order], int(np.count_nonzero(~judged))
    with one_thread():
        # Each array is as large as all rows times all rows: where one is no longer needed, the next takes its place.
        factor = scipy.linalg.cholesky(kernel.of_rows(points), lower=True, overwrite_a=True)
        weights = scipy.linalg.cho_solve((factor, True), errors)[first:]
        inverse, _ = scipy.linalg.lapack.dpotri(factor[first:, first:], lower=True)
        inverse += np.tril(inverse, -1).T
        left, own_fold = np.empty_like(weights), fold[first:]
        for k in np.unique(own_fold):
            own = np.flatnonzero(own_fold == k)
            left[own] = np.linalg.solve(inverse[np.ix_(own, own)], weights[own])
    return np.asarray(left)
