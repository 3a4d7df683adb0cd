"""The scene of a calibration."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from calib.assessment.hand_eye import lens_of, marks_and_pixels
from calib.assessment.judged import JudgedSet
from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.chance import bound
from calib.foundations.units import DISPLAY_OF
from calib.identification.targets import shapes
from calib.machine.tool_uncertainty import tool_uncertainty
from calib.measurement.instruments import Camera
from calib.measurement.kinds import Kind, size
from calib.measurement.measurements import Measurements, numbered
from calib.presentation.machine_scene import led_apart
from calib.presentation.scene import Mark, MarkKind, Scene, magnification
from calib.results.calibration import Calibration
from calib.robot.conditions import joined
from calib.robot.links import arm_of

# Ellipsoids of all rows would hide one another, and take longer than the fit.
_MOST_REGIONS = 60
# More of them hide each other, and all else.
_MOST_TARGETS = 300


def scene_of(found: Calibration) -> Scene:
    """Return the scene of a calibration: every row of every table that tells a point, in the job's order.

    All is drawn in the instrument's frame of the first set-up: from others it is carried there with the robot's base. A
    socket's point is where the calibrated robot says it is. Tables of lengths, heights and pixels tell no points. Where
    there is nothing else, marks are drawn for pixels, with errors across the line of sight; or the calibrated tool's
    points, without errors.
    """
    fit, robot = found.fit, found.fit.robot
    root = robot.root_in_base
    known = [judged for judged in found.sets if fit.knows(judged.data)]
    with_points = [judged for judged in known if size(judged.data.kind) >= 3]
    with_marks = [judged for judged in known if judged.data.camera is not None and _is_placed(found, judged.data)]
    sets = with_points or with_marks or known
    readings = np.concatenate([judged.data.readings for judged in sets])
    conditions = joined([(len(judged.data), judged.data.conditions) for judged in sets])
    if with_points or not with_marks:
        measured = before = after = np.concatenate([_points(found, judged) for judged in sets])
    else:
        measured, before, after = (np.concatenate(of) for of in zip(*(_marks(found, j) for j in sets), strict=True))
    if with_points:
        before = measured - np.concatenate([_turned(found, judged, judged.before) for judged in sets])
        after = measured - np.concatenate([_turned(found, judged, judged.after) for judged in sets])
    calibrated = arm_of(robot, fit.deviations, readings, fit.machine.frames.base @ root, conditions)
    extent = float(np.ptp(np.concatenate([measured, calibrated.root[None, :3, 3]]), axis=0).max())
    # A board lies still before a camera on the arm: errors as long as the arm is large would cover it.
    drawn = float(np.ptp(measured, axis=0).max()) if with_marks and not with_points else extent
    scales = magnification(before - measured, drawn), magnification(after - measured, drawn)
    # Its tool goes to where the errors before calibration, drawn as often, end.
    bases = fit.machine.frames.base, fit.nominal.frames.base
    nominal, apart = led_apart(
        robot, fit.deviations, readings, conditions, lambda times: _beyond(*bases, times) @ root, scales[0]
    )
    tools = dict(zip(fit.measurements[0].tools, fit.machine.frames.tools[:, :3, 3], strict=True))
    marks, notes = _targets(found, extent)
    marks += _cameras_and_boards(found, extent)
    if with_marks and not with_points:
        notes = (*notes, "Points are the marks of boards; errors are across the line of sight, where the marks are.")
    return Scene(
        title=f"{robot.urdf.name or robot.urdf.where}: calibration",
        urdf=robot.urdf,
        mesh_roots=found.origin.mesh_roots,
        calibrated=calibrated,
        nominal=nominal,
        apart=apart,
        tools={name: point for name, point in tools.items() if name not in fit.tool_tips},
        tools_on={name: (fit.tool_tips[name], point) for name, point in tools.items() if name in fit.tool_tips},
        notes=notes,
        tip=robot.tip,
        rows=tuple(f"{judged.file} line {line}" for judged in sets for line in judged.data.lines),
        measured=measured,
        before=before,
        after=after,
        scales=scales,
        marks=(*marks, *_stations(found, extent)),
        judged=bool(with_points or with_marks),
        joints=tuple((reading.name, DISPLAY_OF[reading.dimension].symbol) for reading in robot.readings),
        readings=readings * [DISPLAY_OF[reading.dimension].times for reading in robot.readings],
        colourings={
            "table": [judged.file for judged in sets for _ in range(len(judged.data))],
            "set-up": [judged.data.setups[k] for judged in sets for k in judged.data.setup],
        },
        regions=_regions(found, sets) if with_points else {},
        times=_times(sets),
    )


def _times(sets: Sequence[JudgedSet]) -> Array | None:
    """Return when rows were measured (N,), in s since the first of all, NaN where nobody says; None for no streams."""
    if all(judged.data.stream is None for judged in sets):
        return None
    told = [np.full(len(j.data), np.nan) if j.data.times is None else j.data.times for j in sets]
    times = np.concatenate(told)
    return np.asarray(times - np.nanmin(times))


def _regions(found: Calibration, sets: Sequence[JudgedSet]) -> dict[int, Array]:
    """Return the half axes (3, 3) of the region of the tool with 95 %, in the first set-up's axes, of some rows."""
    if found.machine.uncertainty is None:
        return {}
    known = found.machine.uncertainty
    radius = np.sqrt(bound(0.95, 3, known.degrees_of_freedom))
    total = sum(len(judged.data) for judged in sets)
    chosen = np.unique(np.linspace(0, total - 1, _MOST_REGIONS).astype(int))
    axes: dict[int, Array] = {}
    start = 0
    for judged in sets:
        data, own = judged.data, chosen[(chosen >= start) & (chosen < start + len(judged.data))] - start
        turned = _carried(found, judged)[:, :3, :3]
        for setup, tool in sorted({(data.setups[data.setup[n]], data.tools[data.tool[n]]) for n in own}):
            rows = np.array([n for n in own if (data.setups[data.setup[n]], data.tools[data.tool[n]]) == (setup, tool)])
            told = data.conditions.subset(rows)
            sure = tool_uncertainty(found.machine.at(setup), data.readings[rows], tool, conditions=told)
            sizes, ways = np.linalg.eigh(sure.covariance[:, :3, :3])
            half = turned[rows] @ ways * (radius * np.sqrt(np.maximum(sizes, 0.0)))[:, None, :]
            axes |= {start + int(n): one for n, one in zip(rows, half, strict=True)}
        start += len(data)
    return dict(sorted(axes.items()))


# What targets of a kind of rows are: their layer, and how they are drawn.
_DRAWN: Mapping[Kind, tuple[str, MarkKind]] = {
    "socket": ("sockets", "socket"),
    "sphere": ("balls", "ball"),
    "plane": ("planes", "plane"),
    "indicator": ("indicated planes", "plane"),
    "distance": ("anchors", "point"),
    "pixels": ("marks", "point"),
}


def _targets(found: Calibration, extent: float) -> tuple[list[Mark], tuple[str, ...]]:
    """Return sockets, anchors, balls, planes, boards and cameras where they were found, and what is to be said of them.

    Planes are as large as they were touched, balls as far away from their centres as the tool's point was; sockets are
    open to where the tip was.
    """
    fit, own = found.fit, found.fit.measurements[0]
    known = shapes(fit.measurements)
    every = [t for t, name in enumerate(own.targets) if name in known]
    drawn = [every[k] for k in np.unique(np.linspace(0, len(every) - 1, min(len(every), _MOST_TARGETS)).astype(int))]
    sets = [
        (data, _tool_points(found, data), dict(numbered(data.target)))
        for data in fit.measurements
        if data.kind in _DRAWN
    ]
    marks = []
    for t in drawn:
        name, T = own.targets[t], fit.machine.frames.targets[t]
        about = [(data, points[rows[t]]) for data, points, rows in sets if t in rows]
        layer, kind = _DRAWN[about[0][0].kind]
        if kind == "point" and known[name] == "frame":
            continue
        touched = np.concatenate([points for _, points in about])
        placed, size = _as_touched(kind, T, touched[:, 0], touched[:, 1], extent)
        marks.append(Mark(layer, name, kind, placed, size, own.target_links.get(name)))
    return marks, () if len(drawn) == len(every) else (f"{len(drawn)} of the {len(every)} targets are drawn.",)


def _cameras_and_boards(found: Calibration, extent: float) -> list[Mark]:
    """Return cameras as pyramids of what they see, and boards as large as their marks are spread, wherever they are."""
    fit, own = found.fit, found.fit.measurements[0]
    known, frames = shapes(fit.measurements), fit.machine.frames
    marks: dict[tuple[str, str], Mark] = {}
    for data in fit.measurements:
        if data.camera is None:
            continue
        on_tip, tip = data.camera.camera_on == "tip", data.tip or fit.robot.tip
        tools = [(own.tools[k], frames.tools[k], tip, data.tool == k) for k in np.unique(data.tool)]
        targets = [
            (own.targets[k], frames.targets[k], own.target_links.get(own.targets[k]), data.target == k)
            for k in np.unique(data.target)
            if known.get(own.targets[k]) == "frame"
        ]
        for name, T, link, _ in tools if on_tip else targets:
            marks["cameras", name] = _camera(name, T, link, found, data.camera, extent)
        for name, T, link, rows in targets if on_tip else tools:
            places = data.value[rows, 2:]
            if np.ptp(places, axis=0).max() > 0.0:
                marks["boards", name] = _board(name, T, link, places)
    return list(marks.values())


def _camera(name: str, T: Array, link: str | None, found: Calibration, camera: Camera, extent: float) -> Mark:
    lens = lens_of(found.fit, camera)[0]
    width, height = camera.size or (2.0 * lens.cx, 2.0 * lens.cy)
    spread = 0.5 * width / lens.fx, 0.5 * height / lens.fy
    return Mark("cameras", name, "camera", T, 0.12 * extent, link, spread)


def _board(name: str, T: Array, link: str | None, places: Array) -> Mark:
    low, high = places.min(axis=0), places.max(axis=0)
    half = 0.5 * (high - low)
    size = float(half[:2].max()) or float(half.max())
    placed = T @ rigid.translation(0.5 * (low + high))
    return Mark("boards", name, "plane", placed, size, link, (float(half[0]) / size, float(half[1]) / size))


def _stations(found: Calibration, extent: float) -> Iterator[Mark]:
    """Yield where the instrument stood in set-ups beside the first, as seen from the base of that."""
    bases = found.fit.machine.frames.bases
    for name, base in zip(found.fit.measurements[0].setups[1:], bases[1:], strict=True):
        yield Mark("stations", name, "point", bases[0] @ rigid.inverse(base), 0.02 * extent)


def _as_touched(kind: MarkKind, T: Array, points: Array, tips: Array, extent: float) -> tuple[Array, float]:
    """Return the place (4, 4) and the size of a target that tools at ``points`` (N, 3), on ``tips``, have touched."""
    off = (points - T[:3, 3]) @ T[:3, :3]
    if kind == "ball":
        return T, float(np.median(np.linalg.norm(off, axis=1)))
    if kind == "plane" and np.abs(off[:, 2]).max() < 0.1 * max(float(np.ptp(off[:, :2])), 1e-6):
        middle = np.append((off[:, :2].min(axis=0) + off[:, :2].max(axis=0)) / 2.0, 0.0)
        half = float(np.abs(off[:, :2] - middle[:2]).max())
        return rigid.placement(T[:3, :3], T[:3, 3] + T[:3, :3] @ middle), max(1.1 * half, 0.01 * extent)
    if kind == "socket":
        up = (tips - points).mean(axis=0)
        size = float(np.linalg.norm(up))
        if size > 0.0:
            across = np.cross(np.eye(3)[np.argmin(np.abs(up))], up / size)
            across /= np.linalg.norm(across)
            R = np.column_stack([across, np.cross(up / size, across), up / size])
            return rigid.placement(R, T[:3, 3]), 0.018 * extent
    return T, (0.08 if kind == "plane" else 0.012) * extent


def _tool_points(found: Calibration, data: Measurements) -> Array:
    """Return the points (N, 2, 3) of tools and of the tips that carry them, in the frame in which targets are told."""
    fit = found.fit
    tips = fit.tips_before_targets(data)
    return np.stack([(tips @ fit.tools_of(data))[:, :3, 3], tips[:, :3, 3]], axis=1)


def _points(found: Calibration, judged: JudgedSet) -> Array:
    """Return the points (N, 3) that a table measured, in the instrument's frame of the first set-up."""
    data, fit = judged.data, found.fit
    if data.position is not None:
        T = _carried(found, judged)
        return np.asarray((T[:, :3, :3] @ data.position[:, :, None])[:, :, 0] + T[:, :3, 3])
    placed = fit.machine.frames.base @ data.tips(fit.robot, fit.deviations)
    points = np.asarray((placed @ fit.tools_of(data))[:, :3, 3])
    return points + _turned(found, judged, judged.after) if data.kind == "socket" else points


def _is_placed(found: Calibration, data: Measurements) -> bool:
    """Return whether it was found where the boards, or the cameras, of a table are."""
    return set(data.seen_targets) <= set(found.fit.measurements[0].targets)


def _marks(found: Calibration, judged: JudgedSet) -> tuple[Array, Array, Array]:
    """Return where marks (N, 3) were seen, and where before and after calibration, in the first set-up's frame.

    All are as far away as the calibrated machine has them: a photograph does not tell.
    """
    T = _carried(found, judged)
    places, of_pixel = marks_and_pixels(found.fit, judged.data)
    places, of_pixel = (T[:, :3, :3] @ places[:, :, None])[:, :, 0] + T[:, :3, 3], T[:, :3, :3] @ of_pixel
    before, after = ((of_pixel @ r[:, :, None])[:, :, 0] for r in (judged.before, judged.after))
    return places + after, places + after - before, places


def _carried(found: Calibration, judged: JudgedSet) -> Array:
    """Return the frames (N, 4, 4) in which rows were measured, in that of the first set-up, the base being one."""
    fit, data = found.fit, judged.data
    if len(fit.machine.frames.bases) == 1 and not data.target_links:
        return np.broadcast_to(np.eye(4), (len(data), 4, 4))
    T = np.array(fit.machine.frames.base @ rigid.inverse(fit.bases_of(data)))
    for name, link in data.target_links.items():
        rows = np.array([data.targets[t] == name for t in data.target])
        tips = fit.robot.with_tip(link).tips(data.readings[rows], fit.deviations, data.conditions.subset(rows))
        T[rows] = fit.machine.frames.base @ tips
    return T


def _turned(found: Calibration, judged: JudgedSet, residuals: Array) -> Array:
    """Return residuals of positions (N, 3) in the axes of the first set-up."""
    return np.asarray((_carried(found, judged)[:, :3, :3] @ residuals[:, :3, None])[:, :, 0])


def _beyond(start: Array, end: Array, times: float) -> Array:
    """Return the pose (4, 4) to which the way from ``start`` to ``end`` leads when it is gone ``times`` times."""
    turn = rigid.log3(start[:3, :3].T @ end[:3, :3])
    return rigid.placement(start[:3, :3] @ rigid.exp3(times * turn), start[:3, 3] + times * (end[:3, 3] - start[:3, 3]))
