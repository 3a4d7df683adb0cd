"""Commands out of a calibrated machine: corrected targets, files for controllers, a cell's URDF."""

from calib.compensation.cell import CalibratedCell, calibrated_cell
from calib.compensation.commands import for_joint_targets, for_poses
from calib.compensation.controllers import Export, export_dh, export_offsets, export_ros, export_ur, export_xacro
from calib.compensation.corrections import Corrections
from calib.compensation.targets import Targets, corrected_csv, corrections, read_targets

__all__ = [
    "CalibratedCell",
    "Corrections",
    "Export",
    "Targets",
    "calibrated_cell",
    "corrected_csv",
    "corrections",
    "export_dh",
    "export_offsets",
    "export_ros",
    "export_ur",
    "export_xacro",
    "for_joint_targets",
    "for_poses",
    "read_targets",
]
