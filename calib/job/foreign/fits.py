"""How well the arm follows candidates in every unit, and which of them is right."""

import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.units import MM, UNITS
from calib.identification.followed import FEWEST_ROWS, Followed, followed
from calib.job.chains import listed as tips_of
from calib.job.foreign.answers import AskedError, Pick, Trial, ask, of_dimension, run_of, values_of
from calib.job.foreign.picks import Picks
from calib.job.proposal import About
from calib.measurement.raw import RawColumn
from calib.measurement.roles import (
    Point,
    numbers_of,
)
from calib.robot.robot import Robot

# A share of the spread of what was measured. Sound arms with a degree and a millimetre of errors leave 0.1 to 1 %, with
# 5 degrees and 10 mm up to 5 %; readings in a wrong unit, order or frame leave 30 % and more.
FOLLOWS = 0.15
# What comes so near, or within three times what the best leaves, is a rival that something else must decide on.
ALIKE, TIMES = 0.1, 3.0
# Nothing that an instrument measures agrees with a URDF so well.
_COMPUTED = 2e-5
# Rows on which a reading is tried.
_MOST_ROWS = 120
_LIMIT_SLACK = 1.1


class Fits(Picks):
    """Decides on columns and units: by what the arm follows, by names, by limits; or asks."""

    def _trials(self, pick: Pick, lengths: Sequence[str]) -> list[Trial]:
        assert pick.point is not None
        robot = self._robot(pick.arm)
        columns = [self.raw.columns[k] for k in pick.joints.columns]
        point = [self.raw.columns[k] for k in pick.point.columns]
        numbers = numbers_of(self.raw, (*pick.joints.columns, *pick.point.columns))
        rows = np.flatnonzero(np.isfinite(numbers).all(axis=1))
        if len(rows) > _MOST_ROWS:
            rows = rows[np.linspace(0, len(rows) - 1, _MOST_ROWS).astype(np.intp)]
        if len(rows) < 2 or not of_dimension(point, "length"):
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
                found.append(Trial(pick, (angle, slide, unit), tips, rows, fit))
        return found

    def _units_of_joints(self, robot: Robot, columns: Sequence[RawColumn]) -> list[tuple[str, str]]:
        turns = [c for c, r in zip(columns, robot.readings, strict=True) if r.dimension == "angle"]
        slides = [c for c, r in zip(columns, robot.readings, strict=True) if r.dimension == "length"]
        if not (of_dimension(turns, "angle") and of_dimension(slides, "length")):
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
                UNITS[column.symbol or of[reading.dimension]].factor * values_of(column)
                for column, reading in zip(columns, robot.readings, strict=True)
            ]
        )

    def _decided(self, trials: Sequence[Trial]) -> Trial:
        """Return the only trial that the arm follows, or the one that names prefer among those; or ask."""
        best = trials[0]
        rivals = [t for t in trials if t.fit.share < max(TIMES * best.fit.share, ALIKE)]
        rivals = self._one(rivals, "position", lambda t: t.pick.point)
        rivals = self._one(rivals, "joints", lambda t: t.pick.joints)
        arms = list(dict.fromkeys(t.pick.arm for t in rivals))
        if len(arms) > 1:
            raise ask("tip", f"{self.raw.where}: several arms of the URDF follow the rows alike", tips_of(arms))
        for about, k in (("angles", 0), ("lengths", 2), ("lengths", 1)):
            units = list(dict.fromkeys(t.units[k] for t in rivals))
            if len(units) > 1:
                name: About = "angles" if about == "angles" else "lengths"
                raise ask(name, f"{self.raw.where}: {about} in {' and in '.join(units)} fit alike", units)
        chosen = rivals[0]
        every = {t.pick.point for t in trials}
        if chosen.pick.point is not None and (
            chosen.pick.point.rank == 2
            or any(p is not None and p.rank < chosen.pick.point.rank == 1 and p.rank == 0 for p in every)
        ):
            raise self._point_question({t.pick.point for t in trials if t.pick.point is not None})
        self._say_fit(chosen, trials)
        return chosen

    def _one(self, rivals: Sequence[Trial], about: About, of) -> list[Trial]:  # type: ignore[no-untyped-def]
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
        raise ask(
            about,
            f"{self.raw.where}: {' and '.join(sorted(map(self._titles, columns)))} fit the joints alike",
            [f"'{first_of}={self.raw.columns[one[0]].title}'" for one in sorted(columns)],
            "--column",
        )

    def _point_question(self, found: Iterable[Point]) -> AskedError:
        columns = sorted({one.columns for one in found})
        return ask(
            "position",
            f"{self.raw.where}: which columns were measured, {' or '.join(map(self._titles, columns))}?",
            [f"'x={self.raw.columns[one[0]].title}'" for one in columns],
            "--column",
        )

    def _say_fit(self, best: Trial, trials: Sequence[Trial]) -> None:
        pick, (angle, _, length) = best.pick, best.units
        assert pick.point is not None
        self.reasons += [
            f"{self._titles(pick.joints.columns)} are {run_of(pick.arm.joints)}, {pick.joints.why}",
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
                    f"{what} are taken to be in {unit}: the arm follows to {best.fit.miss / MM:.3g} mm, "
                    f"{best.fit.share:.2%} of the spread{said}"
                )
        if best.fit.miss < _COMPUTED:
            self.reasons.append(
                "the nominal arm follows within "
                f"{1e6 * best.fit.miss:.2g} um: this point seems to be computed from the joints, not measured, and a "
                "calibration would find nothing"
            )

    def _by_ranges(self, trials: Sequence[Trial], picks: Sequence[Pick], enough: bool) -> Trial:
        """Return what is written, or what limits and reach leave; the arm does not follow, or rows are too few."""
        where = self.raw.where
        points = {pick.point for pick in picks if pick.point is not None}
        if len({point.columns for point in points}) > 1:
            raise self._point_question(points)
        if not trials:
            raise ask(
                "columns",
                f"{where}: {self._titles(picks[0].joints.columns)} or the point are in units of something else",
                (),
                "--column 'NAME [UNIT]=TITLE'",
            )
        pick = trials[0].pick
        if len({(t.pick.joints.columns, t.pick.arm) for t in trials}) > 1:
            raise ask("joints", f"{where}: several columns may be the joints", (), "--column 'JOINT=TITLE' or --tip")
        written = all(
            self.raw.columns[k].symbol is not None
            for k in (*pick.joints.columns, *(pick.point.columns if pick.point else ()))
        )
        answered = self.answers.angles is not None and self.answers.lengths is not None
        if enough and not np.isfinite(trials[0].fit.share):
            raise ask("columns", f"{where}: {self._titles(pick.point.columns if pick.point else ())} never change")
        if enough and not ((written or answered) and (pick.joints.exact or self.answers.columns)):
            best = trials[0]
            raise ask(
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
                    f"{self._titles(pick.joints.columns)} are {run_of(pick.arm.joints)}, {pick.joints.why}"
                )
                if enough:
                    self.reasons.append(
                        f"the arm does not follow: {trial.fit.share:.0%} of the spread is left; see what the check says"
                    )
                return trial
        raise AssertionError("units come from the trials")

    def _units_by_limits(self, pick: Pick) -> tuple[str, str]:
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
            raise ask(
                about,
                f"{self.raw.where}: {self._titles(pick.joints.columns)} have no unit, and {' and '.join(units)} are "
                f"{'both within' if inside else 'all beyond'} the limits of the joints",
                units,
            )
        self.reasons.append(f"angles are taken to be in {inside[0][0]}: in another unit they pass the joints' limits")
        return inside[0]

    def _length_by_reach(self, pick: Pick, point: Point) -> str:
        columns = [self.raw.columns[k] for k in point.columns]
        units = self._options(columns, self.answers.lengths, ("m", "mm"))
        if len(units) == 1:
            return units[0]
        numbers = np.column_stack([values_of(column) for column in columns])
        reach = self._robot(pick.arm).reach
        spread = float(np.nanmax(np.nanstd(numbers, axis=0)))
        fits = [unit for unit in units if 2e-3 * reach < spread * UNITS[unit].factor < 2.0 * reach]
        if len(fits) != 1:
            raise ask("lengths", f"{self.raw.where}: {self._titles(point.columns)} have no unit", units)
        self.reasons.append(f"lengths are taken to be in {fits[0]}: in another unit they do not suit the arm's reach")
        return fits[0]
