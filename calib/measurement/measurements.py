"""What was measured of one robot: a table's columns as readings, tip positions or poses, and their noise."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray, read_only, read_only_view
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.rigid import rotation_of_quaternion
from calib.foundations.units import Dimension, Unit, unit_of
from calib.measurement.instruments import LaserTracker
from calib.measurement.table import QUATERNION_COLUMNS, TEXT_COLUMNS, Table, nearest
from calib.robot.robot import Reading

Kind = Literal["position", "pose"]

# Three digits after the point are enough; shifted columns, angles or half a quaternion are not.
_NORM_TOLERANCE = 1e-3
_POSITION = ("x", "y", "z")
_EULER = ("rx", "ry", "rz")
_SIGMAS: tuple[tuple[str, ...], ...] = (("sigma",), ("sigma_x", "sigma_y", "sigma_z"))
_SIGMA_ANGLES: tuple[tuple[str, ...], ...] = (("sigma_angle",), ("sigma_rx", "sigma_ry", "sigma_rz"))
_KNOWN = frozenset(
    (
        *_POSITION,
        *QUATERNION_COLUMNS,
        *TEXT_COLUMNS,
        *(name for names in (*_SIGMAS, *_SIGMA_ANGLES) for name in names),
        *("time", "temperature", "length", "u", "v"),
    )
)


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """N measured rows of one robot; every array is read-only and SI.

    ``readings`` (N, k): rad or m, in the order of ``reading_names``.
    ``position`` (N, 3): the measured point in m, in the instrument's frame.
    ``orientation`` (N, 3, 3): the measured rotation in the instrument's frame, None for positions.
    ``sigma`` (N, 3), for poses (N, 6): the instrument's standard deviations in m, then rad; 0 means unknown, to be
    estimated from the residuals.
    ``tool`` (N): which of ``tools``, the points on the flange that were measured, in order of appearance.
    ``group``, ``target``: N words, None where the table has no such column.
    ``lines`` (N): where a row stands in ``where``, as in :class:`calib.measurement.table.Table`.
    """

    kind: Kind
    reading_names: tuple[str, ...]
    readings: Array
    position: Array
    orientation: Array | None
    sigma: Array
    tools: tuple[str, ...]
    tool: IntArray
    group: tuple[str, ...] | None
    target: tuple[str, ...] | None
    where: str
    lines: IntArray

    def __len__(self) -> int:
        return len(self.lines)

    def subset(self, rows: IntArray | BoolArray | Sequence[int]) -> "Measurements":
        """Return the measurements of some rows, by position or by mask (N); ``tools`` stay as they are."""
        index = np.arange(len(self))[np.asarray(rows, dtype=None if len(rows) else np.intp)]
        return Measurements(
            kind=self.kind,
            reading_names=self.reading_names,
            readings=read_only_view(self.readings[index]),
            position=read_only_view(self.position[index]),
            orientation=None if self.orientation is None else read_only_view(self.orientation[index]),
            sigma=read_only_view(self.sigma[index]),
            tools=self.tools,
            tool=read_only_view(self.tool[index]),
            group=None if self.group is None else tuple(self.group[i] for i in index),
            target=None if self.target is None else tuple(self.target[i] for i in index),
            where=self.where,
            lines=read_only_view(self.lines[index]),
        )


def measurements_from_table(
    table: Table,
    readings: Sequence[Reading],
    kind: Kind,
    *,
    sigma: float | None = None,
    sigma_angle: float | None = None,
    instrument: LaserTracker | None = None,
) -> Measurements:
    """Return what a table says of a robot with these ``readings``.

    The noise comes from one place: ``sigma`` in m, ``instrument``, or the table's columns ``sigma`` or ``sigma_x,
    sigma_y, sigma_z``; that of poses likewise from ``sigma_angle`` in rad or the columns ``sigma_angle`` or
    ``sigma_rx, sigma_ry, sigma_rz``. Without any it is 0: unknown.

    Raises MeasurementError when a column is missing, not known or in a unit of another dimension, when a quaternion is
    not of unit length, and when the noise is said twice; JobError when ``sigma`` or ``sigma_angle`` cannot be used.
    """
    dimensions: dict[str, Dimension] = {reading.name: reading.dimension for reading in readings}
    _require(table, dimensions, "of a joint")
    _require(table, _POSITION, f"of the measured {kind}")
    _refuse_unknown(table, dimensions)
    position = stacked(table, dict.fromkeys(_POSITION, "length"))
    by_distance = None if instrument is None else instrument.sigma_at(position)[:, None]
    noise = [_noise(table, _SIGMAS, "length", {"sigma": sigma, "the instrument": by_distance})]
    if kind == "pose":
        noise.append(_noise(table, _SIGMA_ANGLES, "angle", {"sigma_angle": sigma_angle}))
    elif sigma_angle is not None:
        raise JobError(f"{table.where}: sigma_angle is given, and only positions are observed.")
    point = _words(table, "point")
    tools = ("tool",) if point is None else tuple(dict.fromkeys(point))
    number = {name: i for i, name in enumerate(tools)}
    tool = np.array([number[name] for name in point] if point else [0] * len(table), dtype=np.intp)
    return Measurements(
        kind=kind,
        reading_names=tuple(dimensions),
        readings=stacked(table, dimensions),
        position=position,
        orientation=orientations(table) if kind == "pose" else None,
        sigma=read_only(np.hstack(noise)),
        tools=tools,
        tool=read_only_view(tool),
        group=_words(table, "group"),
        target=_words(table, "target"),
        where=table.where,
        lines=table.lines,
    )


# ---- columns


def _require(table: Table, names: Iterable[str], what: str) -> None:
    missing = [name for name in names if name not in table.columns]
    if missing:
        listed, there = (", ".join(map(repr, some)) for some in (missing, table.columns))
        raise MeasurementError(f"{table.where}: there is no column {listed} {what}; the columns are {there}.")


def _refuse_unknown(table: Table, readings: Iterable[str]) -> None:
    """Refuse a column that would be passed over in silence, and a joint with the name of another column."""
    joints = frozenset(readings)
    for name in sorted(joints & _KNOWN):
        raise MeasurementError(
            f"{table.where}: the joint {name!r} has the name of a measured column; rename the joint in the URDF."
        )
    known = joints | _KNOWN | {f"tau_{name}" for name in joints}
    for name in table.columns:
        # Euler angles are refused by what is wrong with them, where an orientation is asked for.
        if name not in known and name not in _EULER:
            near = nearest(name, sorted(known - table.columns.keys()))
            raise MeasurementError(f"{table.where}: column {name!r} is neither a joint nor a known column{near}.")


def stacked(table: Table, dimensions: dict[str, Dimension]) -> Array:
    """Return columns (N, k) in SI units. Raises MeasurementError for one that is not in a unit of its dimension."""
    columns = [_numbers(table, name, dimension) for name, dimension in dimensions.items()]
    return read_only(np.stack(columns, axis=-1) if columns else np.zeros((len(table), 0)))


def _numbers(table: Table, name: str, dimension: Dimension) -> Array:
    column = table.columns[name]
    # A column of words has a name of TEXT_COLUMNS, which no number has.
    unit = cast(Unit, column.unit)
    unit_of(unit.symbol, dimension, f"{table.where}: column {name!r}", MeasurementError)
    return cast(Array, column.values)


def _words(table: Table, name: str) -> tuple[str, ...] | None:
    column = table.columns.get(name)
    return None if column is None else cast(tuple[str, ...], column.values)


def orientations(table: Table) -> Array:
    """Return the rotations (N, 3, 3) of the columns qw, qx, qy, qz.

    Raises MeasurementError when one is missing, or a quaternion is not of unit length.
    """
    if any(name in table.columns for name in _EULER) and "qw" not in table.columns:
        raise MeasurementError(
            f"{table.where}: rx, ry, rz do not say in which order and about which axes they turn; "
            "convert them to quaternions qw, qx, qy, qz."
        )
    _require(table, QUATERNION_COLUMNS, "of the measured pose")
    quaternion = stacked(table, dict.fromkeys(QUATERNION_COLUMNS, "number"))
    norm = np.linalg.norm(quaternion, axis=-1)
    if (off := np.abs(norm - 1.0) > _NORM_TOLERANCE).any():
        row = int(np.argmax(off))
        raise MeasurementError(
            f"{table.where}:{table.lines[row]}: the quaternion has the norm {norm[row]:.6g} where 1 is allowed, "
            f"within {_NORM_TOLERANCE:g}; the order is qw, qx, qy, qz."
        )
    return read_only(rotation_of_quaternion(quaternion))


# ---- noise


def _noise(
    table: Table, groups: Sequence[tuple[str, ...]], dimension: Dimension, options: dict[str, Array | float | None]
) -> Array:
    """Return standard deviations (N, 3) from the only one of the options and column groups that is there, or 0."""
    given = {name: value for name, value in options.items() if value is not None}
    columns = [names for names in groups if any(name in table.columns for name in names)]
    sources = [*given, *("column " + ", ".join(names) for names in columns)]
    if len(sources) > 1:
        raise MeasurementError(f"{table.where}: the noise is given twice, by {' and by '.join(sources)}; keep one.")
    for name, value in given.items():
        if not (np.isfinite(value).all() and np.min(value) >= 0.0):
            raise JobError(f"{table.where}: {name} is {value}; allowed are finite numbers from 0.")
    values: Array | float = next(iter(given.values()), 0.0)
    for names in columns:
        _require(table, names, "of the noise")
        values = stacked(table, dict.fromkeys(names, dimension))
        if (values < 0.0).any():
            row, axis = np.argwhere(values < 0.0)[0]
            raise MeasurementError(f"{table.where}:{table.lines[row]}: column {names[axis]!r} is negative.")
    return np.broadcast_to(values, (len(table), 3))
