"""Job: a job file in, a folder of results out; no mathematics."""

from calib.foundations.lazy import modules_on_use

modules_on_use(__name__)
