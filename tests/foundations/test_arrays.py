"""Rows among those of their kind, and some of many things."""

import numpy as np
import pytest

from calib.foundations.arrays import evenly, evenly_in_runs, evenly_ranked, evenly_spread, number_in_kind


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


def test_runs_of_neighbours_are_spread_over_all() -> None:
    assert evenly_in_runs(6, 6, 2).tolist() == [0, 1, 2, 3, 4, 5]
    assert evenly_in_runs(100, 6, 2).tolist() == [0, 1, 49, 50, 98, 99]


def test_values_are_taken_over_their_ranks_with_the_largest() -> None:
    values = np.array([3.0, 9.0, 1.0, 7.0, 5.0])
    assert evenly_ranked(values, 5).tolist() == [0, 1, 2, 3, 4]
    assert values[evenly_ranked(values, 3)].tolist() == [9.0, 1.0, 5.0]


def test_spread_are_all_or_some_with_both_ends() -> None:
    assert evenly_spread(3, 5).tolist() == [0, 1, 2]
    assert evenly_spread(11, 3).tolist() == [0, 5, 10]
    assert evenly_spread(0, 3).tolist() == []
