"""Noise that remembers, estimated from what a fit of many parameters leaves of a short stream."""

import numpy as np

from calib.identification import memory
from calib.identification.system import Component
from scripts.simulate.streams import remembering

STEP, MEMORIES = 1.0 / 60.0, (0.05, 0.5)


def slow_columns(rng: np.random.Generator, times: np.ndarray, many: int) -> np.ndarray:
    """Columns (n, 3, many) that change in 4 to 20 s, as those of an arm that moves."""
    rates = 2.0 * np.pi / np.exp(rng.uniform(*np.log([4.0, 20.0]), (3, many, 3)))
    waves = np.sin(np.multiply.outer(times, rates) + rng.uniform(0.0, 2.0 * np.pi, rates.shape))
    return np.asarray(waves.sum(axis=-1))


def test_what_parameters_take_is_that_of_the_whole_matrices() -> None:
    rng = np.random.default_rng(1)
    times = np.sort(rng.choice(120, 100, replace=False)) * STEP
    J, taus = rng.normal(size=(100, 2, 7)), np.array([0.03, 0.3])
    flat = J.reshape(-1, 7)
    C = np.linalg.inv(flat.T @ flat + np.eye(7))
    lags = memory._Lags.of(times, STEP, 0.3)
    found = memory._taken(lags, taus, times, J, C)
    left = np.eye(200) - flat @ C @ flat.T
    apart = np.abs(times[:, None] - times)
    for k, S in enumerate([np.eye(100), *(np.exp(-apart / tau) for tau in taus)]):
        whole = np.kron(S, np.eye(2))
        taken = (whole - left @ whole @ left).reshape(100, 2, 100, 2)
        for lag, own, value in zip(lags.rows, lags.pairs, found[:, k], strict=True):
            truth = np.mean([taken[n + lag, d, n, d] for n in own for d in range(2)])
            np.testing.assert_allclose(value, truth, atol=1e-12)


def test_of_a_short_stream_the_slow_noise_is_found_although_parameters_took_half_of_it() -> None:
    times, found = np.arange(0.0, 18.0, STEP), []
    truth = memory.Memory(0, "position", 1.0 / 3.0, np.full(2, 1.0 / 3.0), np.array(MEMORIES), STEP, len(times))
    for seed in range(12):
        rng = np.random.default_rng(seed)
        J = slow_columns(rng, times, 45)
        flat = J.reshape(-1, J.shape[2])
        C = np.linalg.inv(flat.T @ flat)
        e = sum(remembering(rng, times, one) for one in (0.0, *MEMORIES)) / np.sqrt(3.0)
        r = e - (flat @ (C @ (flat.T @ e.ravel()))).reshape(e.shape)
        one = memory._memory(Component(0, "position", slice(0, 3)), times, J, r, C, len(times))
        assert one is not None
        # The mean variance of parameters, by what was found and by the truth.
        said, true = (np.mean(np.diag(C @ memory._gram(m, times, J) @ C)) for m in (one, truth))
        found.append(said / true)
    assert 0.85 < np.mean(found) < 1.15
