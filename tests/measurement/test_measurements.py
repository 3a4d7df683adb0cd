"""Measurements from tables: what each column becomes, and one exact sentence for every refusal."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from calib.foundations.errors import CalibError, JobError, MeasurementError
from calib.foundations.rigid import quaternion_of
from calib.measurement.from_table import measurements_from_table
from calib.measurement.instruments import LaserTracker
from calib.measurement.measurements import Measurements
from calib.measurement.read import read_measurements
from calib.measurement.table import table_from_arrays
from calib.robot.load import load_robot
from calib.robot.robot import Reading
from calib.robot.urdf import parse_urdf

READINGS = (Reading("j1", "angle", -3.0, 3.0), Reading("slide", "length", 0.0, 2.0))
POSITION = {
    "j1 [deg]": [90.0, 45.0],
    "slide [mm]": [100.0, 200.0],
    "x [mm]": [1, 2],
    "y [mm]": [3, 4],
    "z [mm]": [5, 6],
}
POSE = POSITION | {"qw": [0.0, 0.5], "qx": [1.0, 0.5], "qy": [0.0, 0.5], "qz": [0.0, 0.5]}

Columns = Mapping[str, npt.ArrayLike]


def without(columns: Columns, *titles: str) -> Columns:
    return {title: values for title, values in columns.items() if title not in titles}


def measured(columns: Columns, kind: str = "position", **noise: object) -> Measurements:
    return measurements_from_table(table_from_arrays(columns, "t"), READINGS, kind, **noise)


def test_positions() -> None:
    m = measured(POSITION)
    assert (m.kind, m.reading_names, len(m), m.where) == ("position", ("j1", "slide"), 2, "t")
    np.testing.assert_allclose(m.readings, [[np.pi / 2, 0.1], [np.pi / 4, 0.2]], rtol=1e-15)
    np.testing.assert_allclose(m.position, [[1e-3, 3e-3, 5e-3], [2e-3, 4e-3, 6e-3]], rtol=1e-15)
    assert m.orientation is None
    assert m.sigma.tolist() == [[0.0] * 3] * 2
    assert (m.tools, m.tool.tolist(), m.group, m.targets) == (("tool",), [0, 0], None, ())


def test_poses_keep_the_rotation_of_their_quaternion() -> None:
    m = measured(POSE, "pose")
    assert m.sigma.shape == (2, 6)
    np.testing.assert_allclose(quaternion_of(m.orientation), [[0, 1, 0, 0], [0.5] * 4], atol=1e-15)


def test_a_pose_table_serves_as_positions() -> None:
    assert measured(POSE).orientation is None


def test_readings_come_in_the_order_of_the_robot() -> None:
    backwards = measured(dict(reversed(POSITION.items())))
    assert np.array_equal(backwards.readings, measured(POSITION).readings)
    assert np.array_equal(backwards.position, measured(POSITION).position)


def test_optional_columns() -> None:
    m = measured(
        POSITION
        | {"tool": ["ball2", "ball1"], "group": ["a", "b"], "target": ["t1", "t2"], "pair": ["p", "q"]}
        | {"direction": ["+", "-"], "time [s]": [0, 1], "temperature [degC]": [20, 21], "length [mm]": [1, 1]}
        | {"u [px]": [1, 2], "v [px]": [1, 2], "tau_j1 [Nm]": [0, 0]}
    )
    assert (m.tools, m.tool.tolist()) == (("ball2", "ball1"), [0, 1])
    assert (m.group, m.targets) == (("a", "b"), ())


def test_every_array_is_read_only() -> None:
    for m in (measured(POSE, "pose"), measured(POSE, "pose").subset([0])):
        for values in (m.readings, m.position, m.orientation, m.sigma, m.tool, m.lines):
            assert not values.flags.writeable


@pytest.mark.parametrize("rows", [[1], np.array([1]), np.array([False, True])], ids=["list", "positions", "mask"])
def test_subset(rows: object) -> None:
    m = measured(POSE | {"tool": ["a", "b"], "group": ["g", "h"], "target": ["t", "u"]}, "pose")
    s = m.subset(rows)
    for name in ("readings", "position", "orientation", "sigma", "tool", "lines"):
        assert np.array_equal(getattr(s, name), getattr(m, name)[1:])
    assert (s.tools, s.group, s.targets, len(s)) == (("a", "b"), ("h",), (), 1)


def test_subset_of_no_rows() -> None:
    assert len(measured(POSITION).subset([])) == 0


@pytest.mark.parametrize(
    ("columns", "noise", "sigma"),
    [
        ({}, {"sigma": 2e-5}, [[2e-5] * 3] * 2),
        ({"sigma [um]": [20, 0]}, {}, [[2e-5] * 3, [0.0] * 3]),
        (
            {"sigma_x [um]": [1, 4], "sigma_y [um]": [2, 5], "sigma_z [um]": [3, 6]},
            {},
            [[1e-6, 2e-6, 3e-6], [4e-6, 5e-6, 6e-6]],
        ),
        (
            {},
            {"instrument": LaserTracker(1e-5, 1e-2, (1e-3, 3e-3, 0.0))},
            [[6e-5] * 3, [1e-5 + 1e-5 * np.sqrt(38)] * 3],
        ),
    ],
    ids=["scalar", "column", "columns", "instrument"],
)
def test_noise_of_positions(columns: Columns, noise: dict[str, object], sigma: list[list[float]]) -> None:
    np.testing.assert_allclose(measured(POSITION | columns, **noise).sigma, sigma, rtol=1e-14)


@pytest.mark.parametrize(
    ("columns", "noise", "angles"),
    [
        ({}, {"sigma": (1e-5, 1e-4)}, [[1e-4] * 3] * 2),
        ({"sigma_angle [mrad]": [1, 2]}, {}, [[1e-3] * 3, [2e-3] * 3]),
        (
            {"sigma_rx [mrad]": [1, 1], "sigma_ry [mrad]": [2, 2], "sigma_rz [mrad]": [3, 3]},
            {},
            [[1e-3, 2e-3, 3e-3]] * 2,
        ),
    ],
    ids=["scalar", "column", "columns"],
)
def test_noise_of_poses(columns: Columns, noise: dict[str, object], angles: list[list[float]]) -> None:
    given = {"sigma": 1e-5} | noise
    sigma = measured(POSE | columns, "pose", **given).sigma
    np.testing.assert_allclose(sigma, np.hstack([np.full((2, 3), 1e-5), angles]), rtol=1e-15)


THERE = "'j1', 'slide', 'x', 'y', 'z'"


@pytest.mark.parametrize(
    ("columns", "kind", "sentence"),
    [
        (
            without(POSITION, "j1 [deg]") | {"jo1 [deg]": [1, 2]},
            "position",
            "t: there is no column 'j1' of a joint; the columns are 'slide', 'x', 'y', 'z', 'jo1'.",
        ),
        (
            without(POSITION, "j1 [deg]", "slide [mm]"),
            "position",
            "t: there is no column 'j1', 'slide' of a joint; the columns are 'x', 'y', 'z'.",
        ),
        (
            without(POSITION, "z [mm]"),
            "position",
            "t: there is no column 'z' of the measured position; the columns are 'j1', 'slide', 'x', 'y'.",
        ),
        (
            POSITION,
            "pose",
            f"t: there is no column 'qw', 'qx', 'qy', 'qz' of the measured pose; the columns are {THERE}.",
        ),
        (
            POSITION | {"tempreature [degC]": [1, 2]},
            "position",
            "t: column 'tempreature' is neither a joint nor a known column; near is 'temperature'.",
        ),
        (POSITION | {"j7 [deg]": [1, 2]}, "position", "t: column 'j7' is neither a joint nor a known column."),
        (
            without(POSITION, "slide [mm]") | {"slide [deg]": [1, 2]},
            "position",
            "t: column 'slide': unit 'deg' is not a unit of length; allowed are m, cm, mm, um, inch.",
        ),
        (
            without(POSITION, "j1 [deg]") | {"j1 [mm]": [1, 2]},
            "position",
            "t: column 'j1': unit 'mm' is not a unit of angle; allowed are rad, mrad, urad, deg.",
        ),
        (
            without(POSE, "qw") | {"qw [deg]": [1, 2]},
            "pose",
            "t: column 'qw': unit 'deg' is not a unit of number; allowed are 1.",
        ),
        (
            POSITION | {"rx [deg]": [0, 0], "ry [deg]": [0, 0], "rz [deg]": [0, 0]},
            "pose",
            "t: rx, ry, rz do not say in which order and about which axes they turn; give orientation, "
            "or convert them to quaternions qw, qx, qy, qz.",
        ),
        (
            POSE | {"qw": [0.0, 0.6]},
            "pose",
            "t:1: the quaternion has the norm 1.05357 where 1 is allowed, within 0.001; the order is qw, qx, qy, qz.",
        ),
        (
            POSITION | {"sigma [mm]": [0.1, -0.1]},
            "position",
            "t:1: column 'sigma' is out of range; allowed is 0, or 1e-06 to 1000 mm.",
        ),
        (
            POSITION | {"sigma [mm]": [1, 1], "sigma_x [mm]": [1, 1]},
            "position",
            "t: the noise is given twice, by column sigma and by column sigma_x, sigma_y, sigma_z; keep one.",
        ),
        (
            POSITION | {"sigma_x [mm]": [1, 1], "sigma_z [mm]": [1, 1]},
            "position",
            f"t: there is no column 'sigma_y' of the noise; the columns are {THERE}, 'sigma_x', 'sigma_z'.",
        ),
    ],
)
def test_bad_tables_give_one_sentence(columns: Columns, kind: str, sentence: str) -> None:
    with pytest.raises(MeasurementError) as caught:
        measured(columns, kind)
    assert str(caught.value) == sentence


def test_a_quaternion_with_few_digits_is_accepted() -> None:
    m = measured(POSE | {"qw": [0.0005, 0.5004]}, "pose")
    np.testing.assert_allclose(m.orientation @ np.swapaxes(m.orientation, 1, 2), [np.eye(3)] * 2, atol=1e-15)


@pytest.mark.parametrize(
    ("kind", "columns", "noise", "error", "sentence"),
    [
        ("position", {}, {"sigma": -1.0}, JobError, "t: sigma is -1 m; allowed is 0, or 1e-06 to 1000 mm."),
        ("position", {}, {"sigma": np.inf}, JobError, "t: sigma is inf m; allowed is 0, or 1e-06 to 1000 mm."),
        ("position", {}, {"sigma": (None, 1.0)}, JobError, "t: sigma_angle is given, and only poses have angles."),
        (
            "pose",
            {},
            {"sigma": 1.0, "instrument": LaserTracker(0, 0)},
            MeasurementError,
            "t: the noise is given twice, by sigma and by the instrument; keep one.",
        ),
        (
            "pose",
            {"sigma_angle [deg]": [1, 1]},
            {"sigma": (None, 1.0)},
            MeasurementError,
            "t: the noise is given twice, by sigma_angle and by column sigma_angle; keep one.",
        ),
    ],
)
def test_bad_noise_gives_one_sentence(
    kind: str, columns: Columns, noise: dict[str, object], error: type[CalibError], sentence: str
) -> None:
    with pytest.raises(error) as caught:
        measured(POSE | columns, kind, **noise)
    assert str(caught.value) == sentence


def test_a_joint_named_like_a_measured_column_is_refused() -> None:
    table = table_from_arrays(without(POSITION, "j1 [deg]", "slide [mm]"), "gantry")
    with pytest.raises(MeasurementError) as caught:
        measurements_from_table(table, [Reading("x", "length", 0.0, 1.0)], "position")
    assert str(caught.value) == (
        "gantry: the joint 'x' has the name of a measured column; rename the joint in the URDF."
    )


def test_a_joint_named_like_a_column_is_told_before_the_column_that_comes_twice(tmp_path: Path) -> None:
    """To leave one of the two out, as is said of other columns that come twice, would lose what was measured."""
    urdf = tmp_path / "gantry.urdf"
    urdf.write_text(
        '<robot name="gantry"><link name="base"/><link name="tip"/><joint name="x" type="prismatic">'
        '<parent link="base"/><child link="tip"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    table = tmp_path / "measured.csv"
    table.write_text("x [m], x [mm], y [mm], z [mm]\n0.1, 100, 0, 0\n")
    with pytest.raises(MeasurementError, match=r"gantry\.urdf: the joint 'x' has the name of a measured column"):
        read_measurements(table, load_robot(urdf))


def test_a_column_of_a_joint_that_is_not_read_says_so() -> None:
    joint = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/>{}<axis xyz="0 0 1"/></joint>'
    urdf = (
        "<robot>"
        + "".join(f'<link name="{name}"/>' for name in ("base", "arm", "tip", "hand"))
        + joint.format("j1", "continuous", "base", "arm", "")
        + joint.format("follows", "continuous", "arm", "tip", '<mimic joint="j1"/>')
        + joint.format("beside", "continuous", "arm", "hand", "")
        + "</robot>"
    )
    robot = load_robot(parse_urdf(urdf.encode(), "arm.urdf"), "tip")
    rows = {"j1 [deg]": [1, 2], "x [mm]": [1, 2], "y [mm]": [1, 2], "z [mm]": [1, 2]}
    assert len(read_measurements(rows, robot)) == 2
    with pytest.raises(MeasurementError) as caught:
        read_measurements(rows | {"follows [deg]": [1, 2]}, robot)
    assert str(caught.value) == (
        "arrays: column 'follows' is of a joint that is not read: it is fixed or follows others; leave the column out."
    )
    # One that could move something, and moves nothing that was measured, is named and left out.
    assert read_measurements(rows | {"beside [deg]": [1, 2]}, robot).unused == ("beside",)


def test_a_name_that_is_no_text_is_refused() -> None:
    for wrong in (5, ["a"]):
        with pytest.raises(JobError, match=r"named: tool is .*; needs a text or None\.$"):
            measured(POSITION).named(tool=wrong)  # type: ignore[arg-type]
