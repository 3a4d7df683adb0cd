"""Rows of several machines are told apart; those of one are not."""

import numpy as np
import pytest

import calib
from calib.assessment.checks import of_rows
from calib.assessment.influence import Residue
from calib.assessment.mixed_machines import ONE_MACHINE, MixedMachines, mixed_machines
from calib.assessment.stretches import stretches
from tests.support import machines
from tests.support.machines import Array, Machine, anywhere, pose

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
SIGMA = 5e-5


def fitted(rng: np.random.Generator, rows: int | Array, droop: Array) -> calib.Fit:
    """A fit to so many rows, or to readings (N, nr), that are off by ``droop`` (N, 1 or nr), which nobody tells."""
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    true = Machine(arm.moved(rng), anywhere(rng), {"tool": pose((0.05, 0.02, 0.15), (0.3, -0.2, 0.4))})
    q = arm.draw(rng, rows) if isinstance(rows, int) else rows
    seen = true.see(q + droop)[:, :3, 3] + SIGMA * rng.standard_normal((len(q), 3))
    columns = {f"{r.name} [rad]": q[:, k] for k, r in enumerate(robot.readings)}
    columns |= {f"{axis} [m]": seen[:, k] for k, axis in enumerate("xyz")}
    model = machines.model(robot, offsets="all", placements="all", tool="position")
    return calib.identify(model, calib.read_measurements(columns, robot))


def told_apart(fit: calib.Fit) -> MixedMachines:
    """That which is most: as the verdict takes it, by the number of machines."""
    return max(mixed_machines(stretches(Residue.of(fit, {}))), key=lambda one: one.times / one.machines)


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_a_payload_in_some_of_the_rows(share: float) -> None:
    rng = np.random.default_rng(3)
    loaded = rng.random(80) < share
    droop = 5e-3 * loaded[:, None] * np.array([0, 1.0, 0.5, 0, 0, 0])
    found = told_apart(fitted(rng, 80, droop))
    assert found.times > 10.0
    assert found.share == pytest.approx(loaded.mean(), abs=1e-9)
    # 5 mrad at the shoulder of an arm that reaches 1.3 m.
    assert 1e-3 < found.apart < 8e-3


@pytest.mark.parametrize("many", [3, 4])
def test_several_payloads(many: int) -> None:
    rng = np.random.default_rng(4)
    load = rng.integers(0, many, 80)
    found = told_apart(fitted(rng, 80, 3e-3 * load[:, None] * np.array([0, 1.0, 0.5, 0, 0, 0])))
    assert found.machines == many
    assert found.times > 10.0
    assert found.share == pytest.approx(1.0 - np.bincount(load).max() / 80.0, abs=1e-9)


def test_one_gear_that_wobbles_is_not_several_machines() -> None:
    """However much: of an effect that varies steadily each cut leaves as much less as it makes parts."""
    rng = np.random.default_rng(7)
    off = 5e-3 * np.sin(3.0 * rng.uniform(-2.0, 2.0, (80, 1))) * np.eye(6)[1]
    found = told_apart(fitted(rng, 80, off))
    assert found.times / found.machines < 1.3


def test_rows_of_one_machine_are_left_alone() -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        found = told_apart(fitted(rng, 60, np.zeros((60, 6))))
        assert found.times < 1.3
        # Harmonics of gears are in all rows.
        off = 2e-3 * np.sin(rng.uniform(1.0, 6.0, 6) * rng.uniform(-2.0, 2.0, (60, 6)))
        assert told_apart(fitted(rng, 60, off)).times < 1.5


def repeated(seed: int, poses: int, again: int, mixed: str = "none", by: float = 1e-2) -> calib.Fit:
    """A fit to poses measured again and again, with gears that wobble. Of the rows of two machines, those of a pose

    are of one where "poses" are mixed, and of both where "rows" are.
    """
    rng = np.random.default_rng(seed)
    q = np.repeat(machines.arm(*UR10).draw(rng, poses), again, axis=0)
    of = {
        "none": np.zeros(len(q)),
        "poses": np.repeat(rng.random(poses) < 0.5, again),
        "rows": rng.random(len(q)) < 0.4,
    }
    off = 1e-3 * np.sin(3.0 * q + np.arange(6)) + by * of[mixed][:, None] * np.array([0, 1.0, 0.5, 0, 0, 0])
    return fitted(rng, q, off)


def judged(fit: calib.Fit) -> bool:
    return of_rows.one_machine(mixed_machines(stretches(Residue.of(fit, {}))), fit).passed


def test_rows_of_a_pose_that_err_together_are_no_machines_of_their_own() -> None:
    """Gears that wobble err alike in all rows of a pose: of 14 poses any two machines explain them."""
    for seed in range(6):
        fit = repeated(seed, 14, 5)
        assert fit.repeats
        assert judged(fit)


def test_machines_are_told_apart_within_poses_and_between_them() -> None:
    """As rows of a pose scatter by another cause than poses do, each is looked at by itself."""
    for seed in (1, 2):
        assert not judged(repeated(seed, 20, 5, "rows", 2e-3))
    assert not judged(repeated(0, 60, 3, "poses"))


def test_the_order_of_the_rows_does_not_matter() -> None:
    rng = np.random.default_rng(5)
    droop = 5e-3 * (rng.random(60) < 0.4)[:, None] * np.eye(6)[2]
    fit = fitted(rng, 60, droop)
    (data,) = fit.measurements
    turned = calib.identify(fit.model, data.subset(np.random.default_rng(1).permutation(60)))
    one, other = told_apart(fit), told_apart(turned)
    assert other == pytest.approx(one, rel=1e-4)


def test_too_few_rows_say_nothing() -> None:
    rng = np.random.default_rng(6)
    droop = 5e-3 * (np.arange(24) % 2)[:, None] * np.eye(6)[2]
    assert told_apart(fitted(rng, 24, droop)) == ONE_MACHINE
    assert mixed_machines(()) == (ONE_MACHINE,)
