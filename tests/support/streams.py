"""Simulated streams: an arm that never repeats itself, two clocks, jitter, lost samples, noise that remembers.

Nothing of calib is in it but what reads the tables.
"""

from dataclasses import dataclass

import numpy as np

import calib
from tests.support import machines
from tests.support.machines import Array, Rng

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")


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


def motion(rng: Rng, arm: machines.Arm, *, swing: float = 0.35, shortest: float = 4.0, longest: float = 20.0) -> Motion:
    """A motion of every joint by six sines, ``swing`` rad or m wide; periods from ``shortest`` to ``longest`` s."""
    low, high = np.transpose(list(arm.ranges.values()))
    k = len(low)
    middle = rng.uniform(np.maximum(low, -1.5), np.minimum(high, 1.5))
    periods = np.exp(rng.uniform(np.log(shortest), np.log(longest), (k, 6)))
    amplitudes = rng.uniform(0.3, 1.0, (k, 6))
    amplitudes *= swing / amplitudes.sum(axis=1, keepdims=True)
    return Motion(middle, amplitudes, 2.0 * np.pi / periods, rng.uniform(0.0, 2.0 * np.pi, (k, 6)))


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
class Streams:
    """What controller and tracker wrote down: ``joints`` and ``seen`` are tables, the truth beside them.

    The controller's clock shows ``u = t - offset + skew (t - middle)`` when the tracker's shows t.
    """

    robot: calib.Robot
    machine: machines.Machine
    motion: Motion
    joints: dict[str, Array]
    seen: dict[str, Array]
    offset: float
    skew: float
    middle: float

    def offset_at(self, t: float) -> float:
        """The offset, told at another time t of the tracker."""
        return self.offset - self.skew * (t - self.middle)


def streams(
    seed: int,
    *,
    arm: tuple[str, str] = UR10,
    seconds: float = 60.0,
    offset: float = 7.3,
    skew: float = 1e-3,
    sigma: float = 1e-4,
    memories: tuple[float, ...] = (),
    jitter: float = 0.0,
    lost: float = 0.0,
    swing: float = 0.35,
    moved: bool = True,
    rates: tuple[float, float] = (149.0, 60.0),
) -> Streams:
    """Streams of a badly made arm; ``memories`` in s: of noises that add up with white noise to ``sigma`` in m.

    ``jitter``: standard deviation of the joints' time stamps, in s; ``lost``: share of all samples.
    """
    rng = np.random.default_rng(seed)
    robot, nominal = machines.load(*arm), machines.arm(*arm)
    made = nominal.moved(rng) if moved else nominal
    machine = machines.Machine(made, machines.anywhere(rng), {"tool": machines.pose((0.02, 0.03, 0.1))})
    moving = motion(rng, nominal, swing=swing)
    # True time is the controller's; the tracker starts a little later and ends earlier.
    u = np.arange(0.0, seconds, 1.0 / rates[0])
    t_true = np.arange(1.0, seconds - 1.0, 1.0 / rates[1])
    u, t_true = (x[rng.random(len(x)) >= lost] for x in (u, t_true))
    middle_u = 0.5 * (t_true[0] + t_true[-1])
    t = middle_u + offset + (t_true - middle_u) / (1.0 + skew)
    points = machine.see(moving.at(t_true))[:, :3, 3]
    parts = [remembering(rng, t_true, memory) for memory in (0.0, *memories)]
    points = points + sigma * sum(parts) / np.sqrt(len(parts))
    stamps = np.sort(u + jitter * rng.normal(size=len(u)))
    readings = moving.at(u)
    columns = machines.table(nominal, readings, np.tile(np.eye(4), (len(u), 1, 1)), "position")
    joints = {"time [s]": stamps} | {name: values for name, values in columns.items() if name[0] not in "xyz"}
    seen = {"time [s]": t} | {f"{axis} [m]": points[:, k] for k, axis in enumerate("xyz")}
    return Streams(robot, machine, moving, joints, seen, offset, skew, middle_u + offset)


def read(made: Streams, **options: object) -> calib.Measurements:
    """The streams as calib reads them."""
    return calib.read_measurements(made.seen, made.robot, readings=made.joints, **options)  # type: ignore[arg-type]
