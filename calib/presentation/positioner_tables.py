"""The axes of a positioner as a table."""

import numpy as np
from rich import box
from rich.table import Table

from calib.foundations.units import MM
from calib.positioner.five_point import FivePoint


def axes_table(found: FivePoint) -> Table:
    """Return where both axes of a positioner are in the robot's base: a point of each, and its direction."""
    out = Table(title="Axes in the robot's base", box=box.SIMPLE_HEAD, title_justify="left")
    out.add_column("axis")
    for name in ("x", "y", "z"):
        out.add_column(f"{name}, mm", justify="right")
    for name in ("x", "y", "z"):
        out.add_column(f"direction {name}", justify="right")
    for axis, T in (("tilt", found.B_L), ("rotary", found.B_R)):
        point, direction = np.asarray(T)[:3, 3], np.asarray(T)[:3, 2]
        out.add_row(axis, *(f"{value / MM:.4f}" for value in point), *(f"{value:+.7f}" for value in direction))
    return out
