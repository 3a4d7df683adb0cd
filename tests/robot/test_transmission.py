"""Joint terms: what they add to a reading, and every derivative against finite differences, far from zero too."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.foundations import rigid
from calib.foundations.errors import RobotError
from calib.robot.conditions import NO_CONDITIONS
from calib.robot.robot import Deviations, Robot, TipModel
from calib.robot.terms import JointTerm, kind_of
from calib.robot.transmission import Flexures, TermShares, Transmission
from tests.support import machines

Array = np.ndarray
ROOT = Path(__file__).resolve().parents[2]
LOOP = calib.ClosedLoop("parallelogram", ("rod_end", "rear_lever_pin"), ("x", "z"), ("elbow", "rod"))
ARMS = {
    "ur10": ("example:ur_description/urdf/ur10_robot.urdf", "tool0"),
    **{name: (machines.INLINE[name], "tip") for name in ("mimic", "skew", "gantry")},
}


def terms_for(robot: Robot) -> tuple[JointTerm, ...]:
    found = [JointTerm(reading.name, "gain") for reading in robot.readings]
    for reading in robot.readings:
        if reading.dimension == "angle":
            found += [JointTerm(reading.name, kind, order) for kind in ("cos", "sin") for order in (1, 3)]
    return tuple(found)


def robot_of(name: str) -> Robot:
    if name == "irb2400":
        robot = calib.load_robot(ROOT / "robots" / "irb2400" / "irb2400.urdf", "tool0", loops=[LOOP])
    else:
        robot = machines.load(*ARMS[name])
    return replace(robot, terms=terms_for(robot))


def deviations(robot: Robot, rng: np.random.Generator, size: float) -> Deviations:
    placements = rng.normal(scale=1e-3, size=(len(robot.chain), 6))
    coefficients = rng.uniform(-size, size, len(robot.terms))
    return Deviations(placements, rng.normal(scale=1e-3, size=len(robot.moving)), coefficients)


def readings_of(robot: Robot, rng: np.random.Generator, n: int = 5) -> Array:
    return rng.uniform(-0.5, 0.5, (n, len(robot.readings)))


def test_names_and_units() -> None:
    terms = [JointTerm("a", "gain"), JointTerm("a", "cos", 2), JointTerm("a", "sin", 12), JointTerm("a", "elastic")]
    assert [term.name for term in terms] == ["a.gain", "a.cos_2", "a.sin_12", "a.elastic"]
    assert [kind_of(term).coefficient(term, "angle").unit for term in terms] == ["1", "rad", "rad", "rad/Nm"]
    others = [JointTerm("a", kind) for kind in ("torque", "backlash", "thermal")]
    assert [kind_of(term).coefficient(term, "angle").unit for term in others] == ["rad/Nm", "rad", "rad/K"]
    sliding = [JointTerm("a", kind) for kind in ("gain", "elastic", "backlash", "thermal")]
    assert [kind_of(term).coefficient(term, "length").unit for term in sliding] == ["1", "m/N", "m", "m/K"]


def alone(kind: str) -> Transmission:
    return Transmission(TermShares((JointTerm("a", kind),), ["a"], Flexures((), (range(0),)), ()), np.ones(1))


def test_a_drive_that_gives_way_asks_what_it_holds() -> None:
    with pytest.raises(TypeError, match="has weights"):
        alone("elastic").moved(np.zeros((1, 1)), NO_CONDITIONS)


@pytest.mark.parametrize("name", [*ARMS, "irb2400"])
def test_a_term_does_to_the_tip_what_other_readings_would(name: str) -> None:
    rng = np.random.default_rng(1)
    robot = robot_of(name)
    d, u = deviations(robot, rng, 0.1), readings_of(robot, rng)
    moved = u.copy()
    for term, coefficient in zip(robot.terms, d.terms, strict=True):
        k = [reading.name for reading in robot.readings].index(term.reading)
        for n in range(len(u)):
            angle = term.order * u[n, k]
            moved[n, k] += coefficient * {"gain": u[n, k], "cos": np.cos(angle), "sin": np.sin(angle)}[term.kind]
    plain = replace(robot, terms=())
    np.testing.assert_allclose(
        robot.tips(u, d), plain.tips(moved, Deviations(d.placements, d.offsets)), rtol=0, atol=1e-13
    )


def twist(at: Array, forward: Array, back: Array) -> Array:
    """Small motions (N, 6), in the frames ``at`` (N, 4, 4), from one placement (N, 4, 4) to another."""
    change = rigid.inverse(at) @ forward - rigid.inverse(at) @ back
    v, w = change[:, :3, 3], change[:, :3, :3]
    return np.column_stack([v, w[:, 2, 1], w[:, 0, 2], w[:, 1, 0]])


@pytest.mark.parametrize("size", [1e-3, 0.15])
@pytest.mark.parametrize("name", [*ARMS, "irb2400"])
def test_derivatives_match_central_differences(name: str, size: float) -> None:
    rng = np.random.default_rng(2)
    robot = robot_of(name)
    d, u = deviations(robot, rng, size), readings_of(robot, rng)
    motion = robot.motion(u, d)
    assert motion.by_terms.shape == (len(u), 6, len(robot.terms))
    h = 1e-5

    for t in range(len(robot.terms)):
        step = h * (np.arange(len(robot.terms)) == t)
        ends = [robot.tips(u, replace(d, terms=d.terms + s)) for s in (step, -step)]
        np.testing.assert_allclose(
            motion.by_terms[:, :, t], twist(motion.placement, *ends) / (2.0 * h), rtol=0, atol=2e-8
        )
    tip, driven = TipModel(robot, d).driven(u)
    np.testing.assert_allclose(tip, motion.placement, rtol=0, atol=1e-14)
    for k in range(len(robot.readings)):
        step = h * (np.arange(len(robot.readings)) == k)
        np.testing.assert_allclose(
            driven[:, :, k],
            twist(motion.placement, robot.tips(u + step, d), robot.tips(u - step, d)) / (2.0 * h),
            rtol=0,
            atol=2e-8,
        )


def test_a_term_asks_for_the_condition_that_it_needs() -> None:
    with pytest.raises(RobotError, match=r"a\.thermal needs 'temperature' for every row\."):
        alone("thermal").moved(np.zeros((1, 1)), NO_CONDITIONS)
