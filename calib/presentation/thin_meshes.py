"""Mesh files as a scene draws them: thinned and shaded once, and kept in the user's cache by what they hold."""

import json
from dataclasses import dataclass
from functools import cache as once
from importlib.metadata import version
from pathlib import Path

import numpy as np

from calib.foundations import cache
from calib.foundations.errors import RobotError
from calib.foundations.files import read_bytes, sha256
from calib.foundations.json_text import NotJsonError, parse_json
from calib.presentation import meshes
from calib.presentation.meshes import creased, simplified
from calib.robot import mesh_counts, mesh_files
from calib.robot.mesh_counts import MOST_CORNERS
from calib.robot.mesh_files import LARGEST_FILE, Rgb, Triangles, is_sound, parse_mesh

_LIBRARIES = ("trimesh", "pycollada", "fast-simplification", "numpy")


@dataclass(frozen=True, slots=True, eq=False)
class ThinMesh:
    """The triangles of a mesh as they are drawn, the corners that its file has or asks for, and its size in bytes."""

    parts: tuple[Triangles, ...]
    corners: int
    size: int


def thin_mesh(path: Path, otherwise: Rgb, most_faces: int, spare: int = MOST_CORNERS) -> ThinMesh | None:
    """Return a mesh file with about ``most_faces`` faces at most, in its own colours or ``otherwise``.

    None when the file is unusable, or too much, as :func:`calib.presentation.meshes.parse_mesh` has it.
    """
    try:
        data = read_bytes(path, RobotError, LARGEST_FILE)
    except RobotError:
        return None
    suffix = path.suffix.lower()
    told = f"{suffix} {otherwise} {most_faces} {sha256(data)} {_maker()}"
    key = sha256(told.encode())
    found = cache.kept(key)
    thin = None if found is None else _unpacked(found, len(data))
    if thin is None:
        mesh = parse_mesh(data, suffix, otherwise, spare)
        if mesh is None:
            return None
        thin = ThinMesh(creased(simplified(mesh.parts, most_faces)), mesh.corners, len(data))
        cache.keep(key, _packed(thin))
    # Whether there is room for it is asked of what was kept as of what is made.
    return thin if thin.corners <= spare + thin.size else None


@once
def _maker() -> str:
    """Return what tells whether meshes are made as they were: our own code, and the libraries."""
    own = [sha256(Path(str(module.__file__)).read_bytes()) for module in (meshes, mesh_files, mesh_counts)]
    return " ".join([*own, *map(version, _LIBRARIES)])


def _packed(thin: ThinMesh) -> bytes:
    told = [{"rgb": part.rgb, "vertices": len(part.vertices), "faces": len(part.faces)} for part in thin.parts]
    arrays = [a for part in thin.parts for a in (part.vertices.astype("<f8"), part.faces.astype("<i4"))]
    head = json.dumps({"corners": thin.corners, "parts": told}).encode()
    return head + b"\n" + b"".join(array.tobytes() for array in arrays)


def _unpacked(data: bytes, size: int) -> ThinMesh | None:
    """Return what was kept, None where it makes no sense."""
    head, _, rest = data.partition(b"\n")
    try:
        told = parse_json(head)
        parts: list[Triangles] = []
        for part in told["parts"]:
            red, green, blue = map(float, part["rgb"])
            sizes = int(part["vertices"]), int(part["faces"])
            if min(sizes) < 0:  # NumPy would take all there is
                return None
            vertices = np.frombuffer(rest, "<f8", 3 * sizes[0]).reshape(-1, 3)
            faces = np.frombuffer(rest, "<i4", 3 * sizes[1], vertices.nbytes).reshape(-1, 3)
            rest = rest[vertices.nbytes + faces.nbytes :]
            parts.append(Triangles(vertices.astype(np.float64), faces.astype(np.intp), (red, green, blue)))
        return ThinMesh(tuple(parts), int(told["corners"]), size) if all(map(is_sound, parts)) and not rest else None
    except (NotJsonError, LookupError, TypeError, ValueError):
        return None
