"""A robot: the arm between two links, what its readings and deviations do, and which arms are refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.foundations.errors import RobotError
from calib.foundations.rigid import inverse
from calib.robot.load import load_robot
from calib.robot.robot import Deviations, Robot, segments
from calib.robot.skeleton import Outline
from calib.robot.sources import examples
from calib.robot.urdf import parse_urdf, read_urdf
from tests.support import machines

UNREADABLE = {
    "example:alex_description/urdf/alex_psyonic_hands.urdf",
    "example:ur_description/urdf/ur3.urdf",
}


def robot(*elements: str) -> str:
    return f'<robot name="r">{"".join(elements)}</robot>'


def links(names: str) -> str:
    return "".join(f'<link name="{name}"/>' for name in names)


def joint(parent: str, child: str, kind: str = "revolute", inside: str = "") -> str:
    return (
        f'<joint name="{parent}{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'
    )


def load(text: str, tip: str | None = None, base: str | None = None) -> Robot:
    return load_robot(parse_urdf(text.encode(), "arm.urdf"), tip, base)


# ---- the arm


@pytest.mark.parametrize("name", sorted(set(examples()) - UNREADABLE))
def test_every_tip_of_every_example_is_where_yourdfpy_and_numpy_put_it(name: str) -> None:
    document = read_urdf(name)
    carriers = {joint.parent for joint in document.joints}
    for tip in (link for link in document.links if link not in carriers):
        arm = machines.arm(name, tip)
        if not arm.ranges:
            with pytest.raises(RobotError, match=r"no joint moves between .*; choose another tip\.$"):
                load_robot(document, tip)
            continue
        loaded = load_robot(document, tip)
        assert [reading.name for reading in loaded.readings] == list(arm.ranges)
        readings = arm.draw(np.random.default_rng(0), 3)
        np.testing.assert_allclose(loaded.tips(readings), arm.tips(readings), atol=1e-13)


def test_base_and_tip_choose_a_branch() -> None:
    talos = "example:talos_data/robots/talos_full_v2.urdf"
    arm = load_robot(talos, tip="gripper_left_base_link", base="torso_2_link")
    assert [j.name for j in arm.chain[:7]] == [f"arm_left_{k}_joint" for k in range(1, 8)]
    readings = np.random.default_rng(0).uniform(-1, 1, (3, 7))
    expected = machines.arm(talos, "gripper_left_base_link", "torso_2_link").tips(readings)
    np.testing.assert_allclose(arm.tips(readings), expected, atol=1e-13)


def test_the_only_leaf_is_the_tip_unless_another_is_named() -> None:
    assert load(machines.INLINE["scara"]).tip == "tip"
    assert load(machines.INLINE["scara"], tip="link_elbow").tip == "link_elbow"


def test_readings_have_the_dimension_and_the_limits_of_their_joints() -> None:
    arm = load(machines.INLINE["scara"])
    assert [(r.name, r.dimension, r.lower, r.upper) for r in arm.readings] == [
        ("shoulder", "angle", -2.6, 2.8),
        ("elbow", "angle", -2.6, 2.8),
        ("quill", "length", -0.1, 0.7),
        ("spin", "angle", None, None),
    ]


def test_a_mimic_joint_has_no_reading_and_follows_its_driver_even_from_outside_the_arm() -> None:
    text = robot(
        links("abcd"),
        joint("a", "b"),
        joint("a", "c", "prismatic", '<mimic joint="ab" multiplier="2" offset="0.5"/>'),
        joint("c", "d", "continuous", '<mimic joint="ac" multiplier="-3"/>'),
    )
    arm = load(text, tip="d")
    assert [(r.name, r.dimension) for r in arm.readings] == [("ab", "angle")]
    np.testing.assert_allclose(arm.joint_positions(np.array([[0.1]])), [[0.7, -2.1]], rtol=1e-15)


def test_the_offset_of_a_driver_moves_what_follows_it_and_that_of_a_follower_only_itself() -> None:
    arm = load(machines.INLINE["mimic"])
    q = arm.joint_positions(
        np.zeros((1, 6)), Deviations(np.zeros((len(arm.chain), 6)), np.array([0.0, 0.2, 0.03, 0, 0, 0, 0]))
    )
    np.testing.assert_allclose(q, [[0.0, 0.2, -0.2 + 0.1 + 0.03, 0, 0, 0, 0]], atol=1e-16)


def test_the_reach_bounds_how_far_the_tip_comes() -> None:
    # Links of 0.4 + 0.353 + 0.3 + 0.1 m and a quill that slides up to 0.7 m.
    assert load(machines.INLINE["scara"]).reach == pytest.approx(0.4 + np.hypot(0.35, 0.05) + 0.3 + 0.1 + 0.7)


def test_the_reach_at_readings_counts_slides_as_far_as_they_are_out() -> None:
    arm, links = load(machines.INLINE["scara"]), 0.4 + np.hypot(0.35, 0.05) + 0.3 + 0.1
    readings = np.zeros((2, len(arm.readings)))
    assert arm.reach_at(readings) == arm.reach_at(readings[:0]) == pytest.approx(links)
    readings[:, [reading.name for reading in arm.readings].index("quill")] = 0.2, -0.3
    assert arm.reach_at(readings) == pytest.approx(links + 0.3)


def test_the_frame_of_the_base_link_is_the_root() -> None:
    arm = load(machines.INLINE["scara"])
    frame = Outline(segments(arm)).skeleton(np.full((len(arm.chain), 6), 0.1)).end_frame(-1)
    assert frame.joint == -1
    np.testing.assert_array_equal(frame.placement, np.eye(4))


# ---- deviations


@pytest.mark.parametrize("name", machines.INLINE)
def test_a_deviation_is_a_motion_in_the_frame_whose_z_is_the_axis(name: str) -> None:
    """Origin P Trans Rx Ry Rz P^-1 in the URDF's own frames, large values too."""
    arm, text = load(machines.INLINE[name]), machines.INLINE[name]
    rng = np.random.default_rng(3)
    d = Deviations(rng.uniform(-0.5, 0.5, (len(arm.chain), 6)), rng.uniform(-0.5, 0.5, len(arm.moving)))
    true = machines.arm(text, "tip")
    offset = dict(zip((arm.chain[i].name for i in arm.moving), d.offsets, strict=True))
    joints = []
    for there, own, e in zip(true.joints, arm.chain, d.placements, strict=True):
        E = machines.pose(e[:3], Rotation.from_euler("XYZ", e[3:]).as_rotvec())
        shift = there.shift
        if there.type != "fixed":
            np.testing.assert_allclose(own.frame[:3, 2], there.axis, atol=1e-15)
            follows = there.driver != there.name
            shift += there.multiplier * offset[there.driver] + (offset[there.name] if follows else 0.0)
        joints.append(replace(there, origin=there.origin @ own.frame @ E @ inverse(own.frame), shift=shift))
    readings = true.draw(rng, 5)
    expected = replace(true, joints=tuple(joints)).tips(readings)
    np.testing.assert_allclose(arm.tips(readings, d), expected, atol=1e-13)
    motion = arm.motion(readings, d)
    np.testing.assert_allclose(motion.placement[:, :3, :3], expected[:, :3, :3], atol=1e-13)
    np.testing.assert_allclose(motion.placement[:, :3, 3], expected[:, :3, 3], atol=1e-13)


def test_frames_on_the_base_are_no_tips() -> None:
    """ROS-Industrial's arms carry a fixed frame `base` beside `tool0`."""
    text = robot(links("abct"), joint("a", "b"), joint("a", "c", "fixed"), joint("b", "t", "fixed"))
    assert load(text).tip == "t"


# ---- what is refused


@pytest.mark.parametrize(
    ("text", "tip", "base", "sentence"),
    [
        (
            robot(links("ab"), joint("a", "b")),
            "c",
            None,
            "arm.urdf: tip 'c' is not a link of the URDF; its links are a, b.",
        ),
        (
            robot(links("ab"), joint("a", "b")),
            "b",
            "c",
            "arm.urdf: base 'c' is not a link of the URDF; its links are a, b.",
        ),
        (
            robot(links("abc"), joint("a", "b"), joint("a", "c")),
            None,
            None,
            "arm.urdf: which link is the tip? Choose one of b, c.",
        ),
        (
            robot(links("abc"), joint("a", "b", "fixed"), joint("b", "c")),
            "b",
            None,
            "arm.urdf: no joint moves between 'a' and 'b'; choose another tip.",
        ),
        (
            robot(links("abc"), joint("a", "b"), joint("a", "c")),
            "b",
            "c",
            "arm.urdf: base 'c' does not carry tip 'b': the links are on other branches.",
        ),
        (
            robot(links("abc"), "\n", joint("a", "b", "floating"), joint("b", "c")),
            "c",
            None,
            "arm.urdf:2: joint 'ab' between 'a' and 'c' is floating; "
            "an arm needs revolute, continuous, prismatic or fixed joints, so choose a base behind it.",
        ),
    ],
)
def test_an_arm_that_is_none_is_refused_in_a_sentence(
    text: str, tip: str | None, base: str | None, sentence: str
) -> None:
    with pytest.raises(RobotError) as caught:
        load(text, tip, base)
    assert str(caught.value) == sentence


def test_a_long_list_of_links_is_cut() -> None:
    text = robot(links("abcdefghijklmno"), *(joint("a", child) for child in "bcdefghijklmno"))
    with pytest.raises(RobotError, match=r"its links are a, b, c, d, e, f, g, h, i, j, k, l and 3 more\.$"):
        load(text, "tip")


@pytest.mark.parametrize("shape", [(3, 5), (6,), (2, 3, 6)])
def test_readings_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    robot = load_robot("example:ur_description/urdf/ur10_robot.urdf", "tool0")
    for ask in (robot.tips, robot.joint_positions, robot.motion):
        with pytest.raises(RobotError, match=r"^readings of shape .*: needs \(N, 6\), a column for each of shou"):
            ask(np.zeros(shape))


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.int64, np.bool_])
def test_readings_of_any_precision_are_reckoned_with_in_full(kind: type[np.generic]) -> None:
    robot = load_robot("example:ur_description/urdf/ur10_robot.urdf", "tool0")
    given = np.array([[0, 1, 0, 1, 1, 0], [1, 0, 1, 0, 0, 1]]).astype(kind)
    assert robot.tips(given).tolist() == robot.tips(given.astype(np.float64)).tolist()


def test_which_readings_turn() -> None:
    """Readings that a whole turn leads back, and those that drive by other ratios, or what slides, are told apart."""
    links = "".join(f'<link name="{name}"/>' for name in ("base", "a", "b", "c", "d", "tip"))
    joints = "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{before}"/><child link="{after}"/><axis xyz="0 0 1"/>'
        f'<limit lower="-7" upper="7" effort="1" velocity="1"/>{follows}</joint>'
        for name, kind, before, after, follows in (
            ("whole", "revolute", "base", "a", ""),
            ("half", "continuous", "a", "b", ""),
            ("slide", "prismatic", "b", "c", ""),
            ("by_whole", "revolute", "c", "d", '<mimic joint="whole" multiplier="-2"/>'),
            ("by_half", "revolute", "d", "tip", '<mimic joint="half" multiplier="0.5"/>'),
        )
    )
    robot = load_robot(parse_urdf(f'<robot name="r">{links}{joints}</robot>'.encode(), "r"), "tip")
    assert {r.name: r.turns for r in robot.readings} == {"whole": True, "half": False, "slide": False}


def test_a_link_that_no_joint_carries_is_refused() -> None:
    robot = load_robot("example:ur_description/urdf/ur10_robot.urdf", "tool0")
    assert robot.carrier("world") == -1
    for asked in (robot.carrier, lambda link: robot.driving((link,))):
        with pytest.raises(RobotError, match=r"there is no link 'forearm' of the robot; its joints carry .*'tool0'\.$"):
            asked("forearm")
