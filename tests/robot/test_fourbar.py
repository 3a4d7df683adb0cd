"""The parallelogram in closed form: the loop it solves, its derivatives, and what its linear form is worth."""

import numpy as np
import pytest

from calib.foundations.errors import PoseError
from calib.robot.fourbar import (
    fit_parallelogram,
    four_bar,
    four_bar_partials,
    parallelogram_regressor,
    visible_combinations,
)

Array = np.ndarray
NOMINAL = {"L2": 0.705, "b": 0.18, "c": 0.705, "e": 0.18}
WRONG = {"L2": 0.7054, "b": 0.1797, "c": 0.7048, "e": 0.1805}
RADIUS = 0.18


def grid(low: float = 25.0, high: float = 155.0, n: int = 40) -> tuple[Array, Array]:
    """Crank and lower arm over the joint range, alpha in deg."""
    phi2 = np.radians(90.0 + np.linspace(-60.0, 60.0, 13))[:, None]
    psi = phi2 + np.radians(np.linspace(low, high, n))
    return psi.ravel(), np.broadcast_to(phi2, psi.shape).ravel()


def u(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("lengths", [NOMINAL, WRONG, {"L2": 0.6, "b": 0.2, "c": 0.63, "e": 0.19}])
def test_the_angles_close_the_loop_on_the_branch_of_the_parallelogram(lengths: dict[str, float], side: float) -> None:
    psi, phi2 = (side * angle for angle in grid(35, 145))
    phi, gamma = four_bar(psi, phi2, **lengths)
    gap = lengths["L2"] * u(phi2) + lengths["e"] * u(phi) - lengths["b"] * u(psi) - lengths["c"] * u(gamma)
    assert np.abs(gap).max() < 1e-15
    assert np.abs(phi - psi).max() < 0.6


def test_equal_opposite_links_stay_parallel() -> None:
    psi, phi2 = grid()
    phi, gamma = four_bar(psi + 4 * np.pi, phi2, **NOMINAL)
    np.testing.assert_allclose(phi, psi + 4 * np.pi, atol=1e-14)
    np.testing.assert_allclose(gamma, np.arctan2(np.sin(phi2), np.cos(phi2)), atol=1e-14)


def test_angles_broadcast_and_cannot_be_changed() -> None:
    phi, gamma = four_bar(np.radians([160.0, 180.0]), np.pi / 2, **WRONG)
    assert phi.shape == gamma.shape == (2,)
    assert not phi.flags.writeable


@pytest.mark.parametrize("name", ["L2", "b", "c", "e", "psi", "phi2"])
def test_partial_derivatives_are_those_of_central_differences(name: str) -> None:
    psi, phi2 = grid(30, 150)
    at: dict[str, object] = {"psi": psi, "phi2": phi2, **WRONG}

    def phi(step: float) -> Array:
        return four_bar(**(at | {name: at[name] + step}))[0]

    numeric = (8.0 * (phi(1e-4) - phi(-1e-4)) - (phi(2e-4) - phi(-2e-4))) / 12e-4
    exact = getattr(four_bar_partials(psi, phi2, **WRONG), name)
    np.testing.assert_allclose(exact, numeric, rtol=1e-8, atol=1e-8)


def test_the_linear_form_is_the_derivative_at_the_parallelogram() -> None:
    psi, phi2 = grid()
    partial = four_bar_partials(psi, phi2, **NOMINAL)
    _, by_k1, by_k2 = parallelogram_regressor(psi, phi2, radius=RADIUS).T / RADIUS
    np.testing.assert_allclose(partial.L2, by_k1, atol=1e-11)
    np.testing.assert_allclose(partial.c, -by_k1, atol=1e-11)
    np.testing.assert_allclose(partial.e, by_k2, atol=1e-11)
    np.testing.assert_allclose(partial.b, -by_k2, atol=1e-11)
    np.testing.assert_allclose(partial.psi, 1.0, atol=1e-12)
    np.testing.assert_allclose(partial.phi2, 0.0, atol=1e-12)


def test_only_differences_are_visible() -> None:
    assert visible_combinations(dL2=3e-4, db=1e-4, dc=1e-4, de=4e-4, radius=0.2) == pytest.approx((1e-3, 1.5e-3))
    # Pairs that are wrong alike stay a parallelogram.
    psi, phi2 = grid()
    phi, _ = four_bar(psi, phi2, L2=0.707, b=0.183, c=0.707, e=0.183)
    np.testing.assert_allclose(phi, psi, atol=1e-14)


@pytest.mark.parametrize(("low", "high", "condition"), [(25.0, 155.0, 8.0), (60.0, 120.0, 46.0)])
def test_condition_of_the_linear_form(low: float, high: float, condition: float) -> None:
    alpha = np.radians(np.linspace(low, high, 20001))
    fit = fit_parallelogram(alpha, 0.0 * alpha, np.zeros_like(alpha))
    assert fit.condition == pytest.approx(condition, rel=0.01)


@pytest.mark.parametrize(("error", "worst_mrad"), [(0.5e-3, 0.007), (5e-3, 0.66)])
def test_the_linear_form_is_off_by_a_hundredth_where_the_deviation_is_tenfold(error: float, worst_mrad: float) -> None:
    """The document's 0.007 mrad at 2.8 and 0.66 at 27: a rear lever that is wrong, alpha 60..120 deg."""
    psi, phi2 = grid(60, 120, 601)
    worst = []
    for de in (error, -error):
        linear = parallelogram_regressor(psi, phi2, radius=RADIUS) @ [0.0, 0.0, de / RADIUS]
        exact = four_bar(psi, phi2, **(NOMINAL | {"e": 0.18 + de})).phi - psi
        worst.append(np.abs(exact - linear).max() * 1e3)
    assert max(worst) == pytest.approx(worst_mrad, rel=0.06)


def test_small_wrong_lengths_are_recovered_as_their_differences() -> None:
    psi, phi2 = grid()
    dL2, db, dc, de = 5e-6, -3e-6, 2e-6, 4e-6
    phi, _ = four_bar(psi, phi2, L2=0.705 + dL2, b=0.18 + db, c=0.705 + dc, e=0.18 + de)
    fit = fit_parallelogram(psi, phi2, phi - psi + 1e-3)
    k1, k2 = visible_combinations(dL2=dL2, db=db, dc=dc, de=de, radius=RADIUS)
    assert fit.k0 == pytest.approx(1e-3, abs=1e-8)
    assert (fit.k1, fit.k2) == pytest.approx((k1, k2), abs=1e-8)
    assert (fit.dx, fit.dy) == (None, None)


def test_a_crank_that_is_not_coaxial_is_recovered() -> None:
    psi, phi2 = grid()
    d = np.array([20e-6, -35e-6])
    # The same four-bar seen from the crank's shaft: the lower arm reaches from -d.
    elbow = 0.705 * u(phi2) - d
    L2, towards = np.linalg.norm(elbow, axis=1), np.arctan2(elbow[:, 1], elbow[:, 0])
    phi = np.array(
        [four_bar(a, t, L2=length, b=0.18, c=0.705, e=0.18).phi for a, t, length in zip(psi, towards, L2, strict=True)]
    )
    fit = fit_parallelogram(psi, phi2, phi - psi, radius=RADIUS, coaxial=True)
    assert (fit.dx, fit.dy) == pytest.approx(tuple(d), abs=1e-7)
    assert max(abs(fit.k0), abs(fit.k1), abs(fit.k2)) < 1e-6
    assert fit.sigmas.shape == (5,)
    assert fit.rms < 1e-6


def test_sigmas_are_the_scatter_of_the_estimates() -> None:
    psi, phi2 = grid(n=6)
    rng = np.random.default_rng(0)
    truth = np.array([1e-3, -6e-4, 5e-4, 1e-5, -2e-5])
    exact = parallelogram_regressor(psi, phi2, radius=RADIUS, coaxial=True) @ truth
    fits = [
        fit_parallelogram(psi, phi2, exact + rng.normal(scale=2e-5, size=exact.shape), radius=RADIUS, coaxial=True)
        for _ in range(400)
    ]
    found = np.array([[f.k0, f.k1, f.k2, f.dx, f.dy] for f in fits])
    sigmas = np.mean([f.sigmas for f in fits], axis=0)
    np.testing.assert_allclose(found.std(axis=0), sigmas, rtol=0.12)
    assert np.all(np.abs(found.mean(axis=0) - truth) < 4.0 * sigmas / 20.0)


def test_as_many_rows_as_numbers_leave_no_sigma() -> None:
    fit = fit_parallelogram(np.radians([60.0, 90.0, 120.0]), 0.0, [1e-3, 2e-3, 3e-3])
    assert np.all(np.isinf(fit.sigmas))


def test_too_few_angles_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^5 rows determine 1 of 3 numbers; more angles alpha are needed\.$"):
        fit_parallelogram(np.full(5, 1.0), 0.0, np.zeros(5))


def test_links_that_do_not_reach_and_dead_centres_name_their_row() -> None:
    with pytest.raises(PoseError, match=r"^row 1: the parallelogram cannot close: its links do not reach\.$"):
        four_bar(np.radians([90.0, 5.0]), 0.0, L2=0.705, b=0.18, c=0.72, e=0.18)
    for call in (four_bar, four_bar_partials):
        with pytest.raises(
            PoseError, match=r"^row 2: the parallelogram is at a dead centre: its joints may go two ways"
        ):
            call([1.0, 2.0, 0.5], 0.5, **NOMINAL)
    with pytest.raises(PoseError, match=r"^row 0: the parallelogram is at a dead centre"):
        parallelogram_regressor(0.5, 0.5, radius=1.0)
