"""URDFs as people have them: xacro files, run when that is asked for, and meshes that are not there."""

from pathlib import Path

import pytest

from tests.proposal.test_init import put
from tests.support.cases import ROOT, run

XACRO = """<?xml version="1.0"?>
<robot name="two" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="length" value="${0.2 + 0.1}"/>
  <link name="base"><visual><geometry><mesh filename="package://none/a.stl"/></geometry></visual></link>
  <link name="tip"/>
  <joint name="j" type="revolute"><parent link="base"/><child link="tip"/><origin xyz="${length} 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""


def test_xacro_runs_when_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("xacro")
    monkeypatch.chdir(tmp_path)
    put(tmp_path, "points alone")
    (tmp_path / "arm.urdf.xacro").write_text(XACRO)
    said = run("init", "arm.urdf.xacro", "measured.csv", "--xacro")
    assert said.code == 1
    assert 'xyz="0.30000000000000004 0 0"' in (tmp_path / "arm.urdf").read_text()
    assert "no column is a joint of the arm (j)" in said.err
    (tmp_path / "broken.xacro").write_text("<robot>${1/0}</robot>")
    said = run("init", "broken.xacro", "measured.csv", "--xacro")
    assert said.code == 1
    assert said.err.startswith("Error: broken.xacro: xacro says '")
    assert len(said.err.splitlines()) == 1
    assert run("init", "no.xacro", "measured.csv", "--xacro").err == "Error: no.xacro: there is no such file.\n"


def test_meshes_that_are_not_found_are_said_with_the_cure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    case = ROOT / "robots" / "arm_cmm"
    for name in ("calibration.toml", "identification.csv", "validation.csv"):
        (tmp_path / name).write_bytes((case / name).read_bytes())
    mesh = b'<visual><geometry><mesh filename="package://none/a.stl"/></geometry></visual></link>'
    (tmp_path / "arm_cmm.urdf").write_bytes((case / "arm_cmm.urdf").read_bytes().replace(b"</link>", mesh))
    said = " ".join(run("check", "calibration.toml").out.split())
    assert "1 of its 1 meshes are not found, such as 'package://none/a.stl'; the scene shows sticks" in said
    assert "AMENT_PREFIX_PATH" in said
