"""Plots for people, as matplotlib figures that need no display: ``figure.savefig("name.svg")``.

matplotlib is imported inside the functions, and pyplot nowhere: a figure belongs to its caller, not to a global state.
"""

import io
from pathlib import Path
from typing import TYPE_CHECKING

from calib.assessment.sensitivity import Sensitivity
from calib.foundations.errors import OutputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = {"m": "#0d6b78", "rad": "#c4571a"}
_LABELS = {"m": "lengths, per mm", "rad": "angles, per mrad"}
_OTHER, _OTHERS = "#5b5b8c", "joint terms, per mille or milli-unit"
_GRID = "#d9d9d9"
_FORMATS = ("svg", "png", "pdf")
_ROW = 0.19  # inches for one bar and its name
_ROOM = 1.3  # inches for title and axis


def figure_bytes(figure: "Figure", path: Path) -> bytes:
    """Return a figure in the format that the ending of a path names. Raises OutputError for any other ending."""
    kind = path.suffix.lower().removeprefix(".")
    if kind not in _FORMATS:
        raise OutputError(f"{path}: a plot ends in {', '.join(f'.{name}' for name in _FORMATS)}.")
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, dpi=150)
    return buffer.getvalue()


def sensitivity_figure(sensitivity: Sensitivity) -> "Figure":
    """Return a bar for every parameter, the strongest on top: rms of the tip's motion, and a tick at its largest."""
    from matplotlib.lines import Line2D  # noqa: PLC0415
    from matplotlib.patches import Patch  # noqa: PLC0415

    from calib.presentation.inline_figure import InlineFigure  # noqa: PLC0415

    order = sensitivity.order[::-1]
    parameters = [sensitivity.parameters[k] for k in order]
    rows = range(len(order))
    figure = InlineFigure(figsize=(7.2, _ROOM + _ROW * len(order)), layout="constrained")
    axes = figure.add_subplot()
    # m per m is mm per mm, and m per rad is mm per mrad.
    axes.barh(rows, sensitivity.rms[order], height=0.7, color=[_COLOURS.get(p.unit, _OTHER) for p in parameters])
    axes.plot(sensitivity.largest[order], rows, linestyle="none", marker="|", markersize=8, color="black")
    axes.set_yticks(rows, [p.name for p in parameters], fontsize=8)
    axes.set_ylim(-0.7, len(rows) - 0.3)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("tip motion [mm] per mm and per mrad")
    axes.set_title(f"Sensitivity of the tip over {sensitivity.poses} poses", loc="left", fontsize=11)
    axes.set_axisbelow(True)
    axes.grid(axis="x", color=_GRID, linewidth=0.8)
    axes.tick_params(axis="y", length=0)
    axes.spines[["top", "right", "left"]].set_visible(False)
    units = [unit for unit in _COLOURS if any(p.unit == unit for p in parameters)]
    largest = Line2D([], [], linestyle="none", marker="|", markersize=8, color="black", label="largest")
    bars = [Patch(color=_COLOURS[unit], label=f"{_LABELS[unit]} (rms)") for unit in units]
    if any(p.unit not in _COLOURS for p in parameters):
        bars.append(Patch(color=_OTHER, label=f"{_OTHERS} (rms)"))
    axes.legend(handles=[*bars, largest], loc="lower right", frameon=False, fontsize=8)
    return figure
