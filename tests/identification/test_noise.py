"""The noise that the residuals show beside the instrument's."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri

import calib
from calib.identification.losses import Loss
from calib.identification.noise import RARELY, model_variance, noise_of
from tests.support import machines
from tests.support.machines import Machine

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")


@pytest.mark.parametrize("size", [1.0, 1e-4, 1e-6, 1e-9])
def test_the_model_variance_solves_its_equation_at_any_scale(size: float) -> None:
    rng = np.random.default_rng(0)
    instrument = size * rng.uniform(0.01, 1.5, 500)
    residuals = rng.normal(scale=np.hypot(instrument, size))
    v = model_variance(residuals, instrument, 450.0)
    assert np.sum(residuals**2 / (instrument**2 + v)) == pytest.approx(450.0, rel=1e-6)


@pytest.mark.parametrize(
    ("residuals", "instrument", "freedom", "variance"),
    [
        ([1.0, -1.0, 1.0], [1.0, 1.0, 1.0], 3.0, 0.0),  # the instrument suffices
        ([1.0, -2.0, 1.0], [0.0, 0.0, 0.0], 2.0, 3.0),  # the instrument is not known
        ([1.0, -2.0, 1.0], [1.0, 1.0, 1.0], 2.0, 2.0),
        ([1.0, -2.0, 1.0], [1e-6, 1e-6, 1e-6], 2.0, 3.0),  # the instrument hardly counts
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 2.0, 0.0),
        ([0.0, 2.0], [0.0, 0.0], 0.0, 0.0),  # nothing left to judge by
    ],
)
def test_the_model_variance_of_small_cases(
    residuals: list[float], instrument: list[float], freedom: float, variance: float
) -> None:
    assert model_variance(np.array(residuals), np.array(instrument), freedom) == pytest.approx(variance, abs=1e-10)


@pytest.mark.parametrize("freedom", [7e-7, 0.01, 0.5, 3.0, 400.0])
def test_what_the_instrument_may_well_leave_adds_nothing_to_it(freedom: float) -> None:
    instrument, rare = np.ones(500), chdtri(max(freedom, 1.0), RARELY)
    for squares in (0.999 * freedom, 1.001 * freedom, 0.99 * rare, 1.01 * rare):
        residuals = np.sqrt(squares / 500.0) * instrument
        found = model_variance(residuals, instrument, freedom, clearly=True)
        assert (found > 0.0) == (squares > rare), (squares, freedom)
    # What is added then is all that the residuals ask for.
    found = model_variance(2.0 * np.ones(500), instrument, freedom, clearly=True)
    assert found == pytest.approx(2000.0 / freedom - 1.0)


def test_chi_square_is_known_where_the_instrument_is() -> None:
    known = noise_of(0, "position", np.array([1.0, 2.0, -2.0]), np.ones(3), 2.0, 3.0)
    assert (known.chi_square, known.instrument, known.model) == (3.0, 1.0, pytest.approx(np.sqrt(2.0)))
    assert known.total == pytest.approx(np.sqrt(3.0))
    unknown = noise_of(0, "position", np.array([1.0, 2.0, -2.0]), np.array([1.0, 1.0, 0.0]), 2.0, 3.0)
    assert np.isnan(unknown.chi_square)


@pytest.mark.parametrize(
    "stated", [(0.05e-3, 0.2e-3), (0.0025e-3, 0.01e-3), (0.0, 0.0)], ids=["true", "20x", "unknown"]
)
def test_an_instrument_that_promises_too_much_is_corrected_in_position_and_orientation(
    stated: tuple[float, float],
) -> None:
    rng = np.random.default_rng(5)
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    true = Machine(arm.moved(rng), machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    data = true.measure(robot, arm.draw(rng, 400), "pose", rng=rng, sigma=0.05e-3, sigma_angle=0.2e-3, stated=stated)
    model = calib.error_model(robot, offsets="all", placements="all", tool="pose")
    fit = calib.identify(model, data)
    assert [noise.quantity for noise in fit.noise] == ["position", "orientation"]
    for noise, sigma, promised in zip(fit.noise, (0.05e-3, 0.2e-3), stated, strict=True):
        assert noise.instrument == pytest.approx(promised)
        assert noise.total == pytest.approx(sigma, rel=0.05)
        if promised > 0.0:
            assert noise.chi_square == pytest.approx((sigma / promised) ** 2, rel=0.1)
        else:
            assert np.isnan(noise.chi_square)
    # The rows that the parameters have used up: 30 directions, shared by both components.
    assert sum(noise.degrees_of_freedom for noise in fit.noise) == pytest.approx(6 * 400 - 30)


@pytest.mark.parametrize("loss", ["huber", "soft_l1", "cauchy"])
def test_rows_that_lie_off_make_the_nominal_robot_no_worse(loss: Loss) -> None:
    """Base and tool of the nominal robot leave out what the fit leaves out: else any fit would seem an improvement."""
    rng = np.random.default_rng(6)
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    true = Machine(arm.moved(rng), machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    data = true.measure(robot, arm.draw(rng, 60), rng=rng, sigma=0.02e-3)
    bad = np.array(data.position)
    bad[[5, 17, 33]] += 1.0
    model = calib.error_model(robot, offsets="all", placements="all")
    good = np.delete(np.arange(60), [5, 17, 33])
    sound = calib.identify(model, data.subset(good), losses=[loss]).nominal_residuals[0]
    found = calib.identify(model, replace(data, position=bad), losses=[loss]).nominal_residuals[0][good]
    assert np.sqrt(np.mean(found**2)) < 1.2 * np.sqrt(np.mean(sound**2))


@pytest.mark.parametrize("loss", ["huber", "soft_l1", "cauchy"])
def test_robust_losses_give_back_what_they_take_from_ordinary_rows(loss: str) -> None:
    """Where no row lies off, the noise is that of the rows, whatever the loss."""
    rng = np.random.default_rng(6)
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    true = Machine(arm, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    data = true.measure(robot, arm.draw(rng, 600), rng=rng, sigma=0.05e-3, stated=(0.0, 0.0))
    fit = calib.identify(calib.error_model(robot, offsets=["elbow_joint"]), data, losses=[loss])
    assert fit.noise[0].total == pytest.approx(0.05e-3, rel=0.05)


def test_degrees_of_freedom_that_a_choice_has_spent_widen_noise_and_sigmas_alone() -> None:
    rng = np.random.default_rng(4)
    arm, robot = machines.arm(*UR10), machines.load(*UR10)
    true = Machine(arm.moved(rng), machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    seen = true.measure(robot, arm.draw(rng, 60), "position", rng=rng, sigma=1e-4, stated=(0.0, 0.0))
    model = calib.error_model(robot, offsets="all")
    plain = calib.identify(model, seen)
    freedom = plain.noise[0].degrees_of_freedom
    less = calib.identify(model, seen, spent=[0.75 * freedom])
    assert less.spent == (0.75 * freedom,)
    assert less.noise[0].total == pytest.approx(2.0 * plain.noise[0].total, rel=1e-4)
    assert less.noise[0].degrees_of_freedom == pytest.approx(0.25 * freedom, rel=1e-4)
    known = ~plain.unidentifiable
    np.testing.assert_allclose(less.spread.variances[known], 4.0 * plain.spread.variances[known], rtol=1e-3)
    assert np.all(np.abs(less.values - plain.values)[known] < 0.01 * plain.sigmas[known])
    # More than there are leave one.
    assert calib.identify(model, seen, spent=[1e6]).noise[0].degrees_of_freedom == 1.0


@pytest.mark.parametrize("spent", [[-1.0], [float("nan")], [float("inf")], [], [1.0, 1.0]])
def test_degrees_of_freedom_that_cannot_be_spent_are_refused(spent: list[float]) -> None:
    rng = np.random.default_rng(4)
    arm, robot = machines.arm(*UR10), machines.load(*UR10)
    true = Machine(arm, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    data = true.measure(robot, arm.draw(rng, 20), "position", rng=rng, sigma=1e-4)
    with pytest.raises(calib.JobError, match=r"spent: .* is no list of degrees of freedom, 0 or more, of 1 component"):
        calib.identify(calib.error_model(robot, offsets="all"), data, spent=spent)
