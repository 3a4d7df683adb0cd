"""A board's own file, as ``calib board`` writes it."""

import json

from calib.foundations.units import MM
from calib.measurement.prints import Print


def board_toml(print_: Print) -> str:
    """Return the text of a ``board.toml``."""
    lines = [
        "# What is printed. Measure the ruler: if it is off, write the side of a square as it is.",
        f"kind = {json.dumps(print_.kind)}",
        f"squares = [{print_.squares[0]}, {print_.squares[1]}]",
        f'square = "{print_.square / MM:g} mm"',
    ]
    if print_.kind == "charuco":
        lines += [f'marker = "{print_.marker / MM:g} mm"', f"dictionary = {json.dumps(print_.dictionary)}"]
    lines += [
        f"square_sigma = {print_.square_sigma:g}  # standard deviation of the print's scale, a share; 0 where measured",
        f'shape = "{print_.shape}"  # "flat", "quadratic", "free", or "auto": what photographs held out ask for',
    ]
    return "\n".join(lines) + "\n"
