"""How much a mesh file will be once it is read: a few lines of GLB or COLLADA may ask for any number of triangles.

Counted from what the file says, before a library makes it. Of the other formats only parts are
counted: their points are all in the file. Pictures in a GLB are left out, as nobody looks at them.
"""

import json
import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.foundations.xml_text import Element, read_xml

# Beyond one for every byte: of what a file shows again and again, or asks for and does not hold.
MOST_CORNERS = 600_000
MOST_PARTS = 1000
_HEADER = 12
# A material is looked for within lines as well.
_WORDS_BEFORE_A_PART = {".obj": (b"\no ", b"\ng ", b"usemtl "), ".stl": (b"solid",)}
# What a GLB may require that has nothing to do with places, or that the library reads: whole numbers for them.
_READ_WITHOUT = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_mesh_quantization", "KHR_lights_")
# Properties of a PLY that are looked at as long as one part is made.
_LOOKS_OF_A_PART = 100


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
    if suffix == ".ply":
        # Before each list all properties are looked at again.
        return Counts(0, data.count(b"list") * data.count(b"property") // _LOOKS_OF_A_PART)
    if suffix == ".obj":
        data = data.replace(b"\r\n", b"\n").replace(b"\\\n", b"")
    words = _WORDS_BEFORE_A_PART.get(suffix, ())
    return Counts(0, sum(map((data.lower() if words else data).count, words)))


def _of_glb(data: bytes) -> Counts:
    length = struct.unpack_from("<I", data, _HEADER)[0]
    tree = json.loads(data[_HEADER + 8 : _HEADER + 8 + length])
    _refuse_other_shapes(tree)
    accessors = [int(accessor["count"]) for accessor in tree["accessors"]]
    if any(count < 0 for count in accessors):
        raise ValueError("a negative count")

    def corners(primitive: Mapping[str, Any]) -> int:
        shown = primitive.get("indices", primitive["attributes"]["POSITION"])
        return int(accessors[shown] + accessors[primitive["attributes"]["POSITION"]])

    meshes = [[corners(primitive) for primitive in mesh["primitives"]] for mesh in tree["meshes"]]
    shown = [meshes[node["mesh"]] for node in tree.get("nodes", ()) if "mesh" in node]
    # All that there is is made, whether it is shown or not; and all nodes are parts of the tree.
    made = sum(accessors) + sum(map(sum, meshes)) + _copied(tree.get("bufferViews", ()), len(data))
    nodes = tree.get("nodes", ())
    # Of a tree, each node is the child of one at most; another graph is walked along all its edges.
    children = sum(len(node.get("children", ())) for node in nodes)
    parts = max(sum(map(len, meshes)), sum(map(len, shown)), len(nodes), children, len(accessors) // 10)
    return Counts(max(made, sum(map(sum, shown))), parts)


def _refuse_other_shapes(tree: Mapping[str, Any]) -> None:
    """Raise ValueError where a GLB has what the library passes over, and so would show another shape.

    Places that are fractions of a range or differ from those of the buffer, and that weights or joints move; and what
    the file itself says nobody can do without.
    """
    if any(not str(name).startswith(_READ_WITHOUT) for name in tree.get("extensionsRequired", ())):
        raise ValueError("an extension")
    accessors = tree["accessors"]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            places, used = accessors[primitive["attributes"]["POSITION"]], primitive.get("indices")
            if places.get("normalized") or "sparse" in places or (used is not None and "sparse" in accessors[used]):
                raise ValueError("places that are no numbers of the buffer")
    moved = [thing.get("weights", ()) for thing in (*tree["meshes"], *tree.get("nodes", ()))]
    if any(map(any, moved)) or any("skin" in node for node in tree.get("nodes", ())):
        raise ValueError("places that are moved")


def _copied(views: Iterable[Mapping[str, Any]], size: int) -> int:
    """Return how many bytes more than a GLB of ``size`` has its views have: each is copied, and they may overlap."""
    lengths = (int(view.get("byteLength", 0)) for view in views)
    return max(sum(length if 0 <= length < size else size for length in lengths) - size, 0)


def _of_collada(data: bytes) -> Counts:
    everything: dict[str, list[Element]] = {}
    for element in read_xml(data, texts=True).descendants():
        everything.setdefault(_tag(element), []).append(element)
    _refuse_no_places(everything)
    geometries: dict[str, Counts] = {}

    def add(element: Element, found: Counts) -> None:
        # Of those that share an id, one reader takes the first and another the last.
        key = element.attributes.get("id", "")
        geometries[key] = _most([geometries.get(key, found), found])

    for geometry in everything.get("geometry", ()):
        add(geometry, _of_geometry(geometry))
    for controller in everything.get("controller", ()):
        skins = [
            geometries.get(skin.attributes.get("source", "")[1:], Counts(0, 0)) for skin in _below(controller, "skin")
        ]
        add(controller, _sum(skins))
    libraries = everything.get("library_nodes", ())
    nodes = _called([node for library in libraries for node in library.children], ("id",))
    # One reader looks there first, and then takes what has such an id or a name anywhere.
    nodes = {**_called(everything.get("node", ()), ("id", "name")), **nodes}
    known: dict[int, Counts | None] = {}

    def of_node(node: Element) -> Counts:
        if id(node) in known:
            found = known[id(node)]
            if found is None:
                raise ValueError("nodes have each other in a circle")
            return found
        known[id(node)] = None
        parts = [Counts(0, 1)]
        for child in node.children:
            url = child.attributes.get("url", "")[1:]
            if _tag(child) == "node":
                parts.append(of_node(child))
            elif _tag(child) == "instance_node" and url in nodes:
                parts.append(_most([of_node(one) for one in nodes[url]]))
            elif _tag(child) in ("instance_geometry", "instance_controller"):
                parts.append(geometries.get(url, Counts(0, 1)))
        found = _sum(parts)
        known[id(node)] = found
        return found

    scenes = everything.get("visual_scene", ())
    shown = _sum([of_node(node) for scene in scenes for node in scene.children if _tag(node) == "node"])
    # Whatever is in the library is made as well, and once.
    library = _sum([*geometries.values(), *(of_node(node) for group in libraries for node in group.children)])
    return _most([shown, library])


def _refuse_no_places(everything: Mapping[str, Sequence[Element]]) -> None:
    """Raise ValueError where a place in a COLLADA is no number of four bytes.

    The library would take 0 for NaN, and pass over triangles that have a corner at infinity: another shape. Of normals
    and colours that is as good.
    """
    inputs = everything.get("input", ())
    places = {one.attributes.get("source", "")[1:] for one in inputs if one.attributes.get("semantic") == "POSITION"}
    for source in everything.get("source", ()):
        if source.attributes.get("id", "") in places:
            for array in _below(source, "float_array"):
                with np.errstate(over="ignore"):
                    if not np.isfinite(np.array(array.text.split(), dtype=np.float32)).all():
                        raise ValueError("a place that is no number")


def _of_geometry(geometry: Element) -> Counts:
    corners = parts = 0
    for primitive in geometry.descendants():
        kind = _tag(primitive)
        if kind in ("triangles", "polylist", "polygons", "tristrips", "trifans", "lines", "linestrips"):
            inputs = [one for one in primitive.children if _tag(one) == "input"]
            each = max(1 + max((int(one.attributes.get("offset", "0")) for one in inputs), default=0), 1)
            words = [len(p.text.split()) for p in _below(primitive, "p")]
            # Polygons may say that they have more corners than they have; one of n corners is n - 2 triangles.
            told = [int(word) for count in _below(primitive, "vcount") for word in count.text.split()]
            if min(told, default=0) < 0:
                raise ValueError("a negative count")
            corners += max(sum(words) // each, sum(told)) * (1 if kind in ("triangles", "lines") else 3)
            parts += 1
    return Counts(corners, parts)


def _called(nodes: Iterable[Element], by: Sequence[str]) -> dict[str, list[Element]]:
    """Return nodes by what they are called."""
    found: dict[str, list[Element]] = {}
    for node in nodes:
        for called in {node.attributes.get(key, "") for key in by}:
            found.setdefault(called, []).append(node)
    return found


def _below(element: Element, tag: str) -> list[Element]:
    return [one for one in element.descendants() if _tag(one) == tag]


def _tag(element: Element) -> str:
    """Return the tag without the prefix of its namespace."""
    return element.tag.rpartition(":")[2]


def _sum(found: list[Counts]) -> Counts:
    return Counts(sum(one.corners for one in found), sum(one.parts for one in found))


def _most(found: list[Counts]) -> Counts:
    return Counts(max(one.corners for one in found), max(one.parts for one in found))


def without_pictures(data: bytes) -> bytes:
    """Return a GLB without its pictures: some kilobytes may unpack to gigabytes, which some materials compute with."""
    begin = _HEADER + 8
    length = struct.unpack_from("<I", data, _HEADER)[0]
    tree = json.loads(data[begin : begin + length])
    if not tree.pop("images", ()):
        return data
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = text + data[begin + length :]
    return data[:8] + struct.pack("<II", begin + len(rest), len(text)) + data[_HEADER + 4 : begin] + rest
