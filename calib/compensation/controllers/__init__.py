"""What controllers and other programs take of a calibrated machine, each reloaded and compared before it is handed out.

    model = calib.load_machine("out/")
    found = controllers.export_ur(model)        # or export_offsets, export_dh, export_ros, export_xacro
    found.text, found.lost, found.left_out

No such file holds all of a calibration. What one leaves out is named, with what it costs at the tip.
"""

from collections.abc import Callable, Mapping

from calib.compensation.controllers.dh_table import export_dh
from calib.compensation.controllers.export import Export, LeftOut
from calib.compensation.controllers.offsets import export_offsets
from calib.compensation.controllers.ros import export_ros
from calib.compensation.controllers.ur import export_ur
from calib.compensation.controllers.xacro import export_xacro
from calib.foundations.choices import Target
from calib.machine.calibrated import CalibratedMachine
from calib.robot.dh.table import DhTable

_EXPORTS: Mapping[Target, Callable[[CalibratedMachine], Export]] = {
    "ur": export_ur,
    "offsets": export_offsets,
    "dh": export_dh,
    "ros": export_ros,
    "xacro": export_xacro,
}


def exported(model: CalibratedMachine, to: Target, table: DhTable | None = None) -> Export:
    """Return a calibrated machine as a controller takes it; ``table``: the corrected DH table, where there is one."""
    return export_dh(model, table) if to == "dh" else _EXPORTS[to](model)


__all__ = ["Export", "LeftOut", "export_dh", "export_offsets", "export_ros", "export_ur", "export_xacro", "exported"]
