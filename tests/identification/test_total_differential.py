"""Gauss-Newton by total differential: any free parameters, the trace, why it stops, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.foundations.errors import IdentificationError, JobError, MeasurementError
from calib.identification.identify import with_values
from calib.identification.machine import machine
from calib.identification.total_differential import Trace, total_differential
from tests.support import machines

OFFSETS = np.array([0.04, -0.03, 0.02, -0.05, 0.03, 0.01])
UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
POINT = (0.05, 0.02, 0.15)


class Lab:
    """A UR10 with false zeros at a known place, whose known tool touches known points."""

    def __init__(self, rows: int = 8, *, observes: str = "position", noise: float = 0.0) -> None:
        rng = np.random.default_rng(5)
        self.robot, nominal = machines.load(*UR10), machines.arm(*UR10)
        zeros = dict(zip(nominal.ranges, OFFSETS, strict=True))
        self.base = machines.anywhere(rng)
        arm = nominal.with_errors(np.zeros((len(nominal.joints), 6)), zeros)
        self.true = machines.Machine(arm, self.base, {"tool": machines.pose(POINT)})
        self.readings = nominal.draw(rng, rows)
        self.data = self.true.measure(
            self.robot, self.readings, observes, rng=rng, sigma=noise, stated=(noise or 1e-5, 1e-5)
        )

    def model(self, **options: object) -> calib.ErrorModel:
        fixed = {"base": "fixed", "base_pose": self.base, "tool": "fixed", "tool_poses": {"tool": POINT}}
        return machines.model(self.robot, **{"offsets": "all"} | fixed | options)


def follow(lab: Lab, **options: object) -> Trace:
    return total_differential(lab.model(), lab.data, **{"stop": 1e-9} | options)


def test_finds_the_offsets_and_tells_every_iteration() -> None:
    lab = Lab()
    trace = follow(lab)
    assert np.max(np.abs(trace.values - OFFSETS)) < 1e-10
    assert trace.reason == "below the limit"
    start, *later = trace.iterations
    assert not start.values.any()
    nominal = lab.base @ lab.robot.tips(lab.readings) @ machines.pose(POINT)
    expected = np.linalg.norm(lab.data.position - nominal[:, :3, 3], axis=1)
    assert np.allclose(start.errors, expected, rtol=0.0, atol=1e-12)
    assert [at.largest for at in later] == sorted((at.largest for at in later), reverse=True)
    # Quadratic: every step squares what is left.
    assert [at.largest < 1e-9 for at in later] == [False] * (len(later) - 1) + [True]
    assert len(later) <= 5


def test_machine_of_the_trace_predicts_the_points() -> None:
    lab = Lab()
    at = follow(lab).machine
    points = at.frames.base @ lab.robot.tips(lab.readings, at.deviations) @ at.frames.tools[0]
    assert np.max(np.abs(points[:, :3, 3] - lab.data.position)) < 1e-10


def test_agrees_with_identify_on_noisy_points() -> None:
    lab = Lab(20, noise=1e-4)
    trace = follow(lab, stop=0.0)
    assert trace.reason == "the estimate repeats"
    fit = calib.identify(lab.model(), lab.data)
    # But for weak priors, which the trace does not know.
    assert np.max(np.abs(trace.values - fit.values) / fit.sigmas) < 0.01


def test_base_tool_and_lengths_may_be_free() -> None:
    lab = Lab(20)
    joints = list(lab.true.arm.ranges)[1:5]
    model = calib.error_model(lab.robot, offsets=joints, placements=["shoulder_lift_joint.tz"], tool="position")
    trace = total_differential(model, lab.data, stop=1e-10)
    assert trace.reason == "below the limit"
    found = dict(zip((p.name for p in trace.parameters), trace.values, strict=True))
    assert [found[f"{joint}.offset"] for joint in joints] == pytest.approx(OFFSETS[1:5], abs=1e-9)


def test_rounds_angles_and_leaves_lengths() -> None:
    lab = Lab()
    model = lab.model(placements=["shoulder_lift_joint.tx"])
    trace = total_differential(model, lab.data, stop=0.0, rounding=1e-3)
    for at in trace.iterations:
        milli = at.values[1:] * 1e3
        assert np.max(np.abs(milli - np.round(milli))) < 1e-9
    assert trace.parameters[0].unit == "m"
    assert all(at.values[0] * 1e3 % 1.0 > 0.0 for at in trace.iterations[1:])


def test_stops_when_a_rounded_estimate_repeats() -> None:
    lab = Lab()
    coarse = follow(lab, rounding=0.011)
    assert coarse.reason == "the estimate repeats"
    *before, last = (at.values.tolist() for at in coarse.iterations)
    assert last in before
    assert coarse.iterations[-1].largest > 1e-3


def test_stops_below_the_limit_before_any_step() -> None:
    trace = follow(Lab(), stop=10.0)
    assert len(trace.iterations) == 1
    assert trace.reason == "below the limit"


def test_stops_after_too_many() -> None:
    trace = follow(Lab(), most=2)
    assert len(trace.iterations) == 3
    assert trace.reason == "too many iterations"


def test_several_sets_are_one_system() -> None:
    lab = Lab()
    halves = [lab.data.subset(range(3)), lab.data.subset(range(3, 8))]
    together = total_differential(lab.model(), halves, stop=1e-9)
    assert np.max(np.abs(together.values - follow(lab).values)) < 1e-14
    assert together.iterations[0].errors.tolist() == follow(lab).iterations[0].errors.tolist()


def test_records_are_plain_and_the_text_tells_all() -> None:
    trace = follow(Lab())
    records = trace.records()
    assert [record["iteration"] for record in records] == list(range(len(trace.iterations)))
    assert records[-1]["values"] == dict(zip((p.name for p in trace.parameters), trace.values.tolist(), strict=True))
    text = str(trace)
    assert "shoulder_pan_joint.offset [deg]" in text
    assert f"{np.degrees(OFFSETS[0]):.4f}" in text
    assert text.endswith(f"Stopped after {len(records) - 1} iterations: below the limit.")


def test_arrays_are_read_only() -> None:
    at = follow(Lab()).iterations[-1]
    for array in (at.values, at.errors):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"stop": -1e-3}, "stop: -0.001 is not a length"),
        ({"stop": float("nan")}, "stop: nan"),
        ({"rounding": 0.0}, "rounding: 0.0 is not a positive angle"),
        ({"most": 0}, "most: 0 is not a number of iterations"),
    ],
)
def test_refuses_options(options: dict[str, object], sentence: str) -> None:
    with pytest.raises(JobError, match=sentence):
        follow(Lab(), **options)


def test_needs_more_equations_than_parameters() -> None:
    lab = Lab(2)
    with pytest.raises(IdentificationError, match="2 points give 6 equations for 6 parameters; at least 3 points"):
        follow(lab)


def test_refuses_what_the_points_cannot_tell_apart() -> None:
    lab = Lab()
    # With the point on the last axis its offset moves nothing.
    model = lab.model(tool_poses={"tool": (0.0, 0.0, 0.1)})
    with pytest.raises(IdentificationError, match=r"determine 5 of 6 parameters.*kind = .least_squares"):
        total_differential(model, lab.data, stop=1e-9)


def test_refuses_poses_priors_nothing_free_and_another_robot() -> None:
    lab = Lab(observes="pose")
    with pytest.raises(MeasurementError, match="observes pose"):
        follow(lab)
    lab = Lab()
    with pytest.raises(JobError, match="no priors"):
        total_differential(lab.model(prior_angle=0.01), lab.data, stop=1e-9)
    with pytest.raises(JobError, match="no parameter is free"):
        total_differential(lab.model(offsets="none"), lab.data, stop=1e-9)
    with pytest.raises(MeasurementError, match="are not those of the robot"):
        total_differential(lab.model(), replace(lab.data, reading_names=tuple("abcdef")), stop=1e-9)


def test_a_fit_with_its_values_states_their_own_noise() -> None:
    """Estimates that are a milliradian off leave more than the points' noise, and that is what is said."""
    lab = Lab(20, noise=1e-5)
    fit = calib.identify(lab.model(), lab.data)
    values = fit.values + 1e-3
    own = with_values(fit, values, machine(lab.robot, fit.parameters, fit.machine.frames, values))
    (noise,), left = own.noise, own.residuals[0]
    assert noise.total == pytest.approx(np.sqrt(np.sum(left**2) / (left.size - 6)), rel=0.05)
    assert noise.total > 10.0 * fit.noise[0].total
    assert np.all(own.sigmas > 10.0 * fit.sigmas)


def test_values_that_stopped_early_are_as_sure_as_they_are_far_from_rest() -> None:
    lab = Lab(40, noise=1e-6)
    base = {"base": "pose", "tool": "fixed"}
    model = lab.model(offsets=list(lab.true.arm.ranges)[1:], **base, base_pose=None)
    fit, rest, early = (
        calib.identify(model, lab.data),
        total_differential(model, lab.data, stop=0.0),
        total_differential(model, lab.data, stop=1e-3),
    )
    assert early.reason == "below the limit"
    at_rest, own = (with_values(fit, trace.values, trace.machine) for trace in (rest, early))
    assert own.off is not None
    assert at_rest.off is not None
    # Angles of a base that is found are turns of where the search began: joint offsets compare.
    offsets = [k for k, parameter in enumerate(fit.parameters) if parameter.kind == "offset"]
    assert own.off[offsets] == pytest.approx((early.values - rest.values)[offsets], rel=0.05, abs=1e-7)
    assert np.max(np.abs(own.off) / fit.sigmas) > 5.0
    assert np.max(np.abs(at_rest.off) / fit.sigmas) < 0.01
    q = lab.true.arm.draw(np.random.default_rng(1), 100)
    truth = lab.true.see(q)[:, :3, 3]
    for one in (at_rest, own):
        known = calib.machine_of(one)
        inside = calib.judging.tool_uncertainty(known, q).inside(known.predict(q)[:, :3, 3] - truth)
        assert np.mean(inside) > 0.9
    assert np.all(own.sigmas**2 >= own.off**2)
    # What a row says of the others counts by noise alone.
    assert np.all(own.spread_alone.variances < own.sigmas**2)
    (said,) = (found for found in calib.assess(own).findings if found.code == "off-least-squares")
    assert "standard deviations of its noise off the least-squares" in said.sentence
    assert not [found for found in calib.assess(at_rest).findings if found.code == "off-least-squares"]
