"""What meshcat's viewer is told, packed as its server would send it, and the viewer's own files.

meshcat's Python side makes the same commands; but to import any of it loads its server, and what that asks for: more
than half of what a small calibration costs. ``tests/presentation/test_viewer.py`` holds the two against each other.
"""

import base64
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from calib.foundations.arrays import Array, IntArray

Command = Mapping[str, Any]
# Types of typed arrays in the viewer, and the codes that they have in its messages.
_TYPES = {"float32": ("Float32Array", 0x17), "uint32": ("Uint32Array", 0x16)}


class Look(NamedTuple):
    """How a thing is drawn: a material of three.js, a colour as 0xrrggbb; ``depth``: hidden by what is before it."""

    material: Literal["MeshBasicMaterial", "MeshLambertMaterial", "LineBasicMaterial"]
    colour: int
    opacity: float = 1.0
    transparent: bool = False
    depth: bool = True


def set_property(path: Sequence[str], name: str, value: float) -> Command:
    """Return the command that sets a property of a node of the viewer's tree."""
    return {"type": "set_property", "path": _node(path), "property": name, "value": value}


def set_transform(path: Sequence[str], T: Array) -> Command:
    """Return the command that places a node at ``T`` (4, 4) in its parent."""
    return {"type": "set_transform", "path": _node(path), "matrix": T.astype(float).T.ravel().tolist()}


def set_triangles(path: Sequence[str], vertices: Array, faces: IntArray, look: Look) -> Command:
    """Return the command that draws triangles: vertices (V, 3) in the node's frame, faces (F, 3) of their indices."""
    index = {"index": _packed(faces.astype(np.uint32))}
    return _set_object(path, "Mesh", {"attributes": {"position": _packed(vertices.astype(np.float32))}, **index}, look)


def set_lines(path: Sequence[str], ends: Array, look: Look) -> Command:
    """Return the command that draws lines between the points (2 L, 3), two by two."""
    return _set_object(path, "LineSegments", {"attributes": {"position": _packed(ends.astype(np.float32))}}, look)


def packed(commands: Sequence[Command]) -> list[str]:
    """Return the commands as the viewer takes them, in base64."""
    import umsgpack  # noqa: PLC0415 - nobody else needs it

    return [base64.b64encode(umsgpack.packb(command)).decode() for command in commands]


def asset(name: str) -> str:
    """Return a text file of meshcat's viewer."""
    found = find_spec("meshcat")  # says where it is without loading it
    if found is None or found.origin is None:
        raise ModuleNotFoundError("meshcat is not installed")
    return (Path(found.origin).parent / "viewer" / name).read_text(encoding="utf-8")


def _set_object(path: Sequence[str], kind: str, data: Mapping[str, Any], look: Look) -> Command:
    # meshcat names things by the host's address and the clock; a page should tell neither, and repeat exactly.
    thing, geometry, material = ("/".join((*path, name)) for name in ("object", "geometry", "material"))
    drawn = {
        "uuid": material,
        "type": look.material,
        "color": look.colour,
        "reflectivity": 0.5,
        "side": 2,
        "transparent": look.transparent,
        "opacity": look.opacity,
        "linewidth": 1.0,
        "wireframe": False,
        "wireframeLinewidth": 1.0,
        "vertexColors": 0,
        **({} if look.material == "LineBasicMaterial" else {"depthTest": look.depth}),
    }
    return {
        "type": "set_object",
        "object": {
            "metadata": {"version": 4.5, "type": "Object"},
            "geometries": [{"uuid": geometry, "type": "BufferGeometry", "data": data}],
            "materials": [drawn],
            "object": {
                "uuid": thing,
                "type": kind,
                "geometry": geometry,
                "material": material,
                "matrix": np.eye(4).ravel().tolist(),
            },
        },
        "path": _node(path),
    }


def _packed(rows: npt.NDArray[Any]) -> dict[str, Any]:
    import umsgpack  # noqa: PLC0415

    kind, code = _TYPES[rows.dtype.name]
    array = umsgpack.Ext(code, np.ascontiguousarray(rows).tobytes())
    return {"itemSize": rows.shape[1], "type": kind, "array": array, "normalized": False}


def _node(path: Sequence[str]) -> str:
    return "/" + "/".join(path)
