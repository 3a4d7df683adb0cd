"""What a URDF says of its looks, shape by shape: one that makes no sense is missing, and costs nothing else."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.rigid import placement, rotation_of_rpy
from calib.presentation.meshes import Rgb
from calib.robot.urdf import Element, Urdf, read_document

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
    robot = read_document(urdf.source, urdf.where, generations=4)
    found = {link.attributes["name"]: _all(link, "visual") for link in _all(robot, "link")}
    if sum(map(len, found.values())) > MOST_SHAPES:
        return {name: [None] * len(shapes) for name, shapes in found.items()}
    # Only those that are asked for: a file may have very many.
    named = {m.attributes.get("name", "") for shapes in found.values() for v in shapes for m in _all(v, "material")}
    stated = {m.attributes.get("name", ""): m for m in _all(robot, "material") if m.attributes.get("name", "") in named}
    colours = {name: rgb for name, m in stated.items() if (rgb := _colour(m)) is not None}
    return {name: [_shape(visual, colours, otherwise) for visual in shapes] for name, shapes in found.items()}


def _shape(visual: Element, colours: Mapping[str, Rgb], otherwise: Rgb) -> Shape | None:
    parts = {part.tag: part for part in reversed(visual.children)}  # the first of each
    rgb = otherwise
    if "material" in parts:
        rgb = _colour(parts["material"]) or colours.get(parts["material"].attributes.get("name", ""), otherwise)
    try:
        (shape, *_) = parts["geometry"].children
        sizes = _sizes(shape)
        origin = parts["origin"].attributes if "origin" in parts else {}
        xyz, rpy = (np.array(_numbers(origin.get(name, "0 0 0"), 3)) for name in ("xyz", "rpy"))
    except (LookupError, ValueError):
        return None
    if not (np.all(np.abs([*sizes, *xyz]) <= LARGEST) and np.isfinite(rpy).all()):
        return None
    return Shape(shape.tag, sizes, shape.attributes.get("filename", ""), placement(rotation_of_rpy(rpy), xyz), rgb)


def _sizes(shape: Element) -> tuple[float, ...]:
    """Return the sizes of a shape. Raises KeyError or ValueError where one is missing, no number or below zero."""
    a = shape.attributes
    match shape.tag:
        case "mesh":
            scale = _numbers(a.get("scale", "1 1 1"))
            return scale * 3 if len(scale) == 1 else _numbers(a.get("scale", "") or "1 1 1", 3)
        case "box":
            sizes = _numbers(a["size"], 3)
        case "sphere":
            sizes = _numbers(a["radius"], 1)
        case "cylinder":
            sizes = (*_numbers(a["radius"], 1), *_numbers(a["length"], 1))
        case other:
            raise KeyError(other)
    if min(sizes) < 0.0:
        raise ValueError(sizes)
    return sizes


def _colour(material: Element) -> Rgb | None:
    for colour in _all(material, "color")[:1]:
        try:
            rgba = _numbers(colour.attributes.get("rgba", "1 1 1 1"), 4)
        except ValueError:
            return None
        if np.isfinite(rgba).all():
            r, g, b = np.clip(rgba[:3], 0.0, 1.0).tolist()
            return r, g, b
    return None


def _numbers(text: str, count: int | None = None) -> tuple[float, ...]:
    """Return numbers between spaces, or commas, as some write them. Raises ValueError unless there are ``count``."""
    numbers = tuple(map(float, text.replace(",", " ").split()))
    if count not in (None, len(numbers)):
        raise ValueError(text)
    return numbers


def _all(element: Element, tag: str) -> list[Element]:
    return [child for child in element.children if child.tag == tag]
