"""The figures by which people compare calibrations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.foundations.arrays import Array


@dataclass(frozen=True, slots=True)
class Metrics:
    """Statistics of n error norms, in ``unit``: distances in m or angles in rad."""

    unit: str
    n: int
    mean: float
    rms: float
    p95: float
    max: float


def error_norms(residuals: Array) -> dict[str, Array]:
    """Return error norms (N,) of residuals (N, 3 or 6): ``position`` in m and, for poses, ``orientation`` in rad."""
    norms = {"position": np.linalg.norm(residuals[:, :3], axis=1)}
    if residuals.shape[1] == 6:
        norms["orientation"] = np.linalg.norm(residuals[:, 3:], axis=1)
    return norms


def metrics(residuals: Sequence[Array]) -> Mapping[str, Metrics]:
    """Return the metrics of each quantity over all sets of residuals, (N, 3) in m or (N, 6) in m and rad."""
    norms: dict[str, list[Array]] = {}
    for r in residuals:
        for quantity, values in error_norms(r).items():
            norms.setdefault(quantity, []).append(values)
    return {quantity: _metrics(np.concatenate(values), quantity) for quantity, values in norms.items()}


def _metrics(norms: Array, quantity: str) -> Metrics:
    return Metrics(
        {"position": "m", "orientation": "rad"}[quantity],
        len(norms),
        float(np.mean(norms)),
        float(np.sqrt(np.mean(norms**2))),
        float(np.percentile(norms, 95)),
        float(np.max(norms)),
    )
