"""A table that asks for a base of its own is named; sound tables are not."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.assessment.own_base import own_bases
from tests.support import machines
from tests.support.machines import anywhere, pose
from tests.support.touching import UR10

SIGMA = 3e-5


def sure(_motion: np.ndarray) -> float:
    return 0.0


@pytest.mark.parametrize("moved", [(0.0, 0.0), (3e-4, 0.0), (0.5, 0.4)], ids=["sound", "by 0.3 mm", "elsewhere"])
def test_tables_of_two_set_ups_under_one_name(moved: tuple[float, float]) -> None:
    rng = np.random.default_rng(4)
    robot, arm, base = machines.load(*UR10), machines.arm(*UR10), anywhere(rng)
    tool = {"tool": pose((0, 0.05, 0.1))}
    # A little that the model does not hold, as every real arm has.
    made, other = arm.moved(rng), base @ pose((moved[0], 0, 0), (0, 0, moved[1]))
    sets = []
    for k, at in enumerate((base, base, other)):
        data = machines.Machine(made, at, tool).measure(robot, made.draw(rng, 50), rng=rng, sigma=SIGMA)
        bent = data.position + 1e-4 * np.sin(3.0 * data.readings[:, :3])
        sets.append(replace(data, where=f"{k}.csv", position=bent))
    found = calib.assess(calib.identify(calib.error_model(robot, offsets="all", placements="all"), sets))
    named = [doubt.split(" fits")[0] for doubt in found.doubts if "fits better with a base of its own" in doubt]
    assert ("2.csv" in named) == (moved[0] > 0.0)
    assert not named or not found.trusted
    if not moved[0]:
        assert found.trusted
    # With the set-up named, nothing asks any more.
    told = calib.assess(
        calib.identify(calib.error_model(robot, offsets="all", placements="all"), [*sets[:2], sets[2].named(setup="b")])
    )
    assert told.trusted


def test_tables_of_two_arms_from_two_stations_are_named_though_tools_may_take_it_up() -> None:
    """A tool that only one table has goes to where a common base wants it, and no rigid motion undoes that."""
    rng = np.random.default_rng(4)
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    made, sets = arm.moved(rng), []
    for name in ("a", "b"):
        tool = {"tool": pose(rng.uniform(-0.1, 0.1, 3))}
        data = machines.Machine(made, anywhere(rng), tool).measure(robot, made.draw(rng, 50), rng=rng, sigma=SIGMA)
        sets.append(replace(data.named(tool=name), where=f"{name}.csv"))
    found = calib.assess(calib.identify(calib.error_model(robot, offsets="all", placements="all"), sets))
    assert any("fits better with a base of its own" in doubt for doubt in found.doubts)


def test_what_a_rigid_motion_does_not_explain_asks_for_nothing() -> None:
    rng = np.random.default_rng(0)
    for n in (3, 5, 10, 30, 200):
        for _ in range(200):
            x = rng.uniform(-1.0, 1.0, (n, 3))
            assert not list(own_bases([("a.csv", x, rng.normal(scale=1e-4, size=(n, 3)), sure)], 1.0))
    x = rng.uniform(-1.0, 1.0, (20, 3))
    r = x - (x @ pose(rotvec=(0, 0, 1e-3))[:3, :3].T + (1e-3, 0, 0)) + rng.normal(scale=1e-4, size=(20, 3))
    (found,) = own_bases([("a.csv", x, r, sure)], 1.0)
    assert found.moved == pytest.approx(np.sqrt(3) * 1e-4, rel=0.3)
    assert found.error > 1e-3


@pytest.mark.parametrize("moved", [0.0, 0.5], ids=["sound", "by half a metre"])
def test_rows_held_out_where_the_machine_is_not_sure_ask_for_nothing(moved: float) -> None:
    """Only the wrist was moved; where the rest of the arm stands otherwise, all points are off alike."""
    rng = np.random.default_rng(0)
    robot, arm, base = machines.load(*UR10), machines.arm(*UR10), anywhere(rng)
    made, tool, sets = arm.moved(rng), {"tool": pose((0, 0.05, 0.1))}, []
    for at, n in ((base, 30), (base @ pose((moved, 0, 0)), 10)):
        q = made.draw(rng, n)
        q[:, :3] = q[0, :3]
        sets.append(machines.Machine(made, at, tool).measure(robot, q, rng=rng, sigma=SIGMA))
    found = calib.assess(calib.identify(calib.error_model(robot, offsets="all", placements="all"), sets[0]), sets[1])
    after = found.metrics["validation"]["after"]["position"].rms
    assert after > 1e-3
    assert any("fits better with a base of its own" in doubt for doubt in found.doubts) == (moved > 0.0)
