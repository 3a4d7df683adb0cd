"""A calibration that should not be used says so, and why."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.assessment.changes import LENGTHS, Step, _at_once, apart, drifts, steps
from calib.assessment.checks import of_arm, of_errors, of_fit, of_rows
from calib.assessment.effects import gains, ratios
from calib.assessment.gain import Gain, gain
from calib.assessment.in_time import Timing, delay, timing, unsettled
from calib.assessment.influence import Residue
from calib.assessment.instrument_errors import rounding, strains
from calib.assessment.judged import Check, JudgedSet
from calib.assessment.stretches import pose_by_pose, stretches
from calib.assessment.trust import remarks
from calib.identification.identify import with_values
from calib.identification.targets import Target
from calib.machine.of_fit import machine_of
from calib.measurement.boards import Board
from calib.measurement.checks import Finding
from calib.robot.deviation import axis_frame
from calib.robot.urdf import parse_urdf
from tests.support import cameras, machines
from tests.support.gears import geared
from tests.support.touching import NORMALS, UR10, between, lab

Array = np.ndarray
UR5 = ("example:ur_description/urdf/ur5_robot.urdf", "tool0")


class Cell:
    """A UR5 of known truth, and its tables."""

    def __init__(self, seed: int = 4) -> None:
        self.rng = np.random.default_rng(seed)
        self.robot = calib.load_robot(*UR5)
        tool = {"tool": machines.pose((0.05, 0.02, 0.15))}
        true = machines.arm(*UR5).moved(self.rng)
        self.machine = machines.Machine(true, machines.anywhere(self.rng), tool)
        self.model = calib.error_model(self.robot, offsets="all", placements="all")

    def draw(self, n: int) -> Array:
        """Random readings."""
        return self.rng.uniform(-2.0, 2.0, (n, 6))

    def path(self, n: int) -> Array:
        """Readings on a smooth path, some hundredths of a radian apart."""
        s = np.arange(n)[:, None] * 0.02
        return np.asarray(1.2 * np.sin(s * self.rng.uniform(0.6, 1.4, 6) + self.rng.uniform(0.0, 6.0, 6)))

    def measured(self, q: Array, read: Array | None = None, sigma: float = 5e-5) -> calib.Measurements:
        """What is measured at readings, of which a controller shows ``read``."""
        data = self.machine.measure(self.robot, q, rng=self.rng, sigma=sigma)
        return data if read is None else replace(data, readings=read)

    def effects(self, data: calib.Measurements, model: calib.ErrorModel | None = None) -> tuple[tuple, Array]:
        """The rows of a fit to them, and its covariance."""
        residue = Residue.of(calib.identify(model or self.model, data), {})
        return stretches(residue), residue.C


@pytest.fixture
def cell() -> Cell:
    """One of each test's own: what it draws does not depend on other tests."""
    return Cell()


@pytest.fixture(scope="module")
def fit() -> calib.Fit:
    cell = Cell()
    cell.rng = np.random.default_rng(0)  # the same arm, and other draws than those of tests
    return calib.identify(cell.model, cell.measured(cell.draw(40)))


def lengthened(origin: Array, factor: float) -> Array:
    longer = np.array(origin)
    longer[:3, 3] *= factor
    return longer


def failed(found: calib.Calibration) -> set[str]:
    return {check.name for check in found.checks if not check.passed}


# ---- the verdict


@pytest.mark.parametrize("scrambled", [False, True])
def test_where_stations_stand_widens_nothing_that_the_arm_was_shown_for(cell: Cell, scrambled: bool) -> None:
    q = cell.draw(30)
    seen = cell.machine.see(q)
    seen[:, :3, 3] += cell.rng.normal(scale=5e-5, size=(30, 3))
    moved = machines.pose((40.0, -10.0, 1.0), (0.1, 0.2, 2.0)) @ seen
    read = cell.draw(30) if scrambled else q  # or readings that do not belong to the points
    alike = machines.table(cell.machine.arm, np.tile(read, (2, 1)), np.concatenate([seen, seen]), "position")
    parted = machines.table(cell.machine.arm, np.tile(read, (2, 1)), np.concatenate([seen, moved]), "position")
    stations = {"setup": ["hall"] * 30 + ["yard"] * 30}
    one, two = (
        calib.assess(calib.identify(cell.model, calib.read_measurements(table, cell.robot, sigma=5e-5)))
        for table in (alike, parted | stations)
    )
    assert one.shown[0] == two.shown[0]
    for name in ("places", "explained"):
        was, now = (next(c.statistic for c in each.checks if c.name == name) for each in (one, two))
        assert now == pytest.approx(was, rel=0.05)
    assert ("explained" in failed(two)) is scrambled


def test_a_sound_calibration_passes_all_checks(cell: Cell, fit: calib.Fit) -> None:
    found = calib.assess(fit, cell.measured(cell.draw(20)))
    assert (found.trusted, found.doubts, failed(found)) == (True, (), set())
    assert len({check.name for check in found.checks}) == len(found.checks) == 29
    assert found.shown[0].startswith("Shown for the measured range: ")
    alone = calib.assess(fit)
    assert alone.trusted
    assert "Held-out rows" in alone.shown[1]


def test_the_verdict_is_the_conjunction_of_the_checks(cell: Cell, fit: calib.Fit) -> None:
    held_out = cell.measured(cell.draw(20))
    found = calib.assess(replace(fit, converged=False, step=0.25), held_out)
    assert found.doubts == ("The solver did not converge: its last step was 0.25 parameter scales.",)
    warned = calib.assess(fit, held_out, findings=[Finding("warning", "unexplained", "No mistake explains it.")])
    assert (warned.doubts, failed(warned)) == (("No mistake explains it.",), {"input"})
    harmless = calib.assess(fit, held_out, findings=[Finding("warning", "repeated-row", "One row comes twice.")])
    assert harmless.trusted


def test_joint_offsets_that_explain_a_miss_are_named(cell: Cell, fit: calib.Fit) -> None:
    """Of readings from other zeros nothing said what to do, though the fit found them."""
    finding = Finding("warning", "unexplained", "No mistake explains it.")
    offset = next(k for k, parameter in enumerate(fit.parameters) if parameter.kind == "offset")
    far = np.where(np.arange(len(fit.values)) == offset, 0.5, fit.values)
    name = fit.parameters[offset].name.removesuffix(".offset")
    (said,) = of_arm.naming_zeros(replace(fit, values=far), [finding], 0.001)
    assert said.sentence == (
        f"No mistake explains it. The fit explains it by joint offsets: {name!r} by +29 deg. Where the readings have "
        "these zeros, calibrate again with calibrated.urdf of this result as the URDF."
    )
    for left, of in ((0.05, replace(fit, values=far)), (0.001, fit)):
        assert of_arm.naming_zeros(of, [finding], left) == (finding,)


def test_rows_that_are_copies_are_not_trusted(cell: Cell) -> None:
    """Twice the rows that were measured would make every sigma too small by the root of two."""
    data, held_out = cell.measured(cell.draw(40)), cell.measured(cell.draw(20))
    for copied in ([data, data], data.subset([*range(40), *range(40)])):
        assert failed(calib.assess(calib.identify(cell.model, copied), held_out)) == {"input"}


@pytest.mark.parametrize(
    ("rows", "name"),
    [
        (lambda own, cell: own, "copies"),
        (lambda own, cell: own.subset(np.arange(len(own))[::-1]), "copies"),
        (lambda own, cell: replace(own, readings=own.readings.round(3), position=own.position.round(4)), "copies"),
        (lambda own, cell: cell.measured(cell.draw(1)), "held-out poses"),
        (lambda own, cell: replace(own, readings=cell.draw(len(own))), "explained"),
        (lambda own, cell: replace(d := cell.measured(cell.draw(20)), position=d.position + 2e-3), "prediction"),
    ],
    ids=["the same", "shuffled", "rounded", "one row", "random", "base moved"],
)
def test_what_a_validation_must_be(cell: Cell, fit: calib.Fit, rows, name: str) -> None:
    found = calib.assess(fit, rows(fit.measurements[0], cell))
    assert not found.trusted
    assert name in failed(found)


def test_gauges_of_the_fit_told_from_their_other_end_are_copies_of_it() -> None:
    """Shuffled, half of the rows of a table of gauges have the other end first, and proved nothing in silence."""
    world = lab()
    own = world.pairs(60)
    model = calib.error_model(world.robot, offsets="all", placements="all", base="fixed")
    fit = calib.identify(model, own)
    other = own.other
    assert other is not None
    turned = replace(own, readings=other.readings, other=replace(other, readings=own.readings))
    assert failed(calib.assess(fit, turned)) >= {"copies", "held-out poses"}


def test_errors_of_a_load_that_held_out_rows_do_not_have_are_outside_their_regions() -> None:
    """They are no larger than predicted, and in directions in which they should be far smaller."""
    cell = Cell(7)
    q, load = cell.draw(50), np.array([0.0, 1e-3, 1e-3, 0.0, 0.0, 0.0])
    own = cell.measured(q + load * np.cos(q), q, sigma=3e-5)
    fit = calib.identify(cell.model, own)
    found = calib.assess(fit, cell.measured(cell.draw(20), sigma=3e-5))
    assert failed(found) == {"regions"}
    told = next(check for check in found.checks if check.name == "regions")
    assert told.statistic < 0.5
    loaded = cell.draw(20)
    assert calib.assess(fit, cell.measured(loaded + load * np.cos(loaded), loaded, sigma=3e-5)).trusted


def test_lengths_of_a_tool_that_only_held_out_rows_have_judge(cell: Cell, fit: calib.Fit) -> None:
    """Nobody measured a place of it: how far its points are apart is not known, and not asked for."""
    q = cell.draw(40)
    points = (cell.machine.base @ cell.machine.arm.tips(q))[:, :3] @ (0.0, 0.04, 0.2, 1.0)
    lengths = np.linalg.norm(points - (3.0, 0.5, 0.2), axis=1)
    held_out = calib.measuring.distances(cell.robot, q, lengths, sigma=5e-5).named(tool="other")
    found = calib.assess(fit, held_out)
    assert found.trusted
    assert found.metrics["validation"]["after"]["distance"].rms < 1e-4


def test_random_numbers_are_not_explained() -> None:
    cell = Cell()  # its own: what others have drawn before is a matter of chance
    data = cell.measured(cell.draw(60))
    wild = replace(data, position=cell.rng.uniform(-0.8, 0.8, (60, 3)))
    found = calib.assess(calib.identify(cell.model, wild.subset(range(40))), wild.subset(range(40, 60)))
    assert not any("its URDF" in doubt for doubt in found.doubts)
    assert {"explained", "improvement"} <= failed(found)
    (check,) = (check for check in found.checks if check.name == "explained")
    assert 0.7 < check.statistic < 1.6


def test_nothing_better_than_before_is_not_shown() -> None:
    cell = Cell()
    exact = machines.Machine(machines.arm(*UR5), cell.machine.base, cell.machine.tools)
    own, held_out = (exact.measure(cell.robot, cell.draw(n), rng=cell.rng, sigma=2e-4) for n in (40, 30))
    found = calib.assess(calib.identify(cell.model, own), held_out)
    assert failed(found) == {"improvement"}
    assert "Nothing shows that the arm deviates from its URDF" in found.doubts[0]
    # A job that keeps the URDF, as it says, is trusted.
    assert calib.assess(calib.identify(calib.error_model(cell.robot), own), held_out).trusted


def test_an_arm_of_which_few_poses_show_little_is_not_trusted_for_that() -> None:
    """Base and tool explain what was measured in so small a part of its range, and nothing is known of the rest."""
    cell = Cell()
    exact = machines.Machine(machines.arm(*UR5), cell.machine.base, cell.machine.tools)
    q = 0.4 + 0.01 * cell.draw(40)
    data = exact.measure(cell.robot, q, rng=cell.rng, sigma=5e-5)
    found = calib.assess(calib.identify(cell.model, data.subset(range(20))), data.subset(range(20, 40)))
    assert "improvement" in failed(found)


NO_SCALARS = np.zeros(0)
TURNTABLE = """<robot name="table"><link name="base"/><link name="tip"/><joint name="turn" type="revolute">
<parent link="base"/><child link="tip"/><origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""


def test_a_turntable_shows_nothing_beyond_base_and_tool_and_is_trusted() -> None:
    rng = np.random.default_rng(3)
    robot = calib.load_robot(parse_urdf(TURNTABLE.encode(), "table.urdf"))
    q = rng.uniform(-2.5, 2.5, (60, 1))
    points = Rotation.from_rotvec(q * (0.0, 0.0, 1.0)).apply((0.12, 0.03, 0.05))
    seen = points @ Rotation.from_rotvec((0.3, 1.0, 0.2)).as_matrix().T + rng.normal(1.0, 5e-5, (60, 3))
    data = calib.positions(robot, q, seen, sigma=5e-5)
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all"), data.subset(range(40)))
    found = calib.assess(fit, data.subset(range(40, 60)))
    assert found.trusted
    (check,) = (check for check in found.checks if check.name == "improvement")
    assert check.sentence.startswith("Base and tool alone explain the measurements")
    # Of a table that nothing explains, it is not said.
    wild = replace(data, position=rng.uniform(-0.2, 0.2, (60, 3)))
    fit = calib.identify(fit.model, wild.subset(range(40)))
    assert {"explained", "improvement"} <= failed(calib.assess(fit, wild.subset(range(40, 60))))


def test_errors_along_what_a_calibration_changed_show_that_it_is_right(cell: Cell) -> None:
    """Row by row errors are hardly smaller, of twenty rows all of which have as much noise as was mended."""
    data, rng = cell.measured(cell.draw(20)), np.random.default_rng(1)
    noise, change = (rng.normal(0.0, 1e-4, (20, 3)) for _ in range(2))

    def of(before: Array, after: Array, passed_over: float = 0.0) -> Gain:
        return gain([JudgedSet("validation", "v.csv", data, before, after)], "position", passed_over)

    better = of(noise + change, noise)
    assert better.t > 5.0
    assert better.changed == pytest.approx(np.sqrt(np.mean(np.sum(change**2, axis=1))))
    assert of(noise, noise + change).t == -better.t
    # Of noise alone, with half of it as a change, little shows.
    ts = [of(own, own - 0.5 * other).t for own, other in rng.normal(0.0, 1e-4, (200, 2, 20, 3))]
    assert np.mean(np.array(ts) > better.needed(0.975)) < 0.05
    # Rows that a robust loss passes over hide nothing.
    wild = noise + np.where(np.arange(20)[:, None] < 2, 0.01, 0.0) * rng.normal(size=(20, 3))
    assert of(wild + change, wild, 0.15).t > 3.0
    assert of(wild + change, wild, 0.15).after < 4e-4 < of(wild + change, wild).after


def test_frames_alone_need_not_be_better(cell: Cell) -> None:
    frames = calib.error_model(cell.robot)
    fit = calib.identify(frames, cell.measured(cell.draw(30)))
    assert "improvement" not in failed(calib.assess(fit, cell.measured(cell.draw(20))))


def test_what_the_user_answers_for_does_not_count(cell: Cell) -> None:
    q = cell.draw(60)
    q[:, 4] = 0.7
    found = calib.assess(calib.identify(cell.model, cell.measured(q[:40])), cell.measured(q[40:]))
    assert failed(found) == {"joints"}
    accepted = found.accepting(["joints"])
    assert (accepted.trusted, accepted.doubts) == (True, ())
    (check,) = (check for check in accepted.checks if check.name == "joints")
    assert check.sentence == (
        "Never moved, or never read: 'wrist_2_joint'. Where a joint is locked, accept = [\"joints\"]. "
        "The job accepts this."
    )
    assert found.accepting(["lengths"]).doubts == found.doubts


# ---- effects that no parameter stands for


@pytest.mark.parametrize("rows", [3, -2])
def test_a_delay_comes_back_in_rows_and_seconds(cell: Cell, rows: int) -> None:
    q = cell.path(500)
    # Measured so many rows after it was read.
    late = np.roll(q, rows, axis=0)[10:-10]
    data = cell.measured(late, q[10:-10])
    parts, C = cell.effects(data)
    found, step = delay(parts, C)
    assert found.value == pytest.approx(rows, abs=max(4.0 * found.sigma, 0.15))
    assert abs(found.t) > 6.0
    assert np.isnan(step)
    assert not of_rows.late(found, step).passed
    assert f"rows {'later' if rows > 0 else 'earlier'} than" in of_rows.late(found, step).sentence
    # With times, five rows a second, the same is told in ms.
    timed, step = delay(*cell.effects(replace(data, times=0.2 * np.arange(len(data)))))
    assert timed.value == pytest.approx(0.2 * found.value, rel=1e-6)
    assert step == pytest.approx(0.2)
    assert f"{1e3 * abs(timed.value):.2g} +- " in of_rows.late(timed, step).sentence
    assert " ms " in of_rows.late(timed, step).sentence


def test_a_delay_is_seen_of_angles_that_are_told_within_a_turn(cell: Cell) -> None:
    q = cell.path(500) + np.pi  # every joint is at the seam where its path crosses zero
    late = np.roll(q, 3, axis=0)[10:-10]
    told = (q[10:-10] + np.pi) % (2.0 * np.pi) - np.pi
    assert np.all(np.ptp(told, axis=0) > 6.0)
    whole, within = (
        delay(*cell.effects(replace(cell.measured(late, read), times=0.2 * np.arange(len(read)))))[0]
        for read in (q[10:-10], told)
    )
    assert within.value == pytest.approx(whole.value, rel=0.05)
    assert within.sigma == pytest.approx(whole.sigma, rel=0.2)


def test_errors_that_grew_though_nothing_of_the_arm_was_free(cell: Cell) -> None:
    fit = calib.identify(calib.error_model(cell.robot), cell.measured(cell.draw(20)))
    data = cell.measured(cell.draw(12))
    before = cell.rng.normal(scale=1e-4, size=(12, 3))
    for factor, passed in ((1.0, True), (1.05, True), (2.0, False), (0.5, True)):
        after = factor * before * cell.rng.uniform(0.98, 1.02, (12, 1))
        check = of_errors.improvement(fit, [JudgedSet("validation", "v.csv", data, before, after)])
        assert check.passed == passed
        assert ("Arm, lens or board is not as it is said to be" in check.sentence) != passed


def braking(q: Array, left: float) -> Array:
    """Where joints are before they reach q (n, k), one row after the other: the farthest has ``left`` to go."""
    moved = np.diff(q, axis=0, prepend=q[:1])
    return np.asarray(q - left * moved / np.maximum(np.abs(moved).max(axis=1, keepdims=True), 1e-9))


@pytest.mark.parametrize("left", [1e-3, -1e-3])
def test_an_arm_that_was_read_before_it_stood(cell: Cell, left: float) -> None:
    # Three tools at every pose; how far it had still to go differs from pose to pose.
    q = cell.draw(80)
    before = braking(q, left * cell.rng.uniform(0.3, 1.7, (80, 1)))
    found = unsettled(*cell.effects(cell.measured(np.repeat(q, 3, axis=0), np.repeat(before, 3, axis=0))))
    assert found.value == pytest.approx(left, rel=0.25)
    check = of_rows.at_rest(found)
    assert not check.passed
    assert ("readings were taken before" in check.sentence) == (left > 0.0)
    assert ("poses were measured before" in check.sentence) == (left < 0.0)


def test_nothing_tells_whether_it_stood_where_rows_are_in_no_order(cell: Cell) -> None:
    q = cell.draw(120)
    data = cell.measured(q, braking(q, 1e-3))
    assert not of_rows.at_rest(unsettled(*cell.effects(data))).passed
    mixed = data.subset(cell.rng.permutation(120))
    assert of_rows.at_rest(unsettled(*cell.effects(mixed))).passed
    # Of rows that were held out the next ones do not know where the arm came from.
    every_other = data.subset(np.arange(0, 120, 2))
    assert np.isnan(unsettled(*cell.effects(every_other)).value)


def test_gaps_of_gears_and_sound_rows_are_no_arm_that_has_not_stood(cell: Cell) -> None:
    q = cell.draw(120)
    gaps = np.sign(np.diff(q, axis=0, prepend=q[:1])) * np.array([1.0, 0.2, 0.6, 0.1, 0.8, 0.3]) * 1e-3
    gains = 5e-4 * q  # in part along the way from the pose before
    for read in (q, q - gaps, q - gains, q - 1e-3 * cell.rng.normal(size=q.shape)):
        assert of_rows.at_rest(unsettled(*cell.effects(cell.measured(q, read)))).passed
    assert of_rows.at_rest(unsettled((), np.eye(1))).passed


def test_a_joint_that_is_late_by_itself_and_readings_that_are_means(cell: Cell) -> None:
    q, t = cell.path(520), 0.1 * np.arange(500)
    true = cell.measured(q)
    rows = slice(10, 510)

    def told(read: Array) -> tuple[Timing, Check]:
        data = true.subset(range(10, 510))
        found = timing(*cell.effects(replace(data, readings=read[rows], times=t)), NO_SCALARS)
        return found, of_rows.timing(found, cell.robot)

    found, check = told(q)
    assert check.passed
    assert np.isnan(check.statistic)
    read = np.array(q)
    read[:-2, 2] = q[2:, 2]
    found, check = told(read)
    # This joint was read two rows before what was measured.
    assert found.by_joint["elbow_joint"].value == pytest.approx(0.2, rel=0.1)
    assert not check.passed
    assert "readings of 'elbow_joint' seem to be" in check.sentence
    # Means over eleven rows, about their middle: no delay, but a width.
    means = np.stack([np.convolve(x, np.ones(11) / 11.0, mode="same") for x in q.T], axis=1)
    found, check = told(means)
    assert 2.0 * found.smoothed.value == pytest.approx(np.mean((0.1 * np.arange(-5, 6)) ** 2), rel=0.1)
    assert not check.passed
    assert "means over times" in check.sentence
    # Rounded readings err from row to row, and that is no motion of the arm.
    assert told(np.round(q, 3))[1].passed
    assert np.isnan(timing(*cell.effects(true.subset(range(10, 510))), NO_SCALARS).step)


def test_a_joint_of_a_stream_that_is_behind_its_reading(cell: Cell) -> None:
    """Backlash shows by the way that the joint goes, more than as a joint that is late."""
    q, rows = cell.path(520), slice(10, 510)
    play = np.array(q)
    play[:, 2] += 1e-3 * np.sign(np.gradient(q[:, 2]))
    data = replace(cell.measured(q).subset(range(10, 510)), times=0.1 * np.arange(500))
    for read, passed in ((q, True), (play, False)):
        found = timing(*cell.effects(replace(data, readings=read[rows])), NO_SCALARS)
        check = of_rows.timing(found, cell.robot)
        assert check.passed == passed
    assert found.ahead["elbow_joint"].value == pytest.approx(-1e-3, rel=0.1)
    assert "'elbow_joint' seems to be" in check.sentence
    assert "mrad behind its reading" in check.sentence
    assert 'backlash = ["elbow_joint"], with in_order = true' in check.sentence


def test_a_gap_shows_where_joints_move_in_turn_and_rest_for_most_of_the_time() -> None:
    """By the way that joints went while they moved, 0.5 mrad of one joint did not show."""
    rng, robot, arm = np.random.default_rng(9), machines.load(*UR10), machines.arm(*UR10)
    u = np.arange(0.0, 100.0, 0.01)
    q, turns, start = np.tile(rng.uniform(-1.0, 1.0, 6), (len(u), 1)), 0, 0.5
    while start < u[-1]:
        joint, far, lasts = turns % 6, rng.uniform(0.2, 0.7) * (-1) ** (turns // 6), rng.uniform(0.6, 1.2)
        x = np.clip((u - start) / lasts, 0.0, 1.0)
        q[:, joint] += far * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        turns, start = turns + 1, start + lasts + rng.uniform(0.2, 0.8)
    machine = machines.Machine(arm.moved(rng), machines.anywhere(rng), {"tool": machines.pose((0.02, 0.03, 0.1))})
    readings = q + rng.normal(0.0, 1e-5, q.shape)
    joints = {f"{name} [rad]": readings[:, k] for k, name in enumerate(arm.ranges)} | {"time [s]": u}
    for gap in (0.0, 5e-4):
        held = np.array(q)
        for n in range(1, len(u)):
            held[n, 1] = np.clip(held[n - 1, 1], q[n, 1] - gap, q[n, 1] + gap)
        points = machine.see(held[50:-50:5])[:, :3, 3] + rng.normal(0.0, 5e-5, (len(u[50:-50:5]), 3))
        seen = {"time [s]": u[50:-50:5]} | {f"{axis} [m]": points[:, k] for k, axis in enumerate("xyz")}
        data = calib.measuring.read_stream(seen, robot, joints, clock="given", sigma=5e-5)
        fit = calib.identify(calib.error_model(robot, offsets="all", placements="all"), data)
        residue = Residue.of(fit, {})
        check = of_rows.timing(timing(stretches(residue), residue.C, fit.machine.frames.scalars), robot)
        assert check.passed == (gap == 0.0)
    assert "'shoulder_lift_joint' seems to be" in check.sentence


def test_a_gain_comes_back(cell: Cell) -> None:
    q = cell.draw(80)
    read = q / np.array([1.0, 1.0, 1.03, 1.0, 1.0, 1.0])
    parts, C = cell.effects(cell.measured(q, read))
    found = gains(parts, C)
    assert found["elbow_joint"].value == pytest.approx(0.03, rel=0.05)
    assert max(found, key=lambda name: found[name].size) == "elbow_joint"


@pytest.mark.parametrize("ratio", [-1.0, -1.02])
def test_a_joint_that_follows_another_by_another_ratio(ratio: float) -> None:
    """What the driver says of itself is right, so that no gain of a joint tells it."""
    urdf, rng = machines.INLINE["mimic"], np.random.default_rng(3)
    robot, arm = machines.load(urdf, "tip"), machines.arm(urdf, "tip").moved(rng)
    joints = tuple(replace(j, multiplier=ratio) if j.name == "level" else j for j in arm.joints)
    tool = {"tool": machines.pose((0.05, 0.02, 0.15))}
    machine = machines.Machine(replace(arm, joints=joints), machines.anywhere(rng), tool)
    own, held_out = (machine.measure(robot, arm.draw(rng, n), rng=rng, sigma=5e-5) for n in (40, 15))
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all"), own)
    residue = Residue.of(fit, {})
    assert ratios(stretches(residue), residue.C)["level", "lift"].value == pytest.approx(-1.0 - ratio, abs=2e-3)
    found = calib.assess(fit, held_out)
    assert found.trusted == (ratio == -1.0)
    gear = next(check for check in found.checks if check.name == "gear")
    said = "'level' seems to move by 2 % more than the multiple says by which it follows 'lift': is that right?"
    assert (gear.passed, said in gear.sentence) == (found.trusted, not found.trusted)


@pytest.mark.parametrize("turned", [0.0, 2e-3])
def test_a_probe_that_turned_between_two_rows(cell: Cell, turned: float) -> None:
    """Its point stays, so that a tool that moves is none: poses alone show the turn."""
    data = cell.machine.measure(cell.robot, cell.draw(30), "pose", rng=cell.rng, sigma=5e-5, sigma_angle=1e-4)
    turns = machines.pose(rotvec=np.where(np.arange(30) >= 12, turned, 0.0)[:, None] * (0.0, 0.0, 1.0))[:, :3, :3]
    model = calib.error_model(cell.robot, offsets="all", placements="all", tool="pose")
    found = calib.assess(calib.identify(model, replace(data, orientation=data.orientation @ turns)))
    assert failed(found) == ({"jump"} if turned else set())
    assert any(f":{data.lines[11]}: after this row the tool seems" in doubt for doubt in found.doubts) == bool(turned)


def test_a_jump_of_the_base_is_found_where_it_is(cell: Cell) -> None:
    data = cell.measured(cell.draw(60))
    moved = data.position + np.where(np.arange(60) >= 25, 1e-3, 0.0)[:, None]
    parts, C = cell.effects(replace(data, position=moved))
    worst = steps(parts, C)[0]
    assert (worst.what, worst.line) == ("base", data.lines[24])
    assert worst.size > 10.0
    assert worst.chance < 1e-20


def test_a_jump_where_the_poses_change_too_may_be_of_the_arm(cell: Cell) -> None:
    """Rows in which one joint is stretched follow the others, and this joint's gear is a milliradian off there."""
    q = cell.draw(60)
    q[:, 2] = np.where(np.arange(60) < 45, 1.0, -1.0) + 0.4 * q[:, 2]
    true = q + np.where(q[:, 2:3] < 0.0, 1e-3, 0.0) * (np.arange(6) == 1)
    moved = cell.measured(cell.draw(60))
    moved = replace(moved, position=moved.position + np.where(np.arange(60) >= 45, 1e-3, 0.0)[:, None])

    def doubt(data: calib.Measurements) -> str:
        found = calib.assess(calib.identify(cell.model, data))
        return next(text for text in found.doubts if "after this row" in text)

    assert "as elbow_joint stood elsewhere before it than after it" in doubt(cell.measured(true, q))
    assert doubt(moved).endswith("separately.")


@pytest.mark.parametrize(("rows", "left"), [(12, 3.0), (13, 6.0), (14, 9.0)])
def test_few_rows_that_are_sound_show_no_jump_and_no_strain(rows: int, left: float) -> None:
    """Where few numbers are left over, directions take up many of them: by F with as many as really remain."""
    for seed in range(4):
        cell = Cell(seed)
        cell.model = calib.error_model(cell.robot, offsets="all", placements="all", terms={"gain": "all"})
        parts, C = cell.effects(cell.measured(cell.draw(rows)))
        assert parts[0].r.size - parts[0].used == pytest.approx(left, abs=1e-3)
        assert all(step.chance > 0.01 for step in steps(parts, C))
        assert all(strain.chance > 0.01 for strain in strains(parts, C))


def test_a_small_jump_in_thirty_rows_is_found() -> None:
    for seed in range(4):
        cell = Cell(seed)
        data = cell.measured(cell.draw(30))
        moved = data.position + np.where(np.arange(30) >= 13, 3e-4, 0.0)[:, None]
        worst = min(steps(*cell.effects(replace(data, position=moved))), key=lambda step: step.chance)
        assert (worst.what, worst.line) == ("base", data.lines[12])
        assert worst.chance < of_rows.RARELY
        assert worst.size > of_rows.SIZE


@pytest.mark.parametrize("tables", [1, 4])
@pytest.mark.parametrize("seed", [1013, 1019, 1027, 1038])
def test_rows_in_several_tables_jump_no_more_often_than_in_one(seed: int, tables: int) -> None:
    """Of gears that wobble, as nobody modelled, three rows at an end of a table seemed to be a change."""
    cell = Cell(seed)
    q = cell.draw(60)
    amplitude, phase = cell.rng.normal(0.0, 4e-4, (2, 6)), cell.rng.uniform(0.0, 6.0, 6)
    whole = cell.measured(q + amplitude[0] * np.cos(2.0 * q + phase) + amplitude[1] * np.sin(q), q, sigma=2e-5)
    residue = Residue.of(
        calib.identify(cell.model, [whole.subset(rows) for rows in np.array_split(np.arange(60), tables)]), {}
    )
    found = steps(stretches(residue), residue.C)
    assert all(step.chance > of_rows.RARELY for step in found if step.size > of_rows.SIZE)


def test_a_jump_in_one_of_several_tables_is_found() -> None:
    for seed in range(4):
        cell = Cell(seed)
        data = cell.measured(cell.draw(80))
        moved = data.position + np.where((np.arange(80) >= 48) & (np.arange(80) < 60), 1e-3, 0.0)[:, None]
        parts = [replace(data, position=moved).subset(rows) for rows in np.array_split(np.arange(80), 4)]
        residue = Residue.of(calib.identify(cell.model, parts), {})
        worst = min(steps(stretches(residue), residue.C), key=lambda step: step.chance)
        assert (worst.what, worst.line) == ("base", data.lines[47])
        assert worst.chance < of_rows.RARELY
        assert worst.size > of_rows.SIZE


def test_what_is_elsewhere_in_all_rows_has_not_jumped(cell: Cell) -> None:
    # Zeros that the fit does not seek are off throughout: of a step that leaves out three rows that is nearly all.
    few = calib.error_model(cell.robot)
    rng = np.random.default_rng(7)
    off = rng.normal(0.0, 5e-3, 6)
    q = rng.uniform(0.3, 1.8, (60, 6))
    data = cell.measured(q, q - off)
    parts, C = cell.effects(data, few)
    assert all(step.size < of_rows.SIZE or step.chance > of_rows.RARELY for step in steps(parts, C))
    assert all(abs(gain.value) < of_rows.GEAR for gain in gains(parts, C).values() if abs(gain.t) > of_rows.SURE)
    # A jump in the middle of them still shows.
    later = np.where(np.arange(60) >= 25, 0.05, 0.0)[:, None] * np.eye(6)[2]
    parts, C = cell.effects(replace(data, readings=data.readings + later), few)
    worst = steps(parts, C)[0]
    assert (worst.what, worst.line) == (cell.robot.readings[2].name, data.lines[24])
    assert worst.size > of_rows.SIZE
    assert worst.chance < of_rows.RARELY


def test_a_base_that_moved_between_two_tables_has_not_jumped_within_one(cell: Cell) -> None:
    one, two, rows = cell.measured(cell.draw(60)), cell.measured(cell.draw(60)), np.arange(60)[:, None]
    moved = replace(two, position=two.position + 3e-4)

    def surely(data: calib.Measurements) -> list[tuple[str, int]]:
        fit = calib.identify(cell.model, [one, data])
        found = steps(stretches(residue := Residue.of(fit, {})), residue.C)
        return [(step.what, step.line) for step in found if step.size > of_rows.SIZE and step.chance < of_rows.RARELY]

    assert surely(moved) == []
    # One that moves within a table as well is found there.
    assert surely(replace(moved, position=moved.position + np.where(rows >= 25, 6e-4, 0.0)))[0] == (
        "base",
        two.lines[24],
    )


def test_a_tool_that_is_stated_wrong_for_all_tables_sets_none_of_them_apart(cell: Cell) -> None:
    known = calib.Known(tools={"tool": machines.pose((0.052, 0.019, 0.151))})
    model = calib.error_model(cell.robot, offsets="all", placements="all", tool="fixed", known=known)

    def told(*sets: calib.Measurements) -> tuple[Step, ...]:
        residue = Residue.of(calib.identify(model, sets), {})
        return apart(stretches(residue), residue.C)

    one, other = (cell.measured(cell.draw(40)) for _ in range(2))
    assert all(step.size < of_rows.SIZE or step.chance > of_rows.RARELY for step in told(one, other))
    elsewhere = replace(cell.machine, tools={"tool": machines.pose((0.058, 0.02, 0.15))})
    moved = elsewhere.measure(cell.robot, other.readings, rng=cell.rng, sigma=5e-5)
    worst = told(one, moved)[0]
    assert worst.what == "tool"
    assert worst.size > of_rows.SIZE


def test_sound_rows_show_no_effect(cell: Cell) -> None:
    for q in (cell.draw(60), cell.path(400)):
        parts, C = cell.effects(cell.measured(q))
        late, _ = delay(parts, C)
        assert not abs(late.value) > 5.0 * late.sigma
        assert all(not abs(gain.t) > 6.0 for gain in gains(parts, C).values())
        assert all(step.size < of_rows.SIZE for step in steps(parts, C))
        assert all(drift.size < 1e-4 for drift in drifts(parts, C))


def test_lengths_that_a_fit_nearly_has_and_a_fit_that_stopped_early_show_no_drift(cell: Cell) -> None:
    """What residuals have along parameters, a hundredth of a number, is no growth of which parameters leave 1e-6."""
    (part,), C = cell.effects(cell.measured(cell.draw(60)))
    q, _ = np.linalg.qr(np.column_stack([part.J.reshape(part.r.size, -1) @ C, cell.rng.normal(size=part.r.size)]))
    along, other = q[:, 0].reshape(part.r.shape), q[:, -1].reshape(part.r.shape)
    growth = 500.0 * (along + 1e-3 * other)
    found = drifts([replace(part, r=part.r + 0.3 * along, by_growth=growth)], C)
    scatter = {drift.what: drift.scatter for drift in found}
    assert scatter[LENGTHS] < 1.2 * scatter["base"]
    assert all(drift.chance > of_rows.RARELY for drift in found)


def test_axes_of_an_instrument_that_are_not_equal(cell: Cell) -> None:
    """However the instrument stands: along none of its own axes, and not at right angles."""
    data = cell.measured(cell.draw(60))
    turn = Rotation.from_rotvec([0.4, -0.7, 0.2]).as_matrix()
    for strain in (np.diag([0.01, 0.0, 0.0]), turn @ np.diag([0.006, -0.004, 0.0]) @ turn.T):
        parts, C = cell.effects(replace(data, position=data.position @ (np.eye(3) + strain)))
        (found,) = strains(parts, C)
        assert found.share == pytest.approx(0.01, rel=0.05)
        assert found.size > 5.0
        assert found.chance < 1e-20
        said = of_rows.axes([found], gains(tuple(pose_by_pose(part, C) for part in parts), C))
        assert not said.passed
        assert said.sentence.endswith("or not at right angles: is its scale right, are coordinates all of one kind?")
    # All of them too long is nothing that these rows can tell from links that are.
    (found,) = strains(*cell.effects(replace(data, position=1.003 * data.position)))
    assert of_rows.axes([found], {}).passed


@pytest.mark.parametrize("slide", [0, 1, 2])
def test_a_slide_that_moves_too_far_is_named_where_it_explains_more_than_an_axis_of_the_instrument(
    tmp_path: Path, slide: int
) -> None:
    """Half a per cent is less than a gear may be off."""
    joints = [("lx", "prismatic", "0 0 0", "0 0 0", "1 0 0"), ("ly", "prismatic", "0 0 0.1", "0 0 0", "0 1 0")]
    joints += [("lz", "prismatic", "0 0 0.2", "0 0 0", "0 0 1"), ("c", "revolute", "0 0 -0.1", "0 0 0", "0 1 0")]
    (tmp_path / "gantry.urdf").write_text(machines.urdf(*joints))
    robot = calib.load_robot(tmp_path / "gantry.urdf", tip="tip")
    rng = np.random.default_rng(4)
    q = rng.uniform([-0.1, -0.1, -0.1, -2.5], [0.7, 0.7, 0.7, 2.5], (60, 4))
    went = q * (1.0 + 5e-3 * (np.arange(4) == slide)) + 1e-4 * np.sin(9.0 * q)
    seen = went[:, :3] + Rotation.from_rotvec(went[:, 3:] * [0.0, 1.0, 0.0]).apply([0.15, 0.03, 0.1])
    seen += rng.normal(scale=2e-5, size=seen.shape)
    model = calib.error_model(robot, offsets="all", placements="all")
    found = calib.assess(calib.identify(model, calib.positions(robot, q, seen, sigma=2e-5)))
    checks = {check.name: check for check in found.checks}
    assert checks["gear"].passed
    assert not checks["axes"].passed
    said = checks["axes"].sentence
    assert f"more is explained if 'l{'xyz'[slide]}' moves by 0." in said
    assert "% more than its reading says: is its gear ratio right" in said


@pytest.mark.parametrize("seed", [7, 9, 11])
def test_of_points_nearly_in_a_plane_the_axis_across_it_tells_nothing(tmp_path: Path, seed: int) -> None:
    """Two axes a milliradian off parallel, gears that wobble; in the plane unequal axes are found as ever."""
    joint = '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="{3} 0 0"/>'
    joint += '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint><link name="{2}"/>'
    links = joint.format("one", "floor", "upper", 0) + joint.format("two", "upper", "lower", 0.5)
    (tmp_path / "planar.urdf").write_text(f'<robot name="planar"><link name="floor"/>{links}</robot>')
    robot = calib.load_robot(tmp_path / "planar.urdf", tip="lower")
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2.2, 2.2, (60, 2))
    waves = 1e-4 * rng.normal(size=(4, 2))
    turned = q + waves[0] * np.cos(q) + waves[1] * np.sin(q) + waves[2] * np.cos(2 * q) + waves[3] * np.sin(2 * q)
    first, second = (
        Rotation.from_rotvec(angle[:, None] * np.eye(3)[2]) for angle in (turned[:, 0] + 2e-3, turned[:, 1])
    )
    tilt = Rotation.from_rotvec([*rng.normal(scale=2e-3, size=2), 4e-3])
    seen = first.apply(np.array([0.501, 0.0, 0.001]) + tilt.apply(second.apply([0.05, 0.03, 0.12])))
    seen += rng.normal(scale=2e-5, size=seen.shape)
    turn = Rotation.random(rng=rng)
    model = calib.error_model(robot, offsets="all", placements="all")

    def told(x: Array) -> bool:
        residue = Residue.of(calib.identify(model, calib.positions(robot, q, x, sigma=2e-5)), {})
        return not of_rows.axes(strains(stretches(residue), residue.C), {}).passed

    assert not told(turn.apply(seen))
    assert told(turn.apply(seen * [1.01, 1.0, 1.0]))


def test_few_lengths_of_each_anchor_have_no_outliers() -> None:
    """Their own places take up most of them, and what is left of most is far smaller than of others."""
    rng = np.random.default_rng(1)
    robot, arm = calib.load_robot(*UR5), machines.arm(*UR5).moved(rng)
    machine = machines.Machine(arm, np.eye(4), {"tool": machines.pose((0.05, 0.02, 0.15))})
    positions = machine.measure(robot, rng.uniform(-2.0, 2.0, (40, 6)), rng=rng, sigma=5e-5)
    q, target, places = rng.uniform(-2.0, 2.0, (16, 6)), np.repeat(np.arange(4), 4), rng.uniform(-1.0, 1.0, (4, 3))
    lengths = np.linalg.norm(machine.see(q)[:, :3, 3] - places[target], axis=1) + rng.normal(0.0, 5e-5, 16)
    columns: dict[str, object] = {f"{r.name} [rad]": q[:, k] for k, r in enumerate(robot.readings)}
    columns |= {"length [m]": lengths, "target": [f"anchor {t}" for t in target]}
    data = [positions, calib.read_measurements(columns, robot, "distance", sigma=5e-5)]
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all", base="fixed"), data)
    own = [JudgedSet("identification", d.where, d, r, r) for d, r in zip(fit.measurements, fit.residuals, strict=True)]
    assert of_rows.outliers(fit, own).passed
    gross = own[0].after.copy()
    gross[:3] += 5e-4
    found = of_rows.outliers(fit, [own[0]._replace(after=gross), own[1]])
    assert not found.passed
    # Sound rows of an arm with a screw that nobody told looked like this, and were to be removed.
    assert found.sentence.endswith(
        ": they are wrong, or the arm does there what the model leaves out; look at them before any is removed."
    )


def test_rounded_readings_count_where_they_are_what_remains(cell: Cell) -> None:
    q = cell.draw(60)
    whole = np.radians(np.round(np.degrees(q)))
    parts, _ = cell.effects(cell.measured(q, whole))
    (found,) = rounding(parts, cell.robot)
    # As the tip of an independent arm is moved by readings that are off by as much.
    moved = cell.machine.see(whole + np.radians(cell.rng.uniform(-0.5, 0.5, q.shape))) - cell.machine.see(whole)
    assert found.distance == pytest.approx(np.sqrt(np.mean(np.sum(moved[:, :3, 3] ** 2, axis=1))), rel=0.2)
    assert found.share == pytest.approx(1.0, abs=0.3)
    fit = calib.identify(cell.model, cell.measured(q, whole))
    assert not of_rows.resolution([found], fit).passed
    # Where the arm went to whole degrees, nothing was rounded.
    parts, _ = cell.effects(cell.measured(whole))
    (found,) = rounding(parts, cell.robot)
    assert found.share > 10.0
    assert of_rows.resolution([found], fit).passed
    assert rounding(cell.effects(cell.measured(q))[0], cell.robot) == ()


def test_a_base_that_wanders_by_centimetres(cell: Cell) -> None:
    data = cell.measured(cell.draw(60))
    drift = np.linspace(0.0, 0.03, 60)[:, None] * np.array([1.0, 0.0, 0.0])
    worst = drifts(*cell.effects(replace(data, position=data.position + drift)))[0]
    assert worst.what == "base"
    assert 3e-3 < worst.size < 2e-2
    assert worst.chance < 1e-10


def _warmer(cell: Cell, q: Array) -> Array:
    """What is measured of an arm that grows by 1 mm in a metre, with its tool."""
    seen = cell.measured(q).position
    return np.asarray(seen + np.linspace(0.0, 1e-3, len(q))[:, None] * (seen - cell.machine.base[:3, 3]))


def _slipping(cell: Cell, q: Array) -> Array:
    """What is measured of an arm whose third zero moves by 2 mrad."""
    moved = q + np.linspace(0.0, 2e-3, len(q))[:, None] * np.eye(6)[2]
    return np.asarray(cell.measured(moved).position)


def _loosening(cell: Cell, q: Array) -> Array:
    """What is measured of a tool that moves by 1 mm in its own frame."""
    shift = np.linspace(0.0, 1e-3, len(q))[:, None] * np.array([0.6, 0.0, 0.8])
    return np.asarray(cell.measured(q).position + np.einsum("nij,nj->ni", cell.machine.see(q)[:, :3, :3], shift))


@pytest.mark.parametrize(
    ("seen", "what", "cause"),
    [
        (_warmer, LENGTHS, "let it warm up before it is measured"),
        (_slipping, "elbow_joint", "the joint or its encoder moved"),
        (_loosening, "tool", "the tool, or what it carries, moved"),
    ],
)
def test_what_drifts_by_a_millimetre_is_named(seen, what: str, cause: str) -> None:
    cell = Cell(5)
    q = cell.draw(60)
    data = replace(cell.measured(q), position=seen(cell, q))
    fit = calib.identify(cell.model, data)
    check = of_rows.drift(drifts(*cell.effects(data)), fit)
    assert not check.passed
    assert what in check.sentence
    assert check.sentence.endswith(f"{cause}.")


def test_a_poor_arm_that_goes_along_a_joint_does_not_drift() -> None:
    """Its gears wobble by 10 mrad, with the order of the rows, far more than the instrument errs."""
    cell = Cell(6)
    q = cell.draw(100)
    for k in range(3):
        read = q[np.argsort(q[:, k])]
        data = cell.measured(read + 0.01 * np.cos(2.0 * read + np.arange(6)), read)
        told = drifts(*cell.effects(data))
        assert any(drift.chance < of_rows.RARELY for drift in told)
        assert of_rows.drift(told, calib.identify(cell.model, data)).passed


@pytest.mark.parametrize(("poses", "passed"), [(11, False), (20, True)])
def test_poses_that_are_measured_again_judge_no_model(cell: Cell, poses: int, passed: bool) -> None:
    """At eleven poses a bad arm is followed exactly, however often each is measured."""
    data = cell.measured(np.repeat(cell.draw(poses), 5, axis=0))
    wrong = 2e-3 * np.sin(3.0 * data.readings[:, :3])
    fit = calib.identify(cell.model, replace(data, position=data.position + wrong))
    assert sum(noise.degrees_of_freedom for noise in fit.noise_by_rows) > 100.0
    check = of_fit.redundancy(fit)
    assert check.passed == passed
    assert f"{12 * poses} of them at the same poses again" in check.sentence


@pytest.mark.parametrize(("poses", "moved"), [(13, 0.0), (16, 3e-3)], ids=["sound", "a base that moved"])
def test_poses_that_are_measured_again_err_alike(poses: int, moved: float) -> None:
    """A gear that wobbles errs alike in all five rows of a pose, which is no jump between poses; a moved base is."""
    by_row, by_pose = 0, 0
    for seed in range(3):
        own = Cell(seed)
        q = np.repeat(own.draw(poses), 5, axis=0)
        data, wrong = own.measured(q), 5e-4 * np.sin(3.0 * q[:, :3] + 1.0)
        wrong[40:] += moved
        residue = Residue.of(calib.identify(own.model, replace(data, position=data.position + wrong)), {})
        parts = stretches(residue)
        whole = tuple(pose_by_pose(part, residue.C) for part in parts)
        assert len(whole[0].r) == poses
        by_row += any(step.chance < of_rows.RARELY for step in steps(parts, residue.C))
        by_pose += any(step.chance < of_rows.RARELY for step in steps(whole, residue.C))
    assert by_row > 0
    assert by_pose == (3 if moved else 0)


def test_a_pose_on_both_sides_of_a_rounding_is_one_pose(cell: Cell) -> None:
    poses = 20
    q = np.round(cell.draw(poses), 3) + 5e-4
    q = np.repeat(q, 5, axis=0) + 1e-5 * cell.rng.standard_normal((5 * poses, q.shape[1]))
    assert (
        f"{12 * poses} of them at the same poses again"
        in of_fit.redundancy(calib.identify(cell.model, cell.measured(q))).sentence
    )


def test_what_is_measured_at_one_pose_in_other_ways_is_no_repetition(cell: Cell) -> None:
    q = np.repeat(cell.draw(10), 2, axis=0)
    both = cell.measured(q)
    (other,) = (calib.positions(cell.robot, q, both.position, sigma=5e-5, tool=["a", "b"] * 10),)
    assert "again" not in of_fit.redundancy(calib.identify(cell.model, other)).sentence


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("off", [0, 4])
def test_what_comes_little_by_little_is_no_jump(seed: int, off: int) -> None:
    """On smooth paths of another simulator, gears made 3 of 9 sound sessions look as if the base moved near the end."""
    rng = np.random.default_rng(seed)
    row, D = np.arange(300), np.full((300, 3), 2.0)
    noise = rng.standard_normal(D.shape)
    at_once = np.where(row < 260, -1.0, 0.0)[:, None] * D
    slowly = np.clip((row - 275.0) / 30.0, -1.0, 0.0)[:, None] * D
    assert _at_once(at_once + noise, D, 260 + off, 5)
    assert not _at_once(slowly + noise, D, 260 + off, 5)
    # Where it moves nothing, nothing is told.
    assert not _at_once(noise, np.where(row[:, None] < 200, D, 0.0), 260 + off, 5)


def test_a_base_that_moved_along_a_smooth_path_is_told() -> None:
    made, rng, rows = lab(39, noise=2e-5), np.random.default_rng(139), 300
    low, high = np.transpose(list(made.machine.arm.ranges.values()))
    waves = rng.uniform(1.5, 4.0, len(low)) * 0.02 * np.arange(rows)[:, None] + rng.uniform(0.0, 6.0, len(low))
    q = (low + high) / 2.0 + 0.3 * np.minimum(high - low, 4.0) * np.sin(waves)
    gears = np.sin(q + rng.uniform(0.0, 6.0, len(low))) + np.sin(2.0 * q + rng.uniform(0.0, 6.0, len(low)))
    seen = []
    for moved in (0.0, 3e-4):
        x = made.where(q + 5e-5 * gears) + made.scatter(rows, 3)
        x[rows // 2 :, 0] += moved
        data = made.read(q, "position", **dict(zip(("x_m", "y_m", "z_m"), x.T, strict=True)))
        fit = calib.identify(calib.error_model(made.robot, offsets="all", placements="all"), data)
        (jump,) = (check for check in calib.assess(fit).checks if check.name == "jump")
        seen.append(jump.passed)
    assert seen == [True, False]


# ---- photographs


@pytest.mark.parametrize("moved", [0.0, 0.004])
def test_a_board_that_moved_between_photographs_is_told(moved: float) -> None:
    """Photographs that err together have the change in how they err, beside which it hardly shows mark by mark."""
    rng = np.random.default_rng(0)
    robot = machines.load(cameras.UR5, cameras.TIP)
    true = cameras.scene(rng, machines.arm(cameras.UR5, cameras.TIP).moved(rng), "tip", sigma=0.1)
    later = replace(true, target=true.target @ machines.pose((moved, 0.5 * moved, 0.0), (0.0, 0.0, moved)))
    q = true.draw(rng, 40)
    first, then = (scene.measure(robot, q, rng, 0.1) for scene in (true, later))
    seen = replace(first, value=np.where(np.arange(len(first))[:, None] < 400, first.value, then.value))
    model = calib.error_model(robot, offsets="all", placements="all", base="fixed", tool="pose")
    found = calib.assess(calib.identify(model, seen), []).accepting(["lens"])
    (jump,) = (check for check in found.checks if check.name == "jump")
    assert jump.passed == (moved == 0.0)
    assert found.trusted == jump.passed
    said = "arrays:399: after this row the base, or the board or camera that stands beside it, seems to have changed"
    assert jump.sentence.startswith(said) == (moved > 0.0)


# ---- what is plausible


@pytest.mark.parametrize("placements", ["all", calib.dh.Free(), calib.dh.Free(convention="modified")])
@pytest.mark.parametrize(("factor", "passed"), [(1.05, False), (0.98, False), (1.01, True)])
def test_lengths_that_are_all_too_long(
    cell: Cell, factor: float, passed: bool, placements: str | calib.dh.Free
) -> None:
    """By DH numbers as well: of these it was said that no lengths are free, and 5 % more length was trusted."""
    base, tools = cell.machine.base, cell.machine.tools
    arm = machines.arm(*UR5)
    longer = [replace(j, origin=lengthened(j.origin, factor)) for j in arm.joints]
    true = machines.Machine(replace(arm, joints=tuple(longer)), base, tools)
    model = calib.error_model(cell.robot, offsets="all", placements=placements)
    fit = calib.identify(model, true.measure(cell.robot, cell.draw(60), rng=cell.rng, sigma=5e-5))
    check = of_arm.lengths(fit, of_arm.common_scale(fit, stretches(Residue.of(fit, {}))))
    assert check.statistic == pytest.approx(abs(factor - 1.0), rel=0.1)
    assert check.passed == passed


@pytest.mark.parametrize(("factor", "known", "said"), [(1.01, False, True), (1.0, False, False), (1.01, True, False)])
def test_an_instrument_that_may_be_off_by_its_scale_is_named(
    cell: Cell, factor: float, known: bool, said: bool
) -> None:
    """Of an instrument 1 % off it was only said that links are longer: tools were off by 6 mm, regions by 0.1 mm."""
    q = cell.draw(60)
    seen = cell.machine.see(q)
    seen[:, :3, 3] = factor * seen[:, :3, 3] + cell.rng.normal(scale=5e-5, size=(60, 3))
    table = machines.table(cell.machine.arm, q, seen, "position")
    model = calib.error_model(cell.robot, offsets="all", placements="none" if known else "all")
    found = calib.assess(calib.identify(model, calib.read_measurements(table, cell.robot, sigma=5e-5)))
    sentences = [one for one in found.shown if "as they would by a wrong scale of the instrument" in one]
    assert len(sentences) == said


@pytest.mark.parametrize(("factor", "passed"), [(1.05, False), (0.97, False), (1.0, True)])
def test_lengths_of_a_scara_that_are_all_too_long(factor: float, passed: bool) -> None:
    """Axes that should be parallel are not quite: by metres along them everything else could take up the lengths."""
    scara = machines.INLINE["scara"]
    robot, drawn, rng = machines.load(scara, "tip"), machines.arm(scara, "tip"), np.random.default_rng(8)
    longer = replace(drawn, joints=tuple(replace(j, origin=lengthened(j.origin, factor)) for j in drawn.joints))
    made = longer.moved(rng)
    true = machines.Machine(made, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.03, 0.12))})
    model = calib.error_model(robot, offsets="all", placements="all")
    fit = calib.identify(model, true.measure(robot, made.draw(rng, 60), rng=rng, sigma=5e-5))
    check = of_arm.lengths(fit, of_arm.common_scale(fit, stretches(Residue.of(fit, {}))))
    assert check.statistic == pytest.approx(abs(factor - 1.0), abs=5e-3)
    assert check.passed == passed


def test_limits_of_a_slide_that_stand_for_none_make_no_check_blunt() -> None:
    """Errors are judged by the size of an arm: URDFs of arms on rails have 999999 there."""
    text = machines.urdf(
        ("rail", "prismatic", "0 0 0.1", "0 0 0", "0 1 0"),
        ("joint_1", "revolute", "0 0 0.3", "0 0 0", "0 0 1"),
        ("joint_2", "revolute", "0.1 0 0.1", "0 0 0", "0 1 0"),
        ("joint_3", "revolute", "0 0 0.4", "0 0 0", "0 1 0"),
        ("joint_4", "revolute", "0.3 0 0.1", "0 0 0", "1 0 0"),
        ("joint_5", "revolute", "0.1 0 0", "0 0 0", "0 1 0"),
        ("joint_6", "revolute", "0.1 0 0", "0 0 0", "1 0 0"),
    )
    drawn, rng = machines.arm(text, "tip"), np.random.default_rng(4)
    true = machines.Machine(drawn.moved(rng), np.eye(4), {"tool": machines.pose((0.05, 0.03, 0.12))})
    readings, seen = drawn.draw(rng, 60), []
    for limited in (text, text.replace('lower="-0.1" upper="0.7"', 'lower="-999999" upper="999999"')):
        robot = machines.load(limited, "tip")
        data = true.measure(robot, readings, rng=np.random.default_rng(5), sigma=5e-5)
        found = calib.assess(calib.identify(calib.error_model(robot, offsets="all", placements="all"), data))
        assert calib.check(found.fit.model, data) == ()
        seen.append(found.checks)
    assert [(one.name, one.passed) for one in seen[0]] == [(one.name, one.passed) for one in seen[1]]
    limits, stand_for_none = ([one.threshold for one in checks] for checks in seen)
    np.testing.assert_allclose(limits, stand_for_none, rtol=1e-3)


@pytest.mark.parametrize(("factor", "passed"), [(1.0, True), (1.05, False), (0.98, False)])
def test_lengths_of_an_arm_of_millimetres_are_judged_by_its_size(factor: float, passed: bool) -> None:
    """None of its lengths moves the tool by the millimetres that those of usual arms do."""
    text = machines.urdf(
        ("joint_1", "revolute", "0 0 12e-4", "0 0 0", "0 0 1"),
        ("joint_2", "revolute", "2e-4 0 4e-4", "0 0 0", "0 1 0"),
        ("joint_3", "revolute", "0 0 16e-4", "0 0 0", "0 1 0"),
        ("joint_4", "revolute", "8e-4 0 1e-4", "0 0 0", "1 0 0"),
        ("joint_5", "revolute", "7e-4 0 0", "0 0 0", "0 1 0"),
        ("joint_6", "revolute", "3e-4 0 0", "0 0 0", "1 0 0"),
    )
    robot, drawn, rng = machines.load(text, "tip"), machines.arm(text, "tip"), np.random.default_rng(8)
    longer = replace(drawn, joints=tuple(replace(j, origin=lengthened(j.origin, factor)) for j in drawn.joints))
    made = longer.moved(rng, length=2e-6)
    true = machines.Machine(made, np.eye(4), {"tool": machines.pose((2e-4, 1e-4, 4e-4))})
    model = calib.error_model(robot, offsets="all", placements="all")
    fit = calib.identify(model, true.measure(robot, made.draw(rng, 60), rng=rng, sigma=1e-7))
    check = of_arm.lengths(fit, of_arm.common_scale(fit, stretches(Residue.of(fit, {}))))
    assert check.statistic == pytest.approx(abs(factor - 1.0), abs=5e-3)
    assert check.passed == passed


@pytest.mark.parametrize("placements", ["all", calib.dh.Free()])
@pytest.mark.parametrize(("factor", "passed"), [(1.0, True), (1.03, False)])
def test_lengths_may_be_those_of_fixed_joints(factor: float, passed: bool, placements: str | calib.dh.Free) -> None:
    """Every joint stands at zero in a fixed one: nothing told of lengths that are all 3 % longer."""
    steps = (
        ("0 0 0.29", "0 0 1"),
        ("0.07 0 0", "0 1 0"),
        ("0 0 0.6", "0 1 0"),
        ("0.4 0 0.1", "1 0 0"),
        ("0.3 0 0", "0 1 0"),
        ("0.09 0 0", "1 0 0"),
    )
    text = machines.urdf(
        *(
            joint
            for k, (xyz, axis) in enumerate(steps, start=1)
            for joint in (
                (f"mount_{k}", "fixed", xyz, "0 0 0", "0 0 0"),
                (f"joint_{k}", "revolute", "0 0 0", "0 0 0", axis),
            )
        )
    )
    robot, drawn, rng = machines.load(text, "tip"), machines.arm(text, "tip"), np.random.default_rng(8)
    made = replace(drawn, joints=tuple(replace(j, origin=lengthened(j.origin, factor)) for j in drawn.joints)).moved(
        rng
    )
    true = machines.Machine(made, np.eye(4), {"tool": machines.pose((0.05, 0.03, 0.12))})
    model = calib.error_model(robot, offsets="all", placements=placements)
    fit = calib.identify(model, true.measure(robot, made.draw(rng, 60), rng=rng, sigma=5e-5))
    check = of_arm.lengths(fit, of_arm.common_scale(fit, stretches(Residue.of(fit, {}))))
    assert check.statistic == pytest.approx(abs(factor - 1.0), abs=3e-3)
    assert check.passed == passed


def test_a_short_link_of_a_crane_is_no_share_of_all_lengths() -> None:
    """What its boom's travel does not take up of lengths is one of half a metre: 9 mm of 24 m are no other crane."""
    text = machines.urdf(
        ("slew", "revolute", "0 0 3", "0 0 0", "0 0 1"),
        ("luff", "revolute", "0.5 0 0", "0 0 0", "0 -1 0"),
        ("boom", "prismatic", "8 0 0", "0 0 0", "1 0 0"),
        ("jib", "revolute", "0.5 0 0", "0 0 0", "0 1 0"),
        ("turn", "revolute", "2 0 0", "0 0 0", "1 0 0"),
    )
    robot, arm, rng = machines.load(text, "tip"), machines.arm(text, "tip"), np.random.default_rng(2)
    off = [replace(j, origin=lengthened(j.origin, 1.018 if j.name == "luff" else 1.0)) for j in arm.joints]
    made = replace(arm, joints=tuple(off))
    true = machines.Machine(made, np.eye(4), {"tool": machines.pose((0.6, 0.4, 0.5))})
    model = calib.error_model(robot, offsets="all", placements="all")
    fit = calib.identify(model, true.measure(robot, made.draw(rng, 50), rng=rng, sigma=2e-4))
    check = of_arm.lengths(fit, of_arm.common_scale(fit, stretches(Residue.of(fit, {}))))
    assert check.passed, check.sentence


@pytest.mark.parametrize(("by", "passed"), [(0.02, True), (0.07, False)])
def test_a_joint_that_is_far_beside_its_place_is_another_robot(cell: Cell, by: float, passed: bool) -> None:
    """Across its link, where no length of the URDF is another."""
    arm = machines.arm(*UR5)
    off = [
        replace(j, origin=j.origin @ machines.pose((by, 0.0, 0.0))) if j.name == "wrist_2_joint" else j
        for j in arm.joints
    ]
    true = machines.Machine(replace(arm, joints=tuple(off)), cell.machine.base, cell.machine.tools)
    fit = calib.identify(cell.model, true.measure(cell.robot, cell.draw(60), rng=cell.rng, sigma=5e-5))
    check = of_arm.lengths(fit, of_arm.common_scale(fit, stretches(Residue.of(fit, {}))))
    assert check.passed == passed
    beside = "Joint 'wrist_2_joint' is 70 mm beside its place in the URDF: is it the URDF of this robot?"
    assert (check.sentence == beside) != passed


@pytest.mark.parametrize("factor", [1.0, 0.97, 1.03])
def test_a_known_distance_of_sockets_tells_the_share_of_all_lengths(factor: float) -> None:
    """No touch of a socket tells the size: it is the stated distance alone, right or wrong."""
    made = lab(noise=3e-5)
    right = between("distance", "a", "b", 1e-5)
    known = calib.Known(relations=[replace(right, value=factor * right.value)])
    model = calib.error_model(made.robot, offsets="all", placements="all", base="fixed", known=known)
    fit = calib.identify(model, made.sockets(25))
    check = of_arm.lengths(fit, of_arm.common_scale(fit, stretches(Residue.of(fit, {}))))
    assert check.statistic == pytest.approx(abs(factor - 1.0), abs=5e-3)
    assert check.passed == (factor == 1.0)


@pytest.mark.parametrize("factor", [1.0, 0.95, 1.05])
def test_the_lengths_of_an_arm_tell_that_the_print_of_a_board_is_not_as_stated(factor: float) -> None:
    """No photograph tells the size: the board's prior held its scale, and the whole arm was longer instead."""
    rng = np.random.default_rng(3)
    robot = machines.load(cameras.UR5, cameras.TIP)
    arm = machines.arm(cameras.UR5, cameras.TIP).moved(rng)
    true = cameras.scene(rng, arm, "tip", places=cameras.BOARD / factor, sigma=0.1)
    seen = cameras.photographed(robot, true, 30, true.camera, Board(), rng, 0.1)
    model = calib.error_model(robot, offsets="all", placements="all", base="fixed", tool="pose")
    fit = calib.identify(model, seen)
    assert "board.scale" in [parameter.name for parameter in fit.parameters]
    check = of_arm.lengths(fit, of_arm.common_scale(fit, stretches(Residue.of(fit, {}))))
    assert check.statistic == pytest.approx(abs(factor - 1.0), abs=8e-3)
    assert check.passed == (factor == 1.0)


def test_a_share_of_lengths_that_hardly_move_the_tool_is_no_other_robot() -> None:
    """Of three slides and a short wrist a free base, tool and zeros take up all lengths but a few millimetres."""
    text = machines.urdf(
        ("slide_x", "prismatic", "0 0 1.5", "0 0 0", "1 0 0"),
        ("slide_y", "prismatic", "0 0 0.1", "0 0 0", "0 1 0"),
        ("slide_z", "prismatic", "0.1 0 0", "0 0 0", "0 0 -1"),
        ("turn", "revolute", "0 0 -0.2", "0 0 0", "0 0 1"),
        ("tilt", "revolute", "0 0.02 -0.08", "0 0 0", "0 1 0"),
        ("roll", "revolute", "0 0 -0.1", "0 0 0", "0 0 -1"),
    )
    robot, arm, seen = machines.load(text, "tip"), machines.arm(text, "tip"), []
    model = calib.error_model(robot, offsets="all", placements="all")
    for seed in range(4):
        rng = np.random.default_rng(seed)
        made, tool = arm.moved(rng), {"tool": machines.pose((0.05, 0.03, 0.12))}
        true = machines.Machine(made, machines.anywhere(rng), tool)
        fit = calib.identify(model, true.measure(robot, made.draw(rng, 30), rng=rng, sigma=5e-5))
        check = of_arm.lengths(fit, of_arm.common_scale(fit, stretches(Residue.of(fit, {}))))
        assert check.passed
        seen.append(check.sentence)
    assert "Little tells whether all links are longer than in the URDF." in seen


@pytest.mark.parametrize(("arm", "factor"), [("gantry", 1.0), ("ur10", 1.0), ("ur10", 1.03)])
def test_of_distances_between_two_poses_a_share_of_lengths_is_judged_by_the_tool(arm: str, factor: float) -> None:
    """They show nothing of the base, so that a share of a fraction of a millimetre seemed to be many metres."""
    made = lab(noise=5e-5, arm=UR10 if arm == "ur10" else (machines.INLINE[arm], "tip"))
    data = made.pairs(100)
    model = calib.error_model(made.robot, offsets="all", placements="all", base="fixed")
    fit = calib.identify(model, replace(data, value=factor * data.value))
    check = of_arm.lengths(fit, of_arm.common_scale(fit, stretches(Residue.of(fit, {}))))
    assert check.passed == (factor == 1.0)


XARM7 = ("example:xarm_description/urdf/xarm7.urdf", "link_eef")


@pytest.mark.parametrize("arm", [UR10, XARM7])
@pytest.mark.parametrize("factor", [1.0, 0.97])
def test_of_a_ball_a_share_of_lengths_is_judged_by_the_tool(factor: float, arm: tuple[str, str]) -> None:
    """The ball of the probe that was not counted: 3 % of a radius is half a millimetre, and of the arm centimetres.

    Half a millimetre is also what links are off: rows alone did not tell that it was one share.
    """
    made = lab(noise=1e-5, arm=arm)
    data = made.sphere(100)
    model = calib.error_model(made.robot, offsets="all", placements="all", base="fixed")
    fit = calib.identify(model, replace(data, value=factor * data.value))
    check = of_arm.lengths(fit, of_arm.common_scale(fit, stretches(Residue.of(fit, {}))))
    assert check.passed == (factor == 1.0)


def test_lengths_that_nothing_tells_are_said_in_words(fit: calib.Fit) -> None:
    nothing = of_arm.common_scale(fit, ())
    assert np.isnan(nothing).all()
    assert of_arm.lengths(fit, nothing).sentence == "Nothing tells whether all links are longer than in the URDF."


def test_a_tool_beyond_reach(fit: calib.Fit) -> None:
    assert of_arm.tool_and_base(fit).passed
    tools = np.array(fit.machine.frames.tools)
    tools[:, 0, 3] += 5.0
    frames = replace(fit.machine.frames, tools=tools)
    assert not of_arm.tool_and_base(replace(fit, machine=replace(fit.machine, frames=frames))).passed


# ---- remarks


def test_narrowed_priors_are_remarked(fit: calib.Fit) -> None:
    assert remarks(fit) == ()
    (finding,) = remarks(replace(fit, narrowed=10.0))
    assert finding.code == "priors-narrowed"
    assert "made 10 times narrower" in finding.sentence
    # What did not converge has a doubt, which is more.
    assert remarks(replace(fit, narrowed=100.0, converged=False)) == ()
    # Values that were found in another way were searched without any.
    assert with_values(replace(fit, narrowed=10.0), fit.values, fit.machine).narrowed == 1.0


def test_a_sigma_that_is_too_large_is_remarked(cell: Cell) -> None:
    data = cell.measured(cell.draw(40))
    fit = calib.identify(cell.model, replace(data, sigma=5.0 * data.sigma))
    (finding,) = remarks(fit)
    assert finding.code == "sigma-too-large"
    assert "sigma seems 5 times too large" in finding.sentence
    assert of_errors.prediction(fit, machine_of(fit), []).passed


def input_of(fit: calib.Fit, findings: tuple[Finding, ...] | None = None) -> Check:
    """The check of what looks wrong in the input."""
    (check,) = (check for check in calib.assess(fit, findings=findings).checks if check.name == "input")
    return check


def test_a_table_that_is_explained_far_worse_than_the_others_is_remarked() -> None:
    """As of a set-up whose load nobody told: its base is its own, so that nothing else differs from the other rows."""
    cell = Cell(9)
    one, other = (replace(cell.measured(cell.draw(40)), where=name) for name in ("a.csv", "b.csv"))
    more = np.random.default_rng(4).normal(size=other.position.shape) * 8.0 * other.sigma
    poor = replace(other, position=other.position + more)
    assert remarks(calib.identify(cell.model, [one, other])) == ()
    (finding,) = remarks(calib.identify(cell.model, [one, poor]))
    assert finding.code == "unlike-tables"
    assert finding.sentence.startswith("b.csv: the position residuals scatter ")
    # Its sigma says so, or nobody states one.
    assert remarks(calib.identify(cell.model, [one, replace(poor, sigma=8.0 * poor.sigma)])) == ()
    assert remarks(calib.identify(cell.model, [one, replace(poor, sigma=np.zeros_like(poor.sigma))])) == ()


@pytest.mark.parametrize(("factor", "passed"), [(1.0, True), (1.01, True), (1.04, False)])
def test_a_scale_of_a_board_that_is_far_from_what_is_stated_is_doubted(factor: float, passed: bool) -> None:
    """Few lengths are free, so that photographs tell the size, and the prior holds it back."""
    rng = np.random.default_rng(3)
    robot, arm = machines.load(cameras.UR5, cameras.TIP), machines.arm(cameras.UR5, cameras.TIP)
    true = cameras.scene(rng, arm, "tip", places=cameras.BOARD / factor, sigma=0.1)
    seen = cameras.photographed(robot, true, 30, true.camera, Board(), rng, 0.1)
    fit = calib.identify(calib.error_model(robot, offsets="all", base="fixed", tool="pose"), seen)
    check = input_of(fit, ())
    assert check.passed == passed, check
    assert check.sentence.startswith("board.scale is found -3.") != passed


@pytest.mark.parametrize("off", [1e-4, 0.02])
def test_distortion_that_is_far_from_what_is_stated_is_doubted(off: float) -> None:
    """It was held back by a wrong lens_sigma and trusted."""
    rng = np.random.default_rng(3)
    robot, arm = machines.load(cameras.UR5, cameras.TIP), machines.arm(cameras.UR5, cameras.TIP)
    true = cameras.scene(rng, arm, "tip", sigma=0.1)
    camera = replace(true.camera, k1=true.camera.k1 + off, free=("k1",), lens_sigma={"k1": 1e-3})
    seen = cameras.photographed(robot, true, 30, camera, Board(), rng, 0.1)
    fit = calib.identify(calib.error_model(robot, offsets="all", base="fixed", tool="pose"), seen)
    check = input_of(fit)
    assert check.passed == (off < 1e-3), check
    assert check.passed or check.sentence.startswith("lens.k1 is found -0.02 +- ")
    assert "board" not in check.sentence


def test_a_table_that_asks_for_a_base_of_its_own() -> None:
    cell = Cell(9)
    one, other = (replace(cell.measured(cell.draw(40)), where=name) for name in ("a.csv", "b.csv"))
    moved = replace(other, position=other.position + np.array([2e-3, 0.0, 1e-3]))
    sound = calib.assess(calib.identify(cell.model, [one, other]))
    assert sound.trusted
    found = calib.assess(calib.identify(cell.model, [one, moved]))
    (check,) = (check for check in found.checks if check.name == "groups")
    assert not check.passed
    assert "it fits better with a base of its own" in check.sentence


def test_a_table_that_asks_for_a_tool_of_its_own_however_much() -> None:
    """The noise of a table is estimated with what it lacks in it: its size is judged by what remains all the same."""
    cell = Cell(9)
    one, other = (replace(cell.measured(cell.draw(40)), where=name) for name in ("a.csv", "b.csv"))
    sizes = []
    for shift in (1e-3, 10e-3):
        T = cell.machine.see(other.readings)[:, :3, :3]
        moved = replace(other, position=other.position + T @ np.array([shift, 0.0, 0.0]))
        found = calib.assess(calib.identify(cell.model, [one, moved]))
        (check,) = (check for check in found.checks if check.name == "groups")
        assert not check.passed
        assert "it fits better with a tool of its own" in check.sentence
        sizes.append(check.statistic)
    assert sizes[1] > 5.0 * sizes[0]


@pytest.mark.parametrize("seed", range(3))
def test_photographs_of_an_arm_that_does_not_come_back_are_of_one_machine(seed: int) -> None:
    """It comes back to half a millimetre and 1 mrad; and the same where half the photographs are of another arm."""
    rng = np.random.default_rng(seed)
    robot, arm = machines.load(cameras.UR5, cameras.TIP), machines.arm(cameras.UR5, cameras.TIP)
    true = cameras.scene(rng, arm, "tip", sigma=0.05)
    readings = true.draw(rng, 60)
    off = np.stack([machines.pose(*rng.normal(size=(2, 3)) * [[5e-4], [1e-3]]) for _ in readings])
    model = calib.error_model(robot, offsets=["elbow_joint"], base="fixed", tool="pose")
    for sagged in (0.0, 0.02):
        other = readings + sagged * (np.arange(60) % 2)[:, None] * np.eye(6)[1]
        seen = true.measure(robot, other, rng, 0.05, off)
        fit = calib.identify(model, replace(seen, readings=np.repeat(readings, len(cameras.BOARD), axis=0)))
        assert fit.together[0] is not None
        (check,) = (check for check in calib.assess(fit).checks if check.name == "one machine")
        assert check.passed == (sagged == 0.0), (check, fit.together[0])


# ---- what is stated of targets


def lengths_from_anchors(stated: Mapping[str, tuple[float, float, float]], *, rows: int = 75) -> calib.Calibration:
    """What is said of lengths from three anchors, in places that are stated."""
    made = lab(noise=3e-5)
    anchors = {"a": (1.3, 0.2, 0.1), "b": (-0.4, 1.2, -0.1), "c": (0.2, -1.1, 0.9)}
    q, names = made.draw(rows), np.resize(list(anchors), rows).tolist()
    lengths = np.linalg.norm(made.where(q) - [anchors[name] for name in names], axis=1) + made.scatter(rows)
    data = made.read(q, "distance", length_m=lengths, target=names)
    known = calib.Known(targets={name: Target(machines.pose(place)) for name, place in (anchors | stated).items()})
    model = calib.error_model(made.robot, offsets="all", placements="all", base="fixed", known=known)
    return calib.assess(calib.identify(model, data))


def test_an_anchor_that_is_not_where_it_is_stated_is_named() -> None:
    """The lengths to it make another machine, and no other check said so."""
    assert lengths_from_anchors({}).trusted
    found = lengths_from_anchors({"b": (-0.397, 1.2, -0.1)})
    assert failed(found) == {"groups"}
    assert "the target 'b' differs from the rest" in found.doubts[0]
    assert "it fits better with another place" in found.doubts[0]


def test_planes_in_known_places_are_no_jump() -> None:
    """Two parallel planes tell the size of the arm. A machine that is shrunk to a point would leave nothing at all."""
    made = lab(noise=3e-5)
    up = np.array(NORMALS["floor"]) / np.linalg.norm(NORMALS["floor"])
    heights = {"floor": 0.2, "table": 0.3}
    q = [made.touching(lambda x, h=h: (x @ up - h)[:, None], made.scatter(30, 1), outside=up) for h in heights.values()]
    data = made.read(np.concatenate(q), "plane", target=np.repeat(list(heights), 30).tolist())
    known = {name: Target(axis_frame(up) @ machines.pose((0.0, 0.0, h))) for name, h in heights.items()}
    model = calib.error_model(
        made.robot, offsets="all", placements="all", base="fixed", known=calib.Known(targets=known)
    )
    found = calib.assess(calib.identify(model, data))
    assert failed(found) == set()


SOCKETS = {"a": (0.6, 0.2, 0.3), "b": (0.5, -0.5, 0.25), "c": (-0.2, 0.7, 0.4), "d": (0.4, 0.4, 0.7)}


@pytest.mark.parametrize(("off", "wobble", "named"), [(0.0, 0.0, False), (1e-3, 0.0, True), (0.0, 1e-3, False)])
def test_a_socket_that_is_not_where_it_is_stated_is_named(off: float, wobble: float, named: bool) -> None:
    """In another place nothing is left but noise. Gears that wobble leave more, wherever one socket is."""
    made = lab(noise=3e-5)
    arm = geared(made.machine.arm, lambda u: wobble * np.cos(u + np.arange(6.0)))
    made = replace(made, machine=replace(made.machine, arm=arm))
    q = [made.touching(lambda x, c=c: x - c, made.scatter(20, 3)) for c in SOCKETS.values()]
    order = made.rng.permutation(80)
    data = made.read(np.concatenate(q)[order], "socket", target=np.repeat(list(SOCKETS), 20)[order].tolist())
    stated = SOCKETS | {"b": (0.5, -0.5, 0.25 + off)}
    known = calib.Known(targets={name: Target(machines.pose(place)) for name, place in stated.items()})
    model = calib.error_model(made.robot, offsets="all", placements="all", base="fixed", known=known)
    found = calib.assess(calib.identify(model, data))
    assert ("groups" in failed(found)) == named
    if named:
        assert "the target 'b'" in " ".join(found.doubts)


def test_harmonics_that_nearly_are_a_gain_are_no_gear_of_another_ratio(cell: Cell) -> None:
    """Over half a radian two orders come near a straight line; what weak priors keep of them was told as a gain."""
    names = [reading.name for reading in cell.robot.readings]
    model = calib.error_model(cell.robot, offsets="all", placements="all", terms={"harmonics": "all"})
    for _ in range(3):
        q = cell.draw(80)
        q[:, :3] *= 0.25
        parts, C = cell.effects(cell.measured(q + 5e-4 * np.sin(q) - 5e-4 * np.cos(2.0 * q), read=q), model)
        found = gains(parts, C)
        assert set(found) == set(names)
        assert all(not abs(gain.t) > 4.0 for gain in found.values())


@pytest.mark.parametrize("half", [0.1, 0.3])
def test_a_joint_that_moved_little_with_the_wrong_sign_is_named(half: float) -> None:
    """A tool behind its axis does nearly the same, and a fit takes it."""
    cell = Cell()
    q = cell.draw(80)
    q[:, 5] *= half / np.abs(q[:, 5]).max()
    told = q * (1.0, 1.0, 1.0, 1.0, 1.0, -1.0)
    for readings, wrong in ((told, True), (q, False)):
        data = cell.measured(q, readings)
        found = calib.assess(calib.identify(cell.model, data.subset(range(60))), data.subset(range(60, 80)))
        (check,) = (check for check in found.checks if check.name == "gear")
        assert check.passed != wrong
        assert ("'wrist_3_joint' seems to be read with the wrong sign" in check.sentence) == wrong


@pytest.mark.parametrize("rows", [1, 2])
def test_of_a_joint_that_moved_in_a_row_or_two_these_may_be_wrong_and_not_its_sign(rows: int) -> None:
    """As of a real Panda, whose third joint moved in one of twelve poses: an error of that row looked like its sign."""
    robot = calib.load_robot("example:panda_description/urdf/panda.urdf", tip="panda_link8")
    rng = np.random.default_rng(3)
    read = np.array((0.0, 0.0, 0.0, -2.1, 0.0, 1.9, 0.5)) + rng.uniform(-0.5, 0.5, (12, 7))
    read[:, 2] = 1e-4 * rng.standard_normal(12)
    read[:rows, 2] = -0.008
    stood = read.copy()
    stood[:rows, 2] = 0.025
    seen = robot.tips(stood) @ machines.pose((0.02, 0.03, 0.1))
    R = Rotation.from_matrix(seen[:, :3, :3]) * Rotation.from_rotvec(6e-3 * rng.standard_normal((12, 3)))
    table = {f"{reading.name} [rad]": column for reading, column in zip(robot.readings, read.T, strict=True)}
    place = seen[:, :3, 3] + 2e-3 * rng.standard_normal((12, 3))
    table |= dict(zip(("x [m]", "y [m]", "z [m]"), place.T, strict=True))
    table |= dict(zip(("qx", "qy", "qz", "qw"), R.as_quat().T, strict=True))
    data = calib.read_measurements(table, robot, "pose")
    found = calib.assess(calib.identify(calib.error_model(robot, offsets="all", placements="all", tool="pose"), data))
    (check,) = (check for check in found.checks if check.name == "gear")
    assert check.sentence.startswith(
        "'panda_joint3' seems to be read with the wrong sign, or the few rows in which it moved are wrong"
    )
