"""A calibrated cell in space: both machines at zero, and the marks that were touched."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.compensation.cell import CalibratedCell
from calib.presentation.scene import Scene


def cell_scene(found: CalibratedCell, title: str, mesh_roots: Sequence[Path] = ()) -> Scene:
    """Return the scene of a cell, in the arm's base link, all joints at zero; the tools are the positioner's marks."""
    model = found.model
    tip = found.placement @ model.tips(np.zeros((1, len(model.robot.readings))))[0]
    nothing = np.zeros((0, 3))
    return Scene(
        title=title,
        urdf=found.cell.document,
        mesh_roots=tuple(mesh_roots),
        joint_positions={},
        T_world_base=found.root,
        tool_points={name: (tip @ tool)[:3, 3] for name, tool in model.tools.items()},
        tip=found.cell.links[model.robot.tip],
        measured=nothing,
        before=nothing,
        after=nothing,
    )
