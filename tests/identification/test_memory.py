"""Temperature with memory and wind-up by friction: found again, of rows made by small steps in time and by numpy."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.foundations.errors import RobotError
from calib.robot.conditions import Conditions
from calib.robot.warming import lagged, rungs
from tests.support import machines, slow
from tests.support.gears import UR10

LIFT, ELBOW = slow.LIFT[:2]
TERMS = {"warming": [LIFT], "hysteresis": [LIFT, ELBOW], "elastic": [LIFT, ELBOW]}


def model() -> calib.ErrorModel:
    return machines.model(machines.load(*UR10), offsets="all", placements="all", **TERMS)


@pytest.mark.parametrize("tau", [400.0, 1500.0, 6000.0])
def test_coefficients_and_time_constant_are_found_within_a_tenth(tau: float) -> None:
    """Scripts/studies/memory.py counts over a hundred machines."""
    truth = slow.Slow(int(tau), {LIFT: (8e-5, tau)}, {LIFT: 2e-6, ELBOW: 6e-6}, {LIFT: 9e-6, ELBOW: 1.4e-5})
    fit = calib.identify(model(), truth.measured()[0])
    assert fit.converged
    assert fit.value(f"{LIFT}.warming_1800") == pytest.approx(8e-5, rel=0.1)
    assert 1800.0 * 10.0 ** fit.value(f"{LIFT}.warming_time_1800") == pytest.approx(tau, rel=0.1)
    for name, value in truth.rubs.items():
        assert fit.value(f"{name}.hysteresis") == pytest.approx(value, rel=0.1)
    for name, value in truth.winds.items():
        assert fit.value(f"{name}.elastic") == pytest.approx(value, rel=0.1)


def test_neither_the_order_of_rows_nor_when_the_clock_began_matters() -> None:
    truth = slow.Slow(3, {LIFT: (8e-5, 900.0)}, {ELBOW: 6e-6}, {})
    data, _ = truth.measured(150)
    names = [parameter.name for parameter in model().parameters() if parameter.kind == "term"]
    first = [calib.identify(model(), data).value(name) for name in names]
    mixed = data.subset(np.random.default_rng(0).permutation(len(data)))
    np.testing.assert_allclose([calib.identify(model(), mixed).value(name) for name in names], first, rtol=1e-5)
    assert data.times is not None
    told = replace(data.conditions, lagged=None).in_time(data.times + 1e6)
    later = calib.identify(model(), replace(data, conditions=told))
    np.testing.assert_allclose([later.value(name) for name in names], first, rtol=1e-5)


def test_where_nothing_lags_the_time_constant_is_not_determined() -> None:
    data, _ = slow.Slow(4, {}, {ELBOW: 6e-6}, {}).measured(150)
    fit = calib.identify(model(), data)
    k = [parameter.name for parameter in fit.parameters].index(f"{LIFT}.warming_time_1800")
    assert not fit.sigmas[k] < 0.15


def test_a_lag_of_every_rung_and_between_them_is_that_of_small_steps() -> None:
    rng = np.random.default_rng(1)
    times = np.sort(rng.uniform(0.0, 9000.0, 200))
    degrees = 20.0 + 5.0 * np.sin(times / 900.0) + times / 2000.0
    for tau in (60.0, 333.0, 2500.0, 20_000.0):
        shares, _ = rungs(np.array([tau]))
        found = lagged(times, degrees) @ shares[:, 0]
        np.testing.assert_allclose(found, slow.late(times, degrees, tau), rtol=0, atol=0.06)
    mixed = rng.permutation(200)
    np.testing.assert_array_equal(lagged(times[mixed], degrees[mixed]), lagged(times, degrees)[mixed])


def test_beyond_the_ladder_nothing_changes() -> None:
    shares, slopes = rungs(np.array([1e-3, 1e9]))
    np.testing.assert_allclose(shares.sum(axis=0), 1.0)
    np.testing.assert_array_equal(slopes, 0.0)


def test_without_a_temperature_or_a_time_for_each_row_nothing_is_remembered() -> None:
    with pytest.raises(RobotError, match="the rows have no temperature"):
        Conditions().in_time(np.zeros(3))
    with pytest.raises(RobotError, match=r"times of shape \(2,\); needed is one for each of 3 rows"):
        Conditions(temperature=np.full(3, 20.0)).in_time(np.zeros(2))
