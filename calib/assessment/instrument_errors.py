"""What an instrument or an encoder does to its numbers: axes of unequal length, and readings that are rounded."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.assessment.changes import _LEAST_ROWS
from calib.assessment.effects import per_metre
from calib.assessment.scores import chance_of, score_of, variance_of
from calib.assessment.stretches import Stretch
from calib.foundations.arrays import Array
from calib.measurement.checks import resolutions
from calib.robot.robot import Robot

# The same of axes of unequal length. Points nearly in a plane leave 1e-5 of those across it: by a machine that leaves
# something out, these then seem unequal by any amount. Where axes can be told they left about 1e-3 or more.
_AXES_TAKEN = 1e-4


class Rounding(NamedTuple):
    """What rounded readings of a ``file`` do: rms at the tool in m; ``share``: that over the rms of what remains."""

    file: str
    distance: float
    share: float


def rounding(parts: Sequence[Stretch], robot: Robot) -> tuple[Rounding, ...]:
    """Return what coarse steps of readings do, in every set that has them."""
    found = []
    for part in parts:
        data = part.data
        read = [data.reading_names.index(name) for name in part.joints]
        steps = resolutions(
            np.concatenate([end.readings[:, read] for end in data.ends]), [robot.readings[k] for k in read]
        )
        if not steps.any():
            continue
        # Either end of a pair is rounded by itself.
        square = float(np.sum((part.by_joint * steps) ** 2)) / 12.0 * len(data.ends)
        n, free = len(part.r), max(1.0 - part.used / part.r.size, 0.05)
        rest = max(float(np.sum(part.r**2)), part.least * part.r.size)
        found.append(
            Rounding(data.where, float(np.sqrt(square / n)) / per_metre([part]), float(np.sqrt(square * free / rest)))
        )
    return tuple(sorted(found, key=lambda one: (-one.distance, one.file)))


class Strain(NamedTuple):
    """How much longer one axis of an instrument seems to be than another: ``share``, 0 where nothing says so.

    ``size``: what it does to a row, over the standard deviation of what remains of one number. ``chance``: of it.
    """

    file: str
    share: float
    size: float
    chance: float


# Axes of unequal length, and those that are not at right angles. All of one length the links' lengths may be.
_STRAINS = np.array(
    [
        np.diag([1.0, -1.0, 0.0]),
        np.diag([-1.0, -1.0, 2.0]),
        [[0, 1.0, 0], [1.0, 0, 0], [0, 0, 0]],
        [[0, 0, 1.0], [0, 0, 0], [1.0, 0, 0]],
        [[0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]],
    ]
)


def strains(parts: Sequence[Stretch], C: Array) -> tuple[Strain, ...]:
    """Return how unequal the axes of the instrument seem to be in every set that has positions."""
    found = []
    for part in parts:
        rows = part.row.astype(np.intp)
        if part.data.position is None or len(rows) < 4 * _LEAST_ROWS:
            continue
        x = part.data.position[rows]
        moved = np.einsum("sij,nj->nis", _STRAINS, x - x.mean(axis=0))
        D = (part.by_base[:, :, :3] @ moved).reshape(part.r.size, -1)
        score, shift = score_of(D, part, C, taken=_AXES_TAKEN)
        rest = part.r + shift
        variance = variance_of(rest, part)
        lengths = np.linalg.eigvalsh(np.einsum("sij,s->ij", _STRAINS, score.sizes))
        size = float(np.sqrt(float(score.gain) / variance / len(rows)))
        chance = min(1.0, len(parts) * chance_of(score, rest, part))
        found.append(Strain(part.data.where, float(np.ptp(lengths)), size, chance))
    return tuple(sorted(found, key=lambda one: (-one.share, one.file)))
