"""Identification of machines whose truth is known: exact without noise, at the floor with it, the same in any frame."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.foundations.errors import IdentificationError, JobError, MeasurementError
from calib.identification.identify import identify_near
from calib.identification.parameters import scales
from tests.support import machines
from tests.support.machines import Machine, anywhere, miss, pose, predicted

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
ARMS = {"ur10": UR10} | {name: (text, "tip") for name, text in machines.INLINE.items()}
POINT = (0.05, 0.02, 0.15)
SIGMA = 0.05e-3


class Lab:
    """A badly made arm that stands anywhere and carries one tool; all of its placements and zeros are free."""

    def __init__(self, name: str = "ur10", seed: int = 0, *, point: tuple[float, ...] = POINT) -> None:
        self.rng = np.random.default_rng(seed)
        self.robot, self.arm = machines.load(*ARMS[name]), machines.arm(*ARMS[name])
        self.true = Machine(self.arm.moved(self.rng), anywhere(self.rng), {"tool": pose(point, (0.3, -0.4, 0.5))})
        self.unseen = self.arm.draw(self.rng, 500)

    def model(self, **options: object) -> calib.ErrorModel:
        return machines.model(self.robot, **({"offsets": "all", "placements": "all"} | options))

    def measure(
        self, n: int, observes: str = "position", sigma: float = SIGMA, **options: object
    ) -> calib.Measurements:
        options = {"rng": self.rng, "sigma": sigma, "sigma_angle": 2 * sigma} | options
        return self.true.measure(self.robot, self.arm.draw(self.rng, n), observes, **options)

    def miss(self, fit: calib.Fit) -> float:
        return miss(fit, self.true, self.unseen)


# ---- the truth is found


@pytest.mark.parametrize("observes", ["position", "pose"])
@pytest.mark.parametrize("name", ARMS)
def test_without_noise_unseen_tips_are_exact(name: str, observes: str) -> None:
    lab = Lab(name)
    fit = calib.identify(lab.model(tool="pose" if observes == "pose" else "position"), lab.measure(120, observes, 0.0))
    assert fit.converged
    assert lab.miss(fit) < 1e-12
    if observes == "pose":
        truth, found = lab.true.see(lab.unseen), predicted(fit, lab.unseen)
        np.testing.assert_allclose(found[:, :3, :3], truth[:, :3, :3], atol=1e-12)


@pytest.mark.parametrize("observes", ["position", "pose"])
@pytest.mark.parametrize("name", ARMS)
def test_with_noise_unseen_tips_are_as_good_as_the_noise_allows(name: str, observes: str) -> None:
    lab = Lab(name)
    fit = calib.identify(lab.model(tool="pose" if observes == "pose" else "position"), lab.measure(300, observes))
    assert fit.converged
    # For positions the mean over poses like the measured ones is sigma sqrt(rank / n); orientations only help.
    assert lab.miss(fit) < 1.5 * SIGMA * np.sqrt(fit.rank / 300)


def test_the_floor() -> None:
    """The noise floor: 1.15 times 0.05 mm sqrt(27 / 500), mean of 20 machines."""
    found = []
    for seed in range(20):
        lab = Lab(seed=seed)
        fit = calib.identify(lab.model(), lab.measure(500))
        assert (fit.rank, fit.numerical_rank) == (27, 27)
        assert fit.evaluations <= 6
        found.append(lab.miss(fit))
    assert np.mean(found) <= 0.0134e-3


@pytest.mark.parametrize("point", [(0.3, 0, 0), (0, -0.3, 0.1), (0.2, 0.2, -0.2), (0, 0, 0)])
def test_an_unknown_tool_point_may_be_anywhere(point: tuple[float, ...]) -> None:
    lab = Lab(point=point)
    fit = calib.identify(lab.model(), lab.measure(200))
    assert lab.miss(fit) < 1.5 * SIGMA * np.sqrt(27 / 200)


def test_large_errors_are_found_too() -> None:
    lab = Lab()
    bad = replace(lab.true, arm=lab.arm.moved(lab.rng, length=0.02, angle=0.02, zero=0.1))
    fit = calib.identify(lab.model(), bad.measure(lab.robot, lab.arm.draw(lab.rng, 200)))
    assert fit.converged
    assert miss(fit, bad, lab.unseen) < 1e-12


def test_known_frames_stay() -> None:
    lab = Lab()
    frames = {"base": "fixed", "tool": "fixed", "base_pose": lab.true.base, "tool_poses": lab.true.tools}
    # The fixed joints before and behind the moving ones are wrong too, and no free frame takes that up.
    fit = calib.identify(lab.model(placements=["*"], **frames), lab.measure(300))
    np.testing.assert_array_equal(fit.machine.frames.base, lab.true.base)
    np.testing.assert_array_equal(fit.machine.frames.tools, [lab.true.tools["tool"]])
    assert not any(parameter.kind in ("base", "tool") for parameter in fit.parameters)
    assert lab.miss(fit) < 1.5 * SIGMA * np.sqrt(27 / 300)


def test_base_and_tool_alone_are_the_nominal_robot() -> None:
    lab = Lab()
    fit = calib.identify(lab.model(offsets="none", placements="none"), lab.measure(100))
    assert (fit.rank, len(fit.parameters)) == (9, 9)
    np.testing.assert_allclose(fit.residuals[0], fit.nominal_residuals[0], atol=1e-9)


def test_several_tool_points_and_several_sets_share_one_robot() -> None:
    lab = Lab()
    true = replace(lab.true, tools={"a": pose((0.1, 0, 0.1)), "b": pose((-0.1, 0, 0.1)), "c": pose((0, 0.1, 0.1))})

    def seen(points: str, n: int) -> calib.Measurements:
        readings = lab.arm.draw(lab.rng, n)
        return true.measure(lab.robot, readings, points=list((points * n)[:n]), rng=lab.rng, sigma=SIGMA)

    fit = calib.identify(lab.model(), [seen("ab", 200), seen("ca", 200)])
    assert fit.measurements[0].tools == ("a", "b", "c")
    assert fit.rank == 33
    assert [noise.measurements for noise in fit.noise] == [0, 1]
    for k, point in enumerate("abc"):
        d = predicted(fit, lab.unseen, k)[:, :3, 3] - true.see(lab.unseen, [point] * 500)[:, :3, 3]
        assert np.sqrt(np.mean(np.sum(d**2, axis=1))) < 1.5 * SIGMA * np.sqrt(33 / 400)


def test_poses_and_positions_together() -> None:
    lab = Lab()
    fit = calib.identify(lab.model(tool="pose"), [lab.measure(100), lab.measure(50, "pose")])
    assert fit.rank == 30
    assert [(n.measurements, n.quantity) for n in fit.noise] == [(0, "position"), (1, "position"), (1, "orientation")]
    assert lab.miss(fit) < 1.5 * SIGMA * np.sqrt(30 / 150)


def test_an_unknown_noise_is_found() -> None:
    """Doubts are those of a stated noise, times how much more the residuals scatter."""
    lab = Lab()
    data = lab.measure(150)
    stated = calib.identify(lab.model(), data, model_sigmas=[0.0])
    fit = calib.identify(lab.model(), replace(data, sigma=0.0 * data.sigma))
    assert fit.noise[0].total == pytest.approx(SIGMA, rel=0.1)
    np.testing.assert_allclose(fit.sigmas, stated.sigmas * fit.noise[0].total / SIGMA, rtol=1e-4)


# ---- how sure


@pytest.mark.parametrize("model_sigmas", [[0.0], None], ids=["noise known", "noise estimated"])
def test_95_percent_intervals_hold_the_truth_95_percent_of_the_time(model_sigmas: list[float] | None) -> None:
    """100 repetitions of one measurement, with a model without a null space."""
    rng = np.random.default_rng(11)
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    joints = ("shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint")
    model = calib.error_model(robot, offsets=joints, placements=["elbow_joint.tx", "wrist_2_joint.rx"])
    errors = dict(zip(joints, rng.normal(scale=5e-3, size=4), strict=True))
    true = Machine(arm.with_errors(np.zeros((len(arm.joints), 6)), errors), anywhere(rng), {"tool": pose(POINT)})
    readings = arm.draw(rng, 50)
    truth = calib.identify(model, true.measure(robot, readings), null_space="refuse")
    # Angles of the base are small turns of its start, which every noise moves elsewhere.
    fixed = np.array([not parameter.name.startswith("base.r") for parameter in truth.parameters])
    stated = None if model_sigmas else (0.0, 0.0)
    inside = []
    for _ in range(100):
        data = true.measure(robot, readings, rng=rng, sigma=SIGMA, stated=stated)
        fit = calib.identify(model, data, model_sigmas=model_sigmas)
        inside.append((np.abs(fit.values - truth.values) < 1.96 * fit.sigmas)[fixed])
    assert 0.93 <= np.mean(inside) <= 0.97


def test_a_prior_is_a_measurement_of_every_parameter() -> None:
    """At the solution the data's pull and the priors' balance, and the covariance is that of both together."""
    from calib.identification.system import Problem, jacobian

    lab = Lab()
    data = lab.measure(100)
    fit = calib.identify(lab.model(prior_length=0.5e-3, prior_angle=2e-3), data, model_sigmas=[0.0])
    assert (fit.rank, len(fit.null_space) > 0) == (27, True)
    (J,) = jacobian(Problem(fit.model, fit.parameters, fit.nominal.frames, fit.measurements), fit.values)
    J, r = J.reshape(-1, len(fit.values)) / SIGMA, fit.residuals[0].ravel() / SIGMA
    precision = np.array([0.0 if p.prior is None else p.prior**-2 for p in fit.parameters])
    s = scales(fit.parameters)
    pull = s * (J.T @ r + precision * fit.values)
    assert np.abs(pull).max() < 1e-3 * np.abs(s * precision * fit.values).max()
    np.testing.assert_allclose(
        fit.covariance / np.outer(s, s), np.linalg.inv((J.T @ J + np.diag(precision)) * np.outer(s, s)), atol=1e-5
    )
    assert np.all(np.isfinite(fit.sigmas))
    assert np.all(fit.sigmas <= np.where(precision > 0.0, 1.0 + 1e-9, np.inf) / np.sqrt(np.maximum(precision, 1e-300)))


# ---- what is refused, and what is told


@pytest.mark.parametrize(
    ("rows", "options", "sentence"),
    [
        (2, {}, "6 measured numbers and 0 priors determine 6 unknowns, and no numbers are left to judge the fit; "),
        (9, {}, "27 measured numbers and 0 priors determine 27 unknowns, and no numbers are left to judge the fit; "),
    ],
)
def test_too_few_rows_are_refused(rows: int, options: dict[str, object], sentence: str) -> None:
    lab = Lab()
    with pytest.raises(IdentificationError) as caught:
        calib.identify(lab.model(**options), lab.measure(rows))
    assert str(caught.value) == f"{sentence}measure more poses, free fewer parameters, or give priors."


def test_one_row_more_or_priors_are_enough() -> None:
    lab = Lab()
    assert calib.identify(lab.model(), lab.measure(10)).rank == 27
    assert calib.identify(lab.model(prior_length=1e-3, prior_angle=1e-3), lab.measure(9)).converged


@pytest.mark.parametrize(
    ("run", "error", "sentence"),
    [
        (
            lambda lab: calib.identify(
                lab.model(offsets="none", placements="none", base="fixed", tool="fixed"), lab.measure(20)
            ),
            JobError,
            "no parameter is free: free joint offsets, placements, the base or the tool.",
        ),
        (
            lambda lab: calib.identify(lab.model(), []),
            MeasurementError,
            "there are no measurements to identify from.",
        ),
        (
            lambda lab: calib.identify(lab.model(), [lab.measure(20), lab.measure(20).subset([])]),
            MeasurementError,
            "arrays: has no rows to identify from.",
        ),
        (
            lambda lab: calib.identify(lab.model(), lab.measure(20), null_space="ignore"),
            JobError,
            "null_space: 'ignore' is not one of nearest, minimal, refuse.",
        ),
        (
            lambda lab: calib.identify(lab.model(), lab.measure(20, "pose"), model_sigmas=[0.0]),
            JobError,
            "1 model sigmas are given for 2 components of the data.",
        ),
        (
            lambda lab: calib.identify(lab.model(), Lab("scara").measure(20)),
            MeasurementError,
            "arrays: the readings ('shoulder', 'elbow', 'quill', 'spin') are not those of the robot, "
            "('shoulder_pan_joint', 'shoulder_lift_joint', 'elbow_joint', 'wrist_1_joint', 'wrist_2_joint', "
            "'wrist_3_joint').",
        ),
    ],
)
def test_a_wrong_question_is_refused(run: Callable[[Lab], object], error: type[Exception], sentence: str) -> None:
    with pytest.raises(error) as caught:
        run(Lab())
    assert str(caught.value) == sentence


def test_a_fit_tells_what_it_found() -> None:
    lab = Lab()
    fit = calib.identify(lab.model(), lab.measure(200))
    assert repr(fit) == "<Fit of 45 parameters to 200 rows: formal rank 27, null space of 18 directions>"
    records = {record["name"]: record for record in fit.records()}
    assert list(records) == [parameter.name for parameter in fit.parameters]
    assert records["wrist_2_joint.tx"]["value"] == fit.value("wrist_2_joint.tx")
    for record, sigma, unidentifiable in zip(records.values(), fit.sigmas, fit.unidentifiable, strict=True):
        assert record["identifiable"] is not unidentifiable
        assert (record["sigma"] is None) == unidentifiable == np.isnan(sigma)
    with pytest.raises(calib.JobError, match=r"no parameter 'wrist_2_joint\.tq'; there are 'wrist_2_joint\.tz'"):
        fit.value("wrist_2_joint.tq")


@pytest.mark.parametrize("tool", ["position", "fixed"])
def test_rows_that_weigh_alike_are_aligned_as_well_as_they_are_fitted(tool: str) -> None:
    """Alignment alone gives their nominal machine; weights that differ by nothing to speak of have it fitted."""
    lab = Lab()
    data = lab.measure(150)
    almost = np.array(data.sigma)
    almost[0, 0] *= 1.0 + 1e-12
    aligned, fitted = (calib.identify(lab.model(tool=tool), each) for each in (data, replace(data, sigma=almost)))
    np.testing.assert_allclose(aligned.nominal.frames.base, fitted.nominal.frames.base, atol=1e-10)
    np.testing.assert_allclose(aligned.nominal.frames.tools, fitted.nominal.frames.tools, atol=1e-10)
    np.testing.assert_allclose(aligned.values, fitted.values, atol=1e-9)


@pytest.mark.parametrize("observes", ["position", "pose"])
def test_beginning_at_a_fit_to_all_rows_changes_no_fit_to_some_of_them(observes: str) -> None:
    """Nor does beginning at the fit to an outright different machine of that arm."""
    lab, other = Lab(), Lab(seed=1)
    data = lab.measure(120, observes)
    some = data.subset(np.arange(120) % 3 != 0)
    cold = calib.identify(lab.model(), some)
    for near in (calib.identify(lab.model(), data), calib.identify(other.model(), other.measure(120, observes))):
        fit = identify_near(near, lab.model(), some)
        assert fit.converged
        assert (fit.rank, fit.numerical_rank) == (cold.rank, cold.numerical_rank)
        known = ~cold.unidentifiable
        assert np.max(np.abs(fit.values - cold.values)[known] / cold.sigmas[known]) < 0.01
        np.testing.assert_allclose(fit.sigmas[known], cold.sigmas[known], rtol=1e-3)
        tips, expected = (predicted(one, lab.unseen) for one in (fit, cold))
        np.testing.assert_allclose(tips[:, :3, 3], expected[:, :3, 3], rtol=0.0, atol=0.01 * SIGMA)
        np.testing.assert_allclose(tips, expected, rtol=0.0, atol=0.01 * 2 * SIGMA)
