"""The figures by which people compare calibrations."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from calib.foundations.arrays import Array
from calib.measurement.kinds import QUANTITIES, UNIT_OF, Kind


@dataclass(frozen=True, slots=True)
class Metrics:
    """Statistics of n error norms, in ``unit``: m, rad or px."""

    unit: str
    n: int
    mean: float
    rms: float
    p95: float
    max: float


def error_norms(kind: Kind, residuals: Array) -> dict[str, Array]:
    """Return error norms (N,) by quantity of residuals (N, d) of a kind: of ``position`` in m, for example."""
    return {quantity.name: np.linalg.norm(residuals[:, quantity.columns], axis=1) for quantity in QUANTITIES[kind]}


def metrics(sets: Iterable[tuple[Kind, Array]]) -> Mapping[str, Metrics]:
    """Return the metrics of each quantity over all sets: pairs of a kind and its residuals (N, d)."""
    norms: dict[str, list[Array]] = {}
    for kind, r in sets:
        for quantity, values in error_norms(kind, r).items():
            norms.setdefault(quantity, []).append(values)
    return {quantity: _metrics(np.concatenate(values), UNIT_OF[quantity]) for quantity, values in norms.items()}


def _metrics(norms: Array, unit: str) -> Metrics:
    return Metrics(
        unit,
        len(norms),
        float(np.mean(norms)),
        float(np.sqrt(np.mean(norms**2))),
        float(np.percentile(norms, 95)),
        float(np.max(norms)),
    )
