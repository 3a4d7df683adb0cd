"""Sessions whose right verdict is known before: sound ones, and one for everything that can be wrong with one.

    sound(7)                        a sound session, drawn at random; its label says what it is
    bad("base moved 1 mm midway", "ur5", 3)

Truth and measurements are those of :mod:`scripts.development.judge_machines`, which has none of calib's mathematics.
"""

# ruff: noqa: ARG001, ARG005 - all changes of a table are called alike.

import os
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from calib.assessment.in_time import delay
from calib.assessment.influence import Residue
from calib.assessment.stretches import stretches
from calib.foundations.chance import bound
from calib.machine.tool_uncertainty import tool_uncertainty
from calib.robot.sources import resolve
from calib.robot.urdf import parse_urdf
from scripts.development import judge_cases
from scripts.development.judge_cases import Errors, free_placements, machine, pose, reading_columns, touching
from scripts.development.judge_machines import Arm, Array, State, arm, placed, predict
from scripts.development.judge_one_orientation import one_orientation

ROBOTS = {
    "ur5": ("example:ur_description/urdf/ur5_robot.urdf", "tool0"),
    "ur10": ("example:ur_description/urdf/ur10_robot.urdf", "tool0"),
    "panda": ("example:panda_description/urdf/panda.urdf", "panda_hand_tcp"),
    "xarm7": ("example:xarm_description/urdf/xarm7.urdf", "link7"),
    "z1": ("example:z1_description/urdf/z1.urdf", "link06"),
    "baxter": ("example:baxter_description/urdf/baxter.urdf", "left_gripper"),
}
ORDERS = (1, 2, 5, 11)
NAN = float("nan")


@dataclass(frozen=True)
class Unseen:
    """New poses, by their readings (n, k), and where a tool truly is there (n, 4, 4), without noise."""

    readings: Array
    T: Array
    setup: str | None = None


@dataclass(frozen=True)
class Session:
    """What a user brings: tables to identify from and to judge by, and what is to be found; ``unseen``: the truth."""

    label: Mapping[str, Any]
    model: calib.ErrorModel
    own: tuple[calib.Measurements, ...]
    held_out: tuple[calib.Measurements, ...]
    losses: tuple[str, ...] | None = None
    levels: tuple[tuple[str, ...], ...] = ()
    unseen: Unseen | None = None


@dataclass(frozen=True)
class Judged:
    """``word``: trusted, doubted or refused. ``failed``: names of the checks that did not pass.

    ``inside``: the share of unseen tool points inside their stated 95 % regions, ``errors`` and ``stated``: rms of the
    true errors there and of those that are stated, in m; nan where no truth is known. ``late``: t and size of a delay.
    """

    word: str
    failed: tuple[str, ...]
    said: str
    checks: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    inside: float = NAN
    errors: float = NAN
    stated: float = NAN
    late: tuple[float, float] = (NAN, NAN)


def judge(session: Session) -> Judged:
    """What calib says of a session, as ``calib calibrate`` does: checks of the input, identification, verdict."""
    try:
        findings = calib.check(session.model, session.own)
        errors = [f for f in findings if f.severity == "error"]
        if errors:
            return Judged("refused", (errors[0].code,), errors[0].sentence)
        fit = None
        for free in session.levels or (None,):
            fit = calib.identify(session.model, session.own, free=free, start=fit, losses=session.losses)
        # The lens of these cameras is as it is told.
        found = calib.assess(fit, session.held_out, findings=findings).accepting(["lens"])
    except calib.CalibError as e:
        return Judged("refused", (type(e).__name__,), str(e))
    failed = tuple(check.name for check in found.checks if not check.passed)
    numbers = {check.name: (check.statistic, check.threshold) for check in found.checks}
    right = {} if session.unseen is None else _right(found.machine, session.unseen)
    if fit.measurements[0].times is not None:
        residue = Residue.of(fit, {})
        seen, _ = delay(stretches(residue), residue.C)
        right["late"] = (abs(seen.t), seen.size)
    return Judged("trusted" if found.trusted else "doubted", failed, " ".join(found.doubts), numbers, **right)


def _right(machine: calib.CalibratedMachine, unseen: Unseen) -> dict[str, Any]:
    """What is stated of tool points at new poses, beside the truth."""
    machine = machine.at(unseen.setup)
    said = tool_uncertainty(machine, unseen.readings)
    errors = machine.predict(unseen.readings)[:, :3, 3] - unseen.T[:, :3, 3]
    C = said.covariance[:, :3, :3]
    squares = np.einsum("ni,ni->n", errors, np.linalg.solve(C, errors[:, :, None])[..., 0])
    return {
        "inside": float(np.mean(squares <= bound(0.95, 3, said.degrees_of_freedom))),
        "errors": float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))),
        "stated": float(np.sqrt(np.mean(np.trace(C, axis1=1, axis2=2)))),
    }


# ---- machines


@cache
def known(which: str) -> tuple[Arm, calib.Robot]:
    """An arm as this script and as calib read it."""
    return arm(*ROBOTS[which]), calib.load_robot(*ROBOTS[which])


def told(which: str, factor: Callable[[int], float]) -> calib.Robot:
    """The arm with other lengths: the k-th <origin> of a joint times a factor."""
    source, tip = ROBOTS[which]
    text = resolve(source).read_text(encoding="utf-8")
    count = iter(range(10_000))

    def scaled(found: re.Match[str]) -> str:
        times = factor(next(count))
        return found[1] + " ".join(f"{float(x) * times:.9g}" for x in found[2].split()) + found[3]

    joints = re.sub(r"(<joint\b(?:(?!</joint>).)*?<origin[^>]*?xyz=\")([^\"]*)(\")", scaled, text, flags=re.DOTALL)
    return calib.load_robot(parse_urdf(joints.encode(), f"{which}.urdf"), tip)


@dataclass(frozen=True)
class World:
    """One machine on one floor, with gears that wobble by ``waves`` and an instrument's ``sigma`` (m) and in rad."""

    which: str
    arm: Arm
    robot: calib.Robot
    state: State
    amplitudes: Array
    phases: Array
    sigma: float
    sigma_angle: float
    rng: np.random.Generator

    def turned(self, q: Array) -> Array:
        """Readings on their way to the joints."""
        k = np.array(ORDERS)[:, None, None]
        return q + np.sum(self.amplitudes[:, None] * np.sin(k * q + self.phases[:, None]), axis=0)

    def placed(self, q: Array, state: State | None = None) -> Array:
        """Tools (N, 4, 4) in the instrument's frame, without noise."""
        return predict(self.arm, state or self.state, self.turned(q), np.zeros(len(q), dtype=np.intp))[0]

    def measure(self, q: Array, state: State | None = None) -> Array:
        """Measured poses (N, 4, 4) with noise."""
        T = np.array(self.placed(q, state))
        T[:, :3, 3] += self.sigma * self.rng.standard_normal((len(q), 3))
        turn = Rotation.from_rotvec(self.sigma_angle * self.rng.standard_normal((len(q), 3))).as_matrix()
        T[:, :3, :3] = T[:, :3, :3] @ turn
        return T


def world(which: str, rng: np.random.Generator, errors: Errors, sigma: float, wobble: float = 0.0) -> World:
    """A machine that is off by ``errors``, somewhere."""
    found, robot = known(which)
    tool = placed(pose(rng, 1.0)[:3, :3], rng.uniform((-0.1, -0.1, 0.03), (0.1, 0.1, 0.2)))
    state = machine(rng, found, errors, free_placements(which, found), pose(rng, 3.0), tool[None])
    k = len(found.ranges)
    amplitudes = rng.uniform(0.3, 1.0, (len(ORDERS), k)) * wobble / np.sqrt(len(ORDERS))
    phases = rng.uniform(0.0, 2.0 * np.pi, (len(ORDERS), k))
    return World(which, found, robot, state, amplitudes, phases, sigma, 3.0 * sigma, rng)


def readings(w: World, n: int, share: float = 0.7, middle: Array | None = None) -> Array:
    """Random readings (n, k) in the middle ``share`` of the ranges, or about ``middle``."""
    low, high = np.clip(np.transpose(list(w.arm.ranges.values())), -3.0, 3.0)
    centre = 0.5 * (low + high) if middle is None else middle
    return centre + share * w.rng.uniform(-0.5, 0.5, (n, len(low))) * (high - low)


def path(w: World, n: int, speed: float, longest: int | None = None) -> Array:
    """A smooth path (n, k) through joint space, of about ``speed`` rad from row to row in every joint.

    Of a size that ``longest`` rows, when None these, go through several times.
    """
    low, high = np.clip(np.transpose(list(w.arm.ranges.values())), -2.6, 2.6)
    s = np.arange(n)[:, None]
    size = np.minimum(0.3 * (high - low), (longest or n) * speed / 25.0)
    total = np.zeros((n, len(low)))
    for share in (0.7, 0.3):
        rate = speed * w.rng.uniform(0.5, 1.5, len(low)) / size
        total = total + share * np.sin(rate * s + w.rng.uniform(0.0, 2.0 * np.pi, len(low)))
    return np.asarray(0.5 * (low + high) + size * total)


def reading_rows(w: World, q: Array, T: Array) -> dict[str, Any]:
    """Columns of readings and positions."""
    return reading_columns(w.arm, q) | {f"{axis} [m]": T[:, k, 3] for k, axis in enumerate("xyz")}


def table(
    w: World, q: Array, T: Array, kind: str, sigma: float, robot: calib.Robot | None = None, **more: Any
) -> calib.Measurements:
    """Measurements of readings and poses; ``sigma`` 0 is not stated."""
    columns = reading_rows(w, q, T)
    if kind == "pose":
        x, y, z, s = Rotation.from_matrix(T[:, :3, :3]).as_quat().T
        columns |= {"qw": s, "qx": x, "qy": y, "qz": z}
        return calib.read_measurements(columns | more, robot or w.robot, "pose", sigma=(sigma, 3.0 * sigma))
    return calib.read_measurements(columns | more, robot or w.robot, "position", sigma=sigma)


def whole(robot: calib.Robot, kind: str = "position", **more: Any) -> calib.ErrorModel:
    """All offsets and placements."""
    given: dict[str, Any] = {"offsets": "all", "placements": "all", "tool": "pose" if kind == "pose" else "position"}
    return calib.error_model(robot, **(given | more))


# ---- sound sessions


def sound(seed: int) -> Session:
    """A session that is as it should be, labelled before anything is judged."""
    rng = np.random.default_rng([seed, 20])
    layout = str(
        rng.choice(
            ["random", "random", "few", "many", "path", "path", "lines", "planes", "narrow", "levels", "sockets",
             "pixels", "drift", "outliers", "offsets"]
        )
    )  # fmt: skip
    which = str(rng.choice(["ur5", "ur10", "panda"]))
    stated = bool(rng.random() < 0.5)
    sigma = float(rng.choice([0.02e-3, 0.05e-3, 0.1e-3, 0.2e-3]))
    wobble = float(rng.choice([0.0, 0.05e-3, 0.1e-3, 0.15e-3]))
    zero = float(np.radians(rng.choice([0.3, 1.0, 3.0])))
    size = float(rng.choice([0.2e-3, 0.5e-3, 2e-3]))
    kind = str(rng.choice(["position", "position", "pose"]))
    if layout in ("sockets", "pixels"):
        return _of_family(layout, seed, rng, stated)
    if layout == "offsets":
        size = 0.0
    if layout in ("lines", "planes"):
        kind = "position"
    w = world(which, rng, Errors(zero, size, size), sigma, wobble)
    n, m = int(rng.integers(40, 150)), int(rng.integers(15, 60))
    if layout == "few":
        n, m = int(rng.integers(18, 26)), int(rng.integers(6, 12))
    elif layout == "many":
        n, m = int(rng.integers(300, 1200)), int(rng.integers(100, 300))
    if layout == "path":
        # Several times through +-0.7 rad in every joint: a narrower path, once, has little to show.
        speed = float(rng.choice([8e-3, 15e-3, 25e-3]))
        n = int(18.0 / speed) + int(rng.integers(0, 300))
        m = n // 2
        q, v = path(w, n, speed), path(w, m, speed, n)
    elif layout in ("lines", "planes"):
        (q, v), _ = one_orientation(which, layout, rng, (int(rng.integers(100, 400)), 150), 0.0)
    elif layout == "narrow":
        middle = readings(w, 1, 0.5)[0]
        q, v = readings(w, n, 0.15, middle), readings(w, m, 0.15, middle)
    else:
        share = float(rng.choice([0.5, 0.7, 0.9]))
        q, v = readings(w, n, share), readings(w, m, share)
    T, U = w.measure(q), w.measure(v)
    losses = None
    if layout == "drift":
        total = float(rng.choice([1.0, 2.0, 3.0])) * sigma
        walk = np.cumsum(rng.standard_normal((n + m, 3)), axis=0) * total / np.sqrt(n + m)
        T[:, :3, 3] += walk[:n]
        U[:, :3, 3] += walk[n:]
    if layout == "outliers":
        losses = (str(rng.choice(["huber", "soft_l1", "cauchy"])),)
        for X in (T, U):
            wrong = rng.random(len(X)) < float(rng.choice([0.02, 0.05]))
            X[wrong, :3, 3] += rng.uniform(-5e-3, 5e-3, (int(wrong.sum()), 3))
    free: dict[str, Any] = {"placements": "none"} if layout == "offsets" else {}
    told_sigma = sigma * float(rng.choice([0.5, 1.0, 1.0, 2.0])) if stated else 0.0
    levels: tuple[tuple[str, ...], ...] = ()
    if layout == "levels":
        levels = (("base.*", "tool.*", "*.offset"), ("*",))
    label = {"layout": layout, "robot": which, "kind": kind, "rows": len(q), "held out": len(v), "wobble": wobble}
    label |= {"sigma": sigma, "stated": told_sigma, "zero": zero, "size": size}
    own, held = table(w, q, T, kind, told_sigma), table(w, v, U, kind, told_sigma)
    return Session(label, whole(w.robot, kind, **free), (own,), (held,), losses, levels)


# Gears of arms for hobbyists wobble by up to that, in rad.
POOR = (2e-3, 20e-3)


def poor(seed: int) -> Session:
    """A sound session with an arm that is poor, and as poor with what was held out."""
    rng = np.random.default_rng([seed, 24])
    which = str(rng.choice(["ur5", "ur10", "panda"]))
    kind = str(rng.choice(["position", "pose"]))
    wobble = float(np.exp(rng.uniform(*np.log(POOR))))
    sigma = float(rng.choice([0.05e-3, 0.2e-3, 1e-3]))
    w = world(which, rng, Errors(np.radians(3.0), 2e-3, 10e-3), sigma, wobble)
    q, v = readings(w, int(rng.integers(40, 150))), readings(w, int(rng.integers(15, 60)))
    label = {"layout": "poor", "robot": which, "kind": kind, "rows": len(q), "held out": len(v), "wobble": wobble}
    own, held = table(w, q, w.measure(q), kind, 0.0), table(w, v, w.measure(v), kind, 0.0)
    return Session(label | {"sigma": sigma, "stated": 0.0}, whole(w.robot, kind), (own,), (held,))


def _of_family(layout: str, seed: int, rng: np.random.Generator, stated: bool) -> Session:
    if layout == "sockets":
        found, robot = known("panda")
        errors = Errors(float(np.radians(rng.choice([0.3, 1.0]))), 0.5e-3, 0.5e-3)
        tools = placed(np.eye(3), rng.uniform((-0.05, -0.05, 0.05), (0.05, 0.05, 0.15)))[None]
        true = machine(rng, found, errors, free_placements("panda", found), np.eye(4), tools)
        places = np.array([(0.45, 0.2, 0.2), (0.4, -0.3, 0.35), (0.5, 0.0, 0.5), (0.3, 0.4, 0.1), (0.55, -0.1, 0.1)])
        places = places[: int(rng.integers(3, 6))] + rng.uniform(-0.05, 0.05, (1, 3))
        sigma = float(rng.choice([0.02e-3, 0.05e-3, 0.1e-3]))
        n = int(rng.integers(30, 70))
        target = np.arange(n) % len(places)
        q = touching(rng, found, true, places[target] + sigma * rng.standard_normal((n, 3)))
        names = [f"s{t}" for t in target]
        targets = {f"s{k}": calib.measuring.Target(placed(np.eye(3), p)) for k, p in enumerate(places)}
        data = calib.read_measurements(
            reading_columns(found, q) | {"target": names}, robot, "socket", sigma=sigma if stated else 0.0
        )
        known_ = calib.Known(targets=targets) if rng.random() < 0.5 else calib.Known()
        model = calib.error_model(robot, offsets="all", placements="all", base="fixed", known=known_)
        label = {"layout": layout, "robot": "panda", "kind": "socket", "rows": n, "stated": stated}
    else:
        for k in range(1000):
            made = judge_cases.pixels(1000 * seed + k)
            if made.label["rows"] >= 18:
                break
        data, model = made.data[0], made.model
        label = {"layout": layout, "robot": "ur5", "kind": "pixels", "rows": made.label["rows"], "stated": made.stated}
    own, held = calib.hold_out(data, 0.3) if layout == "pixels" else _a_third(data)
    return Session(label, model, (own,), (held,))


def _a_third(data: calib.Measurements) -> tuple[calib.Measurements, calib.Measurements]:
    out = np.random.default_rng(len(data)).random(len(data)) < 0.3
    return data.subset(~out), data.subset(out)


# ---- bad sessions


@dataclass(frozen=True)
class Tables:
    """What a bad session is made from: 60 rows and 30 to judge by, as a sound one has them."""

    w: World
    q: Array
    T: Array
    v: Array
    U: Array

    def session(self, what: str, sigma: float, robot: calib.Robot | None = None, kind: str = "position") -> Session:
        """The session; ``robot``: what the user takes it for."""
        own = table(self.w, self.q, self.T, kind, sigma, robot)
        held = table(self.w, self.v, self.U, kind, sigma, robot)
        label = {"what": what, "robot": self.w.which, "stated": sigma > 0.0}
        return Session(label, whole(robot or self.w.robot, kind), (own,), (held,))


def sound_tables(which: str, seed: int, how: str = "random") -> Tables:
    """Tables of a sound session of 60 rows, or of a path of 800."""
    rng = np.random.default_rng([seed, 21, *which.encode()])
    w = world(which, rng, Errors(np.radians(1.0), 0.5e-3, 1e-3), 0.05e-3, 0.05e-3)
    if how == "line":
        # Of up to eight lines, one after the other, the first.
        (q, _), _ = one_orientation(which, "lines", rng, (240, 30), 0.0)
        q, v = q[:28:2], q[1:28:2]
    elif how == "path":
        q, v = path(w, 800, 25e-3), path(w, 400, 25e-3, 800)
    else:
        q, v = readings(w, 60), readings(w, 30)
    return Tables(w, q, w.measure(q), v, w.measure(v))


Make = Callable[[str, int, float], Session]
BAD: dict[str, Make] = {}
LATER: dict[str, Make] = {}
LAST: dict[str, Make] = {}


def bad(what: str, which: str, seed: int, more: Mapping[str, Make] = MappingProxyType({})) -> Session:
    """A session with something wrong, one of ours or of ``more``; every other seed states the instrument's sigma."""
    make = {**BAD, **LATER, **LAST, **more}[what]
    made = make(which, seed, 0.05e-3 if seed % 2 else 0.0)
    return replace(made, label={**made.label, "what": what})


def both(change: Callable[[Tables, Array, Array], tuple[Array, Array]], how: str = "random") -> Make:
    """The same change of all rows; to the truth at new poses it happens as well, without noise."""

    def make(which: str, seed: int, sigma: float) -> Session:
        t = sound_tables(which, seed, how)
        (q, T), (v, U) = change(t, t.q, np.array(t.T)), change(t, t.v, np.array(t.U))
        made = replace(t, q=q, T=T, v=v, U=U).session("", sigma)
        exact = replace(t, w=replace(t.w, sigma=0.0, sigma_angle=0.0))
        new = readings(t.w, 200) if how == "random" else path(t.w, 200, 25e-3, 800)
        return replace(made, unseen=Unseen(*change(exact, new, exact.w.measure(new))))

    return make


def _own(change: Callable[[Tables], Tables], how: str = "random") -> Make:
    def make(which: str, seed: int, sigma: float) -> Session:
        return change(sound_tables(which, seed, how)).session("", sigma)

    return make


def _random(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    T[:, :3, 3] = t.w.rng.uniform(-0.8, 0.8, (len(q), 3))
    return q, T


def _column(q: Array, k: int, values: Array | float) -> Array:
    out = np.array(q)
    out[:, k] = values
    return out


def _moved(T: Array, rows: slice, by: Array) -> Array:
    T = np.array(T)
    T[rows, :3, 3] += by
    return T


def _frozen(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    for start in range(5, len(q) - 8, 20):
        T[start : start + 6] = T[start]
    return q, T


def _wild(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    wrong = t.w.rng.random(len(q)) < 0.3
    T[wrong, :3, 3] += t.w.rng.uniform(-20e-3, 20e-3, (int(wrong.sum()), 3))
    return q, T


def _late(rows: int) -> Callable[[Tables, Array, Array], tuple[Array, Array]]:
    return lambda t, q, T: (q[rows:], T[:-rows])


def _scaled(which: str, seed: int, sigma: float) -> Session:
    return sound_tables(which, seed).session("", sigma, told(which, lambda k: 1.05))


def _another(which: str, seed: int, sigma: float) -> Session:
    other = {"ur5": "ur10", "ur10": "ur5"}.get(which)
    if other is not None:
        return sound_tables(which, seed).session("", sigma, known(other)[1])
    factors = np.random.default_rng(seed).uniform(0.6, 1.5, 100)
    return sound_tables(which, seed).session("", sigma, told(which, lambda k: float(factors[k])))


def _other_world(t: Tables, seed: int) -> World:
    rng = np.random.default_rng([seed, 22])
    other = world(t.w.which, rng, Errors(np.radians(1.0), 0.5e-3, 1e-3), t.w.sigma, 0.05e-3)
    return replace(other, state=replace(other.state, base=t.w.state.base, tools=t.w.state.tools))


def _half_another(interleaved: bool) -> Make:
    def make(which: str, seed: int, sigma: float) -> Session:
        t = sound_tables(which, seed)
        other = _other_world(t, seed)
        T, U = np.array(t.T), np.array(t.U)
        for X, q in ((T, t.q), (U, t.v)):
            rows = np.arange(len(q)) % 2 == 0 if interleaved else np.arange(len(q)) < len(q) // 2
            X[rows] = other.measure(q[rows])
        return replace(t, T=T, U=U).session("", sigma)

    return make


def _no_errors(which: str, seed: int, sigma: float) -> Session:
    rng = np.random.default_rng([seed, 23])
    w = world(which, rng, Errors(0.0, 0.0, 0.0), 0.2e-3)
    q, v = readings(w, 60), readings(w, 30)
    return Tables(w, q, w.measure(q), v, w.measure(v)).session("", 4.0 * sigma)


def _tool(t: Tables) -> Tables:
    tools = np.array(t.w.state.tools)
    tools[..., :3, 3] += np.array([5e-3, 0.0, 3e-3])
    T = np.array(t.T)
    T[30:] = t.w.measure(t.q[30:], replace(t.w.state, tools=tools))
    return replace(t, T=T)


def _zero_jumps(t: Tables) -> Tables:
    T = np.array(t.T)
    T[30:] = t.w.measure(t.q[30:] + np.radians(1.0) * np.eye(t.q.shape[1])[2])
    return replace(t, T=T)


BAD |= {
    "random numbers as positions": both(_random),
    "positions in reverse order of rows": both(lambda t, q, T: (q, T[::-1])),
    "rows shifted by one": both(lambda t, q, T: (q[1:], T[:-1])),
    "rows of a path shifted by one": both(_late(1), "path"),
    "all points on a line": _own(lambda t: t, "line"),
    "a joint that was never read": both(lambda t, q, T: (_column(q, 3, 0.0), T)),
    "joints in reverse order": both(lambda t, q, T: (q[:, ::-1], T)),
    "two joints swapped": both(lambda t, q, T: (q[:, [0, 2, 1, *range(3, q.shape[1])]], T)),
    "URDF of another robot": _another,
    "gear ratio 5 % off": both(lambda t, q, T: (_column(q, 2, 1.05 * q[:, 2]), T)),
    "lengths 5 % too long": _scaled,
    "base moved 1 mm midway": _own(lambda t: replace(t, T=_moved(t.T, slice(30, None), [0.7e-3, -0.5e-3, 0.5e-3]))),
    "base moved 100 mm midway": _own(lambda t: replace(t, T=_moved(t.T, slice(30, None), [0.1, 0.0, 0.0]))),
    "base moved 1 mm on a path": _own(
        lambda t: replace(t, T=_moved(t.T, slice(400, None), [0.7e-3, -0.5e-3, 0.5e-3])), "path"
    ),
    "ten samples late on a path": both(_late(10), "path"),
    "two samples early on a path": both(lambda t, q, T: (q[:-2], T[2:]), "path"),
    "validation is the identification table": _own(lambda t: replace(t, v=t.q, U=t.T)),
    "validation is it, shuffled": _own(lambda t: replace(t, v=t.q[::-1], U=t.T[::-1])),
    "validation is it, shuffled and rounded": _own(
        lambda t: replace(t, v=np.radians(np.round(np.degrees(t.q[::-1]), 2)), U=np.round(t.T[::-1], 5))
    ),
    "one validation row": _own(lambda t: replace(t, v=t.v[:1], U=t.U[:1])),
    "no significant improvement": _no_errors,
    "millimetres as metres": both(lambda t, q, T: (q, T * np.array([1.0, 1.0, 1.0, 1e3]))),
    "degrees as radians": both(lambda t, q, T: (np.degrees(q), T)),
    "sign of a joint": both(lambda t, q, T: (_column(q, 2, -q[:, 2]), T)),
    "zero of a joint jumps by 1 deg": _own(_zero_jumps),
    "tool changed midway": _own(_tool),
    "frozen tracker": both(_frozen),
    "y and z swapped": both(lambda t, q, T: (q, T[:, [0, 2, 1, 3]])),
    "left-handed frame": both(lambda t, q, T: (q, T * np.array([1.0, 1.0, -1.0, 1.0])[:, None])),
    "half of the rows another robot's": _half_another(interleaved=False),
    "half of the rows another robot's, mixed": _half_another(interleaved=True),
    "drift of 30 mm": both(
        lambda t, q, T: (
            q,
            T + np.linspace(0.0, 0.03, len(q))[:, None, None] * np.array([[0, 0, 0, 1.0]] * 3 + [[0] * 4]),
        )
    ),
    "random walk of centimetres": both(
        lambda t, q, T: (q, _moved(T, slice(None), np.cumsum(t.w.rng.normal(0, 2e-3, (len(q), 3)), axis=0)))
    ),
    "30 % outliers, least squares": both(_wild),
    "validation by another machine": _own(lambda t: replace(t, U=_other_world(t, 5).measure(t.v))),
    "base moved 2 mm before the validation": _own(lambda t: replace(t, U=_moved(t.U, slice(None), [2e-3, 0.0, 0.0]))),
    "a joint that never moved": both(lambda t, q, T: (_column(q, 4, 0.5), t.w.measure(_column(q, 4, 0.5)))),
    "ten positions": _own(lambda t: replace(t, q=t.q[:10], T=t.T[:10])),
    "elbow counted from the floor": both(lambda t, q, T: (_column(q, 2, q[:, 1] + q[:, 2]), T)),
    "inches as millimetres": both(lambda t, q, T: (q, T / np.array([1.0, 1.0, 1.0, 25.4]))),
}


# ---- ten more, written down before any of them was judged


def _slips(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    lost = np.radians(0.3) * (np.arange(len(q)) // 15)
    return q, t.w.measure(q - lost[:, None] * np.eye(q.shape[1])[3])


def _two_reflectors(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    tools = np.array(t.w.state.tools)
    tools[..., :3, 3] += np.array([0.0, 40e-3, 0.0])
    rows = np.arange(len(q)) % 3 == 0
    T[rows] = t.w.measure(q[rows], replace(t.w.state, tools=tools))
    return q, T


def _half_scaled(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    x = T[:, :3, 3]
    far = x[:, 0] > np.median(x[:, 0])
    T[far, :3, 3] = x.mean(axis=0) + 1.01 * (x[far] - x.mean(axis=0))
    return q, T


def _stale_wrist(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    stale = np.array(q[3:])
    stale[:, 4:] = q[:-3, 4:]
    return stale, T[3:]


def _rolled_over(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    T[:, :3, 3] = (T[:, :3, 3] + 0.512) % 1.024 - 0.512
    return q, T


def _sorted(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    return q, T[np.argsort(T[:, 0, 3])]


def _bends(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    rows = t.w.rng.random(len(q)) < 0.5
    droop = np.radians(0.5) * (np.eye(q.shape[1])[1] + np.eye(q.shape[1])[3])
    T[rows] = t.w.measure(q[rows] + droop)
    return q, T


def _backlash(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    return q, t.w.measure(q + np.radians(0.5) * np.sign(np.sin(7.0 * q[:, :1])) * np.eye(q.shape[1])[1])


def _inverse(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    return q, np.linalg.inv(T)


LATER |= {
    "a joint slips by 0.3 deg every 15 rows": both(_slips),
    "every third row another reflector, not said": both(_two_reflectors),
    "half of the volume 1 % too large": both(_half_scaled),
    "wrist readings three rows old, on a path": both(_stale_wrist, "path"),
    "coordinates rolled over at 512 mm": both(_rolled_over),
    "positions sorted, readings not": both(_sorted),
    "half of the rows with a payload that bends": both(_bends),
    "1 deg of backlash that nobody modelled": both(_backlash),
    "robot seen from the tool": both(_inverse),
    "one joint in degrees": both(lambda t, q, T: (_column(q, 5, np.degrees(q[:, 5])), T)),
}


# ---- ten more, written down when the check for rows of two machines was there, and before any of them was judged


def _seldom(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    rows = t.w.rng.random(len(q)) < 0.1
    T[rows] = t.w.measure(q[rows] + np.radians(0.5) * (np.eye(q.shape[1])[1] + np.eye(q.shape[1])[3]))
    return q, T


def _three_loads(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    load = t.w.rng.integers(0, 3, (len(q), 1))
    return q, t.w.measure(q + np.radians(0.4) * load * (np.eye(q.shape[1])[1] + np.eye(q.shape[1])[2]))


def _sometimes_swapped(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    rows = t.w.rng.random(len(q)) < 0.1
    T[rows] = T[rows][:, [1, 0, 2, 3]]
    return q, T


def _jitter(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    late = t.w.rng.integers(0, 4, len(q) - 3)
    return q[3:], T[np.arange(3, len(q)) - late]


def _leaning(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    lean = 2e-3 * np.stack([np.sin(q[:, 0]), np.cos(q[:, 0]), np.zeros(len(q))], axis=1)
    base = np.array(t.w.state.base).reshape(-1, 4, 4)[0]
    turns = np.zeros((len(q), 4, 4)) + np.eye(4)
    turns[:, :3, :3] = Rotation.from_rotvec(lean).as_matrix()
    return q, base @ turns @ np.linalg.inv(base) @ T


def _bent(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    return q, t.w.measure(q + 0.02 * q[:, 1:2] * np.eye(q.shape[1])[2])


def _stretched(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    T[:, 2, 3] *= 1.01
    return q, T


def _new_zero(t: Tables) -> Tables:
    return replace(t, U=t.w.measure(t.v + np.radians(0.5) * np.eye(t.v.shape[1])[2]))


LAST |= {
    "a tenth of the rows with a payload that bends": both(_seldom),
    "three payloads, not said": both(_three_loads),
    "x and y swapped in a tenth of the rows": both(_sometimes_swapped),
    "readings rounded to whole degrees": both(lambda t, q, T: (np.radians(np.round(np.degrees(q))), T)),
    "none to three samples late at random, on a path": both(_jitter, "path"),
    "a joint whose reading has lost its sign": both(lambda t, q, T: (_column(q, 3, np.abs(q[:, 3])), T)),
    "one axis of the instrument 1 % too long": both(_stretched),
    "a base that leans by 2 mrad after the arm": both(_leaning),
    "a joint that follows its neighbour by 2 %": both(_bent),
    "a zero off by 0.5 deg in the validation": _own(_new_zero),
}
