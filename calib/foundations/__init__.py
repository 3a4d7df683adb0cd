"""Foundations: errors, units, files, arrays and rigid motions. Imports nothing of the other rooms."""

from typing import TYPE_CHECKING

from calib.foundations.lazy import submodules_of

if not TYPE_CHECKING:  # which would take every misspelt name for a module
    __getattr__ = submodules_of(__name__)
