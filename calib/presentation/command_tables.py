"""Tables of commands, at most 80 columns wide: of plans, sensitivity, models side by side, acceptance, axes, topics.

Who shows one of them loads nothing of the others.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from calib.foundations.units import MM, UNITS
from calib.foundations.words import counted
from calib.presentation.report.document import Row, Sheet
from calib.presentation.sheets import SHOWN

if TYPE_CHECKING:
    from calib.assessment.comparison import ModelComparison
    from calib.assessment.performance import Performance
    from calib.assessment.planning import Plan
    from calib.assessment.sensitivity import GroupStudy, Sensitivity
    from calib.measurement.formats.recordings import Topic
    from calib.positioner.five_point import FivePoint

# More would hide the recommendation; the JSON document has all.
_SHOWN_TERMS = 8
_CAPTION = (
    "After the methods of ASME B89.4.22 and ISO 10360-12; no certificate. before: nominal arm, after: calibrated arm, "
)
_FOUND = "the probe found anew for both."
_GIVEN = "the probe is the tool of the results; touches of a cone (--probe) find that of another ball."


def forecast_sheet(plan: "Plan") -> Sheet:
    """Return what more and fewer poses would bring, chosen and at random, in mm."""
    rows = []
    for forecast in plan.forecasts:
        values = (f"{value / MM:.4f}" for value in (forecast.chosen, forecast.random))
        rows.append(Row((str(forecast.poses), *values), strong=len(plan.readings) == forecast.poses))
    return Sheet.of(
        "Error of the tool that more poses would remove, rms [mm]",
        (">poses", ">chosen", ">at random"),
        rows,
        f"over the working poses; not included is what no pose removes: {plan.floor / MM:.4f} mm",
    )


def index_sheet(plan: "Plan") -> Sheet:
    """Return the observability indices of the chosen poses beside those of random ones."""
    rows = [
        (who, *(f"{value:.4g}" for value in found.values()))
        for who, found in (("chosen", plan.indices), ("at random", plan.random_indices))
    ]
    return Sheet.of("Observability (larger is better)", ("poses", *(f">{name}" for name in plan.indices)), rows)


def enough_sentence(planned: "Plan", target: str, *, more: bool) -> str:
    """Return how many poses keep what more would remove below a target, beside those measured already (``more``)."""
    if planned.enough is None:
        return f"No number of these candidates keeps the error that more poses would remove below {target}."
    many = f"{planned.enough}{' more' if more else ''} of the best poses keep"
    return f"{many} the error that more poses would remove below {target}."


def sensitivity_sheet(sensitivity: "Sensitivity") -> Sheet:
    """Return the tip motion of every parameter over the poses, the strongest first; per mm, or per mrad and degree."""
    rows = []
    for k in sensitivity.order:
        parameter, rms, largest = sensitivity.parameters[k], sensitivity.rms[k], sensitivity.largest[k]
        # m per m is mm per mm, and m per rad is mm per mrad.
        unit = f"mm/{'1e-3' if parameter.unit == '1' else f'm{parameter.unit}'}"
        per_degree = f"{rms * UNITS['deg'].factor / MM:.3f} mm" if parameter.unit == "rad" else ""
        rows.append((parameter.name, f"{rms:.4f}", f"{largest:.4f}", unit, per_degree))
    columns = ("parameter", ">rms", ">max", "unit", ">rms per deg")
    return Sheet.of(f"Tip motion over {sensitivity.poses} poses", columns, rows)


def sensitivity_sentence(sensitivity: "Sensitivity") -> str:
    """Return how many combinations of the parameters positions at these poses tell apart."""
    apart = f"{sensitivity.rank} combinations of the {len(sensitivity.parameters)} parameters"
    return f"Positions at these poses tell {apart} apart."


def group_sheet(study: "GroupStudy") -> Sheet:
    """Return what becomes of the tip error when the errors of one group are scaled; in mm over the poses."""
    rows = []
    for group, changes in zip(study.groups, study.changes, strict=True):
        for factor, change in zip(study.factors, changes, strict=True):
            shown = (f"{value / MM:+.3f}" for value in (change.min(), change.mean(), change.max()))
            rows.append(Row((group, f"{factor:g}", *shown, "mm"), ends_group=factor == study.factors[-1]))
    errors = study.errors / MM
    return Sheet.of(
        f"Change of the tip error over {len(errors)} poses",
        ("errors scaled", ">factor", ">smallest", ">mean", ">largest", "unit"),
        rows,
        f"as given, the tip error is {errors.min():.3f} to {errors.max():.3f} mm, {errors.mean():.3f} on average",
    )


def comparison_sheet(found: "ModelComparison") -> Sheet:
    """Return the models by rank, their errors at rows held out and how much worse than the best they are."""
    factor, unit = (1.0, "relative") if found.unit == "1" else SHOWN[found.unit]
    rows = []
    for m in found.models:
        figures = (m.held_out.rms, m.held_out.standard_error, m.difference, m.standard_error)
        shown = (f"{value * factor:.4f}" for value in figures)
        rows.append(Row((m.name, str(m.parameters), str(m.rank), *shown), strong=m is found.recommended))
    some = f" of {found.all_rows}, taken at random," if found.rows < found.all_rows else ""
    rows_of = f"{found.rows} rows{some} in {found.groups} groups, {found.folds} folds"
    return Sheet.of(
        f"Errors at held-out rows, rms [{unit}]",
        ("model", ">free", ">rank", ">held out", ">std. error", ">worse by", ">std. error"),
        rows,
        f"{rows_of}; worse by: difference from the best model, at the same rows",
    )


def comparison_sentences(found: "ModelComparison") -> tuple[str, ...]:
    """Return the recommendation, and of several quantities what each says."""
    said = []
    if found.unit == "1":
        said.append(
            "Relative: the errors of each quantity are divided by the least one; shown is the root mean square over "
            f"{', '.join(found.recommended.rms).replace('_', ' ')}."
        )
    terms = found.recommended.terms
    if terms:
        more = f" and {len(terms) - _SHOWN_TERMS} more" if len(terms) > _SHOWN_TERMS else ""
        chosen = counted(len(terms), "joint term is", "joint terms are")
        said.append(f"{chosen} chosen with all rows: {', '.join(terms[:_SHOWN_TERMS])}{more}.")
    if found.recommended is found.best:
        reason = "the least error, and no simpler one is within one standard error of it"
    else:
        reason = f"the simplest within one standard error of the least, that of {found.best.name}"
    unknown = counted(found.recommended.rank, "direction is", "directions are")
    return (*said, f"Recommended: {found.recommended.name} ({unknown} determined): {reason}.")


def performance_sheet(arms: Mapping[str, "Performance"]) -> Sheet:
    """Return the figures of several arms in the same tests, a column for each: ``before``, ``after``."""
    tests = list(zip(*(arm.figures for arm in arms.values()), strict=True))
    following = [*(first.test for first, *_ in tests[1:]), ""]
    rows = []
    for (first, *others), after in zip(tests, following, strict=True):
        values = (f"{figure.value / MM:.4f}" for figure in (first, *others))
        cells = (first.test, first.place, str(first.n), first.name, *values)
        rows.append(Row(cells, ends_group=first.test != after))
    one, *rest = (arm.probe for arm in arms.values())
    said = _CAPTION + (_GIVEN if all(np.array_equal(one, other) for other in rest) else _FOUND)
    columns = ("test", "place", ">n", "figure", *(f">{arm}" for arm in arms))
    return Sheet.of("Acceptance figures [mm]", columns, rows, said)


def axes_sheet(found: "FivePoint") -> Sheet:
    """Return where both axes of a positioner are in the robot's base: a point of each, and its direction."""
    rows = []
    for axis, T in (("tilt", found.B_L), ("rotary", found.B_R)):
        point = (f"{value / MM:.4f}" for value in T[:3, 3])
        rows.append((axis, *point, *(f"{value:+.7f}" for value in T[:3, 2])))
    columns = ("axis", ">x, mm", ">y, mm", ">z, mm", ">direction x", ">direction y", ">direction z")
    return Sheet.of("Axes in the robot's base", columns, rows)


def topic_sheet(topics: Sequence["Topic"]) -> Sheet:
    """Return the topics of a recording, with rates and longest gaps."""
    rows = []
    for topic in topics:
        rate = f"{topic.rate:.1f}" if topic.rate > 0.0 else "-"
        rows.append((topic.name, topic.of or "-", str(topic.messages), rate, f"{topic.gap:.3f}"))
    return Sheet.of("Topics", ("topic", "becomes", ">messages", ">a second", ">longest gap [s]"), rows)
