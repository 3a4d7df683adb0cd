"""What a machine is commanded, so that it goes where it should: an answer a target."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray, read_only_view
from calib.foundations.brief import brief
from calib.foundations.sealing import sealed

# Of a target there is one answer of these; the steps of all searches for it count.
_ANSWERS = ("readings", "change", "reached", "position_error", "orientation_error")


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Corrections:
    """Commands for N targets of a calibrated machine; every array is read-only and SI.

    ``readings`` (N, nr): the corrected ones, NaN in rows that are not ``reached`` (N). ``change`` (N, nr): corrected
    readings minus those at the start. ``position_error`` (N) in m and ``orientation_error`` (N) in rad: the remaining
    errors that the model predicts; in rows not reached, those of the nearest allowed readings found, NaN if there are
    none; orientation errors are NaN if only positions are to be reached. ``reasons``: N texts: why a row is not
    reached; for a reached row a remark, or nothing. ``steps`` (N): Newton steps taken.
    """

    __repr__ = brief

    readings: Array
    change: Array
    reached: BoolArray
    position_error: Array
    orientation_error: Array
    reasons: tuple[str, ...]
    steps: IntArray

    def __len__(self) -> int:
        return len(self.reached)

    def contents(self) -> dict[str, Any]:
        """Return how many there are, and which rows are not reached and why, as plain data."""
        missed = np.flatnonzero(~self.reached).tolist()
        return {
            "targets": len(self),
            "not_reached": [{"row": row + 1, "reason": self.reasons[row]} for row in missed],
        }


def joined(parts: Sequence[Corrections]) -> Corrections:
    """Return the corrections of several blocks of targets as one."""
    arrays = {
        name: read_only_view(np.concatenate([getattr(part, name) for part in parts])) for name in (*_ANSWERS, "steps")
    }
    return Corrections(reasons=tuple(text for part in parts for text in part.reasons), **arrays)


def better(found: Corrections, more: Corrections, rows: IntArray) -> Corrections:
    """Return the corrections with those of some rows replaced where they are reached or nearer."""
    nearer = np.nan_to_num(more.position_error, nan=np.inf) < np.nan_to_num(found.position_error[rows], nan=np.inf)
    return _with_rows(found, more, rows, np.flatnonzero(more.reached | nearer))


def replaced(found: Corrections, more: Corrections, rows: IntArray) -> Corrections:
    """Return the corrections with others of some rows."""
    return _with_rows(found, more, rows, np.arange(len(rows)))


def _with_rows(found: Corrections, more: Corrections, rows: IntArray, take: IntArray) -> Corrections:
    """Return corrections with those that were sought for ``rows``, of which the numbers ``take`` are taken."""
    merged = {name: getattr(found, name).copy() for name in (*_ANSWERS, "steps")}
    for name in _ANSWERS:
        merged[name][rows[take]] = getattr(more, name)[take]
    merged["steps"][rows] += more.steps
    reasons = list(found.reasons)
    for to, n in zip(rows[take], take, strict=True):
        reasons[to] = more.reasons[n]
    return Corrections(reasons=tuple(reasons), **{name: read_only_view(own) for name, own in merged.items()})
