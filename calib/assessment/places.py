"""Rows in a few places of joint space with nothing between them: what geometry is worth elsewhere.

Such rows hardly tell placements and offsets from each other. Without priors they may grow far beyond what any arm has,
with hardly a trace where rows are, and make predictions elsewhere wrong by millimetres. Priors whose widths are learned
keep them small. But where the data determine too few parameters of a kind, such a prior is the parameter scale, which
is an assumption: so a choice takes them only where they win by places held out, and otherwise the user is told.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.assessment.validation import (
    ChosenRows,
    HeldOut,
    neighbourhoods,
    poses_between,
    predict_held_out,
    row_groups,
)
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.errors import IdentificationError, MeasurementError
from calib.identification.error_model import ErrorModel
from calib.identification.fit import Fit
from calib.identification.identify import identify
from calib.identification.losses import Loss
from calib.machine.tool_motion import tool_poses
from calib.measurement.kinds import QUANTITIES
from calib.measurement.measurements import Measurements
from calib.robot.conditions import ordinary
from calib.robot.sampling import closing

# What is to be taken must make predictions between places scatter this much less.
STEADIER = 0.8
# Of more rows places are not looked for where nobody asked.
_MOST_ROWS = 10_000


@dataclass(frozen=True, slots=True)
class LearnedWidths:
    """Geometry without priors against geometry with learned widths, by places that were held out one by one.

    ``without`` and ``learned``: errors of rows held out, in the unit of their first quantity. ``scatter_without`` and
    ``scatter_learned`` in m: of predictions between places, by the jackknife over places; NaN where held-out rows have
    decided already. ``taken``: whether learned widths make neither the rms nor the 95 % quantile larger, and
    predictions scatter a fifth less.
    """

    places: int
    without: HeldOut
    learned: HeldOut
    scatter_without: float
    scatter_learned: float

    @property
    def taken(self) -> bool:
        """Whether learned widths are taken."""
        return (
            self.learned.rms <= self.without.rms
            and self.learned.p95 <= self.without.p95
            and self.scatter_learned < STEADIER * self.scatter_without
        )

    @property
    def sentence(self) -> str:
        """What was taken, and why."""
        share = f"error of places held out {self.learned.rms / self.without.rms:.3f} of that without priors"
        if np.isfinite(self.scatter_without):
            share += f", scatter between places {self.scatter_learned / self.scatter_without:.2f} of it"
        kept = "learned widths of geometry" if self.taken else "no priors of geometry; with learned widths"
        return f"rows in {self.places} places apart: {kept}: {share}"

    def record(self) -> dict[str, object]:
        """Return it as plain data."""
        told = np.isfinite(self.scatter_without)
        return {
            "places": self.places,
            "without": self.without.rms,
            "learned": self.learned.rms,
            "scatter_without": self.scatter_without if told else None,
            "scatter_learned": self.scatter_learned if told else None,
            "taken": self.taken,
            "because": self.sentence,
        }


def with_learned_geometry(model: ErrorModel) -> ErrorModel:
    """Return a model whose offsets and placements have priors with learned widths."""
    return replace(model, priors=replace(model.priors, length="learned", angle="learned"))


def learned_widths(
    model: ErrorModel,
    measurements: Sequence[Measurements],
    looked_at: BoolArray,
    place: IntArray,
    *,
    model_sigmas: Sequence[float | None] | None = None,
    losses: Sequence[Loss] | None = None,
) -> LearnedWidths | None:
    """Judge learned widths of geometry by places, each held out in turn; None where that cannot be judged.

    ``looked_at`` (N,): which rows of all sets, and ``place`` of these, from 0. Nothing is judged where a prior is
    stated, where there are several set-ups or tools, or where a fit fails without a place. Costs a fit of either model
    for every place.
    """
    first = measurements[0]
    several = any(len(data.setups) > 1 or len(data.tools) > 1 for data in measurements)
    if several or not _without_priors(model):
        return None
    ends = np.cumsum([len(data) for data in measurements])[:-1]
    rows = ChosenRows.of(measurements, np.split(looked_at, ends))
    sigmas, own_losses = rows.sigmas(model_sigmas), rows.losses(losses)
    poses = poses_between(measurements, looked_at, place)

    def judged(model: ErrorModel) -> tuple[HeldOut, list[Fit]]:
        fits: list[Fit] = []

        def find(some: ChosenRows) -> Fit:
            fits.append(
                identify(
                    model.within(some.sets),
                    some.sets,
                    model_sigmas=some.sigmas(sigmas),
                    losses=some.losses(own_losses),
                )
            )
            return fits[-1]

        found = predict_held_out(find, model, rows.sets, place, place)
        return found.figure(QUANTITIES[first.kind][0].name), fits

    try:
        (without, fits), (learned, learning) = judged(model), judged(with_learned_geometry(model))
    except (IdentificationError, MeasurementError):
        return None
    between = _scatter(fits, poses), _scatter(learning, poses)
    return LearnedWidths(int(place.max()) + 1, without, learned, *between)


def _scatter(fits: Sequence[Fit], poses: Array) -> float:
    """Return how far predictions of the tool at poses (n, nr) scatter, in m, by fits without each of the places."""
    robot = fits[0].model.robot
    at = poses[closing(robot, poses, [fit.machine.deviations for fit in fits])]
    if not len(at):
        return float("nan")
    seen = np.stack([tool_poses(robot, fit.machine, at, ordinary(at))[:, :3, 3] for fit in fits])
    return float(np.sqrt((len(fits) - 1) * np.mean(np.sum((seen - seen.mean(axis=0)) ** 2, axis=2))))


def _without_priors(model: ErrorModel) -> bool:
    """Return whether geometry is free, and nobody has said how far it may be from nominal."""
    return bool(model.offsets or model.placements) and model.priors.length is None and model.priors.angle is None


def unshown(fit: Fit) -> tuple[str, ...]:
    """Return what a user should know of a fit without priors to rows in a few places apart; nothing of others."""
    sets = fit.measurements
    if not _without_priors(fit.model) or sum(map(len, sets)) > _MOST_ROWS or any(data.stream for data in sets):
        return ()
    near = neighbourhoods(sets, row_groups(sets))
    if not near.apart:
        return ()
    return (
        f"The rows lie in {int(near.number.max()) + 1} places of joint space with nothing between them, so the "
        "geometry is not shown elsewhere. Measure poses between these places; or, if the arm is near its URDF, keep it "
        'there: error_model.prior = { length = "learned", angle = "learned" }.',
    )
