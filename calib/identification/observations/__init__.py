"""Kinds of observation: one module each, with its residual and the residual's exact derivative.

Every module offers ``residual(measurements, rows, tools) -> Linearised`` for tool placements in the instrument's frame.
"""

from typing import NamedTuple

from calib.foundations.arrays import Array


class Linearised(NamedTuple):
    """Residuals (N, d), measured minus predicted, and their change (N, d, 6) with the local twist of each tool."""

    residual: Array
    twist: Array
