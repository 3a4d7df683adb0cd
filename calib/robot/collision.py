"""Self-collision: the collision shapes of a URDF, moved by its joints and judged by coal.

Bodies are groups of links that no joint of the arm moves apart. Bodies that a joint connects are not judged, as they
touch there. What cannot be judged - a missing mesh, a shape that is not one, two bodies that touch in whatever pose -
is left out, and said.
"""

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, BoolArray, IntArray
from calib.foundations.errors import RobotError
from calib.foundations.files import read_bytes
from calib.foundations.ranges import refuse_shape
from calib.foundations.xml_text import Element
from calib.robot.links import arm_of, link_placements
from calib.robot.mesh_counts import MOST_CORNERS
from calib.robot.mesh_files import LARGEST_FILE, Triangles, joined, parse_mesh
from calib.robot.robot import Robot
from calib.robot.sampling import random_readings
from calib.robot.sources import find_mesh
from calib.robot.urdf import LARGEST_NUMBER, Urdf, read_document

_FORMATS = {".dae", ".stl", ".obj", ".ply"}
_GREY = (0.5, 0.5, 0.5)
# Poses that are tried to find bodies that always touch; by chance alone none would in all of them.
_SAMPLES = 200
# Of a robot; those that we know have up to 150.
MOST_SHAPES = 1000
# Tests of two shapes, of about ten microseconds each, that balls about them do not rule out; of ordinary arms, a few in
# a pose.
_LEAST_TESTS = 300_000
_TESTS_OF_A_POSE = 100
# What a test of a mesh counts at least; of one that winds into another without touching it, as many tests as the
# processor could have done meanwhile, at this many seconds each: ordinary ones are far from that on slow machines, too.
_OF_MESHES = 4.0
_OF_TIME = 2e-5
# Of two meshes of more triangles, so many of each tell beforehand how long a test takes, if even they take as many
# seconds: of triangles that lie on each other each is judged with each.
_FEW_TRIANGLES = 1000
_LONG = 1e-3
# Two balls, in numbers of three coordinates, as a part of such a test.
_OF_BALLS = 1.0 / 1000.0
_BLOCK = 200  # poses at a time
_REQUEST = coal.CollisionRequest()


# Shapes that a URDF states by numbers: what makes them, and its attributes with how many numbers each has.
_PLAIN_SHAPES = {
    "box": (coal.Box, {"size": 3}),
    "sphere": (coal.Sphere, {"radius": 1}),
    "cylinder": (coal.Cylinder, {"radius": 1, "length": 1}),
    "capsule": (coal.Capsule, {"radius": 1, "length": 1}),
}


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """A shape at ``placement`` (4, 4) in ``link``, within a ball of ``radius`` about ``centre`` (3,) in that link.

    ``mesh``: what it is made of, if it is one.
    """

    link: str
    placement: Array
    geometry: object
    centre: Array
    radius: float
    mesh: "_Mesh | None"

    @property
    def effort(self) -> float:
        """What a test of it counts."""
        return 1.0 if self.mesh is None else _OF_MESHES


class _Mesh(NamedTuple):
    """A mesh, and a ``share`` of its triangles, evenly taken, as a mesh of ``few``."""

    whole: Any
    few: object
    share: float


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

    @checked
    def colliding(self, readings: Array, effort: "Effort | None" = None) -> BoolArray:
        """Return at which of the readings (N, nr) in rad and m the robot, as its URDF has it, touches itself.

        Raises RobotError when that takes more than ``effort``, one of as many poses when None.
        """
        readings = self.robot.own(readings)
        effort = effort or Effort(self.robot, len(readings))
        found = np.zeros(len(readings), dtype=bool)
        for start in range(0, len(readings), _BLOCK):
            poses = _Poses(self.robot, self.shapes, readings[start : start + _BLOCK], effort)
            rows = np.arange(len(poses))
            for pair in self.pairs:
                rows = rows[~poses.touching(*self._of(pair), rows)]
            found[start : start + len(poses)] = True
            found[start + rows] = False
        return found

    @checked
    def without_lasting(self, readings: Array) -> "SelfCollision":
        """Return the same without pairs of bodies that touch at all of the readings (N, nr), said in the notes."""
        readings = self.robot.own(readings)
        poses = _Poses(self.robot, self.shapes, readings, Effort(self.robot, len(readings)))
        rows = np.arange(len(readings))
        lasting = [pair for pair in self.pairs if bool(np.all(poses.touching(*self._of(pair), rows)))]
        named = {self.bodies[shape.link]: shape.link for shape in reversed(self.shapes)}
        said = (f"{named[a]} and {named[b]} touch in every sampled pose, and are not judged." for a, b in lasting)
        kept = tuple(pair for pair in self.pairs if pair not in lasting)
        return replace(self, pairs=kept, notes=(*self.notes, *said))

    def _of(self, pair: tuple[int, int]) -> tuple[list[int], list[int]]:
        """Return the numbers of the shapes of two bodies."""
        a, b = ([k for k, s in enumerate(self.shapes) if self.bodies[s.link] == body] for body in pair)
        return a, b


class Effort:
    """Counts tests of two shapes in one pose, and ends with a sentence what takes more than ordinary arms do."""

    def __init__(self, robot: Robot, poses: int) -> None:
        self._robot, self._most = robot, max(_LEAST_TESTS, _TESTS_OF_A_POSE * poses)
        self._done = 0.0

    def spend(self, tests: float) -> None:
        """Count some tests more. Raises RobotError when they are too many."""
        self._done += tests
        self.refuse(0.0)

    def refuse(self, tests: float) -> None:
        """Raise RobotError when some tests more would be too many."""
        if self._done + tests > self._most:
            raise RobotError(
                f"{self._robot.urdf.where}: to find where its collision shapes touch takes more than {self._most} "
                "tests of two of them; give simpler shapes, or do not judge collisions "
                "(--no-collisions)."
            )


class _Poses:
    """Shapes in some poses, placed as they are asked for."""

    def __init__(self, robot: Robot, shapes: Sequence[_Shape], readings: Array, effort: Effort) -> None:
        placed = link_placements(robot.urdf, arm_of(robot, robot.no_deviations(), readings, np.eye(4)))
        self._shapes, self._n, self._effort = shapes, len(readings), effort
        self._placed = [placed[shape.link] for shape in shapes]
        centres = [_moved(T, shape.centre) for T, shape in zip(self._placed, shapes, strict=True)]
        self._centres = np.array(centres).reshape(len(shapes), len(readings), 3)
        self._radii = np.array([shape.radius for shape in shapes])
        self._known: dict[tuple[int, int], object] = {}

    def __len__(self) -> int:
        return self._n

    def touching(self, a_shapes: Sequence[int], b_shapes: Sequence[int], rows: IntArray) -> BoolArray:
        """Return in which of some poses any of ``a_shapes`` touches any of ``b_shapes``; balls rule most out."""
        found = np.zeros(len(rows), dtype=bool)
        centres, radii = self._centres[np.ix_(np.array(b_shapes, dtype=np.intp), rows)], self._radii[b_shapes]
        for a in a_shapes:
            away = centres - self._centres[a, rows]
            self._effort.spend(away.size * _OF_BALLS)
            near = np.einsum("bkx,bkx->bk", away, away) < ((radii + self._radii[a]) ** 2)[:, None]
            for b, k in zip(*np.nonzero(near & ~found), strict=True):
                found[k] = found[k] or self._touch(a, b_shapes[b], int(rows[k]))
        return found

    def _touch(self, a: int, b: int, pose: int) -> bool:
        least = max(self._shapes[a].effort, self._shapes[b].effort)
        where = (self._at(a, pose), self._at(b, pose))
        shapes = (self._shapes[a].geometry, self._shapes[b].geometry)
        meshes = self._shapes[a].mesh, self._shapes[b].mesh
        if meshes[0] is None or meshes[1] is None:
            self._effort.spend(least)
            return _collide(shapes, where)[0]
        share = meshes[0].share * meshes[1].share
        if share < 1.0:
            _, seconds = _collide((meshes[0].few, meshes[1].few), where)
            if seconds > _LONG:
                self._effort.refuse(seconds / share / _OF_TIME)
        found, seconds = _collide(shapes, where)
        self._effort.spend(max(least, seconds / _OF_TIME))
        return found

    def _at(self, shape: int, pose: int) -> object:
        key = (shape, pose)
        if key not in self._known:
            self._known[key] = _transform(self._placed[shape][pose] @ self._shapes[shape].placement)
        return self._known[key]


def _collide(shapes: tuple[object, object], where: tuple[object, object]) -> tuple[bool, float]:
    """Return whether two shapes touch where they are, and how long that took to find, in s."""
    start = time.process_time()
    count: int = coal.collide(shapes[0], where[0], shapes[1], where[1], _REQUEST, coal.CollisionResult())
    return count > 0, time.process_time() - start


@checked
def self_collision(
    robot: Robot, mesh_roots: Sequence[Path] = (), readings: Array | None = None
) -> SelfCollision | None:
    """Return the collision shapes of a robot, or None when its URDF has none that can be read.

    ``mesh_roots``: folders that may be read for meshes. ``readings`` (N, nr): poses over which bodies that always touch
    are found and left out; random ones within the limits when None. Raises RobotError when there are more than 1000
    shapes, or they touch so often that all this takes too long.
    """
    if readings is not None:
        refuse_shape(readings, (None, len(robot.readings)), "readings", RobotError)
    shapes, notes = [], []
    meshes = _Meshes(robot.urdf.where, mesh_roots)
    elements = _elements(robot.urdf)
    if len(elements) > MOST_SHAPES:
        raise RobotError(
            f"{robot.urdf.where}: has {len(elements)} collision shapes; allowed are {MOST_SHAPES}, unless collisions "
            "are not judged (--no-collisions)."
        )
    for link, origin, shape in elements:
        try:
            shapes.append(_shape(link, origin, shape, meshes))
        except _LeftOutError as e:
            notes.append(str(e))
    if not shapes:
        return None
    if readings is None:
        readings = random_readings(robot, _SAMPLES)
    bodies, carried_by = _bodies(robot)
    judged = itertools.combinations(sorted({bodies[shape.link] for shape in shapes}), 2)
    pairs = tuple((a, b) for a, b in judged if a != carried_by[b] and b != carried_by[a])
    return SelfCollision(robot, tuple(shapes), bodies, pairs, tuple(notes)).without_lasting(readings)


def _elements(urdf: Urdf) -> list[tuple[str, Mapping[str, str], Element]]:
    """Return the shapes of all ``<collision>`` elements of a URDF, with their links and what their origins state."""
    return [
        (link.attributes["name"], origin, shape)
        for link in read_document(urdf.source, urdf.where, generations=4).all("link")
        for collision in link.all("collision")
        for origin in [{key: value for element in collision.all("origin") for key, value in element.attributes.items()}]
        for geometry in collision.all("geometry")
        for shape in geometry.children
    ]


class _LeftOutError(RobotError):
    """Why one shape is not judged."""


class _Meshes:
    """The meshes of a robot below some folders: a file is read once, and made once for each of its scales."""

    def __init__(self, where: str, roots: Sequence[Path]) -> None:
        self._where, self._roots = where, roots
        self._read: dict[Path, Triangles | None] = {}
        self._made: dict[tuple[Path, tuple[float, ...]], _Mesh] = {}
        self._spare = MOST_CORNERS

    def find(self, attributes: Mapping[str, str], at: str) -> _Mesh:
        """Return a mesh. Raises RobotError when all that were made are too large together."""
        name = attributes.get("filename", "")
        path = find_mesh(name, self._roots)
        if path is None or path.suffix.lower() not in _FORMATS:
            raise _LeftOutError(f"{at} is the mesh {name[-80:]!r}, which is not found or not read, and is not judged.")
        scale = _numbers(attributes.get("scale", "1 1 1"), 3, at)
        what = f"{at} is the mesh {name[-80:]!r}"
        key = (path, tuple(scale.tolist()))
        if key not in self._made:
            mesh = self._once(path)
            if mesh is None:
                raise _LeftOutError(f"{what}, which cannot be read or is too large, and is not judged.")
            self._spend(mesh)
            self._made[key] = _made(mesh, scale, what)
        return self._made[key]

    def _once(self, path: Path) -> Triangles | None:
        if path not in self._read:
            data = read_bytes(path, _LeftOutError, LARGEST_FILE)
            mesh = parse_mesh(data, path.suffix.lower(), _GREY)
            self._read[path] = mesh and joined([part for part in mesh.parts if len(part.faces)], _GREY)
            self._spare += len(data)
        return self._read[path]

    def _spend(self, mesh: Triangles) -> None:
        """Count the corners of a mesh, as many as are drawn of a scene's: each of its scales is one more."""
        self._spare -= max(mesh.faces.size, len(mesh.vertices))
        if self._spare < 0:
            raise RobotError(
                f"{self._where}: its collision meshes, in all their scales, have more corners of triangles than their "
                f"files have bytes, and {MOST_CORNERS} more; give simpler shapes, or do not judge collisions "
                "(--no-collisions)."
            )


def _shape(link: str, origin: Mapping[str, str], shape: Element, meshes: _Meshes) -> _Shape:
    at = f"The collision shape of link {link!r}"
    xyz, rpy = (_numbers(origin.get(name, "0 0 0"), 3, at) for name in ("xyz", "rpy"))
    placement = rigid.placement(rigid.rotation_of_rpy(rpy), xyz)
    mesh: _Mesh | None = None
    if shape.tag == "mesh":
        mesh = meshes.find(shape.attributes, at)
        geometry: Any = mesh.whole
    elif shape.tag in _PLAIN_SHAPES:
        made, needed = _PLAIN_SHAPES[shape.tag]
        numbers = [_numbers(shape.attributes.get(name, ""), count, at) for name, count in needed.items()]
        geometry = made(*np.concatenate(numbers))
    else:
        raise _LeftOutError(f"{at} is a {shape.tag[:40]!r}, which is not a known shape; its collisions are not judged.")
    geometry.computeLocalAABB()
    centre = np.asarray(geometry.aabb_center, dtype=np.float64)
    return _Shape(
        link,
        placement,
        geometry,
        placement[:3, :3] @ centre + placement[:3, 3],
        float(geometry.aabb_radius),
        mesh,
    )


def _made(found: Triangles, scale: Array, what: str) -> _Mesh:
    vertices = found.vertices * scale
    if np.abs(vertices).max() > LARGEST_NUMBER:
        raise _LeftOutError(f"{what}, which has corners beyond {LARGEST_NUMBER:g} m, and is not judged.")
    corners = vertices[found.faces]
    # What has two corners in one place is no triangle.
    faces = found.faces[(corners != corners[:, [1, 2, 0]]).any(axis=2).all(axis=1)]
    if not len(faces):
        raise _LeftOutError(f"{what}, which has no triangles, and is not judged.")
    whole = _bvh(vertices, faces)
    if len(faces) <= _FEW_TRIANGLES:
        return _Mesh(whole, whole, 1.0)
    few = faces[np.linspace(0, len(faces), _FEW_TRIANGLES, endpoint=False, dtype=np.intp)]
    return _Mesh(whole, _bvh(vertices, few), len(few) / len(faces))


def _bvh(vertices: Array, faces: IntArray) -> object:
    shape = coal.BVHModelOBBRSS()
    shape.beginModel(len(faces), len(vertices))
    shape.addVertices(vertices)
    shape.addTriangles(faces)
    shape.endModel()
    return shape


def _numbers(text: str, count: int, at: str) -> Array:
    try:
        values = np.array(text.split(), dtype=np.float64)
    except ValueError:
        values = np.zeros(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise _LeftOutError(f"{at} has {text[:60]!r} where {count} numbers are needed, and is not judged.")
    if np.abs(values).max() > LARGEST_NUMBER:
        raise _LeftOutError(f"{at} has {text[:60]!r}; allowed are numbers up to {LARGEST_NUMBER:g}. It is not judged.")
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


def _moved(T: Array, point: Array) -> Array:
    return np.asarray(T[:, :3, :3] @ point + T[:, :3, 3])


def _transform(T: Array) -> object:
    return coal.Transform3s(np.ascontiguousarray(T[:3, :3]), T[:3, 3])
