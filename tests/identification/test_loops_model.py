"""A machine with a parallelogram: how much of it positions see, and a truth that is found again."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import calib
from calib.assessment.performance import performance
from calib.identification import system
from calib.identification.machine import Frames
from calib.identification.system import Problem
from calib.measurement.touches import Touches
from calib.robot.sampling import closing, joint_limits, random_readings
from scripts.simulate import irb2400 as simulation
from tests.support import machines

Array = NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[2]
URDF = ROOT / "robots" / "irb2400" / "irb2400.urdf"
LOOP = calib.ClosedLoop("parallelogram", ("rod_end", "rear_lever_pin"), ("x", "z"), ("elbow", "rod"))
LINKS = ("rod_length.tz", "rear_lever_length.tx")
CRANK = ("joint_3.tx", "joint_3.ty")


def commands_deg(n: int, seed: int) -> Array:
    """Random axes (n, 6); crank and lower arm at most 60 deg off the right angle."""
    rng = np.random.default_rng(seed)
    q = rng.uniform([-150, -60, -60, -150, -100, -170], [150, 80, 60, 150, 100, 170], (10 * n, 6))
    return np.round(q[np.abs(q[:, 1] - q[:, 2]) < 60.0][:n], 3)


def measurements(robot: calib.Robot, q: Array, positions: Array) -> calib.Measurements:
    columns: dict[str, object] = {f"joint_{k + 1} [rad]": q[:, k] for k in range(6)}
    columns |= {f"{axis} [m]": positions[:, k] for k, axis in enumerate("xyz")}
    return calib.read_measurements(columns, robot, sigma=1e-6)


def jacobian(robot: calib.Robot, reflector: tuple[float, ...], **free: object) -> Array:
    """Columns (3 N, p) of all free parameters of the nominal robot, base and tool point among them."""
    q = np.radians(commands_deg(150, 0))
    model = machines.model(robot, **free)
    T = np.eye(4)
    T[:3, 3] = reflector
    parameters = model.parameters()
    data = measurements(robot, q, np.zeros((len(q), 3)))
    x = np.zeros(len(parameters))
    if model.tool == "position":
        x[-3:] = reflector
    (J,) = system.jacobian(Problem(model, parameters, Frames(np.eye(4)[None], T[None]), (data,)), x)
    return J.reshape(-1, len(parameters))


def rank(J: Array) -> int:
    values = np.linalg.svd(J, compute_uv=False)
    assert not np.any((values > 1e-11 * values[0]) & (values < 1e-6 * values[0]))
    return int(np.count_nonzero(values > 1e-9 * values[0]))


OFF_AXIS, ON_AXIS = (0.025, 0.0, 0.04955), (0.0, 0.0, 0.04955)


@pytest.mark.parametrize(("reflector", "serial"), [(OFF_AXIS, 27), (ON_AXIS, 25)])
def test_ranks_are_those_of_the_document(reflector: tuple[float, ...], serial: int) -> None:
    """27 without the parallelogram, 29 with k1 and k2, 31 with the crank's coaxiality; 2 fewer on axis 6."""
    tree, machine = calib.load_robot(URDF, "tool0"), calib.load_robot(URDF, "tool0", loops=[LOOP])
    # elbow stays out: behind elbow_cancel it would be a third parallel axis, whose tilts are two more.
    J = jacobian(tree, reflector, offsets="all", placements=["joint_*", "elbow_cancel"])
    fixed = {"base": "fixed", "tool": "fixed"}
    links, crank = (jacobian(machine, reflector, placements=chosen, **fixed) for chosen in (LINKS, CRANK))
    assert rank(J) == serial
    assert rank(np.hstack([J, links])) == serial + 2
    assert rank(np.hstack([J, links, crank])) == serial + 4
    # All lengths of the mechanism at once show no more: only differences do.
    lengths = jacobian(machine, reflector, placements=[*LINKS, "rod_cancel.tx", "elbow_cancel.tx"], **fixed)
    assert rank(np.hstack([J, lengths])) == serial + 2


@pytest.mark.parametrize(("reflector", "serial"), [(OFF_AXIS, 27), (ON_AXIS, 25)])
def test_the_jobs_selection_sees_all_of_it(reflector: tuple[float, ...], serial: int) -> None:
    machine = calib.load_robot(URDF, "tool0", loops=[LOOP])
    J = jacobian(machine, reflector, offsets="all", placements=["joint_*", "elbow_cancel", *LINKS])
    assert rank(J) == serial + 4


@pytest.mark.parametrize("planar", [True, False])
def test_a_truth_that_the_model_can_express_is_found(planar: bool) -> None:
    """Where axes 2 and 3 are tilted, the script's four-bar stays planar and the URDF's does not: 0.01 um at most."""
    true = simulation.Machine(7, wind_up=False, harmonics=False)
    if planar:
        straight = true.truth.dalpha * [0, 0, 1, 1, 1, 1]
        true.truth = replace(true.truth, dalpha=straight, dbeta_2=0.0)
    robot = calib.load_robot(URDF, "tool0", loops=[LOOP])
    seen, unseen = commands_deg(80, 1), commands_deg(200, 2)
    data = measurements(robot, np.radians(seen), true.tcp(seen) * 1e-3)
    model = calib.error_model(robot, offsets="all", placements=["joint_*", "elbow_cancel", *LINKS])
    fit = calib.identify(model, data)
    frames = fit.machine.frames
    tips = frames.base @ robot.tips(np.radians(unseen), fit.machine.deviations) @ frames.tools[0]
    assert len(fit.parameters) - len(fit.null_space) == fit.numerical_rank
    # Of the nominal robot; exact data tell two more, by products of small parameters.
    assert 31 <= fit.numerical_rank <= 33
    assert np.abs(tips[:, :3, 3] * 1e3 - true.tcp(unseen)).max() < (1e-6 if planar else 1e-5)


def test_all_placements_have_the_lengths_of_all_bars() -> None:
    """Behind the pins of rod and rear lever nothing moves: the lengths of these bars are in no other placement."""
    true = simulation.Machine(7, wind_up=False, harmonics=False)
    robot = calib.load_robot(URDF, "tool0", loops=[LOOP])
    seen, unseen = commands_deg(80, 1), commands_deg(200, 2)
    data = measurements(robot, np.radians(seen), true.tcp(seen) * 1e-3)
    model = calib.error_model(robot, offsets="all", placements="all")
    freed = {f"{joint}.{component}" for joint, component in model.placements}
    assert {*LINKS, "rod_length.rx"} <= freed
    assert "rear_lever_length.rx" not in freed, "how the second frame of a loop is turned does not matter"
    fit = calib.identify(model, data)
    frames = fit.machine.frames
    tips = frames.base @ robot.tips(np.radians(unseen), fit.machine.deviations) @ frames.tools[0]
    assert np.abs(tips[:, :3, 3] * 1e3 - true.tcp(unseen)).max() < 1e-5


def test_a_pose_that_cannot_be_is_named_by_file_and_line() -> None:
    robot = calib.load_robot(URDF, "tool0", loops=[LOOP])
    q = np.radians(commands_deg(20, 3))
    data = measurements(robot, q, robot.tips(q)[:, :3, 3])
    far = q.copy()
    far[7, 1:3] = np.pi / 2.0, 0.0  # crank and lower arm lie in line
    late = replace(data, readings=far, where="poses.csv")
    line = late.lines[7]
    with pytest.raises(calib.RobotError, match=rf"^poses\.csv:{line}: .*parallelogram"):
        late.tips(robot)
    with pytest.raises(calib.RobotError, match=rf"^poses\.csv:{line}: .*parallelogram"):
        system.residuals(robot, [late], calib.identify(calib.error_model(robot), data).machine)
    with pytest.raises(calib.CalibError, match=rf"^poses\.csv:{line}: .*parallelogram"):
        calib.identify(calib.error_model(robot, offsets="all"), late)
    cone = Touches("cone", far, {"target": ("a",) * len(far)}, {}, "cone.csv", late.lines)
    with pytest.raises(calib.RobotError, match=rf"^cone\.csv:{line}: .*parallelogram"):
        performance(robot.tips, [cone], None, np.zeros(3))


def sought_from_zero(folder: Path) -> calib.Robot:
    """The machine without a nominal coupling of the passive joints: far from zero their search finds no end."""
    urdf = folder / "arm.urdf"
    urdf.write_text(re.sub(r'(<joint name="(?:elbow|rod)" .*?)<mimic[^>]*>', r"\1", URDF.read_text(), flags=re.DOTALL))
    return calib.load_robot(urdf, "tool0", loops=[LOOP])


def test_where_loops_do_not_close_no_term_asks_for_what_is_held(tmp_path: Path) -> None:
    """The workspace of a machine that gives way is that of its loops, and random poses are drawn there."""
    robot = calib.error_model(sought_from_zero(tmp_path), terms={"moments": ["joint_2"]}).robot
    soft = replace(robot.no_deviations(), terms=np.full(len(robot.terms), 1e-6))
    q = np.random.default_rng(2).uniform(*joint_limits(robot).T, (400, 6))
    nominal, closes = closing(robot, q), closing(robot, q, [soft])
    assert 0.2 < np.mean(closes) < 1.0
    assert np.mean(nominal == closes) > 0.99
    assert closing(robot, random_readings(robot, 50, machines=[soft]), [soft]).all()
    assert np.isfinite(robot.tips(q[closes], soft)).all()


def test_a_mistake_that_would_open_the_loop_hides_no_other(tmp_path: Path) -> None:
    """What is tried - a reading's sign, its zero - may take poses that no parallelogram reaches; others go on."""
    robot = sought_from_zero(tmp_path)
    # joint_3, which turns the crank, is read last: it is beside the way to the tip.
    q = np.radians(commands_deg(60, 3))[:, [0, 1, 3, 4, 5, 2]]
    T = robot.tips(q)
    q[:, 4] *= -1.0
    data = calib.poses(robot, q, T, sigma=1e-5, sigma_angle=1e-5)
    model = calib.error_model(robot, offsets="all", base="fixed", tool="pose")
    finding = next(one for one in calib.check(model, data) if one.severity == "error")
    assert finding.code == "flipped-sign" and "joint_6" in finding.sentence
