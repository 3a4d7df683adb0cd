"""Joint terms of machines whose truth is known: found again, within their intervals, in any frame."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.errors import JobError
from calib.identification.error_model import with_terms
from calib.identification.machine import Frames
from calib.identification.system import Problem
from calib.identification.total_differential import total_differential
from calib.robot.terms import JointTerm
from tests.support import jacobians, machines
from tests.support.gears import UR10, geared, wavy

Array = np.ndarray
SIGMA = 0.05e-3


class Lab:
    """A badly made UR10 with uneven gears, anywhere in the room."""

    def __init__(self, seed: int, *, gain: bool = True, orders: Sequence[int] = (1, 3)) -> None:
        self.rng = rng = np.random.default_rng(seed)
        self.gains = rng.normal(scale=2e-4 if gain else 0.0, size=6)
        self.cosines, self.sines = ({k: rng.normal(scale=2e-4, size=6) for k in orders} for _ in range(2))
        self.robot, plain = machines.load(*UR10), machines.arm(*UR10)
        self.arm = geared(plain.moved(rng), wavy(self.gains, self.cosines, self.sines))
        tools = {"tool": machines.pose((0.05, 0.02, 0.15))}
        self.true = machines.Machine(self.arm, machines.anywhere(rng), tools)
        self.readings = plain.draw(rng, 400)
        self.orders = tuple(orders)

    def model(self, **options: object) -> calib.ErrorModel:
        chosen = {"offsets": "all", "placements": "all", "harmonics": "all", "harmonic_orders": self.orders}
        return machines.model(self.robot, **(chosen | options))

    def measure(self, sigma: float = SIGMA, observes: str = "position") -> calib.Measurements:
        return self.true.measure(
            self.robot, self.readings, observes, rng=self.rng, sigma=sigma, sigma_angle=sigma, stated=(SIGMA, SIGMA)
        )


def test_without_noise_unseen_tips_are_exact() -> None:
    lab = Lab(0)
    fit = calib.identify(lab.model(gain="all"), lab.measure(0.0))
    assert fit.converged
    assert machines.miss(fit, lab.true, lab.arm.draw(lab.rng, 300)) < 1e-11


@pytest.mark.parametrize("observes", ["position", "pose"])
def test_what_is_found_lies_within_its_interval(observes: str) -> None:
    """Harmonics beyond the first: those are told from geometry by no more than second-order effects."""
    inside, total = 0, 0
    for seed in range(4):
        lab = Lab(seed, gain=False, orders=(2, 3, 5))
        tool = "pose" if observes == "pose" else "position"
        fit = calib.identify(lab.model(tool=tool), lab.measure(observes=observes))
        truth = {
            f"{joint}.{kind}_{k}": float(values[k][j])
            for j, joint in enumerate(lab.arm.ranges)
            for kind, values in (("cos", lab.cosines), ("sin", lab.sines))
            for k in lab.orders
        }
        for parameter, value, sigma in zip(fit.parameters, fit.values, fit.sigmas, strict=True):
            if parameter.kind == "term" and np.isfinite(sigma):
                total += 1
                inside += abs(value - truth[parameter.name]) < 1.96 * sigma
    assert total > 100
    assert 0.91 < inside / total < 0.98


def test_gains_are_found() -> None:
    lab = Lab(5, orders=())
    fit = calib.identify(lab.model(harmonics="none", gain="all"), lab.measure())
    for joint, gain in zip(list(lab.arm.ranges)[1:5], lab.gains[1:5], strict=True):
        sigma = fit.sigmas[[p.name for p in fit.parameters].index(f"{joint}.gain")]
        assert abs(fit.value(f"{joint}.gain") - gain) < 4.0 * sigma < 1e-4


def test_ignoring_them_costs_what_they_do_to_the_tip() -> None:
    lab = Lab(1)
    data, unseen = lab.measure(), lab.arm.draw(lab.rng, 300)
    known, ignored = (calib.identify(lab.model(**o), data) for o in ({"gain": "all"}, {"harmonics": "none"}))
    assert machines.miss(known, lab.true, unseen) < 0.3 * machines.miss(ignored, lab.true, unseen)


def test_neither_the_frame_nor_the_order_of_rows_matters() -> None:
    lab = Lab(2)
    data = lab.measure()
    fit = calib.identify(lab.model(), data)
    R, t = Rotation.from_euler("xyz", (1.0, -0.5, 2.0)).as_matrix(), np.array((1.0, -2.0, 0.5))
    moved = replace(data, position=data.position @ R.T + t)
    shuffled = data.subset(np.random.default_rng(0).permutation(len(data)))
    robot = [k for k, parameter in enumerate(fit.parameters) if parameter.of_robot]
    for other in (moved, shuffled):
        again = calib.identify(lab.model(), other)
        np.testing.assert_allclose(again.values[robot], fit.values[robot], rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["ur10", "mimic", "skew"])
def test_columns_match_central_differences(name: str) -> None:
    """Everything free at a point far from zero, observed as poses."""
    urdf, tip = UR10 if name == "ur10" else (machines.INLINE[name], "tip")
    rng = np.random.default_rng(3)
    robot, arm = machines.load(urdf, tip), machines.arm(urdf, tip)
    angles = [reading.name for reading in robot.readings if reading.dimension == "angle"]
    model = machines.model(
        robot, offsets="all", placements="all", tool="pose", gain="all", harmonics=angles, harmonic_orders=(1, 4)
    )
    parameters = model.parameters()
    x = rng.uniform(-0.2, 0.2, len(parameters))
    true = machines.Machine(arm, machines.anywhere(rng), {"tool": np.eye(4)})
    readings = arm.draw(rng, 5)
    problem = Problem(model, parameters, Frames(machines.anywhere(rng)[None], machines.anywhere(rng)[None]), ())
    at = problem.machine(x)
    seen = at.frames.base @ robot_tips(model, readings, at) @ at.frames.tools[0]
    data = true.measure(robot, readings, "pose", sigma=1e-3, sigma_angle=1e-3)
    problem = replace(problem, measurements=(replace(data, orientation=seen[:, :3, :3]),))

    jacobians.check(problem, x)


def robot_tips(model: calib.ErrorModel, readings: Array, at: object) -> Array:
    return model.robot.tips(readings, at.deviations)


def test_a_dh_model_carries_the_terms_too() -> None:
    lab = Lab(4)
    data = lab.measure(0.0)
    fit = calib.identify(lab.model(offsets="none", placements="none", dh="all", gain="all"), data)
    tips = fit.robot.tips(data.readings, fit.deviations)
    other = fit.model.robot.tips(data.readings, fit.machine.deviations)
    np.testing.assert_allclose(tips, other, rtol=0, atol=1e-12)
    assert len(fit.robot.terms) == 30


def test_the_total_differential_knows_no_terms() -> None:
    lab = Lab(4)
    with pytest.raises(JobError, match="takes no joint terms"):
        total_differential(lab.model(), lab.measure(), stop=1e-3)


def test_a_prior_holds_them_back() -> None:
    lab = Lab(6)
    data = lab.measure()
    free, held = (calib.identify(lab.model(prior_harmonics=prior), data) for prior in (None, 1e-6))
    of_terms = [k for k, parameter in enumerate(free.parameters) if parameter.kind == "term"]
    assert np.abs(held.values[of_terms]).max() < 0.1 * np.abs(free.values[of_terms]).max()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"harmonics": ["elbow"]}, "harmonics: 'elbow' matches no joint of the arm"),
        ({"gain": "some"}, "gain: 'some' is not"),
        (
            {"harmonics": "all", "harmonic_orders": (1, 0)},
            "harmonic_orders: (1, 0) is not a list of whole numbers",
        ),
        ({"harmonics": "all", "harmonic_orders": (1.5,)}, "harmonic_orders: (1.5,) is not a list of"),
        ({"prior_harmonics": 0.0}, "prior harmonics: 0.0 is not a positive number"),
        ({"prior_elastic": float("inf")}, "prior elastic is inf rad/Nm; allowed is 1e-09 to "),
        ({"prior_elastic_sliding": -1.0}, "prior elastic sliding: -1.0 is not a positive number"),
        ({"prior_elastic_sliding": 1e-7}, "prior.elastic: m/N is for a joint that slides, and the arm has no"),
    ],
)
def test_wrong_choices_are_refused(options: dict[str, object], sentence: str) -> None:
    with pytest.raises(JobError, match=re.escape(sentence)):
        machines.model(machines.load(*UR10), **options)


def test_a_prior_of_compliance_has_the_unit_of_its_joint() -> None:
    priors = calib.Priors(harmonics=1e-4, elastic=2e-5, elastic_sliding=3e-7)
    elastic, wave, gain = JointTerm("a", "elastic"), JointTerm("a", "cos", 2), JointTerm("a", "gain")
    assert (priors.of_term(elastic, "angle"), priors.of_term(elastic, "length")) == (2e-5, 3e-7)
    assert (priors.of_term(wave, "angle"), priors.of_term(gain, "angle")) == (1e-4, None)
    assert calib.Priors().of_term(elastic, "angle") is None
    panda = calib.load_robot("example:panda_description/urdf/panda.urdf", "panda_hand_tcp")
    model = machines.model(panda, elastic="all", gain="all", prior_elastic=1e-5)
    found = {(p.name.partition(".")[2], p.prior) for p in model.parameters() if p.kind == "term"}
    assert found == {("elastic", 1e-5), ("gain", None)}


def test_what_slides_has_no_harmonics() -> None:
    robot = machines.load(machines.INLINE["gantry"], "tip")
    with pytest.raises(JobError, match="harmonics: 'bridge' slides, and harmonics are of angles"):
        machines.model(robot, harmonics=["bridge"])
    turning = [r.name for r in robot.readings if r.dimension == "angle"]
    assert {term.reading for term in machines.model(robot, harmonics="all").robot.terms} == set(turning) != set()
    slides = machines.load(machines.urdf(("one", "prismatic", "0 0 0", "0 0 0", "1 0 0")), "tip")
    with pytest.raises(JobError, match="harmonics: 'one' slides, and harmonics are of angles"):
        machines.model(slides, harmonics="all")
    assert with_terms(calib.error_model(robot), [JointTerm("bridge", "gain")]).terms == ("bridge.gain",)
