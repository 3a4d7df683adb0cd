"""What is in a table of somebody else: candidates, how well the arm follows them, and what is asked."""

from calib.foundations.lazy import modules_on_use

modules_on_use(__name__)
