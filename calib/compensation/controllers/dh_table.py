"""The corrected DH table, for controllers and programs that are told an arm in these numbers."""

import numpy as np

from calib.compensation.controllers.export import Export, judged_export, judged_readings, plain_tips
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array
from calib.foundations.errors import OutputError
from calib.machine.calibrated import CalibratedMachine
from calib.machine.urdf import calibrated_urdf
from calib.robot.dh.files import parse_dh, write_dh
from calib.robot.dh.frames import dh_of
from calib.robot.dh.table import DhTable
from calib.robot.dh.to_urdf import dh_to_urdf
from calib.robot.load import load_robot
from calib.robot.urdf import parse_urdf


@checked
def export_dh(model: CalibratedMachine, table: DhTable | None = None) -> Export:
    """Return a DH table (CSV) of the calibrated machine, offsets included in theta and d.

    ``table``: the corrected one where DH parameters were free; by default that of the calibrated URDF. Raises
    RobotError for an arm that has none, as joints follow others; OutputError when the table is of another machine.
    """
    robot = model.geometry.robot
    names = [reading.name for reading in robot.readings]
    if table is None:
        document = parse_urdf(calibrated_urdf(robot, model.geometry.deviations), "the calibrated URDF")
        table = dh_of(load_robot(document, robot.tip, robot.base))
    unread = [row.joint for row in table.rows if row.type != "fixed" and row.joint not in names]
    if unread:
        raise OutputError(f"joint {unread[0]!r} has no reading; a DH table has no joints that follow others.")
    text = write_dh(table)

    def read_back(readings: Array) -> Array:
        again = parse_dh(text.encode(), "the DH table")
        arm = load_robot(parse_urdf(dh_to_urdf(again), "the DH table"), "tip")
        return arm.tips(readings[:, [names.index(reading.name) for reading in arm.readings]])

    return judged_export(
        model, text, read_back, np.asarray(plain_tips(model, judged_readings(model))), frozenset({"placements"})
    )
