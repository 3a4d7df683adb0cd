"""Columns of a table by name: those that must be there, those that nobody knows, and numbers in SI units."""

from collections.abc import Collection, Iterable, Sequence
from typing import cast

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import MeasurementError
from calib.foundations.rigid import rotation_of_quaternion
from calib.foundations.units import Dimension, Unit, unit_of
from calib.measurement.orientations import ANGLES
from calib.measurement.table import APPROACH, QUATERNION_COLUMNS, TEXT_COLUMNS, TORQUE, HeaderError, Table, nearest

# Three digits after the point are enough; shifted columns, angles or half a quaternion are not.
_NORM_TOLERANCE = 1e-3
POSITION = ("x", "y", "z")
PIXELS = ("u", "v")
BOARD = ("board_x", "board_y", "board_z")
POINT = ("point_x", "point_y", "point_z")
SIGMAS: tuple[tuple[str, ...], ...] = (("sigma",), ("sigma_x", "sigma_y", "sigma_z"))
SIGMA_ANGLES: tuple[tuple[str, ...], ...] = (("sigma_angle",), ("sigma_rx", "sigma_ry", "sigma_rz"))
KNOWN = frozenset(
    (
        *POSITION,
        *QUATERNION_COLUMNS,
        *TEXT_COLUMNS,
        *(name for names in (*SIGMAS, *SIGMA_ANGLES) for name in names),
        *("time", "temperature", "sigma_tau", "length", "indicated", "diameter", "ball", *PIXELS, *BOARD, *POINT),
    )
)


def require(table: Table, names: Iterable[str], what: str) -> None:
    """Raise MeasurementError when a column is missing; ``what`` says what it would be of."""
    missing = [name for name in names if name not in table.columns]
    if missing:
        listed, there = (", ".join(map(repr, some)) for some in (missing, table.columns))
        raise HeaderError(f"{table.where}: there is no column {listed} {what}; the columns are {there}.")


def refuse_others(table: Table, known: Collection[str], what: str) -> None:
    """Raise MeasurementError for a column that is not ``known``; ``what`` it is not, for the sentence."""
    for name in table.columns:
        if name not in known:
            near = nearest(name, sorted(set(known) - table.columns.keys()))
            raise MeasurementError(f"{table.where}: column {name!r} is not one of {what}{near}.")


def refuse_unknown(
    table: Table,
    readings: Iterable[str],
    unread: Collection[str] = (),
    idle: Collection[str] = (),
    of_joints: Sequence[str] = (TORQUE, APPROACH),
) -> None:
    """Refuse a column that would be passed over in silence, and a joint with the name of another column.

    ``unread``: joints of the URDF that no column tells; ``idle``: such as may have a column that nothing needs.
    ``of_joints``: with what names of columns begin that tell something else of a joint.
    """
    refuse_joints_like_columns(readings, table.where)
    joints = frozenset(readings)
    moving = {*joints, *idle}
    known = moving | KNOWN | {f"{what}{name}" for what in of_joints for name in moving}
    for name in table.columns:
        # Euler angles are refused by what is wrong with them, where an orientation is asked for.
        if name not in known and name in unread:
            raise HeaderError(
                f"{table.where}: column {name!r} is of a joint that is not read: it is fixed or follows others; leave "
                "the column out."
            )
        if name not in known and name not in ANGLES:
            near = nearest(name, sorted(known - table.columns.keys()))
            raise HeaderError(f"{table.where}: column {name!r} is neither a joint nor a known column{near}.")


def refuse_joints_like_columns(readings: Iterable[str], where: str) -> None:
    """Raise MeasurementError for a joint with the name of another column: no reading of the header would tell them."""
    for name in sorted(KNOWN.intersection(readings)):
        raise MeasurementError(
            f"{where}: the joint {name!r} has the name of a measured column; rename the joint in the URDF."
        )


def stacked(table: Table, dimensions: dict[str, Dimension]) -> Array:
    """Return columns (N, k) in SI units. Raises MeasurementError for one that is not in a unit of its dimension."""
    found = np.zeros((len(table), len(dimensions)))
    for k, (name, dimension) in enumerate(dimensions.items()):
        found[:, k] = numbers(table, name, dimension)
    return read_only(found)


def filled(table: Table, dimensions: dict[str, Dimension]) -> Array:
    """Return columns (N, k) in SI units, zeros where there is none. Raises as :func:`stacked` does."""
    found = np.zeros((len(table), len(dimensions)))
    told: dict[str, Dimension] = {name: d for name, d in dimensions.items() if name in table.columns}
    found[:, [name in told for name in dimensions]] = stacked(table, told)
    return read_only(found)


def numbers(table: Table, name: str, dimension: Dimension) -> Array:
    """Return a column (N,) in SI units. Raises as :func:`stacked` does."""
    column = table.columns[name]
    # A column of words has a name of TEXT_COLUMNS, which no number has.
    unit = cast(Unit, column.unit)
    unit_of(unit.symbol, dimension, f"{table.where}: column {name!r}", MeasurementError)
    return cast(Array, column.values)


def words(table: Table, name: str) -> tuple[str, ...] | None:
    """Return the words of a column, None where there is none."""
    column = table.columns.get(name)
    return None if column is None else cast(tuple[str, ...], column.values)


def orientations(table: Table) -> Array:
    """Return the rotations (N, 3, 3) of the columns qw, qx, qy, qz.

    Raises MeasurementError when one is missing, or a quaternion is not of unit length.
    """
    if any(name in table.columns for name in ANGLES) and "qw" not in table.columns:
        raise HeaderError(
            f"{table.where}: rx, ry, rz do not say in which order and about which axes they turn; give orientation, "
            "or convert them to quaternions qw, qx, qy, qz."
        )
    require(table, QUATERNION_COLUMNS, "of the measured pose")
    quaternion = stacked(table, dict.fromkeys(QUATERNION_COLUMNS, "number"))
    norm = np.linalg.norm(quaternion, axis=-1)
    table.refuse(
        np.abs(norm - 1.0) > _NORM_TOLERANCE,
        lambda row: (
            f"the quaternion has the norm {norm[row]:.6g} where 1 is allowed, within {_NORM_TOLERANCE:g}; the order is "
            "qw, qx, qy, qz."
        ),
    )
    return read_only(rotation_of_quaternion(quaternion))
