"""A judged calibration, and the folder, report and scene that are made of it."""

from typing import TYPE_CHECKING

from calib.foundations.lazy import submodules_of

if not TYPE_CHECKING:  # which would take every misspelt name for a module
    __getattr__ = submodules_of(__name__)
