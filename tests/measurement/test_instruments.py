import numpy as np
import pytest

from calib.foundations.errors import JobError
from calib.measurement.instruments import LaserTracker


def test_noise_grows_with_the_distance_from_the_station() -> None:
    tracker = LaserTracker(7.5e-6, 3e-6, station=(1.0, 0.0, 0.0))
    sigma = tracker.sigma_at(np.array([[1.0, 0.0, 0.0], [4.0, 4.0, 0.0]]))
    np.testing.assert_allclose(sigma, [7.5e-6, 22.5e-6], rtol=1e-15)


@pytest.mark.parametrize(
    ("tracker", "sentence"),
    [
        ((-1e-6, 0.0), "laser tracker: sigma is -1e-06 m; allowed is 0, or 1e-06 to 1000 mm."),
        ((0.0, float("nan")), "laser tracker: sigma_per_metre is nan m; allowed is 0, or 1e-06 to 1000 mm."),
        (
            (0.0, 0.0, (0.0, 0.0, float("inf"))),
            "laser tracker: station is inf m; allowed is -10000 to 10000 m.",
        ),
    ],
)
def test_other_numbers_are_refused(tracker: tuple, sentence: str) -> None:
    with pytest.raises(JobError) as caught:
        LaserTracker(*tracker)
    assert str(caught.value) == sentence
