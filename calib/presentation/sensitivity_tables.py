"""Tables of the error model: which parameter error moves the tip how far. At most 80 columns wide."""

from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from calib.assessment.sensitivity import GroupStudy, Sensitivity
from calib.foundations.units import MM, UNITS
from calib.presentation.tables import null_space_lines


def sensitivity_table(sensitivity: Sensitivity) -> Table:
    """Return the tip motion of every parameter over the poses, the strongest first; per mm, or per mrad and degree."""
    out = _table(f"Tip motion over {sensitivity.poses} poses")
    out.add_column("parameter", overflow="fold")
    for name in ("rms", "max"):
        out.add_column(name, justify="right")
    out.add_column("unit")
    out.add_column("rms per deg", justify="right")
    for k in sensitivity.order:
        parameter, rms, largest = sensitivity.parameters[k], sensitivity.rms[k], sensitivity.largest[k]
        angle = parameter.unit == "rad"
        # m per m is mm per mm, and m per rad is mm per mrad.
        out.add_row(
            parameter.name,
            f"{rms:.4f}",
            f"{largest:.4f}",
            f"mm/{'1e-3' if parameter.unit == '1' else f'm{parameter.unit}'}",
            f"{rms * UNITS['deg'].factor / MM:.3f} mm" if angle else "",
        )
    return out


def sensitivity_verdict(sensitivity: Sensitivity) -> list[RenderableType]:
    """Return how many combinations of the parameters positions at these poses tell apart, and what they cannot."""
    apart = f"{sensitivity.rank} combinations of the {len(sensitivity.parameters)} parameters"
    return [
        Text(f"Positions at these poses tell {apart} apart."),
        *null_space_lines(sensitivity.undetermined),
    ]


def group_table(study: GroupStudy) -> Table:
    """Return what becomes of the tip error when the errors of one group are scaled; in mm over the poses."""
    n, errors = len(study.errors), study.errors / MM
    caption = f"as given, the tip error is {errors.min():.3f} to {errors.max():.3f} mm, {errors.mean():.3f} on average"
    out = _table(f"Change of the tip error over {n} poses", caption)
    out.add_column("errors scaled")
    out.add_column("factor", justify="right")
    for name in ("smallest", "mean", "largest"):
        out.add_column(name, justify="right")
    out.add_column("unit")
    for group, changes in zip(study.groups, study.changes, strict=True):
        for factor, change in zip(study.factors, changes, strict=True):
            last = factor == study.factors[-1]
            shown = (f"{value / MM:+.3f}" for value in (change.min(), change.mean(), change.max()))
            out.add_row(group, f"{factor:g}", *shown, "mm", end_section=last)
    return out


def _table(title: str, caption: str | None = None) -> Table:
    return Table(title=title, caption=caption, title_justify="left", caption_justify="left", box=box.SIMPLE_HEAD)
