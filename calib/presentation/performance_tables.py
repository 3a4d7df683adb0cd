"""Tables of acceptance figures: millimetres, at most 80 columns wide."""

from collections.abc import Mapping

import numpy as np
from rich import box
from rich.table import Table

from calib.assessment.performance import Performance
from calib.foundations.units import MM

CAPTION = (
    "After the methods of ASME B89.4.22 and ISO 10360-12; no certificate. before: nominal arm, after: calibrated arm, "
)
_FOUND = "the probe found anew for both."
_GIVEN = "the probe is the tool of the results; of another ball, --probe says where it is."
_WHAT = ("test", "place", "n", "figure")


def performance_table(before: Performance, after: Performance) -> Table:
    """Return the before/after table of the same tests."""
    arms = {"before": before, "after": after}
    out = Table(
        title="Acceptance figures [mm]",
        caption=CAPTION + (_GIVEN if np.array_equal(before.probe, after.probe) else _FOUND),
        title_justify="left",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
    )
    for name in (*_WHAT, *arms):
        out.add_column(name, justify="right" if name in ("n", *arms) else "left")
    rows = performance_rows(arms)
    for row, following in zip(rows, [*rows[1:], [""]], strict=True):
        out.add_row(*row, end_section=row[0] != following[0])
    return out


def performance_markdown(arms: Mapping[str, Performance]) -> str:
    """Return the same table as Markdown, with a column for every arm, all in the same tests."""
    ruler = ["---", "---", "--:", "---", *("--:" for _ in arms)]
    rows = [[*_WHAT, *arms], ruler, *performance_rows(arms)]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def performance_rows(arms: Mapping[str, Performance]) -> list[list[str]]:
    """Return the cells of every figure: test, place, n and name, then the value in mm of every arm."""
    return [
        [
            first.test,
            first.place,
            str(first.n),
            first.name,
            *(f"{figure.value / MM:.4f}" for figure in (first, *others)),
        ]
        for first, *others in zip(*(arm.figures for arm in arms.values()), strict=True)
    ]
