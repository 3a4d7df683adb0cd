"""What is in these files? The one answer, for commands, jobs and Python: columns, units, conventions and roles.

Names list candidates; the nominal arm, base and tool put where they explain most, decides between them: readings that
are right it follows, wrong ones it does not. Where two readings fit alike, that is asked, never guessed.
"""

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import CalibError, JobError, MeasurementError
from calib.foundations.files import read_bytes
from calib.foundations.units import UNITS, symbols
from calib.foundations.words import listed
from calib.identification.followed import FEWEST_ROWS, Followed, followed, pivots, turned_along
from calib.job.chains import Chain, behind, chains
from calib.job.chains import listed as tips_of
from calib.job.proposal import About, Proposal, ProposedTable, Question, table_lines
from calib.measurement.columns import KNOWN
from calib.measurement.kinds import Kind
from calib.measurement.orientations import ANGLES, EULER, MAKERS, MATRIX, ORIENTATIONS, rotations_of
from calib.measurement.raw import RawColumn, RawTable, raw_table, split_title
from calib.measurement.roles import (
    Joints,
    Orientation,
    Point,
    Roles,
    joints_by_name,
    joints_by_order,
    named_among,
    numbered_columns,
    numbers_of,
    roles,
    without_names,
)
from calib.measurement.table import APPROACH, QUATERNION_COLUMNS, TORQUE, Columns, holds_words
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, read_urdf

# A share of the spread of what was measured. Sound arms with a degree and a millimetre of errors leave 0.1 to 1 %, with
# 5 degrees and 10 mm up to 5 %; readings in a wrong unit, order or frame leave 30 % and more.
_FOLLOWS = 0.15
# What comes so near, or within three times what the best leaves, is a rival that something else must decide on.
_ALIKE, _TIMES = 0.1, 3.0
_FOLLOWS_ANGLE, _ALIKE_ANGLE = 0.2, 0.015
# Nothing that an instrument measures agrees with a URDF so well.
_COMPUTED = 2e-5
_SAME_ANGLE = 1e-6
_MOST_ARMS = 12
# Joints beyond an arm.
_FINGER = re.compile(r"finger|grip|hand|jaw|knuckle|thumb|claw|palm", re.IGNORECASE)
# A run of numbered columns that may be the end of a longer arm.
_FEWEST_JOINTS = 4
# Rows on which a reading is tried.
_MOST_ROWS = 120
_HELD_OUT = 0.25
_VALIDATION = re.compile(r"valid|verif|test|check|held|control", re.IGNORECASE)
_LIMIT_SLACK = 1.1


@dataclass(frozen=True, slots=True)
class Answers:
    """What a person said: every field is None, or empty, where nothing was."""

    tip: str | None = None
    angles: str | None = None
    lengths: str | None = None
    orientation: str | None = None
    observes: Kind | None = None
    columns: Mapping[str, str] | None = None

    def named(self) -> dict[str, str]:
        """Return the columns of the file by our names without units."""
        return {split_title(ours)[0]: theirs for ours, theirs in (self.columns or {}).items()}


class _AskedError(Exception):
    def __init__(self, question: Question) -> None:
        super().__init__(question.text)
        self.question = question


def _ask(about: About, text: str, choices: Iterable[str] = (), option: str | None = None) -> _AskedError:
    return _AskedError(Question(about, text, tuple(choices), option or f"--{about}"))


@checked
def propose(
    urdf: str | Path,
    files: Sequence[str | Path],
    *,
    tip: str | None = None,
    angles: str | None = None,
    lengths: str | None = None,
    orientation: str | None = None,
    observes: Kind | None = None,
    columns: Mapping[str, str] | None = None,
) -> Proposal:
    """Return how files of others are read as measurements of the arm of a URDF, with reasons and questions.

        found = calib.propose("arm.urdf", ["measured.csv"])
        print(found.job())

    What is given answers questions, for all files: ``angles`` and ``lengths``, units such as ``"deg"`` and ``"mm"``;
    ``orientation``, the meaning of three angles (``"abc"``, ``"wpr"``, ``"rpy"``, ``"rotation_vector"``, ``"ZYX"``...);
    ``observes``, the kind of measurement; ``columns``, our names for columns: ``{"x": "X2"}``.

    Raises CalibError with one sentence where a file has nothing of the arm, or an answer cannot be used.
    """
    answers = Answers(tip, angles, lengths, orientation, observes, columns)
    _refuse_answers(answers)
    document = read_urdf(urdf)
    if tip is not None and tip not in document.links:
        raise JobError(f"tip: {tip!r} is not a link of {urdf}; its links are {listed(document.links)}.")
    reasons: list[str] = []
    tables: list[ProposedTable] = []
    robot: Robot | None = None
    try:
        if not files:
            raise _tip_question(document, chains(document, tip))
        for file in files:
            raw = raw_table(read_bytes(Path(file), MeasurementError), str(file))
            found = _Reader(document, raw, answers, robot).read()
            robot = found.robot
            reasons += [f"{file}: {reason}." for reason in (*raw.remarks, *found.reasons)]
            tables.append(ProposedTable(str(file), found.observes, found.columns, "identify", None, raw.count))
    except _AskedError as asked:
        arm = robot or _some_robot(document, tip)
        return Proposal(str(urdf), arm, tuple(tables), tuple(reasons), (asked.question,))
    assert robot is not None, "there are files"
    shared, said = _shared_out(tables)
    return Proposal(str(urdf), robot, shared, (*reasons, *said), ())


def _refuse_answers(answers: Answers) -> None:
    for name, given, allowed in (
        ("angles", answers.angles, symbols("angle")),
        ("lengths", answers.lengths, symbols("length")),
        ("orientation", answers.orientation, ORIENTATIONS),
        ("observes", answers.observes, get_args(Kind)),
    ):
        if given is not None and given not in allowed:
            raise JobError(f"{name}: {given!r} is not one of {', '.join(allowed)}.")


def _some_robot(document: Urdf, tip: str | None) -> Robot:
    arms = chains(document, tip)
    if not arms:
        return load_robot(document, tip)
    return load_robot(document, arms[0].tip, arms[0].base)


def _tip_question(document: Urdf, arms: Sequence[Chain]) -> _AskedError:
    if not arms:
        raise MeasurementError(f"{document.where}: no joint moves; there is nothing to calibrate.")
    ways = "; ".join(f"{arm.tip} at the end of {_run(arm.joints)}" for arm in arms[:4])
    return _ask("observes", f"{document.where}: there are no measurements yet; tips are {ways}", (), "a table")


def _shared_out(tables: Sequence[ProposedTable]) -> tuple[tuple[ProposedTable, ...], list[str]]:
    """Give the tables their roles: by their names, else a share of every table is held out."""
    judged = [bool(_VALIDATION.search(Path(table.file).stem)) for table in tables]
    if any(judged) and not all(judged):
        said = [
            f"{table.file}: {'judges the result, by its name' if judge else 'is identified from'}."
            for table, judge in zip(tables, judged, strict=True)
        ]
        return tuple(
            replace(table, use="validate" if judge else "identify") for table, judge in zip(tables, judged, strict=True)
        ), said
    shared = tuple(replace(table, hold_out=_HELD_OUT) for table in tables)
    return shared, [
        f"{table.file}: a quarter of its {table.rows} rows is held out to judge the rest." for table in shared
    ]


def reading_that_fits(file: Path, robot: Robot, observes: Kind) -> str:
    """Return how a job would say that a table is read, for the end of a sentence; empty where that is not clear."""
    try:
        raw = raw_table(read_bytes(file, MeasurementError), str(file))
        found = _Reader(robot.urdf, raw, Answers(observes=observes), robot).read()
    except (_AskedError, CalibError):
        return ""
    return ", ".join(table_lines(found.columns))


def told(file: str | Path) -> tuple[str, ...]:
    """Return what the header of a table says without an arm; one sentence each."""
    raw = raw_table(read_bytes(Path(file), MeasurementError), str(file))
    known = roles(raw) if raw.named else Roles((), (), (), (), None, frozenset())

    def named(columns: Iterable[int]) -> str:
        return _run([raw.columns[k].title for k in columns])

    said = [*raw.remarks, f"{raw.count} rows of {len(raw.columns)} columns"]
    said += [f"{named(point.columns)} may be a point" for point in known.points]
    said += [f"{named(one.columns)} may be an orientation" for one in known.orientations]
    said += [f"{size} columns are numbered" for size in numbered_columns(raw) if size > 2]
    unitless = [c.title for c in raw.columns if c.numbers is not None and c.symbol is None]
    if unitless:
        said.append(f"without a unit: {listed(unitless, most=20)}")
    return tuple(f"{file}: {one}." for one in said)


# ---- one file


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    robot: Robot
    observes: Kind
    columns: Columns
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Pick:
    """Columns that may be the joints of an arm and, where the file has one, a point."""

    arm: Chain
    joints: Joints
    point: Point | None
    turned: tuple[Orientation, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """A pick in units: how well the arm follows it. ``units``: of angles, of joints that slide, of the point."""

    pick: _Pick
    units: tuple[str, str, str]
    tips: Array
    rows: IntArray
    fit: Followed


class _Reader:
    """Reads one table; ``robot``: the arm that tables before it have shown."""

    def __init__(self, document: Urdf, raw: RawTable, answers: Answers, robot: Robot | None) -> None:
        self.document, self.raw, self.answers = document, raw, answers
        self.arms = chains(document, answers.tip)
        self.robots: dict[Chain, Robot] = {}
        if robot is not None:
            base = None if robot.base == document.root else robot.base
            arm = Chain(base, robot.tip, tuple(reading.name for reading in robot.readings))
            self.arms, self.robots = (arm,), {arm: robot}
        self.known = roles(raw) if raw.named else Roles((), (), (), (), None, frozenset())
        self.named = answers.named()
        self.reasons: list[str] = []
        for ours, theirs in self.named.items():
            if not any(theirs in (column.title, column.name) for column in raw.columns):
                raise JobError(f"columns: {ours} is to be {theirs!r}, which is no column of {raw.where}.")

    # -- what may be what

    def read(self) -> _Found:
        picks = self._picks()
        if not picks:
            raise self._no_joints()
        with_point = [pick for pick in picks if pick.point is not None]
        kind = self.answers.observes
        if with_point and kind in (None, "position", "pose"):
            return self._positions(with_point)
        return self._other(picks)

    def _picks(self) -> list[_Pick]:
        if not self.raw.named:
            picks = []
            for arm in self._arms_of(range(len(self.raw.columns) + 1)):
                for way in without_names(self.raw, len(arm.joints)):
                    joints = Joints(way.joints, 1, "by their place", False)
                    point = None if way.point is None else Point(way.point, frozenset(), 1)
                    picks.append(_Pick(arm, joints, point, () if way.orientation is None else (way.orientation,)))
            return self._as_answered(picks)
        points: list[Point | None] = [*self._points()] or [None]
        return self._as_answered(
            [_Pick(arm, joints, point, self._turned(point)) for arm, joints in self._joints() for point in points]
        )

    def _points(self) -> list[Point]:
        if all(axis in self.named for axis in "xyz"):
            x, y, z = (self._column(self.named[axis]) for axis in "xyz")
            return [Point((x, y, z), frozenset(), 1)]
        return list(self.known.points)

    def _turned(self, point: Point | None) -> tuple[Orientation, ...]:
        """Return the orientations that belong to a point: those with the same words around them, or the only one."""
        every = self.known.orientations
        if point is None:
            return ()
        own = set(point.columns)
        free = tuple(one for one in every if not own & set(one.columns))
        aside = {"rot", "rotation", "quat", "q", "r", "phi", "euler", "orientation", "ori", "p", "pos", "position", "t"}
        aside |= {"trans", "translation", "rvec", "rotvec", "rv", "o", "w", "coord"}
        alike = tuple(one for one in free if one.words - aside == point.words - aside)
        return alike or (free if len(self.known.points) == 1 else ())

    def _joints(self) -> list[tuple[Chain, Joints]]:
        """Return the columns of joints by name, of the longest arms that are named whole; else by their numbers."""
        among = frozenset(
            k
            for k, column in enumerate(self.raw.columns)
            if column.numbers is not None and (k not in self.known.spoken or self.raw.named)
        )
        named: list[tuple[Chain, Joints]] = []
        for arm in self.arms:
            given = [self.named.get(name) for name in arm.joints]
            if all(given) and (arm is self.arms[0] or self.answers.tip is not None):
                columns = tuple(self._column(title) for title in given if title is not None)
                named.append((arm, Joints(columns, 0, "as answered", True)))
                continue
            for first in range(len(arm.joints)):
                part = arm.joints[first:]
                if named and len(part) < max(len(other.joints) for other, _ in named):
                    break
                if named_among(self.raw, part, among) < len(part):
                    continue
                named += [(behind(self.document, arm, first), one) for one in joints_by_name(self.raw, part, among)]
                break
        fewest = max((len(arm.joints) for arm, _ in named), default=0)
        named = [(arm, one) for arm, one in named if len(arm.joints) == fewest]
        # Some joints may have names that are nearly theirs: then all columns are looked at in their order as well.
        claimed = {k for _, one in named for k in one.columns}
        if named and not [k for k in among if k not in self.known.spoken and k not in claimed]:
            return named
        found = []
        for arm in self._arms_of(range(fewest + 1, len(self.raw.columns) + 1)):
            found += [(arm, one) for one in joints_by_order(self.raw, len(arm.joints), self.known)]
        longest = max((len(arm.joints) for arm, _ in found), default=0)
        return named + [(arm, one) for arm, one in found if len(arm.joints) == longest]

    def _arms_of(self, counts: Iterable[int]) -> list[Chain]:
        """Return whole arms with as many joints; the ends of longer ones where no whole arm has as many as a family."""
        whole = [arm for arm in self.arms if len(arm.joints) in counts and self._is_plausible(arm)]
        families = set(numbered_columns(self.raw)) if self.raw.named else set()
        lengths = {len(arm.joints) for arm in whole}
        ends = [
            behind(self.document, arm, len(arm.joints) - count)
            for count in families - lengths
            for arm in self.arms
            if len(arm.joints) > count >= _FEWEST_JOINTS and self._is_plausible(arm)
        ]
        return list(dict.fromkeys([*whole, *ends]))[: 4 * _MOST_ARMS]

    def _is_plausible(self, arm: Chain) -> bool:
        """Return whether an arm may be meant where nothing names its joints: a whole one, or all but its fingers."""
        longer = [other for other in self.arms if other is not arm and other.joints[: len(arm.joints)] == arm.joints]
        return all(self._is_finger(name) for other in longer for name in other.joints[len(arm.joints) :])

    def _is_finger(self, name: str) -> bool:
        return _FINGER.search(name) is not None or self.document.joint(name).type == "prismatic"

    def _as_answered(self, picks: Sequence[_Pick]) -> list[_Pick]:
        """Return the picks that an answer does not rule out."""

        def holds(pick: _Pick) -> bool:
            ours = dict(zip(pick.arm.joints, pick.joints.columns, strict=True))
            if pick.point is not None:
                ours |= dict(zip("xyz", pick.point.columns, strict=True))
            return all(
                self._column(theirs) == ours.get(name, self._column(theirs)) for name, theirs in self.named.items()
            )

        return [pick for pick in picks if holds(pick)]

    def _column(self, title: str) -> int:
        return next(k for k, column in enumerate(self.raw.columns) if title in (column.title, column.name))

    def _no_joints(self) -> Exception:
        there = listed([column.title for column in self.raw.columns])
        longest = self.arms[0].joints if self.arms else ()
        sizes = [size for size in numbered_columns(self.raw) if size > 2] if self.raw.named else []
        if sizes and len(longest):
            return _ask(
                "joints",
                f"{self.raw.where}: {max(sizes)} columns are numbered, and the arm {_run(longest)} has "
                f"{len(longest)} joints",
                (),
                f"--column '{longest[0]} [deg]=TITLE' and so on, or --tip LINK",
            )
        return MeasurementError(
            f"{self.raw.where}: no column is a joint of the arm ({_run(longest)}); the columns are {there}."
        )

    # -- positions and poses

    def _positions(self, picks: Sequence[_Pick]) -> _Found:
        trials = [trial for pick in picks for trial in self._trials(pick, ("m", "mm"))]
        if not any(trial.fit.share < _FOLLOWS for trial in trials):
            trials += [trial for pick in picks for trial in self._trials(pick, ("cm", "inch"))]
        trials.sort(key=lambda trial: trial.fit.share)
        enough = trials and len(trials[0].rows) >= FEWEST_ROWS
        if enough and trials[0].fit.share < _FOLLOWS:
            best = self._decided(trials)
        else:
            best = self._by_ranges(trials, picks, bool(enough))
        return self._posed(best)

    def _trials(self, pick: _Pick, lengths: Sequence[str]) -> list[_Trial]:
        assert pick.point is not None
        robot = self._robot(pick.arm)
        columns = [self.raw.columns[k] for k in pick.joints.columns]
        point = [self.raw.columns[k] for k in pick.point.columns]
        numbers = numbers_of(self.raw, (*pick.joints.columns, *pick.point.columns))
        rows = np.flatnonzero(np.isfinite(numbers).all(axis=1))
        if len(rows) > _MOST_ROWS:
            rows = rows[np.linspace(0, len(rows) - 1, _MOST_ROWS).astype(np.intp)]
        if len(rows) < 2 or not _of_dimension(point, "length"):
            return []
        found = []
        for angle, slide in self._units_of_joints(robot, columns):
            q = self._readings(robot, columns, angle, slide)[rows]
            if np.abs(q).max() > 1e4:
                continue
            tips = robot.tips(q)
            for unit in self._options(point, self.answers.lengths, lengths):
                factors = [UNITS[column.symbol or unit].factor for column in point]
                position = numbers[rows, -3:] * factors
                if np.abs(position).max() > 1e4:
                    continue
                fit = followed(tips, position) if len(rows) >= FEWEST_ROWS else Followed(np.inf, np.inf, np.eye(4))
                found.append(_Trial(pick, (angle, slide, unit), tips, rows, fit))
        return found

    def _units_of_joints(self, robot: Robot, columns: Sequence[RawColumn]) -> list[tuple[str, str]]:
        turns = [c for c, r in zip(columns, robot.readings, strict=True) if r.dimension == "angle"]
        slides = [c for c, r in zip(columns, robot.readings, strict=True) if r.dimension == "length"]
        if not (_of_dimension(turns, "angle") and _of_dimension(slides, "length")):
            return []
        angles = self._options(turns, self.answers.angles, ("rad", "deg"))
        lengths = self._options(slides, self.answers.lengths, ("m", "mm")) if slides else ["m"]
        return list(itertools.product(angles, lengths))

    @staticmethod
    def _options(columns: Sequence[RawColumn], answer: str | None, units: Sequence[str]) -> Sequence[str]:
        """Return the units that columns without one may be in."""
        if all(column.symbol is not None for column in columns):
            return [columns[0].symbol or units[0]] if columns else [units[0]]
        return units if answer is None else [answer]

    @staticmethod
    def _readings(robot: Robot, columns: Sequence[RawColumn], angle: str, slide: str) -> Array:
        of = {"angle": angle, "length": slide}
        return np.column_stack(
            [
                UNITS[column.symbol or of[reading.dimension]].factor * _numbers(column)
                for column, reading in zip(columns, robot.readings, strict=True)
            ]
        )

    def _robot(self, arm: Chain) -> Robot:
        if arm not in self.robots:
            self.robots[arm] = load_robot(self.document, arm.tip, arm.base)
        return self.robots[arm]

    def _decided(self, trials: Sequence[_Trial]) -> _Trial:
        """Return the only trial that the arm follows, or the one that names prefer among those; or ask."""
        best = trials[0]
        rivals = [t for t in trials if t.fit.share < max(_TIMES * best.fit.share, _ALIKE)]
        rivals = self._one(rivals, "position", lambda t: t.pick.point)
        rivals = self._one(rivals, "joints", lambda t: t.pick.joints)
        arms = list(dict.fromkeys(t.pick.arm for t in rivals))
        if len(arms) > 1:
            raise _ask("tip", f"{self.raw.where}: several arms of the URDF follow the rows alike", tips_of(arms))
        for about, k in (("angles", 0), ("lengths", 2), ("lengths", 1)):
            units = list(dict.fromkeys(t.units[k] for t in rivals))
            if len(units) > 1:
                name: About = "angles" if about == "angles" else "lengths"
                raise _ask(name, f"{self.raw.where}: {about} in {' and in '.join(units)} fit alike", units)
        chosen = rivals[0]
        every = {t.pick.point for t in trials}
        if chosen.pick.point is not None and (
            chosen.pick.point.rank == 2
            or any(p is not None and p.rank < chosen.pick.point.rank == 1 and p.rank == 0 for p in every)
        ):
            raise self._point_question({t.pick.point for t in trials if t.pick.point is not None})
        self._say_fit(chosen, trials)
        return chosen

    def _one(self, rivals: Sequence[_Trial], about: About, of) -> list[_Trial]:  # type: ignore[no-untyped-def]
        """Return the rivals with the columns whose names say most clearly that they were measured; or ask."""
        found = list(dict.fromkeys(of(t) for t in rivals))
        columns = {one.columns for one in found}
        if len(columns) == 1:
            return list(rivals)
        if about == "joints" and len({one.exact for one in found}) > 1:
            return [t for t in rivals if of(t).exact]
        top = min(one.rank for one in found)
        first = {one.columns for one in found if one.rank == top}
        if len(first) == 1 and len({one.rank for one in found}) > 1:
            chosen = next(iter(first))
            for other in columns - first:
                self.reasons.append(
                    f"{self._titles(other)} fit as well, and {self._titles(chosen)} are "
                    f"{'measured' if top == 0 else 'not commanded'} by their names"
                )
            return [t for t in rivals if of(t).columns == chosen]
        if about == "position":
            raise self._point_question(found)
        first_of = rivals[0].pick.arm.joints[0]
        raise _ask(
            about,
            f"{self.raw.where}: {' and '.join(sorted(map(self._titles, columns)))} fit the joints alike",
            [f"'{first_of}={self.raw.columns[one[0]].title}'" for one in sorted(columns)],
            "--column",
        )

    def _point_question(self, found: Iterable[Point]) -> _AskedError:
        columns = sorted({one.columns for one in found})
        return _ask(
            "position",
            f"{self.raw.where}: which columns were measured, {' or '.join(map(self._titles, columns))}?",
            [f"'x={self.raw.columns[one[0]].title}'" for one in columns],
            "--column",
        )

    def _say_fit(self, best: _Trial, trials: Sequence[_Trial]) -> None:
        pick, (angle, _, length) = best.pick, best.units
        assert pick.point is not None
        self.reasons += [
            f"{self._titles(pick.joints.columns)} are {_run(pick.arm.joints)}, {pick.joints.why}",
            f"{self._titles(pick.point.columns)} are the measured point",
        ]
        for what, unit, k, columns in (
            ("angles", angle, 0, pick.joints.columns),
            ("lengths", length, 2, pick.point.columns),
        ):
            if any(self.raw.columns[c].symbol is None for c in columns):
                other = min((t.fit.share for t in trials if t.pick is pick and t.units[k] != unit), default=None)
                said = "" if other is None else f", in another unit it would miss by {other:.0%} or more"
                self.reasons.append(
                    f"{what} are taken to be in {unit}: the arm follows to {1e3 * best.fit.miss:.3g} mm, "
                    f"{best.fit.share:.2%} of the spread{said}"
                )
        if best.fit.miss < _COMPUTED:
            self.reasons.append(
                "the nominal arm follows within "
                f"{1e6 * best.fit.miss:.2g} um: this point seems to be computed from the joints, not measured, and a "
                "calibration would find nothing"
            )

    def _by_ranges(self, trials: Sequence[_Trial], picks: Sequence[_Pick], enough: bool) -> _Trial:
        """Return what is written, or what limits and reach leave; the arm does not follow, or rows are too few."""
        where = self.raw.where
        points = {pick.point for pick in picks if pick.point is not None}
        if len({point.columns for point in points}) > 1:
            raise self._point_question(points)
        if not trials:
            raise _ask(
                "columns",
                f"{where}: {self._titles(picks[0].joints.columns)} or the point are in units of something else",
                (),
                "--column 'NAME [UNIT]=TITLE'",
            )
        pick = trials[0].pick
        if len({(t.pick.joints.columns, t.pick.arm) for t in trials}) > 1:
            raise _ask("joints", f"{where}: several columns may be the joints", (), "--column 'JOINT=TITLE' or --tip")
        written = all(
            self.raw.columns[k].symbol is not None
            for k in (*pick.joints.columns, *(pick.point.columns if pick.point else ()))
        )
        answered = self.answers.angles is not None and self.answers.lengths is not None
        if enough and not np.isfinite(trials[0].fit.share):
            raise _ask("columns", f"{where}: {self._titles(pick.point.columns if pick.point else ())} never change")
        if enough and not ((written or answered) and (pick.joints.exact or self.answers.columns)):
            best = trials[0]
            raise _ask(
                "columns",
                f"{where}: the arm follows no reading of the file: at best {self._titles(best.pick.joints.columns)} in "
                f"{best.units[0]} and the point in {best.units[2]} leave {best.fit.share:.0%} of the spread; is it "
                "this robot, and are signs and the order of joints those of the URDF?",
                (),
                "--column 'NAME [UNIT]=TITLE' for all joints, --angles and --lengths",
            )
        angle, slide = self._units_by_limits(pick)
        assert pick.point is not None
        length = self._length_by_reach(pick, pick.point)
        for trial in trials:
            if trial.pick is pick and trial.units == (angle, slide, length):
                self.reasons.append(
                    f"{self._titles(pick.joints.columns)} are {_run(pick.arm.joints)}, {pick.joints.why}"
                )
                if enough:
                    self.reasons.append(
                        f"the arm does not follow: {trial.fit.share:.0%} of the spread is left; see what the check says"
                    )
                return trial
        raise AssertionError("units come from the trials")

    def _units_by_limits(self, pick: _Pick) -> tuple[str, str]:
        """Return the units of joints that have none: those in which all rows are within the limits; or ask."""
        robot = self._robot(pick.arm)
        columns = [self.raw.columns[k] for k in pick.joints.columns]
        ways = self._units_of_joints(robot, columns)
        if len(ways) == 1:
            return ways[0]
        inside = []
        for angle, slide in ways:
            q = self._readings(robot, columns, angle, slide)
            low = [-np.inf if r.lower is None else r.lower for r in robot.readings]
            high = [np.inf if r.upper is None else r.upper for r in robot.readings]
            size = np.where(np.isfinite(high), np.abs(high), 4.0 * np.pi)
            slack = (_LIMIT_SLACK - 1.0) * size
            if (
                np.nanmin(q - low + slack) >= 0.0
                and np.nanmin(high - q + slack) >= 0.0
                and np.nanmax(np.abs(q)) < 100.0
            ):
                inside.append((angle, slide))
        if len(inside) != 1:
            about: About = "angles" if len({angle for angle, _ in (inside or ways)}) > 1 else "lengths"
            units = dict.fromkeys((angle if about == "angles" else slide) for angle, slide in (inside or ways))
            raise _ask(
                about,
                f"{self.raw.where}: {self._titles(pick.joints.columns)} have no unit, and {' and '.join(units)} are "
                f"{'both within' if inside else 'all beyond'} the limits of the joints",
                units,
            )
        self.reasons.append(f"angles are taken to be in {inside[0][0]}: in another unit they pass the joints' limits")
        return inside[0]

    def _length_by_reach(self, pick: _Pick, point: Point) -> str:
        columns = [self.raw.columns[k] for k in point.columns]
        units = self._options(columns, self.answers.lengths, ("m", "mm"))
        if len(units) == 1:
            return units[0]
        numbers = np.column_stack([_numbers(column) for column in columns])
        reach = self._robot(pick.arm).reach
        spread = float(np.nanmax(np.nanstd(numbers, axis=0)))
        fits = [unit for unit in units if 2e-3 * reach < spread * UNITS[unit].factor < 2.0 * reach]
        if len(fits) != 1:
            raise _ask("lengths", f"{self.raw.where}: {self._titles(point.columns)} have no unit", units)
        self.reasons.append(f"lengths are taken to be in {fits[0]}: in another unit they do not suit the arm's reach")
        return fits[0]

    # -- orientations

    def _posed(self, best: _Trial) -> _Found:
        pick = best.pick
        assert pick.point is not None
        names = self._names(pick, best.units)
        length = best.units[2]
        for axis, k in zip("xyz", pick.point.columns, strict=True):
            names[f"{axis} [{self.raw.columns[k].symbol or length}]"] = self.raw.columns[k].title
        chosen = None
        if self.answers.observes != "position":
            chosen = self._orientation(best)
        if chosen is None:
            if self.answers.observes == "pose":
                raise _ask("orientation", f"{self.raw.where}: there is no orientation that fits", ORIENTATIONS[:5])
            return self._result(pick, "position", names, None)
        orientation, columns, unit = chosen
        titles = [self.raw.columns[k].title for k in columns]
        if orientation is None:
            names |= dict(zip(QUATERNION_COLUMNS, titles, strict=True))
        elif orientation == "matrix":
            names |= dict(zip(MATRIX, titles, strict=True))
        else:
            names |= {
                f"{ours} [{self.raw.columns[k].symbol or unit}]": self.raw.columns[k].title
                for ours, k in zip(ANGLES, columns, strict=True)
            }
        return self._result(pick, "pose", names, orientation)

    def _orientation(self, best: _Trial) -> tuple[str | None, tuple[int, ...], str] | None:
        """Return convention, columns and unit of the orientation that turns with the arm; None where none does."""
        ways = []
        for one in best.pick.turned:
            own = [self.raw.columns[k] for k in one.columns]
            numbers = np.column_stack([_numbers(column) for column in own])[best.rows]
            if not np.isfinite(numbers).all():
                continue
            for orientation, order, unit, rotation in self._rotations(one, own, numbers):
                angle = turned_along(best.tips, best.fit.base, rotation)
                ways.append((angle, orientation, tuple(one.columns[k] for k in order), unit, rotation, one))
        if not ways or not np.isfinite(best.fit.share):
            return self._only_written(best)
        ways.sort(key=lambda way: way[0])
        angle, orientation, columns, unit, rotation, one = ways[0]
        if angle > _FOLLOWS_ANGLE:
            self.reasons.append(
                f"{self._titles(one.columns)} are no orientation that turns with the arm (at best "
                f"{np.degrees(angle):.3g} deg are left): they are left out"
            )
            return None
        alike = [way for way in ways if way[0] < max(_TIMES * angle, _ALIKE_ANGLE)]
        others = [
            way
            for way in alike
            if np.linalg.norm(rigid.log3(np.swapaxes(way[4], 1, 2) @ rotation), axis=-1).max() > _SAME_ANGLE
        ]
        by_name = [way for way in alike if way[1] is not None and way[1] == way[5].convention]
        if others and by_name:
            angle, orientation, columns, unit, rotation, one = by_name[0]
        elif others:
            choices = tuple(dict.fromkeys(way[1] or "quaternion" for way in alike))
            if self.answers.observes is None:
                raise _ask(
                    "orientation",
                    f"{self.raw.where}: {self._titles(one.columns)} fit as {', '.join(choices[:8])} alike",
                    choices,
                )
        else:
            # One rotation by several names: the one that the columns have, or the shortest.
            same = [way for way in alike if way[1] == way[5].convention] or alike[:1]
            angle, orientation, columns, unit, rotation, one = same[0]
        self.reasons.append(
            f"{self._titles(columns)} are the orientation, {_called(orientation)}"
            + ("" if orientation in (None, "matrix") else f" in {unit}")
            + f": it turns with the arm within {np.degrees(angle):.2g} deg"
        )
        return orientation, columns, unit

    def _only_written(self, best: _Trial) -> tuple[str | None, tuple[int, ...], str] | None:
        """Return an orientation whose columns have our names, where nothing can be tried; else it is left out."""
        for one in best.pick.turned:
            names = tuple(self.raw.columns[k].name for k in one.columns)
            if names == QUATERNION_COLUMNS:
                return None, one.columns, ""
        if best.pick.turned:
            self.reasons.append(
                f"{self._titles(best.pick.turned[0].columns)} are left out: too few rows tell what orientation they are"
            )
        return None

    def _rotations(
        self, one: Orientation, columns: Sequence[RawColumn], numbers: Array
    ) -> Iterable[tuple[str | None, Sequence[int], str, Array]]:
        given = self.answers.orientation
        if one.form == "quaternion":
            size = np.linalg.norm(numbers, axis=1)
            if given is not None or np.abs(size - 1.0).max() > 1e-2:
                return
            # Columns that are called x, y, z, w say their order; numbered ones have w first, or last.
            letters = {column.name.lower()[-1:] for column in columns}
            orders = [(0, 1, 2, 3)] if "w" in letters else [(0, 1, 2, 3), (3, 0, 1, 2)]
            for order in orders:
                yield None, order, "", rigid.rotation_of_quaternion(numbers[:, order])
        elif one.form == "matrix":
            matrices = numbers.reshape(-1, 3, 3)
            if np.abs(np.swapaxes(matrices, 1, 2) @ matrices - np.eye(3)).max() < 1e-2:
                yield "matrix", range(9), "", rotations_of(numbers, "matrix")
        elif _of_dimension(columns, "angle"):
            names = [given] if given is not None else ["rotation_vector", *EULER]
            if one.convention in MAKERS and given is None:
                names = [one.convention, *(name for name in names if name != MAKERS[one.convention])]
            for unit in self._options(columns, self.answers.angles, ("rad", "deg")):
                factors = [UNITS[column.symbol or unit].factor for column in columns]
                if np.abs(numbers * factors).max() > 1e3:
                    continue
                for name in names:
                    yield name, range(3), unit, rotations_of(numbers * factors, name)

    # -- without a point

    def _other(self, picks: Sequence[_Pick]) -> _Found:
        kind, where = self.answers.observes, self.raw.where
        known = self.known
        if kind is None and known.pixels is not None:
            raise _ask(
                "observes",
                f"{where}: u and v are pixels, and nothing here says the camera's numbers; write the job by hand",
                (),
                "a job file with instruments.NAME of kind camera",
            )
        whole = [pick for pick in picks if pick.point is None] or list(picks)
        if len({(pick.joints.columns, pick.arm) for pick in whole}) > 1:
            ranks = {pick.joints.rank for pick in whole}
            whole = [pick for pick in whole if pick.joints.rank == min(ranks)]
            if len(whole) > 1:
                raise _ask(
                    "joints", f"{where}: several columns may be the joints", (), "--column 'JOINT=TITLE' or --tip"
                )
        pick = whole[0]
        targets = [k for k in known.targets if k not in pick.joints.columns]
        lengths = [k for k in known.lengths if k not in pick.joints.columns]
        if kind is None and lengths and targets:
            kind = "distance"
        elif kind is None and targets and not lengths:
            kind = "socket"
        if kind not in ("socket", "distance") or not targets:
            raise _ask(
                "observes",
                f"{where}: {self._titles(pick.joints.columns)} are joints, and no column says what was measured there",
                (),
                "a column of the point (x, y, z), of a socket's name, or a length with a target",
            )
        target = self.raw.columns[targets[0]]
        units = self._touched(pick, target) if kind == "socket" else (*self._units_by_limits(pick), "m")
        self.reasons.append(f"{self._titles(pick.joints.columns)} are {_run(pick.arm.joints)}, {pick.joints.why}")
        names = self._names(pick, units)
        names["target"] = target.title
        if kind == "distance":
            column = self.raw.columns[lengths[0]]
            unit = self._options([column], self.answers.lengths, ("m", "mm"))
            if len(unit) > 1:
                size, reach = float(np.nanmedian(np.abs(_numbers(column)))), self._robot(pick.arm).reach
                unit = [u for u in unit if 0.02 * reach < size * UNITS[u].factor < 20.0 * reach]
            if len(unit) != 1:
                raise _ask("lengths", f"{where}: {column.title!r} has no unit", ("m", "mm"))
            names[f"length [{unit[0]}]"] = column.title
            if column.symbol is None:
                self.reasons.append(f"{column.title!r} is taken to be in {unit[0]}: by the arm's reach")
        said = "rows of one name touch one point" if kind == "socket" else "lengths from the point that a row names"
        self.reasons.append(f"{target.title!r} names the target: {said}")
        return self._result(pick, kind, names, None)

    def _touched(self, pick: _Pick, target: RawColumn) -> tuple[str, str, str]:
        """Return the units in which rows of one socket touch one point; by limits where they do not tell."""
        robot = self._robot(pick.arm)
        columns = [self.raw.columns[k] for k in pick.joints.columns]
        ways = self._units_of_joints(robot, columns)
        words = list(dict.fromkeys(target.words))
        number = np.array([words.index(word) for word in target.words])
        shares = []
        for angle, slide in ways:
            q = self._readings(robot, columns, angle, slide)
            rows = np.flatnonzero(np.isfinite(q).all(axis=1) & (np.abs(q).max(axis=1) < 1e4))
            if 3 * len(rows) > 2 * (3 + 3 * len(words)):
                shares.append((pivots(robot.tips(q[rows]), number[rows]), angle, slide))
        shares.sort()
        clear = len(shares) == 1 or (len(shares) > 1 and shares[1][0] > max(_TIMES * shares[0][0], _ALIKE))
        if shares and shares[0][0] < _FOLLOWS and clear:
            if len(ways) > 1:
                self.reasons.append(
                    f"angles are taken to be in {shares[0][1]}: rows of one target then touch one point within "
                    f"{shares[0][0]:.2%} of what the tip moves"
                )
            return shares[0][1], shares[0][2], "m"
        if shares and len(ways) == 1:
            self.reasons.append(f"rows of one target do not touch one point: {shares[0][0]:.0%} of the motion is left")
            return ways[0][0], ways[0][1], "m"
        if shares:
            raise _ask(
                "columns",
                f"{self.raw.where}: in no unit do rows of one {target.title!r} touch one point",
                (),
                "--angles, and --observes where it is no socket",
            )
        return (*self._units_by_limits(pick), "m")

    # -- the answer

    def _names(self, pick: _Pick, units: tuple[str, str, str]) -> dict[str, str]:
        of = {"angle": units[0], "length": units[1]}
        return {
            f"{reading.name} [{self.raw.columns[k].symbol or of[reading.dimension]}]": self.raw.columns[k].title
            for reading, k in zip(self._robot(pick.arm).readings, pick.joints.columns, strict=True)
        }

    def _result(self, pick: _Pick, kind: Kind, names: dict[str, str], orientation: str | None) -> _Found:
        robot = self._robot(pick.arm)
        taken = set(names.values())
        ours = {split_title(name)[0] for name in names}
        own = KNOWN - {*"xyz", *QUATERNION_COLUMNS}
        told = {f"{what}{reading.name}" for what in (TORQUE, APPROACH) for reading in robot.readings}
        ignore = []
        for column in self.raw.columns:
            if column.title in taken:
                continue
            kept = column.name in own | told and column.name not in ours and self._reads(column)
            if not kept:
                ignore.append(column.title)
        if ignore:
            self.reasons.append(f"not read: {listed(ignore, most=20)}")
        if pick.arm.others:
            self.reasons.append(
                f"the tip is {pick.arm.tip}; {listed(pick.arm.others, most=4)} would do as well, since the tool is free"
            )
        if pick.arm.base is not None:
            self.reasons.append(f"the base is {pick.arm.base}: joints before it are in no column")
        return _Found(robot, kind, Columns(names, tuple(ignore), orientation), tuple(self.reasons))

    @staticmethod
    def _reads(column: RawColumn) -> bool:
        """Return whether a column that has our name is one of ours: words, or numbers with a unit, whole."""
        if not all(column.words):
            return False
        if holds_words(column.name):
            few = column.name in ("point", "target") and len(set(column.words)) > 0.34 * len(column.words)
            return column.symbol is None and not few
        return column.numbers is not None and column.symbol is not None

    def _titles(self, columns: Iterable[int]) -> str:
        titles = [self.raw.columns[k].title for k in columns]
        return _run(titles)


def _called(orientation: str | None) -> str:
    if orientation is None:
        return "a quaternion"
    if orientation in ("matrix", "rotation_vector"):
        return f"a {orientation.replace('_', ' ')}"
    order = MAKERS.get(orientation, orientation)
    about = "axes that turn along" if order.isupper() else "axes that stay"
    return f"{orientation}, turns about {', '.join(order.lower())}, {about},"


def _run(names: Sequence[str]) -> str:
    """Return a row of names, the middle of a long one left out."""
    if len(names) > 4:
        return f"{names[0]} to {names[-1]}"
    return ", ".join(names)


def _numbers(column: RawColumn) -> Array:
    assert column.numbers is not None, "roles have columns of numbers"
    return column.numbers


def _of_dimension(columns: Sequence[RawColumn], dimension: Literal["angle", "length"]) -> bool:
    return all(column.dimension in (None, dimension) for column in columns)
