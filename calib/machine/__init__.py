"""The calibrated machine: its prediction, its uncertainty, its files. What judges or uses it takes it whole."""

from calib.foundations.lazy import modules_on_use

modules_on_use(__name__)
