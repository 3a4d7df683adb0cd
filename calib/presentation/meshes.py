"""Triangles: the simple shapes a scene is drawn with, and mesh files read under declared roots.

A mesh is decoration: whatever is wrong with one (missing, outside the roots, broken), the scene is drawn without it.
"""

import io
import struct
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
import numpy.typing as npt

from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import RobotError
from calib.foundations.files import read_bytes
from calib.presentation.mesh_counts import MOST_CORNERS, counts

Rgb = tuple[float, float, float]

# Formats that hold a mesh and nothing else: trimesh would also open archives, drawings and CAD files.
_FORMATS = {".dae", ".stl", ".obj", ".ply", ".off", ".glb"}
_LARGEST_FILE = 200_000_000
# What the readers were seen to raise on damaged files; they have no exception of their own.
_DAMAGED = (
    *(ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, NameError, OSError),
    *(RuntimeError, SyntaxError, TypeError, ValueError, struct.error, expat.ExpatError),
)
# Edges sharper than this stay edges; the browser shades the rest smoothly.
_CREASE = np.deg2rad(30.0)
# Of the cells of grids that simplify; the first one is so many times finer than it might be.
_GROWTH = 1.4
_SAFETY = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """Triangles of one colour: vertices (V, 3) in m, faces (F, 3) of vertex indices, and red, green, blue in 0..1."""

    vertices: Array
    faces: IntArray
    rgb: Rgb


def balls(centres: Array, radius: float, rgb: Rgb, subdivisions: int = 0) -> Triangles:
    """Return triangles that draw a ball at each of ``centres`` (N, 3), with 20 faces, times 4 a subdivision."""
    import trimesh  # noqa: PLC0415 - calib must not load it on import

    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return Triangles(
        (centres[:, None] + ball.vertices).reshape(-1, 3), _repeated(np.asarray(ball.faces), len(centres)), rgb
    )


def sticks(starts: Array, ends: Array, radius: float, rgb: Rgb, sides: int = 4) -> Triangles:
    """Return triangles that draw a stick from each of ``starts`` (N, 3) to its end, none where the two coincide."""
    length = np.linalg.norm(ends - starts, axis=1)
    starts, ends, length = (a[length > 0.0] for a in (starts, ends, length))
    axis = (ends - starts) / length[:, None]
    # The coordinate axis least along the stick is safely not parallel to it.
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = 2.0 * np.pi * np.arange(sides)[:, None] / sides
    ring = radius * (np.cos(angle) * across[:, None] + np.sin(angle) * np.cross(axis, across)[:, None])
    vertices = np.concatenate([starts[:, None] + ring, ends[:, None] + ring], axis=1).reshape(-1, 3)
    i = np.arange(sides)
    j = (i + 1) % sides
    wall = np.concatenate([np.stack([i, j, i + sides], axis=1), np.stack([j, j + sides, i + sides], axis=1)])
    return Triangles(vertices, _repeated(wall, len(starts)), rgb)


def primitive(kind: str, sizes: Sequence[float], rgb: Rgb, faces: int = 1280) -> Triangles:
    """Return a box of three edges, a sphere of a radius or a cylinder (along z) of a radius and a length, in m.

    What is round has about so many ``faces``: of a sphere at most 1280, of a cylinder 192, of both at least 20.
    """
    from trimesh import creation  # noqa: PLC0415

    # Of size 1 first: trimesh divides by the size of a sphere, and some have none.
    scale = 1.0
    if kind == "box":
        mesh = creation.box(extents=sizes)
    elif kind == "sphere":
        halvings = max(k for k in range(4) if k == 0 or 20 * 4**k <= faces)
        mesh, scale = creation.icosphere(subdivisions=halvings), sizes[0]
    else:
        mesh = creation.cylinder(radius=sizes[0], height=sizes[1], sections=min(max(faces // 4, 5), 48))
    return Triangles(scale * np.asarray(mesh.vertices), np.asarray(mesh.faces), rgb)


def joined(parts: Sequence[Triangles]) -> tuple[Triangles, ...]:
    """Return the same triangles with all parts of one colour joined, in the order in which colours first appear."""
    colours = dict.fromkeys(part.rgb for part in parts)
    return tuple(_concatenated([part for part in parts if part.rgb == rgb], rgb) for rgb in colours)


def moved(part: Triangles, T: Array) -> Triangles:
    """Return the triangles moved by the placement (or any affine map) ``T`` (4, 4)."""
    return Triangles(part.vertices @ T[:3, :3].T + T[:3, 3], part.faces, part.rgb)


def read_mesh(path: Path, otherwise: Rgb, spare: int = MOST_CORNERS) -> tuple[Triangles, ...] | None:
    """Return the triangles of a mesh file in m, in its own colours or ``otherwise``; None when the file is unusable.

    It is unusable as well when its triangles have more corners than the file has bytes and ``spare`` ones, or are in
    too many parts.
    Nothing but ``path`` is opened: textures and material libraries beside it are not followed.
    """
    import trimesh  # noqa: PLC0415
    from collada.common import DaeError  # noqa: PLC0415

    if path.suffix.lower() not in _FORMATS:
        return None
    try:
        data = read_bytes(path, RobotError, _LARGEST_FILE)
        if path.suffix.lower() == ".dae":
            _refuse_doctype(data)
        if not counts(data, path.suffix.lower()).within(spare + len(data)):
            return None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = trimesh.load_scene(io.BytesIO(data), file_type=path.suffix[1:].lower(), resolver=None)
            # COLLADA states its unit, and ROS viewers obey it.
            unit = 1.0 if scene.units is None else trimesh.units.unit_conversion(scene.units, "meters")
            parts = [
                moved(_triangles(scene.geometry[name], otherwise), T @ np.diag([unit, unit, unit, 1.0]))
                for T, name in map(scene.graph.get, scene.graph.nodes_geometry)
                if isinstance(scene.geometry[name], trimesh.Trimesh)
            ]
    except (RobotError, DaeError, *_DAMAGED):
        return None
    usable = (
        bool(parts)
        and all(np.isfinite(part.vertices).all() for part in parts)
        and 0 < 3 * sum(len(part.faces) for part in parts) <= spare + len(data)
    )
    return joined(parts) if usable else None


def _refuse_doctype(data: bytes) -> None:
    """Raise ValueError for XML with a document type, whose entities may grow without end or name other files."""

    def refuse(*_: object) -> None:
        raise ValueError("has a document type")

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.Parse(data, True)


def simplified(parts: Sequence[Triangles], most_faces: int) -> tuple[Triangles, ...]:
    """Return the parts with at most ``most_faces`` faces in all: vertices that share a cell of a grid become one.

    The first grid, a micrometre, only joins what the file wrote twice; it grows until the faces are few enough, from
    where so many faces could first cover as much surface.
    """
    cell = 1e-6
    out = tuple(_clustered(part, cell) for part in parts)
    cell = 5e-4
    if sum(len(part.faces) for part in out) > most_faces:
        while cell < np.sqrt(sum(map(_surface, out)) / most_faces) / _SAFETY:
            cell *= _GROWTH
    while sum(len(part.faces) for part in out) > most_faces:
        out, cell = tuple(_clustered(part, cell) for part in out), _GROWTH * cell
    return out


def _surface(part: Triangles) -> float:
    a, b, c = np.swapaxes(part.vertices[part.faces], 0, 1)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def creased(parts: Sequence[Triangles]) -> tuple[Triangles, ...]:
    """Return the triangles with vertices doubled along sharp edges, which smooth shading would otherwise smear."""
    import trimesh  # noqa: PLC0415

    if not any(len(part.faces) for part in parts):
        return tuple(parts)
    # All at once: a library call for every part of thousands takes longer than all else.
    whole = _concatenated(parts, parts[0].rgb)
    mesh = trimesh.Trimesh(whole.vertices, whole.faces, process=False)
    smooth = mesh.face_adjacency[mesh.face_adjacency_angles <= _CREASE]
    patch = trimesh.graph.connected_component_labels(smooth, node_count=len(whole.faces))
    out, end = [], 0
    for part in parts:
        start, end = end, end + len(part.faces)
        corners = np.stack([np.repeat(patch[start:end], 3), part.faces.ravel()], axis=1)
        doubled, index = np.unique(corners, axis=0, return_inverse=True)
        out.append(Triangles(part.vertices[doubled[:, 1]], index.reshape(-1, 3), part.rgb))
    return tuple(out)


def _triangles(mesh: Any, otherwise: Rgb) -> Triangles:
    material = getattr(mesh.visual, "material", None)
    named = mesh.visual if material is None else material
    r, g, b = (c / 255.0 for c in named.main_color[:3].tolist()) if mesh.visual.defined else otherwise
    return Triangles(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces), (r, g, b))


def _repeated(faces: npt.NDArray[np.integer], n: int) -> IntArray:
    return np.asarray((faces + np.arange(n)[:, None, None] * (faces.max() + 1)).reshape(-1, 3), dtype=np.intp)


def _concatenated(parts: Sequence[Triangles], rgb: Rgb) -> Triangles:
    first = np.cumsum([0] + [len(part.vertices) for part in parts])
    return Triangles(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + i for part, i in zip(parts, first, strict=False)]),
        rgb,
    )


def _clustered(part: Triangles, cell: float) -> Triangles:
    _, first, index = np.unique(_numbered(np.round(part.vertices / cell)), return_index=True, return_inverse=True)
    faces = index.reshape(-1)[part.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, once = np.unique(_numbered(np.sort(faces, axis=1)), return_index=True)
    return Triangles(part.vertices[first], faces[np.sort(once)], part.rgb)


def _numbered(rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a number (N,) for each of rows (N, 3) of whole numbers, in the order of the rows: many times faster."""
    if not len(rows):
        return np.zeros(0)
    low = rows.min(axis=0)
    sizes = rows.max(axis=0) - low + 1.0
    if not np.prod(sizes) < 2.0**62:
        return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)
    x, y, z = (rows - low).astype(np.int64).T
    return np.asarray((x * int(sizes[1]) + y) * int(sizes[2]) + z)
