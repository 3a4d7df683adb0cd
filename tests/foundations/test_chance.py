"""Tails of chi-squared and F, against those of SciPy's own distributions."""

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from calib.foundations.chance import autocorrelations, bound, density, exceeded


@pytest.mark.parametrize("numbers", [1, 2, 3, 40, 1000])
def test_they_are_those_of_scipy(numbers: int) -> None:
    squares = np.concatenate([[0.0, 1e-300, 1e-9, 1e9], np.linspace(0.1, 3.0 * numbers, 9)])
    np.testing.assert_allclose(exceeded(squares, numbers), stats.chi2.sf(squares, numbers), rtol=1e-14)
    for freedom in (0.3, 1.0, 7.5, 400.0):
        expected = stats.f.sf(squares / numbers, numbers, freedom)
        np.testing.assert_allclose(exceeded(squares, numbers, freedom), expected, rtol=1e-14)
        for p in (0.01, 0.5, 0.999):
            assert bound(p, numbers, freedom) == pytest.approx(numbers * stats.f.ppf(p, numbers, freedom), rel=1e-14)
    for p in (0.01, 0.5, 0.999):
        assert bound(p, numbers) == pytest.approx(stats.chi2.ppf(p, numbers), rel=1e-14)
    for square in squares[2:]:
        assert density(float(square), numbers) == pytest.approx(stats.chi2.pdf(square, numbers), rel=1e-12)


def test_a_square_below_zero_is_rounding() -> None:
    assert exceeded(-1e-30, 3) == 1.0
    assert exceeded(-1e-30, 3, 5.0) == 1.0
    assert np.isnan(exceeded(np.nan, 3, 5.0))


def test_no_command_waits_for_all_of_scipys_distributions() -> None:
    code = "import sys, calib.cli; print('scipy.stats' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


def test_autocorrelations_are_of_all_parts_together() -> None:
    turns = np.tile([[1.0], [-1.0]], (5, 1))
    assert list(autocorrelations([turns], 4)) == pytest.approx([-0.9, 0.8, -0.7])
    assert list(autocorrelations([turns, np.ones((10, 1))], 3)) == pytest.approx([0.0, 0.8])
    assert list(autocorrelations([np.zeros((5, 2))], 3)) == []
