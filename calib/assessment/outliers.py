"""Which rows, targets and groups do not go with the rest, and what becomes of a calibration without them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.assessment.disagreement import Jump, OutlyingGroup, groups_of, jumps_of
from calib.assessment.influence import ALONE, Influence, Residue, SquaresOfSet, WhitenedRows
from calib.foundations import linear
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray
from calib.foundations.brief import brief
from calib.identification.fit import Fit
from calib.measurement.kinds import WITH_TARGET

# What is found by chance in one of a hundred calibrations is told.
LEVEL = 0.01
# Of more rows only these, the least likely, are kept: all others are quite ordinary.
_MOST_ROWS = 10_000


@dataclass(frozen=True, slots=True)
class OutlyingRow:
    """One row, in ``line`` of ``file``; ``target`` is None for kinds that have none.

    ``leverage``: share of its numbers that the fit follows, from 0 to 1. ``studentised``: distance of its d numbers
    from what the other rows say, in the standard deviations that these show and over sqrt(d): about 1 for an ordinary
    row. ``p``: probability of as much in an ordinary row; ``chance``: of one such row among all, at most. They are nan
    for a row that alone determines something and leaves nothing to be tested.
    """

    file: str
    line: int
    target: str | None
    leverage: float
    studentised: float
    p: float
    chance: float
    without: Influence


@dataclass(frozen=True, slots=True)
class Outliers:
    """Rows, jumps of targets, and groups, each the least likely first. Made by :func:`calib.judging.outliers`."""

    __repr__ = brief

    rows: tuple[OutlyingRow, ...]
    jumps: tuple[Jump, ...]
    groups: tuple[OutlyingGroup, ...]

    @property
    def outlying(self) -> tuple[OutlyingRow, ...]:
        """Rows that are no accident."""
        return tuple(row for row in self.rows if row.chance < LEVEL)

    @property
    def moved(self) -> tuple[Jump, ...]:
        """Jumps that are no accident, and not the work of one row of the target."""
        worst: dict[str | None, float] = {}
        for row in self.rows:
            worst[row.target] = min(worst.get(row.target, 1.0), _or_one(row.p))
        return tuple(jump for jump in self.jumps if jump.is_told(LEVEL) and jump.p < worst[jump.target])

    @property
    def disagreeing(self) -> tuple[OutlyingGroup, ...]:
        """Groups whose disagreement with the rest is no accident."""
        return tuple(group for group in self.groups if group.chance < LEVEL)


@checked
def outliers(fit: Fit, *, files: Mapping[str, str] | None = None) -> Outliers:
    """Return rows, targets and groups of a fit, and how the fit changes without them, the least likely first.

    Of more than ten thousand rows the least likely are returned.


    ``files``: names for the tables, by where they came from; None for no other names.

    A row is judged by the multivariate form of the externally studentised residual, F distributed by its d numbers and
    the degrees of freedom of the others of its set. A row that a robust loss gives a weight below 1 is judged as a new
    one would be. Jumps and groups: :mod:`calib.assessment.disagreement`. One linear step each: nothing is fitted anew.
    """
    with linear.one_thread():
        residue = Residue.of(fit, files or {})
        judged: list[_Judged] = []
        for i in range(len(fit.measurements)):
            # Of a single set, no other takes a part of what changes.
            alone = len(fit.measurements) == 1
            squares = None if alone else SquaresOfSet.of(residue.blocks(i), residue.covariance)
            judged += [_judged(residue, block, squares) for block in residue.blocks(i)]
        return Outliers(_least_likely(residue, judged), jumps_of(residue, LEVEL), groups_of(residue))


class _Judged(NamedTuple):
    """Some rows of set ``measurements``, from row ``first`` on, all (n,): figures as in OutlyingRow.

    ``parameter``, ``change`` and ``prediction``: what becomes of the result without each.
    """

    measurements: int
    first: int
    leverage: Array
    studentised: Array
    p: Array
    parameter: IntArray
    change: Array
    prediction: Array


def _judged(residue: Residue, block: WhitenedRows, squares: SquaresOfSet | None) -> _Judged:
    """Judge the rows of a block, by the ``squares`` that are left of their set without each; None for the only set."""
    i, w = block.measurements, block.w[:, None]
    CJ = residue.covariance.of_rows(block.J, block.block)
    h, U = np.linalg.eigh(block.J @ CJ)
    u = (np.swapaxes(U, -1, -2) @ block.r[:, :, None])[:, :, 0]
    left = 1.0 - w * h
    tested = left > ALONE
    left = np.where(tested, left, np.inf)
    # Without the row its residual is u / left, of variance (1 + (1 - w) h) / left.
    q = np.sum(u**2 / left / (1.0 + (1.0 - w) * h), axis=1)
    steps = (CJ @ (U @ (w * u / left)[:, :, None]))[:, :, 0]
    d = tested.sum(axis=1)
    lowered = block.w * q
    if squares is not None:
        without = block.r + (block.J @ steps[:, :, None])[:, :, 0]
        lowered = block.w * np.sum(without**2, axis=1) - squares.change(steps, block.block, residue.covariance)
    found = q / residue.scatter(lowered, d, i)
    distance = np.sqrt(np.divide(found, d, out=np.full_like(q, np.nan), where=d > 0))
    return _Judged(
        i,
        block.rows.start,
        np.mean(w * h, axis=1),
        distance,
        residue.probability(found, d, i),
        *residue.influences(steps, block.block),
    )


def _least_likely(residue: Residue, judged: Sequence[_Judged]) -> tuple[OutlyingRow, ...]:
    """Return the rows, the least likely first, those of large data that are quite ordinary left out."""
    sets, parameters = residue.fit.measurements, residue.fit.parameters
    p = np.concatenate([np.nan_to_num(block.p, nan=1.0) for block in judged])
    limit = np.partition(p, _MOST_ROWS)[_MOST_ROWS] if len(p) > _MOST_ROWS else 1.0
    found = []
    for block in judged:
        data = sets[block.measurements]
        for n in np.flatnonzero(np.nan_to_num(block.p, nan=1.0) <= limit).tolist():
            row, own = block.first + n, float(block.p[n])
            found.append(
                OutlyingRow(
                    residue.name(data),
                    int(data.lines[row]),
                    data.targets[data.target[row]] if data.kind in WITH_TARGET else None,
                    float(block.leverage[n]),
                    float(block.studentised[n]),
                    own,
                    min(1.0, len(p) * own) if np.isfinite(own) else float("nan"),
                    Influence(parameters[block.parameter[n]].name, float(block.change[n]), float(block.prediction[n])),
                )
            )
    return tuple(sorted(found, key=lambda row: (_or_one(row.p), row.file, row.line)))


def _or_one(p: float) -> float:
    """Return a probability, 1 where nothing was tested."""
    return 1.0 if math.isnan(p) else p
