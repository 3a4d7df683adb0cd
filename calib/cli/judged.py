"""A calibrated machine that says how sure it is, as the commands that judge one need it."""

from pathlib import Path

from calib.foundations.errors import OutputError
from calib.machine.calibrated import CalibratedMachine
from calib.machine.model_file import load_machine


def sure_machine(folder: Path) -> CalibratedMachine:
    """Return the calibrated machine of a folder of results; OutputError where it does not state its uncertainty."""
    machine = load_machine(folder)
    if machine.uncertainty is None:
        raise OutputError(f"{folder}: holds no uncertainty.json; calibrate again with this version.")
    return machine
