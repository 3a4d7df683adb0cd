"""Files of others that are no plain tables, as titles and cells of text; what these mean, ``calib init`` finds."""

from typing import TYPE_CHECKING

from calib.foundations.lazy import submodules_of

if not TYPE_CHECKING:  # which would take every misspelt name for a module
    __getattr__ = submodules_of(__name__)
