"""What is wrong with rows that a fit does not explain: rows that lie far off, or lengths that are stated wrong."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import calib
from calib.assessment.checks.of_fit import stated_sigma
from calib.identification.losses import Loss
from tests.support import machines
from tests.support.touching import SOCKETS, lab

Array = np.ndarray
Spoil = Callable[[Array, np.random.Generator], Array]
UR5 = ("example:ur_description/urdf/ur5_robot.urdf", "tool0")


def told(found: calib.Calibration) -> str:
    (check,) = (check for check in found.checks if check.name == "cause")
    return "" if check.passed else check.sentence


def table(spoil: Spoil, seed: int = 4) -> tuple[calib.Calibration, calib.Calibration]:
    """A calibration of a UR5 from 100 positions that are spoilt, by least squares and by a robust loss."""
    rng = np.random.default_rng(seed)
    robot = calib.load_robot(*UR5)
    machine = machines.Machine(
        machines.arm(*UR5).moved(rng), machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))}
    )
    data, rest = (machine.measure(robot, rng.uniform(-2, 2, (n, 6)), rng=rng, sigma=5e-5) for n in (100, 30))
    assert data.position is not None
    data = replace(data, position=spoil(data.position.copy(), rng))
    model = calib.error_model(robot, offsets="all", placements="all")
    least, robust = calib.identify(model, data), calib.identify(model, data, losses=["cauchy"])
    return calib.assess(least, rest), calib.assess(robust, rest)


def few(x: Array, rng: np.random.Generator) -> Array:
    x[[1, 40, 77]] += rng.normal(scale=0.03, size=(3, 3))
    return x


def one(x: Array, rng: np.random.Generator) -> Array:
    x[40] += 0.3
    return x


def moved(x: Array, rng: np.random.Generator) -> Array:
    x[90:] += (0.02, -0.01, 0.01)
    return x


def test_rows_that_lie_far_off_are_named_with_the_loss_that_passes_over_them() -> None:
    least, robust = table(few)
    lines = least.fit.measurements[0].lines[[1, 40, 77]].tolist()
    assert not least.trusted
    assert f"rows {', '.join(map(str, lines))} lie far from the rest" in told(least)
    assert least.doubts[0] == told(least)
    assert not any("seems to have changed" in doubt for doubt in least.doubts)
    assert robust.trusted


def test_what_a_loss_passes_over_is_no_scatter_beside_the_stated_sigma() -> None:
    """The instrument explains all other rows; the fit by the loss that is advised was doubted for this one."""
    _, found = table(one)
    fit = calib.identify(found.fit.model, found.fit.measurements, losses=["cauchy"], model_sigmas=[0.0])
    assert np.sqrt(fit.noise[0].chi_square) > 300.0
    check = stated_sigma(fit)
    assert check.passed
    assert check.statistic == pytest.approx(1.0, abs=0.3)


def test_a_base_that_moved_is_no_rows_that_lie_far_off() -> None:
    least, _ = table(moved)
    assert told(least) == ""
    assert any("after this row the base seems to have changed" in doubt for doubt in least.doubts)


def test_a_held_out_row_that_lies_far_off_is_named() -> None:
    """It takes no part in the fit: what else seemed wrong then, was of the rest of its table."""
    of = lab(5, noise=2e-5)
    data = replace(of.sockets(30), sigma=np.full((90, 3), 2e-5))
    own, held_out = calib.hold_out(data, places=["c"])
    readings = held_out.readings.copy()
    readings[4] = own.readings[5]  # its label is that of another socket
    known = calib.Known(base=np.eye(4), targets=of.known("a", "b", "c"))
    model = calib.error_model(of.robot, offsets="all", placements="all", base="fixed", known=known)
    wrong = replace(own, target=np.where(np.arange(len(own)) == 3, 1 - own.target, own.target))
    losses: tuple[Loss, ...] = ("linear", "huber")
    for spoilt, loss in product((own, wrong), losses):
        fit = calib.identify(model.within([own]), spoilt, losses=[loss])
        found = calib.assess(replace(fit, model=model), replace(held_out, readings=readings))  # as of a job
        sentences = told(found).split(": ")
        assert f"row {held_out.lines[4]} lies far from the rest" in sentences[-2]
        assert sentences[-1] == "look at it."  # no loss passes over what no fit takes
        assert ("loss" in told(found)) == (spoilt is wrong)  # which a weak loss does not quite pass over
        # Two sockets do not tell by how much the arm is turned about the line between them, which the third one asks.
        assert all("would without that" in doubt or "as large as predicted" in doubt for doubt in found.doubts[1:])


@pytest.mark.parametrize("what", ["tool", "setup"])
def test_rows_that_name_another_tool_or_set_up_are_named_with_theirs(what: str) -> None:
    """Rows of another set-up were said to need a base of their own, and those of another tool to be wrong."""
    rng = np.random.default_rng(3)
    robot, arm = calib.load_robot(*UR5), machines.arm(*UR5).moved(rng)
    bases, tools = [machines.anywhere(rng)], [machines.pose((0.05, 0.02, 0.15))]
    if what == "setup":
        bases.append(machines.anywhere(rng))
    else:
        tools.append(machines.pose((-0.03, 0.04, 0.1)))

    def seen(n: int, wrong: list[int]) -> calib.Measurements:
        readings, number = rng.uniform(-2, 2, (n, 6)), np.arange(n) % 2
        every = [base @ arm.tips(readings) @ tool for base in bases for tool in tools]
        poses = np.where((number == 0)[:, None, None], *every)
        poses[:, :3, 3] += rng.normal(scale=5e-5, size=(n, 3))
        number[wrong] = 1 - number[wrong]
        columns = machines.table(arm, readings, poses, "position") | {what: [("left", "right")[k] for k in number]}
        return calib.read_measurements(columns, robot, sigma=5e-5)

    model = calib.error_model(robot, offsets="all", placements="all")
    data, held_out = seen(60, [7, 20, 33, 46]), seen(20, [])
    found = calib.assess(calib.identify(model, data), held_out)
    kind, lines = {"tool": "tool", "setup": "set-up"}[what], data.lines
    assert told(found).startswith(
        f"arrays: 4 rows fit another {kind} than they name: row {lines[7]} 'right', row {lines[20]} 'left', "
        f"row {lines[33]} 'right', 1 more. So named"
    )
    assert all("would without that" in doubt for doubt in found.doubts[1:])
    sound = calib.assess(calib.identify(model, held_out), data.subset([k for k in range(60) if k % 13 != 7]))
    assert told(sound) == ""


def test_a_sound_table_asks_for_no_cause() -> None:
    least, _ = table(lambda x, rng: x)
    assert least.trusted
    assert told(least) == ""


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_a_radius_that_is_told_as_a_diameter(factor: float) -> None:
    of = lab(3, noise=1e-5)
    data = replace(of.sphere(90), sigma=np.full((90, 1), 1e-5))
    stated = factor * data.value
    model = calib.error_model(of.robot, offsets="all", placements="all")
    found = calib.assess(calib.identify(model, replace(data, value=stated)))
    if factor == 1.0:
        assert told(found) == ""
    else:
        assert f"mm from the centre and not {1e3 * stated[0, 0]:.4g} mm" in told(found)
        assert not any("seems to have moved" in doubt for doubt in found.doubts)


@pytest.mark.parametrize("off", [0.5e-3, 0.0])
def test_a_distance_of_targets_that_is_stated_wrong_is_named_and_not_a_target_that_moved(off: float) -> None:
    """Draw wires from two places, whose distance was measured; a tracker tells where the places are."""
    rng = np.random.default_rng(6)
    robot = calib.load_robot(*UR5)
    machine = machines.Machine(
        machines.arm(*UR5).moved(rng), machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))}
    )
    data, rest = (machine.measure(robot, rng.uniform(-2, 2, (n, 6)), rng=rng, sigma=3e-5) for n in (50, 20))
    places = machine.base[:3, 3] + np.array([(0.9, 0.8, 0.1), (-0.9, 0.7, 0.4)])
    q = rng.uniform(-2, 2, (60, 6))
    of = np.arange(60) % 2
    lengths = np.linalg.norm(machine.see(q)[:, :3, 3] - places[of], axis=1) + rng.normal(scale=3e-5, size=60)
    columns = {f"{joint} [rad]": q[:, k] for k, joint in enumerate(machine.arm.ranges)}
    columns |= {"length [m]": lengths, "target": [("left", "right")[k] for k in of]}
    wires = calib.read_measurements(columns, robot, "distance", sigma=3e-5)
    apart = float(np.linalg.norm(places[1] - places[0]))
    stated = calib.measuring.Relation("distance", ("left", "right"), apart + off, 1e-5)
    model = calib.error_model(robot, offsets="all", placements="all", known=calib.Known(relations=[stated]))
    found = calib.assess(calib.identify(model, [data, wires]), rest)
    assert found.trusted is (off == 0.0), found.doubts
    if off:
        assert "the distance between 'left' and 'right' is" in told(found)
        assert f"where {1e3 * stated.value:.2f} mm is stated" in told(found)
        seems = float(told(found).split(" mm where ")[0].rpartition(" ")[2])
        assert seems == pytest.approx(1e3 * apart, abs=0.1)
        assert not any("seems to have moved" in doubt for doubt in found.doubts)


def test_distances_of_sockets_are_not_named_where_only_one_is_wrong_and_no_row_tells_lengths() -> None:
    """A fit without them does not know how large the arm is: right ones were said to be wrong, too."""
    of = lab(5, noise=3e-5)
    names = [name for name in SOCKETS for _ in range(16)]
    q = of.touching(lambda points: points, np.array([SOCKETS[name] for name in names]) + of.scatter(48, 3))
    pairs = [("a", "b"), ("a", "c"), ("b", "c")]
    apart = [float(np.linalg.norm(np.subtract(SOCKETS[one], SOCKETS[other]))) for one, other in pairs]
    apart[0] += 1e-3
    stated = [calib.measuring.Relation("distance", pair, at, 2e-5) for pair, at in zip(pairs, apart, strict=True)]
    known = calib.Known(relations=stated)
    model = calib.error_model(of.robot, offsets="all", placements="all", known=known, base="fixed")
    found = calib.assess(calib.identify(model, calib.measuring.sockets(of.robot, q, names, sigma=3e-5)))
    assert not found.trusted and "the distance between" not in told(found)
