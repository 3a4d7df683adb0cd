"""A calibrated cell in space: both machines, the axes of the one that was placed, and its marks as these turn."""

from collections.abc import Sequence
from pathlib import Path

from calib.compensation.cell import CalibratedCell
from calib.presentation.machine_scene import sweeps
from calib.presentation.scene import Mark, Scene
from calib.robot.deviation import axis_frame
from calib.robot.links import arm_of, link_placements
from calib.robot.load import with_document
from calib.robot.urdf import parse_urdf

# Half the length of a drawn axis, in m.
_AXIS = 0.6


def cell_scene(found: CalibratedCell, title: str, mesh_roots: Sequence[Path] = ()) -> Scene:
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
