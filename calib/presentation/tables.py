"""Tables for people: millimetres and degrees, at most 80 columns wide."""

import io
from collections.abc import Mapping, Sequence

import numpy as np
from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from calib.assessment.metrics import Metrics, metrics
from calib.identification.fit import Fit
from calib.identification.identifiability import BlindDirection

WIDTH = 80
# What is shown of a length in m and an angle in rad.
_SHOWN = {"m": (1e3, "mm"), "rad": (180.0 / np.pi, "deg")}


def table(fit: Fit) -> str:
    """Return the fit as plain text: errors before and after on its own data, its parameters and its doubts."""
    figures = {"identification": {"before": metrics(fit.nominal_residuals), "after": metrics(fit.residuals)}}
    return plain(Group(error_table(figures), parameter_table(fit), *verdict(fit)))


def plain(renderable: RenderableType) -> str:
    """Return a renderable as text without colours, at most 80 columns wide."""
    text = io.StringIO()
    Console(file=text, width=WIDTH, no_color=True, force_terminal=False).print(renderable)
    return text.getvalue()


def error_table(figures: Mapping[str, Mapping[str, Mapping[str, Metrics]]]) -> Table:
    """Return the before/after table of ``figures[use][when][quantity]``."""
    out = _table("Tip errors, measured minus predicted", "before: nominal robot, base and tool fitted")
    out.add_column("data")
    out.add_column("robot")
    for name in ("n", "mean", "rms", "p95", "max"):
        out.add_column(name, justify="right")
    out.add_column("unit")
    for use, whens in figures.items():
        for quantity in next(iter(whens.values())):
            for when, found in whens.items():
                m = found[quantity]
                factor, unit = _SHOWN[m.unit]
                figures_shown = (f"{value * factor:.4f}" for value in (m.mean, m.rms, m.p95, m.max))
                style = "bold" if when == "after" else None
                out.add_row(use, when, str(m.n), *figures_shown, unit, style=style, end_section=when == "after")
    return out


def parameter_table(fit: Fit) -> Table:
    """Return all parameters with values, sigmas and flags, in mm and degrees."""
    out = _table("Parameters")
    out.add_column("parameter", overflow="fold")
    out.add_column("value", justify="right")
    out.add_column("sigma", justify="right")
    out.add_column("unit")
    out.add_column("seen by the data")
    for parameter, value, sigma, blind, weak in zip(
        fit.parameters, fit.values, fit.sigmas, fit.blind, fit.weak, strict=True
    ):
        factor, unit = _SHOWN[parameter.unit]
        seen = "only in combination" if blind else "weakly" if weak else "yes"
        out.add_row(parameter.name, f"{value * factor:+.4f}", "-" if blind else f"{sigma * factor:.4f}", unit, seen)
    return out


def _table(title: str, caption: str | None = None) -> Table:
    return Table(title=title, caption=caption, title_justify="left", caption_justify="left", box=box.SIMPLE_HEAD)


def verdict(fit: Fit, doubts: Sequence[str] = ()) -> list[Text]:
    """Return what a person must know beside the figures: noise, rank, what was done about it, doubts."""
    lines = [Text(noise) for noise in _noise(fit)]
    blind = len(fit.blind_directions)
    if blind:
        done = {
            "nearest": "among all equal fits, the machine nearest to the nominal one was taken",
            "minimal": f"{len(fit.held)} parameters were held at their nominal values",
        }[fit.policy]
        priors = any(parameter.prior is not None for parameter in fit.parameters)
        done = "where priors do not decide, " + done if priors else done
        weak_rank = fit.rank - fit.usable_rank
        too_weak = f", {weak_rank} of them too weakly to use" if weak_rank > 0 else ""
        lines.append(
            Text(
                f"The data see {fit.rank} of {len(fit.parameters) + len(fit.held)} parameters{too_weak}. "
                f"{blind} directions are blind; {done}. No prediction at poses like these depends on it."
            )
        )
    else:
        lines.append(Text(f"The data see all {fit.rank} parameters."))
    weak = [p.name for p, w in zip(fit.parameters, fit.weak, strict=True) if w]
    if weak:
        lines.append(Text(f"Weakly seen: {', '.join(weak[:6])}{' and more' if len(weak) > 6 else ''}."))
    lines += [Text(doubt, style="bold red") for doubt in doubts]
    return lines


def blind_lines(blind: Sequence[BlindDirection], most: int | None = None) -> list[Text]:
    """Return the blind directions, one line each."""
    shown = blind if most is None else blind[:most]
    lines = [Text(f"  {direction}") for direction in shown]
    return lines if len(shown) == len(blind) else [*lines, Text(f"  ... and {len(blind) - len(shown)} more")]


def _noise(fit: Fit) -> list[str]:
    said = []
    for noise in fit.noise:
        factor, unit = _SHOWN["m" if noise.quantity == "position" else "rad"]
        instrument = (
            f"{noise.instrument * factor:.4f} {unit} instrument" if noise.instrument else "instrument not stated"
        )
        chi = "" if np.isnan(noise.chi_square) else f", chi-square per degree of freedom {noise.chi_square:.3g}"
        said.append(
            f"Noise of one {noise.quantity} coordinate: {instrument}, {noise.model * factor:.4f} {unit} model{chi}."
        )
    return said
