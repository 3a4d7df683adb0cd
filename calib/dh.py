"""Denavit-Hartenberg tables: another way to write the arm that a URDF describes, never a second kinematics.

    table = dh.read_dh("table.csv")
    urdf = dh.dh_to_urdf(table, "arm")            # the bytes of a URDF
    table = dh.dh_of(calib.load_robot("arm.urdf"))
    text = dh.write_dh(table)                     # the CSV again

J. Denavit, R. S. Hartenberg, *A kinematic notation for lower-pair mechanisms based on matrices*, J. Appl. Mech. 22,
1955 ("standard"); J. J. Craig, *Introduction to Robotics*, 1986 ("modified"); S. A. Hayati, *Robot arm geometric link
parameter estimation*, CDC 1983 (the turn beta where neighbouring axes are parallel).
"""

from calib.foundations.choices import Convention
from calib.robot.dh.files import parse_dh, read_dh, write_dh
from calib.robot.dh.frames import PARALLEL, DhFrames, dh_frames, dh_of
from calib.robot.dh.free import Free
from calib.robot.dh.table import DhRow, DhTable
from calib.robot.dh.to_urdf import dh_to_urdf

__all__ = [
    "PARALLEL",
    "Convention",
    "DhFrames",
    "DhRow",
    "DhTable",
    "Free",
    "dh_frames",
    "dh_of",
    "dh_to_urdf",
    "parse_dh",
    "read_dh",
    "write_dh",
]
