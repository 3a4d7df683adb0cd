"""The axes of a positioner as a table."""

from calib.foundations.units import MM
from calib.positioner.five_point import FivePoint
from calib.presentation.report.document import Sheet


def axes_sheet(found: FivePoint) -> Sheet:
    """Return where both axes of a positioner are in the robot's base: a point of each, and its direction."""
    rows = []
    for axis, T in (("tilt", found.B_L), ("rotary", found.B_R)):
        point = (f"{value / MM:.4f}" for value in T[:3, 3])
        rows.append((axis, *point, *(f"{value:+.7f}" for value in T[:3, 2])))
    columns = ("axis", ">x, mm", ">y, mm", ">z, mm", ">direction x", ">direction y", ">direction z")
    return Sheet.of("Axes in the robot's base", columns, rows)
