"""A UR10 that warms up later than its sensor, and whose gears rub under load: truth by steps of seconds and numpy."""

from dataclasses import dataclass

import numpy as np

import calib
from tests.support import machines, sagging
from tests.support.gears import UR10, geared

Array = np.ndarray
SIGMA = 5e-5
ROW, STEP = 40.0, 1.0  # seconds
LIFT = ("shoulder_lift_joint", "elbow_joint", "wrist_1_joint")


def late(times: Array, temperature: Array, tau: float) -> Array:
    """What a body (N,) with this time constant has of a temperature (N,), by Euler's rule, a second at a time."""
    fine = np.arange(times[0], times[-1] + STEP, STEP)
    around, now, found = np.interp(fine, times, temperature), temperature[0], []
    for shown in around:
        found.append(now)
        now += STEP / tau * (shown - now)
    return np.interp(times, fine, found)


@dataclass(frozen=True)
class Slow:
    """Coefficients by joint: ``warms`` (rad/K, s), and ``rubs`` and ``winds`` in rad/Nm."""

    seed: int
    warms: dict[str, tuple[float, float]]
    rubs: dict[str, float]
    winds: dict[str, float]

    def measured(self, n: int = 250) -> tuple[calib.Measurements, machines.Machine]:
        rng = np.random.default_rng([self.seed, 91])
        robot, plain = machines.load(*UR10), machines.arm(*UR10)
        joints, u = list(plain.ranges), plain.draw(rng, n)
        sides = rng.choice([-1.0, 1.0], (n, 6))
        times = np.cumsum(rng.uniform(0.5, 1.5, n)) * ROW
        # The arm works and rests by turns, and the sensor follows within minutes.
        works = np.sin(2.0 * np.pi * times / rng.uniform(3000.0, 6000.0)) > 0.0
        degrees = 20.0 + late(times, np.where(works, 15.0, 0.0) + 2.0 * times / times[-1], rng.uniform(100.0, 400.0))
        extra = np.zeros((n, 6))
        for name, (coefficient, tau) in self.warms.items():
            extra[:, joints.index(name)] += coefficient * (late(times, degrees, tau) - 20.0)
        heavy = sagging.Sagging(UR10[0], {})
        loaded = sorted({*self.rubs, *self.winds})
        if loaded:
            for row in range(n):
                places = heavy._places(dict(zip(joints, u[row], strict=True)))
                for name in loaded:
                    k, torque = joints.index(name), heavy._torque(name, places, sagging.DOWN, {})
                    extra[row, k] += self.winds.get(name, 0.0) * torque
                    extra[row, k] -= sides[row, k] * self.rubs.get(name, 0.0) * abs(torque)
        tool = {"tool": sagging.BALL}
        true = machines.Machine(geared(plain.moved(rng), lambda _: extra), machines.anywhere(rng), tool)
        x = true.see(u)[:, :3, 3] + SIGMA * rng.standard_normal((n, 3))
        columns: dict[str, object] = {f"{name} [rad]": u[:, k] for k, name in enumerate(joints)}
        columns |= {f"{axis} [m]": x[:, k] for k, axis in enumerate("xyz")}
        columns |= {f"direction_{name}": np.where(sides[:, k] > 0.0, "+", "-") for k, name in enumerate(joints)}
        columns |= {"temperature [degC]": degrees, "time [s]": times}
        return calib.read_measurements(columns, robot, sigma=SIGMA), true
