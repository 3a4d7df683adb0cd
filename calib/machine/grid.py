"""What no model of the arm explains, measured at the corners of cells in joint space and interpolated.

A sector grid spans some of the joints; the others stood at a reference when its nodes were measured. The error vectors
at the nodes, measured minus predicted, are kept in the axes of the base or of the tip link, whichever they follow.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from calib.foundations.arrays import Array, BoolArray, IntArray, read_only, read_only_view
from calib.foundations.brief import brief
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.sealing import sealed
from calib.foundations.units import DISPLAY_OF
from calib.machine.npz import NotReadableError
from calib.machine.residual_file import HEAD, head_of, load_residuals, named, residual_bytes
from calib.machine.residual_model import Frame, Leaning, axes_of, joint_numbers, measured_errors
from calib.machine.turns import points_of
from calib.robot.robot import Reading

# Encoders at rest jitter by less than this share of a step; over it errors do not change by anything that counts.
_OFF_GRID = 1e-3
# Readings are inside up to rounding, and so is a cell whose missing corner has no more weight than this.
_ROUNDING = 1e-9
_MOST_NODES = 10_000_000
# Each joint more doubles the corners of a cell: of twenty joints one reading took hundreds of megabytes.
_MOST_JOINTS = 8
_KEYS = (*HEAD, "reference", "axes", "lengths", "errors", "measured")


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
        at_all = _said(values[0], reading.dimension)
        ends = " and ".join(_said(value, reading.dimension) for value in ordered[[0, -1]])
        stands = f"anywhere between {ends}" if span > _OFF_GRID else f"at {at_all} in all rows"
        raise MeasurementError(
            f"{at[0]}: {reading.name} stands {stands}; a joint of the grid must have at least two nodes."
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


def load_grid(path: str | Path, robot_readings: Sequence[Reading] | None = None) -> SectorGrid:
    """Read a grid as :func:`grid_bytes` makes it; nothing in the file is ever executed.

    Raises OutputError with one sentence when the file is not such a grid, or not one of a robot with these readings.
    """
    return load_residuals(path, _KEYS, _grid_of, ("a residual grid", "the grid of"), robot_readings)


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
