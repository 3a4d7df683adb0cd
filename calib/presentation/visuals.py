"""What a URDF says of its looks, shape by shape: a shape that makes no sense is missing, and costs nothing else."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.rigid import placement, rotation_of_rpy
from calib.foundations.units import NUMBER
from calib.presentation.meshes import Rgb
from calib.robot.urdf import Element, Urdf, read_document

# In m, of sizes, places and scales: larger ones are mistakes, and would make all else a dot.
_LARGEST = 1e4
_SIZES = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "length")}


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
    """Return the shapes of every link, None for one that cannot be drawn; ``otherwise``: colour of what has none."""
    robot = read_document(urdf.source, urdf.where, generations=4)
    colours = {m.attributes.get("name", ""): rgb for m in _all(robot, "material") if (rgb := _colour(m)) is not None}
    return {
        link.attributes["name"]: [_shape(visual, colours, otherwise) for visual in _all(link, "visual")]
        for link in _all(robot, "link")
    }


def _shape(visual: Element, colours: Mapping[str, Rgb], otherwise: Rgb) -> Shape | None:
    T = np.eye(4)
    for origin in _all(visual, "origin")[:1]:
        xyz, rpy = (_numbers(origin.attributes.get(name, "0 0 0"), 3) for name in ("xyz", "rpy"))
        if xyz is None or rpy is None:
            return None
        T = placement(rotation_of_rpy(np.array(rpy)), np.array(xyz))
    rgb = otherwise
    for material in _all(visual, "material")[:1]:
        rgb = _colour(material) or colours.get(material.attributes.get("name", ""), otherwise)
    shapes = [shape for geometry in _all(visual, "geometry")[:1] for shape in geometry.children]
    if len(shapes) != 1:
        return None
    kind, a = shapes[0].tag, shapes[0].attributes
    if kind == "mesh":
        scale = _numbers(a.get("scale", "1 1 1"), 3)
        return None if scale is None else Shape(kind, scale, a.get("filename", ""), T, rgb)
    names = _SIZES.get(kind, ())
    sizes = _numbers(" ".join(a.get(name, "") for name in names), 3 if kind == "box" else len(names))
    return None if not sizes or min(sizes) < 0.0 else Shape(kind, sizes, "", T, rgb)


def _all(element: Element, tag: str) -> list[Element]:
    return [child for child in element.children if child.tag == tag]


def _colour(material: Element) -> Rgb | None:
    for colour in _all(material, "color")[:1]:
        rgba = _numbers(colour.attributes.get("rgba", ""), 4)
        if rgba is not None:
            r, g, b = np.clip(rgba[:3], 0.0, 1.0).tolist()
            return r, g, b
    return None


def _numbers(text: str, count: int) -> tuple[float, ...] | None:
    """Return ``count`` plain numbers, None where a text is not these."""
    words = text.split()
    if len(words) != count or not all(map(NUMBER.fullmatch, words)):
        return None
    values = tuple(map(float, words))
    return values if max(map(abs, values), default=0.0) <= _LARGEST else None
