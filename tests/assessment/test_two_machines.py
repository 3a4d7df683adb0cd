"""Rows of two machines are told apart; those of one are not."""

import numpy as np
import pytest

import calib
from calib.assessment.effects import Stretch, stretches
from calib.assessment.influence import Residue
from calib.assessment.two_machines import ONE_MACHINE, two_machines
from tests.support import machines
from tests.support.machines import Array, Machine, anywhere, pose

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
SIGMA = 5e-5


def fitted(rng: np.random.Generator, rows: int, droop: Array, kind: str = "position") -> calib.Fit:
    """A fit to rows (N, nr) whose readings are off by ``droop`` (N, 1 or nr), which nobody tells."""
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    true = Machine(arm.moved(rng), anywhere(rng), {"tool": pose((0.05, 0.02, 0.15), (0.3, -0.2, 0.4))})
    q = arm.draw(rng, rows)
    seen = true.see(q + droop)[:, :3, 3] + SIGMA * rng.standard_normal((rows, 3))
    columns = {f"{r.name} [rad]": q[:, k] for k, r in enumerate(robot.readings)}
    columns |= {f"{axis} [m]": seen[:, k] for k, axis in enumerate("xyz")}
    model = machines.model(robot, offsets="all", placements="all", tool="position")
    return calib.identify(model, calib.read_measurements(columns, robot))


def parts_of(fit: calib.Fit) -> tuple[Stretch, ...]:
    return stretches(Residue.of(fit, {}))


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_a_payload_in_some_of_the_rows(share: float) -> None:
    rng = np.random.default_rng(3)
    loaded = rng.random(80) < share
    droop = 5e-3 * loaded[:, None] * np.array([0, 1.0, 0.5, 0, 0, 0])
    found = two_machines(parts_of(fitted(rng, 80, droop)))
    assert found.times > 10.0
    assert found.share == pytest.approx(loaded.mean(), abs=1e-9)
    # 5 mrad at the shoulder of an arm that reaches 1.3 m.
    assert 1e-3 < found.apart < 8e-3


def test_rows_of_one_machine_are_left_alone() -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        found = two_machines(parts_of(fitted(rng, 60, np.zeros((60, 6)))))
        assert found.times < 1.3
        # Waves of gears are in all rows.
        off = 2e-3 * np.sin(rng.uniform(1.0, 6.0, 6) * rng.uniform(-2.0, 2.0, (60, 6)))
        assert two_machines(parts_of(fitted(rng, 60, off))).times < 1.5


def test_the_order_of_the_rows_does_not_matter() -> None:
    rng = np.random.default_rng(5)
    droop = 5e-3 * (rng.random(60) < 0.4)[:, None] * np.eye(6)[2]
    fit = fitted(rng, 60, droop)
    (data,) = fit.measurements
    turned = calib.identify(fit.model, data.subset(np.random.default_rng(1).permutation(60)))
    one, other = two_machines(parts_of(fit)), two_machines(parts_of(turned))
    assert other == pytest.approx(one, rel=1e-4)


def test_too_few_rows_say_nothing() -> None:
    rng = np.random.default_rng(6)
    droop = 5e-3 * (np.arange(24) % 2)[:, None] * np.eye(6)[2]
    assert two_machines(parts_of(fitted(rng, 24, droop))) == ONE_MACHINE
    assert two_machines(()) == ONE_MACHINE
