"""What controllers and other programs take of a calibrated machine, each reloaded and compared before it is handed out.

    model = calib.load_machine("out/")
    found = controllers.export_ur(model)        # or export_offsets, export_dh, export_ros
    found.text, found.lost, found.left_out

No such file holds all of a calibration. What one leaves out is named, with what it costs at the tip.
"""

from calib.compensation.controllers.dh_table import export_dh
from calib.compensation.controllers.export import Export, LeftOut
from calib.compensation.controllers.offsets import export_offsets
from calib.compensation.controllers.ros import export_ros
from calib.compensation.controllers.ur import export_ur

__all__ = ["Export", "LeftOut", "export_dh", "export_offsets", "export_ros", "export_ur"]
