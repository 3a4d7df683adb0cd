"""Weights of robust losses against the derivatives of the losses themselves, and their shrinkage against chance."""

import numpy as np
import pytest

import calib
from calib.identification.losses import Loss, scatter_weight, shrinkage, squares, weighed_square, weight
from tests.support import machines, touching

# rho(z) of z = (t / c)^2, as in scipy.optimize.least_squares, and c.
RHO = {
    "huber": (lambda z: np.where(z <= 1.0, z, 2.0 * np.sqrt(z) - 1.0), 1.345),
    "soft_l1": (lambda z: 2.0 * (np.sqrt(1.0 + z) - 1.0), 1.287),
    "cauchy": (np.log1p, 2.385),
}


@pytest.mark.parametrize("loss", RHO)
def test_a_weight_is_the_slope_of_the_loss(loss: Loss) -> None:
    rho, c = RHO[loss]
    t = np.array([0.1, 0.7, 1.2, 1.5, 2.3, 4.0, 30.0])
    z, h = (t / c) ** 2, 1e-5
    assert np.allclose(weight(loss, t), (rho(z * (1.0 + h)) - rho(z * (1.0 - h))) / (2.0 * h * z), rtol=1e-6)
    assert weight(loss, np.zeros(1)) == 1.0


@pytest.mark.parametrize("loss", RHO)
def test_squares_are_those_of_the_loss(loss: Loss) -> None:
    rho, c = RHO[loss]
    t = np.array([0.0, 0.1, 0.7, 1.2, 1.5, 2.3, 4.0, 30.0, 1e6])
    assert np.allclose(squares(loss, t), c**2 * rho((t / c) ** 2), rtol=1e-9)


@pytest.mark.parametrize("loss", RHO)
def test_efficiency_at_the_normal_is_95_percent(loss: Loss) -> None:
    """That of a location: (E psi')^2 / E psi^2, psi(t) = w(t) t, by the trapezoidal rule."""
    t = np.linspace(-12.0, 12.0, 240_001)
    density = np.exp(-(t**2) / 2.0) / np.sqrt(2.0 * np.pi)
    psi = weight(loss, np.abs(t)) * t
    slope = np.gradient(psi, t)
    assert np.trapezoid(slope * density, t) ** 2 / np.trapezoid(psi**2 * density, t) == pytest.approx(0.95, abs=5e-4)


def test_squares_weigh_all_alike() -> None:
    assert np.array_equal(weight("linear", np.array([0.0, 1.0, 1e6])), np.ones(3))
    assert np.array_equal(squares("linear", np.array([0.0, 3.0])), [0.0, 9.0])
    assert shrinkage("linear", 3) == 1.0


@pytest.mark.parametrize(("loss", "bound"), [("huber", 1.345**2), ("soft_l1", 1.287**2), ("cauchy", 2.385**2)])
def test_no_row_adds_more_to_the_scatter_than_a_bound(loss: Loss, bound: float) -> None:
    t = np.array([1e3, 1e6])
    assert np.allclose(scatter_weight(loss, t) * t**2, bound, rtol=1e-5)
    assert scatter_weight(loss, np.zeros(1)) == 1.0


@pytest.mark.parametrize("loss", RHO)
@pytest.mark.parametrize("d", [1, 3])
def test_shrinkage_is_what_ordinary_rows_lose(loss: Loss, d: int) -> None:
    r = np.random.default_rng(0).normal(size=(400_000, d))
    square = np.mean(r**2, axis=1)
    assert np.mean(scatter_weight(loss, np.sqrt(square)) * square) == pytest.approx(shrinkage(loss, d), rel=0.01)
    assert np.mean(weight(loss, np.sqrt(square)) * square) == pytest.approx(weighed_square(loss, d), rel=0.01)


def test_rows_that_weigh_less_beside_stated_priors_come_to_rest() -> None:
    """Where no step helps while rows are weighted as before, they are weighted by what they leave at the last point."""
    made = touching.lab(4, noise=3e-5, base=machines.pose((0.8, -0.4, 0.2), (0.1, 0.2, -1.2)))
    data = [made.positions(30), made.sockets(11)]
    priors = calib.Priors(length=1.8e-3, angle=1.5e-3)
    model = calib.error_model(made.robot, offsets="all", placements="all", priors=priors)
    fit = calib.identify(model, data, losses=["linear", "huber"])
    assert (fit.converged, fit.narrowed) == (True, 1.0)


@pytest.mark.parametrize("loss", RHO)
def test_weights_settle_among_points_that_no_arm_has_reached(loss: Loss) -> None:
    """Where most rows lie off, full steps by the last weights are short; what they foretell of each other is used."""
    made = touching.lab(4, noise=3e-5, base=machines.pose((0.8, -0.4, 0.2), (0.1, 0.2, -1.2)))
    data = made.positions(400)
    nowhere = np.random.default_rng(0).uniform(-0.9, 0.9, (len(data), 3))
    data = calib.positions(made.robot, data.readings, nowhere, sigma=3e-5)
    fit = calib.identify(calib.error_model(made.robot, offsets="all", placements="all"), data, losses=[loss])
    assert fit.converged
    assert fit.evaluations < 200
