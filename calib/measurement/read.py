"""Measurements from a file, a DataFrame or arrays, in one call."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from calib.foundations.arguments import checked
from calib.measurement.columns import refuse_joints_like_columns
from calib.measurement.from_table import Joints, Sigma, measurements_from_table
from calib.measurement.instruments import Camera, LaserTracker
from calib.measurement.kinds import Kind
from calib.measurement.measurements import Measurements
from calib.measurement.streams.join import streamed
from calib.measurement.streams.samples import joint_stream, times_of
from calib.measurement.streams.stream import Clock, ClockFreedom
from calib.measurement.table import (
    AS_WRITTEN,
    Columns,
    DataFrameLike,
    HeaderError,
    Table,
    as_columns,
    names_in,
    read_table,
    table_from_arrays,
    table_from_frame,
)
from calib.robot.robot import Robot

# A CSV file, a mapping of arrays, or a DataFrame.
Source = str | Path | Mapping[str, Any] | DataFrameLike


@checked
def read_measurements(
    source: Source,
    robot: Robot,
    observes: Kind = "position",
    *,
    sigma: Sigma = None,
    instrument: LaserTracker | Camera | None = None,
    offset: str | None = None,
    in_order: bool = False,
    columns: Mapping[str, str] | Columns | None = None,
) -> Measurements:
    """Return the measurements of ``robot`` in a CSV file, a pandas DataFrame or a mapping of arrays.

    Every dimensional column has its unit in its name: ``"joint_1 [deg]"``, ``"x [mm]"``. ``sigma`` is the
    instrument's standard deviation of each coordinate in m, of poses a pair, in m and rad, when no column and no
    ``instrument`` gives it; ``pixels`` need as ``instrument`` the camera that saw them; what is unknown of the board
    that it saw, :func:`calib.measuring.seen_by` says. ``offset`` names an unknown
    length that all lengths share. ``in_order``: the order of the rows says from which side joints were reached.
    ``columns`` maps our names to the source's, and may add a unit that it leaves out: ``{"x [mm]": "measured_x"}``; as
    :class:`calib.measuring.Columns` it also says what is ignored, and what angles mean. Of a robot with several tips,
    the rows are about the one that it looks at, ``robot.with_tip("left_hand")``, and need the joints that move it.

    Raises MeasurementError, or JobError for an option, with one sentence.
    """
    # Asked before the header is read, where the column would only appear twice.
    refuse_joints_like_columns((reading.name for reading in robot.readings), robot.urdf.where)
    return measurements_from_table(
        _table(source, AS_WRITTEN if columns is None else columns),
        robot.readings,
        observes,
        sigma=sigma,
        instrument=instrument,
        offset=offset,
        in_order=in_order,
        joints=Joints.of(robot),
    )


@checked
def read_stream(
    source: Source,
    robot: Robot,
    readings: Source,
    observes: Kind = "position",
    *,
    clock: ClockFreedom | Clock = "free",
    sigma: Sigma = None,
    instrument: LaserTracker | Camera | None = None,
    columns: Mapping[str, str] | Columns | None = None,
) -> Measurements:
    """Return what was measured of ``robot`` while it moved, and where the joints were then.

        moving = calib.measuring.read_stream("tracker.csv", robot, "joints.csv", clock="free")

    ``source`` has a column ``time`` by the instrument's clock, and no joints; ``readings`` has ``time`` by the
    controller's, and the joints. ``clock``: whether the instrument's is "free", so that offset and skew are found with
    the machine, or "given", the same as the controller's; :class:`calib.measuring.Clock` says more. All else as of
    :func:`read_measurements`; ``columns`` are those of both. Rows for which no joint is known are left out.

    Raises MeasurementError, or JobError for an option, with one sentence.
    """
    return stream_of(
        source, readings, robot, observes, sigma=sigma, instrument=instrument, columns=columns, clock=clock
    )


def stream_of(
    source: Source,
    readings: Source,
    robot: Robot,
    observes: Kind,
    *,
    clock: ClockFreedom | Clock,
    sigma: Sigma = None,
    instrument: LaserTracker | Camera | None = None,
    offset: str | None = None,
    in_order: bool = False,
    columns: Mapping[str, str] | Columns | None = None,
) -> Measurements:
    """Return what :func:`read_stream` does; ``offset`` and ``in_order`` as of :func:`read_measurements`."""
    own_columns, of_readings = _of_each(as_columns(AS_WRITTEN if columns is None else columns), source, readings)
    table, joints = _table(source, own_columns), Joints.of(robot)
    found = measurements_from_table(
        table,
        robot.readings,
        observes,
        sigma=sigma,
        instrument=instrument,
        offset=offset,
        joints=_elsewhere(table, robot, joints),
    )
    known = clock if isinstance(clock, Clock) else Clock(clock)
    times_of(table)
    own = joint_stream(_table(readings, of_readings), robot.readings, known.gap, joints)
    return streamed(found, own, known, robot, ordered=in_order)


def _of_each(columns: Columns, source: Source, readings: Source) -> tuple[Columns, Columns]:
    """Return how each table of a stream is read: titles that only the readings have are of these."""
    if not columns.names and not columns.ignore:
        return columns, AS_WRITTEN
    own, theirs = map(_names_in, (source, readings))
    moved = Columns(
        {name: title for name, title in columns.names.items() if title in theirs},
        tuple(title for title in columns.ignore if title in theirs),
    )
    return replace(
        columns,
        names={name: title for name, title in columns.names.items() if title in own or title not in theirs},
        ignore=tuple(title for title in columns.ignore if title in own or title not in theirs),
    ), moved


def _names_in(source: Source) -> frozenset[str]:
    if isinstance(source, str | Path):
        return names_in(source)
    labels: list[Any] = list(source) if isinstance(source, Mapping) else list(source.columns)
    return names_in([label for label in labels if isinstance(label, str)])


def _table(source: Source, columns: Mapping[str, str] | Columns) -> Table:
    if isinstance(source, str | Path):
        return read_table(source, columns)
    if isinstance(source, Mapping):
        return table_from_arrays(source, columns=columns)
    return table_from_frame(source, columns=columns)


def _elsewhere(table: Table, robot: Robot, joints: Joints) -> Joints:
    """Return what is asked of a stream's own table: no joints, since they are elsewhere."""
    names = tuple(reading.name for reading in robot.readings)
    if both := [name for name in (*names, *joints.idle) if name in table.columns]:
        raise HeaderError(
            f"{table.where}: column {both[0]!r} is of a joint, and another file has the readings of this stream; keep "
            "one of them."
        )
    return joints._replace(elsewhere=True)
