"""What the data do not determine, in sentences, and what to measure or give so that they would.

Remedies are not guessed: each is tried, at the poses that were measured, on every direction of the null space, and is
named only where it shows that direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, evenly_spread, read_only
from calib.foundations.units import DISPLAY, MRAD
from calib.foundations.words import noun
from calib.identification.error_model import ErrorModel
from calib.identification.fit import Fit
from calib.identification.identifiability import NullDirection
from calib.identification.initialisation.frames import initial_frames
from calib.identification.initialisation.problem import with_common_names
from calib.identification.machine import Frames, values_at
from calib.identification.system import Problem, jacobian
from calib.measurement.measurements import Measurements
from calib.robot.sampling import random_readings

Kind = Literal["null space", "weakly determined", "correlated"]

# A remedy shows a direction when it moves the new residuals by more than this share of what its parameters would move
# them one by one. Shares of a direction are told to a hundredth, and those of identifiable parameters stay below 0.02.
_SHOWN = 0.05
_MOST_ROWS = 200
# Of all tables together, but for a few of each.
_MOST_OF_ALL = 1000
# Of a set-up and a tool of a table, where a direction is tried at random readings.
_FEWEST_ROWS = 10
_CORRELATED = 0.95
_TO_SHOW_A_CLOCK = "A clock shows where the speed changes: move now faster and now slower, in other directions."
# Where more tool points are tried, in m on the tip link beside the first one.
_MORE_POINTS = ((0.1, 0.0, 0.0), (0.0, 0.1, 0.05))
# A base or tool that a direction moves by less of a parameter scale has no part in it.
_HAS_PART = 0.02

# Fewer directions than these are told one by one.
_A_FEW = 3
_NUMBERS = dict(enumerate(["no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"]))

_REMEDIES = {
    "orientation": "measure orientations as well",
    "points": "measure two more tool points",
    "base": "measure where the base is and fix it",
    "tool": "measure where the tool is and fix it",
}


@dataclass(frozen=True, slots=True)
class Advice:
    """One sentence about ``parameters``. ``remedies``: keys of what would determine a direction, each tried."""

    kind: Kind
    parameters: tuple[str, ...]
    sentence: str
    remedies: tuple[str, ...] = ()


@checked
def advice(fit: Fit) -> tuple[Advice, ...]:
    """Return what the data of a fit leave open: null space with remedies, weakly determined and correlated parameters.

    A parameter is weakly determined when its sigma exceeds half its scale. Correlated are pairs of identifiable
    parameters whose correlation exceeds 0.95.
    """
    found = null_space_advice(fit.model, fit.measurements, fit.null_space)
    factor = {**DISPLAY, "rad": (1.0 / MRAD, "mrad")}
    said = []
    left_open = np.sum(fit.by_null_space**2, axis=1) > 0.5 * fit.sigmas**2
    for parameter, sigma, weak, is_open in zip(
        fit.parameters, fit.sigmas, fit.weakly_determined, left_open.tolist(), strict=True
    ):
        if weak:
            remedy = (
                "the null space leaves most of that open, and what helps against it helps here"
                if is_open
                else "more or other poses would help, or a prior"
            )
            times, unit = factor.get(parameter.unit, (1.0, parameter.unit))
            judged = "its prior" if parameter.hold == 1.0 else "the parameter scale"
            said.append(
                Advice(
                    "weakly determined",
                    (parameter.name,),
                    f"{parameter.name} is weakly determined: its sigma is {sigma * times:.3g} {unit}, where {judged} "
                    f"is {parameter.scale * times:.3g} {unit}; {remedy}.",
                )
            )
    return (*found, *said, *_correlated(fit))


def null_space_advice(
    model: ErrorModel, measurements: Sequence[Measurements], null_space: Sequence[NullDirection]
) -> tuple[Advice, ...]:
    """Return a sentence with remedies for each direction of the null space, before or after a fit.

    Raises MeasurementError when the measurements are not of this robot.
    """
    if not null_space:
        return ()
    if any(data.position is None for data in measurements):
        # What more would help is tried with what an instrument sees; sockets and gauges are another matter.
        return tuple(Advice("null space", tuple(direction.shares), str(direction)) for direction in null_space)
    sets = with_common_names(model, [data.at_readings() for data in measurements])
    others = [direction for direction in null_space if not _of_clock(direction, sets)]
    remedies = iter(_tried(model, sets, others))
    return tuple(
        Advice("null space", tuple(direction.shares), f"{direction} {_TO_SHOW_A_CLOCK}")
        if _of_clock(direction, sets)
        else _of_direction(direction, next(remedies))
        for direction in null_space
    )


def _of_clock(direction: NullDirection, sets: Sequence[Measurements]) -> bool:
    """Return whether a direction moves a number of an instrument, such as the offset of its clock."""
    return not direction.shares.keys().isdisjoint(one.name for data in sets for one in data.scalars)


def told_briefly(
    model: ErrorModel, measurements: Sequence[Measurements], null_space: Sequence[NullDirection], said: Sequence[str]
) -> tuple[str, ...]:
    """Return the sentences ``said`` of a null space, one for all directions that no pose of the arm would show.

    Those are tried at random readings over the whole ranges of the joints, with what these measurements observe.
    """
    if len(null_space) < _A_FEW or any(data.kind not in ("position", "pose") for data in measurements):
        return tuple(said)
    sets = with_common_names(model, [data.at_readings() for data in measurements])
    if len(model.robot.links) > 1 or not (anywhere := _anywhere(model, sets)):
        # What one link does not show, others may.
        return tuple(said)
    frames = initial_frames(model, sets)
    J, names = _per_unit(Problem(model, model.parameters(sets[0].tools, sets[0].setups), frames, anywhere))
    never = [not _of_clock(direction, sets) and not _shown(J, names, [], direction) for direction in null_space]
    if sum(never) < _A_FEW:
        return tuple(said)
    seen = "pose" if any(data.kind == "pose" for data in sets) else "position"
    several = f"{sum(never)} combinations that no {seen} determines"
    others = [sentence for sentence, always in zip(said, never, strict=True) if not always]
    return (f"{several}: normal for {_joints(model)}. No prediction depends on them.", *others)


def _anywhere(model: ErrorModel, sets: Sequence[Measurements]) -> tuple[Measurements, ...]:
    """Return the sets as they would be with as many rows, at random readings, of every set-up and tool in them.

    Nothing where there are too many of these.
    """
    pairs = [np.unique(np.stack([data.setup, data.tool]), axis=1).T for data in sets]
    if (count := sum(map(len, pairs))) > _MOST_ROWS // _FEWEST_ROWS:
        return ()
    n = _MOST_ROWS // count
    found = []
    for data, own in zip(sets, pairs, strict=True):
        rows = [np.resize(np.flatnonzero((data.setup == setup) & (data.tool == tool)), n) for setup, tool in own]
        readings = random_readings(model.urdf_robot, n * len(own))
        found.append(replace(data.subset(np.concatenate(rows)), readings=read_only(readings)))
    return tuple(found)


def _joints(model: ErrorModel) -> str:
    types = [model.robot.moving_types[j] for j in range(len(model.robot.moving))]
    told = [_in_words(types.count(kind), f"{kind} joint") for kind in dict.fromkeys(types)]
    # A mimic joint moves and is not read, so that a controller may show fewer joints, or others.
    read = f", moved by {_in_words(n, 'reading')}," if (n := len(model.robot.readings)) != len(types) else ""
    free = [name for name, freedom in (("base", model.base), ("tool", model.tool)) if freedom != "fixed"]
    with_free = f" with a free {' and '.join(free)}" if free else ""
    return (" and ".join(told) + read + with_free).removesuffix(",")


def _in_words(count: int, one: str) -> str:
    return f"{_NUMBERS.get(count, str(count))} {noun(count, one)}"


def _of_direction(direction: NullDirection, remedies: Sequence[str]) -> Advice:
    if remedies:
        help_ = f"To tell them apart, {' or '.join(_REMEDIES[name] for name in remedies)}."
    elif len(direction.shares) == 1:
        help_ = "No measurement with such a tool determines it; leave it out, or take another tool."
    else:
        help_ = "No measurement of the tip tells them apart, as they move it in the same way; leave one of them out."
    return Advice("null space", tuple(direction.shares), f"{direction} {help_}", tuple(remedies))


def _tried(
    model: ErrorModel, sets: Sequence[Measurements], null_space: Sequence[NullDirection]
) -> list[tuple[str, ...]]:
    """Return, for every direction, the remedies that show it."""
    frames = initial_frames(model, sets)
    most = max(min(_MOST_ROWS, _MOST_OF_ALL // len(sets)), 2 * _FEWEST_ROWS)
    sets = [data.subset(evenly_spread(len(data), most)) for data in sets]
    names = [parameter.name for parameter in model.parameters(sets[0].tools, sets[0].setups)]
    found: list[list[str]] = [[] for _ in null_space]
    for remedy in ("orientation", "points"):
        trial = _trial(remedy, model, sets, frames)
        if trial is not None:
            J, own = _per_unit(trial)
            new = [k for k, name in enumerate(own) if name not in names]
            for direction, helpful in zip(null_space, found, strict=True):
                if _shown(J, own, new, direction):
                    helpful.append(remedy)
    for remedy in ("base", "tool"):
        for direction, helpful in zip(null_space, found, strict=True):
            largest = max(abs(share) for share in direction.shares.values())
            if any(
                name.startswith(f"{remedy}.") and abs(share) > _HAS_PART * largest
                for name, share in direction.shares.items()
            ):
                helpful.append(remedy)
    return [tuple(helpful) for helpful in found]


def _trial(remedy: str, model: ErrorModel, sets: Sequence[Measurements], frames: Frames) -> Problem | None:
    """Return the problem with more measured, as it would be seen at the start; None where that is measured already."""
    if remedy == "orientation":
        if model.tool == "fixed" or all(data.kind == "pose" for data in sets):
            return None
        more = [_with_orientation(model, data, frames) for data in sets]
        wider = replace(model, tool="pose")
        return Problem(wider, wider.parameters(sets[0].tools, sets[0].setups), frames, tuple(more))
    if model.tool == "fixed" or len(sets[0].tools) > 2:
        return None
    tools = (*sets[0].tools, *(f"more_{k}" for k in range(len(_MORE_POINTS))))
    first = frames.tools[0]
    others = np.stack([first] * len(_MORE_POINTS))
    others[:, :3, 3] += np.array(_MORE_POINTS)
    placed = Frames(frames.bases, np.concatenate([frames.tools, others]))
    more = [
        replace(data, tools=tools, tool=np.full(len(data), k) if k >= len(sets[0].tools) else data.tool)
        for data in sets
        for k in (0, *range(len(sets[0].tools), len(tools)))
    ]
    return Problem(model, model.parameters(tools, sets[0].setups), placed, tuple(more))


def _with_orientation(model: ErrorModel, data: Measurements, frames: Frames) -> Measurements:
    placed = frames.bases[data.setup] @ data.tips(model.robot) @ data.placed_by(frames.tools)
    sigma = np.repeat(data.sigma[:, :1], 6, axis=1)
    return replace(data, kind="pose", orientation=read_only(placed[:, :3, :3]), sigma=read_only(sigma))


def _per_unit(problem: Problem) -> tuple[Array, list[str]]:
    """Return the Jacobian (rows, p) of a problem at its start, in m and rad per SI unit, and parameter names."""
    x = values_at(problem.model.robot, problem.parameters, problem.reference)
    J = np.concatenate([part.reshape(-1, len(x)) for part in jacobian(problem, x)])
    return J, [parameter.name for parameter in problem.parameters]


def _shown(J: Array, names: Sequence[str], new: Sequence[int], direction: NullDirection) -> bool:
    """Whether a direction moves the residuals, whatever the new unknowns do to undo it."""
    number = {name: k for k, name in enumerate(names)}
    columns = np.array([number[name] for name in direction.shares])
    # The parameter itself moves one way; what the others imitate is taken back.
    signs = np.where(np.arange(len(columns)) == 0, 1.0, -1.0)
    moved = J[:, columns] * (np.array(list(direction.shares.values())) * signs)
    rest = moved.sum(axis=1)
    if new:
        rest = rest - J[:, new] @ np.linalg.lstsq(J[:, new], rest, rcond=None)[0]
    return bool(np.linalg.norm(rest) > _SHOWN * np.linalg.norm(moved))


def _correlated(fit: Fit) -> list[Advice]:
    seen = fit.correlated
    sigmas = fit.sigmas[seen]
    correlation = fit.told_covariance(seen) / (sigmas[:, None] * sigmas)
    said = []
    for i, j in zip(*np.nonzero(np.triu(np.abs(correlation) > _CORRELATED, 1)), strict=True):
        a, b = (fit.parameters[seen[k]].name for k in (i, j))
        r = float(correlation[i, j])
        how = "difference" if r > 0.0 else "sum"
        said.append(
            Advice(
                "correlated",
                (a, b),
                f"{a} and {b} are correlated by {r:+.3f}: their weighted {how} is known much better than each alone.",
            )
        )
    return said
