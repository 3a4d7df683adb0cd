"""What a controller and a tracker write down while an arm moves: two clocks, jitter, lost samples, correlated noise.

Nothing of calib's mathematics is used.

    python scripts/simulate/streams.py [output folder] [--seed 1] [--seconds 80]

writes a UR10 with 80 s of motion as a job: ``tracker.csv`` and ``joints.csv``, whose clocks are 7.3 s and 0.1 % apart,
and ``truth.toml``.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from numpy.typing import NDArray

from scripts.development.judge_machines import arm

Array = NDArray[np.float64]
Rng = np.random.Generator
Points = Callable[[Array], Array]

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
JOB = """schema = 1

[robot]
urdf = "{urdf}"
tip = "{tip}"

[error_model]
offsets = "all"
placements = "all"

[[measurements]]
file = "tracker.csv"          # time [s], x, y, z
readings = "joints.csv"       # time [s], joints
clock = "free"                # offset and skew become parameters clock.offset, clock.skew
sigma = "0.1 mm"
hold_out = 0.25
"""


@dataclass(frozen=True)
class Motion:
    """Readings (n, k) at any time: sums of sines around ``middle`` (k,)."""

    middle: Array
    amplitudes: Array
    rates: Array
    phases: Array

    def at(self, t: Array) -> Array:
        waves = self.amplitudes * np.sin(np.multiply.outer(t, self.rates) + self.phases)
        return np.asarray(self.middle + waves.sum(axis=-1))


def motion(
    rng: Rng, ranges: Sequence[tuple[float, float]], *, swing: float = 0.35, periods: tuple[float, float] = (4.0, 20.0)
) -> Motion:
    """A motion of every joint by six sines, ``swing`` rad or m to either side, that never repeats itself."""
    low, high = np.transpose(list(ranges))
    middle = rng.uniform(np.maximum(low, -1.5), np.minimum(high, 1.5))
    period = np.exp(rng.uniform(*np.log(periods), (len(low), 6)))
    amplitudes = rng.uniform(0.3, 1.0, (len(low), 6))
    amplitudes *= swing / amplitudes.sum(axis=1, keepdims=True)
    return Motion(middle, amplitudes, 2.0 * np.pi / period, rng.uniform(0.0, 2.0 * np.pi, (len(low), 6)))


def remembering(rng: Rng, times: Array, memory: float, width: int = 3) -> Array:
    """Noise (n, width) of standard deviation 1 at times (n,), correlated by exp(-dt / memory)."""
    white = rng.normal(size=(len(times), width))
    if memory <= 0.0:
        return np.asarray(white)
    keep = np.exp(-np.diff(times, prepend=times[0]) / memory)
    found = np.empty_like(white)
    found[0] = white[0]
    for n in range(1, len(times)):
        found[n] = keep[n] * found[n - 1] + np.sqrt(1.0 - keep[n] ** 2) * white[n]
    return found


@dataclass(frozen=True)
class Recorded:
    """Joints, ``readings`` (n, k) at ``stamps`` (n,), and ``points`` (m, 3) at ``times`` (m,), each by its own clock.

    ``true_times`` (m,): those of the points by the controller's clock, which shows ``u = t - offset + skew (t -
    middle)`` when the tracker's shows t.
    """

    stamps: Array
    readings: Array
    times: Array
    points: Array
    true_times: Array
    offset: float
    skew: float
    middle: float

    def offset_at(self, t: float) -> float:
        """The offset, told at another time t of the tracker."""
        return self.offset - self.skew * (t - self.middle)


def record(
    rng: Rng,
    moving: Motion,
    points: Points,
    *,
    seconds: float = 60.0,
    offset: float = 7.3,
    skew: float = 1e-3,
    sigma: float = 1e-4,
    memories: Sequence[float] = (),
    jitter: float = 0.0,
    lost: float = 0.0,
    rates: tuple[float, float] = (149.0, 60.0),
) -> Recorded:
    """Record a motion; ``points`` returns where the tool is (n, 3), in m, at readings (n, k).

    ``memories`` in s: of noises that add up with white noise to ``sigma`` in m. ``jitter``: standard deviation of the
    joints' time stamps, in s; ``lost``: share of all samples. ``rates``: samples of joints and points a second.
    """
    u = np.arange(0.0, seconds, 1.0 / rates[0])
    true = np.arange(1.0, seconds - 1.0, 1.0 / rates[1])
    u, true = (x[rng.random(len(x)) >= lost] for x in (u, true))
    half = 0.5 * (true[0] + true[-1])
    seen = points(moving.at(true))
    parts = [remembering(rng, true, memory) for memory in (0.0, *memories)]
    return Recorded(
        np.sort(u + jitter * rng.normal(size=len(u))),
        moving.at(u),
        half + offset + (true - half) / (1.0 + skew),
        seen + sigma * np.sum(parts, axis=0) / np.sqrt(len(parts)),
        true,
        offset,
        skew,
        half + offset,
    )


def write_table(path: Path, titles: Sequence[str], *columns: Array) -> None:
    """Write a table of numbers."""
    rows = np.column_stack(columns)
    np.savetxt(path, rows, fmt="%.9f", delimiter=",", header=",".join(titles), comments="")


def write_case(folder: Path, seed: int, seconds: float) -> None:
    """Write the job of a badly made UR10."""
    rng = np.random.default_rng(seed)
    found = arm(*UR10)
    deviations = rng.normal(scale=np.repeat((0.5e-3, 1e-3), 3), size=(1, len(found.joints), 6))
    offsets = rng.normal(scale=5e-3, size=(1, len(found.ranges)))
    tool, base = np.array([0.02, 0.03, 0.1]), rng.uniform(-2.0, 2.0, 3)

    def points(q: Array) -> Array:
        tips = found.tips(q, deviations, offsets)[0]
        return np.asarray(tips[:, :3, 3] + tips[:, :3, :3] @ tool + base)

    moving = motion(rng, list(found.ranges.values()))
    made = record(rng, moving, points, seconds=seconds, memories=(0.05, 0.5), jitter=3e-4, lost=0.02)
    folder.mkdir(parents=True, exist_ok=True)
    write_table(
        folder / "joints.csv", ["time [s]", *(f"{name} [rad]" for name in found.ranges)], made.stamps, made.readings
    )
    write_table(folder / "tracker.csv", ["time [s]", "x [m]", "y [m]", "z [m]"], made.times, made.points)
    (folder / "calibration.toml").write_text(JOB.format(urdf=UR10[0], tip=UR10[1]), encoding="utf-8", newline="\n")
    truth = f"offset = {made.offset}\nskew = {made.skew}\nmiddle = {made.middle:.6f}\n"
    (folder / "truth.toml").write_text(truth, encoding="utf-8", newline="\n")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, nargs="?", default=Path("streams"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=80.0)
    arguments = parser.parse_args()
    write_case(arguments.out, arguments.seed, arguments.seconds)
    return 0


if __name__ == "__main__":
    sys.exit(main())
