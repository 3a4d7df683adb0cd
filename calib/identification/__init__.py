"""Identification: the error model, residuals and their derivatives, start values, the solver, and the fit."""

from calib.foundations.lazy import modules_on_use

modules_on_use(__name__)
