"""A calibrated machine that says how sure it is, as the commands that judge one need it."""

from pathlib import Path

from calib.assessment.uncertainty import Uncertainty
from calib.compensation.model_file import load_model
from calib.foundations.errors import OutputError


def load_uncertainty(folder: Path) -> Uncertainty:
    """Return the calibrated machine of a folder of results with its uncertainty; OutputError where it states none."""
    stated = load_model(folder).uncertainty
    if stated is None:
        raise OutputError(f"{folder}: holds no uncertainty.json; calibrate again with this version.")
    return stated
