"""Triangles and their inverses; a singular value decomposition ends, also where NumPy's does not converge."""

import subprocess
import sys

import numpy as np
import pytest

from calib.foundations import linear
from calib.foundations.errors import CalibError
from calib.foundations.linear import Gathered, inverse_triangle, one_thread, svd, triangle


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


@pytest.mark.parametrize("more", [1, 60, 120])
def test_a_triangle_on_another_is_reduced_as_all_rows_are(more: int) -> None:
    rng = np.random.default_rng(more)
    upper, other = np.triu(rng.normal(size=(120, 120))), np.triu(rng.normal(size=(more, 120)))
    rows = np.concatenate([upper, other])
    R = triangle(rows)
    assert not np.tril(R, -1).any()
    np.testing.assert_allclose(R.T @ R, rows.T @ rows, atol=1e-10)


def test_the_inverse_of_a_triangle_solves_unless_it_is_nearly_singular() -> None:
    rng = np.random.default_rng(3)
    rows = triangle(rng.normal(size=(40, 13)))
    found = inverse_triangle(rows)
    assert found is not None
    inverse, z = found
    np.testing.assert_allclose(inverse @ rows[:12, :12], np.eye(12), atol=1e-12)
    np.testing.assert_allclose(z, np.linalg.lstsq(rows[:, :12], -rows[:, 12], rcond=None)[0], atol=1e-12)
    rows[:12, :12] = triangle(rng.normal(size=(12, 11)) @ rng.normal(size=(11, 12)))[:12]
    assert inverse_triangle(rows) is None
    assert inverse_triangle(rows[:5]) is None
    rows[3, 3] = 0.0
    assert inverse_triangle(rows) is None


def test_too_little_memory_is_said_before_a_library_waits_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linear, "_SET_ASIDE", 1 << 60)
    linear._libraries.cache_clear()
    for of_scipy in (True, False):
        with pytest.raises(CalibError, match="memory that this process may use does not suffice"):
            one_thread(of_scipy=of_scipy)


@pytest.mark.skipif(sys.platform != "linux", reason="reads how large this process is")
def test_libraries_set_their_memory_aside_when_it_is_looked_for() -> None:
    """OpenBLAS, which is refused it later, tries again without end."""
    said = """
import numpy as np, scipy.linalg
from pathlib import Path
from calib.foundations.linear import one_thread

def size():
    return int(Path("/proc/self/statm").read_text().split()[0]) * 4096

with one_thread():
    before = size()
    np.linalg.solve(np.eye(3), np.ones(3))
    scipy.linalg.lapack.dtrcon(np.eye(3))
    print(size() - before)
"""
    found = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert int(found.stdout) < 2**24


def rows_of_set_ups(width: int, own: int, seed: int = 0) -> list[np.ndarray]:
    """Rows that see the last ten columns, and six of the others; a few see nothing, and those of the end see all."""
    rng, found = np.random.default_rng(seed), []
    for n in (400, 0, 7, 400):
        rows = np.zeros((n, 3, width))
        rows[:, :, -10:] = rng.normal(size=(n, 3, 10))
        for row, k in zip(rows, rng.integers(0, own, n), strict=True):
            row[:, 6 * k : 6 * k + 6] = rng.normal(size=(3, 6))
        rows[::97] = 0.0
        found.append(rows)
    return [*found, rng.normal(size=(40, 1, width))]


@pytest.mark.parametrize(("width", "own"), [(130, 20), (310, 50), (120, 1), (70, 10)])
def test_rows_that_come_bit_by_bit_have_the_triangle_of_all(width: int, own: int) -> None:
    rows, gathered = rows_of_set_ups(width, own), Gathered(width)
    for some in rows[:2]:
        gathered.add(some)
    assert gathered.triangle.shape[1] == width  # more may come after it was asked for
    gathered.add(*rows[2:])
    every, R = np.concatenate([some.reshape(-1, width) for some in rows]), gathered.triangle
    assert not np.tril(R, -1).any()
    np.testing.assert_allclose(R.T @ R, every.T @ every, atol=1e-10)
    assert Gathered(width).triangle.shape == (0, width)


def test_rows_of_many_set_ups_are_reduced_in_the_columns_that_they_see(monkeypatch: pytest.MonkeyPatch) -> None:
    """A table of 99 set-ups took 15 s: every row was turned in the columns of all bases."""
    rows, reduced = rows_of_set_ups(310, 50)[:-1], 0

    def counted(M: np.ndarray) -> np.ndarray:
        nonlocal reduced
        reduced += M.shape[0] * M.shape[1] ** 2
        return triangle(M)

    gathered = Gathered(310)
    with monkeypatch.context() as patch:
        patch.setattr(linear, "triangle", counted)
        gathered.add(*rows)
        assert gathered.triangle.shape == (310, 310)
    assert reduced < sum(some.size for some in rows) * 310 / 4


def test_rows_that_see_all_columns_are_not_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linear, "_MOST_APART", 500)
    gathered, rng = Gathered(120), np.random.default_rng(0)
    for _ in range(3):  # each row sees other columns
        gathered.add(rng.normal(size=(100, 2, 120)) * (rng.random((100, 1, 120)) < 0.1))
        assert not gathered._few
    gathered.add(*rows_of_set_ups(120, 3)[:1])
    assert not gathered._few  # these are too many to be kept apart
