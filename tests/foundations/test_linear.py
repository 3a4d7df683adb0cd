"""A singular value decomposition ends, also where NumPy's does not converge."""

import numpy as np
import pytest

from calib.foundations.linear import svd


@pytest.mark.parametrize("shape", [(7, 4), (4, 7), (3, 7, 4), (2, 3, 4, 4)])
@pytest.mark.parametrize("full", [True, False])
def test_where_divide_and_conquer_fails_another_way_is_taken(
    shape: tuple[int, ...], full: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    M = np.random.default_rng(1).normal(size=shape)
    expected = [part.shape for part in np.linalg.svd(M, full_matrices=full)]

    def fails(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", fails)
    U, s, Vt = svd(M, full_matrices=full)
    assert [part.shape for part in (U, s, Vt)] == expected
    k = s.shape[-1]
    np.testing.assert_allclose(U[..., :k] @ (s[..., None] * Vt[..., :k, :]), M, atol=1e-13)
    assert np.all(np.diff(s) <= 0.0)
