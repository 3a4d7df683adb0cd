"""The scene: its numbers, its meshes, its commands, and the page in a real browser."""

import base64
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.foundations.errors import RobotError
from calib.foundations.rigid import inverse, placement, rotation_about
from calib.presentation.meshes import balls, read_mesh, simplified, sticks
from calib.presentation.scene import Scene, magnification, render_scene
from calib.robot.sources import find_mesh

RED = (1.0, 0.0, 0.0)
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

URDF = """<robot name="arm"><material name="grey"><color rgba=".5 .5 .5 1"/></material>
<link name="base"><visual><geometry>{shape}</geometry><material name="grey"/></visual></link>
<link name="upper"/><link name="tip"/><link name="twin"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 .4"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="j2" type="fixed"><parent link="upper"/><child link="tip"/><origin xyz="0 0 .5"/></joint>
<joint name="j3" type="revolute"><parent link="base"/><child link="twin"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/><mimic joint="j1" multiplier="-2" offset="0.1"/></joint></robot>"""
BOX = '<box size=".2 .3 .1"/>'
MESH = '<mesh filename="package://arm/meshes/base.stl"/>'


def scene(n: int = 20, shape: str = BOX, **changes: Any) -> Scene:
    rng = np.random.default_rng(1)
    measured = rng.uniform(-0.5, 0.5, (n, 3))
    before = measured + rng.normal(scale=2e-3, size=(n, 3))
    after = measured + rng.normal(scale=1e-4, size=(n, 3))
    T = placement(rotation_about(np.array([0.0, 0.0, 1.0]), 0.7), np.array([0.3, -0.2, 0.1]))
    tools = {"ball": np.array([0.5, 0.0, 0.9])}
    urdf = URDF.format(shape=shape).encode()
    return replace(Scene("An <arm>", urdf, (), {"j1": 0.3}, T, tools, "tip", measured, before, after), **changes)


def page_of(text: str) -> dict[str, Any]:
    match = re.search(r'<script type="application/json" id="page">(.*?)</script>', text, re.DOTALL)
    assert match is not None
    page: dict[str, Any] = json.loads(match[1])
    return page


def legend_of(text: str) -> str:
    match = re.search(r'<div id="legend">(.*?)</div>', text, re.DOTALL)
    assert match is not None
    return match[1]


def commands_of(text: str) -> list[dict[str, Any]]:
    import umsgpack

    return [umsgpack.unpackb(base64.b64decode(command)) for command in page_of(text)["commands"]]


def transforms(commands: list[dict[str, Any]]) -> dict[str, Any]:
    placed = [c for c in commands if c["type"] == "set_transform"]
    return {c["path"]: np.array(c["matrix"]).reshape(4, 4).T for c in placed}


def vertices(commands: list[dict[str, Any]], path: str) -> Any:
    (command,) = [c for c in commands if c["type"] == "set_object" and c["path"] == path]
    (geometry,) = command["object"]["geometries"]
    return np.frombuffer(geometry["data"]["attributes"]["position"]["array"].data, np.float32).reshape(-1, 3)


def test_importing_calib_and_the_scene_loads_no_viewer() -> None:
    code = "import sys, calib.presentation.scene; print({'meshcat', 'yourdfpy', 'trimesh'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize(("error", "factor"), [(1e-3, 50.0), (4e-3, 10.0), (0.05, 1.0), (9.0, 1.0), (5e-6, 10000.0)])
def test_magnification_is_round_and_draws_p95_at_a_twentieth(error: float, factor: float) -> None:
    errors = np.zeros((100, 3))
    errors[:, 1] = error
    errors[0, 1] = 1e3  # one wild row does not set the scale
    assert magnification(errors, 1.0) == factor


def test_magnification_of_nothing_is_one() -> None:
    assert magnification(np.zeros((0, 3)), 1.0) == 1.0
    assert magnification(np.full((5, 3), 1e-13), 1.0) == 1.0


def test_balls_and_sticks_lie_where_they_are_told() -> None:
    centres = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
    ball = balls(centres, 0.1, RED)
    np.testing.assert_allclose(np.linalg.norm(ball.vertices.reshape(2, -1, 3) - centres[:, None], axis=2), 0.1)
    assert ball.faces.shape == (40, 3)
    stick = sticks(centres[[0, 0]], centres, 0.1, RED)  # the first has no length
    assert stick.vertices.shape == (8, 3)
    assert stick.faces.max() == 7
    axis = centres[1] / np.linalg.norm(centres[1])
    np.testing.assert_allclose(np.linalg.norm(stick.vertices - (stick.vertices @ axis)[:, None] * axis, axis=1), 0.1)


def test_simplified_keeps_the_budget_and_the_shape() -> None:
    ball = balls(np.zeros((1, 3)), 0.3, RED, subdivisions=5)
    (small,) = simplified([ball], 1000)
    assert 100 < len(small.faces) <= 1000
    assert np.abs(np.linalg.norm(small.vertices, axis=1) - 0.3).max() < 1e-9
    (same,) = simplified([ball], 10**6)
    assert len(same.faces) == len(ball.faces)


def test_meshes_are_found_below_their_roots_and_nowhere_else(tmp_path: Path) -> None:
    root, secret = tmp_path / "share", tmp_path / "secret.stl"
    mesh = root / "arm" / "meshes" / "base.stl"
    mesh.parent.mkdir(parents=True)
    mesh.write_text("solid")
    secret.write_text("solid")
    (root / "link.stl").symlink_to(secret)
    (root / "loop.stl").symlink_to(root / "loop.stl")
    (tmp_path / "share2").mkdir()
    (tmp_path / "share2" / "x.stl").write_text("solid")
    found = mesh.resolve()
    assert find_mesh("package://arm/meshes/base.stl", (root,)) == found
    assert find_mesh("package://arm/meshes/base.stl", (tmp_path / "none", root / "arm")) == found
    assert find_mesh("package://other/arm/meshes/base.stl", (root,)) == found
    assert find_mesh("arm/meshes/base.stl", (root,)) == found
    assert find_mesh(f"file://{mesh}", (root,)) == found
    assert find_mesh(str(mesh), (root,)) == found
    for uri in (
        "package://../secret.stl",
        "package://arm/../../secret.stl",
        "../secret.stl",
        "../share2/x.stl",
        f"file://{secret}",
        "file:///etc/passwd",
        "link.stl",
        "loop.stl",
        "arm",
        "http://example.com/base.stl",
        "file://%00",
        "x" * 5000,
        "",
    ):
        assert find_mesh(uri, (root,)) is None, uri
    assert find_mesh(str(mesh), ()) is None


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "off", "glb", "dae"])
def test_meshes_are_read_and_damaged_ones_are_not(kind: str, tmp_path: Path) -> None:
    import trimesh

    box = trimesh.creation.box(extents=(1.0, 2.0, 3.0)).export(file_type=kind)
    whole, damaged = tmp_path / f"whole.{kind}", tmp_path / f"damaged.{kind}"
    whole.write_bytes(box.encode() if isinstance(box, str) else box)
    damaged.write_bytes(b"\x00\xff<broken>" * 40)
    parts = read_mesh(whole, RED)
    assert parts is not None
    np.testing.assert_allclose(np.ptp(np.concatenate([part.vertices for part in parts]), axis=0), [1.0, 2.0, 3.0])
    assert read_mesh(damaged, RED) is None


def test_only_meshes_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.zip").write_bytes(b"PK\x03\x04")
    assert read_mesh(tmp_path / "a.zip", RED) is None
    assert read_mesh(tmp_path / "absent.stl", RED) is None


def test_page_stands_alone_and_repeats_exactly() -> None:
    text = render_scene(scene())
    assert text == render_scene(scene())
    assert "<title>An &lt;arm&gt;</title>" in text
    assert "default-src 'none'" in text
    assert not re.search(r"<(?:script|link|img|iframe)[^>]*\b(?:src|href)=", text)
    assert len(text) < 2_000_000


def test_everything_is_placed_in_the_base_frame() -> None:
    s = scene()
    commands = commands_of(render_scene(s))
    T = transforms(commands)
    np.testing.assert_allclose(T["/frames/base"], np.eye(4))
    np.testing.assert_allclose(T["/frames/instrument"], inverse(s.T_world_base), atol=1e-12)
    tip = np.array([0.5 * np.sin(0.3), 0.0, 0.4 + 0.5 * np.cos(0.3)])
    np.testing.assert_allclose(T["/frames/tip"][:3, 3], tip, atol=1e-12)
    turned = rotation_about(np.array([0.0, 0.0, 1.0]), 0.1 - 2 * 0.3)  # j3 mimics j1
    np.testing.assert_allclose(T["/robot/twin"][:3, :3], turned, atol=1e-12)
    ball = inverse(s.T_world_base) @ [*s.tool_points["ball"], 1.0]
    np.testing.assert_allclose(T["/frames/tools/ball"][:, 3], ball, atol=1e-12)
    np.testing.assert_allclose(np.ptp(vertices(commands, "/robot/base/0"), axis=0), [0.2, 0.3, 0.1], atol=1e-6)


def test_layers_join_measured_points_to_magnified_predictions() -> None:
    s = scene()
    text = render_scene(s)
    commands = commands_of(text)
    to_base = inverse(s.T_world_base)
    measured = s.measured @ to_base[:3, :3].T + to_base[:3, 3]
    scales = [float(x) for x in re.findall(r"data-scales='(\S+) (\S+)'", text)[0]]
    assert scales[1] > scales[0]
    dots = vertices(commands, "/measured/0").reshape(20, -1, 3)
    np.testing.assert_allclose(dots.mean(axis=1), measured, atol=1e-6)
    layers = {"before": (s.before, 0), "after": (s.after, 0), "after_magnified": (s.after, 1)}
    for name, (predicted, which) in layers.items():
        both = vertices(commands, f"/{name}/0")
        sticks_, ends = both[: 20 * 8].reshape(20, 2, 4, 3).mean(axis=2), both[20 * 8 :].reshape(20, -1, 3).mean(axis=1)
        drawn = measured + scales[which] * (predicted - s.measured) @ to_base[:3, :3].T
        np.testing.assert_allclose(sticks_[:, 0], measured, atol=1e-6)
        np.testing.assert_allclose(sticks_[:, 1], drawn, atol=1e-6)
        np.testing.assert_allclose(ends, drawn, atol=1e-6)
    hidden = [c["path"] for c in commands if c["type"] == "set_property" and c["value"] is False]
    assert hidden == ["/Axes", "/after_magnified"]


def test_legend_states_the_figures() -> None:
    s = scene()
    text = render_scene(s)
    for errors in (s.before - s.measured, s.after - s.measured):
        length = 1e3 * np.linalg.norm(errors, axis=1)
        assert f"<td>{np.sqrt(np.mean(length**2)):.3f}<td>{length.max():.3f}" in text
    assert "20 points" in text
    assert "not found" not in legend_of(text)


def test_missing_meshes_become_sticks_and_are_counted(tmp_path: Path) -> None:
    import trimesh

    text = render_scene(scene(shape=MESH, mesh_roots=(tmp_path,)))
    assert "1 mesh not found" in text
    folder = tmp_path / "arm" / "meshes"
    folder.mkdir(parents=True)
    (folder / "base.stl").write_bytes(trimesh.creation.box(extents=(0.2, 0.3, 0.1)).export(file_type="stl"))
    found = render_scene(scene(shape=MESH, mesh_roots=(tmp_path,)))
    assert "not found" not in legend_of(found)
    np.testing.assert_allclose(
        np.ptp(vertices(commands_of(found), "/robot/base/0"), axis=0), [0.2, 0.3, 0.1], atol=1e-6
    )


def test_many_points_stay_light() -> None:
    s = scene(5000)
    text = render_scene(s)
    assert len(text) < 8_000_000
    assert "1000 of the 5000 points" in text
    worst = s.measured[np.argmax(np.linalg.norm(s.after - s.measured, axis=1))]
    dots = vertices(commands_of(text), "/measured/0").reshape(1000, -1, 3).mean(axis=1)
    to_base = inverse(s.T_world_base)
    assert np.linalg.norm(dots - (to_base @ [*worst, 1.0])[:3], axis=1).min() < 1e-6


def test_huge_meshes_are_simplified(tmp_path: Path) -> None:
    import trimesh

    (tmp_path / "big.stl").write_bytes(trimesh.creation.icosphere(subdivisions=7, radius=0.2).export(file_type="stl"))
    text = render_scene(scene(shape='<mesh filename="big.stl"/>', mesh_roots=(tmp_path,)))
    assert "not found" not in legend_of(text)
    assert len(text) < 8_000_000


def test_a_scene_without_points_is_drawn() -> None:
    text = render_scene(scene(0, tool_points={}))
    assert "points" not in legend_of(text)
    assert not [c for c in commands_of(text) if c["type"] == "set_object" and c["path"].startswith("/before")]


def test_a_pose_or_tip_of_another_robot_is_refused() -> None:
    with pytest.raises(RobotError, match=r"'elbow'.*not in the URDF"):
        render_scene(scene(joint_positions={"elbow": 1.0}))
    with pytest.raises(RobotError, match="tip 'tool9' is not a link"):
        render_scene(scene(tip="tool9"))


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
@pytest.mark.parametrize("width", [1280, 390])
def test_page_opens_in_a_browser_without_error_or_request(width: int, tmp_path: Path) -> None:
    from PIL import Image

    assert CHROMIUM is not None
    (tmp_path / "scene.html").write_text(render_scene(scene()), encoding="utf-8")
    flags = (
        "--headless --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --disable-gpu-sandbox "
        "--disable-background-networking --disable-component-update --disable-sync --no-first-run "
        "--virtual-time-budget=4000 --enable-logging=stderr"
    )
    done = subprocess.run(
        [
            *(CHROMIUM, *flags.split(), f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={width},800"),
            *("--host-resolver-rules=MAP * ~NOTFOUND", f"--log-net-log={tmp_path / 'net.json'}"),
            *(f"--screenshot={tmp_path / 'scene.png'}", (tmp_path / "scene.html").as_uri()),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert [line for line in console if "GPU stall" not in line] == []
    # The browser's own errands have no initiator, or "not an origin"; a page's requests carry the page's.
    events = json.loads((tmp_path / "net.json").read_text())["events"]
    asked = [e["params"] for e in events if "url" in e.get("params", {})]
    assert [p["url"] for p in asked if p.get("initiator", "not an origin") != "not an origin"] == []
    picture = np.asarray(Image.open(tmp_path / "scene.png").convert("RGB")).astype(int)
    for colour in ((213, 94, 0), (0, 114, 178)):  # the legend and, blended, the points
        assert (np.abs(picture - colour).max(axis=2) < 12).sum() > 50
