"""Measurements from plain arrays, for those who have no table."""

from collections.abc import Sequence, Sized
from typing import Any

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array
from calib.foundations.errors import MeasurementError
from calib.foundations.words import counted
from calib.measurement.measurements import Measurements
from calib.measurement.read import read_measurements
from calib.measurement.table import QUATERNION_COLUMNS
from calib.robot.robot import Robot


@checked
def positions(
    robot: Robot,
    readings: npt.ArrayLike,
    xyz: npt.ArrayLike,
    *,
    sigma: float | None = None,
    tool: str | Sequence[str] | None = None,
) -> Measurements:
    """Return measured positions of a robot from plain arrays.

        data = calib.positions(robot, q, xyz, sigma=0.02e-3)

    ``readings`` (N, nr) in rad and m, columns in the order of ``robot.readings``; ``xyz`` (N, 3) in m, in the
    instrument's frame; ``sigma`` in m: the instrument's standard deviation of a coordinate, None where it is not known.
    ``tool``: which point was measured, one name or N. For all else a row may have, see :func:`read_measurements`, which
    takes arrays by name. Raises MeasurementError for arrays of other shapes, or values that are not finite numbers.
    """
    p = _rows(xyz, 3, "xyz")
    return read_measurements(_columns(robot, readings, tool, xyz=p) | _position(p), robot, "position", sigma=sigma)


@checked
def poses(
    robot: Robot,
    readings: npt.ArrayLike,
    placements: npt.ArrayLike,
    *,
    sigma: float | None = None,
    sigma_angle: float | None = None,
    tool: str | Sequence[str] | None = None,
) -> Measurements:
    """Return measured poses of a robot from plain arrays.

        data = calib.poses(robot, q, T, sigma=0.05e-3, sigma_angle=0.1e-3)

    ``placements`` (N, 4, 4) of the tool in the instrument's frame; ``sigma_angle`` in rad; all else as
    :func:`positions`. Raises MeasurementError for what is no placement.
    """
    T = np.asarray(placements, dtype=np.float64)
    if T.ndim != 3 or T.shape[1:] != (4, 4):
        raise MeasurementError(f"placements of shape {T.shape}: needed is (N, 4, 4).")
    bad = ~rigid.are_placements(T)
    if bad.any():
        raise MeasurementError(
            f"placements: row {int(np.argmax(bad)) + 1} is not a placement; needed are a rotation, a finite position "
            "and a last row 0 0 0 1."
        )
    columns = _columns(robot, readings, tool, placements=T) | _position(T[:, :3, 3])
    columns |= dict(zip(QUATERNION_COLUMNS, rigid.quaternion_of(T[:, :3, :3]).T, strict=True))
    return read_measurements(columns, robot, "pose", sigma=(sigma, sigma_angle))


@checked
def distances(
    robot: Robot,
    readings: npt.ArrayLike,
    lengths: npt.ArrayLike,
    *,
    anchor: str | Sequence[str] = "anchor",
    sigma: float | None = None,
    tool: str | Sequence[str] | None = None,
) -> Measurements:
    """Return measured distances (N,) in m of the tool point from an anchor, one name or N; as :func:`positions`."""
    found = np.asarray(lengths, dtype=np.float64)
    if found.ndim != 1:
        raise MeasurementError(f"lengths of shape {found.shape}: needed is (N,).")
    columns = _columns(robot, readings, tool, lengths=found) | {"length [m]": found}
    return read_measurements(columns | {"target": _names(anchor, len(found), "anchor")}, robot, "distance", sigma=sigma)


@checked
def sockets(
    robot: Robot,
    readings: npt.ArrayLike,
    names: Sequence[str],
    *,
    sigma: float | None = None,
    tool: str | Sequence[str] | None = None,
) -> Measurements:
    """Return touches of sockets: the tool point was in the socket that the N ``names`` name; as :func:`positions`."""
    columns = _columns(robot, readings, tool, names=names)
    return read_measurements(columns | {"target": list(names)}, robot, "socket", sigma=sigma)


def _columns(
    robot: Robot, readings: npt.ArrayLike, tool: str | Sequence[str] | None, **measured: Sized
) -> dict[str, Any]:
    """Return the columns of readings and tools; what was ``measured``, by name, must have as many rows."""
    q = _rows(readings, len(robot.readings), "readings")
    for what, values in measured.items():
        if len(values) != len(q):
            raise MeasurementError(f"{what}: {counted(len(values), 'row')} for {counted(len(q), 'row')} of readings.")
    unit = {"angle": "rad", "length": "m"}
    columns: dict[str, Any] = {
        f"{reading.name} [{unit[reading.dimension]}]": q[:, k] for k, reading in enumerate(robot.readings)
    }
    if tool is not None:
        columns["tool"] = _names(tool, len(q), "tool")
    return columns


def _position(p: Array) -> dict[str, Any]:
    return {f"{axis} [m]": p[:, k] for k, axis in enumerate("xyz")}


def _rows(values: npt.ArrayLike, width: int, what: str) -> npt.NDArray[np.float64]:
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as e:
        raise MeasurementError(f"{what}: are not numbers (N, {width}).") from e
    if found.ndim != 2 or found.shape[1] != width:
        raise MeasurementError(f"{what} of shape {found.shape}: needed is (N, {width}).")
    return found


def _names(names: str | Sequence[str], count: int, what: str) -> list[str]:
    found = [names] * count if isinstance(names, str) else list(names)
    if len(found) != count:
        raise MeasurementError(f"{what}: {len(found)} names are given for {count} rows.")
    return found
