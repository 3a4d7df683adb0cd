"""Self-collision: the collision shapes of a URDF, moved by its joints and judged by coal.

Bodies are groups of links that no joint of the arm moves apart. Bodies that a joint connects are not judged, as they
touch there. What cannot be judged - a missing mesh, a shape that is not one, two bodies that touch in whatever pose -
is left out, and said.
"""

import itertools
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.parsers import expat

import coal
import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, BoolArray
from calib.foundations.errors import RobotError
from calib.foundations.files import read_bytes
from calib.robot.robot import Robot
from calib.robot.sampling import random_readings
from calib.robot.sources import find_mesh

_LARGEST_MESH = 200_000_000
_FORMATS = {".dae", ".stl", ".obj", ".ply"}
# Poses that are tried to find bodies that always touch; by chance alone none would in all of them.
_SAMPLES = 200


@dataclass(frozen=True, slots=True)
class _Element:
    """A ``<collision>``: its link, and the attributes of its origin and of its shape."""

    link: str
    origin: dict[str, str]
    shape: str
    attributes: dict[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """A shape at ``placement`` (4, 4) in ``link``, within a ball of ``radius`` about ``centre`` (3,) in that link."""

    link: str
    placement: Array
    geometry: object
    centre: Array
    radius: float


@dataclass(frozen=True, slots=True, eq=False)
class SelfCollision:
    """The collision shapes of a robot. Made by :func:`self_collision`.

    ``bodies``: number of the body of every link; ``pairs`` of bodies that are judged; ``notes``: sentences on what is
    not judged.
    """

    robot: Robot
    shapes: tuple[_Shape, ...]
    bodies: Mapping[str, int]
    pairs: tuple[tuple[int, int], ...]
    notes: tuple[str, ...]

    def colliding(self, readings: Array) -> BoolArray:
        """Return at which of the readings (N, nr) in rad and m the robot, as its URDF has it, touches itself."""
        placed = _link_placements(self.robot, readings)
        found = np.zeros(len(readings), dtype=bool)
        for pair in self.pairs:
            rows = np.flatnonzero(~found)
            found[rows] = self._touch(pair, {name: T[rows] for name, T in placed.items()}, len(rows))
        return found

    def without_lasting(self, readings: Array) -> "SelfCollision":
        """Return the same without pairs of bodies that touch at all of the readings (N, nr), said in the notes."""
        placed = _link_placements(self.robot, readings)
        lasting = [pair for pair in self.pairs if bool(np.all(self._touch(pair, placed, len(readings))))]
        named = {self.bodies[shape.link]: shape.link for shape in reversed(self.shapes)}
        said = (f"{named[a]} and {named[b]} touch in every sampled pose, and are not judged." for a, b in lasting)
        kept = tuple(pair for pair in self.pairs if pair not in lasting)
        return replace(self, pairs=kept, notes=(*self.notes, *said))

    def _touch(self, pair: tuple[int, int], placed: Mapping[str, Array], n: int) -> BoolArray:
        """Return in which of n poses two bodies touch; balls about the shapes rule most of them out."""
        found = np.zeros(n, dtype=bool)
        a_shapes, b_shapes = ([s for s in self.shapes if self.bodies[s.link] == body] for body in pair)
        request = coal.CollisionRequest()
        for a, b in itertools.product(a_shapes, b_shapes):
            Ta, Tb = placed[a.link], placed[b.link]
            apart = np.linalg.norm(_moved(Ta, a.centre) - _moved(Tb, b.centre), axis=1) - a.radius - b.radius
            for k in np.flatnonzero((apart < 0.0) & ~found):
                result = coal.CollisionResult()
                where = (_transform(Ta[k] @ a.placement), _transform(Tb[k] @ b.placement))
                found[k] = coal.collide(a.geometry, where[0], b.geometry, where[1], request, result) > 0
        return found


def self_collision(
    robot: Robot, mesh_roots: Sequence[Path] = (), readings: Array | None = None
) -> SelfCollision | None:
    """Return the collision shapes of a robot, or None when its URDF has none that can be read.

    ``mesh_roots``: folders that may be read for meshes. ``readings`` (N, nr): poses over which bodies that always touch
    are found and left out; random ones within the limits when None.
    """
    shapes, notes = [], []
    for element in _elements(robot.urdf.source):
        try:
            shapes.append(_shape(element, mesh_roots))
        except RobotError as e:
            notes.append(str(e))
    if not shapes:
        return None
    if readings is None:
        readings = random_readings(robot, _SAMPLES)
    bodies, carried_by = _bodies(robot)
    judged = itertools.combinations(sorted({bodies[shape.link] for shape in shapes}), 2)
    pairs = tuple((a, b) for a, b in judged if a != carried_by[b] and b != carried_by[a])
    return SelfCollision(robot, tuple(shapes), bodies, pairs, tuple(notes)).without_lasting(readings)


def _elements(source: bytes) -> list[_Element]:
    """Return the ``<collision>`` elements of a URDF that was read before, so that it is known to be harmless XML."""
    found: list[_Element] = []
    stack: list[str] = []
    link, origin = "", dict[str, str]()

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal link, origin
        stack.append(tag)
        match stack:
            case ["robot", "link"]:
                link = attributes.get("name", "")
            case ["robot", "link", "collision"]:
                origin = {}
            case ["robot", "link", "collision", "origin"]:
                origin = attributes
            case ["robot", "link", "collision", "geometry", shape]:
                found.append(_Element(link, {}, shape, attributes))

    def end(_: str) -> None:
        if stack == ["robot", "link", "collision"] and found and found[-1].link == link:
            # The origin may stand behind the geometry.
            found[-1] = _Element(link, origin, found[-1].shape, found[-1].attributes)
        stack.pop()

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(source, True)
    return found


def _shape(element: _Element, roots: Sequence[Path]) -> _Shape:
    at = f"The collision shape of link {element.link!r}"
    xyz, rpy = (_numbers(element.origin.get(name, "0 0 0"), 3, at) for name in ("xyz", "rpy"))
    placement = rigid.placement(rigid.rotation_of_rpy(rpy), xyz)
    a = element.attributes
    match element.shape:
        case "box":
            geometry = coal.Box(*_numbers(a.get("size", ""), 3, at))
        case "sphere":
            geometry = coal.Sphere(*_numbers(a.get("radius", ""), 1, at))
        case "cylinder":
            geometry = coal.Cylinder(*_numbers(a.get("radius", ""), 1, at), *_numbers(a.get("length", ""), 1, at))
        case "capsule":
            geometry = coal.Capsule(*_numbers(a.get("radius", ""), 1, at), *_numbers(a.get("length", ""), 1, at))
        case "mesh":
            geometry = _mesh(a, roots, at)
        case other:
            raise RobotError(f"{at} is a {other[:40]!r}, which is not known, and is not judged.")
    geometry.computeLocalAABB()
    centre = np.asarray(geometry.aabb_center, dtype=np.float64)
    return _Shape(
        element.link, placement, geometry, placement[:3, :3] @ centre + placement[:3, 3], float(geometry.aabb_radius)
    )


def _mesh(attributes: dict[str, str], roots: Sequence[Path], at: str) -> object:
    name = attributes.get("filename", "")
    path = find_mesh(name, roots)
    if path is None or path.suffix.lower() not in _FORMATS:
        raise RobotError(f"{at} is the mesh {name[-80:]!r}, which is not found or not read, and is not judged.")
    scale = _numbers(attributes.get("scale", "1 1 1"), 3, at)
    try:
        data = read_bytes(path, RobotError, _LARGEST_MESH)
        # The reader opens files by name, and of an OBJ the materials that it names: it gets a copy that stands alone.
        with tempfile.TemporaryDirectory() as folder:
            alone = Path(folder) / f"mesh{path.suffix.lower()}"
            alone.write_bytes(_without_materials(data) if alone.suffix == ".obj" else data)
            return coal.MeshLoader().load(str(alone), scale)
    except (RobotError, RuntimeError, ValueError, OSError) as e:
        raise RobotError(f"{at} is the mesh {name[-80:]!r}, which cannot be read, and is not judged.") from e


def _without_materials(data: bytes) -> bytes:
    """Return an OBJ without lines that start with an m (``mtllib``, ``mg``), also where a line goes on in the next."""
    lines = re.sub(rb"\r\n?", b"\n", data)
    return re.sub(rb"(?m)^[ \t\v\f]*[mM].*$", b"", lines.replace(b"\\\n", b" "))


def _numbers(text: str, count: int, at: str) -> Array:
    try:
        values = np.array(text.split(), dtype=np.float64)
    except ValueError:
        values = np.zeros(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise RobotError(f"{at} has {text[:60]!r} where {count} numbers are needed, and is not judged.")
    return values


def _bodies(robot: Robot) -> tuple[dict[str, int], dict[int, int]]:
    """Return the body of every link, and for every body the one that carries it, -1 for the first."""
    moving = {robot.chain[i].name for i in robot.moving}
    body, carried_by = {robot.urdf.root: 0}, {0: -1}
    for joint in _outward(robot):
        if joint in moving:
            number = len(carried_by)
            parent = robot.urdf.joint(joint).parent
            carried_by[number] = body[parent]
            body[robot.urdf.joint(joint).child] = number
        else:
            body[robot.urdf.joint(joint).child] = body[robot.urdf.joint(joint).parent]
    return body, carried_by


def _outward(robot: Robot) -> list[str]:
    """Return the names of all joints of the URDF, parents before children."""
    by_parent: dict[str, list[tuple[str, str]]] = {}
    for joint in robot.urdf.joints:
        by_parent.setdefault(joint.parent, []).append((joint.name, joint.child))
    found, open_ = [], [robot.urdf.root]
    while open_:
        for name, child in by_parent.get(open_.pop(), []):
            found.append(name)
            open_.append(child)
    return found


def _link_placements(robot: Robot, readings: Array) -> dict[str, Array]:
    """Return the placements (N, 4, 4) of every link in the root link; joints that are not of the arm stand at rest."""
    q = robot.joint_positions(readings)
    column = {robot.chain[i].name: q[:, j] for j, i in enumerate(robot.moving)}
    placed = {robot.urdf.root: np.broadcast_to(np.eye(4), (len(readings), 4, 4))}
    joints = {joint.name: joint for joint in robot.urdf.joints}
    for name in _outward(robot):
        joint = joints[name]
        T = placed[joint.parent] @ joint.origin
        if joint.type in ("revolute", "continuous", "prismatic"):
            rest = min(max(0.0, joint.lower or 0.0), joint.upper or 0.0) if joint.type != "continuous" else 0.0
            position = column.get(name, np.full(len(readings), rest))
            motion = np.broadcast_to(np.eye(4), (len(readings), 4, 4)).copy()
            if joint.type == "prismatic":
                motion[:, :3, 3] = position[:, None] * joint.axis
            else:
                motion[:, :3, :3] = rigid.rotation_about(joint.axis, position)
            T = T @ motion
        placed[joint.child] = T
    return placed


def _moved(T: Array, point: Array) -> Array:
    return np.asarray(T[:, :3, :3] @ point + T[:, :3, 3])


def _transform(T: Array) -> object:
    return coal.Transform3s(np.ascontiguousarray(T[:3, :3]), T[:3, 3])
