"""Calibrate any robot arm described by a URDF."""

__version__ = "0.1.0.dev0"
