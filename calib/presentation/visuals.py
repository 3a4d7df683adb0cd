"""What a URDF says of its looks, shape by shape: one that makes no sense is missing, and costs nothing else.

yourdfpy reads them. It gives up a whole robot for one bad number, so it is given every shape by itself, of a document
that was read strictly before. It takes long to load, so what it has read is kept by the document's hash.
"""

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache as once
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from calib.foundations import cache
from calib.foundations.arrays import Array
from calib.foundations.files import sha256
from calib.foundations.json_text import NotJsonError, parse_json
from calib.foundations.xml_text import Element
from calib.robot.mesh_files import Rgb
from calib.robot.urdf import Urdf, read_document

# In m, of sizes, places and scales: larger ones are mistakes, and would make all else a dot.
LARGEST = 1e4
# Ten times those of the robots we know; each is read by itself.
MOST_SHAPES = 1000


class Shape(NamedTuple):
    """One ``<visual>``: ``T`` (4, 4) in its link, and a mesh's file, or the sizes (m) of a ``kind`` of simple shape.

    ``sizes``: of a box three edges, of a sphere its radius, of a cylinder radius and length, of a mesh its scale (3).
    """

    kind: str
    sizes: tuple[float, ...]
    file: str
    T: Array
    rgb: Rgb


def visuals(urdf: Urdf, otherwise: Rgb) -> Mapping[str, Sequence[Shape | None]]:
    """Return the shapes of every link, None for one that cannot be drawn; ``otherwise``: colour of what has none.

    Where a robot has more than 1000, none is drawn.
    """
    key = sha256(f"{sha256(urdf.source)} {otherwise} {_maker()}".encode())
    kept = cache.kept(key)
    known = None if kept is None else _unpacked(kept)
    if known is None:
        known = _visuals(urdf, otherwise)
        cache.keep(key, _packed(known))
    return known


@once
def _maker() -> str:
    """Return what tells whether looks are read as they were: our own code, and the library."""
    return f"{sha256(Path(__file__).read_bytes())} {version('yourdfpy')}"


def _packed(known: Mapping[str, Sequence[Shape | None]]) -> bytes:
    plain = {
        name: [None if s is None else [s.kind, list(s.sizes), s.file, s.T.tolist(), list(s.rgb)] for s in shapes]
        for name, shapes in known.items()
    }
    return json.dumps(plain).encode()


def _unpacked(data: bytes) -> Mapping[str, Sequence[Shape | None]] | None:
    """Return what was kept, None where it makes no sense."""
    try:
        return {name: [_kept(shape) for shape in shapes] for name, shapes in parse_json(data).items()}
    except (NotJsonError, AttributeError, TypeError, ValueError):
        return None


def _kept(plain: Any) -> Shape | None:
    if plain is None:
        return None
    kind, sizes, file, T, (red, green, blue) = plain
    placed = np.array(T, dtype=np.float64)
    if placed.shape != (4, 4) or not np.isfinite(placed).all():
        raise ValueError(placed)
    return Shape(str(kind), tuple(map(float, sizes)), str(file), placed, (float(red), float(green), float(blue)))


def _visuals(urdf: Urdf, otherwise: Rgb) -> Mapping[str, Sequence[Shape | None]]:
    robot = read_document(urdf.source, urdf.where, generations=4)
    found = {link.attributes["name"]: link.all("visual") for link in robot.all("link")}
    if sum(map(len, found.values())) > MOST_SHAPES:
        return {name: [None] * len(shapes) for name, shapes in found.items()}
    # Only those that are asked for: a file may have very many.
    named = {m.attributes.get("name", "") for shapes in found.values() for v in shapes for m in v.all("material")}
    stated = {m.attributes.get("name", ""): m for m in robot.all("material") if m.attributes.get("name", "") in named}
    colours = {name: rgb for name, m in stated.items() if (rgb := _colour(m)) is not None}
    return {name: [_shape(visual, colours, otherwise) for visual in shapes] for name, shapes in found.items()}


def _shape(visual: Element, colours: Mapping[str, Rgb], otherwise: Rgb) -> Shape | None:
    # Its colour by itself: a bad one is not to hide the shape.
    link = ElementTree.Element("link", name="link")
    _copied(replace(visual, children=tuple(c for c in visual.children if c.tag != "material")), link)
    robot = _read(link)
    if robot is None:
        return None
    rgb = otherwise
    for material in visual.all("material")[:1]:
        rgb = _colour(material) or colours.get(material.attributes.get("name", ""), otherwise)
    (found,) = robot.links[0].visuals
    T = np.eye(4) if found.origin is None else np.asarray(found.origin, dtype=np.float64)
    shape, file = found.geometry, ""
    sizes: Sequence[float]
    if shape.mesh is not None:
        scale = [1.0] if shape.mesh.scale is None else np.ravel(shape.mesh.scale).tolist()
        kind, sizes, file = "mesh", 3 * scale if len(scale) == 1 else scale, shape.mesh.filename or ""
    elif shape.box is not None:
        kind, sizes = "box", shape.box.size.tolist()
    elif shape.sphere is not None:
        kind, sizes = "sphere", [shape.sphere.radius]
    else:
        kind, sizes = "cylinder", [shape.cylinder.radius, shape.cylinder.length]
    wrong = (kind in ("box", "mesh") and len(sizes) != 3) or (kind != "mesh" and min(sizes) < 0.0)
    if wrong or not np.all(np.abs([*sizes, *T.ravel()]) <= LARGEST):
        return None
    return Shape(kind, tuple(sizes), file, T, rgb)


def _colour(material: Element) -> Rgb | None:
    around = ElementTree.Element("robot")
    _copied(material, around)
    robot = _read(*around)
    rgba = None if robot is None or robot.materials[0].color is None else robot.materials[0].color.rgba
    if rgba is None or len(rgba) != 4 or not np.all(np.isfinite(rgba)):
        return None
    r, g, b = np.clip(rgba[:3], 0.0, 1.0).tolist()
    return r, g, b


def _read(element: ElementTree.Element) -> Any:
    """Return yourdfpy's robot of one link or material, None if it makes no sense."""
    import yourdfpy  # noqa: PLC0415 - import calib must not load it

    document = ElementTree.Element("robot", name="robot")
    document.append(element)
    source = io.BytesIO(ElementTree.tostring(document))
    try:
        with np.errstate(all="ignore"):  # what is not finite is found in the result
            return yourdfpy.URDF.load(source, load_meshes=False, build_scene_graph=False).robot
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        return None


def _copied(element: Element, into: ElementTree.Element) -> None:
    copy = ElementTree.SubElement(into, element.tag, dict(element.attributes))
    for child in element.children:
        _copied(child, copy)
