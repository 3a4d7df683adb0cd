"""Random sessions of known truth, to judge calib's solver by: one family for every robot and way of measuring.

    case(seed, family)       a session: the truth, what was measured, and what calib is told

The truth is made by :mod:`scripts.development.judge_machines`. Joint zeros are off by up to 6 deg, placements by up to
5 mm and as many mrad; noise is 0.02 to 0.2 mm, stated or not; there are 3 to 30 rows.
"""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from calib.identification.relations import Relation
from calib.identification.targets import Target
from scripts.development.judge_machines import (
    COMPONENTS,
    POSE,
    Arm,
    Array,
    Distance,
    Layout,
    Lens,
    Rows,
    State,
    arm,
    inverse,
    placed,
    predict,
    rx_ry_rz,
)

ROOT = Path(__file__).resolve().parents[2]
UR5 = ("example:ur_description/urdf/ur5_robot.urdf", "tool0")
PANDA = ("example:panda_description/urdf/panda.urdf", "panda_hand_tcp")
ARM_CMM = (str(ROOT / "robots" / "arm_cmm" / "arm_cmm.urdf"), "probe")
IRB2400 = (str(ROOT / "robots" / "irb2400" / "irb2400.urdf"), "tool0")
LOOP = calib.ClosedLoop("parallelogram", ("rod_end", "rear_lever_pin"), ("x", "z"), ("elbow", "rod"))
# Tilts between the shafts of crank and lower arm are not among them: of those that the arm itself does not show,
# nothing but their squares shows, so that either sign is a minimum.
OF_LOOP = (
    *("joint_1", "joint_2.t?", "joint_2.ry", "joint_3.t?", "joint_4", "joint_5", "joint_6"),
    *("elbow_cancel", "rod_length.tz", "rear_lever_length.tx"),
)
BOARD = np.array([(0.03 * i, 0.03 * j, 0.0) for i in range(5) for j in range(4)])
LENS = {"fx": 1395.2, "fy": 1393.8, "cx": 648.3, "cy": 505.9, "k1": -0.1124, "k2": 0.1387, "p1": 3.1e-4, "p2": -4.7e-4}
UNSEEN = 200
# Standard deviations of lengths (m) and angles (rad) that are stated with some of the sockets.
SOCKETS_PRIOR = (1e-3, 5e-3)


@dataclass(frozen=True)
class Case:
    """A session. ``truth`` (p,): of the free parameters, whose ``layout`` has what is fixed at what calib is told.

    ``sigmas``: true noise of every component of ``rows``; ``stated``: whether calib is told. ``priors``: standard
    deviations for lengths and angles of the robot, or None. ``unseen``: readings of new poses, and with which tools.
    ``aligned``: before the tool at new poses is compared, "no", "rigid" or "similar": what no data of the kind see.
    """

    family: str
    seed: int
    label: Mapping[str, Any]
    layout: Layout
    truth: Array
    rows: tuple[Rows, ...]
    sigmas: tuple[float, ...]
    stated: bool
    robot: calib.Robot
    free: Mapping[str, Any]
    data: tuple[calib.Measurements, ...]
    unseen: Array
    unseen_tool: Array
    true_points: Array
    distances: tuple[Distance, ...] = ()
    priors: tuple[float, float] | None = None
    aligned: str = "no"
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def model(self) -> calib.ErrorModel:
        """What calib is told to be unknown."""
        return calib.error_model(self.robot, **self.free)

    @property
    def numbers(self) -> int:
        """How many numbers were measured."""
        return sum(n for rows in self.rows for n in rows.components) + len(self.distances)


@cache
def known_arm(which: str) -> tuple[Arm, calib.Robot]:
    """An arm as the judge and as calib read it."""
    if which == "irb2400":
        closes = (LOOP.frames, "xz", LOOP.passive)
        limits = np.radians([(-150, 150), (-60, 80), (-60, 60), (-150, 150), (-100, 100), (-170, 170)])
        ranges = {f"joint_{k + 1}": (float(low), float(high)) for k, (low, high) in enumerate(limits)}
        return arm(*IRB2400, ranges=ranges, loop=closes), calib.load_robot(*IRB2400, loops=[LOOP])
    source, tip = {"ur5": UR5, "panda": PANDA, "arm_cmm": ARM_CMM}[which]
    return arm(source, tip), calib.load_robot(source, tip)


def pose(rng: np.random.Generator, distance: float) -> Array:
    """A placement (4, 4), turned any way."""
    return placed(Rotation.random(rng=rng).as_matrix(), rng.uniform(-distance, distance, 3))


def draw(which: str, found: Arm, rng: np.random.Generator, n: int) -> Array:
    """Random readings; where a parallelogram is far from its dead centres."""
    if which != "irb2400":
        return found.draw(rng, n)
    q = found.draw(rng, 20 * n)
    return q[np.abs(q[:, 1] - q[:, 2]) < np.radians(50.0)][:n]


@dataclass(frozen=True)
class Errors:
    """How far a machine is off: ``zero`` (rad), ``length`` (m) and ``angle`` (rad) at most."""

    zero: float
    length: float
    angle: float


def drawn_errors(rng: np.random.Generator) -> Errors:
    """Large zeros or small ones, with placements or without."""
    zero = np.radians(rng.choice([0.5, 1.0, 3.0, 6.0]))
    size = rng.choice([0.0, 0.2e-3, 1e-3, 5e-3])
    return Errors(float(zero), float(size), float(size))


def machine(
    rng: np.random.Generator, found: Arm, errors: Errors, placements: tuple[str, ...], base: Array, tools: Array
) -> State:
    """A machine whose zeros and named placements are off, uniformly within the errors."""
    d = np.zeros((1, len(found.joints), 6))
    for j, joint in enumerate(found.joints):
        for c, component in enumerate(COMPONENTS):
            if f"{joint.name}.{component}" in placements:
                size = errors.length if c < 3 else errors.angle
                d[0, j, c] = rng.uniform(-size, size)
    offsets = rng.uniform(-errors.zero, errors.zero, (1, len(found.ranges)))
    return State(d, offsets, base[None], tools[None], np.zeros((1, 0, 4, 4)))


def nominal_of(true: State) -> State:
    """The nominal machine in the frames of the true one."""
    return replace(true, deviations=np.zeros_like(true.deviations), offsets=np.zeros_like(true.offsets))


def free_placements(which: str, found: Arm) -> tuple[str, ...]:
    """Names of all components of placements that "all" frees, or about the selection of the job of robots/irb2400."""
    own = {"revolute": "rz", "prismatic": "tz", "fixed": ""}
    every = [joint for joint in found.joints if joint.kind != "fixed"]
    if which == "irb2400":
        every = [joint for joint in every if joint.name.startswith("joint_") or joint.name == "elbow_cancel"]
    names = [f"{joint.name}.{c}" for joint in every for c in COMPONENTS if c != own[joint.kind]]
    if which == "irb2400":
        names = [name for name in names if not name.startswith(("joint_3.r", "joint_2.rx"))]
    return (*names, *(("rod_length.tz", "rear_lever_length.tx") if which == "irb2400" else ()))


def reading_columns(found: Arm, readings: Array) -> dict[str, Any]:
    """Columns of a table."""
    return {f"{name} [rad]": readings[:, k] for k, name in enumerate(found.ranges)}


def tracked(which: str, seed: int, few: bool = False) -> Case:
    """Positions or poses of one to three tools, from an instrument beside the robot.

    ``few``: 8 to 20 positions of one tool at a stated noise of 0.05 mm, zeros off by 3 or 6 deg, all placements free.
    """
    rng = np.random.default_rng([seed, 1, *which.encode(), few])
    found, robot = known_arm(which)
    kind = str(rng.choice(["position", "position", "pose"]))
    errors, n = drawn_errors(rng), int(rng.integers(3, 31))
    several = int(rng.choice([1, 1, 1, 2, 3]))
    with_placements = bool(rng.random() < 0.85)
    if not with_placements:
        errors = Errors(errors.zero, 0.0, 0.0)
    base_free, tool_free = bool(rng.random() < 0.85), bool(rng.random() < 0.85)
    placements = free_placements(which, found) if with_placements else ()
    base = pose(rng, 3.0)
    sigma = float(np.exp(rng.uniform(np.log(0.02e-3), np.log(0.2e-3))))
    sigma_angle = float(sigma * rng.uniform(1.0, 5.0))
    stated = bool(rng.random() < 0.6)
    if few:
        kind, n, several, with_placements, base_free, tool_free = (
            "position",
            int(rng.integers(8, 21)),
            1,
            True,
            True,
            True,
        )
        errors = Errors(float(np.radians(rng.choice([3.0, 6.0]))), errors.length, errors.angle)
        sigma, stated, placements = 0.05e-3, True, free_placements(which, found)
    tools = np.stack([placed(pose(rng, 1.0)[:3, :3], rng.uniform(-0.15, 0.15, 3)) for _ in range(several)])
    if kind == "position":
        tools[:, :3, :3] = np.eye(3)
    true = machine(rng, found, errors, placements, base, tools)
    readings = draw(which, found, rng, n)
    tool = np.arange(n) % several
    seen = predict(found, true, readings, tool)[0]
    position = seen[:, :3, 3] + sigma * rng.standard_normal((n, 3))
    turned = seen[:, :3, :3] @ Rotation.from_rotvec(sigma_angle * rng.standard_normal((n, 3))).as_matrix()
    rows = Rows(kind, readings, tool, position=position, orientation=turned if kind == "pose" else None)
    names = ("tool",) if several == 1 else tuple(f"t{k}" for k in range(several))
    columns = reading_columns(found, readings) | {f"{axis} [m]": position[:, k] for k, axis in enumerate("xyz")}
    if kind == "pose":
        x, y, z, w = Rotation.from_matrix(turned).as_quat().T
        columns |= {"qw": w, "qx": x, "qy": y, "qz": z}
    if several > 1:
        columns |= {"tool": [names[t] for t in tool]}
    data = calib.read_measurements(
        columns,
        robot,
        "pose" if kind == "pose" else "position",
        sigma=(sigma if stated else 0.0, None if kind == "position" else sigma_angle if stated else 0.0),
    )
    freedom = "fixed" if not tool_free else "pose" if kind == "pose" else "position"
    free: dict[str, Any] = {"offsets": "all", "base": "pose" if base_free else "fixed", "tool": freedom}
    if which == "irb2400":
        free["offsets"] = ["joint_*"]
    if with_placements:
        free["placements"] = list(OF_LOOP) if which == "irb2400" else "all"
    free["known"] = calib.Known(
        base=None if base_free else base, tools={} if tool_free else dict(zip(names, tools, strict=True))
    )
    parameters = [*placements, *(f"{name}.offset" for name in found.ranges)]
    parameters += [f"base.{c}" for c in POSE] if base_free else []
    for name in names if tool_free else ():
        prefix = "tool" if name == "tool" else f"tool.{name}"
        parameters += [f"{prefix}.{c}" for c in POSE[: 6 if kind == "pose" else 3]]
    nominal = State(np.zeros_like(true.deviations), np.zeros_like(true.offsets), base[None], tools[None], true.targets)
    layout = Layout(found, tuple(parameters), nominal, names, ())
    unseen = draw(which, found, rng, UNSEEN)
    unseen_tool = np.arange(UNSEEN) % several
    label = {
        "kind": kind,
        "rows": n,
        "zeros [deg]": round(float(np.degrees(errors.zero)), 2),
        "placements [mm]": errors.length * 1e3,
        "free placements": with_placements,
        "tools": several,
        "base": free["base"],
        "tool": freedom,
        "sigma [mm]": round(sigma * 1e3, 4),
        "stated": stated,
    }
    return Case(
        f"{which}_few" if few else which,
        seed,
        label,
        layout,
        layout.values(true),
        (rows,),
        (sigma, sigma_angle) if kind == "pose" else (sigma,),
        stated,
        robot,
        free,
        (data,),
        unseen,
        unseen_tool,
        predict(found, true, unseen, unseen_tool)[0, :, :3, 3],
    )


@cache
def own_rows() -> tuple[Array, Array, State]:
    """Readings (N, 6) and positions (N, 3) that are shipped with the arm CMM, and the truth file as a machine."""
    folder = ROOT / "robots" / "arm_cmm"
    lines = (folder / "identification.csv").read_text(encoding="utf-8").splitlines()
    cells = np.array([[float(c) for c in line.split(",")] for line in lines if line and line[0] not in "#j"])
    truth = tomllib.loads((folder / "truth.toml").read_text(encoding="utf-8"))
    found, _ = known_arm("arm_cmm")

    def values(entry: dict[str, Any]) -> Array:
        return np.concatenate([np.array(entry["translation_mm"]) * 1e-3, np.radians(entry["rotation_deg"])])

    def motion(entry: dict[str, Any]) -> Array:
        v = values(entry)
        return placed(rx_ry_rz(v[3:]), v[:3])

    d = np.zeros((1, len(found.joints), 6))
    d[0, :6] = [values(truth[f"joint_{k}"]) for k in range(1, 7)]
    offsets = np.radians([[truth[f"joint_{k}"]["offset_deg"] for k in range(1, 7)]])
    # The handle's mount is before the probe's: what it is off, the free tool point takes.
    mount = found.joints[-1].origin
    tip = np.array([*(np.array(truth["tip_in_probe_mm"]) * 1e-3), 1.0])
    point = inverse(mount) @ motion(truth["handle_mount"]) @ mount @ tip
    tool = placed(np.eye(3), point[:3])
    base = motion(truth["base_in_tracker"])
    true = State(d, offsets, base[None], tool[None, None], np.zeros((1, 0, 4, 4)))
    return np.radians(cells[:, :6]), cells[:, 6:9] * 1e-3, true


def arm_cmm_rows(seed: int) -> Case:
    """Some of the rows that are shipped with the arm CMM."""
    rng = np.random.default_rng([seed, 2])
    found, robot = known_arm("arm_cmm")
    readings, positions, true = own_rows()
    n = int(rng.choice([8, 9, 10, 10, 11, 12, 12, 14, 16, 20, 25, 30]))
    chosen = np.sort(rng.choice(len(readings), n, replace=False))
    stated = bool(rng.random() < 0.6)
    columns = reading_columns(found, readings[chosen])
    columns |= {f"{axis} [m]": positions[chosen, k] for k, axis in enumerate("xyz")}
    data = calib.read_measurements(columns, robot, sigma=0.02e-3 if stated else 0.0)
    parameters = [*free_placements("arm_cmm", found), *(f"{name}.offset" for name in found.ranges)]
    parameters += [*(f"base.{c}" for c in POSE), *(f"tool.{c}" for c in POSE[:3])]
    nominal = nominal_of(true)
    layout = Layout(found, tuple(parameters), nominal, ("tool",), ())
    unseen = readings[np.setdiff1d(np.arange(len(readings)), chosen)]
    unseen = np.concatenate([unseen, found.draw(rng, UNSEEN - len(unseen))])
    none = np.zeros(len(unseen), dtype=np.intp)
    return Case(
        "arm_cmm_rows",
        seed,
        {"kind": "position", "rows": n, "stated": stated, "sigma [mm]": 0.02},
        layout,
        layout.values(true),
        (Rows("position", readings[chosen], none[:n], position=positions[chosen]),),
        (0.02e-3,),
        stated,
        robot,
        {"offsets": "all", "placements": "all", "base": "pose", "tool": "position"},
        (data,),
        unseen,
        none,
        predict(found, true, unseen, none)[0, :, :3, 3],
    )


def touching(rng: np.random.Generator, found: Arm, true: State, points: Array) -> Array:
    """Random readings (n, k) at which the tool is at points (n, 3) of the base, by damped Newton steps."""
    n, k = len(points), len(found.ranges)
    low, high = np.transpose(list(found.ranges.values()))
    answer = np.full((n, k), np.nan)
    zero = np.zeros(1, dtype=np.intp)

    def gap(q: Array) -> Array:
        return predict(found, true, q, np.repeat(zero, len(q)))[0, :, :3, 3]

    while (todo := np.flatnonzero(np.isnan(answer[:, 0]))).size:
        q = found.draw(rng, len(todo))
        for _ in range(40):
            every = (q + 1e-6 * np.vstack([np.zeros(k), np.eye(k)])[:, None]).reshape(-1, k)
            g = gap(every).reshape(k + 1, len(q), 3)
            J = np.moveaxis((g[1:] - g[0]) / 1e-6, 0, -1)
            r = points[todo] - g[0]
            H = J @ np.swapaxes(J, -1, -2) + 1e-9 * np.eye(3)
            step = (np.swapaxes(J, -1, -2) @ np.linalg.solve(H, r[..., None]))[..., 0]
            q = q + step * np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))
        there = np.all((q > low) & (q < high), axis=1) & (np.linalg.norm(gap(q) - points[todo], axis=1) < 1e-9)
        answer[todo[there]] = q[there]
    return answer


def sockets(seed: int, drawn: Errors | None = None) -> Case:
    """A Panda whose ball was put into two to five sockets at known or unknown places, maybe at known distances.

    ``drawn``: how far machines are off of which priors are stated; when None, no farther than twice the priors.
    """
    rng = np.random.default_rng([seed, 3])
    found, robot = known_arm("panda")
    errors, n = drawn_errors(rng), int(rng.integers(8, 31))
    several = int(rng.integers(2, 1 + min(5, n // 4)))
    known = str(rng.choice(["places", "distances", "nothing"]))
    prior = SOCKETS_PRIOR if rng.random() < 0.3 else None
    if prior is not None:
        errors = drawn or Errors(
            min(errors.zero, 2.0 * prior[1]), min(errors.length, 1e-3), min(errors.angle, 2.0 * prior[1])
        )
    placements = free_placements("panda", found)
    tools = placed(np.eye(3), rng.uniform((-0.05, -0.05, 0.05), (0.05, 0.05, 0.15)))[None]
    true = machine(rng, found, errors, placements, np.eye(4), tools)
    angles = rng.uniform(-np.pi, np.pi, several)
    places = np.stack(
        [0.5 * np.cos(angles), 0.5 * np.sin(angles), rng.uniform(0.0, 0.5, several)], axis=1
    ) + rng.uniform(-0.1, 0.1, (several, 3))
    targets = np.stack([placed(np.eye(3), place) for place in places])
    true = State(true.deviations, true.offsets, true.base, true.tools, targets[None])
    sigma = float(np.exp(rng.uniform(np.log(0.02e-3), np.log(0.2e-3))))
    stated = bool(rng.random() < 0.6)
    target = np.arange(n) % several
    readings = touching(rng, found, true, places[target] + sigma * rng.standard_normal((n, 3)))
    names = tuple(f"s{k}" for k in range(several))
    columns = reading_columns(found, readings) | {"target": [names[t] for t in target]}
    data = calib.read_measurements(columns, robot, "socket", sigma=sigma if stated else 0.0)
    free: dict[str, Any] = {"offsets": "all", "placements": "all", "tool": "position"}
    distances: tuple[Distance, ...] = ()
    parameters = [*placements, *(f"{name}.offset" for name in found.ranges)]
    free["base"] = "fixed"
    if known == "places":
        free["known"] = calib.Known(targets={name: Target(T) for name, T in zip(names, targets, strict=True)})
    parameters += [f"tool.{c}" for c in POSE[:3]]
    if known != "places":
        parameters += [f"target.{name}.{c}" for name in names for c in POSE[:3]]
    if known == "distances":
        pairs = [(k, k + 1) for k in range(several - 1)]
        lengths = [float(np.linalg.norm(places[b] - places[a]) + 1e-5 * rng.standard_normal()) for a, b in pairs]
        distances = tuple(Distance(pair, value, 1e-5) for pair, value in zip(pairs, lengths, strict=True))
        told = [
            Relation("distance", (names[known_.targets[0]], names[known_.targets[1]]), known_.value, known_.sigma)
            for known_ in distances
        ]
        free["known"] = calib.Known(relations=told)
    if prior is not None:
        free["priors"] = calib.Priors(*prior)
    nominal = nominal_of(true)
    layout = Layout(found, tuple(parameters), nominal, ("tool",), names)
    unseen = found.draw(rng, UNSEEN)
    none = np.zeros(UNSEEN, dtype=np.intp)
    return Case(
        "sockets",
        seed,
        {
            "kind": "socket",
            "rows": n,
            "zeros [deg]": round(float(np.degrees(errors.zero)), 2),
            "placements [mm]": errors.length * 1e3,
            "sockets": several,
            "known": known,
            "prior": prior is not None,
            "sigma [mm]": round(sigma * 1e3, 4),
            "stated": stated,
        },
        layout,
        layout.values(true),
        (Rows("socket", readings, none[:n], target=target),),
        (sigma,),
        stated,
        robot,
        free,
        (data,),
        unseen,
        none,
        predict(found, true, unseen, none)[0, :, :3, 3],
        distances,
        prior,
        {"places": "no", "distances": "rigid", "nothing": "similar"}[known],
    )


def pixels(seed: int) -> Case:
    """Images of a board by a camera on the flange, or of a board on the flange by a camera beside the robot."""
    rng = np.random.default_rng([seed, 4])
    found, robot = known_arm("ur5")
    errors, n = drawn_errors(rng), int(rng.integers(3, 31))
    on_tip = bool(rng.random() < 0.6)
    lens = Lens(on_tip, **LENS)
    placements = free_placements("ur5", found)
    sigma = float(rng.uniform(0.1, 0.5))
    stated = bool(rng.random() < 0.6)
    middle = BOARD.mean(axis=0)
    none = np.zeros(n, dtype=np.intp)
    while True:
        tool = placed(pose(rng, 1.0)[:3, :3], rng.uniform(-0.08, 0.08, 3))
        true = machine(rng, found, errors, placements, np.eye(4), tool[None])
        at = predict(found, true, found.draw(rng, 1), none[:1])[0, 0]
        # The board in the camera: its middle near the line of sight, its face to the camera, turned about any way.
        tilt = Rotation.from_rotvec(rng.uniform(-0.7, 0.7, 3)).as_matrix() @ np.diag([1.0, -1.0, -1.0])
        board = placed(tilt, np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.4, 0.9)])) @ placed(np.eye(3), -middle)
        target = at @ (board if on_tip else inverse(board))
        true = State(true.deviations, true.offsets, true.base, true.tools, target[None, None])
        readings = np.zeros((0, 6))
        for _ in range(40):
            some = found.draw(rng, 4000)
            readings = np.concatenate([readings, some[_in_sight(found, true, lens, some)]])
            if len(readings) >= n:
                break
        if len(readings) >= n:
            readings = readings[:n]
            break
    rows = Rows("pixels", readings, none, target=none, pixels=np.zeros((n, len(BOARD), 2)), marks=BOARD, lens=lens)
    seen = lens.see(_marks(found, true, lens, readings)) + sigma * rng.standard_normal((n, len(BOARD), 2))
    rows = Rows("pixels", readings, none, target=none, pixels=seen, marks=BOARD, lens=lens)
    m = len(BOARD)
    columns = reading_columns(found, np.repeat(readings, m, axis=0))
    columns |= {f"{name} [px]": seen[..., k].ravel() for k, name in enumerate("uv")}
    columns |= {f"board_{axis} [m]": np.tile(BOARD, (n, 1))[:, k] for k, axis in enumerate("xyz")}
    columns |= {"target": ["board"] * (n * m)}
    camera = calib.measuring.Camera("tip" if on_tip else "floor", **LENS, sigma=sigma if stated else 0.0)
    data = calib.read_measurements(columns, robot, "pixels", instrument=camera)
    # The independent search takes board and lens as known.
    data = calib.measuring.seen_by(data, camera, calib.measuring.Board(scale_sigma=0.0))
    parameters = [*placements, *(f"{name}.offset" for name in found.ranges)]
    parameters += [*(f"tool.{c}" for c in POSE), *(f"target.board.{c}" for c in POSE)]
    nominal = nominal_of(true)
    layout = Layout(found, tuple(parameters), nominal, ("tool",), ("board",))
    unseen = found.draw(rng, UNSEEN)
    every = np.zeros(UNSEEN, dtype=np.intp)
    return Case(
        "pixels",
        seed,
        {
            "kind": "pixels",
            "rows": n,
            "zeros [deg]": round(float(np.degrees(errors.zero)), 2),
            "placements [mm]": errors.length * 1e3,
            "camera_on": "tip" if on_tip else "floor",
            "sigma [px]": round(sigma, 3),
            "stated": stated,
        },
        layout,
        layout.values(true),
        (rows,),
        (sigma,),
        stated,
        robot,
        {"offsets": "all", "placements": "all", "base": "fixed", "tool": "pose"},
        (data,),
        unseen,
        every,
        predict(found, true, unseen, every)[0, :, :3, 3],
        aligned="rigid",
    )


def _marks(found: Arm, true: State, lens: Lens, readings: Array) -> Array:
    tools = predict(found, true, readings, np.zeros(len(readings), dtype=np.intp))[0]
    target = true.targets[0, 0]
    T = inverse(tools) @ target if lens.on_tip else inverse(target) @ tools
    return np.asarray(BOARD @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3])


def _in_sight(found: Arm, true: State, lens: Lens, readings: Array) -> Array:
    marks = _marks(found, true, lens, readings)
    near = np.abs(marks[..., :2]).max(axis=-1) < 0.42 * marks[..., 2]
    seen = np.all(near & (marks[..., 2] > 0.2) & (marks[..., 2] < 1.5), axis=1)
    # The printed side is seen, and not from its edge.
    u, v = marks[:, 4] - marks[:, 0], marks[:, 1] - marks[:, 0]
    normal = np.cross(v, u)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return np.asarray(seen & (np.abs(normal[:, 2]) > 0.3))


FAMILIES: Mapping[str, Callable[[int], Case]] = {
    "ur5": lambda seed: tracked("ur5", seed),
    "ur5_few": lambda seed: tracked("ur5", seed, few=True),
    "panda": lambda seed: tracked("panda", seed),
    "arm_cmm": lambda seed: tracked("arm_cmm", seed),
    "arm_cmm_rows": arm_cmm_rows,
    "irb2400": lambda seed: tracked("irb2400", seed),
    "sockets": sockets,
    "pixels": pixels,
}


def case(seed: int, family: str) -> Case:
    """The session of a seed."""
    return FAMILIES[family](seed)
