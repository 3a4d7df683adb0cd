"""The calibration in space: one HTML page with the arm, its frames, and what was measured and predicted.

meshcat draws it. Its server is never started (it would listen on every address of the machine): the page holds
meshcat's own viewer script and the commands that its server would have sent, and asks the network for nothing.
"""

import base64
import html
import io
import json
import math
import string
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.foundations.arrays import Array, IntArray
from calib.foundations.errors import RobotError
from calib.foundations.rigid import inverse, translation
from calib.presentation.meshes import (
    Rgb,
    Triangles,
    balls,
    creased,
    joined,
    moved,
    primitive,
    read_mesh,
    simplified,
    sticks,
)
from calib.robot.sources import find_mesh

# Okabe and Ito's vermillion and blue: told apart by every kind of colour vision, and in grey.
BEFORE: Rgb = (0.835, 0.369, 0.0)
AFTER: Rgb = (0.0, 0.447, 0.698)
MEASURED: Rgb = (0.13, 0.13, 0.13)
TOOL: Rgb = (0.8, 0.475, 0.655)
AXES: tuple[Rgb, Rgb, Rgb] = ((0.80, 0.15, 0.15), (0.13, 0.58, 0.23), (0.15, 0.30, 0.80))
_METAL: Rgb = (0.72, 0.74, 0.76)
_JOINT: Rgb = (0.45, 0.48, 0.52)
_GRID: Rgb = (0.80, 0.81, 0.83)

# A page of some megabytes that a phone still turns smoothly.
_MOST_FACES = 100_000
_MOST_POINTS = 1000
# Below a nanometre an error is rounding, and magnifying it would show noise as a finding.
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What a scene shows. All points are in the world (instrument) frame, in m.

    ``urdf`` is a document that the robot room has accepted. ``mesh_roots`` are the folders below which meshes may be
    read. ``joint_positions`` are by joint name, in rad or m, missing ones 0; mimic joints follow their drivers.
    ``T_world_base`` (4, 4) places the root link. ``tool_points`` (3,) are by tool name, at the shown pose. ``measured``
    and the predictions ``before`` and ``after`` calibration are (N, 3), row by row.
    """

    title: str
    urdf: bytes
    mesh_roots: tuple[Path, ...]
    joint_positions: Mapping[str, float]
    T_world_base: Array
    tool_points: Mapping[str, Array]
    tip: str
    measured: Array
    before: Array
    after: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Drawing:
    """One node of the viewer's tree: triangles in the frame of the node, which sits at ``T`` (4, 4).

    ``flat`` is drawn in exactly its colours, as the legend shows them; the rest is lit and shaded.
    """

    path: tuple[str, ...]
    parts: Sequence[Triangles]
    T: Array
    flat: bool = True
    opacity: float = 1.0
    visible: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class _Link:
    """A link at ``T`` (4, 4) in the root link's frame, its shapes, and the origins of the links it carries (K, 3)."""

    name: str
    T: Array
    parts: tuple[Triangles, ...]
    carries: Array
    missing: int


def magnification(errors: Array, extent: float) -> float:
    """Return the round factor (1, 2, 5, 10, ...) that draws the p95 of error vectors (N, 3) at about 5 % of ``extent``.

    Both in m. Never below 1, and 1 where there is no error to show.
    """
    p95 = float(np.percentile(np.linalg.norm(errors, axis=1), 95.0)) if len(errors) else 0.0
    return max(1.0, _round_number(0.05 * extent / p95)) if p95 > _ROUNDING else 1.0


def render_scene(scene: Scene) -> str:
    """Return the scene as one HTML document that needs nothing beside it.

    Raises RobotError when the tip or a joint of ``joint_positions`` is not in the URDF.
    """
    # Drawn in the root link's frame: the base stands on the grid whatever way the instrument's axes point.
    T_base_world = inverse(scene.T_world_base)
    rows = _shown_rows(scene)
    measured, before, after = (_moved(x[rows], T_base_world) for x in (scene.measured, scene.before, scene.after))
    tools = {name: _moved(point, T_base_world) for name, point in scene.tool_points.items()}
    links = _links(scene)
    tip = next(link.T for link in links if link.name == scene.tip)

    points = [link.T[:3, 3] for link in links] + list(tools.values())
    solids = [_moved(part.vertices, link.T) for link in links for part in link.parts]
    box = np.concatenate([np.array(points), measured, before, after, *solids])
    extent = max(float(np.ptp(box, axis=0).max()), 1e-3)
    cell = _round_number(extent / 10.0)
    # A tracker that stands metres away would shrink the robot to a dot; it is there for those who zoom out.
    near = float(np.linalg.norm(T_base_world[:3, 3] - box.mean(axis=0))) < extent
    box = np.concatenate([box, T_base_world[None, :3, 3]]) if near else box
    low, high = box.min(axis=0), box.max(axis=0)

    scales = magnification(scene.before - scene.measured, extent), magnification(scene.after - scene.measured, extent)
    drawings = [
        *_robot(links, extent),
        *_frames(T_base_world, tip, tools, extent),
        *_clouds(measured, before, after, scales, extent),
    ]
    page = {
        "commands": _commands(drawings, _grid(low, high, cell)),
        "outline": _outline(box).tolist(),
        "labels": _labels(scene),
    }
    return _PAGE.substitute(
        title=html.escape(scene.title),
        legend=_legend(scene, links, scales, cell),
        licences=(_asset("LICENSE") + _asset("dist/main.min.js.THIRD_PARTY_LICENSES.json")).replace("</", "< /"),
        viewer=_asset("dist/main.min.js"),
        page=json.dumps(page).replace("<", "\\u003c"),
    )


def _shown_rows(scene: Scene) -> IntArray:
    """Return the rows to draw: all, or as many as allowed, evenly over the ranks of the error, the worst among them."""
    n = len(scene.measured)
    if n <= _MOST_POINTS:
        return np.arange(n)
    ranked = np.argsort(np.linalg.norm(scene.after - scene.measured, axis=1))
    return np.sort(ranked[np.linspace(0, n - 1, _MOST_POINTS).round().astype(np.intp)])


def _links(scene: Scene) -> tuple[_Link, ...]:
    import yourdfpy  # noqa: PLC0415 - import calib must not load it

    model = yourdfpy.URDF.load(io.BytesIO(scene.urdf), load_meshes=False)
    unknown = sorted(set(scene.joint_positions) - set(model.joint_map))
    if unknown:
        raise RobotError(f"joint {unknown[0]!r} of the pose to show is not in the URDF.")
    if scene.tip not in model.link_map:
        raise RobotError(f"tip {scene.tip!r} is not a link of the URDF.")
    model.update_cfg({name: float(scene.joint_positions.get(name, 0.0)) for name in model.actuated_joint_names})
    T = {link.name: np.array(model.get_transform(link.name)) for link in model.robot.links}

    colours = {m.name: _rgb(m.color) for m in model.robot.materials if m.color is not None}
    visuals = {link.name: [_visual(v, colours, scene.mesh_roots) for v in link.visuals] for link in model.robot.links}
    owned = [(name, part) for name, found in visuals.items() for parts in found for part in parts or ()]
    # One budget for the whole arm, so that every link keeps the same fineness.
    fine = [creased(part) for part in simplified([part for _, part in owned], _MOST_FACES)]
    return tuple(
        _Link(
            name,
            T[name],
            joined([part for (owner, _), part in zip(owned, fine, strict=True) if owner == name]),
            np.array([T[joint.child][:3, 3] for joint in model.robot.joints if joint.parent == name]).reshape(-1, 3),
            sum(parts is None for parts in found),
        )
        for name, found in visuals.items()
    )


def _visual(visual: Any, colours: Mapping[str, Rgb], roots: Sequence[Path]) -> tuple[Triangles, ...] | None:
    """Return the triangles of a yourdfpy visual in its link's frame, or None when its mesh cannot be had."""
    shape, material = visual.geometry, visual.material
    T = np.eye(4) if visual.origin is None else visual.origin
    if material is None:
        rgb = _METAL
    else:
        rgb = colours.get(material.name, _METAL) if material.color is None else _rgb(material.color)
    if shape.mesh is None:
        return (moved(primitive(shape, rgb), T),)
    path = find_mesh(shape.mesh.filename, roots)
    parts = None if path is None else read_mesh(path, rgb)
    scale = np.broadcast_to(1.0 if shape.mesh.scale is None else shape.mesh.scale, 3)
    return None if parts is None else tuple(moved(part, T @ np.diag([*scale, 1.0])) for part in parts)


def _robot(links: Sequence[_Link], extent: float) -> Iterator[_Drawing]:
    # A robot without any shape is a stick figure; in one with shapes, only the links whose mesh is missing are.
    shapeless = not any(link.parts for link in links)
    for link in links:
        parts = list(link.parts)
        if shapeless or link.missing:
            ends = _moved(link.carries, inverse(link.T))
            parts.append(sticks(np.zeros_like(ends), ends, 0.012 * extent, _METAL, sides=24))
            parts.append(balls(np.zeros((1, 3)), 0.02 * extent, _JOINT, subdivisions=3))
        yield _Drawing(("robot", link.name), joined(parts), link.T, flat=False)


def _frames(T_base_world: Array, T_base_tip: Array, tools: Mapping[str, Array], extent: float) -> Iterator[_Drawing]:
    arms = 0.09 * extent * np.eye(3)[:, None]
    triad = [sticks(np.zeros((1, 3)), arm, 0.004 * extent, rgb, sides=12) for arm, rgb in zip(arms, AXES, strict=True)]
    yield _Drawing(("frames", "base"), triad, np.eye(4))
    yield _Drawing(("frames", "instrument"), triad, T_base_world)
    yield _Drawing(("frames", "tip"), triad, T_base_tip)
    for name, point in tools.items():
        offset = T_base_tip[None, :3, 3] - point
        tool = [
            sticks(np.zeros((1, 3)), offset, 0.003 * extent, TOOL, sides=12),
            balls(np.zeros((1, 3)), 0.008 * extent, TOOL, subdivisions=3),
        ]
        yield _Drawing(("frames", "tools", name), joined(tool), translation(point))


def _clouds(
    measured: Array, before: Array, after: Array, scales: tuple[float, float], extent: float
) -> Iterator[_Drawing]:
    """Yield the points, and the error vectors of both predictions at one scale, so that they compare at a glance.

    The errors that calibration left are there a second time at their own scale, hidden until the reader asks.
    """
    radius, width = 0.004 * extent, 0.0011 * extent
    yield _Drawing(("measured",), [balls(measured, radius, MEASURED)], np.eye(4))
    layers = [("before", before, BEFORE, scales[0]), ("after", after, AFTER, scales[0])]
    if scales[1] > scales[0]:
        layers.append(("after_magnified", after, AFTER, scales[1]))
    for name, predicted, rgb, scale in layers:
        ends = measured + scale * (predicted - measured)
        parts = [sticks(measured, ends, width, rgb), balls(ends, 1.3 * radius, rgb)]
        yield _Drawing((name,), joined(parts), np.eye(4), opacity=0.75, visible=name != "after_magnified")


def _grid(low: Array, high: Array, cell: float) -> Array:
    """Return the end points (2L, 3) of the grid's lines: whole cells in the base's plane, under everything drawn."""
    a, b = np.floor(low[:2] / cell - 0.5) * cell, np.ceil(high[:2] / cell + 0.5) * cell
    x, y = (np.arange(a[i], b[i] + 0.5 * cell, cell) for i in range(2))
    along_y = [[(v, a[1], 0.0), (v, b[1], 0.0)] for v in x]
    along_x = [[(a[0], v, 0.0), (b[0], v, 0.0)] for v in y]
    return np.array(along_y + along_x).reshape(-1, 3)


def _outline(points: Array) -> Array:
    """Return those of ``points`` (N, 3) that lie furthest out in some direction: what the camera has to take in."""
    u = np.random.default_rng(0).normal(size=(200, 3))
    return np.asarray(points[np.unique(np.argmax(points @ u.T, axis=0))])


def _labels(scene: Scene) -> list[tuple[str, str]]:
    """Return which nodes of the tree carry which text."""
    same = np.allclose(scene.T_world_base, np.eye(4), atol=1e-6)
    base = [("frames/base", "base = instrument")] if same else [("frames/base", "base")]
    instrument = [] if same else [("frames/instrument", "instrument")]
    tools = [(f"frames/tools/{_node(name)}", name) for name in scene.tool_points]
    return [*base, *instrument, ("frames/tip", scene.tip), *tools]


def _commands(drawings: Sequence[_Drawing], grid: Array) -> list[str]:
    """Return meshcat's commands, packed as its server sends them, in base64."""
    with warnings.catch_warnings():
        # meshcat reaches for IPython on import, which warns.
        warnings.simplefilter("ignore")
        import umsgpack  # noqa: PLC0415
        from meshcat import geometry as g  # noqa: PLC0415
        from meshcat.commands import SetObject, SetProperty, SetTransform  # noqa: PLC0415
        from meshcat.path import Path as Node  # noqa: PLC0415

    def placed(path: tuple[str, ...], T: Array) -> Any:
        return SetTransform(T.astype(float), Node(tuple(map(_node, path))))

    def drawn(path: tuple[str, ...], thing: Any) -> Any:
        # meshcat names things by the host's address and the clock; a page should tell neither, and repeat exactly.
        for part, name in ((thing, "object"), (thing.geometry, "geometry"), (thing.material, "material")):
            part.uuid = "/".join((*path, name))
        return SetObject(thing, path=Node(tuple(map(_node, path))))

    lines = g.LineSegments(g.PointsGeometry(grid.T.astype(np.float32)), g.LineBasicMaterial(color=_hex(_GRID)))
    commands: list[Any] = [
        SetProperty("top_color", [1.0, 1.0, 1.0], Node(("Background",))),
        SetProperty("bottom_color", [0.93, 0.94, 0.95], Node(("Background",))),
        SetProperty("visible", False, Node(("Axes",))),
        # meshcat's lights together bleach a white robot on white paper.
        SetProperty("intensity", 0.45, Node(("Lights", "AmbientLight", "<object>"))),
        drawn(("Grid",), lines),
    ]
    for drawing in drawings:
        material = g.MeshBasicMaterial if drawing.flat else g.MeshPhongMaterial
        commands.append(placed(drawing.path, drawing.T))
        for i, part in enumerate(drawing.parts):
            if len(part.faces):
                # Transparent things are drawn last: frames without depth show through the links they sit in.
                frame = drawing.path[0] == "frames"
                fading = frame or drawing.opacity < 1.0
                look = material(color=_hex(part.rgb), opacity=drawing.opacity, transparent=fading, depthTest=not frame)
                mesh = g.Mesh(g.TriangularMeshGeometry(part.vertices, part.faces), look)
                commands.append(drawn((*drawing.path, str(i)), mesh))
        if not drawing.visible:
            commands.append(SetProperty("visible", False, Node(drawing.path)))
    return [base64.b64encode(umsgpack.packb(command.lower())).decode() for command in commands]


def _legend(scene: Scene, links: Sequence[_Link], scales: tuple[float, float], cell: float) -> str:
    """Return the legend's HTML: what each colour is, the errors in mm, and how much they are magnified."""
    n, missing = len(scene.measured), sum(link.missing for link in links)
    rows = [f"<tr><td>{_dot(MEASURED)}<td>measured<td colspan=3>{n} points"] if n else []
    if n:
        rows += [
            f"<tr><td>{_dot(rgb)}<td>{name}<td>{rms:.3f}<td>{worst:.3f}<td{mark}>&times;{scales[0]:g}"
            for name, rgb, mark, (rms, worst) in (
                ("before", BEFORE, "", _rms_max_mm(scene.before - scene.measured)),
                ("after", AFTER, " id=scale", _rms_max_mm(scene.after - scene.measured)),
            )
        ]
    notes = []
    if n > _MOST_POINTS:
        notes.append(f"{_MOST_POINTS} of the {n} points are drawn, the worst among them; the figures are of all.")
    if missing:
        notes.append(f"{missing} mesh{'es' if missing > 1 else ''} not found, drawn as sticks.")
    axes = " ".join(f"<b style='color:{_css(rgb)}'>{axis}</b>" for axis, rgb in zip("xyz", AXES, strict=True))
    notes.append(f"Frames {axes}. Grid {cell:g} m.")
    magnify = (
        f"<label><input type=checkbox id=magnify data-scales='{scales[0]:g} {scales[1]:g}'> "
        f"magnify after to &times;{scales[1]:g}</label>"
        if scales[1] > scales[0]
        else ""
    )
    header = "<tr><th><th>error in mm<th>rms<th>max<th>drawn" if n else ""
    return f"<table>{header}{''.join(rows)}</table>{magnify}" + "".join(f"<p>{note}" for note in notes)


def _rms_max_mm(errors: Array) -> tuple[float, float]:
    length = 1e3 * np.linalg.norm(errors, axis=1)
    return float(np.sqrt(np.mean(length**2))), float(length.max())


def _moved(points: Array, T: Array) -> Array:
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def _round_number(x: float) -> float:
    """Return the number 1, 2 or 5 times a power of ten that is nearest to ``x`` > 0 in proportion."""
    power = math.floor(math.log10(x))
    rounds = [float(f"{m}e{p}") for p in (power, power + 1) for m in (1, 2, 5)]
    return min(rounds, key=lambda r: abs(math.log(r / x)))


def _rgb(color: Any) -> Rgb:
    r, g, b = np.clip(color.rgba[:3], 0.0, 1.0).tolist()
    return r, g, b


def _hex(rgb: Rgb) -> int:
    r, g, b = (round(255 * c) for c in rgb)
    return (r << 16) + (g << 8) + b


def _css(rgb: Rgb) -> str:
    return f"#{_hex(rgb):06x}"


def _dot(rgb: Rgb) -> str:
    return f"<i style='background:{_css(rgb)}'></i>"


def _node(name: str) -> str:
    """Return a name as one step of a path in the viewer's tree."""
    return name.replace("/", "_") or "_"


def _asset(name: str) -> str:
    """Return a text file of meshcat's viewer."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import meshcat  # noqa: PLC0415
    return (Path(meshcat.viewer_assets_path()) / name).read_text(encoding="utf-8")


_PAGE = string.Template("""\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'unsafe-inline'; \
style-src 'unsafe-inline'; img-src data: blob:">
<title>$title</title>
<style>
html, body { margin: 0; height: 100%; overflow: hidden; background: #fff; color: #222; }
#pane { width: 100vw; height: 100vh; overflow: hidden; }
#legend, .label { font: 13px/1.45 system-ui, sans-serif; }
#legend { position: absolute; left: 12px; top: 12px; width: 290px; padding: 12px 14px; border-radius: 8px;
  box-sizing: border-box; background: rgba(255, 255, 255, .92); box-shadow: 0 1px 6px rgba(0, 0, 0, .18); }
#legend h1 { font-size: 16px; line-height: 1.3; margin: 0 0 6px; overflow-wrap: anywhere; }
#legend p { margin: 6px 0 0; color: #555; }
#legend label { display: block; margin-top: 6px; }
#legend table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
#legend th { font-weight: normal; color: #666; text-align: right; }
#legend td { text-align: right; padding: 1px 0 1px 6px; }
#legend tr > :first-child, #legend tr > :nth-child(2) { text-align: left; padding-left: 0; }
#legend tr > :first-child { width: 18px; }
#legend i { display: inline-block; width: 11px; height: 11px; border-radius: 50%; vertical-align: -1px; }
.label { position: absolute; left: 0; top: 0; padding: 0 4px; border-radius: 3px; pointer-events: none;
  background: rgba(255, 255, 255, .75); font-size: 12px; white-space: nowrap; }
@media (max-width: 640px) {
  #legend { left: 8px; right: 8px; top: auto; bottom: 8px; width: auto; padding: 8px 12px; }
  #legend h1 { font-size: 15px; margin-bottom: 2px; }
  #legend p { margin-top: 2px; }
}
</style>
</head>
<body>
<div id="pane"></div>
<div id="legend"><h1>$title</h1>$legend</div>
<script type="text/plain" id="licences">$licences</script>
<script>$viewer</script>
<script type="application/json" id="page">$page</script>
<script>
const page = JSON.parse(document.getElementById("page").textContent);
const legend = document.getElementById("legend"), pane = document.getElementById("pane");
const viewer = new MeshCat.Viewer(pane);
for (const command of page.commands)
  viewer.handle_command_bytearray(Uint8Array.from(atob(command), c => c.charCodeAt(0)));

// three.js has y up, the scene z.
const outline = page.outline.map(([x, y, z]) => new MeshCat.THREE.Vector3(x, z, -y));
const camera = viewer.camera, back = new MeshCat.THREE.Vector3(0.72, 0.42, 0.9).normalize();
let touched = false;
viewer.controls.addEventListener("start", () => { touched = true; });

// Centre the outline in the part of the pane that the legend leaves free, and step back until all of it is inside.
function fit() {
  const w = pane.offsetWidth, h = window.innerHeight, cover = legend.getBoundingClientRect();
  const wide = cover.width < 0.5 * w;
  const free = wide ? [cover.right, 0, w, h] : [0, 24, w, cover.top];
  const [fw, fh] = [free[2] - free[0], free[3] - free[1]];
  camera.fov = 35;
  const t = Math.tan(camera.fov * Math.PI / 360), tx = t * fw / h, ty = t * fh / h;
  const right = new MeshCat.THREE.Vector3(0, 1, 0).cross(back).normalize(), up = back.clone().cross(right);
  const target = new MeshCat.THREE.Vector3();
  for (const axis of [right, up, back]) {
    const along = outline.map(p => p.dot(axis));
    target.addScaledVector(axis, (Math.min(...along) + Math.max(...along)) / 2);
  }
  let distance = 0;
  for (const p of outline) {
    const v = p.clone().sub(target);
    const side = Math.max(Math.abs(v.dot(right)) / tx, Math.abs(v.dot(up)) / ty);
    distance = Math.max(distance, v.dot(back) + side);
  }
  distance *= 1.08;
  camera.near = distance / 500;
  camera.far = distance * 50;
  camera.setViewOffset(w, h, (w - free[0] - free[2]) / 2, (h - free[1] - free[3]) / 2, w, h);
  if (!touched) {
    viewer.controls.target.copy(target);
    camera.position.copy(target).addScaledVector(back, distance);
  }
  viewer.set_dirty();
}

// Names of the frames, kept over their origins; a frame switched off in the tree takes its name along.
const labels = page.labels.map(([path, text]) => {
  const element = document.body.appendChild(document.createElement("div"));
  element.className = "label";
  element.textContent = text;
  return [element, viewer.scene_tree.find(path.split("/")).object];
});
const render = viewer.render.bind(viewer);
viewer.render = () => {
  render();
  for (const [element, object] of labels) {
    const p = new MeshCat.THREE.Vector3().setFromMatrixPosition(object.matrixWorld).project(camera);
    let shown = p.z < 1;
    for (let o = object; o; o = o.parent) shown = shown && o.visible;
    const x = (p.x + 1) / 2 * pane.offsetWidth + 6, y = (1 - p.y) / 2 * window.innerHeight + 4;
    element.style.display = shown ? "" : "none";
    element.style.transform = "translate(" + x + "px, " + y + "px)";
  }
};

const magnify = document.getElementById("magnify");
if (magnify) {
  const scales = magnify.dataset.scales.split(" "), scale = document.getElementById("scale");
  const choose = () => {
    viewer.set_property(["after"], "visible", !magnify.checked);
    viewer.set_property(["after_magnified"], "visible", magnify.checked);
    scale.textContent = "\\u00d7" + scales[+magnify.checked];
    viewer.set_dirty();
  };
  magnify.addEventListener("change", choose);
  choose();
}
window.addEventListener("load", fit);
window.addEventListener("resize", fit);
</script>
</body>
</html>
""")
