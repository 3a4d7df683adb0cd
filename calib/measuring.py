"""Instruments, targets, relations and conditions: with what is measured, and what is known of what is measured."""

from calib.identification.relations import Relation
from calib.identification.set_ups import SetUp
from calib.identification.targets import Target
from calib.job.proposal import Proposal, ProposedTable, Question
from calib.job.propose import propose
from calib.machine.touching import TouchingArm, touched
from calib.measurement.arrays import distances, poses, positions, sockets
from calib.measurement.boards import Board
from calib.measurement.checks import Finding
from calib.measurement.instruments import Camera, LaserTracker
from calib.measurement.measurements import Measurements
from calib.measurement.optics import seen_by
from calib.measurement.read import read_measurements, read_stream
from calib.measurement.streams.rest import at_rest
from calib.measurement.streams.stream import Clock
from calib.measurement.table import Columns
from calib.robot.conditions import Conditions
from calib.robot.gravity import Load, Payload

__all__ = [
    "Board",
    "Camera",
    "Clock",
    "Columns",
    "Conditions",
    "Finding",
    "LaserTracker",
    "Load",
    "Measurements",
    "Payload",
    "Proposal",
    "ProposedTable",
    "Question",
    "Relation",
    "SetUp",
    "Target",
    "TouchingArm",
    "at_rest",
    "distances",
    "poses",
    "positions",
    "propose",
    "read_measurements",
    "read_stream",
    "seen_by",
    "sockets",
    "touched",
]
