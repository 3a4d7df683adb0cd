"""URDFs as people have them: xacro files, run when that is asked for, and meshes that are not there."""

import re
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.job import xacro as of_xacro
from calib.job.xacro import expanded
from calib.robot.sources import resolve
from calib.robot.urdf import parse_urdf
from tests.proposal.test_init import put
from tests.support.cases import ROOT, run
from tests.support.people import UR10

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
    assert "no column is a joint of the arm (j)" in said.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.urdf.xacro", "measured.csv"]
    assert b'xyz="0.30000000000000004 0 0"' in expanded(tmp_path / "arm.urdf.xacro").urdf
    (tmp_path / "broken.xacro").write_text("<robot>${1/0}</robot>")
    said = run("init", "broken.xacro", "measured.csv", "--xacro")
    assert said.code == 1
    assert said.err.startswith("Error: broken.xacro: xacro says '")
    assert len(said.err.splitlines()) == 1
    assert run("init", "no.xacro", "measured.csv", "--xacro").err == "Error: no.xacro: there is no such file.\n"


@pytest.mark.parametrize(
    ("inside", "says"),
    [
        ('<link name="${nothing}"/>', "xacro says \"name 'nothing' is not defined\"."),
        ('<xacro:if value="maybe"/>', "which is not a boolean expression.'."),
        (
            "<link name=\"${len('x' * 2000000000)}\"/>",
            "xacro needs more than the 1000000000 bytes of memory that are allowed.",
        ),
        (  # it warns of range first
            '<link name="${len(list(range(10**9)))}"/>',
            "xacro needs more than the 1000000000 bytes of memory that are allowed.",
        ),
        (
            "<link name=\"${[xacro.message('x' * 10**7) for _ in range(9)]}\"/>",
            "xacro writes more than the 10000000 bytes that are allowed.",
        ),
        ("<link name=\"${'x' * 10**7}\"/>", "xacro writes more than the 10000000 bytes that are allowed."),
        ('<link name="${9**9**9}"/>', "xacro took more than 1 s of processor time, which are allowed."),
    ],
)
def test_what_is_wrong_in_a_xacro_file_is_said_and_its_time_and_memory_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, inside: str, says: str
) -> None:
    pytest.importorskip("xacro")
    monkeypatch.setattr(of_xacro, "_RUN", of_xacro._RUN.replace("RLIMIT_CPU, 8", "RLIMIT_CPU, 1"))
    monkeypatch.setattr(of_xacro, "_OF_PROCESSOR", 1)
    (tmp_path / "a.xacro").write_text(XACRO.replace("</robot>", f"{inside}</robot>"))
    with pytest.raises(calib.RobotError) as raised:
        expanded(tmp_path / "a.xacro")
    assert str(raised.value).startswith(f"{tmp_path / 'a.xacro'}: xacro ")
    assert str(raised.value).endswith(says)


def test_of_files_that_a_xacro_file_includes_the_wrong_one_is_named_and_one_that_is_not_there_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("xacro")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "inner.xml").write_text("no robot")
    include = '<xacro:include filename="{}"/></robot>'
    (tmp_path / "a.xacro").write_text(XACRO.replace("</robot>", include.format("inner.xml")))
    with pytest.raises(calib.RobotError, match=r"a\.xacro: xacro says '.*line 1, column 0' of '.*inner\.xml'\.$"):
        expanded(tmp_path / "a.xacro")
    put(tmp_path, "FANUC")
    arm = Path(resolve(UR10)).read_text()
    (tmp_path / "arm.xacro").write_text(arm.replace("</robot>", include.format("tool_*.xacro")))
    said = run("init", "arm.xacro", "measured.csv", "--xacro", "--yes")
    assert said.code == 0
    assert "arm.xacro: xacro warns: " in " ".join(said.out.split())
    assert "tool_*.xacro" in "".join(said.out.split())


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("x" * 300 + ".xacro", "cannot be read (File name too long)."),
        ("folder.xacro", "is not a regular file."),
        ("a:=b.xacro", "a path with ':=' is an argument to xacro, and no file; call it otherwise."),
        ("foo.xacro", "what xacro makes of it:6: the outermost element is <foo>; a URDF has <robot>."),
    ],
)
def test_what_is_no_xacro_file_is_refused_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, says: str
) -> None:
    pytest.importorskip("xacro")
    monkeypatch.chdir(tmp_path)
    put(tmp_path, "points alone")
    (tmp_path / "folder.xacro").mkdir()
    for other in ("a:=b.xacro", "foo.xacro"):
        (tmp_path / other).write_text("<foo/>")
    said = run("init", name, "measured.csv", "--xacro")
    assert said.code == 1
    assert said.err.endswith(f"{says}\n")


def test_xacro_runs_again_and_takes_no_module_from_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("xacro")
    monkeypatch.chdir(tmp_path)
    put(tmp_path, "points alone")
    (tmp_path / "arm.urdf.xacro").write_text(XACRO)
    (tmp_path / "xacro.py").write_text("raise SystemExit('not asked for')")
    first, again = (run("init", "arm.urdf.xacro", "measured.csv", "--xacro") for _ in range(2))
    assert first == again
    assert "no column is a joint of the arm (j)" in again.err
    (tmp_path / "arm.urdf").write_text("mine")
    said = run("init", "arm.urdf.xacro", "measured.csv", "--xacro")
    assert said.err.startswith("Error: arm.urdf: already exists, and is not what arm.urdf.xacro makes; ")
    assert (tmp_path / "arm.urdf").read_text() == "mine"


@pytest.mark.parametrize(("name", "made"), [("arm.urdf.xacro", "arm.urdf"), ("arm.urdf", "arm_expanded.urdf")])
def test_the_urdf_of_a_xacro_file_stays_with_its_job(
    name: str, made: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of one that is called a URDF, as Elephant Robotics' are, which is kept."""
    pytest.importorskip("xacro")
    monkeypatch.chdir(tmp_path)
    put(tmp_path, "FANUC")
    (tmp_path / name).write_bytes(Path(resolve(UR10)).read_bytes())
    assert run("init", name, "measured.csv", "--xacro", "--yes").code == 0
    assert f'urdf = "{made}"' in (tmp_path / "calibration.toml").read_text()
    assert (tmp_path / made).read_bytes() == expanded(tmp_path / name).urdf
    assert (tmp_path / name).read_bytes() == Path(resolve(UR10)).read_bytes()


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
    urdf = (tmp_path / "arm_cmm.urdf").read_bytes()
    for change, what in (
        ((b"visual>", b"collision>"), "; calib plan judges no collisions of them, and nothing else needs them"),
        ((b"</robot>", b'<!-- <mesh filename="old.stl"/> --></robot>'), "1 of its 1 meshes are not found"),
    ):
        (tmp_path / "arm_cmm.urdf").write_bytes(urdf.replace(*change))
        assert what in " ".join(run("check", "calibration.toml").out.split())
    many = mesh.removesuffix(b"</link>") + b"".join(
        b'<visual><geometry><mesh filename="%d.stl"/></geometry></visual>' % k for k in range(1500)
    )
    (tmp_path / "arm_cmm.urdf").write_bytes(urdf.replace(b"</link>", many + b"</link>", 1))
    said = " ".join(run("check", "calibration.toml").out.split())
    assert "1000 of the first 1000 of its 1501 meshes are not found" in said


def test_origins_go_back_into_a_xacro_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A xacro file that loads the exported origins makes the arm of calibrated.urdf."""
    pytest.importorskip("xacro")
    monkeypatch.chdir(tmp_path)
    case = ROOT / "robots" / "arm_cmm"
    assert run("calibrate", str(case / "calibration.toml"), "-o", "out", "-q").code == 0
    assert run("export", "out", "--to", "xacro", "-o", "origins.yaml", "-q") == (0, "", "")
    urdf = parse_urdf((tmp_path / "out" / "nominal.urdf").read_bytes(), "nominal")
    text = urdf.source.decode()
    for joint in urdf.joints:
        own = "".join(f" {key}=\"${{origins['{joint.name}']['{key}']}}\"" for key in ("xyz", "rpy"))
        at = text.index(f'name="{joint.name}"')
        end = text.index("</joint>", at)
        inside = re.sub(r"<origin[^>]*/>", "", text[at:end])
        text = text[:at] + inside + f"<origin{own}/>" + text[end:]
    load = "<xacro:property name='origins' value=\"${xacro.load_yaml('origins.yaml')['origins']}\"/>"
    text = re.sub(r"(<robot[^>]*)>", rf'\1 xmlns:xacro="http://www.ros.org/wiki/xacro">{load}', text, count=1)
    (tmp_path / "arm.xacro").write_text(text)
    made = calib.load_robot(parse_urdf(expanded(tmp_path / "arm.xacro").urdf, "made"), "probe")
    should = calib.load_robot("out/calibrated.urdf", "probe")
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, len(made.readings)))
    np.testing.assert_allclose(made.tips(q), should.tips(q), rtol=0.0, atol=1e-12)
