"""Files that people have published, read where they lie (scripts/development/peoples_files.py), with what each holds.

Expected is what their authors say of them: the joints' unit, the columns of the point and its unit, and the convention;
or what is to be asked; or that they are refused, since no joints are in them.
"""

import os
from pathlib import Path
from typing import NamedTuple

import pytest

import calib
from tests.support.people import PANDA, UR10

FOLDER = Path(os.environ.get("CALIB_DATASETS", "")) / "peoples_files"
TALOS = "example:talos_data/robots/talos_reduced.urdf"
TIAGO = "example:tiago_description/robots/tiago.urdf"


class Held(NamedTuple):
    file: str
    urdf: str
    observes: str = ""
    joints: str = ""  # unit of the angles, and the titles of the first and the last joint
    point: str = ""  # unit, and the title of x
    orientation: str | None = None
    asks: str = ""
    refuses: str = ""


IPA = "rad shoulder_pan_joint wrist_3_joint"
FILES = [
    *(Held(f"ipa_{k}.csv", UR10, "pose", IPA, "mm measurement_x", "XYZ") for k in "abcd"),
    Held("ipa_b_handeye.csv", UR10, refuses="no column is a joint"),
    Held("plus_ur10.csv", UR10, "pose", IPA, "m x1", "xyz"),
    Held("plus_ur10_simulation.csv", UR10, "pose", IPA, "m x1", "xyz"),
    Held("plus_ur10_joints.csv", UR10, asks="observes"),
    Held("plus_talos.csv", TALOS, "position", "rad torso_1_joint arm_left_7_joint", "m x1"),
    Held("talos_crane.csv", TALOS, "position", "rad torso1 armL7", "m x1"),
    Held("talos_contact.csv", TALOS, "position", "rad torso1 armL7", "m x1"),
    Held("talos_no_header.csv", TALOS, "position", "rad column+5 column+13", "m column+2"),
    Held("talos_right.csv", TALOS, "position", "rad torso1 armR7", "m x1"),
    Held("plus_tiago.csv", TIAGO, asks="position"),
    Held("plus_tiago_positions.csv", TIAGO, asks="observes"),
    Held("tiago_64.csv", TIAGO, asks="position"),
    Held("tiago_64_gaps.csv", TIAGO, asks="position"),
    Held("tiago_oct.csv", TIAGO, asks="position"),
    Held("tiago_cross_valid.csv", TIAGO, "position", "rad torso arm7", "m x"),
    Held("tiago_pose.csv", TIAGO, asks="joints"),
    Held("plus_mate.csv", "mate.urdf", asks="columns"),
    Held("plus_mate_x.csv", "mate.urdf", asks="observes"),
    Held("plus_mate_poses.csv", "mate.urdf", asks="zeros"),
    Held("plus_tx40.csv", "tx40.urdf", asks="observes"),
    Held("panda_hole.csv", PANDA, asks="observes"),
    Held("panda_hole_pose.csv", PANDA, asks="observes"),
    Held("iiwa_hole.csv", "iiwa14.urdf", asks="observes"),
    Held("gen3_hole.csv", "gen3lite.urdf", asks="observes"),
    Held("irb120_joints.txt", "irb120.urdf", asks="observes"),
    Held("irb120_measured_joints.txt", "irb120.urdf", asks="observes"),
    Held("irb120_smr.txt", "irb120.urdf", refuses="no column is a joint"),
    Held("irb120_measured_smr.txt", "irb120.urdf", refuses="no column is a joint"),
    Held("kalibrot_points.txt", "iiwa14.urdf", refuses="no column is a joint"),
    Held("neuebot_abb.csv", UR10, refuses="no column is a joint"),
    Held("cmm_points.csv", UR10, refuses="no column is a joint"),
    Held("no_robot.csv", UR10, refuses="no column is a joint"),
    Held("three_smr.csv", UR10, refuses="no column is a joint"),
    Held("angles.txt", UR10, refuses="cells and this row has"),
]


@pytest.mark.skipif(not FOLDER.is_dir(), reason="CALIB_DATASETS names no folder with peoples_files")
@pytest.mark.parametrize("held", FILES, ids=lambda held: held.file)
def test_published_file(held: Held) -> None:
    urdf = held.urdf if held.urdf.startswith("example:") else str(FOLDER / held.urdf)
    if held.refuses:
        with pytest.raises(calib.MeasurementError, match=held.refuses):
            calib.measuring.propose(urdf, [FOLDER / held.file])
        return
    found = calib.measuring.propose(urdf, [FOLDER / held.file])
    assert [question.about for question in found.questions] == ([held.asks] if held.asks else [])
    if held.asks:
        return
    (table,) = found.tables
    names = table.columns.names
    angle, first, last = held.joints.split()
    length, x = held.point.split()
    turning = [reading.name for reading in found.robot.readings if reading.dimension == "angle"]
    assert names[f"{turning[-1]} [{angle}]"] == last.replace("+", " ")
    assert next(iter(names.values())) == first.replace("+", " ")
    assert names[f"x [{length}]"] == x.replace("+", " ")
    assert (table.observes, table.columns.orientation) == (held.observes, held.orientation)
