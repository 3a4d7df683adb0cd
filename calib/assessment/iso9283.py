"""Pose accuracy and repeatability of a robot from repeated cycles, after ISO 9283:1998.

After the method of: the figures are those that the standard defines, computed from attained and commanded poses; load,
velocity, warm-up and the choice of poses (five in the diagonal plane of a cube, 30 cycles) are the user's affair.

Everywhere positions are in one frame, that of the commands (the standard's base frame): x_j (n, 3) the attained ones of
one pose in n cycles, xbar their mean, x_c the commanded one. Angles a, b, c are the small turns about the axes of that
frame from the commanded orientation (from the mean one, where no command is given).
"""

import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray, rows_by_word
from calib.foundations.errors import MeasurementError
from calib.foundations.ranges import finite
from calib.foundations.words import counted
from calib.measurement.cycles import Cycles


@dataclass(frozen=True, slots=True)
class IsoFigure:
    """One figure of ISO 9283: ``value`` in ``unit`` (m or rad) at a ``place``, from ``n`` cycles."""

    name: str
    place: str
    n: int
    value: float
    unit: str


def records(figures: Sequence[IsoFigure]) -> list[dict[str, Any]]:
    """Return one plain record for every figure."""
    return [asdict(figure) for figure in figures]


_NO_POINT = "the commanded position must be three finite numbers, in m."

# ---- the formulas; they raise MeasurementError for cycles of another shape, or too few of them


def _cycles(attained: Array, least: int = 1) -> Array:
    """Return positions or turns (n, 3) of ``least`` cycles or more as they are."""
    found = finite(attained, (None, 3), "what was attained must be finite numbers (n, 3), in m or rad.")
    if len(found) < least:
        raise MeasurementError(f"repeatability needs {least} cycles or more.")
    return found


def _distances_of(first: Array, second: Array, least: int) -> Array:
    """Return the distances (n,) of two poses, cycle by cycle."""
    one, other = _cycles(first, least), _cycles(second, least)
    if len(one) != len(other):
        raise MeasurementError(f"{counted(len(one), 'cycle')} of one pose and {len(other)} of the other.")
    return np.asarray(np.linalg.norm(one - other, axis=1))


@checked
def position_accuracy(attained: Array, commanded: Array) -> float:
    """Return AP_P = |xbar - x_c| in m of attained positions (n, 3) and the commanded one (3,).

    AP_P = sqrt((xbar - x_c)^2 + (ybar - y_c)^2 + (zbar - z_c)^2); the parts AP_x, AP_y, AP_z are its components.
    """
    return float(np.linalg.norm(_cycles(attained).mean(axis=0) - finite(commanded, (3,), _NO_POINT)))


@checked
def position_repeatability(attained: Array) -> float:
    """Return RP_l = lbar + 3 S_l in m of attained positions (n, 3), n >= 2.

    With l_j = |x_j - xbar|, lbar their mean and S_l = sqrt(sum (l_j - lbar)^2 / (n - 1)): the radius of a ball about
    the mean position.
    """
    own = _cycles(attained, 2)
    distances = np.linalg.norm(own - own.mean(axis=0), axis=1)
    return float(distances.mean() + 3.0 * distances.std(ddof=1))


@checked
def orientation_accuracy(turns: Array) -> Array:
    """Return AP_a, AP_b, AP_c = mean turn (3,) in rad of turns (n, 3) from the commanded orientation."""
    return np.asarray(_cycles(turns).mean(axis=0))


@checked
def orientation_repeatability(turns: Array) -> Array:
    """Return RP_a, RP_b, RP_c = 3 S (3,) in rad, S_a = sqrt(sum (a_j - abar)^2 / (n - 1)) of turns (n, 3), n >= 2."""
    return np.asarray(3.0 * _cycles(turns, 2).std(axis=0, ddof=1))


@checked
def multidirectional_variation(by_direction: Sequence[Array]) -> float:
    """Return vAP_P = max |xbar_h - xbar_k| in m over pairs of directions; attained positions (n, 3) of each."""
    means = np.array([_cycles(attained).mean(axis=0) for attained in by_direction])
    if len(means) < 2:
        raise MeasurementError("multidirectional variation needs two directions or more.")
    return float(scipy.spatial.distance.pdist(means).max())


@checked
def distance_accuracy(first: Array, second: Array, commanded: float) -> float:
    """Return AD = Dbar - D_c in m, signed, of attained positions (n, 3) of two poses, cycle by cycle.

    With D_j = |x_1j - x_2j| and D_c the commanded distance.
    """
    return float(_distances_of(first, second, 1).mean() - commanded)


@checked
def distance_repeatability(first: Array, second: Array) -> float:
    """Return RD = 3 S_D in m, S_D = sqrt(sum (D_j - Dbar)^2 / (n - 1)) of the distances of two poses, n >= 2."""
    return float(3.0 * _distances_of(first, second, 2).std(ddof=1))


@checked
def accuracy_drift(first: Array, last: Array, commanded: Array) -> float:
    """Return dAP_P = |AP_P(first) - AP_P(last)| in m: how the accuracy at one pose changed between two spells."""
    return abs(position_accuracy(first, commanded) - position_accuracy(last, commanded))


@checked
def repeatability_drift(first: Array, last: Array) -> float:
    """Return dRP_P = |RP_l(first) - RP_l(last)| in m."""
    return abs(position_repeatability(first) - position_repeatability(last))


# ---- all figures of a table


@checked
def figures(data: Cycles) -> tuple[IsoFigure, ...]:
    """Return the figures that a table of cycles has data for.

    For every pose RP, and with commands AP; with several directions vAP, AP and RP for each of them; between every two
    poses AD and RD, where they have as many cycles; with time, drift of AP and RP between the first and the last third
    of the cycles of a pose, and how far its mean went.

    Raises MeasurementError for a pose of fewer than two cycles.
    """
    found: list[IsoFigure] = []
    for place, rows in rows_by_word(data.target).items():
        if data.direction is None:
            found += _of_pose(data, place, rows)
        else:
            ways = {way: rows[own] for way, own in rows_by_word([data.direction[n] for n in rows]).items()}
            for way, own in ways.items():
                found += _of_pose(data, f"{place} from {way}", own)
            if len(ways) > 1:
                value = multidirectional_variation([data.position[own] for own in ways.values()])
                found.append(IsoFigure("vAP_P", place, min(map(len, ways.values())), value, "m"))
    found += _distances(data)
    return (*found, *_drifts(data))


def _of_pose(data: Cycles, place: str, rows: IntArray) -> list[IsoFigure]:
    n = len(rows)
    if n < 2:
        raise MeasurementError(f"{data.where}: pose {place!r} has one cycle; repeatability takes two or more.")
    attained = data.position[rows]
    found = []
    if data.commanded is not None:
        found.append(IsoFigure("AP_P", place, n, position_accuracy(attained, data.commanded[rows[0]]), "m"))
        parts = attained.mean(axis=0) - data.commanded[rows[0]]
        found += [IsoFigure(f"AP_{axis}", place, n, float(v), "m") for axis, v in zip("xyz", parts, strict=True)]
    found.append(IsoFigure("RP_l", place, n, position_repeatability(attained), "m"))
    if data.turn is not None:
        turns = _turns(data, rows)
        if data.commanded_turn is not None:
            values = orientation_accuracy(turns)
            found += [IsoFigure(f"AP_{axis}", place, n, float(v), "rad") for axis, v in zip("abc", values, strict=True)]
        values = orientation_repeatability(turns)
        found += [IsoFigure(f"RP_{axis}", place, n, float(v), "rad") for axis, v in zip("abc", values, strict=True)]
    return found


def _turns(data: Cycles, rows: IntArray) -> Array:
    """Return the turns (n, 3) about the axes of the frame from the commanded, or else the mean, orientation."""
    assert data.turn is not None, "asked only where orientations were measured"
    attained = data.turn[rows]
    given = data.commanded_turn
    reference = rigid.nearest_rotation(attained.mean(axis=0)) if given is None else given[rows[0]]
    return rigid.log3(attained @ reference.T)


def _distances(data: Cycles) -> list[IsoFigure]:
    found = []
    poses = rows_by_word(data.target)
    for (a, first), (b, second) in itertools.combinations(poses.items(), 2):
        if len(first) != len(second) or len(first) < 2:
            continue
        x, y, n = data.position[first], data.position[second], len(first)
        if data.commanded is not None:
            wanted = float(np.linalg.norm(data.commanded[first[0]] - data.commanded[second[0]]))
            found.append(IsoFigure("AD_P", f"{a} to {b}", n, distance_accuracy(x, y, wanted), "m"))
        found.append(IsoFigure("RD_P", f"{a} to {b}", n, distance_repeatability(x, y), "m"))
    return found


def _drifts(data: Cycles) -> list[IsoFigure]:
    if data.time is None:
        return []
    found = []
    for place, rows in rows_by_word(data.target).items():
        ordered = rows[np.argsort(data.time[rows], kind="stable")]
        third = len(ordered) // 3
        if third < 2:
            continue
        first, last = data.position[ordered[:third]], data.position[ordered[-third:]]
        if data.commanded is not None:
            found.append(IsoFigure("dAP_P", place, third, accuracy_drift(first, last, data.commanded[rows[0]]), "m"))
        went = float(np.linalg.norm(last.mean(axis=0) - first.mean(axis=0)))
        found += [
            IsoFigure("dRP_P", place, third, repeatability_drift(first, last), "m"),
            IsoFigure("drift of the mean", place, third, went, "m"),
        ]
    return found
