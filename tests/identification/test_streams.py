"""Fits of streams: clocks found with the machine, exact derivatives, ranks, and sigmas of rows that err together."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.assessment.checks import of_rows
from calib.assessment.in_time import delay
from calib.assessment.influence import Residue
from calib.assessment.judged import Check
from calib.assessment.stamps import stamps, step_of
from calib.assessment.stretches import Stretch, stretches
from calib.identification import system
from calib.identification.initialisation.problem import initial_problem
from calib.identification.machine import values_at
from calib.identification.system import Problem
from calib.measurement.read import stream_of
from calib.measurement.scalars import Scalar
from calib.measurement.streams.samples import joint_stream
from calib.measurement.streams.stream import OFFSET, SKEW, Stream
from calib.measurement.table import table_from_arrays
from calib.measuring import Clock
from scripts.simulate.streams import motion
from tests.support import machines, streams
from tests.support.loops import four_bar_urdf
from tests.support.streams import Streams
from tests.support.trees import tree

FOUR_BAR = {"urdf": four_bar_urdf(), "tip": "tip"}


def of_clock(problem: Problem, x: np.ndarray, tolerance: float = 1e-6) -> None:
    """Columns of the clock agree with central differences, as shares of the largest number."""
    (J,) = system.jacobian(problem, x)
    names = [parameter.name for parameter in problem.parameters]
    for name, h in (("clock.offset", 1e-4), ("clock.skew", 1e-5), ("clock.latency", 1e-4)):
        if name not in names:
            continue
        k = names.index(name)
        step = h * (np.arange(len(x)) == k)
        after, before = (problem.residuals(x + s)[0] for s in (step, -step))
        numeric = (after - before) / (2.0 * h)
        np.testing.assert_allclose(J[:, :, k], numeric, atol=tolerance * np.abs(numeric).max(), err_msg=name)


def test_a_clock_does_not_lean_to_times_between_rounded_readings() -> None:
    """There errors of two samples are mixed, and less; with the rates at each moment it came out 4 ms off."""
    for seed in (1, 2):
        made = streams.streams(seed, swing=0.06, rates=(100.0, 50.0), skew=0.0, sigma=5e-5)
        rounded = {name: column if name == "time [s]" else np.round(column, 3) for name, column in made.joints.items()}
        data = calib.measuring.read_stream(made.seen, made.robot, rounded, sigma=5e-5)
        fit = calib.identify(calib.error_model(made.robot, offsets="all", placements="all"), data)
        assert fit.converged
        assert fit.value("clock.offset") == pytest.approx(made.recorded.offset_at(data.stream.middle), abs=5e-4)


@pytest.mark.parametrize("turning", ["at once", "through the gap"])
def test_gaps_of_a_stream_come_back_however_joints_cross_them(turning: str) -> None:
    """With sides that changed after ten standard deviations of noise, a gap came out 3 % small, with a z of 9."""
    rng, robot, arm = np.random.default_rng(3), machines.load(*streams.UR10), machines.arm(*streams.UR10)
    moving = motion(rng, list(arm.ranges.values()))
    u = np.arange(0.0, 60.0, 1e-3)
    q, gaps = moving.at(u), rng.uniform(3e-4, 7e-4, 6)
    held = q - gaps * np.sign(np.gradient(q, axis=0))
    if turning == "through the gap":
        for n in range(1, len(u)):
            held[n] = np.clip(held[n - 1], q[n] - gaps, q[n] + gaps)
    machine = machines.Machine(arm.moved(rng), machines.anywhere(rng), {"tool": machines.pose((0.02, 0.03, 0.1))})
    seen, read = slice(1000, -1000, 20), slice(None, None, 8)
    points = machine.see(held[seen])[:, :3, 3] + rng.normal(0.0, 5e-5, (len(u[seen]), 3))
    table = {"time [s]": u[seen]} | {f"{axis} [m]": points[:, k] for k, axis in enumerate("xyz")}
    readings = q[read] + rng.normal(0.0, 2e-5, q[read].shape)
    joints = {f"{name} [rad]": readings[:, k] for k, name in enumerate(arm.ranges)} | {"time [s]": u[read]}
    data = stream_of(table, joints, robot, "position", clock="given", sigma=5e-5, in_order=True)
    assert len(data) > 0.6 * len(points)
    model = calib.error_model(robot, offsets="all", placements="all", terms={"backlash": "all"})
    fit = calib.identify(model, data)
    names = [f"{name}.backlash" for name in arm.ranges]
    sigmas = fit.sigmas[[[one.name for one in fit.parameters].index(name) for name in names]]
    z = (np.array([fit.value(name) for name in names]) + gaps) / sigmas
    assert np.abs(z).max() < 3.5


@pytest.mark.parametrize("observes", ["position", "pose"])
@pytest.mark.parametrize("terms", [{}, {"harmonics": "all", "gain": "all"}])
@pytest.mark.usefixtures("exact_rates")
def test_the_columns_of_a_clock_are_minus_the_velocity(observes: str, terms: dict[str, str]) -> None:
    made = streams.streams(1, seconds=20.0)
    rng = np.random.default_rng(2)
    seen = dict(made.seen)
    if observes == "pose":
        seen |= {"qw": np.ones(len(seen["time [s]"]))} | {f"q{c}": np.zeros(len(seen["time [s]"])) for c in "xyz"}
    data = calib.measuring.read_stream(
        seen, made.robot, made.joints, observes, sigma=(1e-4, 1e-4 if observes == "pose" else None)
    )
    model = calib.error_model(made.robot, offsets="all", placements="all", terms=terms, tool="pose")
    problem = initial_problem(model, (data.subset(np.arange(0, len(data), 100)),))
    x = values_at(model.robot, problem.parameters, problem.reference)
    x = x + rng.uniform(-0.02, 0.02, len(x)) * [q.unit in ("m", "rad") for q in problem.parameters]
    of_clock(problem, x)


@pytest.mark.usefixtures("exact_rates")
def test_the_velocity_follows_closed_loops_and_links_that_carry_targets() -> None:
    robot = machines.load(FOUR_BAR["urdf"], FOUR_BAR["tip"])
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 4.0, 0.01)
    k = len(robot.readings)
    q = 0.2 + 0.2 * np.sin(np.multiply.outer(t, rng.uniform(1.0, 3.0, k)) + rng.uniform(0.0, 6.0, k))
    unit = {"angle": "rad", "length": "m"}
    joints = {"time [s]": t} | {f"{r.name} [{unit[r.dimension]}]": q[:, j] for j, r in enumerate(robot.readings)}
    x = robot.tips(q)[:, :3, 3]
    seen = {"time [s]": t} | {f"{a} [m]": x[:, j] for j, a in enumerate("xyz")}
    clock = Clock("given", latency=True)
    data = calib.measuring.read_stream(seen, robot, joints, clock=clock, sigma=1e-4)
    model = calib.error_model(robot, offsets="all", placements="all")
    problem = initial_problem(model, (data.subset(np.arange(0, len(data), 10)),))
    at = values_at(model.robot, problem.parameters, problem.reference)
    of_clock(problem, at + rng.uniform(-5e-3, 5e-3, len(at)))


@pytest.mark.usefixtures("exact_rates")
def test_the_velocity_is_that_against_a_target_on_a_moving_link() -> None:
    made, rng, n = tree(), np.random.default_rng(4), len(tree().names)
    t = np.arange(0.0, 3.0, 0.01)
    q = 0.5 * np.sin(np.multiply.outer(t, rng.uniform(1.0, 3.0, n)) + rng.uniform(0.0, 6.0, n))
    columns = made.columns(q) | {"time [s]": t, "length [m]": 0.7 + 0.1 * t, "target": ["a"] * len(t)}
    plain = calib.read_measurements(columns, made.robot, "distance", sigma=1e-4).named(on={"a": "left_hand"})
    joints = joint_stream(table_from_arrays(made.columns(q) | {"time [s]": t}), made.robot.readings, 0.1)
    scalars = (Scalar("clock.offset", "s", 1e-3, 0.02), Scalar("clock.skew", "s/s", 1e-4))
    data = replace(plain, stream=Stream(joints, t - 1.5, 1.5), scalars=scalars, uses={OFFSET: 0, SKEW: 1})
    problem = initial_problem(calib.error_model(made.robot, offsets="all"), (data.subset(np.arange(20, 280, 7)),))
    x = values_at(made.robot, problem.parameters, problem.reference)
    of_clock(problem, x + [0.05 * rng.uniform(-1, 1) * (q.unit in ("m", "rad")) for q in problem.parameters])


def test_clock_and_machine_are_found_from_streams_without_noise() -> None:
    made = streams.streams(5, seconds=40.0, offset=-12.5, skew=-1.5e-3, sigma=1e-9)
    data = streams.read(made, sigma=1e-6)
    fit = calib.identify(calib.error_model(made.robot, offsets="all", placements="all"), data)
    assert data.stream is not None
    assert fit.value("clock.offset") == pytest.approx(made.recorded.offset_at(data.stream.middle), abs=2e-7)
    assert fit.value("clock.skew") == pytest.approx(made.recorded.skew, abs=1e-7)
    assert machines.miss(fit, made.machine, made.motion.at(np.linspace(3.0, 37.0, 50))) < 1e-6
    # What the fit has made of its rows: the readings then.
    np.testing.assert_allclose(fit.measurements[0].readings, made.motion.at(_true_times(made, fit)), atol=1e-6)


def _true_times(made: Streams, fit: calib.Fit) -> np.ndarray:
    t = fit.measurements[0].times
    assert t is not None
    return np.asarray(t - made.recorded.offset + made.recorded.skew * (t - made.recorded.middle))


def test_the_world_may_move_clocks_may_be_set_and_units_changed() -> None:
    made = streams.streams(6, seconds=30.0, sigma=1e-4)
    model = calib.error_model(made.robot, offsets="all", placements="all")
    fit = calib.identify(model, streams.read(made, sigma=1e-4))
    T = machines.pose((1.0, -2.0, 0.5), (0.3, 0.2, -1.0))
    points = np.column_stack([made.seen[f"{axis} [m]"] for axis in "xyz"]) @ T[:3, :3].T + T[:3, 3]
    seen = {"time [ms]": 1e3 * (made.seen["time [s]"] + 500.0)}
    seen |= {f"{axis} [mm]": 1e3 * points[:, k] for k, axis in enumerate("xyz")}
    other = calib.identify(model, calib.measuring.read_stream(seen, made.robot, made.joints, sigma=1e-4))
    assert other.value("clock.offset") == pytest.approx(fit.value("clock.offset") + 500.0, abs=1e-7)
    assert other.value("clock.skew") == pytest.approx(fit.value("clock.skew"), abs=1e-8)
    q = made.motion.at(np.linspace(3.0, 27.0, 20))
    there = machines.predicted(fit, q) @ np.eye(4)
    np.testing.assert_allclose((T @ there)[:, :3, 3], machines.predicted(other, q)[:, :3, 3], atol=2e-8)


def test_a_constant_velocity_does_not_show_a_latency() -> None:
    robot, arm = machines.load(*streams.UR10), machines.arm(*streams.UR10)
    t = np.arange(0.0, 10.0, 0.01)
    q = np.zeros((len(t), 6))
    q[:, 0], q[:, 1:] = 0.1 * t, (0.3, -0.5, 0.4, 0.2, 0.1)
    machine = machines.Machine(arm, machines.anywhere(np.random.default_rng(1)), {"tool": np.eye(4)})
    x = machine.see(q)[:, :3, 3] + 1e-5 * np.random.default_rng(2).normal(size=(len(t), 3))
    joints = {"time [s]": t} | {f"{name} [rad]": q[:, k] for k, name in enumerate(arm.ranges)}
    seen = {"time [s]": t} | {f"{axis} [m]": x[:, k] for k, axis in enumerate("xyz")}
    data = calib.measuring.read_stream(seen, robot, joints, clock=Clock("given", latency=True), sigma=1e-5)
    fit = calib.identify(calib.error_model(robot), data)
    names = [parameter.name for parameter in fit.parameters]
    assert fit.unidentifiable[names.index("clock.latency")]
    assert any("clock.latency" in direction.shares for direction in fit.null_space)
    assert any("move now faster" in said.sentence for said in calib.advice(fit))


def test_rows_that_err_together_say_less_and_sigmas_know_it() -> None:
    made = streams.streams(8, seconds=60.0, sigma=1e-4, memories=(0.05, 0.5), moved=False)
    data = streams.read(made, sigma=1e-4)
    model = calib.error_model(made.robot)
    fit = calib.identify(model, data)
    (memory,) = fit.memories
    # A third of the variance each: alone, 50 ms and 500 ms at 60 Hz.
    rates = np.exp(-1.0 / 60.0 / np.array([0.05, 0.5]))
    assert memory.rows_as_one == pytest.approx(np.mean([1.0, *((1 + rates) / (1 - rates))]), rel=0.35)
    assert memory.alone == pytest.approx(1.0 / 3.0, abs=0.08)
    # By blocks of 3 s, which hardly know of each other, sums of whitened scores scatter as the covariance says.
    problem = Problem(fit.model, fit.parameters, fit.machine.frames, fit.measurements)
    (J,) = system.jacobian(problem, values_at(made.robot, fit.parameters, fit.machine.frames))
    k = [p.name for p in fit.parameters].index("clock.offset")
    step = (J.reshape(-1, J.shape[2]) @ fit.covariance[:, k]).reshape(J.shape[:2]) / fit.covariance[k, k]
    scores = np.add.reduceat(np.sum(step * fit.residuals[0], axis=1), np.arange(0, len(step), 180))
    alone = np.sum(step**2) * np.mean(fit.residuals[0] ** 2)
    assert np.sum(scores**2) / alone > 5.0


def test_rows_that_err_alone_keep_their_sigmas() -> None:
    made = streams.streams(9, seconds=30.0, sigma=1e-4, moved=False)
    fit = calib.identify(calib.error_model(made.robot), streams.read(made, sigma=1e-4))
    assert all(memory.rows_as_one < 1.5 for memory in fit.memories)


@pytest.mark.parametrize("late", [0.01, -0.01])
def test_a_clock_that_was_given_wrongly_is_told_in_milliseconds(late: float) -> None:
    made = streams.streams(13, seconds=30.0, offset=late, skew=0.0, memories=(0.05, 0.5))
    data = calib.measuring.read_stream(made.seen, made.robot, made.joints, clock="given", sigma=1e-4)
    model = calib.error_model(made.robot, offsets="all", placements="all")
    fit = calib.identify(model, data)
    found, step = delay(*_effects(fit))
    assert not stamps(_effects(fit)[0], fit.machine.frames.scalars)  # a delay is no jitter
    assert found.value == pytest.approx(late, abs=max(4.0 * found.sigma, 1e-3))
    check = of_rows.late(found, step)
    assert not check.passed
    assert " ms later than" in check.sentence if late > 0 else " ms earlier than" in check.sentence
    # A clock that is free takes it all.
    free = calib.measuring.read_stream(
        made.seen, made.robot, made.joints, clock=Clock("given", latency=True), sigma=1e-4
    )
    assert of_rows.late(*delay(*_effects(calib.identify(model, free)))).passed


@pytest.mark.parametrize(("stamped", "jitters"), [("points", 2e-3), ("joints", 3e-3), ("points", 0.0)])
def test_stamps_that_jitter_are_told_from_errors_of_the_machine(stamped: str, jitters: float) -> None:
    """Uniformly by so many s to either side; what gears wobble by is in no proportion to the speed."""
    made = streams.streams(5, seconds=40.0, sigma=1e-4, jitter=0.0)
    table = made.seen if stamped == "points" else made.joints
    off = np.random.default_rng(1).uniform(-jitters, jitters, len(table["time [s]"]))
    table["time [s]"] = np.sort(table["time [s]"] + off)
    if not jitters:
        for name in made.joints.keys() - {"time [s]"}:
            made.joints[name] = made.joints[name] + 2e-4 * np.cos(3.0 * made.joints[name])
    fit = calib.identify(calib.error_model(made.robot, offsets="all", placements="all"), streams.read(made, sigma=1e-4))
    found = stamps(_effects(fit)[0], fit.machine.frames.scalars)
    if not jitters:
        assert not found
        return
    (one,) = found
    # Of two samples beside a row, each is off by itself, and a cubic goes through both.
    assert one.off == pytest.approx(jitters / np.sqrt(3.0), rel=0.15 if stamped == "points" else 0.25)
    assert one.step == 0.0
    assert "time stamps, of measurements or readings, seem to jitter by " in one.sentence
    told = one.named_in(Check.of("outliers", 0.06, 0.05, False, "Too many."))
    assert told.sentence == f"Too many. But {one.what}, and that may be all there is to it."
    sound = Check.of("outliers", 0.01, 0.05, True, "Few.")
    assert one.named_in(sound) is sound


def test_stamps_that_are_rounded_are_told() -> None:
    made = streams.streams(5, seconds=40.0, sigma=1e-4, jitter=0.0)
    made.joints["time [s]"] = np.round(made.joints["time [s]"] / 0.004) * 0.004
    fit = calib.identify(calib.error_model(made.robot, offsets="all", placements="all"), streams.read(made, sigma=1e-4))
    (one,) = stamps(_effects(fit)[0], fit.machine.frames.scalars)
    assert one.step == pytest.approx(0.004)
    assert one.what.endswith("time stamps are rounded to 4 ms")


@pytest.mark.parametrize(
    ("times", "step"),
    [
        (np.arange(100) * 0.008, 0.0),  # a clock that ticks exactly
        (np.delete(np.arange(100), [20, 40, 41]) * 0.008, 0.0),  # and whose samples were lost
        (np.concatenate([np.arange(40) * 0.008, 1.003 + np.arange(40) * 0.008, 2.107 + np.arange(40) * 0.008]), 0.0),
        (np.round(np.arange(100) * 0.0067, 3), 0.001),
        (1.7e9 + np.round(np.arange(100) * 0.0067, 3), 0.001),
        (np.arange(100) * 0.0067123 % 100.0, 0.0),
        (np.sort(np.random.default_rng(0).uniform(0.0, 1.0, 100)), 0.0),
        (np.array([1.0]), 0.0),
    ],
)
def test_the_step_of_stamps(times: np.ndarray, step: float) -> None:
    assert step_of(times) == pytest.approx(step)


def _effects(fit: calib.Fit) -> tuple[tuple[Stretch, ...], np.ndarray]:
    residue = Residue.of(fit, {})
    return stretches(residue), residue.C
