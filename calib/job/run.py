"""From inputs to an outcome: identify, level by level where a job has levels, and judge by what was held out."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from glob import escape
from typing import Literal, NamedTuple

import numpy as np

from calib.assessment.choice import Choice, choose_terms
from calib.assessment.metrics import Metrics, metrics
from calib.assessment.outliers import Outliers, outliers
from calib.assessment.trust import doubts, remarks
from calib.compensation.gaussian import GaussianResiduals
from calib.compensation.grid import SectorGrid
from calib.compensation.urdf import lost_in_urdf
from calib.foundations.arrays import Array
from calib.foundations.errors import IdentificationError, JobError, MeasurementError
from calib.foundations.units import parse_quantity
from calib.identification.fit import Fit
from calib.identification.identify import identify, residuals_of, with_values
from calib.identification.posing import posed
from calib.identification.total_differential import Trace, total_differential
from calib.job.inputs import Inputs, Progress
from calib.job.residuals import residual_model
from calib.measurement.measurements import Measurements
from calib.robot.conditions import joined


class JudgedSet(NamedTuple):
    """One table and its residuals (N, 3 or 6), measured minus predicted, in m and rad, before and after."""

    use: Literal["identification", "validation"]
    file: str
    data: Measurements
    before: Array
    after: Array


@dataclass(frozen=True, slots=True)
class LevelReport:
    """What one level has brought: metrics by quantity of the held-out data, base and tool fitted anew.

    Of the data to identify from, where nothing is held out. ``free``: number of parameters; ``rank``: of those seen.
    """

    name: str
    free: int
    rank: int
    metrics: Mapping[str, Metrics]


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """A finished calibration.

    ``metrics[use][when][quantity]``: use is identification or validation, when is before or after.
    ``sets``: residuals of every table, those after with the ``residual_model``, where it has values. ``doubts``: why it
    should not be trusted. ``levels`` and ``trace``: on the way to the fit. ``lost_in_urdf``: rms in m at the tip that
    the calibrated URDF alone is off, as it holds neither closed loops nor joint terms. ``choice``: of the joint terms,
    where the job leaves it to the tool; ``inputs.model`` then has them. ``outliers``: of the data to identify from.
    """

    inputs: Inputs
    fit: Fit
    sets: tuple[JudgedSet, ...]
    metrics: Mapping[str, Mapping[str, Mapping[str, Metrics]]]
    doubts: tuple[str, ...]
    outliers: Outliers
    trace: Trace | None = None
    levels: tuple[LevelReport, ...] = ()
    residual_model: SectorGrid | GaussianResiduals | None = None
    lost_in_urdf: float = 0.0
    choice: Choice | None = None


def run(inputs: Inputs, progress: Progress = lambda _: None) -> Outcome:
    """Identify, and judge by the data held out."""
    try:
        choice = _choose(inputs, progress)
        if choice is not None:
            inputs = replace(inputs, model=choice.model)
        fit, reports = _climb(inputs, progress)
        known, values, remark = residual_model(inputs, fit, progress)
        if remark is not None:
            inputs = replace(inputs, findings=(*inputs.findings, remark))
    except (IdentificationError, JobError) as e:
        raise type(e)(f"{inputs.path}: {e}") from e
    trace = None
    if inputs.job.solver.kind == "total_differential":
        progress("following the total differential")
        trace = _follow(inputs)
        fit = with_values(fit, trace.values, trace.machine)
    inputs = replace(inputs, findings=(*inputs.findings, *remarks(fit)))
    progress("validating")
    judged_sets = (
        *_judged("identification", inputs.tables("identify"), inputs.identify, fit, known),
        *_judged("validation", inputs.tables("validate"), inputs.validate, fit, known),
    )
    figures: dict[str, Mapping[str, Mapping[str, Metrics]]] = {
        use: {
            "before": metrics((judged.data.kind, judged.before) for judged in judged_sets if judged.use == use),
            "after": metrics((judged.data.kind, judged.after) for judged in judged_sets if judged.use == use),
        }
        for use in dict.fromkeys(judged.use for judged in judged_sets)
    }
    judged = figures["validation" if inputs.validate else "identification"]
    if known is not None:
        reports = (*reports, LevelReport(inputs.job.levels[-1].name, values, values, judged["after"]))
    progress("looking for outliers")
    files = {data.where: file for file, data in zip(inputs.tables("identify"), inputs.identify, strict=True)}
    stopped = () if trace is None or trace.reason == "below the limit" else (_not_stopped(trace),)
    return Outcome(
        inputs,
        fit,
        judged_sets,
        figures,
        (*stopped, *doubts(fit, judged["before"], judged["after"], held_out=bool(inputs.validate))),
        outliers(fit, files=files),
        trace,
        reports,
        known,
        lost_in_urdf(
            fit.robot,
            fit.deviations,
            np.concatenate([end.readings for judged in judged_sets for end in judged.data.ends]),
            joined([end.conditions for judged in judged_sets for end in judged.data.ends]),
        ),
        choice,
    )


def _choose(inputs: Inputs, progress: Progress) -> Choice | None:
    """Choose joint terms from all that is to be identified from, where the job leaves it to the tool."""
    section = inputs.job.error_model
    if section.terms != "auto":
        return None
    try:
        return choose_terms(
            inputs.model,
            inputs.identify,
            model_sigmas=_flat(inputs.model_sigmas),
            losses=inputs.losses,
            progress=progress,
        )
    except MeasurementError as e:
        raise MeasurementError(f"{inputs.path}: error_model.terms: {e}") from e


def _follow(inputs: Inputs) -> Trace:
    solver = inputs.job.solver
    try:
        return total_differential(
            inputs.model,
            inputs.identify,
            stop=parse_quantity(solver.stop, "length", "solver.stop"),
            rounding=None if solver.rounding is None else parse_quantity(solver.rounding, "angle", "solver.rounding"),
            most=solver.most,
        )
    except (IdentificationError, JobError) as e:
        raise type(e)(f"{inputs.path}: solver: {e}") from e


def _not_stopped(trace: Trace) -> str:
    largest = trace.iterations[-1].largest * 1e3
    return f"The total differential ended because {trace.reason}, with a largest error of {largest:.3g} mm."


def _climb(inputs: Inputs, progress: Progress) -> tuple[Fit, tuple[LevelReport, ...]]:
    """Identify level by level, or all at once where the job has no levels."""
    policy = inputs.job.error_model.blind
    if not inputs.job.levels:
        progress("identifying")
        sigmas = _flat(inputs.model_sigmas)
        fit = identify(inputs.model, inputs.identify, blind=policy, model_sigmas=sigmas, losses=inputs.losses)
        return _knowing(fit, inputs), ()
    given = zip(inputs.identify, inputs.model_sigmas, inputs.losses, strict=True)
    by_file = dict(zip(inputs.tables("identify"), given, strict=True))
    found: Fit | None = None
    reports: list[LevelReport] = []
    for level in inputs.job.levels:
        if level.residual_model is not None:
            continue
        progress(f"identifying level {level.name}")
        chosen = [by_file[file] for file in level.measurements or by_file]
        sets = [data for data, _, _ in chosen]
        found = identify(
            inputs.model.within(sets),
            sets,
            free=level.free,
            start=found,
            blind=policy,
            model_sigmas=_flat(group for _, group, _ in chosen),
            losses=[loss for _, _, loss in chosen],
        )
        found = _knowing(found, inputs)
        reports.append(LevelReport(level.name, len(found.parameters), found.rank, _judge(inputs, found)))
    if found is None:
        raise TypeError("a job with levels has a first one")
    return found, tuple(reports)


def _knowing(fit: Fit, inputs: Inputs) -> Fit:
    """Return the fit with what the job knows of all targets, also of those that it was not identified from."""
    return replace(fit, model=replace(fit.model, targets=inputs.targets))


def _judged(
    use: Literal["identification", "validation"],
    files: Sequence[str],
    sets: Sequence[Measurements],
    fit: Fit,
    known: SectorGrid | GaussianResiduals | None,
) -> Iterator[JudgedSet]:
    before, after = residuals_of(fit, sets, fit.nominal), residuals_of(fit, sets, fit.machine)
    for file, data, b, a in zip(files, sets, before, after, strict=True):
        if known is not None and data.position is not None:
            a = a.copy()  # noqa: PLW2901
            a[:, :3] -= known.shifts(fit.machine.frames.base, data.tips(fit.robot, fit.deviations), data.readings)
        yield JudgedSet(use, file, data, b, a)


def _flat(groups: Iterable[tuple[float | None, ...]]) -> list[float | None]:
    return [sigma for group in groups for sigma in group]


def _judge(inputs: Inputs, fit: Fit) -> Mapping[str, Metrics]:
    """Return the metrics of a level. Base and tool are fitted anew: a level by itself leaves them where they were."""
    parameters = posed(inputs.model, inputs.identify).parameters
    frames = [escape(p.name) for p in parameters if p.kind in ("base", "tool")]
    judged = fit
    if frames:
        sigmas, losses = _flat(inputs.model_sigmas), inputs.losses
        judged = identify(inputs.model, inputs.identify, free=frames, start=fit, model_sigmas=sigmas, losses=losses)
        judged = _knowing(judged, inputs)
    sets = inputs.validate or inputs.identify
    found = residuals_of(judged, sets, judged.machine)
    return metrics((data.kind, r) for data, r in zip(sets, found, strict=True))


def resolved(inputs: Inputs) -> str:
    """Return the job with every default written out, as JSON."""
    return json.dumps(inputs.job.model_dump(by_alias=True), indent=2, allow_nan=False) + "\n"
