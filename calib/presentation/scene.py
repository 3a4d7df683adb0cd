"""The calibration in space: one HTML page with the arm, its frames, and what was measured and predicted.

meshcat draws it. Its server is never started (it would listen on every address of the machine): the page holds
meshcat's own viewer script and the commands that its server would have sent, and asks the network for nothing. What
moves, hides and names things is ``pages/scene.js``.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calib.foundations.arrays import Array, IntArray, evenly_ranked
from calib.foundations.errors import RobotError
from calib.foundations.rigid import inverse, translation
from calib.foundations.sealing import sealed
from calib.foundations.units import MM
from calib.foundations.words import counted
from calib.presentation import viewer
from calib.presentation.meshes import balls, creased, primitive, sticks
from calib.presentation.page_files import page_file, template
from calib.presentation.thin_meshes import thin_mesh
from calib.presentation.visuals import LARGEST, MOST_SHAPES, Shape, visuals
from calib.robot.links import Arm, link_placements
from calib.robot.mesh_counts import MOST_CORNERS
from calib.robot.mesh_files import Rgb, Triangles, joined_by_colour, moved
from calib.robot.sources import find_mesh
from calib.robot.urdf import Urdf

MEASURED: Rgb = (0.13, 0.13, 0.13)
NOMINAL: Rgb = (0.0, 0.447, 0.698)
TOOL: Rgb = (0.8, 0.475, 0.655)
MARK: Rgb = (0.0, 0.52, 0.39)
REGION: Rgb = (0.0, 0.62, 0.45)
AXES: tuple[Rgb, Rgb, Rgb] = ((0.80, 0.15, 0.15), (0.13, 0.58, 0.23), (0.15, 0.30, 0.80))
# matplotlib's "plasma" without its yellow end, which white paper swallows: in order for every kind of colour vision.
_SCALE = ("0d0887", "46039f", "7201a8", "9c179e", "bd3786", "d8576b", "ed7953", "fb9f3a")
# The same on dark paper, which swallows the other end.
_SCALE_DARK = ("7d6cf0", "9a5fe6", "b656d6", "cf55bb", "e3659a", "f0807a", "f9a35c", "f6d84f")
SCALE: tuple[Rgb, ...] = tuple((int(h[:2], 16) / 255, int(h[2:4], 16) / 255, int(h[4:], 16) / 255) for h in _SCALE)
_METAL: Rgb = (0.72, 0.74, 0.76)
_JOINT: Rgb = (0.45, 0.48, 0.52)
_GRID: Rgb = (0.80, 0.81, 0.83)

# A page of some megabytes that a phone still turns smoothly, and that a machine without a graphics card draws at once.
_MOST_FACES = 40_000
_MOST_POINTS = 10_000
# Links that are drawn as round sticks; more of them get four sides.
_MOST_ROUND = 100
# Below a nanometre an error is rounding, and magnifying it would show noise as a finding.
_ROUNDING = 1e-9
_PAGE = "scene.html.jinja"
_SCRIPT = "scene.js"


MarkKind = Literal["point", "ball", "socket", "plane", "axis", "camera"]


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Mark:
    """Something beside the arm, at ``T`` (4, 4) in the world.

    A point is drawn as a ball, a ball is seen through, a socket is a cup that is open along z, a plane a plate in x and
    y, an axis a line along z, a camera a pyramid of what it sees, with its tip in the camera. Marks of one ``layer``
    are shown and hidden together, those on links with the robot. ``size`` in m: the radius, or half the side or length,
    of a camera how far the pyramid goes. ``spread``: half the sides in x and y of a plane that is no square, or of the
    end of a camera's pyramid, as shares of ``size``.
    ``link``: of the robot, that carries it and in whose frame T is; None where it stands in the world.
    """

    layer: str
    name: str
    kind: MarkKind
    T: Array
    size: float
    link: str | None = None
    spread: tuple[float, float] = (1.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Scene:
    """What a scene shows. All points are in the world (instrument) frame, in m.

    ``urdf``: the robot; ``mesh_roots``: the folders below which its meshes may be read. ``calibrated``: the arm at
    every row, and ``nominal`` the nominal one, its difference from it taken ``apart`` times, or None where there is
    none to compare; where there are no rows, both at one pose or more. ``tools`` (3,): points in the tip link, and
    ``tools_on`` other links, each with the link. ``notes``: what else is to be said of what is drawn.
    ``measured`` and the predictions ``before`` and ``after`` calibration (N, 3) of the rows, which ``rows`` name.
    ``scales``: how many times the errors before and after calibration are drawn.
    ``judged``: False where the points are the tool's own, and there are no errors to tell. ``joints``: name and unit of
    every joint reading, and ``readings`` (N, nr) of the rows in these units; none where they are not told.
    ``colourings``: by what rows may be coloured, such as their table, and the name (N) that each has. ``regions``: of
    some rows the half axes (3, 3), as columns, of the ellipsoid around the prediction where the calibrated tool is with
    95 %.
    ``times`` (N,) in s: of rows of streams, which are played as they came; NaN where nobody says.
    """

    title: str
    urdf: Urdf
    mesh_roots: tuple[Path, ...]
    calibrated: Arm
    nominal: Arm | None
    apart: float
    tools: Mapping[str, Array]
    tip: str
    rows: tuple[str, ...]
    measured: Array
    before: Array
    after: Array
    scales: tuple[float, float] = (1.0, 1.0)
    marks: tuple[Mark, ...] = ()
    judged: bool = True
    joints: tuple[tuple[str, str], ...] = ()
    readings: Array = field(default_factory=lambda: np.zeros((0, 0)))
    tools_on: Mapping[str, tuple[str, Array]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    colourings: Mapping[str, Sequence[str]] = field(default_factory=dict)
    regions: Mapping[int, Array] = field(default_factory=dict)
    times: Array | None = None


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

    Raises RobotError when the tip is not in the URDF.
    """
    if scene.tip not in scene.urdf.links:
        raise RobotError(f"tip {scene.tip!r} is not a link of the URDF.")
    # Drawn in the root link's frame: the base stands on the grid whatever way the instrument's axes point.
    T_base_world = inverse(scene.calibrated.root)
    rows = evenly_ranked(np.linalg.norm(scene.after - scene.measured, axis=1), _MOST_POINTS)
    measured, before, after = (_moved(x[rows], T_base_world) for x in (scene.measured, scene.before, scene.after))
    at_first = replace(scene.calibrated, positions=scene.calibrated.positions[:1])
    first = {name: T[0] for name, T in link_placements(scene.urdf, at_first).items()}
    links = _links(scene, first)

    points = [link.T[:3, 3] for link in links]
    solids = [_moved(part.vertices, link.T) for link in links for part in link.parts]
    box = np.concatenate([np.array(points), measured, before, after, *solids])
    extent = max(float(np.ptp(box, axis=0).max()), 1e-3)
    cell = _round_number(extent / 10.0)
    # A tracker that stands metres away would shrink the robot to a dot; it is there for those who zoom out.
    near = float(np.linalg.norm(T_base_world[:3, 3] - box.mean(axis=0))) < 0.7 * extent
    box = np.concatenate([box, T_base_world[None, :3, 3]]) if near else box
    # So it is with what stands about: what is near is in the picture.
    marked = np.array([(_placed(mark, T_base_world, first))[:3, 3] for mark in scene.marks]).reshape(-1, 3)
    box = np.concatenate([box, marked[np.linalg.norm(marked - box.mean(axis=0), axis=1) < 1.5 * extent]])
    low, high = box.min(axis=0), box.max(axis=0)

    errors = [np.linalg.norm(x - scene.measured, axis=1) / MM for x in (scene.before, scene.after)]
    edges = _edges(np.concatenate(errors))
    drawings = [
        *_robot(links, extent),
        *_frames(T_base_world, first[scene.tip], scene.tools, extent),
        *_tools_on(scene.tools_on, extent),
        *_marks(scene.marks, T_base_world),
    ]
    page = {
        "commands": _commands(drawings, _grid(low, high, cell)),
        "outline": _outline(box).tolist(),
        "labels": _labels(scene),
        "judged": scene.judged,
        "joints": [
            {"parent": _node(j.parent), "child": _node(j.child), "axis": j.axis.tolist(), "kind": _kind(j.type)}
            for j in scene.urdf.joints
        ],
        "root": _node(scene.urdf.root),
        "tip": _node(scene.tip),
        "nominal": _hex(NOMINAL),
        "apart": scene.apart,
        "arms": {
            name: _arm(arm, T_base_world, rows if len(rows) else np.array([0]))
            for name, arm in (("robot", scene.calibrated), ("nominal", scene.nominal))
            if arm is not None
        },
        "rows": [scene.rows[n] for n in rows],
        "joint_names": scene.joints,
        "readings": scene.readings[rows].round(4).tolist() if scene.joints else [],
        "clouds": _clouds(measured, before, after, [e[rows] for e in errors], edges),
        "lengths": [[round(float(e[n]), 4) for e in errors] for n in rows],
        "colourings": _colourings(scene, rows),
        "regions": _regions(scene, rows, T_base_world[:3, :3]),
        "times": None
        if scene.times is None
        else [None if np.isnan(t) else round(float(t), 4) for t in scene.times[rows]],
        "scales": scene.scales,
        "factors": _factors(scene.scales),
        "radius": 0.004 * extent,
    }
    return template(_PAGE).render(
        title=scene.title,
        legend=_legend(scene, links, errors, edges, cell),
        licences=(viewer.asset("LICENSE") + viewer.asset("dist/main.min.js.THIRD_PARTY_LICENSES.json")).replace(
            "</", "< /"
        ),
        viewer=viewer.asset("dist/main.min.js"),
        script=page_file(_SCRIPT),
        page=json.dumps(page, separators=(",", ":")).replace("<", "\\u003c"),
    )


def _arm(arm: Arm, T_base_world: Array, rows: IntArray) -> dict[str, Any]:
    """Return an arm as the page's script reads it: matrices column by column, positions to a microradian."""
    return {
        "root": (T_base_world @ arm.root).T.ravel().tolist(),
        "origins": np.swapaxes(arm.origins, 1, 2).reshape(-1, 16).tolist(),
        "positions": arm.positions[rows].round(6).tolist(),
    }


def _kind(joint: str) -> str:
    return {"revolute": "turn", "continuous": "turn", "prismatic": "slide"}.get(joint, "fixed")


def _edges(errors: Array) -> Array:
    """Return the limits (n + 1,) in mm between the n colours of errors (N,) in mm, each as many times the last."""
    positive = errors[errors > _ROUNDING / MM]
    if not positive.size:
        return np.linspace(0.0, 1.0, len(SCALE) + 1)
    high = float(positive.max())
    return np.geomspace(min(float(np.percentile(positive, 5.0)), 0.2 * high), high, len(SCALE) + 1)


def _links(scene: Scene, T: Mapping[str, Array]) -> tuple[_Link, ...]:
    shapes = visuals(scene.urdf, _METAL)
    drawn = _drawn(shapes, scene.mesh_roots)
    # Few and large parts: a link's own of one colour.
    own = {name: joined_by_colour([part for parts in found for part in parts or ()]) for name, found in drawn.items()}
    carries: dict[str, list[Array]] = {name: [] for name in drawn}
    for joint in scene.urdf.joints:
        carries[joint.parent].append(T[joint.child][:3, 3])
    return tuple(
        _Link(
            name,
            T[name],
            own[name],
            np.array(carries[name]).reshape(-1, 3),
            sum(parts is None for parts in found),
        )
        for name, found in drawn.items()
    )


def _drawn(
    shapes: Mapping[str, Sequence[Shape | None]], roots: Sequence[Path]
) -> Mapping[str, Sequence[tuple[Triangles, ...] | None]]:
    """Return the triangles of all shapes in their links' frames, None for those that cannot be had, or are too many."""
    every = [shape for found in shapes.values() for shape in found if shape is not None]
    # One share for all, and not for every mesh what it might need: so each is the same in whatever robot it comes.
    share = _MOST_FACES // max(1, len(every))
    spare = MOST_CORNERS
    meshes: dict[tuple[str, Rgb], tuple[Triangles, ...] | None] = {}
    for shape in every:
        if shape.kind == "mesh" and (shape.file, shape.rgb) not in meshes:
            path = find_mesh(shape.file, roots)
            mesh = None if path is None else thin_mesh(path, shape.rgb, share, spare)
            if mesh is not None:
                spare -= max(0, mesh.corners - mesh.size)
            meshes[shape.file, shape.rgb] = None if mesh is None else mesh.parts
    return {
        name: [None if shape is None else _triangles(shape, share, meshes) for shape in found]
        for name, found in shapes.items()
    }


def _triangles(
    shape: Shape, share: int, meshes: Mapping[tuple[str, Rgb], tuple[Triangles, ...] | None]
) -> tuple[Triangles, ...] | None:
    """Return the triangles of a shape in its link's frame, or None when its mesh cannot be had."""
    if shape.kind != "mesh":
        return tuple(moved(part, shape.T) for part in creased([primitive(shape.kind, shape.sizes, shape.rgb, share)]))
    parts = meshes[shape.file, shape.rgb]
    if parts is None:
        return None
    placed = tuple(moved(part, shape.T @ np.diag([*shape.sizes, 1.0])) for part in parts)
    # As of the sizes of shapes: one vertex at a place without sense would make all else a dot.
    return placed if all(np.abs(part.vertices).max(initial=0.0) <= LARGEST for part in placed) else None


def _robot(links: Sequence[_Link], extent: float) -> Iterator[_Drawing]:
    # A robot without any shape is a stick figure; in one with shapes, only the links whose mesh is missing are.
    shapeless = not any(link.parts for link in links)
    few = len(links) <= _MOST_ROUND
    for link in links:
        parts = list(link.parts)
        if shapeless or link.missing:
            ends = _moved(link.carries, inverse(link.T))
            parts.append(sticks(np.zeros_like(ends), ends, 0.012 * extent, _METAL, sides=24 if few else 4))
            parts.append(balls(np.zeros((1, 3)), 0.02 * extent, _JOINT, subdivisions=3 if few else 0))
        yield _Drawing(("robot", _node(link.name)), joined_by_colour(parts), link.T, flat=False)


def _frames(T_base_world: Array, T_base_tip: Array, tools: Mapping[str, Array], extent: float) -> Iterator[_Drawing]:
    arms = 0.09 * extent * np.eye(3)[:, None]
    triad = [sticks(np.zeros((1, 3)), arm, 0.004 * extent, rgb, sides=12) for arm, rgb in zip(arms, AXES, strict=True)]
    yield _Drawing(("frames", "base"), triad, np.eye(4))
    yield _Drawing(("frames", "instrument"), triad, T_base_world)
    yield _Drawing(("frames", "tip"), triad, T_base_tip)
    for name, point in tools.items():
        yield _Drawing(("frames", "tip", "tools", _node(name)), _tool(point, extent), translation(point))


def _tools_on(tools: Mapping[str, tuple[str, Array]], extent: float) -> Iterator[_Drawing]:
    # What a link carries is below it in the tree, and goes where it goes.
    for name, (link, point) in tools.items():
        yield _Drawing(("robot", _node(link), "tools", _node(name)), _tool(point, extent), translation(point))


def _tool(point: Array, extent: float) -> Sequence[Triangles]:
    """Return a stick from the link's origin to a point (3,), and a ball there, in a frame at the point."""
    stick = sticks(np.zeros((1, 3)), -point[None], 0.003 * extent, TOOL, sides=12)
    return joined_by_colour([stick, balls(np.zeros((1, 3)), 0.008 * extent, TOOL, subdivisions=3)])


def _clouds(measured: Array, before: Array, after: Array, errors: Sequence[Array], edges: Array) -> dict[str, Any]:
    """Return the points and the error vectors of both predictions, in m to a nanometre, and the colour of each."""

    def kinds(error: Array) -> list[int]:
        return [int(k) for k in np.clip(np.searchsorted(edges, error, side="right") - 1, 0, len(SCALE) - 1)]

    return {
        "measured": measured.round(6).tolist(),
        "before": {"errors": (before - measured).round(9).tolist(), "kinds": kinds(errors[0])},
        "after": {"errors": (after - measured).round(9).tolist(), "kinds": kinds(errors[1])},
        "light": {"scale": [_hex(rgb) for rgb in SCALE], "measured": _hex(MEASURED), "grid": _hex(_GRID)},
        "dark": {"scale": [int(h, 16) for h in _SCALE_DARK], "measured": 0xE6EAED, "grid": 0x3A444D},
    }


def _colourings(scene: Scene, rows: IntArray) -> dict[str, dict[str, Any]]:
    """Return the names of every kind of group, and which of them the rows drawn have; none of a kind of one name."""
    found = {}
    for kind, names in scene.colourings.items():
        every = list(dict.fromkeys(names))
        if len(every) > 1:
            numbers = {name: k for k, name in enumerate(every)}
            found[kind] = {"names": every, "kinds": [numbers[names[n]] for n in rows]}
    return found


def _regions(scene: Scene, rows: IntArray, R_base_world: Array) -> list[tuple[int, list[float]]]:
    """Return the half axes, one after the other, of the regions of rows that are drawn, by their places among them."""
    place = {int(n): k for k, n in enumerate(rows)}
    return [
        (place[n], (R_base_world @ axes).T.ravel().round(9).tolist()) for n, axes in scene.regions.items() if n in place
    ]


def _marks(marks: Sequence[Mark], T_base_world: Array) -> Iterator[_Drawing]:
    for mark in marks:
        opacity = 0.35 if mark.kind in ("plane", "ball", "camera") else 1.0
        T = mark.T if mark.link is not None else T_base_world @ mark.T
        yield _Drawing(_path(mark), [_shape(mark)], T, opacity=opacity)


def _path(mark: Mark) -> tuple[str, ...]:
    own = (_node(mark.layer), _node(mark.name))
    return ("marks", *own) if mark.link is None else ("robot", _node(mark.link), *own)


def _placed(mark: Mark, T_base_world: Array, links: Mapping[str, Array]) -> Array:
    """Return where a mark is (4, 4) in the root link's frame; ``links``: the placements there."""
    return np.asarray((T_base_world if mark.link is None else links[mark.link]) @ mark.T)


def _shape(mark: Mark) -> Triangles:
    if mark.kind == "point":
        return balls(np.zeros((1, 3)), mark.size, MARK, subdivisions=2)
    if mark.kind == "ball":
        return balls(np.zeros((1, 3)), mark.size, MARK, subdivisions=3)
    if mark.kind == "socket":
        whole = balls(np.zeros((1, 3)), mark.size, MARK, subdivisions=3)
        lower = whole.faces[whole.vertices[whole.faces][:, :, 2].mean(axis=1) < 0.0]
        # Both sides: it is looked into.
        return Triangles(whole.vertices, np.concatenate([lower, lower[:, ::-1]]), MARK)
    if mark.kind == "axis":
        end = np.array([[0.0, 0.0, mark.size]])
        return sticks(-end, end, 0.02 * mark.size, MARK, sides=12)
    corners = mark.size * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    corners[:, :2] *= mark.spread
    if mark.kind == "camera":
        tip = np.vstack([corners + np.array([0.0, 0.0, mark.size]), np.zeros(3)])
        sides = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
        return Triangles(tip, np.concatenate([sides, sides[:, ::-1]]), MARK)
    # Both sides: a plate is seen from below as well.
    return Triangles(corners, np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]]), MARK)


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
    # One direction at a time: all at once take a hundred times the memory, and longer.
    return np.asarray(points[np.unique([np.argmax(points @ direction) for direction in u])])


def _labels(scene: Scene) -> list[tuple[str, str]]:
    """Return which nodes of the tree carry which text."""
    same = np.allclose(scene.calibrated.root, np.eye(4), atol=1e-6)
    base = [("frames/base", "base = instrument")] if same else [("frames/base", "base")]
    instrument = [] if same else [("frames/instrument", "instrument")]
    tools = [(f"frames/tip/tools/{_node(name)}", name) for name in scene.tools]
    tools += [(f"robot/{_node(link)}/tools/{_node(name)}", name) for name, (link, _) in scene.tools_on.items()]
    # A camera on the tip is a tool: its name stands there already.
    named = scene.tools.keys() | scene.tools_on.keys()
    marks = [("/".join(_path(mark)), mark.name) for mark in scene.marks if mark.link is None or mark.name not in named]
    return [*base, *instrument, ("frames/tip", scene.tip), *tools, *marks]


def _commands(drawings: Sequence[_Drawing], grid: Array) -> list[str]:
    """Return meshcat's commands, packed as its server sends them, in base64."""
    commands: list[viewer.Command] = [
        # The page paints what lies behind: cheaper than a texture over the whole window in every picture.
        viewer.set_property(("Background",), "visible", False),
        viewer.set_property(("Axes",), "visible", False),
        # meshcat's lights together bleach a white robot on white paper.
        viewer.set_property(("Lights", "AmbientLight", "<object>"), "intensity", 0.45),
        viewer.set_lines(("Grid",), grid, viewer.Look("LineBasicMaterial", _hex(_GRID))),
    ]
    for drawing in drawings:
        commands.append(viewer.set_transform(drawing.path, drawing.T))
        # Transparent things are drawn last: frames without depth show through the links they sit in.
        frame = drawing.path[0] == "frames"
        fading = frame or drawing.opacity < 1.0
        for i, part in enumerate(drawing.parts):
            if len(part.faces):
                material: Literal["MeshBasicMaterial", "MeshLambertMaterial"] = (
                    "MeshBasicMaterial" if drawing.flat else "MeshLambertMaterial"
                )
                look = viewer.Look(material, _hex(part.rgb), drawing.opacity, fading, not frame)
                commands.append(viewer.set_triangles((*drawing.path, str(i)), part.vertices, part.faces, look))
    return viewer.packed(commands)


def _legend(scene: Scene, links: Sequence[_Link], errors: Sequence[Array], edges: Array, cell: float) -> dict[str, Any]:
    """Return the texts of the legend: the errors in mm, how much they are magnified, and what the colours are."""
    n, missing = len(scene.measured), sum(link.missing for link in links)
    notes = list(scene.notes)
    if n > _MOST_POINTS:
        notes.append(f"{_MOST_POINTS} of the {n} points are drawn, the worst among them; the figures are of all.")
    if missing:
        shapes = counted(missing, "shape")
        notes.append(
            f"{missing} shapes are more than the {MOST_SHAPES} that are drawn; there are sticks in their place."
            if missing > MOST_SHAPES
            else f"{shapes} not found, damaged, too large or of a format that is not read, drawn as sticks."
        )
    figures = [
        {"name": name, "rms": f"{np.sqrt(np.mean(e**2)):.3f}", "max": f"{e.max():.3f}"}
        for name, e in zip(("before", "after"), errors, strict=True)
        if n and scene.judged
    ]
    return {
        "n": n,
        "judged": scene.judged,
        "figures": figures,
        "scales": [f"{scale:g}" for scale in scene.scales],
        "factors": len(_factors(scene.scales)),
        "drawn": _factors(scene.scales).index(scene.scales[0]),
        "apart": None if scene.nominal is None else f"{scene.apart:g}",
        "colours": [_css(rgb) for rgb in SCALE],
        "colourings": list(_colourings(scene, np.arange(n))),
        "regions": bool(scene.regions),
        "views": ["all", "front", "side", "top", "along the tool"]
        + ([] if np.allclose(scene.calibrated.root, np.eye(4), atol=1e-6) else ["from the instrument"]),
        "limits": [_two_digits(edges[k]) for k in (0, len(SCALE) // 2, len(SCALE))],
        "axes": [(axis, _css(rgb)) for axis, rgb in zip("xyz", AXES, strict=True)],
        "dots": {"nominal": _css(NOMINAL), "marks": _css(MARK), "regions": _css(REGION)},
        "marks": [
            (_node(layer), layer) for layer in dict.fromkeys(mark.layer for mark in scene.marks if mark.link is None)
        ],
        "cell": f"{cell:g}",
        "notes": notes,
    }


def _moved(points: Array, T: Array) -> Array:
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def _round_number(x: float) -> float:
    """Return the number 1, 2 or 5 times a power of ten that is nearest to ``x`` > 0 in proportion."""
    power = math.floor(math.log10(x))
    rounds = [float(f"{m}e{p}") for p in (power, power + 1) for m in (1, 2, 5)]
    return min(rounds, key=lambda r: abs(math.log(r / x)))


def _factors(scales: tuple[float, float]) -> list[float]:
    """Return by which round factors the errors may be drawn: from as they are to twice the larger scale."""
    highest = 2.0 * max(scales)
    rounds = [m * 10.0**p for p in range(math.ceil(math.log10(highest)) + 1) for m in (1, 2, 5)]
    return sorted({scales[0], *(r for r in rounds if r <= highest)})


def _two_digits(x: float) -> str:
    return np.format_float_positional(x, 2, unique=False, fractional=False, trim="-")


def _hex(rgb: Rgb) -> int:
    r, g, b = (round(255 * c) for c in rgb)
    return (r << 16) + (g << 8) + b


def _css(rgb: Rgb) -> str:
    return f"#{_hex(rgb):06x}"


def _node(name: str) -> str:
    """Return a name as one step of a path in the viewer's tree."""
    return name.replace("/", "_") or "_"
