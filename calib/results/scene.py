"""The scene of a calibration."""

from collections.abc import Iterator
from typing import Literal

import numpy as np

from calib.assessment.judged import JudgedSet
from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.errors import PoseError
from calib.foundations.units import DISPLAY_OF
from calib.identification.targets import shapes
from calib.measurement.kinds import size
from calib.presentation.scene import Mark, Scene, magnification
from calib.results.calibration import Calibration
from calib.robot.conditions import Conditions, joined
from calib.robot.links import Arm, arm_of
from calib.robot.robot import Deviations


def scene_of(found: Calibration) -> Scene:
    """Return the scene of a calibration: every row of every table that tells a point, in the job's order.

    All is drawn in the instrument's frame of the first set-up: from others it is carried there with the robot's base. A
    socket's point is where the calibrated robot says it is. Tables of lengths, heights and pixels tell no points:
    where there is nothing else, the calibrated tool's are drawn, without errors.
    """
    fit, robot = found.fit, found.fit.robot
    root = robot.root_in_base
    known = [judged for judged in found.sets if fit.knows(judged.data)]
    with_points = [judged for judged in known if size(judged.data.kind) >= 3]
    sets = with_points or known
    readings = np.concatenate([judged.data.readings for judged in sets])
    conditions = joined([judged.data.conditions for judged in sets])
    measured = np.concatenate([_points(found, judged) for judged in sets])
    before = after = measured
    if with_points:
        before = measured - np.concatenate([_turned(found, judged, judged.before) for judged in sets])
        after = measured - np.concatenate([_turned(found, judged, judged.after) for judged in sets])
    calibrated = arm_of(robot, fit.deviations, readings, fit.machine.frames.base @ root, conditions)
    extent = float(np.ptp(np.concatenate([measured, calibrated.root[None, :3, 3]]), axis=0).max())
    scales = magnification(before - measured, extent), magnification(after - measured, extent)
    nominal, apart = _nominal(found, readings, conditions, root, scales[0])
    return Scene(
        title=f"{robot.urdf.name or robot.urdf.where}: calibration",
        urdf=robot.urdf,
        mesh_roots=found.origin.mesh_roots,
        calibrated=calibrated,
        nominal=nominal,
        apart=apart,
        tools={
            name: tool[:3, 3]
            for name, tool in zip(fit.measurements[0].tools, fit.machine.frames.tools, strict=True)
            if name not in fit.tool_tips
        },
        tip=robot.tip,
        rows=tuple(f"{judged.file} line {line}" for judged in sets for line in judged.data.lines),
        measured=measured,
        before=before,
        after=after,
        scales=scales,
        marks=tuple(_targets(found, extent)),
        judged=bool(with_points),
        joints=tuple((reading.name, DISPLAY_OF[reading.dimension].symbol) for reading in robot.readings),
        readings=readings * [DISPLAY_OF[reading.dimension].times for reading in robot.readings],
    )


def _targets(found: Calibration, extent: float) -> Iterator[Mark]:
    """Yield the sockets, anchors, balls, planes, boards and cameras where the calibration has found them."""
    fit = found.fit
    known = shapes(fit.measurements)
    for name, T in zip(fit.measurements[0].targets, fit.machine.frames.targets, strict=True):
        shape = known.get(name)
        if shape and name not in fit.measurements[0].target_links:
            kind: Literal["point", "plane"] = "point" if shape == "point" else "plane"
            yield Mark("targets", name, kind, T, (0.012 if kind == "point" else 0.08) * extent)


def _points(found: Calibration, judged: JudgedSet) -> Array:
    """Return the points (N, 3) that a table measured, in the instrument's frame of the first set-up."""
    data, fit = judged.data, found.fit
    if data.position is not None:
        T = _carried(found, judged)
        return np.asarray((T[:, :3, :3] @ data.position[:, :, None])[:, :, 0] + T[:, :3, 3])
    placed = fit.machine.frames.base @ data.tips(fit.robot, fit.deviations)
    points = np.asarray((placed @ fit.tools_of(data))[:, :3, 3])
    return points + _turned(found, judged, judged.after) if data.kind == "socket" else points


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


def _nominal(
    found: Calibration, readings: Array, conditions: Conditions, root: Array, apart: float
) -> tuple[Arm, float]:
    """Return the nominal arm, its difference from the calibrated one taken ``apart`` times, or as often as loops allow.

    Deviations and base are led on beyond the nominal ones, to first order, so that its tool goes to where the errors
    before calibration, drawn as often, end.
    """
    fit = found.fit
    for times in (*(apart / k for k in (1.0, 2.0, 5.0, 10.0, 100.0) if apart / k > 1.0), 1.0):
        d = fit.deviations
        try:
            led = Deviations((1.0 - times) * d.placements, (1.0 - times) * d.offsets, (1.0 - times) * d.terms)
            base = _beyond(fit.machine.frames.base, fit.nominal.frames.base, times)
            return arm_of(fit.robot, led, readings, base @ root, conditions), times
        except PoseError:  # a loop that does not close so far away
            continue
    raise AssertionError("the nominal robot closed its loops when it was read")


def _beyond(start: Array, end: Array, times: float) -> Array:
    """Return the pose (4, 4) to which the way from ``start`` to ``end`` leads when it is gone ``times`` times."""
    turn = rigid.log3(start[:3, :3].T @ end[:3, :3])
    return rigid.placement(start[:3, :3] @ rigid.exp3(times * turn), start[:3, 3] + times * (end[:3, 3] - start[:3, 3]))
