"""App: a page of this computer that goes the way of ``calib init``, ``check`` and ``calibrate`` by their functions.

page.html, app.js   what a person sees; every text of a file is put there as text
server.py           requests of the page, each behind the guards
session.py          one person's files and answers, and the one child process that works on them
folder.py           the private folder: names, sizes, and the folder as one file
child.py            a look or a calibration, by the public functions, in a process that can be cancelled
"""

from typing import TYPE_CHECKING

from calib.foundations.lazy import submodules_of

if not TYPE_CHECKING:  # which would take every misspelt name for a module
    __getattr__ = submodules_of(__name__)
