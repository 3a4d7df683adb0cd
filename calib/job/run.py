"""From inputs to an outcome: identify, level by level where a job has levels, and judge by what was held out."""

import json
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import replace
from glob import escape
from itertools import chain, islice
from typing import TYPE_CHECKING, TypeVar

from calib.assessment.blame import blame
from calib.assessment.metrics import Metrics, metrics
from calib.assessment.suggestions import suggestions
from calib.foundations.errors import IdentificationError, JobError, MeasurementError, naming
from calib.foundations.words import listed, noun
from calib.identification.fit import Fit
from calib.identification.identify import identify, residuals_of, with_values
from calib.identification.initialisation.problem import initial_problem
from calib.identification.total_differential import Trace, total_differential
from calib.job.inputs import Inputs
from calib.job.read import Progress
from calib.job.residuals import moved_nodes, residual_model, worse
from calib.measurement.checks import Finding
from calib.results.calibration import Calibration, LevelReport, Origin, assess

if TYPE_CHECKING:
    from calib.assessment.choice import Choice

_Number = TypeVar("_Number", bound=float | None)


def run(inputs: Inputs, progress: Progress = lambda _: None) -> Calibration:
    """Identify, and judge by the data held out."""
    with naming(inputs.path, IdentificationError, JobError):
        choice = _choose(inputs, progress)
        if choice is not None:
            inputs = replace(inputs, model=choice.model)
        fit, reports = _climb(inputs, choice, progress)
        inputs = replace(inputs, findings=(*inputs.findings, *_left_behind(fit, inputs)))
        known, values, remark = residual_model(inputs, fit, progress)
        remarks = [*([] if remark is None else [remark]), *([] if known is None else moved_nodes(inputs, fit))]
        inputs = replace(inputs, findings=(*inputs.findings, *remarks))
    trace = None
    if inputs.job.solver.kind == "total_differential":
        progress("following the total differential")
        trace = _follow(inputs)
        fit = with_values(fit, trace.values, trace.machine)
    progress("validating")
    found = assess(
        fit,
        inputs.validate,
        data=inputs.identify,
        residual_model=known,
        names=(*inputs.tables("identify"), *inputs.tables("validate")),
        findings=inputs.findings,
        trace=trace,
        origin=Origin(
            f"calib calibrate {shlex.quote(inputs.path.name)} -o out",
            resolved(inputs),
            inputs.files,
            inputs.hashes,
            inputs.mesh_roots,
            {name: said for name, said in inputs.job.about.model_dump().items() if said is not None},
        ),
    )
    if inputs.bases is not None:
        found = replace(found, machine=replace(found.machine, placed=inputs.bases.placed()))
    if known is not None:
        found = replace(found, findings=(*found.findings, *worse(found.machine, fit, inputs.validate)))
        reports = (*reports, LevelReport(inputs.job.levels[-1].name, values, values, found.judged_by["after"]))
    # What a fit leaves that explains nothing is nothing that joint terms make smaller.
    explained = all(check.passed for check in found.checks if check.name == "explained")
    if choice is None and not inputs.job.levels and trace is None and explained:
        found = replace(found, suggested=suggestions(fit, inputs.validate))
    found = replace(found, levels=reports, choice=choice, optics=inputs.optics).accepting(inputs.job.accept)
    return found if inputs.job.levels or trace is not None else found.blaming(blame(fit, found.sets))


def _choose(inputs: Inputs, progress: Progress) -> "Choice | None":
    """Choose joint terms from all that is to be identified from, where the job leaves it to the toolkit."""
    section = inputs.job.error_model
    if section.terms != "auto":
        return None
    from calib.assessment.choice import choose_terms  # noqa: PLC0415 - slow to load, and not every job leaves it to us

    with naming(f"{inputs.path}: error_model.terms", MeasurementError):
        return choose_terms(
            inputs.model,
            inputs.identify,
            model_sigmas=_flat(inputs.model_sigmas),
            losses=inputs.losses,
            progress=progress,
        )


def _follow(inputs: Inputs) -> Trace:
    solver = inputs.job.solver
    with naming(f"{inputs.path}: solver", IdentificationError, JobError):
        return total_differential(
            inputs.model,
            inputs.identify,
            stop=solver.stop.si,
            rounding=None if solver.rounding is None else solver.rounding.si,
            most=solver.most,
        )


def _climb(inputs: Inputs, choice: "Choice | None", progress: Progress) -> tuple[Fit, tuple[LevelReport, ...]]:
    """Identify level by level, or all at once where the job has no levels, after a choice of joint terms, if any."""
    policy = inputs.job.error_model.null_space
    spent = iter(() if choice is None else choice.spent)
    spent_by_set = [tuple(islice(spent, len(group))) for group in inputs.model_sigmas]
    if not inputs.job.levels:
        progress("identifying")
        fit = identify(
            inputs.model,
            inputs.identify,
            null_space=policy,
            model_sigmas=_flat(inputs.model_sigmas),
            losses=inputs.losses,
            spent=_flat(spent_by_set) or None,
        )
        return _knowing(fit, inputs), ()
    given = zip(inputs.identify, inputs.model_sigmas, inputs.losses, spent_by_set, strict=True)
    by_file = dict(zip(inputs.tables("identify"), given, strict=True))
    found: Fit | None = None
    reports: list[LevelReport] = []
    for level in inputs.job.levels:
        if level.residual_model is not None:
            continue
        progress(f"identifying level {level.name}")
        chosen = [by_file[file] for file in level.measurements or by_file]
        sets = [data for data, _, _, _ in chosen]
        found = identify(
            inputs.model.within(sets),
            sets,
            free=level.free,
            start=found,
            null_space=policy,
            model_sigmas=_flat(group for _, group, _, _ in chosen),
            losses=[loss for _, _, loss, _ in chosen],
            spent=_flat(lost for _, _, _, lost in chosen) or None,
        )
        found = _knowing(found, inputs)
        reports.append(LevelReport(level.name, len(found.parameters), found.rank, _judge(inputs, found)))
    if found is None:
        raise TypeError("a job with levels has a first one")
    return found, tuple(reports)


def _left_behind(fit: Fit, inputs: Inputs) -> list[Finding]:
    """Return a warning where set-ups or tools are of earlier levels alone: the machine is that of the last one."""
    own, found = fit.measurements[0], []
    for what, known, every in (
        ("set-up", own.setups, [data.setups for data in inputs.identify]),
        ("tool", own.tools, [data.tools for data in inputs.identify]),
    ):
        if lost := [name for name in dict.fromkeys(chain.from_iterable(every)) if name not in known]:
            sentence = (
                f"levels: the last one has no rows of the {noun(len(lost), what)} {listed(lost)}, which the results "
                "therefore do not have; let it take their tables as well, and free them."
            )
            found.append(Finding.warning("left-behind", sentence))
    return found


def _knowing(fit: Fit, inputs: Inputs) -> Fit:
    """Return the fit with what the job knows of all targets and set-ups, also of those not identified from."""
    return replace(fit, model=replace(fit.model, targets=inputs.whole_model.targets, setups=inputs.whole_model.setups))


def _flat(groups: Iterable[tuple[_Number, ...]]) -> list[_Number]:
    return [number for group in groups for number in group]


def _judge(inputs: Inputs, fit: Fit) -> Mapping[str, Metrics]:
    """Return the metrics of a level. Base and tool are fitted anew: a level by itself leaves them where they were."""
    parameters = initial_problem(inputs.model, inputs.identify).parameters
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
