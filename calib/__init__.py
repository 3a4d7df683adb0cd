"""Calibrate any robot arm described by a URDF: what deviates, how sure, and a corrected URDF.

    import calib

    robot = calib.load_robot("arm.urdf", tip="probe")
    data, held_out = calib.hold_out(calib.read_measurements("measured.csv", robot, sigma=0.02e-3))
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all"), data)
    found = calib.assess(fit, held_out)
    print(found)
    calib.save(found, "results")

SI units inside and in every argument: m, rad. More is in ``calib.commands`` (corrected targets, controllers),
``calib.planning``, ``calib.measuring`` (instruments, targets), ``calib.judging`` (models, sensitivity, acceptance),
``calib.positioner`` (external axes) and ``calib.dh``.
"""

from calib.foundations import system as _system  # noqa: F401 # isort: skip - says where this runs
from calib import commands, judging, measuring, planning
from calib.assessment.acceptance import verify
from calib.assessment.advice import advice
from calib.assessment.checking import check
from calib.assessment.drift import compare
from calib.assessment.outliers import outliers
from calib.assessment.planning import plan
from calib.assessment.validation import hold_out
from calib.foundations.errors import (
    CalibError,
    IdentificationError,
    JobError,
    MeasurementError,
    OutputError,
    RobotError,
)
from calib.foundations.version import __version__
from calib.identification import positioner
from calib.identification.error_model import ErrorModel, error_model
from calib.identification.fit import Fit
from calib.identification.identify import identify
from calib.job.calibrate import calibrate
from calib.machine.calibrated import CalibratedMachine, machine_of
from calib.machine.model_file import load_machine
from calib.machine.tool_uncertainty import outside_identified, tool_uncertainty, uncertainty_map
from calib.machine.urdf import write_urdf
from calib.measurement.arrays import poses, positions
from calib.measurement.measurements import Measurements
from calib.measurement.read import read_measurements
from calib.presentation import display as _display
from calib.presentation.fit_plots import plot
from calib.presentation.frames import data_frame
from calib.presentation.tables import table
from calib.results.calibration import Calibration, assess
from calib.results.folder import report, save, scene
from calib.robot import dh
from calib.robot.gravity import Payload
from calib.robot.load import load_robot
from calib.robot.robot import ClosedLoop, Coupling, Deviations, Robot

# How a fit shows itself is for the presentation room, which the fit's own room must not know; the front door may.
_display.attach(Fit)

# fmt: off
__all__ = [
    "CalibError", "CalibratedMachine", "Calibration", "ClosedLoop", "Coupling", "Deviations", "ErrorModel", "Fit",
    "IdentificationError", "JobError", "MeasurementError", "Measurements", "OutputError", "Payload", "Robot",
    "RobotError", "__version__", "advice", "assess", "calibrate", "check", "commands", "compare", "data_frame", "dh",
    "error_model", "hold_out", "identify", "judging", "load_machine", "load_robot", "machine_of", "measuring",
    "outliers", "outside_identified", "plan", "planning", "plot", "poses", "positioner", "positions",
    "read_measurements", "report", "save", "scene", "table", "tool_uncertainty", "uncertainty_map", "verify",
    "write_urdf",
]
# fmt: on
