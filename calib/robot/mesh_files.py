"""Mesh files as triangles, for scenes and for collisions: one reader, and nothing but the file is opened."""

import io
import logging
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from calib.foundations.arrays import Array, IntArray
from calib.foundations.files import DAMAGED
from calib.robot.mesh_counts import MOST_CORNERS, counts

Rgb = tuple[float, float, float]

# Formats that hold a mesh and nothing else: trimesh would also open archives, drawings and CAD files.
_FORMATS = {".dae", ".stl", ".obj", ".ply", ".off", ".glb"}
LARGEST_FILE = 200_000_000


@dataclass(frozen=True, slots=True, eq=False)
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
    from collada.common import DaeError  # noqa: PLC0415

    trimesh = _trimesh()
    try:
        told = counts(data, suffix)
        if not told.within(spare + len(data)):
            return None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], resolver=None)
            # COLLADA states its unit, and ROS viewers obey it.
            unit = 1.0 if scene.units is None else trimesh.units.unit_conversion(scene.units, "meters")
            parts = [
                moved(_triangles(scene.geometry[name], otherwise), T @ np.diag([unit, unit, unit, 1.0]))
                for T, name in map(scene.graph.get, scene.graph.nodes_geometry)
                if isinstance(scene.geometry[name], trimesh.Trimesh)
            ]
    except (DaeError, *DAMAGED):
        return None
    corners = 3 * sum(len(part.faces) for part in parts)
    usable = 0 < corners <= spare + len(data) and all(map(is_sound, parts))
    return Mesh(joined_by_colour(parts), max(corners, told.corners)) if usable else None


def is_sound(part: Triangles) -> bool:
    """Return whether vertices are numbers, and faces are of vertices that there are."""
    faces = part.faces
    return bool(np.isfinite(part.vertices).all() and ((faces >= 0) & (faces < len(part.vertices))).all())


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
