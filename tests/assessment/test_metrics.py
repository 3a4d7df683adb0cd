"""The figures, against numbers worked out by hand."""

import numpy as np
import pytest

from calib.assessment.metrics import Metrics, error_norms, metrics

RESIDUALS = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -12.0]])


def test_figures_of_positions() -> None:
    found = metrics([("position", RESIDUALS)])
    assert list(found) == ["position"]
    m = found["position"]
    assert (m.unit, m.n, m.max) == ("m", 3, 12.0)
    assert m.mean == pytest.approx(17.0 / 3.0)
    assert m.rms == pytest.approx(np.sqrt(169.0 / 3.0))
    assert m.p95 == pytest.approx(5.0 + 0.9 * 7.0)


def test_sets_are_one_population_whatever_their_kind() -> None:
    poses = np.hstack([RESIDUALS[:1], [[0.0, 0.6, 0.8]]])
    found = metrics([("position", RESIDUALS), ("pose", poses)])
    assert found["position"].n == 4
    assert found["position"].rms == pytest.approx(np.sqrt((169.0 + 25.0) / 4.0))
    assert found["orientation"] == Metrics("rad", 1, 1.0, 1.0, 1.0, 1.0)


def test_norms_are_those_of_the_rows() -> None:
    norms = error_norms("pose", np.hstack([RESIDUALS, 2.0 * RESIDUALS]))
    assert norms["position"].tolist() == [5.0, 0.0, 12.0]
    assert norms["orientation"].tolist() == [10.0, 0.0, 24.0]
    assert list(error_norms("position", RESIDUALS)) == ["position"]


def test_no_data_has_no_figures() -> None:
    assert metrics([]) == {}
