"""Streams: joint readings between samples, gaps, clocks without a guess, poses at rest, and what is refused."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.arrays import Array
from calib.foundations.errors import CalibError
from calib.identification import system
from calib.identification.initialisation.problem import initial_problem
from calib.identification.machine import values_at
from calib.measurement.checks import unreached
from calib.measurement.read import stream_of
from calib.measurement.streams import lags
from calib.measurement.streams.samples import joint_stream, refuse_no_stream
from calib.measurement.streams.sides import _between, sides
from calib.measurement.table import table_from_arrays
from calib.measuring import Clock, at_rest
from tests.support import machines, streams
from tests.support.streams import Streams


@pytest.fixture(scope="module")
def made() -> Streams:
    return streams.streams(3, seconds=40.0, lost=0.01, jitter=2e-4)


def test_readings_between_samples_follow_a_cubic_and_rates_are_their_derivative(made: Streams) -> None:
    t = np.arange(0.0, 20.0, 1.0 / 60.0)
    arm = machines.arm(*streams.UR10)
    table = {"time [s]": t} | {f"{n} [rad]": made.motion.at(t)[:, k] for k, n in enumerate(arm.ranges)}
    joints = joint_stream(table_from_arrays(table), made.robot.readings, 0.1)
    at = np.random.default_rng(1).uniform(1.0, 19.0, 500)
    np.testing.assert_allclose(joints.at(at), made.motion.at(at), atol=2e-8)
    h = 1e-5
    np.testing.assert_allclose(joints.rates(at), (joints.at(at + h) - joints.at(at - h)) / (2 * h), atol=1e-8)


def test_angles_that_are_told_within_a_turn_go_on_between_samples(made: Streams) -> None:
    """As drivers tell a joint without limits: -179.9 deg follows 179.9, and no sample is between them."""
    t = np.arange(0.0, 20.0, 1.0 / 60.0)
    t = t[(t < 9.0) | (t > 11.0)]
    names = [reading.name for reading in made.robot.readings]
    turned = made.motion.at(t) + np.pi - made.motion.at(np.array([5.0]))  # each is at the seam there
    told = (turned + np.pi) % (2.0 * np.pi) - np.pi
    assert np.all(np.ptp(told, axis=0) > 6.0)
    asked = {f"commanded_{name} [rad]": turned[:, k] - 1e-3 for k, name in enumerate(names)}
    table = {"time [s]": t} | {f"{name} [rad]": told[:, k] for k, name in enumerate(names)} | asked
    joints = joint_stream(table_from_arrays(table), made.robot.readings, 0.1)
    at = np.random.default_rng(1).uniform(1.0, 8.0, 500)
    np.testing.assert_allclose(np.diff(joints.at(at), axis=0), np.diff(made.motion.at(at), axis=0), atol=4e-8)
    np.testing.assert_allclose([one.largest for one in joints.following], 1e-3)


def test_sides_of_approach_are_those_of_the_joints_motion_between_rows() -> None:
    """Encoders jitter while the arm rests, and a joint turns when its own samples say so, not a row later."""
    robot = streams.streams(3, seconds=40.0).robot
    names = [reading.name for reading in robot.readings]
    t, rng = np.arange(0.0, 24.0, 1.0 / 250.0), np.random.default_rng(1)

    def moved(u: Array) -> Array:
        """It rests for 5 s, swings until 20 s and rests again; it turns at 7, 11, 15 and 19 s."""
        swings = np.sin(0.25 * np.pi * (np.clip(u, 5.0, 20.0) - 5.0))
        return swings[:, None] * np.linspace(0.3, 0.8, len(names))

    told = moved(t) + np.round(rng.normal(0.0, 2e-5, (len(t), len(names))), 5)
    table = {"time [s]": t} | {f"{name} [rad]": told[:, k] for k, name in enumerate(names)}
    at = np.arange(1.0, 23.0, 0.01)
    wanted = np.select([at < 5.0, at < 7.0, at < 11.0, at < 15.0, at < 19.0], [0.0, 1.0, -1.0, 1.0, -1.0], 1.0)
    found = sides(joint_stream(table_from_arrays(table), robot.readings, 0.1), at)
    # A joint that turned is between the flanks of its gears, for nobody knows how long, until it is back by 2 mrad.
    apart = np.linspace(0.3, 0.8, len(names)) - np.abs(moved(at))
    turned = np.any((at[:, None] > [7.0, 11.0, 15.0, 19.0]) & (at[:, None] < [8.0, 12.0, 16.0, 20.0]), axis=1)
    between = turned[:, None] & (apart < 2e-3)
    sure = (np.abs(at[:, None] - [5.0, 7.0, 11.0, 15.0, 19.0]).min(axis=1) > 0.02)[:, None]
    sure = sure & (np.abs(apart - 2e-3) > 3e-4)
    wanted = np.where(between, np.nan, wanted[:, None])
    np.testing.assert_array_equal(found[sure], wanted[sure])

    points = robot.tips(moved(at))[:, :3, 3]
    seen = {"time [s]": at, "x [m]": points[:, 0], "y [m]": points[:, 1], "z [m]": points[:, 2]}
    rows = stream_of(seen, table, robot, "position", clock="given", in_order=True)
    assert rows.times is not None
    assert rows.times[0] == pytest.approx(5.0, abs=0.05)  # nothing tells from where it came before
    turning = np.count_nonzero(between.any(axis=1))
    assert rows.unreached == pytest.approx(np.count_nonzero(at < rows.times[0]) + turning, abs=8)
    assert len(rows) + rows.unreached == len(at)
    (found,) = unreached(rows)
    assert (
        f"leaves out {rows.unreached} rows of {len(at)}, where a joint has not moved yet or has just" in found.sentence
    )
    assert set(np.unique(rows.conditions.approach)) == {-1.0, 1.0}


def test_a_joint_that_goes_back_a_little_and_on_again_is_at_its_side_or_between() -> None:
    """What overshoots and comes to rest has hardly left its flank; what went back by more may be off it."""
    robot = streams.streams(3, seconds=40.0).robot
    names = [reading.name for reading in robot.readings]
    t = np.arange(0.0, 12.0, 1.0 / 250.0)
    times, back = [0.0, 1.0, 3.0, 4.0, 6.0, 7.0, 11.0], np.array([1e-4, 3e-4, 1e-3, 1.8e-3, 2.5e-3, 5e-2])
    # It goes up, rests, goes back, rests, comes again, and goes back for good.
    told = np.stack([np.interp(t, times, [0.0, 0.3, 0.3, 0.3 - by, 0.3 - by, 0.3, 0.0]) for by in back], axis=1)
    told += np.random.default_rng(1).normal(0.0, 1e-5, told.shape)
    table = {"time [s]": t} | {f"{name} [rad]": told[:, k] for k, name in enumerate(names)}
    found = sides(joint_stream(table_from_arrays(table), robot.readings, 0.1), np.array([2.0, 5.0, 6.9, 9.0]))
    np.testing.assert_array_equal(found[0], 1.0)
    np.testing.assert_array_equal(found[1], [1.0, 1.0, np.nan, np.nan, -1.0, -1.0])
    np.testing.assert_array_equal(found[2, [0, 1, 2, 5]], [1.0, 1.0, np.nan, 1.0])
    np.testing.assert_array_equal(found[3], -1.0)


def test_joints_whose_readings_are_rounded_coarsely_are_between_sides_where_they_turn() -> None:
    """By ten standard deviations of the rounding they go back farther than gears are wide."""
    robot = streams.streams(3, seconds=40.0).robot
    names = [reading.name for reading in robot.readings]
    t = np.arange(0.0, 40.0, 1.0 / 125.0)
    swings = 0.3 * np.sin(0.5 * t)
    table = {"time [s]": t} | {f"{name} [rad]": np.round(swings / 1.5e-3) * 1.5e-3 for name in names}
    at = t[(t > 1.0) & (t < 39.0)]
    found = sides(joint_stream(table_from_arrays(table), robot.readings, 0.1), at)[:, 0]
    way, back = np.sign(np.cos(0.5 * at)), 0.3 - np.abs(0.3 * np.sin(0.5 * at))
    assert not np.any(found == np.where(back > 3e-3, -way, np.nan))
    assert np.isnan(found).mean() == pytest.approx(np.mean((back < 4.3e-3) & (way * np.sin(0.5 * at) < 0.0)), rel=0.3)


def test_columns_of_either_table_are_renamed_and_ignored(made: Streams, tmp_path: Path) -> None:
    """A driver tells the fingers as well, and has its own names for joints."""
    first = made.robot.readings[0].name
    joints = {("own/pan" if name == f"{first} [rad]" else name): x for name, x in made.joints.items()}
    joints["finger [rad]"] = joints["seq"] = np.zeros(len(joints["time [s]"]))
    seen = made.seen | {"quality": np.ones(len(made.seen["time [s]"]))}
    files = []
    for name, columns in (("seen", seen), ("joints", joints)):
        rows = "\n".join(",".join(map(repr, map(float, row))) for row in zip(*columns.values(), strict=True))
        files.append(tmp_path / f"{name}.csv")
        files[-1].write_text(f"{','.join(columns)}\n{rows}\n")
    how = calib.measuring.Columns({f"{first} [rad]": "own/pan"}, ("finger", "seq", "quality"))
    wanted = calib.measuring.read_stream(made.seen, made.robot, made.joints)
    for source, readings in ((seen, joints), files, (pd.DataFrame(seen), pd.DataFrame(joints))):
        found = calib.measuring.read_stream(source, made.robot, readings, columns=how)
        np.testing.assert_array_equal(found.readings, wanted.readings)
    for wrong in (replace(how, ignore=("fingr",)), replace(how, names={"x [m]": "own/pn"})):
        with pytest.raises(CalibError, match=r"there is no column '(fingr' to ignore|own/pn' to read as 'x \[m\]')"):
            calib.measuring.read_stream(files[0], made.robot, files[1], columns=wrong)


def test_longer_gaps_are_not_bridged_and_shorter_ones_are(made: Streams) -> None:
    t = made.joints["time [s]"]
    without = {name: x[(t < 15.0) | (t > 15.5)] for name, x in made.joints.items()}
    bridged = calib.measuring.read_stream(made.seen, made.robot, without, clock=Clock(gap=0.6))
    whole = streams.read(made)
    apart = calib.measuring.read_stream(made.seen, made.robot, without)
    assert len(bridged) == len(whole)
    assert 25 <= len(whole) - len(apart) <= 35
    assert apart.stream is not None
    u = apart.stream.times(apart.shifts(np.array([one.start for one in apart.scalars])))
    assert not np.any((u > 15.0) & (u < 15.5))
    np.testing.assert_allclose(apart.readings, made.motion.at(u), atol=1e-3)


@pytest.mark.parametrize(("seed", "offset", "skew"), [(0, 0.0, 0.0), (1, 60.0, 2e-3), (2, -31.4, -2e-3)])
def test_the_start_needs_no_guess(seed: int, offset: float, skew: float) -> None:
    made = streams.streams(seed, seconds=60.0, offset=offset, skew=skew, jitter=1e-3, lost=0.02, memories=(0.05, 0.5))
    data = streams.read(made)
    assert data.stream is not None
    found = {one.name: one.start for one in data.scalars}
    assert found["clock.offset"] == pytest.approx(made.recorded.offset_at(data.stream.middle), abs=2e-3)
    assert found["clock.skew"] == pytest.approx(skew, abs=1e-4)


def test_an_hour_with_a_skew_needs_no_guess() -> None:
    # One correlation over all of it would fail: its ends are 7 s apart.
    made = streams.streams(4, seconds=3600.0, offset=20.0, skew=2e-3, rates=(25.0, 12.0))
    data = streams.read(made)
    assert data.stream is not None
    assert data.scalars[0].start == pytest.approx(made.recorded.offset_at(data.stream.middle), abs=2e-3)
    assert data.scalars[1].start == pytest.approx(2e-3, abs=1e-5)


def test_an_arm_that_goes_and_stops_in_turn_is_told_by_positions() -> None:
    seen, joints, robot, poses = stops(12)
    data = calib.measuring.read_stream(seen, robot, joints)
    assert data.scalars[0].start == pytest.approx(5.0, abs=5e-3)
    rests = at_rest(data, least=0.5)
    assert len(rests) == 13
    np.testing.assert_allclose(rests.readings, poses, atol=1e-6)
    # 20 um a row, about 70 of them.
    assert np.all((rests.sigma > 1e-6) & (rests.sigma < 6e-6))


def stops(moves: int) -> tuple[dict[str, Any], dict[str, Any], calib.Robot, np.ndarray]:
    """Streams of an arm that moves for 2 s and rests for 2 s; the tracker is 5 s ahead."""
    rng = np.random.default_rng(11)
    robot, arm = machines.load(*streams.UR10), machines.arm(*streams.UR10)
    poses = np.array([0.3, -0.8, 1.0, 0.2, 0.5, 0.1]) + rng.uniform(-0.3, 0.3, (moves + 1, 6))
    u = np.arange(0.0, 4.0 * moves + 2.0, 0.008)
    k = np.minimum((u // 4.0).astype(int), moves)
    share = np.clip((u - 4.0 * k - 2.0) / 2.0, 0.0, 1.0)
    s = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    q = poses[k] + s[:, None] * (poses[np.minimum(k + 1, moves)] - poses[k])
    machine = machines.Machine(arm, machines.anywhere(rng), {"tool": machines.pose((0.0, 0.05, 0.1))})
    x = machine.see(q[::2])[:, :3, 3] + 2e-5 * rng.normal(size=(len(u[::2]), 3))
    seen = {"time [s]": u[::2] + 5.0} | {f"{axis} [m]": x[:, j] for j, axis in enumerate("xyz")}
    return seen, {"time [s]": u} | {f"{n} [rad]": q[:, j] for j, n in enumerate(arm.ranges)}, robot, poses


def refused(made: Streams, seen: dict[str, Any], joints: dict[str, Any], clock: str | Clock = "free") -> str:
    with pytest.raises(CalibError) as caught:
        calib.measuring.read_stream(seen, made.robot, joints, clock=clock)  # type: ignore[arg-type]
    return str(caught.value)


def test_marks_of_one_photograph_have_one_time(made: Streams) -> None:
    """Of a board most rows have the time of the row before; they are no stream that is too fast."""
    times = np.repeat(np.arange(2.0, 30.0, 0.25), 6)
    marks = np.tile(
        [[0.0, 0.0], [0.03, 0.0], [0.06, 0.0], [0.0, 0.03], [0.03, 0.03], [0.06, 0.03]], (len(times) // 6, 1)
    )
    seen = {"time [s]": times, "u [px]": 600.0 + 1e3 * marks[:, 0], "v [px]": 500.0 + 1e3 * marks[:, 1]}
    seen |= {"board_x [m]": marks[:, 0], "board_y [m]": marks[:, 1]}
    camera = calib.measuring.Camera("tip", 1400.0, 1400.0, 640.0, 512.0)

    def read(clock: Literal["free", "given"] | Clock) -> calib.Measurements:
        return calib.measuring.read_stream(seen, made.robot, made.joints, "pixels", clock=clock, instrument=camera)

    data = read("given")
    assert len(data) == len(times)
    np.testing.assert_array_equal(data.readings[::6], data.readings[5::6])
    with pytest.raises(CalibError, match="a pixels alone does not show when it was measured"):
        read("free")
    # A clock that is given already is no remedy.
    with pytest.raises(CalibError, match="a free latency is found from positions and poses only; leave latency out"):
        read(Clock("given", latency=True))


def test_a_lag_at_which_no_row_is_known_ends_no_search(made: Streams) -> None:
    """Streams of less than a second: of the lags that are tried within a second, most leave no row."""
    seen = {"time [s]": np.arange(40) * 0.02, **{f"{axis} [m]": np.linspace(0.0, 1.0, 40) for axis in "xyz"}}
    joints = {name: np.full(60, x[0]) for name, x in made.joints.items()} | {"time [s]": np.arange(60) * 0.02 - 0.1}
    joints["elbow_joint [rad]"] = np.linspace(0.0, 1.0, 60)
    assert "do the two recordings overlap" in refused(made, seen, joints)


def test_a_stream_without_sides_and_torques_tells_none(made: Streams) -> None:
    """Its own table has no joints, as a table of one arm has none of the other, which rest."""
    told = calib.measuring.read_stream(made.seen, made.robot, made.joints, clock="given").conditions
    assert told.approach is None
    assert told.torque is None


def test_bad_streams_are_refused_with_one_sentence(made: Streams) -> None:
    seen, joints = made.seen, made.joints
    back = dict(seen) | {"time [s]": np.concatenate([seen["time [s]"][:50], seen["time [s]"][:-50]])}
    assert refused(made, back, joints) == (
        f"arrays:50: the time {back['time [s]'][50]:.6f} s is before that of the row above, "
        f"{back['time [s]'][49]:.6f} s; the rows of a stream are in order of time."
    )
    back = dict(joints) | {"time [s]": joints["time [s]"][::-1]}
    assert "is before that of the row above" in refused(made, seen, back)
    slow = dict(seen) | {"time [s]": 1e3 * seen["time [s]"]}
    assert refused(made, slow, joints).endswith(
        "s apart or more; in a stream it is 0.0001 to 1 s: is the unit of 'time' right? Points at which the arm stood "
        "still are no stream: give each its own row of the joints."
    )
    quick = dict(seen) | {"time [s]": 1e-3 * seen["time [s]"]}
    assert refused(made, quick, joints) == (
        "arrays: half of its rows are 1.665e-05 s apart or less; in a stream it is 0.0001 to 1 s: "
        "is the unit of 'time' right?"
    )
    sent = dict(seen) | {"time [s]": seen["time [s]"][::10].repeat(10)[: len(seen["time [s]"])]}
    sent["time [s]"] = sent["time [s]"] + 3e-5 * (np.arange(len(sent["time [s]"])) % 10)
    assert refused(made, sent, joints) == (
        "arrays: half of its rows are 3e-05 s apart or less; in a stream it is 0.0001 to 1 s: "
        "they come in bursts: are these the times at which they arrived, and not those of measurement?"
    )
    rest = {name: x if name == "time [s]" else np.full_like(x, x[0]) for name, x in joints.items()}
    assert (
        refused(made, seen, rest)
        == "arrays: no joint moves by more than 0.0001 rad or m; a clock shows only while the arm moves."
    )
    still = dict(seen) | {f"{axis} [m]": np.full(len(seen["time [s]"]), 1.0) for axis in "xyz"}
    assert "what was measured hardly moves, at 0 mm/s; a free clock is found from motion" in refused(
        made, still, joints
    )
    later = dict(seen) | {"time [s]": seen["time [s]"] + 100.0}
    assert refused(made, later, joints, "given").startswith("arrays: 0 of its")
    assert refused(made, later, joints, "given").endswith("s; the clocks do not overlap.")
    other = streams.streams(77, seconds=40.0)
    assert refused(made, other.seen, joints).endswith("do the two recordings overlap, and are they of this robot?")
    both = dict(seen) | {"elbow_joint [rad]": np.zeros(len(seen["time [s]"]))}
    assert refused(made, both, joints).startswith("arrays: column 'elbow_joint' is of a joint, and another file")
    untimed = {name: x for name, x in seen.items() if name != "time [s]"}
    assert refused(made, untimed, joints) == (
        "arrays: there is no column 'time' of a stream; the columns are 'x', 'y', 'z'."
    )
    twice = {name: np.insert(x, 10, x[10] + (name != "time [s]") * 0.01) for name, x in joints.items()}
    assert refused(made, seen, twice) == (
        "arrays:11: has the same time as the row before, but other readings; give each row its own time."
    )


@pytest.mark.parametrize("seed", [41, 43, 44])
def test_recordings_that_do_not_overlap_are_refused_although_their_speeds_go_together(seed: int) -> None:
    made = streams.streams(seed, seconds=40.0)
    joints = {name: values[:2500] for name, values in made.joints.items()}
    seen = {name: values[1080:] for name, values in made.seen.items()}
    with pytest.raises(CalibError, match="do the two recordings overlap, and are they of this robot"):
        calib.measuring.read_stream(seen, made.robot, joints)


@pytest.mark.parametrize("pauses", [[(60.0, 200.0)], [(20.0, 100.0), (120.0, 200.0), (220.0, 290.0)]], ids=len)
def test_recordings_with_the_same_long_pauses_need_no_guess(pauses: list[tuple[float, float]]) -> None:
    """Both clocks went on meanwhile, and no window of a minute is known to both from one side to the other."""
    made = streams.streams(2, seconds=300.0, offset=12.0, skew=1e-3, rates=(50.0, 25.0))
    ahead = made.recorded.offset_at(150.0)

    def recorded(table: dict[str, Any], offset: float) -> dict[str, Any]:
        u = table["time [s]"] - offset
        kept = np.all([(u < begins) | (u > ends) for begins, ends in pauses], axis=0)
        return {name: x[kept] for name, x in table.items()}

    data = calib.measuring.read_stream(recorded(made.seen, ahead), made.robot, recorded(made.joints, 0.0))
    assert data.stream is not None
    found = {one.name: one.start for one in data.scalars}
    assert found["clock.offset"] == pytest.approx(made.recorded.offset_at(data.stream.middle), abs=2e-3)
    assert found["clock.skew"] == pytest.approx(1e-3, abs=2e-5)


def test_a_motion_that_repeats_itself_is_refused() -> None:
    robot, arm = machines.load(*streams.UR10), machines.arm(*streams.UR10)
    u = np.arange(0.0, 60.0, 0.008)
    q = 0.3 + 0.2 * np.sin(2.0 * np.pi * u[:, None] / np.array([5.0, 2.5, 5.0, 1.25, 2.5, 5.0]) + np.arange(6.0))
    x = machines.Machine(arm, np.eye(4), {"tool": np.eye(4)}).see(q)[1000:5000:2, :3, 3]
    joints = {"time [s]": u} | {f"{n} [rad]": q[:, j] for j, n in enumerate(arm.ranges)}
    seen = {"time [s]": u[1000:5000:2]} | {f"{axis} [m]": x[:, j] for j, axis in enumerate("xyz")}
    with pytest.raises(CalibError, match=r"equally well at two lags.*a motion that does not repeat itself"):
        calib.measuring.read_stream(seen, robot, joints)


def test_a_lag_that_explains_a_few_rows_by_chance_is_no_rival() -> None:
    def lag(offset: float, left: float, rows: int) -> lags.Refined:
        return lags.Refined(lags.Lag(offset, 0.0), left, rows)

    true, few = lag(3.0, 9e-5, 500), lag(15.0, 8e-5, 180)
    assert lags._by_what_they_leave([few, true]) == [true]
    # As many rows: a rival. Few rows, and nothing else explains them: the recordings overlap a little.
    rival, bad = lag(15.0, 8e-5, 300), lag(1.0, 5e-3, 500)
    assert lags._by_what_they_leave([true, rival]) == [rival, true]
    assert lags._by_what_they_leave([few, bad]) == [few, bad]


@pytest.mark.parametrize("rates", [(149.0, 10.0), (10.0, 60.0), (10.0, 10.0)])
def test_ten_samples_a_second_are_enough_of_a_slow_motion(rates: tuple[float, float]) -> None:
    made = streams.streams(5, seconds=80.0, rates=rates, lost=0.02)
    data = streams.read(made)
    assert data.stream is not None and len(data) > 0.9 * len(made.recorded.times)
    assert data.scalars[0].start == pytest.approx(made.recorded.offset_at(data.stream.middle), abs=2e-3)


def test_rows_farther_apart_than_the_gap_are_called_so(made: Streams) -> None:
    rare = {name: values[::6] for name, values in made.seen.items()}
    assert refused(made, rare, made.joints, Clock(gap=0.05)) == (
        "arrays: its rows are 0.0999 s apart, and gaps from 0.05 s on are not bridged; allow longer gaps, or measure "
        "more often."
    )
    # As long as the gap itself, but for the last digits of times.
    steps = {**made.seen, "time [s]": 0.05 * np.arange(len(made.seen["time [s]"]))}
    assert refused(made, steps, made.joints, Clock(gap=0.05)).startswith("arrays: its rows are 0.05 s apart, and gaps")


def test_options_of_clocks_are_checked(made: Streams) -> None:
    with pytest.raises(CalibError, match="cannot tell the latency from the clock's offset"):
        streams.read(made, clock=Clock("free", latency=True))
    with pytest.raises(CalibError, match=r"allowed is 0\.001 to 10 s"):
        Clock(gap=100.0)
    with pytest.raises(CalibError, match="is not one of free, given"):
        Clock("loose")  # type: ignore[arg-type]


def test_a_latency_is_found_where_the_clock_is_given() -> None:
    made = streams.streams(12, seconds=30.0, offset=0.012, skew=0.0)
    data = calib.measuring.read_stream(
        made.seen, made.robot, made.joints, clock=Clock("given", latency=True), sigma=1e-4
    )
    fit = calib.identify(calib.error_model(made.robot, offsets="all", placements="all"), data)
    assert [p.name for p in fit.parameters][-1] == "clock.latency"
    assert fit.value("clock.latency") == pytest.approx(0.012, abs=5.0 * fit.sigmas[-1])
    assert fit.sigmas[-1] < 1e-4


def test_a_clock_is_found_although_the_base_was_moved_within_the_stream() -> None:
    """One map of positions for both places would follow neither; the step itself is no motion of the arm."""
    made = streams.streams(14, seconds=40.0, offset=5.2, skew=8e-4)
    n = len(made.seen["time [s]"])
    later, moved = np.arange(n) >= n // 2, machines.pose((0.4, -0.3, 0.2), (0.1, 0.2, 0.7))
    points = np.column_stack([made.seen[f"{axis} [m]"] for axis in "xyz"])
    points[later] = points[later] @ moved[:3, :3].T + moved[:3, 3]
    seen = made.seen | {f"{axis} [m]": points[:, k] for k, axis in enumerate("xyz")}
    told: dict[str, Any] = {**seen, "setup": np.where(later, "there", "here")}
    data = calib.measuring.read_stream(told, made.robot, made.joints)
    assert data.stream is not None
    found = {one.name: one.start for one in data.scalars}
    assert found["clock.offset"] == pytest.approx(made.recorded.offset_at(data.stream.middle), abs=2e-3)
    assert found["clock.skew"] == pytest.approx(8e-4, abs=1e-4)


def test_points_all_over_a_tool_do_not_show_a_clock(made: Streams) -> None:
    rng, n = np.random.default_rng(4), len(made.seen["time [s]"])
    spots = rng.uniform(-0.5, 0.5, (n, 3))
    told = made.seen | {f"{axis} [m]": made.seen[f"{axis} [m]"] + spots[:, k] for k, axis in enumerate("xyz")}
    told |= {f"point_{axis} [m]": spots[:, k] for k, axis in enumerate("xyz")}
    with pytest.raises(CalibError, match="its points are at other places of the tool from row to row"):
        calib.measuring.read_stream(told, made.robot, made.joints)


@pytest.fixture(scope="module")
def two_of_one_clock() -> tuple[Streams, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """One tracker's rows as those of two, of which the second comes 8 ms late, and begins and ends later."""
    made = streams.streams(14, seconds=40.0, offset=5.2, skew=8e-4)
    own = {name: values[:1500:2] for name, values in made.seen.items()}
    late = {name: values[301::2] for name, values in made.seen.items()}
    return made, own, late | {"time [s]": late["time [s]"] + 0.008}


def test_a_latency_is_found_of_the_second_stream_of_a_clock(
    two_of_one_clock: tuple[Streams, dict[str, np.ndarray], dict[str, np.ndarray]],
) -> None:
    made, own, late = two_of_one_clock
    first = calib.measuring.read_stream(own, made.robot, made.joints, sigma=1e-4)
    clock = Clock(latency=True, name="clock.second", of=first.clock)
    second = calib.measuring.read_stream(late, made.robot, made.joints, clock=clock, sigma=1e-4)
    fit = calib.identify(calib.error_model(made.robot, offsets="all", placements="all"), [first, second])
    names = [parameter.name for parameter in fit.parameters][-3:]
    assert names == ["clock.offset", "clock.skew", "clock.second.latency"]
    assert first.stream is not None
    truth = (made.recorded.offset_at(first.stream.middle), 8e-4, 0.008)
    for k, true in enumerate(truth):
        assert fit.values[k - 3] == pytest.approx(true, abs=5.0 * fit.sigmas[k - 3])
    assert fit.sigmas[-1] < 1e-4
    # The order of tables is nobody's business, and without a latency both come at one time.
    turned = calib.identify(calib.error_model(made.robot, offsets="all", placements="all"), [second, first])
    assert turned.value("clock.second.latency") == pytest.approx(fit.values[-1], abs=1e-7)
    same = calib.measuring.read_stream(own, made.robot, made.joints, clock=Clock(of=first.clock), sigma=1e-4)
    np.testing.assert_array_equal(same.readings, first.readings)
    assert same.scalars == first.scalars


def test_mean_rates_go_over_the_time_around_and_never_beyond_a_piece() -> None:
    made = streams.streams(1, seconds=20.0)
    joints = streams.read(made).stream.joints
    (begin,), (end,) = joints.starts, joints.ends
    times = np.array([begin - 1e-3, begin, begin + 0.02, 7.1, end - 0.01, end, end + 1e-3])
    found = joints.mean_rates(times)
    np.testing.assert_allclose(found[3], (joints.at(times[3:4] + 0.05) - joints.at(times[3:4] - 0.05))[0] / 0.1)
    np.testing.assert_allclose(found, joints.rates(times), atol=0.02)


@pytest.mark.usefixtures("exact_rates")
def test_the_column_of_a_latency_is_minus_the_velocity(
    two_of_one_clock: tuple[Streams, dict[str, np.ndarray], dict[str, np.ndarray]],
) -> None:
    made, own, late = two_of_one_clock
    first = calib.measuring.read_stream(own, made.robot, made.joints, sigma=1e-4)
    clock = Clock(latency=True, name="clock.b", of=first.clock)
    second = calib.measuring.read_stream(late, made.robot, made.joints, clock=clock, sigma=1e-4)
    model = calib.error_model(made.robot, offsets="all")
    problem = initial_problem(model, (first.subset([5, 50]), second.subset([7, 70, 300])))
    x = values_at(made.robot, problem.parameters, problem.reference)
    J = system.jacobian(problem, x)
    for k in range(len(x) - 3, len(x)):
        h = 1e-5 * (np.arange(len(x)) == k)
        numeric = [(a - b) / 2e-5 for a, b in zip(problem.residuals(x + h), problem.residuals(x - h), strict=True)]
        for columns, found in zip(J, numeric, strict=True):
            np.testing.assert_allclose(columns[:, :, k], found, atol=1e-6)
    assert not J[0][:, :, -1].any()


def test_only_a_free_clock_is_shared(made: Streams) -> None:
    given = calib.measuring.read_stream(
        made.seen | {"time [s]": made.recorded.true_times}, made.robot, made.joints, clock="given"
    )
    with pytest.raises(CalibError, match="arrays: has no free clock of its own"):
        assert given.clock
    with pytest.raises(CalibError, match="clock: is given, and is that of arrays as well, which is free; keep one"):
        Clock("given", of=streams.read(made).clock)


def test_a_subset_keeps_the_clock_of_the_whole(made: Streams) -> None:
    data = streams.read(made)
    half = data.subset(np.arange(len(data) // 2))
    at = np.array([one.start for one in data.scalars])
    np.testing.assert_array_equal(half.readings_at(at), data.readings_at(at)[: len(half)])


def test_stretches_of_a_stream_are_held_out_whole(made: Streams) -> None:
    data = streams.read(made)
    some, rest = calib.hold_out(data, 0.3)
    assert len(some) + len(rest) == len(data)
    assert some.stream is not None
    assert rest.stream is not None
    of_some, of_rest = (set(np.floor(part.stream.since / 5.0)) for part in (some, rest) if part.stream is not None)
    assert of_some.isdisjoint(of_rest)
    assert 0.2 < len(rest) / len(data) < 0.4


def test_clocks_are_not_sought_in_days(made: Streams) -> None:
    """Time and memory of the search grow with the span, whatever is between: one wrong row would take all of both."""
    seen = {name: np.append(values, values[-1]) for name, values in made.seen.items()}
    seen["time [s]"][-1] += 1e9
    with pytest.raises(calib.MeasurementError, match="a free clock is searched in 10000 s at the most"):
        calib.measuring.read_stream(seen, made.robot, made.joints, sigma=1e-4)


@pytest.mark.parametrize("step", [1e-4, 1.0])
def test_a_step_that_is_just_allowed_is_not_refused_by_its_rounding(step: float) -> None:
    refuse_no_stream(1e5 + step * np.arange(200), "arrays")


def test_a_tip_on_the_axis_of_its_joint_shows_the_clock_by_what_it_carries() -> None:
    """The tip of a turntable stands still, and that of one that tilts moves little of what it carries."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 60.0, 0.05)
    waves = rng.uniform(0.3, 1.4, (2, 4)), rng.uniform(0.0, 6.0, (2, 4))

    def readings(u: Array) -> Array:
        return np.stack([np.sin(f * u[:, None] + phase).sum(axis=1) for f, phase in zip(*waves, strict=True)], axis=1)

    for tilts in (0.0, 0.2):

        def tips(u: Array, tilts: float = tilts) -> Array:
            tilt, turn = (readings(u) * [tilts, 0.5]).T
            T = np.tile(np.eye(4), (len(u), 1, 1))
            T[:, :3, :3] = Rotation.from_euler("XZ", np.stack([tilt, turn], axis=1)).as_matrix()
            T[:, :3, 3] = T[:, :3, 2] * 0.15
            return T

        u = t + 0.3
        points = tips(u)[:, :3, 3] + tips(u)[:, :3, :3] @ (0.12, -0.05, 0.04) + rng.normal(0.0, 2e-5, (len(t), 3))
        seen = lags.Seen(t + 7.0, points, "seen", np.zeros(len(t), dtype=np.intp))
        moved = lags.Moved(tips, lambda at: (at >= 0.0) & (at <= 60.0), 0.0, 60.0, "moved")
        found = lags.clock_lag(seen, moved, 37.0, 0.1)
        assert found.offset == pytest.approx(6.7, abs=1e-3)
        assert abs(found.skew) < 1e-4


def test_sides_of_a_joint_that_goes_to_and_fro_within_a_gap_take_no_longer_than_others() -> None:
    """All samples since a joint came to its flank were looked through whenever it left it: a second became minutes."""
    n = 1_000_000
    ahead = np.concatenate([np.linspace(0.0, 0.1, n // 20), np.full(n - n // 20, 0.1)])
    q = ahead + 5e-4 * np.sin(0.1 * np.arange(n))
    before = time.process_time()
    between = _between(q, np.gradient(q), np.array([100]), np.array([0.0, 1.0]), 1e-5, 5e-4)
    assert time.process_time() - before < 3.0
    assert between[n // 10 :].mean() > 0.8


def test_joints_of_a_stream_that_first_move_late_are_named(made: Streams) -> None:
    name = made.robot.readings[1].name
    moved = made.joints[f"{name} [rad]"]
    late = np.arange(len(moved)) < 0.7 * len(moved)
    joints = made.joints | {f"{name} [rad]": np.where(late, moved[late][-1], moved)}
    seen = made.seen | {"time [s]": made.recorded.true_times}
    data = stream_of(seen, joints, made.robot, "position", clock="given", sigma=1e-4, in_order=True)
    _, found = unreached(data, {name})
    many = np.count_nonzero(data.conditions.approach[:, 1] == 0.0)
    assert 0.5 * len(data) < many < 0.8 * len(data)
    assert f"in {many} of {len(data)} rows nothing tells from which side '{name}' was reached" in found.sentence
    assert found.sentence.endswith("begin with a motion of all joints, and turn less often.")
    assert [one.code for one in unreached(data)] == ["rows-left-out"]
