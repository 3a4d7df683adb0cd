"""What was measured of one robot: a table's columns as readings, what was seen of the tool there, and its noise."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from calib.foundations.arrays import Array, BoolArray, IntArray, read_only, read_only_view
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.rigid import rotation_of_quaternion
from calib.foundations.units import Dimension, Unit, unit_of
from calib.measurement.instruments import LaserTracker
from calib.measurement.kinds import WITH_TARGET, Kind, size
from calib.measurement.table import APPROACH, QUATERNION_COLUMNS, TEXT_COLUMNS, TORQUE, Table, nearest
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.conditions import in_order as sides_in_order
from calib.robot.robot import Reading

# Three digits after the point are enough; shifted columns, angles or half a quaternion are not.
_NORM_TOLERANCE = 1e-3
_POSITION = ("x", "y", "z")
_EULER = ("rx", "ry", "rz")
_SIGMAS: tuple[tuple[str, ...], ...] = (("sigma",), ("sigma_x", "sigma_y", "sigma_z"))
_SIGMA_ANGLES: tuple[tuple[str, ...], ...] = (("sigma_angle",), ("sigma_rx", "sigma_ry", "sigma_rz"))
_SIDES = {"+": 1.0, "-": -1.0, "0": 0.0, "1": 1.0, "-1": -1.0}
_KNOWN = frozenset(
    (
        *_POSITION,
        *QUATERNION_COLUMNS,
        *TEXT_COLUMNS,
        *(name for names in (*_SIGMAS, *_SIGMA_ANGLES) for name in names),
        *("time", "temperature", "length", "indicated", "diameter", "ball", "u", "v"),
    )
)


@dataclass(frozen=True, slots=True, eq=False)
class OtherEnd:
    """The other end of every row that has two: ``readings`` (N, k), ``tool`` (N) and ``conditions`` there."""

    readings: Array
    tool: IntArray
    conditions: Conditions = NO_CONDITIONS


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """N measured rows of one robot; every array is read-only and SI.

    ``readings`` (N, k): rad or m, in the order of ``reading_names``.
    ``position`` (N, 3): the measured point in m, in the instrument's frame; None where none is.
    ``orientation`` (N, 3, 3): the measured rotation in the instrument's frame, of poses only.
    ``value`` (N, v): what other kinds measure, in m: the length of a ``distance`` or ``pair_distance``, the radius at
    which a ``sphere`` is touched, the height above a ``plane``, what an ``indicator`` shows. A ``socket`` has none.
    ``sigma`` (N, d), with d numbers in a row's residual: the instrument's standard deviations, 0 where unknown, to be
    estimated from the residuals.
    ``tool`` (N): which of ``tools``, the points on the flange that were measured, in order of appearance. ``target``
    (N): which of ``targets``, the sockets, anchors, planes or balls; -1 in kinds that have none.
    ``other``: the second end of a ``pair_distance``. ``offset``: which of ``offsets``, unknown lengths, all
    values share; -1 for none.
    ``group``: N words, None where the table has no such column.
    ``conditions``: what else the rows carry.
    ``lines`` (N): where a row stands in ``where``, as in :class:`calib.measurement.table.Table`.
    """

    kind: Kind
    reading_names: tuple[str, ...]
    readings: Array
    position: Array | None
    orientation: Array | None
    value: Array
    sigma: Array
    tools: tuple[str, ...]
    tool: IntArray
    targets: tuple[str, ...]
    target: IntArray
    other: OtherEnd | None
    offsets: tuple[str, ...]
    offset: int
    group: tuple[str, ...] | None
    where: str
    lines: IntArray
    conditions: Conditions = NO_CONDITIONS

    def __len__(self) -> int:
        return len(self.lines)

    def subset(self, rows: IntArray | BoolArray | Sequence[int]) -> "Measurements":
        """Return the measurements of some rows, by position or by mask (N); ``tools`` and ``targets`` stay."""
        index = np.arange(len(self))[np.asarray(rows, dtype=None if len(rows) else np.intp)]
        other = self.other
        return replace(
            self,
            readings=read_only_view(self.readings[index]),
            position=None if self.position is None else read_only_view(self.position[index]),
            orientation=None if self.orientation is None else read_only_view(self.orientation[index]),
            value=read_only_view(self.value[index]),
            sigma=read_only_view(self.sigma[index]),
            tool=read_only_view(self.tool[index]),
            target=read_only_view(self.target[index]),
            other=None
            if other is None
            else OtherEnd(
                read_only_view(other.readings[index]), read_only_view(other.tool[index]), other.conditions.subset(index)
            ),
            group=None if self.group is None else tuple(self.group[i] for i in index),
            lines=read_only_view(self.lines[index]),
            conditions=self.conditions.subset(index),
        )


def unmeasured(
    reading_names: Sequence[str],
    readings: Array,
    position: Array,
    orientation: Array | None = None,
    *,
    tools: Sequence[str] = ("tool",),
    tool: int = 0,
    conditions: Conditions = NO_CONDITIONS,
    where: str,
) -> Measurements:
    """Return positions (N, 3) or, with orientations (N, 3, 3), poses that nobody measured, such as predicted ones.

    Their sigmas are 1 m and 1 rad.
    """
    n = len(readings)
    kind: Kind = "position" if orientation is None else "pose"
    return Measurements(
        kind=kind,
        reading_names=tuple(reading_names),
        readings=read_only(readings),
        position=read_only(position),
        orientation=None if orientation is None else read_only(orientation),
        value=read_only(np.zeros((n, 0))),
        sigma=read_only(np.ones((n, size(kind)))),
        tools=tuple(tools),
        tool=np.full(n, tool, dtype=np.intp),
        targets=(),
        target=np.full(n, -1, dtype=np.intp),
        other=None,
        offsets=(),
        offset=-1,
        group=None,
        where=where,
        lines=np.arange(n, dtype=np.intp),
        conditions=conditions,
    )


def measurements_from_table(
    table: Table,
    readings: Sequence[Reading],
    kind: Kind,
    *,
    sigma: float | None = None,
    sigma_angle: float | None = None,
    instrument: LaserTracker | None = None,
    offset: str | None = None,
    in_order: bool = False,
) -> Measurements:
    """Return what a table says of a robot with these ``readings``.

    The noise comes from one place: ``sigma`` in m, ``instrument``, or the table's columns ``sigma`` or ``sigma_x,
    sigma_y, sigma_z``; that of poses likewise from ``sigma_angle`` in rad or the columns ``sigma_angle`` or
    ``sigma_rx, sigma_ry, sigma_rz``. Without any it is 0: unknown. ``offset`` names an unknown length by which every
    length of a ``distance`` or ``pair_distance`` is too long, or the unknown radius of a ``sphere``. ``in_order``:
    poses were taken one after the other, and the order of the rows says from which side joints were reached.

    Raises MeasurementError when a column is missing, not known or in a unit of another dimension, when a quaternion is
    not of unit length, when a pair has not two rows, and when the noise is said twice; JobError when ``sigma``,
    ``sigma_angle``, ``instrument`` or ``offset`` cannot be used.
    """
    dimensions: dict[str, Dimension] = {reading.name: reading.dimension for reading in readings}
    _require(table, dimensions, "of a joint")
    _refuse_unknown(table, dimensions)
    _refuse_useless(table, kind, sigma_angle=sigma_angle, instrument=instrument, offset=offset)
    seen = "position" if kind in ("position", "pose") else None
    position = None
    if seen:
        _require(table, _POSITION, f"of the measured {kind}")
        position = stacked(table, dict.fromkeys(_POSITION, "length"))
    by_distance = None if instrument is None or position is None else instrument.sigma_at(position)[:, None]
    width = min(size(kind), 3)
    ways = _SIGMAS if width == 3 else _SIGMAS[:1]
    noise = _noise(table, ways, "length", {"sigma": sigma, "the instrument": by_distance}, width)
    if kind == "pose":
        noise = np.hstack([noise, _noise(table, _SIGMA_ANGLES, "angle", {"sigma_angle": sigma_angle}, 3)])
    tools, tool = _numbered(_words(table, "point"), "tool", len(table))
    targets, target = _numbered(_words(table, "target"), "target", len(table))
    if kind not in WITH_TARGET:
        targets, target = (), np.full(len(table), -1, dtype=np.intp)
    found = Measurements(
        kind=kind,
        reading_names=tuple(dimensions),
        readings=stacked(table, dimensions),
        position=position,
        orientation=orientations(table) if kind == "pose" else None,
        value=_value(table, kind, radius_is_known=offset is None),
        sigma=read_only(noise),
        tools=tools,
        tool=read_only_view(tool),
        targets=targets,
        target=read_only_view(target),
        other=None,
        offsets=() if offset is None else (offset,),
        offset=-1 if offset is None else 0,
        group=_words(table, "group"),
        where=table.where,
        lines=table.lines,
        conditions=conditions(table, readings, in_order=in_order),
    )
    return _paired(found, _words(table, "pair")) if kind == "pair_distance" else found


def _refuse_useless(
    table: Table, kind: Kind, *, sigma_angle: float | None, instrument: LaserTracker | None, offset: str | None
) -> None:
    """Refuse an option that would be passed over in silence."""
    if sigma_angle is not None and kind != "pose":
        raise JobError(f"{table.where}: sigma_angle is given, and only poses have angles.")
    if instrument is not None and kind not in ("position", "pose"):
        raise JobError(f"{table.where}: a laser tracker is given, and it measures no {kind}; give sigma.")
    if offset is not None and kind not in ("distance", "pair_distance", "sphere"):
        raise JobError(f"{table.where}: an unknown offset is given, and a {kind} has no length.")


def _numbered(words: tuple[str, ...] | None, only: str, n: int) -> tuple[tuple[str, ...], IntArray]:
    """Return the names in order of appearance and the number of each of n rows; ``only`` where none are given."""
    names = (only,) if words is None else tuple(dict.fromkeys(words))
    number = {name: i for i, name in enumerate(names)}
    return names, np.array([number[word] for word in words] if words else [0] * n, dtype=np.intp)


def _value(table: Table, kind: Kind, *, radius_is_known: bool) -> Array:
    """Return what a kind measures beside positions (N, v): lengths in m."""

    def lengths(name: str) -> Array:
        _require(table, (name,), f"of the measured {kind}")
        return stacked(table, {name: "length"})

    # A ball that touches has its centre off the surface by its radius.
    ball = 0.5 * lengths("ball") if "ball" in table.columns else np.zeros((len(table), 1))
    if kind in ("distance", "pair_distance"):
        return lengths("length")
    if kind == "indicator":
        return lengths("indicated")
    if kind == "plane":
        return read_only(ball)
    if kind == "sphere":
        return read_only(0.5 * lengths("diameter") + ball if radius_is_known else ball)
    return read_only(np.zeros((len(table), 0)))


def _paired(rows: Measurements, pair: tuple[str, ...] | None) -> Measurements:
    """Return rows of which each has both ends, from rows of one end each; those of one ``pair`` belong together."""
    if pair is None:
        raise MeasurementError(f"{rows.where}: there is no column 'pair', which says which two rows are the ends.")
    ends: dict[str, list[int]] = {}
    for row, name in enumerate(pair):
        ends.setdefault(name, []).append(row)
    for name, found in ends.items():
        if len(found) != 2:
            raise MeasurementError(
                f"{rows.where}:{rows.lines[found[-1]]}: the pair {name!r} has {len(found)} rows; a pair has 2 ends."
            )
        if rows.value[found[0], 0] != rows.value[found[1], 0]:
            raise MeasurementError(
                f"{rows.where}:{rows.lines[found[1]]}: the pair {name!r} has two lengths; both rows say the same one."
            )
    first, second = np.array(list(ends.values()), dtype=np.intp).T
    other = OtherEnd(
        read_only_view(rows.readings[second]), read_only_view(rows.tool[second]), rows.conditions.subset(second)
    )
    return replace(rows.subset(first), other=other)


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
    known = joints | _KNOWN | {f"{what}{name}" for what in (TORQUE, APPROACH) for name in joints}
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


# ---- conditions


def conditions(table: Table, readings: Sequence[Reading], *, in_order: bool = False) -> Conditions:
    """Return what a table says beside readings.

    In columns ``temperature``, ``tau_<joint>``, and ``direction`` or ``direction_<joint>``; ``in_order``: the order of
    the rows says it instead of the latter. Raises MeasurementError for a word that is no side, a unit of another
    dimension, and where sides are said twice.
    """
    own = {reading.name: f"{APPROACH}{reading.name}" for reading in readings}
    said = [name for name in ("direction", *own.values()) if name in table.columns]
    sources = [*(["the order of the rows"] if in_order else []), *said]
    if len(sources) > 1 and (in_order or "direction" in said):
        raise MeasurementError(
            f"{table.where}: the side of approach is said twice, by {sources[0]} and by {sources[1]}; keep one."
        )
    approach = None
    if in_order:
        approach = sides_in_order(stacked(table, {reading.name: reading.dimension for reading in readings}))
    elif said:
        unsaid = np.full(len(table), np.nan)
        columns = {name: _sides(table, name) for name in said}
        sides = [columns.get("direction", columns.get(name, unsaid)) for name in own.values()]
        approach = read_only(np.stack(sides, axis=-1))
    temperature = None
    if "temperature" in table.columns:
        temperature = stacked(table, {"temperature": "temperature"})[:, 0]
    torque = np.full((len(table), len(readings)), np.nan)
    for k, reading in enumerate(readings):
        if f"{TORQUE}{reading.name}" in table.columns:
            torque[:, k] = _numbers(table, f"{TORQUE}{reading.name}", "torque")
    return Conditions(approach, temperature, None if np.isnan(torque).all() else read_only(torque))


def _sides(table: Table, name: str) -> Array:
    found = np.empty(len(table))
    for row, word in enumerate(_words(table, name) or ()):
        if word not in _SIDES:
            raise MeasurementError(
                f"{table.where}:{table.lines[row]}: column {name!r}: {word!r} is not a side of approach; allowed are "
                f"{', '.join(_SIDES)}."
            )
        found[row] = _SIDES[word]
    return found


# ---- noise


def _noise(
    table: Table,
    groups: Sequence[tuple[str, ...]],
    dimension: Dimension,
    options: dict[str, Array | float | None],
    width: int,
) -> Array:
    """Return standard deviations (N, width) from the only one of options and column groups that is there, or 0."""
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
    return np.broadcast_to(values, (len(table), width))
