"""``calib five-point``: the axes of a two-axis positioner, from five touched points."""

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import MORE, Telling, command
from calib.cli.options import Json, Quiet
from calib_start import loading

_POINTS = typer.Argument(
    metavar="POINTS", help="tilt, rotary, x, y, z of the five places (CSV).", show_default=False, readable=False
)
_OUT = typer.Option(
    "--out", "-o", metavar="FILE", help="Also the positioner's URDF, to be written.", show_default=False, readable=False
)
_SIGMA = typer.Option("--sigma", metavar="LENGTH", help="Standard deviation of a touched coordinate.")


@command("five-point", MORE, "calib five-point five.csv -o positioner.urdf")
def five_point(
    points: Annotated[Path, _POINTS],
    out: Annotated[Path | None, _OUT] = None,
    sigma: Annotated[str, _SIGMA] = "0.1 mm",
    as_json: Json = False,
    quiet: Quiet = False,
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
        from calib.presentation.console import printable, warning
        from calib.presentation.positioner_tables import axes_table
    if out is not None:
        refuse_taken(out)
    found = five_point_of(points, sigma=parse_within(sigma, RANGES["sigma"], "sigma"))
    if out is not None:
        write_new(out, found.robot().urdf.source)
    Telling(as_json, quiet).tell(
        found.contents,
        lambda: [
            *(warning(finding.sentence) for finding in found.findings),
            axes_table(found),
            *([] if out is None else [printable(f"The positioner's URDF is {out}.")]),
        ],
    )
