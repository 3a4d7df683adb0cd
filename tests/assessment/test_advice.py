"""Remedies that are named do help, what is not named does not, weak and correlated parameters are told."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.assessment.advice import advice, null_space_advice, told_briefly
from calib.identification.observability import indices, observability
from calib.robot.robot import Robot
from calib.robot.sampling import closing, random_readings
from calib.robot.urdf import parse_urdf
from tests.support import machines
from tests.support.loops import four_bar_urdf
from tests.support.machines import Machine, anywhere, pose

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
POINTS = {"a": (0.05, 0.02, 0.15), "b": (-0.1, 0.0, 0.1), "c": (0.0, 0.1, 0.05), "axis": (0.0, 0.0, 0.15)}


def measured(
    observes: str = "position", points: Sequence[str] = "a", rows: int = 90, sigma: float = 2e-5
) -> tuple[Robot, calib.Measurements]:
    rng = np.random.default_rng(2)
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    true = Machine(arm, anywhere(rng), {name: pose(POINTS[name], (0.1, 0.2, 0.3)) for name in points})
    return robot, true.measure(
        robot,
        arm.draw(rng, rows),
        observes,
        points=(list(points) * rows)[:rows],
        rng=rng,
        sigma=sigma,
        sigma_angle=2 * sigma,
    )


def null_count(robot: Robot, data: calib.Measurements, **options: object) -> int:
    chosen = {"offsets": "all", "placements": "all"} | options
    seen = observability(machines.model(robot, **chosen), [data])
    return len(seen.parameters) - seen.rank


@pytest.fixture(scope="module")
def fit() -> calib.Fit:
    robot, data = measured()
    return calib.identify(calib.error_model(robot, offsets="all", placements="all"), data)


def test_every_null_direction_has_a_sentence(fit: calib.Fit) -> None:
    said = [a for a in advice(fit) if a.kind == "null space"]
    assert [a.parameters[0] for a in said] == [d.parameter for d in fit.null_space]
    for a, direction in zip(said, fit.null_space, strict=True):
        assert a.sentence.startswith(f"{direction} ")
        assert ("To tell them apart" in a.sentence) == bool(a.remedies)


@pytest.mark.parametrize(("point", "shown"), [("a", 0), ("axis", 2)])
def test_what_a_measurement_was_said_to_show_is_what_it_then_shows(point: str, shown: int) -> None:
    """The directions of the null space that remain, counted by the rank of what would then be measured."""
    robot, data = measured(points=[point], sigma=0.0)  # noise would lift a point off the axis
    model = calib.error_model(robot, offsets="all", placements="all")
    said = null_space_advice(model, [data], observability(model, [data]).undetermined)
    assert null_count(*measured("pose", [point]), tool="pose") == len(said) - shown
    assert null_count(*measured(points=[point, "b", "c"])) == len(said) - shown
    assert sum("orientation" in a.remedies for a in said) == sum("points" in a.remedies for a in said) == shown


def test_the_last_offset_asks_for_the_tool_and_the_first_for_the_base(fit: calib.Fit) -> None:
    by_name = {a.parameters[0]: a for a in advice(fit) if a.kind == "null space"}
    last, first = by_name["wrist_3_joint.offset"], by_name["shoulder_pan_joint.offset"]
    assert "tool" in last.remedies
    assert last.sentence.endswith("measure where the tool is and fix it.")
    assert "base" in first.remedies
    # A tool that is fixed shows it indeed.
    robot, data = measured()
    pairs = {"offsets": ["wrist_3_joint"], "placements": "none"}
    assert null_count(robot, data, **pairs) == 1
    fixed = machines.model(robot, **pairs, tool="fixed", tool_poses={"a": pose(POINTS["a"])})
    assert observability(fixed, [data]).rank == 7


def test_what_only_moves_alike_is_to_be_left_out() -> None:
    """Parallel axes: sliding the second joint's frame along its axis is sliding the third's."""
    robot, data = measured("pose")
    model = calib.error_model(robot, placements=["elbow_joint.tz", "wrist_1_joint.tz"], tool="pose")
    seen = observability(model, [data])
    (said,) = null_space_advice(model, [data], seen.undetermined)
    assert said.remedies == ()
    assert said.sentence.endswith(
        "No measurement of the tip tells them apart, as they move it in the same way; leave one of them out."
    )


def test_weak_and_correlated_parameters_are_told_with_numbers() -> None:
    robot, data = measured(rows=8)
    near = data.readings[:1] + 0.03 * np.random.default_rng(0).standard_normal(data.readings.shape)
    arm = machines.arm(*UR10)
    true = Machine(arm, pose(), {"a": pose(POINTS["a"])})
    close = true.measure(robot, near, points=["a"] * 8, rng=np.random.default_rng(1), sigma=1e-4)
    model = calib.error_model(robot, offsets=["elbow_joint"], base="fixed", tool="position")
    fit = calib.identify(model, close, model_sigmas=[0.0])
    found = advice(fit)
    weak = [a for a in found if a.kind == "weakly determined"]
    assert (
        {a.parameters[0] for a in weak}
        == {p.name for p, w in zip(fit.parameters, fit.weakly_determined, strict=True) if w}
        != set()
    )
    sigma = {p.name: s for p, s in zip(fit.parameters, fit.sigmas, strict=True)}
    for a in weak:
        (name,) = a.parameters
        unit = "mrad" if name.endswith("offset") else "mm"
        assert f"its sigma is {1e3 * sigma[name]:.3g} {unit}, where the parameter scale is 1 {unit}" in a.sentence
    pairs = {a.parameters for a in found if a.kind == "correlated"}
    C = fit.covariance / np.sqrt(np.outer(np.diag(fit.covariance), np.diag(fit.covariance)))
    names = [p.name for p in fit.parameters]
    expected = {
        (names[i], names[j])
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if abs(C[i, j]) > 0.95 and not fit.unidentifiable[[i, j]].any()
    }
    assert pairs == expected != set()


def test_priors_judge_by_themselves(fit: calib.Fit) -> None:
    parameters = tuple(replace(p, prior=1e-6) if p.of_robot else p for p in fit.parameters)
    said = [
        a.sentence
        for a in advice(replace(fit, parameters=parameters, unidentifiable=np.zeros_like(fit.unidentifiable)))
    ]
    assert any("where its prior is 0.001 m" in sentence for sentence in said)


# ---- ranks of a 6R arm, base and tool free


@pytest.mark.parametrize(
    ("observes", "points", "tool", "rank"),
    [("pose", "a", "pose", 30), ("position", "a", "position", 27), ("position", "abc", "position", 33)],
)
def test_ranks_of_a_6r_arm(observes: str, points: str, tool: str, rank: int) -> None:
    robot, data = measured(observes, points)
    seen = observability(calib.error_model(robot, offsets="all", placements="all", tool=tool), [data])
    assert seen.rank == rank


def test_a_point_on_the_last_axis_sees_two_fewer() -> None:
    rng = np.random.default_rng(2)
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    data = Machine(arm, pose(), {"tool": pose((0, 0, 0.15))}).measure(robot, arm.draw(rng, 90))
    assert observability(calib.error_model(robot, offsets="all", placements="all"), [data]).rank == 25


def test_observability_indices_of_three_singular_values() -> None:
    found = indices(np.array([8.0, 2.0, 0.5]), 4)
    assert found == pytest.approx({"O1": 1.0, "O2": 1 / 16, "O3": 0.5, "O4": 1 / 32, "O5": 1 / (1 / 8 + 1 / 2 + 2)})
    assert indices(np.zeros(0), 4) == {}


def test_priors_change_no_remedy(fit: calib.Fit) -> None:
    """Scales follow priors; what a measurement would show does not."""
    robot, data = measured()
    wide = machines.model(robot, offsets="all", placements="all", prior_length=0.2e-3, prior_angle=0.7e-3)
    (plain, scaled) = (
        {a.parameters[0]: a.remedies for a in null_space_advice(m, [data], observability(m, [data]).undetermined)}
        for m in (fit.model, wide)
    )
    assert plain == scaled


def test_what_no_pose_would_show_is_one_sentence() -> None:
    robot, data = measured()
    model = calib.error_model(robot, offsets="all", placements="all")
    null_space = observability(model, [data]).undetermined
    every = [a.sentence for a in null_space_advice(model, [data], null_space)]
    assert len(every) == 18
    (said,) = told_briefly(model, [data], null_space, every)
    assert said == (
        "18 combinations that no position determines: normal for six revolute joints with a free base and tool. "
        "No prediction depends on them."
    )
    # Few directions are told one by one.
    assert told_briefly(model, [data], null_space[:2], every[:2]) == tuple(every[:2])


def test_what_no_pose_would_show_from_several_places_is_one_sentence() -> None:
    """An arm that was measured where it stood in three places, with a base for each, of which one has few rows."""
    robot, data = measured()
    model = calib.error_model(robot, offsets="all", placements="all")
    places = [data.named(setup=name) for name in ("dock", "bench")]
    places.append(data.subset(np.arange(4)).named(setup="door"))
    null_space = observability(model, places).undetermined
    every = [a.sentence for a in null_space_advice(model, places, null_space)]
    assert len(every) == 18
    (said,) = told_briefly(model, places, null_space, every)
    assert said.startswith("18 combinations that no position determines: normal for six revolute joints")
    # Two rows leave a turn of the base open, which is not normal: others would show it.
    places[-1] = data.subset(np.arange(2)).named(setup="door")
    null_space = observability(model, places).undetermined
    every = [a.sentence for a in null_space_advice(model, places, null_space)]
    first, *others = told_briefly(model, places, null_space, every)
    assert "combinations that no position determines" in first
    assert others
    assert set(others) < set(every)
    assert all("base.door" in sentence for sentence in others)


def test_joints_that_follow_others_are_told_beside_the_readings() -> None:
    """Of the IRB2400 without its loop seven joints carry the tip, and its controller shows six."""
    robot = calib.load_robot(Path(__file__).parents[2] / "robots/irb2400/irb2400.urdf", tip="tool0")
    q = np.random.default_rng(0).uniform(-0.5, 0.5, (60, 6))
    data = calib.positions(robot, q, robot.tips(q)[:, :3, 3], sigma=1e-4)
    model = calib.error_model(robot, offsets="all", placements="all")
    null_space = observability(model, [data]).undetermined
    said = told_briefly(model, [data], null_space, [str(direction) for direction in null_space])
    assert ": normal for seven revolute joints, moved by six readings, with a free base and tool. No " in said[0]
    fixed = calib.error_model(robot, offsets="all", placements="all", base="fixed", tool="fixed")
    null_space = observability(fixed, [data]).undetermined
    said = told_briefly(fixed, [data], null_space, [str(direction) for direction in null_space])
    assert ": normal for seven revolute joints, moved by six readings. No " in said[0]


def test_poses_that_would_show_a_direction_are_those_that_close() -> None:
    """A crank that cannot turn all the way: at some readings within its limits the loop does not close."""
    loop = calib.ClosedLoop("four-bar", ("rod_end", "pin"), ("x", "z"), ("elbow", "rod"))
    robot = calib.load_robot(parse_urdf(four_bar_urdf(e=0.12).encode(), "arm.urdf"), "tip", loops=[loop])
    q = np.random.default_rng(3).uniform(-0.3, 0.3, (30, len(robot.readings)))
    x = robot.tips(q)[:, :3, 3]
    columns: dict[str, object] = {f"{reading.name} [rad]": q[:, k] for k, reading in enumerate(robot.readings)}
    columns |= {f"{axis} [m]": x[:, k] for k, axis in enumerate("xyz")}
    data = calib.read_measurements(columns, robot, sigma=1e-5)
    model = calib.error_model(robot, offsets="all", placements="all")
    null_space = observability(model, [data]).undetermined
    assert not closing(robot, random_readings(robot, 30, None, ())).all()
    said = told_briefly(model, [data], null_space, [str(direction) for direction in null_space])
    assert "that no position determines" in said[0]
