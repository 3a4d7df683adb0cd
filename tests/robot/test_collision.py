"""Self-collision against geometry that can be worked out: balls on the links of arms."""

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import coal
import numpy as np
import pytest

import calib
from calib.assessment.candidates import random_candidates
from calib.foundations.errors import JobError, RobotError
from calib.identification.machine import Frames
from calib.robot.collision import MOST_SHAPES, _Poses, self_collision
from calib.robot.urdf import parse_urdf
from scripts.development import hostile_files
from tests.support import machines
from tests.support.collisions import ARM, BALLS, RADIUS, ball, with_shapes


def robot_of(urdf: str, tip: str = "tip") -> calib.Robot:
    return calib.load_robot(parse_urdf(urdf.encode(), "inline.urdf"), tip)


@pytest.mark.parametrize("origin_first", [True, False])
def test_balls_touch_when_their_centres_are_near(origin_first: bool) -> None:
    robot = robot_of(with_shapes(ARM, {link: ball(at, origin_first=origin_first) for link, at in BALLS.items()}))
    readings = machines.arm(ARM, "tip").draw(np.random.default_rng(0), 400)
    # machines.py walks the arm by itself; every link but the tip is the tip of a shorter arm.
    centres = []
    for link, at in BALLS.items():
        if link == "base":
            centres.append(np.zeros((400, 3)))
            continue
        part = machines.arm(ARM, link)
        T = part.tips(readings[:, : len(part.joints)])
        centres.append(T[:, :3, :3] @ np.array(at, dtype=float) + T[:, :3, 3])
    expected = np.zeros(400, dtype=bool)
    for i in range(5):
        for j in range(i + 2, 5):  # neighbours touch at their joint
            expected |= np.linalg.norm(centres[i] - centres[j], axis=1) < 2 * RADIUS
    found = self_collision(robot)
    assert found is not None
    assert found.notes == ()
    assert 20 < expected.sum() < 380
    np.testing.assert_array_equal(found.colliding(readings), expected)


def test_bodies_that_always_touch_are_left_out_and_said() -> None:
    shapes = {link: ball(at) for link, at in BALLS.items()} | {"base": ball((0, 0, 0.45), 0.3)}
    robot = robot_of(with_shapes(ARM, shapes))
    found = self_collision(robot)
    assert found is not None
    assert found.notes == ("base and link_b touch in every sampled pose, and are not judged.",)
    alone = self_collision(robot_of(with_shapes(ARM, {k: v for k, v in shapes.items() if k != "link_b"})))
    assert alone is not None
    readings = machines.arm(ARM, "tip").draw(np.random.default_rng(1), 100)
    assert np.all(found.colliding(readings) >= alone.colliding(readings))


def test_fixed_links_belong_to_the_body_that_carries_them() -> None:
    """A flange behind the last joint is no neighbour's neighbour: it touches the link before the joint lawfully."""
    arm = ARM.replace(
        "</robot>",
        '<link name="flange"/><joint name="f" type="fixed"><parent link="tip"/><child link="flange"/></joint></robot>',
    )
    robot = robot_of(with_shapes(arm, {"link_c": ball((0.3, 0, 0)), "flange": ball((0.0, 0, 0))}), "flange")
    found = self_collision(robot, readings=np.zeros((1, 4)))
    assert found is not None
    assert not found.colliding(np.zeros((1, 4))).any()


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        ('<box size="0.2 0.2 0.2"/>', 0.1),
        ('<cylinder radius="0.1" length="0.2"/>', 0.1),
        ('<sphere radius="0.1"/>', 0.1),
    ],
)
def test_boxes_cylinders_and_balls_end_where_they_say(shape: str, size: float) -> None:
    slide = machines.urdf(
        ("x", "prismatic", "0 0 0", "0 0 0", "1 0 0"),
        ("y", "prismatic", "0 0 0", "0 0 0", "0 1 0"),
    )
    shapes = {"base": f"<collision><geometry>{shape}</geometry></collision>", "tip": ball((0, 0, 0), 0.05)}
    robot = robot_of(with_shapes(slide, shapes))
    found = self_collision(robot, readings=np.array([[0.5, 0.5]]))
    assert found is not None
    just = size + 0.05
    readings = np.array([[just - 1e-3, 0.0], [just + 1e-3, 0.0], [0.0, just - 1e-3], [0.0, just + 1e-3]])
    assert found.colliding(readings).tolist() == [True, False, True, False]


FACES = "1 2 4,1 4 3,5 7 8,5 8 6,1 5 6,1 6 2,3 4 8,3 8 7,1 3 7,1 7 5,2 6 8,2 8 4"
CUBE = "\n".join(
    [f"v {x} {y} {z}" for x, y, z in np.ndindex(2, 2, 2)] + [f"f {corners}" for corners in FACES.split(",")]
)


@pytest.mark.parametrize(
    "named", ["mtllib trap.mtl\n", " mtllib trap.mtl\r\n", "\tmtllib \\\ntrap.mtl\n", "mtl\\\r\nlib trap.mtl\n"]
)
def test_materials_that_a_mesh_names_are_not_opened(tmp_path: Path, named: str) -> None:
    """A pipe of that name, or an endless device, would never be read to its end."""
    os.mkfifo(tmp_path / "trap.mtl")
    os.mkfifo(tmp_path / "cube.mtl")
    (tmp_path / "cube.obj").write_bytes((named + CUBE).encode())
    slide = machines.urdf(("x", "prismatic", "0 0 0", "0 0 0", "1 0 0"), ("y", "prismatic", "0 0 0", "0 0 0", "0 1 0"))
    mesh = '<collision><geometry><mesh filename="cube.obj" scale="0.1 0.2 0.1"/></geometry></collision>'
    robot = robot_of(with_shapes(slide, {"base": mesh, "tip": ball((0, 0, 0.05), 0.05)}))
    found = self_collision(robot, (tmp_path,), np.array([[0.5, 0.5]]))
    assert found is not None
    assert found.notes == ()
    assert found.colliding(np.array([[0.14, 0.05], [0.16, 0.05]])).tolist() == [True, False]


def test_meshes_are_read_below_the_roots_only_and_scaled(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "cube.obj").write_text(CUBE)
    slide = machines.urdf(("x", "prismatic", "0 0 0", "0 0 0", "1 0 0"), ("y", "prismatic", "0 0 0", "0 0 0", "0 1 0"))
    mesh = (
        '<collision><geometry><mesh filename="package://arm/in/cube.obj" scale="0.1 0.2 0.1"/></geometry></collision>'
    )
    robot = robot_of(with_shapes(slide, {"base": mesh, "tip": ball((0, 0, 0.05), 0.05)}))
    found = self_collision(robot, (tmp_path,), np.array([[0.5, 0.5]]))
    assert found is not None
    assert (
        found.colliding(np.array([[0.14, 0.05], [0.16, 0.05], [0.05, 0.24], [0.05, 0.26]])).tolist()
        == [True, False] * 2
    )
    (tmp_path / "elsewhere").mkdir()
    outside = self_collision(robot, (tmp_path / "elsewhere",))
    assert outside is not None
    assert outside.notes == (
        "The collision shape of link 'base' is the mesh 'package://arm/in/cube.obj', which is not found or not read, "
        "and is not judged.",
    )
    assert not outside.colliding(np.array([[0.0, 0.0]])).any()


@pytest.mark.parametrize(
    ("shape", "why"),
    [
        ('<box size="1 1"/>', "has '1 1' where 3 numbers are needed, and is not judged"),
        ('<sphere radius="big"/>', "has 'big' where 1 numbers are needed, and is not judged"),
        ("<cone/>", "is a 'cone', which is not a known shape; its collisions are not judged"),
    ],
)
def test_broken_shapes_are_said_and_not_judged(shape: str, why: str) -> None:
    broken = f"<collision><geometry>{shape}</geometry></collision>"
    found = self_collision(robot_of(with_shapes(ARM, {"base": broken, "tip": ball((0, 0, 0))})))
    assert found is not None
    assert found.notes == (f"The collision shape of link 'base' {why}.",)
    assert self_collision(robot_of(with_shapes(ARM, {"base": broken}))) is None


@pytest.mark.parametrize("value", [1e30, np.nan])
def test_a_mesh_of_no_size_is_not_judged(tmp_path: Path, value: float) -> None:
    corners = np.array([[0.0, 0.0, 0.0], [value, 0.0, 0.0], [0.0, 1.0, 0.0]], dtype="<f4")
    facet = np.concatenate([np.zeros(3, dtype="<f4"), corners.ravel()]).tobytes() + bytes(2)
    (tmp_path / "m.stl").write_bytes(bytes(80) + (1).to_bytes(4, "little") + facet)
    mesh = '<collision><geometry><mesh filename="m.stl"/></geometry></collision>'
    found = self_collision(robot_of(with_shapes(ARM, {"base": mesh, "tip": ball((0, 0, 0))})), [tmp_path])
    assert found is not None
    why = "cannot be read or is too large" if np.isnan(value) else "has corners beyond 1e+06 m"
    assert found.notes[0].endswith(f"'m.stl', which {why}, and is not judged.")
    assert len(found.shapes) == 1


@pytest.mark.parametrize(
    "name",
    [
        "dae doubling, judged",
        "dae doubling by name, judged",
        "dae of one id, judged",
        "dae instances, judged",
        "obj materials, judged",
    ],
)
def test_a_mesh_that_swells_is_not_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    hostile_files.fill(name, tmp_path, 40_000)
    (path,) = tmp_path.glob("m.*")
    monkeypatch.setattr("trimesh.load_scene", None)
    mesh = f'<collision><geometry><mesh filename="{path.name}"/></geometry></collision>'
    found = self_collision(robot_of(with_shapes(ARM, {"base": mesh, "tip": ball((0, 0, 0))})), [tmp_path])
    assert found is not None
    assert found.notes[0].endswith(f"{path.name!r}, which cannot be read or is too large, and is not judged.")
    assert len(found.shapes) == 1


PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
"""


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("m.ply", PLY + "3 0 1 2\n", ""),
        ("m.ply", PLY + "3 0 1 -1\n", "cannot be read or is too large"),
        ("m.ply", PLY + "3 0 1 2147483647\n", "cannot be read or is too large"),
        ("m.ply", PLY + "0\n", "cannot be read or is too large"),
        ("m.ply", PLY.replace("element vertex 3", "element vertex 90000000") + "3 0 1 2\n", "cannot be read"),
        ("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n", "cannot be read or is too large"),
        ("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 nan\nf 1 2 3\n", "cannot be read or is too large"),
        ("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 2\n", "has no triangles"),
    ],
)
def test_a_damaged_mesh_costs_its_shape_alone(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str, text: str, why: str
) -> None:
    """A reader in C++ ended the process at some of these, and wrote to the terminal at others."""
    (tmp_path / name).write_text(text)
    mesh = f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'
    found = self_collision(robot_of(with_shapes(ARM, {"base": mesh, "tip": ball((0, 0, 0))})), [tmp_path])
    assert found is not None
    assert len(found.shapes) == (1 if why else 2)
    assert all(why in note for note in found.notes)
    assert capfd.readouterr() == ("", "")


def needles(many: int, seed: int) -> bytes:
    """Return an STL of triangles in all directions that are all near each other and hardly touch."""
    rng = np.random.default_rng(seed)
    ends = rng.normal(size=(2, many, 3))
    ends /= np.linalg.norm(ends, axis=2)[:, :, None]
    facets = np.zeros(many, dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
    facets["corners"] = np.stack([ends[0], ends[1], ends[1] + rng.normal(scale=1e-6, size=(many, 3))], axis=1)
    return bytes(80) + many.to_bytes(4, "little") + facets.tobytes()


def test_meshes_that_wind_into_each_other_count_by_the_time_they_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.stl").write_bytes(needles(500, 0))
    (tmp_path / "b.stl").write_bytes(needles(500, 1))
    shapes = {
        link: f'<collision><geometry><mesh filename="{"ab"[k % 2]}.stl"/></geometry></collision>'
        for k, link in enumerate(BALLS)
    }
    monkeypatch.setattr("calib.robot.collision._LEAST_TESTS", 10_000)
    # Three pairs in 200 poses are 2400 tests, and take a hundred times longer.
    with pytest.raises(RobotError, match=r"takes more than 20000 tests of two of them; "):
        self_collision(robot_of(with_shapes(ARM, shapes)), [tmp_path])


def test_triangles_that_lie_on_each_other_are_refused_before_each_is_judged_with_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "m.stl").write_bytes(needles(20_000, 2))
    mesh = '<collision><geometry><mesh filename="m.stl"/></geometry></collision>'
    judged: list[int] = []

    def collide(a: Any, *more: Any) -> int:
        judged.append(a.num_tris)
        return int(coal.collide(a, *more))

    monkeypatch.setattr("calib.robot.collision.coal", SimpleNamespace(**vars(coal) | {"collide": collide}))
    with pytest.raises(RobotError, match=r"takes more than 300000 tests of two of them; "):
        self_collision(robot_of(with_shapes(ARM, dict.fromkeys(BALLS, mesh))), [tmp_path])
    assert set(judged) == {1000}


def test_an_arm_without_shapes_has_none() -> None:
    assert self_collision(robot_of(ARM)) is None


def many(shape: str, count: int) -> dict[str, str]:
    """Return so many shapes on every link, a millimetre apart."""
    return {
        link: "".join(
            f'<collision><origin xyz="0 0 {k * 1e-3}"/><geometry>{shape}</geometry></collision>' for k in range(count)
        )
        for link in BALLS
    }


def test_shapes_that_touch_too_often_to_be_judged_are_refused() -> None:
    robot = robot_of(with_shapes(ARM, many('<box size="1e-4 1e-4 1"/>', 40)))
    with pytest.raises(RobotError, match=r"inline.urdf: to find .* takes more than 300000 tests of two of them; "):
        found = self_collision(robot)
        assert found is not None
        found.colliding(machines.arm(ARM, "tip").draw(np.random.default_rng(0), 1000))


def test_shapes_end(tmp_path: Path) -> None:
    robot = robot_of(with_shapes(ARM, many('<sphere radius="1"/>', MOST_SHAPES // 5 + 1)))
    with pytest.raises(RobotError, match=r"inline.urdf: has 1005 collision shapes; allowed are 1000, unless "):
        self_collision(robot)


def test_hundreds_of_shapes_are_tested_where_they_are_near_each_other_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = robot_of(with_shapes(ARM, many('<sphere radius="4e-4"/>', 50)))
    tested: list[int] = []
    touch = _Poses._touch

    def counting(poses: _Poses, a: int, b: int, pose: int) -> bool:
        tested.append(pose)
        return touch(poses, a, b, pose)

    monkeypatch.setattr(_Poses, "_touch", counting)
    found = self_collision(robot)
    assert found is not None
    assert len(tested) < 200


def test_a_mesh_that_comes_often_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "m.stl").write_bytes(hostile_files._stl(5_000))
    read: list[Path] = []
    monkeypatch.setattr("calib.robot.collision.read_bytes", lambda path, *rest: read.append(path) or path.read_bytes())
    for scale in ("", ' scale="2 2 2"'):
        mesh = many('<mesh filename="m.stl"/>', 3) | {"tip": many(f'<mesh filename="m.stl"{scale}/>', 1)["tip"]}
        found = self_collision(robot_of(with_shapes(ARM, mesh)), (tmp_path,), np.zeros((1, 4)))
        assert found is not None
        assert len(found.shapes) == 13
        assert len(read) == 1
        read.clear()


def test_scales_of_a_mesh_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "m.stl").write_bytes(hostile_files._stl(5_000))
    shapes = "".join(
        f'<collision><geometry><mesh filename="m.stl" scale="{1 + k} 1 1"/></geometry></collision>' for k in range(20)
    )
    robot = robot_of(with_shapes(ARM, {"base": shapes}))
    assert self_collision(robot, (tmp_path,), np.zeros((1, 4))) is not None
    monkeypatch.setattr("calib.robot.collision.MOST_CORNERS", 100)
    with pytest.raises(RobotError, match=r"inline.urdf: its collision meshes, in all their scales, have more corners "):
        self_collision(robot, (tmp_path,), np.zeros((1, 4)))


def test_poses_that_no_arm_can_take_are_given_up_soon() -> None:
    """Shapes that touch nearly always, and not always, which would leave them out."""
    robot = robot_of(with_shapes(ARM, {"base": ball((0, 0, 0), 3.0), "tip": ball((0, 0, 0))}))
    rows = np.zeros((2, 4))
    found = self_collision(robot, readings=rows)
    assert found is not None
    judged = replace(found, pairs=((0, 4),))
    with pytest.raises(JobError, match=r"only 0 of 2000 random poses can be measured, .*: 2000 touching itself"):
        random_candidates(robot, Frames(np.eye(4)[None], np.eye(4)[None]), 1000, collision=judged)
