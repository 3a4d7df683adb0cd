"""Triangles: the simple shapes a scene is drawn with, and meshes with fewer faces."""

import itertools
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.lazy import loaded_in_one_go
from calib.foundations.units import DEG
from calib.robot.mesh_files import Rgb, Triangles

# Edges sharper than this stay edges; the browser shades the rest smoothly.
_CREASE = 30.0 * DEG
# Of a mesh's size: vertices nearer than this are one.
_SAME = 1e-6
# The fewest faces of a body, and how many more faces than asked may be left.
_LEAST = 4
_SLACK = 2.0
# Of the library, which moves a surface at last by sqrt(103^k 1e-9) thousandths of the mesh: 0.3 %, 3 %, then anything.
_KEENNESS = (5, 6, 7)
# Of the cells of grids that simplify; the first one is so many times finer than it might be.
_GROWTH = 1.4
_SAFETY = 3.0


def balls(centres: Array, radius: float, rgb: Rgb, subdivisions: int = 0) -> Triangles:
    """Return triangles that draw a ball at each of ``centres`` (N, 3), with 20 faces, times 4 a subdivision."""
    vertices, faces = _ball(subdivisions)
    return Triangles((centres[:, None] + radius * vertices).reshape(-1, 3), _repeated(faces, len(centres)), rgb)


@cache
def _ball(subdivisions: int) -> tuple[Array, IntArray]:
    """Return a ball of radius 1: an icosahedron whose faces are cut in four again and again."""
    if not subdivisions:
        g = (1.0 + np.sqrt(5.0)) / 2.0
        corners = np.array([(0.0, s, t * g) for s in (-1.0, 1.0) for t in (-1.0, 1.0)])
        vertices = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)])
        triples = np.array(list(itertools.combinations(range(12), 3)))
        # Three corners are a face where all are neighbours; its order makes it look outward.
        sides = np.linalg.norm(vertices[triples] - vertices[np.roll(triples, 1, axis=1)], axis=2)
        faces = triples[(sides < 2.1).all(axis=1)]
        inward = np.linalg.det(vertices[faces]) < 0.0
        faces[inward] = faces[inward][:, ::-1]
        return read_only(vertices / np.sqrt(1.0 + g * g)), np.asarray(faces, dtype=np.intp)
    vertices, faces = _ball(subdivisions - 1)
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    cut, index = np.unique(edges, axis=0, return_inverse=True)
    middles = vertices[cut].sum(axis=1)
    a, b, c = faces.T
    ab, bc, ca = index.reshape(-1, 3).T + len(vertices)
    quarters = np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], axis=1).reshape(-1, 3)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    return read_only(np.concatenate([vertices, middles])), np.asarray(quarters, dtype=np.intp)


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
    if kind == "sphere":
        halvings = max(k for k in range(4) if k == 0 or 20 * 4**k <= faces)
        return balls(np.zeros((1, 3)), sizes[0], rgb, halvings)
    with loaded_in_one_go():
        from trimesh import creation  # noqa: PLC0415 - slow to load

    if kind == "box":
        mesh = creation.box(extents=sizes)
    else:
        mesh = creation.cylinder(radius=sizes[0], height=sizes[1], sections=min(max(faces // 4, 5), 48))
    return Triangles(np.asarray(mesh.vertices), np.asarray(mesh.faces), rgb)


def simplified(parts: Sequence[Triangles], most_faces: int) -> tuple[Triangles, ...]:
    """Return the parts with about ``most_faces`` faces in all, at most twice as many, near the surface they had.

    Vertices that the file wrote twice are joined first. Then edges whose end costs the surface least are taken away
    (M. Garland, P. S. Heckbert, *Surface simplification using quadric error metrics*, SIGGRAPH 1997): what was closed
    stays closed, and a surface that ends keeps its edge: a flat one could else vanish, for its loss costs nothing. What
    that leaves too much of, as of loose triangles, is thinned by a grid.
    """
    extent = max((float(np.ptp(part.vertices, axis=0).max()) for part in parts if len(part.vertices)), default=0.0)
    welded = tuple(_clustered(part, _SAME * extent or 1.0) for part in parts)
    faces = sum(len(part.faces) for part in welded)
    if faces <= most_faces:
        return welded
    for keenness in _KEENNESS:
        thin = tuple(_decimated(part, round(most_faces * len(part.faces) / faces), extent, keenness) for part in welded)
        if sum(len(part.faces) for part in thin) <= _SLACK * most_faces:
            return thin
    out = welded
    # The grid begins where so many faces could first cover as much surface.
    cell = np.sqrt(sum(map(_surface, out)) / most_faces) / _SAFETY
    while sum(len(part.faces) for part in out) > most_faces:
        out, cell = tuple(_clustered(part, cell) for part in out), _GROWTH * cell
    return out


def _decimated(part: Triangles, faces: int, extent: float, keenness: int) -> Triangles:
    if len(part.faces) <= max(faces, _LEAST):
        return part
    import fast_simplification  # noqa: PLC0415 - slow to load

    # In thousandths of the mesh: the library begins with errors of fixed sizes.
    scale = 1e3 / extent
    vertices, left = fast_simplification.simplify(
        part.vertices * scale,
        part.faces.astype(np.int32),
        target_count=max(faces, _LEAST),
        agg=keenness,
        preserve_border=True,
    )
    return Triangles(np.asarray(vertices, dtype=np.float64) / scale, np.asarray(left, dtype=np.intp), part.rgb)


def _surface(part: Triangles) -> float:
    a, b, c = np.swapaxes(part.vertices[part.faces], 0, 1)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def creased(parts: Sequence[Triangles]) -> tuple[Triangles, ...]:
    """Return the triangles with vertices doubled along sharp edges, which smooth shading would otherwise smear."""
    return tuple(_creased(part) if len(part.faces) else part for part in parts)


def _creased(part: Triangles) -> Triangles:
    edges = np.sort(part.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    number = edges[:, 0].astype(np.int64) * len(part.vertices) + edges[:, 1]
    order = np.argsort(number, kind="stable")
    runs = np.flatnonzero(np.diff(number[order], prepend=-1))
    # Edges of two faces; where there are more, nobody can say which belong together.
    first = runs[np.diff(runs, append=len(order)) == 2]
    beside = np.stack([order[first], order[first + 1]], axis=1) // 3
    a, b, c = np.swapaxes(part.vertices[part.faces], 0, 1)
    normals = np.cross(b - a, c - a)
    sizes = np.linalg.norm(normals, axis=1)
    normals /= np.where(sizes > 0.0, sizes, 1.0)[:, None]
    smooth = beside[(normals[beside[:, 0]] * normals[beside[:, 1]]).sum(axis=1) >= np.cos(_CREASE)]
    n = len(part.faces)
    _, patch = scipy.sparse.csgraph.connected_components(
        scipy.sparse.coo_array((np.ones(len(smooth)), smooth.T), shape=(n, n)), directed=False
    )
    corners = np.repeat(patch, 3).astype(np.int64) * len(part.vertices) + part.faces.ravel()
    doubled, index = np.unique(corners, return_inverse=True)
    return Triangles(part.vertices[doubled % len(part.vertices)], index.reshape(-1, 3), part.rgb)


def _repeated(faces: npt.NDArray[np.integer], n: int) -> IntArray:
    return np.asarray((faces + np.arange(n)[:, None, None] * (faces.max() + 1)).reshape(-1, 3), dtype=np.intp)


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
