"""Where all links are, those beside the arm too."""

from pathlib import Path

import numpy as np
import pytest

import calib
from calib.robot.collision import self_collision
from calib.robot.links import arm_of, link_placements

BALL = '<collision><origin xyz="0 0 0.1"/><geometry><sphere radius="0.02"/></geometry></collision>'
POST = BALL.replace('"0 0 0.1"', '"0.045 0 0.1"').replace("0.02", "0.01")
GRIPPER = f"""<robot name="gripper">
  <link name="floor">{POST}</link><link name="waist"/><link name="arm"/>
  <link name="left">{BALL}</link><link name="right">{BALL}</link>
  <joint name="turn" type="revolute"><parent link="floor"/><child link="waist"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="spin" type="revolute"><parent link="waist"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="open" type="prismatic"><parent link="arm"/><child link="left"/><axis xyz="1 0 0"/>
    <limit lower="LOWER" upper="0.08" effort="1" velocity="1"/></joint>
  <joint name="close" type="prismatic"><parent link="arm"/><child link="right"/><axis xyz="-1 0 0"/>
    <limit lower="0" upper="0.08" effort="1" velocity="1"/><mimic joint="open" multiplier="0.5" offset="0.01"/></joint>
</robot>"""


@pytest.mark.parametrize("lower", [-0.05, 0.03])
def test_joints_beside_the_arm_rest_within_their_limits_and_drive_what_mimics_them(
    lower: float, tmp_path: Path
) -> None:
    (tmp_path / "gripper.urdf").write_text(GRIPPER.replace("LOWER", str(lower)), encoding="utf-8")
    robot = calib.load_robot(tmp_path / "gripper.urdf", tip="arm")
    q = np.array([[0.0, 0.0], [1.0, np.pi / 2.0 - 1.0]])
    placed = link_placements(robot.urdf, arm_of(robot, robot.no_deviations(), q, np.eye(4)))
    rest = max(lower, 0.0)
    expected = np.array([[rest, 0.0, 0.0], [0.0, rest, 0.0]])
    np.testing.assert_allclose(placed["left"][:, :3, 3], expected, atol=1e-15)
    other = -(0.5 * rest + 0.01)
    np.testing.assert_allclose(placed["right"][:, :3, 3], [[other, 0.0, 0.0], [0.0, other, 0.0]], atol=1e-15)
    assert self_collision(robot).colliding(q).tolist() == [lower > 0.0, False]
