"""The scene of a calibration."""

from collections.abc import Iterator
from typing import Literal

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.errors import PoseError
from calib.foundations.units import DISPLAY_OF
from calib.identification.targets import shapes
from calib.measurement.kinds import size
from calib.presentation.arm import Arm, arm_of
from calib.presentation.scene import Mark, Scene, magnification
from calib.results.calibration import Calibration, JudgedSet
from calib.robot.conditions import Conditions, joined
from calib.robot.robot import Deviations


def scene_of(found: Calibration) -> Scene:
    """Return the scene of a calibration: every row of every table that tells a point, in the job's order.

    A socket's point is where the calibrated robot says it is. Tables of lengths, heights and pixels tell no points:
    where there is nothing else, the calibrated tool's are drawn, without errors.
    """
    fit, robot = found.fit, found.fit.robot
    root = robot.root_in_base
    with_points = [judged for judged in found.sets if size(judged.data.kind) >= 3]
    sets = with_points or list(found.sets)
    readings = np.concatenate([judged.data.readings for judged in sets])
    conditions = joined([judged.data.conditions for judged in sets])
    measured = np.concatenate([_points(found, judged) for judged in sets])
    before = after = measured
    if with_points:
        before = measured - np.concatenate([judged.before[:, :3] for judged in sets])
        after = measured - np.concatenate([judged.after[:, :3] for judged in sets])
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
            name: tool[:3, 3] for name, tool in zip(fit.measurements[0].tools, fit.machine.frames.tools, strict=True)
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
        if shape := known.get(name):
            kind: Literal["point", "plane"] = "point" if shape == "point" else "plane"
            yield Mark("targets", name, kind, T, (0.012 if kind == "point" else 0.08) * extent)


def _points(found: Calibration, judged: JudgedSet) -> Array:
    """Return the points (N, 3) that a table measured, in the instrument's frame."""
    data, fit = judged.data, found.fit
    if data.position is not None:
        return data.position
    placed = fit.machine.frames.base @ data.tips(fit.robot, fit.deviations)
    names = fit.measurements[0].tools
    own = np.array([names.index(tool) for tool in data.tools])[data.tool]
    points = np.asarray((placed @ fit.machine.frames.tools[own])[:, :3, 3])
    return points + judged.after if data.kind == "socket" else points


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
