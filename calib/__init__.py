"""Calibrate any robot arm described by a URDF: what deviates, how sure, and a corrected URDF.

    import calib

    robot = calib.load_robot("arm.urdf", tip="probe")
    data = calib.read_measurements("identification.csv", robot, sigma=0.02e-3)
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all"), data)
    print(fit)
    calib.write_urdf(fit, "calibrated.urdf")

SI units inside and in every argument: m, rad.
"""

from calib.foundations import system as _system  # noqa: F401 # isort: skip - says where this runs
from calib.assessment.acceptance import verify
from calib.assessment.advice import advice
from calib.assessment.bootstrap import bootstrap
from calib.assessment.choice import choose_terms
from calib.assessment.drift import compare
from calib.assessment.outliers import Outliers, outliers
from calib.compensation import commands
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
from calib.identification.total_differential import Trace, total_differential
from calib.machine.calibrated import CalibratedMachine, machine_of
from calib.machine.model_file import load_machine
from calib.machine.tool_uncertainty import outside_identified, tool_uncertainty, uncertainty_map
from calib.machine.urdf import write_urdf
from calib.measurement.instruments import Camera, LaserTracker
from calib.measurement.measurements import Measurements
from calib.measurement.read import read_measurements
from calib.presentation import display as _display
from calib.presentation.fit_plots import plot
from calib.presentation.frames import data_frame
from calib.presentation.tables import table
from calib.robot import dh
from calib.robot.gravity import Payload
from calib.robot.load import load_robot
from calib.robot.robot import ClosedLoop, Coupling, Deviations, Robot

# How a fit shows itself is for the presentation room, which the fit's own room must not know; the front door may.
_display.attach(Fit)

__all__ = [
    "CalibError",
    "CalibratedMachine",
    "Camera",
    "ClosedLoop",
    "Coupling",
    "Deviations",
    "ErrorModel",
    "Fit",
    "IdentificationError",
    "JobError",
    "LaserTracker",
    "MeasurementError",
    "Measurements",
    "Outliers",
    "OutputError",
    "Payload",
    "Robot",
    "RobotError",
    "Trace",
    "__version__",
    "advice",
    "bootstrap",
    "choose_terms",
    "commands",
    "compare",
    "data_frame",
    "dh",
    "error_model",
    "identify",
    "load_machine",
    "load_robot",
    "machine_of",
    "outliers",
    "outside_identified",
    "plot",
    "positioner",
    "read_measurements",
    "table",
    "tool_uncertainty",
    "total_differential",
    "uncertainty_map",
    "verify",
    "write_urdf",
]
