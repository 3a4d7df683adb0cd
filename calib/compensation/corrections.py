"""What a machine is commanded, so that it goes where it should: an answer a target."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray, read_only, read_only_view
from calib.foundations.brief import brief


@dataclass(frozen=True, slots=True, eq=False)
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
    return Corrections(
        read_only(np.concatenate([part.readings for part in parts])),
        read_only(np.concatenate([part.change for part in parts])),
        read_only_view(np.concatenate([part.reached for part in parts])),
        read_only(np.concatenate([part.position_error for part in parts])),
        read_only(np.concatenate([part.orientation_error for part in parts])),
        tuple(text for part in parts for text in part.reasons),
        read_only_view(np.concatenate([part.steps for part in parts])),
    )


def better(found: Corrections, more: Corrections, rows: IntArray) -> Corrections:
    """Return the corrections with those of some rows replaced where they are reached or nearer."""
    nearer = np.nan_to_num(more.position_error, nan=np.inf) < np.nan_to_num(found.position_error[rows], nan=np.inf)
    take = more.reached | nearer
    index, mine = rows[take], np.flatnonzero(take)

    def merged(old: Array, new: Array) -> Array:
        out = old.copy()
        out[index] = new[mine]
        return read_only_view(out)

    reasons = list(found.reasons)
    for to, n in zip(index, mine, strict=True):
        reasons[to] = more.reasons[n]
    steps = found.steps.copy()
    steps[rows] += more.steps
    return Corrections(
        merged(found.readings, more.readings),
        merged(found.change, more.change),
        read_only_view(merged(found.reached.astype(np.float64), more.reached.astype(np.float64)) > 0.5),
        merged(found.position_error, more.position_error),
        merged(found.orientation_error, more.orientation_error),
        tuple(reasons),
        read_only_view(steps),
    )
