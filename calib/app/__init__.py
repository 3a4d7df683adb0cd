"""App: a page of this computer that goes the way of ``calib init``, ``check`` and ``calibrate`` by their functions.

page.html, app.js   what a person sees; every text of a file is put there as text
server.py           requests of the page, each behind the guards
session.py          one person's files and answers, and the one child process that works on them
folder.py           the private folder: names, sizes, and the folder as one file
child.py            a look or a calibration, by the public functions, in a process that can be cancelled
"""

from calib.foundations.lazy import modules_on_use

modules_on_use(__name__)
