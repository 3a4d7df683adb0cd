"""A calibrated arm as an instrument: its joint readings say where its tool point touched another robot.

Positions are in the arm's base link, whatever instrument the arm itself was calibrated with.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.foundations.arguments import checked, own_fields
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.errors import MeasurementError, naming_rows
from calib.foundations.ranges import refuse_beyond, refuse_shape
from calib.foundations.sealing import sealed
from calib.foundations.units import UNITS, Dimension
from calib.machine.calibrated import CalibratedMachine
from calib.measurement.checks import Finding, table_findings
from calib.measurement.columns import POSITION, stacked
from calib.measurement.conditions import conditions as conditions_of
from calib.measurement.conditions import refuse_lacking
from calib.measurement.from_table import Joints, measurements_from_table
from calib.measurement.measurements import Measurements
from calib.measurement.table import APPROACH, AS_WRITTEN, TORQUE, Column, Columns, Table, read_table
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.robot import Robot

# What makes sense of the checks for the arm's own readings; where it goes is not what is measured here.
_OF_READINGS = ("beyond-limits", "degrees-as-radians", "radians-as-degrees")


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class TouchingArm:
    """A calibrated arm that touches. ``point`` (3,): its tool point on its tip link; ``sigma``: of a coordinate, in m.

        arm = calib.measuring.TouchingArm(calib.load_machine("arm"), point, sigma=0.03e-3)

    Raises JobError when a number is out of range.
    """

    __repr__ = brief

    machine: CalibratedMachine
    point: Array
    sigma: float

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_shape(self.point, (3,), "touching arm: point")
        refuse_beyond(self.point, "position, station, point", "touching arm: point")
        refuse_beyond(self.sigma, "instruments.sigma", "touching arm: sigma")

    @checked
    def points(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return the tool points (N, 3) in the base link at readings (N, nr), with what a residual model adds."""
        T = self.machine.tips(readings, conditions)
        return np.asarray(T[:, :3, :3] @ self.point + T[:, :3, 3])


def touches_of(path: str | Path, arm: TouchingArm, columns: Columns) -> tuple[Array, Conditions]:
    """Return the arm's own readings (N, nr), and conditions, in a table that :func:`touched` has read without error."""
    table = read_table(path, columns)
    return stacked(table, _dimensions(arm)), _conditions(table, arm)


def _dimensions(arm: TouchingArm) -> dict[str, Dimension]:
    return {reading.name: reading.dimension for reading in arm.machine.robot.readings}


def _conditions(table: Table, arm: TouchingArm) -> Conditions:
    # What is said of all joints, such as one side of approach, is said of the robot.
    own = replace(table, columns={name: column for name, column in table.columns.items() if name != "direction"})
    return conditions_of(own, arm.machine.robot.readings)


@checked
def touched(
    path: str | Path,
    arm: TouchingArm,
    robot: Robot,
    columns: Mapping[str, str] | Columns = AS_WRITTEN,
    *,
    in_order: bool = False,
) -> tuple[Measurements, tuple[Finding, ...]]:
    """Return what a table of touched points says of ``robot``, and what looks wrong with the arm's readings.

        data, findings = calib.measuring.touched("touches.csv", arm, robot)

    The arm's columns become the position. ``in_order``: whether the order of the rows says from which side the robot's
    joints were reached. Raises MeasurementError when a column of the arm is missing, when one is both the arm's and the
    robot's, and as :func:`calib.read_measurements` does.
    """
    table = read_table(path, columns)
    own = _dimensions(arm)
    if both := [reading.name for reading in robot.readings if reading.name in own]:
        raise MeasurementError(
            f"{table.where}: {both[0]!r} is a joint of the arm that touches and of the robot; rename one in its URDF."
        )
    if missing := [name for name in own if name not in table.columns]:
        listed, there = (", ".join(map(repr, some)) for some in (missing, table.columns))
        raise MeasurementError(
            f"{table.where}: there is no column {listed} of the arm that touches; the columns are {there}."
        )
    if given := [name for name in POSITION if name in table.columns]:
        raise MeasurementError(
            f"{table.where}: column {given[0]!r} is there, and the instrument, an arm, gives it as well; keep one "
            "of them."
        )
    told = {f"{what}{name}" for what in (APPROACH, TORQUE) for name in own}
    conditions = _conditions(table, arm)
    refuse_lacking(arm.machine.robot, conditions, table.where)
    with naming_rows(table.where, table.lines):
        points = arm.points(stacked(table, own), conditions)
    position = {name: Column(name, UNITS["m"], read_only(points[:, k])) for k, name in enumerate(POSITION)}
    arms = replace(table, columns={name: table.columns[name] for name in own} | position)
    by_arm = measurements_from_table(arms, arm.machine.robot.readings, "position")
    doubts = table_findings(by_arm, arm.machine.robot.readings, by_arm.reach(arm.machine.robot))
    rest = {name: column for name, column in table.columns.items() if name not in own and name not in told}
    return (
        measurements_from_table(
            replace(table, columns=rest | position),
            robot.readings,
            "position",
            sigma=arm.sigma,
            in_order=in_order,
            joints=Joints.of(robot),
        ),
        tuple(finding for finding in doubts if finding.code in _OF_READINGS),
    )
