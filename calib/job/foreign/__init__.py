"""What is in a table of somebody else: candidates, how well the arm follows them, and what is asked."""

from typing import TYPE_CHECKING

from calib.foundations.lazy import submodules_of

if not TYPE_CHECKING:  # which would take every misspelt name for a module
    __getattr__ = submodules_of(__name__)
