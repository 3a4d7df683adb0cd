"""How hypothesis searches: the same few examples every time; many, made small, with ``CALIB_EXAMPLES=1000``."""

import os

from hypothesis import HealthCheck, Phase, settings

MANY = os.environ.get("CALIB_EXAMPLES")

settings.register_profile(
    "ours",
    derandomize=MANY is None,
    max_examples=int(MANY or 8),
    phases=[Phase.explicit, Phase.generate] if MANY is None else list(Phase),
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("ours")
