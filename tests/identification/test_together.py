"""Rows of a photograph that err together: whitening by their covariance, and its sizes found from residuals."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from calib.identification.arrow import Arrow, Split
from calib.identification.together import PhotographRows, Together, _Criterion, _heads, likeliest

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


def plain(J: np.ndarray, by_twist: np.ndarray, r: np.ndarray) -> PhotographRows:
    """Rows of which all parameters are common."""
    return PhotographRows(J, np.zeros((*r.shape, 0)), np.full(len(r), -1), by_twist, r)


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
    known, zero = Arrow.plain(np.zeros((3, 3))), np.zeros_like(r)
    found = likeliest(number, plain(J, by_twist, r), zero, known)
    assert found is not None
    length, angle, variance = found
    assert length == pytest.approx(LENGTH, rel=0.3)
    assert angle == pytest.approx(ANGLE, rel=0.3)
    assert variance == pytest.approx(SIGMA**2, rel=0.1)
    order = rng.permutation(len(number))
    again = likeliest(number[order], plain(J[order], by_twist[order], r[order]), zero, known)
    assert again == pytest.approx(found, rel=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_rows_that_err_alone_are_left_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    number, by_twist, J = seen(rng)
    r = at_solution(J, SIGMA * rng.normal(size=(len(number), 2)))
    assert likeliest(number, plain(J, by_twist, r), np.zeros_like(r), Arrow.plain(np.zeros((3, 3)))) is None


@pytest.mark.parametrize("times", [1.0, 1e9])
def test_no_arm_comes_back_to_decimetres_only(times: float) -> None:
    """Twists that large are of readings that are not those of the photographs; also of marks at the camera's plane."""
    rng = np.random.default_rng(0)
    number, by_twist, J = seen(rng)
    r = at_solution(J, 300.0 * moved(rng, number, by_twist) + SIGMA * rng.normal(size=(len(number), 2)))
    known, zero = Arrow.plain(np.zeros((3, 3))), np.zeros_like(r)
    assert likeliest(number, plain(J, times * by_twist, r * times), zero, known) is None


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
    assert likeliest(number, plain(J, by_twist, r), sigma, Arrow.plain(np.zeros((3, 3)))) is None


def of_boards(seed: int) -> tuple[np.ndarray, PhotographRows, Arrow, np.ndarray]:
    """Twelve photographs, three each of boards with two parameters of their own, and three common ones; the last two
    photographs are of no board. What is known of all, and all columns (N, d, 9) in the order of the parameters.
    """
    rng = np.random.default_rng(seed)
    number, by_twist, J = seen(rng, 11)
    block = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2, -1, -1])[number]
    own = rng.normal(size=(len(number), 2, 2))
    own[block < 0] = 0.0
    # The second board has but one parameter.
    own[block == 1, :, 1] = 0.0
    split = Split(np.array([0, 3, 5]), np.array([[1, 2], [4, -1], [6, 7]]))
    whole = np.zeros((len(number), 2, split.size))
    whole[:, :, split.common] = J
    for k, columns in enumerate(split.blocks):
        whole[np.ix_(block == k, [0, 1], columns[columns >= 0])] = own[block == k][:, :, columns >= 0]
    r = moved(rng, number, by_twist) + SIGMA * rng.normal(size=(len(number), 2))
    known = Arrow.empty(split).held(rng.uniform(0.1, 2.0, split.size), rng.normal(size=split.size))
    return number, PhotographRows(J, own, block, by_twist, r), known, whole


def written_out(known: Arrow) -> np.ndarray:
    """Rows ``[J r]`` (q, p + 1) of an arrow."""
    split, a = known.split, known.a
    heads = np.zeros((*known.heads.shape[:2], split.size + 1))
    heads[:, :, split.common], heads[:, :, -1] = known.heads[:, :, a:-1], known.heads[:, :, -1]
    for k, columns in enumerate(split.blocks):
        heads[k][:, columns[columns >= 0]] = known.heads[k][:, :a][:, columns >= 0]
    rest = np.zeros((len(known.rest), split.size + 1))
    rest[:, split.common], rest[:, -1] = known.rest[:, :-1], known.rest[:, -1]
    return np.concatenate([heads.reshape(-1, split.size + 1), rest])


def test_the_criterion_is_the_restricted_likelihood_of_the_whole_covariance() -> None:
    number, rows, known, whole = of_boards(0)
    sigma = np.full_like(rows.residual, SIGMA)
    heads, _ = _heads(number, rows, sigma, known.split)
    criterion = _Criterion.of(heads, known)
    more = written_out(known)

    def dense(theta: np.ndarray) -> float:
        widths = np.repeat([1e-4 * np.exp(theta[0]), 3e-4 * np.exp(theta[1])], 3)
        U = (rows.by_twist * widths / SIGMA).reshape(-1, 6)
        same = np.repeat(number, 2)[:, None] == np.repeat(number, 2)
        V = block_diag(np.eye(len(U)) + np.where(same, U @ U.T, 0.0), np.eye(len(more)))
        X = np.concatenate([whole.reshape(len(U), -1) / SIGMA, more[:, :-1]])
        y = np.concatenate([rows.residual.ravel() / SIGMA, more[:, -1]])
        VX, Vy = np.linalg.solve(V, X), np.linalg.solve(V, y)
        H = X.T @ VX
        logs = float(np.linalg.slogdet(V)[1] + np.linalg.slogdet(H)[1])
        return logs + float(y @ Vy - VX.T @ y @ np.linalg.solve(H, VX.T @ y))

    points = [np.array(at) for at in ((0.0, 0.0), (1.0, -2.0), (-3.0, 1.5))]
    offsets = [criterion(at)[0] - dense(at) for at in points]
    np.testing.assert_allclose(offsets, offsets[0], atol=1e-6 * abs(dense(points[0])))
    for at in points:
        differences = [(criterion(at + step)[0] - criterion(at - step)[0]) / 2e-4 for step in 1e-4 * np.eye(2)]
        np.testing.assert_allclose(criterion(at)[1], differences, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_sizes_are_the_same_with_boards_eliminated(seed: int) -> None:
    number, rows, known, whole = of_boards(seed)
    found = likeliest(number, rows, np.zeros_like(rows.residual), known)
    more = written_out(known)
    dense = Arrow(Split.none(more.shape[1] - 1), np.zeros((0, 0, more.shape[1])), more)
    same = likeliest(number, plain(whole, rows.by_twist, rows.residual), np.zeros_like(rows.residual), dense)
    assert found is not None
    assert found == pytest.approx(same, rel=1e-6)
