"""Models side by side, judged by rows held out: a table and what follows from it."""

from calib.assessment.comparison import ModelComparison
from calib.presentation.report.document import Row, Sheet
from calib.presentation.sheets import SHOWN, count

# More would hide the recommendation; the JSON document has all.
_SHOWN_TERMS = 8


def comparison_sheet(found: ModelComparison) -> Sheet:
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


def comparison_sentences(found: ModelComparison) -> tuple[str, ...]:
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
        chosen = count(len(terms), "joint term is", "joint terms are")
        said.append(f"{chosen} chosen with all rows: {', '.join(terms[:_SHOWN_TERMS])}{more}.")
    if found.recommended is found.best:
        reason = "the least error, and no simpler one is within one standard error of it"
    else:
        reason = f"the simplest within one standard error of the least, that of {found.best.name}"
    unknown = count(found.recommended.rank, "direction is", "directions are")
    return (*said, f"Recommended: {found.recommended.name} ({unknown} determined): {reason}.")
