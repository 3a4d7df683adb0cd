"""A job with given features, its files, and the machine whose measurements they hold.

The machine is the job's own robot with deviations drawn at random: that kinematics, terms and loops are right, others
tests show; these ask whether everything reaches everything.
"""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib
from calib.compensation.commands import for_poses
from calib.foundations import rigid
from calib.identification.machine import Frames, machine, values_at
from calib.job.stated import load_arm
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
TORQUE_OFFSET = 3.0
OFFSET, SKEW, MIDDLE, LATENCY = 3.2, 2e-4, 10.0, 0.03
SIDE = 0.03
MARKS = SIDE * np.array([(i, j, 0.0) for j in range(1, 4) for i in range(1, 5)])
WALL = (1.0, 2.0, -9.5)
CAMERA = {"camera_on": "floor", "fx": "1200 px", "fy": "1190 px", "cx": "640 px", "cy": "500 px", "k1": -0.05}


class Rows(NamedTuple):
    """What N rows have beside what was measured: readings (N, nr), conditions, names, and points (N, 3) of tools."""

    readings: Array
    told: Conditions
    tools: list[str]
    setups: list[str]
    points: Array

    def subset(self, rows: NDArray[np.intp]) -> "Rows":
        tools, setups = [self.tools[k] for k in rows], [self.setups[k] for k in rows]
        return Rows(self.readings[rows], self.told.subset(rows), tools, setups, self.points[rows])


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
    def modelled_badly(self) -> bool:
        """Whether what is calibrated cannot be the machine: a field, a minimal set."""
        return self.field or self.draft.error_model["null_space"] == "minimal"

    @property
    def places_of_touch(self) -> Array:
        """Points (4, 3) before the arm, in the instrument's frame."""
        tool = self.truth.tools[self.draft.tools[0]]
        return np.asarray((self.truth.base @ self.robot.tips(BEFORE[:, : len(self.robot.readings)]) @ tool)[:, :3, 3])

    @property
    def setups(self) -> tuple[str, ...]:
        """The names of the places where the robot stood, as the machine has them."""
        return tuple(self.truth.bases)

    def tools_of(self, n: int) -> list[str]:
        return [self.draft.tools[k // 4 % len(self.draft.tools)] for k in range(n)]

    def rows(self, readings: Array, conditions: Conditions | None = None, tools: Sequence[str] = ()) -> "Rows":
        """Rows at readings (N, nr): every tool and every place in turn, points of a scanner at random."""
        n = len(readings)
        points = self.rng.uniform(-0.03, 0.03, (n, 3)) if self.draft.points else np.zeros((n, 3))
        setups = [self.setups[k // 8 % len(self.setups)] for k in range(n)]
        told = self.conditions(readings) if conditions is None else conditions
        return Rows(readings, told, list(tools) or self.tools_of(n), setups, points)

    def draw(self, n: int) -> Array:
        """Readings (N, nr) within the middle of the limits."""
        low, high = self._middle()
        return self.rng.uniform(0.7 * low, 0.7 * high, (n, len(low)))

    def _middle(self) -> tuple[Array, Array]:
        low, high = np.transpose([(r.lower or -2.0, r.upper or 2.0) for r in self.robot.readings])
        if self.draft.arm == "loop":  # crank and lower arm keep their angle
            low, high = np.array([-2.0, -0.6, -0.6, -2.0, -1.6]), np.array([2.0, 0.6, 0.6, 2.0, 1.6])
        return low, high

    def conditions(self, readings: Array) -> Conditions:
        """What the rows carry, as the draft says it."""
        n, said = len(readings), self.draft.said
        approach = self.rng.choice([-1.0, 1.0], readings.shape)
        if said == "row":
            approach = np.repeat(approach[:, :1], readings.shape[1], axis=1)
        if said == "order":
            approach = in_order(readings)
        return Conditions(approach, self.rng.uniform(12.0, 30.0, n), self.rng.normal(0.0, 20.0, readings.shape))

    def see(self, rows: "Rows") -> Array:
        """Where the points of the tools are (N, 4, 4), the field of the residual model included."""
        found = np.empty((len(rows.readings), 4, 4))
        offsets = self.torque_offsets
        told = rows.told if rows.told.torque is None else replace(rows.told, torque=rows.told.torque - offsets)
        for setup in dict.fromkeys(rows.setups):
            for tool in dict.fromkeys(rows.tools):
                own = np.array([s == setup and t == tool for s, t in zip(rows.setups, rows.tools, strict=True)])
                if not own.any():
                    continue
                machine = self.truth.at(setup)
                tips = np.array(machine.of(tool).tips(rows.readings[own], told.subset(own)))
                q = rows.readings[own]
                if self.field and tool in self.draft.tools:
                    tips[:, :3, 3] += FIELD * np.column_stack([q[:, 0], q[:, 1], q[:, 0] + q[:, 1]])
                found[own] = machine.base @ tips @ machine.tools[tool]
        found[:, :3, 3] += np.einsum("nij,nj->ni", found[:, :3, :3], rows.points)
        return found

    @property
    def field(self) -> bool:
        return self.draft.levels in ("grid", "gaussian") and self.draft.kind in ("position", "pose")

    @property
    def torque_offsets(self) -> Array:
        """What the measured torques show too much (nr,), in Nm."""
        free = self.draft.error_model.get("torque_offsets") == "free"
        return TORQUE_OFFSET * np.ones(len(self.robot.readings)) * free

    def reach(self, points: Array, tools: Sequence[str]) -> tuple["Rows", NDArray[np.intp]]:
        """Rows in which tools are at points (N, 3) in the instrument's frame, and which of them can be reached."""
        near = BEFORE[np.arange(len(points)) % 2, : len(self.robot.readings)]
        q = near + 0.2 * (self.draw(len(points)) - near)
        rows, kept = self.rows(q, tools=tools), np.arange(len(points))
        for _ in range(3 if self.draft.said == "order" else 1):
            reached, q = np.zeros(len(kept), dtype=bool), np.array(rows.readings)
            offsets = self.torque_offsets
            for setup in dict.fromkeys(rows.setups):
                own = np.array([name == setup for name in rows.setups])
                placed = {
                    str(k): self.truth.tools[rows.tools[k]] @ rigid.translation(rows.points[k])
                    for k in np.flatnonzero(own)
                }
                machine = replace(self.truth.at(setup), tools=placed, tool_tips={})
                told = rows.told.subset(own)
                told = replace(told, torque=np.asarray(told.torque) - offsets)
                found = for_poses(
                    machine,
                    points[kept][own],
                    q[own],
                    list(placed),
                    frame="instrument",
                    conditions=told,
                    tolerance=(1e-8, 1e-6),
                )
                q[own], reached[own] = found.readings, found.reached
            rows, kept = rows._replace(readings=q).subset(np.flatnonzero(reached)), kept[reached]
            if self.draft.said == "order":
                told = Conditions(in_order(rows.readings), rows.told.temperature, rows.told.torque)
                rows = rows._replace(told=told)
        return rows, kept

    # ---- tables

    def columns(self, rows: "Rows", *, of_stream: bool = False) -> Columns:
        """The columns that every table of the job has."""
        found: Columns = {} if of_stream else self.joints(rows.readings)
        conditions = rows.told
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
            found["tool"] = np.array(rows.tools)
        if len(self.setups) > 1:
            found["setup"] = np.array(rows.setups)
        if self.draft.points:
            found |= {f"point_{axis} [mm]": 1e3 * rows.points[:, k] for k, axis in enumerate("xyz")}
        return found

    def as_targets(self, rows: "Rows") -> Columns:
        """The columns of a table of targets: of no order, and of no place."""
        said, self.draft.said = self.draft.said, "each" if self.draft.said == "order" else self.draft.said
        found = self.columns(rows) | {"tool": np.array(rows.tools)}
        self.draft.said = said
        return {name: values for name, values in found.items() if name != "setup" and not name.startswith("point_")}

    def joints(self, readings: Array) -> Columns:
        units = {"angle": ("deg", np.degrees(1.0)), "length": ("mm", 1e3)}
        found: Columns = {}
        for k, reading in enumerate(self.robot.readings):
            unit, factor = units[reading.dimension]
            found[f"{reading.name} [{unit}]"] = readings[:, k] * factor
        return found

    def positions(self, readings: Array, *, pose: bool = False, tool: str = "") -> Columns:
        rows = self.rows(readings)
        rows = rows._replace(tools=[tool] * len(readings)) if tool else rows
        found = self.columns(rows) | self.placed_at(rows, pose=pose)
        if tool:
            found.pop("tool", None)
        return found

    def placed_at(self, rows: "Rows", *, pose: bool = False) -> Columns:
        """Columns of positions or poses."""
        T = self.see(rows)
        x = T[:, :3, 3] + self.rng.normal(0.0, SIGMA, (len(T), 3))
        found: Columns = {f"{axis} [m]": x[:, k] for k, axis in enumerate("xyz")}
        if pose:
            turns = Rotation.from_rotvec(self.rng.normal(0.0, SIGMA_ANGLE, (len(T), 3)))
            qx, qy, qz, qw = (Rotation.from_matrix(T[:, :3, :3]) * turns).as_quat().T
            found |= {"qw": qw, "qx": qx, "qy": qy, "qz": qz}
        return found

    def stream(self, n: int, start: float, *, pose: bool = False) -> tuple[Columns, Columns]:
        """What tracker and controller write down, each by its own clock, while the arm moves; a rest at every change.

        The first reading of the controller's clock is at ``start`` in s.
        """
        low, high = self._middle()
        parts = [
            (self.draft.tools[k % len(self.draft.tools)], self.setups[k % len(self.setups)])
            for k in range(max(len(self.draft.tools), len(self.setups)))
        ]
        each = n // len(parts)
        rate, joint_rate = 5.0, 40.0  # of every part some stretches that go together when rows are held out
        wave = self.rng.uniform(0.6, 1.6, (2, len(low), 4))
        phase = self.rng.uniform(0.0, 6.0, (len(low), 4))
        middle, swing = 0.5 * (low + high), 0.3 * (high - low)

        def at(t: Array, derivative: int = 0) -> Array:
            arms = np.multiply.outer(t, wave[0]) + phase + 0.5 * np.pi * derivative
            return np.asarray(
                (derivative == 0) * middle + swing * np.mean(wave[0] ** derivative * np.sin(arms), axis=-1)
            )

        stamps = np.arange(start, start + (each / rate + 3.0) * len(parts), 1.0 / joint_rate)
        starts = start + 1.0 + (each / rate + 3.0) * np.arange(len(parts))
        true = (starts[:, None] + np.arange(each) / rate).ravel()
        q = at(true)
        told = replace(self.conditions(q), motion=np.stack([at(true, 1), at(true, 2)], axis=1))
        rows = self.rows(q, told)
        rows = rows._replace(points=np.repeat(rows.points[:1], len(q), axis=0))  # a scanner's one spot
        rows = rows._replace(
            tools=[parts[k // each][0] for k in range(len(q))], setups=[parts[k // each][1] for k in range(len(q))]
        )
        clock = true + LATENCY if self.draft.motion == "late" else true + OFFSET + SKEW * (true - MIDDLE)
        seen = {"time [s]": clock} | self.columns(rows, of_stream=True) | self.placed_at(rows, pose=pose)
        return seen, {"time [s]": stamps} | self.joints(at(stamps))

    def table(self, n: int) -> Columns:
        """One table of the kind that the job observes."""
        kind = self.draft.kind
        if kind in ("position", "pose"):
            return self.positions(self.draw(n), pose=kind == "pose")
        if self.draft.board:
            return self._board(n)
        return getattr(self, f"_{kind}")(n)  # type: ignore[no-any-return]

    def _touched(self, points: Array, targets: NDArray[Any] | None = None) -> tuple[Columns, NDArray[np.intp]]:
        rows, kept = self.reach(points, self.tools_of(len(points)))
        assert len(kept) >= len(points) // 3, "the simulated places are within the arm's reach"
        found = self.columns(rows)
        if targets is not None:
            found["target"] = targets[kept]
        return found, kept

    def carried(self, points: Array, setups: Sequence[str]) -> Array:
        """Points (N, 3), in the frame of their carrier, in the instrument's: the floor, or the robot's first link."""
        if self.draft.known != "link":
            return points
        placed = self.truth.bases
        first = placed[self.setups[0]]
        local = (points - first[:3, 3]) @ first[:3, :3]
        return np.stack([placed[name][:3, :3] @ x + placed[name][:3, 3] for x, name in zip(local, setups, strict=True)])

    def _socket(self, n: int) -> Columns:
        which = np.arange(n) % 4
        setups = [self.setups[k // 8 % len(self.setups)] for k in range(n)]
        points = self.carried(self.places[which], setups) + self.rng.normal(0.0, SIGMA, (n, 3))
        return self._touched(points, np.array([f"s{k}" for k in which]))[0]

    def _distance(self, n: int) -> Columns:
        rows, which = self.rows(self.draw(n)), np.arange(n) % 2
        x = self.see(rows)[:, :3, 3]
        length = np.linalg.norm(x - self.carried(self.places[which], rows.setups), axis=1)
        length += self.rng.normal(0.0, SIGMA, n) + LENGTH_OFFSET * (self.draft.known == "length")
        return self.columns(rows) | {"target": np.array(["s0", "s1"])[which], "length [m]": length}

    def _pair_distance(self, n: int) -> Columns:
        rows = self.rows(self.draw(2 * n))
        x = self.see(rows)[:, :3, 3].reshape(n, 2, 3)
        length = np.linalg.norm(x[:, 0] - x[:, 1], axis=1) + self.rng.normal(0.0, SIGMA, n)
        length += LENGTH_OFFSET * (self.draft.known == "length")
        names = np.array([f"p{k}" for k in range(n)])
        return self.columns(rows) | {"pair": np.repeat(names, 2), "length [m]": np.repeat(length, 2)}

    def _plane(self, n: int) -> Columns:
        which, spread = np.arange(n) % 2, self.rng.uniform(-0.12, 0.12, (n, 3))
        normals = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
        spread -= np.sum(spread * normals[which], axis=1, keepdims=True) * normals[which]
        noise = self.rng.normal(0.0, SIGMA, (n, 1))
        setups = [self.setups[k // 8 % len(self.setups)] for k in range(n)]
        points = self.carried(self.places[which] + spread + (BALL + noise) * normals[which], setups)
        found, rows = self._touched(points, np.array(["s0", "s1"])[which])
        return found | {"ball [m]": np.full(len(rows), 2.0 * BALL)}

    def _sphere(self, n: int) -> Columns:
        which, way = np.arange(n) % 2, self.rng.normal(size=(n, 3))
        radius = 0.02 + BALL + self.rng.normal(0.0, SIGMA, (n, 1))
        setups = [self.setups[k // 8 % len(self.setups)] for k in range(n)]
        points = self.places[which] + radius * way / np.linalg.norm(way, axis=1, keepdims=True)
        found, rows = self._touched(self.carried(points, setups), np.array(["s0", "s1"])[which])
        if self.draft.known != "length":
            found["diameter [m]"] = np.full(len(rows), 0.04)
        return found | {"ball [m]": np.full(len(rows), 2.0 * BALL)}

    def _indicator(self, n: int) -> Columns:
        rows = self.rows(self.draw(n))
        x = self.see(rows)[:, :3, 3]
        if self.draft.known == "link":  # its normal and its height are in the link's frame
            bases = np.linalg.inv(np.stack([self.truth.bases[name] for name in rows.setups]))
            x = np.einsum("nij,nj->ni", bases[:, :3, :3], x) + bases[:, :3, 3]
        shown = x @ np.array([0.6, 0.0, 0.8]) - 0.4 + self.rng.normal(0.0, SIGMA, n)
        return self.columns(rows) | {"target": np.array(["s0"] * n), "indicated [m]": shown}

    def _pixels(self, n: int) -> Columns:
        rows, which = self.rows(self.draw(n)), np.arange(n) % 2
        T = self.see(rows)
        seen = np.empty((n, 2))
        for k in range(2):
            own = which == k
            # Of a camera that stands on a link, at each place of the robot.
            first = self.truth.bases[self.setups[0]]
            moved = [self.truth.bases[name] if self.draft.known == "link" else first for name in rows.setups]
            views = np.linalg.inv(np.stack(moved) @ np.linalg.inv(first) @ _view(first, k))[own]
            seen[own] = _pinhole(np.einsum("nij,nj->ni", views[:, :3, :3], T[own][:, :3, 3]) + views[:, :3, 3])
        seen += self.rng.normal(0.0, SIGMA_PIXEL, seen.shape)
        columns = self.columns(rows) | {"target": np.array(["s0", "s1"])[which]}
        return columns | {"u [px]": seen[:, 0], "v [px]": seen[:, 1]}

    def _board(self, n: int) -> Columns:
        """Photographs by the tool, which is a camera, of a board before it: n marks of which each has some."""
        low, high = self._middle()
        home = BEFORE[0, : len(low)]
        many = len(MARKS)
        q = home + 0.2 * self.rng.uniform(-1.0, 1.0, (n // 4, len(low))) * np.minimum(1.0, high - low)
        photos = self.rows(q)._replace(points=np.zeros((len(q), 3)))
        eyes, board = np.linalg.inv(self.see(photos)), board_of(self.truth, home, self.draft)
        rows = photos.subset(np.repeat(np.arange(len(q)), many))
        marks = np.tile(MARKS, (len(q), 1))
        there = self.carried(marks @ board[:3, :3].T + board[:3, 3], rows.setups)
        eyes = np.repeat(eyes, many, axis=0)
        x = np.einsum("nij,nj->ni", eyes[:, :3, :3], there) + eyes[:, :3, 3]
        assert (x[:, 2] > 0.2).all(), "the board is before the camera"
        seen = _pinhole(x, 0.8) + self.rng.normal(0.0, SIGMA_PIXEL, (len(x), 2))
        columns = self.columns(rows) | {"target": np.array(["s0"] * len(x))}
        columns |= {"u [px]": seen[:, 0], "v [px]": seen[:, 1]}
        return columns | {f"board_{axis} [mm]": 1e3 * marks[:, k] for k, axis in enumerate("xyz")}

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
    alone = draft.kind in ("socket", "pixels") and not draft.motion and not draft.elbow
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
    first, *others = draft.places
    named = {"setup": first} if first else {}
    carried = {ELBOW: _elbow(draft)} if draft.elbow else {}
    truth = calib.CalibratedMachine(
        robot,
        d,
        base,
        placed | ({ELBOW: ELBOW_TOOL} if draft.elbow else {}),
        others=dict.fromkeys(others, base @ STEP),
        tool_tips=carried,
        **named,
    )
    case = Case(path, draft, arm.robot, truth.at(first) if first else truth, not alone, rng, places)
    (folder / "gantry.urdf").write_text(GANTRY, encoding="utf-8")
    (folder / "board.toml").write_text(BOARD, encoding="utf-8")
    start = 0.0
    for section in job["measurements"]:
        file = section["file"]
        n = FRESH if section["use"] == "validate" else ROWS
        n *= 2 if section["observes"] == "pixels" else 1  # two numbers a row, and two cameras
        if "readings" in section:
            columns, joints = case.stream(STREAMED[section["use"]], start, pose=section["observes"] == "pose")
            start += 100.0
            write(folder / section["readings"], joints)
        elif file == "nodes.csv":
            columns = case.nodes()
        elif file.startswith("elbow"):
            columns = case.positions(case.draw(n), tool=ELBOW)
        elif file.startswith("positions"):
            columns = case.positions(case.draw(n))
        else:
            columns = case.table(n)
        if "ignore" in section:
            columns |= {"remark": np.array(["good"] * len(next(iter(columns.values()))))}
        if section.get("instrument") == "probe":
            columns = {TO_GANTRY.get(name, name): values for name, values in columns.items()}
        write(folder / file, _with_noise(columns, draft, section), section.get("columns"))
    return case


STREAMED = {"identify": 160, "validate": 80}
ELBOW, ELBOW_TOOL = "ball on the elbow", rigid.translation(np.array([0.02, 0.07, 0.03]))
STEP = rigid.placement(Rotation.from_rotvec([0.01, 0.02, 0.12]).as_matrix(), np.array([0.03, -0.04, 0.02]))
BOARD = f'kind = "chessboard"\nsquares = [5, 4]\nsquare = "{SIDE} m"\nsquare_sigma = 0.0\nshape = "flat"\n'
TO_GANTRY = {f"{axis} [m]": f"rail_{axis} [m]" for axis in "xyz"}


def _gantry() -> str:
    """Three rails in line with the axes: their readings are where the probe is."""
    links = ["ground", "along_x", "along_y", "probe"]
    joints = [
        f'<joint name="rail_{axis}" type="prismatic"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{way}"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
        for axis, parent, child, way in zip("xyz", links, links[1:], ("1 0 0", "0 1 0", "0 0 1"), strict=False)
    ]
    return f'<robot name="gantry">{"".join(f"""<link name="{link}"/>""" for link in links)}{"".join(joints)}</robot>'


GANTRY = _gantry()
BASE = rigid.placement(Rotation.from_rotvec([0.02, -0.03, 0.6]).as_matrix(), np.array([2.1, -0.4, 0.8]))
TOOLS = [
    rigid.placement(Rotation.from_rotvec([0.1, 0.2, -0.1]).as_matrix(), np.array([0.03, 0.01, 0.08])),
    rigid.placement(Rotation.from_rotvec([-0.2, 0.1, 0.3]).as_matrix(), np.array([-0.02, 0.03, 0.06])),
]


def _elbow(draft: Draft) -> str:
    return "elbow" if draft.arm == "loop" else "link_3"


def _pinhole(points: Array, longer: float = 0.0) -> Array:
    """Pixels (N, 2) of points (N, 3) in a camera's frame; its focal lengths are ``longer`` than the job says, in px."""
    fx, fy, cx, cy = (float(str(CAMERA[key]).split()[0]) for key in ("fx", "fy", "cx", "cy"))
    flat = points[:, :2] / points[:, 2:]
    bent = flat * (1.0 + float(str(CAMERA["k1"])) * np.sum(flat**2, axis=1, keepdims=True))
    return np.asarray(bent * [fx + longer, fy + longer] + [cx, cy])


def board_of(truth: calib.CalibratedMachine, home: Array, draft: Draft) -> Array:
    """Where the board is (4, 4): 0.7 m before the camera at ``home``, by the nominal arm, and turned a little."""
    before = rigid.placement(Rotation.from_rotvec([0.2, -0.3, 0.1]).as_matrix(), np.array([-0.05, -0.03, 0.7]))
    base = truth.bases[next(iter(truth.bases))]
    return np.asarray(base @ truth.robot.tips(home[None])[0] @ truth.tools[draft.tools[0]] @ before)


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
        error_model |= {"dh": "all", "dh_convention": "modified", "dh_parallel": "0.02 rad"}
    else:
        error_model |= {"offsets": [roles["@second"], roles["@wrist"]]}
    if draft.placed_by == "load":  # moments of links of unknown masses are those of one load
        error_model.pop("moments", None)
    job: dict[str, Any] = {"schema": 1, "robot": draft.robot, "error_model": error_model, **draft.job}
    if error_model.get("base") == "fixed":
        job["base"] = _frame(BASE)
    if error_model.get("tool") == "fixed":
        job["tools"] = {name: _frame(_tool(draft, k)) for k, name in enumerate(draft.tools)}
        if draft.elbow:
            job["tools"][ELBOW] = _frame(ELBOW_TOOL)
    _place(draft, job, base)
    job["instruments"] = {}
    if draft.noise == "tracker":
        job["instruments"]["tracker"] = {
            "kind": "laser_tracker",
            "sigma": "1.5 um",
            "sigma_per_metre": "0.1 um",
            "station": ["0 m", "0 m", "0 m"],
        }
    if draft.noise == "arm":
        job["instruments"]["probe"] = {
            "kind": "arm",
            "sigma": f"{SIGMA!r} m",
            "urdf": "gantry.urdf",
            "tip": "probe",
            "point": ["0 m", "0 m", "0 m"],
        }
    if draft.kind == "pixels":
        sigma = "0 px" if draft.noise in ("estimated", "column", "axes") else f"{SIGMA_PIXEL} px"
        job["instruments"]["eye"] = {"kind": "camera", "sigma": sigma, **CAMERA}
        if draft.board:
            job["instruments"]["eye"] |= {
                "camera_on": "tip",
                "lens": ["fx", "fy"],
                "lens_sigma": {"fx": "2 px", "fy": "2 px"},
                "size": [1280, 1000],
            }
    _know(draft, job, places, base)
    sections = []
    for use in ("identify", *(["validate"] if draft.judge == "validate" else [])):
        if draft.beside_positions or (draft.motion and draft.kind not in ("position", "pose")):
            sections.append(_section(draft, f"positions_{use}.csv", "position", use))
        sections.append(_section(draft, f"{use}.csv", draft.kind, use))
        if draft.elbow:
            sections.append(_section(draft, f"elbow_{use}.csv", "position", use))
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
    if draft.known == "link":
        job["targets"] = {**job.get("targets", {}), "s0": {**job.get("targets", {}).get("s0", {}), "on": "base"}}
        if draft.kind != "indicator" and not draft.board:
            job["targets"]["s1"] = {"on": "base"}
        if draft.kind == "socket":
            job["targets"] |= {name: {"on": "base"} for name in ("s2", "s3")}
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
    elif draft.noise == "arm" and (kind == "position" or (kind == draft.kind and not draft.beside_positions)):
        found["instrument"] = "probe"
    elif draft.noise not in ("column", "axes", "estimated") and kind != "pixels":
        found["sigma"] = f"{SIGMA!r} m"
    if kind == "pixels" and "instrument" not in found:
        found["instrument"] = "eye"
    if kind == "pose" and draft.noise not in ("column", "axes", "estimated"):
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
    if file.startswith("elbow"):
        found |= {"tip": _elbow(draft), "tool": ELBOW}
    elif draft.motion and kind in ("position", "pose") and use != "nodes":
        found |= {"readings": f"joints_{file}", "gap": "0.3 s"}
        if draft.motion == "late":
            found |= {"clock": "given", "latency": "free"}
        elif use == "identify":
            found["clock"] = "free"
        else:
            found["clock_of"] = file.replace("validate", "identify")
        if draft.renamed:
            found["columns"] = {"x [m]": "east"}
    if kind == "pixels" and draft.board:
        found["board"] = "board.toml"
    return found


def _place(draft: Draft, job: dict[str, Any], base: Array) -> None:
    """What the job knows of the places where the robot stood."""
    if len(draft.places) < 2:
        return
    fixed = job["error_model"].get("base") == "fixed"
    job.pop("base", None)
    setups: dict[str, dict[str, Any]] = {name: {} for name in draft.places}
    for name, T in zip(draft.places, (base, base @ STEP), strict=True):
        if fixed:
            setups[name] |= _frame(T)
        elif draft.placed_by == "prior":
            setups[name] |= _frame(T) | {"prior": {"length": "2 mm", "angle": "2 mrad"}}
    if draft.placed_by == "load":
        setups[draft.places[1]] |= {
            "gravity": [f"{g} m/s2" for g in WALL],
            "payload": {"mass": "2 kg", "position": ["0.01 m", "0.03 m", "0 m"], "link": "tip"},
        }
    job["setups"] = {name: known for name, known in setups.items() if known}


def _with_noise(columns: Columns, draft: Draft, section: Mapping[str, Any]) -> Columns:
    if draft.noise not in ("column", "axes"):
        return columns
    n = len(next(iter(columns.values())))
    if draft.noise == "axes" and section["observes"] in ("position", "pose", "socket"):
        more: Columns = {f"sigma_{axis} [m]": np.full(n, SIGMA) for axis in "xyz"}
        if section["observes"] == "pose":
            more |= {f"sigma_r{axis} [rad]": np.full(n, SIGMA_ANGLE) for axis in "xyz"}
        return columns | more
    more = {"sigma [px]": np.full(n, SIGMA_PIXEL)}
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
