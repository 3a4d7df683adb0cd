"""Commands: the calibrated machine, moved to corrected readings, is where the nominal one would have been."""

import csv
import itertools
import pickle
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib
from calib.compensation import commands, inverse, targets
from calib.foundations.choices import PoseFrame
from calib.foundations.errors import JobError, MeasurementError
from calib.machine import grid
from calib.machine.gaussian import GaussianResiduals, Kernel
from calib.machine.residual_model import FRAMES, Frame
from calib.measurement.table import Columns, table_from_arrays
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.kinematics import Kinematics
from calib.robot.robot import TipModel
from calib.robot.terms import JointTerm
from calib.robot.urdf import parse_urdf
from tests.support import machines
from tests.support.reach import apart, well_posed
from tests.support.sagging import two_arms

Array = NDArray[np.float64]

TOOLS = {"tool": machines.pose((0.03, 0.01, 0.12), (0.2, 0.1, -0.4)), "other": machines.pose((0, 0.05, 0.05))}
IRB = Path(__file__).parents[2] / "robots" / "irb2400"
ARMS: dict[str, tuple[str, str]] = {
    "ur10": ("example:ur_description/urdf/ur10_robot.urdf", "tool0"),
    "panda": ("example:panda_description/urdf/panda.urdf", "panda_link8"),
    **{name: (machines.INLINE[name], "tip") for name in ("mimic", "skew", "negative", "gantry")},
}


def irb2400() -> calib.Robot:
    job = tomllib.loads((IRB / "calibration.toml").read_text(encoding="utf-8"))
    loops = [
        calib.ClosedLoop(loop["name"], tuple(loop["frames"]), tuple(loop["closes"]), tuple(loop["passive"]))
        for loop in job["robot"]["loop"]
    ]
    return calib.load_robot(IRB / "irb2400.urdf", "tool0", loops=loops)


def robot_of(name: str) -> calib.Robot:
    return irb2400() if name == "irb2400" else machines.load(*ARMS[name])


def deviations(robot: calib.Robot, seed: int = 1, size: float = 1.0) -> calib.Deviations:
    rng = np.random.default_rng(seed)
    placements = rng.normal(scale=size * np.repeat((3e-4, 5e-4), 3), size=(len(robot.chain), 6))
    return calib.Deviations(placements, rng.normal(scale=size * 1e-3, size=len(robot.moving)))


def model_of(robot: calib.Robot, seed: int = 1, size: float = 1.0) -> calib.CalibratedMachine:
    base = machines.anywhere(np.random.default_rng(seed))
    return calib.CalibratedMachine(robot, deviations(robot, seed, size), base, TOOLS)


def draw(robot: calib.Robot, n: int, seed: int = 2, share: float = 0.6) -> Array:
    rng = np.random.default_rng(seed)
    columns = []
    for reading in robot.readings:
        low, high = (
            (-2.5 if reading.lower is None else reading.lower),
            (2.5 if reading.upper is None else reading.upper),
        )
        low, high = max(low, -2.5), min(high, 2.5)
        middle, half = (low + high) / 2, share * (high - low) / 2
        columns.append(rng.uniform(middle - half, middle + half, n))
    readings = np.stack(columns, axis=1)
    if "elbow_cancel" in {joint.name for joint in robot.chain}:
        # The parallelogram folds flat where crank and lower arm are in line.
        readings[:, 2] = np.clip(readings[:, 2], readings[:, 1] - 0.9, readings[:, 1] + 0.9)
        readings[:, 2] = np.clip(readings[:, 2], -1.0, 1.0)
    return readings


# ---- the Jacobian


@pytest.mark.parametrize("name", [*ARMS, "irb2400"])
def test_driven_against_differences(name: str) -> None:
    robot = robot_of(name)
    model, readings, h = TipModel(robot, deviations(robot)), draw(robot, 20), 1e-6
    T, J = model.driven(readings)
    # Products of the same placements, from the other end.
    np.testing.assert_allclose(T, model.motion(readings).placement, rtol=0, atol=1e-14)
    assert J.shape == (20, 6, len(robot.readings))
    for j in range(readings.shape[1]):
        step = h * np.eye(readings.shape[1])[j]
        high, low = model.tips(readings + step), model.tips(readings - step)
        v = (np.swapaxes(T[:, :3, :3], 1, 2) @ (high - low)[:, :3, 3, None])[:, :, 0] / (2 * h)
        w = Rotation.from_matrix(np.swapaxes(low[:, :3, :3], 1, 2) @ high[:, :3, :3]).as_rotvec() / (2 * h)
        assert np.abs(J[:, :, j] - np.hstack([v, w])).max() < 5e-9


# ---- joint targets


@pytest.mark.parametrize("name", [*ARMS, "irb2400"])
@pytest.mark.parametrize("tool", ["tool", "other"])
def test_the_machine_goes_where_the_nominal_one_would(name: str, tool: str) -> None:
    model = model_of(robot_of(name))
    robot = model.robot
    readings = well_posed(model, draw(robot, 60))
    found = commands.for_joint_targets(model, readings, tool)
    assert len(readings) > 10
    assert found.reached.all(), found.reasons
    wanted = robot.tips(readings) @ TOOLS[tool]
    before = apart(robot.tips(readings, model.deviations) @ TOOLS[tool], wanted)
    after = apart(robot.tips(found.readings, model.deviations) @ TOOLS[tool], wanted)
    assert before[0] > 1e-3
    assert after[0] < 1e-9
    assert after[1] < 1e-9
    assert found.position_error.max() < 1e-9
    assert found.orientation_error.max() < 1e-9
    assert np.array_equal(found.change, found.readings - readings)
    assert found.steps.max() <= 8


@pytest.mark.parametrize("name", ["ur10", "panda", "mimic", "irb2400"])
def test_no_deviations_change_nothing(name: str) -> None:
    model = model_of(robot_of(name), size=0.0)
    readings = draw(model.robot, 30)
    found = commands.for_joint_targets(model, readings)
    assert found.reached.all()
    assert np.abs(found.readings - readings).max() < 1e-12
    assert np.array_equal(found.steps, np.zeros(30))


@pytest.mark.parametrize("name", ["ur10", "irb2400"])
def test_joint_terms_are_corrected_as_well(name: str) -> None:
    bare = robot_of(name)
    terms = [JointTerm(r.name, kind, k) for r in bare.readings for kind, k in (("gain", 0), ("cos", 2), ("sin", 11))]
    robot = replace(bare, terms=tuple(terms))
    coefficients = np.random.default_rng(3).normal(scale=2e-4, size=len(terms))
    model = replace(model_of(bare), robot=robot, deviations=replace(deviations(robot), terms=coefficients))
    readings = well_posed(model, draw(robot, 40))
    found = commands.for_joint_targets(model, readings)
    assert found.reached.all(), found.reasons
    wanted = bare.tips(readings) @ TOOLS["tool"]
    reached = bare.tips(found.readings + waves(robot, coefficients, found.readings), deviations(bare)) @ TOOLS["tool"]
    assert apart(reached, wanted)[0] < 1e-9
    assert found.steps.max() <= 8


def waves(robot: calib.Robot, coefficients: Array, u: Array) -> Array:
    """What gains, cosines of order 2 and sines of order 11 add to readings."""
    gain, cos, sin = coefficients.reshape(len(robot.readings), 3).T
    return np.asarray(gain * u + cos * np.cos(2.0 * u) + sin * np.sin(11.0 * u))


# ---- targets that are visited in their order

IN_ORDER = Conditions(ordered=True)


def with_gaps(name: str, half: float = 4e-4) -> calib.CalibratedMachine:
    """A machine of whose joints all but the last have a gap; ``half`` of it, in rad."""
    bare = robot_of(name)
    terms = tuple(JointTerm(reading.name, "backlash") for reading in bare.readings[:-1])
    robot = replace(bare, terms=terms)
    sizes = half * np.linspace(1.0, 2.0, len(terms))
    return replace(model_of(bare), robot=robot, deviations=replace(deviations(robot), terms=sizes))


def walked(model: calib.CalibratedMachine, commanded: Array, rows: Array) -> Array:
    """Return where the tip is when a robot is sent to some of the rows, one after the other, joint by joint."""
    side, before, found = np.zeros(commanded.shape[1]), None, np.full((len(commanded), 4, 4), np.nan)
    gaps = np.append(model.deviations.terms, 0.0)
    bare = replace(model.deviations, terms=np.zeros(0))
    for n in rows:
        for k in range(len(side)):
            if before is not None and abs(commanded[n, k] - before[k]) > 1e-9:
                side[k] = 1.0 if commanded[n, k] > before[k] else -1.0
        before = commanded[n]
        found[n] = replace(model.robot, terms=()).tips((commanded[n] + gaps * side)[None], bare)[0]
    return found


@pytest.mark.parametrize("half", [4e-4, -4e-4])
@pytest.mark.parametrize("start", ["joints", "poses from readings", "poses"])
def test_commands_tell_from_which_side_their_order_reaches_them(start: str, half: float) -> None:
    model = with_gaps("ur10", half)
    readings = well_posed(model_of(robot_of("ur10")), draw(model.robot, 40))
    readings[5:9, 1] = readings[4, 1]  # this one rests, or moves by what is corrected alone
    readings[12] = readings[11]
    readings[20:24] = readings[19] + 1e-5 * np.arange(1, 5)[:, None]
    nominal = replace(model.robot, terms=()).tips(readings) @ TOOLS["tool"]
    if start == "joints":
        found = commands.for_joint_targets(model, readings, conditions=IN_ORDER)
    else:
        found = commands.for_poses(model, nominal, readings if "from" in start else None, conditions=IN_ORDER)
    rows = np.flatnonzero(found.reached)
    assert len(rows) == len(readings)
    unsettled = np.array(["cannot be told: corrected for one side, it comes" in text for text in found.reasons])
    there = walked(model, found.readings, rows) @ TOOLS["tool"]
    assert apart(there[~unsettled], nominal[~unsettled])[0] < 1e-8
    missed = np.linalg.norm(there[:, :3, 3] - nominal[:, :3, 3], axis=1)
    assert np.allclose(missed, found.position_error, rtol=0, atol=1e-8)
    # Joints stay behind their readings, as gaps let them: each side is then consistent.
    assert unsettled.any() == (half > 0.0)
    assert found.reasons[0].startswith("from which side 'shoulder_pan_joint', 'shoulder_lift_joint', 'elbow_joint', ")
    assert found.reasons[0].endswith("is reached is not known, as it has not moved before")
    # What the same path would miss if nobody told the sides.
    blind = commands.for_joint_targets(model, readings, conditions=Conditions(approach=np.zeros_like(readings)))
    assert apart(walked(model, blind.readings, rows)[rows] @ TOOLS["tool"], nominal[rows])[0] > 1e-4


def test_a_robot_does_not_go_where_targets_are_not_reached() -> None:
    model = with_gaps("ur10")
    readings = well_posed(model_of(robot_of("ur10")), draw(model.robot, 12))
    poses = replace(model.robot, terms=()).tips(readings) @ TOOLS["tool"]
    far = np.insert(poses, [0, 6], np.array([[1, 0, 0, 9], [0, 1, 0, 9], [0, 0, 1, 9], [0, 0, 0, 1]]), axis=0)
    found = commands.for_poses(model, far, conditions=IN_ORDER)
    assert np.flatnonzero(~found.reached).tolist() == [0, 7]
    alone = commands.for_poses(model, poses, conditions=IN_ORDER)
    assert np.allclose(np.delete(found.readings, [0, 7], axis=0), alone.readings, rtol=0, atol=1e-10)


def test_sides_are_told_once() -> None:
    model = with_gaps("ur10")
    readings = draw(model.robot, 3)
    told = Conditions(approach=np.ones_like(readings), ordered=True)
    with pytest.raises(
        JobError, match=r"^the side of approach is given twice, by 'approach' and as 'ordered'; keep one"
    ):
        commands.for_joint_targets(model, readings, conditions=told)
    with pytest.raises(JobError, match=r"needs 'direction_shoulder_pan_joint' for every target\.$"):
        commands.for_joint_targets(model, readings)
    bare = model_of(robot_of("ur10"))
    pair = [commands.for_joint_targets(bare, readings, conditions=told).readings for told in (IN_ORDER, NO_CONDITIONS)]
    assert np.array_equal(*pair)


def test_tables_of_targets_tell_sides_by_their_order() -> None:
    model = with_gaps("ur10")
    names = [reading.name for reading in model.robot.readings]
    readings = well_posed(model_of(robot_of("ur10")), draw(model.robot, 12))
    columns: dict[str, Any] = {f"{name} [rad]": readings[:, k] for k, name in enumerate(names)}
    table = table_from_arrays(columns)
    with pytest.raises(MeasurementError, match=r"tell it, too: in_order\.$"):
        targets.targets(table, model)
    wanted = targets.targets(table, model, in_order=True)
    found = targets.corrections(model, wanted)
    same = commands.for_joint_targets(model, readings, conditions=IN_ORDER)
    assert np.array_equal(found.readings, same.readings)
    assert targets.idle(model, wanted, frame="base", clamp=False) == ()
    assert targets.idle(model_of(robot_of("ur10")), wanted, frame="base", clamp=False) == (
        "The machine has no joint term that asks for sides of approach: in_order has no effect.",
    )
    sided = table_from_arrays({**columns, "direction": ["+"] * len(readings)})
    with pytest.raises(MeasurementError, match="given twice, by the order of the rows and by direction; keep one"):
        targets.targets(sided, model, in_order=True)


def test_tools_row_by_row() -> None:
    model = model_of(robot_of("ur10"))
    readings = well_posed(model, draw(model.robot, 20))
    names = ["tool", "other"] * (len(readings) // 2)
    readings = readings[: len(names)]
    mixed = commands.for_joint_targets(model, readings, names)
    for k, name in enumerate(("tool", "other")):
        alone = commands.for_joint_targets(model, readings, name)
        assert np.allclose(mixed.readings[k::2], alone.readings[k::2], atol=1e-13, rtol=0)


def test_answers_do_not_depend_on_the_other_rows() -> None:
    model = model_of(robot_of("panda"))
    readings = draw(model.robot, 12)
    together = commands.for_joint_targets(model, readings)
    alone = [commands.for_joint_targets(model, row[None]).readings[0] for row in readings]
    assert np.allclose(together.readings, alone, atol=1e-12, rtol=0, equal_nan=True)


def test_seven_joints_change_least() -> None:
    model = model_of(robot_of("panda"))
    readings = draw(model.robot, 40)
    found = commands.for_joint_targets(model, readings)
    J = TipModel(model.robot, model.deviations).driven(found.readings)[1]
    null = np.linalg.svd(J)[2][:, 6]
    assert found.reached.all()
    # The change has no part along which the arm moves with its tool at rest.
    assert np.abs(np.sum(null * found.change, axis=1)).max() < 1e-8


def test_positions_alone_change_least() -> None:
    model = model_of(robot_of("ur10"))
    readings = draw(model.robot, 40)
    found = commands.for_joint_targets(model, readings, what="position")
    assert found.reached.all()
    assert np.isnan(found.orientation_error).all()
    tips = model.robot.tips(found.readings, model.deviations) @ TOOLS["tool"]
    wanted = model.robot.tips(readings) @ TOOLS["tool"]
    assert np.abs(tips - wanted)[:, :3, 3].max() < 1e-9
    J = TipModel(model.robot, model.deviations).driven(found.readings)[1]
    lever = J[:, :3] + np.cross(J[:, 3:], np.broadcast_to(TOOLS["tool"][:3, 3, None], (40, 3, 6)), axis=1)
    share = np.swapaxes(lever, 1, 2) @ np.linalg.solve(lever @ np.swapaxes(lever, 1, 2), lever)
    assert np.abs(found.change - (share @ found.change[:, :, None])[:, :, 0]).max() < 1e-8
    pose = commands.for_joint_targets(model, readings)
    both = pose.reached
    assert (np.linalg.norm(found.change, axis=1) <= np.linalg.norm(pose.change, axis=1) + 1e-9)[both].all()


def test_positions_end_nearest_to_a_start_that_is_far_away() -> None:
    model = model_of(robot_of("ur10"))
    readings = draw(model.robot, 60)
    positions = (model.robot.tips(readings, model.deviations) @ TOOLS["tool"])[:, :3, 3]
    start = np.tile([0.5, -1.0, 1.2, -0.4, 0.6, 0.3], (60, 1))
    found = commands.for_poses(model, positions, start)
    assert found.reached.all()
    J = TipModel(model.robot, model.deviations).driven(found.readings)[1]
    lever = J[:, :3] + np.cross(J[:, 3:], np.broadcast_to(TOOLS["tool"][:3, 3, None], (60, 3, 6)), axis=1)
    share = np.swapaxes(lever, 1, 2) @ np.linalg.solve(lever @ np.swapaxes(lever, 1, 2), lever)
    left = np.abs(found.change - (share @ found.change[:, :, None])[:, :, 0]).max(axis=1)
    # Nothing along which the tool stands still is left of the change. Where it is, the limits or a singularity ask it.
    assert np.mean(left < 1e-8) > 0.9
    assert np.median(found.steps) < 20


@pytest.mark.parametrize("limit", [None, 2.0])
@pytest.mark.parametrize("case", ["ur10", "panda", "irb2400", "torques", "residuals"])
def test_positions_without_a_start_are_those_of_plain_linear_algebra(
    case: str, limit: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = robot_of(case if case in {*ARMS, "irb2400"} else "ur10")
    conditions, n = NO_CONDITIONS, 24
    if limit is not None:
        robot = replace(robot, readings=tuple(replace(r, lower=-limit, upper=limit) for r in robot.readings))
    model = model_of(robot)
    if case == "torques":
        giving = replace(robot, terms=tuple(JointTerm(r.name, "torque") for r in robot.readings))
        model = replace(model, robot=giving, deviations=replace(deviations(giving), terms=np.full(6, 2e-5)))
        conditions = Conditions(torque=np.random.default_rng(8).normal(0.0, 50.0, (n, 6)))
    if case == "residuals":
        model = replace(model, residual_model=residual_grid(robot, "tip"))
    positions = (robot.tips(draw(robot, n, share=0.8), deviations(robot)) @ TOOLS["tool"])[:, :3, 3]
    clamp = case == "residuals"
    found = commands.for_poses(model, positions, conditions=conditions, clamp=clamp)
    assert found.reached.all(), found.reasons
    tips = TipModel(model.robot, model.deviations).tips(found.readings, conditions)
    there = (tips @ TOOLS["tool"])[:, :3, 3]
    if model.residual_model is not None:
        there += np.einsum("nij,nj->ni", tips[:, :3, :3], model.residual_model.at(found.readings, clamp=True))
    assert np.abs(there - positions).max() < 1e-6
    low, high = inverse.limits(robot.readings)
    assert ((found.readings >= low - 1e-9) & (found.readings <= high + 1e-9)).all()

    def by_twists(own: Kinematics, q: Array) -> tuple[Array, Array]:
        tip = own.regressors(q)[0]
        return tip.placement, tip.by_position(tip.through(*tip.local), own._tree.types).transpose(2, 1, 0)

    monkeypatch.setattr(Kinematics, "jacobian", by_twists)
    monkeypatch.setattr(
        inverse, "_by_normal_equations", lambda J: (np.empty((len(J), *J.shape[:0:-1])), np.zeros(len(J), dtype=bool))
    )
    plain = commands.for_poses(model, positions, conditions=conditions, clamp=clamp)
    assert np.array_equal(plain.reached, found.reached)
    assert np.abs(plain.readings - found.readings).max() < 1e-8


@pytest.mark.parametrize(("m", "columns"), [(3, 6), (6, 6), (6, 7), (6, 3), (3, 1)])
def test_inverses_of_slopes_are_those_of_numpy(m: int, columns: int) -> None:
    J = np.random.default_rng(m + columns).normal(size=(9, m, columns))
    J[3], J[4, -1], J[5, -1] = 0.0, J[4, 0], J[5, 0] * (1.0 + 1e-7)
    expected = [np.linalg.pinv(one, rcond=1e-12) for one in J]
    found = inverse._inverse(J, np.zeros(9))
    size = np.linalg.norm(expected, axis=(1, 2))[:, None, None] + 1.0
    assert np.abs((found - expected) / size).max() < 1e-9
    damped, largest = inverse._inverse(J[:3], np.full(3, 1e-3)), np.linalg.svd(J[:3], compute_uv=False)[:, 0]
    for one, own, s in zip(damped, J[:3], largest, strict=True):
        assert np.abs(one - own.T @ np.linalg.inv(own @ own.T + 1e-3 * s**2 * np.eye(m))).max() < 1e-9


# ---- refusals


def test_a_search_that_takes_too_long_is_cut_short_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    model = model_of(robot_of("ur10"))
    poses = model.robot.tips(well_posed(model, draw(model.robot, 40))[:20], model.deviations) @ TOOLS["tool"]
    whole = commands.for_poses(model, poses)
    assert whole.reached.all()
    monkeypatch.setattr(inverse, "_LOOKS", 0)
    monkeypatch.setattr(inverse, "_LOOKS_PER_ROW", 12)
    found = commands.for_poses(model, poses)
    assert 0 < found.reached.sum() < 20
    assert found.steps.sum() < 20 * 14
    for reached, reason in zip(found.reached, found.reasons, strict=True):
        assert reached or reason.endswith("give readings to start from, or fewer targets")
    T = model.robot.tips(found.readings[found.reached], model.deviations) @ TOOLS["tool"]
    assert max(apart(T, poses[found.reached])) < 1e-6


def test_where_most_targets_are_not_reached_the_search_ends_sooner(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within their links' length, and too low for their orientation; as many that are reached are searched for on."""
    model = model_of(robot_of("ur10"))
    poses = model.robot.tips(well_posed(model, draw(model.robot, 40))[:30], model.deviations) @ TOOLS["tool"]
    beyond = poses.copy()
    beyond[:, :3, 3] *= 1.3 / np.linalg.norm(beyond[:, :3, 3], axis=1)[:, None]
    looks: list[int] = []
    spend = inverse.Effort.spend
    monkeypatch.setattr(inverse.Effort, "spend", lambda effort, n: (looks.append(n), spend(effort, n))[1])
    monkeypatch.setattr(inverse, "_BLOCK", 10)
    monkeypatch.setattr(inverse, "_LOOKS_OF_HOPELESS", 100)
    assert commands.for_poses(model, poses).reached.all()
    looks.clear()
    found = commands.for_poses(model, beyond)
    assert sum(looks) < 1000
    for reached, reason in zip(found.reached, found.reasons, strict=True):
        assert reached or reason.endswith("give readings to start from, or fewer targets")


def test_targets_that_come_later_keep_their_share_of_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    model = model_of(robot_of("ur10"))
    readings = well_posed(model, draw(model.robot, 40))[:20]
    poses = model.robot.tips(readings, model.deviations) @ TOOLS["tool"]
    poses[:10, :3, 3] *= 1.2 / np.linalg.norm(poses[:10, :3, 3], axis=1)[:, None]
    monkeypatch.setattr(inverse, "_LOOKS", 0)
    monkeypatch.setattr(inverse, "_BLOCK", 10)
    found = commands.for_poses(model, poses, readings + 0.02)
    assert found.reached[10:].all()


def test_where_a_look_costs_more_fewer_are_spent_and_readings_to_start_from_are_never_short_of_them() -> None:
    def left(effort: inverse.Effort) -> int:
        for n in itertools.count():
            if effort.spent:
                return 1000 * n
            effort.spend(1000)
        raise AssertionError

    def hopeless(price: float) -> int:
        effort = inverse.Effort(1_000_000, price)
        effort.told(tried=100, reached=49)
        return left(effort)

    assert (hopeless(1.0), hopeless(7.0)) == (801_000, 115_000)
    assert left(inverse.Effort(1000)) == 524_000
    assert left(inverse.Effort(1_000_000)) == 24_500_000
    assert left(inverse.Effort(1000, 6.0)) == 417_000, "a small table hardly notices"
    assert left(inverse.Effort(80_000, 6.0)) == 417_000, "what they cost is bounded"
    assert left(inverse.Effort(80_000, 6.0, to_start=True)) == 960_000, "a dozen each"
    short = inverse.Effort(80_000, 6.0)
    short.reserve(79_000)
    assert left(short) == 417_000, "what does not suffice for all is for the first"
    enough = inverse.Effort(80_000, 6.0, to_start=True)
    enough.reserve(79_000)
    assert left(enough) == 12_000


def test_looks_cost_more_with_loops_and_with_the_rows_of_a_gaussian_process() -> None:
    arm = model_of(robot_of("ur10"))
    loop = model_of(irb2400())
    assert inverse.price(arm, None) == 1.0
    assert inverse.price(loop, None) == 7.0
    rows = np.zeros((1300, 6))
    kernel = Kernel(1e-4, np.ones(6), 1e-5)
    names = tuple((reading.name, reading.dimension) for reading in arm.robot.readings)
    none = np.zeros((0, 0))
    process = GaussianResiduals(names, tuple(range(6)), rows, rows[:, :3], "base", kernel, none, none)
    assert inverse.price(arm, process) == 11.0


def test_looks_cost_more_with_terms_and_with_readings() -> None:
    """What a look took was measured: each of these within two thirds and twice of it."""
    model = model_of(robot_of("ur10"))
    names = [reading.name for reading in model.robot.readings]

    def of(*terms: JointTerm) -> float:
        own = replace(model.deviations, terms=np.zeros(len(terms)))
        return inverse.price(replace(model, robot=replace(model.robot, terms=terms), deviations=own), None)

    assert of(*(JointTerm(names[1], "cos", k + 1) for k in range(600))) == 11.0
    assert of(*(JointTerm(name, "elastic") for name in names)) == pytest.approx(2.1)
    assert 5.0 < of(*(JointTerm(name, "bending") for name in names[1:])) < 8.0


def test_targets_for_which_nothing_is_left_are_not_looked_for() -> None:
    """The first ones are reached, and the others say why not: each would else be looked at a few times."""
    model = model_of(robot_of("ur10"))
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (600, 6))
    poses, conditions = model.tips(q) @ model.tools["tool"], Conditions()
    how = inverse.How("position", None, False, (1e-6, 1e-6), 1.0)
    asked = inverse.Asked(poses, np.broadcast_to(model.tools["tool"], (600, 4, 4)), q + 0.01, ("",) * 600, conditions)
    looked: list[int] = []

    class Few(inverse.Effort):
        def spend(self, looks: int) -> None:
            looked.append(looks)
            super().spend(looks)

    found = inverse.solve(model, asked, how, Few(600, 2000.0))
    assert sum(looked) < 2000
    assert found.reached[:64].all() and not found.reached[-64:].any()
    assert found.reasons[-1].startswith("was not looked for; the search was cut short")
    assert np.isnan(found.position_error[-1])


def test_limits() -> None:
    robot = machines.load(machines.INLINE["negative"], "tip")
    offsets = np.zeros(6)
    offsets[1] = 0.01
    deviated = calib.Deviations(np.zeros((len(robot.chain), 6)), offsets)
    model = calib.CalibratedMachine(robot, deviated, np.eye(4), TOOLS)
    inside = np.array([0.3, 0.2, 0.4, 0.1, 0.7, 0.2])
    low, past = inside.copy(), inside.copy()
    low[1], past[1] = -2.595, 2.9
    found = commands.for_joint_targets(model, np.stack([inside, low, past]))
    assert found.reached.tolist() == [True, False, False]
    assert np.abs(found.change[0] + offsets).max() < 1e-9
    assert found.reasons[0] == ""
    assert found.reasons[1] == ("the corrected j2 at -149.2555 deg is beyond its limits, -148.969 deg and 160.4282 deg")
    assert found.reasons[2].startswith("j2 at 166.1578 deg is beyond its limits")
    assert np.isnan(found.readings[1:]).all()
    assert 1e-3 < found.position_error[1] < 0.02


def test_a_redundant_arm_keeps_its_limits() -> None:
    model = model_of(robot_of("panda"))
    readings = draw(model.robot, 30)
    low, high = (np.array([getattr(r, side) for r in model.robot.readings]) for side in ("lower", "upper"))
    free = commands.for_joint_targets(model, readings)
    # One joint stands at the limit that the least change would pass; six others can do without it.
    joint = 2
    readings[:, joint] = np.where(free.change[:, joint] < 0.0, low[joint], high[joint])
    found = commands.for_joint_targets(model, readings)
    assert found.reached.mean() > 0.8
    reached = found.readings[found.reached]
    assert ((reached >= low - 1e-9) & (reached <= high + 1e-9)).all()
    assert (np.abs(found.change[found.reached][:, joint]) < 1e-9).any()
    wanted = model.robot.tips(readings[found.reached]) @ TOOLS["tool"]
    assert max(apart(model.robot.tips(reached, model.deviations) @ TOOLS["tool"], wanted)) < 1e-9
    for text in np.array(found.reasons)[~found.reached]:
        assert "beyond its limits" in text


def test_what_is_not_reached_is_never_said_to_be_farther_than_where_the_search_began() -> None:
    robot = robot_of("ur10")
    low, high = (np.array([getattr(r, side) for r in robot.readings]) for side in ("lower", "upper"))
    # The arm is stretched, all readings near their limits: the search passes some of these by half a radian.
    readings = np.stack([high - 1e-4, low + 1e-5, high - 0.05])
    for seed in range(4):
        model = model_of(robot, seed, size=3.0)
        found = commands.for_joint_targets(model, readings)
        wanted = robot.tips(readings) @ TOOLS["tool"]
        at_start = model.robot.tips(readings, model.deviations) @ TOOLS["tool"]
        assert not found.reached.all()
        for n in np.flatnonzero(~found.reached):
            began = np.hypot(*apart(at_start[n : n + 1], wanted[n : n + 1]))  # 1 mm counts as 1 mrad
            assert np.hypot(found.position_error[n], found.orientation_error[n]) <= began + 1e-12


def test_far_away_and_singular() -> None:
    model = model_of(robot_of("ur10"))
    readings = well_posed(model, draw(model.robot, 9))[:3]
    poses = model.robot.tips(readings, model.deviations) @ TOOLS["tool"]
    poses[1, :3, 3] = 5.0, 0.0, 0.0
    found = commands.for_poses(model, poses, readings + 0.05)
    assert found.reached.tolist() == [True, False, True]
    assert found.reasons[1].startswith("no solution found: the nearest found is ")
    assert found.position_error[1] > 3.0
    stretched = np.zeros((1, 6))
    pushed = model.robot.tips(stretched, model.deviations) @ TOOLS["tool"]
    pushed[:, 0, 3] += np.sign(pushed[0, 0, 3]) * 0.05
    lost = commands.for_poses(model, pushed, stretched)
    assert not lost.reached[0]
    assert lost.reasons[0].endswith(" away, where the arm is singular")


def test_a_loop_that_cannot_close_spoils_its_row_alone() -> None:
    model = model_of(robot_of("irb2400"))
    readings = well_posed(model, draw(model.robot, 20))
    flat = readings.copy()
    flat[3, 1], flat[3, 2] = -0.9, -0.9 + np.pi / 2
    found = commands.for_joint_targets(model, flat)
    alone = commands.for_joint_targets(model, readings)
    others = np.arange(len(readings)) != 3
    assert found.reached[others].all()
    assert not found.reached[3]
    assert "parallelogram" in found.reasons[3]
    assert np.allclose(found.readings[others], alone.readings[others], atol=1e-12, rtol=0)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda m: commands.for_joint_targets(m, np.zeros((2, 5))), "shape (2, 5)"),
        (lambda m: commands.for_joint_targets(m, np.full((1, 6), np.nan)), "finite"),
        (lambda m: commands.for_joint_targets(m, np.zeros((1, 6)), "no"), "there is no tool 'no'"),
        (lambda m: commands.for_joint_targets(m, np.zeros((1, 6)), ["tool", "tool"]), "2 tools are named for 1"),
        (
            lambda m: commands.for_joint_targets(m, np.zeros((1, 6)), what=cast(Any, "turn")),
            "what shall be reached is 'turn'",
        ),
        (lambda m: commands.for_joint_targets(m, np.zeros((1, 6)), tolerance=(0.0, 1e-6)), "the tolerances are"),
        (lambda m: commands.for_poses(m, np.zeros((1, 7))), "shape (1, 7)"),
        (lambda m: commands.for_poses(m, np.full((1, 3), np.inf)), "finite"),
        (lambda m: commands.for_poses(m, np.full((1, 3), 1e200)), "is 1e+200 m; allowed is -10000 to 10000 m"),
        (lambda m: commands.for_poses(m, 2.0 * np.eye(4)[None]), "not all placements"),
        (
            lambda m: commands.for_poses(m, np.eye(4)[None], frame=cast(Any, "world")),
            "the frame of the poses is 'world'",
        ),
        (lambda m: commands.for_poses(m, np.eye(4)[None], np.zeros((2, 6))), "2 rows of readings"),
    ],
)
def test_options_that_cannot_be_used(call: Any, said: str) -> None:
    with pytest.raises(JobError) as caught:
        call(model_of(robot_of("ur10")))
    assert said in str(caught.value)
    assert str(caught.value).endswith(".")


def test_no_rows() -> None:
    model = model_of(robot_of("ur10"))
    for found in (commands.for_joint_targets(model, np.zeros((0, 6))), commands.for_poses(model, np.zeros((0, 3)))):
        assert len(found) == 0
        assert found.readings.shape == (0, 6)


# ---- poses


@pytest.mark.parametrize("frame", ["base", "instrument"])
@pytest.mark.parametrize("name", ["ur10", "irb2400"])
def test_poses(name: str, frame: PoseFrame) -> None:
    model = model_of(robot_of(name))
    readings = well_posed(model, draw(model.robot, 30))
    poses = model.predict(readings)
    wanted = poses if frame == "instrument" else np.linalg.inv(model.base) @ poses
    start = readings + np.random.default_rng(5).uniform(-0.02, 0.02, readings.shape)
    found = commands.for_poses(model, wanted, start, frame=frame)
    assert found.reached.all(), found.reasons
    assert max(apart(model.predict(found.readings), poses)) < 1e-8
    assert np.abs(found.readings - readings).max() < 1e-6


def test_without_a_start() -> None:
    model = model_of(robot_of("ur10"))
    poses = model.robot.tips(draw(model.robot, 40), model.deviations) @ TOOLS["tool"]
    found = commands.for_poses(model, poses)
    assert found.reached.mean() > 0.9
    some = found.reached
    assert max(apart(model.robot.tips(found.readings[some], model.deviations) @ TOOLS["tool"], poses[some])) < 1e-6
    again = commands.for_poses(model, poses)
    assert np.array_equal(found.readings, again.readings, equal_nan=True)
    points = commands.for_poses(model, poses[:, :3, 3])
    assert points.reached.all()


# ---- residuals


def test_a_grid_holds_in_every_turn_of_a_joint_within_its_limits() -> None:
    model = model_of(robot_of("ur10"))
    model = replace(model, residual_model=residual_grid(model.robot, "base"))
    readings = draw(model.robot, 6, share=0.3)
    readings = readings[[not said for said in model.residual_model.outside(readings)]]
    other = readings - 2.0 * np.pi * np.sign(readings) * (np.arange(6) == 0)
    low, high = inverse.limits(model.robot.readings)
    assert len(readings) and ((low < other) & (other < high)).all()
    one, turned = (commands.for_joint_targets(model, some) for some in (readings, other))
    assert one.reached.all() and turned.reached.all()
    assert np.abs(turned.change - one.change).max() < 1e-9
    assert np.abs(model.tips(turned.readings) - model.tips(one.readings)).max() < 1e-9


def residual_grid(robot: calib.Robot, frame: Frame) -> grid.SectorGrid:
    axes = [np.linspace(-1.0, 1.0, 5), np.linspace(-1.2, 0.8, 4)]
    rows = np.zeros((20, len(robot.readings)))
    rows[:, :2] = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    errors = 2e-4 * np.stack([np.sin(rows[:, 0]), np.cos(rows[:, 1]), rows[:, 0] * rows[:, 1]], axis=1)
    names = [reading.name for reading in robot.readings[:2]]
    return grid.grid_from_residuals(rows, errors, robot.readings, names, frame)


@pytest.mark.parametrize("frame", FRAMES)
def test_residuals_are_counted(frame: Frame) -> None:
    model = model_of(robot_of("ur10"))
    rng = np.random.default_rng(9)
    readings = well_posed(model, rng.uniform((-0.9, -1.1, 0.5, -1, 0.5, -1), (0.9, 0.7, 1.5, 1, 1.5, 1), (50, 6)))
    known = residual_grid(model.robot, frame)
    found = commands.for_joint_targets(replace(model, residual_model=known), readings)
    assert found.reached.all(), found.reasons
    tip = model.robot.tips(found.readings, model.deviations)
    error = known.at(found.readings)
    error = error if frame == "base" else np.einsum("nij,nj->ni", tip[:, :3, :3], error)
    wanted = model.robot.tips(readings) @ TOOLS["tool"]
    there = tip @ TOOLS["tool"]
    assert np.abs(there[:, :3, 3] + error - wanted[:, :3, 3]).max() < 2e-9
    assert np.abs(error).max() > 1e-4


def test_outside_the_residuals() -> None:
    model = model_of(robot_of("ur10"))
    model = replace(model, residual_model=residual_grid(model.robot, "base"))
    readings = np.array([[0.5, 0.3, 0.9, 0.5, 0.8, 0.1], [1.2, 0.3, 0.9, 0.5, 0.8, 0.1]])
    refused = commands.for_joint_targets(model, readings)
    assert refused.reached.tolist() == [True, False]
    assert " is outside the grid, from -57.2958 deg to 57.2958 deg" in refused.reasons[1]
    clamped = commands.for_joint_targets(model, readings, clamp=True)
    assert clamped.reached.all()
    assert clamped.reasons[0] == ""
    assert clamped.reasons[1].endswith("; the nearest known errors are taken")


def test_what_a_residual_model_does_not_know_is_asked_of_all_rows_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A row at a time took a Gaussian process of many rows minutes: each goes through a matrix of all of them."""
    model = model_of(robot_of("ur10"))
    model = replace(model, residual_model=residual_grid(model.robot, "base"))
    asked: list[int] = []
    outside = grid.SectorGrid.outside

    def counted(known: grid.SectorGrid, readings: Array) -> tuple[str, ...]:
        asked.append(len(readings))
        return outside(known, readings)

    monkeypatch.setattr(grid.SectorGrid, "outside", counted)
    readings = np.tile([0.5, 0.3, 0.9, 0.5, 0.8, 0.1], (7, 1))
    assert commands.for_joint_targets(model, readings).reached.all()
    assert asked == [7]


# ---- tables


def panel(model: calib.CalibratedMachine, readings: Array, **more: Any) -> dict[str, Any]:
    return {f"{r.name} [deg]": np.degrees(readings[:, k]) for k, r in enumerate(model.robot.readings)} | more


def test_joint_targets_of_a_table() -> None:
    model = model_of(robot_of("ur10"))
    readings = draw(model.robot, 5)
    readings[4] = 7.0
    wanted = targets.targets(table_from_arrays(panel(model, readings, tool=["tool", "other"] * 2 + ["tool"])), model)
    found = targets.corrections(model, wanted)
    lines = list(csv.reader(targets.corrected_csv(model, wanted, found).splitlines()))
    names = [f"{r.name} [deg]" for r in model.robot.readings]
    assert lines[0] == [*names, "tool", "remaining_error [mm]", "remaining_turn [mrad]", "reached", "reason"]
    assert [line[9] for line in lines[1:]] == ["yes"] * 4 + ["no"]
    with pytest.raises(calib.CalibError, match=r"are \(2, 6\) readings; of .* and this arm: \(5, 6\)\."):
        targets.corrected_csv(model, wanted, commands.for_joint_targets(model, readings[:2]))
    with pytest.raises(calib.CalibError, match="what: 'poses' is not one of pose, position"):
        targets.corrections(model, wanted, what="poses")  # type: ignore[arg-type]
    assert (
        np.abs(np.radians(np.array([line[:6] for line in lines[1:5]], dtype=float)) - found.readings[:4]).max() < 1e-10
    )
    assert lines[5][:6] == [""] * 6
    assert "beyond its limits" in lines[5][10]
    assert lines[1][7] == "0.000000"


def test_poses_of_a_table() -> None:
    model = model_of(robot_of("ur10"))
    readings = well_posed(model, draw(model.robot, 8))
    poses = model.predict(readings)
    xyz = {f"{axis} [mm]": 1e3 * poses[:, k, 3] for k, axis in enumerate("xyz")}
    x, y, z, w = Rotation.from_matrix(poses[:, :3, :3]).as_quat().T
    columns = panel(model, readings + 0.01, **xyz, qw=w, qx=x, qy=y, qz=z)
    wanted = targets.targets(table_from_arrays(columns), model)
    found = targets.corrections(model, wanted, frame="instrument")
    assert found.reached.all(), found.reasons
    assert np.abs(found.readings - readings).max() < 1e-6
    lines = targets.corrected_csv(model, wanted, found).splitlines()
    assert lines[0].startswith("shoulder_pan_joint [deg],")
    assert ",z [mm],qw,qx,qy,qz,remaining_error [mm],remaining_turn [mrad],reached,reason" in lines[0]


def test_positions_of_a_table_without_joints(tmp_path: Path) -> None:
    model = model_of(robot_of("ur10"))
    path = tmp_path / "targets.csv"
    path.write_text("target,x [mm],y [inch],z [m]\na,600,10,0.4\nb,9000,0,0\n", encoding="utf-8")
    wanted = targets.read_targets(path, model)
    found = targets.corrections(model, wanted)
    lines = targets.corrected_csv(model, wanted, found).splitlines()
    assert lines[0].endswith("wrist_3_joint [deg],target,x [mm],y [inch],z [m],remaining_error [mm],reached,reason")
    assert ",a,600,10,0.4,0.000000,yes," in lines[1]
    assert ",b,9000,0,0,7" in lines[2]
    there = (model.robot.tips(found.readings[:1], model.deviations) @ TOOLS["tool"])[0, :3, 3]
    assert np.abs(there - (0.6, 0.254, 0.4)).max() < 1e-6


def of_scipy(angles: Array, orientation: str) -> Array:
    """Rotations (N, 3, 3) of three angles in deg."""
    if orientation == "rotation_vector":
        return Rotation.from_rotvec(np.radians(angles)).as_matrix()
    return Rotation.from_euler(
        {"abc": "ZYX", "wpr": "xyz", "rpy": "xyz"}.get(orientation, orientation), angles, True
    ).as_matrix()


@pytest.mark.parametrize("orientation", ["rotation_vector", "abc", "wpr", "rpy", "ZYX", "xyz", "XYZ", "zyz"])
def test_poses_with_three_angles_come_out_as_they_were_given(orientation: str, tmp_path: Path) -> None:
    """A controller's titles, units and angles; where two axes fall together as well, and angles beyond half a turn."""
    model, rng = model_of(robot_of("ur10")), np.random.default_rng(4)
    readings = well_posed(model, draw(model.robot, 20))[:6]
    xyz = 1e3 * (model.robot.tips(readings) @ TOOLS["tool"])[:, :3, 3]
    angles = rng.uniform(-170.0, 170.0, (6, 3))
    angles[:3] = [[30.0, 90.0, 20.0], [-100.0, 0.0, 40.0], [200.0, -90.0, -350.0]]
    given = np.round(np.hstack([xyz, angles]), 6)
    rows = [f"P{k};{';'.join(f'{v:.6f}' for v in row)};7".replace(".", ",") for k, row in enumerate(given)]
    path = tmp_path / "targets.csv"
    path.write_text("\n".join(["Name;X;Y;Z;A (deg);B (deg);C (deg);speed", *rows]) + "\n", encoding="utf-8")
    names = {"group": "Name", **{f"{axis} [mm]": axis.upper() for axis in "xyz"}, "rx": "A", "ry": "B", "rz": "C (deg)"}
    columns = Columns(names, ("speed",), orientation)
    wanted = targets.read_targets(path, model, columns=columns)
    assert wanted.poses is not None
    np.testing.assert_allclose(wanted.poses[:, :3, :3], of_scipy(given[:, 3:], orientation), rtol=0, atol=1e-12)
    np.testing.assert_allclose(1e3 * wanted.poses[:, :3, 3], given[:, :3], rtol=0, atol=1e-9)

    found = targets.corrections(model, wanted)
    corrected = targets.corrected_csv(model, pickle.loads(pickle.dumps(wanted)), found)
    lines = list(csv.reader(corrected.splitlines()))
    assert lines[0][6:14] == ["Name", "X", "Y", "Z", "A (deg)", "B (deg)", "C (deg)", "remaining_error [mm]"]
    assert [line[6] for line in lines[1:]] == [f"P{k}" for k in range(6)]
    assert [[float(cell) for cell in line[7:13]] for line in lines[1:]] == given.tolist()
    there = model.robot.tips(found.readings[found.reached], model.deviations) @ TOOLS["tool"]
    assert np.abs(there[:, :3, :3] - of_scipy(given[found.reached, 3:], orientation)).max() < 1e-6

    # What comes out is read as what came in.
    (tmp_path / "corrected.csv").write_text(corrected, encoding="utf-8")
    left = ("remaining_error", "remaining_turn", "reached", "reason", *(r.name for r in model.robot.readings))
    again = targets.read_targets(tmp_path / "corrected.csv", model, columns=replace(columns, ignore=left))
    assert again.poses is not None
    np.testing.assert_allclose(again.poses, wanted.poses, rtol=0, atol=1e-12)


def test_joints_by_other_titles_are_corrected_in_their_columns(tmp_path: Path) -> None:
    model = model_of(robot_of("ur10"))
    readings = draw(model.robot, 3)
    path = tmp_path / "targets.csv"
    rows = [",".join(f"{v:.9f}" for v in row) for row in np.degrees(readings)]
    path.write_text("\n".join(["A1,A2,A3,A4,A5,A6", *rows]) + "\n", encoding="utf-8")
    names = {f"{reading.name} [deg]": f"A{k + 1}" for k, reading in enumerate(model.robot.readings)}
    wanted = targets.read_targets(path, model, columns=names)
    found = targets.corrections(model, wanted)
    lines = list(csv.reader(targets.corrected_csv(model, wanted, found).splitlines()))
    assert lines[0][:7] == ["A1", "A2", "A3", "A4", "A5", "A6", "remaining_error [mm]"]
    sent = np.array([line[:6] for line in lines[1:]], dtype=float)
    assert np.abs(np.radians(sent) - found.readings).max() < 1e-10
    assert np.abs(sent - np.degrees(readings)).max() > 1e-2


def test_a_matrix_and_units_below_titles_come_out_as_they_were_given(tmp_path: Path) -> None:
    model = model_of(robot_of("ur10"))
    T = model.predict(well_posed(model, draw(model.robot, 1)))[0]
    path = tmp_path / "targets.csv"
    cells = [*(f"{v:.9f}" for v in T[:3, :3].ravel()), *(f"{v:.6f}" for v in 1e3 * T[:3, 3])]
    path.write_text(
        ",".join(f"r{i}{j}" for i in "123" for j in "123") + f",X,Y,Z\n{',' * 9}mm,mm,mm\n{','.join(cells)}\n"
    )
    columns = Columns({"x": "X", "y": "Y", "z": "Z"}, orientation="matrix")
    wanted = targets.read_targets(path, model, columns=columns)
    assert wanted.poses is not None
    np.testing.assert_allclose(wanted.poses[0], T, rtol=0, atol=1e-8)
    head, line = targets.corrected_csv(
        model, wanted, targets.corrections(model, wanted, frame="instrument")
    ).splitlines()
    assert ",r11,r12,r13,r21,r22,r23,r31,r32,r33,X [mm],Y [mm],Z [mm],remaining_error" in head
    assert [float(cell) for cell in line.split(",")[6:18]] == [float(cell) for cell in cells]


@pytest.mark.parametrize(
    ("title", "columns", "said"),
    [
        ("rx", {}, "column 'rx' is of an orientation, and nothing says of which kind; orientation does "
                   "(rotation_vector, abc, wpr, rpy, or an order like ZYX or xyz)."),
        ("A", {}, "column 'A' is not one of targets; allowed are joints, or x, y, z, with qw, qx, qy, qz of a pose, or "
                  "its three angles rx, ry, rz with orientation, and what joint terms need; columns, or --column "
                  "'NAME=A', reads it as the one that it is, and ignore passes it over."),
        ("A", {"orientation": "abc"}, "orientation is 'abc', and there is no column 'rx'; a column with another title "
                                      "is read as one by columns, or --column 'rx=TITLE'."),
        *(
            ("rx", {"orientation": order}, f"orientation {order!r} is not known; allowed are rotation_vector, matrix, ")
            for order in ("kuka", "ZZX", "zyX", "ZY", "")
        ),
        ("rx", {"names": {"qw": "ry"}}, "qz of a pose, and what joint terms need; columns, or --column 'NAME=rx', "),
        ("A", {"names": {"rx": "D"}}, "there is no column 'D' to read as 'rx'."),
        ("rx", {"ignore": ("speed",), "orientation": "rpy"}, "there is no column 'speed' to ignore."),
    ],
)  # fmt: skip
def test_angles_that_nothing_explains_are_refused(
    title: str, columns: dict[str, Any], said: str, tmp_path: Path
) -> None:
    path = tmp_path / "targets.csv"
    path.write_text(f"x [mm],y [mm],z [mm],{title} [deg],ry [deg],rz [deg]\n600,100,400,1,2,3\n", encoding="utf-8")
    with pytest.raises(MeasurementError) as e:
        targets.read_targets(path, model_of(robot_of("ur10")), columns=Columns(**columns))
    assert said in str(e.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"shoulder_pan_joint [deg]": None}, "there is no column 'shoulder_pan_joint' of the targets"),
        (
            {"shoulder_pan_joint [deg]": None, "shoulder_pan_join [deg]": [0.0]},
            "column 'shoulder_pan_join' is not one of targets; near is",
        ),
        ({"x [mm]": [0.0]}, "there is no column 'y', 'z' of the targets"),
        ({"x [deg]": [0.0], "y [mm]": [0.0], "z [mm]": [0.0]}, "column 'x': unit 'deg' is not a unit of length"),
        ({"tool": ["left"]}, "there is no tool 'left'; the calibrated ones are 'tool', 'other'"),
        (
            {"x [m]": [0.0], "y [m]": [0.0], "z [m]": [0.0], "qw": [2.0], "qx": [0.0], "qy": [0.0], "qz": [0.0]},
            "the quaternion has the norm 2",
        ),
    ],
)
def test_tables_that_cannot_be_used(change: dict[str, Any], said: str) -> None:
    model = model_of(robot_of("ur10"))
    columns = panel(model, np.zeros((1, 6))) | change
    with pytest.raises(MeasurementError) as caught:
        targets.targets(table_from_arrays({k: v for k, v in columns.items() if v is not None}), model)
    assert said in str(caught.value)


def test_a_tool_that_no_column_names_is_asked_for() -> None:
    model = model_of(robot_of("ur10"))
    table = table_from_arrays(panel(model, np.zeros((1, 6))))
    with pytest.raises(MeasurementError, match=r"arrays: there is no tool 'no'; .* name one, or write a column 'tool'"):
        targets.targets(table, model, "no")


def test_rows_of_another_tool_or_set_up_than_is_asked_for_are_not_corrected_for_that_one() -> None:
    """A table as it was measured, in two places: its positions are those of two bases."""
    wall = np.eye(4)
    wall[0, 3] = 1.0
    model = replace(model_of(robot_of("ur10")), others={"wall": wall})
    there = {"x [m]": [0.6, 0.6], "y [m]": [0.2, 0.2], "z [m]": [0.4, 0.4], "setup": ["base", "wall"]}
    wanted = targets.targets(table_from_arrays(there), model)
    for setup, other, line in (("base", "wall", 1), ("wall", "base", 0)):
        said = rf"arrays:{line}: is of the set-up '{other}', and the commands are for '{setup}'; .* at a time"
        with pytest.raises(MeasurementError, match=said):
            targets.corrections(model.at(setup), wanted, frame="instrument")
    assert targets.corrections(model, wanted, frame="base").reached.all()
    two = table_from_arrays(panel(model, np.zeros((2, 6))) | {"tool": ["tool", "other"]})
    with pytest.raises(MeasurementError, match="the tool is given twice, as 'other' and by column 'tool'"):
        targets.targets(two, model, "other")


def test_nothing_can_be_reached() -> None:
    model = model_of(robot_of("ur10"))
    wanted = targets.targets(table_from_arrays({"x [m]": [9.0, 8.0], "y [m]": [0.0, 0.0], "z [m]": [0.0, 0.0]}), model)
    said = r"arrays: none of the 2 targets can be reached; that of line 0: is 9.* m from the base.*"
    for frame, other in (("base", "instrument"), ("instrument", "base")):
        with pytest.raises(MeasurementError, match=rf"{said} in the frame of the {frame}; .* \(frame = \"{other}\""):
            targets.corrections(model, wanted, frame=frame)


def test_an_arm_of_few_joints_is_asked_for_positions() -> None:
    """A SCARA that leans by a milliradian meets no pose of the one that stands upright."""
    robot = machines.load(machines.INLINE["scara"], "tip")
    leaning = np.zeros((len(robot.chain), 6))
    leaning[1, 3] = 1e-3
    model = calib.CalibratedMachine(
        robot, calib.Deviations(leaning, np.zeros(4), np.zeros(0)), np.eye(4), {"tool": TOOLS["tool"]}
    )
    q = np.array([[0.3, 0.8, 0.1, -0.4], [-0.5, 1.0, 0.05, 0.2]])
    columns = {f"{r.name} [{'m' if r.dimension == 'length' else 'rad'}]": q[:, k] for k, r in enumerate(robot.readings)}
    wanted = targets.targets(table_from_arrays(columns), model)
    with pytest.raises(MeasurementError, match=r"mrad away\. An arm of 4 joints .* \(what = \"position\", --what"):
        targets.corrections(model, wanted)
    assert targets.corrections(model, wanted, what="position").reached.all()


def test_a_joint_that_follows_others_beyond_its_limits_is_told() -> None:
    head, joint, rest = machines.INLINE["mimic"].partition('<joint name="level"')
    narrow = head + joint + rest.replace('lower="-2.6" upper="2.8"', 'lower="-0.2" upper="0.2"', 1)
    model = model_of(machines.load(narrow, "tip"))
    lift = [reading.name for reading in model.robot.readings].index("lift")
    q = np.tile([0.3, 0.0, 0.4, 0.2, 0.5, 0.1], (2, 1))
    q[:, lift] = 0.0, 0.5
    found = commands.for_joint_targets(model, q)
    assert found.reached.all()
    assert found.reasons[0] == ""
    # Such a limit is no limit of a reading, and may be written without care: a remark.
    limits = "deg is beyond its limits, -11.45916 deg and 11.45916 deg; it follows others"
    assert found.reasons[1].startswith("level at -2")
    assert found.reasons[1].endswith(limits)


@pytest.mark.parametrize(
    ("name", "tool", "frame", "said"),
    [
        ("scara", "position", "base", True),
        ("scara", "position", "instrument", False),
        ("scara", "fixed", "base", False),
        ("ur10", "position", "base", False),
    ],
)
def test_targets_in_the_base_link_of_a_tool_whose_height_nothing_told(
    name: str, tool: Literal["position", "fixed"], frame: PoseFrame, said: bool
) -> None:
    """A palletizer found its tool 0.25 m higher on the flange, its base lower; corrected positions were as far off."""
    urdf, tip = {**ARMS, "scara": (machines.INLINE["scara"], "tip")}[name]
    robot, rng = machines.load(urdf, tip), np.random.default_rng(3)
    made = machines.arm(urdf, tip).moved(rng)
    true = machines.Machine(made, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.03, 0.25))})
    data = true.measure(robot, made.draw(rng, 40), rng=rng, sigma=3e-5)
    known = calib.Known(tools={"tool": true.tools["tool"]}) if tool == "fixed" else calib.Known()
    model = calib.error_model(robot, offsets="all", placements="all", tool=tool, known=known)
    machine = calib.machine_of(calib.identify(model, data))
    aims = {f"{axis} [m]": [x, x] for axis, x in zip("xyz", (0.4, 0.2, 0.3), strict=True)}
    wanted = targets.targets(table_from_arrays(aims), machine)
    notes = targets.in_base(machine, wanted, frame=frame)
    assert len(notes) == said
    assert len(calib.judging.not_placed(machine)) == (said or frame == "instrument")
    far = targets.targets(table_from_arrays({title: [9.0] for title in aims}), machine)
    with pytest.raises(calib.MeasurementError, match="none of the 1 targets can be reached") as refused:
        targets.corrections(machine, far, frame=frame)
    assert all(note in str(refused.value) for note in notes)
    assert all("where 'tool' is on its link along (0, 0, 1)" in note for note in notes)


@pytest.mark.parametrize("torso", ["soft", "stiff"])
def test_an_arm_that_weighs_on_joints_of_the_other_has_to_be_told(torso: str) -> None:
    """It was taken to be at zero without a word."""
    robot = calib.load_robot(parse_urdf(two_arms().encode(), "two.urdf"), "left_hand", links=["right_hand"])
    model = calib.error_model(robot, terms={"elastic": ["right_lift", *(["lean"] if torso == "soft" else [])]})
    tools, base, tips = {"left": np.eye(4), "right": np.eye(4)}, np.eye(4), {"right": "right_hand"}
    machine = calib.CalibratedMachine(model.robot, model.robot.no_deviations(), base, tools, tool_tips=tips)
    own = {f"{name} [rad]": [0.1, 0.2] for name in ("lean", "right_lift", "right_bend")}
    place = machine.of("right").tips(np.full((1, len(robot.readings)), 0.1))[0, :3, 3]
    posed = targets.targets(
        table_from_arrays({f"{axis} [m]": [place[k]] for k, axis in enumerate("xyz")}), machine, "right"
    )
    said = targets.idle(machine, posed, frame="base", clamp=False)
    titles = targets.corrected_csv(machine, posed, targets.corrections(machine, posed)).partition("\n")[0]
    if torso == "stiff":
        assert len(targets.targets(table_from_arrays(own), machine, "right").table) == 2
        assert said == () and "left" not in titles
        return
    assert "what hangs on 'left_lift', 'left_bend' weighs on joints of this arm" in said[0]
    assert "left_lift [deg]" in titles
    with pytest.raises(calib.MeasurementError, match=r"'left_lift', 'left_bend', of what weighs on joints of this arm"):
        targets.targets(table_from_arrays(own), machine, "right")
