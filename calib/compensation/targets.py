"""Targets of a calibrated machine as tables: joint targets, poses or positions in, corrected commands out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast, get_args

import numpy as np

from calib.compensation.commands import at_tip, for_joint_targets, for_poses
from calib.compensation.corrections import Corrections
from calib.compensation.order import sided, with_sides
from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.choices import PoseFrame, What
from calib.foundations.csv_text import csv_cell, csv_text
from calib.foundations.errors import MeasurementError
from calib.foundations.sealing import sealed
from calib.foundations.units import MM, MRAD, UNITS, Dimension
from calib.foundations.words import listed, not_calibrated, refuse_other
from calib.identification.machine import POSE
from calib.machine.calibrated import CalibratedMachine
from calib.machine.identified import not_placed
from calib.measurement.columns import filled, orientations, stacked
from calib.measurement.conditions import conditions, sided_columns
from calib.measurement.measurements import ONLY_TOOL
from calib.measurement.orientations import ANGLES, MATRIX
from calib.measurement.table import (
    APPROACH,
    AS_WRITTEN,
    QUATERNION_COLUMNS,
    TEXT_COLUMNS,
    TORQUE,
    Columns,
    Table,
    nearest,
    read_table,
)
from calib.robot.conditions import Conditions
from calib.robot.transmission import lacking


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Targets:
    """N targets of a table.

    ``readings`` (N, nr) in rad and m: the targets, or where to start from, or None. ``poses`` (N, 4, 4), or positions
    (N, 3), or None for joint targets. ``tools``: N names. ``conditions``: what joint terms need to be told. ``table``:
    as it was read.
    """

    __repr__ = brief

    readings: Array | None
    poses: Array | None
    tools: tuple[str, ...]
    conditions: Conditions
    table: Table

    def __len__(self) -> int:
        return len(self.table)


@checked
def read_targets(
    path: str | Path,
    model: CalibratedMachine,
    tool: str = "tool",
    *,
    in_order: bool = False,
    columns: Mapping[str, str] | Columns | None = None,
) -> Targets:
    """Read targets of a calibrated machine from a CSV file.

    ``columns`` maps our names to those of the file; as :class:`calib.measuring.Columns` it also says what is ignored,
    and what angles mean. Raises MeasurementError as :func:`targets` does.
    """
    return targets(read_table(path, AS_WRITTEN if columns is None else columns), model, tool, in_order=in_order)


def targets(table: Table, model: CalibratedMachine, tool: str = "tool", *, in_order: bool = False) -> Targets:
    """Return the targets of a table; which kind they are, its columns say.

    With x, y, z: positions, with qw, qx, qy, qz poses; joint columns are then optional readings to start from. Without:
    joint targets. A column ``tool`` names the tool of every row, else ``tool`` is that of all. ``in_order``: they are
    visited in the order of the rows, which tells from which side joints are reached. Which set-up a column ``setup``
    names is for :func:`corrections` to look at.

    Raises MeasurementError when a column is missing, not known or in a unit of another dimension, when a quaternion is
    not of unit length, when a tool is not known or given twice, and when a joint term of the machine needs a column
    that is not there.
    """
    columns, where = table.columns, table.where
    joints: dict[str, Dimension] = {reading.name: reading.dimension for reading in model.robot.readings}
    position: dict[str, Dimension] = dict.fromkeys(("x", "y", "z"), "length")
    rotation: dict[str, Dimension] = dict.fromkeys(QUATERNION_COLUMNS, "number")
    known = {
        *joints,
        *position,
        *rotation,
        *TEXT_COLUMNS,
        "time",
        "temperature",
        "sigma_tau",
        *(f"{what}{name}" for what in (APPROACH, TORQUE) for name in joints),
    }
    for name in columns:
        if name not in known:
            raise MeasurementError(f"{where}: column {name!r} {_unknown(name, sorted(known - columns.keys()))}.")
    posed = any(name in columns for name in (*position, *rotation))
    tools = cast(tuple[str, ...], columns["tool"].values) if "tool" in columns else (tool,) * len(table)
    if tool != ONLY_TOOL and set(tools) - {tool}:
        raise MeasurementError(f"{where}: the tool is given twice, as {tool!r} and by column 'tool'; keep one.")
    # Joints of other arms need not be there, but where they weigh on joints of this one.
    needed = {*position, *rotation, *_needed(model, tools)}
    wanted = [position] if posed else [joints]
    wanted += [some for some in ([rotation, joints] if posed else []) if any(name in columns for name in some)]
    if missing := [name for some in wanted for name in some if name in needed and name not in columns]:
        names, there = (", ".join(map(repr, some)) for some in (missing, columns))
        weighs = "" if set(missing).isdisjoint(_weighing(model, tools)) else ", of what weighs on joints of this arm,"
        raise MeasurementError(f"{where}: there is no column {names}{weighs} of the targets; the columns are {there}.")
    start = filled(table, joints) if joints in wanted else None
    poses = None
    if posed:
        poses = stacked(table, position)
        if rotation in wanted:
            poses = read_only(rigid.placement(orientations(table), poses))
    for n, name in enumerate(tools):
        if name not in model.tools:
            line, say = (
                (f":{table.lines[n]}", "") if "tool" in columns else ("", "; name one, or write a column 'tool'")
            )
            raise MeasurementError(f"{where}{line}: {not_calibrated('tool', name, model.tools)}{say}.")
    # What is visited in order comes from the sides that its order tells, and rests where it does not move.
    absent = [] if in_order else [name for name in joints if name not in needed and name not in columns]
    told = replace(conditions(table, model.robot.readings, absent=absent), ordered=in_order)
    sided_columns(table, model.robot.readings, in_order=in_order)
    if unsaid := lacking(model.robot.terms, list(joints), with_sides(told, len(table), len(joints))):
        needs = f"there is no column {unsaid[1]!r}, which {unsaid[0]} of the machine needs"
        otherwise = "; targets in the order of their visits tell it, too: in_order" if APPROACH in unsaid[1] else ""
        raise MeasurementError(f"{where}: {needs}{otherwise}.")
    return Targets(start, poses, tools, told, table)


def _unknown(name: str, known: Sequence[str]) -> str:
    """Return what is to be said of a column that targets do not have; ``known``: columns that they may have."""
    if name in (*ANGLES, *MATRIX) and "qw" in known:
        kinds = "matrix" if name in MATRIX else "rotation_vector, abc, wpr, rpy, or an order like ZYX or xyz"
        return f"is of an orientation, and nothing says of which kind; orientation does ({kinds})"
    angles = ", or its three angles rx, ry, rz with orientation" if "qw" in known else ""
    near = nearest(name, known) or (
        f"; allowed are joints, or x, y, z, with qw, qx, qy, qz of a pose{angles}, and what joint terms need"
    )
    return (
        f"is not one of targets{near}; columns, or --column 'NAME={name}', reads it as the one that it is, and ignore "
        "passes it over"
    )


@checked
def corrections(
    model: CalibratedMachine,
    wanted: Targets,
    *,
    what: What = "pose",
    frame: PoseFrame = "base",
    clamp: bool = False,
) -> Corrections:
    """Return the commands for the targets of a table; ``what`` counts for joint targets, ``frame`` for poses.

    Raises MeasurementError when none of them can be reached, with the reason of the first, and where a column ``setup``
    names another set-up than that in which the machine stands, and this matters. Raises JobError for other words.
    """
    refuse_other(what, get_args(What), "what")
    refuse_other(frame, get_args(PoseFrame), "frame")
    if "setup" in wanted.table.columns and of_set_up(model, wanted, frame=frame):
        for line, name in zip(wanted.table.lines, wanted.table.columns["setup"].values, strict=True):
            if name != model.setup:
                raise MeasurementError(
                    f"{wanted.table.where}:{line}: is of the set-up {name!r}, and the commands are for "
                    f"{model.setup!r}; correct the targets of one set-up at a time."
                )
    if wanted.poses is None:
        readings = cast(Array, wanted.readings)
        found = for_joint_targets(model, readings, wanted.tools, what=what, clamp=clamp, conditions=wanted.conditions)
    else:
        poses = wanted.poses if what == "pose" or wanted.poses.ndim == 2 else wanted.poses[:, :3, 3]
        found = for_poses(
            model,
            poses,
            wanted.readings,
            wanted.tools,
            frame=frame,
            clamp=clamp,
            conditions=wanted.conditions,
        )
    if not found.reached.any():
        table, arm = wanted.table, at_tip(model, wanted.tools).robot
        joints = len(arm.driving((arm.tip,)))
        sought_poses = what == "pose" and (wanted.poses is None or wanted.poses.ndim == 3)
        hint = ""
        if sought_poses and joints < len(POSE):
            hint = (
                f" An arm of {joints} joints meets a pose of the nominal one only nearly; ask for its position alone "
                '(what = "position", --what position).'
            )
        elif wanted.poses is not None:
            other: PoseFrame = "instrument" if frame == "base" else "base"
            hint = (
                f" They are taken to be in the frame of the {frame}; if they are in that of the {other}, say so "
                f'(frame = "{other}", --frame {other}).'
            )
        hint = " ".join((hint, *in_base(model, wanted, frame=frame)))
        raise MeasurementError(
            f"{table.where}: none of the {len(found)} targets can be reached; that of line {table.lines[0]}: "
            f"{found.reasons[0]}.{hint}"
        )
    return found


def of_set_up(model: CalibratedMachine, wanted: Targets, *, frame: PoseFrame) -> bool:
    """Return whether it matters in which set-up targets are: in the instrument's frame, or where loads differ."""
    return (frame == "instrument" and wanted.poses is not None) or model.sags_by_set_up


def idle(model: CalibratedMachine, wanted: Targets, *, frame: PoseFrame, clamp: bool) -> tuple[str, ...]:
    """Return what is to be said of wishes that change nothing of these targets, and of what they do not tell."""
    said = []
    if wanted.poses is None and frame != "base":
        said.append(f"{wanted.table.where}: holds joint targets, which are in no frame: frame {frame!r} has no effect.")
    if clamp and model.residual_model is None:
        said.append("The machine has no residual model: clamp has no effect.")
    if wanted.readings is None and (others := _weighing(model, wanted.tools)):
        said.append(
            f"{wanted.table.where}: what hangs on {listed(others)} weighs on joints of this arm, and no column says "
            "where these are; the commands are for what the search puts them to. Give the joints to start from."
        )
    if wanted.conditions.ordered and not sided(model.robot):
        said.append("The machine has no joint term that asks for sides of approach: in_order has no effect.")
    return tuple(said)


def in_base(model: CalibratedMachine, wanted: Targets, *, frame: PoseFrame) -> tuple[str, ...]:
    """Return what is to be said of tools whose targets are in the base link, where the data do not place them there."""
    return not_placed(model, wanted.tools) if wanted.poses is not None and frame == "base" else ()


@checked
def corrected_csv(model: CalibratedMachine, wanted: Targets, found: Corrections) -> str:
    """Return the table with corrected joints, in the units of its header, and what is expected of every row.

    Columns have the titles, units and angles of the table. Joints that it does not have come first, in deg and mm. New
    columns: ``remaining_error [mm]``, for poses ``remaining_turn [mrad]``, ``reached`` (yes or no) and ``reason``.
    Joints of rows not reached are empty. Raises MeasurementError for corrections of other rows, or of another arm.
    """
    shape, there = (len(wanted.table), len(model.robot.readings)), found.readings.shape
    if there != shape:
        raise MeasurementError(f"the corrections are {there} readings; of {wanted.table.where} and this arm: {shape}.")
    table, joints = wanted.table, {reading.name: k for k, reading in enumerate(model.robot.readings)}
    own = {reading.name: UNITS["deg" if reading.dimension == "angle" else "mm"] for reading in model.robot.readings}
    needed = _needed(model, wanted.tools)
    own = {name: unit for name, unit in own.items() if name in needed}
    added = [name for name in own if name not in table.columns]
    turned = not np.isnan(found.orientation_error).all()
    header = [f"{name} [{own[name].symbol}]" for name in added] + [column.title for column in table.written]
    # Column by column, and numbers as they are: of a table of many rows this is most of the work.
    columns: list[Sequence[str]] = [
        _numbers(found.readings[:, joints[name]] / own[name].factor, ".12g") for name in added
    ]
    for column in table.written:
        if column.unit is None:
            columns.append([csv_cell(str(value)) for value in column.values])
        else:
            values = found.readings[:, joints[column.name]] if column.name in joints else cast(Array, column.values)
            columns.append(_numbers(values / column.unit.factor, ".12g"))
    errors = ["remaining_error [mm]"]
    columns.append(_numbers(found.position_error / MM, ".6f"))
    if turned:
        errors.append("remaining_turn [mrad]")
        columns.append(_numbers(found.orientation_error / MRAD, ".6f"))
    columns += [["yes" if there else "no" for there in found.reached.tolist()], list(map(csv_cell, found.reasons))]
    rows = "".join(",".join(cells) + "\n" for cells in zip(*columns, strict=True))
    return csv_text([[*header, *errors, "reached", "reason"]]) + rows


def _needed(model: CalibratedMachine, tools: Sequence[str]) -> tuple[str, ...]:
    """Return the joints that bear on where tools are: those of the arm, and of what weighs on joints of it."""
    robot = at_tip(model, tools).robot
    return robot.bearing_on((robot.tip,))


def _weighing(model: CalibratedMachine, tools: Sequence[str]) -> list[str]:
    """Return the joints of another arm that weighs on joints of these tools'."""
    arm = at_tip(model, tools).robot
    own = arm.driving((arm.tip,))
    return [name for name in _needed(model, tools) if name not in own]


def _numbers(values: Array, how: str) -> list[str]:
    """Return numbers (N,) as they are written; what is none is empty."""
    return ["" if text == "nan" else text for text in map(f"{{:{how}}}".format, (values + 0.0).tolist())]
