"""Resampled fits agree with the covariance where the model is right, and keep the rows of a pose together."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.assessment.bootstrap import Kind, _seen, bootstrap, pose_groups
from calib.foundations.errors import IdentificationError, JobError, MeasurementError
from calib.robot.urdf import parse_urdf
from tests.support import cameras, machines, trees
from tests.support.machines import Machine, anywhere, pose
from tests.support.touching import Lab

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
REPETITIONS = 40


def fit_of(rows: int, observes: str = "position") -> tuple[calib.Fit, machines.Arm]:
    rng = np.random.default_rng(11)
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    offsets = dict.fromkeys(("elbow_joint", "wrist_1_joint"), 0.002)
    true = Machine(
        arm.with_errors(np.zeros((len(arm.joints), 6)), offsets), anywhere(rng), {"tool": pose((0.05, 0, 0.1))}
    )
    data = true.measure(robot, arm.draw(rng, rows), observes, rng=rng, sigma=1e-4, sigma_angle=2e-4)
    tool = "pose" if observes == "pose" else "position"
    return calib.identify(calib.error_model(robot, offsets=list(offsets), tool=tool), data), arm


@pytest.mark.parametrize(
    ("kind", "observes"), [("residuals", "position"), ("residuals", "pose"), ("poses", "position")]
)
def test_agrees_with_the_covariance(kind: Kind, observes: str) -> None:
    fit, arm = fit_of(60, observes)
    readings = arm.draw(np.random.default_rng(0), 8)
    steps: list[tuple[int, int]] = []
    found = bootstrap(fit, readings, REPETITIONS, kind=kind, progress=lambda done, of: steps.append((done, of)))
    assert (found.failed, len(found.values), steps[-1]) == (0, REPETITIONS, (REPETITIONS, REPETITIONS))
    # Errors that the model leaves out are no scatter of repeated fits.
    expected = machines.scatter_of_positions(fit, readings)
    # A standard deviation from 40 repetitions is itself known to a ninth.
    assert 0.8 < np.mean(found.sigma / expected) < 1.25
    assert 0.75 < np.mean(np.sqrt(np.diag(found.covariance)) / fit.sigmas) < 1.3


def test_photographs_that_err_together_are_drawn_whole() -> None:
    """An arm that comes back to 0.2 mm and 0.5 mrad, corners to 0.05 px: what is told is what repeated fits scatter."""
    rng = np.random.default_rng(5)
    robot, arm = machines.load(cameras.UR5, cameras.TIP), machines.arm(cameras.UR5, cameras.TIP)
    true = cameras.scene(rng, arm, "tip", sigma=0.05)
    readings = true.draw(rng, 40)
    off = np.stack([pose(*rng.normal(size=(2, 3)) * [[2e-4], [5e-4]]) for _ in readings])
    data = true.measure(robot, readings, rng, 0.05, off)
    fit = calib.identify(calib.error_model(robot, offsets=["elbow_joint"], base="fixed", tool="pose"), data)
    (together,) = fit.together
    assert together is not None
    assert (together.length, together.angle) == pytest.approx((2e-4, 5e-4), rel=0.4)
    said = f"came back to {1e3 * together.length:.2g} mm along and {1e3 * together.angle:.2g} mrad about each axis"
    assert said in " ".join(str(fit).split())
    found = bootstrap(fit, readings[:2], 20)
    assert found.failed == 0
    assert 0.75 < np.mean(np.sqrt(np.diag(found.covariance)) / fit.sigmas) < 1.33
    # A photograph that is drawn twice errs twice, each time by itself.
    twice = together.drawn(np.array([0, 1, 0, 1, 20]), np.array([0, 0, 1, 1, 2]))
    assert twice.number.tolist() == [0, 0, 1, 1, 2]
    np.testing.assert_array_equal(twice.share[0], twice.share[1])
    np.testing.assert_array_equal(twice.directions[:2], twice.directions[2:4])


def test_a_seed_is_an_answer_and_another_one_another() -> None:
    fit, arm = fit_of(20)
    readings = arm.draw(np.random.default_rng(0), 2)
    a, b, c = (bootstrap(fit, readings, 3, seed=seed).positions for seed in (0, 0, 1))
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).max() > 1e-6


def test_rows_of_one_pose_stay_together() -> None:
    fit, _ = fit_of(6)
    data = fit.measurements[0].subset([0, 1, 2, 0, 4, 1])
    assert sorted(rows.tolist() for rows in pose_groups(data)) == [[0, 3], [1, 5], [2], [4]]
    named = replace(data, group=("a", "b", "b", "a", "a", "c"))
    # Row 5 is the pose of row 1 again, whatever it is called.
    assert sorted(rows.tolist() for rows in pose_groups(named)) == [[0, 3, 4], [1, 2, 5]]


@pytest.mark.parametrize("beside", [False, True])
def test_a_repetition_that_does_not_place_a_set_up_has_failed(beside: bool) -> None:
    """Its base would stay where the fit has it, as if that were known; lengths beside the positions do not place it."""
    rng = np.random.default_rng(12)
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    true = Machine(arm, anywhere(rng), {"tool": pose((0.05, 0, 0.1))})
    q = arm.draw(rng, 36)
    data = true.measure(robot, q, rng=rng, sigma=1e-4)
    right = np.arange(36) >= 30
    names = ("left", "right")
    sets = [
        replace(
            data,
            setup=right.astype(np.intp),
            setups=names,
            group=tuple("right" if own else str(k) for k, own in enumerate(right)),
        )
    ]
    if beside:
        columns: dict[str, object] = {f"{r.name} [rad]": q[:, k] for k, r in enumerate(robot.readings)}
        columns["length [m]"] = np.linalg.norm(true.see(q)[:, :3, 3] - 2.0, axis=1)
        lengths = calib.read_measurements(columns | {"target": ["anchor"] * 36}, robot, "distance", sigma=1e-4)
        sets.append(replace(lengths, setup=(np.arange(36) % 2).astype(np.intp), setups=names))
    fit = calib.identify(calib.error_model(robot, offsets=["elbow_joint"], tool="position"), sets)
    found = bootstrap(fit, q[:2], 8, seed=1)
    assert 0 < found.failed < 7
    assert len(found.values) == 8 - found.failed


def test_a_tool_of_the_other_end_alone_has_rows_as_well() -> None:
    fit, arm = fit_of(20)
    rng = np.random.default_rng(0)
    true = Machine(arm, anywhere(rng), {"tool": pose((0.05, 0, 0.1))})
    pairs = Lab(true, machines.load(*UR10), rng).pairs(4)
    assert pairs.other is not None
    both = replace(pairs, tools=("tool", "ball"), other=replace(pairs.other, tool=np.ones(4, dtype=np.intp)))
    assert {name for kind, name in _seen(fit, [both]) if kind == "tool"} == {"tool", "ball"}
    assert {name for kind, name in _seen(fit, [pairs]) if kind == "tool"} == {"tool"}


def test_wrong_wishes_are_refused() -> None:
    fit, arm = fit_of(20)
    readings = arm.draw(np.random.default_rng(0), 2)
    with pytest.raises(JobError, match="1 repetitions of kind 'poses'"):
        bootstrap(fit, readings, 1)
    with pytest.raises(JobError, match="100001 repetitions of kind"):
        bootstrap(fit, readings, 100_001)
    with pytest.raises(MeasurementError, match=r"there is no tool 'ball'; the calibrated one is 'tool'\."):
        bootstrap(fit, readings, 2, tool="ball")
    (data,) = fit.measurements
    with pytest.raises(IdentificationError, match="too few to be drawn from"):
        bootstrap(replace(fit, measurements=(data.subset([0]),)), readings, 4)


def test_a_tool_of_another_tip_is_put_where_it_is() -> None:
    rng = np.random.default_rng(6)
    made = trees.tree(rng)
    robot = calib.load_robot(parse_urdf(trees.urdf().encode(), "tree"), trees.TIPS[0], links=[trees.TIPS[1]])
    q = made.draw(rng, 60)
    own = q[:, [made.names.index(reading.name) for reading in robot.readings]]
    sets = [
        calib.positions(robot.with_tip(tip), own, (made.link(tip, q) @ trees.TOOLS[tip])[:, :3, 3], sigma=1e-5)
        for tip in trees.TIPS[:2]
    ]
    sets[1] = sets[1].named(tool="left_hand")
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all"), sets)
    found = calib.judging.bootstrap(fit, own[:5], 2, tool="left_hand")
    seen = sets[1].position
    assert seen is not None
    np.testing.assert_allclose(found.positions[0], seen[:5], atol=1e-4)
