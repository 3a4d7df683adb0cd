"""Which columns may be the joints of which arm, and which the point."""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from calib.foundations.errors import MeasurementError, RobotError
from calib.foundations.words import counted, listed, shown
from calib.job.chains import Chain, behind
from calib.job.foreign.answers import Pick, ask, run_of
from calib.job.foreign.seen import Seen
from calib.measurement import roles
from calib.measurement.formats.statements import begins_list
from calib.measurement.layout import is_number
from calib.measurement.raw import RawColumn, of_lists

# Arms that the columns of a table may be of, as far as they are looked at, and the joints of all of them: what a long
# arm takes to be looked at grows with the third power of its joints.
_MOST_READ, _MOST_JOINTS_READ = 48, 1000
# Joints beyond an arm.
_FINGER = re.compile(r"finger|grip|hand|jaw|knuckle|thumb|claw|palm", re.IGNORECASE)
# What may be meant as a number: 12.5 mm, or with another minus than a keyboard's.
_BEGINS_NUMBER = re.compile(r"[-+\u2212\u2013]?[.,]?[0-9]")
# A run of numbered columns that may be the end of a longer arm.
_FEWEST_JOINTS = 4


def picks_of(seen: Seen) -> list[Pick]:
    """Return the columns that may be the joints of an arm and a point, in every way that answers allow.

    Raises MeasurementError where a joint's own column has a few cells that are no numbers: without it the rest would
    be a shorter arm.
    """
    for column, wrong in _not_numbers(_of_joints(seen)):
        if column.name not in seen.named and 2 * len(wrong) < len(column.words):
            raise _no_number(seen, column, wrong, "joint")
    if not seen.raw.named:
        found = []
        for arm in _arms_of(seen, range(len(seen.raw.columns) + 1)):
            given = _answered(seen, arm.joints), _answered(seen, "xyz")
            found += [Pick(arm, *way) for way in roles.without_names(seen.raw, len(arm.joints), *given)]
        return _as_answered(seen, found)
    picks = []
    for arm, joints in _joints(seen):
        # What a joint reads is no measured point.
        points = [point for point in _points(seen) if not set(point.columns) & set(joints.columns)]
        picks += [Pick(arm, joints, point, _turned(seen, point, joints)) for point in points or (None,)]
    return _as_answered(seen, picks)


def _answered(seen: Seen, names: Sequence[str]) -> tuple[int, ...]:
    """Return the columns that a person named; none if not all of them."""
    titles = [seen.named.get(name) for name in names]
    return () if None in titles else tuple(seen.column(title) for title in titles if title is not None)


def _points(seen: Seen) -> list[roles.Point]:
    if given := _answered(seen, "xyz"):
        # The words around its titles are those of its orientation, too.
        words = (one.words for one in seen.known.points if one.columns == given)
        return [roles.Point((given[0], given[1], given[2]), next(words, frozenset()), 1)]
    # The zeros of a matrix that is a rotation alone are no place of anything.
    every = seen.known.points
    return [point for point in every if any(roles.changes(seen.raw, k) for k in point.columns)] or list(every)


def _turned(seen: Seen, point: roles.Point | None, joints: roles.Joints) -> tuple[roles.Orientation, ...]:
    """Return the orientations that belong to a point: those with the same words around them, or the only one."""
    every = seen.known.orientations
    if point is None:
        return ()
    own = {*point.columns, *joints.columns}
    free = tuple(one for one in every if not own & set(one.columns))
    aside = {
        "rot",
        "rotation",
        "orn",
        "quaternion",
        "quat",
        "q",
        "r",
        "phi",
        "euler",
        "orientation",
        "ori",
        "p",
        "pos",
        "position",
        "t",
    }
    aside |= {"trans", "translation", "tvec", "rvec", "rotvec", "rv", "o", "w", "coord", "xyz", "point"}
    alike = tuple(one for one in free if one.words - aside == point.words - aside)
    return alike or (free if len(_points(seen)) == 1 else ())


def _joints(seen: Seen) -> list[tuple[Chain, roles.Joints]]:
    """Return the columns of joints by name, of the longest arms that are named whole; else by their numbers."""
    among = frozenset(
        k
        for k, column in enumerate(seen.raw.columns)
        if column.numbers is not None and (k not in seen.known.spoken or seen.raw.named)
    )
    with_names = roles.named_among(seen.raw, {name for arm in seen.arms for name in arm.joints}, among)
    named: list[tuple[Chain, roles.Joints]] = []
    for arm in seen.arms:
        if not _is_room_for(arm, [other for other, _ in named]):
            break
        given = _answered(seen, arm.joints)
        if given and (arm is seen.arms[0] or seen.answers.tip is not None):
            named.append((arm, roles.Joints(given, 0, "as answered", True)))
            continue
        for first in range(len(arm.joints) if seen.has_ends else 1):
            part = arm.joints[first:]
            if named and len(part) < max(len(other.joints) for other, _ in named):
                break
            if not with_names.issuperset(part):
                continue
            named += [(behind(seen.document, arm, first), one) for one in roles.joints_by_name(seen.raw, part, among)]
            break
    fewest = max((len(arm.joints) for arm, _ in named), default=0)
    named = [(arm, one) for arm, one in named if len(arm.joints) == fewest]
    # Some joints may have names that are nearly theirs: then all columns are looked at in their order as well.
    claimed = {k for _, one in named for k in one.columns}
    if named and not [k for k in among if k not in seen.known.spoken and k not in claimed]:
        return named
    found = []
    for arm in _arms_of(seen, range(fewest + 1, len(seen.raw.columns) + 1)):
        found += [(arm, one) for one in roles.joints_by_order(seen.raw, len(arm.joints), seen.known)]
    # As many columns as the arm has joints with its fingers may be those of the arm without them, and one more.
    families = set(roles.numbered_columns(seen.raw))
    numbered = [(arm, one) for arm, one in found if len(arm.joints) in families and arm in seen.arms]
    return list(dict.fromkeys([*named, *_longest(found), *_longest(numbered)]))


def _longest(found: Sequence[tuple[Chain, roles.Joints]]) -> list[tuple[Chain, roles.Joints]]:
    longest = max((len(arm.joints) for arm, _ in found), default=0)
    return [(arm, one) for arm, one in found if len(arm.joints) == longest]


def _arms_of(seen: Seen, counts: Iterable[int]) -> list[Chain]:
    """Return whole arms with as many joints; the ends of longer ones where no whole arm has as many as a family."""
    cut = _cut_short(seen)
    whole = [arm for arm in seen.arms if len(arm.joints) in counts and arm.joints not in cut]
    families = set(roles.numbered_columns(seen.raw)) if seen.raw.named else set()
    lengths = {len(arm.joints) for arm in whole}
    ends = [
        behind(seen.document, arm, len(arm.joints) - count)
        for count in families - lengths
        for arm in seen.arms
        if seen.has_ends and len(arm.joints) > count >= _FEWEST_JOINTS and arm.joints not in cut
    ]
    found: list[Chain] = []
    for arm in dict.fromkeys([*whole, *ends]):
        if not _is_room_for(arm, found):
            break
        found.append(arm)
    return found


def _is_room_for(arm: Chain, others: Sequence[Chain]) -> bool:
    """Return whether one more arm is looked at; the first always is."""
    joints = sum(len(other.joints) for other in others) + len(arm.joints)
    return not others or (len(others) < _MOST_READ and joints <= _MOST_JOINTS_READ)


def _cut_short(seen: Seen) -> frozenset[tuple[str, ...]]:
    """Return beginnings of arms that are not meant where nothing names their joints: more than fingers is left out."""
    fingers = {name: _is_finger(seen, name) for name in {name for arm in seen.arms for name in arm.joints}}
    ends = {
        arm.joints: max((k for k, name in enumerate(arm.joints) if not fingers[name]), default=0) for arm in seen.arms
    }
    return frozenset(joints[:k] for joints, end in ends.items() for k in range(1, end + 1))


def _is_finger(seen: Seen, name: str) -> bool:
    return _FINGER.search(name) is not None or seen.document.joint(name).type == "prismatic"


def _as_answered(seen: Seen, picks: Sequence[Pick]) -> list[Pick]:
    """Return the picks that an answer does not rule out."""

    def holds(pick: Pick) -> bool:
        ours = dict(zip(pick.arm.joints, pick.joints.columns, strict=True))
        if pick.point is not None:
            ours |= dict(zip("xyz", pick.point.columns, strict=True))
        return all(seen.column(theirs) == ours.get(name, seen.column(theirs)) for name, theirs in seen.named.items())

    held = [pick for pick in picks if holds(pick)]
    if picks and not held:
        answers = listed([f"{ours}={theirs}" for ours, theirs in seen.named.items()])
        raise MeasurementError(
            f"{seen.raw.where}: its columns cannot be read as answered, {answers}; name the columns of all joints, or "
            "all of x, y, z."
        )
    return held


def without_fingers(seen: Seen, picks: Sequence[Pick], *, by_name: bool = False) -> list[Pick]:
    """Return picks of arms that end with fingers, such as a gripper in percent, as those of the arms before them.

    ``by_name``: fingers are only what is called so, and no other joint that slides.
    """
    arms = {arm.joints: arm for arm in reversed(seen.arms)}
    found = []
    for pick in picks:
        joints = pick.arm.joints
        ends = [_FINGER.search(name) is not None if by_name else _is_finger(seen, name) for name in joints]
        count = next((k for k in range(len(joints), 0, -1) if not ends[k - 1]), 0)
        arm = arms.get(joints[:count])
        if arm is not None and count < len(joints) and not any(name in seen.named for name in joints[count:]):
            own = pick.joints._replace(columns=pick.joints.columns[:count])
            found.append(replace(pick, arm=arm, joints=own))
    return found


def no_joints(seen: Seen) -> Exception:
    """Return what to raise where no column is a joint."""
    if (torn := no_number_of_joint(seen)) is not None:
        return torn
    if any(begins_list(text) for column in seen.raw.columns for text in (column.title, *column.words[:1])):
        return of_lists(seen.raw.where)
    there = listed([column.title for column in seen.raw.columns])
    if not seen.arms:
        end = "" if seen.answers.tip is None else f" on the way to {seen.answers.tip!r}"
        return RobotError(f"{seen.document.where}: no joint moves{end}, and there is nothing to calibrate.")
    longest = seen.arms[0].joints
    sizes = [size for size in roles.numbered_columns(seen.raw, seen.known) if size > 2] if seen.raw.named else []
    if sizes:
        return ask(
            "joints",
            f"{seen.raw.where}: {max(sizes)} columns are numbered, and the arm {run_of(longest)} has "
            f"{counted(len(longest), 'joint')}",
            (),
            f"--column '{longest[0]} [deg]=TITLE' and so on, or --tip LINK",
        )
    numbers = sum(column.numbers is not None for column in seen.raw.columns)
    way = (
        f"; if some are, say which by columns, or --column '{longest[0]} [deg]=TITLE' and so on"
        if numbers >= len(longest)
        else ""
    )
    return MeasurementError(
        f"{seen.raw.where}: no column is a joint of the arm ({run_of(longest)}); the columns are {there}{way}."
    )


def no_number_of_joint(seen: Seen) -> Exception | None:
    """Return what to raise where columns have names or numbers of joints, and cells that are none; None else."""
    numbered = roles.would_be_joints(seen.raw, {len(arm.joints) for arm in seen.arms})
    for column, wrong in _not_numbers([*_of_joints(seen), *(seen.raw.columns[k] for k in numbered)]):
        if any(_BEGINS_NUMBER.match(word) for word in column.words):
            return _no_number(seen, column, wrong, "joint")
    return None


def no_point(seen: Seen) -> Exception | None:
    """Return what to raise where columns with names of a point hold something else than numbers, None where none do."""
    for column, wrong in _not_numbers([seen.raw.columns[k] for k in roles.would_be_points(seen.raw)]):
        return _no_number(seen, column, wrong, "point")
    return None


def _of_joints(seen: Seen) -> list[RawColumn]:
    joints = {name for arm in seen.arms for name in arm.joints}
    return [column for column in seen.raw.columns if column.name in joints]


def _not_numbers(columns: Iterable[RawColumn]) -> Iterator[tuple[RawColumn, list[str]]]:
    """Yield the columns that have cells that are no numbers, with these cells."""
    for column in columns:
        wrong = [word for word in column.words if word and not is_number(word, ",")]
        if column.numbers is None and wrong:
            yield column, wrong


def _no_number(seen: Seen, column: RawColumn, wrong: Sequence[str], of: str) -> MeasurementError:
    # Surely no number are those that are none with a decimal comma either.
    cell = next((word for word in wrong if not is_number(word, ";")), wrong[0])
    return MeasurementError(
        f"{seen.raw.where}: column {column.title!r} is of a {of}, and {shown(cell)} in it is no number, like "
        "12.5 or 1.25e1."
    )
