"""Machines, measurements and least squares without any of calib's mathematics: what its solver is judged by.

An arm is read by yourdfpy and walked by numpy, several sets of parameters at a time. Derivatives are taken by complex
steps of 1e-30, which are exact, through loops and lenses as well; the minimum is searched from the truth by
Levenberg-Marquardt on an SVD. Nothing of calib's kinematics, residuals, start or solver is used.

The parameters are those that calib states: a joint's origin is followed by Trans(tx, ty, tz) Rx Ry Rz in a frame whose
z is the joint's axis, and a reading by its offset. Base, tools and targets are Trans(x, y, z) R Rx Ry Rz.
"""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import yourdfpy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.robot.sources import resolve

Array = NDArray[Any]  # float, or complex where derivatives are taken
COMPONENTS = ("tx", "ty", "tz", "rx", "ry", "rz")
POSE = ("x", "y", "z", "rx", "ry", "rz")
STEP = 1e-30
# A search is at the end where so much of the cost is left to gain.
FORETOLD = 1e-9


# ---- motions, of real and of complex numbers


def rx_ry_rz(angles: Array) -> Array:
    """Rotations (..., 3, 3) Rx(a) Ry(b) Rz(c) of angles (..., 3)."""
    (ca, cb, cc), (sa, sb, sc) = (np.moveaxis(f(angles), -1, 0) for f in (np.cos, np.sin))
    rows = [
        [cb * cc, -cb * sc, sb],
        [ca * sc + sa * sb * cc, ca * cc - sa * sb * sc, -sa * cb],
        [sa * sc - ca * sb * cc, sa * cc + ca * sb * sc, ca * cb],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def placed(rotation: Array, position: Array) -> Array:
    """Placements (..., 4, 4)."""
    shape = np.broadcast_shapes(rotation.shape[:-2], position.shape[:-1])
    T = np.zeros((*shape, 4, 4), dtype=np.result_type(rotation, position))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = rotation, position, 1.0
    return T


def inverse(T: Array) -> Array:
    """Inverses of placements (..., 4, 4)."""
    R = np.swapaxes(T[..., :3, :3], -1, -2)
    return placed(R, -(R @ T[..., :3, 3, None])[..., 0])


def rotation_vector(R: Array) -> Array:
    """Rotation vectors (..., 3) of rotations; complex ones must be by less than a right angle."""
    if not np.iscomplexobj(R):
        return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(*R.shape[:-2], 3)
    v = 0.5 * np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    square = np.sum(v * v, axis=-1, keepdims=True)
    small = square.real < 1e-8
    s = np.sqrt(np.where(small, 1.0, square))
    return v * np.where(small, 1.0 + square / 6.0 + 0.075 * square**2, np.arcsin(s) / s)


def pose_values(T: Array, R: Array) -> Array:
    """x, y, z, rx, ry, rz (..., 6) with ``T = Trans(x, y, z) R Rx Ry Rz``."""
    turn = np.swapaxes(R, -1, -2) @ T[..., :3, :3]
    angles = np.stack(
        [
            np.arctan2(-turn[..., 1, 2], turn[..., 2, 2]),
            np.arcsin(np.clip(turn[..., 0, 2], -1.0, 1.0)),
            np.arctan2(-turn[..., 0, 1], turn[..., 0, 0]),
        ],
        axis=-1,
    )
    return np.concatenate([T[..., :3, 3], angles], axis=-1)


# ---- arms


@dataclass(frozen=True)
class Joint:
    """A joint of the tree; ``origin`` leads from the parent's frame, both frames with z along their axes."""

    name: str
    kind: str
    parent: int
    origin: Array
    driver: str
    multiplier: float
    shift: float


@dataclass(frozen=True)
class Loop:
    """Two links whose origins meet in two directions of the first one; ``passive``: numbers of two revolute joints."""

    ends: tuple[tuple[int, Array], tuple[int, Array]]
    closes: tuple[int, int]
    passive: tuple[int, int]


@dataclass(frozen=True)
class Arm:
    """A tree of joints, parents first; ``tip``: the joint that carries the tip link, and the link in its frame."""

    joints: tuple[Joint, ...]
    ranges: Mapping[str, tuple[float, float]]
    tip: tuple[int, Array]
    reach: float
    loop: Loop | None = None
    moving: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "moving", tuple(j for j, joint in enumerate(self.joints) if joint.kind != "fixed"))

    @property
    def free(self) -> tuple[str, ...]:
        """Names of joints with an encoder."""
        return tuple(self.ranges)

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Random readings (n, k) within the ranges."""
        low, high = np.transpose(list(self.ranges.values()))
        return rng.uniform(low, high, (n, len(low)))

    def tips(self, readings: Array, deviations: Array | None = None, offsets: Array | None = None) -> Array:
        """Tips (B, N, 4, 4) in the base link for deviations (B, J, 6) and offsets (B, k) at readings (N, k)."""
        d = np.zeros((1, len(self.joints), 6)) if deviations is None else deviations
        o = np.zeros((len(d), len(self.ranges))) if offsets is None else offsets
        moved = readings[None] + o[:, None]
        columns = {name: moved[:, :, k] for k, name in enumerate(self.ranges)}
        q = [
            np.zeros(moved.shape[:2])
            if joint.kind == "fixed"
            else columns[joint.driver] * joint.multiplier + joint.shift
            for joint in self.joints
        ]
        deviating = np.any(d != 0.0, axis=(0, 2))
        origins = [
            (joint.origin @ placed(rx_ry_rz(d[:, j, 3:]), d[:, j, :3]))[:, None] if deviating[j] else joint.origin
            for j, joint in enumerate(self.joints)
        ]
        if np.iscomplexobj(d):
            return self._with_steps(origins, q)
        frames, _ = self._closed(origins, q)
        return frames[self.tip[0]] @ self.tip[1]

    def _with_steps(self, origins: Sequence[Array], q: Sequence[Array]) -> Array:
        """Tips of machines whose parameters have complex steps: the product rule in the place of complex products."""
        real = [T[:1].real if T.ndim > 2 else T.real for T in origins]
        frames, _ = self._closed(real, [v[:1].real for v in q])
        frames = [np.broadcast_to(T, (1, len(q[0][0]), 4, 4))[0] for T in frames]
        by_origin = [T.imag / STEP if np.iscomplexobj(T) else np.zeros((1, 1, 1, 1)) for T in origins]
        by_q = [v.imag / STEP for v in q]
        B = len(q[0])

        def change(end: tuple[int, Array]) -> Array:
            """Derivatives (B, N, 4, 4) of a link's placement."""
            link = frames[end[0]] @ end[1]
            found = np.zeros((B, *link.shape))
            j = end[0]
            while j >= 0:
                joint = self.joints[j]
                ahead = inverse(frames[j]) @ link
                moved = np.flatnonzero(np.any(by_origin[j] != 0.0, axis=(1, 2, 3)))
                if len(moved):
                    before = (frames[joint.parent] if joint.parent >= 0 else np.eye(4)) @ by_origin[j][moved]
                    # The joint's own motion is what its frame is beyond its origin.
                    own = frames[joint.parent] @ real[j] if joint.parent >= 0 else real[j]
                    own = np.broadcast_to(own, (1, *link.shape))[0]
                    found[moved] += before @ (inverse(own) @ frames[j] @ ahead)
                turned = np.flatnonzero(np.any(by_q[j] != 0.0, axis=1)) if joint.kind != "fixed" else ()
                if len(turned):
                    G = np.zeros((4, 4))
                    if joint.kind == "revolute":
                        G[1, 0], G[0, 1] = 1.0, -1.0
                    else:
                        G[2, 3] = 1.0
                    found[turned] += by_q[j][turned][:, :, None, None] * (frames[j] @ G @ ahead)
                j = joint.parent
            return found

        if self.loop is not None:
            for j in self.loop.passive:
                by_q[j] = np.zeros_like(by_q[j])
            (A, b), (dA, db) = (
                [frames[j] @ at_ for j, at_ in self.loop.ends],
                [change(end) for end in self.loop.ends],
            )
            columns = self._by_passive(self.loop, frames, [A, b])
            apart = (b[:, :3, 3] - A[:, :3, 3])[..., None]
            dr = np.swapaxes(dA[..., :3, :3], -1, -2) @ apart
            dr = dr + np.swapaxes(A[..., :3, :3], -1, -2) @ (db[..., :3, 3] - dA[..., :3, 3])[..., None]
            for j, v in zip(self.loop.passive, self._newton(self.loop, columns, dr[..., 0]), strict=True):
                by_q[j] = v
        T = frames[self.tip[0]] @ self.tip[1]
        return T + 1j * STEP * change(self.tip)

    def _walk(self, origins: Sequence[Array], q: Sequence[Array]) -> list[Array]:
        frames: list[Array] = []
        for joint, origin, travel in zip(self.joints, origins, q, strict=True):
            T = (frames[joint.parent] if joint.parent >= 0 else np.eye(4)) @ origin
            if joint.kind == "fixed":
                frames.append(T)
                continue
            T = np.array(np.broadcast_to(T, (*travel.shape, 4, 4)), dtype=np.result_type(T, travel))
            if joint.kind == "revolute":
                c, s = np.cos(travel)[..., None], np.sin(travel)[..., None]
                x, y = T[..., :, 0].copy(), T[..., :, 1].copy()
                T[..., :, 0], T[..., :, 1] = c * x + s * y, c * y - s * x
            else:
                T[..., :, 3] += travel[..., None] * T[..., :, 2]
            frames.append(T)
        return frames

    def _closed(self, origins: Sequence[Array], q: Sequence[Array]) -> tuple[list[Array], list[Array]]:
        """Frames and positions of all joints, the loop closed by Newton's method."""
        q = list(q)
        frames = self._walk(origins, q)
        for _ in range(0 if self.loop is None else 30):
            assert self.loop is not None
            ends = [frames[j] @ at for j, at in self.loop.ends]
            R_t = np.swapaxes(ends[0][..., :3, :3], -1, -2)
            r = (R_t @ (ends[1][..., :3, 3] - ends[0][..., :3, 3])[..., None])[..., 0]
            steps = self._newton(self.loop, self._by_passive(self.loop, frames, ends), r)
            for j, step in zip(self.loop.passive, steps, strict=True):
                q[j] = q[j] + step
            frames = self._walk(origins, q)
            if max(np.max(np.abs(step)) for step in steps) < 1e-13:
                break
        return frames, q

    def _by_passive(self, loop: Loop, frames: Sequence[Array], ends: Sequence[Array]) -> list[Array]:
        """What each passive joint does to the second end (..., 3), seen in the first one."""
        A, b = ends[0], ends[1][..., :3, 3]
        R_t = np.swapaxes(A[..., :3, :3], -1, -2)
        found = []
        for passive in loop.passive:
            axis, origin = frames[passive][..., :3, 2], frames[passive][..., :3, 3]
            # Where the first end is carried along, the second one moves the other way in it.
            way = float(self._carries(passive, loop.ends[1][0])) - float(self._carries(passive, loop.ends[0][0]))
            found.append(way * (R_t @ np.cross(axis, b - origin)[..., None])[..., 0])
        return found

    @staticmethod
    def _newton(loop: Loop, columns: Sequence[Array], r: Array) -> tuple[Array, Array]:
        (i, k), (u, v) = loop.closes, columns
        determinant = u[..., i] * v[..., k] - u[..., k] * v[..., i]
        return (
            -(v[..., k] * r[..., i] - v[..., i] * r[..., k]) / determinant,
            -(u[..., i] * r[..., k] - u[..., k] * r[..., i]) / determinant,
        )

    def _carries(self, joint: int, other: int) -> bool:
        while other >= 0 and other != joint:
            other = self.joints[other].parent
        return other == joint


def axis_turn(axis: Array) -> Array:
    """The frame (4, 4) with z along a joint's axis; along a coordinate axis it permutes the axes."""
    for k in range(3):
        if np.array_equal(axis, np.eye(3)[k]):
            columns = np.eye(3)[[(k + 1) % 3, (k + 2) % 3, k]].T
            return placed(columns, np.zeros(3))
    z = np.array([0.0, 0.0, 1.0])
    flip = np.diag([1.0, -1.0, -1.0]) if axis[2] <= -0.5 else np.eye(3)
    to = flip.T @ axis
    about = np.cross(z, to)
    angle = np.arctan2(np.linalg.norm(about), to[2])
    turn = Rotation.from_rotvec(about / max(np.linalg.norm(about), 1e-300) * angle).as_matrix()
    return placed(flip @ turn, np.zeros(3))


def arm(
    source: str,
    tip: str,
    *,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    loop: tuple[tuple[str, str], str, tuple[str, str]] | None = None,
) -> Arm:
    """The arm of a URDF - ``example:...``, a file, or its text - from its root to ``tip``.

    ``ranges``: where readings are drawn, in place of the limits. ``loop``: two links, the directions in which their
    origins meet, such as "xz", and the two joints that follow.
    """
    urdf = _read(source)
    by_child = {joint.child: joint for joint in urdf.robot.joints}
    by_name = urdf.joint_map
    ends = [tip, *(loop[0] if loop else ())]
    order: list[Any] = []
    for end in ends:
        path, link = [], end
        while link in by_child:
            path.append(by_child[link])
            link = by_child[link].parent
        order += [joint for joint in reversed(path) if joint not in order]
    number = {joint.child: j for j, joint in enumerate(order)}
    joints: list[Joint] = []
    back: list[Array] = []
    drivers: list[str] = []
    for joint in order:
        kind = {"continuous": "revolute"}.get(joint.type, joint.type)
        multiplier, shift, driver = 1.0, 0.0, joint
        while driver.mimic is not None:
            shift += multiplier * (driver.mimic.offset or 0.0)
            multiplier *= 1.0 if driver.mimic.multiplier is None else driver.mimic.multiplier
            driver = by_name[driver.mimic.joint]
        turn = np.eye(4) if kind == "fixed" else axis_turn(joint.axis / np.linalg.norm(joint.axis))
        parent = number.get(joint.parent, -1)
        origin = np.eye(4) if joint.origin is None else joint.origin
        before = back[parent] if parent >= 0 else np.eye(4)
        joints.append(Joint(joint.name, kind, parent, before @ origin @ turn, driver.name, multiplier, shift))
        back.append(inverse(turn))
        if kind != "fixed" and driver.name not in drivers and driver is joint:
            drivers.append(driver.name)
    # In the order of the file, as tables have them.
    names = [joint.name for joint in urdf.robot.joints if joint.name in drivers]
    passive = loop[2] if loop is not None else ()
    found = {name: (ranges or {}).get(name, _limits(by_name[name])) for name in names if name not in passive}
    reach, j = 0.0, number[tip]
    while j >= 0:
        reach += float(np.linalg.norm(joints[j].origin[:3, 3]))
        j = joints[j].parent
    closed = None
    if loop is not None:
        a, b = (number[link] for link in loop[0])
        names = [joint.name for joint in joints]
        u, v = (names.index(name) for name in loop[2])
        i, k = ("xyz".index(c) for c in loop[1])
        closed = Loop(((a, back[a]), (b, back[b])), (i, k), (u, v))
    return Arm(tuple(joints), found, (number[tip], back[number[tip]]), reach, closed)


def _read(source: str) -> yourdfpy.URDF:
    # Where example-robot-data keeps its files is no mathematics.
    file: Any = io.BytesIO(source.encode()) if source.startswith("<") else str(resolve(source))
    return yourdfpy.URDF.load(file, build_scene_graph=False, load_meshes=False)


def _limits(joint: Any) -> tuple[float, float]:
    if joint.type == "continuous" or joint.limit is None or joint.limit.lower == joint.limit.upper:
        return (-np.pi, np.pi)
    return (max(joint.limit.lower, -np.pi), min(joint.limit.upper, np.pi))


# ---- what was measured


@dataclass(frozen=True)
class Lens:
    """A pinhole with Brown's distortion; ``on_tip``: the camera is on the tool and sees a board, or the reverse."""

    on_tip: bool
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def see(self, points: Array) -> Array:
        """Pixels (..., 2) of points (..., 3) in the camera's frame."""
        x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        u = x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x)
        v = y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y
        return np.stack([self.fx * u + self.cx, self.fy * v + self.cy], axis=-1)


@dataclass(frozen=True)
class Rows:
    """Rows of one kind. ``tool`` and ``target`` (N,): numbers. ``marks`` (m, 3): of a board, seen in every row.

    ``position`` (N, 3) and ``orientation`` (N, 3, 3) as measured; ``pixels`` (N, m, 2).
    """

    kind: str
    readings: Array
    tool: Array
    target: Array | None = None
    position: Array | None = None
    orientation: Array | None = None
    pixels: Array | None = None
    marks: Array | None = None
    lens: Lens | None = None

    @property
    def components(self) -> tuple[int, ...]:
        """Measured numbers of every component, which share their noise."""
        n = len(self.readings)
        if self.kind == "pixels":
            assert self.marks is not None
            return (2 * n * len(self.marks),)
        return (3 * n, 3 * n) if self.kind == "pose" else (3 * n,)


@dataclass(frozen=True)
class Distance:
    """Two sockets are known to be so far apart."""

    targets: tuple[int, int]
    value: float
    sigma: float


@dataclass(frozen=True)
class State:
    """A machine, or B of them. ``deviations`` (B, J, 6), ``offsets`` (B, k), frames (B, 4, 4) and (B, m, 4, 4)."""

    deviations: Array
    offsets: Array
    base: Array
    tools: Array
    targets: Array


@dataclass(frozen=True)
class Layout:
    """The free parameters by name, in order, and what holds where a frame is not free.

    ``at``: one machine, whose rotations are the reference of frames. ``tool_names`` and ``target_names``: in order.
    """

    arm: Arm
    names: tuple[str, ...]
    at: State
    tool_names: tuple[str, ...]
    target_names: tuple[str, ...]

    def state(self, x: Array) -> State:
        """The machines at values (B, p)."""
        values = dict(zip(self.names, np.moveaxis(x, -1, 0), strict=True))
        B = len(x)
        d = np.array(np.broadcast_to(self.at.deviations, (B, *self.at.deviations.shape[1:])), dtype=x.dtype)
        o = np.array(np.broadcast_to(self.at.offsets, (B, self.at.offsets.shape[1])), dtype=x.dtype)
        for j, joint in enumerate(self.arm.joints):
            for c, component in enumerate(COMPONENTS):
                if (name := f"{joint.name}.{component}") in values:
                    d[:, j, c] = values[name]
        for k, reading in enumerate(self.arm.ranges):
            if (name := f"{reading}.offset") in values:
                o[:, k] = values[name]

        def frame(prefix: str, T: Array) -> Array:
            own = pose_values(T, T[:3, :3]).astype(x.dtype)
            v = np.array(np.broadcast_to(own, (B, 6)))
            found = False
            for c, component in enumerate(POSE):
                if (name := f"{prefix}.{component}") in values:
                    v[:, c], found = values[name], True
            return placed(T[:3, :3] @ rx_ry_rz(v[:, 3:]), v[:, :3]) if found else np.broadcast_to(T, (B, 4, 4))

        tools = [frame(name, T) for name, T in zip(self.prefixes, self.at.tools[0], strict=True)]
        targets = [frame(f"target.{name}", T) for name, T in zip(self.target_names, self.at.targets[0], strict=True)]
        empty = np.zeros((B, 0, 4, 4))
        return State(
            d,
            o,
            frame("base", self.at.base[0]),
            np.stack(tools, axis=1) if tools else empty,
            np.stack(targets, axis=1) if targets else empty,
        )

    @property
    def prefixes(self) -> tuple[str, ...]:
        """What parameters of tools begin with."""
        return tuple("tool" if name == "tool" else f"tool.{name}" for name in self.tool_names)

    def values(self, state: State) -> Array:
        """The values (p,) of one machine."""
        known: dict[str, float] = {}
        for j, joint in enumerate(self.arm.joints):
            known |= {f"{joint.name}.{c}": float(v) for c, v in zip(COMPONENTS, state.deviations[0, j], strict=True)}
        known |= {f"{name}.offset": float(v) for name, v in zip(self.arm.ranges, state.offsets[0], strict=True)}
        frames = [("base", state.base[0], self.at.base[0])]
        frames += list(zip(self.prefixes, state.tools[0], self.at.tools[0], strict=True))
        names = [f"target.{name}" for name in self.target_names]
        frames += list(zip(names, state.targets[0], self.at.targets[0], strict=True))
        for prefix, T, at in frames:
            own = pose_values(T, at[:3, :3])
            known |= {f"{prefix}.{c}": float(v) for c, v in zip(POSE, own, strict=True)}
        return np.array([known[name] for name in self.names])

    def is_angle(self, name: str) -> bool:
        """Whether a parameter is an angle."""
        head, _, component = name.rpartition(".")
        if component == "offset":
            return next(joint.kind for joint in self.arm.joints if joint.name == head) == "revolute"
        return component.startswith("r")


def predict(arm: Arm, state: State, readings: Array, tool: Array) -> Array:
    """Tool poses (B, N, 4, 4) in the instrument's frame."""
    tips = arm.tips(readings, state.deviations, state.offsets)
    return state.base[:, None] @ tips @ state.tools[:, tool]


def residuals(arm: Arm, state: State, rows: Rows) -> list[Array]:
    """Measured minus predicted of every component, (B, n), in m, rad or px."""
    tools = predict(arm, state, rows.readings, rows.tool)
    B = len(tools)
    if rows.kind in ("position", "pose"):
        found = [(rows.position - tools[..., :3, 3]).reshape(B, -1)]
        if rows.kind == "pose":
            assert rows.orientation is not None
            turn = rotation_vector(np.swapaxes(tools[..., :3, :3], -1, -2) @ rows.orientation)
            found.append(turn.reshape(B, -1))
        return found
    assert rows.target is not None
    targets = state.targets[:, rows.target]
    if rows.kind == "socket":
        return [(targets[..., :3, 3] - tools[..., :3, 3]).reshape(B, -1)]
    assert rows.marks is not None and rows.lens is not None and rows.pixels is not None
    cameras, boards = (tools, targets) if rows.lens.on_tip else (targets, tools)
    T = inverse(cameras) @ boards
    marks = rows.marks @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]
    return [(rows.pixels - rows.lens.see(marks)).reshape(B, -1)]


# ---- the cost and its minimum


@dataclass(frozen=True)
class Cost:
    """sum (r / sigma)^2 + sum ((x - origin) / width)^2 over the rows, what is known of targets, and the parameters.

    ``sigmas``: of every component of all rows, in order. ``widths`` (p,): inf where nothing holds a parameter.
    """

    layout: Layout
    rows: tuple[Rows, ...]
    sigmas: tuple[float, ...]
    distances: tuple[Distance, ...]
    origin: Array
    widths: Array

    def whitened(self, x: Array) -> tuple[Array, Array]:
        """Whitened residuals (B, n) of data, and of what is held, at values (B, p)."""
        state = self.layout.state(x)
        found = [r for rows in self.rows for r in residuals(self.layout.arm, state, rows)]
        parts = [r / sigma for r, sigma in zip(found, self.sigmas, strict=True)]
        for known in self.distances:
            a, b = known.targets
            apart = state.targets[:, b, :3, 3] - state.targets[:, a, :3, 3]
            parts.append((known.value - np.sqrt(np.sum(apart * apart, axis=-1, keepdims=True))) / known.sigma)
        held = np.isfinite(self.widths)
        return np.concatenate(parts, axis=1), ((x - self.origin) / self.widths)[:, held]

    def of(self, x: Array) -> tuple[float, float]:
        """Cost of the data, and of what is held, at values (p,)."""
        data, held = self.whitened(x[None])
        return float(np.sum(data**2)), float(np.sum(held**2))

    def jacobian(self, x: Array) -> Array:
        """Derivatives (n, p) of the data's whitened residuals."""
        p, found = len(x), []
        for k in range(0, p, 16):
            some = np.arange(k, min(k + 16, p))
            z = np.repeat(x[None].astype(complex), len(some), axis=0)
            z[np.arange(len(some)), some] += 1j * STEP
            found.append(self.whitened(z)[0].imag / STEP)
        return np.concatenate(found).T


class Minimum:
    """What a search found: ``x`` (p,), its costs, steps taken, and whether the last one was negligible."""

    def __init__(self, cost: Cost, x: Array, steps: int, settled: bool) -> None:
        self.x, self.steps, self.settled = x, steps, settled
        self.data, self.held = cost.of(x)

    @property
    def total(self) -> float:
        """All of the cost."""
        return self.data + self.held


def minimise(cost: Cost, x: Array, most: int = 200) -> Minimum:
    """Levenberg-Marquardt in scaled parameters from x (p,), until there is nothing to gain."""
    p = len(x)
    held = np.flatnonzero(np.isfinite(cost.widths))
    hold = np.zeros((len(held), p))
    hold[np.arange(len(held)), held] = 1.0 / cost.widths[held]
    damping, idle, settled, k = 0.0, 0, False, 0
    total = sum(cost.of(x))
    while k < most:
        k += 1
        data, pull = cost.whitened(x[None])
        J = np.concatenate([cost.jacobian(x), hold])
        r = np.concatenate([data[0], pull[0]])
        norms = np.linalg.norm(J, axis=0)
        scale = np.where(norms > 0.0, norms, 1.0)
        U, s, Vt = np.linalg.svd(J / scale, full_matrices=False)
        b = np.where(s > 1e-13 * s[0], U.T @ r, 0.0)
        # What a full step of Gauss-Newton would take away.
        if float(b @ b) <= FORETOLD * (total + 1.0):
            settled = True
            break
        while True:
            step = -(Vt.T @ (b * s / (s * s + damping + 1e-300))) / scale
            new = sum(cost.of(x + step))
            if new < total or damping > 1e6:
                break
            damping = max(10.0 * damping, 1e-10)
        if new >= total:
            break
        idle = idle + 1 if total - new <= FORETOLD * (total + 1.0) else 0
        x, total = x + step, new
        damping = 0.1 * damping if damping > 1e-10 else 0.0
        if idle == 3:
            settled = True
            break
    return Minimum(cost, x, k, settled)


def formal_rank(cost: Cost, x: Array) -> int:
    """How many combinations of the parameters the data see at x, however weakly: columns are compared at their norm."""
    J = cost.jacobian(x)
    norms = np.linalg.norm(J, axis=0)
    s = np.linalg.svd(J / np.where(norms > 0.0, norms, 1.0), compute_uv=False)
    return int(np.count_nonzero(s > 1e-9 * s[0]))
