"""Verification and comparison against simulated truth: what has not changed passes as often as it should."""

import json
import re
import shutil
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import calib
from calib.assessment import acceptance
from calib.assessment.acceptance import verify
from calib.assessment.drift import compare
from calib.foundations.errors import MeasurementError
from calib.machine.gaussian import Kernel, gaussian_from_residuals
from calib.machine.grid import grid_from_residuals
from calib.machine.identified import outside_identified
from calib.machine.of_fit import machine_of
from calib.machine.residual_model import Leaning, ResidualModel
from calib.presentation.acceptance_tables import change_sheet, comparison_sentences, verification_lines
from calib.robot.joint_terms import with_joint_terms
from calib.robot.terms import JointTerm
from calib.robot.urdf import parse_urdf
from tests.support import machines, trees
from tests.support.cases import CASE, copy_case, run
from tests.support.machines import Array, Machine, anywhere, pose

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
SIGMA = 5e-5


def machine(seed: int = 0) -> tuple[calib.Robot, Machine, machines.Arm]:
    rng = np.random.default_rng(seed)
    arm = machines.arm(*UR10)
    return machines.load(*UR10), Machine(arm.moved(rng), anywhere(rng), {"tool": pose((0.05, 0.02, 0.15))}), arm


def seen(true: Machine, rows: int, seed: int, observes: str = "position", **options: object) -> calib.Measurements:
    rng = np.random.default_rng(seed)
    readings = machines.arm(*UR10).draw(rng, rows)
    return true.measure(machines.load(*UR10), readings, observes, rng=rng, sigma=SIGMA, sigma_angle=1e-4, **options)  # type: ignore[arg-type]


def calibrated(true: Machine, seed: int, observes: str = "position", rows: int = 60, **options: object) -> calib.Fit:
    tool = "pose" if observes == "pose" else "position"
    model = calib.error_model(machines.load(*UR10), offsets="all", placements="all", tool=tool)
    return calib.identify(model, seen(true, rows, seed, observes, **options))


def with_zero(true: Machine, joint: str, by: float) -> Machine:
    return replace(true, arm=true.arm.with_errors(np.zeros((len(true.arm.joints), 6)), {joint: by}))


@pytest.mark.parametrize(("observes", "stated"), [("position", None), ("position", (SIGMA / 20, 0.0)), ("pose", None)])
def test_what_has_not_changed_passes(observes: str, stated: tuple[float, float] | None) -> None:
    """The statistic over its degrees of freedom is 1 on average, base refitted or not, from ten points."""
    _, true, _ = machine()
    u = machine_of(calibrated(true, 1, observes, stated=stated))
    found = [verify(u, seen(true, 10, seed, observes, stated=stated)) for seed in range(100, 116)]
    for tests in ([v.as_calibrated.test for v in found], [v.base_refitted.test for v in found if v.base_refitted]):
        assert len(tests) == 16
        ratios = np.array([t.statistic / t.degrees_of_freedom for t in tests])
        # The fit's own luck is common to all: the noise it states is known to a twentieth or so.
        assert 0.7 < ratios.mean() < 1.35
        assert np.mean([t.passed for t in tests]) > 0.85
    numbers = 10 * (6 if observes == "pose" else 3)
    assert found[0].as_calibrated.test.degrees_of_freedom == numbers
    assert found[0].base_refitted is not None
    assert found[0].base_refitted.test.degrees_of_freedom == numbers - 6


def test_the_probability_is_uniform_over_calibrations() -> None:
    """Each time another machine, another calibration and other points: no probability is likelier than another."""
    probabilities = []
    for seed in range(16):
        _, true, _ = machine(seed)
        u = machine_of(calibrated(true, seed + 500, rows=40))
        probabilities.append(verify(u, seen(true, 10, seed + 900)).as_calibrated.test.probability)
    p = np.sort(probabilities)
    # Kolmogorov and Smirnov: 16 uniform numbers stay within 0.36 of their places in 98 of 100 cases.
    assert np.abs(p - (np.arange(16) + 0.5) / 16).max() < 0.36


def test_a_shifted_zero_fails_and_a_moved_base_only_with_its_old_place() -> None:
    _, true, _ = machine()
    u = machine_of(calibrated(true, 1))
    bent = verify(u, seen(with_zero(true, "elbow_joint", 5e-4), 12, 7))
    assert not bent.passed
    assert bent.base_refitted is not None
    assert not bent.base_refitted.test.passed
    said = [str(line) for line in verification_lines(bent)]
    assert any(
        "mm rms, more than the stated uncertainty explains: the arm itself has changed, it bears a load or " in line
        for line in said
    )
    moved = replace(true, base=true.base @ pose((3e-4, -4e-4, 0.0), (0.0, 0.0, 1e-3)))
    data = seen(moved, 12, 7)
    standing, refitted = verify(u, data), verify(u, data, refit=True)
    assert not standing.passed
    assert refitted.passed
    assert refitted.base_moved is not None
    assert refitted.base_moved[0] == pytest.approx(5e-4, abs=1e-4)
    assert refitted.base_moved[1] == pytest.approx(1e-3, abs=1e-4)
    # From anywhere: a tracker on another stand.
    elsewhere = replace(true, base=anywhere(np.random.default_rng(9)))
    assert verify(u, seen(elsewhere, 12, 7), refit=True).passed


@pytest.mark.parametrize("observes", ["position", "pose"])
def test_a_tool_that_moved_is_found_anew_and_said(observes: str) -> None:
    _, true, _ = machine()
    u = machine_of(calibrated(true, 1, observes))
    remounted = replace(true, tools={"tool": true.tools["tool"] @ pose((1e-3, 0.0, 2e-3), (0.0, 0.02, 0.01))})
    data = seen(remounted, 12, 7, observes)
    standing, found = verify(u, data), verify(u, data, refit_tool=True)
    assert (standing.passed, found.passed) == (False, True)
    assert set(standing.anew) == {"base", "tool", "both"}
    assert not standing.anew["base"].judgement.test.passed
    tool = found.anew["tool"]
    assert found.decisive is tool.judgement
    numbers = 6 if observes == "pose" else 3
    assert tool.judgement.test.degrees_of_freedom == 11 * numbers
    assert found.anew["both"].judgement.test.degrees_of_freedom == 11 * numbers - 6
    assert tool.base_moved is None
    assert tool.tool_moved is not None
    assert tool.tool_moved[0] == pytest.approx(np.hypot(1e-3, 2e-3), abs=1e-4)
    assert tool.tool_moved[1] == pytest.approx(np.hypot(0.02, 0.01) if observes == "pose" else 0.0, abs=1e-4)
    said = " ".join(map(str, verification_lines(standing)))
    turn = " and 1.2" if observes == "pose" else " explains them: "
    assert re.search(rf"A tool moved by 2\.[12]\d\d mm{turn}", said), said
    assert (
        "as far as these rows show, the arm is as calibrated, but carries another tool, or its tool elsewhere." in said
    )
    assert "the arm itself has changed" not in said
    contents = found.contents()
    assert (contents["base_refitted"], contents["tool_refitted"]) == (False, True)
    assert contents["with_tool_refitted"]["tool_moved"] == tool.tool_moved


def test_base_and_tool_are_found_anew_together() -> None:
    """As after a year: a tracker on another stand, and a nest that was glued again."""
    _, true, _ = machine()
    u = machine_of(calibrated(true, 1))
    other = replace(
        true, base=anywhere(np.random.default_rng(9)), tools={"tool": true.tools["tool"] @ pose((1e-3, 0.0, 2e-3))}
    )
    data = seen(other, 12, 7)
    base, both = verify(u, data, refit=True), verify(u, data, refit=True, refit_tool=True)
    assert not base.passed
    assert both.passed
    found = str(verification_lines(both)[0])
    assert re.fullmatch(
        r"Found anew: a base moved by [\d.]+ mm and [\d.]+ deg, with a tool moved by 2\.\d+ mm\.", found
    )
    said = " ".join(map(str, verification_lines(base)))
    assert re.search(
        r"A base moved by [\d.]+ mm and [\d.]+ deg, with a tool moved by 2\.\d+ mm, explains them: these rows do not "
        "show that the arm itself has changed.",
        said,
    ), said
    bent = seen(with_zero(other, "elbow_joint", 1e-3), 12, 7)
    said = " ".join(map(str, verification_lines(verify(u, bent, refit=True, refit_tool=True))))
    assert said.endswith("is stated too small. Failed.")
    assert re.search(r"A base moved by .*, with a tool moved by .*, leaves .* mm rms, .*: the arm itself has ch", said)
    assert "explains them" not in said


def test_rows_too_few_for_base_and_tool_do_not_blame_the_arm_alone() -> None:
    """Three positions find a base or a tool anew, not both: it was said that the arm itself has changed."""
    _, true, _ = machine()
    u = machine_of(calibrated(true, 1))
    tools = {"tool": true.tools["tool"] @ pose((0.03, 0.0, 0.02))}
    found = verify(u, seen(replace(true, base=anywhere(np.random.default_rng(9)), tools=tools), 3, 7))
    assert set(found.anew) == {"base", "tool"}
    said = " ".join(map(str, verification_lines(found)))
    assert re.search(
        r"A base moved by [^,]* leaves [\d.]+ mm rms, more than the stated uncertainty explains: base", said
    )
    assert "base and tool have both moved, which these rows cannot show, the arm itself has changed, it bears" in said


def test_an_offset_of_the_last_joint_looks_like_a_tool_that_moved() -> None:
    _, true, _ = machine()
    for observes in ("position", "pose"):
        u = machine_of(calibrated(true, 1, observes))
        found = verify(u, seen(with_zero(true, "wrist_3_joint", 0.05), 12, 7, observes))
        assert found.anew["tool"].or_offset_of == "wrist_3_joint"
        said = " ".join(map(str, verification_lines(found)))
        assert "or the offset of 'wrist_3_joint' has changed, which looks the same." in said
        moved = replace(true, tools={"tool": true.tools["tool"] @ pose((0.0, 0.0, 2e-3))})
        assert verify(u, seen(moved, 12, 7, observes)).anew["tool"].or_offset_of is None


def test_an_offset_of_any_joint_that_explains_the_rows_is_told() -> None:
    """At poses near one another, a joint within the arm moves the tip as a base or a tool that moved."""
    _, true, _ = machine()
    u, robot = machine_of(calibrated(true, 1)), machines.load(*UR10)
    rng = np.random.default_rng(3)
    near = np.array([0.4, -1.1, 1.3, -0.8, 0.9, 0.5]) + rng.uniform(-0.05, 0.05, (12, 6))
    for joint in ("shoulder_lift_joint", "elbow_joint", "wrist_2_joint"):
        found = verify(u, with_zero(true, joint, 2e-3).measure(robot, near, "position", rng=rng, sigma=SIGMA))
        assert not found.passed
        explain = [anew for anew in (found.anew["base"], found.anew["tool"]) if anew.judgement.test.passed]
        assert explain
        assert [anew.or_offset_of for anew in explain] == [joint] * len(explain)


def test_no_offset_is_told_by_which_tools_would_turn_to_both_sides() -> None:
    _, true, _ = machine()
    robot, rng = machines.load(*UR10), np.random.default_rng(3)
    true = replace(true, tools={"one": pose((0.05, 0.02, 0.15)), "two": pose((-0.06, 0.03, 0.1))})
    readings = machines.arm(*UR10).draw(rng, 80)
    model = calib.error_model(robot, offsets="all", placements="all")

    def measured(of: Machine, readings: Array) -> calib.Measurements:
        names = ["one", "two"] * (len(readings) // 2)
        return of.measure(robot, readings, "position", points=names, rng=rng, sigma=SIGMA)

    u = machine_of(calib.identify(model, measured(true, readings)))
    readings = machines.arm(*UR10).draw(rng, 20)
    for of_one, of_two, told in ((0.01, 0.01, "wrist_3_joint"), (0.01, -0.02, None)):
        turns = {"one": pose(rotvec=(0.0, 0.0, of_one)), "two": pose(rotvec=(0.0, 0.0, of_two))}
        turned = replace(true, tools={name: turns[name] @ tool for name, tool in true.tools.items()})
        tool = verify(u, measured(turned, readings)).anew["tool"]
        assert tool.judgement.test.passed
        assert tool.or_offset_of == told


def test_one_of_several_tools_is_found_anew() -> None:
    _, true, _ = machine()
    true = replace(true, tools={"a": true.tools["tool"], "b": pose((0.0, -0.08, 0.1))})
    robot, rng, arm = machines.load(*UR10), np.random.default_rng(3), machines.arm(*UR10)

    def measured(true: Machine, points: list[str]) -> calib.Measurements:
        return true.measure(robot, arm.draw(rng, len(points)), points=points, rng=rng, sigma=SIGMA)

    model = calib.error_model(robot, offsets="all", placements="all", tool="position")
    u = machine_of(calib.identify(model, measured(true, ["a", "b"] * 40)))
    moved = replace(true, tools={"a": true.tools["a"], "b": pose((0.0, -0.08, 0.103))})
    found = verify(u, measured(moved, ["a", "b"] * 10), refit_tool=True)
    assert found.passed
    tool = found.anew["tool"]
    assert tool.tool_moved is not None
    assert tool.tool_moved[0] == pytest.approx(3e-3, abs=1e-4)
    assert tool.judgement.test.degrees_of_freedom == 60 - 6
    few = measured(moved, ["a"] * 10 + ["b"] * 2)
    with pytest.raises(MeasurementError, match="2 rows of the tool 'b' are too few to find the tool anew; it takes th"):
        verify(u, few, refit_tool=True)


def test_base_and_tool_that_look_alike_are_found_anew_without_a_number() -> None:
    """Of a tip that turns about one axis alone, as that of a SCARA: a tool that moves along it looks like a base."""
    _, true, arm = machine()
    robot, rng = machines.load(*UR10), np.random.default_rng(5)
    u = machine_of(calibrated(true, 1))
    readings = arm.draw(rng, 12)
    readings[:, 1:5] = [-1.0, 1.0, -np.pi / 2, -np.pi / 2]  # the last axis upright
    other = replace(true, base=anywhere(rng), tools={"tool": true.tools["tool"] @ pose((1e-3, 0.0, 2e-3))})
    found = verify(u, other.measure(robot, readings, rng=rng, sigma=SIGMA), refit=True, refit_tool=True)
    assert found.passed
    both = found.anew["both"]
    assert (both.base_moved, both.tool_moved) == (None, None)
    standing = verify(u, other.measure(robot, readings, rng=rng, sigma=SIGMA))
    said = " ".join(map(str, verification_lines(standing)))
    assert "A motion of base and tool together explains them: these rows do not show that the arm" in said


def test_a_tool_is_not_found_anew_by_points_of_rows() -> None:
    _, true, _ = machine()
    data = replace(seen(true, 12, 8), points=np.tile([0.0, 0.0, 0.01], (12, 1)))
    with pytest.raises(MeasurementError, match="every row has a point of its own in the tool's frame"):
        verify(machine_of(calibrated(true, 1)), data, refit_tool=True)


def test_the_base_is_found_anew_by_points_of_rows() -> None:
    """What a line scanner saw, at a point in the tool's frame that differs from row to row."""
    _, true, arm = machine()
    robot, rng = machines.load(*UR10), np.random.default_rng(5)
    u = machine_of(calibrated(true, 1, "pose"))
    elsewhere, readings, points = replace(true, base=anywhere(rng)), arm.draw(rng, 20), rng.normal(0.0, 0.02, (20, 3))
    frames = elsewhere.see(readings)
    at = frames[:, :3, 3] + np.einsum("nij,nj->ni", frames[:, :3, :3], points) + rng.normal(0.0, SIGMA, (20, 3))
    data = replace(elsewhere.measure(robot, readings, rng=rng, sigma=SIGMA), position=at, points=points)
    assert verify(u, data, refit=True).passed


def test_the_limit_is_one_of_every_error() -> None:
    _, true, _ = machine()
    u, data = machine_of(calibrated(true, 1)), seen(true, 12, 8)
    largest = float(np.linalg.norm(verify(u, data).as_calibrated.residuals, axis=1).max())
    above, below = (verify(u, data, limit=largest * share) for share in (1.01, 0.99))
    assert (above.within_limit, above.passed) == (True, True)
    assert (below.within_limit, below.passed) == (False, False)
    assert verify(u, data).within_limit is None


def test_shifts_of_a_grid_belong_to_the_prediction() -> None:
    _, true, _ = machine()
    u, data = machine_of(calibrated(true, 1)), seen(true, 12, 8)

    class AlongTheBase(ResidualModel):
        def shifts(self, base: Array, tips: Array, readings: Array) -> Array:
            return np.tile(base[:3, 0] * 1e-3, (len(readings), 1))

        def leaning(self, readings: Array) -> Leaning:
            none = np.zeros((len(readings), 0))
            return Leaning(np.zeros((*none.shape, readings.shape[1])), none, np.ones(len(none)), np.zeros(len(none)))

        def own_errors(self, readings: Array, noise: float) -> Array:
            return np.zeros((len(readings), 0))

        frame = "base"
        setups = tools = ()

    shifted = replace(data, position=data.position + 1e-3 * u.base[:3, 0])
    known = replace(u, residual_model=AlongTheBase())
    np.testing.assert_allclose(
        verify(known, shifted).as_calibrated.residuals, verify(u, data).as_calibrated.residuals, atol=1e-15
    )
    assert not verify(u, shifted).passed
    # Where the base is found anew, the shifts turn with it.
    T = anywhere(np.random.default_rng(4))
    moved = replace(shifted, position=shifted.position @ T[:3, :3].T + T[:3, 3])
    here, there = (verify(known, some, refit=True).base_refitted for some in (shifted, moved))
    assert here is not None and there is not None
    np.testing.assert_allclose(there.residuals, here.residuals @ T[:3, :3].T, atol=1e-9)


@pytest.mark.parametrize("one_node", [False, True])
def test_what_a_grid_gets_wrong_is_expected(one_node: bool) -> None:
    """Nodes were measured with noise: it comes back in every row of their cells, and is common to these."""
    _, true, _ = machine()
    u, robot = machine_of(calibrated(true, 1, stated=(SIGMA, 0.0), rows=200)), machines.load(*UR10)
    axes = np.radians([[-40.0, -20.0, 0.0, 20.0, 40.0]] * 2 + [[30.0, 50.0, 70.0, 90.0, 110.0]])
    nodes = np.zeros((125, 6))
    nodes[:, :3] = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    joints = [reading.name for reading in robot.readings][:3]
    tests = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        at_nodes, rows = true.measure(robot, nodes, rng=rng, sigma=SIGMA), np.zeros((60, 6))
        grid = grid_from_residuals(nodes, u.residuals(at_nodes) @ u.base[:3, :3], robot.readings, joints)
        rows[:, :3] = nodes[31, :3] if one_node else rng.uniform(axes[:, 0], axes[:, -1], (60, 3))
        data = true.measure(robot, rows, rng=rng, sigma=SIGMA, stated=(SIGMA, 0.0))
        tests.append(verify(replace(u, residual_model=grid), data).as_calibrated.test)
    ratios = np.array([test.statistic / test.degrees_of_freedom for test in tests])
    assert 0.9 < ratios.mean() < 1.1
    assert all(test.passed for test in tests)


def test_a_residual_model_looks_once_at_every_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many ways there are of finding base and tool anew; a process goes through all its rows for each look."""
    _, true, _ = machine()
    u, rng = machine_of(calibrated(true, 1)), np.random.default_rng(2)
    readings = true.arm.draw(rng, 40)
    process = gaussian_from_residuals(readings, rng.normal(scale=1e-4, size=(40, 3)), u.robot.readings)
    data, seen_by, between = seen(true, 20, 8), list[int](), Kernel.between

    def counted(kernel: Kernel, a: Array, b: Array) -> Array:
        seen_by.append(len(a) * len(b))
        return between(kernel, a, b)

    monkeypatch.setattr(Kernel, "between", counted)
    found = verify(replace(u, residual_model=process), data)
    assert set(found.anew) == {"base", "tool", "both"}
    # Its errors, how sure it is of them, and what neighbours have in common.
    assert sum(seen_by) <= 3 * 20 * 40 + 20 * 20


def test_many_rows_of_a_grid_are_judged_some_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """What rows have in common is kept among those looked at together; whole, or in halves that share no cell."""
    _, true, _ = machine()
    u, robot = machine_of(calibrated(true, 1)), machines.load(*UR10)
    nodes = np.zeros((4, 6))
    nodes[:, 0] = [-0.3, 0.0, 0.3, 0.6]
    grid = grid_from_residuals(nodes, np.zeros((4, 3)), robot.readings, [robot.readings[0].name])
    rows = np.zeros((20, 6))
    rows[:, 0] = np.repeat([-0.2, 0.4], 10)
    known, data = replace(u, residual_model=grid), true.measure(robot, rows, rng=np.random.default_rng(3), sigma=SIGMA)
    whole = verify(known, data).as_calibrated.test
    monkeypatch.setattr(acceptance, "_TOGETHER", 10)
    assert verify(known, data).as_calibrated.test.statistic == pytest.approx(whole.statistic, rel=1e-9)


def test_the_order_of_rows_and_the_place_of_the_world_do_not_matter() -> None:
    _, true, _ = machine()
    fit, data = calibrated(true, 1), seen(true, 12, 8)
    u = machine_of(fit)
    order = np.random.default_rng(0).permutation(12)
    a, b = (verify(u, some).as_calibrated.test.statistic for some in (data, data.subset(order)))
    assert a == pytest.approx(b, rel=1e-9)
    T = anywhere(np.random.default_rng(4))
    (own,) = fit.measurements
    there = calib.identify(fit.model, replace(own, position=own.position @ T[:3, :3].T + T[:3, 3]))
    moved = replace(data, position=data.position @ T[:3, :3].T + T[:3, 3])
    assert verify(machine_of(there), moved).as_calibrated.test.statistic == pytest.approx(a, rel=1e-4)


def test_what_cannot_be_verified_is_said() -> None:
    _, true, _ = machine()
    u = machine_of(calibrated(true, 1))
    with pytest.raises(MeasurementError, match="the calibration was made without any orientation"):
        verify(u, seen(true, 5, 3, "pose"))
    with pytest.raises(MeasurementError, match="2 rows are too few to find the base anew; it takes three"):
        verify(u, seen(true, 2, 3), refit=True)
    assert verify(u, seen(true, 2, 3)).base_refitted is None
    with pytest.raises(MeasurementError, match="has no rows to verify by"):
        verify(u, seen(true, 5, 3).subset([]))
    other = replace(seen(true, 5, 3), tools=("ball",))
    with pytest.raises(MeasurementError, match="there is no tool 'ball'; the calibrated one is 'tool'"):
        verify(u, other)
    known = u.known_uncertainty
    assert known.position is not None
    none = replace(u, uncertainty=replace(known, position=replace(known.position, model=0.0, total=0.0)))
    unstated = seen(true, 5, 3)
    unstated = replace(unstated, sigma=np.zeros_like(unstated.sigma))
    with pytest.raises(MeasurementError, match=r"state any noise of a position; give the standard deviation"):
        verify(none, unstated)


# ---- comparison


@pytest.mark.parametrize("places", [1, 2])
def test_rows_that_do_not_show_the_base_are_judged_where_it_was(places: int) -> None:
    _, true, _ = machine()
    u = machine_of(calibrated(true, 1))
    data = seen(true, 12, 7).subset([row % places for row in range(6)])
    found = verify(u, data)
    assert found.base_refitted is None
    assert found.base_moved is None
    assert 0.0 < found.as_calibrated.test.probability < 1.0
    with pytest.raises(MeasurementError, match=r": all rows are at one place or in line, .* it takes three places\.$"):
        verify(u, data, refit=True)


@pytest.mark.parametrize("size", [1e-200, 1e12])
def test_doubts_of_any_size_are_judged(size: float) -> None:
    _, true, _ = machine()
    u, data = machine_of(calibrated(true, 1)), seen(true, 12, 7)
    known = u.known_uncertainty
    found = verify(replace(u, uncertainty=replace(known, factor=np.full_like(known.factor, size))), data)
    assert 0.0 <= found.as_calibrated.test.probability <= 1.0


def test_two_calibrations_of_one_machine_are_the_same() -> None:
    _, true, _ = machine()
    found = [
        compare(*(machine_of(calibrated(true, seed + k)) for k in (0, 1)))
        for seed in range(20, 34, 2)
    ]  # fmt: skip
    ratios = np.array([c.statistic / c.degrees_of_freedom for c in found if c.statistic is not None])
    assert len(ratios) == 7
    assert 0.7 < ratios.mean() < 1.4
    assert np.mean([c.moved for c in found]) <= 0.3
    assert {c.degrees_of_freedom for c in found} == {18}  # 27, less base and tool
    tips = np.array([c.tip_rms / c.stated for c in found])
    # What both state is what the two differ by, base and tool refitted.
    assert 0.75 < np.sqrt(np.mean(tips**2)) < 1.25


def test_a_zero_that_moved_is_named_with_what_it_does_at_the_tip() -> None:
    robot, true, arm = machine()
    model = calib.error_model(robot, offsets=["elbow_joint", "wrist_1_joint"])
    good = Machine(arm, true.base, true.tools)
    # The tracker has been moved as well.
    late = with_zero(replace(good, base=anywhere(np.random.default_rng(5))), "elbow_joint", 1e-3)
    before, after = (calib.identify(model, seen(one, 60, seed)) for one, seed in ((good, 1), (late, 2)))
    found = compare(machine_of(before), machine_of(after))
    changes = {change.name: change for change in found.changes}
    assert set(changes) == {"elbow_joint.offset", "wrist_1_joint.offset"}
    elbow = changes["elbow_joint.offset"]
    assert (elbow.moved, changes["wrist_1_joint.offset"].moved) == (True, False)
    assert elbow.new - elbow.old == pytest.approx(1e-3, abs=5 * elbow.sigma)
    assert found.probability is not None
    assert found.probability < 1e-6
    assert found.moved
    # The lever: the distance of the tool point from the elbow's axis, rms over the poses.
    readings = arm.draw(np.random.default_rng(1), 500)
    h = np.zeros(6)
    h[2] = 5e-7
    ends = [(arm.tips(readings + s * h) @ true.tools["tool"])[:, :3, 3] for s in (1, -1)]
    lever = float(np.sqrt(np.mean(np.sum(((ends[0] - ends[1]) / 1e-6) ** 2, axis=1))))
    assert elbow.at_tip == pytest.approx(lever * (elbow.new - elbow.old), rel=0.1)
    assert found.tip_max > found.tip_rms > 1e-4


def test_readings_told_in_another_turn_are_a_range_in_common() -> None:
    true = machine()[1]
    before, after = (machine_of(calibrated(true, seed)) for seed in (1, 2))
    turning = np.array([reading.turns for reading in before.robot.readings])[:, None]
    assert turning.any()
    known = after.known_uncertainty
    turned = replace(after, uncertainty=replace(known, identified=known.identified + 2.0 * np.pi * turning))
    at_tip = [compare(before, one).tip_rms for one in (after, turned)]
    assert at_tip[1] == pytest.approx(at_tip[0], rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_heights_of_a_tool_that_is_not_seen_are_no_difference(seed: int) -> None:
    """Identifiable parameters have a small part in the null space, along which the two calibrations are far apart."""
    scara, rng = (machines.INLINE["scara"], "tip"), np.random.default_rng(seed)
    robot, arm = machines.load(*scara), machines.arm(*scara)
    true = Machine(arm.moved(rng), anywhere(rng), {"tool": pose((0.03, 0.02, 0.05))})

    def found(one: Machine, height: float) -> calib.CalibratedMachine:
        known = calib.Known(tools={"tool": [0.03, 0.02, height]})
        model = calib.error_model(robot, offsets="all", placements="all", known=known)
        return machine_of(calib.identify(model, one.measure(robot, one.arm.draw(rng, 60), rng=rng, sigma=SIGMA)))

    before = found(true, 0.05)
    assert not compare(before, found(true, 0.2)).moved  # all of them have with the noise alone
    # Nor what the tool may have changed unseen where it was mounted anew: with what is seen alone all have moved.
    anew = replace(true, tools={"tool": pose((0.06, -0.02, 0.1))})
    assert not compare(before, found(anew, 0.05)).moved
    assert compare(before, found(with_zero(true, "elbow", 1e-3), 0.05)).moved


def with_terms(true: Machine, seed: int, *, backlash: float, gain: float) -> calib.CalibratedMachine:
    """A calibration of an arm whose elbow has half a gap (rad) and whose lift has a gain."""
    rng, robot = np.random.default_rng(seed), machines.load(*UR10)
    readings = true.arm.draw(rng, 80)
    side = rng.choice([-1.0, 1.0], 80)
    turned = readings.copy()
    turned[:, 2] += backlash * side
    turned[:, 1] *= 1.0 + gain
    places = true.see(turned)
    places[:, :3, 3] += rng.normal(scale=SIGMA, size=(80, 3))
    columns = machines.table(true.arm, readings, places, "position")
    columns["direction_elbow_joint"] = ["+" if one > 0.0 else "-" for one in side]
    data = calib.read_measurements(columns, robot, sigma=SIGMA)
    terms = {"backlash": ["elbow_joint"], "gain": ["shoulder_lift_joint"]}
    return machine_of(calib.identify(calib.error_model(robot, offsets="all", placements="all", terms=terms), data))


def test_joint_terms_that_changed_have_moved() -> None:
    """A gap that grew does not show at a tip that is reached from neither side."""
    _, true, _ = machine()
    before = with_terms(true, 1, backlash=-1e-4, gain=2e-4)
    same = compare(before, with_terms(true, 2, backlash=-1e-4, gain=2e-4))
    assert not same.moved
    assert {"elbow_joint.backlash", "shoulder_lift_joint.gain"} <= {change.name for change in same.changes}
    for name, of in (
        ("elbow_joint.backlash", {"backlash": -5e-4, "gain": 2e-4}),
        ("shoulder_lift_joint.gain", {"backlash": -1e-4, "gain": 8e-4}),
    ):
        found = compare(before, with_terms(true, 3, **of))
        assert [change.name for change in found.changes if change.moved] == [name]
        (moved,) = (change for change in found.changes if change.moved)
        assert moved.at_tip > 1e-4
        assert found.tip_rms > 5 * found.stated


def test_what_stated_priors_decide_has_not_moved() -> None:
    """Both sessions keep what they do not see where it was stated: that they agree there to a hair is no precision."""
    robot, true, _ = machine()
    model = calib.error_model(robot, offsets="all", placements="all", priors=calib.Priors(length=1e-3, angle=1e-3))

    def found(one: Machine, seed: int) -> calib.CalibratedMachine:
        elsewhere = replace(one, base=anywhere(np.random.default_rng(seed)))
        return machine_of(calib.identify(model, seen(elsewhere, 60, seed)))

    all_same = [compare(found(true, seed), found(true, seed + 1)) for seed in (20, 22, 24)]
    ratios = [same.statistic / same.degrees_of_freedom for same in all_same if same.statistic is not None]
    assert len(ratios) == 3
    assert 0.5 < np.mean(ratios) < 1.7
    assert sum(same.moved for same in all_same) <= 1  # once in ten by chance
    assert compare(found(true, 20), found(with_zero(true, "elbow_joint", 1e-3), 21)).moved
    # Who states priors and who does not have freed the same.
    assert compare(machine_of(calibrated(true, 1)), found(true, 20)).statistic is not None


def test_two_calibrations_of_thousands_of_terms_are_compared_in_little_memory() -> None:
    """Nothing is made that has a number for each two entries."""
    _, true, _ = machine()
    u = machine_of(calibrated(true, 1))
    names = [reading.name for reading in u.robot.readings]
    terms = [JointTerm(name, kind, order) for name in names for order in range(1, 501) for kind in ("cos", "sin")]
    robot, known, at = with_joint_terms(u.robot, terms), u.known_uncertainty, u.layout.base
    more = np.full((len(terms), known.factor.shape[1]), 1e-6)
    factor, null_basis = (
        np.insert(of, [at], np.zeros((len(terms), 1)) + rows, axis=0)
        for of, rows in ((known.factor, more), (known.null_basis, np.zeros((len(terms), known.null_basis.shape[1]))))
    )
    many = replace(
        u,
        robot=robot,
        deviations=replace(u.deviations, terms=np.zeros(len(terms))),
        uncertainty=replace(known, factor=factor, null_basis=null_basis),
        in_urdf=None,
    )
    tracemalloc.start()
    found = compare(many, many)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert not found.moved
    assert len(found.changes) >= len(terms)
    # Nor the derivatives of all 500 poses by every entry.
    assert peak < 500 * 6 * 8 * many.layout.size, peak / (500 * 6 * 8 * many.layout.size)


def test_calibrations_that_free_different_parameters_are_compared_at_the_tip() -> None:
    robot, true, _ = machine()
    some = calib.error_model(robot, offsets=["elbow_joint"])
    found = compare(machine_of(calibrated(true, 1)), machine_of(calib.identify(some, seen(true, 60, 2))))
    assert (found.statistic, found.probability) == (None, None)
    assert found.tip_rms > 5e-4
    said = replace(found, changes=())
    assert "the tips differ by more than the uncertainty" in comparison_sentences(said)[-1]
    assert comparison_sentences(replace(said, tip_rms=found.stated))[-1].startswith("Nothing has moved")


@pytest.mark.parametrize("policy", ["minimal", "nearest"])
def test_parameters_that_move_several_entries_are_compared(policy: Literal["minimal", "nearest"]) -> None:
    """A DH number moves more than one component of a placement: fewer combinations vary than there are components."""
    robot, true, _ = machine()
    model = calib.error_model(robot, placements=calib.dh.Free("all"))
    fits = [calib.identify(model, seen(true, 60, seed), null_space=policy) for seed in (1, 2)]
    found = compare(*map(machine_of, fits))
    placements = compare(*(machine_of(calibrated(true, seed)) for seed in (1, 2)))
    # The same machines in other words.
    assert found.degrees_of_freedom == placements.degrees_of_freedom == 18
    assert found.statistic == pytest.approx(placements.statistic, rel=0.05)
    assert found.tip_rms == pytest.approx(placements.tip_rms, rel=0.05)
    assert not found.moved


def test_what_a_minimal_set_holds_is_not_compared() -> None:
    """Nothing is known of it: its sigma was 0, and the table of changes was divided by it."""
    robot, true, as_designed = machine()
    model = calib.error_model(robot, offsets="all", placements="all")
    # Errors that are smaller than the noise of their estimates.
    fit = calib.identify(model, seen(replace(true, arm=as_designed), 40, 1), null_space="minimal")
    found = compare(machine_of(fit), machine_of(fit))
    assert {change.name for change in found.changes} <= {parameter.name for parameter in fit.parameters}
    assert len(change_sheet(found).rows) == len(found.changes) > 5


def two_arms(true: trees.Tree, seed: int, *, first: str = "right_hand") -> calib.CalibratedMachine:
    """A calibration of a torso with two arms, whose hands a tracker saw, that of ``first`` before the other one."""
    rng, ball = np.random.default_rng(seed), pose((0.05, 0.02, 0.1))
    tips = sorted(("right_hand", "left_hand"), key=lambda tip: tip != first)
    robot = calib.load_robot(parse_urdf(trees.urdf().encode(), "tree.urdf"), tips[0], links=tips[1:])
    data = []
    for tip in tips:
        q = true.draw(rng, 80)
        xyz = (true.link(tip, q) @ ball)[:, :3, 3] + rng.normal(scale=SIGMA, size=(80, 3))
        columns = true.columns(q, tuple(tips)) | {f"{axis} [m]": xyz[:, k] for k, axis in enumerate("xyz")}
        seen_there = calib.read_measurements(columns, robot.with_tip(tip), sigma=SIGMA)
        data.append(seen_there.named(tool=f"of {tip}"))
    return machine_of(calib.identify(calib.error_model(robot, offsets="all", placements="all"), data))


def test_all_tools_of_two_arms_are_looked_at() -> None:
    true = trees.tree(np.random.default_rng(0))
    before = two_arms(true, 1)
    offsets, tools = np.array(before.deviations.offsets), {"right": 0.0, "left": 0.0}
    names = [before.robot.chain[i].name for i in before.robot.moving]
    for side in tools:
        turned = offsets.copy()
        turned[names.index(f"{side}_elbow")] += 2e-3
        found = compare(before, replace(before, deviations=replace(before.deviations, offsets=turned)))
        tools[side] = found.tip_max
    # The two arms are alike: what moves one of them shows as much as what moves the other.
    assert tools["left"] > 3e-4
    assert tools["left"] == pytest.approx(tools["right"], rel=0.3)


def test_only_joints_that_bear_on_a_tool_are_outside_their_range() -> None:
    made = two_arms(trees.tree(np.random.default_rng(0)), 1)
    names = [reading.name for reading in made.robot.readings]
    q = np.mean(made.known_uncertainty.identified, axis=1)[None]
    q[0, names.index("left_elbow")] += 3.0
    (said,) = outside_identified(made, q)
    assert said.startswith("left_elbow is outside the range it was identified in")
    assert outside_identified(made, q, tool="of left_hand") == (said,)
    assert outside_identified(made, q, tool="of right_hand") == ()
    with pytest.raises(MeasurementError, match="nothing"):
        outside_identified(made, q, tool="nothing")


def test_arms_in_another_order_are_the_same_machine() -> None:
    """The tip of a job is that of its first table, from which the order of the arms follows."""
    true = trees.tree(np.random.default_rng(0))
    before, after = two_arms(true, 1), two_arms(true, 2, first="left_hand")
    names = [[reading.name for reading in one.robot.readings] for one in (before, after)]
    assert names[0] != names[1]
    found, back = compare(before, after), compare(after, before)
    assert found.statistic is not None
    assert 0.4 < found.statistic / found.degrees_of_freedom < 1.8
    assert (back.statistic, back.degrees_of_freedom) == (
        pytest.approx(found.statistic, rel=1e-3),
        found.degrees_of_freedom,
    )
    assert found.tip_rms < 2.0 * found.stated


def test_machines_are_looked_at_under_one_load() -> None:
    """Their first set-ups may have carried others, and what sags under these has not moved."""
    robot, true, _ = machine()
    model = calib.error_model(robot, offsets="all", terms={"elastic": ["shoulder_lift_joint"]})
    before = machine_of(calib.identify(model, seen(true, 60, 1)))
    soft = replace(before, deviations=replace(before.deviations, terms=np.array([2e-5])))
    loaded = replace(soft.robot, payload=calib.measuring.Payload(8.0, (0.0, 0.0, 0.06)))
    heavy = replace(soft, robot=with_joint_terms(loaded, loaded.terms))
    q = np.zeros((1, 6))
    assert np.linalg.norm(heavy.tips(q)[0, :3, 3] - soft.tips(q)[0, :3, 3]) > 1e-3
    for found in (compare(soft, heavy), compare(heavy, soft)):
        assert found.tip_max < 1e-7


def test_other_machines_are_not_compared() -> None:
    _, true, _ = machine()
    name = (machines.INLINE["negative"], "tip")
    rng = np.random.default_rng(0)
    arm = machines.arm(*name)
    data = Machine(arm, pose(), true.tools).measure(machines.load(*name), arm.draw(rng, 30), rng=rng, sigma=SIGMA)
    fit = calib.identify(calib.error_model(machines.load(*name), offsets="all"), data)
    with pytest.raises(MeasurementError, match="not of one machine"):
        compare(machine_of(calibrated(true, 1)), machine_of(fit))


# ---- the commands


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("acceptance")
    job = copy_case(folder)
    assert run("calibrate", job, "-o", folder / "out", "-q").code == 0
    return folder


def test_what_was_fitted_is_told(case: Path, tmp_path: Path) -> None:
    """The table of the fit passes, and shows nothing; the one that was held out is as good as new."""
    copied = shutil.copy(case / "identification.csv", tmp_path / "new.csv")
    said = f"{copied}: the machine was identified from this table; what was fitted verifies nothing."
    found = run("verify", case / "out", copied, "--json")
    assert (found.code, json.loads(found.out)["notes"]) == (0, [said])
    assert json.loads(run("verify", case / "out", case / "validation.csv", "--json").out)["notes"] == []


def test_verify_passes_and_fails(case: Path) -> None:
    out, table = case / "out", case / "validation.csv"
    good = run("verify", out, table, "--sigma", "0.02 mm", "--limit", "0.1 mm")
    assert (good.code, good.err) == (0, "")
    text = " ".join(good.out.split())
    assert "is within the limit, 0.1 mm." in text
    assert "The stated uncertainty explains the errors" in text
    assert text.endswith("Passed.")
    assert "So few rows" not in text
    few = case / "few.csv"
    few.write_text("".join(table.read_text().splitlines(keepends=True)[:-28]))
    # Chi-square of 6 degrees of freedom has 1 % beyond 16.81, and half beyond 5.35.
    assert "with errors 1.8 times as large as stated, half of such tests would pass." in " ".join(
        run("verify", out, few, "--sigma", "0.02 mm").out.split()
    )
    bad = run("verify", out, table, "--sigma", "0.02 mm", "--limit", "0.01 mm")
    assert (bad.code, bad.out.splitlines()[-1]) == (3, "Failed.")
    assert run("verify", out, table, "--limit", "0.01 mm", "-q") == (3, "", "")
    noted = case / "noted.csv"
    lines = [line for line in table.read_text().splitlines() if not line.startswith("#")]
    noted.write_text("\n".join([f"{lines[0]}, spindle", *(f"{line}, 1" for line in lines[1:])]))
    asked = run("verify", out, noted, "-q")
    assert asked.code == 1
    assert "column 'spindle' has no unit" in asked.err
    assert asked.err.endswith("; or pass over what is not needed: --ignore 'spindle'.\n")
    assert run("verify", out, noted, "--ignore", "spindle", "-q").code == 0
    contents = json.loads(run("verify", out, table, "--json").out)
    assert (contents["passed"], contents["within_limit"], contents["limit"]) == (True, None, None)
    assert contents["as_calibrated"]["test"]["degrees_of_freedom"] == 90
    wrong = run("verify", out, table, "--limit", "1 deg")
    assert (wrong.code, wrong.out) == (1, "")


@pytest.mark.parametrize(
    "command",
    [
        ("verify", "OUT", "validation.csv"),
        ("uncertainty", "OUT", "--samples", "10"),
        ("export", "OUT", "--to", "offsets", "-o", "offsets.csv"),
        ("compensate", "OUT", "validation.csv", "--frame", "instrument", "-o", "corrected.csv"),
        ("performance", "OUT", "cone.csv"),
        ("compare", "OUT", "OUT"),
    ],
    ids=lambda command: command[0],
)
def test_commands_say_that_the_calibration_is_doubted(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    """Errors of decimetres passed verify, as the doubted result states as much, and no word told of the doubt."""
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "doubted"
    shutil.copytree(case / "out", out)
    for name in ("validation.csv", "cone.csv"):
        shutil.copyfile(CASE / name, tmp_path / name)
    text = (out / "result.json").read_text(encoding="utf-8")
    (out / "result.json").write_text(text.replace('"trusted": true', '"trusted": false', 1), encoding="utf-8")

    def called(folder: Path) -> list[str | Path]:
        for written in ("offsets.csv", "corrected.csv"):
            (tmp_path / written).unlink(missing_ok=True)
        return [folder if word == "OUT" else word for word in command]

    said = run(*called(out))
    assert said.code == 0, said.err
    assert "is not trusted: see its own report." in " ".join(said.out.split())
    told = json.loads(run(*called(out), "--json").out)
    assert told["notes"] == [f"{out} is not trusted: see its own report."]
    assert json.loads(run(*called(case / "out"), "--json").out)["notes"] == []


def test_tables_of_other_programs_are_verified(case: Path, tmp_path: Path) -> None:
    """Columns by other names, without units, to be passed over, or of three angles: as a job reads them."""
    out, table = case / "out", case / "validation.csv"
    head, *rows = [line for line in table.read_text().splitlines() if not line.startswith("#")]
    titles = [title.strip() for title in head.split(",")]
    theirs = [{"x [mm]": "X2"}.get(title, title) for title in titles]
    (tmp_path / "theirs.csv").write_text(
        "\n".join(
            [",".join([*theirs, "who", "rx [deg]", "ry [deg]", "rz [deg]"]), *(f"{row},me,1,2,3" for row in rows)]
        )
    )
    options = ("--column", "x [mm]=X2", "--ignore", "who", "--orientation", "rpy")
    assert run("verify", out, tmp_path / "theirs.csv", *options, "--json") == run("verify", out, table, "--json")
    assert "give orientation" not in run("verify", out, tmp_path / "theirs.csv", *options, "--observes", "pose").err
    wrong = run("verify", out, tmp_path / "theirs.csv", "--column", "X2")
    assert (wrong.code, wrong.err) == (
        1,
        "Error: --column: 'X2' is not like 'x=X2': our name, and the title in the file.\n",
    )


def test_tables_are_verified_as_the_calibration_read_its_own(case: Path, tmp_path: Path) -> None:
    """Columns by other names and columns to be passed over need not be said twice; ours are read as well."""
    out, table, theirs = tmp_path / "out", case / "validation.csv", tmp_path / "theirs.csv"
    shutil.copytree(case / "out", out)
    head, *rows = [line for line in table.read_text().splitlines() if not line.startswith("#")]
    theirs.write_text("\n".join([head.replace("x [mm]", "X2") + ",who", *(f"{row},me" for row in rows)]))
    wanted = run("verify", out, table, "--json")
    assert "'X2', 'who' have no unit" in run("verify", out, theirs).err

    job = json.loads((out / "job.json").read_text())
    for one in job["measurements"]:
        one.update(columns={"x [mm]": "X2"}, ignore=["who", "when"], orientation="rpy")
    (out / "job.json").write_text(json.dumps(job))
    assert run("verify", out, theirs, "--json") == run("verify", out, table, "--json") == wanted

    job["measurements"][0]["ignore"] = []
    (out / "job.json").write_text(json.dumps(job))
    assert "have no unit" in run("verify", out, theirs).err  # Tables were read in two ways.
    (out / "job.json").write_text('{"measurements": [{"observes": "position"}]}')
    assert run("verify", out, table) == (1, "", f"Error: {out / 'job.json'}: is not a job of this toolkit.\n")
    (out / "job.json").unlink()
    assert run("verify", out, table, "--json") == wanted


@pytest.mark.parametrize(
    ("wrong", "why"), [(("[deg]", "[rad]"), "seem to be degrees"), (("[mm]", "[m]"), "seem to be millimetres")]
)
def test_wrong_units_are_no_arm_that_has_changed(case: Path, tmp_path: Path, wrong: tuple[str, str], why: str) -> None:
    table = tmp_path / "new.csv"
    table.write_text((case / "validation.csv").read_text().replace(*wrong))
    said = run("verify", case / "out", table)
    assert (said.code, said.out) == (1, "")
    assert why in said.err


def shifted(folder: Path, by: float, title: str = "x") -> Path:
    path = folder / f"shifted_{title}_{by}.csv"
    lines = (folder / "validation.csv").read_text(encoding="utf-8").splitlines()
    header = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    x = [name.split("[")[0].strip() for name in lines[header].split(",")].index(title)
    for k in range(header + 1, len(lines)):
        cells = lines[k].split(",")
        cells[x] = repr(float(cells[x]) + by)
        lines[k] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_verify_says_that_the_base_has_moved(case: Path) -> None:
    said = run("verify", case / "out", shifted(case, 0.5))
    text = " ".join(said.out.split())
    assert said.code == 3
    assert "does not explain the errors" in text
    assert "the arm is as calibrated, but stands elsewhere." in text
    assert run("verify", case / "out", shifted(case, 0.5), "--refit-base", "-q").code == 0


def test_verify_says_that_an_offset_of_the_first_joint_looks_like_a_base_that_has_moved(case: Path) -> None:
    text = " ".join(run("verify", case / "out", shifted(case, 0.02, "joint_1")).out.split())
    assert (
        "the arm is as calibrated, but stands elsewhere, or the offset of 'joint_1' has changed, which looks the same."
        in text
    )
    found = json.loads(run("verify", case / "out", shifted(case, 0.02, "joint_1"), "--json").out)
    assert found["or_offset_of"] == "joint_1"
    other = json.loads(run("verify", case / "out", shifted(case, 0.02, "joint_2"), "--json").out)
    assert other["or_offset_of"] is None


def test_compare_of_a_folder_with_itself(case: Path) -> None:
    said = run("compare", case / "out", case / "out")
    assert (said.code, said.err) == (0, "")
    assert " ".join(said.out.split()).endswith("Nothing has moved by more than the uncertainty of both explains.")
    contents = json.loads(run("compare", case / "out", case / "out", "--json").out)
    assert (contents["moved"], contents["tip"]["max"]) == (False, pytest.approx(0.0, abs=1e-9))


def test_two_results_side_by_side_as_a_page(case: Path, tmp_path: Path) -> None:
    page, other = tmp_path / "both.html", tmp_path / "later"
    shutil.copytree(case / "out", other)
    result = json.loads((other / "result.json").read_text(encoding="utf-8"))
    result["metrics"]["validation"]["after"]["position"]["rms"] = 1.2345e-3
    result["checks"][0]["passed"] = False
    result["inputs"]["more.csv"] = "abc"
    (other / "result.json").write_text(json.dumps(result), encoding="utf-8")
    assert run("compare", case / "out", other, "-o", page, "-q") == (0, "", "")
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr.*?</tr>", page.read_text(), re.DOTALL)]
    old = json.loads((case / "out" / "result.json").read_text(encoding="utf-8"))["metrics"]["validation"]["after"]
    (judged,) = [row for row in rows if row[:3] == ["validation", "after", "position"]][:1]
    assert (judged[4], judged[7]) == (f"{1e3 * old['position']['rms']:.4f}", "1.2345")
    assert [result["checks"][0]["name"], "yes", "NO"] in rows
    assert ["more.csv", "-", "abc"] in rows
    before = page.read_bytes()
    assert run("compare", case / "out", other, "-o", page).code == 1
    assert page.read_bytes() == before
    for edited, why in (
        ('{"trusted": true, "metrics": []}', "doubts is missing"),
        (json.dumps(result | {"trusted": True, "doubts": ["One."]}), "its top level: it is trusted, and has doubts"),
        (json.dumps(result | {"run": "a\nb"}), "run is \"a\\nb\"; string should match pattern '^[0-9a-f]{64}$'"),
        (json.dumps(result | {"trusted": "yes"}), 'trusted is "yes"; it must be a valid boolean'),
    ):
        (other / "result.json").write_text(edited)
        said = run("compare", case / "out", other, "-o", tmp_path / "new.html")
        assert (said.code, said.err) == (
            1,
            f"Error: {other / 'result.json'}: is not a result of this toolkit: {why}.\n",
        )
    assert not (tmp_path / "new.html").exists()


@pytest.mark.parametrize("name", ["job.json", "result.json"])
def test_a_file_of_another_run_is_refused(case: Path, tmp_path: Path, name: str) -> None:
    """What differs is said; files of earlier versions name no run, in no file, and are used."""
    out, page = tmp_path / "out", tmp_path / "both.html"
    shutil.copytree(case / "out", out)
    asked = {
        "job.json": ("verify", out, case / "validation.csv", "-q"),
        "result.json": ("compare", case / "out", out, "-o", page, "-q"),
    }[name]
    own = json.loads((out / name).read_text(encoding="utf-8"))
    (out / name).write_text(json.dumps(own | {"run": "0123456789ab" + 52 * "0"}), encoding="utf-8")
    ours = own["run"][:12]
    assert run(*asked) == (
        1,
        "",
        f"Error: {out / name}: names the run 0123456789ab, and model.json beside it names the run {ours}; a folder of "
        "results is used as one run wrote it.\n",
    )
    assert not page.exists()
    for part in {"model.json", "uncertainty.json", "result.json", name}:
        contents = json.loads((out / part).read_text(encoding="utf-8"))
        (out / part).write_text(json.dumps({k: v for k, v in contents.items() if k != "run"}), encoding="utf-8")
    assert run(*asked) == (0, "", "")


def test_a_folder_without_doubts_cannot_be_verified(case: Path, tmp_path: Path) -> None:
    for name in ("model.json", "nominal.urdf"):
        (tmp_path / name).write_bytes((case / "out" / name).read_bytes())
    said = run("verify", tmp_path, case / "validation.csv")
    assert (said.code, said.out) == (1, "")
    assert said.err == (
        f"Error: {tmp_path / 'nominal.urdf'}: the machine's uncertainty is not known; calibrate it again, or load the "
        "whole folder of its results.\n"
    )


def test_uncertainty_over_the_workspace(case: Path, tmp_path: Path) -> None:
    said = run("uncertainty", case / "out", "--samples", "50", "-o", tmp_path / "map.csv")
    assert (said.code, said.err) == (0, "")
    assert "100 %" in said.out
    lines = (tmp_path / "map.csv").read_text().splitlines()
    assert len(lines) == 51
    sigma = np.array([float(line.split(",")[9]) for line in lines[1:]])
    contents = json.loads(run("uncertainty", case / "out", "--samples", "50", "--json").out)
    assert contents["sigmas"]["100"][0] == pytest.approx(sigma.max() / 1e3, abs=1e-8)
    assert contents["known"] == {"position": 1.0, "orientation": 0.0}


def test_uncertainty_of_joint_terms_beyond_what_taught_them_is_told(case: Path, tmp_path: Path) -> None:
    robot = machines.load(*UR10)
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.0, 1.0, (60, 6))
    true = Machine(machines.arm(*UR10).moved(rng), anywhere(rng), {"tool": np.eye(4)})
    data = true.measure(robot, q, rng=rng, sigma=2e-5)
    model = calib.error_model(robot, offsets="all", placements="all", terms={"harmonics": ["elbow_joint"]})
    calib.save(calib.assess(calib.identify(model, data)), tmp_path / "out")
    whole = run("uncertainty", tmp_path / "out", "--samples", "20", "--whole")
    assert "Warning: elbow_joint is outside the range it was identified in, " in whole.out
    assert "only if the machine's joint terms are the right ones" in " ".join(whole.out.split())
    # Where it was measured, and for geometry alone, there is nothing to say.
    assert "Warning" not in run("uncertainty", tmp_path / "out", "--samples", "20").out
    assert "Warning" not in run("uncertainty", case / "out", "--samples", "20", "--whole").out


def test_compensate_warns_outside_the_identified_range(case: Path, tmp_path: Path) -> None:
    joints = [f"joint_{k}" for k in range(1, 7)]
    header = ",".join(f"{name} [deg]" for name in joints)
    (tmp_path / "inside.csv").write_text(f"{header}\n10,10,10,10,10,10\n")
    (tmp_path / "outside.csv").write_text(f"{header}\n10,10,10,10,10,10\n10,10,10,10,10,175\n")
    inside = run("compensate", case / "out", tmp_path / "inside.csv", "-o", tmp_path / "a.csv")
    assert (inside.code, "Warning" in inside.out) == (0, False)
    outside = run("compensate", case / "out", tmp_path / "outside.csv", "-o", tmp_path / "b.csv")
    assert outside.code == 0
    assert outside.out.startswith("Warning: joint_6 is outside the range it was identified in, ")
    assert "in 1 of 2 rows" in outside.out.replace("\n", " ")
