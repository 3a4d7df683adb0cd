"""The commands of the scene, against those that meshcat itself makes of the same things."""

import base64
from pathlib import Path
from typing import Any

import numpy as np
import umsgpack

from calib.presentation import viewer

V = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.5]])
F = np.array([[0, 1, 2], [2, 1, 0]])


def told(command: viewer.Command) -> Any:
    (text,) = viewer.packed([command])
    return umsgpack.unpackb(base64.b64decode(text))


def of_meshcat(thing: Any, path: tuple[str, ...]) -> Any:
    from meshcat.commands import SetObject
    from meshcat.path import Path as Node

    for part, name in ((thing, "object"), (thing.geometry, "geometry"), (thing.material, "material")):
        part.uuid = "/".join((*path, name))
    return umsgpack.unpackb(umsgpack.packb(SetObject(thing, path=Node(path)).lower()))


def test_things_are_those_of_meshcat() -> None:
    from meshcat import geometry as g

    path = ("robot", "link", "0")
    for name, material in (("MeshBasicMaterial", g.MeshBasicMaterial), ("MeshLambertMaterial", g.MeshLambertMaterial)):
        look = viewer.Look(name, 0x123456, 0.35, True, False)  # type: ignore[arg-type]
        same = material(color=0x123456, opacity=0.35, transparent=True, depthTest=False)
        assert told(viewer.set_triangles(path, V, F, look)) == of_meshcat(
            g.Mesh(g.TriangularMeshGeometry(V, F), same), path
        )
    lines = g.LineSegments(g.PointsGeometry(V[:2].T.astype(np.float32)), g.LineBasicMaterial(color=5))
    assert told(viewer.set_lines(("Grid",), V[:2], viewer.Look("LineBasicMaterial", 5))) == of_meshcat(lines, ("Grid",))


def test_places_and_properties_are_those_of_meshcat() -> None:
    from meshcat.commands import SetProperty, SetTransform
    from meshcat.path import Path as Node

    T = np.arange(16.0).reshape(4, 4)
    path = ("Lights", "<object>")
    assert told(viewer.set_transform(path, T)) == SetTransform(T, Node(path)).lower()
    assert told(viewer.set_property(path, "intensity", 0.45)) == SetProperty("intensity", 0.45, Node(path)).lower()


def test_files_are_those_of_meshcat() -> None:
    import meshcat

    page = Path(meshcat.viewer_assets_path()) / "dist" / "main.min.js"
    assert viewer.asset("dist/main.min.js") == page.read_text(encoding="utf-8")
