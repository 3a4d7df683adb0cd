"""Outliers: one-step influence against refits, what is wrong found, and no alarm where nothing is."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

import calib
from calib.assessment import disagreement
from calib.assessment.influence import Residue, SquaresOfSet
from calib.assessment.outliers import LEVEL
from calib.identification import elimination
from calib.identification.relations import Relation
from calib.presentation.report.outlying import outlier_section
from scripts.simulate import panda_sockets as simulation
from tests.support import machines

Array = NDArray[np.float64]
PANDA = "example:panda_description/urdf/panda.urdf"
PLAY = 1e-4


Recorded = tuple[object, dict[str, dict[str, Array]], dict[str, dict[str, Array]]]


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    return simulation.recordings(7)


@pytest.fixture(scope="module")
def robot() -> calib.Robot:
    return calib.load_robot(PANDA, "panda_hand_tcp")


def resampled(recorded: Recorded, rng: np.random.Generator) -> dict[str, dict[str, Array]]:
    """Other angles near the recorded ones, with new play of the ball and nobody who pushes: one Newton step."""
    arm, where, rows = recorded
    found: dict[str, dict[str, Array]] = {}
    for place, holes in rows.items():
        found[place] = {}
        for hole, angles in holes.items():
            new = []
            for q in angles:
                start = q + rng.normal(scale=0.005, size=7)
                frames = arm.frames(start)  # type: ignore[attr-defined]
                x = frames[-1][:3] @ np.append(arm.ball_in_joint_7, 1.0)  # type: ignore[attr-defined]
                J = np.array([np.cross(T[:3, 2], x - T[:3, 3]) for T in frames]).T
                new.append(start + np.linalg.pinv(J) @ (where[place][hole] + rng.normal(scale=PLAY, size=3) - x))
            found[place][hole] = np.array(new)
    return found


def measured(robot: calib.Robot, rows: dict[str, dict[str, Array]], sigma: float | None) -> list[calib.Measurements]:
    names = [f"panda_joint{k} [rad]" for k in range(1, 8)]
    sets = []
    for place, holes in rows.items():
        angles = np.concatenate(list(holes.values()))
        table = dict(zip(names, angles.T, strict=True))
        table["target"] = np.repeat([f"{place}/{hole}" for hole in holes], [len(q) for q in holes.values()])
        sets.append(replace(calib.read_measurements(table, robot, "socket", sigma=sigma), where=place))
    return sets


def socket_fit(robot: calib.Robot, sets: Sequence[calib.Measurements]) -> calib.Fit:
    model = machines.model(
        robot,
        offsets="all",
        placements="all",
        base="fixed",
        prior_length=1e-3,
        prior_angle=5e-3,
        relations=[Relation("distance", (f"{d.where}/hole_0", f"{d.where}/hole_1"), 0.05, 1e-4) for d in sets],
    )
    return calib.identify(model, sets)


def positions(robot: calib.Robot, rng: np.random.Generator, n: int = 40) -> calib.Measurements:
    """Positions of the tip of an arm with zeros off by 3 mrad, seen to 0.1 mm; two groups."""
    q = rng.uniform(robot_low(robot), robot_high(robot), (n, 7))
    x = robot.tips(q + rng.normal(scale=3e-3, size=7))[:, :3, 3] + rng.normal(scale=PLAY, size=(n, 3))
    table = dict(zip([f"panda_joint{k} [rad]" for k in range(1, 8)], q.T, strict=True))
    table |= dict(zip(("x [m]", "y [m]", "z [m]"), x.T, strict=True))
    table["group"] = np.array(["first", "second"])[np.arange(n) % 2]
    return calib.read_measurements(table, robot)


def robot_low(robot: calib.Robot) -> Array:
    return np.array([reading.lower for reading in robot.readings])


def robot_high(robot: calib.Robot) -> Array:
    return np.array([reading.upper for reading in robot.readings])


@pytest.fixture(scope="module")
def model(robot: calib.Robot) -> calib.ErrorModel:
    return machines.model(robot, offsets="all", prior_angle=5e-3)


def without(fit: calib.Fit, data: calib.Measurements, kept: Array) -> calib.Fit:
    return calib.identify(fit.model, data.subset(kept), model_sigmas=[noise.model for noise in fit.noise])


def test_a_row_left_out_is_the_fit_without_it(robot: calib.Robot) -> None:
    data = positions(robot, np.random.default_rng(3))
    # The angles of a free base count from a start that every fit finds for itself.
    model = machines.model(robot, offsets="all", placements=["panda_joint4"], base="fixed", prior_angle=5e-3)
    fit = calib.identify(model, data)
    fit = calib.identify(model, data, model_sigmas=[fit.noise[0].model])
    names = [p.name for p in fit.parameters]
    squares = float(np.sum(fit.residuals[0] ** 2)) / fit.noise[0].total ** 2
    prior = sum((value / 5e-3) ** 2 for value, p in zip(fit.values, fit.parameters, strict=True) if p.prior)
    freedom = fit.noise[0].degrees_of_freedom
    found = {row.line: row for row in calib.judging.outliers(fit).rows}
    assert len(found) == len(data)
    assert sum(row.leverage for row in found.values()) * 3 == pytest.approx(3 * len(data) - freedom, rel=1e-3)
    for n, line in enumerate(data.lines):
        other = without(fit, data, np.arange(len(data)) != n)
        row = found[int(line)]
        change = (other.values - fit.values) / fit.sigmas
        worst = int(np.argmax(np.abs(change)))
        assert row.without.change == pytest.approx(change[names.index(row.without.parameter)], abs=5e-3)
        assert abs(row.without.change) == pytest.approx(abs(change[worst]), abs=5e-3)
        moved = fit.machine, other.machine
        x = [m.frames.base @ robot.tips(data.readings, m.deviations) @ m.frames.tools[0] for m in moved]
        rms = np.sqrt(np.mean((x[1] - x[0])[:, :3, 3] ** 2))
        assert row.without.prediction == pytest.approx(rms, rel=0.02)
        # What the sum of squares falls by, over three numbers and the scatter of the rest.
        rest = float(np.sum(other.residuals[0] ** 2)) / fit.noise[0].total ** 2
        rest += sum((value / 5e-3) ** 2 for value, p in zip(other.values, other.parameters, strict=True) if p.prior)
        q = squares + prior - rest
        scatter = (squares - q) / (freedom - 3)
        assert row.studentised == pytest.approx(np.sqrt(q / scatter / 3), rel=2e-3)


def test_gross_rows_are_found_with_their_lines(robot: calib.Robot, model: calib.ErrorModel) -> None:
    data = positions(robot, np.random.default_rng(4))
    bad = np.array(data.position)
    bad[7] += (0.0, 1e-3, 0.0)
    bad[30] -= (8e-4, 0.0, 8e-4)
    found = calib.judging.outliers(calib.identify(model, replace(data, position=bad)))
    assert {row.line for row in found.outlying} == {int(data.lines[7]), int(data.lines[30])}
    # A loss that takes the weight from them does not hide them.
    robust = calib.judging.outliers(calib.identify(model, replace(data, position=bad), losses=["cauchy"]))
    assert {row.line for row in robust.outlying} >= {int(data.lines[7]), int(data.lines[30])}
    by_line = {row.line: row for row in robust.rows}
    assert all(by_line[row.line].leverage < 0.3 * row.leverage for row in found.outlying)


def test_a_group_on_another_base_disagrees(robot: calib.Robot, model: calib.ErrorModel) -> None:
    data = positions(robot, np.random.default_rng(5))
    second = np.array([word == "second" for word in data.group or ()])
    clean = calib.judging.outliers(calib.identify(model, data))
    assert not clean.disagreeing
    shifted = np.array(data.position) + np.where(second[:, None], (3e-4, 0.0, 0.0), 0.0)
    found = calib.judging.outliers(calib.identify(model, replace(data, position=shifted)))
    assert {group.name for group in found.disagreeing} == {"first", "second"}
    for group in found.disagreeing:
        assert group.differs == "base"
        # Base, tool and seven zeros, less two: the first joint turns the base, the last one the tool.
        assert group.freedom == 14
        assert 20 < group.differs_gain <= group.gain + 1e-6


def test_a_group_without_which_nothing_is_left_is_told_without_a_number(
    robot: calib.Robot, model: calib.ErrorModel
) -> None:
    """As a table of 24 rows beside a plane of 12: the plane alone has no degrees of freedom."""
    data = positions(robot, np.random.default_rng(5))
    second = np.array([word == "second" for word in data.group or ()])
    shifted = np.array(data.position) + np.where(second[:, None], (3e-4, 0.0, 0.0), 0.0)
    found = calib.judging.outliers(calib.identify(model, replace(data, position=shifted)))
    assert found.disagreeing
    told = str(outlier_section(found))
    assert "times as much" in told
    groups = tuple(replace(group, scatter=float("nan")) for group in found.groups)
    told = str(outlier_section(replace(found, groups=groups)))
    assert "nan" not in told
    assert "too few to say" in told


def test_a_groups_gain_is_that_of_machines_of_its_own(robot: calib.Robot) -> None:
    """Where there are no priors: what the groups cost together, less what they cost apart."""
    model = calib.error_model(robot, offsets=["panda_joint2", "panda_joint4"], tool="position")
    data = positions(robot, np.random.default_rng(6))
    second = np.array([word == "second" for word in data.group or ()])
    shifted = np.array(data.position) + np.where(second[:, None], (0.0, 0.0, 3e-3), 0.0)
    data = replace(data, position=shifted, sigma=np.full((len(data), 3), 1e-3))
    fit = calib.identify(model, data, model_sigmas=[0.0])

    def squares(fit: calib.Fit) -> float:
        return float(np.sum(fit.residuals[0] ** 2)) / 1e-6

    apart = sum(squares(calib.identify(model, data.subset(own), model_sigmas=[0.0])) for own in (second, ~second))
    freedom = data.sigma.size - len(fit.parameters)
    gain = squares(fit) - apart
    group = calib.judging.outliers(fit).groups[0]
    d = len(fit.parameters)
    assert group.freedom == d
    scatter = max((squares(fit) - gain) / (freedom - d), 1.0)
    assert group.gain == pytest.approx(gain / scatter, rel=1e-2)


def test_a_target_that_moved_is_found(robot: calib.Robot, recorded: Recorded) -> None:
    rows = recorded[2]
    place, hole, after = simulation.PUSHED
    for sigma in (None, 5e-4):
        found = calib.judging.outliers(socket_fit(robot, measured(robot, rows, sigma)))
        (jump,) = found.moved
        assert (jump.target, jump.file) == (f"{place}/{hole}", place)
        assert jump.rows == (after, simulation.ROWS - after)
        assert np.allclose(jump.shift, simulation.PUSH, atol=1.5e-4)


def test_a_jump_is_what_a_second_target_would_say(robot: calib.Robot, recorded: Recorded) -> None:
    rows = recorded[2]
    place, hole, after = simulation.PUSHED
    sets = measured(robot, rows, PLAY)
    (jump,) = calib.judging.outliers(socket_fit(robot, sets)).moved
    k = list(rows).index(place)
    target = np.array(sets[k].target)
    target[simulation.ROWS + after :] = len(sets[k].targets)
    sets[k] = replace(sets[k], targets=(*sets[k].targets, "later"), target=target)
    fit = socket_fit(robot, sets)
    moved = [fit.value(f"target.later.{c}") - fit.value(f"target.{place}/{hole}.{c}") for c in "xyz"]
    assert np.allclose(jump.shift, moved, atol=5e-5)


def test_one_gross_row_is_no_jump(
    robot: calib.Robot,
    recorded: Recorded,
) -> None:
    rows = resampled(recorded, np.random.default_rng(1))
    rows["left"]["hole_0"][-2] += (0.0, 0.003, 0.0, 0.0, 0.0, 0.0, 0.0)
    found = calib.judging.outliers(socket_fit(robot, measured(robot, rows, None)))
    assert [(row.target, row.line) for row in found.outlying] == [("left/hole_0", simulation.ROWS - 2)]
    assert not found.moved


def test_clean_data_give_no_alarm(
    robot: calib.Robot,
    model: calib.ErrorModel,
    recorded: Recorded,
) -> None:
    """Chances are below the level in about one of a hundred clean calibrations, for rows, jumps and groups alike."""
    alarms = {"rows": 0, "jumps": 0, "groups": 0}
    p_rows: list[float] = []
    trials = 40
    for seed in range(trials):
        if seed % 8:
            found = calib.judging.outliers(calib.identify(model, positions(robot, np.random.default_rng(100 + seed))))
        else:
            rows = resampled(recorded, np.random.default_rng(seed))
            found = calib.judging.outliers(socket_fit(robot, measured(robot, rows, (None, 5e-4)[seed % 16 // 8])))
        p_rows += [row.p for row in found.rows]
        alarms["rows"] += bool(found.outlying)
        alarms["jumps"] += any(jump.is_told(LEVEL) for jump in found.jumps)
        alarms["groups"] += bool(found.disagreeing)
    assert max(alarms.values()) <= 2
    # The probabilities are what they say.
    p = np.sort(p_rows)
    assert np.max(np.abs(p - (np.arange(len(p)) + 0.5) / len(p))) < 2.0 / np.sqrt(len(p))


def test_the_order_of_rows_changes_no_row(robot: calib.Robot, model: calib.ErrorModel) -> None:
    data = positions(robot, np.random.default_rng(8))
    order = np.random.default_rng(0).permutation(len(data))
    a = calib.judging.outliers(calib.identify(model, data))
    b = calib.judging.outliers(calib.identify(model, data.subset(order)))
    assert [row.line for row in a.rows] == [row.line for row in b.rows]
    assert np.allclose([row.p for row in a.rows], [row.p for row in b.rows], rtol=1e-5)
    assert np.allclose([group.gain for group in a.groups], [group.gain for group in b.groups], rtol=1e-5)


def test_a_row_that_alone_determines_something_is_not_tested(robot: calib.Robot) -> None:
    rng = np.random.default_rng(9)
    data = positions(robot, rng)
    tool = np.array(data.tool)
    tool[5] = 1
    data = replace(data, tools=("tool", "other"), tool=tool)
    fit = calib.identify(machines.model(robot, offsets="all", prior_angle=5e-3), data)
    row = next(row for row in calib.judging.outliers(fit).rows if row.line == data.lines[5])
    assert np.isnan(row.p)
    assert np.isnan(row.studentised)
    assert row.leverage == pytest.approx(1.0, abs=1e-6)


def test_what_a_step_does_to_one_of_several_sets(
    robot: calib.Robot, recorded: Recorded, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(elimination, "_MUCH", 0)
    monkeypatch.setattr(elimination, "_WORTH_IT", np.inf)
    rng = np.random.default_rng(11)
    model = machines.model(robot, offsets="all", base="fixed", prior_angle=5e-3)
    fit = calib.identify(model, measured(robot, resampled(recorded, rng), PLAY))
    residue = Residue.of(fit, {})
    covariance = residue.covariance
    c, (m, a) = len(covariance.split.common), covariance.split.blocks.shape
    assert a == 3
    assert len(fit.measurements) > 1
    steps, block = rng.normal(size=(6, c + a)), np.array([0, m - 1, 1, -1, 2, 0])
    for i in range(len(fit.measurements)):
        expected = np.zeros(6)
        for rows in residue.blocks(i):
            assert rows.measurements == i
            for k, (step, own) in enumerate(zip(steps, block, strict=True)):
                # Each target follows the common parameters, but for the one that is moved.
                moved = covariance.follow @ step[:c]
                if own >= 0:
                    moved[own] = step[c:]
                change = rows.J[:, :, :c] @ step[:c] + np.einsum("nda,na->nd", rows.J[:, :, c:], moved[rows.block])
                expected[k] += np.sum(rows.w[:, None] * ((rows.r + change) ** 2 - rows.r**2))
        found = SquaresOfSet.of(residue.blocks(i), covariance).change(steps, block, covariance)
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_row_of_a_small_set_beside_a_large_one_is_judged_by_what_is_left_of_its_own(robot: calib.Robot) -> None:
    rng = np.random.default_rng(12)
    large, small = positions(robot, rng, 60), positions(robot, rng, 8)
    sets = [replace(large, where="large"), replace(small, where="small")]
    model = machines.model(robot, offsets="all", base="fixed")
    fit = calib.identify(model, sets, model_sigmas=[2e-3, 2e-3])
    found = {(row.file, row.line): row for row in calib.judging.outliers(fit).rows}
    for k, data in enumerate(sets):
        for n, line in enumerate(data.lines):
            left = list(sets)
            left[k] = data.subset(np.arange(len(data)) != n)
            other = calib.identify(model, left, model_sigmas=[2e-3, 2e-3])
            sigma, freedom = fit.noise[k].total, fit.noise[k].degrees_of_freedom
            whole = sum(np.sum((r / noise.total) ** 2) for r, noise in zip(fit.residuals, fit.noise, strict=True))
            rest = [np.sum((r / noise.total) ** 2) for r, noise in zip(other.residuals, fit.noise, strict=True)]
            scatter = rest[k] / (freedom - 3)
            assert sigma > 0.0
            row = found[data.where, int(line)]
            assert row.studentised == pytest.approx(np.sqrt((whole - sum(rest)) / scatter / 3), rel=5e-3)


@pytest.mark.parametrize("off", [1.0, 1.05, 1.2])
def test_no_split_of_a_target_explains_more_than_noise_does(off: float) -> None:
    """Of a Panda that was dragged in one socket, covariances of what it hardly determined were 1.2 times too large."""
    n, best = 400, []
    for seed, width in product(range(6, 10), (2.0, 10.0, 40.0)):
        rng = np.random.default_rng(seed)
        turned = np.tanh((np.arange(n) - 150.0) / width)  # what a joint that is turned in between does to the tip
        J = np.column_stack([np.ones(n), turned, rng.standard_normal((n, 2))])
        r = rng.standard_normal(n)
        r -= J @ np.linalg.lstsq(J, r, rcond=None)[0]
        run = disagreement._Run([], [0], n)
        run.add(0, np.arange(n), np.column_stack([J, r])[:, None, :], np.full(n, -1), np.zeros((0, 0, 4)))
        covariance = SimpleNamespace(common=off * np.linalg.inv(J.T @ J))
        residue = cast("Residue", SimpleNamespace(split=SimpleNamespace(common=np.arange(4)), covariance=covariance))
        best.append(max(split.gain for split in run.splits(residue, related=False)))
    assert 1.0 < max(best) < 20.0  # of 400 in all, of which it explained up to 1200
