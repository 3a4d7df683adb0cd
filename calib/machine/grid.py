"""What no model of the arm explains, measured at the corners of cells in joint space and interpolated.

A sector grid spans some of the joints; the others stood at a reference when its nodes were measured. The error vectors
at the nodes, measured minus predicted, are kept in the axes of the base or of the tip link, whichever they follow.
"""

import io
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, NamedTuple, Protocol, TypeVar, cast

import numpy as np
import numpy.typing as npt

from calib.foundations.arrays import Array, BoolArray, IntArray, read_only, read_only_view
from calib.foundations.brief import brief
from calib.foundations.errors import JobError, MeasurementError, OutputError
from calib.foundations.files import read_bytes
from calib.foundations.sealing import sealed
from calib.foundations.units import DISPLAY_OF
from calib.machine.npz import LARGEST_FILE, NotReadableError, arrays_of
from calib.machine.run import refuse_other_run
from calib.machine.turns import points_of
from calib.robot.robot import Reading

Frame = Literal["base", "tip"]
FRAMES: Final[tuple[Frame, ...]] = ("base", "tip")

# Encoders at rest jitter by less than this share of a step; over it errors do not change by anything that counts.
_OFF_GRID = 1e-3
# Readings are inside up to rounding, and so is a cell whose missing corner has no more weight than this.
_ROUNDING = 1e-9
_MOST_NODES = 10_000_000
# Each joint more doubles the corners of a cell: of twenty joints one reading took hundreds of megabytes.
_MOST_JOINTS = 8
SCHEMA = 1
_RUN = "run"  # in files of results
_SETUPS, _TOOLS = "setups", "tools"
_KEYS = ("schema", "frame", "joints", "dimensions", "reference", "axes", "lengths", "errors", "measured")


class Leaning(NamedTuple):
    """What a residual model takes its values from, at N readings.

    Errors measured at ``points`` (N, c, nr), with ``weights`` (N, c). ``unknown`` (N,): which share of errors that are
    common to neighbours it leaves; ``sigma`` (N,): of a component of its own prediction, in m, beside these.
    """

    points: Array
    weights: Array
    unknown: Array
    sigma: Array


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class SectorGrid:
    """Error vectors at the nodes of a regular grid over some joints. Made by :func:`grid_from_residuals`.

    ``readings``: all joints of the robot, in the order of its readings, and ``joints``: numbers of those that the grid
    spans, each with its nodes in ``axes``, ascending, in rad or m. ``reference`` (nr): where the other joints stood;
    NaN for those of the grid. ``errors`` (n_1, ..., n_k, 3): in m, in the axes of ``frame``; where ``measured``
    (n_1, ..., n_k) is false, those of the nearest measured node. ``turning``: of all joints, or none, whether a whole
    turn brings them back; their readings are inside if they are so some whole turns away. ``setups``,
    ``tools``: of a machine with several, the names of those in which, and with which, the errors were measured.
    """

    __repr__ = brief

    readings: tuple[tuple[str, Literal["angle", "length"]], ...]
    joints: tuple[int, ...]
    axes: tuple[Array, ...]
    reference: Array
    errors: Array
    measured: BoolArray
    frame: Frame
    turning: tuple[bool, ...] = ()
    setups: tuple[str, ...] = ()
    tools: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """How many measured rows are gone through for every vector: none, as the nodes around it suffice."""
        return 0

    def at(self, readings: Array, *, clamp: bool = False) -> Array:
        """Return the error vectors (N, 3) in m, multilinear in each cell, at readings (N, nr) in rad and m.

        NaN in rows outside the grid, which :meth:`outside` explains. With ``clamp`` these have the errors at the
        nearest edge, and nearest nodes stand for missing ones.
        """
        inside = self._clipped(readings)
        values = self._multilinear(self.errors, inside)
        return values if clamp else np.where(self._covered(readings)[:, None], values, np.nan)

    def shifts(self, base: Array, tips: Array, readings: Array) -> Array:
        """Return the error vectors (N, 3) in the axes of the instrument; 0 in rows where the grid has no values.

        ``base`` (4, 4) is the robot's in the instrument's frame; ``tips`` (N, 4, 4): tip link in the base link.
        """
        axes = axes_of(self.frame, base, tips)
        return np.asarray((axes @ np.nan_to_num(self.at(readings))[:, :, None])[:, :, 0])

    def leaning(self, readings: Array) -> Leaning:
        """Return the corners of each cell and their weights; none in rows where the grid has no values."""
        N = len(readings)
        corners, lower, weights = self._cells(self._clipped(readings))
        weights = np.where(self._covered(readings)[:, None] & (weights > _ROUNDING), weights, 0.0)
        at = np.broadcast_to(self.reference, (N, len(corners), len(self.reference))).copy()
        for k, (j, axis) in enumerate(zip(self.joints, self.axes, strict=True)):
            at[:, :, j] = axis[lower[:, k, None] + corners[:, k]]
        # A corner without weight may be a place that the robot cannot reach.
        points = np.where(weights[:, :, None] > 0.0, at, np.asarray(readings)[:, None])
        return Leaning(points, weights, np.ones(N), np.zeros(N))

    def own_errors(self, readings: Array, noise: float) -> Array:
        """Return a factor (N, r) of the covariance of the noise of the corners, one column for each that counts."""
        lean = self.leaning(readings)
        row, corner = np.nonzero(lean.weights)
        nodes, number = np.unique(lean.points[row, corner], axis=0, return_inverse=True)
        found = np.zeros((len(readings), len(nodes)))
        found[row, number.reshape(-1)] = noise * lean.weights[row, corner]
        return found

    def scatter(self, noise: float) -> float:  # noqa: ARG002 - it is told pose by pose, from where it was measured
        """Return 0: the other joints stood still at its nodes, and what errs otherwise elsewhere is in `leaning`."""
        return 0.0

    @property
    def when_clamped(self) -> str:
        """What :meth:`at` returns outside, where it clamps."""
        return "the nearest known errors are taken"

    def outside(self, readings: Array) -> tuple[str, ...]:
        """Return for every row of readings (N, nr) why it is outside the grid, or an empty text."""
        covered = self._covered(readings)
        return tuple("" if covered[n] else self._reason(readings[n]) for n in range(len(readings)))

    def _reason(self, row: Array) -> str:
        for point, j, axis in zip(self._points(row[None])[0], self.joints, self.axes, strict=True):
            if not _within(point, axis):
                name, dimension = self.readings[j]
                low, high = (_said(value, dimension) for value in (axis[0], axis[-1]))
                return f"{name} at {_said(row[j], dimension)} is outside the grid, from {low} to {high}"
        _, lower, _ = self._cells(self._clipped(row[None]))
        cell = ", ".join(
            f"{self.readings[j][0]} {_said(axis[i], self.readings[j][1])} to {_said(axis[i + 1], self.readings[j][1])}"
            for j, axis, i in zip(self.joints, self.axes, lower[0], strict=True)
        )
        return f"the cell {cell} has a corner that was not measured"

    def _points(self, readings: Array) -> Array:
        """Return the readings (N, nr) of the grid's joints (N, k), turned towards it where they are outside."""
        return points_of(readings, self.joints, *self._ends, self.turning)

    @property
    def _ends(self) -> tuple[Array, Array]:
        return np.array([axis[0] for axis in self.axes]), np.array([axis[-1] for axis in self.axes])

    def _clipped(self, readings: Array) -> Array:
        return np.asarray(np.clip(self._points(readings), *self._ends))

    def _covered(self, readings: Array) -> BoolArray:
        points = self._points(readings).T
        inside = np.all([_within(own, axis) for own, axis in zip(points, self.axes, strict=True)], axis=0)
        if not self.measured.all():
            # A missing node counts only where it has weight: the faces of a whole cell belong to it.
            missing = self._multilinear((~self.measured).astype(np.float64), self._clipped(readings))
            inside &= missing <= _ROUNDING
        return np.asarray(inside)

    def _multilinear(self, values: Array, points: Array) -> Array:
        """Return what has ``values`` at the nodes at N points within the grid, as SciPy's RegularGridInterpolator does.

        Without SciPy's interpolation, which takes as long to load as all else of ``calib uncertainty``.
        """
        corners, lower, weights = self._cells(points)
        found = np.zeros((len(points), *values.shape[len(self.axes) :]))
        for corner, weight in zip(corners, weights.T, strict=True):
            found += (values[tuple((lower + corner).T)].T * weight).T
        return found

    def _cells(self, points: Array) -> tuple[IntArray, IntArray, Array]:
        """Return which nodes N points of k coordinates are between, and the weights (N, 2^k) of these.

        They are the lower ones (N, k) plus each of the corners (2^k, k) of a cell.
        """
        lower = np.stack(
            [
                np.clip(np.searchsorted(axis, points[:, k], side="right") - 1, 0, len(axis) - 2)
                for k, axis in enumerate(self.axes)
            ],
            axis=1,
        )
        low, high = (np.stack([axis[lower[:, k] + i] for k, axis in enumerate(self.axes)], axis=1) for i in (0, 1))
        place, corners = (points - low) / (high - low), np.array(list(itertools.product((0, 1), repeat=len(self.axes))))
        return corners, lower, np.prod(np.where(corners, place[:, None], 1.0 - place[:, None]), axis=2)


def axes_of(frame: Frame, base: Array, tips: Array) -> Array:
    """Return the axes (N, 3, 3) of a grid's frame in the instrument's.

    Arguments as for :meth:`SectorGrid.shifts`; ``base`` also (N, 4, 4), of every row.
    """
    turned = base[..., :3, :3] if frame == "base" else (base @ tips)[:, :3, :3]
    return np.broadcast_to(turned, (len(tips), 3, 3))


def _within(values: Array, axis: Array) -> BoolArray:
    slack = _ROUNDING * (axis[-1] - axis[0])
    return np.asarray((values >= axis[0] - slack) & (values <= axis[-1] + slack))


def _said(value: float, dimension: str) -> str:
    factor, symbol = DISPLAY_OF[dimension]
    return f"{value * factor:.6g} {symbol}"


# ---- from measured nodes


def grid_from_residuals(
    readings: Array,
    errors: Array,
    robot_readings: Sequence[Reading],
    joints: Sequence[str],
    frame: Frame = "base",
    *,
    axes: Mapping[str, npt.ArrayLike] | None = None,
    partial: bool = False,
    where: str | Sequence[str] = "nodes",
) -> SectorGrid:
    """Return the grid of error vectors (N, 3) in m, in the axes of ``frame``, measured at readings (N, nr).

    ``joints``: names, out of ``robot_readings``, of those that the grid spans; the others must stand still. The rows,
    in any order, must hold every combination once. The nodes of a joint are evenly spaced unless ``axes`` names them
    in rad or m. ``partial``: nodes may be missing, and a cell is used where all its corners are there. ``where``:
    all rows stand, or each of N, as "nodes.csv:12", for messages. Measure all nodes in one set-up: what an identified
    base errs by is in all errors measured from it, and neighbours of several would differ by that.

    Raises JobError when an option cannot be used, and MeasurementError naming the first row that is not on the grid or
    appears twice, the first node that is missing, or the joint that moves and is not one of the grid's.
    """
    place = where if isinstance(where, str) else where[0].rpartition(":")[0] if where else "nodes"
    given = axes or {}
    names = [reading.name for reading in robot_readings]
    numbers = joint_numbers(names, joints, frame)
    if len(numbers) > _MOST_JOINTS:
        raise JobError(
            f"a grid of residuals spans {_MOST_JOINTS} joints at most, and {len(numbers)} are named; a Gaussian "
            "process has no such bound."
        )
    for name in given:
        if name not in joints:
            raise JobError(f"nodes are given for {name!r}, which is not a joint of the grid: {', '.join(joints)}.")
    readings, errors = measured_errors(readings, errors, len(names), place)
    at = [f"{place}, row {n}" for n in range(len(readings))] if isinstance(where, str) else list(where)
    reference = _reference(readings, robot_readings, numbers, at)
    placed = [_placed(readings[:, j], robot_readings[j], at, given.get(names[j])) for j in numbers]
    nodes = tuple(read_only(axis) for axis, _ in placed)
    shape = tuple(len(axis) for axis in nodes)
    if np.prod([float(n) for n in shape]) > _MOST_NODES:
        raise MeasurementError(f"{place}: the steps make a grid of more than {_MOST_NODES} nodes.")
    index = tuple(np.asarray(i) for _, i in placed)
    row_of = np.full(shape, -1, dtype=np.intp)
    for n, node in enumerate(zip(*index, strict=True)):
        if row_of[node] >= 0:
            raise MeasurementError(
                f"{at[n]}: the node {_node(node, nodes, numbers, robot_readings)} appears twice, first at "
                f"{at[row_of[node]]}."
            )
        row_of[node] = n
    measured = row_of >= 0
    if not (partial or measured.all()):
        missing = tuple(int(i) for i in np.argwhere(~measured)[0])
        raise MeasurementError(
            f"{place}: {np.count_nonzero(~measured)} of the {measured.size} nodes of the grid are missing, the first "
            f"at {_node(missing, nodes, numbers, robot_readings)}."
        )
    filled = errors[row_of]
    filled[~measured] = filled[tuple(_nearest_measured(measured).T)]
    return SectorGrid(
        tuple((reading.name, reading.dimension) for reading in robot_readings),
        tuple(numbers),
        nodes,
        read_only(reference),
        read_only(filled),
        read_only_view(measured),
        frame,
        tuple(reading.turns for reading in robot_readings),
    )


def joint_numbers(names: Sequence[str], joints: Sequence[str], frame: str) -> list[int]:
    """Return the joints of a residual model, by number. Raises JobError for others, and for another frame."""
    if frame not in FRAMES:
        raise JobError(f"the frame of a residual model is {frame!r}; allowed are {', '.join(FRAMES)}.")
    for name in joints:
        if name not in names:
            raise JobError(f"a residual model cannot follow {name!r}; the joints that are read are {', '.join(names)}.")
    if not joints or len(set(joints)) < len(joints):
        raise JobError("the joints of a residual model must be at least one, each named once.")
    return [names.index(name) for name in joints]


def measured_errors(readings: Array, errors: Array, width: int, place: str) -> tuple[Array, Array]:
    """Return readings (N, width) and errors (N, 3), one row or more. Raises MeasurementError for anything else."""
    readings, errors = np.asarray(readings, dtype=np.float64), np.asarray(errors, dtype=np.float64)
    if readings.shape != (len(errors), width) or errors.shape != (len(readings), 3) or not len(errors):
        raise MeasurementError(
            f"{place}: readings {readings.shape} and errors {errors.shape} must have the shapes (N, {width}) and "
            "(N, 3)."
        )
    if not (np.isfinite(readings).all() and np.isfinite(errors).all()):
        raise MeasurementError(f"{place}: readings and errors must be finite numbers.")
    return readings, errors


def _reference(readings: Array, robot_readings: Sequence[Reading], joints: Sequence[int], at: Sequence[str]) -> Array:
    reference = np.full(readings.shape[1], np.nan)
    for j, reading in enumerate(robot_readings):
        if j not in joints:
            middle = float(np.median(readings[:, j]))
            off = np.abs(readings[:, j] - middle)
            if (row := int(np.argmax(off > _OFF_GRID))) or off[0] > _OFF_GRID:
                raise MeasurementError(
                    f"{at[row]}: {reading.name} stands at {_said(readings[row, j], reading.dimension)} and elsewhere "
                    f"at {_said(middle, reading.dimension)}; a joint that is not one of the grid's must stand still."
                )
            reference[j] = middle
    return reference


def _placed(values: Array, reading: Reading, at: Sequence[str], given: npt.ArrayLike | None) -> tuple[Array, IntArray]:
    """Return the nodes of one joint, and the node (N) of every row."""
    axis = _even_axis(values, reading, at) if given is None else _given_axis(given, reading)
    index = np.argmin(np.abs(values[:, None] - axis), axis=1)
    off = np.abs(values - axis[index]) > _OFF_GRID * np.min(np.diff(axis))
    if off.any():
        row = int(np.argmax(off))
        nodes = _said(axis[0], reading.dimension), _said(axis[1] - axis[0], reading.dimension)
        steps = f"starts at {nodes[0]} with steps of {nodes[1]}" if given is None else "is given"
        raise MeasurementError(
            f"{at[row]}: {reading.name} at {_said(values[row], reading.dimension)} is not on the grid, which {steps}."
        )
    return axis, index


def _given_axis(given: npt.ArrayLike, reading: Reading) -> Array:
    axis = np.asarray(given, dtype=np.float64)
    if axis.ndim != 1 or len(axis) < 2 or not (np.isfinite(axis).all() and (np.diff(axis) > 0.0).all()):
        raise JobError(f"the nodes of {reading.name} must be at least two ascending numbers.")
    return axis


def _even_axis(values: Array, reading: Reading, at: Sequence[str]) -> Array:
    ordered = np.sort(values)
    gaps = np.diff(ordered)
    span = float(ordered[-1] - ordered[0])
    # Jitter of one node is far smaller than the steps between nodes, of which the usual one is the median.
    starts = np.concatenate([[0], np.flatnonzero(gaps > _OFF_GRID * span) + 1]) if span > 0.0 else np.zeros(1, int)
    if len(starts) < 2 or span <= _OFF_GRID * _OFF_GRID:
        raise MeasurementError(
            f"{at[0]}: {reading.name} stands at {_said(values[0], reading.dimension)} in all rows; "
            "a joint of the grid must have at least two nodes."
        )
    levels = np.array([np.median(level) for level in np.split(ordered, starts[1:])])
    counts = np.diff(np.append(starts, len(ordered)))
    # Levels where few rows stand are slips; the spacing is that of the others.
    usual = levels[counts >= 0.5 * np.median(counts)]
    usual = usual if len(usual) > 1 else levels
    step = float(np.median(np.diff(usual)))
    k = np.rint((usual - usual[0]) / step)
    on = np.abs(usual - usual[0] - k * step) <= 10.0 * _OFF_GRID * step
    if np.count_nonzero(on) > 1:  # the step to the last digit, from the whole span
        last = int(np.flatnonzero(on)[-1])
        step = float((usual[last] - usual[0]) / k[last])
    low, high = (np.rint((value - usual[0]) / step) for value in (levels[0], levels[-1]))
    if high - low > _MOST_NODES:
        raise MeasurementError(f"{at[0]}: the steps of {reading.name} are too uneven for a grid.")
    return np.asarray(usual[0] + step * np.arange(low, high + 1))


def _node(node: Sequence[int], axes: Sequence[Array], joints: Sequence[int], robot_readings: Sequence[Reading]) -> str:
    parts = zip(node, axes, (robot_readings[j] for j in joints), strict=True)
    return ", ".join(f"{reading.name} {_said(axis[i], reading.dimension)}" for i, axis, reading in parts)


def _nearest_measured(measured: BoolArray) -> IntArray:
    """Return for every missing node (in order) the nearest measured one, in steps: (missing, k)."""
    there, missing = np.argwhere(measured), np.argwhere(~measured)
    nearest = [there[np.argmin(np.sum((there - node) ** 2, axis=1))] for node in missing]
    return np.array(nearest, dtype=np.intp).reshape(-1, measured.ndim)


# ---- files


def grid_bytes(grid: SectorGrid, run: str | None = None) -> bytes:
    """Return a grid as an npz file, of a run's results: plain arrays, the same bytes for the same grid."""
    arrays = {
        "reference": grid.reference,
        "axes": np.concatenate(grid.axes),
        "lengths": np.array([len(axis) for axis in grid.axes], dtype=np.int64),
        "errors": grid.errors,
        "measured": grid.measured,
    }
    return residual_bytes(grid.frame, grid.joints, grid.readings, arrays | named(grid.setups, grid.tools), run)


def named(setups: Sequence[str], tools: Sequence[str]) -> dict[str, npt.NDArray[Any]]:
    """Return what a file tells of the set-ups and the tools of a residual model: nothing where there is but one."""
    return {key: np.array(names) for key, names in ((_SETUPS, setups), (_TOOLS, tools)) if names}


def residual_bytes(
    frame: Frame,
    joints: Sequence[int],
    readings: Sequence[tuple[str, str]],
    arrays: Mapping[str, npt.NDArray[Any]],
    run: str | None,
) -> bytes:
    """Return a residual model as an npz file: the head that :func:`head_of` reads, then its own ``arrays``."""
    head: dict[str, Any] = {
        "schema": SCHEMA,
        "frame": frame,
        "joints": np.array(joints, np.int64),
        "dimensions": readings,
        **({} if run is None else {_RUN: run}),
    }
    buffer = io.BytesIO()
    np.savez(buffer, **head, **dict[str, Any](arrays))
    return buffer.getvalue()


def load_grid(path: str | Path, robot_readings: Sequence[Reading] | None = None) -> SectorGrid:
    """Read a grid as :func:`grid_bytes` makes it; nothing in the file is ever executed.

    Raises OutputError with one sentence when the file is not such a grid, or not one of a robot with these readings.
    """
    return load_residuals(path, _KEYS, _grid_of, ("a residual grid", "the grid of"), robot_readings)


class _OfReadings(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def readings(self) -> tuple[tuple[str, Literal["angle", "length"]], ...]: ...


_Residuals = TypeVar("_Residuals", bound=_OfReadings)


def load_residuals(
    path: str | Path,
    keys: Sequence[str],
    made: Callable[[Mapping[str, npt.NDArray[Any]]], _Residuals],
    names: tuple[str, str],
    robot_readings: Sequence[Reading] | None,
) -> _Residuals:
    """Read a residual model of these ``keys``. ``names``: what it is, and what it is of a robot, for messages."""
    data = read_bytes(Path(path), OutputError, LARGEST_FILE)
    try:
        arrays = arrays_of(data, keys, (_RUN, _SETUPS, _TOOLS))
        run = _run_in(arrays.pop(_RUN, None))
        setups, tools = (_names_in(arrays.pop(key, None), key) for key in (_SETUPS, _TOOLS))
        known = replace(made(arrays), setups=setups, tools=tools)
    except NotReadableError as e:
        raise OutputError(f"{path}: is not {names[0]} of this toolkit: {e}.") from e
    if robot_readings is not None and known.readings != tuple((r.name, r.dimension) for r in robot_readings):
        theirs, ours = (", ".join(name for name, _ in known.readings), ", ".join(r.name for r in robot_readings))
        raise OutputError(f"{path}: is {names[1]} a robot with the joints {theirs}, and this one has {ours}.")
    refuse_other_run(Path(path), run)
    # What follows a joint the file does not say, and the robot does.
    return known if robot_readings is None else replace(known, turning=tuple(r.turns for r in robot_readings))


def _run_in(array: npt.NDArray[Any] | None) -> str | None:
    """Return the run that a residual model names, if it does. Raises NotReadableError for what is no name."""
    if array is not None and (array.shape != () or array.dtype.kind != "U"):
        raise NotReadableError(f"{_RUN} has a wrong type")
    return None if array is None else str(array)


def _names_in(array: npt.NDArray[Any] | None, key: str) -> tuple[str, ...]:
    """Return the set-ups or tools that a residual model names. Raises NotReadableError for what are no names."""
    if array is not None and (array.ndim != 1 or array.dtype.kind != "U"):
        raise NotReadableError(f"{key} has a wrong type")
    return () if array is None else tuple(str(name) for name in array)


def head_of(
    arrays: Mapping[str, npt.NDArray[Any]], kinds: Mapping[str, str]
) -> tuple[Frame, tuple[tuple[str, Literal["angle", "length"]], ...], tuple[int, ...]]:
    """Return what every file of a residual model begins with: its frame, and names and dimensions of all joints.

    ``kinds``: of arrays beside those of the head that are no floating-point numbers, as numpy's letters. Raises
    NotReadableError for an array of another type, another schema, and a head that is none.
    """
    kinds = {"schema": "i", "frame": "U", "joints": "i", "dimensions": "U", **kinds}
    for key, array in arrays.items():
        if array.dtype.kind != kinds.get(key, "f"):
            raise NotReadableError(f"{key} has a wrong type")
    if arrays["schema"].shape != () or int(arrays["schema"]) != SCHEMA:
        raise NotReadableError(f"its schema is not {SCHEMA}")
    if arrays["frame"].shape != () or str(arrays["frame"]) not in FRAMES:
        raise NotReadableError(f"its frame is not one of {', '.join(FRAMES)}")
    table = arrays["dimensions"]
    if table.ndim != 2 or table.shape[1] != 2 or not np.isin(table[:, 1], list(DISPLAY_OF)).all():
        raise NotReadableError("its joints have no names and dimensions")
    readings = tuple((str(name), cast(Literal["angle", "length"], str(dimension))) for name, dimension in table)
    joints = arrays["joints"]
    numbers = tuple(int(j) for j in joints.ravel())
    if joints.ndim != 1 or not numbers or len(set(numbers)) < len(numbers) or not {*numbers} <= {*range(len(readings))}:
        raise NotReadableError("its joints are not different ones of the robot's")
    return cast(Frame, str(arrays["frame"])), readings, numbers


def _grid_of(arrays: Mapping[str, npt.NDArray[Any]]) -> SectorGrid:
    frame, readings, numbers = head_of(arrays, {"lengths": "i", "measured": "b"})
    lengths, n = arrays["lengths"], len(readings)
    if len(numbers) > _MOST_JOINTS:
        raise NotReadableError(f"it spans more than {_MOST_JOINTS} joints")
    if lengths.shape != (len(numbers),) or (lengths < 2).any() or arrays["axes"].shape != (int(lengths.sum()),):
        raise NotReadableError("its axes are not at least two nodes for every joint")
    axes = tuple(read_only(axis) for axis in np.split(arrays["axes"], np.cumsum(lengths)[:-1]))
    if not all(np.isfinite(axis).all() and (np.diff(axis) > 0.0).all() for axis in axes):
        raise NotReadableError("its nodes do not ascend")
    shape = tuple(int(length) for length in lengths)
    if arrays["measured"].shape != shape or arrays["errors"].shape != (*shape, 3) or not arrays["measured"].any():
        raise NotReadableError("its errors are not those of its nodes")
    if not np.isfinite(arrays["errors"]).all():
        raise NotReadableError("an error is not a finite number")
    still = [j for j in range(n) if j not in numbers]
    reference = arrays["reference"]
    spanned = list(numbers)
    if reference.shape != (n,) or not np.isfinite(reference[still]).all() or not np.isnan(reference[spanned]).all():
        raise NotReadableError("its reference is not that of the joints beside the grid")
    return SectorGrid(
        readings,
        numbers,
        axes,
        read_only(reference),
        read_only(arrays["errors"]),
        read_only_view(arrays["measured"].copy()),
        frame,
    )
