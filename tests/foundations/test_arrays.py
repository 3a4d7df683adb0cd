"""Rows among those of their kind, and some of many things."""

import numpy as np
import pytest

from calib.foundations.arrays import evenly, number_in_kind


@pytest.mark.parametrize("n", [0, 1, 7, 500])
def test_rows_are_numbered_among_those_alike_in_all_kinds(n: int) -> None:
    kinds = np.random.default_rng(n).integers(0, 4, (3, n))
    counts: dict[tuple[int, ...], int] = {}
    expected = []
    for kind in map(tuple, kinds.T.tolist()):
        expected.append(counts.get(kind, 0))
        counts[kind] = expected[-1] + 1
    assert number_in_kind(*kinds).tolist() == expected


@pytest.mark.parametrize(("count", "taken"), [(0, []), (1, [0]), (4, [0, 1, 2, 3]), (5, [0, 2, 4]), (9, [0, 3, 6])])
def test_some_of_many_are_taken_evenly(count: int, taken: list[int]) -> None:
    assert list(range(count))[evenly(count, 4)] == taken
