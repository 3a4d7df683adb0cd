"""External axes: positioners, turntables, tracks, from touched points.

A positioner is a machine like any other: a URDF, its base and its marks (tool points on the table) unknown. What
positions of marks determine are the lines of its axes and the marks themselves, no more: for two revolute axes 4 + 4 +
3 = 11 numbers. :func:`five_point` finds them from five points in closed form, as its inventors do; :func:`axes_robot`
makes a URDF machine of any axes, and :func:`axes_model` frees in it what :func:`calib.identify` then fits to any number
of points.

Source of the closed form: a patent of the South China University of Technology on two-axis positioners and five points.
"""

from calib.positioner.axes import (
    Axis,
    PrismaticAxis,
    RevoluteAxis,
    circle_axis,
    circle_point_analysis,
    expected_circle_error,
    expected_line_error,
    line_axis,
)
from calib.positioner.five_point import FivePoint, five_point, five_point_of
from calib.positioner.machine import TableError, axes_model, axes_robot, table_error, table_points
from calib.positioner.pivot import Pivot, pivot
from calib.positioner.relative import RelativeBase, relative_base

__all__ = [
    "Axis",
    "FivePoint",
    "Pivot",
    "PrismaticAxis",
    "RelativeBase",
    "RevoluteAxis",
    "TableError",
    "axes_model",
    "axes_robot",
    "circle_axis",
    "circle_point_analysis",
    "expected_circle_error",
    "expected_line_error",
    "five_point",
    "five_point_of",
    "line_axis",
    "pivot",
    "relative_base",
    "table_error",
    "table_points",
]
