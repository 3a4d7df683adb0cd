"""``calib five-point``: the axes of a two-axis positioner, from five touched points."""

from pathlib import Path
from typing import Annotated

from calib.cli.application import IN_WORDS, MORE, Telling, command
from calib.cli.options import argument, option, written
from calib_start import loading


@command("five-point", MORE, "calib five-point five.csv -o positioner.urdf")
def five_point(
    points: Annotated[Path, argument("POINTS", "tilt, rotary, x, y, z of the five places (CSV).")],
    out: Annotated[Path | None, written("FILE", "Also the positioner's URDF, to be written.")] = None,
    sigma: Annotated[str, option("--sigma", "LENGTH", "Standard deviation of a touched coordinate.")] = "0.1 mm",
    telling: Telling = IN_WORDS,
) -> None:
    """Find a positioner's axes from five touched points.

    One mark on the table is touched at zero, at a positive and a negative turn of the rotary axis, and at a positive
    and a negative turn of the tilt axis; the readings say which row is which. The result is exact without noise,
    but five points leave no residual to check it by: calib calibrate takes any number of points.
    """
    with loading():
        from calib.foundations.files import refuse_taken, write_new
        from calib.foundations.ranges import RANGES, parse_within
        from calib.positioner import five_point_of
        from calib.presentation.command_tables import axes_sheet
        from calib.presentation.console import warning
    refuse_taken(out)
    found = five_point_of(points, sigma=parse_within(sigma, RANGES["sigma"], "sigma"))
    if out is not None:
        write_new(out, found.robot().urdf.source)
    telling.tell(
        found.contents,
        lambda: [
            *(warning(finding.sentence) for finding in found.findings),
            axes_sheet(found),
            *([] if out is None else [f"The positioner's URDF is {out}."]),
        ],
    )
