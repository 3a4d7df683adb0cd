"""Mesh files as triangles, for scenes and for collisions: one reader, and nothing but the file is opened."""

import codecs
import io
import logging
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from calib.foundations.arrays import Array, IntArray
from calib.foundations.files import DAMAGED
from calib.foundations.lazy import loaded_in_one_go
from calib.foundations.sealing import sealed
from calib.robot.mesh_counts import MOST_CORNERS, counts, without_pictures

Rgb = tuple[float, float, float]

# Formats that hold a mesh and nothing else: trimesh would also open archives, drawings and CAD files.
_FORMATS = {".dae", ".stl", ".obj", ".ply", ".off", ".glb"}
_TEXTS = {".stl", ".obj", ".off"}
LARGEST_FILE = 200_000_000
# Of an OBJ: a line that begins with a blank, tabs, remarks behind words, and points counted backwards or from 0.
_UNUSUAL_OBJ = re.compile(rb"(?m)^[ \t]+[vf]|^[vf][^\n]*[\t#]|^f[^\n]*(?:[ /]-| 0)")
# Corners so near each other, in m, are one vertex.
_SAME_PLACE = 1e-8
_STL_HEADER = 84
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Triangles:
    """Triangles of one colour: vertices (V, 3) in m, faces (F, 3) of vertex indices, and red, green, blue in 0..1."""

    vertices: Array
    faces: IntArray
    rgb: Rgb


class Mesh(NamedTuple):
    """The triangles of a file, and how many corners it has or asks for."""

    parts: tuple[Triangles, ...]
    corners: int


def joined_by_colour(parts: Sequence[Triangles]) -> tuple[Triangles, ...]:
    """Return the same triangles with all parts of one colour joined, in the order in which colours first appear."""
    colours = dict.fromkeys(part.rgb for part in parts)
    return tuple(joined([part for part in parts if part.rgb == rgb], rgb) for rgb in colours)


def moved(part: Triangles, T: Array) -> Triangles:
    """Return the triangles moved by the placement (or any affine map) ``T`` (4, 4)."""
    return Triangles(part.vertices @ T[:3, :3].T + T[:3, 3], part.faces, part.rgb)


@cache
def _trimesh() -> Any:
    """Return trimesh. What it says of textures that it does not find is not for the terminal."""
    with loaded_in_one_go():
        import trimesh  # noqa: PLC0415 - slow to load

    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    return trimesh


def parse_mesh(data: bytes, suffix: str, otherwise: Rgb, spare: int = MOST_CORNERS) -> Mesh | None:
    """Return the triangles of a mesh file in m, in its own colours or ``otherwise``; None when the file is unusable.

    It is unusable as well when its triangles have more corners than the file has bytes and ``spare`` ones, or are in
    too many parts. ``suffix``: of the file, as ``.stl``.
    Nothing else is opened: textures and material libraries beside it are not followed.
    """
    if suffix not in _FORMATS:
        return None
    triangles = _of_binary_stl(data, otherwise) if suffix == ".stl" else None
    if suffix in _TEXTS and triangles is None:
        data = _as_utf8(data)
    try:
        data = _as_usual(data) if suffix == ".obj" else data
        told = counts(data, suffix)
    except DAMAGED:
        return None
    if not told.within(spare + len(data)):
        return None
    parts = _by_library(data, suffix, otherwise) if triangles is None else [triangles]
    corners = 3 * sum(len(part.faces) for part in parts)
    usable = 0 < corners <= spare + len(data) and all(map(is_sound, parts)) and any(map(_is_seen, parts))
    return Mesh(joined_by_colour(parts), max(corners, told.corners)) if usable else None


def _as_utf8(data: bytes) -> bytes:
    """Return a text as the library reads it: it would guess the encoding, and so read words that nobody counted."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace").encode()
    return data.removeprefix(codecs.BOM_UTF8).decode("utf-8", "replace").encode()


def _as_usual(data: bytes) -> bytes:
    """Return an OBJ as the library reads it: it passes over lines that begin with a blank, and would miscount.

    Numbers of points that are told from a face backwards are of those before it; the library counts from the end of
    the file. Raises ValueError for a number of no point.
    """
    if not _UNUSUAL_OBJ.search(data):
        return data
    counted, lines = {b"v": 0, b"vt": 0, b"vn": 0}, []

    def forwards(number: bytes, kind: bytes) -> bytes:
        found = counted[kind] + 1 + int(number) if number.startswith(b"-") else number
        if found == b"0" or (isinstance(found, int) and found < 1):
            raise ValueError(number)
        return b"%d" % found if isinstance(found, int) else found

    for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        words = line.partition(b"#")[0].split() if line.lstrip()[:1] in (b"v", b"f") else line.split()
        if words and words[0] in counted:
            counted[words[0]] += 1
        elif words[:1] == [b"f"]:
            corners = (corner.split(b"/") for corner in words[1:])
            words[1:] = [b"/".join(map(forwards, corner, counted)) for corner in corners]
        lines.append(b" ".join(words))
    return b"\n".join([*lines, b""])


def _of_binary_stl(data: bytes, rgb: Rgb) -> Triangles | None:
    """Return the triangles of a binary STL, corners in one place as one vertex; None when the file is none.

    trimesh would find the same, but to load it takes longer than most commands that judge collisions.
    """
    count = int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little")
    if len(data) != _STL_HEADER + count * _STL_TRIANGLE.itemsize:
        return None
    with np.errstate(invalid="ignore"):
        corners = np.frombuffer(data, _STL_TRIANGLE, offset=_STL_HEADER)["corners"].reshape(-1, 3).astype(np.float64)
        # 0 is added to what is rounded to -0.
        places = np.rint(corners / _SAME_PLACE) + 0.0
    _, first, vertex = np.unique(places.view("V24").ravel(), return_index=True, return_inverse=True)
    order = np.argsort(first)
    return Triangles(corners[first[order]], np.argsort(order)[vertex].reshape(-1, 3), rgb)


def _by_library(data: bytes, suffix: str, otherwise: Rgb) -> list[Triangles]:
    """Return the triangles of a mesh file of any format, none when it is damaged."""
    from collada.common import DaeError  # noqa: PLC0415

    trimesh = _trimesh()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            data = without_pictures(data) if suffix == ".glb" else data
            scene = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], resolver=None, process=False)
            # COLLADA states its unit, and ROS viewers obey it. The places of its nodes are in that unit as well.
            unit = 1.0 if scene.units is None else trimesh.units.unit_conversion(scene.units, "meters")
            return [
                moved(_triangles(scene.geometry[name], otherwise), np.diag([unit, unit, unit, 1.0]) @ T)
                for T, name in map(scene.graph.get, scene.graph.nodes_geometry)
                if isinstance(scene.geometry[name], trimesh.Trimesh)
            ]
    except (DaeError, *DAMAGED):
        return []


def is_sound(part: Triangles) -> bool:
    """Return whether vertices are numbers, and faces are of vertices that there are."""
    faces = part.faces
    return bool(np.isfinite(part.vertices).all() and ((faces >= 0) & (faces < len(part.vertices))).all())


def _is_seen(part: Triangles) -> bool:
    """Return whether vertices are in more than one place; they are not where a packing of them is not known (Draco)."""
    return len(part.vertices) > 0 and bool(np.ptp(part.vertices, axis=0).max() > 0.0)


def _triangles(mesh: Any, otherwise: Rgb) -> Triangles:
    material = getattr(mesh.visual, "material", None)
    named = mesh.visual if material is None else material
    r, g, b = (c / 255.0 for c in named.main_color[:3].tolist()) if mesh.visual.defined else otherwise
    return Triangles(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces), (r, g, b))


def joined(parts: Sequence[Triangles], rgb: Rgb) -> Triangles:
    """Return the triangles of one part or more as one, of one colour."""
    first = np.cumsum([0] + [len(part.vertices) for part in parts])
    return Triangles(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + i for part, i in zip(parts, first, strict=False)]),
        rgb,
    )
