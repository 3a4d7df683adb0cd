"""Points and orientations as lists of numbers, as JSON and YAML have them, and poses that are inverse."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.measuring import Proposal
from tests.support.cases import run
from tests.support.people import UR10, angles, quaternions, session

_ARM = """<robot name="small"><link name="l0"/><link name="l1"/><link name="l2"/><link name="l3"/>
<joint name="first" type="continuous"><parent link="l0"/><child link="l1"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
</joint><joint name="second" type="continuous"><parent link="l1"/><child link="l2"/><origin xyz="0.1 0 0"/>
<axis xyz="0 1 0"/></joint><joint name="third" type="continuous"><parent link="l2"/><child link="l3"/>
<origin xyz="0.4 0 0.1"/><axis xyz="1 0 0"/></joint></robot>"""

_SCARA = """<robot name="scara"><link name="base"/><link name="upper"/><link name="fore"/><link name="quill"/>
<link name="flange"/><joint name="first" type="continuous"><parent link="base"/><child link="upper"/>
<origin xyz="0 0 0.3"/><axis xyz="0 0 1"/></joint><joint name="second" type="continuous"><parent link="upper"/>
<child link="fore"/><origin xyz="0.35 0 0.05"/><axis xyz="0 0 1"/></joint><joint name="slide" type="prismatic">
<parent link="fore"/><child link="quill"/><origin xyz="0.3 0 0"/><axis xyz="0 0 -1"/>
<limit lower="0.01" upper="0.15" effort="1" velocity="1"/></joint><joint name="last" type="continuous">
<parent link="quill"/><child link="flange"/><axis xyz="0 0 1"/></joint></robot>"""


def poses() -> np.ndarray:
    """Return what an instrument saw, (40, 4, 4)."""
    s = session()
    T = np.tile(np.eye(4), (40, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = s.rotation, s.position
    return T


def proposal(folder: Path, record: Callable[[int], dict[str, Any]], urdf: str | Path = UR10, n: int = 40) -> Proposal:
    """Return how records are understood that `calib import` makes a table of."""
    (folder / "log.jsonl").write_text("".join(json.dumps(record(k)) + "\n" for k in range(n)))
    assert run("import", str(folder / "log.jsonl"), "-o", str(folder / "log.csv"), "-q")[0] == 0
    return calib.measuring.propose(urdf, [folder / "log.csv"])


def columns(found: Proposal) -> tuple[str, str | None, dict[str, str]]:
    assert not found.questions, found.questions
    (table,) = found.tables
    names = {ours.split(" [")[0]: theirs for ours, theirs in table.columns.names.items()}
    return table.observes, table.columns.orientation, names


def column(vector: np.ndarray) -> list[list[float]]:
    """Return a vector as OpenCV writes one, a list for each number."""
    return vector[:, None].tolist()  # type: ignore[no-any-return]


PLACED: dict[str, tuple[Callable[[np.ndarray], dict[str, Any]], str | None, str, str]] = {
    "position": (lambda T: {"position": T[:3, 3].tolist()}, None, "position_0", ""),
    "position and quaternion": (
        lambda T: {"position": T[:3, 3].tolist(), "orientation": quaternions(T[None, :3, :3], "xyzw")[0].tolist()},
        None,
        "position_0",
        "orientation_3",
    ),
    "rvec and tvec": (
        lambda T: {"rvec": Rotation.from_matrix(T[:3, :3]).as_rotvec().tolist(), "tvec": T[:3, 3].tolist()},
        "rotation_vector",
        "tvec_0",
        "rvec_0",
    ),
    "rvec and tvec of OpenCV": (
        lambda T: {
            "T_cam_target_rvec": column(Rotation.from_matrix(T[:3, :3]).as_rotvec()),
            "T_cam_target_tvec": column(T[:3, 3]),
        },
        "rotation_vector",
        "T_cam_target_tvec_0_0",
        "T_cam_target_rvec_0_0",
    ),
    "translation and euler": (
        lambda T: {"translation": T[:3, 3].tolist(), "euler": angles(T[None, :3, :3], "ZYX")[0].tolist()},
        "ZYX",
        "translation_0",
        "euler_0",
    ),
    "R and t": (
        lambda T: {"R_target2cam": T[:3, :3].tolist(), "t_target2cam": T[:3, 3].tolist()},
        "matrix",
        "t_target2cam_0",
        "R_target2cam_0_0",
    ),
    "a rotation as a whole matrix, and the place apart": (
        lambda T: {"r_mtx": np.where(np.arange(4) < 3, T, np.eye(4)).tolist(), "t_vec": T[:3, 3].tolist()},
        "matrix",
        "t_vec_0",
        "r_mtx_0_0",
    ),
    "sixteen numbers by rows": (lambda T: {"T": T.ravel().tolist()}, "matrix", "T_3", "T_0"),
    "sixteen numbers by columns": (lambda T: {"O_T_EE": T.T.ravel().tolist()}, "matrix", "O_T_EE_12", "O_T_EE_0"),
    "twelve numbers": (lambda T: {"pose": T[:3].ravel().tolist()}, "matrix", "pose_3", "pose_0"),
}


@pytest.mark.parametrize("name", PLACED)
def test_lists_of_numbers_are_points_and_orientations(tmp_path: Path, name: str) -> None:
    of, orientation, x, first = PLACED[name]
    T, q = poses(), session().readings
    observes, found, names = columns(proposal(tmp_path, lambda k: {"joint_pose": q[k].tolist(), **of(T[k])}))
    assert (names["shoulder_pan_joint"], names["x"], found) == ("joint_pose_0", x, orientation)
    assert observes == ("pose" if first else "position")
    assert names.get({"matrix": "r11", None: "qw"}.get(orientation, "rx"), "") == first


def _of_four_joints(folder: Path) -> Path:
    arm = folder / "four.urdf"
    fourth = '<joint name="fourth" type="continuous"><parent link="l3"/><child link="l4"/><origin xyz="0.2 0.1 0"/>'
    arm.write_text(_ARM.replace("</robot>", f'<link name="l4"/>{fourth}<axis xyz="0 0 1"/></joint></robot>'))
    return arm


def test_four_readings_called_q_are_no_quaternion_beside_a_matrix(tmp_path: Path) -> None:
    """The last row of a matrix is of four numbers as well, and none of joints."""
    arm = _of_four_joints(tmp_path)
    s = session(str(arm), "l4")
    T = np.tile(np.eye(4), (40, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = s.rotation, s.position
    observes, orientation, names = columns(
        proposal(tmp_path, lambda k: {"q": s.readings[k].tolist(), "T": T[k].tolist()}, arm)
    )
    assert (observes, orientation) == ("pose", "matrix")
    assert [names[joint] for joint in ("first", "second", "third", "fourth")] == ["q_0", "q_1", "q_2", "q_3"]


@pytest.mark.parametrize("besides", ["dq", "tau"])
def test_four_readings_called_q_are_no_quaternion_beside_velocities_or_torques(tmp_path: Path, besides: str) -> None:
    arm = _of_four_joints(tmp_path)
    s = session(str(arm), "l4")

    def record(k: int) -> dict[str, Any]:
        return {"q": s.readings[k].tolist(), besides: s.readings[-1 - k].tolist(), "position": s.position[k].tolist()}

    observes, _, names = columns(proposal(tmp_path, record, arm))
    assert observes == "position"
    assert [names[joint] for joint in ("first", "second", "third", "fourth")] == ["q_0", "q_1", "q_2", "q_3"]


def test_the_unit_of_a_short_slide_is_known_where_another_fits_far_worse(tmp_path: Path) -> None:
    """A slide of 0.14 m that seems to stand still leaves less than a tenth of what an arm of 0.7 m moves."""
    arm = tmp_path / "scara.urdf"
    arm.write_text(_SCARA)
    s = session(str(arm), "flange")
    assert 0.1 < np.ptp(s.readings[:, 2]) < 0.15
    found = proposal(tmp_path, lambda k: {"joints": s.readings[k].tolist(), "p": s.position[k].tolist()}, arm)
    assert not found.questions, found.questions
    (table,) = found.tables
    assert [ours for ours, theirs in table.columns.names.items() if theirs == "joints_2"] == ["slide [m]"]


def test_cells_of_a_matrix_by_columns_are_those_of_the_rotation(tmp_path: Path) -> None:
    T, q = poses(), session().readings
    _, _, names = columns(proposal(tmp_path, lambda k: {"q": q[k].tolist(), "T": T[k].T.ravel().tolist()}))
    assert [names[f"r{i}{j}"] for i in (1, 2, 3) for j in (1, 2, 3)] == [
        f"T_{i + 4 * j}" for i in range(3) for j in range(3)
    ]


@pytest.mark.parametrize("called", ["joints", "position", "angle", "theta"])
def test_three_numbers_may_be_the_joints_of_an_arm_that_has_three(tmp_path: Path, called: str) -> None:
    (tmp_path / "arm.urdf").write_text(_ARM)
    arm = calib.load_robot(tmp_path / "arm.urdf")
    q = np.random.default_rng(3).uniform(-1.5, 1.5, (40, 3))
    seen = arm.tips(q) @ (0.05, 0.02, 0.1, 1.0) + 1e-3 * np.random.default_rng(4).standard_normal((40, 4))
    found = proposal(tmp_path, lambda k: {called: q[k].tolist(), "tcp": seen[k, :3].tolist()}, tmp_path / "arm.urdf")
    observes, _, names = columns(found)
    assert (observes, names["third"], names["z"]) == ("position", f"{called}_2", "tcp_2")
    assert not any("no orientation" in reason for reason in found.reasons)


INVERSE: dict[str, Callable[[np.ndarray], dict[str, Any]]] = {
    "a matrix": lambda T: {"T": T.tolist()},
    "vectors": lambda T: {"rvec": Rotation.from_matrix(T[:3, :3]).as_rotvec().tolist(), "tvec": T[:3, 3].tolist()},
    "a quaternion": lambda T: {
        "position": T[:3, 3].tolist(),
        "quaternion": quaternions(T[None, :3, :3], "xyzw")[0].tolist(),
    },
    "angles": lambda T: (
        {"x": 1e3 * T[0, 3], "y": 1e3 * T[1, 3], "z": 1e3 * T[2, 3]}
        | dict(zip(("a", "b", "c"), angles(T[None, :3, :3], "abc")[0].tolist(), strict=True))
    ),
}


@pytest.mark.parametrize("name", INVERSE)
def test_poses_of_what_a_camera_on_the_arm_sees_are_told(tmp_path: Path, name: str) -> None:
    T, q = np.linalg.inv(poses()), session().readings
    found = proposal(tmp_path, lambda k: {"q": np.degrees(q[k]).tolist(), **INVERSE[name](T[k])})
    (question,) = found.questions
    assert "are inverse (of the instrument in the tool" in question.text
    assert "is it this robot" not in question.text


def test_what_was_computed_does_not_hide_poses_that_are_inverse(tmp_path: Path) -> None:
    T, s = np.linalg.inv(poses()), session()
    found = proposal(
        tmp_path,
        lambda k: {"q": s.readings[k].tolist(), "O_T_EE": s.flange[k].ravel().tolist(), "T_cam": T[k].tolist()},
    )
    (question,) = found.questions
    assert "the poses T_cam_0_3, T_cam_1_3, T_cam_2_3 with" in question.text


def test_of_poses_alone_the_computed_ones_are_taken_with_a_remark(tmp_path: Path) -> None:
    s = session()
    found = proposal(tmp_path, lambda k: {"q": s.readings[k].tolist(), "O_T_EE": s.flange[k].ravel().tolist()})
    assert columns(found)[2]["x"] == "O_T_EE_3"
    assert any("a calibration would find nothing" in reason for reason in found.reasons)


def test_a_point_that_never_changes_is_named_with_an_option_that_there_is(tmp_path: Path) -> None:
    q = session().readings
    found = proposal(tmp_path, lambda k: {"q": q[k].tolist(), "position": [0.1, 0.2, 0.3]})
    (question,) = found.questions
    assert question.sentence.endswith("never change, and nothing else is a point; answer by --column 'x=TITLE'.")


def test_readings_in_degrees_and_in_radians_are_the_same(tmp_path: Path) -> None:
    T, q = poses(), session().readings

    def record(k: int) -> dict[str, Any]:
        return {"joints_deg": np.degrees(q[k]).tolist(), "joints_rad": q[k].tolist(), "tvec_m": T[k, :3, 3].tolist()}

    found = proposal(tmp_path, record)
    assert columns(found)[2]["x"] == "tvec_m_0"
    assert len([reason for reason in found.reasons if "are the same readings as joints_" in reason]) == 1


def test_a_point_beside_the_matrix_that_has_it_is_the_same(tmp_path: Path) -> None:
    T, q = poses(), session().readings
    found = proposal(
        tmp_path, lambda k: {"joints": q[k].tolist(), "tvec_m": T[k, :3, 3].tolist(), "T_board": T[k].tolist()}
    )
    observes, orientation, names = columns(found)
    assert (observes, orientation, names["x"]) == ("pose", "matrix", "T_board_0_3")
    assert any("are the same point as T_board_0_3" in reason for reason in found.reasons)


def test_poses_of_hand_and_board_without_joints_are_refused_as_such(tmp_path: Path) -> None:
    """As MoveIt keeps samples: sixteen numbers of a placement are no joints."""
    T = poses()

    def record(k: int) -> dict[str, Any]:
        return {"effector_wrt_world": T[k].ravel().tolist(), "object_wrt_sensor": T[-k].ravel().tolist()}

    with pytest.raises(calib.MeasurementError, match="no column is a joint of the arm"):
        proposal(tmp_path, record)
