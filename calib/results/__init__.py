"""A judged calibration, and the folder, report and scene that are made of it."""

from calib.foundations.lazy import modules_on_use

modules_on_use(__name__)
