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
from calib.foundations.sealing import sealed
from calib.machine.calibrated import CalibratedMachine
from calib.machine.model_file import load_machine
from calib.machine.place import Place
from calib.machine.run import MODEL_FILE
from calib.machine.standing import place_of
from calib.machine.urdf import calibrated_urdf
from calib.robot.cell import Cell, compose
from calib.robot.urdf import parse_urdf, read_urdf


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class CalibratedCell:
    """A cell and where things are in it, all in the arm's base link. Made by :func:`calibrated_cell`.

    ``root`` (4, 4): the document's root link. ``placement`` (4, 4): the base link of the positioner ``model``, which
    was found in the frame of ``placed_in``. ``place``: how sure the placement is, of twists at that base link's origin
    in the axes of the arm's; None where it is not known. ``remarks``: why it is not, or what it does not count.
    """

    __repr__ = brief

    cell: Cell
    model: CalibratedMachine
    root: Array
    placement: Array
    placed_in: PlacedIn
    place: Place | None
    remarks: tuple[str, ...]

    def contents(self) -> dict[str, Any]:
        """Return what became of the names, where the positioner stands and how sure that is, as plain data in m."""
        return {
            "links": dict(self.cell.links),
            "joints": dict(self.cell.joints),
            "placement": self.placement.tolist(),
            "placed_in": self.placed_in,
            "uncertainty": None if self.place is None else self.place.contents(),
            "remarks": list(self.remarks),
        }


@checked
def calibrated_cell(
    arm: Path,
    positioner: Path,
    placed_in: PlacedIn | None = None,
    prefix: str | None = None,
    *,
    setup: str | None = None,
) -> CalibratedCell:
    """Return the URDF that carries an arm and a positioner, or another machine, where calibration found it.

    ``arm``: the folder of the arm's results, or a URDF that is calibrated already. ``positioner``: the folder of
    results. ``placed_in``: whose frame its base was found in: "arm", because the arm touched it, or "instrument", one
    that both were calibrated with; when None as the folder says, and the arm's where it does not. ``prefix``: as in
    ``calib.robot.cell.compose``. ``setup``: in which set-up they stand in the cell, where a folder has several.

    Raises JobError when a URDF is to be placed in an instrument's frame, and for a ``placed_in`` that is not as a
    folder says, OutputError when a folder holds no readable
    model, RobotError when a URDF cannot be used, MeasurementError for an unknown set-up, and for None where a base was
    found in several.
    """
    whole = _standing(positioner, setup)
    within, remarks = _within(whole, str(positioner), placed_in)
    model = whole.geometry
    second = parse_urdf(calibrated_urdf(model.robot, model.deviations), str(positioner))
    placement, root = model.base, np.eye(4)
    if arm.suffix.lower() == ".urdf" and not os.path.lexists(arm / MODEL_FILE):
        first, carrier = read_urdf(arm), None
        if within == "instrument":
            raise JobError(
                f"{arm}: a URDF does not say where the arm stood in the instrument's frame; give the folder "
                "of its results."
            )
        base = first.root
    else:
        carrier = _standing(arm, setup) if within == "instrument" else load_machine(arm)
        geometry = carrier.geometry
        first = parse_urdf(calibrated_urdf(geometry.robot, geometry.deviations), str(arm))
        base, root = geometry.robot.base, geometry.robot.root_in_base
        if within == "instrument":
            if placed_in is None and carrier.placed is not None and carrier.placed.within == "arm":
                raise JobError(
                    f"{arm}: its base was found in the base of an arm that touched it, and that of {positioner} in an "
                    "instrument's frame; the arm is named first, what it touched second."
                )
            _within(carrier, str(arm), within)
            placement = rigid.inverse(geometry.base) @ placement
    if setup is not None and setup not in {*whole.bases, *(() if carrier is None else carrier.bases)}:
        whole.at(setup)  # says which there are
    cell = compose(first, second, base, placement @ model.robot.root_in_base, prefix)
    if within == "arm":
        place, unknown = _touched(whole, str(positioner))
    else:
        assert carrier is not None, "a URDF has been refused"
        place, unknown = _seen_by_one(carrier, whole, (str(arm), str(positioner)))
    return CalibratedCell(cell, model, read_only(root), read_only(placement), within, place, (*remarks, *unknown))


def _within(machine: CalibratedMachine, where: str, placed_in: PlacedIn | None) -> tuple[PlacedIn, tuple[str, ...]]:
    """Return in whose frame a machine's base was found, and what is to be said of it.

    Raises JobError where another one is asked for.
    """
    if machine.placed is None:
        if placed_in is not None:
            return placed_in, ()
        return "arm", (
            f"{where}: does not say in whose frame its base was found; it is taken as found in the arm's base. Say by "
            "placed_in which it is: 'arm', or 'instrument' where one instrument measured both.",
        )
    found = machine.placed.within
    if placed_in not in (None, found):
        how = {
            "arm": "in the base of an arm that touched it, and not in an instrument's frame",
            "instrument": "in an instrument's frame, and not in the base of an arm that touched it",
        }[found]
        raise JobError(f"{where}: its base was found {how}: placed_in {placed_in!r} is wrong here.")
    return found, ()


def _touched(machine: CalibratedMachine, where: str) -> tuple[Place | None, tuple[str, ...]]:
    """Return how sure the place is of a machine in the base of the arm that touched it, and what is not counted."""
    own, unknown = _own(machine, where)
    by_arm = None if machine.placed is None else machine.placed.by_arm
    if own is None:
        return None, unknown
    if by_arm is None:
        return own, (*unknown, f"{where}: does not hold the errors of the arm that touched; they are not counted.")
    return own.beside(by_arm.at(machine.base[:3, 3])), unknown


def _seen_by_one(
    arm: CalibratedMachine, machine: CalibratedMachine, where: tuple[str, str]
) -> tuple[Place | None, tuple[str, ...]]:
    """Return how sure the place is of a machine in the base of an arm, both in one instrument's frame."""
    found = [_own(one, folder) for one, folder in zip((arm, machine), where, strict=True)]
    unknown = tuple(dict.fromkeys(said for _, some in found for said in some))
    (first, _), (second, _) = found
    if first is None or second is None:
        return None, unknown
    between = first.at(machine.base[:3, 3] - arm.base[:3, 3])
    return second.beside(between).turned(arm.base[:3, :3].T), unknown


def _own(machine: CalibratedMachine, where: str) -> tuple[Place | None, tuple[str, ...]]:
    """Return how sure a machine's place is in the frame of its base, and what is to be said of it."""
    if machine.uncertainty is None:
        return None, (f"{where}: its uncertainty is not known; calibrate it again.",)
    known, bases = machine.uncertainty, slice(machine.layout.base, machine.layout.base + 6)
    if known.factor[bases].any() or known.null_basis[bases].any():
        return place_of(machine), ()
    return place_of(machine), (f"{where}: its base was given, and counts as exact.",)


def _standing(folder: Path, setup: str | None) -> CalibratedMachine:
    """Return the machine of a folder as it stood in a set-up; one that never stood elsewhere, whatever its name."""
    machine = load_machine(folder)
    return machine if len(machine.bases) == 1 else machine.standing(setup, str(folder))
