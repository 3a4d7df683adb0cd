"""How well the arm follows candidates in every unit, and which of them is right."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray, evenly_spread
from calib.foundations.errors import MeasurementError
from calib.foundations.units import UNITS
from calib.foundations.words import first_of, shown
from calib.identification.error_model import error_model
from calib.identification.followed import FEWEST_ROWS, Followed, followed, strays
from calib.identification.sanity import Named, named
from calib.job.foreign.answers import AskedError, Pick, Trial, ask, of_dimension, off_arm, run_of, values_of
from calib.job.foreign.seen import Seen
from calib.job.proposal import About, Question
from calib.measurement.arrays import positions
from calib.measurement.bodies import points_of_one_body
from calib.measurement.cells import to_import
from calib.measurement.raw import RawColumn
from calib.measurement.roles import Point, Rank, changes, numbers_of
from calib.robot.robot import Robot

# A share of the spread of what was measured. Sound arms with a degree and a millimetre of errors leave 0.1 to 1 %, with
# 5 degrees and 10 mm up to 5 %; readings in a wrong unit, order or frame leave 30 % and more.
FOLLOWS = 0.15
# What comes so near, or within three times what the best leaves, is a rival that something else must decide on.
ALIKE, TIMES = 0.1, 3.0
# Nothing that an instrument measures agrees with a URDF so well.
COMPUTED = 2e-5
# By what tips differ at most, in m and in rotations, where the same readings are written twice.
_SAME_READINGS = 1e-6
# Rows on which a reading is tried, and in how many ways one table is read: of each it is seen how well the arm follows.
_MOST_ROWS, _MOST_WAYS = 120, 400
_LIMIT_SLACK = 1.1
# A base and a tool of their own explain a few rows of anything better than many.
_FEWEST_OF_PART = FEWEST_ROWS + 4
_MOST_PARTS = 12
# What the arm follows as well as this, in every part, is no chance.
_PARTS_FOLLOW = 0.1
# Rows that spoil a fit are told from a wrong reading where they are so few: one of so many rows, and so many at most.
_KEPT_FOR_A_STRAY, _MOST_STRAYS = 10, 5
_LOOKED_AT = 12
# In so many readings, of all units together, a mistake is sought; it takes 0.1 s of each.
_MOST_READINGS = 30
# Beyond this angle, in rad, no joint turns; so many times more, or less, than the tips, no points of the same arm are
# spread, whatever its zeros are.
_MOST_TURNED, _OTHERWISE_SPREAD = 8.0 * np.pi, 5.0
# With fewer rows nothing is tried, nor with readings in rad or points in m beyond this.
_FEWEST_TRIED, _LARGEST = 2, 1e4


def trials(seen: Seen, picks: Sequence[Pick], lengths: Sequence[str], before: int = 0) -> list[Trial]:
    """Return picks in all units that they may have, after so many ways that were tried ``before``.

    ``lengths``: units of a point without one. Raises AskedError where that is more than can be tried.
    """
    ways = before + sum(_ways(seen, pick, lengths) for pick in picks)
    if ways > _MOST_WAYS:
        arms, points = (len({getattr(pick, name) for pick in picks}) for name in ("arm", "point"))
        raise ask(
            "columns",
            f"{seen.raw.where}: joints, point and units may be read in {ways} ways (arms: {arms}; "
            f"points: {points}); {_MOST_WAYS} are tried at most",
            (),
            "--tip LINK, --column 'x=TITLE' and so on, --angles and --lengths, as far as you know them",
        )
    return [trial for pick in picks for trial in _trials_of(seen, pick, lengths)]


def without_unit(seen: Seen, picks: Sequence[Pick]) -> list[Pick]:
    """Return the picks whose points may be in any unit of length."""
    return [pick for pick in picks if len(options(_columns_of(seen, pick)[1], seen.answers.lengths, ("m", "mm"))) > 1]


def _ways(seen: Seen, pick: Pick, lengths: Sequence[str]) -> int:
    columns, point = _columns_of(seen, pick)
    units = units_of_joints(seen, seen.robot(pick.arm), columns)
    return len(units) * len(options(point, seen.answers.lengths, lengths))


def _columns_of(seen: Seen, pick: Pick) -> tuple[list[RawColumn], list[RawColumn]]:
    assert pick.point is not None
    joints, point = pick.joints.columns, pick.point.columns
    return [seen.raw.columns[k] for k in joints], [seen.raw.columns[k] for k in point]


def _trials_of(seen: Seen, pick: Pick, lengths: Sequence[str]) -> list[Trial]:
    robot = seen.robot(pick.arm)
    columns, point = _columns_of(seen, pick)
    numbers, rows = _numbers_and_rows(seen, pick)
    rows = rows[evenly_spread(len(rows), _MOST_ROWS)]
    if len(rows) < _FEWEST_TRIED or not of_dimension(point, "length"):
        return []
    found = []
    for angle, slide in units_of_joints(seen, robot, columns):
        q = readings_in(robot, columns, angle, slide)[rows]
        if np.abs(q).max() > _LARGEST:
            continue
        tips = robot.tips(q)
        for unit in options(point, seen.answers.lengths, lengths):
            factors = [UNITS[column.symbol or unit].factor for column in point]
            position = numbers[rows, -3:] * factors
            if np.abs(position).max() > _LARGEST:
                continue
            fit = followed(tips, position) if len(rows) >= FEWEST_ROWS else Followed(np.inf, np.inf, np.eye(4))
            found.append(Trial(pick, (angle, slide, unit), tips, position, rows, fit))
    return found


def _numbers_and_rows(seen: Seen, pick: Pick) -> tuple[Array, IntArray]:
    """Return the columns of joints and point, and the rows of one kind that have numbers in all of them."""
    assert pick.point is not None
    numbers = numbers_of(seen.raw, (*pick.joints.columns, *pick.point.columns))
    return numbers, np.flatnonzero(np.isfinite(numbers).all(axis=1) & seen.alike())


def _why_none(seen: Seen, pick: Pick) -> str:
    """Return why there is no way at all to read a pick."""
    assert pick.point is not None
    columns = f"{seen.titles(pick.joints.columns)} and {seen.titles(pick.point.columns)}"
    if (rows := len(_numbers_and_rows(seen, pick)[1])) < _FEWEST_TRIED:
        found = "only one row" if rows else "no row"
        raise MeasurementError(
            f"{seen.raw.where}: {found} has numbers in {columns}; what columns are is known by how the arm follows "
            "several."
        )
    joints, point = _columns_of(seen, pick)
    if (unknown := next((c.title for c in (*joints, *point) if c.dimension == "unknown"), None)) is not None:
        return f"column {shown(unknown)} has a unit that is not known"
    if not (of_dimension(point, "length") and units_of_joints(seen, seen.robot(pick.arm), joints)):
        return f"{seen.titles(pick.joints.columns)} or the point have units of another quantity"
    return f"{columns} have numbers that no arm has, beyond {_LARGEST:g} rad or m{_where_beyond(seen, pick)}"


def _where_beyond(seen: Seen, pick: Pick) -> str:
    """Return in which rows numbers are too large in any unit, for the end of a sentence; "" where these are many."""
    numbers, rows = _numbers_and_rows(seen, pick)
    joints, point = _columns_of(seen, pick)
    least = [UNITS[column.symbol or "deg"].factor for column in joints]
    least += [UNITS[column.symbol or "mm"].factor for column in point]
    beyond = rows[(np.abs(numbers[rows] * least) > _LARGEST).any(axis=1)]
    return f", in {seen.named_rows(beyond.tolist())}" if 0 < len(beyond) <= _MOST_STRAYS else ""


def units_of_joints(seen: Seen, robot: Robot, columns: Sequence[RawColumn]) -> list[tuple[str, str]]:
    """Return the units, of angles and of lengths, that joints may be in; none where columns are of something else."""
    turns = [c for c, r in zip(columns, robot.readings, strict=True) if r.dimension == "angle"]
    slides = [c for c, r in zip(columns, robot.readings, strict=True) if r.dimension == "length"]
    if not (of_dimension(turns, "angle") and of_dimension(slides, "length")):
        return []
    angles = options(turns, seen.answers.angles, ("rad", "deg"))
    lengths = options(slides, seen.answers.lengths, ("m", "mm")) if slides else ["m"]
    return list(itertools.product(angles, lengths))


def options(columns: Sequence[RawColumn], answer: str | None, units: Sequence[str]) -> Sequence[str]:
    """Return the units that columns without one may be in."""
    if all(column.symbol is not None for column in columns):
        return [columns[0].symbol or units[0]] if columns else [units[0]]
    return units if answer is None else [answer]


def readings_in(robot: Robot, columns: Sequence[RawColumn], angle: str, slide: str) -> Array:
    """Return the columns of joints as readings (N, nr) in SI."""
    of = {"angle": angle, "length": slide}
    return np.column_stack(
        [
            UNITS[column.symbol or of[reading.dimension]].factor * values_of(column)
            for column, reading in zip(columns, robot.readings, strict=True)
        ]
    )


def decided(seen: Seen, trials: Sequence[Trial]) -> Trial:
    """Return the only trial that the arm follows, or the one that names prefer among those; or ask."""
    best = trials[0]
    # The same columns in another unit fit as well by chance, or not: a short slide is a small share of the spread.
    rivals = _apart([t for t in trials if t.fit.share < max(TIMES * best.fit.share, ALIKE * (t.pick != best.pick))])
    computed = _computed(seen, rivals)
    rivals = [t for t in rivals if t.point.columns not in computed]
    rivals = _of_the_same_joints(seen, _of_one_point(seen, rivals))
    arms = list(dict.fromkeys(t.pick.arm for t in rivals))
    if len(arms) > 1:
        tips = dict.fromkeys(arm.tip for arm in arms)
        raise ask("tip", f"{seen.raw.where}: several arms of the URDF fit the rows equally well", tips)
    for about, k in (("angles", 0), ("lengths", 2), ("lengths", 1)):
        units = sorted({t.units[k] for t in rivals})  # they fit alike: which is best is chance
        if len(units) > 1:
            name: About = "angles" if about == "angles" else "lengths"
            raise ask(name, f"{seen.raw.where}: {about} in {' and in '.join(units)} fit equally well", units)
    chosen = rivals[0]
    # What was only commanded is never taken without a word, nor anything else while something says it was measured.
    points = {t.point for t in trials if t.point.columns not in computed}
    if chosen.point.rank == 2 or (chosen.point.rank == 1 and any(point.rank == 0 for point in points)):
        raise _point_question(seen, points)
    _say_fit(seen, chosen, trials)
    return chosen


def _computed(seen: Seen, rivals: Sequence[Trial]) -> set[tuple[int, int, int]]:
    """Return the columns of points that were computed from the joints, where another one may have been measured."""
    found = {t.point.columns for t in rivals if t.fit.miss < COMPUTED}
    if not any(t.point.rank < 2 and t.point.columns not in found for t in rivals):
        return set()
    for columns in sorted(found):
        seen.reasons.append(f"{seen.titles(columns)} are computed from the joints, by the nominal arm")
    return found


def _apart(rivals: Sequence[Trial]) -> list[Trial]:
    """Return the rivals without those whose point has a column of one that fits far better.

    Where nothing names the columns, y and z of one point and x of the next nearly move as a point.
    """

    def clearer(t: Trial) -> bool:
        return any(
            o.point.columns != t.point.columns
            and set(o.point.columns) & set(t.point.columns)
            and TIMES * o.fit.share < t.fit.share
            for o in rivals
        )

    return [t for t in rivals if not clearer(t)]


def _of_one_point(seen: Seen, rivals: Sequence[Trial]) -> list[Trial]:
    """Return the rivals with the point whose name says most clearly that it was measured; or ask."""
    ranks = {t.point.columns: t.point.rank for t in rivals}
    first = min(rivals, key=lambda t: (t.point.rank, not t.pick.turned))
    if len(ranks) > 1 and all(_are_one_point(first, t) for t in rivals):
        others = [seen.titles(columns) for columns in ranks if columns != first.point.columns]
        seen.reasons.append(f"{' and '.join(others)} are the same point as {seen.titles(first.point.columns)}")
        return [t for t in rivals if t.point.columns == first.point.columns]
    chosen = _by_rank(seen, ranks)
    if chosen is None:
        raise _point_question(seen, {t.point for t in rivals})
    return [t for t in rivals if t.point.columns == chosen]


def _of_the_same_joints(seen: Seen, rivals: Sequence[Trial]) -> list[Trial]:
    """Return the rivals whose columns have the joints' names, or say most clearly that they were measured; or ask."""
    ranks = {t.pick.joints.columns: t.pick.joints.rank for t in rivals}
    if len(ranks) > 1 and len({t.pick.joints.exact for t in rivals}) > 1:
        return [t for t in rivals if t.pick.joints.exact]
    first = rivals[0]
    if len(ranks) > 1 and all(_say_the_same(first, t) for t in rivals[1:]):
        others = [seen.titles(columns) for columns in ranks if columns != first.pick.joints.columns]
        seen.reasons.append(f"{' and '.join(others)} are the same readings as {seen.titles(first.pick.joints.columns)}")
        return [t for t in rivals if t.pick.joints.columns == first.pick.joints.columns]
    chosen = _by_rank(seen, ranks)
    if chosen is None:
        first_joint = rivals[0].pick.arm.joints[0]
        raise ask(
            "joints",
            f"{seen.raw.where}: {' and '.join(first_of(sorted(map(seen.titles, ranks))))} fit the joints equally well",
            [f"'{first_joint}={seen.raw.columns[one[0]].title}'" for one in sorted(ranks)],
            "--column",
        )
    return [t for t in rivals if t.pick.joints.columns == chosen]


def _say_the_same(one: Trial, other: Trial) -> bool:
    """Return whether readings are the same, as in degrees and in radians."""
    alike = one.tips.shape == other.tips.shape and one.pick.arm == other.pick.arm
    return alike and bool(np.abs(one.tips - other.tips).max() < _SAME_READINGS)


def _are_one_point(one: Trial, other: Trial) -> bool:
    alike = one.position.shape == other.position.shape
    return alike and bool(np.abs(one.position - other.position).max() < _SAME_READINGS)


_Some = TypeVar("_Some", bound=tuple[int, ...])


def _by_rank(seen: Seen, ranks: Mapping[_Some, Rank]) -> _Some | None:
    """Return the columns that are first by their names, and say so; None where several are."""
    top = min(ranks.values())
    first = [columns for columns, rank in ranks.items() if rank == top]
    if len(first) > 1:
        return None
    for other in ranks.keys() - set(first):
        seen.reasons.append(
            f"{seen.titles(other)} fit as well, and {seen.titles(first[0])} are "
            f"{'measured' if top == 0 else 'not commanded'} by their names"
        )
    return first[0]


def _point_question(seen: Seen, found: Iterable[Point]) -> AskedError:
    columns = sorted({one.columns for one in found})
    ways = " or ".join(first_of([*map(seen.titles, columns)]))
    of_one = points_of_one_body(seen.raw)
    of_body = (
        f" {len(of_one)} points keep their distances, as reflectors on one body do: {to_import(seen.raw.where)} "
        "--each-point -o rows.csv makes a row of each"
    )
    return ask(
        "position",
        f"{seen.raw.where}: which columns were measured, {ways}?{of_body if of_one else ''}",
        [f"'x={seen.raw.columns[one[0]].title}'" for one in columns],
        "--column",
    )


def _say_fit(seen: Seen, best: Trial, trials: Sequence[Trial]) -> None:
    pick, (angle, _, length) = best.pick, best.units
    seen.reasons += [
        f"{seen.titles(pick.joints.columns)} are {run_of(pick.arm.joints)}, {pick.joints.why}",
        f"{seen.titles(best.point.columns)} are the measured point",
    ]
    for what, unit, k, columns in (
        ("angles", angle, 0, pick.joints.columns),
        ("lengths", length, 2, best.point.columns),
    ):
        if any(seen.raw.columns[c].symbol is None for c in columns):
            other = min((t.fit.share for t in trials if t.pick is pick and t.units[k] != unit), default=None)
            said = "" if other is None else f"; in another unit it would be {other:.0%} or more"
            seen.reasons.append(
                f"{what} are taken to be in {unit}: the points are then {off_arm(best.fit.miss, best.fit.share)}{said}"
            )
    if best.fit.miss < COMPUTED:
        seen.reasons.append(
            "the nominal arm follows within "
            f"{1e6 * best.fit.miss:.2g} um: this point seems to be computed from the joints, not measured, and a "
            "calibration would find nothing"
        )


def by_ranges(seen: Seen, trials: Sequence[Trial], picks: Sequence[Pick], enough: bool) -> Trial:
    """Return what is written, or what limits and reach leave; the arm does not follow, or rows are too few."""
    where = seen.raw.where
    points = {pick.point for pick in picks if pick.point is not None}
    if len({point.columns for point in points}) > 1:
        raise _point_question(seen, points)
    if not trials:
        raise ask("columns", f"{where}: {_why_none(seen, picks[0])}", (), "--column 'NAME [UNIT]=TITLE'")
    pick = trials[0].pick
    if len({(t.pick.joints.columns, t.pick.arm) for t in trials}) > 1:
        raise several_joints(seen, [t.pick for t in trials])
    written = all(seen.raw.columns[k].symbol is not None for k in (*pick.joints.columns, *trials[0].point.columns))
    answered = seen.answers.angles is not None and seen.answers.lengths is not None
    if enough and not any(changes(seen.raw, k) for k in trials[0].point.columns):
        point = seen.titles(trials[0].point.columns)
        raise ask("columns", f"{where}: {point} never change, and nothing else is a point", (), "--column 'x=TITLE'")
    if enough:
        told = (written or answered) and (pick.joints.exact or seen.answers.columns)
        question = None if told else _parts_question(seen, trials) or _strays_question(seen, trials)
        if question is not None:
            raise question
        found, best = _mistake(seen, trials)
        if found is not None and found.zeros is not None:
            raise _other_zeros(seen, best, found)
        if not told:
            raise _no_way_fits(seen, best, found)
    angle, slide = units_by_limits(seen, pick)
    length = _length_by_reach(seen, pick, trials[0].point)
    for trial in trials:
        if trial.pick is pick and trial.units == (angle, slide, length):
            seen.reasons.append(f"{seen.titles(pick.joints.columns)} are {run_of(pick.arm.joints)}, {pick.joints.why}")
            if enough:
                seen.reasons.append(
                    f"the arm does not fit: {trial.fit.share:.0%} of the spread is left; see what the check says"
                )
            return trial
    raise AssertionError("units come from the trials")


def _no_way_fits(seen: Seen, best: Trial, found: Named | None) -> AskedError:
    """Return the question of an arm that does not follow; ``found``: the mistake that explains it."""
    said = "is it this robot, and are signs, zeros and the order of joints those of the URDF?"
    answer = "--column 'NAME [UNIT]=TITLE' for all joints, --angles and --lengths"
    if found is not None:
        said, answer = found.finding.sentence, "a table or a URDF in which this is corrected"
    return ask(
        "columns",
        f"{seen.raw.where}: no way to read the columns fits the arm: the best, "
        f"{seen.titles(best.pick.joints.columns)} in {best.units[0]} and the point in {best.units[2]}, leaves "
        f"{best.fit.share:.0%} of the spread of the points; {said}",
        (),
        answer,
    )


def _mistake(seen: Seen, trials: Sequence[Trial]) -> tuple[Named | None, Trial]:
    """Return the mistake that explains why an arm does not follow, None where none does, and how columns are read.

    Where the arm does not follow, chance decides in which units it follows best: all are looked at in which joints turn
    and points are spread as those of an arm.
    """
    best_in = {trial.units: trial for trial in reversed(trials)}
    looked_at = 0
    for trial in sorted(best_in.values(), key=lambda trial: trial.fit.share):
        robot = seen.robot(trial.pick.arm)
        angle, slide, _ = trial.units
        q = readings_in(robot, _columns_of(seen, trial.pick)[0], angle, slide)[trial.rows]
        if not _plausible(robot, q, trial):
            continue
        looked_at += len(robot.readings)
        if looked_at > _MOST_READINGS:
            break
        data = positions(robot, q, trial.position)
        for found in named(error_model(robot), [data]):
            if found.finding.severity == "error":
                sentence = found.finding.sentence.removeprefix(f"{data.where}: ").removesuffix(".")
                return replace(found, finding=replace(found.finding, sentence=sentence)), trial
    return None, trials[0]


def _plausible(robot: Robot, q: Array, trial: Trial) -> bool:
    """Return whether readings (N, nr) and points are those of an arm, whatever its zeros and signs are."""
    angles = [reading.dimension == "angle" for reading in robot.readings]
    spreads = [float(np.linalg.norm(points - points.mean(axis=0))) for points in (trial.tips[:, :3, 3], trial.position)]
    return bool(np.all(np.abs(q[:, angles]) < _MOST_TURNED)) and max(spreads) < _OTHERWISE_SPREAD * min(spreads)


def _other_zeros(seen: Seen, trial: Trial, found: Named) -> AskedError:
    """Return the question whether the readings have the zeros and signs that were found."""
    assert found.zeros is not None, "it is asked where they were found"
    readings = seen.robot(trial.pick.arm).readings
    changed = found.zeros.by_name(readings)
    question = Question(
        "zeros",
        f"{seen.raw.where}: {seen.titles(trial.pick.joints.columns)} in {trial.units[0]}: {found.finding.sentence}; "
        "correct the table, or take a URDF whose joints count as it does",
        (),
        "--zeros FILE of calib init, which writes that URDF",
    )
    return AskedError(question, changed)


def several_joints(seen: Seen, picks: Sequence[Pick]) -> AskedError:
    """Return the question which columns are the joints, of which arm, where nothing tells."""
    ways = [
        (seen.titles(pick.joints.columns), run_of(pick.arm.joints))
        for pick in sorted(picks, key=lambda pick: pick.joints.columns)
    ]
    arms = {joints for _, joints in ways}
    told = dict.fromkeys(titles if len(arms) == 1 else f"{titles} as {joints}" for titles, joints in ways)
    return ask(
        "joints",
        f"{seen.raw.where}: several columns may be the joints, {' or '.join(first_of(list(told), 4))}, and the rows do "
        "not tell which, if any",
        (),
        "--column 'JOINT=TITLE' or --tip",
    )


def units_by_limits(seen: Seen, pick: Pick) -> tuple[str, str]:
    """Return the units of joints that have none: those in which all rows are within the limits; or ask."""
    robot = seen.robot(pick.arm)
    columns = [seen.raw.columns[k] for k in pick.joints.columns]
    ways = units_of_joints(seen, robot, columns)
    if len(ways) == 1:
        return ways[0]
    inside = []
    for angle, slide in ways:
        q = readings_in(robot, columns, angle, slide)
        low = [-np.inf if r.lower is None else r.lower for r in robot.readings]
        high = [np.inf if r.upper is None else r.upper for r in robot.readings]
        size = np.where(np.isfinite(high), np.abs(high), 4.0 * np.pi)
        slack = (_LIMIT_SLACK - 1.0) * size
        if np.nanmin(q - low + slack) >= 0.0 and np.nanmin(high - q + slack) >= 0.0 and np.nanmax(np.abs(q)) < 100.0:
            inside.append((angle, slide))
    if len(inside) != 1:
        about: About = "angles" if len({angle for angle, _ in (inside or ways)}) > 1 else "lengths"
        units = dict.fromkeys((angle if about == "angles" else slide) for angle, slide in (inside or ways))
        raise ask(
            about,
            f"{seen.raw.where}: {seen.titles(pick.joints.columns)} have no unit, and {' and '.join(units)} are "
            f"{'both within' if inside else 'all beyond'} the limits of the joints",
            units,
        )
    seen.reasons.append(f"angles are taken to be in {inside[0][0]}: in another unit they exceed the joints' limits")
    return inside[0]


def _length_by_reach(seen: Seen, pick: Pick, point: Point) -> str:
    columns = [seen.raw.columns[k] for k in point.columns]
    units = options(columns, seen.answers.lengths, ("m", "mm"))
    if len(units) == 1:
        return units[0]
    numbers = np.column_stack([values_of(column) for column in columns])
    reach = seen.robot(pick.arm).reach
    spread = float(np.nanmax(np.nanstd(numbers, axis=0)))
    fits = [unit for unit in units if 2e-3 * reach < spread * UNITS[unit].factor < 2.0 * reach]
    if len(fits) != 1:
        raise ask("lengths", f"{seen.raw.where}: {seen.titles(point.columns)} have no unit", units)
    seen.reasons.append(f"lengths are taken to be in {fits[0]}: in another unit they do not fit the arm's reach")
    return fits[0]


def _parts_question(seen: Seen, trials: Sequence[Trial]) -> AskedError | None:
    """Return a question where parts of the rows are followed each alone, and not together; None where they are not."""
    where = seen.raw.where
    for k, column in enumerate(seen.raw.columns):
        kinds = sorted(set(column.words))
        if 1 < len(kinds) <= _MOST_PARTS:
            for trial in trials:
                own = np.array(column.words)[trial.rows]
                is_beside = k not in (*trial.pick.joints.columns, *trial.point.columns)
                if is_beside and _are_followed(trial, [own == kind for kind in kinds]):
                    return ask(
                        "setup",
                        f"{where}: the rows of each {column.title!r} fit the arm, all rows together do not; is it the "
                        "place of the robot or the instrument, or the tool?",
                        [f"'{name}={column.title}'" for name in ("setup", "tool")],
                        "--column",
                    )
    for trial in trials:
        first = _best_split(trial)
        if first is not None and _are_followed(trial, [first, ~first]):
            return ask(
                "setup",
                f"{where}: {seen.first_rows(int(trial.rows[first].max()))} and the rows after them fit the arm "
                "separately, but not together; was the robot, the instrument or the tool moved there?",
                (),
                "a column setup, or tool, that says which rows belong together",
            )
    return None


def _strays_question(seen: Seen, trials: Sequence[Trial]) -> AskedError | None:
    """Return a question where all rows are followed but a few that lie far off; None where they are not."""
    for trial in trials[:_LOOKED_AT]:
        most = min(len(trial.rows) // _KEPT_FOR_A_STRAY, _MOST_STRAYS)
        found = strays(trial.tips, trial.position, most, _PARTS_FOLLOW) if np.isfinite(trial.fit.share) else None
        if found is not None:
            rows, fit = found
            return ask(
                "columns",
                f"{seen.raw.where}: without {seen.named_rows(trial.rows[rows].tolist())} the points are "
                f"{off_arm(fit.miss, fit.share)}, with all rows {trial.fit.share:.0%}; do these readings and points "
                "belong together?",
                (),
                "a table without what does not belong together",
            )
    return None


def _are_followed(trial: Trial, parts: Sequence[BoolArray]) -> bool:
    return all(
        part.sum() >= _FEWEST_OF_PART and followed(trial.tips[part], trial.position[part]).share < _PARTS_FOLLOW
        for part in parts
    )


def _best_split(trial: Trial) -> BoolArray | None:
    """Return the first rows (N) of the split after which the arm follows best; None where there are too few rows."""
    n = len(trial.rows)
    if n < 2 * _FEWEST_OF_PART:
        return None
    count = np.arange(n)

    def left(k: int) -> float:
        halves = (count < k, count >= k)
        return float(sum(h.sum() * followed(trial.tips[h], trial.position[h]).miss ** 2 for h in halves))

    coarse = np.unique(np.linspace(_FEWEST_OF_PART, n - _FEWEST_OF_PART, _LOOKED_AT).astype(int)).tolist()
    best = min(range(len(coarse)), key=lambda i: left(coarse[i]))
    low, high = coarse[max(best - 1, 0)], coarse[min(best + 1, len(coarse) - 1)]
    return count < min(range(low, high + 1), key=left)
