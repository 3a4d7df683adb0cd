"""Measurements from a file, a DataFrame or arrays, in one call."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calib.foundations.arguments import checked
from calib.measurement.boards import Board
from calib.measurement.from_table import Joints, Sigma, measurements_from_table
from calib.measurement.instruments import Camera, LaserTracker
from calib.measurement.kinds import Kind
from calib.measurement.measurements import Measurements
from calib.measurement.table import (
    AS_WRITTEN,
    Columns,
    DataFrameLike,
    read_table,
    table_from_arrays,
    table_from_frame,
)
from calib.robot.robot import Robot


@checked
def read_measurements(
    source: str | Path | Mapping[str, Any] | DataFrameLike,
    robot: Robot,
    observes: Kind = "position",
    *,
    sigma: Sigma = None,
    instrument: LaserTracker | Camera | None = None,
    offset: str | None = None,
    in_order: bool = False,
    columns: Mapping[str, str] | Columns | None = None,
    board: Board | None = None,
) -> Measurements:
    """Return the measurements of ``robot`` in a CSV file, a pandas DataFrame or a mapping of arrays.

    Every dimensional column has its unit in its name: ``"joint_1 [deg]"``, ``"x [mm]"``. ``sigma`` is the
    instrument's standard deviation of each coordinate in m, of poses a pair, in m and rad, when no column and no
    ``instrument`` gives it; ``pixels`` need as ``instrument`` the camera that saw them, and a ``board`` where its marks
    are known better or worse than to half a percent. ``offset`` names an unknown
    length that all lengths share. ``in_order``: the order of the rows says from which side joints were reached.
    ``columns`` maps our names to the source's, and may add a unit that it leaves out: ``{"x [mm]": "measured_x"}``; as
    :class:`calib.measuring.Columns` it also says what is ignored, and what angles mean. Of a robot with several tips,
    the rows are about the one that it looks at, ``robot.with_tip("left_hand")``, and need the joints that move it.

    Raises MeasurementError, or JobError for an option, with one sentence.
    """
    renamed = AS_WRITTEN if columns is None else columns
    if isinstance(source, str | Path):
        table = read_table(source, renamed)
    elif isinstance(source, Mapping):
        table = table_from_arrays(source, columns=renamed)
    else:
        table = table_from_frame(source, columns=renamed)
    return measurements_from_table(
        table,
        robot.readings,
        observes,
        sigma=sigma,
        instrument=instrument,
        offset=offset,
        in_order=in_order,
        joints=Joints.of(robot),
        board=board,
    )
