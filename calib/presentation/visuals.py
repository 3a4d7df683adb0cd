"""What a URDF says of its looks, shape by shape: one that makes no sense is missing, and costs nothing else."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import RobotError
from calib.foundations.xml_text import Element
from calib.presentation.meshes import Rgb
from calib.robot.urdf import Urdf, numbers_of, origin_of, read_document

# In m, of sizes, places and scales: larger ones are mistakes, and would make all else a dot.
LARGEST = 1e4
# Ten times those of the robots we know.
MOST_SHAPES = 1000
# The attributes that state the sizes of simple shapes, with how many numbers each has.
_SIZES = {"box": {"size": 3}, "sphere": {"radius": 1}, "cylinder": {"radius": 1, "length": 1}}


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
    robot = read_document(urdf.source, urdf.where, generations=4)
    found = {link.attributes["name"]: link.all("visual") for link in robot.all("link")}
    if sum(map(len, found.values())) > MOST_SHAPES:
        return {name: [None] * len(shapes) for name, shapes in found.items()}
    stated = {material.attributes.get("name", ""): material for material in robot.all("material")}
    return {name: [_shape(visual, stated, otherwise) for visual in shapes] for name, shapes in found.items()}


def _shape(visual: Element, materials: Mapping[str, Element], otherwise: Rgb) -> Shape | None:
    try:
        T = origin_of(visual.all("origin")[0], "") if visual.all("origin") else np.eye(4)
        shape = visual.all("geometry")[0].children[0]
        kind, file = shape.tag, ""
        if kind == "mesh":
            file = shape.attributes.get("filename", "")
            scale = shape.attributes.get("scale", "1").split()
            sizes = numbers_of(shape, "scale", "", count=len(scale)) if "scale" in shape.attributes else (1.0,)
            sizes = 3 * sizes if len(sizes) == 1 else sizes
        else:
            sizes = tuple(v for name, count in _SIZES[kind].items() for v in numbers_of(shape, name, "", count=count))
    except (RobotError, LookupError):
        return None
    wrong = (kind == "mesh" and len(sizes) != 3) or (kind != "mesh" and min(sizes) < 0.0)
    if wrong or not np.all(np.abs([*sizes, *T.ravel()]) <= LARGEST):
        return None
    rgb = None
    for material in visual.all("material")[:1]:
        rgb = _colour(material) or _colour(materials.get(material.attributes.get("name", ""), material))
    return Shape(kind, sizes, file, T, rgb or otherwise)


def _colour(material: Element) -> Rgb | None:
    try:
        r, g, b, _ = numbers_of(material.all("color")[0], "rgba", "", count=4)
    except (RobotError, LookupError):
        return None
    return min(max(r, 0.0), 1.0), min(max(g, 0.0), 1.0), min(max(b, 0.0), 1.0)
