"""Two URDFs in one: the first kept byte for byte, the second renamed where names clash, both read by yourdfpy."""

import io
import re

import numpy as np
import pytest
import yourdfpy

import calib
from calib.robot.cell import compose
from calib.robot.urdf import parse_urdf
from tests.support.positioners import place, turn

FIRST = """<?xml version="1.0"?>
<!-- an arm: first & foremost -->
<robot name="arm">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="base"><visual><geometry><box size="1 1 1"/></geometry><material name="grey"/></visual></link>
  <link name="tip"/>
  <joint name="turn" type="continuous"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/></joint>
</robot>
<!-- after the end -->
"""
SECOND = """<?xml version='1.0' encoding='UTF-8'?>
<robot name="rotary table">
  <!-- <link name="base"/> was here; Drehtisch für Schweißer -->
  <material name='grey'><color rgba="0.9 0.1 0.1 1"/></material>
  <material name="blue"><color rgba="0 0 1 1"/></material>
  <link name='base'><visual><geometry><box size="1 1 1"/></geometry><material name="grey"/></visual></link>
  <link name="dis&amp;c"/>
  <link name="pointer"/>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="dis&amp;c"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 0.3"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="follow" type="prismatic"><parent link="dis&amp;c"/><child link="pointer"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="2" effort="1" velocity="1"/><mimic joint="turn" multiplier="0.5"/></joint>
  <transmission name="t"><joint name="turn"/></transmission>
  <gazebo reference="base"><selfCollide>true</selfCollide></gazebo>
</robot>
"""
T = place(turn([0.3, -0.4, 2.0]), [1.5, -0.2, 0.6])


def test_both_machines_are_there_where_they_belong() -> None:
    first, second = parse_urdf(FIRST.encode(), "arm.urdf"), parse_urdf(SECOND.encode(), "table.urdf")
    cell = compose(first, second, "base", T)
    assert cell.links == {"base": "rotary_table_base", "dis&c": "dis&c", "pointer": "pointer"}
    assert cell.joints == {"turn": "rotary_table_turn", "follow": "follow"}
    # The first document is kept, the new part stands before its end tag.
    head, tail = FIRST.encode().split(b"</robot>")
    assert cell.document.startswith(head)
    assert cell.document.endswith(b"</robot>" + tail)
    text = cell.document.decode("ascii")
    for renamed in (
        '<transmission name="t"><joint name="rotary_table_turn"/>',
        '<gazebo reference="rotary_table_base">',
        "<material name='rotary_table_grey'>",
        '<mimic joint="rotary_table_turn" multiplier="0.5"/>',
        '<!-- <link name="base"/> was here',
    ):
        assert renamed in text
    # yourdfpy, a second opinion on where everything is.
    alone, both = (yourdfpy.URDF.load(io.BytesIO(d), load_meshes=False) for d in (SECOND.encode(), cell.document))
    for q in (0.0, 0.7, -0.4):
        alone.update_cfg({"turn": q})
        both.update_cfg({"rotary_table_turn": q, "turn": 1.0})
        for link, name in cell.links.items():
            expected = T @ alone.get_transform(link, "base")
            np.testing.assert_allclose(both.get_transform(name, "base"), expected, atol=1e-12)
    assert {m.name for m in both.robot.materials} == {"grey", "rotary_table_grey", "blue"}


def test_machines_without_a_common_name_keep_theirs() -> None:
    table = re.sub(r"\b(base|turn|grey)\b", r"my_\1", SECOND)
    cell = compose(parse_urdf(FIRST.encode(), "a"), parse_urdf(table.encode(), "b"), "tip", T)
    assert all(old == new for names in (cell.links, cell.joints) for old, new in names.items())
    assert b'<joint name="my_base_mount" type="fixed">\n    <parent link="tip"/>' in cell.document


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1"])
@pytest.mark.parametrize("other", ["utf-8", "utf-16", "latin-1"])
def test_encodings_meet(encoding: str, other: str) -> None:
    declared = {"utf-8": "UTF-8", "utf-16": "UTF-16", "latin-1": "ISO-8859-1"}
    first = FIRST.replace('version="1.0"', f'version="1.0" encoding="{declared[encoding]}"').replace("arm:", "Ärm:")
    second = SECOND.replace("UTF-8", declared[other]).replace("pointer", "Zeigerspäne")
    cell = compose(parse_urdf(first.encode(encoding), "a"), parse_urdf(second.encode(other), "b"), "tip", T)
    assert cell.links["Zeigerspäne"] == "Zeigerspäne"
    assert "Zeigerspäne" in parse_urdf(cell.document, "cell").links
    assert "Ärm:" in cell.document.decode(encoding)


def test_a_name_may_be_taken_twice() -> None:
    """``table_base`` is there as well, so that the prefix comes twice."""
    first = FIRST.replace('<link name="tip"/>', '<link name="tip"/><link name="rotary_table_base"/>').replace(
        "</robot>",
        '<joint name="j" type="fixed"><parent link="base"/><child link="rotary_table_base"/></joint></robot>',
    )
    cell = compose(parse_urdf(first.encode(), "a"), parse_urdf(SECOND.encode(), "b"), "base", T)
    assert cell.links["base"] == "rotary_table_rotary_table_base"
    other = compose(parse_urdf(FIRST.encode(), "a"), parse_urdf(SECOND.encode(), "b"), "base", T, prefix="p2")
    assert other.links["base"] == "p2_base"


def test_what_cannot_be_composed_is_refused() -> None:
    first, second = parse_urdf(FIRST.encode(), "arm.urdf"), parse_urdf(SECOND.encode(), "table.urdf")
    with pytest.raises(calib.RobotError, match=r"arm.urdf: there is no link 'bse'; did you mean 'base'"):
        compose(first, second, "bse", T)
    with pytest.raises(calib.JobError, match="prefix: 'a b' is not made of the letters"):
        compose(first, second, "base", T, prefix="a b")
    with pytest.raises(calib.OutputError, match="reads back otherwise"):
        compose(first, second, "base", np.diag([2.0, 1.0, 1.0, 1.0]))
