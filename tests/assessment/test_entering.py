"""Products of columns: the same from rows that are kept as from all products, and with blocks that are eliminated."""

import numpy as np
import pytest

from calib.assessment.eliminated import Own
from calib.assessment.entering import Products
from calib.foundations.arrays import Array, IntArray


def test_rows_that_are_kept_say_the_same_as_all_products() -> None:
    rng = np.random.default_rng(0)
    rows, fold = rng.normal(size=(30, 3, 8)), rng.integers(0, 4, 30)
    columns = np.array([[0, 1], [3, 3]])
    kept, all_ = (Products([(fold, rows, None)], 4, numbers, 8, columns) for numbers in (1, 90))
    for without in (None, 2):
        left = rows[fold != without].reshape(-1, 8)
        for one in (kept, all_):
            assert one.freedom(without) == left.shape[0]
            gram = one.grams(np.array([6, 1]))[-1 if without is None else without]
            np.testing.assert_allclose(gram, (left.T @ left)[np.ix_([6, 1], [6, 1])], atol=1e-12)
            np.testing.assert_allclose(one.rows([5, 2], without), (left.T @ left)[[5, 2]], atol=1e-12)
            C, g = one.blocks(without)
            np.testing.assert_allclose(C[0], (left.T @ left)[:2, :2], atol=1e-12)
            np.testing.assert_allclose(g[0], (left.T @ left)[:2, 7], atol=1e-12)


def dense(rows: Array, own: Own, blocks: int, held: Array) -> Array:
    """``[B C r]`` of all rows, blocks first, with what holds them: (q, blocks * a + size)."""
    n, d, a = own.by.shape
    B = np.zeros((n, d, blocks, a))
    there = np.flatnonzero(own.block >= 0)
    B[there, :, own.block[there]] = own.by[there]
    whole = np.concatenate([B.reshape(n, d, -1), rows], axis=2).reshape(n * d, -1)
    return np.concatenate([whole, np.pad(np.diag(np.sqrt(held.reshape(-1))), ((0, 0), (0, rows.shape[2])))])


@pytest.mark.parametrize("numbers", [1, 1000])
def test_eliminated_blocks_leave_what_all_unknowns_together_leave(numbers: int) -> None:
    """Blocks of rows of many folds, of one fold alone, of no row, and rows of no block."""
    rng = np.random.default_rng(1)
    rows, fold = rng.normal(size=(40, 3, 8)), rng.integers(0, 4, 40)
    own = Own(rng.normal(size=(40, 3, 2)), rng.integers(-1, 4, 40))
    own.block[fold == 3] = 5
    own.block[own.block == 3] = 6
    held = np.full((7, 2), 1e-6)
    columns = np.array([[0, 1], [3, 3]])
    parts: list[tuple[IntArray, Array, Own | None]] = [
        (fold[half], rows[half], Own(own.by[half], own.block[half])) for half in (np.s_[:13], np.s_[13:])
    ]
    products = Products(parts, 4, numbers, 8, columns, held)
    for without in (None, 0, 1, 2, 3):
        left = np.ones(40, dtype=bool) if without is None else fold != without
        whole = dense(rows[left], Own(own.by[left], own.block[left]), 7, held)
        B, C = whole[:, :14], whole[:, 14:]
        H = B.T @ B
        followed = np.linalg.solve(H, B.T @ C)
        expected = C.T @ C - C.T @ B @ followed
        np.testing.assert_allclose(products.rows([5, 2], without), expected[[5, 2]], atol=1e-9)
        gram = products.grams(np.array([6, 1]))[-1 if without is None else without]
        np.testing.assert_allclose(gram, expected[np.ix_([6, 1], [6, 1])], atol=1e-9)
        within, with_last = products.blocks(without)
        np.testing.assert_allclose(within[0], expected[:2, :2], atol=1e-9)
        np.testing.assert_allclose(with_last[0], expected[:2, 7], atol=1e-9)
        seen = 2 * len(set(own.block[left & (own.block >= 0)]))
        np.testing.assert_allclose(products.freedom(without), 3 * np.count_nonzero(left) - seen, atol=1e-4)
        if without is not None:
            out = np.flatnonzero(~left)
            found = products.following(rows[out], Own(own.by[out], own.block[out]), without)
            placed = np.concatenate([followed, np.zeros((2, 8))]).reshape(8, 2, 8)[own.block[out]]
            np.testing.assert_allclose(found, rows[out] - own.by[out] @ placed, atol=1e-9)
