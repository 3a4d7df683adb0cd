"""Tables of the error model: which parameter error moves the tip how far. At most 80 columns wide."""

from calib.assessment.sensitivity import GroupStudy, Sensitivity
from calib.foundations.units import MM, UNITS
from calib.presentation.report.document import Row, Sheet


def sensitivity_sheet(sensitivity: Sensitivity) -> Sheet:
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


def sensitivity_sentence(sensitivity: Sensitivity) -> str:
    """Return how many combinations of the parameters positions at these poses tell apart."""
    apart = f"{sensitivity.rank} combinations of the {len(sensitivity.parameters)} parameters"
    return f"Positions at these poses tell {apart} apart."


def group_sheet(study: GroupStudy) -> Sheet:
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
