"""Which columns may be the joints of which arm, and which the point."""

import re
from collections.abc import Iterable, Sequence

from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.words import listed
from calib.job.chains import Chain, behind, chains
from calib.job.foreign.answers import Answers, Pick, ask, run_of
from calib.measurement.raw import RawTable
from calib.measurement.roles import (
    Joints,
    Orientation,
    Point,
    Roles,
    joints_by_name,
    joints_by_order,
    named_among,
    numbered_columns,
    roles,
    without_names,
)
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

_MOST_ARMS = 12
# Joints beyond an arm.
_FINGER = re.compile(r"finger|grip|hand|jaw|knuckle|thumb|claw|palm", re.IGNORECASE)
# A run of numbered columns that may be the end of a longer arm.
_FEWEST_JOINTS = 4


class Picks:
    """Candidates of one table; ``robot``: the arm that tables before it have shown."""

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

    def _picks(self) -> list[Pick]:
        if not self.raw.named:
            picks = []
            for arm in self._arms_of(range(len(self.raw.columns) + 1)):
                for way in without_names(self.raw, len(arm.joints)):
                    joints = Joints(way.joints, 1, "by their place", False)
                    point = None if way.point is None else Point(way.point, frozenset(), 1)
                    picks.append(Pick(arm, joints, point, () if way.orientation is None else (way.orientation,)))
            return self._as_answered(picks)
        points: list[Point | None] = [*self._points()] or [None]
        return self._as_answered(
            [Pick(arm, joints, point, self._turned(point)) for arm, joints in self._joints() for point in points]
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

    def _as_answered(self, picks: Sequence[Pick]) -> list[Pick]:
        """Return the picks that an answer does not rule out."""

        def holds(pick: Pick) -> bool:
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
            return ask(
                "joints",
                f"{self.raw.where}: {max(sizes)} columns are numbered, and the arm {run_of(longest)} has "
                f"{len(longest)} joints",
                (),
                f"--column '{longest[0]} [deg]=TITLE' and so on, or --tip LINK",
            )
        return MeasurementError(
            f"{self.raw.where}: no column is a joint of the arm ({run_of(longest)}); the columns are {there}."
        )

    def _robot(self, arm: Chain) -> Robot:
        if arm not in self.robots:
            self.robots[arm] = load_robot(self.document, arm.tip, arm.base)
        return self.robots[arm]

    def _titles(self, columns: Iterable[int]) -> str:
        titles = [self.raw.columns[k].title for k in columns]
        return run_of(titles)
