"""One table of somebody else, read."""

from collections.abc import Sequence

import numpy as np

from calib.foundations.units import UNITS
from calib.foundations.words import listed
from calib.identification.followed import FEWEST_ROWS, pivots
from calib.job.foreign.answers import Found, Pick, Trial, ask, run_of, values_of
from calib.job.foreign.fits import ALIKE, FOLLOWS, TIMES
from calib.job.foreign.turns import Turns
from calib.measurement.columns import KNOWN
from calib.measurement.kinds import Kind
from calib.measurement.orientations import ANGLES, MATRIX, ORIENTATIONS
from calib.measurement.raw import RawColumn, split_title
from calib.measurement.table import APPROACH, QUATERNION_COLUMNS, TORQUE, Columns, holds_words


class Reader(Turns):
    """Reads one table; ``robot``: the arm that tables before it have shown."""

    def read(self) -> Found:
        """Return how the table is read. Raises AskedError, or MeasurementError where no column is a joint."""
        picks = self._picks()
        if not picks:
            raise self._no_joints()
        with_point = [pick for pick in picks if pick.point is not None]
        kind = self.answers.observes
        if with_point and kind in (None, "position", "pose"):
            return self._positions(with_point)
        return self._other(picks)

    def _positions(self, picks: Sequence[Pick]) -> Found:
        trials = [trial for pick in picks for trial in self._trials(pick, ("m", "mm"))]
        if not any(trial.fit.share < FOLLOWS for trial in trials):
            trials += [trial for pick in picks for trial in self._trials(pick, ("cm", "inch"))]
        trials.sort(key=lambda trial: trial.fit.share)
        enough = trials and len(trials[0].rows) >= FEWEST_ROWS
        if enough and trials[0].fit.share < FOLLOWS:
            best = self._decided(trials)
        else:
            best = self._by_ranges(trials, picks, bool(enough))
        return self._posed(best)

    def _posed(self, best: Trial) -> Found:
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
                raise ask("orientation", f"{self.raw.where}: there is no orientation that fits", ORIENTATIONS[:5])
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

    def _other(self, picks: Sequence[Pick]) -> Found:
        kind, where = self.answers.observes, self.raw.where
        known = self.known
        if kind is None and known.pixels is not None:
            raise ask(
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
                raise ask(
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
            raise ask(
                "observes",
                f"{where}: {self._titles(pick.joints.columns)} are joints, and no column says what was measured there",
                (),
                "a column of the point (x, y, z), of a socket's name, or a length with a target",
            )
        target = self.raw.columns[targets[0]]
        units = self._touched(pick, target) if kind == "socket" else (*self._units_by_limits(pick), "m")
        self.reasons.append(f"{self._titles(pick.joints.columns)} are {run_of(pick.arm.joints)}, {pick.joints.why}")
        names = self._names(pick, units)
        names["target"] = target.title
        if kind == "distance":
            column = self.raw.columns[lengths[0]]
            unit = self._options([column], self.answers.lengths, ("m", "mm"))
            if len(unit) > 1:
                size, reach = float(np.nanmedian(np.abs(values_of(column)))), self._robot(pick.arm).reach
                unit = [u for u in unit if 0.02 * reach < size * UNITS[u].factor < 20.0 * reach]
            if len(unit) != 1:
                raise ask("lengths", f"{where}: {column.title!r} has no unit", ("m", "mm"))
            names[f"length [{unit[0]}]"] = column.title
            if column.symbol is None:
                self.reasons.append(f"{column.title!r} is taken to be in {unit[0]}: by the arm's reach")
        said = "rows of one name touch one point" if kind == "socket" else "lengths from the point that a row names"
        self.reasons.append(f"{target.title!r} names the target: {said}")
        return self._result(pick, kind, names, None)

    def _touched(self, pick: Pick, target: RawColumn) -> tuple[str, str, str]:
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
        clear = len(shares) == 1 or (len(shares) > 1 and shares[1][0] > max(TIMES * shares[0][0], ALIKE))
        if shares and shares[0][0] < FOLLOWS and clear:
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
            raise ask(
                "columns",
                f"{self.raw.where}: in no unit do rows of one {target.title!r} touch one point",
                (),
                "--angles, and --observes where it is no socket",
            )
        return (*self._units_by_limits(pick), "m")

    def _names(self, pick: Pick, units: tuple[str, str, str]) -> dict[str, str]:
        of = {"angle": units[0], "length": units[1]}
        return {
            f"{reading.name} [{self.raw.columns[k].symbol or of[reading.dimension]}]": self.raw.columns[k].title
            for reading, k in zip(self._robot(pick.arm).readings, pick.joints.columns, strict=True)
        }

    def _result(self, pick: Pick, kind: Kind, names: dict[str, str], orientation: str | None) -> Found:
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
        return Found(robot, kind, Columns(names, tuple(ignore), orientation), tuple(self.reasons))

    @staticmethod
    def _reads(column: RawColumn) -> bool:
        """Return whether a column that has our name is one of ours: words, or numbers with a unit, whole."""
        if not all(column.words):
            return False
        if holds_words(column.name):
            few = column.name in ("tool", "target") and len(set(column.words)) > 0.34 * len(column.words)
            return column.symbol is None and not few
        return column.numbers is not None and column.symbol is not None
