"""Collect tables of robots that people have published, for the tests that read them where they lie.

    python scripts/development/peoples_files.py MIRRORS CALIB_DATASETS/peoples_files

MIRRORS has a git directory OWNER+NAME/repo for every repository below. Nothing of them is committed here; the README
that is written beside the files states where each is from. Long tables are cut after 3000 lines.
"""

import subprocess
import sys
from pathlib import Path

LONGEST = 3000
LICENCES = {
    "christianlandgraf/ipa-robot-accuracy": "MIT",
    "thanhndv212/figaroh-plus": "Apache-2.0",
    "thanhndv212/figaroh": "no licence file",
    "platonics-delft/kinematics_calibration": "MIT",
    "icelinker/Robot-Calibration-LaserTracker": "no licence file",
    "RABKKK/LaserTrackerPoseData4KinIdent": "no licence file",
    "cursi36/Kalibrot": "no licence file",
    "neuebot/Kinematic-Calibration": "GPL-3.0",
    "Georgia-Tech-Manufacturing-Institute/multi_robot_calibration": "Apache-2.0",
    "kaidn28/robot-calibration-method": "MIT",
    "Alcatrazee/Robot_calibration": "no licence file",
    "dongjy-s/LM_PyTorch": "no licence file",
}
IPA, PLUS, OLD = "christianlandgraf/ipa-robot-accuracy", "thanhndv212/figaroh-plus", "thanhndv212/figaroh"
DELFT, LASER = "platonics-delft/kinematics_calibration", "icelinker/Robot-Calibration-LaserTracker"
TIAGO = "data/tiago"
FILES = {
    "ipa_a.csv": (IPA, "Series_A/measurements_grid.csv"),
    "ipa_b.csv": (IPA, "Series_B/measurements_joint_configurations.csv"),
    "ipa_b_handeye.csv": (IPA, "Series_B/calibration_handeye.csv"),
    "ipa_c.csv": (IPA, "Series_C/measurements_random_poses.csv"),
    "ipa_d.csv": (IPA, "Series_D/measurements_iso_cubes.csv"),
    "plus_ur10.csv": (PLUS, "examples/ur10/data/calibration.csv"),
    "plus_ur10_simulation.csv": (PLUS, "examples/ur10/data/simulation.csv"),
    "plus_ur10_joints.csv": (PLUS, "examples/ur10/data/identification_q_simulation.csv"),
    "plus_talos.csv": (PLUS, "examples/talos/data/talos_left_arm_02_10_contact.csv"),
    "plus_tiago.csv": (PLUS, "examples/tiago/data/calibration/mocap/qualysis_base_hand_calibration.csv"),
    "plus_tiago_positions.csv": (PLUS, "examples/tiago/data/identification/dynamic/tiago_position.csv"),
    "plus_mate.csv": (PLUS, "examples/mate/data/10_points_in_radians.csv"),
    "plus_mate_x.csv": (PLUS, "examples/mate/data/10_points_x.csv"),
    "plus_mate_poses.csv": (PLUS, "examples/mate/data/transformed_poses.csv"),
    "plus_tx40.csv": (PLUS, "examples/staubli_TX40/data/pos_read_data.csv"),
    "talos_crane.csv": (OLD, "data/talos/talos_feb_arm_02_07_crane.csv"),
    "talos_contact.csv": (OLD, "data/talos/talos_feb_arm_02_10_contact.csv"),
    "talos_no_header.csv": (OLD, "data/talos/talos_feb_arm_2_contact.csv"),
    "talos_right.csv": (OLD, "data/talos/talos_mars_right_arm_04_03_crane.csv"),
    "tiago_pose.csv": (OLD, f"{TIAGO}/exp_data_0924.csv"),
    "tiago_cross_valid.csv": (OLD, f"{TIAGO}/cross_valid.csv"),
    "tiago_64.csv": (OLD, f"{TIAGO}/exp_data_nov_64.csv"),
    "tiago_64_gaps.csv": (OLD, f"{TIAGO}/exp_data_nov_64_2611.csv"),
    "tiago_oct.csv": (OLD, f"{TIAGO}/exp_data_oct.csv"),
    "panda_hole.csv": (DELFT, "data/panda_2/front_center/hole_0.csv"),
    "iiwa_hole.csv": (DELFT, "data/kuka_14/front/hole_0.csv"),
    "gen3_hole.csv": (DELFT, "data/dinova_1/front/hole_0.csv"),
    "panda_hole_pose.csv": (DELFT, "data/panda_2/front_center/hole_0_pose.csv"),
    "irb120_joints.txt": (LASER, "1-Basic Identification/Measurements/joints_SMR_tool.txt"),
    "irb120_smr.txt": (LASER, "1-Basic Identification/Measurements/position_SMR_1.txt"),
    "irb120_measured_joints.txt": (LASER, "3-Full Measurement/Output/Backup/measured_joints.txt"),
    "irb120_measured_smr.txt": (LASER, "3-Full Measurement/Output/Backup/measured_SMR_1.txt"),
    "three_smr.csv": ("RABKKK/LaserTrackerPoseData4KinIdent", "N1N2N3Jval.csv"),
    "kalibrot_points.txt": ("cursi36/Kalibrot", "RealRobotsData/KUKA_IIWA_LBR14/P_KUKA.txt"),
    "neuebot_abb.csv": ("neuebot/Kinematic-Calibration", "ABB/j1.csv"),
    "cmm_points.csv": (
        "Georgia-Tech-Manufacturing-Institute/multi_robot_calibration",
        "python/mr_calibration/data/rob_self_transform.csv",
    ),
    "no_robot.csv": ("kaidn28/robot-calibration-method", "datasets/regression_gt/dataset_05032022.csv"),
    "angles.txt": ("Alcatrazee/Robot_calibration", "data files/data_points_cali/c_angles.txt"),
    "rokae_joints.csv": ("dongjy-s/LM_PyTorch", "data/joint_angle.csv"),
    "rokae_points.csv": ("dongjy-s/LM_PyTorch", "data/laser_pos.csv"),
    "rokae_dh.csv": ("dongjy-s/LM_PyTorch", "data/dh.csv"),
    "iiwa14.urdf": (DELFT, "urdf/iiwa14.urdf"),
    "gen3lite.urdf": (DELFT, "urdf/gen3lite.urdf"),
    "irb120.urdf": (LASER, "2-Configuration Generation/models/IRB120/model.urdf"),
    "mate.urdf": (PLUS, "examples/mate/urdf/mate.urdf"),
    "tx40.urdf": (PLUS, "models/staubli_tx40_description/urdf/tx40_mdh_modified.urdf"),
}


def main(mirrors: Path, target: Path) -> None:
    target.mkdir(parents=True, exist_ok=True)
    lines = [
        "# Tables of robots that people have published\n\n| file | repository | path | licence |\n|---|---|---|---|\n"
    ]
    for name, (repository, path) in FILES.items():
        git = mirrors / repository.replace("/", "+") / "repo"
        if not git.is_dir():
            print(f"{name}: {repository} is not there")
            continue
        show = ["git", f"--git-dir={git}", "show", f"HEAD:{path}"]
        contents = subprocess.run(show, capture_output=True, check=True).stdout
        if name.endswith(".urdf"):
            contents = contents.lstrip()  # one has a blank line before its declaration
        else:
            contents = b"".join(contents.splitlines(keepends=True)[:LONGEST])
        (target / name).write_bytes(contents)
        lines.append(f"| {name} | {repository} | {path} | {LICENCES[repository]} |\n")
    (target / "README.md").write_text("".join(lines))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
