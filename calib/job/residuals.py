"""The last level of a job: a model of what the identified machine leaves, over joint space."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.assessment.checks.of_rows import far_off
from calib.assessment.comparison import paired
from calib.assessment.gaussian_choice import MOST_JUDGED, bought
from calib.assessment.judged import JudgedSet
from calib.assessment.own_base import tables_with_own_base
from calib.assessment.validation import row_groups
from calib.foundations.arrays import Array, BoolArray
from calib.foundations.errors import MeasurementError
from calib.foundations.units import MM
from calib.foundations.words import listed
from calib.identification.fit import Fit
from calib.identification.identify import residuals_of
from calib.identification.losses import Loss
from calib.job.inputs import Inputs
from calib.job.read import Progress
from calib.job.refusals import with_positions
from calib.machine.calibrated import CalibratedMachine
from calib.machine.gaussian import GaussianResiduals, gaussian_from_residuals
from calib.machine.grid import SectorGrid, grid_from_residuals
from calib.machine.of_fit import machine_of
from calib.machine.residual_model import axes_of
from calib.measurement.checks import Finding
from calib.measurement.measurements import Measurements


class ResidualLevel(NamedTuple):
    """A residual model, the number of its free values, and what is to be said of it."""

    known: SectorGrid | GaussianResiduals | None
    values: int = 0
    remark: Finding | None = None


def residual_model(inputs: Inputs, fit: Fit, progress: Progress) -> ResidualLevel:
    """Return the residual model for which the last level asks. A Gaussian process must earn its place.

    Raises JobError and MeasurementError as :func:`calib.machine.grid.grid_from_residuals` and
    :func:`calib.machine.gaussian.gaussian_from_residuals`.
    """
    section = inputs.job.levels[-1].residual_model if inputs.job.levels else None
    if section is None:
        return ResidualLevel(None)
    sets = inputs.nodes or with_positions(inputs.identify)
    errors = [r[:, :3] for r in residuals_of(fit, sets, fit.machine)]
    for data in sets:
        if not fit.knows(data):
            raise MeasurementError(f"{data.where}: is of a tool or a set-up that no level identifies.")
    axes = [axes_of(section.frame, fit.bases_of(data), data.tips(fit.robot, fit.deviations)) for data in sets]
    turned = np.concatenate(
        [(np.swapaxes(R, -1, -2) @ r[:, :, None])[:, :, 0] for R, r in zip(axes, errors, strict=True)]
    )
    readings, group = np.concatenate([data.readings for data in sets]), row_groups(sets)
    # Elsewhere base and load err otherwise, and so do other tools.
    setups, tools = (_of_several(names, sets, fit.measurements) for names in (_setups, _tools))
    if section.kind == "grid":
        grid = grid_from_residuals(
            readings,
            turned,
            fit.robot.readings,
            section.joints or (),
            section.frame,
            partial=True,
            where=[f"{data.where}:{line}" for data in sets for line in data.lines],
        )
        return ResidualLevel(replace(grid, setups=setups, tools=tools), int(3 * grid.measured.sum()))
    progress("learning the Gaussian process")
    if not inputs.nodes:
        # What a loss takes for a wrong measurement in the fit is no error of the arm here.
        told = np.concatenate([_told(r, loss) for r, loss in zip(errors, _losses(inputs), strict=True)])
        readings, turned, group = readings[told], turned[told], np.unique(group[told], return_inverse=True)[1]
    known = gaussian_from_residuals(
        readings, turned, fit.robot.readings, section.joints, section.frame, where=sets[0].where
    )
    gain = bought(known, readings, turned, group)
    if gain.enters:
        return ResidualLevel(replace(known, setups=setups, tools=tools), len(known.joints) + 2)
    without, held = gain
    of = f" ({MOST_JUDGED} of {len(readings)} are looked at)" if len(readings) > MOST_JUDGED else ""
    sentence = (
        f"The Gaussian process is left out: at rows held out{of} it brings the position error from "
        f"{without.rms / MM:.3g} mm to {held.rms / MM:.3g} mm, which is not better by more than a standard error."
    )
    return ResidualLevel(None, 0, Finding.warning("gaussian-process-left-out", sentence))


def _losses(inputs: Inputs) -> list[Loss]:
    """Return the losses of the tables to identify from that have positions."""
    every = zip(inputs.identify, inputs.losses, strict=True)
    return [loss for data, loss in every if data.position is not None]


def _told(errors: Array, loss: Loss) -> BoolArray:
    """Return which rows of a table tell of the arm by their errors (N, 3): of a robust loss, those not far off."""
    return np.full(len(errors), fill_value=True) if loss == "linear" else ~far_off(np.linalg.norm(errors, axis=1), 3)


def _of_several(
    names: Callable[[Measurements], set[str]], sets: Sequence[Measurements], every: Sequence[Measurements]
) -> tuple[str, ...]:
    """Return the names in sets, none where ``every`` set has the same one."""
    return tuple(sorted(set().union(*map(names, sets)))) if len(set().union(*map(names, every))) > 1 else ()


def _setups(data: Measurements) -> set[str]:
    return {data.setups[k] for k in data.setup}


def _tools(data: Measurements) -> set[str]:
    return {data.tools[k] for k in data.tool}


def moved_nodes(inputs: Inputs, fit: Fit) -> Iterable[Finding]:
    """Yield which nodes ask for a base of their own: a residual model takes that motion for errors of the arm.

    And that neighbours in a grid were measured in several set-ups, of which each has what its own base errs by.
    """
    if not inputs.nodes:
        return
    setups, section = sorted(set().union(*map(_setups, inputs.nodes))), inputs.job.levels[-1].residual_model
    sought = any(parameter.kind == "base" for parameter in fit.parameters)
    if len(setups) > 1 and sought and section is not None and section.kind == "grid":
        yield Finding.warning(
            "nodes-of-several-setups",
            f"The nodes of the grid were measured in the set-ups {listed(setups, 6)}: what "
            "the base of each errs by is taken for errors of the arm, and the uncertainty does not hold; measure all "
            "nodes in one set-up.",
        )
    before, after = (residuals_of(fit, inputs.nodes, of) for of in (fit.nominal, fit.machine))
    rows = zip(inputs.tables("nodes"), inputs.nodes, before, after, strict=True)
    for one in tables_with_own_base(fit.model, machine_of(fit), [JudgedSet("validation", *table) for table in rows]):
        if one.wide:
            yield Finding.warning(
                "nodes-moved",
                f"{one.file}: these nodes fit better with a base of their own: their rms error would be "
                f"{one.moved / MM:.4g} mm in the place of {one.error / MM:.4g} mm. If robot or instrument was moved "
                "before they were measured, the residual model takes that for errors of the arm: measure the nodes "
                "from where the other tables were measured.",
            )


def worse(machine: CalibratedMachine, fit: Fit, held_out: Sequence[Measurements]) -> Iterable[Finding]:
    """Yield that a residual model makes held-out positions worse, by more than a standard error of the difference.

    The noise of what it was measured from is in all that it adds.
    """
    sets = with_positions(held_out)
    group = row_groups(sets) if sets else np.zeros(0, dtype=np.intp)
    # A single pose has no standard error.
    if not group.any():
        return
    left = residuals_of(fit, sets, fit.machine)
    without = np.concatenate([_squared(r) for r in left])
    now = np.concatenate([_squared(machine.less_shifts(r, d)) for r, d in zip(left, sets, strict=True)])
    more, error = paired(now, without, group)
    if more > error:
        before, after = (float(np.sqrt(np.mean(of))) / MM for of in (without, now))
        yield Finding.warning(
            "residual-model-worse",
            f"The residual model makes held-out positions worse: {after:.3g} mm rms with it, and {before:.3g} mm with "
            "the levels before it alone; leave its level out.",
        )


def _squared(residuals: Array) -> Array:
    """Return the squared errors (N,) in m^2 of residuals (N, 3 or 6) of positions or poses."""
    return np.asarray(np.sum(residuals[:, :3] ** 2, axis=1))
