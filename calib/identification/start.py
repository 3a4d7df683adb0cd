"""From a model and measurements to a problem: common names, start values of all frames, and what is unknown.

Every start is in closed form for the nominal robot. Base and tools come from positions and poses, where there are any
(:mod:`calib.identification.alignment`); other tool points from turning in a socket or about a ball's centre; targets
from where the nominal robot puts the tool.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.errors import JobError, MeasurementError
from calib.identification import targets
from calib.identification.alignment import Known, Rows, align
from calib.identification.error_model import ErrorModel
from calib.identification.machine import Frames, Layout, Machine, values_at
from calib.identification.solver import solve
from calib.identification.system import Problem
from calib.measurement.kinds import IN_INSTRUMENT_FRAME
from calib.measurement.measurements import Measurements
from calib.robot.transmission import lacking

# Directions of a linear fit below this share of the best one are left at their start.
_NEGLIGIBLE = 1e-8


def posed(model: ErrorModel, measurements: Sequence[Measurements]) -> Problem:
    """Return the problem of finding all that is free, with base, tools and targets where the nominal robot has them.

    Where nothing was measured in an instrument's frame, such as by sockets alone, the base's frame is taken for it.

    Raises MeasurementError when the measurements are not of this robot, or a target is two things; JobError when a name
    means two things, or a known or related target is in no measurement.
    """
    sets = with_common_names(model, measurements)
    if not any(data.kind in IN_INSTRUMENT_FRAME for data in sets) and not any(
        target.height_is_known for target in model.targets.values()
    ):
        model = replace(model, base="fixed")
    reference = start_frames(model, sets)
    layout = Layout.of(model.robot, reference)
    parameters = (*model.parameters(sets[0].tools), *targets.unknowns(sets, model.targets, layout))
    _refuse_unknown_targets(model, sets)
    names = [parameter.name for parameter in parameters]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise JobError(f"the parameter name {twice[0]!r} means two things; rename a joint, a target or a length.")
    return Problem(model, parameters, reference, sets, relations=model.relations)


def _refuse_unknown_targets(model: ErrorModel, sets: Sequence[Measurements]) -> None:
    """Refuse what is known of targets that nobody measured, and relations of the wrong things."""
    found = targets.shapes(sets)
    for name in model.targets:
        if name not in found:
            raise JobError(f"targets: {name!r} is in no measurement; they have {', '.join(found) or 'no targets'}.")
    for relation in model.relations:
        shape = "point" if relation.kind == "distance" else "plane"
        for name in relation.targets:
            if found.get(name) != shape:
                raise JobError(
                    f"relations: a known {relation.kind} is between two {shape}s, and {name!r} is "
                    f"{'a ' + found[name] if name in found else 'in no measurement'}."
                )


def with_common_names(model: ErrorModel, sets: Sequence[Measurements]) -> tuple[Measurements, ...]:
    """Return the sets with common lists of tools, targets and lengths.

    Raises MeasurementError when they are not of this robot, or lack what a joint term needs.
    """
    names = tuple(reading.name for reading in model.robot.readings)
    for data in sets:
        if data.reading_names != names:
            raise MeasurementError(
                f"{data.where}: the readings {data.reading_names} are not those of the robot, {names}."
            )
        for conditions in (data.conditions, *(() if data.other is None else (data.other.conditions,))):
            if missing := lacking(model.robot.terms, names, conditions):
                raise MeasurementError(f"{data.where}: there is no column {missing[1]!r}, which {missing[0]} needs.")
    tools = tuple(dict.fromkeys(tool for data in sets for tool in data.tools))
    every = tuple(dict.fromkeys(target for data in sets for target in data.targets))
    offsets = tuple(dict.fromkeys(offset for data in sets for offset in data.offsets))

    def numbered(old: Sequence[str], new: Sequence[str], numbers: IntArray) -> IntArray:
        # -1 stays what it is: none.
        return np.array([*(new.index(name) for name in old), -1], dtype=np.intp)[numbers]

    return tuple(
        replace(
            data,
            tools=tools,
            tool=numbered(data.tools, tools, data.tool),
            targets=every,
            target=numbered(data.targets, every, data.target),
            other=None
            if data.other is None
            else replace(data.other, tool=numbered(data.tools, tools, data.other.tool)),
            offsets=offsets,
            offset=offsets.index(data.offsets[data.offset]) if data.offset >= 0 else -1,
        )
        for data in sets
    )


def start_frames(model: ErrorModel, sets: Sequence[Measurements]) -> Frames:
    """Return base, tools and targets that explain sets with common names best with the nominal robot.

    What is fixed or known stays as given.
    """
    given = model.given_frames(sets[0].tools)
    tips = [model.robot.tips(data.readings) for data in sets]
    base, tools, placed = given.base, given.tools, np.zeros(len(given.tools), dtype=np.bool_)
    seen = [(data, T, data.position) for data, T in zip(sets, tips, strict=True) if data.position is not None]
    if seen:
        rows = Rows(
            np.concatenate([T for _, T, _ in seen]),
            np.concatenate([position for _, _, position in seen]),
            np.concatenate([_orientation(data) for data, _, _ in seen]),
            np.concatenate([data.tool for data, _, _ in seen]),
        )
        known = Known(
            given.base if model.base == "fixed" else None,
            given.tools[:, :3, 3] if model.tool == "fixed" else None,
            None if model.tool == "pose" else given.tools[:, :3, :3],
        )
        base, tools = align(rows, known, given.tools)
        placed[rows.tool] = True
    if model.tool != "fixed" and not placed.all():
        tools = _turned_in_sockets(model, sets, tips, base, tools, placed)
    return _with_targets(model, sets, tips, Frames(base, tools))


def with_new_targets(model: ErrorModel, sets: Sequence[Measurements], machine: Machine) -> Machine:
    """Return a machine with the targets and lengths of sets with common names that it does not know yet.

    The sets' names are the machine's, then new ones. Raises IdentificationError when the measurements are too few.
    """
    frames = machine.frames
    known_targets, known_lengths = len(frames.targets), len(frames.lengths)
    if (known_targets, known_lengths) == (len(sets[0].targets), len(sets[0].offsets)):
        return machine
    tips = [model.robot.tips(data.readings, machine.deviations, data.conditions) for data in sets]
    placed = _with_targets(model, sets, tips, frames)
    placed = replace(
        placed,
        targets=np.concatenate([frames.targets, placed.targets[known_targets:]]),
        lengths=np.concatenate([frames.lengths, placed.lengths[known_lengths:]]),
    )
    layout = Layout.of(model.robot, placed)
    targets_end, lengths_end = layout.targets + 6 * known_targets, layout.lengths + known_lengths
    new = tuple(
        parameter
        for parameter in targets.unknowns(sets, model.targets, layout)
        if targets_end <= parameter.direction[0][0] < layout.lengths or parameter.direction[0][0] >= lengths_end
    )
    problem = Problem(model, new, placed, tuple(sets), machine.deviations)
    start = values_at(model.robot, new, placed, machine.deviations)
    # The mean of a socket's rows is the answer already; other targets are near it.
    others = [data for data in sets if data.kind in targets.SHAPES and data.kind != "socket"]
    return problem.machine(solve(problem, start).x if others and new else start)


def _orientation(data: Measurements) -> Array:
    return np.full((len(data), 3, 3), np.nan) if data.orientation is None else data.orientation


def _turned_in_sockets(
    model: ErrorModel, sets: Sequence[Measurements], tips: Sequence[Array], base: Array, tools: Array, placed: BoolArray
) -> Array:
    """Return the tools with those points that are not ``placed`` found by turning about points that stay.

    A point p that stays at c while the tip turns obeys R_n p + t_n = c: linear in both. A ball that is touched all
    around keeps its centre on average, which is near enough for a start.
    """
    rows, right = [], []
    k, m = len(tools), len(sets[0].targets)
    for data, T in zip(sets, tips, strict=True):
        if data.kind not in ("socket", "sphere"):
            continue
        in_world = base @ T
        A = np.zeros((len(data), 3, k + m, 3))
        b = -in_world[:, :3, 3].copy()
        n = np.arange(len(data))
        A[n, :, data.tool] = np.where(placed[data.tool, None, None], 0.0, in_world[:, :3, :3])
        b -= np.where(placed[data.tool, None], (in_world[:, :3, :3] @ tools[data.tool, :3, 3:])[:, :, 0], 0.0)
        for t, name in enumerate(data.targets):
            own = n[data.target == t]
            if name in model.targets:
                b[own] += model.targets[name].pose[:3, 3]
            else:
                A[own, :, k + t] = -np.eye(3)
        rows.append(A.reshape(3 * len(data), -1))
        right.append(b.ravel())
    if not rows:
        return tools
    # What turning does not show, such as the height on an axis that alone turns, stays as guessed.
    guess = np.concatenate([tools[:, :3, 3].ravel(), np.zeros(3 * m)])
    A, b = np.concatenate(rows), np.concatenate(right)
    change = np.linalg.lstsq(A, b - A @ guess, rcond=_NEGLIGIBLE)[0]
    points = (guess + change)[: 3 * k].reshape(-1, 3)
    return np.asarray(rigid.placement(tools[:, :3, :3], np.where(placed[:, None], tools[:, :3, 3], points)))


def _with_targets(model: ErrorModel, sets: Sequence[Measurements], tips: Sequence[Array], frames: Frames) -> Frames:
    """Return the frames with the targets where the nominal robot puts them."""
    names, found = sets[0].targets, targets.shapes(sets)
    poses, lengths = np.tile(np.eye(4), (len(names), 1, 1)), np.zeros(len(sets[0].offsets))
    points = [(frames.base @ T @ frames.tools[data.tool])[:, :3, 3] for data, T in zip(sets, tips, strict=True)]
    for t, name in enumerate(names):
        own = [(data, x[data.target == t], data.value[data.target == t]) for data, x in zip(sets, points, strict=True)]
        own = [(data, x, value) for data, x, value in own if len(x) and data.kind in targets.SHAPES]
        if name in model.targets:
            poses[t] = _known_pose(model.targets[name], own)
        elif found.get(name) == "plane":
            poses[t] = _plane(np.concatenate([x for _, x, _ in own]), frames.base[:3, 3])
        elif own:
            sockets = [x for data, x, _ in own if data.kind == "socket"]
            poses[t, :3, 3] = np.concatenate(sockets).mean(axis=0) if sockets else _centre(own)
    for k in range(len(lengths)):
        missing = [
            value[:, 0] - np.linalg.norm(x - poses[data.target, :3, 3], axis=1)
            for data, x, value in zip(sets, points, (data.value for data in sets), strict=True)
            if data.offset == k and data.kind != "pair_distance"
        ]
        lengths[k] = np.concatenate(missing).mean() if missing else 0.0
    return Frames(frames.base, frames.tools, poses, lengths)


def _known_pose(target: targets.Target, own: Sequence[tuple[Measurements, Array, Array]]) -> Array:
    """Return the pose of a target that is known, its height found where that is not."""
    if target.height_is_known or not own:
        return target.pose
    normal = target.pose[:3, 2]
    height = np.concatenate([x @ normal - value[:, 0] for _, x, value in own]).mean()
    return rigid.placement(target.pose[:3, :3], height * normal)


def _plane(x: Array, base: Array) -> Array:
    """Return a frame whose x and y are in the plane nearest to points (n, 3), z on the side of the robot's base."""
    middle = x.mean(axis=0)
    axes = np.linalg.svd(x - middle, full_matrices=True)[2]
    normal = axes[2] if axes[2] @ (base - middle) >= 0.0 else -axes[2]
    return rigid.placement(np.column_stack([axes[0], np.cross(normal, axes[0]), normal]), middle)


def _centre(own: Sequence[tuple[Measurements, Array, Array]]) -> Array:
    """Return the point at measured distances from points: |x|^2 - l^2 = 2 x c - 2 l o + o^2 - |c|^2, linear."""
    x = np.concatenate([points for _, points, _ in own])
    length = np.concatenate([value[:, 0] for _, _, value in own])
    middle = x.mean(axis=0)
    y = x - middle
    offset = [length] if any(data.offset >= 0 for data, _, _ in own) and np.ptp(length) > 0.0 else []
    A = np.column_stack([2.0 * y, np.ones(len(y)), *offset])
    z = np.linalg.lstsq(A, (y * y).sum(axis=1) - length**2, rcond=_NEGLIGIBLE)[0]
    return np.asarray(middle + z[:3])
