"""Simulated UR10 streams: how well clock and machine are found, and whether what is stated of them holds.

    python scripts/studies/clocks.py --store clocks.jsonl [--sessions 40] [--cells TEXT] [--minutes 30]
    python scripts/studies/clocks.py --store clocks.jsonl --markdown docs/clocks_study.md

Joints at 149 Hz, a tracker at 60 Hz; its clock is 0 to 60 s ahead and runs by up to 2e-3 faster or slower; time stamps
of the joints jitter by 0.3 ms, 2 % of all samples are lost, and the noise, 0.1 mm in all, is a third white, a third
correlated over 50 ms and a third over 500 ms. Each machine is badly made: 0.5 mm, 1 mrad, zeros 5 mrad. Every session
is a line of the store, and fitted twice: with the clock free, and with the true clock given. Machines are made and
walked by scripts/development/judge_machines.py, streams by scripts/simulate/streams.py: nothing of calib's mathematics.
"""

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.chance import bound
from calib.machine.of_fit import machine_of
from calib.machine.tool_uncertainty import tool_uncertainty
from scripts.development.judge_machines import Array, arm
from scripts.simulate.streams import UR10, Recorded, motion, record
from scripts.studies.store import simulate, stored

SIGMA = 1e-4
MEMORIES = (0.05, 0.5)
# Seconds, and how far joints swing, in rad.
CELLS = {
    "60 s, fast": (60.0, 0.35),
    "120 s, fast": (120.0, 0.35),
    "60 s, slow": (60.0, 0.08),
    "20 s, fast": (20.0, 0.35),
}
UNSEEN = 200
NORMAL = 1.959964


def session(cell: str, seed: int) -> dict[str, Any]:
    """The figures of one session, in s, m and their ratios."""
    seconds, swing = CELLS[cell]
    rng = np.random.default_rng([seed, *cell.encode()])
    found, robot = arm(*UR10), calib.load_robot(*UR10)
    deviations = rng.normal(scale=np.repeat((0.5e-3, 1e-3), 3), size=(1, len(found.joints), 6))
    offsets = rng.normal(scale=5e-3, size=(1, len(found.ranges)))
    turn, place = Rotation.random(rng=rng).as_matrix(), rng.uniform(-2.0, 2.0, 3)
    tool = np.array([0.02, 0.03, 0.1]) + rng.normal(scale=0.02, size=3)

    def points(q: Array) -> Array:
        tips = found.tips(q, deviations, offsets)[0]
        return np.asarray((tips[:, :3, 3] + tips[:, :3, :3] @ tool) @ turn.T + place)

    moving = motion(rng, list(found.ranges.values()), swing=swing)
    how = {"offset": rng.uniform(0.0, 60.0), "skew": rng.uniform(-2e-3, 2e-3)}
    made = record(rng, moving, points, seconds=seconds, sigma=SIGMA, memories=MEMORIES, jitter=3e-4, lost=0.02, **how)
    model = calib.error_model(robot, offsets="all", placements="all")
    joints = {"time [s]": made.stamps} | {f"{name} [rad]": made.readings[:, k] for k, name in enumerate(found.ranges)}
    # Poses of the same joints' ranges that the streams did not pass through.
    unseen = moving.middle + rng.uniform(-swing, swing, (UNSEEN, len(found.ranges)))
    free, own = fitted(model, robot, made, made.times, joints, "free")
    known, _ = fitted(model, robot, made, made.true_times, joints, "given")
    step = 0.1
    moved = np.diff(points(moving.at(np.arange(1.0, seconds - 1.0, step))), axis=0) / step
    names = [parameter.name for parameter in free.parameters]
    at = {name: names.index(f"clock.{name}") for name in ("offset", "skew")}
    assert own.stream is not None
    truth = {"offset": made.offset_at(own.stream.middle), "skew": made.skew}
    errors = [predicted(fit, unseen) - points(unseen) for fit in (free, known)]
    misses = [float(np.sqrt(np.mean(np.sum(e**2, axis=1)))) for e in errors]
    return {
        "speed": float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))),
        **{name: float(free.values[k] - truth[name]) for name, k in at.items()},
        **{f"{name} sigma": float(free.sigmas[k]) for name, k in at.items()},
        "alone": float(np.sqrt(free.covariance_alone[at["offset"], at["offset"]])),
        "miss": misses[0],
        "miss with the clock known": misses[1],
        "inside": inside(free, unseen, errors[0]),
        "rows": len(own),
        "rows as one": float(np.mean([memory.rows_as_one for memory in free.memories] or [1.0])),
    }


def fitted(
    model: calib.ErrorModel, robot: calib.Robot, made: Recorded, times: Array, joints: Mapping[str, Array], clock: str
) -> tuple[calib.Fit, calib.Measurements]:
    seen = {"time [s]": times} | {f"{axis} [m]": made.points[:, k] for k, axis in enumerate("xyz")}
    data = calib.measuring.read_stream(seen, robot, joints, clock=clock, sigma=SIGMA)
    return calib.identify(model, data), data


def predicted(fit: calib.Fit, readings: Array) -> Array:
    """Points of the tool (N, 3) in the tracker's frame, in m."""
    tips = fit.robot.tips(readings, fit.deviations)
    return np.asarray((fit.machine.frames.base @ tips @ fit.machine.frames.tools[0])[:, :3, 3])


def inside(fit: calib.Fit, readings: Array, errors: Array) -> float:
    """Share of true points inside the stated 95 % regions around what was predicted, by its errors (N, 3)."""
    said = tool_uncertainty(machine_of(fit), readings)
    squares = np.einsum("ni,ni->n", errors, np.linalg.solve(said.covariance[:, :3, :3], errors[:, :, None])[..., 0])
    return float(np.mean(squares <= bound(0.95, 3, said.degrees_of_freedom)))


HEAD = (
    "| streams | sessions | tip speed, rms | clock error, rms / largest [ms] | its sigma [ms] "
    "| as if rows erred alone [ms] | offset in 95 % | skew in 95 % | points in 95 % regions "
    "| machine / with the clock known |",
    "|---|---|---|---|---|---|---|---|---|---|",
)


def row(cell: str, told: Sequence[Mapping[str, Any]]) -> str:
    """A line of the table."""
    counted = [t for t in told if "refused" not in t]
    if not counted:
        return f"| {cell} | 0 | | | | | | | | |"
    x = {name: np.array([t[name] for t in counted]) for name in counted[0] if name not in ("cell", "seed")}
    rms = {name: float(np.sqrt(np.mean(values**2))) for name, values in x.items()}
    held = {name: float(np.mean(np.abs(x[name]) <= NORMAL * x[f"{name} sigma"])) for name in ("offset", "skew")}
    return (
        f"| {cell} | {len(counted)}{f' and {len(told) - len(counted)} refused' if len(told) > len(counted) else ''} "
        f"| {rms['speed']:.2f} m/s | {1e3 * rms['offset']:.3f} / {1e3 * np.abs(x['offset']).max():.3f} "
        f"| {1e3 * np.median(x['offset sigma']):.3f} | {1e3 * np.median(x['alone']):.3f} | {held['offset']:.2f} "
        f"| {held['skew']:.2f} | {np.mean(x['inside']):.3f} "
        f"| {1e3 * rms['miss']:.3f} / {1e3 * rms['miss with the clock known']:.3f} mm = "
        f"{rms['miss'] / rms['miss with the clock known']:.2f} |"
    )


def table(told: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    return "\n".join([*HEAD, *(row(cell, sessions) for cell, sessions in told.items())]) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--sessions", type=int, default=40)
    parser.add_argument("--cells", default="", help="only those whose name has this")
    parser.add_argument("--minutes", type=float, default=float("inf"))
    parser.add_argument("--markdown", type=Path, help="the table is written there, and nothing is simulated")
    arguments = parser.parse_args()
    if arguments.markdown is None:
        chosen = [cell for cell in CELLS if arguments.cells in cell]
        simulate(arguments.store, chosen, arguments.sessions, time.monotonic() + 60.0 * arguments.minutes, session)
    text = table(stored(arguments.store, CELLS))
    if arguments.markdown is not None:
        arguments.markdown.write_text(text, encoding="utf-8", newline="\n")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
