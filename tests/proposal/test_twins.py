"""What is in this file? The table of twins, each with what is to be read from it."""

from pathlib import Path

import numpy as np
import pytest

import calib
from calib.job.chains import chains
from calib.robot.load import load_robot
from calib.robot.urdf import read_urdf
from tests.proposal.twins import PANDA, TWINS, URDF_OF, XYZ, Expected, Twin, numbered, session, text


@pytest.mark.parametrize("twin", TWINS, ids=lambda twin: twin.name)
def test_twin(twin: Twin, tmp_path: Path) -> None:
    contents = twin.contents()
    file = tmp_path / "table.csv"
    file.write_bytes(contents if isinstance(contents, bytes) else contents.encode())
    urdf = URDF_OF[twin.robot]
    if twin.refuses:
        with pytest.raises(calib.MeasurementError, match=twin.refuses):
            calib.measuring.propose(urdf, [file])
        return
    found = calib.measuring.propose(urdf, [file])
    if twin.asks:
        assert [question.about for question in found.questions][:1] == [twin.asks], found.reasons
        if twin.answers:
            assert not calib.measuring.propose(urdf, [file], **twin.answers).questions
        return
    assert not found.questions, found.questions
    assert twin.expected is not None
    check(found, twin.expected)


def test_the_tip_of_an_arm_may_have_a_name_of_two_words() -> None:
    arms = chains(read_urdf("example:kinova_description/robots/kinova.urdf"))
    assert [arm.tip for arm in arms if len(arm.joints) == 6] == ["j2s6s200_end_effector"]


@pytest.mark.parametrize("urdf", ["baxter_description/urdf/baxter.urdf", "panda_description/urdf/panda.urdf"])
def test_an_arm_has_the_readings_that_move_it_also_behind_fingers_that_follow_others(urdf: str) -> None:
    document = read_urdf(f"example:{urdf}")
    arms = chains(document)
    assert len(arms) > 6
    for arm in arms:
        robot = load_robot(document, arm.tip, arm.base)
        assert tuple(reading.name for reading in robot.readings) == arm.joints


def test_a_column_beside_the_numbered_joints_is_not_taken_for_the_fingers(tmp_path: Path) -> None:
    """The arm with its fingers has a joint more: that many columns are the joints and the one before them."""
    seen = session(PANDA, "panda_hand_tcp")
    contents = [np.arange(len(seen.readings)) * 12.5, np.degrees(seen.readings), 1e3 * seen.position]
    file = tmp_path / "table.csv"
    file.write_text(text(["Zeit", *numbered("J{}", 1, 7), *XYZ], contents))
    found = calib.measuring.propose(URDF_OF["Panda"], [file])
    assert not found.questions, found.questions
    check(found, Expected(numbered("J{}", 1, 7), "deg", XYZ, ignore=["Zeit"]))


def check(found: calib.measuring.Proposal, expected: Expected) -> None:
    (table,) = found.tables
    joints = [reading.name for reading in found.robot.readings]
    columns = {f"{ours} [{expected.angle}]": theirs for ours, theirs in zip(joints, expected.joints, strict=True)}
    columns |= {f"{axis} [{expected.length}]": theirs for axis, theirs in zip("xyz", expected.position, strict=False)}
    if expected.convention == "matrix":
        names = [f"r{i}{j}" for i in "123" for j in "123"]
    else:
        names = [f"r{axis} [{expected.angle}]" for axis in "xyz"] if expected.convention else ["qw", "qx", "qy", "qz"]
    columns |= dict(zip(names, expected.orientation, strict=False))
    columns |= expected.words
    assert dict(table.columns.names) == columns, found.reasons
    assert (table.observes, table.columns.orientation) == (expected.observes, expected.convention)
    if expected.ignore is not None:
        assert sorted(table.columns.ignore) == sorted(expected.ignore)
    assert any(expected.says in reason for reason in found.reasons)
