"""Denavit-Hartenberg tables of arms, read, written, and made into URDFs."""

from calib.foundations.choices import Convention
from calib.robot.dh import (
    PARALLEL,
    DhFrames,
    DhRow,
    DhTable,
    Free,
    dh_frames,
    dh_of,
    dh_to_urdf,
    parse_dh,
    read_dh,
    write_dh,
)

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
