"""Sanity of measurements before any fit: typical mistakes, recognised by their signature and said in one sentence.

An error says that a fit would be meaningless; a warning, that a look is worth it. The limits of the signatures stand
below with their reasons; all are far from what real data show.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import MeasurementError
from calib.foundations.units import DEG, MM
from calib.foundations.words import counted, listed
from calib.measurement.measurements import Measurements
from calib.measurement.streams.joints import AT_REST
from calib.measurement.streams.stream import OFFSET
from calib.robot.robot import Reading, Robot
from calib.robot.transmission import sided

# Controllers and rounding pass a limit by little: a warning from 1 mrad (1 mm) plus 0.1 % of the joint's largest limit.
_SLACK = 1e-3
# No controller passes its limits by a tenth of the largest; another variant of the robot does.
_BEYOND = 0.1
# Degrees read as radians pass the limits by up to 57 times; twice the largest limit is beyond any turn counter.
_FAR_BEYOND = 2.0
# Where so many rows of a column fit as they are, its others may have been joined to them from another file.
_MIXED = 0.25
# A wrong header shows in many rows, a slip of the pen in one.
_MANY = 0.1
# Positions scatter by the robot's size: a factor of 1000 leaves more than a decade on both sides of these.
_TOO_WIDE = 20.0
_TOO_NARROW = 1e-3
# Below this much of motion (0.2 rad, 0.2 m) the positions of a sound table may be narrow.
_IN_MOTION = 0.2
_LISTED = 10
# Of a stream some rows are always left out where joints turn: it is told of such a share.
_TURNED = 0.1
# Of a table whose rows are there once more by chance, or by a repeated click, few are.
_COPIED = 0.5
# Steps of readings, in degrees and in rad or m. What is on a coarser grid was commanded so.
_STEPS = (1.0, 0.5, 0.25, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
_COARSEST, _FINEST, _GRID = 0.1, 3e-4, (2.0, 5.0)
# That so many readings are as near to multiples of a step is no chance.
_NEAR, _FEWEST_VALUES = 0.02, 8
_DIGITS = 9

_UNITS = {"angle": "rad", "length": "m"}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing worth saying of the measurements: ``code`` names the check, ``sentence`` says it with the evidence."""

    severity: Literal["error", "warning"]
    code: str
    sentence: str

    @classmethod
    def warning(cls, code: str, sentence: str) -> "Finding":
        """Return a finding that is worth a look, and no error."""
        return cls("warning", code, sentence)


def refuse_findings(findings: Sequence[Finding]) -> None:
    """Raise MeasurementError for the first finding that is an error."""
    for finding in findings:
        if finding.severity == "error":
            raise MeasurementError(finding.sentence)


def table_findings(measurements: Measurements, readings: Sequence[Reading], reach: float) -> tuple[Finding, ...]:
    """Return what looks wrong, the checks of the readings first.

    ``readings`` are the robot's, in the order of the columns of ``measurements.readings``; ``reach`` is the longest
    distance in m from the robot's base to its tip. Raises nothing: an empty tuple is a sound table.
    """
    if len(measurements) == 0:
        return ()
    told = [k for k, name in enumerate(measurements.reading_names) if name not in measurements.absent]
    moving, limits = _only(measurements, told), [readings[k] for k in told]
    return (
        *_beyond_limits(moving, limits),
        *_radians_as_degrees(moving, limits),
        *_at_rest(moving),
        *_rounded(moving, limits, reach),
        *_unused(measurements),
        *_commanded(measurements),
        *(finding for setup in measurements.setups for finding in _spread(measurements.at(setup), reach)),
        *_repeated(measurements),
    )


def unreached(m: Measurements, asked: Collection[str] = ()) -> tuple[Finding, ...]:
    """Return warnings where ``in_order`` leaves out more rows of a table than the first one, or leaves a side untold.

    ``asked``: readings of which something follows the side (:func:`sides_asked`).
    """
    found = []
    what = "rows" if m.other is None else "pairs"
    every = len(m) + m.unreached
    if m.unreached > (1 if m.stream is None else _TURNED * every):
        when, remedy = "before every joint has moved", "begin with a motion of all joints"
        if m.stream is not None:
            when, remedy = "where a joint has not moved yet or has just turned", f"{remedy}, and turn less often"
        sentence = (
            f"{m.where}: in_order leaves out {m.unreached} {what}{'' if m.stream is None else f' of {every}'}, {when}: "
            f"nothing tells from which side it was reached; {remedy}."
        )
        found.append(Finding.warning("rows-left-out", sentence))
    sides = [end.conditions.approach for end in m.ends if end.conditions.approach is not None]
    if (m.unreached or m.stream is not None) and sides:
        untold = np.any([own == 0.0 for own in sides], axis=0) & np.isin(m.reading_names, list(asked))
        names = [name for name, own in zip(m.reading_names, untold.T, strict=True) if own.any()]
        if names:
            many = np.count_nonzero(untold.any(axis=1))
            sentence = (
                f"{m.where}: in {many} of {len(m)} {what} nothing tells from which side {listed(names)} was reached: "
                "it counts as in the middle, and half of its gap may then look like an offset, a base or a tool "
                f"that changed; begin with a motion of all joints{'' if m.stream is None else ', and turn less often'}."
            )
            found.append(Finding.warning("side-not-known", sentence))
    return tuple(found)


def sides_asked(m: Measurements, robot: Robot) -> frozenset[str]:
    """Return the readings that move what rows are about, and of which a joint term follows the side."""
    return sided(robot.terms) & frozenset(robot.driving(m.links_about(robot)))


# ---- readings


def _only(m: Measurements, told: Sequence[int]) -> Measurements:
    """Return the rows with those readings alone that columns tell."""
    if len(told) == len(m.reading_names):
        return m
    other = None if m.other is None else replace(m.other, readings=m.other.readings[:, told])
    names = tuple(m.reading_names[k] for k in told)
    return replace(m, reading_names=names, readings=m.readings[:, told], other=other)


def _unused(m: Measurements) -> Iterable[Finding]:
    if m.unused:
        names = ", ".join(map(repr, m.unused))
        yield Finding.warning(
            "joint-unused",
            f"{m.where}: joints that move nothing that was measured, and are left out: {names}.",
        )


def _commanded(m: Measurements) -> Iterable[Finding]:
    if m.stream is not None and m.stream.joints.commanded:
        delay = (
            f"the delay that all have in common is in {m.scalars[m.uses[OFFSET]].name}"
            if OFFSET in m.uses
            else 'write latency = "free", and the delay that all have in common is found'
        )
        yield Finding.warning(
            "commanded-readings",
            f"{m.stream.joints.where}: says what joints were commanded to do, and not where they were; {delay}, but by "
            "how much each of them is late, and what friction leaves, is in the results: log actual readings.",
        )


def _beyond_limits(m: Measurements, readings: Sequence[Reading]) -> Iterable[Finding]:
    largest = np.array([_largest_limit(reading) for reading in readings])
    slack = _SLACK * (1.0 + largest)
    excess = _excess(m.readings, readings)
    beyond = excess.max(axis=0)
    in_degrees = _excess(m.readings * DEG, readings).max(axis=0) <= slack
    many = np.mean(excess > slack, axis=0) >= _MANY
    far = many & (np.abs(m.readings).max(axis=0) > _FAR_BEYOND * largest)
    angles = np.array([reading.dimension == "angle" for reading in readings], dtype=np.bool_)
    # As controllers write them that count from 0 to 360 deg.
    turns = [_excess(m.readings + turn, readings) for turn in (-2.0 * np.pi, 0.0, 2.0 * np.pi)]
    turned = angles & (np.min(turns, axis=0).max(axis=0) <= slack)
    degrees = far & in_degrees & angles & ~turned
    # As where a controller counts a joint the other way.
    negated = many & (_excess(-m.readings, readings).max(axis=0) <= slack)

    def farthest(j: int) -> str:
        reading, row = readings[j], int(excess[:, j].argmax())
        lower, upper = _limits(reading)
        unit = _UNITS[reading.dimension]
        return (
            f"{m.where}:{m.lines[row]}: column {reading.name!r} has {m.readings[row, j]:.6g} {unit} "
            f"where the limits are {lower:.6g} and {upper:.6g} {unit}"
        )

    if degrees.any():
        first, *others = (int(j) for j in np.flatnonzero(degrees))
        # Of a column in degrees alone, few rows are within limits in rad.
        within = int(np.sum(excess[:, first] <= slack[first]))
        mixed = within >= _MIXED * len(m)
        also = f"; likewise in {', '.join(repr(readings[j].name) for j in others)}" if others else ""
        yield Finding(
            "error",
            "degrees-as-radians",
            f"{farthest(first)}, and divided by 57.3 all its rows fit: "
            + (f"{len(m) - within} of {len(m)} numbers, or all," if mixed else "the numbers")
            + f" seem to be degrees, not [rad]{also}.",
        )
    for j in (int(j) for j in np.flatnonzero((beyond > slack) & ~degrees)):
        said = "."
        if readings[j].lower == readings[j].upper:
            said = ": the URDF leaves the joint no room, as exporters do. Write its limits there, or take <limit> out."
        elif turned[j]:
            said = ", and all fit a whole turn away: take it off there."
        elif negated[j]:
            said = ", and all fit with the other sign: does it count the other way, or is this another joint's column?"
        yield Finding(
            "error" if beyond[j] > _BEYOND * largest[j] else "warning",
            "beyond-limits",
            f"{farthest(j)}; {np.sum(excess[:, j] > slack[j])} of {len(m)} rows are beyond{said}",
        )


def _radians_as_degrees(m: Measurements, readings: Sequence[Reading]) -> Iterable[Finding]:
    angles = [j for j, reading in enumerate(readings) if reading.dimension == "angle"]
    values = m.readings[:, angles]
    largest = float(np.abs(values).max(initial=0.0))
    moving = np.ptp(values, axis=0).max(initial=0.0) > _IN_MOTION * DEG
    fits = _excess(values / DEG, [readings[j] for j in angles]).max(initial=-np.inf) <= _SLACK
    if moving and fits and largest < 2.0 * np.pi * DEG:
        yield Finding.warning(
            "radians-as-degrees",
            f"{m.where}: no joint turns farther than {largest:.6g} rad from zero, and multiplied by 57.3 all rows fit "
            "the limits: the numbers seem to be radians, not [deg].",
        )


def _at_rest(m: Measurements) -> Iterable[Finding]:
    still = np.flatnonzero(np.ptp(np.concatenate([end.readings for end in m.ends]), axis=0) <= AT_REST)
    if len(m) > 1 and still.size:
        names = ", ".join(repr(m.reading_names[j]) for j in still)
        yield Finding.warning("joint-at-rest", f"{m.where}: joints that never move: {names}.")


def resolutions(values: Array, readings: Sequence[Reading]) -> Array:
    """Return to which step (k,), in rad or m, readings (n, k) seem to be rounded: 0 where to none, or to a fine one.

    Rounding is wrong by up to half a step, and by a step over the root of 12 (rms).
    """
    return np.array([_step(column, reading) for column, reading in zip(values.T, readings, strict=True)])


def _step(values: Array, reading: Reading) -> float:
    if len(np.unique(np.round(values, _DIGITS))) < _FEWEST_VALUES:
        return 0.0

    def all_of(step: float) -> bool:
        return bool(np.all(np.abs(values / step - np.round(values / step)) < _NEAR))

    units = (DEG, 1.0) if reading.dimension == "angle" else (1.0,)
    steps = [step * unit for unit in units for step in _STEPS if _FINEST < step * unit <= _COARSEST]
    found = max((step for step in steps if all_of(step)), default=0.0)
    on_grid = found in (DEG, _COARSEST) and any(all_of(times * found) for times in _GRID)
    return 0.0 if on_grid else found


def _rounded(m: Measurements, readings: Sequence[Reading], reach: float) -> Iterable[Finding]:
    steps = resolutions(np.concatenate([end.readings for end in m.ends]), readings)
    arms = np.array([reach if reading.dimension == "angle" else 1.0 for reading in readings])
    if not len(steps) or not steps.any():
        return
    j = int(np.argmax(steps * arms))
    factor, unit = (1.0 / DEG, "deg") if readings[j].dimension == "angle" else (1.0 / MM, "mm")
    more = int(np.count_nonzero(steps)) - 1
    others = f" and {counted(more, 'other')}" if more else ""
    yield Finding.warning(
        "rounded-readings",
        f"{m.where}: readings of {readings[j].name!r}{others} come in steps of "
        f"{steps[j] * factor:.4g} {unit}; if they are not where joints were told to be, but rounded, the tip is off by "
        f"up to {0.5 * steps[j] * arms[j] / MM:.2g} mm: write more digits.",
    )


def _limits(reading: Reading) -> tuple[float, float]:
    lower = -np.inf if reading.lower is None else reading.lower
    upper = np.inf if reading.upper is None else reading.upper
    return lower, upper


def _largest_limit(reading: Reading) -> float:
    return max((abs(limit) for limit in (reading.lower, reading.upper) if limit is not None), default=np.inf)


def _excess(values: Array, readings: Sequence[Reading]) -> Array:
    """Return how far readings (N, k) are outside their limits, negative inside."""
    limits = np.array([_limits(reading) for reading in readings]).reshape(-1, 2)
    return np.asarray(np.maximum(limits[:, 0] - values, values - limits[:, 1]))


# ---- positions and rows


def _spread(m: Measurements, reach: float) -> Iterable[Finding]:
    if m.position is None or not len(m):
        return
    # The median row stands for all of them, so that one wild row is not taken for a wrong unit.
    distance = np.linalg.norm(m.position - np.median(m.position, axis=0), axis=-1)
    typical, farthest = float(np.median(distance)), int(distance.argmax())
    motion = float(np.ptp(m.readings, axis=0).max(initial=0.0))
    if typical > _TOO_WIDE * reach and typical * MM <= 2.0 * reach:
        yield Finding(
            "error",
            "millimetres-as-metres",
            f"{m.where}: half of the positions are over {typical:.4g} m from their median, and the robot reaches "
            f"{reach:.4g} m; divided by 1000 they fit: the numbers seem to be millimetres, not [m].",
        )
    elif distance[farthest] > _TOO_WIDE * reach:
        yield Finding(
            "error",
            "position-beyond-reach",
            f"{m.where}:{m.lines[farthest]}: the position is {distance[farthest]:.4g} m from the median of all, and "
            f"the robot reaches {reach:.4g} m.",
        )
    elif typical < _TOO_NARROW * reach and motion > _IN_MOTION:
        yield Finding.warning(
            "metres-as-millimetres",
            f"{m.where}: half of the positions are within {typical:.4g} m of their median, and the robot reaches "
            f"{reach:.4g} m: the numbers seem to be metres, not [mm], or the point was held still.",
        )


def _repeated(m: Measurements) -> Iterable[Finding]:
    numbers = [m.tool, m.setup, m.target, *([] if m.other is None else [m.other.tool])]
    rows = np.hstack([_said(m), *(number[:, None] for number in numbers)])
    _, first = np.unique(rows, axis=0, return_index=True)
    again = m.lines[np.setdiff1d(np.arange(len(m)), first)]
    if again.size:
        lines = ", ".join(map(str, again[:_LISTED])) + (", ..." if again.size > _LISTED else "")
        many = again.size >= _COPIED * len(m)
        yield Finding.warning(
            "copied-rows" if many else "repeated-row",
            f"{m.where}: {again.size} of {len(m)} rows repeat an earlier one to the last digit, at line {lines}"
            + (": copies count as if they had been measured." if many else "."),
        )


def copied_tables(sets: Sequence[Measurements]) -> tuple[Finding, ...]:
    """Return an error for every table of which another has the rows, in any order: they were measured only once.

    Of the same table by itself :func:`table_findings` tells.
    """
    found: list[Finding] = []
    first: dict[object, int] = {}
    for k, data in enumerate(sets):
        rows = _row_keys(data)
        there = Counter(first[row] for row in rows if row in first)
        for other, many in there.items():
            if many >= _COPIED * min(len(data), len(sets[other])):
                name = sets[other].where
                said = "an earlier table of the same name" if name == data.where else name
                sentence = f"{data.where}: {many} of its {len(data)} rows are rows of {said}; leave out the copies."
                found.append(Finding("error", "copied-table", sentence))
                break
        first |= dict.fromkeys((row for row in rows if row not in first), k)
    return tuple(found)


def _row_keys(m: Measurements) -> set[object]:
    """Return what tells rows apart, over all tables: numbers to a nanometre, or nanoradian, and names."""
    numbers = np.round(_said(m), _DIGITS) + 0.0  # no -0.0
    others = m.tool if m.other is None else m.other.tool
    named = zip(m.tool, others, m.setup, m.target, strict=True)
    names = [
        (m.tools[tool], m.tools[other], m.setups[setup], m.targets[target] if m.targets else "")
        for tool, other, setup, target in named
    ]
    of_table = (m.kind, m.tip, m.reading_names)
    return {(of_table, name, row.tobytes()) for name, row in zip(names, numbers, strict=True)}


def _said(m: Measurements) -> Array:
    """Return all numbers of rows (N, n): readings, and what was measured."""
    other = None if m.other is None else m.other.readings
    every = (m.readings, m.position, m.orientation, m.value, m.points, m.mark, other)
    return np.hstack([x.reshape(len(m), int(np.prod(x.shape[1:]))) for x in every if x is not None])
