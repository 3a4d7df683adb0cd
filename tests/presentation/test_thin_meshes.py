"""Thinned meshes: closed where they were, near the surface they had, and the same whether they were kept or not."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from calib.foundations import cache
from calib.presentation import thin_meshes
from calib.presentation.meshes import balls, creased, primitive, simplified
from calib.presentation.thin_meshes import thin_mesh
from calib.robot.mesh_files import Triangles, parse_mesh
from calib.robot.sources import examples_folder
from tests.presentation.test_scene import page_of, render_scene, scene

GREY = (0.5, 0.5, 0.5)
ROBOTS = examples_folder()
PANDA = sorted((ROBOTS / "panda_description/meshes/visual").glob("*.dae"))
UR10 = sorted((ROBOTS / "ur_description/meshes/ur10/visual").glob("*.dae"))


def loose_edges(part: Triangles) -> int:
    """Return how many edges have one face only: where a surface is torn, or ends."""
    edges = np.sort(part.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return int((np.unique(edges, axis=0, return_counts=True)[1] == 1).sum())


def farthest(a: Triangles, b: Triangles) -> float:
    """Return how far points all over a surface are from another, at most: one side of what Hausdorff has."""
    first, second = (trimesh.Trimesh(part.vertices, part.faces, process=False) for part in (a, b))
    points = trimesh.sample.sample_surface(first, 3000, seed=0)[0]
    return float(trimesh.proximity.closest_point(second, points)[1].max())


@pytest.mark.parametrize("path", [*UR10, *PANDA], ids=lambda path: path.stem)
def test_meshes_of_robots_stay_whole(path: Path) -> None:
    assert len(PANDA) == 10
    mesh = parse_mesh(path.read_bytes(), path.suffix, GREY)
    assert mesh is not None
    welded, thin = simplified(mesh.parts, 10**9), simplified(mesh.parts, 4000)
    assert sum(len(part.faces) for part in thin) <= 2 * 4000
    for before, after in zip(welded, thin, strict=True):
        assert loose_edges(after) <= loose_edges(before)
        size = max(float(np.ptp(part.vertices, axis=0).max()) for part in welded)
        assert farthest(before, after) < 0.01 * size
        assert farthest(after, before) < 0.01 * size


@pytest.mark.parametrize("size", [1e-3, 0.3, 300.0])
def test_a_ball_stays_a_ball(size: float) -> None:
    (small,) = simplified([balls(np.zeros((1, 3)), size, GREY, subdivisions=5)], 1000)
    assert 900 <= len(small.faces) <= 2000
    assert loose_edges(small) == 0
    assert np.abs(np.linalg.norm(small.vertices, axis=1) / size - 1.0).max() < 0.01
    mesh = trimesh.Trimesh(small.vertices, small.faces, process=False)
    assert mesh.volume / size**3 == pytest.approx(4.0 / 3.0 * np.pi, rel=0.02)  # all faces look outward


def test_what_is_small_enough_is_left() -> None:
    box = primitive("box", (0.1, 0.2, 0.3), GREY)
    (same,) = simplified([box], 100)
    assert len(same.faces) == 12
    assert {tuple(v) for v in same.vertices.round(9)} == {tuple(v) for v in box.vertices.round(9)}
    nothing = Triangles(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.intp), GREY)
    point = Triangles(np.zeros((300, 3)), np.arange(300).reshape(-1, 3), GREY)
    assert [len(part.faces) for part in simplified([nothing, point], 10)] == [0, 0]


def test_a_flat_sheet_keeps_its_edge() -> None:
    x, y = np.meshgrid(np.linspace(0.0, 0.3, 60), np.linspace(0.0, 0.2, 60))
    i = np.arange(59)[:, None] * 60 + np.arange(59)
    faces = np.concatenate([np.stack([i, i + 1, i + 61], axis=2), np.stack([i, i + 61, i + 60], axis=2)]).reshape(-1, 3)
    (sheet,) = simplified([Triangles(np.stack([x, y, 0.0 * x], axis=2).reshape(-1, 3), faces, GREY)], 800)
    assert len(sheet.faces) <= 1000
    a, b, c = np.swapaxes(sheet.vertices[sheet.faces], 0, 1)
    assert np.cross(b - a, c - a)[:, 2].sum() / 2.0 == pytest.approx(0.06)


def test_sharp_edges_stay_sharp_and_round_ones_smooth() -> None:
    (plain,) = simplified([primitive("box", (1.0, 1.0, 1.0), GREY)], 100)
    box, ball = creased([plain, balls(np.zeros((1, 3)), 1.0, GREY, 3)])
    assert len(box.vertices) == 24
    assert len(ball.vertices) == 642


# The cache. -------------------------------------------------------------------------------------------------------


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CALIB_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    path = tmp_path / "ball.stl"
    path.write_bytes(trimesh.creation.icosphere(subdivisions=4, radius=0.2).export(file_type="stl"))
    return path


def told(path: Path, most: int = 500, **changes: Any) -> Any:
    found = thin_mesh(path, GREY, most, **changes)
    if found is None:
        return None
    parts = [(part.rgb, part.vertices.tolist(), part.faces.tolist(), part.faces.dtype) for part in found.parts]
    return parts, found.corners, found.size


def test_a_kept_mesh_is_the_same_and_is_not_made_again(
    place: Path, ball: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = told(ball)
    assert len(list(place.iterdir())) == 1
    monkeypatch.setattr(thin_meshes, "parse_mesh", None)
    assert told(ball) == made
    ball.rename(ball.with_name("other.stl"))
    assert told(ball.with_name("other.stl")) == made


def test_another_mesh_another_share_and_another_maker_are_made(
    place: Path, ball: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told(ball)
    told(ball, 400)
    ball.write_bytes(ball.read_bytes()[:-2] + b"ab")
    told(ball)
    monkeypatch.setattr(thin_meshes, "_maker", lambda: "another")
    told(ball)
    assert len(list(place.iterdir())) == 4


def test_what_was_kept_and_makes_no_sense_is_made_anew(
    place: Path, ball: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = told(ball)
    (entry,) = place.iterdir()
    good = cache.kept(entry.stem)
    assert good is not None
    head, _, rest = good.partition(b"\n")
    nowhere = np.full(3, np.nan).tobytes() + rest[24:]
    beyond = rest[:-4] + np.int32(10**6).tobytes()
    heads = [b"", b"[]", b"{}", head.replace(b"corners", b"corner"), head.replace(b'"faces": ', b'"faces": -')]
    for bad in [*(one + b"\n" + rest for one in heads), *(head + b"\n" + one for one in (rest[:-1], nowhere, beyond))]:
        assert bad != good
        cache.keep(entry.stem, bad)
        assert told(ball) == made
        assert cache.kept(entry.stem) == good


def test_too_much_is_too_much_also_when_it_was_kept(place: Path, ball: Path) -> None:
    room = 3 * 20 * 4**4 - ball.stat().st_size
    made = told(ball, spare=room)
    assert made is not None
    assert told(ball, spare=room - 1) is None
    assert told(ball, spare=room) == made
    for entry in place.iterdir():
        entry.unlink()
    assert told(ball, spare=room - 1) is None


def test_a_scene_is_the_same_with_and_without(place: Path, ball: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = replace(scene(shape='<mesh filename="ball.stl"/>'), mesh_roots=(ball.parent,))
    first, second = render_scene(shown), render_scene(shown)
    assert len(list(place.iterdir())) == 2  # the mesh, and what the URDF says of looks
    monkeypatch.setenv("CALIB_CACHE", "off")
    assert first == second == render_scene(shown)
    assert page_of(first)["commands"]
