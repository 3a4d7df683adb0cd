"""How much a mesh file will be once it is read: a few lines of GLB or COLLADA may ask for any number of triangles.

Counted from what the file says, before a library makes it. Of the other formats only parts are
counted: their points are all in the file.
"""

import json
import struct
from collections.abc import Mapping
from typing import Any, NamedTuple
from xml.etree import ElementTree

# Beyond one for every byte: of what a file shows again and again, or asks for and does not hold.
MOST_CORNERS = 600_000
MOST_PARTS = 1000
_HEADER = 12
_WORDS_BEFORE_A_PART = {".obj": (b"\no ", b"\ng ", b"\nusemtl "), ".stl": (b"solid ",)}


class Counts(NamedTuple):
    """Corners of triangles, and parts, of a mesh."""

    corners: int
    parts: int

    def within(self, corners: int) -> bool:
        """Return whether there are no more than so many corners, and parts as few as are drawn."""
        return self.corners <= corners and self.parts <= MOST_PARTS


def counts(data: bytes, suffix: str) -> Counts:
    """Return at most how much the bytes of a mesh file are once they are read.

    Raises what a damaged file makes the readers of JSON and XML raise, and ValueError for a COLLADA in a circle.
    """
    if suffix == ".glb":
        return _of_glb(data)
    if suffix == ".dae":
        return _of_collada(data)
    return Counts(0, sum(map(data.count, _WORDS_BEFORE_A_PART.get(suffix, ()))))


def _of_glb(data: bytes) -> Counts:
    length = struct.unpack_from("<I", data, _HEADER)[0]
    tree = json.loads(data[_HEADER + 8 : _HEADER + 8 + length])
    accessors = [int(accessor["count"]) for accessor in tree["accessors"]]
    if any(count < 0 for count in accessors):
        raise ValueError("a negative count")

    def corners(primitive: Mapping[str, Any]) -> int:
        shown = primitive.get("indices", primitive["attributes"]["POSITION"])
        return int(accessors[shown] + accessors[primitive["attributes"]["POSITION"]])

    meshes = [[corners(primitive) for primitive in mesh["primitives"]] for mesh in tree["meshes"]]
    shown = [meshes[node["mesh"]] for node in tree.get("nodes", ()) if "mesh" in node]
    # All that there is is made, whether it is shown or not; and all nodes are parts of the tree.
    made = sum(accessors) + sum(map(sum, meshes))
    parts = max(sum(map(len, meshes)), sum(map(len, shown)), len(tree.get("nodes", ())), len(accessors) // 10)
    return Counts(max(made, sum(map(sum, shown))), parts)


def _of_collada(data: bytes) -> Counts:
    root = ElementTree.fromstring(data)  # noqa: S314 - documents with a type, hence entities, are refused before
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    geometries = {geometry.get("id", ""): _of_geometry(geometry) for geometry in root.iter("geometry")}
    for controller in root.iter("controller"):
        skins = [geometries.get(skin.get("source", "")[1:], Counts(0, 0)) for skin in controller.iter("skin")]
        geometries[controller.get("id", "")] = _sum(skins)
    nodes = {node.get("id", ""): node for node in root.iter("node")}
    known: dict[int, Counts | None] = {}

    def of_node(node: ElementTree.Element) -> Counts:
        if id(node) in known:
            found = known[id(node)]
            if found is None:
                raise ValueError("nodes have each other in a circle")
            return found
        known[id(node)] = None
        parts = [Counts(0, 1)]
        for child in node:
            url = child.get("url", "")[1:]
            if child.tag == "node":
                parts.append(of_node(child))
            elif child.tag == "instance_node" and url in nodes:
                parts.append(of_node(nodes[url]))
            elif child.tag in ("instance_geometry", "instance_controller"):
                parts.append(geometries.get(url, Counts(0, 1)))
        found = _sum(parts)
        known[id(node)] = found
        return found

    shown = _sum([of_node(node) for scene in root.iter("visual_scene") for node in scene if node.tag == "node"])
    # Whatever is in the library is made as well, and once.
    library = _sum([*geometries.values(), *(of_node(node) for group in root.iter("library_nodes") for node in group)])
    return Counts(max(shown.corners, library.corners), max(shown.parts, library.parts))


def _of_geometry(geometry: ElementTree.Element) -> Counts:
    corners = parts = 0
    for primitive in geometry.iter():
        if primitive.tag in ("triangles", "polylist", "polygons", "tristrips", "trifans", "lines", "linestrips"):
            each = 1 + max((int(i.get("offset", "0")) for i in primitive.iter("input")), default=0)
            words = sum(len((p.text or "").split()) for p in primitive.iter("p"))
            # A polygon of n corners is n - 2 triangles.
            corners += words // max(each, 1) * (1 if primitive.tag in ("triangles", "lines") else 3)
            parts += 1
    return Counts(corners, parts)


def _sum(found: list[Counts]) -> Counts:
    return Counts(sum(one.corners for one in found), sum(one.parts for one in found))
