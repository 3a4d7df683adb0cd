"""An instrument that is a calibrated arm: its joint readings say where its tool point touched.

Positions are in the arm's base link, whatever instrument the arm itself was calibrated with.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.assessment.uncertainty import refuse_lacking
from calib.compensation.model_file import MODEL_FILE, NOMINAL_FILE, CalibratedModel, load_model, residual_file
from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.units import UNITS, Dimension, parse_quantity
from calib.identification.pivot import pivot
from calib.job.schema import InstrumentSection
from calib.measurement.checks import Finding, check
from calib.measurement.columns import stacked
from calib.measurement.conditions import conditions as conditions_of
from calib.measurement.from_table import measurements_from_table
from calib.measurement.measurements import Measurements
from calib.measurement.table import APPROACH, TORQUE, Column, read_table
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.sources import EXAMPLE, resolve

_POSITION = ("x", "y", "z")
# What makes sense of the checks for the arm's own readings; where it goes is not what is measured here.
_OF_READINGS = ("beyond-limits", "degrees-as-radians", "radians-as-degrees")
# Touches of a pivot scatter by the stated sigma; three times as much tells that something moved.
_SCATTER = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """A calibrated arm that touches. ``point`` (3,): its tool point on its tip link; ``sigma``: of a coordinate, in m.

    ``files``: what it was read from, by the name that the job gives it. ``findings``: doubts about the pivoting.
    """

    model: CalibratedModel
    point: Array
    sigma: float
    files: Mapping[str, Path]
    findings: tuple[Finding, ...]

    def points(self, readings: Array, conditions: Conditions = NO_CONDITIONS) -> Array:
        """Return the tool points (N, 3) in the base link at readings (N, nr), with what a residual model adds."""
        T = self.model.placements(readings, conditions)
        return np.asarray(T[:, :3, :3] @ self.point + T[:, :3, 3])


def read_arm(name: str, section: InstrumentSection, folder: Path) -> Arm:
    """Return the arm that an instrument of the job is.

    Raises CalibError when it cannot be read, has no such tool, or its pivoting does not show the tool point.
    """
    files: dict[str, Path] = {}
    if section.model is not None:
        model = load_model(folder / section.model)
        beside = residual_file(model.residual_model)
        parts = [MODEL_FILE, NOMINAL_FILE] + ([] if beside is None else [beside])
        files |= {f"{section.model}/{part}": folder / section.model / part for part in parts}
    else:
        assert section.urdf is not None, "the schema asks for one of both"
        urdf = resolve(section.urdf) if section.urdf.startswith(EXAMPLE) else folder / section.urdf
        robot = load_robot(urdf, section.tip)
        model = CalibratedModel(robot, robot.no_deviations(), read_only(np.eye(4)), {})
        files[section.urdf] = urdf
    sigma = parse_quantity(section.sigma, "length", "sigma")
    arm = Arm(model, read_only(np.zeros(3)), sigma, files, ())
    if section.tool is not None:
        if section.tool not in model.tools:
            known = ", ".join(map(repr, model.tools)) or "none"
            raise JobError(f"instruments.{name}.tool: {section.tool!r} is no tool of the arm; it has {known}.")
        return replace(arm, point=read_only(model.tools[section.tool][:3, 3]))
    if section.point is not None:
        return replace(arm, point=read_only([parse_quantity(text, "length", "point") for text in section.point]))
    return arm if section.pivot is None else _pivoted(arm, section.pivot, folder)


def _pivoted(arm: Arm, file: str, folder: Path) -> Arm:
    from calib.assessment.performance import read_touches  # noqa: PLC0415 - of arms that were touched alone

    touches = read_touches(folder / file, arm.model.robot)
    if touches.kind != "cone":
        raise MeasurementError(f"{touches.where}: is a {touches.kind} test; a pivot is a point touched many times.")
    refuse_lacking(arm.model.robot, touches.conditions, touches.where)
    found = pivot(arm.model.placements(touches.readings, touches.conditions), touches.words["target"])
    if found.rank < 3:
        raise MeasurementError(
            f"{touches.where}: the orientations turn about {'one axis only' if found.rank else 'no axis'}, and do not "
            "show where the tool point is along it; touch the point with the tool tilted in several ways."
        )
    findings = list(arm.findings)
    if found.noise > _SCATTER * arm.sigma > 0.0:
        findings.append(
            Finding(
                "warning",
                "pivot-scatters",
                f"{touches.where}: the touches scatter by {found.noise * 1e3:.3g} mm per coordinate, and sigma says "
                f"{arm.sigma * 1e3:.3g} mm.",
            )
        )
    return replace(arm, point=found.tool_point, files={**arm.files, file: folder / file}, findings=tuple(findings))


def touched(path: Path, arm: Arm, robot: Robot, columns: Mapping[str, str]) -> tuple[Measurements, tuple[Finding, ...]]:
    """Return what a table of touched points says of ``robot``, and what looks wrong with the arm's readings.

    The arm's columns become the position. Raises MeasurementError when a column of the arm is missing, when one is both
    the arm's and the robot's, and as :func:`calib.measurement.measurements.measurements_from_table` does.
    """
    table = read_table(path, columns)
    own: dict[str, Dimension] = {reading.name: reading.dimension for reading in arm.model.robot.readings}
    if both := [reading.name for reading in robot.readings if reading.name in own]:
        raise MeasurementError(
            f"{table.where}: {both[0]!r} is a joint of the arm that touches and of the robot; rename one in its URDF."
        )
    if missing := [name for name in own if name not in table.columns]:
        listed, there = (", ".join(map(repr, some)) for some in (missing, table.columns))
        raise MeasurementError(
            f"{table.where}: there is no column {listed} of the arm that touches; the columns are {there}."
        )
    if given := [name for name in _POSITION if name in table.columns]:
        raise MeasurementError(f"{table.where}: column {given[0]!r} is there, and the arm says it as well; keep one.")
    # What is said of all joints, such as one side of approach, is said of the robot.
    told = {f"{what}{name}" for what in (APPROACH, TORQUE) for name in own}
    arms = replace(table, columns={name: column for name, column in table.columns.items() if name != "direction"})
    conditions = conditions_of(arms, arm.model.robot.readings)
    refuse_lacking(arm.model.robot, conditions, table.where)
    points = arm.points(stacked(table, own), conditions)
    position = {name: Column(name, UNITS["m"], read_only(points[:, k])) for k, name in enumerate(_POSITION)}
    arms = replace(table, columns={name: table.columns[name] for name in own} | position)
    doubts = check(
        measurements_from_table(arms, arm.model.robot.readings, "position"),
        arm.model.robot.readings,
        arm.model.robot.reach,
    )
    rest = {name: column for name, column in table.columns.items() if name not in own and name not in told}
    return (
        measurements_from_table(replace(table, columns=rest | position), robot.readings, "position", sigma=arm.sigma),
        tuple(finding for finding in doubts if finding.code in _OF_READINGS),
    )
