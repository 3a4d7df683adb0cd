"""Compensation: the calibrated machine put to use."""
