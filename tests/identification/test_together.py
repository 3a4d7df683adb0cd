"""Rows of a photograph that err together: whitening by their covariance, and its sizes found from residuals."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from calib.identification.together import Together, likeliest

PHOTOGRAPHS, MARKS = 60, 20
LENGTH, ANGLE, SIGMA = 1.5e-4, 4e-4, 0.05


def seen(rng: np.random.Generator, photographs: int = PHOTOGRAPHS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers of photographs, derivatives by the tool's twist in px, and a Jacobian of three parameters."""
    number = np.repeat(np.arange(photographs), MARKS)
    # A camera of 900 px at half a metre: what a shift does, and what a turn.
    by_twist = rng.normal(size=(len(number), 2, 6)) * np.repeat([1800.0, 900.0], 3)
    return number, by_twist, rng.normal(size=(len(number), 2, 3))


def moved(rng: np.random.Generator, number: np.ndarray, by_twist: np.ndarray) -> np.ndarray:
    """What the twists of the photographs do to every row."""
    twists = rng.normal(size=(number.max() + 1, 6)) * np.repeat([LENGTH, ANGLE], 3)
    return np.einsum("ndk,nk->nd", by_twist, twists[number])


def at_solution(J: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Residuals where parameters explain as much of them as they can."""
    flat = J.reshape(-1, J.shape[2])
    return r - J @ np.linalg.lstsq(flat, r.ravel(), rcond=None)[0]


def test_rows_are_whitened_by_the_covariance_of_their_photograph() -> None:
    rng = np.random.default_rng(0)
    number, by_twist, _ = seen(rng, 3)
    order = rng.permutation(len(number))
    number, by_twist = number[order], by_twist[order]
    sigma = rng.uniform(0.03, 0.2, size=(len(number), 2))
    together = Together.of(LENGTH, ANGLE, 0.0, number, by_twist, sigma)
    size = sigma.size
    less = together.less(np.eye(size).reshape(len(number), 2, size)).reshape(size, size)
    U = (by_twist * np.repeat([LENGTH, ANGLE], 3) / sigma[:, :, None]).reshape(size, 6)
    same = np.repeat(number, 2)[:, None] == np.repeat(number, 2)
    covariance = np.eye(size) + np.where(same, U @ U.T, 0.0)
    np.testing.assert_allclose(less @ covariance @ less.T, np.eye(size), atol=1e-9)
    # Photograph by photograph, in any order of rows.
    parts = [np.flatnonzero(np.repeat(number, 2) == k) for k in range(3)]
    np.testing.assert_allclose(
        less[np.ix_(*[np.concatenate(parts)] * 2)], block_diag(*[less[np.ix_(p, p)] for p in parts])
    )


@pytest.mark.parametrize("seed", range(3))
def test_sizes_of_a_planted_twist_are_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    number, by_twist, J = seen(rng)
    r = at_solution(J, moved(rng, number, by_twist) + SIGMA * rng.normal(size=(len(number), 2)))
    known = np.zeros((3, 4))
    found = likeliest(number, by_twist, J, r, np.zeros_like(r), known)
    assert found is not None
    length, angle, variance = found
    assert length == pytest.approx(LENGTH, rel=0.3)
    assert angle == pytest.approx(ANGLE, rel=0.3)
    assert variance == pytest.approx(SIGMA**2, rel=0.1)
    order = rng.permutation(len(number))
    again = likeliest(number[order], by_twist[order], J[order], r[order], np.zeros_like(r), known)
    assert again == pytest.approx(found, rel=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_rows_that_err_alone_are_left_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    number, by_twist, J = seen(rng)
    r = at_solution(J, SIGMA * rng.normal(size=(len(number), 2)))
    assert likeliest(number, by_twist, J, r, np.zeros_like(r), np.zeros((3, 4))) is None


def test_photographs_of_few_marks_are_whitened_too_and_tell_nothing() -> None:
    rng = np.random.default_rng(0)
    number = np.array([0, 1, 1, 2, 2, 2])
    by_twist, sigma = rng.normal(size=(6, 2, 6)) * 900.0, np.full((6, 2), 0.05)
    together = Together.of(LENGTH, ANGLE, 0.0, number, by_twist, sigma)
    less = together.less(np.eye(12).reshape(6, 2, 12)).reshape(12, 12)
    U = (by_twist * np.repeat([LENGTH, ANGLE], 3) / sigma[:, :, None]).reshape(12, 6)
    same = np.repeat(number, 2)[:, None] == np.repeat(number, 2)
    np.testing.assert_allclose(less @ (np.eye(12) + np.where(same, U @ U.T, 0.0)) @ less.T, np.eye(12), atol=1e-9)
    J, r = rng.normal(size=(6, 2, 3)), rng.normal(size=(6, 2))
    assert likeliest(number, by_twist, J, r, sigma, np.zeros((3, 4))) is None
