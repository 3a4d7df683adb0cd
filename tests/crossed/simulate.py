"""A job with given features, its files, and the machine whose measurements they hold.

The machine is the job's own robot with deviations drawn at random: that kinematics, terms and loops are right, others
tests show; these ask whether everything reaches everything.
"""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib
from calib.compensation.commands import for_poses
from calib.foundations import rigid
from calib.identification.machine import Frames, machine, values_at
from calib.job.stated import load_arm
from calib.measurement.projection import project
from calib.robot.conditions import Conditions, in_order
from calib.robot.robot import Deviations, Robot
from calib.robot.terms import JointTerm
from tests.crossed.features import Draft, Feature

Array = NDArray[np.float64]
Columns = dict[str, Any]

SIGMA, SIGMA_ANGLE, SIGMA_PIXEL = 2e-6, 5e-6, 0.005
ROWS, FRESH = 28, 10
FIELD = 1e-4  # m per rad: what a residual model is to find
LENGTH_OFFSET = 1.5e-3
BALL = 3e-3
ROLES = {
    "turning": {"@first": "joint_1", "@second": "joint_2", "@third": "joint_6", "@wrist": "joint_4"},
    "loop": {"@first": "turret", "@second": "lower", "@third": "crank", "@wrist": "roll"},
}
# Readings at which the arm is before what it touches.
BEFORE = np.array([[0.2, 0.3, 0.4, 0.3, 0.5, 0.2], [-0.4, 0.2, 0.2, -0.3, 0.6, 0.1]] * 2)
BEFORE[2:, 0] += 0.7
CAMERA = {"camera_on": "floor", "fx": "1200 px", "fy": "1190 px", "cx": "640 px", "cy": "500 px", "k1": -0.05}


@dataclass(frozen=True)
class Case:
    """A job on disk and its truth. ``placed``: whether the base's place in the instrument's frame can be known."""

    path: Path
    draft: Draft
    robot: Robot
    truth: calib.CalibratedMachine
    placed: bool
    rng: np.random.Generator
    places: Array

    @property
    def follows(self) -> bool:
        """Whether some joint follows others."""
        return self.draft.arm != "turning"

    @property
    def places_of_touch(self) -> Array:
        """Points (4, 3) before the arm, in the instrument's frame."""
        tool = self.truth.tools[self.draft.tools[0]]
        return np.asarray((self.truth.base @ self.robot.tips(BEFORE[:, : len(self.robot.readings)]) @ tool)[:, :3, 3])

    def tools_of(self, n: int) -> list[str]:
        return [self.draft.tools[k // 4 % len(self.draft.tools)] for k in range(n)]

    def draw(self, n: int) -> Array:
        """Readings (N, nr) within the middle of the limits."""
        low, high = np.transpose([(r.lower or -2.0, r.upper or 2.0) for r in self.robot.readings])
        if self.draft.arm == "loop":  # crank and lower arm keep their angle
            low, high = np.array([-2.0, -0.6, -0.6, -2.0, -1.6]), np.array([2.0, 0.6, 0.6, 2.0, 1.6])
        return self.rng.uniform(0.7 * low, 0.7 * high, (n, len(low)))

    def conditions(self, readings: Array) -> Conditions:
        """What the rows carry, as the draft says it."""
        n, said = len(readings), self.draft.said
        approach = self.rng.choice([-1.0, 1.0], readings.shape)
        if said == "row":
            approach = np.repeat(approach[:, :1], readings.shape[1], axis=1)
        if said == "order":
            approach = in_order(readings)
        return Conditions(approach, self.rng.uniform(12.0, 30.0, n), self.rng.normal(0.0, 20.0, readings.shape))

    def see(self, readings: Array, conditions: Conditions, tools: Sequence[str]) -> Array:
        """Where the tools are (N, 4, 4), the field of the residual model included."""
        placed = np.stack([self.truth.tools[name] for name in tools])
        tips = self.truth.tips(readings, conditions)
        if self.draft.levels in ("grid", "gaussian") and self.draft.kind in ("position", "pose"):
            tips = np.array(tips)
            tips[:, :3, 3] += FIELD * np.column_stack([readings[:, 0], readings[:, 1], readings[:, 0] + readings[:, 1]])
        return self.truth.base @ tips @ placed

    def reach(self, points: Array, tools: Sequence[str]) -> tuple[Array, Conditions, NDArray[np.intp]]:
        """Readings at which tools are at points (N, 3) in the instrument's frame, and which of them can be reached."""
        near = BEFORE[np.arange(len(points)) % 2, : len(self.robot.readings)]
        q = near + 0.2 * (self.draw(len(points)) - near)
        told, kept = self.conditions(q), np.arange(len(points))
        for _ in range(3 if self.draft.said == "order" else 1):
            found = for_poses(
                self.truth, points, q, list(tools), frame="instrument", conditions=told, tolerance=(1e-8, 1e-6)
            )
            rows = np.flatnonzero(found.reached)
            q, points, tools = found.readings[rows], points[rows], [tools[k] for k in rows]
            told, kept = told.subset(rows), kept[rows]
            if self.draft.said == "order":
                told = Conditions(in_order(q), told.temperature, told.torque)
        return q, told, kept

    # ---- tables

    def columns(self, readings: Array, conditions: Conditions, tools: Sequence[str]) -> Columns:
        """The columns that every table of the job has."""
        joints = {"angle": ("deg", np.degrees(1.0)), "length": ("mm", 1e3)}
        found: Columns = {}
        for k, reading in enumerate(self.robot.readings):
            unit, factor = joints[reading.dimension]
            found[f"{reading.name} [{unit}]"] = readings[:, k] * factor
        assert conditions.approach is not None
        if self.draft.said == "each":
            for k, reading in enumerate(self.robot.readings):
                found[f"direction_{reading.name}"] = np.where(conditions.approach[:, k] > 0, "+", "-")
        elif self.draft.said == "row":
            found["direction"] = np.where(conditions.approach[:, 0] > 0, "+", "-")
        if self.draft.told:
            found["temperature [degC]"] = conditions.temperature
            assert conditions.torque is not None
            for k, reading in enumerate(self.robot.readings):
                if reading.dimension == "angle":
                    found[f"tau_{reading.name} [Nm]"] = conditions.torque[:, k]
        if len(self.draft.tools) > 1:
            found["tool"] = np.array(tools)
        return found

    def positions(self, readings: Array, *, pose: bool = False, noise: bool = True) -> Columns:
        tools, told = self.tools_of(len(readings)), self.conditions(readings)
        T = self.see(readings, told, tools)
        found = self.columns(readings, told, tools)
        x = T[:, :3, 3] + noise * self.rng.normal(0.0, SIGMA, (len(T), 3))
        found |= {f"{axis} [m]": x[:, k] for k, axis in enumerate("xyz")}
        if pose:
            turns = Rotation.from_rotvec(noise * self.rng.normal(0.0, SIGMA_ANGLE, (len(T), 3)))
            qx, qy, qz, qw = (Rotation.from_matrix(T[:, :3, :3]) * turns).as_quat().T
            found |= {"qw": qw, "qx": qx, "qy": qy, "qz": qz}
        return found

    def table(self, n: int) -> Columns:
        """One table of the kind that the job observes."""
        kind = self.draft.kind
        if kind in ("position", "pose"):
            return self.positions(self.draw(n), pose=kind == "pose")
        return getattr(self, f"_{kind}")(n)  # type: ignore[no-any-return]

    def _touched(self, points: Array, targets: NDArray[Any] | None = None) -> tuple[Columns, NDArray[np.intp], Array]:
        tools = self.tools_of(len(points))
        q, told, rows = self.reach(points, tools)
        assert len(rows) >= len(points) // 3, "the simulated places are within the arm's reach"
        found = self.columns(q, told, [tools[k] for k in rows])
        if targets is not None:
            found["target"] = targets[rows]
        return found, rows, self.see(q, told, [tools[k] for k in rows])

    def _socket(self, n: int) -> Columns:
        which = np.arange(n) % 4
        points = self.places[which] + self.rng.normal(0.0, SIGMA, (n, 3))
        return self._touched(points, np.array([f"s{k}" for k in which]))[0]

    def _distance(self, n: int) -> Columns:
        q, tools = self.draw(n), self.tools_of(n)
        told, which = self.conditions(q), np.arange(n) % 2
        x = self.see(q, told, tools)[:, :3, 3]
        length = np.linalg.norm(x - self.places[which], axis=1) + self.rng.normal(0.0, SIGMA, n)
        length += LENGTH_OFFSET * (self.draft.known == "length")
        return self.columns(q, told, tools) | {"target": np.array(["s0", "s1"])[which], "length [m]": length}

    def _pair_distance(self, n: int) -> Columns:
        q, tools = self.draw(2 * n), self.tools_of(2 * n)
        told = self.conditions(q)
        x = self.see(q, told, tools)[:, :3, 3].reshape(n, 2, 3)
        length = np.linalg.norm(x[:, 0] - x[:, 1], axis=1) + self.rng.normal(0.0, SIGMA, n)
        length += LENGTH_OFFSET * (self.draft.known == "length")
        names = np.array([f"p{k}" for k in range(n)])
        return self.columns(q, told, tools) | {"pair": np.repeat(names, 2), "length [m]": np.repeat(length, 2)}

    def _plane(self, n: int) -> Columns:
        which, spread = np.arange(n) % 2, self.rng.uniform(-0.12, 0.12, (n, 3))
        normals = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
        spread -= np.sum(spread * normals[which], axis=1, keepdims=True) * normals[which]
        noise = self.rng.normal(0.0, SIGMA, (n, 1))
        points = self.places[which] + spread + (BALL + noise) * normals[which]
        found, rows, _ = self._touched(points, np.array(["s0", "s1"])[which])
        return found | {"ball [m]": np.full(len(rows), 2.0 * BALL)}

    def _sphere(self, n: int) -> Columns:
        which, way = np.arange(n) % 2, self.rng.normal(size=(n, 3))
        radius = 0.02 + BALL + self.rng.normal(0.0, SIGMA, (n, 1))
        points = self.places[which] + radius * way / np.linalg.norm(way, axis=1, keepdims=True)
        found, rows, _ = self._touched(points, np.array(["s0", "s1"])[which])
        if self.draft.known != "length":
            found["diameter [m]"] = np.full(len(rows), 0.04)
        return found | {"ball [m]": np.full(len(rows), 2.0 * BALL)}

    def _indicator(self, n: int) -> Columns:
        q, tools = self.draw(n), self.tools_of(n)
        told = self.conditions(q)
        x = self.see(q, told, tools)[:, :3, 3]
        shown = x @ np.array([0.6, 0.0, 0.8]) - 0.4 + self.rng.normal(0.0, SIGMA, n)
        return self.columns(q, told, tools) | {"target": np.array(["s0"] * n), "indicated [m]": shown}

    def camera(self) -> calib.measuring.Camera:
        lens = {key: float(str(CAMERA[key]).split()[0]) for key in ("fx", "fy", "cx", "cy", "k1")}
        return calib.measuring.Camera("floor", **lens)

    def _pixels(self, n: int) -> Columns:
        q, tools = self.draw(n), self.tools_of(n)
        told, which = self.conditions(q), np.arange(n) % 2
        T = self.see(q, told, tools)
        seen = np.empty((n, 2))
        for k in range(2):
            own = which == k
            points = (rigid.inverse(_view(self.truth.base, k)) @ T[own])[:, :3, 3]
            seen[own] = project(self.camera().lens, points).pixels
        seen += self.rng.normal(0.0, SIGMA_PIXEL, seen.shape)
        columns = self.columns(q, told, tools) | {"target": np.array(["s0", "s1"])[which]}
        return columns | {"u [px]": seen[:, 0], "v [px]": seen[:, 1]}

    def nodes(self) -> Columns:
        q = np.full((9, len(self.robot.readings)), 0.25)
        q[:, 0], q[:, 1] = (axis.ravel() for axis in np.meshgrid([-1.5, 0.0, 1.5], [-0.8, 0.0, 0.8], indexing="ij"))
        return self.positions(q)


def build(features: Sequence[Feature], folder: Path, seed: int = 0) -> Case:
    """Write the files of a job with these features."""
    draft = Draft()
    for feature in features:
        feature.apply(draft)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.urdf").write_text(draft.urdf, encoding="utf-8")
    path = folder / "job.toml"
    path.write_text(toml(_job(draft, np.zeros((4, 3)))), encoding="utf-8")
    robot = load_arm(path).robot
    alone = draft.kind in ("socket", "pixels")
    base = np.eye(4) if alone and draft.error_model["base"] == "pose" else BASE
    places = (base @ robot.tips(BEFORE[:, : len(robot.readings)]) @ _tool(draft, 0))[:, :3, 3]
    if draft.kind == "distance":
        places = base[:3, 3] + np.array([[0.9, 0.8, -0.2], [-0.7, 0.9, 0.3]])
    job = _job(draft, places, base)
    path.write_text(toml(job), encoding="utf-8")
    arm = load_arm(path)
    rng = np.random.default_rng(seed)
    model, tools = arm.model, draft.tools
    robot = model.robot
    placed = {name: _tool(draft, k) for k, name in enumerate(tools)}
    frames = Frames(base[None], np.stack([placed[name] for name in tools]))
    parameters = [p for p in model.parameters(tools) if p.of_robot]
    sizes = [_size(p.name, p.unit, p.typical_size if p.kind == "term" else None) for p in parameters]
    x = values_at(robot, parameters, frames) + rng.normal(0.0, sizes)
    d = machine(robot, parameters, frames, x).deviations
    if draft.error_model.get("terms") == "auto":
        second = _roles(draft)["@second"]
        robot = replace(robot, terms=(JointTerm(second, "gain"), JointTerm(second, "backlash")))
        d = Deviations(d.placements, d.offsets, np.array([2e-3, 1e-3]))
    case = Case(path, draft, arm.robot, calib.CalibratedMachine(robot, d, base, placed), not alone, rng, places)
    for section in job["measurements"]:
        file = section["file"]
        n = FRESH if section["use"] == "validate" else ROWS
        n *= 2 if section["observes"] == "pixels" else 1  # two numbers a row, and two cameras
        if file == "nodes.csv":
            columns = case.nodes()
        elif file.startswith("positions"):
            columns = case.positions(case.draw(n))
        else:
            columns = case.table(n)
        write(folder / file, _with_noise(columns, draft, section), section.get("columns"))
    return case


BASE = rigid.placement(Rotation.from_rotvec([0.02, -0.03, 0.6]).as_matrix(), np.array([2.1, -0.4, 0.8]))
TOOLS = [
    rigid.placement(Rotation.from_rotvec([0.1, 0.2, -0.1]).as_matrix(), np.array([0.03, 0.01, 0.08])),
    rigid.placement(Rotation.from_rotvec([-0.2, 0.1, 0.3]).as_matrix(), np.array([-0.02, 0.03, 0.06])),
]


def _view(base: Array, k: int) -> Array:
    """Where one of two cameras stands that look at the arm's middle, in the instrument's frame."""
    stand = np.array(([5.0, 0.0, 1.0], [0.5, 5.0, 1.5])[k])
    z = np.array([0.3, 0.0, 0.6]) - stand
    z = z / np.linalg.norm(z)
    x = np.cross([0.0, 0.0, 1.0], z)
    x = x / np.linalg.norm(x)
    return np.asarray(base @ rigid.placement(np.column_stack([x, np.cross(z, x), z]), stand))


def _tool(draft: Draft, k: int) -> Array:
    """The pose of a tool; where its position alone is sought, it is turned as the tip link is."""
    return rigid.placement(np.eye(3), TOOLS[k][:3, 3]) if draft.error_model["tool"] == "position" else TOOLS[k]


def _size(name: str, unit: str, typical_size: float | None) -> float:
    if typical_size is not None:
        return typical_size
    if name.endswith(".offset"):
        return 3e-3 if unit == "rad" else 3e-4
    return 5e-4 if unit == "rad" else 3e-4


def _roles(draft: Draft) -> Mapping[str, str]:
    return ROLES["loop" if draft.arm == "loop" else "turning"]


def _named(value: Any, roles: Mapping[str, str]) -> Any:
    return [roles.get(name, name) for name in value] if isinstance(value, list) else value


def _job(draft: Draft, places: Array, base: Array = BASE) -> dict[str, Any]:
    roles = _roles(draft)
    error_model = {key: _named(value, roles) for key, value in draft.error_model.items()}
    if draft.geometry == "all":
        # Of a mechanism, what carries the tip; most of the rest cannot be told apart.
        placements = ["turret", "lower", "roll", "tip"] if draft.arm == "loop" else "all"
        error_model |= {"offsets": "all", "placements": placements}
    elif draft.geometry == "dh":
        error_model |= {"dh": "all", "dh_convention": "modified"}
    else:
        error_model |= {"offsets": [roles["@second"], roles["@wrist"]]}
    job: dict[str, Any] = {"schema": 1, "robot": draft.robot, "error_model": error_model, **draft.job}
    if error_model.get("base") == "fixed":
        job["base"] = _frame(BASE)
    if error_model.get("tool") == "fixed":
        job["tools"] = {name: _frame(_tool(draft, k)) for k, name in enumerate(draft.tools)}
    job["instruments"] = {}
    if draft.noise == "tracker":
        job["instruments"]["tracker"] = {
            "kind": "laser_tracker",
            "sigma": "1.5 um",
            "sigma_per_metre": "0.1 um",
            "station": ["0 m", "0 m", "0 m"],
        }
    if draft.kind == "pixels":
        sigma = "0 px" if draft.noise in ("estimated", "column") else f"{SIGMA_PIXEL} px"
        job["instruments"]["eye"] = {"kind": "camera", "sigma": sigma, **CAMERA}
    _know(draft, job, places, base)
    sections = []
    for use in ("identify", *(["validate"] if draft.judge == "validate" else [])):
        if draft.beside_positions:
            sections.append(_section(draft, f"positions_{use}.csv", "position", use))
        sections.append(_section(draft, f"{use}.csv", draft.kind, use))
    if draft.levels == "grid":
        sections.append(_section(draft, "nodes.csv", "position", "nodes"))
    job["measurements"] = sections
    files = [section["file"] for section in sections if section["use"] == "identify"]
    if draft.levels:
        job["levels"] = [
            {"name": "zeros", "free": ["*.offset"], "measurements": files[:1]},
            {"name": "all", "free": ["*"]},
        ]
    if draft.levels == "grid":
        job["levels"].append(
            {
                "name": "rest",
                "residual_model": {"kind": "grid", "joints": [roles["@first"], roles["@second"]], "frame": "base"},
                "measurements": ["nodes.csv"],
            }
        )
    elif draft.levels == "gaussian":
        job["levels"].append({"name": "rest", "residual_model": {"kind": "gaussian_process", "frame": "tip"}})
    return job


def _know(draft: Draft, job: dict[str, Any], places: Array, base: Array) -> None:
    """What the job knows of targets, which are at ``places`` in the instrument's frame."""
    if draft.kind == "indicator":
        job["targets"] = {"s0": {"normal": [0.6, 0.0, 0.8], "height": "0.4 m"}}
        if draft.known == "renamed":
            job["targets"] = {"here": job["targets"]["s0"]}
    if draft.known == "targets":
        if draft.kind == "plane":
            job["targets"] = {"s0": {"normal": [0.0, 0.0, 1.0], "height": f"{float(places[0, 2])!r} m"}}
        elif draft.kind == "pixels":
            job["targets"] = {"s0": _frame(_view(base, 0))}
        elif draft.kind != "indicator":
            job["targets"] = {"s0": {"position": [f"{float(v)!r} m" for v in places[0]]}}
    if draft.known == "relation":
        if draft.kind == "plane":
            value = {"angle": f"{float(np.arccos(0.8))!r} rad", "sigma": "1 urad"}
        else:
            value = {"distance": f"{float(np.linalg.norm(places[0] - places[1]))!r} m", "sigma": "1 um"}
        job["relations"] = [{"targets": ["s0", "s1"], **value}]


def _section(draft: Draft, file: str, kind: str, use: str) -> dict[str, Any]:
    found: dict[str, Any] = {"file": file, "observes": kind, "use": use}
    own = {**draft.section}
    if use != "identify":
        own = {key: value for key, value in own.items() if key == "in_order"}
    found |= own
    touching = kind not in ("position", "pose", "pixels")
    if (
        draft.noise == "tracker"
        and (kind == draft.kind or kind == "position")
        and not (touching and draft.beside_positions)
    ):
        found["instrument"] = "tracker"
    elif draft.noise not in ("column", "estimated") and kind != "pixels":
        found["sigma"] = f"{SIGMA!r} m"
    if kind == "pixels" and "instrument" not in found:
        found["instrument"] = "eye"
    if kind == "pose" and draft.noise not in ("column", "estimated"):
        found["sigma_angle"] = f"{SIGMA_ANGLE!r} rad"
    if draft.noise == "model" and use == "identify":
        found["model_sigma"] = "0.002 px" if kind == "pixels" else "1 um"
        if kind == "pose":
            found["model_sigma_angle"] = "1 urad"
    if draft.known == "renamed" and kind == draft.kind:
        found["targets"] = {"s0": "here"}
    if draft.known == "length" and kind == draft.kind:
        found["length_offset"] = "probe"
    if draft.renamed:
        joint = _roles(draft)["@first"]
        found["columns"] = {f"{joint} [deg]": "axis one"}
    return found


def _with_noise(columns: Columns, draft: Draft, section: Mapping[str, Any]) -> Columns:
    if draft.noise != "column":
        return columns
    n = len(next(iter(columns.values())))
    more: Columns = {"sigma [px]": np.full(n, SIGMA_PIXEL)}
    if section["observes"] != "pixels":
        more = {"sigma [m]": np.full(n, SIGMA)}
    if section["observes"] == "pose":
        more["sigma_angle [rad]"] = np.full(n, SIGMA_ANGLE)
    return columns | more


def write(path: Path, columns: Columns, renamed: Mapping[str, str] | None = None) -> None:
    """Write a table; numbers with all their digits."""
    titles = [(renamed or {}).get(name, name) for name in columns]
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(titles)
        writer.writerows(zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True))


def _frame(T: Array) -> dict[str, Any]:
    return {
        "position": [f"{float(v)!r} m" for v in T[:3, 3]],
        "quaternion": rigid.quaternion_of(T[:3, :3]).tolist(),
    }


def toml(job: Mapping[str, Any]) -> str:
    """A job as TOML: every value in one line."""

    def value(v: Any) -> str:
        if isinstance(v, Mapping):
            return "{ " + ", ".join(f"{json.dumps(k)} = {value(w)}" for k, w in v.items()) + " }"
        if isinstance(v, list | tuple):
            return "[" + ", ".join(map(value, v)) + "]"
        return json.dumps(v)

    return "".join(f"{key} = {value(v)}\n" for key, v in job.items() if v != {})
