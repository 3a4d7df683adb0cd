"""Any arm: simulated calibrations of many robots recover unseen tips, and all their Jacobians are exact."""

import numpy as np
import pytest

import calib
from tests.support import machines
from tests.support.jacobians import check, problem
from tests.support.machines import Machine, anywhere, miss, pose

SIGMA = 0.05e-3
ROWS = 300

# URDF, tip, base, rank for positions with all placements and zeros, base and tool point free.
ARMS = {
    "UR3": ("ur_description/urdf/ur3_robot.urdf", "tool0", None, 27),
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "tool0", None, 27),
    "UR10": ("ur_description/urdf/ur10_robot.urdf", "tool0", None, 27),
    "Panda": ("panda_description/urdf/panda.urdf", "panda_hand_tcp", None, 31),
    "xArm7": ("xarm_description/urdf/xarm7.urdf", "link_eef", None, 31),
    "Kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", None, 27),
    "Z1": ("z1_description/urdf/z1.urdf", "gripperMover", None, 31),
    "SO-100": ("so_arm_description/urdf/so100.urdf", "jaw", None, 27),
    "SO-101": ("so_arm_description/urdf/so101.urdf", "gripper_frame_link", None, 23),
    "TALOS left arm": ("talos_data/robots/talos_full_v2.urdf", "gripper_left_base_link", "torso_2_link", 31),
    "TIAGo": ("tiago_description/robots/tiago.urdf", "arm_tool_link", None, 33),
    "PR2": ("pr2_description/urdf/pr2.urdf", "r_gripper_tool_frame", "torso_lift_link", 31),
    "Baxter": ("baxter_description/urdf/baxter.urdf", "left_gripper", "torso", 31),
    "iCub arm": ("icub_description/robots/icub.urdf", "l_hand_dh_frame", "chest", 31),
}


@pytest.mark.parametrize("name", ARMS)
def test_unseen_tips_are_as_good_as_the_noise_allows(name: str) -> None:
    path, tip, base, rank = ARMS[name]
    urdf, rng = f"example:{path}", np.random.default_rng(4)
    robot, arm = machines.load(urdf, tip, base), machines.arm(urdf, tip, base)
    true = Machine(arm.moved(rng), anywhere(rng), {"tool": pose((0.05, 0.02, 0.15))})
    data = true.measure(robot, arm.draw(rng, ROWS), rng=rng, sigma=SIGMA)
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all"), data)
    assert fit.converged
    assert fit.rank == rank
    assert miss(fit, true, arm.draw(rng, 1000)) < 1.3 * SIGMA * np.sqrt(rank / ROWS)


@pytest.mark.parametrize("observes", ["position", "pose"])
@pytest.mark.parametrize("name", ARMS)
def test_columns_match_central_differences(name: str, observes: str) -> None:
    path, tip, base, _ = ARMS[name]
    check(*problem(f"example:{path}", tip, observes, "pose", rows=2, base=base))
