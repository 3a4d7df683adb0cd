"""Calibrate any robot arm described by a URDF: what deviates, how sure, and a corrected URDF.

    import calib

    robot = calib.load_robot("arm.urdf", tip="probe")
    data, held_out = calib.hold_out(calib.read_measurements("measured.csv", robot, sigma=0.02e-3))
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all"), data)
    found = calib.assess(fit, held_out)
    print(found)
    calib.save(found, "results")

SI units inside and in every argument: m, rad. More is in ``calib.commands`` (corrected targets, controllers),
``calib.planning``, ``calib.measuring`` (instruments, targets), ``calib.judging`` (uncertainty, models, sensitivity),
``calib.positioner`` (external axes) and ``calib.dh``. A name is loaded, with the libraries that it needs, when first
used.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING

from calib.foundations import showing as _showing
from calib.foundations import system as _system  # noqa: F401 - says where this runs
from calib.foundations.lazy import submodules_of as _submodules_of
from calib.foundations.version import __version__ as __version__

if TYPE_CHECKING:
    from calib import commands, dh, judging, measuring, planning, positioner
    from calib.assessment.acceptance import verify
    from calib.assessment.advice import advice
    from calib.assessment.checking import check
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
    from calib.identification.error_model import ErrorModel, Known, error_model
    from calib.identification.fit import Fit
    from calib.identification.identify import identify
    from calib.identification.parameters import Priors
    from calib.job.calibrate import calibrate
    from calib.machine.calibrated import CalibratedMachine
    from calib.machine.in_urdf import write_urdf
    from calib.machine.model_file import load_machine
    from calib.machine.of_fit import machine_of
    from calib.measurement.arrays import poses, positions
    from calib.measurement.measurements import Measurements
    from calib.measurement.read import read_measurements
    from calib.presentation.fit_tables import table
    from calib.presentation.frames import data_frame
    from calib.presentation.plots import plot
    from calib.results.calibration import Calibration, assess
    from calib.results.folder import report, save, scene
    from calib.robot.load import load_robot
    from calib.robot.robot import ClosedLoop, Coupling, Deviations, Robot
    from calib.robot.terms import JointTerm

# Where each name is, for whoever runs this; the imports above say the same to whoever reads or checks it.
_HOMES = {
    "assessment.acceptance": "verify",
    "assessment.advice": "advice",
    "assessment.checking": "check",
    "assessment.planning": "plan",
    "assessment.validation": "hold_out",
    "foundations.errors": "CalibError IdentificationError JobError MeasurementError OutputError RobotError",
    "identification.error_model": "ErrorModel Known error_model",
    "identification.fit": "Fit",
    "identification.identify": "identify",
    "identification.parameters": "Priors",
    "job.calibrate": "calibrate",
    "machine.calibrated": "CalibratedMachine",
    "machine.in_urdf": "write_urdf",
    "machine.model_file": "load_machine",
    "machine.of_fit": "machine_of",
    "measurement.arrays": "poses positions",
    "measurement.measurements": "Measurements",
    "measurement.read": "read_measurements",
    "presentation.plots": "plot",
    "presentation.frames": "data_frame",
    "presentation.fit_tables": "table",
    "results.calibration": "Calibration assess",
    "results.folder": "report save scene",
    "robot.load": "load_robot",
    "robot.robot": "ClosedLoop Coupling Deviations Robot",
    "robot.terms": "JointTerm",
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
    "CalibError", "CalibratedMachine", "Calibration", "ClosedLoop", "Coupling", "Deviations", "ErrorModel", "Fit",
    "IdentificationError", "JobError", "JointTerm", "Known", "MeasurementError", "Measurements", "OutputError",
    "Priors", "Robot", "RobotError", "advice", "assess", "calibrate", "check", "commands", "data_frame", "dh",
    "error_model", "hold_out", "identify", "judging", "load_machine", "load_robot", "machine_of", "measuring", "plan",
    "planning", "plot", "poses", "positioner", "positions", "read_measurements", "report", "save", "scene", "table",
    "verify", "write_urdf",
]
# fmt: on
