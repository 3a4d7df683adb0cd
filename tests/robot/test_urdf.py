"""The reader: real files load, doubtful ones are refused in one sentence that says where and why."""

import random
import re
from pathlib import Path

import numpy as np
import pytest

from calib.foundations.errors import RobotError
from calib.foundations.xml_text import NOT_EXPANDED
from calib.robot.sources import examples
from calib.robot.urdf import LARGEST_URDF, Mimic, parse_urdf, read_urdf

# Why each of these is refused, and that no other is: the whole of example-robot-data, version 6.
REFUSED_EXAMPLES = {
    "example:alex_description/urdf/alex_psyonic_hands.urdf": (
        ":1030: joint 'Left_index_q2' mimics 'index_q1', which does not exist; "
        "did you mean 'Left_index_q1' or 'Right_index_q1' or 'Left_index_q2'?"
    ),
    "example:ur_description/urdf/ur3.urdf": ":6: the robot has no link.",
}

JOINT = '<joint name="j" type="revolute">\n<parent link="a"/><child link="b"/>\n{}</joint>'


def robot(*lines: str) -> bytes:
    return "\n".join(['<robot name="r">', *lines, "</robot>"]).encode()


def arm(inside: str = "", *more: str) -> bytes:
    """Links a, b and joint j in lines 2 to 5, ``inside`` in its fifth line."""
    return robot('<link name="a"/><link name="b"/>', JOINT.format(inside), *more)


def sentence(source: bytes) -> str:
    with pytest.raises(RobotError) as caught:
        parse_urdf(source, "arm.urdf")
    return str(caught.value)


@pytest.mark.parametrize("name", examples())
def test_every_example_loads_or_is_refused_in_a_sentence(name: str) -> None:
    if name in REFUSED_EXAMPLES:
        with pytest.raises(RobotError) as caught:
            read_urdf(name)
        assert str(caught.value) == name + REFUSED_EXAMPLES[name]
        return
    urdf = read_urdf(name)
    assert urdf.where == name
    assert len(urdf.joints) == len(urdf.links) - 1
    assert urdf.parent_joint(urdf.root) is None
    lines = urdf.source.splitlines()
    for joint in urdf.joints:
        assert urdf.joint(joint.name) is joint
        assert urdf.parent_joint(joint.child) is joint
        assert b"<joint" in lines[joint.line - 1]
        assert not joint.origin.flags.writeable
        assert not joint.axis.flags.writeable
        assert np.linalg.norm(joint.axis) == pytest.approx(1.0, abs=1e-15)
        R = joint.origin[:3, :3]
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)


def test_a_joint_is_read_exactly() -> None:
    urdf = parse_urdf(
        robot(
            '<link name="a"/><link name="b"/><link name="c"/>',
            '<joint type="prismatic" name="slide">',
            '<limit upper="0.5" lower="-.25" effort="1" velocity="1"/><axis xyz="0 3 4"/>',
            '<child link="b"/><parent link="a"/><origin rpy="0 0 1.5707963267948966" xyz="+1. -2e-3 3"/>',
            "</joint>",
            '<joint name="turn" type="continuous"><parent link="b"/><child link="c"/>',
            '<mimic joint="slide" multiplier="-2" offset="0.1"/></joint>',
        ),
        "arm.urdf",
    )
    assert (urdf.name, urdf.root, urdf.links) == ("r", "a", ("a", "b", "c"))
    slide, turn = urdf.joints
    assert (slide.name, slide.type, slide.parent, slide.child, slide.line) == ("slide", "prismatic", "a", "b", 3)
    assert (slide.lower, slide.upper, slide.mimic) == (-0.25, 0.5, None)
    np.testing.assert_array_equal(slide.axis, [0.0, 0.6, 0.8])
    expected = [[0, -1, 0, 1], [1, 0, 0, -0.002], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(slide.origin, expected, atol=1e-15)
    assert (turn.lower, turn.upper, turn.mimic) == (None, None, Mimic("slide", -2.0, 0.1))
    np.testing.assert_array_equal(turn.axis, [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(turn.origin, np.eye(4))


@pytest.mark.parametrize(
    ("inside", "limits"),
    [
        ("", (None, None)),
        ('<limit effort="1" velocity="1"/>', (0.0, 0.0)),  # what URDF says an omitted limit is
        ('<limit lower="0" upper="0"/>', (0.0, 0.0)),
        ('<limit lower="-1"/>', (-1.0, 0.0)),
        ('<limit lower="-1e16" upper="1.7976931348623157e+308"/>', (None, None)),
        ('<limit lower="-1" upper="1e999"/>', (-1.0, None)),
    ],
)
def test_limits(inside: str, limits: tuple[float | None, float | None]) -> None:
    joint = parse_urdf(arm(inside), "arm.urdf").joint("j")
    assert (joint.lower, joint.upper) == limits


@pytest.mark.parametrize(
    "source",
    [
        pytest.param(arm('<origin/>\n<axis xyz=" 0\t0\n2 "/>'), id="origin without numbers, white space"),
        pytest.param(arm('<axis xyz="0 0 1"/>').replace(b"\n", b"\r\n"), id="CRLF"),
        pytest.param(b"\xef\xbb\xbf" + arm('<axis xyz="0 0 1"/>'), id="byte order mark"),
        pytest.param(b'<?xml version="1.0" encoding="utf-8"?>' + arm('<axis xyz="0 0 1"/>'), id="declaration"),
        pytest.param(b'<?xml version="1.0" encoding="utf8"?>' + arm('<axis xyz="0 0 1"/>'), id="utf8"),
        pytest.param(
            b'<?xml version="1.0" encoding="windows-1252"?><!-- \xe9 -->' + arm('<axis xyz="0 0 1"/>'), id="cp1252"
        ),
        pytest.param(arm('<axis xyz="0 0 1"/>').decode().encode("utf-16"), id="UTF-16"),
        pytest.param(arm('<axis xyz="0 0 1"/>').decode().encode("utf-16-be"), id="UTF-16 without mark"),
        pytest.param(arm('<!-- <axis/> --><axis xyz="0 0 &#49;"/>'), id="comment, character reference"),
        pytest.param(arm('<axis xyz="0 0 1"/><limit effort="${x}" velocity="nan"/>'), id="what is not read"),
        pytest.param(
            arm(
                '<axis xyz="0 0 1"/><gazebo><origin xyz="bad"/><axis/></gazebo><x:y xmlns="z"/>',
                '<gazebo reference="b"><joint name="j"><origin/></joint><link name="a"/></gazebo>',
                '<transmission><joint name="j"/></transmission><ros2_control><joint name="q"/></ros2_control>',
            ),
            id="joints of other kinds",
        ),
        pytest.param(
            arm('<axis xyz="0 0 1"/>').replace(b"<robot", b'<robot xmlns="u:x" xmlns:xacro="http://ros.org/xacro"'),
            id="namespaces",
        ),
    ],
)
def test_quirks_whose_meaning_is_clear(source: bytes) -> None:
    (joint,) = parse_urdf(source, "arm.urdf").joints
    assert (joint.name, joint.parent, joint.child) == ("j", "a", "b")
    np.testing.assert_array_equal(joint.axis, [0, 0, 1])
    np.testing.assert_array_equal(joint.origin, np.eye(4))


def test_what_means_nothing_on_a_fixed_joint_is_passed_over() -> None:
    inside = '<axis xyz="0 0 0"/><limit lower="2" upper="1"/><mimic joint="none"/>'
    (joint,) = parse_urdf(arm(inside).replace(b"revolute", b"fixed"), "arm.urdf").joints
    assert (joint.lower, joint.upper, joint.mimic) == (None, None, None)
    np.testing.assert_array_equal(joint.axis, [1, 0, 0])


K = '<link name="c"/><joint name="k" type="{}"><parent link="b"/><child link="c"/>{}</joint>'


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        # XML
        (b"", "arm.urdf:1: is not well-formed XML (no element found)."),
        (b"solid cube", "arm.urdf:1: is not well-formed XML (syntax error)."),
        (arm()[:-12], "arm.urdf:5: is not well-formed XML (unclosed token)."),
        (arm()[:-9], "arm.urdf:5: is not well-formed XML (no element found)."),
        (arm() + b"<x/>", "arm.urdf:6: is not well-formed XML (junk after document element)."),
        (arm("&e;"), "arm.urdf:5: is not well-formed XML (undefined entity)."),
        (arm("\0"), "arm.urdf:5: is not well-formed XML (not well-formed (invalid token))."),
        (b"<!DOCTYPE robot>" + arm(), "arm.urdf:1: a DOCTYPE is not allowed; remove it."),
        (
            b'<!DOCTYPE robot [\n<!ENTITY a "aa">\n<!ENTITY b SYSTEM "file:///etc/passwd">]>' + arm("&b;"),
            "arm.urdf:1: a DOCTYPE is not allowed; remove it.",
        ),
        (
            b'<?xml version="1.0" encoding="shift_jis"?>' + arm(),
            "arm.urdf:1: the encoding 'shift_jis' is not one that is read; save the file as UTF-8.",
        ),
        (
            b'<?xml version="1.0" encoding="unicode_escape"?>' + arm(),
            "arm.urdf:1: the encoding 'unicode_escape' is not one that is read; save the file as UTF-8.",
        ),
        (b"<robot>" + b"\n<a>" * 100, "arm.urdf:101: elements are nested more than 100 deep."),
        (b" " * (LARGEST_URDF + 1), "arm.urdf: is larger than 10000000 bytes."),
        (b"\n<sdf/>", "arm.urdf:2: the outermost element is <sdf>; a URDF has <robot>."),
        # xacro
        (
            arm("", '<xacro:arm prefix=""/>'),
            f"arm.urdf:6: <xacro:arm> {NOT_EXPANDED}",
        ),
        (
            arm('<origin xyz="0 0 ${d}"/>'),
            f"arm.urdf:5: joint 'j': <origin>: xyz='0 0 ${{d}}' {NOT_EXPANDED}",
        ),
        (
            arm("", '<link name="$(arg prefix)c"/>'),
            f"arm.urdf:6: <link>: name='$(arg prefix)c' {NOT_EXPANDED}",
        ),
        # names
        (robot(), "arm.urdf:1: the robot has no link."),
        (arm("", "<link/>"), "arm.urdf:6: <link> has no name."),
        (arm("", '<joint name=""/>'), "arm.urdf:6: <joint> has no name."),
        (arm("", '<link name="a"/>'), "arm.urdf:6: link 'a' is declared already in line 2."),
        (arm("", '<joint name="j"/>'), "arm.urdf:6: joint 'j' is declared already in line 3."),
        (
            arm("", f'<link name="{"x" * 201}"/>'),
            f"arm.urdf:6: <link>: name='{'x' * 60}...' is longer than 200 characters.",
        ),
        # joints
        (arm("", '<joint name="k"/>'), "arm.urdf:6: joint 'k' has no type."),
        (
            arm().replace(b"revolute", b"Revolute"),
            "arm.urdf:3: joint 'j' has type 'Revolute'; "
            "allowed are revolute, continuous, prismatic, fixed, floating, planar.",
        ),
        (arm().replace(b'<child link="b"/>', b""), "arm.urdf:3: joint 'j' has no <child>."),
        (arm().replace(b'<parent link="a"/>', b"<parent/>"), "arm.urdf:4: joint 'j': <parent> has no link."),
        (arm("<origin/>\n<origin/>"), "arm.urdf:6: joint 'j' has a second <origin>; the first is in line 5."),
        # the tree
        (
            arm().replace(b'<parent link="a"/>', b'<parent link="aa"/>'),
            "arm.urdf:3: joint 'j' has the parent link 'aa', which does not exist; did you mean 'a'?",
        ),
        (
            arm().replace(b'<child link="b"/>', b'<child link="tool"/>'),
            "arm.urdf:3: joint 'j' has the child link 'tool', which does not exist; there are 'a', 'b'.",
        ),
        (
            arm("", '<joint name="k" type="fixed"><parent link="a"/><child link="b"/></joint>'),
            "arm.urdf:6: joint 'k' carries link 'b', which joint 'j' in line 3 carries already; a link has one parent.",
        ),
        (
            arm("", '<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>'),
            "arm.urdf:3: the links 'b', 'a' carry each other in a circle; a URDF is a tree.",
        ),
        (
            arm("", '<link name="c"/><joint name="k" type="fixed"><parent link="c"/><child link="c"/></joint>'),
            "arm.urdf:6: joint 'k' carries link 'c' on itself.",
        ),
        (
            arm("", '<link name="c"/>', '<link name="d"/>'),
            "arm.urdf: the links 'a', 'c', 'd' have no parent joint; a robot has one root.",
        ),
        (
            robot(*(f'<link name="{i}"/>' for i in range(30))),
            "arm.urdf: the links '0', '1', '2', '3', '4', '5', '6', '7' and 22 more have no parent joint; "
            "a robot has one root.",
        ),
        # numbers
        *(
            (
                arm(f'<origin {attribute}="{text}"/>'),
                f"arm.urdf:5: joint 'j': <origin> {attribute}='{text}' is not 3 plain decimal numbers.",
            )
            for attribute in ("xyz", "rpy")
            for text in (
                "",
                "1 2",
                "1 2 3 4",
                "0 0 nan",
                "inf 0 0",
                "1_0 0 0",
                "\uff11 0 0",
                "0,0,0",
                "0x1 0 0",
                "1.5m",
            )
        ),
        (
            arm('<origin xyz="0\u00a00 0"/>'),
            "arm.urdf:5: joint 'j': <origin> xyz='0\\xa00 0' is not 3 plain decimal numbers.",
        ),
        (
            arm('<origin xyz="0 -1.1e6 0"/>'),
            "arm.urdf:5: joint 'j': <origin> xyz='0 -1.1e6 0' is beyond 1e+06, in SI units.",
        ),
        (
            arm('<origin rpy="0 1e999 0"/>'),
            "arm.urdf:5: joint 'j': <origin> rpy='0 1e999 0' is beyond 1e+06, in SI units.",
        ),
        (arm('<axis xyz="0 0"/>'), "arm.urdf:5: joint 'j': <axis> xyz='0 0' is not 3 plain decimal numbers."),
        (arm('<axis xyz="0 0 0"/>'), "arm.urdf:5: joint 'j': <axis> xyz='0 0 0' has no direction."),
        (arm('<axis xyz="0 1e-17 0"/>'), "arm.urdf:5: joint 'j': <axis> xyz='0 1e-17 0' has no direction."),
        (arm("<axis/>"), "arm.urdf:5: joint 'j': <axis> has no xyz."),
        (arm('<limit lower="1"/>'), "arm.urdf:5: joint 'j': <limit> lower=1 is above upper=0."),
        (
            arm('<limit lower="-inf"/>'),
            "arm.urdf:5: joint 'j': <limit> lower='-inf' is not a plain decimal number.",
        ),
        # mimics
        (arm("<mimic/>"), "arm.urdf:5: joint 'j': <mimic> has no joint."),
        (arm('<mimic joint="j"/>'), "arm.urdf:3: joint 'j' mimics itself."),
        (
            arm('<mimic joint="joint"/>'),
            "arm.urdf:3: joint 'j' mimics 'joint', which does not exist; there are 'j'.",
        ),
        (
            arm('<mimic joint="k" multiplier="0"/>'),
            "arm.urdf:5: joint 'j': <mimic> multiplier is zero, so the joint does not follow 'k'.",
        ),
        (
            arm('<mimic joint="k" offset="a"/>'),
            "arm.urdf:5: joint 'j': <mimic> offset='a' is not a plain decimal number.",
        ),
        (
            arm('<mimic joint="k"/>', K.format("fixed", "")),
            "arm.urdf:3: joint 'j' mimics 'k', which is fixed and has no position to follow.",
        ),
        (
            arm('<mimic joint="k"/>', K.format("revolute", '<mimic joint="j"/>')),
            "arm.urdf:3: the joints 'j', 'k' mimic each other in a circle.",
        ),
    ],
)
def test_what_is_refused(source: bytes, expected: str) -> None:
    assert sentence(source) == expected


def test_unknown_names_come_with_the_near_ones() -> None:
    urdf = read_urdf("example:panda_description/urdf/panda.urdf")
    with pytest.raises(RobotError) as caught:
        urdf.joint("panda_jonit1")
    assert str(caught.value) == (
        "example:panda_description/urdf/panda.urdf: there is no joint 'panda_jonit1'; "
        "did you mean 'panda_joint1' or 'panda_joint8' or 'panda_joint7'?"
    )
    with pytest.raises(RobotError) as caught:
        urdf.joint("A1")
    assert str(caught.value) == (
        "example:panda_description/urdf/panda.urdf: there is no joint 'A1'; there are 'panda_joint1', 'panda_joint2', "
        "'panda_joint3', 'panda_joint4', 'panda_joint5', 'panda_joint6', 'panda_joint7', 'panda_joint8' and 4 more."
    )
    with pytest.raises(RobotError, match="there is no link 'panda_link9'; did you mean 'panda_link"):
        urdf.parent_joint("panda_link9")


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    with pytest.raises(RobotError, match=re.escape(f"{path}: there is no such file.")):
        read_urdf(path)
    path.write_bytes(arm())
    assert read_urdf(path).where == str(path)
    assert read_urdf(str(path)).source == arm()


def test_a_mimic_may_follow_a_mimic() -> None:
    urdf = parse_urdf(
        arm(
            '<mimic joint="k"/>',
            K.format("prismatic", '<mimic joint="m" multiplier="2"/>'),
            '<link name="d"/><joint name="m" type="continuous"><parent link="c"/><child link="d"/></joint>',
        ),
        "arm.urdf",
    )
    assert [joint.mimic for joint in urdf.joints] == [Mimic("k", 1.0, 0.0), Mimic("m", 2.0, 0.0), None]


def test_any_bytes_give_a_robot_or_a_sentence() -> None:
    chance = random.Random(7)
    text = arm('<origin xyz="1 2 3" rpy="0 0 0.1"/><limit lower="-1" upper="2"/>').decode()
    seeds = [(f'<?xml version="1.0" encoding="{e}"?>{text}').encode(e) for e in ("utf-8", "utf-16", "windows-1252")]
    for _ in range(6000):
        source = bytearray(chance.choice(seeds))
        for _ in range(chance.randint(1, 4)):
            at = chance.randrange(len(source))
            source[at : at + chance.randint(0, 3)] = chance.choice([b"", b"<", b'"', b"\0", b"\xd8", b"1", b"&#9;"])
        try:
            parse_urdf(bytes(source), "arm.urdf")
        except RobotError as e:
            assert str(e).startswith("arm.urdf:")
            assert "\n" not in str(e)
