"""Boards: what their modes hold and what not, and where marks are, against differences."""

import numpy as np
import pytest

from calib.foundations.errors import JobError
from calib.measurement.boards import Board, places_of, shape_modes

MARKS = np.array([(0.03 * i, 0.025 * j, 0.0) for j in range(4) for i in range(6)])


def test_all_modes_with_the_motions_of_the_whole_are_every_motion_of_the_marks() -> None:
    modes = shape_modes(MARKS, "free")
    assert modes.shape == (24, 3, 72 - 7)
    flat = modes.reshape(72, -1)
    assert np.linalg.matrix_rank(flat) == 65
    np.testing.assert_allclose(np.mean(np.sum(modes**2, axis=1), axis=0), 1.0)
    for motion in (
        np.tile([1.0, 0.0, 0.0], (24, 1)),
        np.cross([0.3, -0.2, 0.9], MARKS),
        MARKS - MARKS.mean(axis=0),
    ):
        np.testing.assert_allclose(flat.T @ motion.ravel(), 0.0, atol=1e-9)


def test_a_sheet_that_bends_and_a_print_that_is_sheared_are_quadratic() -> None:
    modes = shape_modes(MARKS, "quadratic").reshape(72, 5)
    x, y = MARKS[:, 0], MARKS[:, 1]
    bent = np.column_stack([0.002 * y - 0.001 * x, 0.003 * x, 0.5 * x**2 - 0.3 * x * y + 0.1 * y**2 + 0.01 * x])
    left = np.column_stack([modes, *(m.reshape(72) for m in _whole())])
    r = bent.ravel() - left @ np.linalg.lstsq(left, bent.ravel(), rcond=None)[0]
    assert np.abs(r).max() < 1e-15


def _whole() -> list[np.ndarray]:
    return [np.tile(e, (24, 1)) for e in np.eye(3)] + [np.cross(e, MARKS) for e in np.eye(3)] + [MARKS]


def test_derivatives_of_places_match_central_differences() -> None:
    modes, rng = shape_modes(MARKS, "free"), np.random.default_rng(0)
    values, h = np.concatenate([[0.01], rng.normal(scale=1e-3, size=65)]), 1e-4
    _, J = places_of(MARKS, modes, values)
    for k in range(66):
        step = h * np.eye(66)[k]
        numeric = (places_of(MARKS, modes, values + step)[0] - places_of(MARKS, modes, values - step)[0]) / (2 * h)
        np.testing.assert_allclose(J[:, :, k], numeric, atol=1e-9)


def test_marks_are_known_by_their_places() -> None:
    board = Board(marks=MARKS)
    assert board.numbers(np.array([MARKS[7], MARKS[0], [0.5, 0.0, 0.0]])).tolist() == [7, 0, -1]
    assert board.modes.shape == (24, 3, 0)
    assert Board(marks=MARKS, shape="free").mode_names[4:7] == ("shear", "shape_6", "shape_7")


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"shape": "round"}, "shape: 'round' is not one of flat, quadratic, free"),
        ({"shape": "free"}, "a free shape needs the places of six marks or more"),
        ({"scale_sigma": 0.5}, "square_sigma is 0.5; allowed is 0, or 1e-06 to 0.2"),
        ({"marks": np.random.default_rng(0).normal(size=(9, 3)), "shape": "quadratic"}, "not in a plane"),
    ],
)
def test_impossible_boards_are_refused(given: dict[str, object], says: str) -> None:
    with pytest.raises(JobError, match=says):
        Board(**given)
