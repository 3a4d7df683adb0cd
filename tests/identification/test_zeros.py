"""Zeros and signs of any number of joints are found from where an independent machine was seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.identification.sanity import named, otherwise_read, signatures
from calib.identification.zeros import other_zeros
from calib.job.inputs import load
from tests.identification.test_sanity import Lab
from tests.support import machines
from tests.support.machines import Array


def read_by(lab: Lab, signs: Array, zeros: Array, rows: int = 45) -> calib.Measurements:
    """What a machine measures whose joints stand at ``signs * reading + zeros``, these in deg."""
    data = lab.measure(rows=rows)
    return replace(data, readings=(data.readings - np.radians(zeros)) * signs)


def drawn(nr: int, seed: int, quarters: bool) -> tuple[Array, Array]:
    rng = np.random.default_rng([5, seed])
    zeros = rng.choice([0.0, 90.0, -90.0, 180.0], nr) if quarters else rng.uniform(-180.0, 180.0, nr)
    return np.where(rng.random(nr) < 0.4, -1.0, 1.0), zeros


@pytest.mark.parametrize("quarters", [True, False])
@pytest.mark.parametrize(("observes", "seed"), [("position", 0), ("position", 1), ("pose", 0)])
def test_all_signs_and_zeros(observes: str, seed: int, quarters: bool) -> None:
    """Those that are named mend the table: the nominal arm misses it no more."""
    lab = Lab("ur10", observes, seed)
    signs, zeros = drawn(6, seed, quarters)
    data = read_by(lab, signs, zeros)
    (found,) = named(lab.model(), [data])
    assert (found.finding.severity, found.finding.code) == ("error", "other-zeros")
    assert found.zeros is not None
    mended = otherwise_read(found.zeros.signs, found.zeros.offsets)(data)
    assert signatures(lab.model(), [mended]) == ()


def test_seven_joints() -> None:
    lab = Lab("panda")
    signs, zeros = drawn(7, 1, True)
    data = read_by(lab, signs, zeros)
    (found,) = named(lab.model(), [data])
    assert found.zeros is not None, found.finding.sentence
    assert signatures(lab.model(), [otherwise_read(found.zeros.signs, found.zeros.offsets)(data)]) == ()


def test_known_base_and_tool_show_the_outer_zeros() -> None:
    lab = Lab("ur10", "pose")
    data = read_by(lab, np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0]), np.array([90.0, 0.0, 0.0, 90.0, 0.0, -90.0]))
    known = {
        "base": "fixed",
        "base_pose": lab.true.base,
        "tool": "fixed",
        "tool_poses": {"tool": lab.true.tools["tool"]},
    }
    (found,) = named(lab.model(**known), [data])
    assert found.zeros is not None, found.finding.sentence
    assert found.zeros.signs.tolist() == [1.0, 1.0, -1.0, 1.0, 1.0, 1.0]
    np.testing.assert_allclose(np.degrees(found.zeros.offsets), [90.0, 0.0, 0.0, 90.0, 0.0, -90.0], atol=1e-9)


@pytest.mark.parametrize(
    ("observes", "first", "second"), [("position", 90.0, -90.0), ("position", -90.0, -90.0), ("pose", -90.0, 90.0)]
)
def test_two_zeros_of_an_elbow(observes: str, first: float, second: float) -> None:
    """Makers read an arm from where its elbow is bent, and its URDF is drawn straight: nothing explained it."""
    lab = Lab("ur10", observes)
    data = read_by(lab, np.ones(6), np.array([0.0, first, second, 0.0, 0.0, 0.0]))
    (finding,) = signatures(lab.model(), [data])
    assert (finding.severity, finding.code) == ("error", "other-zeros")
    signed = [f"{'-' if angle < 0.0 else '+'} {abs(angle):.0f} deg" for angle in (first, second)]
    assert (
        f"'shoulder_lift_joint' stands at reading {signed[0]}, 'elbow_joint' stands at reading {signed[1]}:"
        in finding.sentence
    )


def test_whole_turns_put_readings_into_limits() -> None:
    lab = Lab("panda")
    lower, upper = (np.array([getattr(one, end) for one in lab.robot.readings]) for end in ("lower", "upper"))
    data = read_by(lab, np.ones(7), np.array([0.0, 90.0, 0.0, 250.0, 0.0, 0.0, 0.0]))
    (found,) = named(lab.model(), [data])
    assert found.zeros is not None, found.finding.sentence
    stands = found.zeros.signs * data.readings + found.zeros.offsets
    assert np.all((stands > lower - 1e-6) & (stands < upper + 1e-6))


def test_a_slide_has_a_sign() -> None:
    lab = Lab("scara")
    signs, zeros = np.ones(len(lab.robot.readings)), np.zeros(len(lab.robot.readings))
    slide = next(k for k, one in enumerate(lab.robot.readings) if one.dimension == "length")
    signs[[1, slide]] = -1.0
    found = other_zeros(lab.robot, [read_by(lab, signs, zeros)], at_base=True, at_tool=True)
    assert any(np.prod(zeros.signs[[0, 1]]) * zeros.signs[slide] == 1.0 for zeros in found)


@pytest.mark.parametrize("rows", [16, 45])
def test_another_arm_has_no_other_zeros(rows: int) -> None:
    """A longer arm of the same maker, and rows that belong to other readings, are not explained by zeros and signs."""
    lab = Lab("panda")
    data = lab.measure(rows=rows)
    assert data.position is not None
    (finding,) = signatures(lab.model(), [replace(data, position=data.position[::-1])])
    assert finding.code == "unexplained"


def test_few_rows_and_joints_that_follow_are_not_searched() -> None:
    lab = Lab("ur10")
    assert other_zeros(lab.robot, [lab.measure(rows=9)], at_base=True, at_tool=True) == ()
    robot = machines.load(machines.INLINE["mimic"], "tip")
    readings = np.random.default_rng(0).uniform(-1.0, 1.0, (20, len(robot.readings)))
    data = calib.positions(robot, readings, robot.tips(readings)[:, :3, 3])
    assert other_zeros(robot, [data], at_base=True, at_tool=True) == ()


def test_one_of_two_zeros_that_explains_a_part_does_not_hide_the_other() -> None:
    """That of the shoulder alone lowered the miss more than threefold, and alone was named."""
    lab = Lab("ur10", seed=3)
    lab.true = replace(lab.true, tools={"tool": machines.pose((0.02, 0.01, 0.0))})
    data = read_by(lab, np.array([1.0, 1.0, 1.0, 1.0, -1.0, 1.0]), np.array([0.0, 90.0, 0.0, 0.0, 0.0, 0.0]))
    (found,) = named(lab.model(), [data])
    assert found.zeros is not None, found.finding.sentence
    assert found.zeros.by_name(lab.robot.readings).keys() >= {"shoulder_lift_joint", "wrist_2_joint"}


def test_an_elbow_of_an_arm_whose_joints_follow_others() -> None:
    """Two zeros of quarter turns are tried where all cannot be searched."""
    inputs = load(Path(__file__).resolve().parents[2] / "robots/irb2400/calibration.toml")
    data = inputs.identify[2]
    elbow = np.radians([0.0, 90.0, -90.0, 0.0, 0.0, 0.0])
    (finding,) = signatures(inputs.model, [replace(data, readings=data.readings - elbow)])
    assert finding.code == "other-zeros", finding.sentence


@pytest.mark.parametrize("seed", range(2))
def test_of_zeros_that_do_as_well_those_within_the_limits_are_named(seed: int) -> None:
    """Zeros of the outer joints, which base and tool absorb, and half turns of a wrist: the table was refused then."""
    lab = Lab("panda", seed=seed)
    signs, zeros = np.array([-1.0, 1.0, 1.0, 1.0, -1.0, 1.0, 1.0]), np.array([180.0, 0.0, 90.0, 0.0, 180.0, 0.0, 77.0])
    data = read_by(lab, signs, zeros, rows=30)
    (found,) = named(lab.model(), [data])
    assert found.zeros is not None, found.finding.sentence
    stands = found.zeros.signs * data.readings + found.zeros.offsets
    for k, reading in enumerate(lab.robot.readings):
        assert reading.lower is not None and reading.upper is not None
        assert np.all((reading.lower <= stands[:, k]) & (stands[:, k] <= reading.upper)), reading.name


def test_ten_rows_of_anything_are_brought_near_by_so_many_unknowns() -> None:
    """Another maker's arm was told to have other zeros: what leaves as much as noise of 35 mm explains nothing."""
    lab = Lab("ur10")
    data = read_by(lab, np.ones(6), np.array([0.0, 90.0, 0.0, 90.0, 0.0, 0.0]), rows=10)
    assert data.position is not None
    noisy = replace(data, position=data.position + np.random.default_rng(1).normal(scale=0.02, size=(10, 3)))
    (finding,) = signatures(lab.model(), [noisy])
    assert finding.code == "unexplained", finding.sentence
