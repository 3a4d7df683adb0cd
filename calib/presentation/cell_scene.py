"""A calibrated cell in space: both machines at zero, and the marks that were touched."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.compensation.cell import CalibratedCell
from calib.presentation.arm import arm_of
from calib.presentation.scene import Scene
from calib.robot.load import load_robot
from calib.robot.urdf import parse_urdf


def cell_scene(found: CalibratedCell, title: str, mesh_roots: Sequence[Path] = ()) -> Scene:
    """Return the scene of a cell, in the arm's base link, all joints at zero; the tools are the positioner's marks."""
    model = found.model
    robot = load_robot(parse_urdf(found.cell.document, "the cell"), found.cell.links[model.robot.tip])
    arm = arm_of(robot, robot.no_deviations(), np.zeros((1, len(robot.readings))), found.root)
    nothing = np.zeros((0, 3))
    return Scene(
        title=title,
        urdf=robot.urdf,
        mesh_roots=tuple(mesh_roots),
        calibrated=arm,
        nominal=None,
        apart=1.0,
        tools={name: tool[:3, 3] for name, tool in model.tools.items()},
        tip=robot.tip,
        rows=(),
        measured=nothing,
        before=nothing,
        after=nothing,
        scales=(1.0, 1.0),
    )
