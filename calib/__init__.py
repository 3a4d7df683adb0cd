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
from calib.assessment.uncertainty import outside_identified, tool_uncertainty, uncertainty_map, uncertainty_of
from calib.compensation import commands
from calib.compensation.model_file import CalibratedModel, load_model
from calib.compensation.urdf import write_urdf
from calib.foundations.errors import (
    CalibError,
    IdentificationError,
    JobError,
    MeasurementError,
    OutputError,
    RobotError,
)
from calib.identification import positioner
from calib.identification.error_model import ErrorModel, Known, error_model
from calib.identification.fit import Fit
from calib.identification.identify import identify
from calib.identification.parameters import Priors
from calib.identification.total_differential import Trace, total_differential
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
from calib.robot.terms import JointTerm

# How a fit shows itself is for the presentation room, which the fit's own room must not know; the front door may.
_display.attach(Fit)

__version__ = "0.1.0.dev0"

__all__ = [
    "CalibError",
    "CalibratedModel",
    "Camera",
    "ClosedLoop",
    "Coupling",
    "Deviations",
    "ErrorModel",
    "Fit",
    "IdentificationError",
    "JobError",
    "JointTerm",
    "Known",
    "LaserTracker",
    "MeasurementError",
    "Measurements",
    "Outliers",
    "OutputError",
    "Payload",
    "Priors",
    "Robot",
    "RobotError",
    "Trace",
    "advice",
    "bootstrap",
    "choose_terms",
    "commands",
    "compare",
    "data_frame",
    "dh",
    "error_model",
    "identify",
    "load_model",
    "load_robot",
    "outliers",
    "outside_identified",
    "plot",
    "positioner",
    "read_measurements",
    "table",
    "tool_uncertainty",
    "total_differential",
    "uncertainty_map",
    "uncertainty_of",
    "verify",
    "write_urdf",
]
