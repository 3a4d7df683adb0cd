"""Uncertainty by resampling: what would have been found from other measurements like these.

It asks no model of the noise, and so judges the covariance of a fit. Two kinds (B. Efron, R. Tibshirani, *An
Introduction to the Bootstrap*, 1993, chapters 9.4 and 9.5): resampled *residuals*, which keeps the poses and takes the
scatter to be the same everywhere, and resampled *poses*, which takes all rows of a pose together and so keeps what they
have in common; it also shows what the choice of poses does to an answer whose model leaves something out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from glob import escape
from typing import Literal

import numpy as np
import numpy.typing as npt

from calib.assessment.validation import row_groups
from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.brief import brief
from calib.foundations.chance import drawing
from calib.foundations.errors import IdentificationError, JobError, MeasurementError
from calib.foundations.sealing import sealed
from calib.foundations.words import not_calibrated
from calib.identification.fit import Fit
from calib.identification.identify import identify_alike
from calib.measurement.kinds import QUANTITIES
from calib.measurement.measurements import Measurements
from calib.robot.conditions import ordinary

Kind = Literal["residuals", "poses"]

_MOST = 100_000


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Bootstrap:
    """Repeated fits. ``values`` (B, p) of the fit's parameters; ``positions`` (B, N, 3) of a tool in m.

    Angles of base and tools are counted from where the fit has them. ``failed``: repetitions that had too few different
    poses to be solved, or to place a tool, a target or a set-up.
    """

    __repr__ = brief

    values: Array
    positions: Array
    failed: int

    @property
    def covariance(self) -> Array:
        """Covariance (p, p) of the parameters in SI units; where not identifiable, of the chosen machine."""
        return np.atleast_2d(np.cov(self.values, rowvar=False))

    @property
    def sigma(self) -> Array:
        """Standard deviations (N,) of the tool's position, all three coordinates together, in m."""
        return np.asarray(np.sqrt(np.sum(np.var(self.positions, axis=0, ddof=1), axis=1)))


@checked
def bootstrap(
    fit: Fit,
    readings: npt.ArrayLike,
    repetitions: int = 200,
    *,
    kind: Kind = "poses",
    tool: str = "tool",
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda _done, _of: None,
) -> Bootstrap:
    """Return repeated fits, and where they put a tool in the instrument's frame at readings (N, nr) in rad and m.

    ``kind`` "residuals" or "poses"; of poses, rows with one ``group`` stay together, or, without groups, rows with the
    same readings; of a stream, stretches of 5 s, of which a dozen tell little and fewer nothing. Rows of photographs
    that err together are weighed as in the fit. ``progress`` is told how many of how many are done.

    Raises JobError for fewer than two repetitions or more than 100 000, MeasurementError for an unknown tool,
    RobotError for what is no readings of this robot.
    """
    if not 2 <= repetitions <= _MOST or kind not in ("residuals", "poses"):
        raise JobError(
            f"bootstrap: {repetitions} repetitions of kind {kind!r}; it takes 2 to {_MOST}, residuals or poses."
        )
    tools = fit.measurements[0].tools
    if tool not in tools:
        raise MeasurementError(f"{not_calibrated('tool', tool, tools)}.")
    where, tip = fit.robot.own(readings), fit.tool_tips.get(tool, fit.robot.tip)
    rng = drawing(seed)
    poses = [pose_groups(data) for data in fit.measurements]
    seen = _seen(fit, fit.measurements)
    free = [escape(parameter.name) for parameter in fit.parameters]
    values, positions, failed = [], [], 0
    for done in range(repetitions):
        if kind == "poses":
            drawn = [_drawn(rows, rng) for rows in poses]
            sets = [data.subset(rows) for data, (rows, _) in zip(fit.measurements, drawn, strict=True)]
            together = tuple(own and own.drawn(*of) for own, of in zip(fit.together, drawn, strict=False))
        else:
            sets, together = _with_other_residuals(fit, rng), ()
        if _seen(fit, sets) != seen:  # nothing says where the others are
            failed += 1
            progress(done + 1, repetitions)
            continue
        # A minimal set was chosen once and for all: what it does not hold is not free here.
        try:
            again = identify_alike(fit, sets, free, start=fit, together=together)
        except (IdentificationError, MeasurementError):  # of what is seen too few rows may be left to place it
            failed += 1
        else:
            machine = again.machine
            robot = again.model.robot.with_tip(tip)
            tips = robot.tips(where, machine.deviations, ordinary(where))
            values.append(again.values)
            positions.append((machine.frames.base @ tips @ machine.frames.tools[tools.index(tool)])[:, :3, 3])
        progress(done + 1, repetitions)
    if len(values) < 2:
        raise IdentificationError("bootstrap: the poses are too few to be drawn from; resample residuals instead.")
    return Bootstrap(read_only(np.array(values)), read_only(np.array(positions)), failed)


def pose_groups(data: Measurements) -> tuple[IntArray, ...]:
    """Return the rows of every pose: those of one ``group``, of the same readings, or of one stretch of a stream."""
    group = row_groups([data])
    return tuple(np.flatnonzero(group == k) for k in range(int(group.max(initial=-1)) + 1))


def _seen(fit: Fit, sets: Sequence[Measurements]) -> set[tuple[str, str]]:
    """Return kind and name of all targets, and of tools and set-ups where they were found, of which there are rows."""
    sought = {"target", *(parameter.kind for parameter in fit.parameters)}
    own = [data.with_own_names() for data in sets]
    names = [("target", data.targets) for data in own]
    names += [("tool", data.tools) for data in own] + [("base", data.setups) for data in own]
    return {(kind, name) for kind, of_set in names if kind in sought for name in of_set}


def _drawn(groups: Sequence[IntArray], rng: np.random.Generator) -> tuple[IntArray, IntArray]:
    """Return rows of poses that were drawn, and the draw of each. What is drawn twice stays side by side."""
    drawn = np.sort(rng.integers(len(groups), size=len(groups)))
    rows = [groups[k] for k in drawn]
    return np.concatenate(rows), np.repeat(np.arange(len(rows)), [len(own) for own in rows])


def _with_other_residuals(fit: Fit, rng: np.random.Generator) -> list[Measurements]:
    """Return the measurements as the fit predicts them, with residuals drawn from all of theirs.

    Residuals are smaller than errors by what the parameters have used up; they are widened by that.
    """
    sets = []
    for i, (data, r) in enumerate(zip(fit.measurements, fit.residuals, strict=True)):
        wide = r.copy()
        for noise in fit.noise_by_rows:
            if noise.measurements == i:
                columns = next(q.columns for q in QUANTITIES[data.kind] if q.name == noise.quantity)
                wide[:, columns] *= np.sqrt(r[:, columns].size / max(noise.degrees_of_freedom, 1.0))
        wide = wide[rng.integers(len(data), size=len(data))]
        position, orientation = data.position, data.orientation
        if position is None:
            raise MeasurementError(f"{data.where}: a {data.kind} has no measured point whose residual could be drawn.")
        position = position - r[:, :3] + wide[:, :3]
        if orientation is not None:
            predicted = orientation @ np.swapaxes(rigid.exp3(r[:, 3:]), 1, 2)
            orientation = predicted @ rigid.exp3(wide[:, 3:])
        sets.append(replace(data, position=read_only(position), orientation=orientation))
    return sets
