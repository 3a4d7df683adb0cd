"""How the pose of a tool follows the state of a machine, whether it was calibrated or is only planned."""

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.identification.machine import Layout, Machine
from calib.robot.conditions import Conditions
from calib.robot.robot import Robot, TipModel, TipMotion


def tool_poses(robot: Robot, at: Machine, readings: Array, conditions: Conditions, tool: int = 0) -> Array:
    """Return the poses (N, 4, 4) of a tool in the instrument's frame at readings (N, nr), in rad and m."""
    tips = TipModel(robot, at.deviations).tips(readings, conditions)
    return np.asarray(at.frames.base @ tips @ at.frames.tools[tool])


def tool_jacobian(robot: Robot, at: Machine, readings: Array, conditions: Conditions, tool: int = 0) -> Array:
    """Return how the pose of a tool follows the state of a machine (N, 6, n), at readings (N, nr), in rad and m.

    Rows: position in the instrument's axes, in m, and small turns about the tool's axes, in rad. Columns: as
    :class:`calib.identification.machine.Layout` has them.
    """
    motion = TipModel(robot, at.deviations).motion(readings, conditions)
    return jacobian_of(motion, Layout.of(robot, at.frames), at, tool)


def jacobian_of(motion: TipMotion, layout: Layout, at: Machine, tool: int = 0) -> Array:
    """Return :func:`tool_jacobian` where the motion of the tip is known already."""
    T_tool = at.frames.tools[tool]
    placed = motion.placement @ T_tool
    J = np.zeros((len(placed), 6, layout.size))
    # Local twists of the tip, then of the tool.
    J[:, :, : layout.terms] = motion.by_deviations
    J[:, :, layout.terms : layout.base] = motion.by_terms
    J[:, :, : layout.base] = rigid.adjoint(rigid.inverse(T_tool)) @ J[:, :, : layout.base]
    # The first set-up is the one that is looked at.
    J[:, :, layout.base : layout.base + 6] = rigid.adjoint(rigid.inverse(placed)) @ at.base_twists[0]
    J[:, :, layout.tools + 6 * tool : layout.tools + 6 * tool + 6] = at.tool_twists[tool]
    J[:, :3] = (at.frames.base @ placed)[:, :3, :3] @ J[:, :3]
    return J
