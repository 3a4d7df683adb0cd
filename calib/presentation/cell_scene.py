"""A calibrated cell in space: both machines, the axes of the one that was placed, and its marks as these turn."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.compensation.cell import CalibratedCell
from calib.foundations.arrays import Array
from calib.foundations.errors import RobotError
from calib.foundations.units import DISPLAY_OF
from calib.presentation.scene import Mark, Scene
from calib.robot.deviation import axis_frame
from calib.robot.links import arm_of, link_placements
from calib.robot.load import with_document
from calib.robot.robot import Robot
from calib.robot.sampling import closing
from calib.robot.urdf import parse_urdf

# Where joints without limits are led to, in rad and m, and in how many steps.
_WAY = {"angle": np.pi, "length": 0.5}
_STEPS = 9
# Half the length of a drawn axis, in m.
_AXIS = 0.6


def cell_scene(found: CalibratedCell, title: str, mesh_roots: Sequence[Path] = ()) -> Scene:
    """Return the scene of a cell, in the arm's base link: the placed machine's joints move, one after the other."""
    model, names = found.model, found.cell.links
    document = parse_urdf(found.cell.document, title)
    robot = with_document(model.robot, document, names, found.cell.joints)
    rows, readings = _sweeps(robot)
    arm = arm_of(robot, robot.no_deviations(), readings, found.root)
    links = link_placements(document, arm)
    axes = []
    for i in robot.moving:
        joint = next(joint for joint in document.joints if joint.name == robot.chain[i].name)
        T = found.root @ links[joint.child][0] @ axis_frame(joint.axis)
        axes.append(Mark("axes", joint.name, "axis", T, _AXIS))
    tip = found.root @ links[names[model.robot.tip]]
    tools = {name: tool[:3, 3] for name, tool in model.tools.items()}
    points = (tip @ next(iter(model.tools.values())))[:, :3, 3]
    return Scene(
        title=title,
        urdf=document,
        mesh_roots=tuple(mesh_roots),
        calibrated=arm,
        nominal=None,
        apart=1.0,
        tools=tools,
        tip=names[model.robot.tip],
        rows=rows,
        measured=points,
        before=points,
        after=points,
        scales=(1.0, 1.0),
        marks=tuple(axes),
        judged=False,
    )


def _sweeps(robot: Robot) -> tuple[tuple[str, ...], Array]:
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
