"""Products of columns: the same from rows that are kept as from all products."""

import numpy as np

from calib.assessment.entering import Products


def test_rows_that_are_kept_say_the_same_as_all_products() -> None:
    rng = np.random.default_rng(0)
    rows, fold = rng.normal(size=(30, 3, 8)), rng.integers(0, 4, 30)
    columns = np.array([[0, 1], [3, 3]])
    kept, all_ = (Products([(fold, rows)], 4, numbers, 8, columns) for numbers in (1, 90))
    for without in (None, 2):
        left = rows[fold != without].reshape(-1, 8)
        for one in (kept, all_):
            np.testing.assert_array_equal(one.counts, 3 * np.bincount(fold))
            grams = one.grams(np.array([6, 1]))
            gram = grams.sum(axis=0) - (0.0 if without is None else grams[without])
            np.testing.assert_allclose(gram, (left.T @ left)[np.ix_([6, 1], [6, 1])], atol=1e-12)
            np.testing.assert_allclose(one.rows([5, 2], without), (left.T @ left)[[5, 2]], atol=1e-12)
            C, g = one.blocks(without)
            np.testing.assert_allclose(C[0], (left.T @ left)[:2, :2], atol=1e-12)
            np.testing.assert_allclose(g[0], (left.T @ left)[:2, 7], atol=1e-12)
