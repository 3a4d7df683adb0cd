"""Tables for people: millimetres and degrees, at most 80 columns wide."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from calib.assessment.metrics import Metrics, metrics
from calib.identification.fit import Fit
from calib.identification.identifiability import BlindDirection
from calib.measurement.kinds import QUANTITIES

WIDTH = 80
# What is shown of a length in m, an angle in rad and an error in pixels.
_SHOWN = {"m": (1e3, "mm"), "rad": (180.0 / np.pi, "deg"), "px": (1.0, "px")}
_UNITS = {quantity.name: quantity.unit for quantities in QUANTITIES.values() for quantity in quantities}


def table(fit: Fit) -> str:
    """Return the fit as plain text: errors before and after on its own data, its parameters and its doubts."""
    figures = {
        "identification": {
            when: metrics((data.kind, r) for data, r in zip(fit.measurements, residuals, strict=True))
            for when, residuals in (("before", fit.nominal_residuals), ("after", fit.residuals))
        }
    }
    return plain(Group(error_table(figures), parameter_table(fit), *verdict(fit)))


def plain(renderable: RenderableType) -> str:
    """Return a renderable as text that any file and encoding takes: no colours, no lines of another alphabet.

    At most 80 columns wide, no blanks at the ends of lines.
    """
    text = io.StringIO()
    Console(file=text, width=WIDTH, no_color=True, force_terminal=False, highlight=False, markup=False).print(
        renderable
    )
    return "".join(f"{line.rstrip()}\n" for line in text.getvalue().replace("─", "-").splitlines())


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


def level_table(levels: Sequence[tuple[str, int, int, Mapping[str, Metrics]]]) -> Table:
    """Return what every level brought: name, number of free parameters, rank and metrics by quantity."""
    out = _table("Levels", "tip errors of the data held out, base and tool fitted anew after each level")
    out.add_column("level", overflow="fold")
    for name in ("free", "rank", "mean", "rms", "max"):
        out.add_column(name, justify="right")
    out.add_column("unit")
    for name, free, rank, figures in levels:
        for m in figures.values():
            factor, unit = _SHOWN[m.unit]
            out.add_row(name, str(free), str(rank), *(f"{v * factor:.4f}" for v in (m.mean, m.rms, m.max)), unit)
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
    blind, held = len(fit.blind_directions), len(fit.held)
    if blind:
        done = {
            "nearest": "among all equal fits, the machine nearest to the nominal one was taken",
            "minimal": f"{_count(held, 'parameter was', 'parameters were')} held at the nominal value",
        }[fit.policy]
        priors = any(parameter.prior is not None for parameter in fit.parameters)
        done = "where priors do not decide, " + done if priors else done
        weak_rank = fit.rank - fit.usable_rank
        too_weak = f", {weak_rank} of them too weakly to use" if weak_rank > 0 else ""
        lines.append(
            Text(
                f"The data see {fit.rank} of {len(fit.parameters) + held} parameters{too_weak}. "
                f"{_count(blind, 'direction is', 'directions are')} blind; {done}. "
                f"No prediction at poses like these depends on it."
            )
        )
    else:
        lines.append(Text(f"The data see all {fit.rank} parameters."))
    weak = [p.name for p, w in zip(fit.parameters, fit.weak, strict=True) if w]
    if weak:
        lines.append(Text(f"Weakly seen: {', '.join(weak[:6])}{' and more' if len(weak) > 6 else ''}."))
    lines += [Text(doubt, style="bold red") for doubt in doubts]
    return lines


def lost_lines(lost: float) -> list[Text]:
    """Return what a person must know who takes the calibrated URDF alone, where it cannot hold the machine."""
    if lost == 0.0:
        return []
    off = "takes other readings" if np.isnan(lost) else f"is off by {lost * 1e3:.3f} mm rms at the tip at these poses"
    return [Text(f"A URDF holds no closed loops: calibrated.urdf alone {off}. model.json holds all.")]


def blind_lines(blind: Sequence[BlindDirection], most: int | None = None) -> list[RenderableType]:
    """Return the blind directions under their number; nothing where there are none."""
    if not blind:
        return []
    lines = Table.grid(padding=(0, 1))
    lines.add_column()
    lines.add_column(overflow="fold")
    for direction in blind[:most]:
        lines.add_row(" -", Text(str(direction)))
    if most is not None and len(blind) > most:
        lines.add_row(" -", Text(f"and {len(blind) - most} more"))
    return [Text(f"{_count(len(blind), 'direction is', 'directions are')} blind:"), lines]


def _count(n: int, one: str, several: str) -> str:
    return f"{n} {one if n == 1 else several}"


def _noise(fit: Fit) -> list[str]:
    said = []
    for noise in fit.noise:
        factor, unit = _SHOWN[_UNITS[noise.quantity]]
        instrument = (
            f"{noise.instrument * factor:.4f} {unit} instrument" if noise.instrument else "instrument not stated"
        )
        chi = "" if np.isnan(noise.chi_square) else f", chi-square per degree of freedom {noise.chi_square:.3g}"
        of = f" of {Path(fit.measurements[noise.measurements].where).name}" if len(fit.measurements) > 1 else ""
        said.append(
            f"Noise of one {noise.quantity} coordinate{of}: {instrument}, {noise.model * factor:.4f} {unit} model{chi}."
        )
    return said
