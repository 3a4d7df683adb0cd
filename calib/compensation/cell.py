"""The calibrated cell: an arm and what it touched, in one URDF, at the calibrated place."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.choices import PlacedIn
from calib.foundations.errors import JobError
from calib.machine.calibrated import CalibratedMachine
from calib.machine.model_file import load_machine
from calib.machine.run import MODEL_FILE
from calib.machine.urdf import calibrated_urdf
from calib.robot.cell import Cell, compose
from calib.robot.urdf import parse_urdf, read_urdf


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedCell:
    """A cell and where things are in it, all in the arm's base link. Made by :func:`calibrated_cell`.

    ``root`` (4, 4): the document's root link. ``placement`` (4, 4): the base link of the positioner ``model``.
    """

    __repr__ = brief

    cell: Cell
    model: CalibratedMachine
    root: Array
    placement: Array

    def contents(self) -> dict[str, Any]:
        """Return what became of the names, and where the positioner stands, as plain data in m."""
        return {
            "links": dict(self.cell.links),
            "joints": dict(self.cell.joints),
            "placement": self.placement.tolist(),
        }


@checked
def calibrated_cell(
    arm: Path,
    positioner: Path,
    placed_in: PlacedIn = "arm",
    prefix: str | None = None,
    *,
    setup: str | None = None,
) -> CalibratedCell:
    """Return the URDF that carries an arm and a positioner, or another machine, where calibration found it.

    ``arm``: the folder of the arm's results, or a URDF that is calibrated already. ``positioner``: the folder of
    results. ``placed_in``: whose frame its base was found in: "arm", because the arm touched it, or "instrument", one
    that both were calibrated with. ``prefix``: as in :func:`calib.robot.cell.compose`. ``setup``: in which set-up they
    stand in the cell, where a folder has several.

    Raises JobError when a URDF is to be placed in an instrument's frame, OutputError when a folder holds no readable
    model, RobotError when a URDF cannot be used, MeasurementError for an unknown set-up, and for None where a base was
    found in several.
    """
    model = _standing(positioner, setup).geometry
    second = parse_urdf(calibrated_urdf(model.robot, model.deviations), str(positioner))
    placement, root = model.base, np.eye(4)
    if arm.suffix.lower() == ".urdf" and not os.path.lexists(arm / MODEL_FILE):
        if placed_in == "instrument":
            raise JobError(
                f"{arm}: a URDF does not say where the arm stood in the instrument's frame; give the folder "
                "of its results."
            )
        first = read_urdf(arm)
        base = first.root
    else:
        carrier = (_standing(arm, setup) if placed_in == "instrument" else load_machine(arm)).geometry
        first = parse_urdf(calibrated_urdf(carrier.robot, carrier.deviations), str(arm))
        base, root = carrier.robot.base, carrier.robot.root_in_base
        if placed_in == "instrument":
            placement = rigid.inverse(carrier.base) @ placement
    cell = compose(first, second, base, placement @ model.robot.root_in_base, prefix)
    return CalibratedCell(cell, model, read_only(root), read_only(placement))


def _standing(folder: Path, setup: str | None) -> CalibratedMachine:
    """Return the machine of a folder as it stood in a set-up; one that never stood elsewhere, whatever its name."""
    machine = load_machine(folder)
    return machine if len(machine.bases) == 1 else machine.standing(setup, str(folder))
