"""What is in this file? The table of twins, each with what is to be read from it."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.job.chains import chains
from calib.robot.load import load_robot
from calib.robot.urdf import read_urdf
from tests.proposal.twins import PANDA, TWINS, UR, UR10, URDF_OF, XYZ, Expected, Twin, numbered, session, text


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


def test_columns_without_names_are_found_by_what_fits_and_taken_as_answered(tmp_path: Path) -> None:
    """As a tracker's points of three reflectors and what a controller logs: no place in the row says what is what."""
    seen = session(UR10, "tool0")
    moved = np.einsum("nij,kj->nki", seen.rotation, [[0.0, 0.1, 0.0], [0.1, 0.0, 0.05]]).reshape(-1, 6)
    points = 1e3 * (np.hstack([seen.position, seen.position, seen.position]) + np.hstack([np.zeros((40, 3)), moved]))
    zeros = np.zeros((40, 6))
    file = tmp_path / "table.csv"
    file.write_text(text(None, [points, zeros, np.degrees(seen.readings)]))
    (asked,) = calib.measuring.propose(URDF_OF["UR10"], [file]).questions
    assert asked.about == "position"
    assert [one.split("=")[1] for one in asked.choices] == ["column 1'", "column 4'", "column 7'"]
    joints = {f"{name} [deg]": f"column {k}" for k, name in enumerate(UR, 16)}
    point = dict(zip("xyz", numbered("column {}", 4, 3), strict=True))
    for answers in ({"x": "column 4"}, joints | point):
        found = calib.measuring.propose(URDF_OF["UR10"], [file], columns=answers)
        assert not found.questions, found.questions
        check(found, Expected(numbered("column {}", 16), "deg", numbered("column {}", 4, 3)))


def test_columns_without_names_that_do_not_fit_are_to_be_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    file = tmp_path / "table.csv"
    file.write_text(text(None, [rng.uniform(-90.0, 90.0, (40, 6)), rng.uniform(-900.0, 900.0, (40, 9))]))
    with pytest.raises(calib.MeasurementError, match=r"say which by columns, or --column 'shoulder_pan_joint \[deg\]"):
        calib.measuring.propose(URDF_OF["UR10"], [file])


def test_an_orientation_is_found_behind_a_point_that_was_answered(tmp_path: Path) -> None:
    """Nominal poses before the measured ones, and how far both are apart."""
    seen = session(UR10, "tool0")
    turned = np.degrees(Rotation.from_matrix(seen.rotation).as_euler("xyz"))
    pose = np.hstack([1e3 * seen.position, turned])
    file = tmp_path / "table.csv"
    nominal, apart = np.round(pose, 0), np.random.default_rng(0).uniform(0.0, 0.1, (40, 2))
    file.write_text(text(None, [["j"] * 40, np.degrees(seen.readings), nominal, pose, apart]))
    answers = {f"{name} [deg]": f"column {k}" for k, name in enumerate(UR, 2)}
    answers |= dict(zip("xyz", numbered("column {}", 14, 3), strict=True))
    found = calib.measuring.propose(URDF_OF["UR10"], [file], columns=answers)
    assert not found.questions, found.questions
    check(
        found,
        Expected(
            numbered("column {}", 2),
            "deg",
            numbered("column {}", 14, 3),
            orientation=numbered("column {}", 17, 3),
            convention="xyz",
            observes="pose",
        ),
    )


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


def test_a_place_may_be_called_as_its_rotation_is(tmp_path: Path) -> None:
    """As a published log of a controller has it: px_r beside rx_r."""
    seen = session(UR10, "tool0")
    turned = Rotation.from_matrix(seen.rotation).as_rotvec()
    titles = [*numbered("q{}"), "px_r", "py_r", "pz_r", "rx_r", "ry_r", "rz_r"]
    (tmp_path / "table.csv").write_text(text(titles, [seen.readings, seen.position, turned]))
    found = calib.measuring.propose(URDF_OF["UR10"], [tmp_path / "table.csv"])
    assert not found.questions, found.questions
    names = found.tables[0].columns.names
    assert (names["x [m]"], names["rz [rad]"]) == ("px_r", "rz_r")
    assert found.tables[0].columns.orientation == "rotation_vector"
