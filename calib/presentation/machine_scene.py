"""Calibrated machines in space, without measurements: one beside its nominal arm, and a cell of two."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import PoseError, RobotError
from calib.foundations.units import DISPLAY_OF
from calib.machine.calibrated import CalibratedMachine
from calib.machine.identified import usual_conditions
from calib.presentation.scene import Mark, Scene, magnification
from calib.robot.conditions import Conditions
from calib.robot.deviation import axis_frame
from calib.robot.links import Arm, arm_of, link_placements
from calib.robot.load import with_document
from calib.robot.robot import Deviations, Robot
from calib.robot.sampling import closing
from calib.robot.urdf import parse_urdf

if TYPE_CHECKING:
    from calib.compensation.cell import CalibratedCell

# Where joints without limits are led to, in rad and m, and in how many steps.
_WAY = {"angle": np.pi, "length": 0.5}
_STEPS = 9
# Half the length of a drawn axis, in m.
_AXIS = 0.6


def machine_scene(model: CalibratedMachine, mesh_roots: Sequence[Path] = ()) -> Scene:
    """Return the scene of a machine in the instrument's frame: both arms on the calibrated base."""
    robot = model.robot
    rows, readings = sweeps(robot)
    usual = usual_conditions(model, readings)
    root = model.base @ robot.root_in_base
    calibrated = arm_of(robot, model.deviations, readings, root, usual)
    tips = model.base @ robot.tips(readings, model.deviations, usual)
    off = (model.base @ robot.tips(readings, conditions=usual))[:, :3, 3] - tips[:, :3, 3]
    extent = float(np.ptp(np.concatenate([tips[:, :3, 3], root[None, :3, 3]]), axis=0).max())
    nominal, apart = led_apart(robot, model.deviations, readings, usual, lambda _: root, magnification(off, extent))
    own, others = _tools(model)
    points = (tips @ model.tools[next(iter(own))])[:, :3, 3] if own else tips[:, :3, 3]
    return Scene(
        title=f"{robot.urdf.name or robot.urdf.where}: calibrated machine",
        urdf=robot.urdf,
        mesh_roots=tuple(mesh_roots),
        calibrated=calibrated,
        nominal=nominal,
        apart=apart,
        tools=own,
        tools_on=others,
        tip=robot.tip,
        rows=rows,
        measured=points,
        before=points,
        after=points,
        judged=False,
    )


def cell_scene(found: "CalibratedCell", title: str, mesh_roots: Sequence[Path] = ()) -> Scene:
    """Return the scene of a cell, in the arm's base link: the placed machine's joints move, one after the other."""
    model, names = found.model, found.cell.links
    document = parse_urdf(found.cell.document, title)
    robot = with_document(model.robot, document, names, found.cell.joints)
    rows, readings = sweeps(robot)
    arm = arm_of(robot, robot.no_deviations(), readings, found.root)
    links = link_placements(document, arm)
    axes = []
    for i in robot.moving:
        joint = next(joint for joint in document.joints if joint.name == robot.chain[i].name)
        T = found.root @ links[joint.child][0] @ axis_frame(joint.axis)
        axes.append(Mark("axes", joint.name, "axis", T, _AXIS))
    tip = found.root @ links[names[model.robot.tip]]
    own, others = _tools(model)
    points = (tip @ model.tools[next(iter(own))])[:, :3, 3] if own else tip[:, :3, 3]
    return Scene(
        title=title,
        urdf=document,
        mesh_roots=tuple(mesh_roots),
        calibrated=arm,
        nominal=None,
        apart=1.0,
        tools=own,
        tools_on={name: (names[link], point) for name, (link, point) in others.items()},
        tip=names[model.robot.tip],
        rows=rows,
        measured=points,
        before=points,
        after=points,
        marks=tuple(axes),
        judged=False,
    )


def _tools(model: CalibratedMachine) -> tuple[dict[str, Array], dict[str, tuple[str, Array]]]:
    """Return the points (3,) of the tools on the tip link, and on other links, each with its link."""
    tips = {name: model.of(name).robot.tip for name in model.tools}
    own = {name: T[:3, 3] for name, T in model.tools.items() if tips[name] == model.robot.tip}
    return own, {name: (tips[name], T[:3, 3]) for name, T in model.tools.items() if name not in own}


def led_apart(
    robot: Robot,
    d: Deviations,
    readings: Array,
    conditions: Conditions,
    root: Callable[[float], Array],
    apart: float,
) -> tuple[Arm, float]:
    """Return the nominal arm, its difference from the calibrated one taken ``apart`` times, or as often as loops allow.

    ``root``: where the root link is, when the difference is taken so many times. Deviations are led on beyond the
    nominal ones, to first order.
    """
    for times in (*(apart / k for k in (1.0, 2.0, 5.0, 10.0, 100.0) if apart / k > 1.0), 1.0):
        try:
            led = Deviations((1.0 - times) * d.placements, (1.0 - times) * d.offsets, (1.0 - times) * d.terms)
            return arm_of(robot, led, readings, root(times), conditions), times
        except PoseError:  # a loop that does not close so far away
            continue
    raise AssertionError("the nominal robot closed its loops when it was read")


def sweeps(robot: Robot) -> tuple[tuple[str, ...], Array]:
    """Return names and readings (N, nr): all at zero first, then every joint from end to end, the others at zero.

    Without those where a closed loop does not close. Raises RobotError when none is left.
    """
    rows, found = ["all joints at zero"], [np.zeros(len(robot.readings))]
    for j, reading in enumerate(robot.readings):
        way = _WAY[reading.dimension]
        low = -way if reading.lower is None else reading.lower
        high = way if reading.upper is None else reading.upper
        factor, unit = DISPLAY_OF[reading.dimension]
        for q in np.linspace(max(low, -way), min(high, way), _STEPS):
            rows.append(f"{reading.name} at {q * factor:.0f} {unit}")
            found.append(np.where(np.arange(len(robot.readings)) == j, q, 0.0))
    closes = np.flatnonzero(closing(robot, np.array(found)))
    if not len(closes):
        raise RobotError(f"{robot.urdf.where}: its loops close at no pose that would be drawn.")
    return tuple(rows[k] for k in closes), np.array(found)[closes]
