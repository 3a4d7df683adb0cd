"""Every signature in one exact sentence, and nothing said of sound tables."""

from dataclasses import replace

import numpy as np
import pytest

from calib.foundations.arrays import Array
from calib.measurement.checks import Finding, copied_tables, resolutions, table_findings
from calib.measurement.from_table import measurements_from_table
from calib.measurement.measurements import Measurements
from calib.measurement.table import table_from_arrays
from calib.robot.robot import Reading

READINGS = (
    Reading("a", "angle", -2.9, 2.9),
    Reading("b", "angle", -3.0, -0.1),
    Reading("c", "angle", None, None),
    Reading("d", "length", 0.0, 0.5),
)
REACH = 1.5
N = 40


def sound_readings() -> Array:
    u = np.random.default_rng(5).uniform(size=(N, 4))
    return np.array([-2.5, -2.9, -9.0, 0.02]) + u * np.array([5.0, 2.6, 18.0, 0.45])


def sound_positions() -> Array:
    return np.random.default_rng(6).uniform(-1.0, 1.0, size=(N, 3))


def measurements(readings: Array | None = None, position: Array | None = None) -> Measurements:
    readings = sound_readings() if readings is None else readings
    position = sound_positions() if position is None else position
    columns = {f"{r.name} [{'rad' if r.dimension == 'angle' else 'm'}]": readings[:, j] for j, r in enumerate(READINGS)}
    columns |= {f"{name} [m]": position[:, j] for j, name in enumerate("xyz")}
    return measurements_from_table(table_from_arrays(columns, "t"), READINGS, "position")


def with_value(row: int, column: int, value: float) -> Array:
    readings = sound_readings()
    readings[row, column] = value
    return readings


ANGLES = np.array([1.0, 1.0, 1.0, 0.0], dtype=bool)
DEGREES = np.where(ANGLES, 180.0 / np.pi, 1.0)


def found(m: Measurements) -> list[tuple[str, str, str]]:
    return [(finding.severity, finding.code, finding.sentence) for finding in table_findings(m, READINGS, REACH)]


def test_a_sound_table_gives_nothing() -> None:
    assert table_findings(measurements(), READINGS, REACH) == ()


def test_few_rows_and_no_rows_give_nothing() -> None:
    assert table_findings(measurements().subset([3]), READINGS, REACH) == ()
    assert table_findings(measurements().subset([]), READINGS, REACH) == ()


def test_repeated_readings_with_other_positions_are_fine() -> None:
    assert table_findings(measurements(np.repeat(sound_readings()[::4], 4, axis=0)), READINGS, REACH) == ()


def test_readings_at_their_limits_are_fine() -> None:
    assert table_findings(measurements(with_value(1, 0, 2.9 + 2e-3)), READINGS, REACH) == ()


def test_degrees_under_rad() -> None:
    readings = sound_readings() * DEGREES
    row = int(np.argmax(np.abs(readings[:, 0])))
    assert found(measurements(readings)) == [
        (
            "error",
            "degrees-as-radians",
            f"t:{row}: column 'a' has {readings[row, 0]:.6g} rad where the limits are -2.9 and 2.9 rad, "
            "and divided by 57.3 all its rows fit: the numbers seem to be degrees, not [rad]; likewise in 'b'.",
        )
    ]


def test_degrees_in_one_column_only() -> None:
    readings = sound_readings() * np.array([1.0, DEGREES[0], 1.0, 1.0])
    row = int(np.argmin(readings[:, 1]))
    assert found(measurements(readings)) == [
        (
            "error",
            "degrees-as-radians",
            f"t:{row}: column 'b' has {readings[row, 1]:.6g} rad where the limits are -3 and -0.1 rad, "
            "and divided by 57.3 all its rows fit: the numbers seem to be degrees, not [rad].",
        )
    ]


def test_degrees_in_some_rows_of_a_column() -> None:
    """Rows of two files, one of them in degrees: who takes the whole column for degrees spoils the others."""
    readings = sound_readings()
    readings[: N // 2, 0] *= DEGREES[0]
    within = int(np.sum(np.abs(readings[:, 0]) < 2.9))
    ((severity, code, sentence),) = found(measurements(readings))
    assert (severity, code) == ("error", "degrees-as-radians")
    assert N // 2 <= within < N
    assert sentence.endswith(f"all its rows fit: {N - within} of {N} numbers, or all, seem to be degrees, not [rad].")


def test_readings_from_0_to_360_degrees_are_no_degrees() -> None:
    """As a controller counts that knows no sign: the limits of the joint are those of the URDF."""
    readings = sound_readings()
    below = int(np.sum(readings[:, 0] < 0.0))
    readings[:, 0] %= 2.0 * np.pi
    [(severity, code, sentence)] = found(measurements(readings))
    assert (severity, code) == ("error", "beyond-limits")
    assert sentence.endswith(f"{below} of {N} rows are beyond, and all fit a whole turn away: take it off there.")


def test_a_joint_that_counts_the_other_way_than_its_limits_allow() -> None:
    readings = sound_readings()
    readings[:, 1] *= -1.0
    beyond = int(np.sum(readings[:, 1] > -0.1 + 1e-9))
    [(severity, code, sentence)] = found(measurements(readings))
    assert (severity, code) == ("error", "beyond-limits")
    assert beyond > N // 2
    assert sentence.endswith(
        f"{beyond} of {N} rows are beyond, and all fit with the other sign: does it count the other way, or is this "
        "another joint's column?"
    )


def test_radians_under_deg() -> None:
    u = np.random.default_rng(7).uniform(-1.0, 1.0, size=(N, 1))
    readings = np.hstack([u * 2.0, u - 1.5, u, 0.25 + 0.1 * u]) / DEGREES
    largest = float(np.abs(readings[:, :3]).max())
    # b, whose limits leave zero out, is also said to be beyond them.
    assert [finding[1] for finding in found(measurements(readings))] == ["beyond-limits", "radians-as-degrees"]
    assert found(measurements(readings))[1] == (
        "warning",
        "radians-as-degrees",
        f"t: no joint turns farther than {largest:.6g} rad from zero, and multiplied by 57.3 all rows fit the limits: "
        "the numbers seem to be radians, not [deg].",
    )


@pytest.mark.parametrize("step", [1.0, 0.5, 0.25, 0.1])
def test_readings_rounded_to_degrees(step: float) -> None:
    degrees = np.array([1.0, 1.0, 1.0, 0.0])
    rounded = np.round(sound_readings() / np.radians(step)) * np.radians(step)
    ((severity, code, sentence),) = found(measurements(np.where(degrees, rounded, sound_readings())))
    assert (severity, code) == ("warning", "rounded-readings")
    off = 0.5e3 * REACH * np.radians(step)
    assert sentence == (
        f"t: readings of 'a' and 2 others come in steps of {step:.4g} deg; if they are not where joints were told "
        f"to be, but rounded, the tip is off by up to {off:.2g} mm: write more digits."
    )
    # As a table in rad with five digits has them.
    steps = resolutions(np.round(rounded[:, :1], 6), READINGS[:1])
    assert steps == pytest.approx([np.radians(step)])


def test_what_is_not_rounded() -> None:
    commanded = np.radians(15.0 * np.random.default_rng(1).integers(-10, 10, (N, 1)))
    even, fine = np.linspace(-1.0, 1.0, N)[:, None], np.round(sound_readings()[:, :1], 4)
    few = np.radians(np.arange(6.0) % 3)[:, None]
    for values in (commanded, even, fine, few, sound_readings()[:, :1]):
        assert not resolutions(values, READINGS[:1]).any()
    assert resolutions(np.round(sound_readings()[:, 3:], 3), READINGS[3:]) == pytest.approx([1e-3])


@pytest.mark.parametrize(
    ("row", "column", "value", "severity", "sentence"),
    [
        (
            4,
            0,
            3.0,
            "warning",
            "t:4: column 'a' has 3 rad where the limits are -2.9 and 2.9 rad; 1 of 40 rows are beyond.",
        ),
        (
            4,
            0,
            -3.2,
            "error",
            "t:4: column 'a' has -3.2 rad where the limits are -2.9 and 2.9 rad; 1 of 40 rows are beyond.",
        ),
        (
            5,
            0,
            99.0,
            "error",
            "t:5: column 'a' has 99 rad where the limits are -2.9 and 2.9 rad; 1 of 40 rows are beyond.",
        ),
        (6, 3, 25.0, "error", "t:6: column 'd' has 25 m where the limits are 0 and 0.5 m; 1 of 40 rows are beyond."),
    ],
)
def test_beyond_limits(row: int, column: int, value: float, severity: str, sentence: str) -> None:
    assert found(measurements(with_value(row, column, value))) == [(severity, "beyond-limits", sentence)]


def test_limits_that_leave_no_room_say_what_to_do() -> None:
    """Exporters that know no limits write 0 and 0; every row was refused without a remedy."""
    data = measurements(sound_readings())
    still = [replace(READINGS[0], lower=0.0, upper=0.0), *READINGS[1:]]
    (said,) = (finding.sentence for finding in table_findings(data, still, REACH) if finding.code == "beyond-limits")
    assert said.endswith(
        ": the URDF leaves the joint no room, as exporters do. Write its limits there, or take <limit> out."
    )


def test_a_joint_that_never_moves() -> None:
    readings = sound_readings()
    readings[:, 1:3] = -1.0
    assert found(measurements(readings)) == [("warning", "joint-at-rest", "t: joints that never move: 'b', 'c'.")]


def test_millimetres_under_m() -> None:
    assert found(measurements(position=1000.0 * sound_positions() + 5e3)) == [
        (
            "error",
            "millimetres-as-metres",
            "t: half of the positions are over 1010 m from their median, and the robot reaches 1.5 m; divided by 1000 "
            "they fit: the numbers seem to be millimetres, not [m].",
        )
    ]


def test_one_wild_position_is_not_taken_for_a_unit() -> None:
    position = sound_positions()
    position[7, 1] = 500.0
    assert found(measurements(position=position)) == [
        (
            "error",
            "position-beyond-reach",
            "t:7: the position is 500.1 m from the median of all, and the robot reaches 1.5 m.",
        )
    ]


def test_metres_under_mm() -> None:
    assert found(measurements(position=sound_positions() / 1000.0)) == [
        (
            "warning",
            "metres-as-millimetres",
            "t: half of the positions are within 0.00101 m of their median, and the robot reaches 1.5 m: the "
            "numbers seem to be metres, not [mm], or the point was held still.",
        )
    ]


def test_repeated_rows() -> None:
    m = measurements()
    twice = m.subset([*range(N), 3, 5, 3])
    assert found(twice) == [
        ("warning", "repeated-row", "t: 3 of 43 rows repeat an earlier one to the last digit, at line 3, 5, 3.")
    ]
    assert found(m.subset([*range(N), *range(11)]))[0][2] == (
        "t: 11 of 51 rows repeat an earlier one to the last digit, at line 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, ...."
    )
    assert found(m.subset([*range(N), *range(N)]))[0][:2] == ("warning", "copied-rows")


def test_a_table_twice_is_no_second_table() -> None:
    """Under another name, in another order, in part, and with digits lost in other units; new rows are none."""
    m, rng = measurements(), np.random.default_rng(1)
    shuffled = replace(m.subset(rng.permutation(N)), where="u")
    part = replace(m.subset(range(0, N, 2)), where="u", readings=m.readings[::2] * (1.0 + 1e-15))
    for other in (shuffled, part):
        (finding,) = copied_tables([m, other])
        assert (finding.severity, finding.code) == ("error", "copied-table")
        assert finding.sentence == f"u: {len(other)} of its {len(other)} rows are rows of t; leave out the copies."
    assert "an earlier table of the same name" in copied_tables([m, m])[0].sentence
    again = replace(m, position=m.position + rng.normal(scale=1e-6, size=(N, 3)))
    assert copied_tables([m, again, replace(m, tools=("other",))]) == ()
    few = replace(m.subset(range(3)), where="few")
    assert copied_tables([measurements().subset(range(10, N)), few]) == ()


def test_points_of_one_scan_are_no_copies() -> None:
    """A scanner sees many points from one pose, which differ in where they are in its own frame alone."""
    scan = replace(measurements().subset([0] * N), points=sound_positions())
    assert "repeated" not in "".join(code for _, code, _ in found(scan))
    assert copied_tables([scan, replace(scan, points=scan.points + 1e-3)]) == ()


def test_findings_are_plain_values() -> None:
    assert Finding("error", "a", "b") == Finding("error", "a", "b")
