"""One table of somebody else, read."""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace

import numpy as np

from calib.foundations.errors import MeasurementError
from calib.foundations.ranges import RANGES
from calib.foundations.units import UNITS
from calib.foundations.words import listed
from calib.identification.followed import FEWEST_ROWS, pivots
from calib.job.foreign import fits
from calib.job.foreign.answers import Answers, Found, Pick, Trial, ask, of_dimension, run_of, values_of
from calib.job.foreign.picks import no_joints, no_number_of_joint, no_point, picks_of, without_fingers
from calib.job.foreign.seen import CHOSEN, Seen, is_ours
from calib.job.foreign.turns import inverse_question, orientation_of
from calib.measurement.kinds import Kind
from calib.measurement.orientations import ANGLES, MATRIX, ORIENTATIONS
from calib.measurement.raw import RawColumn, RawTable, split_title
from calib.measurement.roles import SPREADS, TORQUES, changes, tokens
from calib.measurement.table import APPROACH, QUATERNION_COLUMNS, TORQUE, Columns
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

# An arm without its fingers fits no worse: by rounding alone, as a share; by chance, three standard deviations of what
# fingers that carry nothing take off the sum of squares.
_NO_SHARE, _BY_CHANCE = 1e-9, 9.0


def read(document: Urdf, raw: RawTable, answers: Answers, robot: Robot | None) -> Found:
    """Return how a table is read; ``robot``: the arm that tables before it have shown.

    Raises AskedError, or MeasurementError where no column is a joint, or none an orientation that is asked for.
    """
    seen = Seen(document, raw, answers, robot)
    picks = picks_of(seen)
    if not picks:
        raise no_joints(seen)
    with_point = [pick for pick in picks if pick.point is not None]
    kind = seen.answers.observes
    if with_point and kind in (None, "position", "pose"):
        return _positions(seen, with_point)
    return _other(seen, picks)


def _positions(seen: Seen, picks: Sequence[Pick]) -> Found:
    trials = fits.trials(seen, picks, ("m", "mm"))
    if not any(trial.fit.share < fits.FOLLOWS for trial in trials):
        trials += fits.trials(seen, fits.without_unit(seen, picks), ("cm", "inch"), len(trials))
    if not any(trial.fit.share < fits.FOLLOWS for trial in trials):
        shorter = fits.trials(seen, without_fingers(seen, picks), ("m", "mm"), len(trials))
        trials = shorter if any(trial.fit.share < fits.ALIKE for trial in shorter) else trials
    else:
        trials = _less_fingers(seen, picks, trials)
    trials.sort(key=lambda trial: trial.fit.share)
    enough = trials and len(trials[0].rows) >= FEWEST_ROWS
    if enough and trials[0].fit.share < fits.FOLLOWS:
        best = fits.decided(seen, trials)
        others = [trial for trial in trials if trial.point.columns != best.point.columns]
        if best.fit.miss < fits.COMPUTED and (inverse := inverse_question(seen, others)) is not None:
            raise inverse  # what was measured stands beside what was computed
    elif enough and (inverse := inverse_question(seen, trials)) is not None:
        raise inverse
    elif not seen.raw.named and len({pick.point for pick in picks}) > 1:
        raise no_joints(seen)  # columns that nothing names, and no way that fits: which are meant, only a person knows
    elif (torn := no_number_of_joint(seen)) is not None:
        raise torn  # without these joints the rest would be a shorter arm
    else:
        best = fits.by_ranges(seen, trials, picks, bool(enough))
    return _posed(seen, best)


def _less_fingers(seen: Seen, picks: Sequence[Pick], trials: list[Trial]) -> list[Trial]:
    """Return the trials of arms before their fingers where these fit no worse: what was measured is on no finger.

    The readings of a gripper that never moved show nothing, and those of one that did are not the tool's: with them, in
    one unit or another, an arm fits a little better or worse by chance. A point on the axis of a joint that turned says
    nothing of that joint: there it must fit clearly better without.
    """
    shorter = fits.trials(seen, without_fingers(seen, picks, by_name=True), ("m", "mm"), len(trials))
    if not shorter:
        return trials
    less, whole = (min(some, key=lambda trial: trial.fit.share) for some in (shorter, trials))
    if _turned(seen, whole.pick) - _turned(seen, less.pick):
        return shorter if less.fit.share + _NO_SHARE <= whole.fit.share / fits.TIMES else trials
    chance = float(np.sqrt(1.0 + _BY_CHANCE / (3 * len(less.rows))))
    return shorter if less.fit.share <= whole.fit.share * chance + _NO_SHARE else trials


def _turned(seen: Seen, pick: Pick) -> set[str]:
    """Return the joints of a pick that turn, and did."""
    joints = zip(pick.arm.joints, pick.joints.columns, strict=True)
    return {name for name, k in joints if seen.document.joint(name).type != "prismatic" and changes(seen.raw, k)}


def _posed(seen: Seen, best: Trial) -> Found:
    pick = best.pick
    names = _names(seen, pick, best.units)
    length = best.units[2]
    for axis, k in zip("xyz", best.point.columns, strict=True):
        names[f"{axis} [{seen.raw.columns[k].symbol or length}]"] = seen.raw.columns[k].title
    names |= _sigmas(seen, best)
    chosen = None
    if seen.answers.observes != "position":
        chosen = orientation_of(seen, best)
    if chosen is None:
        if seen.answers.observes == "pose":
            if not pick.turned:  # no convention makes an orientation of no columns
                raise MeasurementError(
                    f"{seen.raw.where}: poses are to be read, and no columns are an orientation of the point "
                    f"{seen.titles(best.point.columns)}; give these titles like qw, qx, qy, qz or rx, ry, rz in the "
                    "file, or read positions."
                )
            raise ask("orientation", f"{seen.raw.where}: there is no orientation that fits", ORIENTATIONS[:5])
        return _result(seen, pick, "position", names, None)
    orientation, columns, unit = chosen
    titles = [seen.raw.columns[k].title for k in columns]
    if orientation is None:
        names |= dict(zip(QUATERNION_COLUMNS, titles, strict=True))
    elif orientation == "matrix":
        names |= dict(zip(MATRIX, titles, strict=True))
    else:
        names |= {
            f"{ours} [{seen.raw.columns[k].symbol or unit}]": seen.raw.columns[k].title
            for ours, k in zip(ANGLES, columns, strict=True)
        }
    return _result(seen, pick, "pose", names, orientation)


def _other(seen: Seen, picks: Sequence[Pick]) -> Found:
    kind, where = seen.answers.observes, seen.raw.where
    known = seen.known
    if (torn := no_number_of_joint(seen)) is not None:
        raise torn
    if kind is None and known.pixels is not None:
        raise MeasurementError(
            f"{where}: u and v are pixels, and no table says of which camera; from photographs, calib import images "
            'writes table and job; else write a job with [instruments.NAME] of kind = "camera" (docs/cameras.md).'
        )
    whole = [pick for pick in picks if pick.point is None] or list(picks)
    if not seen.raw.named:
        # Where it is not said that sockets were touched, only rows that touch points show it.
        others = [pick for pick in whole if pick.target is not None] if kind else [replace(whole[0], target=None)]
        whole = _that_touch(seen, whole) or others or whole
    if len({(pick.joints.columns, pick.arm) for pick in whole}) > 1:
        ranks = {pick.joints.rank for pick in whole}
        whole = [pick for pick in whole if pick.joints.rank == min(ranks)]
        if len(whole) > 1:
            raise fits.several_joints(seen, whole)
    pick = whole[0]
    targets = [k for k in known.targets if k not in pick.joints.columns]
    if "target" in seen.named:
        targets = [seen.column(seen.named["target"])]
    elif pick.target is not None:
        targets = [pick.target]
    lengths = [k for k in known.lengths if k not in pick.joints.columns]
    if kind is None and lengths and targets:
        kind = "distance"
    elif kind is None and targets and not lengths:
        kind = "socket"
    if kind not in ("socket", "distance") or not targets:
        if (wrong := no_point(seen)) is not None:
            raise wrong
        raise ask(
            "observes",
            f"{where}: {seen.titles(pick.joints.columns)} {'are' if seen.raw.named else 'may be'} joints, and no "
            "column says what was measured there",
            (),
            "a column of the point (x, y, z), of a socket's name, or a length with a target; calib import joins joints "
            "and points that are in two files",
        )
    target = seen.raw.columns[targets[0]]
    pick, shares = _less_a_gripper(seen, pick, target) if kind == "socket" else (pick, [])
    units = _touched(seen, pick, target, shares) if kind == "socket" else (*fits.units_by_limits(seen, pick), "m")
    seen.reasons.append(f"{seen.titles(pick.joints.columns)} are {run_of(pick.arm.joints)}, {pick.joints.why}")
    names = _names(seen, pick, units)
    names["target"] = target.title
    if kind == "distance":
        column = seen.raw.columns[lengths[0]]
        unit = fits.options([column], seen.answers.lengths, ("m", "mm"))
        if len(unit) > 1:
            size, reach = float(np.nanmedian(np.abs(values_of(column)))), seen.robot(pick.arm).reach
            unit = [u for u in unit if 0.02 * reach < size * UNITS[u].factor < 20.0 * reach]
        if len(unit) != 1:
            raise ask("lengths", f"{where}: {column.title!r} has no unit", ("m", "mm"))
        names[f"length [{unit[0]}]"] = column.title
        if column.symbol is None:
            seen.reasons.append(f"{column.title!r} is taken to be in {unit[0]}: by the arm's reach")
    said = "rows of one name touch one point" if kind == "socket" else "lengths from the point that a row names"
    seen.reasons.append(f"{target.title!r} names the target: {said}")
    return _result(seen, pick, kind, names, None)


_Shares = list[tuple[float, str, str]]


def _less_a_gripper(seen: Seen, pick: Pick, target: RawColumn) -> tuple[Pick, _Shares]:
    """Return the pick, or that of the arm before its fingers where rows of one target touch one point only so.

    And what touches leave in each unit, as :func:`_shares` has it.
    """
    whole = _shares(seen, pick, target)
    if not _touch_one_point(whole):
        for less in without_fingers(seen, [pick]):
            if _touch_one_point(shares := _shares(seen, less, target)):
                return less, shares
    return pick, whole


def _touched(seen: Seen, pick: Pick, target: RawColumn, shares: _Shares) -> tuple[str, str, str]:
    """Return the units in which rows of one socket touch one point; by limits where they do not tell."""
    if _touch_one_point(shares):
        share, angle, slide = shares[0]
        if len(shares) > 1:
            seen.reasons.append(
                f"angles are taken to be in {angle}: rows of one target then touch one point within "
                f"{share:.2%} of what the tip moves"
            )
        return angle, slide, "m"
    if len(shares) == 1:
        seen.reasons.append(f"rows of one target do not touch one point: {shares[0][0]:.0%} of the motion is left")
        return shares[0][1], shares[0][2], "m"
    if shares:
        raise ask(
            "columns",
            f"{seen.raw.where}: rows of one {target.title!r} touch one point in no unit, or in several units",
            (),
            "--angles, and --observes where it is no socket",
        )
    return (*fits.units_by_limits(seen, pick), "m")


def _shares(seen: Seen, pick: Pick, target: RawColumn) -> _Shares:
    """Return what touches of one target leave of the tip's motion in each unit, least first; none of too few rows."""
    robot = seen.robot(pick.arm)
    columns = [seen.raw.columns[k] for k in pick.joints.columns]
    words = list(dict.fromkeys(target.words))
    number = np.array([words.index(word) for word in target.words])
    shares = []
    for angle, slide in fits.units_of_joints(seen, robot, columns):
        q = fits.readings_in(robot, columns, angle, slide)
        rows = np.flatnonzero(np.isfinite(q).all(axis=1) & (np.abs(q).max(axis=1) < 1e4) & seen.alike())
        if 3 * len(rows) > 2 * (3 + 3 * len(words)):
            shares.append((pivots(robot.tips(q[rows]), number[rows]), angle, slide))
    return sorted(shares)


def _touch_one_point(shares: _Shares) -> bool:
    return bool(shares) and shares[0][0] < fits.FOLLOWS and _is_clear(shares)


def _is_clear(shares: _Shares) -> bool:
    return len(shares) < 2 or shares[1][0] > max(fits.TIMES * shares[0][0], fits.ALIKE)


def _that_touch(seen: Seen, picks: Sequence[Pick]) -> list[Pick]:
    """Return the pick of a table without a header whose rows of one target touch one point; none where not clear."""
    found = []
    for pick in picks:
        if pick.target is not None:
            found += [(one, pick) for one in _shares(seen, pick, seen.raw.columns[pick.target])]
    found.sort(key=lambda one: one[0])
    return [found[0][1]] if _touch_one_point([share for share, _ in found]) else []


def _names(seen: Seen, pick: Pick, units: tuple[str, str, str]) -> dict[str, str]:
    of = {"angle": units[0], "length": units[1]}
    return {
        f"{reading.name} [{seen.raw.columns[k].symbol or of[reading.dimension]}]": seen.raw.columns[k].title
        for reading, k in zip(seen.robot(pick.arm).readings, pick.joints.columns, strict=True)
    }


def _result(seen: Seen, pick: Pick, kind: Kind, names: dict[str, str], orientation: str | None) -> Found:
    robot = seen.robot(pick.arm)
    own = CHOSEN - {*"xyz"}
    told = {f"{what}{reading.name}" for what in (TORQUE, APPROACH) for reading in robot.readings}
    answered = (seen.answers.columns or {}).items()
    given = {ours: theirs for ours, theirs in answered if split_title(ours)[0] in own | told}
    names |= {ours: seen.raw.columns[seen.column(theirs)].title for ours, theirs in given.items()}
    names |= _torques(seen, pick, {split_title(name)[0] for name in names})
    taken = set(names.values())
    ours = {split_title(name)[0] for name in names}
    ignore = []
    for column in seen.raw.columns:
        if column.title in taken:
            continue
        kept = column.name in own | told and column.name not in ours and is_ours(column)
        if not kept:
            ignore.append(column.title)
    if ignore:
        seen.reasons.append(f"not read: {listed(ignore, most=20)}")
    if pick.arm.others:
        seen.reasons.append(
            f"the tip is {pick.arm.tip}; {listed(pick.arm.others, most=4)} would do as well, since the tool is free"
        )
    if pick.arm.base is not None:
        seen.reasons.append(f"the base is {pick.arm.base}: joints before it are in no column")
    return Found(robot, kind, Columns(names, tuple(ignore), orientation), tuple(seen.reasons))


def _torques(seen: Seen, pick: Pick, given: AbstractSet[str]) -> dict[str, str]:
    """Return names for the columns of the joints' torques, where each joint has one that is called as its own is."""
    readings = seen.robot(pick.arm).readings
    wanted = [_besides(seen.raw.columns[k].name, frozenset()) for k in pick.joints.columns]
    called = [column for column in seen.raw.columns if TORQUES & set(tokens(column.name))]
    found = {_besides(column.name, TORQUES): column for column in called}
    columns = [found.get(word) for word in wanted]
    torques = [column for column in columns if column is not None and _is_torque(column)]
    ours = [f"{TORQUE}{reading.name}" for reading in readings]
    apart = len(set(wanted)) == len(wanted) and len(found) == len(called)
    if not apart or len(torques) < len(wanted) or given & set(ours):
        return {}
    run, of = run_of([column.title for column in torques]), run_of(pick.arm.joints)
    unit = "" if all(column.symbol for column in torques) else ", taken to be in Nm"
    seen.reasons.append(f"{run} are the torques of {of}, by their numbers{unit}")
    return {f"{name} [Nm]": column.title for name, column in zip(ours, torques, strict=True)}


def _sigmas(seen: Seen, best: Trial) -> dict[str, str]:
    """Return names for the columns of the point's standard deviations: called as its own, and std or the like beside.

    Not where a person named others, nor where one is none: zero, or larger than what the arm misses.
    """
    own = [seen.raw.columns[k] for k in best.point.columns]
    called = {
        _less(column, SPREADS): k
        for k, column in enumerate(seen.raw.columns)
        if SPREADS & set(tokens(column.name)) and of_dimension([column], "length")
    }
    columns = [called[tokens(column.name)] for column in own if tokens(column.name) in called]
    if len(columns) < len(own) or any(name.startswith("sigma") for name in seen.named):
        return {}
    names, assumed = {}, ""
    for axis, k, values, point in zip("xyz", columns, seen.raw.all_numbers(columns), own, strict=True):
        column = seen.raw.columns[k]
        symbol = column.symbol or point.symbol or best.units[2]
        if values is None or not all(map(RANGES["sigma"].holds, (values * UNITS[symbol].factor).tolist())):
            return {}
        if np.median(values) * UNITS[symbol].factor > best.fit.miss:
            return {}
        names[f"sigma_{axis} [{symbol}]"] = column.title
        assumed = assumed if column.symbol else f", taken to be in {symbol} as well"
    seen.reasons.append(f"{run_of(list(names.values()))} are the standard deviations of the point{assumed}")
    return names


def _less(column: RawColumn, words: AbstractSet[str]) -> tuple[str, ...]:
    return tuple(part for part in tokens(column.name) if part not in words)


def _is_torque(column: RawColumn) -> bool:
    # A bracket that is no unit we know may be one of something else.
    fits_unit = column.symbol == "Nm" or (column.symbol is None and "[" not in column.title)
    return column.numbers is not None and bool(np.isfinite(column.numbers).all()) and fits_unit


def _besides(name: str, words: AbstractSet[str]) -> tuple[str, ...]:
    """Return the numbers in a name of which some of ``words`` are parts, or any; all parts where it has none."""
    parts = [part for part in tokens(name) if part not in words]
    return tuple(part for part in parts if part.isdigit()) or tuple(parts)
