"""The writer: the asked origins change, exactly, and nothing else does, to the byte."""

import io
import re

import numpy as np
import pytest
import yourdfpy

from calib.foundations.arrays import Array
from calib.foundations.errors import OutputError, RobotError
from calib.foundations.rigid import exp3, placement, rotation_about, rotation_of_rpy
from calib.robot.sources import examples
from calib.robot.urdf import Urdf, parse_urdf, read_document, read_urdf
from calib.robot.urdf_writer import splice_origins

NOT_ROBOTS = ("example:alex_description/urdf/alex_psyonic_hands.urdf", "example:ur_description/urdf/ur3.urdf")
ROBOTS = [name for name in examples() if name not in NOT_ROBOTS]

# A quarter turn about z and a step, whose numbers are short.
TURN = placement(rotation_of_rpy(np.array([0.0, 0.0, 0.5])), np.array([0.25, -1e-5, 3.0]))
SAME_ROTATION = placement(np.eye(3), np.array([0.25, -0.0, 3.0]))

ARM = """<?xml version='1.0'?>
<!-- bench 3, measured by hand -->
<robot  name = "arm"  >
  <link name="a"/><link name="b"/>
  <joint name="j" type="revolute">
    {}<parent link="a"/>
    <child link="b"/>  <!-- <origin xyz="9 9 9"/> -->
    <gazebo><origin xyz="7 7 7" rpy="7 7 7"/></gazebo>
  </joint>
  <transmission><joint name="j"><origin xyz="8 8 8"/></joint></transmission>
</robot>
"""


def arm(origin: str) -> bytes:
    return ARM.format(origin).encode()


def perturbed(urdf: Urdf, seed: int) -> dict[str, Array]:
    """Return the origins of about half the joints, moved by a few cm and any rotation."""
    chance = np.random.default_rng(seed)
    return {
        joint.name: joint.origin @ placement(exp3(chance.normal(size=3)), chance.normal(scale=0.03, size=3))
        for joint in urdf.joints
        if chance.random() < 0.5
    }


@pytest.mark.parametrize("name", ROBOTS)
def test_random_origins_survive_in_every_example(name: str) -> None:
    urdf = read_urdf(name)
    origins = perturbed(urdf, len(urdf.source))
    spliced = splice_origins(urdf.source, origins)
    again = parse_urdf(spliced, name)
    for old, new in zip(urdf.joints, again.joints, strict=True):
        asked = origins.get(old.name, old.origin)
        np.testing.assert_allclose(new.origin, asked, rtol=0.0, atol=1e-12)
        np.testing.assert_array_equal(new.origin[:3, 3], asked[:3, 3])


ORIGIN = re.compile(rb"(<origin\b[^>]*>)")
VALUES = re.compile(rb"""\s*\b(?:xyz|rpy)\s*=\s*(?:"[^"]*"|'[^']*')""")


@pytest.mark.parametrize("name", ROBOTS)
def test_bytes_outside_the_values_are_kept(name: str) -> None:
    urdf = read_urdf(name)
    # Where an origin is inserted is for the short texts below; here, tags are found without any parser.
    elements = read_document(urdf.source, name).children
    with_origin = {e.attributes["name"] for e in elements if any(part.tag == "origin" for part in e.children)}
    origins = {joint: origin for joint, origin in perturbed(urdf, 3).items() if joint in with_origin}
    before, after = (ORIGIN.split(text) for text in (urdf.source, splice_origins(urdf.source, origins)))
    assert before[::2] == after[::2]
    assert [VALUES.sub(b"", tag) for tag in before[1::2]] == [VALUES.sub(b"", tag) for tag in after[1::2]]
    assert sum(old != new for old, new in zip(before, after, strict=True)) == len(origins)


@pytest.mark.parametrize("name", ROBOTS)
def test_origins_that_stay_change_no_byte(name: str) -> None:
    urdf = read_urdf(name)
    assert splice_origins(urdf.source, {joint.name: joint.origin for joint in urdf.joints}) == urdf.source
    assert splice_origins(urdf.source, {}) == urdf.source


@pytest.mark.parametrize(
    ("before", "after"),
    [
        pytest.param(
            '<origin xyz="0 0 0" rpy="0 0 0"/>', '<origin xyz="0.25 -1e-05 3.0" rpy="0.0 0.0 0.5"/>', id="plain"
        ),
        pytest.param(
            "<origin\n\trpy = '0 0 0'\n\txyz='0  0 0' ></origin >",
            "<origin\n\trpy = '0.0 0.0 0.5'\n\txyz='0.25 -1e-05 3.0' ></origin >",
            id="order, white space, quotes, not empty",
        ),
        pytest.param(
            """<origin note="a > b 'rpy=' &amp;" xyz='&#48; 0 0' é="1" rpy="0 0 0"><x rpy="1 1 1"/> t </origin>""",
            """<origin note="a > b 'rpy=' &amp;" xyz='0.25 -1e-05 3.0' é="1" rpy="0.0 0.0 0.5"><x rpy="1 1 1"/> t """
            "</origin>",
            id="other attributes, references, contents",
        ),
        pytest.param(
            """<origin xyz="0 0 0" >rpy="0 0 0"</origin>""",
            """<origin xyz="0.25 -1e-05 3.0" rpy="0.0 0.0 0.5" >rpy="0 0 0"</origin>""",
            id="text like an attribute",
        ),
        pytest.param("<origin/>", '<origin xyz="0.25 -1e-05 3.0" rpy="0.0 0.0 0.5"/>', id="no attributes"),
        pytest.param("<origin ></origin>", '<origin xyz="0.25 -1e-05 3.0" rpy="0.0 0.0 0.5" ></origin>', id="empty"),
        pytest.param("<origin rpy='0 0 0' />", "<origin rpy='0.0 0.0 0.5' xyz='0.25 -1e-05 3.0' />", id="without xyz"),
        pytest.param("<origin xyz='0 0 0'/>", "<origin xyz='0.25 -1e-05 3.0' rpy='0.0 0.0 0.5'/>", id="without rpy"),
        pytest.param("", '<origin xyz="0.25 -1e-05 3.0" rpy="0.0 0.0 0.5"/>\n    ', id="missing"),
        pytest.param(
            "<!-- c --> ",
            '<!-- c --> <origin xyz="0.25 -1e-05 3.0" rpy="0.0 0.0 0.5"/> ',
            id="missing, after a comment",
        ),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be", "crlf"])
def test_the_numbers_are_cut_into_the_text(before: str, after: str, encoding: str) -> None:
    source, expected = ARM.format(before), ARM.format(after)
    if encoding == "crlf":
        source, expected, encoding = source.replace("\n", "\r\n"), expected.replace("\n", "\r\n"), "utf-8"
    assert splice_origins(source.encode(encoding), {"j": TURN}).decode(encoding) == expected


def test_latin_1_is_kept() -> None:
    source = ARM.replace("'1.0'", "'1.0' encoding='ISO-8859-1'").format('<origin é="ü" xyz="0 0 0"/>')
    spliced = splice_origins(source.encode("latin-1"), {"j": SAME_ROTATION})
    assert spliced == source.replace('"0 0 0"', '"0.25 0.0 3.0"').encode("latin-1")


def test_a_rotation_that_stays_keeps_its_text() -> None:
    spliced = splice_origins(arm('<origin xyz="0 0 0" rpy="0 -0 0e5"/>'), {"j": SAME_ROTATION})
    assert spliced == arm('<origin xyz="0.25 0.0 3.0" rpy="0 -0 0e5"/>')


def test_several_joints_in_any_order() -> None:
    urdf = read_urdf("example:ur_description/urdf/ur5_robot.urdf")
    origins = perturbed(urdf, 1)
    backwards = dict(reversed(origins.items()))
    assert splice_origins(urdf.source, origins) == splice_origins(urdf.source, backwards)


def test_a_document_longer_than_what_expat_takes_at_once() -> None:
    source = arm('<origin xyz="0 0 0"/>').replace(b"<link", b"<!--" + b"x" * 3_000_000 + b"--><link", 1)
    assert splice_origins(source, {"j": SAME_ROTATION}) == source.replace(b'"0 0 0"', b'"0.25 0.0 3.0"')


@pytest.mark.parametrize("pitch", [0.5 * np.pi, -0.5 * np.pi, 0.5 * np.pi - 1e-9, 0.5 * np.pi + 1e-7, 0.0, np.pi])
def test_every_pitch_survives(pitch: float) -> None:
    for roll in (0.0, 1.0, -3.0):
        R = rotation_of_rpy(np.array([roll, pitch, 2.0])) @ rotation_about(np.array([0.0, 0.0, 1.0]), 1e-5)
        origin = placement(R, np.array([1e5 / 3.0, 1e-300, -1.0 / 3.0]))
        (joint,) = parse_urdf(splice_origins(arm(""), {"j": origin}), "arm.urdf").joints
        np.testing.assert_allclose(joint.origin, origin, rtol=0.0, atol=1e-14)
        np.testing.assert_array_equal(joint.origin[:3, 3], origin[:3, 3])


def test_an_unknown_joint_is_refused() -> None:
    with pytest.raises(RobotError) as caught:
        splice_origins(arm(""), {"jj": TURN}, "arm.urdf")
    assert str(caught.value) == "arm.urdf: there is no joint 'jj'; did you mean 'j'?"


def test_a_document_that_is_no_urdf_is_refused() -> None:
    with pytest.raises(RobotError, match="the outermost element is <sdf>"):
        splice_origins(b"<sdf/>", {}, "arm.urdf")


@pytest.mark.parametrize(
    ("origin", "sentence"),
    [
        (
            np.diag([1.0, 1.0, 1.1, 1.0]),
            "arm.urdf: joint 'j' reads back with an error of 1.0e-01; "
            "this is a bug, or the placement asked for is no rigid motion.",
        ),
        (
            np.diag([1.0, 1.0, -1.0, 1.0]),
            "arm.urdf: joint 'j' reads back with an error of 2.0e+00; "
            "this is a bug, or the placement asked for is no rigid motion.",
        ),
        (
            placement(np.eye(3), np.array([np.nan, 0.0, 0.0])),
            "arm.urdf: with what was changed it does not read back (arm.urdf:6: joint 'j': <origin> xyz='nan 0.0 0.0' "
            "is not 3 plain decimal numbers.); this is a bug.",
        ),
        (
            placement(np.eye(3), np.array([0.0, 1e7, 0.0])),
            "arm.urdf: joint 'j' would have an <origin> with xyz='0.0 10000000.0 0.0', and no URDF that is read has "
            "one beyond 1e+06 m.",
        ),
    ],
)
def test_what_is_no_placement_never_leaves(origin: Array, sentence: str) -> None:
    with pytest.raises(OutputError) as caught:
        splice_origins(arm(""), {"j": origin}, "arm.urdf")
    assert str(caught.value) == sentence


# yourdfpy as a second opinion on what the written file means. ----------------------------------------------------

SECOND_OPINIONS = (
    "example:panda_description/urdf/panda.urdf",
    "example:ur_description/urdf/ur5_robot.urdf",
    "example:ur_description/urdf/ur10_robot.urdf",
    "example:kinova_description/robots/kinova.urdf",
    "example:xarm_description/urdf/xarm7.urdf",
    "example:z1_description/urdf/z1.urdf",
    "example:so_arm_description/urdf/so101.urdf",
    "example:baxter_description/urdf/baxter.urdf",
    "example:double_pendulum_description/urdf/double_pendulum.urdf",
)


def poses(urdf: Urdf, origins: dict[str, Array], q: dict[str, float]) -> dict[str, Array]:
    """Return the placements (4, 4) of all links in the root, with ``origins`` in the place of the file's."""
    found = {urdf.root: np.eye(4)}
    while len(found) < len(urdf.links):
        for joint in urdf.joints:
            if joint.parent in found and joint.child not in found:
                driver, multiplier, offset = joint.name, 1.0, 0.0
                if joint.mimic is not None:
                    driver, multiplier, offset = joint.mimic.joint, joint.mimic.multiplier, joint.mimic.offset
                position = multiplier * q.get(driver, 0.0) + offset
                motion = np.eye(4)
                if joint.type == "prismatic":
                    motion = placement(np.eye(3), position * joint.axis)
                elif joint.type != "fixed":
                    motion = placement(rotation_about(joint.axis, position), np.zeros(3))
                found[joint.child] = found[joint.parent] @ origins.get(joint.name, joint.origin) @ motion
    return found


@pytest.mark.parametrize("name", SECOND_OPINIONS)
def test_another_reader_sees_the_robot_that_was_asked_for(name: str) -> None:
    urdf = read_urdf(name)
    origins = perturbed(urdf, 11)
    spliced = io.BytesIO(splice_origins(urdf.source, origins))
    other = yourdfpy.URDF.load(spliced, load_meshes=False, build_collision_scene_graph=False)
    chance = np.random.default_rng(5)
    for _ in range(3):
        q = {joint: chance.uniform(-1.0, 1.0) for joint in other.actuated_joint_names}
        other.update_cfg(q)
        for link, pose in poses(urdf, origins, q).items():
            np.testing.assert_allclose(other.get_transform(link), pose, atol=1e-10)
