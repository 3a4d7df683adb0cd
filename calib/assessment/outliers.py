"""Which rows, targets and groups do not go with the rest, and what becomes of a calibration without them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from calib.assessment.disagreement import Jump, OutlyingGroup, groups_of, jumps_of
from calib.assessment.influence import ALONE, Influence, Residue, Rows
from calib.foundations import linear
from calib.identification.fit import Fit
from calib.measurement.kinds import WITH_TARGET

# What is found by chance in one of a hundred calibrations is told.
LEVEL = 0.01


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
    """Rows, jumps of targets, and groups, each the least likely first. Made by :func:`calib.outliers`."""

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
            worst[row.target] = min(worst.get(row.target, 1.0), float(np.nan_to_num(row.p, nan=1.0)))
        return tuple(jump for jump in self.jumps if jump.is_told(LEVEL) and jump.p < worst[jump.target])

    @property
    def disagreeing(self) -> tuple[OutlyingGroup, ...]:
        """Groups whose disagreement with the rest is no accident."""
        return tuple(group for group in self.groups if group.chance < LEVEL)


def outliers(fit: Fit, *, files: Mapping[str, str] | None = None) -> Outliers:
    """Return all rows, targets and groups of a fit with what becomes of it without them, the least likely first.

    ``files``: what the tables are called, by where they came from; so, when None.

    A row is judged by the multivariate form of the externally studentised residual, F distributed by its d numbers and
    the degrees of freedom of the others of its set. A row that a robust loss gives a weight below 1 is judged as a new
    one would be. Jumps and groups: :mod:`calib.assessment.disagreement`. One linear step each: nothing is fitted anew.
    """
    with linear.one_thread():
        residue = Residue.of(fit, files or {})
        number = sum(map(len, fit.measurements))
        rows = [row for block in residue.blocks() for row in _judged(residue, block, number)]
        return Outliers(
            tuple(sorted(rows, key=lambda row: (np.nan_to_num(row.p, nan=1.0), row.file, row.line))),
            jumps_of(residue, LEVEL),
            groups_of(residue),
        )


def _judged(residue: Residue, block: Rows, number: int) -> Iterator[OutlyingRow]:
    """Yield the rows of a block, of ``number`` rows in all."""
    i, w = block.measurements, block.w[:, None]
    data = residue.fit.measurements[i]
    CJ = residue.C @ np.swapaxes(block.J, -1, -2)
    h, U = np.linalg.eigh(block.J @ CJ)
    u = (np.swapaxes(U, -1, -2) @ block.r[:, :, None])[:, :, 0]
    left = 1.0 - w * h
    tested = left > ALONE
    left = np.where(tested, left, np.inf)
    # Without the row its residual is u / left, of variance (1 + (1 - w) h) / left.
    q = np.sum(u**2 / left / (1.0 + (1.0 - w) * h), axis=1)
    steps = (CJ @ (U @ (w * u / left)[:, :, None]))[:, :, 0]
    for n, d in enumerate(map(int, tested.sum(axis=1))):
        row = block.rows.start + n
        scatter = residue.scatter(float(block.w[n] * q[n]), d, i)
        found = float(q[n]) / scatter
        p = residue.probability(found, d, i)
        yield OutlyingRow(
            residue.name(data),
            int(data.lines[row]),
            data.targets[data.target[row]] if data.kind in WITH_TARGET else None,
            float(np.mean(w[n] * h[n])),
            float(np.sqrt(found / d)) if d else float("nan"),
            p,
            min(1.0, number * p) if np.isfinite(p) else float("nan"),
            residue.influence(steps[n]),
        )
