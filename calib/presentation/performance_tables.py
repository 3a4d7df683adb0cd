"""Tables of acceptance figures: millimetres, at most 80 columns wide."""

from collections.abc import Mapping

import numpy as np

from calib.assessment.performance import Performance
from calib.foundations.units import MM
from calib.presentation.report.document import Row, Sheet

_CAPTION = (
    "After the methods of ASME B89.4.22 and ISO 10360-12; no certificate. before: nominal arm, after: calibrated arm, "
)
_FOUND = "the probe found anew for both."
_GIVEN = "the probe is the tool of the results; of another ball, --probe says where it is."


def performance_sheet(arms: Mapping[str, Performance]) -> Sheet:
    """Return the figures of several arms in the same tests, a column for each: ``before``, ``after``."""
    tests = list(zip(*(arm.figures for arm in arms.values()), strict=True))
    following = [*(first.test for first, *_ in tests[1:]), ""]
    rows = []
    for (first, *others), after in zip(tests, following, strict=True):
        values = (f"{figure.value / MM:.4f}" for figure in (first, *others))
        cells = (first.test, first.place, str(first.n), first.name, *values)
        rows.append(Row(cells, ends_group=first.test != after))
    one, *rest = (arm.probe for arm in arms.values())
    said = _CAPTION + (_GIVEN if all(np.array_equal(one, other) for other in rest) else _FOUND)
    columns = ("test", "place", ">n", "figure", *(f">{arm}" for arm in arms))
    return Sheet.of("Acceptance figures [mm]", columns, rows, said)
