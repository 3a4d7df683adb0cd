"""Joints that do not stand where they were commanded to be: what is told of it, and commands instead of readings."""

from pathlib import Path

import numpy as np
import pytest

import calib
from calib.foundations.errors import CalibError
from calib.measurement.streams.joints import following
from calib.measurement.streams.samples import joint_stream
from calib.measurement.table import table_from_arrays
from scripts.simulate import streams as simulated
from tests.support import streams
from tests.support.cases import run

Array = np.ndarray
LATE = np.array([0.012, 0.009, 0.020, 0.0, 0.004, 0.030])


def commands(made: streams.Streams) -> dict[str, Array]:
    """What would have been commanded of joints that come late."""
    t, names = made.recorded.stamps, [reading.name for reading in made.robot.readings]
    return {f"commanded_{name} [rad]": made.motion.at(t + LATE[k])[:, k] for k, name in enumerate(names)}


def test_how_late_every_joint_was_is_found() -> None:
    made = streams.streams(31, seconds=30.0)
    table = table_from_arrays(made.joints | commands(made))
    found = joint_stream(table, made.robot.readings, 0.1).following
    assert [one.joint for one in found] == [reading.name for reading in made.robot.readings]
    np.testing.assert_allclose([one.late for one in found], LATE, atol=2e-4)
    rates = np.gradient(made.motion.at(made.recorded.stamps), made.recorded.stamps, axis=0)
    np.testing.assert_allclose([one.rms for one in found], LATE * np.sqrt(np.mean(rates**2, axis=0)), rtol=0.05)
    assert max(one.left for one in found) < 1e-3 < max(one.rms for one in found)


def test_a_constant_error_is_no_delay_and_a_joint_at_rest_has_none() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    q = np.column_stack([np.sin(t), np.full_like(t, 0.3)])
    rates = np.column_stack([np.cos(t), np.zeros_like(t)])
    turning, resting = following({"a": "angle", "b": "length"}, q, q - np.array([0.002, 0.001]), rates)
    assert turning.late == pytest.approx(0.0, abs=1e-12)
    assert (turning.rms, turning.largest) == pytest.approx((0.002, 0.002))
    assert turning.left == pytest.approx(0.0, abs=1e-12)
    assert (resting.late, resting.dimension) == (0.0, "length")


def test_commands_alone_stand_for_readings_and_the_offset_takes_the_common_delay() -> None:
    made = streams.streams(32, seconds=30.0, offset=2.0, skew=0.0)
    names = [reading.name for reading in made.robot.readings]
    asked = made.motion.at(made.recorded.stamps + 0.015)
    joints = {"time [s]": made.recorded.stamps} | {f"commanded_{n} [rad]": asked[:, k] for k, n in enumerate(names)}
    data = calib.measuring.read_stream(made.seen, made.robot, joints, sigma=1e-4)
    assert data.stream is not None
    assert data.stream.joints.commanded
    fit = calib.identify(calib.error_model(made.robot, offsets="all", placements="all"), data)
    assert fit.value("clock.offset") == pytest.approx(2.015, abs=1e-3)
    del joints[f"commanded_{names[2]} [rad]"]
    with pytest.raises(CalibError, match=f"there is no column 'commanded_{names[2]}' of a joint"):
        calib.measuring.read_stream(made.seen, made.robot, joints, sigma=1e-4)


def test_commands_are_no_column_of_other_tables() -> None:
    made = streams.streams(33, seconds=5.0)
    names = [reading.name for reading in made.robot.readings]
    table = {f"{name} [rad]": np.zeros(3) for name in names} | {f"{axis} [m]": np.zeros(3) for axis in "xyz"}
    with pytest.raises(CalibError, match="is neither a joint nor a known column"):
        calib.read_measurements(table | {f"commanded_{names[0]} [rad]": np.zeros(3)}, made.robot)


def test_a_report_says_how_joints_followed_and_a_job_that_only_commands_are_known(tmp_path: Path) -> None:
    simulated.write_case(tmp_path, 3, 25.0)
    joints = tmp_path / "joints.csv"
    head, *rows = joints.read_text().splitlines()
    own = head.split(",")
    asked = [title.replace(name := title.split(" ")[0], f"commanded_{name}") for title in own[1:]]
    both = [f"{row},{row.split(',', 1)[1]}" for row in rows]
    joints.write_text("\n".join([",".join([*own, *asked]), *both]) + "\n")
    said = run("calibrate", tmp_path / "calibration.toml", "-o", tmp_path / "out")
    assert said.code in (0, 3), said.err
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Following error" in page
    assert "late [ms]" in page
    joints.write_text("\n".join([",".join([own[0], *asked]), *rows]) + "\n")
    said = run("check", tmp_path / "calibration.toml")
    assert said.code == 0, said.err
    told = " ".join((said.out + said.err).split())
    assert "what joints were commanded to do, and not where they were; the delay that all have in common is in " in told
    assert "common is in clock.offset" in told
