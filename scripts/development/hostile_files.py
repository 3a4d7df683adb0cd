"""Small files made to take long or to swell: every command refuses or serves them in 10 s of processor time and 1 GiB.

    python scripts/development/hostile_files.py                    every file, at three sizes up to 1 MB
    python scripts/development/hostile_files.py --only spheres     one of them
    python scripts/development/hostile_files.py --write FOLDER     write them all, and run nothing

Every file is filled by repeating what stands in it to a size in bytes. Each is read by a command in a process of its
own, of which processor time and the largest memory are printed with what it said; where one of them is above its limit
the script returns 1.
"""

import argparse
import io
import itertools
import json
import os
import resource
import shutil
import struct
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from calib.foundations.ranges import COUNTS, MOST_LOOPS, MOST_RELATED, MOST_TERMS, MOST_TOUCHED
from calib.job.stated import load_arm
from calib.machine.gaussian import GaussianResiduals, Kernel, gaussian_bytes
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.urdf import MOST_LINKS
from scripts.development.hostile_imports import IMPORTED, Fill
from tests.support import cameras, machines, streams

ROOT = Path(__file__).resolve().parents[2]
Floats = NDArray[np.float64]
CASE = ROOT / "robots" / "arm_cmm"
SIZES = (20_000, 150_000, 990_000)
SECONDS = 10.0
MEGABYTES = 1024.0
_PATIENCE = 15  # s of processor time after which a process is ended
_FILES = ("calibration.toml", "arm_cmm.urdf", "identification.csv", "validation.csv")
_PLAN = ("plan", "calibration.toml", "-o", "plan.csv", "-n", "20")
_CHOOSE = ("plan", "calibration.toml", "-o", "plan.csv", "--candidates", "candidates.csv")
_CALIBRATE = ("calibrate", "calibration.toml", "-o", "out")
_MODELS = ("models", "calibration.toml")
_COMMAND = "import sys; sys.argv[0] = 'calib'; from calib.cli import main; main()"
# A folder of results for the commands that read one; made once.
_RESULTS = "results"


class Hostile(NamedTuple):
    """``write`` fills files of a folder with the shipped case to about so many bytes; ``run`` reads them."""

    write: Callable[[Path, int], None]
    run: tuple[str, ...] = _CALIBRATE


class Measured(NamedTuple):
    """What a command took and said, and how it ended."""

    seconds: float
    megabytes: float
    code: int
    said: str


def repeated(piece: Callable[[int], str], size: int) -> str:
    """Return so many pieces, each made of its number, as go into ``size`` bytes, and one at least."""
    found: list[str] = []
    length = 0
    for k in itertools.count():
        text = piece(k)
        length += len(text.encode())
        if found and length > size:
            return "".join(found)
        found.append(text)
    raise AssertionError


# Of the robot. ---------------------------------------------------------------------------------------------------


def _urdf(piece: Callable[[int], str], before: str = "</robot>") -> Hostile:
    def write(folder: Path, size: int) -> None:
        path = folder / "arm_cmm.urdf"
        text = path.read_text(encoding="utf-8")
        many = repeated(piece, size - len(text))
        path.write_text(text.replace(before, many + before, 1), encoding="utf-8")

    return Hostile(write)


def _shape(shape: str) -> Hostile:
    return _urdf(
        lambda k: f'<link name="l{k}"/>' if not shape else f"<visual><geometry><{shape}/></geometry></visual>",
        "</link>",
    )


def _branches(k: int) -> str:
    return f'<link name="b{k}"/><joint name="f{k}" type="fixed"><parent link="base_link"/><child link="b{k}"/></joint>'


def _tail(k: int) -> str:
    parent = "base_link" if not k else f"t{k - 1}"
    return (
        f'<link name="t{k}"/><joint name="g{k}" type="revolute"><parent link="{parent}"/><child link="t{k}"/></joint>'
    )


def _collisions(k: int) -> str:
    return f'<collision><origin xyz="{k} 0 0"/><geometry><sphere radius=".1"/></geometry></collision>'


def _crossing(folder: Path, size: int) -> None:
    """Write thin long shapes on all links: their balls overlap, and they hardly touch."""
    path = folder / "arm_cmm.urdf"
    text = path.read_text(encoding="utf-8")
    shape = '<collision><origin xyz="0 0 {:.4f}"/><geometry><box size="1e-4 1e-4 1"/></geometry></collision>'
    links = text.count("</link>")
    many = repeated(lambda k: shape.format(k * 1e-3), (size - len(text)) // links)
    path.write_text(text.replace("</link>", many + "</link>"), encoding="utf-8")


def _needles(folder: Path, size: int) -> None:
    """Write two meshes of needles in all directions, which hardly touch and are all near each other, on all links."""
    rng = np.random.default_rng(0)
    for name in ("a.stl", "b.stl"):
        many = max(size // 100, 4)
        ends = rng.normal(size=(2, many, 3))
        ends /= np.linalg.norm(ends, axis=2)[:, :, None]
        facets = np.zeros(many, dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
        facets["corners"] = np.stack([ends[0], ends[1], ends[1] + rng.normal(scale=1e-6, size=(many, 3))], axis=1)
        (folder / name).write_bytes(bytes(80) + struct.pack("<I", many) + facets.tobytes())
    path = folder / "arm_cmm.urdf"
    *links, rest = path.read_text(encoding="utf-8").split("</link>")
    shapes = [f'<collision><geometry><mesh filename="{"ab"[k % 2]}.stl"/></geometry></collision>' for k in range(99)]
    many_links = "".join(f"{link}{shape}</link>" for link, shape in zip(links, shapes, strict=False))
    path.write_text(many_links + rest, encoding="utf-8")


def _chain(n: int) -> str:
    links = "".join(f'<link name="l{k}"/>' for k in range(n + 1))
    return (
        f'<robot name="r">{links}'
        + "".join(
            f'<joint name="j{k}" type="revolute"><origin xyz=".1 0 .1" rpy="1 .5 0"/><parent link="l{k}"/>'
            f'<child link="l{k + 1}"/></joint>'
            for k in range(n)
        )
        + "</robot>"
    )


def _masses(folder: Path, size: int) -> None:
    """Hang a row of masses on a link, each following the one before, as many as a URDF may have; drives give way."""
    path = folder / "arm_cmm.urdf"
    mass, follows = '<inertial><mass value="1"/></inertial>', '<mimic joint="m{}"/>'
    row = repeated(
        lambda k: (
            f'<link name="{k:0200d}">{mass}</link><joint name="m{k}" type="continuous"><parent link="'
            f'{f"{k - 1:0200d}" if k else "link_2"}"/><child link="{k:0200d}"/>'
            f"{follows.format(k - 1) if k else ''}</joint>\n"
        ),
        size,
    )
    many = "".join(row.splitlines(keepends=True)[: MOST_LINKS - 20])
    path.write_text(path.read_text(encoding="utf-8").replace("</robot>", many + "</robot>"), encoding="utf-8")
    _edited(folder / "calibration.toml", "[[measurements]]", 'elastic = "all"\n[[measurements]]')


def _long_arm(folder: Path, size: int) -> None:
    """Write an arm of so many joints that its table, of three rows for a joint, has the size; all of them free."""
    n = max(2, round((size / 16) ** 0.5))
    (folder / "arm_cmm.urdf").write_text(_chain(n), encoding="utf-8")
    chance = np.random.default_rng(0)
    header = ",".join([f"j{k} [rad]" for k in range(n)] + ["x [m]", "y [m]", "z [m]"])
    for name in ("identification.csv", "validation.csv"):
        rows = repeated(lambda _: ",".join(f"{v:.2f}" for v in chance.uniform(-3, 3, n + 3)) + "\n", size)
        (folder / name).write_text(f"{header}\n{rows}", encoding="utf-8")
    _edited(folder / "calibration.toml", 'tip = "probe"', f'tip = "l{n}"')


def _fork(folder: Path, size: int) -> None:
    """Write a long arm that ends in very many fingers, and a table that names as many joints as a table may."""
    joint = '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{0}"/><axis xyz="0 {2} 1"/></joint>'
    long, many = 199, min(790, max(2, size // 200 - 199))
    names = [*(f"f{k}" for k in range(long)), *(f"finger_x{k}" for k in range(many))]
    parents = ["base", *names[: long - 1], *[names[long - 1]] * many]
    links = "".join(f'<link name="{name}"/>' for name in ("base", *names))
    joints = "".join(
        joint.format(name, parent, k % 2) for k, (name, parent) in enumerate(zip(names, parents, strict=False))
    )
    (folder / "fork.urdf").write_text(f'<robot name="r">{links}{joints}</robot>', encoding="utf-8")
    rng = np.random.default_rng(0)
    rows = rng.uniform(-1.0, 1.0, (max(9, size // (5 * len(names))), len(names) + 3))
    _table(folder / "fork.csv", ",".join([*(f"{name} [rad]" for name in names), "x [m]", "y [m]", "z [m]"]), rows, 1)


# Of meshes. ------------------------------------------------------------------------------------------------------


def _mesh(name: str, data: Callable[[int], bytes], times: int = 1, *, judged: bool = False) -> Hostile:
    """A mesh that is drawn, or judged for collisions."""
    element = "collision" if judged else "visual"

    def write(folder: Path, size: int) -> None:
        (folder / name).write_bytes(data(size))
        shape = f'<{element}><geometry><mesh filename="{name}"/></geometry></{element}>'
        _edited(folder / "arm_cmm.urdf", "</link>", shape * times + "</link>")

    return Hostile(write, _PLAN) if judged else Hostile(write)


_TRIANGLE = (
    '<geometry id="g"><mesh><source id="p"><float_array id="a" count="9">0 0 0 1 0 0 0 1 0</float_array>'
    '<technique_common><accessor source="#a" count="3" stride="3"><param name="X" type="float"/><param name="Y" '
    'type="float"/><param name="Z" type="float"/></accessor></technique_common></source><vertices id="v"><input '
    'semantic="POSITION" source="#p"/></vertices><triangles count="{n}"><input semantic="VERTEX" source="#v" '
    'offset="0"/><p>{p}</p></triangles></mesh></geometry>'
)


def _dae(geometry: str, nodes: str, library: str = "") -> bytes:
    return (
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>'
        '<unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>'
        f"<library_geometries>{geometry}</library_geometries>{library}<library_visual_scenes><visual_scene "
        f'id="s">{nodes}</visual_scene></library_visual_scenes><scene>'
        '<instance_visual_scene url="#s"/></scene></COLLADA>'
    ).encode()


_ONE = '<instance_geometry url="#g"/>'


def _doubling(size: int) -> bytes:
    """Return a COLLADA file whose nodes have each other twice: two to the power of how many there are."""
    nodes = repeated(
        lambda k: f'<node id="n{k}">' + (f'<instance_node url="#n{k - 1}"/>' * 2 if k else _ONE) + "</node>",
        min(size, 4000),
    )
    last = nodes.count("<node ") - 1
    inside = f"<library_nodes>{nodes}</library_nodes>"
    return _dae(_TRIANGLE.format(n=1, p="0 1 2"), f'<node id="t"><instance_node url="#n{last}"/></node>', inside)


def _doubling_inline(size: int) -> bytes:
    """Return the same with nodes that stand in the scene, and point to those before them."""
    nodes = repeated(
        lambda k: f'<node id="n{k}">' + (f'<instance_node url="#n{k - 1}"/>' * 2 if k else _ONE) + "</node>",
        min(size, 4000),
    )
    return _dae(_TRIANGLE.format(n=1, p="0 1 2"), nodes)


def _doubling_by_name(size: int) -> bytes:
    """Nodes that one reader finds by their ids alone, and another by their names."""
    return _doubling(size).replace(b'<node id="', b'<node name="')


def _dae_of_one_id(size: int) -> bytes:
    """Geometries and nodes that share their ids, of which one reader takes the first and another the last."""
    small = _TRIANGLE.format(n=1, p="0 1 2")
    large = _TRIANGLE.format(n=size // 12, p="0 1 2 " * (size // 12))
    return _dae(large + small, "<node>" + repeated(lambda _: _ONE, size // 2) + "</node>")


def _dae_promise(size: int) -> bytes:
    """Counts of numbers and triangles that are not there."""
    promised = _TRIANGLE.format(n=10**9, p="0 1 2").replace('count="9"', 'count="900000000"')
    return _dae(promised, f"<node>{_ONE}</node>" + "<!-- -->" * (size // 8))


def _dae_instances(size: int) -> bytes:
    many = _TRIANGLE.format(n=size // 16, p="0 1 2 " * (size // 16))
    return _dae(many, "<node>" + repeated(lambda _: _ONE, size // 2) + "</node>")


def _dae_nodes(size: int) -> bytes:
    return _dae(_TRIANGLE.format(n=1, p="0 1 2"), repeated(lambda k: f'<node id="n{k}">{_ONE}</node>', size))


def _dae_deep(size: int) -> bytes:
    n = size // 13
    return _dae(_TRIANGLE.format(n=1, p="0 1 2"), "<node>" * n + _ONE + "</node>" * n)


def _dae_triangles(size: int) -> bytes:
    n = size // 6
    return _dae(_TRIANGLE.format(n=n, p="0 1 2 " * n), f"<node>{_ONE}</node>")


def _dae_polygon(size: int) -> bytes:
    n = size // 2
    polygon = (
        _TRIANGLE.format(n=1, p="0 " * n).replace("triangles", "polylist").replace("<p>", f"<vcount>{n}</vcount><p>")
    )
    return _dae(polygon, f"<node>{_ONE}</node>")


def _dae_geometries(size: int) -> bytes:
    one = _TRIANGLE.format(n=1, p="0 1 2")
    geometries = repeated(lambda k: one.replace('id="g"', f'id="g{k}"'), size)
    instances = "".join(f'<instance_geometry url="#g{k}"/>' for k in range(geometries.count("<geometry ")))
    return _dae(geometries, f"<node>{instances}</node>")


def _glb(tree: dict[str, object], binary: bytes = b"") -> bytes:
    text = json.dumps({"asset": {"version": "2.0"}, "scene": 0} | tree).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


_POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype="<f4").tobytes()
_MESHES = [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}]
_VIEWS = [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}]
_ACCESSORS = [
    {"componentType": 5126, "count": 3, "type": "VEC3", "bufferView": 0},
    {"componentType": 5125, "count": 3, "type": "SCALAR", "bufferView": 1},
]
_BINARY = _POINTS + np.arange(3, dtype="<u4").tobytes()
_SOUND: dict[str, object] = {
    "meshes": _MESHES,
    "bufferViews": _VIEWS,
    "accessors": _ACCESSORS,
    "buffers": [{"byteLength": 48}],
    "nodes": [{"mesh": 0}],
    "scenes": [{"nodes": [0]}],
}


def _glb_accessor(_: int) -> bytes:
    """Return a GLB whose points are nowhere in the file, and 400 million."""
    accessors: list[dict[str, object]] = [{"componentType": 5126, "count": 400_000_000, "type": "VEC3"}, _ACCESSORS[1]]
    return _glb(_SOUND | {"accessors": accessors}, _BINARY)


def _glb_accessors(size: int) -> bytes:
    n = size // 150
    accessors = [{"componentType": 5126, "count": 2_000_000, "type": "VEC3"}] * n
    meshes = [{"primitives": [{"attributes": {"POSITION": k}}]} for k in range(n)]
    nodes = [{"mesh": k} for k in range(n)]
    return _glb(_SOUND | {"accessors": accessors, "meshes": meshes, "nodes": nodes}, _BINARY)


def _glb_same_view(size: int) -> bytes:
    """Return a GLB of very many accessors that all show the same points."""
    n = size // 200
    points = np.zeros(size // 2 // 12 * 3, dtype="<f4").tobytes()
    views = [{"buffer": 0, "byteLength": len(points)}]
    count = len(points) // 12
    accessors = [{"componentType": 5126, "count": count, "type": "VEC3", "bufferView": 0}] * n
    meshes = [{"primitives": [{"attributes": {"POSITION": k}}]} for k in range(n)]
    tree = {"bufferViews": views, "accessors": accessors, "meshes": meshes, "buffers": [{"byteLength": len(points)}]}
    return _glb(_SOUND | tree | {"nodes": [{"mesh": k} for k in range(n)]}, points)


def _glb_views(size: int) -> bytes:
    """Return a GLB of very many views, each of all its bytes."""
    views = [*_VIEWS, *({"buffer": 0, "byteLength": size // 2} for _ in range(size // 80))]
    return _glb(_SOUND | {"bufferViews": views, "buffers": [{"byteLength": size // 2}]}, _BINARY.ljust(size // 2))


def _glb_pictures(_: int) -> bytes:
    """Return a GLB with a picture of 81 million black pixels, of which a material computes another one."""
    rows = zlib.compress(bytes((1 + 3 * 9000) * 9000), 9)
    head = struct.pack(">IIBBBBB", 9000, 9000, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", rows), (b"IEND", b""))
    png = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(part)) + kind + part + struct.pack(">I", zlib.crc32(kind + part)) for kind, part in chunks
    )
    names = ("diffuseTexture", "specularGlossinessTexture")
    more: dict[str, object] = {
        "images": [{"bufferView": 2, "mimeType": "image/png"}],
        "textures": [{"source": 0}],
        "materials": [{"extensions": {"KHR_materials_pbrSpecularGlossiness": {name: {"index": 0} for name in names}}}],
        "bufferViews": [*_VIEWS, {"buffer": 0, "byteOffset": len(_BINARY), "byteLength": len(png)}],
        "buffers": [{"byteLength": len(_BINARY) + len(png)}],
    }
    return _glb(_SOUND | more, _BINARY + png)


def _glb_instances(size: int) -> bytes:
    """Return a GLB of one large mesh that very many nodes have."""
    n, faces = size // 40, size // 24
    indices = np.tile(np.arange(3, dtype="<u4"), faces).tobytes()
    views = [_VIEWS[0], {"buffer": 0, "byteOffset": 36, "byteLength": len(indices)}]
    accessors = [_ACCESSORS[0], _ACCESSORS[1] | {"count": 3 * faces}]
    tree = {"nodes": [{"mesh": 0}] * n, "scenes": [{"nodes": list(range(n))}], "accessors": accessors}
    return _glb(
        _SOUND | tree | {"bufferViews": views, "buffers": [{"byteLength": 36 + len(indices)}]}, _POINTS + indices
    )


def _glb_chain(size: int) -> bytes:
    n = size // 30
    nodes: list[dict[str, object]] = [{"children": [k + 1]} for k in range(n)]
    return _glb(_SOUND | {"nodes": [*nodes, {"mesh": 0}]}, _BINARY)


def _glb_edges(size: int) -> bytes:
    """Return a GLB of some hundreds of nodes, each of which is the child of all before it."""
    n = int((size / 3) ** 0.5)
    nodes: list[dict[str, object]] = [{"children": list(range(k + 1, n + 1))} for k in range(n)]
    return _glb(_SOUND | {"nodes": [*nodes, {"mesh": 0}]}, _BINARY)


def _glb_doubling(size: int) -> bytes:
    n = size // 35
    nodes: list[dict[str, object]] = [{"children": [k + 1, k + 1]} for k in range(n)]
    return _glb(_SOUND | {"nodes": [*nodes, {"mesh": 0}]}, _BINARY)


def _obj(piece: Callable[[int], str]) -> Callable[[int], bytes]:
    return lambda size: ("v 0 0 0\nv 1 0 0\nv 0 1 0\n" + repeated(piece, size)).encode()


def _ply(size: int) -> bytes:
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element face {}\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
    n = size // 8
    return (head.format(n) + "3 0 1 2\n" * n).encode()


def _ply_lists(size: int) -> bytes:
    """Return a PLY of one thing with very many lists, each of them empty."""
    n = size // 30
    lists = "".join(f"property list uchar int {k}\n" for k in range(n))
    return f"ply\nformat binary_little_endian 1.0\nelement o 1\n{lists}end_header\n".encode() + bytes(n)


def _ply_promise(_: int) -> bytes:
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex 2000000000\nproperty float x\nproperty float y\n"
    return head + b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n" + bytes(48)


def _ply_polygon(kind: str) -> Callable[[int], bytes]:
    """One polygon of three points again and again, counted by a long number or line by line of text."""

    def write(size: int) -> bytes:
        text = kind == "ascii"
        n = size // 2 if text else size
        header = (
            f"ply\nformat {kind} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
            f"element face 1\nproperty list {'uchar' if text else 'uint'} uchar vertex_indices\nend_header\n"
        ).encode()
        if text:
            return header + b"0 0 0\n1 0 0\n0 1 0\n" + f"{n} ".encode() + b"0 1 2 " * (n // 3) + b"\n"
        corners = np.eye(3, dtype="<f4").tobytes()
        return header + corners + struct.pack("<I", n) + b"\0\1\2" * (n // 3) + b"\0" * (n % 3)

    return write


def _dae_polygons(kind: str) -> Callable[[int], bytes]:
    """A polygon of three points again and again, as COLLADA writes them."""

    def write(size: int) -> bytes:
        n = size // 2 // 3 * 3
        counts = f"<vcount>{n}</vcount>" if kind == "polylist" else ""
        geometry = _TRIANGLE.format(n=1, p="0 1 2 " * (n // 3)).replace("triangles", kind)
        return _dae(geometry.replace("<p>", f"{counts}<p>"), f"<node>{_ONE}</node>")

    return write


def _off(size: int) -> bytes:
    n = size // 8
    return (f"OFF\n3 {n} 0\n0 0 0\n1 0 0\n0 1 0\n" + "3 0 1 2\n" * n).encode()


def _off_promise(_: int) -> bytes:
    return b"OFF\n2000000000 2000000000 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"


def _stl(size: int) -> bytes:
    n = size // 50
    chance = np.random.default_rng(0)
    facet = np.zeros(n, dtype=[("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("flags", "<u2")])
    facet["points"] = chance.uniform(-1, 1, (n, 3, 3))
    return bytes(80) + struct.pack("<I", n) + facet.tobytes()


def _stl_ascii(size: int) -> bytes:
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    return repeated(lambda k: f"solid s{k}\n{facet}endsolid s{k}\n", size).encode()


# Of jobs. --------------------------------------------------------------------------------------------------------


def _edited(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text, old
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def _job(piece: Callable[[int], str]) -> Hostile:
    """Fill the job with sections."""

    def write(folder: Path, size: int) -> None:
        with (folder / "calibration.toml").open("a", encoding="utf-8") as file:
            file.write(repeated(piece, size))

    return Hostile(write)


def _list(key: str, piece: Callable[[int], str], before: str = "[[measurements]]") -> Hostile:
    """Fill a list of the job, at the end of the section before."""

    def write(folder: Path, size: int) -> None:
        path = folder / "calibration.toml"
        for line in (f'{key} = "all"',):
            text = path.read_text(encoding="utf-8")
            if f"\n{line}\n" in text:
                _edited(path, f"{line}\n", "")
        _edited(path, before, f"{key} = [\n{repeated(lambda k: piece(k) + ',' + chr(10), size)}]\n{before}")

    return Hostile(write)


_SECTION = '\n[[measurements]]\nfile = "identification.csv"\nsigma = "0.02 mm"\n'


# Of tables. ------------------------------------------------------------------------------------------------------


def _rows(column: Callable[[int], str], title: str, job: tuple[tuple[str, str], ...] = ()) -> Hostile:
    """Fill the table to be identified from with rows, and one column more."""

    def write(folder: Path, size: int) -> None:
        path = folder / "identification.csv"
        lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
        header, *rows = lines
        text = repeated(lambda k: f"{rows[k % len(rows)]}{',' if title else ''}{column(k)}\n", size)
        path.write_text(f"{header}{',' if title else ''}{title}\n{text}", encoding="utf-8")
        path = folder / "calibration.toml"
        path.write_text(path.read_text(encoding="utf-8").rpartition("[[measurements]]")[0], encoding="utf-8")
        for old, new in job:
            _edited(path, old, new)

    return Hostile(write)


def _wide(folder: Path, size: int) -> None:
    path = folder / "identification.csv"
    header, *rows = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    n = size // (len(rows) * 2)
    text = "".join(f"{row}{',0' * n}\n" for row in rows)
    path.write_text(header + "".join(f",c{k} [1]" for k in range(n)) + "\n" + text, encoding="utf-8")


# Of rows that all differ, of several arms: what many fits are made of. ---------------------------------------------

_UR10 = "example:ur_description/urdf/ur10_robot.urdf"
_NOISE = 0.05e-3  # of what is measured, m
_MADE = 0.5e-3  # of a deviation of an arm as it is made, m and rad
_PROCESS = (
    '[[levels]]\nname = "a"\nfree = ["*"]\n[[levels]]\nname = "b"\n'
    'residual_model = { kind = "gaussian_process" }\n[error_model]'
)


def _seen_by_tracker(robot: Robot, n: int, *, sigma: float = _NOISE, swing: float = 1.2) -> tuple[str, Floats]:
    """Header and rows (n, k) of positions at random readings of a badly made arm, in deg or m, and mm."""
    rng = np.random.default_rng(0)
    nominal = robot.no_deviations()
    made = replace(nominal, placements=rng.normal(0.0, _MADE, nominal.placements.shape))
    low, high = (
        np.array([getattr(r, end) or sign for r in robot.readings]) for end, sign in (("lower", -1), ("upper", 1))
    )
    middle, half = 0.5 * (low + high), np.minimum(0.45 * (high - low), swing)
    readings = middle + half * rng.uniform(-1.0, 1.0, (n, len(middle)))
    tips = np.concatenate([robot.tips(some, made) for some in np.array_split(readings, max(n // 1000, 1))])
    units = ["deg" if reading.dimension == "angle" else "m" for reading in robot.readings]
    header = [f"{reading.name} [{unit}]" for reading, unit in zip(robot.readings, units, strict=True)]
    shown = np.where([unit == "deg" for unit in units], np.degrees(readings), readings)
    measured = 1e3 * (tips[:, :3, 3] + rng.normal(0.0, sigma, (n, 3)))
    return ",".join([*header, "x [mm]", "y [mm]", "z [mm]"]), np.column_stack([shown, measured])


def _table(path: Path, header: str, rows: Floats, digits: int = 3) -> None:
    lines = (",".join(f"{value:.{digits}f}" for value in row) for row in rows)
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")


def _different(job: tuple[tuple[str, str], ...] = (), sigma: float = _NOISE) -> Callable[[Path, int], None]:
    """Fill the table to be identified from with rows of different poses, so many as there is room for."""

    def write(folder: Path, size: int) -> None:
        path = folder / "calibration.toml"
        path.write_text(path.read_text(encoding="utf-8").rpartition("[[measurements]]")[0], encoding="utf-8")
        robot = load_robot(folder / "arm_cmm.urdf", "probe")
        _table(folder / "identification.csv", *_seen_by_tracker(robot, size // 75, sigma=sigma))
        for old, new in job:
            _edited(path, old, new)

    return write


def _unrelated(
    observes: str,
    rows: int,
    cells: str = "",
    columns: str = "",
    relations: int = 0,
    run: tuple[str, ...] = _CALIBRATE,
) -> Hostile:
    """Fill a table with ``rows`` touches of each of most targets at poses that have nothing to do with them.

    ``relations`` between as many targets as may have some contradict each other.
    """

    def write(folder: Path, size: int) -> None:
        robot = load_robot(folder / "arm_cmm.urdf", "probe")
        header, table = _seen_by_tracker(robot, min(size // 60, MOST_TOUCHED * rows))
        targets = MOST_RELATED if relations else MOST_TOUCHED
        touched = [f"{','.join(f'{v:.3f}' for v in row[:-3])},t{k % targets}{cells}" for k, row in enumerate(table)]
        header = f"{header.rpartition(',x')[0]},target{columns}"
        (folder / "identification.csv").write_text("\n".join([header, *touched]) + "\n", encoding="utf-8")
        rng = np.random.default_rng(0)
        pairs = [rng.choice(targets, 2, replace=False) for _ in range(relations)]
        known = (
            f'[[relations]]\ntargets = ["t{a}", "t{b}"]\ndistance = "{100 + a + b} mm"\nsigma = "0.1 mm"\n'
            for a, b in pairs
        )
        section = f'[[measurements]]\nfile = "identification.csv"\nobserves = "{observes}"\nsigma = "0.1 mm"\n'
        _own_job(folder, "arm_cmm.urdf", "probe", 'base = "fixed"\n', section, *known)

    return Hostile(write, run)


def _crossed(folder: Path, size: int) -> None:
    """Measure, in turn, forty tools from forty places of the tracker."""
    robot = load_robot(folder / "arm_cmm.urdf", "probe")
    header, table = _seen_by_tracker(robot, size // 90)
    lines = (f"{','.join(f'{v:.3f}' for v in row)},t{k % 40},s{k // 7 % 40}" for k, row in enumerate(table))
    (folder / "identification.csv").write_text("\n".join([f"{header},tool,setup", *lines]) + "\n", encoding="utf-8")
    _own_job(folder, "arm_cmm.urdf", "probe", _measured("identification.csv"))


def _loaded(folder: Path, size: int) -> None:
    """Measure a hundred tables in eighty set-ups, each under a load of its own, by an arm that gives way everywhere."""
    robot = load_robot(_UR10, "tool0")
    header, table = _seen_by_tracker(robot, size // 120)
    tables = []
    for k, rows in enumerate(np.array_split(table, 100)):
        _table(folder / f"t{k}.csv", header, rows)
        load = f'payload = {{ mass = "{1 + k / 10:.1f} kg", position = ["0 mm", "0 mm", "{10 + k} mm"] }}\n'
        tables.append(_measured(f"t{k}.csv", f'setup = "s{k % 80}"\n{load}'))
    terms = "".join(f'{key} = "all"\n' for key in ("gain", "elastic", "lateral", "bending", "torsion"))
    _own_job(folder, _UR10, "tool0", terms, *tables)


def _nowhere(folder: Path, size: int) -> None:
    """Measure points that no arm has reached, and let a loss seek those that agree."""
    _different((('sigma = "0.02 mm"', 'sigma = "0.02 mm"\nloss = "cauchy"'),))(folder, size)
    path = folder / "identification.csv"
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    rng = np.random.default_rng(0)
    table = np.array([row.split(",") for row in rows], dtype=np.float64)
    table[:, -3:] = rng.uniform(-900.0, 900.0, (len(table), 3))
    _table(path, header, table, 1)


def _struts(n: int) -> Callable[[Path, int], None]:
    """Fill the table with rows of an arm on whose first joint n struts stand, each a closed loop."""

    def write(folder: Path, size: int) -> None:
        _different()(folder, size)
        joints, loops = "", ""
        for k in range(n):
            joints += (
                f'<link name="p{k}"/><link name="s{k}"/><link name="h{k}"/>'
                f'<joint name="p{k}" type="continuous"><origin xyz="0.3 {k / 100} 0"/><parent link="base_link"/>'
                f'<child link="p{k}"/><axis xyz="0 0 1"/></joint>'
                f'<joint name="s{k}" type="prismatic"><origin xyz="-0.2 0 0"/><parent link="p{k}"/><child link="s{k}"/>'
                '<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
                f'<joint name="h{k}" type="fixed"><origin xyz="0.1 0 0"/><parent link="link_1"/>'
                f'<child link="h{k}"/></joint>'
            )
            loops += (
                f'[[robot.loop]]\nname = "l{k}"\nframes = ["h{k}", "s{k}"]\ncloses = ["x", "y"]\n'
                f'passive = ["p{k}", "s{k}"]\n'
            )
        _edited(folder / "arm_cmm.urdf", "</robot>", f"{joints}</robot>")
        _edited(folder / "calibration.toml", "[error_model]", f"{loops}[error_model]")
        # What the struts say of themselves is nothing.
        _edited(folder / "calibration.toml", 'placements = "all"', 'placements = ["joint_*"]')

    return write


def _parallelogram(folder: Path, size: int) -> None:
    """Write the shipped arm with a loop, and for its levels tables of other poses where these are larger."""
    case = ROOT / "robots" / "irb2400"
    for path in case.iterdir():
        shutil.copyfile(path, folder / path.name)
    names = ("base_fit.csv", "level1.csv", "level2.csv")
    if size > sum((case / name).stat().st_size for name in names):
        arm = load_arm(folder / "calibration.toml")
        header, rows = _seen_by_tracker(arm.model.robot, size // 75, swing=0.4)
        for k, name in enumerate(names):
            _table(folder / name, header, rows[k :: len(names)])


_OWN = """schema = 1
[robot]
urdf = "{urdf}"
tip = "{tip}"
[error_model]
offsets = "all"
placements = "all"
"""


def _own_job(folder: Path, urdf: str, tip: str, *more: str) -> None:
    """Write a job of an arm of its own, of which offsets and placements are free, and ``more``."""
    job = _OWN.format(urdf=urdf, tip=tip) + "".join(more)
    (folder / "calibration.toml").write_text(job, encoding="utf-8")


def _measured(file: str, more: str = "", sigma: float = 0.05) -> str:
    return f'[[measurements]]\nfile = "{file}"\n{more}sigma = "{sigma} mm"\n'


def _two_streams(folder: Path, size: int) -> None:
    """Write a recording of a moving arm, of 7 kB a second, whose points are in two tables."""
    made = streams.streams(1, seconds=max(size / 7_000.0, 40.0), rates=(100.0, 30.0), offset=0.3)
    seen = np.column_stack(list(made.seen.values()))
    for k, some in enumerate(np.array_split(seen, 2)):
        _table(folder / f"seen{k}.csv", ",".join(made.seen), some, 5)
    _table(folder / "joints.csv", ",".join(made.joints), np.column_stack(list(made.joints.values())), 5)
    clock = 'readings = "joints.csv"\nclock = "free"\n'
    _own_job(folder, *streams.UR10, *(_measured(f"seen{k}.csv", clock, 0.1) for k in range(2)))


def _torso(folder: Path, size: int) -> None:
    """Write two arms of six joints on a torso of two."""
    links, joints = ['<link name="base"/><link name="t1"/><link name="t2"/>'], []
    joint = (
        '<joint name="j_{0}" type="revolute"><origin xyz=".1 .05 .3" rpy="{2} 0 0"/><axis xyz="0 0 1"/>'
        '<parent link="{1}"/><child link="{0}"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
    )
    ways = [["base", "t1", "t2"], *(["t2", *(f"{arm}{k}" for k in range(1, 7))] for arm in "ab")]
    for way in ways:
        for k, (parent, child) in enumerate(itertools.pairwise(way)):
            joints.append(joint.format(child, parent, (1.3, -1.1, 0.7)[k % 3]))
            links += [] if child.startswith("t") else [f'<link name="{child}"/>']
    (folder / "torso.urdf").write_text(f'<robot name="r">{"".join(links + joints)}</robot>', encoding="utf-8")
    for arm in "ab":
        robot = load_robot(folder / "torso.urdf", f"{arm}6")
        _table(folder / f"{arm}.csv", *_seen_by_tracker(robot, max(size // 150, 60)))
    other = 'tip = "b6"\ntool = "other"\n'
    _own_job(folder, "torso.urdf", "a6", _measured("a.csv"), _measured("b.csv", other))


def _giving_way(folder: Path, size: int) -> None:
    """Write an arm whose masses are unknown, whose bearings tilt, and torques that say nothing of it."""
    robot = load_robot(_UR10, "tool0")
    n = max(size // 150, 63)
    header, rows = _seen_by_tracker(robot, n)
    torques = np.random.default_rng(1).normal(0.0, 20.0, (n, len(robot.readings)))
    header += "".join(f",tau_{reading.name} [Nm]" for reading in robot.readings)
    _table(folder / "loaded.csv", header, np.hstack([rows, torques]))
    bearings = 'lateral_moments = "all"\ntorque = "all"\n'
    _own_job(folder, _UR10, "tool0", bearings, _measured("loaded.csv", 'loss = "cauchy"\n'))


def _candidates(folder: Path, size: int) -> None:
    """Write readings, of which those of a plan are chosen."""
    robot = load_robot(folder / "arm_cmm.urdf", "probe")
    header, rows = _seen_by_tracker(robot, max(size // 45, 60))
    joints = len(robot.readings)
    _table(folder / "candidates.csv", ",".join(header.split(",")[:joints]), rows[:, :joints])


def _verified(folder: Path, size: int, of: int = 1000) -> None:
    """Write rows to verify by, and a Gaussian process of so many rows in the folder of results."""
    path = folder / _RESULTS / "model.json"
    model = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(model | {"residual_model": "gaussian.npz"}), encoding="utf-8")
    robot = load_robot(folder / "arm_cmm.urdf", "probe")
    rng, names = np.random.default_rng(0), tuple((r.name, r.dimension) for r in robot.readings)
    points, errors = rng.uniform(-2.0, 2.0, (of, len(names))), rng.normal(0.0, 1e-4, (of, 3))
    none, kernel = np.zeros((0, 0)), Kernel(1e-4, np.full(len(names), 1.0), 5e-5)
    numbers = tuple(range(len(names)))
    process = GaussianResiduals(names, numbers, points, errors, "base", kernel, none, none)
    (folder / _RESULTS / "gaussian.npz").write_bytes(gaussian_bytes(process, model.get("run")))
    _table(folder / "new.csv", *_seen_by_tracker(robot, max(size // 75, 10)))


# Of results. -----------------------------------------------------------------------------------------------------


def _model(key: str, entry: Callable[[int], object], run: tuple[str, ...]) -> Hostile:
    """Fill a list or a section of ``model.json`` with entries made of numbers."""

    def write(folder: Path, size: int) -> None:
        path = folder / _RESULTS / "model.json"
        model = json.loads(path.read_text(encoding="utf-8"))
        each = len(json.dumps(entry(0))) + 12
        for k in range(max(size // each, 1)):
            if isinstance(model[key], dict):
                model[key][f"e{k}"] = entry(k)
            else:
                model[key].append(entry(k))
        path.write_text(json.dumps(model), encoding="utf-8")

    return Hostile(write, run)


def _packed(name: str, run: tuple[str, ...]) -> Hostile:
    """Write an archive of arrays that unpacks to a thousand times its size."""

    def write(folder: Path, size: int) -> None:
        path = folder / _RESULTS / "model.json"
        model = json.loads(path.read_text(encoding="utf-8"))
        model["residual_model"] = name
        path.write_text(json.dumps(model), encoding="utf-8")
        n = min(size * 900, 95_000_000)
        keys = {
            "grid.npz": ("schema", "frame", "joints", "axes", "errors", "dimensions", "counts", "nodes"),
            "gaussian.npz": (
                *("schema", "frame", "dimensions", "joints", "points", "errors"),
                *("amplitude", "noise", "scales"),
            ),
        }[name]
        data = io.BytesIO()
        head = io.BytesIO()
        np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (n // 8,)})
        with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
            for key in keys:
                archive.writestr(f"{key}.npy", head.getvalue() + bytes(n // 8 * 8 if key == "errors" else 8))
        (folder / _RESULTS / name).write_bytes(data.getvalue())

    return Hostile(write, run)


_COMPENSATE = ("compensate", _RESULTS, "targets.csv", "-o", "corrected.csv")
_POSE = {"position": [0.0, 0.0, 0.0], "quaternion": [1.0, 0.0, 0.0, 0.0]}


def _targets(folder: Path, size: int) -> None:
    lines = (CASE / "identification.csv").read_text(encoding="utf-8").splitlines()
    header, *rows = [",".join(line.split(",")[:6]) for line in lines if not line.startswith("#")]
    (folder / "targets.csv").write_text(
        header + "\n" + repeated(lambda k: rows[k % len(rows)] + "\n", size), encoding="utf-8"
    )


def _positions(folder: Path, size: int) -> None:
    rows = repeated(lambda k: f"{k % 900},{k % 701},300\n", size)
    (folder / "targets.csv").write_text("x [mm],y [mm],z [mm]\n" + rows, encoding="utf-8")


def _positions_of_a_loop(folder: Path, size: int) -> None:
    """Write positions, and results of an arm with a loop in the place of the shipped ones."""
    _positions(folder, size)
    shutil.rmtree(folder / _RESULTS)
    shutil.copytree(_results("irb2400"), folder / _RESULTS)


def _poses_of_a_loop(folder: Path, size: int) -> None:
    """Write poses of one orientation all about an arm with a loop, most of which it does not reach."""
    _positions_of_a_loop(folder, size)
    rows = repeated(lambda k: f"{k % 1900 - 900},{k % 1701 - 800},{k % 1900},1,0,0,0\n", size)
    (folder / "targets.csv").write_text("x [mm],y [mm],z [mm],qw,qx,qy,qz\n" + rows, encoding="utf-8")


def _positions_of_terms(folder: Path, size: int) -> None:
    """Write positions, and give the machine as many harmonics as fit, which no uncertainty knows."""
    _positions(folder, size)
    path = folder / _RESULTS / "model.json"
    model = json.loads(path.read_text(encoding="utf-8"))
    model["terms"] = [
        {"reading": f"joint_{k // 1000 + 1}", "kind": "cos", "order": k % 1000 + 1, "coefficient": 0.0}
        for k in range(min(size // 80, 6000))
    ]
    path.write_text(json.dumps(model), encoding="utf-8")
    (path.parent / "uncertainty.json").unlink()


def _earlier_of_terms(folder: Path, size: int) -> None:
    """Write earlier results with as many harmonics as fit, all of them free."""
    earlier = folder / "earlier"
    shutil.copytree(folder / _RESULTS, earlier)
    model = json.loads((earlier / "model.json").read_text(encoding="utf-8"))
    many = min(size // 75, MOST_TERMS)
    model["terms"] = [
        {"reading": f"joint_{k // 2000 + 1}", "kind": ("cos", "sin")[k % 2], "order": k // 2 % 1000 + 1}
        | {"coefficient": 0.0}
        for k in range(many)
    ]
    (earlier / "model.json").write_text(json.dumps(model), encoding="utf-8")
    path = earlier / "uncertainty.json"
    known = json.loads(path.read_text(encoding="utf-8"))
    entries = len(known["factor"]) + many
    known |= {"schema": 2, "causes": {"instrument": 1}, "factor": [[1e-5]] * entries, "null_basis": [[0.0]] * entries}
    for key in ("waves", "wind_up", "left_out"):
        known.pop(key)
    path.write_text(json.dumps(known), encoding="utf-8")


def _poses(folder: Path, size: int) -> None:
    """Write poses that the arm can hardly reach: of one orientation, about the end of its links."""
    (folder / "targets.csv").write_text(
        "x [mm],y [mm],z [mm],qw,qx,qy,qz\n" + repeated(lambda k: f"{k % 50}{k % 97},{k % 900},9,1,0,0,0\n", size),
        encoding="utf-8",
    )


def _far_positions(folder: Path, size: int) -> None:
    (folder / "targets.csv").write_text(
        "x [mm],y [mm],z [mm]\n" + repeated(lambda k: f"{k},9,9999\n", size), encoding="utf-8"
    )


def _cycles(row: Callable[[int], str], header: str = "target,x [mm],y [mm],z [mm]") -> Hostile:
    def write(folder: Path, size: int) -> None:
        (folder / "cycles.csv").write_text(f"{header}\n{repeated(row, size)}", encoding="utf-8")

    return Hostile(write, ("iso9283", "cycles.csv"))


# Of recordings, logs and photographs. ----------------------------------------------------------------------------


def _log(head: str, piece: Callable[[int], str]) -> Hostile:
    def write(folder: Path, size: int) -> None:
        (folder / "log.csv").write_text(head + repeated(piece, size), encoding="utf-8")

    return Hostile(write, ("import", "log.csv", "-o", "table.csv"))


_TAKE = "Format Version,1.23,Take Name,T,Rotation Type,Quaternion,Length Units,Meters\n"
_BODY = "".join(
    f",{label}{''.join(f',{cell}' for cell in cells)}\n"
    for label, cells in (
        ("Type", ("Rigid Body",) * 7),
        ("Name", ("t",) * 7),
        ("", ("Rotation",) * 4 + ("Position",) * 3),
    )
)


def _wide_log(folder: Path, size: int) -> None:
    """Write an export of Motive of very many rigid bodies."""
    n = size // 40
    lines = (",Type" + ",Rigid Body" * n, ",Name" + "".join(f",b{k}" for k in range(n)), "," + ",Position" * n)
    text = _TAKE + "\n".join((*lines, "Frame,Time" + ",X" * n, "0,0" + ",1" * n)) + "\n"
    (folder / "log.csv").write_text(text, encoding="utf-8")


def _stream(time: Callable[[int], str]) -> Hostile:
    """Fill the tables of a stream: a tracker, and joints that all move; ``time`` is that of the tracker's rows."""

    def write(folder: Path, size: int) -> None:
        names = [f"joint_{k} [rad]" for k in range(1, 7)]

        def readings(k: int) -> str:
            return ",".join(f"{np.sin(0.02 * k * (1 + j) + j):.3f}" for j in range(6))

        (folder / "validation.csv").write_text(
            f"time [s],{','.join(names)}\n" + repeated(lambda k: f"{0.08 * k:.2f},{readings(k)}\n", size),
            encoding="utf-8",
        )
        (folder / "identification.csv").write_text(
            "time [s],x [m],y [m],z [m]\n"
            + repeated(lambda k: f"{time(k)},{np.sin(0.03 * k):.4f},{np.cos(0.05 * k):.4f},0\n", size),
            encoding="utf-8",
        )
        job = (folder / "calibration.toml").read_text(encoding="utf-8").rpartition("[[measurements]]")[0]
        job = job.replace('observes = "position"', 'observes = "position"\nreadings = "validation.csv"')
        (folder / "calibration.toml").write_text(job, encoding="utf-8")

    return Hostile(write)


_PHOTOGRAPHS = ("import", "images", "photos", "--board", "board.toml", "--readings", "readings.csv", "-o", "marks.csv")
_MARKERS = 'kind = "charuco"\nsquares = [7, 5]\nsquare = "30 mm"\nmarker = "22 mm"\ndictionary = "DICT_4X4_50"\n'
_CHESSBOARD = 'kind = "chessboard"\nsquares = [6, 5]\nsquare = "30 mm"\n'


def _photographs(board: Callable[[int], str], readings: Callable[[int], str]) -> Hostile:
    """Fill what belongs to photographs: the board, and readings; there is one, of nothing."""

    def write(folder: Path, size: int) -> None:
        (folder / "photos").mkdir()
        (folder / "photos" / "p0.pgm").write_bytes(b"P5 32 32 255\n" + bytes(1024))
        (folder / "board.toml").write_text(_CHESSBOARD + board(size), encoding="utf-8")
        (folder / "readings.csv").write_text("image,joint_1 [deg]\n" + readings(size), encoding="utf-8")

    return Hostile(write, _PHOTOGRAPHS)


def _image(folder: Path, size: int) -> None:
    """Write an image of noise, in which a chessboard is looked for."""
    _photographs(lambda _: "", lambda _: "p0,1\n").write(folder, size)
    side = int(size**0.5)
    noise = np.random.default_rng(0).integers(0, 256, side * side, dtype=np.uint8).tobytes()
    (folder / "photos" / "p0.pgm").write_bytes(b"P5 %d %d 255\n" % (side, side) + noise)


def _picture(drawn: Callable[[int], NDArray[np.bool_]], pixels: Callable[[int], int], board: str = "") -> Hostile:
    """Return a photograph: what is white, by the length of its side, and its pixels, by the size of its file in bytes.

    The rest of the file is noise.
    """

    def write(folder: Path, size: int) -> None:
        _photographs(lambda _: "", lambda _: "p0,1\n").write(folder, size)
        if board:
            (folder / "board.toml").write_text(board, encoding="utf-8")
        side = int(pixels(size) ** 0.5)
        grey = np.where(drawn(side), np.uint8(255), np.uint8(0))
        rows = max(size - 60_000, 0) // side
        grey[side - rows :] = np.random.default_rng(0).integers(0, 256, (rows, side), dtype=np.uint8)
        lines = np.concatenate([np.zeros((side, 1), dtype=np.uint8), grey], axis=1).tobytes()
        parts = (
            b"IHDR" + struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0),
            b"IDAT" + zlib.compress(lines, 9),
            b"IEND",
        )
        (folder / "photos" / "p0.pgm").unlink()
        (folder / "photos" / "p0.png").write_bytes(
            b"\x89PNG\r\n\x1a\n"
            + b"".join(struct.pack(">I", len(p) - 4) + p + struct.pack(">I", zlib.crc32(p)) for p in parts)
        )

    return Hostile(write, _PHOTOGRAPHS)


def _squares(cell: int) -> Callable[[int], NDArray[np.bool_]]:
    """Return what draws a board of black and white squares of so many pixels."""
    return lambda side: (np.arange(side) // cell + np.arange(side)[:, None] // cell) % 2 == 1


def _rings(cell: int) -> Callable[[int], NDArray[np.bool_]]:
    """Return what draws hollow squares, one in each cell of so many pixels."""

    def drawn(side: int) -> NDArray[np.bool_]:
        near = np.minimum(np.arange(side) % cell, cell - 1 - np.arange(side) % cell)
        apart = np.minimum(near, near[:, None])
        return np.asarray((apart < 2) | (apart >= 5))

    return drawn


def _most_pixels(size: int) -> int:
    """Return how many pixels a photograph of so many bytes may have."""
    return max(19_900_000, 29 * size)


def _recording(folder: Path, size: int) -> None:
    """Write what begins as a recording of ROS 1, and has a record of 4 GB."""
    (folder / "one.bag").write_bytes(b"#ROSBAG V2.0\n" + b"\xff\xff\xff\xff" * (size // 4))


def _of_definitions(piece: Callable[[int], str], head: str = "", tail: str = "") -> Hostile:
    """Return a recording (MCAP, with nothing packed) of one message, whose type is defined so."""

    def record(kind: int, *parts: bytes) -> bytes:
        return bytes([kind]) + struct.pack("<Q", sum(map(len, parts))) + b"".join(parts)

    def text(said: str) -> bytes:
        return struct.pack("<I", len(said.encode())) + said.encode()

    def write(folder: Path, size: int) -> None:
        definition = head + repeated(piece, size - len(head) - len(tail)) + tail
        language = "ros2idl" if definition.startswith("module") else "ros2msg"
        magic = b"\x89MCAP0\r\n"
        (folder / "one.mcap").write_bytes(
            magic
            + record(1, text("ros2"), text(""))
            + record(3, struct.pack("<H", 1), text("a/msg/B"), text(language), text(definition))
            + record(4, struct.pack("<HH", 1, 1), text("/t"), text("cdr"), struct.pack("<I", 0))
            + record(5, struct.pack("<HIQQ", 1, 0, 1, 1), b"\0\1\0\0", b"\xff" * 4, bytes(96))
            + record(15, struct.pack("<I", 0))
            + record(2, struct.pack("<QQI", 0, 0, 0))
            + magic
        )

    return Hostile(write, ("import", "one.mcap"))


# Of jobs of photographs with one thing wrong. ----------------------------------------------------------------------

_LENS = "".join(f'{name} = "{cameras.BENT[name]} px"\n' for name in ("fx", "fy", "cx", "cy")) + "".join(
    f"{name} = {cameras.BENT[name]}\n" for name in ("k1", "k2", "p1", "p2", "k3")
)
_SEEN = """schema = 1
[robot]
urdf = "{urdf}"
tip = "{tip}"
[error_model]
offsets = "all"
placements = "all"
base = "fixed"
tool = "pose"
[instruments.camera]
kind = "camera"
camera_on = "{camera_on}"
{lens}
[[measurements]]
file = "marks.csv"
observes = "pixels"
instrument = "camera"
hold_out = 0.25
"""
_Change = Callable[[Floats, np.random.Generator], Floats]
# Columns of a table of marks: readings of six joints, a pixel, a place on the board.
_READINGS, _PIXELS, _PLACES = slice(0, 6), slice(6, 8), slice(8, 11)


@cache
def _seen(photographs: int, side: int) -> tuple[tuple[str, ...], Floats]:
    """Titles and rows of a sound table of marks, a square of so many by side in each, found to 0.1 px."""
    rng = np.random.default_rng(11)
    places = np.array([(x, y, 0.0) for x in np.linspace(0.0, 0.12, side) for y in np.linspace(0.0, 0.09, side)])
    true = cameras.scene(rng, machines.arm(cameras.UR5, cameras.TIP), "tip", places)
    columns = true.columns(true.draw(rng, photographs), rng, 0.1)
    return tuple(columns), np.column_stack([np.asarray(values) for values in columns.values()])


def _seen_wrongly(
    change: _Change,
    urdf: str = cameras.UR5,
    camera_on: str = "tip",
    side: int = 5,
    lens: str = 'lens = "given"\n' + _LENS,
    digits: int = 7,
) -> Hostile:
    """Fill a table of marks, (photographs, marks, columns), that ``change`` makes wrong."""

    def write(folder: Path, size: int) -> None:
        # As many photographs as there is room for.
        titles, some = _seen(6, side)
        row = len(",".join(f"{value:.{digits}f}" for value in some[0])) + 1
        titles, table = _seen(max(size // (row * side**2), 6), side)
        table = change(table.reshape(-1, side**2, len(titles)), np.random.default_rng(0)).reshape(table.shape)
        lines = [",".join(titles), *(",".join(f"{value:.{digits}f}" for value in row) for row in table)]
        (folder / "marks.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        job = _SEEN.format(urdf=urdf, tip=cameras.TIP, camera_on=camera_on, lens=lens)
        (folder / "calibration.toml").write_text(job, encoding="utf-8")

    return Hostile(write)


def _changed(columns: slice, change: _Change) -> _Change:
    def changed(table: Floats, rng: np.random.Generator) -> Floats:
        table = table.copy()
        table[..., columns] = change(table[..., columns], rng)
        return table

    return changed


def _of_joint(joint: int, factor: float, offset: float) -> _Change:
    def changed(readings: Floats, _: np.random.Generator) -> Floats:
        now = readings.copy()
        now[..., joint] = np.angle(np.exp(1j * (factor * now[..., joint] + offset)))  # within the limits
        return now

    return _changed(_READINGS, changed)


def _same(table: Floats, _: np.random.Generator) -> Floats:
    return table


def _one_of_most(table: Floats, _: np.random.Generator) -> Floats:
    """Say that the robot stood still for all but the last few photographs."""
    table = table.copy()
    table[:-20, :, _READINGS] = table[0, 0, _READINGS]
    return table


def _astray(pixels: Floats, rng: np.random.Generator) -> Floats:
    pixels = pixels.copy()
    pixels[:, 0] = rng.uniform(0.0, 1000.0, pixels[:, 0].shape)
    return pixels


_WRONG_PHOTOGRAPHS: dict[str, Hostile] = {
    "photographs as they should be": _seen_wrongly(_same),
    "photographs, no lens": _seen_wrongly(_same, lens='lens = "free"\nsize = [1280, 1024]\n'),
    "photographs of four marks": _seen_wrongly(_same, side=2),
    "photographs of 256 marks": _seen_wrongly(_same, side=16),
    "photographs, one of most marks": _seen_wrongly(_one_of_most, side=3),
    "photographs, short numbers": _seen_wrongly(_same, digits=2),
    "photographs, a pixel astray in each": _seen_wrongly(_changed(_PIXELS, _astray)),
    "a camera beside its arm": _seen_wrongly(_same, camera_on="floor"),
    "photographs, other arm": _seen_wrongly(_same, urdf="example:ur_description/urdf/ur10_robot.urdf"),
    "photographs, joints in other order": _seen_wrongly(_changed(_READINGS, lambda q, _: q[..., ::-1])),
    "photographs, other readings": _seen_wrongly(_changed(_READINGS, lambda q, rng: rng.permutation(q))),
    "photographs, one sign": _seen_wrongly(_of_joint(3, -1.0, 0.0)),
    "photographs, all signs": _seen_wrongly(_changed(_READINGS, lambda q, _: -q)),
    "photographs, degrees as radians": _seen_wrongly(_changed(_READINGS, lambda q, _: np.degrees(q))),
    "photographs, a zero off by 90 deg": _seen_wrongly(_of_joint(2, 1.0, np.pi / 2.0)),
    "photographs, a zero off by 5 mrad": _seen_wrongly(_of_joint(2, 1.0, 5e-3)),
    "photographs, other marks": _seen_wrongly(
        _changed(_PLACES, lambda marks, rng: np.stack([rng.permutation(m) for m in marks]))
    ),
    "photographs, board mirrored": _seen_wrongly(_changed(_PLACES, lambda marks, _: marks * [-1.0, 1.0, 1.0])),
    "photographs, smaller images": _seen_wrongly(_changed(_PIXELS, lambda uv, _: uv / 4.0)),
    "photographs, u and v changed": _seen_wrongly(_changed(_PIXELS, lambda uv, _: uv[..., ::-1])),
}


# Of others' files: kinematics, lenses, records, metadata, boards, acceptance tests. --------------------------------


def _text(name: str, run: tuple[str, ...], piece: Callable[[int], str], head: str = "", tail: str = "") -> Hostile:
    """Fill one file of the folder with pieces between a head and a tail."""

    def write(folder: Path, size: int) -> None:
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(head + repeated(piece, size - len(head) - len(tail)) + tail, encoding="utf-8")

    return Hostile(write, run)


def _kinematics(piece: Callable[[int], str], head: str = "", tail: str = "") -> Hostile:
    return _text("own.conf", ("import", "own.conf", "--robot", _UR10, "-o", "own.urdf"), piece, head, tail)


_K = "[900.0, 0.0, 640.0, 0.0, 901.5, 360.0, 0.0, 0.0, 1.0]"
_CAMERA = """
[instruments.camera]
kind = "camera"
camera_on = "tip"
lens_file = "lens.yaml"
sigma = "0.2 px"
[[measurements]]
file = "identification.csv"
observes = "pixels"
instrument = "camera"
"""


def _lens(piece: Callable[[int], str], head: str = "", tail: str = "") -> Hostile:
    """Fill a lens, and name it in the job; there are no pixels to be read with it."""
    filled = _text("lens.yaml", _CALIBRATE, piece, head, tail)

    def write(folder: Path, size: int) -> None:
        filled.write(folder, size)
        path = folder / "calibration.toml"
        job = path.read_text(encoding="utf-8").partition("[[measurements]]")[0]
        path.write_text(job + _CAMERA, encoding="utf-8")

    return Hostile(write)


def _records(name: str, piece: Callable[[int], str], head: str = "", tail: str = "") -> Hostile:
    return _text(name, ("import", name, "-o", "table.csv"), piece, head, tail)


def _imported(name: str, filled: Fill, more: tuple[str, ...]) -> Hostile:
    """Write a file of the kinds that are imported."""

    def write(folder: Path, size: int) -> None:
        (folder / name).write_bytes(filled(size))

    return Hostile(write, ("import", name, "-o", "table.csv", *more))


def _laughs(mark: str, last: str) -> str:
    """Return lines of which each has the one before it nine times, by aliases, and what is then the last."""
    lines = [f"a0: &{mark}a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{k}: &{mark}a{k} [{', '.join([f'*{mark}a{k - 1}'] * 9)}]" for k in range(1, 10)]
    return "\n".join([*lines, f"{last}: *{mark}a9", ""])


_BAG = "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n  relative_file_paths: [bag.db3]\n"


def _metadata(piece: Callable[[int], str], head: str = _BAG, tail: str = "") -> Hostile:
    return _text("bag/metadata.yaml", ("import", "bag"), piece, head, tail)


def _touches(table: str, row: Callable[[int], str]) -> Hostile:
    """Fill a table of an acceptance test; ``row``: what stands behind the readings of the shipped one."""

    def write(folder: Path, size: int) -> None:
        lines = (CASE / table).read_text(encoding="utf-8").splitlines()
        header, *rows = [line for line in lines if not line.startswith("#")]
        joints = [",".join(line.split(",")[:6]) for line in rows]
        (folder / table).write_text(
            header + "\n" + repeated(lambda k: f"{joints[k % len(joints)]},{row(k)}\n", size), encoding="utf-8"
        )

    return Hostile(write, ("performance", _RESULTS, table))


def _naming(folder: Path, size: int) -> None:
    """Write two tables of a hundred columns, each of which may name the rows of both, in another order."""
    n = max(size // 1000, 3)
    rows = (",".join(str((k + c) % n) for c in range(100)) for k in range(n))
    text = "\n".join((",".join(f"c{c}" for c in range(100)), *rows)) + "\n"
    for name in ("a.csv", "b.csv"):
        (folder / name).write_text(text, encoding="utf-8")


def _long_paths(folder: Path, size: int) -> None:
    """Write a robot whose meshes have long paths, which are looked for below a hundred folders."""
    mesh = repeated(lambda k: f'<visual><geometry><mesh filename="{k}{"/a" * 450}"/></geometry></visual>', size)
    _edited(folder / "arm_cmm.urdf", "</link>", f"{mesh}</link>")
    roots = ",\n".join(f'"{"./" * k}."' for k in range(100))
    _edited(folder / "calibration.toml", "[error_model]", f"mesh_roots = [{roots}]\n[error_model]")


_OTHERS: dict[str, Hostile] = {
    "columns that name rows": Hostile(_naming, ("import", "a.csv", "b.csv", "-o", "c.csv")),
    "lists in brackets": _records("a.txt", lambda _: "[1,2,3]\n"),
    "lists in a list": _records("a.txt", lambda _: "[1,2,3],", "[", "[1,2,3]]\n"),
    "lists that begin": _records("a.txt", lambda _: "[", "[1,2,3]\n" * 2),
    "lists that end at once": _records("a.txt", lambda _: "[]", "[1,2,3]\n" * 2),
    "lists of kinds": _records("a.txt", lambda k: f"[{'1,' * (3 + k % 300)}1]\n"),
    "a long list": _records("a.txt", lambda _: "1,", "[1,2,3]\n[", "1]\n"),
    "words with lists": _records("a.txt", lambda _: "a1 [1,2,3] b c d\n"),
    "quotes in lists": _records("a.txt", lambda _: "'[1,2,3]\"", "[1,2,3]\n" * 2),
    "cells of lists": _records("a.csv", lambda _: "[1 2 3];[4 5 6]\n", "a;b\n"),
    "long paths of meshes": Hostile(_long_paths, ("check", "calibration.toml")),
    "blank lines of kinematics": _kinematics(lambda _: "\n"),
    "blanks of kinematics": _kinematics(lambda _: " "),
    "lists of kinematics that begin": _kinematics(lambda _: "delta_a=[\n"),
    "numbers of kinematics": _kinematics(lambda _: "1,", "delta_a = [", "1]\n"),
    "digits of kinematics": _kinematics(lambda _: "1", "delta_a = [", "]\n"),
    "kinematics again and again": _kinematics(
        lambda _: "".join(f"delta_{name} = [0, 0, 0, 0, 0, 0]\n" for name in ("theta", "a", "d", "alpha"))
    ),
    "links of kinematics": _kinematics(lambda k: f"shoulder:\n  {'xyz'[k % 3]}: 1\n"),
    "blanks in links of kinematics": _kinematics(lambda _: " ", "shoulder:\n  x:", "y\n"),
    "lens deep": _lens(lambda _: "[", "camera_matrix: "),
    "lens of blocks": _lens(lambda _: "- "),
    "lens of keys of keys": _lens(lambda _: "{a: ", "camera_matrix: "),
    "lens of questions": _lens(lambda _: "? "),
    "lens that laughs": _lens(lambda _: "# laughs\n", tail=_laughs("", "camera_matrix")),
    "lens that laughs with a dash": _lens(lambda _: "# laughs\n", tail=_laughs("-", "camera_matrix")),
    "keys of a lens": _lens(lambda k: f"k{k}: 1\n", f"camera_matrix: {_K}\n"),
    "one key of a lens": _lens(lambda _: f"camera_matrix: {_K}\n"),
    "numbers of a lens": _lens(lambda _: "1,", "camera_matrix: [", "1]\n"),
    "digits of a lens": _lens(lambda _: "1", "camera_matrix: [", "]\n"),
    "words of a lens": _lens(lambda _: "a ", f"camera_matrix: {_K}\nname: "),
    "lens in XML": _lens(lambda k: f"<m{k}>1</m{k}>", "<?xml version='1.0'?><opencv_storage>", "</opencv_storage>"),
    "records of YAML, deep": _records("a.yaml", lambda _: "[", "a: "),
    "records of YAML, in blocks": _records("a.yaml", lambda _: "- "),
    "records of YAML, blank lines": _records("a.yaml", lambda _: "\n", "a: 1\n"),
    "records of YAML that laugh": _records("a.yaml", lambda _: "# laughs\n", tail=_laughs("-", "z")),
    "records of YAML": _records("a.yaml", lambda k: f"- {{a: {k}, b: 2}}\n"),
    "documents of YAML": _records("a.yaml", lambda k: f"---\na: {k}\n"),
    "records of JSON, deep": _records("a.json", lambda _: "["),
    "records of JSON": _records("a.json", lambda k: f'{{"a": {k}, "b": [1, 2]}},', "[", '{"a": 1, "b": [1, 2]}]'),
    "names of JSON": _records("a.json", lambda k: f'"a{k}": 1,', "[{", '"a": 1}]'),
    "metadata that laugh": _metadata(lambda _: "# laughs\n", _laughs("", "rosbag2_bagfile_information")),
    "metadata deep": _metadata(lambda _: "[", _BAG + "x: "),
    "metadata of keys": _metadata(lambda k: f"k{k}: 1\n"),
    "metadata of files": _metadata(lambda _: "bag.db3, ", _BAG.removesuffix("bag.db3]\n"), "bag.db3]\n"),
    "metadata of words": _metadata(lambda _: "a ", _BAG + "x: "),
    "lists of a board": _photographs(lambda size: "x = " + "[" * (size - 100) + "\n", lambda _: "p0,1\n"),
    "numbers of a board": _photographs(
        lambda size: "x = [" + repeated(lambda k: f"{k},\n", size) + "]\n", lambda _: "p0,1\n"
    ),
    "dots of a board": _photographs(lambda size: "a" + ".a" * (size // 2) + " = 1\n", lambda _: "p0,1\n"),
    "digits of a board": _photographs(lambda size: "x = " + "1" * size + "\n", lambda _: "p0,1\n"),
    "tables of a board": _photographs(lambda size: repeated(lambda k: f"[t{k}]\n", size), lambda _: "p0,1\n"),
    "a title of blanks": _text("a.csv", ("import", "a.csv", "-o", "t.csv"), lambda _: " ", "x [mm],y[", "\n1,2\n"),
    "a title of blanks in a table": Hostile(
        lambda folder, size: _edited(
            folder / "identification.csv", "x [mm]", f"x{' ' * min(size // 2, 45_000)}[{' ' * min(size // 2, 45_000)}"
        )
    ),
    "a title of brackets": _text("a.csv", ("import", "a.csv", "-o", "t.csv"), lambda _: "( ", "x", "\n1\n"),
    "touches of one cone": _touches("cone.csv", lambda _: "near"),
    "touches of cones": _touches("cone.csv", lambda k: f"c{k % 100}"),
    "touches of cones without end": _touches("cone.csv", lambda k: f"c{k}"),
    "touches of one length": _touches("lengths.csv", lambda k: f"{'AB'[k % 2]},1,299.987"),
    "touches of lengths": _touches("lengths.csv", lambda k: f"{'AB'[k % 2]},{k // 2},299.987"),
    "touches of one sphere": _touches("sphere.csv", lambda _: "near,24.9982,6"),
    "touches of spheres": _touches("sphere.csv", lambda k: f"s{k % 100},24.9982,6"),
    "touches of one sphere, articulated": _touches("articulations.csv", lambda k: f"near,{k},24.9982,6"),
    "touches of many articulations": _touches("articulations.csv", lambda k: f"s{k % 50},{k // 250},24.9982,6"),
    "touches of a sphere of kilometres": _touches("sphere.csv", lambda k: f"s{k % 9},1e6,1e6"),
    "cycles of distances": _cycles(
        lambda k: f"P{k % 5},{k % 3},{k % 7},{k % 2},{100 * (k % 5)},0,0,{k}\n",
        "target,x [mm],y [mm],z [mm],command_x [mm],command_y [mm],command_z [mm],time [s]",
    ),
    "cycles of distances of many": _cycles(
        lambda k: f"P{k % 100},{k % 3},{k % 7},{k % 2},{k % 100},0,0\n",
        "target,x [mm],y [mm],z [mm],command_x [mm],command_y [mm],command_z [mm]",
    ),
}


def _observed(kind: str) -> tuple[tuple[str, str], ...]:
    return (('observes = "position"', f'observes = "{kind}"'),)


_MESHES_OF: dict[str, tuple[str, Callable[[int], bytes]]] = {
    "dae doubling": ("m.dae", _doubling),
    "dae doubling in the scene": ("m.dae", _doubling_inline),
    "dae doubling by name": ("m.dae", _doubling_by_name),
    "dae of one id": ("m.dae", _dae_of_one_id),
    "dae promise": ("m.dae", _dae_promise),
    "dae instances": ("m.dae", _dae_instances),
    "dae nodes": ("m.dae", _dae_nodes),
    "dae deep": ("m.dae", _dae_deep),
    "dae triangles": ("m.dae", _dae_triangles),
    "dae polygon": ("m.dae", _dae_polygon),
    "dae geometries": ("m.dae", _dae_geometries),
    "glb accessor": ("m.glb", _glb_accessor),
    "glb accessors": ("m.glb", _glb_accessors),
    "glb same points": ("m.glb", _glb_same_view),
    "glb views": ("m.glb", _glb_views),
    "glb pictures": ("m.glb", _glb_pictures),
    "glb instances": ("m.glb", _glb_instances),
    "glb chain": ("m.glb", _glb_chain),
    "glb edges": ("m.glb", _glb_edges),
    "glb doubling": ("m.glb", _glb_doubling),
    "obj triangles": ("m.obj", _obj(lambda _: "f 1 2 3\n")),
    "obj objects": ("m.obj", _obj(lambda k: f"o o{k}\nf 1 2 3\n")),
    "obj materials": ("m.obj", _obj(lambda k: f"usemtl m{k}\nf 1 2 3\n")),
    "obj materials within lines": ("m.obj", _obj(lambda k: f" usemtl m{k}\nf 1 2 3\n")),
    "obj materials over lines": ("m.obj", _obj(lambda k: f"use\\\r\nmtl m{k}\nf 1 2 3\n")),
    "obj polygon": ("m.obj", lambda size: b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf" + b" 1 2 3" * (size // 6)),
    "obj points": ("m.obj", lambda size: repeated(lambda k: f"v {k} {k} 1\n", size).encode() + b"f 1 2 3\n"),
    "dae polylist": ("m.dae", _dae_polygons("polylist")),
    "dae polygons": ("m.dae", _dae_polygons("polygons")),
    "dae fan": ("m.dae", _dae_polygons("trifans")),
    "ply polygon": ("m.ply", _ply_polygon("binary_little_endian")),
    "ply polygon as text": ("m.ply", _ply_polygon("ascii")),
    "ply triangles": ("m.ply", _ply),
    "ply lists": ("m.ply", _ply_lists),
    "ply promise": ("m.ply", _ply_promise),
    "off triangles": ("m.off", _off),
    "off promise": ("m.off", _off_promise),
    "stl triangles": ("m.stl", _stl),
    "stl solids": ("m.stl", _stl_ascii),
}

HOSTILE: dict[str, Hostile] = {
    "cycles of many poses": _cycles(lambda k: f"P{k // 2},0,0,{k % 2}\n"),
    "cycles of a hundred poses": _cycles(lambda k: f"P{k % 100},0,0,{k % 7}\n"),
    "cycles from many directions": _cycles(
        lambda k: f"P{k % 3},d{k // 6},0,0,{k % 2}\n", "target,direction,x [mm],y [mm],z [mm]"
    ),
    "frames of a log": _log(_TAKE + _BODY + "Frame,Time,X,Y,Z,W,X,Y,Z\n", lambda k: f"{k},{k}.0,0,0,0,1,{k % 7},2,3\n"),
    "readings of a log": _log(
        "timestamp " + " ".join(f"actual_q_{k}" for k in range(6)) + "\n", lambda k: f"{k}.5 1 2 3 4 5 {k % 9}\n"
    ),
    "bodies of a log": Hostile(_wide_log, ("import", "log.csv", "-o", "table.csv")),
    "a stream": _stream(lambda k: f"{0.05 * k:.2f}"),
    "a stream with a gap of years": _stream(lambda k: f"{0.05 * k + 1e9 * (k > 500):.2f}"),
    "readings of photographs": _photographs(lambda _: "", lambda size: repeated(lambda k: f"p{k},{k % 90}\n", size)),
    "keys of a board": _photographs(lambda size: repeated(lambda k: f"k{k} = 1\n", size), lambda _: "p0,1\n"),
    "an image of noise": Hostile(_image, _PHOTOGRAPHS),
    "an image of rings": _picture(_rings(24), lambda _: 4_000_000, _MARKERS),
    "an image of small squares": _picture(_squares(8), lambda _: 1_000_000, _MARKERS),
    "an image of most rings": _picture(_rings(90), _most_pixels, _MARKERS),
    "an image of most pixels": _picture(_squares(40), _most_pixels),
    "an image of single pixels": _picture(_squares(1), lambda _: 7_990_000, _MARKERS),
    "a recording that promises": Hostile(_recording, ("import", "one.bag")),
    "definitions of fields": _of_definitions(lambda k: f"bool a{k}\n"),
    "definitions of types": _of_definitions(lambda k: f"bool a\n{80 * '='}\nMSG: a/C{k}\n", tail="bool a\n"),
    "definitions of blank lines": _of_definitions(lambda _: "\n", "bool a\n"),
    "definitions that compute": _of_definitions(lambda _: "(", "module a { const long A = "),
    "definitions of constants": _of_definitions(
        lambda k: f"const long A{k} = 1;", "module a { ", "struct B { double x; }; };"
    ),
    "definitions of strings": _of_definitions(lambda _: "# many\n", tail="string[1000000000] a\n"),
    "spheres": _shape('sphere radius=".1"'),
    "boxes": _shape('box size=".1 .1 .1"'),
    "cylinders": _shape('cylinder radius=".1" length=".1"'),
    "shapes that make no sense": _shape('sphere radius="x"'),
    "visuals of no shape": _urdf(lambda _: "<visual/>", "</link>"),
    "materials": _urdf(lambda k: f'<material name="m{k}"><color rgba="1 0 0 1"/></material>'),
    "materials of a shape": _urdf(
        lambda k: (
            f'<visual><geometry><box size="1 1 1"/></geometry><material name="m{k}">'
            '<color rgba="1 0 0 1"/></material></visual>'
        ),
        "</link>",
    ),
    "branches": _urdf(_branches),
    "shapes on branches": _urdf(
        lambda k: _branches(k).replace(
            "/><joint", '><visual><geometry><box size="1 1 1"/></geometry></visual></link><joint', 1
        )
    ),
    "a tail": _urdf(_tail),
    "mimics": _urdf(
        lambda k: _tail(k).replace("</joint>", f'<mimic joint="g{k - 1}" multiplier="9"/></joint>') if k else _tail(k)
    ),
    "comments": _urdf(lambda k: f"<!-- {k} -->"),
    "unknown elements": _urdf(lambda k: f"<e{k}/>"),
    "an attribute": _urdf(lambda _: f'<e a="{"x" * 100_000}"/>'),
    "attributes": Hostile(
        lambda folder, size: _edited(
            folder / "arm_cmm.urdf", "</robot>", "<e " + repeated(lambda k: f'a{k}="" ', size) + "/></robot>"
        )
    ),
    "masses that follow": Hostile(_masses),
    "a long arm": Hostile(_long_arm),
    "a fork of fingers": Hostile(_fork, ("check", "fork.urdf", "fork.csv")),
    "collision shapes": Hostile(
        _urdf(_collisions, "</link>").write,
        ("plan", "calibration.toml", "-o", "plan.csv", "--candidates", "50", "-n", "20"),
    ),
    "collision meshes of needles": Hostile(_needles, _PLAN),
    "collision shapes all over": Hostile(_crossing, _PLAN),
    **{what: _mesh(*of) for what, of in _MESHES_OF.items()},
    **{
        f"{what}, judged": _mesh(*of, judged=True)
        for what, of in _MESHES_OF.items()
        if not of[0].endswith((".glb", ".off"))
    },
    "one mesh often": _mesh("m.stl", _stl, 100),
    "one mesh very often": _mesh("m.stl", lambda _: _stl(20_000), 2000),
    "levels": _job(lambda k: f'[[levels]]\nname = "l{k}"\nfree = ["*"]\n'),
    "measurements": _job(lambda _: _SECTION),
    "held out": _job(lambda _: _SECTION + "hold_out = 0.5\n"),
    "validations": _job(lambda _: _SECTION + 'use = "validate"\n'),
    "nodes": _job(lambda _: _SECTION + 'use = "nodes"\n'),
    "robust": _job(lambda _: _SECTION + 'loss = "cauchy"\n'),
    "targets": _job(lambda k: f'[targets.t{k}]\nposition = ["0 m", "0 m", "0 m"]\n'),
    "relations": _job(lambda k: f'[[relations]]\ntargets = ["a{k}", "b{k}"]\ndistance = "1 m"\nsigma = "1 mm"\n'),
    "relations of the same": _job(lambda _: '[[relations]]\ntargets = ["a", "b"]\ndistance = "1 m"\nsigma = "1 mm"\n'),
    "tools": _job(lambda k: f'[tools.t{k}]\nposition = ["0 m", "0 m", "0 m"]\n'),
    "instruments": _job(lambda k: f'[instruments.i{k}]\nkind = "laser_tracker"\nsigma = "1 mm"\n'),
    "arms that touch": _job(
        lambda k: (
            f'[instruments.i{k}]\nkind = "arm"\nsigma = "1 mm"\nurdf = "arm_cmm.urdf"\n'
            f'[[measurements]]\nfile = "identification.csv"\ninstrument = "i{k}"\n'
        )
    ),
    "couplings": _job(lambda k: f'[[robot.coupling]]\njoint = "joint_{k}"\ndrivers = {{ joint_2 = 1.0 }}\n'),
    "loops": _job(
        lambda k: (
            f'[[robot.loop]]\nname = "l{k}"\nframes = ["link_1", "link_2"]\ncloses = ["x"]\npassive = ["joint_2"]\n'
        )
    ),
    "unknown keys": _job(lambda k: f"key_{k} = 1\n"),
    "sections": _job(lambda k: f"[section_{k}]\n"),
    "wrong sections": _job(lambda _: "[[measurements]]\nfile = 1\n"),
    "offsets": _list("offsets", lambda _: '"joint_1"'),
    "placements": _list("placements", lambda _: '"*"'),
    "starry placements": _list("placements", lambda k: '"' + "*j" * 20 + f'{k}"'),
    "orders": _list("harmonic_orders", lambda k: str(1 + k % 1000)),
    "orders of all": Hostile(
        lambda folder, size: (
            _list("harmonic_orders", lambda k: str(1 + k % 1000)).write(folder, size),
            _edited(folder / "calibration.toml", "harmonic_orders", 'harmonics = "all"\nharmonic_orders'),
        )[0]
    ),
    "mesh roots": _list("mesh_roots", lambda _: '"."', "[error_model]"),
    "columns": Hostile(
        lambda folder, size: _edited(
            folder / "calibration.toml",
            'sigma = "0.02 mm"\n',
            'sigma = "0.02 mm"\n[measurements.columns]\n' + repeated(lambda k: f'c{k} = "d{k}"\n', size),
        )
    ),
    "other names": Hostile(
        lambda folder, size: _edited(
            folder / "calibration.toml",
            'sigma = "0.02 mm"\n',
            'sigma = "0.02 mm"\n[measurements.targets]\n' + repeated(lambda k: f'c{k} = "d{k}"\n', size),
        )
    ),
    "drivers": Hostile(
        lambda folder, size: _edited(
            folder / "calibration.toml",
            "[error_model]",
            '[[robot.coupling]]\njoint = "joint_3"\n[robot.coupling.drivers]\n'
            + repeated(lambda k: f"j{k} = 1.0\n", size)
            + "[error_model]",
        )
    ),
    "rows": _rows(lambda _: "", ""),
    "points": _rows(lambda k: f"p{k}", "tool"),
    "groups": _rows(lambda k: f"g{k}", "group"),
    "pairs": _rows(lambda k: f"p{k // 2}", "pair"),
    "pair distances": _rows(lambda k: f"p{k // 2},1", "pair,length [m]", _observed("pair_distance")),
    "sockets": _rows(lambda k: f"t{k // 3 % MOST_TOUCHED}", "target", _observed("socket")),
    "one socket": _rows(lambda _: "t", "target", _observed("socket")),
    "planes": _rows(lambda k: f"t{k // 4 % MOST_TOUCHED},1", "target,ball [mm]", _observed("plane")),
    "one plane": _rows(lambda _: "t,1", "target,ball [mm]", _observed("plane")),
    "spheres that are touched": _rows(
        lambda k: f"t{k // 5 % MOST_TOUCHED},1,30", "target,ball [mm],diameter [mm]", _observed("sphere")
    ),
    "one sphere": _rows(lambda _: "t,1,30", "target,ball [mm],diameter [mm]", _observed("sphere")),
    "unrelated sockets": _unrelated("socket", 3),
    "unrelated planes": _unrelated("plane", 5, ",6", ",ball [mm]"),
    "unrelated spheres": _unrelated("sphere", 5, ",6,25", ",ball [mm],diameter [mm]"),
    "unrelated distances": _unrelated("distance", 5, ",1", ",length [m]"),
    "relations that contradict": _unrelated("socket", 2, relations=COUNTS["relations"]),
    "distances": _rows(lambda k: f"t{k // 4 % MOST_TOUCHED},1", "target,length [m]", _observed("distance")),
    "indicators": _rows(lambda k: f"t{k // 4 % MOST_TOUCHED},1", "target,indicated [mm]", _observed("indicator")),
    "held out groups": _rows(lambda k: f"g{k}", "group", (('sigma = "0.02 mm"', 'sigma = "0.02 mm"\nhold_out = 0.5'),)),
    "chosen terms": _rows(lambda _: "", "", (("[error_model]", '[error_model]\nterms = "auto"'),)),
    "models of sockets": _unrelated("socket", 3, run=_MODELS),
    "models of crossed set-ups": Hostile(_crossed, _MODELS),
    "models of many rows": Hostile(_rows(lambda _: "", "").write, _MODELS),
    "models of many poses": Hostile(_different(), _MODELS),
    "models of a parallelogram": Hostile(_parallelogram, _MODELS),
    "models of two streams": Hostile(_two_streams, _MODELS),
    "models of a torso": Hostile(_torso, _MODELS),
    "many poses": Hostile(_different()),
    "terms of many poses": Hostile(_different((("[error_model]", '[error_model]\nterms = "auto"'),))),
    "harmonics of many poses": Hostile(
        _different((("[error_model]", f'[error_model]\nharmonics = "all"\nharmonic_orders = {list(range(1, 21))}'),))
    ),
    "a loss among noise": Hostile(_nowhere),
    "rows of three loops": Hostile(_struts(3)),
    "rows of many loops": Hostile(_struts(MOST_LOOPS)),
    "bearings and torques": Hostile(_giving_way),
    "loads of many set-ups": Hostile(_loaded),
    "a process of many rows": _rows(lambda _: "", "", (("[error_model]", _PROCESS),)),
    "a process of noise": Hostile(_different((("[error_model]", _PROCESS),))),
    "verified by a process": Hostile(_verified, ("verify", _RESULTS, "new.csv")),
    "verified by the largest process": Hostile(
        lambda folder, size: _verified(folder, size // 4, 5000), ("verify", _RESULTS, "new.csv")
    ),
    "candidates of a plan": Hostile(_candidates, _CHOOSE),
    "candidates of a plan of poses": Hostile(_candidates, (*_CHOOSE, "--observes", "pose")),
    "candidates of a plan with a target": Hostile(_candidates, (*_CHOOSE, "--target", "0.01 mm")),
    "columns of a table": Hostile(_wide),
    "lines without cells": Hostile(
        lambda folder, size: (folder / "identification.csv").write_text("a\n" * (size // 2), encoding="utf-8") and None
    ),
    "joint targets": Hostile(_targets, _COMPENSATE),
    "positions": Hostile(_positions, _COMPENSATE),
    "positions of a loop": Hostile(_positions_of_a_loop, _COMPENSATE),
    "poses of a loop": Hostile(_poses_of_a_loop, _COMPENSATE),
    "poses hardly in reach": Hostile(_poses, _COMPENSATE),
    "positions out of reach": Hostile(_far_positions, _COMPENSATE),
    "tools of a model": _model("tools", lambda _: _POSE, _COMPENSATE),
    "joints of a model": _model(
        "joints", lambda k: {"name": f"j{k}", "type": "fixed", "deviation": [0.0] * 6, "offset": None}, _COMPENSATE
    ),
    "positions of a machine of many terms": Hostile(_positions_of_terms, _COMPENSATE),
    "compared terms": Hostile(_earlier_of_terms, ("compare", "earlier", _RESULTS)),
    "packed grid": _packed("grid.npz", _COMPENSATE),
    "packed process": _packed("gaussian.npz", _COMPENSATE),
    **_OTHERS,
    **_WRONG_PHOTOGRAPHS,
    **{name: _imported(*of) for name, of in IMPORTED.items()},
}


def fill(name: str, folder: Path, size: int) -> tuple[str, ...]:
    """Write a file of about ``size`` bytes and the shipped case around it; return the command that reads it."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in _FILES:
        shutil.copyfile(CASE / file, folder / file)
    hostile = HOSTILE[name]
    if _RESULTS in hostile.run:
        shutil.copytree(_results(), folder / _RESULTS)
        if not (folder / "targets.csv").exists():
            _targets(folder, 1000)
    hostile.write(folder, size)
    return hostile.run


def _made() -> Path:
    return Path(tempfile.gettempdir()) / f"calib-hostile-{os.getpid()}"


def _results(case: str = "arm_cmm") -> Path:
    folder = _made() / case
    if not folder.exists():
        folder.parent.mkdir(exist_ok=True)
        done = measure(("calibrate", str(ROOT / "robots" / case / "calibration.toml"), "-o", str(folder)), ROOT)
        assert done.code == 0, done.said
    return folder


def measure(arguments: tuple[str, ...], folder: Path) -> Measured:
    """Run a command in a process of its own; return what it took."""

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (_PATIENCE, _PATIENCE))
        resource.setrlimit(resource.RLIMIT_AS, (8 * 2**30, 8 * 2**30))

    environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryFile() as out:
        process = subprocess.Popen(
            [sys.executable, "-c", _COMMAND, *arguments],
            cwd=folder,
            env=environment,
            stdout=out,
            stderr=subprocess.STDOUT,
            preexec_fn=limited,  # noqa: PLW1509 - a script of one thread
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        said = out.read().decode(errors="replace").strip().splitlines()
    return Measured(
        used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0, process.returncode, said[-1] if said else ""
    )


def main() -> int:
    """Make and read what is asked for; return 1 where something takes more than is promised."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=sorted(HOSTILE), action="append")
    parser.add_argument("--sizes", type=int, nargs="*", default=SIZES)
    parser.add_argument("--write", type=Path)
    asked = parser.parse_args()
    bad = 0
    for name in asked.only or HOSTILE:
        for size in asked.sizes:
            with tempfile.TemporaryDirectory() as scratch:
                folder = Path(scratch) if asked.write is None else asked.write / f"{name} {size}"
                arguments = fill(name, folder, size)
                if asked.write is not None:
                    continue
                took = measure(arguments, folder)
            within = took.seconds <= SECONDS and took.megabytes <= MEGABYTES and took.code in (0, 1, 3)
            bad += not within
            print(
                f"{'    ' if within else 'BAD '} {name:28} {size:9,} {took.seconds:6.1f} s {took.megabytes:6.0f} MB"
                f" {took.code:3} {took.said[:110]}",
                flush=True,
            )
    shutil.rmtree(_made(), ignore_errors=True)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
