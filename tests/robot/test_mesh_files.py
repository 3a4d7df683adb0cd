"""Triangles of mesh files: what is read here is what trimesh reads."""

import io
import json
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from calib.foundations.arrays import Array
from calib.robot.mesh_files import Triangles, parse_mesh
from calib.robot.sources import resolve

GREY = (0.5, 0.5, 0.5)


def binary_stl(corners: Array, told: int | None = None) -> bytes:
    """Return the bytes of a binary STL of triangles (N, 3, 3); it may tell of another number of them."""
    parts = [struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 7) for triangle in corners]
    return b"a robot".ljust(80) + struct.pack("<I", len(corners) if told is None else told) + b"".join(parts)


def read(data: bytes) -> Triangles:
    mesh = parse_mesh(data, ".stl", GREY)
    assert mesh is not None
    (part,) = mesh.parts
    assert mesh.corners == 3 * len(part.faces)
    return part


def test_binary_stl_is_read_as_trimesh_reads_it() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(40, 3)) * 10.0 ** rng.integers(-6, 3, size=(40, 1))
    points[0], points[1], points[2] = 0.0, -0.0, 3e-9
    data = binary_stl(points[rng.integers(0, 40, size=(300, 3))])
    found = read(data)
    expected = trimesh.load_mesh(io.BytesIO(data), file_type="stl")
    np.testing.assert_array_equal(found.vertices, expected.vertices)
    np.testing.assert_array_equal(found.faces, expected.faces)
    assert len(found.vertices) == 38
    assert found.rgb == GREY


def test_binary_stl_that_does_not_hold_what_it_tells_is_refused() -> None:
    corners = np.random.default_rng(1).normal(size=(5, 3, 3))
    assert len(read(binary_stl(corners)).faces) == 5
    for told in (0, 4, 6, 2**32 - 1):
        assert parse_mesh(binary_stl(corners, told), ".stl", GREY) is None
    assert parse_mesh(binary_stl(corners[:0]), ".stl", GREY) is None
    assert parse_mesh(binary_stl(corners)[:83], ".stl", GREY) is None


def test_a_mesh_without_extent_is_none() -> None:
    """As of a GLB that is packed by Draco: it was drawn as nothing at all, and no stick in its place."""
    packing = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    tree = {
        "asset": {"version": "2.0"},
        "extensionsRequired": list(packing),
        "buffers": [{"byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [
            {"componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "extensions": packing}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + 36, len(text), b"JSON")
    data = head + text + struct.pack("<I4s", 36, b"BIN\0") + bytes(range(36))
    assert parse_mesh(data, ".glb", GREY) is None
    assert parse_mesh(binary_stl(np.ones((5, 3, 3))), ".stl", GREY) is None


@pytest.mark.parametrize("number", [b"\x00\x00\xc0\x7f", b"\x01\x00\x80\x7f", b"\x00\x00\x80\x7f"])
def test_corners_that_are_no_numbers_are_refused(number: bytes) -> None:
    data = bytearray(binary_stl(np.random.default_rng(2).normal(size=(5, 3, 3))))
    data[96:100] = number
    assert parse_mesh(bytes(data), ".stl", GREY) is None


def test_text_stl_is_read_by_trimesh() -> None:
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [0, 0, 1]]], dtype=float)
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in triangle)
        + "endloop\nendfacet\n"
        for triangle in corners
    )
    found = read(f"solid a\n{facets}endsolid a\n".encode())
    np.testing.assert_array_equal(found.vertices[found.faces], corners)
    np.testing.assert_array_equal(read(binary_stl(corners)).vertices[read(binary_stl(corners)).faces], corners)


def test_a_plan_with_collision_meshes_waits_for_no_trimesh(tmp_path: Path) -> None:
    arm = "example:ur_description/urdf/ur10_robot.urdf"
    assert resolve(arm).read_bytes().count(b".stl") > 5
    code = "import atexit, sys; atexit.register(lambda: print('trimesh' in sys.modules))\n"
    command = [sys.executable, "-c", code + "from calib_start import main; main()", "plan", "-n", "12"]
    arguments = [arm, "--tip", "tool0", "--candidates", "50"]
    done = subprocess.run(
        [*command, *arguments, "-o", str(tmp_path / "plan.csv")], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "False"), done.stderr
    assert "not judged" not in done.stdout


TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.mark.parametrize(
    "text",
    [
        # Relative numbers are of the points before the face: the library counted from the end of the file.
        "o a\nv 0 0 0\nv 1 0 0\nv 0 2 0\nf -3 -1 -2\no b\nv 0 0 3\nf -4 -3 -1\nf -4 -1 -2\nf -3 -2 -1\n",
        TETRAHEDRON.replace("f 1 3 2", "f \\\n1/-1/-1 3/1/1 2/1/1").replace("v 0 0 3", "v 0 0 3\nvt 0 0\nvn 0 0 1"),
        TETRAHEDRON.replace("v ", "  v  ").replace("f ", "\tf "),
        TETRAHEDRON.replace("v ", "v\t"),
        TETRAHEDRON.replace("\n", "  # an index: 9\n"),
        TETRAHEDRON.replace("\n", "\r\n"),
        "\ufeff" + TETRAHEDRON,
    ],
)
def test_an_obj_that_is_written_otherwise_is_the_same_shape(text: str) -> None:
    expected = parse_mesh(TETRAHEDRON.encode(), ".obj", GREY)
    found = parse_mesh(text.encode(), ".obj", GREY)
    assert expected is not None
    assert found is not None
    corners = [np.concatenate([part.vertices[part.faces] for part in mesh.parts]) for mesh in (expected, found)]
    assert {triangle.tobytes() for triangle in np.sort(corners[0], axis=1)} == {
        triangle.tobytes() for triangle in np.sort(corners[1], axis=1)
    }


@pytest.mark.parametrize("number", ["0", "5", "-5"])
def test_an_obj_with_the_number_of_no_point_is_refused(number: str) -> None:
    assert parse_mesh(TETRAHEDRON.replace("f 1", f"f {number}").encode(), ".obj", GREY) is None


@pytest.mark.parametrize("number", ["nan", "inf", "1e400"])
@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply", ".stl"])
def test_a_text_with_corners_that_are_no_numbers_is_refused(number: str, suffix: str) -> None:
    """The library left their triangles out, and kept the others."""
    points, faces = ["0 0 0", "1 0 0", "0 2 0", "0 0 3"], [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]

    def text(points: list[str]) -> str:
        threes = "\n".join([*points, *(f"3 {a} {b} {c}" for a, b, c in faces)])
        facets = (
            "facet normal 0 0 0\nouter loop\n" + "".join(f"vertex {points[k]}\n" for k in face) + "endloop\nendfacet\n"
            for face in faces
        )
        places = "".join(f"property float {axis}\n" for axis in "xyz")
        return {
            ".obj": TETRAHEDRON.replace("v 0 2 0", f"v {points[2]}"),
            ".off": f"OFF\n4 4 0\n{threes}\n",
            ".ply": f"ply\nformat ascii 1.0\nelement vertex 4\n{places}element face 4\n"
            f"property list uchar int vertex_indices\nend_header\n{threes}\n",
            ".stl": f"solid a\n{''.join(facets)}endsolid a\n",
        }[suffix]

    assert parse_mesh(text(points).encode(), suffix, GREY) is not None
    assert parse_mesh(text([*points[:2], f"0 {number} 0", points[3]]).encode(), suffix, GREY) is None


def _glb(change: Callable[[dict[str, Any]], object]) -> bytes:
    """Return a GLB of one tetrahedron, its tree changed."""
    places = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], dtype="<f4").tobytes()
    binary = places + np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3], dtype="<u2").tobytes()
    tree: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 2, 3]},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(binary), len(text), b"JSON")
    return head + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary


def test_a_glb_of_places_that_the_library_takes_for_others_is_refused() -> None:
    """Fractions of a range were drawn as 65535 times as large, and places that replace others were passed over."""
    sparse = {"count": 1, "indices": {"bufferView": 1, "componentType": 5123}, "values": {"bufferView": 0}}
    for harmless in (
        lambda tree: tree,
        lambda tree: tree.update(extensionsRequired=["KHR_materials_unlit"]),
        lambda tree: tree["meshes"][0].update(weights=[0.0]),
    ):
        assert parse_mesh(_glb(harmless), ".glb", GREY) is not None
    for change in (
        lambda tree: tree["accessors"][0].update(normalized=True, componentType=5123),
        lambda tree: tree["accessors"][0].update(sparse=sparse),
        lambda tree: tree["accessors"][1].update(sparse=sparse),
        lambda tree: tree["meshes"][0].update(weights=[0.5]),
        lambda tree: tree["nodes"][0].update(skin=0),
        lambda tree: tree.update(extensionsRequired=["EXT_meshopt_compression"]),
        lambda tree: tree.update(extensionsRequired=5),
    ):
        assert parse_mesh(_glb(change), ".glb", GREY) is None


_DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="12">{}</float_array>
<technique_common><accessor source="#a" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common>
</source>
<source id="n"><float_array id="b" count="3">{}</float_array>
<technique_common><accessor source="#b" count="1" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common>
</source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="2">
<input semantic="VERTEX" source="#v" offset="0"/><input semantic="NORMAL" source="#n" offset="1"/>
<p>0 0 1 0 2 0 0 0 2 0 3 0</p></triangles></mesh></geometry></library_geometries><library_visual_scenes>
<visual_scene id="s"><node><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def test_a_collada_with_places_that_are_no_numbers_is_refused() -> None:
    """Triangles with a corner at infinity were lost, and NaN was taken for 0. Of normals that is as good."""
    places = "0 0 0 1 0 0 1 1 0 0 1 "
    for normal in ("0 0 1", "0 0 nan", "inf 0 0"):
        (part,) = parse_mesh(_DAE.format(places + "0", normal).encode(), ".dae", GREY).parts  # type: ignore[union-attr]
        assert (len(part.faces), len(part.vertices)) == (2, 4)
    for last in ("inf", "-INF", "nan", "1e39", "1e400", "none"):
        assert parse_mesh(_DAE.format(places + last, "0 0 1").encode(), ".dae", GREY) is None


@pytest.mark.parametrize(
    "node", ["<translate>100 0 0</translate>", "<matrix>1 0 0 100 0 1 0 0 0 0 1 0 0 0 0 1</matrix>"]
)
def test_the_places_of_the_nodes_of_a_collada_are_in_its_unit(node: str) -> None:
    """A part that its node puts 100 mm away stood 100 m away: the corners alone were taken to metres."""
    text = _DAE.format("0 0 0 1 0 0 1 1 0 0 1 0", "0 0 1").replace("<node>", f"<node>{node}")
    text = text.replace("<asset>", '<asset><unit name="millimeter" meter="0.001"/>')
    (part,) = parse_mesh(text.encode(), ".dae", GREY).parts  # type: ignore[union-attr]
    np.testing.assert_allclose(part.vertices.min(axis=0), [0.1, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(part.vertices.max(axis=0), [0.101, 0.001, 0.0], atol=1e-12)
