"""How sure a machine is of its tool over the workspace, as tables."""

from collections.abc import Sequence

import numpy as np

from calib.foundations.arrays import BoolArray
from calib.foundations.csv_text import csv_text
from calib.foundations.units import DEG, DISPLAY_OF, MM
from calib.machine.uncertainty import UncertaintyMap
from calib.presentation.report.document import Sheet
from calib.presentation.sheets import figures_in
from calib.robot.robot import Reading


def map_sheet(found: UncertaintyMap, known: BoolArray) -> Sheet:
    """Return percentiles of the standard deviations over the workspace."""
    rows = []
    for k, (quantity, unit) in enumerate((("position", "m"), ("orientation", "rad"))):
        # As np.percentile, which loads NumPy's masked arrays first.
        ordered = np.sort(found.sigmas[:, k])
        places = np.array([0.05, 0.5, 0.95, 1.0]) * (len(ordered) - 1)
        values = figures_in(unit, *np.interp(places, np.arange(len(ordered)), ordered))
        rows.append((quantity, *values, f"{100 * np.mean(known[:, k]):.0f} %"))
    return Sheet.of(
        "Standard deviation of the tool, in the instrument's frame",
        ("quantity", ">5 %", ">median", ">95 %", ">max", "unit", ">known"),
        rows,
        "all coordinates together, over sampled poses",
    )


def map_csv(found: UncertaintyMap, readings: Sequence[Reading]) -> str:
    """Return every sampled pose of a map as a table: joints in degrees and mm, the rest as its columns say."""
    factors = np.array([DISPLAY_OF[reading.dimension][0] for reading in readings])
    columns = [*(f"{r.name} [{DISPLAY_OF[r.dimension][1]}]" for r in readings), "x [mm]", "y [mm]", "z [mm]"]
    header = [*columns, "sigma [mm]", "sigma_angle [deg]", "null_space [mm]", "null_space_angle [deg]"]
    both = np.array([MM, DEG])
    rows = np.hstack([found.readings * factors, found.positions / MM, found.sigmas / both, found.null_space_rms / both])
    return csv_text([header, *([f"{value:.5f}" for value in row] for row in rows)])
