"""Sanity before any fit: a typical mistake in a table, recognised by its signature and named with the evidence.

A mistake that everybody makes once (a flipped sign, swapped columns, degrees for radians) lets the nominal robot miss
its measurements by decimetres, and mending it brings them back. So where they are missed, the mistakes of one table are
mended on trial, and the one that brings them back is named. To miss means here: what the best base and tool leave,
joint offsets of a typical size allowed for. Those are what calibration is for; they must neither look like a mistake
nor hide one.

What no data can tell apart is said together: where a free base or tool takes the rest, the sign of an outer joint and
half a turn of the one next to it (UR10: joints 1 and 2, and 6 and 5; Panda: 1 and 2). A zero that a free base or tool
absorbs is no mistake. Two mistakes at once are not searched, but for signs and zeros of any number of joints
(:mod:`calib.identification.zeros`); no single one explains them, and that is said.

Photographs of a board are taken for the poses that they show (:mod:`calib.identification.photographed_poses`).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations, islice, pairwise, product
from typing import Literal

import numpy as np
import numpy.typing as npt

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array, evenly_spread, read_only
from calib.foundations.errors import PoseError
from calib.foundations.units import DEG, INCH, MM
from calib.foundations.words import counted, shown
from calib.identification.arrow import Split
from calib.identification.error_model import ErrorModel
from calib.identification.initialisation.frames import initial_frames
from calib.identification.initialisation.problem import initial_problem, with_common_names
from calib.identification.machine import values_at
from calib.identification.parameters import Priors, scales
from calib.identification.photographed_poses import Strays, poses_seen, strays
from calib.identification.system import Problem, evaluate
from calib.identification.zeros import Zeros, other_zeros, told
from calib.measurement.checks import Finding
from calib.measurement.instruments import CameraPlace
from calib.measurement.measurements import Measurements, reach_of
from calib.robot.robot import Reading

# Ordinary joint offsets: their standard deviation, and how many of these at most. Allowing for them is what makes the
# signatures sharp: besides 1 deg of offsets and 1 mm of placements, a UR10's flipped wrist_2 leaves 53 times what it
# leaves mended, and only 5 times if they are not allowed for; besides 5 deg and 10 mm, 3.3 times and 1.3.
_ORDINARY_ANGLE = 5.0 * DEG
_ORDINARY_LENGTH = 0.01
_MOST_ORDINARY = 2.0
# The thresholds, as fractions of the reach and as factors, from simulated UR10 and Panda arms, 10 to 300 positions or
# poses. Sound arms with 1 deg, 1 mm and 2 mrad of errors are missed by 0.1 to 0.9 %, and nothing is tried. With up to
# 5 deg, and 10 mm and 10 mrad (standard deviations) in every placement, it is 0.6 to 4.9 %, and no mistake lowers that
# by more than 1.07. A wrong robot (UR3, UR5, UR10 for each other) is missed by 10 to 56 %, which its size lowers by 2.2
# to 29 and nothing else by more than 1.2. A mistake that was made lowers it by 13 at least besides 1 deg of errors.
_GOOD = 0.01
_CLEARLY = 3.0
_LARGE = 0.07
# Mended, all comes near but ordinary errors. A wrong given base misses by so much that nonsense can lower it threefold.
_EXPLAINED = 0.1
# Zeros of several joints are many ways to bring another maker's arm nearer: two of them left 4 % of the reach, and true
# ones 0.9 % at most.
_EXPLAINED_BY_ZEROS = 0.02
_OTHER_ZEROS = "other-zeros"
# An explanation that does not suffice is worth mentioning if it halves what is missed.
_HELPFULLY = 2.0
# Explanations that leave up to 1.5 times as much are mentioned; within a hundredth the first of the table is the best,
# of zeros and signs within a tenth: in the few steps of a trial those that are the same for an arm differ by so much.
_AS_WELL = 1.5
_SAME, _SAME_ZEROS = 1.01, 1.1
# Sizes of one family differ by more (UR3, UR5, UR10: 1.4 to 2.4); a unit is taken for one within this factor.
_ANOTHER_SIZE, _FAMILY = 1.1, 4.0
_LIKE_A_UNIT = 1.15
# A board as large as is stated shows a size as true as the nominal robot is.
_ANOTHER_BOARD = 1.02
# Cost: evenly spread rows, evaluations of a trial (the last steps change the third digit; without an instrument's frame
# a start is less near, and more are needed), trials after the screening.
_MOST_ROWS = 120
# Three times those of the longest arm we know; without an instrument, where a trial costs more, half as many.
_MOST_TRIED, _MOST_TRIED_UNSEEN = 30, 15
_NUMBERS_PER_UNKNOWN = 2
_EVALUATIONS, _EVALUATIONS_UNSEEN = 4, 16
# A trial ends where one step changes what is missed by less than this share.
_HARDLY = 1e-3
_PROMISING = 8
_LISTED = 3
# Set-ups that are missed and in which a mistake is sought: a hundred whose rows are noise took half a minute.
_MOST_SOUGHT = 10
# Tables in which alone a mistake is tried: forty of ten rows each, of a wrong robot, took over a minute.
_MOST_ALONE = 3

_NEGLIGIBLE = 1e-10
# Numbers in tables are not written finer; what leaves less explains all.
_ROUNDED = 1e-6

Mend = Callable[[Measurements], Measurements]


@dataclass(frozen=True, slots=True)
class Mistake:
    """A mistake: its code, what it looks as if, and how rows that suffered it are mended.

    Mending makes positions ``shrink`` times smaller. What it leaves then counts so many times: positions shrunk to a
    point are explained by any robot that hardly moves.
    """

    code: str
    looks_as_if: str
    mend: Mend
    shrink: float = 1.0
    zeros: Zeros | None = None


@dataclass(frozen=True, slots=True)
class _Trial:
    """What one mistake, mended in the sets of ``scope``, leaves of the miss, in m."""

    mistake: Mistake
    scope: tuple[int, ...]
    miss: float

    @property
    def counted(self) -> float:
        """The miss by which the mistake is judged."""
        return self.miss * self.mistake.shrink


@dataclass(frozen=True, slots=True)
class Named:
    """What is wrong with measurements; ``zeros``: how readings count then, where that is what is wrong."""

    finding: Finding
    zeros: Zeros | None = None


def signatures(model: ErrorModel, measurements: Sequence[Measurements]) -> tuple[Finding, ...]:
    """Return :func:`named`, the findings alone."""
    return tuple(one.finding for one in named(model, measurements))


def named(model: ErrorModel, measurements: Sequence[Measurements]) -> tuple[Named, ...]:
    """Return the typical mistake that explains why the nominal robot misses the measurements; usually nothing.

    A mistake is sought in all sets together, then in every single one, and in the rows of one set-up after the other,
    until the robot has missed ten of them.
    An error names it, and what explains the rows as well; a warning says that the robot misses them by far and no
    typical mistake explains it. Too few rows to judge give nothing. Raises MeasurementError when the measurements are
    not of this robot.
    """
    with linear.one_thread(of_scipy=False):
        placed = [data for data in measurements if len(data) and data.position is not None and data.points is None]
        # Without an instrument the readings alone can be wrong, and what stays in place shows that they are.
        touched = [data for data in measurements if len(data) and data.position is None and data.camera is None]
        camera_on = None
        if not placed:
            model, placed, camera_on = poses_seen(model, [data for data in measurements if len(data)])
        sets = [data.at_readings() for data in placed or touched]
        setups = dict.fromkeys(setup for data in sets for setup in data.setups)
        loaded = [data.loaded(model.urdf_robot) for data in sets]
        # One arm has one zero for each joint, in whatever set-up: sought once, and only where nothing else explains.
        zeros = cache(lambda: () if camera_on else tuple(_of_zeros(model, loaded)))
        sought = (
            _named(model.at(setup), [data.at(setup) for data in loaded if setup in data.setups], camera_on, zeros)
            for setup in setups
        )
        missed = islice((found for found in sought if found is not None), _MOST_SOUGHT)
        return tuple(one for found in missed for one in found)


@dataclass(frozen=True, slots=True)
class Apart:
    """What each table has of its own: its ``tool``, its ``setup``, or both; by how much the nominal robot misses them.

    ``missed``: with one for all, ``left``: with one of each, rms in m.
    """

    what: tuple[Literal["tool", "setup"], ...]
    missed: float
    left: float

    @property
    def sentence(self) -> str:
        """It, with the evidence."""
        said = {
            "tool": "the tool is another one in each",
            "setup": "robot or instrument stood elsewhere in each",
        }
        return (
            f"{' and '.join(said[what] for what in self.what)}: the arm misses them by {_mm(self.missed)} with one for "
            f"all, and by {_mm(self.left)} with its own"
        )


def apart(model: ErrorModel, measurements: Sequence[Measurements]) -> Apart | None:
    """Return what each of several tables of positions or poses has of its own, None where nothing shows it."""
    with linear.one_thread(of_scipy=False):
        seen = [data.at_readings() for data in measurements if len(data) and data.position is not None]
        if len(seen) < 2 or len(seen) < len(measurements):
            return None
        sets = tuple(_spread_rows(data, seen) for data in with_common_names(model, seen))
        missed, reach = _miss(model, sets), reach_of(model.robot, sets)
        if missed < _GOOD * reach:
            return None
        best = _likeliest(_trials_of_tables(model, sets))[0]
        if missed <= _CLEARLY * best.miss or best.miss > _EXPLAINED * reach:
            return None
        return Apart(_OF_TABLES[best.mistake.code], missed, best.miss)


def _named(
    model: ErrorModel,
    sets: Sequence[Measurements],
    camera_on: CameraPlace | None,
    zeros: Callable[[], Sequence[Mistake]],
) -> tuple[Named, ...] | None:
    """Return the mistake in the rows of one set-up; None where they are too few, or near where they should be."""
    filled = [data for data in sets if len(data)]
    if not filled:
        return None
    sets = tuple(_spread_rows(data, filled) for data in with_common_names(model, filled))
    problem, reach = _problem(_ordinary(model), sets), reach_of(model.robot, sets)
    if sum(data.sigma.size for data in sets) < _NUMBERS_PER_UNKNOWN * len(problem.parameters):
        return None
    missed = _missed(problem)
    # One number of a row, such as a length, shows a third of the square of an error in space.
    shown = min(3.0, sum(data.sigma.size for data in sets) / sum(map(len, sets))) / 3.0
    if missed < _GOOD * reach * float(np.sqrt(shown)):
        return None
    if camera_on and (found := strays(model, sets)) is not None:
        return (Named(_contradicted(sets, found)),)
    every = tuple(range(len(sets)))
    tables = _trials_of_tables(model, sets) if len(every) > 1 and _seen(sets) and not camera_on else []
    if model.tool == "position" and any(data.kind == "pose" for data in sets) and not camera_on:
        # Poses are taken to be turned as the link of the tool is.
        turned = _Trial(_TURNED, every, _reached(_miss, replace(model, tool="pose"), sets))
        # A tool of each table's own explains no less.
        tables = [turned, *(trial for trial in tables if _CLEARLY * trial.counted < turned.miss)]
    tried: list[_Trial] = []
    explained: list[_Trial] = []
    for scope, trials, most, same in _searches(
        model, sets, tables, camera_on, zeros if missed > _LARGE * reach else tuple
    ):
        if not trials:
            continue
        best, *others = _likeliest(trials, same)
        # Readings that are made too small explain positions that hardly change: a robot that stands still does so too.
        still = _still([best.mistake.mend(sets[i]) for i in scope]) if _seen(sets) else np.inf
        # What is found later is less typical, and must explain clearly more.
        before = explained[0].counted if explained else missed
        if before > _CLEARLY * best.counted and best.miss < min(most * reach, still):
            explained = [best, *others]
        tried.append(best)
        if explained and explained[0].miss < _GOOD * reach:
            break
    if explained:
        best, *others = explained
        return (Named(_explained(model, sets, missed, best, others), best.mistake.zeros),)
    if missed <= _LARGE * reach:
        return ()
    return (Named(_unexplained(model, sets, missed, min(tried, key=_counted, default=None))),)


def _searches(
    model: ErrorModel,
    sets: Sequence[Measurements],
    tables: Sequence[_Trial],
    camera_on: CameraPlace | None,
    zeros: Callable[[], Sequence[Mistake]],
) -> Iterator[tuple[tuple[int, ...], list[_Trial], float, float]]:
    """Yield the tables in which a mistake may be, its trials, what they may leave, and what is the same.

    May leave: a share of the reach; the same is what leaves up to so many times as much. ``tables``: trials of what
    tables have of their own. ``zeros``: those of several joints, when asked for.
    """
    every = tuple(range(len(sets)))
    yield every, [*_trials(model, sets, every, camera_on), *tables], _EXPLAINED, _SAME
    for scope in _alone(model, sets):
        yield scope, [*_trials(model, sets, scope, camera_on), *tables], _EXPLAINED, _SAME
    by_zeros = _trials_of(model, sets, every, zeros())
    most = _EXPLAINED_BY_ZEROS * (_spare(model, sets) if by_zeros and _seen(sets) else 1.0)
    yield every, by_zeros, most, _SAME_ZEROS


def _spare(model: ErrorModel, sets: Sequence[Measurements]) -> float:
    """Return the share of what any arm is missed by that is left to see, when its zeros and signs are unknown too.

    So many unknowns bring any arm near few rows: another maker's left 1.7 % of the reach in 16.
    """
    unknown = len(_problem(_ordinary(model), sets).parameters) + len(model.robot.readings)
    return float(np.sqrt(max(0.0, 1.0 - unknown / sum(data.sigma.size for data in sets))))


def _alone(model: ErrorModel, sets: Sequence[Measurements]) -> Iterator[tuple[int, ...]]:
    """Yield the tables in which alone a mistake may be: of many those without which the arm misses the others least."""
    chosen = list(range(len(sets))) if len(sets) > 1 else []
    if len(chosen) > _MOST_ALONE:
        screen = _relaxed_miss if _seen(sets) else _second_miss
        left = [_reached(screen, model, [*sets[:i], *sets[i + 1 :]]) for i in chosen]
        chosen = sorted(np.argsort(left, kind="stable")[:_MOST_ALONE].tolist())
    yield from ((i,) for i in chosen)


def _spread_rows(data: Measurements, sets: Sequence[Measurements]) -> Measurements:
    """Return at most a fair share of ``_MOST_ROWS`` rows, spread evenly."""
    share = max(1, _MOST_ROWS * len(data) // sum(map(len, sets)))
    return data if len(data) <= share else data.subset(evenly_spread(len(data), share))


def _positions(data: Measurements) -> Array:
    """Return the measured positions (N, 3) of a set; those without were left out at the door."""
    assert data.position is not None, "mistakes are sought in positions and poses"
    return data.position


# ---- how far the robot misses


def _ordinary(model: ErrorModel) -> ErrorModel:
    """Return the model in which nothing but base, tool and ordinary joint offsets is unknown."""
    return replace(
        model,
        offsets=tuple(model.robot.chain[i].name for i in model.robot.moving),
        placements=(),
        terms=(),
        priors=Priors(_ORDINARY_LENGTH, _ORDINARY_ANGLE),
    )


def _miss(model: ErrorModel, sets: Sequence[Measurements], evaluations: int | None = None) -> float:
    """Return :func:`_missed` of base, tool and ordinary offsets."""
    return _missed(_problem(_ordinary(model), sets), evaluations)


def _missed(problem: Problem, evaluations: int | None = None) -> float:
    """Return the rms over the rows, in m, that what is unknown leaves; turns weigh times the reach.

    Gauss-Newton from the best base and tool: priors hold the offsets back while much is unexplained, and limits always.
    Without ``evaluations``, as many as are usual. Where a step opens a closed loop, what was missed before it counts.
    """
    parameters, sets, robot = problem.parameters, problem.measurements, problem.model.robot
    if evaluations is None:
        evaluations = _EVALUATIONS if _seen(sets) else _EVALUATIONS_UNSEEN
    units = np.repeat([1.0, 1.0 / reach_of(robot, sets)], 3)
    sigmas = [np.broadcast_to(units[: data.sigma.shape[1]], data.sigma.shape) for data in sets]
    s = scales(parameters)
    z = values_at(robot, parameters, problem.reference) / s
    of_robot = np.array([parameter.of_robot for parameter in parameters])
    limit = np.where(of_robot, _MOST_ORDINARY, np.inf)
    least = before = np.inf
    for _ in range(evaluations):
        try:
            data = np.concatenate(evaluate(problem, sigmas, z * s, Split.none(len(z))).triangles)
        except PoseError:
            break
        miss = float(np.linalg.norm(data[:, -1])) / float(np.sqrt(sum(map(len, sets))))
        least = min(least, miss)
        if evaluations > _EVALUATIONS and abs(before - miss) < _HARDLY * miss:
            break
        before = miss
        priors = np.column_stack([np.eye(len(z)), z])[of_robot]
        rows = np.concatenate([data / max(miss, _NEGLIGIBLE), priors])
        z = np.clip(z - np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=_NEGLIGIBLE)[0], -limit, limit)
    return least


def _problem(model: ErrorModel, sets: Sequence[Measurements]) -> Problem:
    """Return the problem of a model in which little is unknown; of what an instrument saw, without targets."""
    if not _seen(sets):
        return initial_problem(model.within(sets), sets)
    parameters = model.parameters(sets[0].tools, sets[0].setups)
    return Problem(model, parameters, initial_frames(model, sets), tuple(sets))


def _seen(sets: Sequence[Measurements]) -> bool:
    """Return whether an instrument saw positions or poses; sets of both kinds never come together."""
    return sets[0].position is not None


def _still(sets: Sequence[Measurements]) -> float:
    """Return the rms over the rows, in m, by which a robot that stands still misses the measurements."""
    y = np.concatenate(list(map(_positions, sets)))
    return float(np.linalg.norm(y - y.mean(axis=0))) / float(np.sqrt(len(y)))


def _relaxed(model: ErrorModel, sets: Sequence[Measurements]) -> tuple[Array, float]:
    """Return the matrix A (3, 3) for R_base^T that explains the rows best, and the rms in m that it leaves.

    As in :mod:`calib.identification.initialisation.base_and_tools`, ``A x_n + s = t_n + R_n p`` and ``R_n^T A
    R_measured`` is the same for all rows of a tool, with A any matrix: linear, and never worse than the best rotation.
    """
    tips = np.concatenate([data.tips(model.robot) for data in sets])
    R, t = tips[:, :3, :3], tips[:, :3, 3]
    tool = np.concatenate([data.tool for data in sets])
    unknown = np.full((len(tool), 3, 3), np.nan)
    seen = [unknown[: len(data)] if data.orientation is None else data.orientation for data in sets]
    orientation = np.concatenate(seen)
    y = np.concatenate([_positions(data) for data in sets])
    y = y - y.mean(axis=0)
    size = max(float(np.abs(y).max()), _NEGLIGIBLE)
    X = np.einsum("ni,jk->njki", y / size, np.eye(3)).reshape(-1, 9)
    points = [(-R * (tool == k)[:, None, None]).reshape(-1, 3) for k in range(len(sets[0].tools))]
    rows = [np.column_stack([X, np.tile(np.eye(3), (len(y), 1)), *points, t.ravel()])]
    turned = ~np.isnan(orientation[:, 0, 0])
    for own in (turned & (tool == k) for k in np.unique(tool[turned])):
        # vec(R^T A R_measured) = K vec(A); the mean stands for the tool.
        K = np.einsum("nki,nml->nilkm", R[own], orientation[own]).reshape(-1, 9, 9)
        K = linear.triangle((K - K.mean(axis=0)).reshape(-1, 9))
        # |R - R'|^2 is twice the angle squared.
        rows.append(np.pad(K * reach_of(model.robot, sets) / np.sqrt(2.0) / size, ((0, 0), (0, rows[0].shape[1] - 9))))
    triangle = linear.triangle(np.concatenate(rows))
    L, c = triangle[:, :-1], triangle[:, -1]
    solution = np.asarray(np.linalg.lstsq(L, c, rcond=_NEGLIGIBLE)[0], dtype=np.float64)
    return solution[:9].reshape(3, 3) / size, float(np.linalg.norm(c - L @ solution)) / float(np.sqrt(len(y)))


# ---- trials


def _counted(trial: _Trial) -> float:
    return trial.counted


def _trials(
    model: ErrorModel, sets: Sequence[Measurements], scope: tuple[int, ...], camera_on: CameraPlace | None
) -> list[_Trial]:
    """Return trials of the promising mistakes."""
    chosen, seen = [sets[i] for i in scope], _seen(sets)
    others = _of_frames(model, chosen, camera_on) if seen else _of_indicators(chosen)
    table = (*_of_readings(_tried_one_by_one(model, sets), units=seen), *others)
    more = tuple(_not_in_screening(model, chosen, camera_on)) if seen else ()
    return _trials_of(model, sets, scope, table, more)


def _tried_one_by_one(model: ErrorModel, sets: Sequence[Measurements]) -> tuple[Reading, ...]:
    """Return the readings; of too many none, as what one may have wrong is tried each time for the whole arm."""
    most = _MOST_TRIED if _seen(sets) else _MOST_TRIED_UNSEEN
    return model.robot.readings if len(model.robot.readings) <= most else ()


def _trials_of(
    model: ErrorModel,
    sets: Sequence[Measurements],
    scope: tuple[int, ...],
    table: Sequence[Mistake],
    more: Sequence[Mistake] = (),
) -> list[_Trial]:
    """Return trials of the promising mistakes of a table, and of ``more``."""

    def mended(mistake: Mistake) -> list[Measurements]:
        return [mistake.mend(data) if i in scope else data for i, data in enumerate(sets)]

    # A free base costs a search among all rotations, which few mistakes are worth: a linear fit screens them.
    # Of lengths the start shows no tool; one step does.
    screen = (_relaxed_miss if model.base == "pose" else _first_miss) if _seen(sets) else _second_miss
    screened = [_reached(screen, model, mended(mistake)) for mistake in table]
    promising = [table[i] for i in np.sort(np.argsort(screened, kind="stable")[:_PROMISING])]
    return [_Trial(mistake, scope, _reached(_miss, model, mended(mistake))) for mistake in (*promising, *more)]


def _likeliest(trials: Sequence[_Trial], same: float = _SAME) -> list[_Trial]:
    """Return trials, the best first; of those that leave up to ``same`` times as much, the first of the table."""
    least = max(min(map(_counted, trials)), _ROUNDED)
    # The same to rounding: the order of the table, the most typical first, decides.
    return sorted(trials, key=lambda trial: max(trial.counted, same * least))


def _trials_of_tables(model: ErrorModel, sets: Sequence[Measurements]) -> list[_Trial]:
    """Return trials of what may differ from table to table, and nobody has said: the tool, and where the robot is."""
    every, found = tuple(range(len(sets))), []
    for mistake in _TABLES:
        own = model
        if "tool" in _OF_TABLES[mistake.code]:
            own = replace(own, tool="pose")
        if "setup" in _OF_TABLES[mistake.code]:
            own = replace(own, base="pose")
        mended = with_common_names(own, [mistake.mend(data) for data in sets])
        found.append(_Trial(mistake, every, _reached(_miss, own, mended)))
    return found


def _reached(
    miss: Callable[[ErrorModel, Sequence[Measurements]], float], model: ErrorModel, mended: Sequence[Measurements]
) -> float:
    """Return what mended rows miss: without end where the arm cannot take their poses, as with a loop left open."""
    try:
        return miss(model, mended)
    except PoseError:
        return np.inf


def _relaxed_miss(model: ErrorModel, sets: Sequence[Measurements]) -> float:
    A, left = _relaxed(model, sets)
    # Rotations have the norm sqrt(3); A fades away where robot and measurements have nothing in common.
    return left * float(np.sqrt(3.0)) / max(float(np.linalg.norm(A)), _NEGLIGIBLE)


def _first_miss(model: ErrorModel, sets: Sequence[Measurements]) -> float:
    return _miss(model, sets, evaluations=1)


def _second_miss(model: ErrorModel, sets: Sequence[Measurements]) -> float:
    return _miss(model, sets, evaluations=2)


# ---- sentences


def _explained(
    model: ErrorModel, sets: Sequence[Measurements], missed: float, best: _Trial, others: Sequence[_Trial]
) -> Finding:
    as_well = [trial.mistake.looks_as_if for trial in others if trial.counted <= _AS_WELL * best.counted]
    more = f", or {len(as_well) - _LISTED} more" if len(as_well) > _LISTED else ""
    also = f"; it could also be that {', or that '.join(as_well[:_LISTED])}{more}" if as_well else ""
    if best.mistake.code == _OTHER_ZEROS:
        also = f"; {counted(len(as_well), 'other combination')} of zeros and signs would do as well" if as_well else ""
    return Finding(
        "error",
        best.mistake.code,
        f"{_where(sets, best.scope)}: it looks as if {best.mistake.looks_as_if}: {_misses(model, sets, missed)}, "
        f"and by {_mm(best.miss)} with this corrected{also}.",
    )


def _unexplained(model: ErrorModel, sets: Sequence[Measurements], missed: float, best: _Trial | None) -> Finding:
    fixed = [name for name, freedom in (("base", model.base), ("tool", model.tool)) if freedom == "fixed"]
    nearest = ""
    if best is not None and missed > _HELPFULLY * best.counted:
        nearest = f" (the nearest, that {best.mistake.looks_as_if}, leaves {_mm(best.miss)})"
    questions = (
        "is this the URDF of the robot that was measured",
        *(f"is the given {name} right" for name in fixed),
        f"is a joint offset above {_MOST_ORDINARY * _ORDINARY_ANGLE / DEG:.0f} deg",
        *(("does a loop close another way than the URDF draws it",) if model.robot.loops else ()),
        "do readings and measurements of a row belong together",
        "or are there two mistakes?",
    )
    return Finding.warning(
        "unexplained",
        f"{_where(sets, range(len(sets)))}: {_misses(model, sets, missed)}, and no typical mistake explains it"
        f"{nearest}: {', '.join(questions)}",
    )


def _contradicted(sets: Sequence[Measurements], found: Strays) -> Finding:
    """Return that few photographs are elsewhere than where all others put them."""
    told = [
        f"{shown(name)} by {_mm(length)} and {angle / DEG:.3g} deg"
        for name, length, angle in zip(found.names, found.lengths, found.angles, strict=True)
    ]
    more = f", and {len(told) - _LISTED} more" if len(told) > _LISTED else ""
    return Finding.warning(
        "stray-photographs",
        f"{_where(sets, range(len(sets)))}: photographs are off from where all others put them: "
        f"{', '.join(told[:_LISTED])}{more}: do their readings belong to them, and are they as the camera took them?",
    )


def _misses(model: ErrorModel, sets: Sequence[Measurements], missed: float) -> str:
    turns = any(data.orientation is not None for data in sets)
    weighed = f" (1 rad counted as {reach_of(model.robot, sets):.3g} m)" if turns else ""
    return f"the nominal robot misses the measurements by {_mm(missed)} rms{weighed}"


def _where(sets: Sequence[Measurements], scope: Sequence[int]) -> str:
    return ", ".join(dict.fromkeys(sets[i].where for i in scope))


def _mm(metres: float) -> str:
    millimetres = metres / MM
    return f"{millimetres:.0f} mm" if millimetres >= 100.0 else f"{millimetres:.2g} mm"


# ---- the table of mistakes, the most typical first


def _of_readings(readings: Sequence[Reading], *, units: bool) -> Iterator[Mistake]:
    """Yield what readings may have wrong; ``units``: also those by which a robot hardly moves and touches one place."""
    ones = np.eye(len(readings))
    for reading, one in zip(readings, ones, strict=True):
        says = f"{reading.name!r} is read with the wrong sign"
        yield _counted_otherwise("flipped-sign", says, Zeros(1.0 - 2.0 * one, 0.0 * one))
    for i, j in combinations(range(len(readings)), 2):
        if readings[i].dimension == readings[j].dimension:
            a, b = readings[i].name, readings[j].name
            swap = ones.copy()
            swap[[i, j]] = swap[[j, i]]
            yield Mistake("swapped-joints", f"the columns {a!r} and {b!r} are swapped", otherwise_read(swap=swap))
    for i, (a, b) in enumerate(pairwise(reading.name for reading in readings)):
        for sign in (1.0, -1.0) if readings[i].dimension == readings[i + 1].dimension == "angle" else ():
            # An elbow that is read against the floor, a wrist that is driven through another one.
            follows = ones.copy()
            follows[i, i + 1] = sign
            says = f"{a!r} and {b!r} are coupled: the joint of {b!r} stands at {b} {'+' if sign > 0.0 else '-'} {a}"
            yield Mistake("coupled-joints", says, otherwise_read(swap=follows))
    for reading, one in zip(readings, ones, strict=True):
        for degrees in ("+90", "-90", "180") if reading.dimension == "angle" else ():
            says = f"{reading.name!r} is read from another zero and needs {degrees} deg"
            zeros = Zeros(np.ones_like(one), float(degrees) * DEG * one)
            yield _counted_otherwise("shifted-zero", says, zeros)
    for dimension, factor, says in _READING_UNITS if units else ():
        its = np.array([reading.dimension == dimension for reading in readings])
        if its.any():
            yield Mistake("reading-unit", says, otherwise_read(np.where(its, factor, 1.0)))


def _of_zeros(model: ErrorModel, sets: Sequence[Measurements]) -> Iterator[Mistake]:
    """Yield signs and zeros of several joints that bring the robot near; those of one have been tried.

    Of what cannot be searched, such as touches, two zeros of an elbow.
    """
    at_base, at_tool = model.base == "pose", model.tool != "fixed"
    if any(data.orientation is not None for data in sets):
        at_tool = model.tool == "pose"
    readings = model.robot.readings
    found = other_zeros(model.robot, sets, at_base=at_base, at_tool=at_tool) if _seen(sets) else ()
    for zeros in found or _two_zeros(_tried_one_by_one(model, sets)):
        says = f"the readings have other zeros or signs than the URDF: {told(zeros.by_name(readings))}"
        yield _counted_otherwise(_OTHER_ZEROS, says, zeros)


def _two_zeros(readings: Sequence[Reading]) -> Iterator[Zeros]:
    """Yield two neighbouring zeros of quarter turns: an arm that is drawn straight, and at zero has a bent elbow."""
    ones = np.eye(len(readings))
    for i, (a, b) in enumerate(pairwise(readings)):
        for first, second in product((90.0, -90.0), repeat=2) if a.dimension == b.dimension == "angle" else ():
            yield Zeros(np.ones(len(readings)), DEG * (first * ones[i] + second * ones[i + 1]))


def _counted_otherwise(code: str, says: str, zeros: Zeros) -> Mistake:
    return Mistake(code, says, otherwise_read(zeros.signs, zeros.offsets), zeros=zeros)


def _of_frames(model: ErrorModel, sets: Sequence[Measurements], camera_on: CameraPlace | None) -> Iterator[Mistake]:
    """Yield what a free base cannot absorb: columns where something else tells the axes, and orientations."""
    if camera_on:
        yield _camera_elsewhere(camera_on)
        return
    turned = any(data.orientation is not None for data in sets)
    yield from _COLUMNS if turned or model.base == "fixed" else ()
    yield from _ORIENTATIONS if turned else ()


def _of_indicators(sets: Sequence[Measurements]) -> Iterator[Mistake]:
    """Yield the sense in which indicators count: of all, and of each where there are several."""
    dials = [data for data in sets if data.kind == "indicator"]
    names = tuple(dict.fromkeys(data.targets[k] for data in dials for k in data.target))
    other = "the other way: 'indicated' has the wrong sign, or the normal points away"
    if names:
        yield Mistake(
            "indicator-sign",
            f"{'indicators count' if len(names) > 1 else 'the indicator counts'} {other}",
            _backward(names),
        )
    for name in names if 1 < len(names) <= _MOST_TRIED else ():
        yield Mistake("indicator-sign", f"the indicator {shown(name)} counts {other}", _backward((name,)))


def _backward(names: Sequence[str]) -> Mend:
    """Count the values of these indicators the other way."""

    def mend(data: Measurements) -> Measurements:
        if data.kind != "indicator":
            return data
        own = np.array([name in names for name in data.targets])[data.target]
        return replace(data, value=read_only(np.where(own[:, None], -data.value, data.value)))

    return mend


def _not_in_screening(
    model: ErrorModel, sets: Sequence[Measurements], camera_on: CameraPlace | None
) -> Iterator[Mistake]:
    """Yield the mistakes that a linear fit cannot show: it takes a robot of any size, from positions also mirrored."""
    positions = [replace(data, orientation=None) for data in sets]  # orientations have no size, and pull A to nothing
    determinant = abs(float(np.linalg.det(_relaxed(model, positions)[0])))
    size = max(determinant, _NEGLIGIBLE**4) ** (-1.0 / 3.0)
    if camera_on:
        if max(size, 1.0 / size) > _ANOTHER_BOARD:
            says = f"the board is {1.0 / size:.3g} times as large as stated"
            if max(size, 1.0 / size) < _FAMILY:
                says += f", or the machine {size:.3g} times as large as the URDF says"
            yield Mistake("board-size", says, _placed(np.eye(3) / size), max(size, 1.0))
        return
    for factor, says in _POSITION_UNITS:
        if max(size / factor, factor / size) < _LIKE_A_UNIT:
            yield Mistake("position-unit", says, _placed(np.eye(3) / factor), max(factor, 1.0))
            break
    else:
        if _ANOTHER_SIZE < max(size, 1.0 / size) < _FAMILY:
            says = f"the machine is {size:.3g} times the size of the URDF, another one of its family"
            yield Mistake("another-size", says, _placed(np.eye(3) / size), max(size, 1.0))
    if model.base == "pose" and all(data.orientation is None for data in sets):
        says = "x, y, z are left-handed: two of the columns are swapped, or one has the wrong sign"
        yield Mistake("position-columns", says, _placed(-np.eye(3)))


def _camera_elsewhere(camera_on: CameraPlace) -> Mistake:
    says = {
        "tip": 'the camera stands beside the robot, and the board is on the tip: camera_on = "floor"',
        "floor": 'the camera is on the tip, and the board stands beside the robot: camera_on = "tip"',
    }
    return Mistake("camera-on", says[camera_on], _inverted)


def otherwise_read(factor: Array | float = 1.0, offset: Array | float = 0.0, swap: Array | None = None) -> Mend:
    """Return what reads joints otherwise: columns swapped by a matrix (nr, nr), times factors (nr,), and moved."""

    def mend(data: Measurements) -> Measurements:
        def right(readings: Array) -> Array:
            return read_only((readings if swap is None else readings @ swap) * factor + offset)

        other = None if data.other is None else replace(data.other, readings=right(data.other.readings))
        return replace(data, readings=right(data.readings), other=other)

    return mend


def _placed(matrix: npt.ArrayLike) -> Mend:
    M = read_only(matrix)
    return lambda data: replace(data, position=read_only(_positions(data) @ M.T))


def _turned(change: Callable[[Array], Array]) -> Mend:
    def mend(data: Measurements) -> Measurements:
        R = data.orientation
        return data if R is None else replace(data, orientation=read_only(change(R)))

    return mend


def _inverted(data: Measurements) -> Measurements:
    if data.orientation is None:
        return data
    T = rigid.inverse(rigid.placement(data.orientation, _positions(data)))
    return replace(data, position=read_only(T[:, :3, 3]), orientation=read_only(T[:, :3, :3]))


def _reordered(order: Sequence[int]) -> Mend:
    """Read the quaternion's numbers in another order; its sign, which a rotation forgets, is the same for all four."""
    return _turned(lambda R: rigid.rotation_of_quaternion(rigid.quaternion_of(R)[:, list(order)]))


def _tool_of_its_own(data: Measurements) -> Measurements:
    return replace(data, tools=tuple(f"{name} of {data.where}" for name in data.tools))


def _set_up_of_its_own(data: Measurements) -> Measurements:
    return replace(data, setups=tuple(f"{name} of {data.where}" for name in data.setups))


def _both_of_its_own(data: Measurements) -> Measurements:
    return _tool_of_its_own(_set_up_of_its_own(data))


# What differs from table to table; each is to be named in the job. Both together explain no less than one of them, and
# count only where they leave a third of it.
_TABLES = (
    Mistake("own-tools", 'each table has a tool of its own, which tool = "..." names for each', _tool_of_its_own),
    Mistake(
        "own-set-ups",
        'robot or instrument stood elsewhere in each table, which setup = "..." names for each',
        _set_up_of_its_own,
    ),
    Mistake(
        "own-tools-and-set-ups",
        'each table has a tool of its own, and robot or instrument stood elsewhere in each, which tool = "..." and '
        'setup = "..." name for each',
        _both_of_its_own,
        shrink=_CLEARLY,
    ),
)
_TURNED = Mistake("turned-tool", 'the tool is turned on its link, which tool = "pose" finds', lambda data: data)
_OF_TABLES: Mapping[str, tuple[Literal["tool", "setup"], ...]] = {
    "own-tools": ("tool",),
    "own-set-ups": ("setup",),
    "own-tools-and-set-ups": ("tool", "setup"),
}
_READING_UNITS: tuple[tuple[str, float, str], ...] = (
    ("angle", DEG, "degrees stand under [rad] in all angles"),
    ("angle", 1.0 / DEG, "radians stand under [deg] in all angles"),
    ("length", MM, "millimetres stand under [m] in all joints that slide"),
    ("length", 1.0 / MM, "metres stand under [mm] in all joints that slide"),
)

# How many times too large the positions are.
_POSITION_UNITS = (
    (1.0 / MM, "millimetres stand under [m] in x, y, z"),
    (MM, "metres stand under [mm] in x, y, z"),
    (INCH / MM, "millimetres stand under [inch] in x, y, z"),
    (MM / INCH, "inches stand under [mm] in x, y, z"),
    (1.0 / INCH, "inches stand under [m] in x, y, z"),
    (INCH, "metres stand under [inch] in x, y, z"),
)

_COLUMNS = tuple(
    Mistake("position-columns", says, _placed(np.diag(signs)[list(order)]))
    for says, order, signs in (
        ("the columns x and y are swapped", (1, 0, 2), (1, 1, 1)),
        ("the columns y and z are swapped", (0, 2, 1), (1, 1, 1)),
        ("the columns x and z are swapped", (2, 1, 0), (1, 1, 1)),
        ("x has the wrong sign", (0, 1, 2), (-1, 1, 1)),
        ("y has the wrong sign", (0, 1, 2), (1, -1, 1)),
        ("z has the wrong sign", (0, 1, 2), (1, 1, -1)),
        ("x, y, z hold y, z, x", (2, 0, 1), (1, 1, 1)),
        ("x, y, z hold z, x, y", (1, 2, 0), (1, 1, 1)),
    )
)

_ORIENTATIONS = (
    Mistake("quaternion-order", "qw, qx, qy, qz hold x, y, z, w", _reordered((3, 0, 1, 2))),
    Mistake("quaternion-order", "qw, qx, qy, qz hold z, w, x, y", _reordered((1, 2, 3, 0))),
    Mistake("inverse-rotation", "the rotations are inverse (quaternions conjugated)", _turned(lambda R: R.mT)),
    Mistake("inverse-pose", "the poses are inverse (of the instrument in the tool)", _inverted),
    Mistake(
        "euler-order",
        "the orientations were made as Rz Ry Rx (extrinsic x, y, z) of angles that mean Rx Ry Rz (intrinsic)",
        _turned(lambda R: rigid.rx_ry_rz(rigid.rpy_of(R))),
    ),
    Mistake(
        "euler-order",
        "the orientations were made as Rx Ry Rz (intrinsic x, y, z) of angles that mean Rz Ry Rx (extrinsic)",
        # Rx Ry Rz of angles is the inverse of Rz Ry Rx of their negatives.
        _turned(lambda R: rigid.rotation_of_rpy(-rigid.rpy_of(R.mT))),
    ),
)
