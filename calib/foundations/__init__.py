"""Foundations: errors, units, files, arrays and rigid motions. Imports nothing of the other rooms."""

from calib.foundations.lazy import modules_on_use

modules_on_use(__name__)
