"""Plots for people, as matplotlib figures that need no display: ``figure.savefig("name.svg")``.

matplotlib is imported inside the functions, and pyplot nowhere: a figure belongs to its caller, not to a global state.
Names are drawn as they are: two dollars in one make no formula of it (``parse_math``).
"""

import contextlib
import io
import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from calib.assessment.metrics import error_norms
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array
from calib.foundations.errors import OutputError
from calib.foundations.words import refuse_other
from calib.identification.fit import Fit
from calib.measurement.kinds import UNIT_OF
from calib.presentation.sheets import SHOWN, correlation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from calib.assessment.sensitivity import Sensitivity

_COLOURS = {"m": "#0d6b78", "rad": "#c4571a"}
_LABELS = {"m": "lengths, per mm", "rad": "angles, per mrad"}
_OTHER, _OTHERS = "#5b5b8c", "joint terms, per mille or milli-unit"
_GRID = "#d9d9d9"
_FORMATS = ("svg", "png", "pdf")
_ROW = 0.19  # inches for one bar and its name
_ROOM = 1.3  # inches for title and axis
_BEFORE, _AFTER, _SOFT = "#d55e00", "#0072b2", "#8a949d"
_ROW_OF_FIT = 0.2  # inches for one parameter and its name


def load_matplotlib() -> None:
    """Load matplotlib for a command that writes a figure: without the settings of the current folder.

    Those are of whoever has put files there, and may have TeX run. Where this user has no home, it makes a folder of
    its own among the temporary ones, and has to enter it to remove it in the end, whatever the umask.
    """
    before = os.umask(0o077)
    try:
        with contextlib.chdir("/"):
            import_module("matplotlib")
    finally:
        os.umask(before)


def figure_bytes(figure: "Figure", path: Path) -> bytes:
    """Return a figure in the format that the ending of a path names. Raises OutputError for any other ending."""
    kind = path.suffix.lower().removeprefix(".")
    if kind not in _FORMATS:
        raise OutputError(f"{path}: a plot ends in {', '.join(f'.{name}' for name in _FORMATS)}.")
    import matplotlib as mpl  # noqa: PLC0415 - the figure has loaded it

    buffer = io.BytesIO()
    # The same figure is the same file: without the date, and without numbers drawn by chance.
    date = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    with mpl.rc_context({"svg.hashsalt": "calib"}):
        figure.savefig(buffer, format=kind, dpi=150, metadata=date)
    return buffer.getvalue()


def sensitivity_figure(sensitivity: "Sensitivity") -> "Figure":
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
    axes.set_yticks(rows, [p.name for p in parameters], fontsize=8, parse_math=False)
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


@checked
def plot(fit: Fit, what: Literal["errors", "parameters", "correlations"] = "errors") -> "Figure":
    """Return a matplotlib figure of a fit: ``figure.savefig("name.svg")``; a notebook shows it in place.

    ``errors``: which share of its rows has which error, before and after. ``parameters``: values of the robot's
    parameters with two sigmas, where identifiable. ``correlations``: of the uncertainties of identifiable parameters.
    Raises JobError for another word.
    """
    figures = {"errors": _errors, "parameters": _parameters, "correlations": _correlations}
    refuse_other(what, figures, "what")
    return figures[what](fit)


def _errors(fit: Fit) -> "Figure":
    from calib.presentation.inline_figure import InlineFigure  # noqa: PLC0415

    before, after = (_norms(fit, residuals) for residuals in (fit.nominal_residuals, fit.residuals))
    figure = InlineFigure(figsize=(4.6 * len(after), 3.2), layout="constrained")
    for k, quantity in enumerate(after):
        factor, unit = SHOWN[UNIT_OF[quantity]]
        axes = figure.add_subplot(1, len(after), k + 1)
        for name, norms, colour in (("before", before, _BEFORE), ("after", after, _AFTER)):
            axes.ecdf(norms[quantity] * factor, label=name, color=colour)
        axes.set_xscale("log")
        axes.set_xlabel(f"{quantity} error [{unit}]")
        axes.set_ylabel("share of the rows")
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False)
    return figure


def _parameters(fit: Fit) -> "Figure":
    from calib.presentation.inline_figure import InlineFigure  # noqa: PLC0415

    chosen = [k for k, parameter in enumerate(fit.parameters) if parameter.of_robot]
    units = [unit for unit in SHOWN if any(fit.parameters[k].unit == unit for k in chosen)]
    most = max((sum(fit.parameters[k].unit == unit for k in chosen) for unit in units), default=1)
    figure = InlineFigure(figsize=(4.2 * max(len(units), 1), 1.2 + _ROW_OF_FIT * most), layout="constrained")
    for column, unit in enumerate(units):
        factor, shown = SHOWN[unit]
        rows = [k for k in chosen if fit.parameters[k].unit == unit][::-1]
        values, sigmas = fit.values[rows] * factor, fit.sigmas[rows] * factor
        seen = np.isfinite(sigmas)
        places = np.arange(len(rows), dtype=np.float64)
        axes = figure.add_subplot(1, len(units), column + 1)
        axes.axvline(0.0, color=_SOFT, linewidth=0.8)
        axes.errorbar(values[seen], places[seen], xerr=2.0 * sigmas[seen], fmt="o", markersize=4, color=_AFTER)
        axes.plot(values[~seen], places[~seen], "o", markersize=4, markerfacecolor="none", color=_SOFT)
        axes.set_yticks(places, [fit.parameters[k].name for k in rows], fontsize=8, parse_math=False)
        axes.set_xlabel(f"value and two sigmas, conditional on the model [{shown}]; hollow: not identifiable")
        axes.spines[["top", "right", "left"]].set_visible(False)
    return figure


def _correlations(fit: Fit) -> "Figure":
    from calib.presentation.inline_figure import InlineFigure  # noqa: PLC0415

    seen, r = correlation(fit)
    side = 1.5 + _ROW_OF_FIT * len(seen)
    figure = InlineFigure(figsize=(side + 0.6, side), layout="constrained")
    axes = figure.add_subplot()
    image = axes.imshow(r, vmin=-1.0, vmax=1.0, cmap="PuOr")
    names = [fit.parameters[k].name for k in seen]
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7, parse_math=False)
    axes.set_yticks(range(len(names)), names, fontsize=7, parse_math=False)
    figure.colorbar(image, label="correlation", shrink=0.6)
    return figure


def _norms(fit: Fit, residuals: tuple[Array, ...]) -> dict[str, Array]:
    """Return error norms by quantity over all sets, (N,) in m, rad or px."""
    found: dict[str, list[Array]] = {}
    for data, r in zip(fit.measurements, residuals, strict=True):
        for quantity, norms in error_norms(data.kind, r).items():
            found.setdefault(quantity, []).append(norms)
    return {quantity: np.concatenate(norms) for quantity, norms in found.items()}
