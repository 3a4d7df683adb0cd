"""Rows of an arm whose drives state torques that scatter and are off."""

import numpy as np

from tests.support import machines, sagging
from tests.support.gears import UR10, geared

LIFT, ELBOW = "shoulder_lift_joint", "elbow_joint"
SOFT = {LIFT: 1.2e-5, ELBOW: 2e-5}
OFFSETS = {LIFT: 8.0, ELBOW: -5.0}
SIGMA = 3e-5


def table(
    seed: int, noise: float, n: int = 160, heavier: float = 0.0, stated: bool = True, built: bool = True
) -> dict[str, object]:
    """The columns of these rows. ``heavier``: kg on the hand of which nobody tells.

    ``built``: whether the arm is built as badly as others, and not as drawn.
    """
    rng = np.random.default_rng([seed, 12])
    plain = machines.arm(*UR10)
    joints, u = list(plain.ranges), plain.draw(rng, n)
    arm, torques = sagging.Sagging(UR10[0], {}), np.zeros((n, 6))
    hand = {"wrist_3_link": (heavier, (0.0, 0.0, 0.1))} if heavier else {}
    for row in range(n):
        places = arm._places(dict(zip(joints, u[row], strict=True)))
        for name in SOFT:
            torques[row, joints.index(name)] = -arm._torque(name, places, sagging.DOWN, hand)
    extra = -torques * [SOFT.get(name, 0.0) for name in joints]
    true = machines.Machine(
        geared(plain.moved(rng) if built else plain, lambda _: extra), machines.anywhere(rng), {"tool": sagging.BALL}
    )
    x = true.see(u)[:, :3, 3] + SIGMA * rng.standard_normal((n, 3))
    columns: dict[str, object] = {f"{name} [rad]": u[:, k] for k, name in enumerate(joints)}
    columns |= {f"{axis} [m]": x[:, k] for k, axis in enumerate("xyz")}
    for name in SOFT:
        k = joints.index(name)
        columns[f"tau_{name} [Nm]"] = torques[:, k] + OFFSETS[name] + noise * rng.standard_normal(n)
    if stated:
        columns["sigma_tau [Nm]"] = np.full(n, noise)
    return columns
