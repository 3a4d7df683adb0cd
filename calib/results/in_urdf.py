"""What ``calibrated.urdf`` alone reaches, where a URDF cannot hold the whole machine."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from calib.assessment.metrics import Metrics, metrics
from calib.foundations.brief import brief
from calib.identification.fit import Fit
from calib.identification.identify import residuals_of
from calib.machine.in_urdf import fit_in_urdf
from calib.measurement.measurements import Measurements


@dataclass(frozen=True, slots=True, eq=False)
class InUrdf:
    """The best fit that a URDF holds, base and tool fitted with it, and its metrics by use and quantity.

    ``metrics`` is empty where joints of the URDF take other readings, so that nothing can be said of it alone.
    """

    __repr__ = brief

    fit: Fit
    metrics: Mapping[str, Mapping[str, Metrics]]


def judged_in_urdf(
    fit: Fit, own: Sequence[Measurements], uses: Sequence[tuple[str, Sequence[Measurements]]]
) -> InUrdf | None:
    """Return what the URDF of a fit reaches on the tables of each use; None where it holds the whole machine.

    ``own``: the tables to identify from.
    """
    alone = fit_in_urdf(fit, own)
    if alone is None and not (fit.robot.loops or fit.robot.couplings):
        return None
    found = fit if alone is None else alone
    if found.robot.loops or found.robot.couplings:
        return InUrdf(found, {})
    return InUrdf(
        found,
        {
            use: metrics((data.kind, r) for data, r in zip(some, residuals_of(found, some, found.machine), strict=True))
            for use, some in uses
        },
    )
