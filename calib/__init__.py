"""Calibrate any robot arm described by a URDF: what deviates, how sure, and a corrected URDF.

    import calib

    robot = calib.load_robot("arm.urdf", tip="probe")
    data = calib.read_measurements("identification.csv", robot, sigma=0.02e-3)
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all"), data)
    print(fit)
    calib.write_urdf(fit, "calibrated.urdf")

SI units inside and in every argument: m, rad. A name is loaded, with the libraries that it needs, when first used.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING

from calib.foundations import showing as _showing
from calib.foundations import system as _system  # noqa: F401 - says where this runs
from calib.foundations.lazy import submodules_of as _submodules_of

if TYPE_CHECKING:
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
    from calib.identification.error_model import ErrorModel, error_model
    from calib.identification.fit import Fit
    from calib.identification.identify import identify
    from calib.identification.total_differential import Trace, total_differential
    from calib.measurement.instruments import Camera, LaserTracker
    from calib.measurement.measurements import Measurements
    from calib.measurement.read import read_measurements
    from calib.presentation.fit_plots import plot
    from calib.presentation.frames import data_frame
    from calib.presentation.tables import table
    from calib.robot import dh
    from calib.robot.gravity import Payload
    from calib.robot.load import load_robot
    from calib.robot.robot import ClosedLoop, Coupling, Deviations, Robot

__version__ = "0.1.0.dev0"

# Where each name is, for whoever runs this; the imports above say the same to whoever reads or checks it.
_HOMES = {
    "assessment.acceptance": "verify",
    "assessment.advice": "advice",
    "assessment.bootstrap": "bootstrap",
    "assessment.choice": "choose_terms",
    "assessment.drift": "compare",
    "assessment.outliers": "Outliers outliers",
    "assessment.uncertainty": "outside_identified tool_uncertainty uncertainty_map uncertainty_of",
    "compensation": "commands",
    "compensation.model_file": "CalibratedModel load_model",
    "compensation.urdf": "write_urdf",
    "foundations.errors": "CalibError IdentificationError JobError MeasurementError OutputError RobotError",
    "identification": "positioner",
    "identification.error_model": "ErrorModel error_model",
    "identification.fit": "Fit",
    "identification.identify": "identify",
    "identification.total_differential": "Trace total_differential",
    "measurement.instruments": "Camera LaserTracker",
    "measurement.measurements": "Measurements",
    "measurement.read": "read_measurements",
    "presentation.fit_plots": "plot",
    "presentation.frames": "data_frame",
    "presentation.tables": "table",
    "robot": "dh",
    "robot.gravity": "Payload",
    "robot.load": "load_robot",
    "robot.robot": "ClosedLoop Coupling Deviations Robot",
}
_MODULES = {name: f"calib.{home}" for home, names in _HOMES.items() for name in names.split()}

# How a fit shows itself is for the presentation room, which the fit's own room must not know; the front door may.
_showing.shown_by("calib.presentation.display")


if not TYPE_CHECKING:  # which would take every misspelt name for one of these
    _submodule = _submodules_of(__name__)

    def __getattr__(name: str) -> object:
        if name not in _MODULES:
            return _submodule(name)
        home = _import_module(_MODULES[name])
        globals()[name] = getattr(home, name)
        return globals()[name]

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})


# fmt: off
__all__ = [
    "CalibError", "CalibratedModel", "Camera", "ClosedLoop", "Coupling", "Deviations", "ErrorModel", "Fit",
    "IdentificationError", "JobError", "LaserTracker", "MeasurementError", "Measurements", "Outliers", "OutputError",
    "Payload", "Robot", "RobotError", "Trace", "advice", "bootstrap", "choose_terms", "commands", "compare",
    "data_frame", "dh", "error_model", "identify", "load_model", "load_robot", "outliers", "outside_identified",
    "plot", "positioner", "read_measurements", "table", "tool_uncertainty", "total_differential", "uncertainty_map",
    "uncertainty_of", "verify", "write_urdf",
]
# fmt: on
