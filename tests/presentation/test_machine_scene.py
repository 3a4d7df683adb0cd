"""The scene of a machine without measurements."""

import re

import numpy as np

import calib
from calib.presentation.machine_scene import machine_scene
from calib.presentation.scene import render_scene

UR5 = "example:ur_description/urdf/ur5_robot.urdf"


def test_a_machine_is_drawn_with_the_meshes_that_lie_where_its_urdf_was_read() -> None:
    robot = calib.load_robot(UR5, tip="tool0")
    machine = calib.CalibratedMachine(robot, robot.no_deviations(), np.eye(4), {"tool": np.eye(4)})
    page, sticks = calib.scene(machine), render_scene(machine_scene(machine))
    told = re.compile(r"(\d+) shapes? not found")
    assert told.search(page) is None
    assert told.search(sticks).group(1) == "7"  # type: ignore[union-attr]
    assert len(page) > 1.2 * len(sticks)
