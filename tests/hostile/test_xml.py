"""URDFs and meshes made to harm: bombs, other people's files, robots without end."""

import socket
from pathlib import Path

import numpy as np
import pytest

from calib.foundations.errors import RobotError
from calib.foundations.xml_text import read_xml
from calib.presentation.meshes import primitive
from calib.presentation.visuals import visuals
from calib.robot.load import MOST_JOINTS, load_robot
from calib.robot.mesh_files import parse_mesh
from calib.robot.robot import Coupling
from calib.robot.sources import find_mesh
from calib.robot.urdf import parse_urdf

LAUGHS = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 10))
ARM = '<link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>{}</joint>'


def said(source: str | bytes) -> str:
    data = source.encode() if isinstance(source, str) else source
    with pytest.raises(RobotError) as caught:
        load_robot(parse_urdf(data, "arm.urdf"))
    assert len(str(caught.value)) < 1000
    return str(caught.value)


def arm(inside: str = "", head: str = "") -> str:
    return f'{head}<robot name="r">{ARM.format(inside)}</robot>'


@pytest.mark.parametrize(
    "doctype",
    [
        f'<!DOCTYPE r [<!ENTITY l0 "ha">{LAUGHS}]>',
        '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE r SYSTEM "http://127.0.0.1:1/evil.dtd">',
        '<!DOCTYPE r [<!ENTITY % p SYSTEM "http://127.0.0.1:1/evil.dtd"> %p;]>',
        "<!DOCTYPE r>",
    ],
    ids=["billion laughs", "another file", "a DTD elsewhere", "a parameter entity", "empty"],
)
def test_document_types_are_refused_before_anything_grows_or_is_fetched(
    doctype: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket, "socket", None)
    assert said(arm("&l9;&x;", doctype)).startswith("arm.urdf:1: a DOCTYPE is not allowed")


def test_an_entity_that_nobody_declared() -> None:
    assert said(arm("&x;")) == "arm.urdf:1: is not well-formed XML (undefined entity)."


def test_nesting_without_end() -> None:
    assert said("<a>" * 100_000) == "arm.urdf:1: elements are nested more than 100 deep."


@pytest.mark.parametrize(
    ("number", "why"),
    [
        ("1e400", "is beyond 1e+06, in SI units."),
        ("9" * 5000, "is beyond 1e+06, in SI units."),
        ("0." + "3" * 1_000_000, None),
        ("nan", "is not 3 plain decimal numbers."),
        ("-inf", "is not 3 plain decimal numbers."),
        ("0x1p3", "is not 3 plain decimal numbers."),
        ("1_000", "is not 3 plain decimal numbers."),
        ("1,5", "is not 3 plain decimal numbers."),
    ],
    ids=["1e400", "5000 digits", "a million digits", "nan", "inf", "hexadecimal", "underscore", "decimal comma"],
)
def test_numbers(number: str, why: str | None) -> None:
    source = arm(f'<origin xyz="0 {number} 0"/>')
    if why is None:
        assert parse_urdf(source.encode(), "arm.urdf").joints[0].origin[1, 3] == pytest.approx(1.0 / 3.0)
    else:
        assert said(source).endswith(why)


def chain(n: int, more: str = "") -> str:
    links = "".join(f'<link name="l{k}"/>' for k in range(n + 1))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/></joint>' for k in range(n)
    )
    return f'<robot name="r">{links}{joints}{more}</robot>'


def test_an_arm_without_end() -> None:
    assert len(load_robot(parse_urdf(chain(MOST_JOINTS).encode(), "arm.urdf")).readings) == MOST_JOINTS
    assert "more than the 200 joints that are allowed" in said(chain(1_500))


def test_joints_that_follow_each_other_without_end() -> None:
    links = '<link name="a"/>' + "".join(f'<link name="l{k}"/>' for k in range(1500))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="a"/><child link="l{k}"/>'
        + (f'<mimic joint="j{k + 1}"/>' if k < 1499 else "")
        + "</joint>"
        for k in range(1500)
    )
    with pytest.raises(RobotError, match="and so on, through more than the 200 joints"):
        load_robot(parse_urdf(f"<robot>{links}{joints}</robot>".encode(), "arm.urdf"), "l0")


def test_couplings_that_double_at_every_joint() -> None:
    """Two drivers each, forty deep: 2^40 ways from the first to the last, and as many multiples."""
    n = 60
    couplings = [Coupling(f"j{k}", {f"j{k + 1}": 1.0, f"j{k + 2}": 1.0}, 0.0) for k in range(n - 2)]
    with pytest.raises(RobotError, match="follows its readings with a multiplier or an offset above 1e\\+06"):
        load_robot(parse_urdf(chain(n).encode(), "arm.urdf"), couplings=couplings)
    halves = [Coupling(c.joint, dict.fromkeys(c.drivers, 0.5), 0.0) for c in couplings]
    robot = load_robot(parse_urdf(chain(n).encode(), "arm.urdf"), couplings=halves)
    # Halves of what two numbers are: between the two, and all of it.
    np.testing.assert_allclose(robot.coupling.sum(axis=1), 1.0)


def test_a_wrong_name_among_very_many_long_ones() -> None:
    links = "".join(f'<link name="{k:06d}{"x" * 150}"/>' for k in range(1_900))
    joint = '<joint name="j" type="fixed"><parent link="{}"/><child link="y"/></joint>'
    sentence = said(f'<robot name="r">{links}{joint.format("z" * 200)}</robot>')
    assert "does not exist" in sentence


@pytest.mark.parametrize("codec", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_is_read(codec: str) -> None:
    source = arm(head='<?xml version="1.0" encoding="utf-16"?>')
    mark = {"utf-16-le": b"\xff\xfe", "utf-16-be": b"\xfe\xff"}.get(codec, b"")
    assert parse_urdf(mark + source.encode(codec), "arm.urdf").links == ("a", "b")


def test_encodings_of_which_markup_hides() -> None:
    assert "the encoding 'UTF-7' is not one that is read" in said(arm(head='<?xml version="1.0" encoding="UTF-7"?>'))
    assert said(arm().encode().replace(b"a", b"\0", 1)).startswith("arm.urdf:1: is not well-formed XML")
    assert said(arm().encode().replace(b'"a"', b'"\xe9"', 1)).startswith("arm.urdf:1: is not well-formed XML")


def test_xacro_is_never_run(tmp_path: Path) -> None:
    made = tmp_path / "made"
    call = f"$(eval open('{made}', 'w'))"
    assert "run xacro first" in said(f'<robot name="r"><link name="{call}"/></robot>')
    sentence = said('<robot xmlns:xacro="http://x"><xacro:include filename="/etc/passwd"/><link name="a"/></robot>')
    assert sentence.endswith("run xacro first and use the URDF that it prints, or let calib init --xacro run it.")
    assert not made.exists()


@pytest.mark.parametrize(
    "element",
    [
        '<x:include filename="arm.xacro"/>',
        '<x:if value="1"><link name="b"/></x:if>',
        '<link name="b"><x:macro/></link>',
        '<include filename="arm.xacro"/>',
        '<macro name="arm"/>',
        '<unless value="0"/>',
    ],
)
def test_xacro_of_another_prefix_or_of_none_is_not_passed_over(element: str) -> None:
    """What it holds of the robot is not there: without it, it would be another one."""
    sentence = said(f'<robot xmlns:x="http://www.ros.org/wiki/xacro"><link name="a"/>{element}</robot>')
    assert "is not expanded; run xacro first" in sentence
    assert read_xml(b'<robot xmlns:x="http://x/sensor"><x:include/></robot>').children[0].tag == "x:include"


@pytest.mark.parametrize(
    ("inside", "says"),
    [
        ('<origin quat_xyzw="0 0 1 0"/>', "<origin> has 'quat_xyzw', which is not read; read are xyz, rpy."),
        ('<origin xyz="1 0 0" RPY="1 0 0"/>', "<origin> has 'RPY', which is not read; read are xyz, rpy."),
        ('<axis xyz="1 0 0" Xyz="0 1 0"/>', "<axis> has 'Xyz', which is not read; read are xyz."),
        ('<Origin xyz="1 0 0"/>', "arm.urdf:1: <Origin> is written <origin>; else it is not read."),
        ('</joint><Link name="c"/><joint name="k" type="fixed">', "<Link> is written <link>; else it is not read."),
        (
            '<mimic joint="k" multipler="2"/>',
            "<mimic> has 'multipler', which is not read; read are joint, multiplier, offset.",
        ),
    ],
)
def test_what_would_make_another_arm_is_not_passed_over(inside: str, says: str) -> None:
    assert said(arm(inside)).endswith(says)


def test_meshes_outside_their_roots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "socket", None)
    root, secret = tmp_path / "robot", tmp_path / "secret.stl"
    (root / "arm").mkdir(parents=True)
    secret.write_text("solid", encoding="utf-8")
    (root / "link.stl").symlink_to(secret)
    (root / "self.stl").symlink_to(root / "self.stl")
    (root / "up").symlink_to(tmp_path)
    for name in (
        *("../secret.stl", "arm/../../secret.stl", "package://arm/../../secret.stl", "package://../secret.stl"),
        *("file://" + str(secret), str(secret), "file:///etc/passwd", "/etc/passwd", "link.stl", "up/secret.stl"),
        *("self.stl", "file://%2e%2e/secret.stl", "http://127.0.0.1:1/a.stl", "https://x/a.stl", "ftp://x/a.stl"),
        *("package://", "", ".", "a\0.stl", "x" * 5000, "\udcff.stl"),
    ):
        assert find_mesh(name, (root,)) is None, name


def test_a_mesh_is_xml_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "socket", None)
    path = tmp_path / "part.dae"
    for doctype in (f'<!DOCTYPE r [<!ENTITY l0 "ha">{LAUGHS}]>', '<!DOCTYPE r [<!ENTITY x SYSTEM "/etc/passwd">]>'):
        path.write_text(f"{doctype}<COLLADA>&l9;&x;</COLLADA>", encoding="utf-8")
        assert parse_mesh(path.read_bytes(), path.suffix, (0.5, 0.5, 0.5)) is None


GOOD = '<geometry><sphere radius="0.1"/></geometry>'
BAD_SHAPES = (
    *("", "<geometry/>", "<geometry><box/></geometry>", '<geometry><box size="a"/></geometry>'),
    *('<geometry><box size="1 2"/></geometry>', '<geometry><box size="nan 1 1"/></geometry>'),
    *('<geometry><box size="1e400 1 1"/></geometry>', '<geometry><sphere radius="1e300"/></geometry>'),
    *('<geometry><sphere radius="-1"/></geometry>', '<geometry><capsule radius="1" length="1"/></geometry>'),
    *(f'<origin xyz="a b c"/>{GOOD}', f'<origin rpy="0 0"/>{GOOD}', "<geometry><mesh/></geometry>"),
    *('<geometry><mesh filename="a.stl" scale="x"/></geometry>', '<geometry><mesh filename="/etc/passwd"/></geometry>'),
)


@pytest.mark.parametrize("shape", BAD_SHAPES)
def test_a_shape_that_is_none_costs_no_other_and_no_results(shape: str) -> None:
    looks = f"<visual>{shape}</visual><visual>{GOOD}</visual><inertial><mass value='x'/></inertial>"
    source = f'<robot name="r"><link name="a">{looks}</link><link name="b"/>{ARM.partition("<joint")[1]}'
    source += f"{ARM.partition('<joint')[2].format('')}</robot>"
    urdf = parse_urdf(source.encode(), "arm.urdf")
    none, ball = visuals(urdf, (0.5, 0.5, 0.5))["a"]
    assert none is None or (none.kind == "mesh" and find_mesh(none.file, ()) is None)
    assert ball is not None
    assert np.ptp(primitive(ball.kind, ball.sizes, ball.rgb).vertices, axis=0) == pytest.approx(0.2, rel=1e-2)


def test_colours_that_are_none() -> None:
    paint = '<material name="p"><color rgba="{}"/></material>'
    link = f'<link name="a"><visual>{GOOD}{paint}</visual></link>'
    for rgba, expected in (("1 0 0 1", (1.0, 0.0, 0.0)), ("9 -1 0 1", (1.0, 0.0, 0.0)), ("x", (0.5, 0.5, 0.5))):
        urdf = parse_urdf(f"<robot>{link.format(rgba)}</robot>".encode(), "arm.urdf")
        assert visuals(urdf, (0.5, 0.5, 0.5))["a"][0].rgb == expected
