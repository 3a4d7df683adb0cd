"""Tests keep nothing in the cache folder of whoever runs them."""

import os
from collections.abc import Iterator

import pytest

from calib.measurement.streams.joints import JointStream


@pytest.fixture
def exact_rates(monkeypatch: pytest.MonkeyPatch) -> None:
    """The velocity of a stream is that of the moment, as differences of its residuals show it."""
    monkeypatch.setattr(JointStream, "mean_rates", JointStream.rates)


@pytest.fixture(autouse=True, scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    before = os.environ.get("CALIB_CACHE")
    os.environ["CALIB_CACHE"] = str(tmp_path_factory.mktemp("cache"))
    yield
    if before is None:
        del os.environ["CALIB_CACHE"]
    else:
        os.environ["CALIB_CACHE"] = before
