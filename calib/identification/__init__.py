"""Identification."""

from calib.foundations.lazy import modules_on_use

modules_on_use(__name__)
