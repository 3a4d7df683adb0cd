"""Joint zero offsets as a table, for controllers that take nothing else: ABB's calibration offsets, KUKA's mastering.

Assumed: the controller adds the offset to the reading of the joint's own encoder, seen behind the gear, in the sense of
the joint of the URDF: joint position = reading + offset. Where a controller subtracts, counts at the motor, or turns
the joint the other way round, the number needs that sign or ratio. Base and tool are those of the calibration.
"""

import csv
import io
from collections.abc import Mapping
from dataclasses import replace
from itertools import dropwhile

import numpy as np

from calib.compensation.controllers.export import Export, LeftOut, judged_export, judged_readings, rms, whole_positions
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.csv_text import csv_text
from calib.foundations.units import MM, UNITS
from calib.machine.calibrated import CalibratedMachine
from calib.robot.robot import Deviations

_HEADER = ("joint", "offset [deg]", "offset [mm]")


@checked
def export_offsets(model: CalibratedMachine) -> Export:
    """Return the table of the offsets of all joints that are read: ``joint``, ``offset [deg]`` or ``offset [mm]``.

    Comments above the header tell the sense, and how far the tip is off with no correction and with this one. Offsets
    alone are never the whole of a calibration that found placements too; they were not fitted to stand alone.
    """
    robot, d = model.robot, model.deviations
    own = dict(zip((robot.chain[i].name for i in robot.moving), map(float, d.offsets), strict=True))
    rows: list[tuple[str, ...]] = [_HEADER]
    for reading in robot.readings:
        offset, turns = own.get(reading.name, 0.0) + 0.0, reading.dimension == "angle"
        value = repr(offset / UNITS["deg" if turns else "mm"].factor)
        rows.append((reading.name, *((value, "") if turns else ("", value))))
    read = {reading.name for reading in robot.readings}
    kept = np.array([value if name in read else 0.0 for name, value in own.items()])
    readings = judged_readings(model)
    expected = robot.tips(readings, _offsets_alone(model, kept))
    before = rms(robot.tips(readings, robot.no_deviations())[:, :3, 3], whole_positions(model, readings))
    after = rms(expected[:, :3, 3], whole_positions(model, readings))
    comments = (
        "# Joint position = reading + offset, in the sense of the joint of the URDF.\n"
        f"# rms at the tip to the whole calibration: without any correction {before / MM:.4f} mm, "
        f"with these offsets alone {after / MM:.4f} mm.\n"
    )
    table = comments + csv_text(rows)

    def read_back(readings: Array) -> Array:
        offsets = read_offsets(table)
        return robot.tips(readings, _offsets_alone(model, np.array([offsets.get(name, 0.0) for name in own])))

    followers = rms(robot.tips(readings, _offsets_alone(model, d.offsets))[:, :3, 3], expected[:, :3, 3])
    more = [LeftOut("offsets of joints that follow others", followers)] if np.any(kept != d.offsets) else []
    return judged_export(model, table, read_back, expected, frozenset({"closed loops and couplings"}), more)


def read_offsets(table: str) -> Mapping[str, float]:
    """Return the offsets (rad or m) by joint of a table as :func:`export_offsets` writes it."""
    # Not by lines: a name may have characters that end one.
    rows = dropwhile(lambda row: row[0].startswith("# "), csv.reader(io.StringIO(table, newline="")))
    units = (UNITS["deg"].factor, UNITS["mm"].factor)
    return {
        name: next(float(cell) * unit for cell, unit in zip(cells, units, strict=True) if cell)
        for name, *cells in list(rows)[1:]
    }


def _offsets_alone(model: CalibratedMachine, offsets: Array) -> Deviations:
    d = model.deviations
    return replace(
        d,
        placements=np.zeros_like(d.placements),
        offsets=read_only(offsets),
        terms=np.zeros_like(d.terms),
    )
