"""Sessions of arms that move while they are measured, and of photographs: sound ones, and what can be wrong with them.

    moving(7)                   a sound session, drawn at random: streams, rows with times, photographs
    NEXT["..."]("baxter", 0, 0.0)   ten bad situations, also with two tools and two set-ups

Truth and measurements have none of calib's mathematics: :mod:`scripts.development.judge_machines`, streams by
:mod:`scripts.simulate.streams`.
"""

# ruff: noqa: ARG001 - all changes of a table are called alike.

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import calib
from scripts.development.judge_cases import BOARD, LENS, Errors, pose, reading_columns
from scripts.development.judge_machines import Array, Lens, inverse, placed
from scripts.simulate.streams import Recorded, motion, record
from scripts.studies.verdict_sessions import (
    Make,
    Session,
    Tables,
    Unseen,
    World,
    both,
    reading_rows,
    readings,
    sound_tables,
    whole,
    world,
)

SWING = 0.35
SIZE = (1280, 1024)
NUMBERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")


# ---- streams


def recorded(w: World, seconds: float, sigma: float, rates: tuple[float, float], **how: Any) -> Recorded:
    """A motion through a part of the joints' ranges, as controller and tracker write it down."""
    moving = motion(w.rng, list(w.arm.ranges.values()), swing=SWING)
    return record(
        w.rng, moving, lambda q: np.asarray(w.placed(q)[:, :3, 3]), seconds=seconds, sigma=sigma, rates=rates, **how
    )


def streamed(w: World, made: Recorded, clock: str, sigma: float) -> tuple[calib.Measurements, calib.Measurements]:
    """The stream of a recording, and a quarter of it that is held out."""
    times = made.times if clock == "free" else made.true_times
    seen = {"time [s]": times} | {f"{axis} [m]": made.points[:, k] for k, axis in enumerate("xyz")}
    joints = {"time [s]": made.stamps} | reading_columns(w.arm, made.readings)
    data = calib.measuring.read_stream(seen, w.robot, joints, clock="free" if clock == "free" else "given", sigma=sigma)
    return calib.hold_out(data, 0.25)


def along(w: World, made: Recorded, n: int = 200) -> Unseen:
    """Poses of the range that a recording went through, and where the tool is there."""
    low, high = made.readings.min(axis=0), made.readings.max(axis=0)
    q = w.rng.uniform(low, high, (n, len(low)))
    return Unseen(q, w.placed(q))


# ---- photographs


def photographs(w: World, n: int, sigma: float) -> tuple[World, Array, Array]:
    """A world whose tool is a camera, readings (n, k) at which it sees a board, and pixels (n, m, 2) of its marks."""
    lens = Lens(True, **LENS)
    while True:
        eye = placed(pose(w.rng, 1.0)[:3, :3], w.rng.uniform(-0.08, 0.08, 3))
        there = replace(w, state=replace(w.state, base=np.eye(4)[None], tools=eye[None, None]))
        at = there.placed(readings(w, 1))[0]
        away = placed(np.eye(3), np.array([*w.rng.uniform(-0.1, 0.1, 2), w.rng.uniform(0.4, 0.9)]))
        away[:3, :3] = pose(w.rng, 1.0)[:3, :3]
        if away[2, 2] > -0.75:
            continue
        board = at @ away @ placed(np.eye(3), -BOARD.mean(axis=0))
        q = np.zeros((0, len(w.arm.ranges)))
        for _ in range(40):
            some = readings(w, 4000, 1.0)
            q = np.concatenate([q, some[_in_sight(_marks(there, board, some))]])
            if len(q) >= n:
                pixels = lens.see(_marks(there, board, q[:n]))
                return there, q[:n], pixels + sigma * w.rng.standard_normal(pixels.shape)


def _marks(w: World, board: Array, q: Array) -> Array:
    T = inverse(w.placed(q)) @ board
    return np.asarray(BOARD @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3])


def _in_sight(marks: Array) -> Array:
    near = np.abs(marks[..., :2]).max(axis=-1) < 0.42 * marks[..., 2]
    seen = np.all(near & (marks[..., 2] > 0.2) & (marks[..., 2] < 1.5), axis=1)
    # The printed side is seen, and not from its edge.
    normal = np.cross(marks[:, 1] - marks[:, 0], marks[:, 4] - marks[:, 0])
    return np.asarray(seen & (np.abs(normal[:, 2]) > 0.3 * np.linalg.norm(normal, axis=1)))


def pictured(w: World, q: Array, pixels: Array, sigma: float, *, free: bool) -> Session:
    """The session of photographs, a third of them held out."""
    m = len(BOARD)
    columns = reading_columns(w.arm, np.repeat(q, m, axis=0)) | {"target": ["board"] * (len(q) * m)}
    columns |= {f"{name} [px]": pixels[..., k].ravel() for k, name in enumerate("uv")}
    columns |= {f"board_{axis} [m]": np.tile(BOARD, (len(q), 1))[:, k] for k, axis in enumerate("xyz")}
    lens: dict[str, Any] = {"free": NUMBERS, "size": SIZE} if free else LENS
    camera = calib.measuring.Camera("tip", **lens, sigma=sigma)
    data = calib.read_measurements(columns, w.robot, "pixels", instrument=camera)
    own, held = calib.hold_out(data, 0.3)
    return Session({}, calib.error_model(w.robot, offsets="all", placements="all", tool="pose"), (own,), (held,))


# ---- sound sessions


def moving(seed: int) -> Session:
    """A session in motion, or through a lens, that is as it should be, labelled before anything is judged."""
    rng = np.random.default_rng([seed, 25])
    layout = str(rng.choice(["clock free", "clock given", "times", "lens free", "lens given"]))
    which = str(rng.choice(["ur5", "ur10", "panda"]))
    wobble = float(rng.choice([0.0, 0.05e-3, 0.1e-3, 0.15e-3]))
    stated = bool(rng.random() < 0.6)
    errors = Errors(float(np.radians(rng.choice([0.3, 1.0]))), float(rng.choice([0.2e-3, 0.5e-3])), 1e-3)
    label: dict[str, Any] = {"layout": layout, "robot": which, "wobble": wobble}
    if layout.startswith("lens"):
        sigma = float(rng.choice([0.03, 0.1, 0.3]))
        w, q, pixels = photographs(world(which, rng, errors, 0.0, wobble), int(rng.integers(30, 60)), sigma)
        made = pictured(w, q, pixels, sigma if stated else 0.0, free=layout == "lens free")
        told = sigma * stated
    else:
        sigma = float(rng.choice([0.05e-3, 0.1e-3, 0.2e-3]))
        told = sigma * float(rng.choice([0.5, 1.0, 2.0])) * stated
        w = world(which, rng, errors, sigma, wobble)
        how = {
            "memories": ((), (0.05, 0.5))[int(rng.integers(2))],
            "jitter": float(rng.choice([0.0, 3e-4])),
            "lost": 0.02,
        }
        how |= {"offset": float(rng.uniform(0.0, 60.0)), "skew": float(rng.uniform(-2e-3, 2e-3))}
        rates = (float(rng.choice([50.0, 125.0])), float(rng.choice([20.0, 30.0])))
        stream = recorded(w, float(rng.choice([60.0, 90.0])), sigma, rates, **how)
        if layout == "times":
            # One clock, and readings at the very times of the points.
            at = np.stack([np.interp(stream.true_times, stream.stamps, x) for x in stream.readings.T], axis=1)
            columns = reading_rows(w, at, w.measure(at)) | {"time [s]": stream.true_times}
            data = calib.read_measurements(columns, w.robot, sigma=told)
            first = np.arange(len(data)) < 2 * len(data) // 3
            own, held = data.subset(first), data.subset(~first)
        else:
            own, held = streamed(w, stream, layout.removeprefix("clock "), told)
        made = Session({}, whole(w.robot), (own,), (held,))
    return replace(made, label=label | {"sigma": sigma, "stated": told, "rows": len(made.own[0])})


# ---- ten bad situations, written down before any of them was judged

NEXT: dict[str, Make] = {}


def _stream(change: Callable[[World, Recorded], Recorded]) -> Make:
    def make(which: str, seed: int, sigma: float) -> Session:
        rng = np.random.default_rng([seed, 26, *which.encode()])
        w = world(which, rng, Errors(np.radians(1.0), 0.5e-3, 1e-3), 0.05e-3, 0.05e-3)
        made = recorded(w, 80.0, w.sigma, (100.0, 20.0), offset=7.3, skew=1e-4)
        own, held = streamed(w, change(w, made), "free", sigma)
        label = {"robot": which, "stated": sigma}
        return Session(label, whole(w.robot), (own,), (held,), unseen=along(w, made))

    return make


def _clock_stops(w: World, made: Recorded) -> Recorded:
    late = 0.05 * (np.arange(len(made.times)) > len(made.times) // 2)
    return replace(made, times=made.times + late)


def _one_joint_late(w: World, made: Recorded) -> Recorded:
    read = np.array(made.readings)
    read[4:, 1] = read[:-4, 1]
    return replace(made, readings=read)


def _smoothed(w: World, made: Recorded) -> Recorded:
    sums = np.cumsum(np.vstack([np.zeros(made.readings.shape[1]), made.readings]), axis=0)
    return replace(made, readings=(sums[50:] - sums[:-50]) / 50.0, stamps=made.stamps[49:])


def _pictures(change: Callable[[World, Array], Array]) -> Make:
    def make(which: str, seed: int, sigma: float) -> Session:
        rng = np.random.default_rng([seed, 27, *which.encode()])
        w, q, pixels = photographs(world(which, rng, Errors(np.radians(1.0), 0.5e-3, 1e-3), 0.0, 0.05e-3), 50, 0.1)
        made = pictured(w, q, change(w, pixels), 0.1 if sigma else 0.0, free=True)
        new = readings(w, 200)
        return replace(made, label={"robot": which, "stated": sigma}, unseen=Unseen(new, w.placed(new)))

    return make


def _zoomed(w: World, pixels: Array) -> Array:
    out, centre = np.array(pixels), np.array([LENS["cx"], LENS["cy"]])
    half = len(out) // 2
    out[half:] = centre + 1.01 * (out[half:] - centre)
    return out


def _turned(w: World, pixels: Array) -> Array:
    out, some = np.array(pixels), w.rng.random(len(pixels)) < 0.2
    out[some] = out[some, ::-1]
    return out


def _named(column: str, name: Callable[[World, Array], tuple[Array, Array]]) -> Make:
    """Two tools, or two set-ups, by turns; ``name`` says of rows with which they were measured, and what is told."""

    def make(which: str, seed: int, sigma: float) -> Session:
        t = sound_tables(which, seed)
        w, other = t.w, t.w.state
        if column == "tool":
            tools = np.array(other.tools)
            tools[..., :3, 3] += np.array([0.02, -0.03, 0.05])
            other = replace(other, tools=tools)
        else:
            other = replace(other, base=pose(w.rng, 3.0)[None])
        sets = []
        for n in (120, 60):
            q = readings(w, n)
            true, told = name(w, q)
            T = np.where(true[:, None, None], w.measure(q, other), w.measure(q))
            columns = reading_rows(w, q, T) | {column: [("tool", "b")[int(k)] for k in told]}
            sets.append(calib.read_measurements(columns, w.robot, sigma=sigma))
        new = readings(w, 200)
        unseen = Unseen(new, w.placed(new), setup="tool" if column == "setup" else None)
        return Session({"robot": which, "stated": sigma}, whole(w.robot), (sets[0],), (sets[1],), unseen=unseen)

    return make


def _exchanged(share: float) -> Callable[[World, Array], tuple[Array, Array]]:
    def name(w: World, q: Array) -> tuple[Array, Array]:
        true = np.arange(len(q)) % 2 == 1
        return true, true ^ (w.rng.random(len(q)) < share)

    return name


def _sags(which: str, seed: int, sigma: float) -> Session:
    t = sound_tables(which, seed)
    w, wall = t.w, replace(t.w.state, base=pose(t.w.rng, 3.0)[None])
    droop = np.radians(0.3) * (np.eye(t.q.shape[1])[1] + np.eye(t.q.shape[1])[3])
    sets = []
    for n in (120, 60):
        q, second = readings(w, n), np.arange(n) >= n // 2
        T = np.where(second[:, None, None], w.measure(q + droop * np.sin(q[:, 1:2]), wall), w.measure(q))
        columns = reading_rows(w, q, T) | {"setup": [("floor", "wall")[int(k)] for k in second]}
        sets.append(calib.read_measurements(columns, w.robot, sigma=sigma))
    new = readings(w, 200)
    unseen = Unseen(new, w.placed(new), setup="floor")
    return Session({"robot": which, "stated": sigma}, whole(w.robot), (sets[0],), (sets[1],), unseen=unseen)


def _plays(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    # The nest of the reflector lets it fall by a millimetre along its own x, whichever way that is down.
    falls = 0.5e-3 * np.sign(T[:, 2, 0])
    T[:, :3, 3] -= falls[:, None] * T[:, :3, 0]
    return q, T


def _warms(t: Tables, q: Array, T: Array) -> tuple[Array, Array]:
    base = np.array(t.w.state.base).reshape(-1, 4, 4)[0]
    # Links and tool grow by 0.2 % from the first row to the last; what is held out is measured warm.
    growth = 2e-3 * (np.arange(len(q)) / len(q) if len(q) == len(t.q) else np.ones(len(q)))
    T[:, :3, 3] += growth[:, None] * (T[:, :3, 3] - base[:3, 3])
    return q, T


NEXT |= {
    "stream: the tracker's clock stops for 50 ms": _stream(_clock_stops),
    "stream: readings of one joint 40 ms old": _stream(_one_joint_late),
    "stream: readings are means of the last half second": _stream(_smoothed),
    "photographs: 1 % more zoom from the middle on": _pictures(_zoomed),
    "photographs: a fifth with the board read the other way round": _pictures(_turned),
    "two tools, their names exchanged in a tenth of the rows": _named("tool", _exchanged(0.1)),
    "two set-ups, their names exchanged in a fifth of the rows": _named("setup", _exchanged(0.2)),
    "two set-ups, and a payload in one that is not told": _sags,
    "a reflector that falls by 1 mm to one side": both(_plays),
    "an arm that grows by 0.2 % while it warms up": both(_warms),
}
