"""Small charts as SVG: drawn for a page that is read on a phone, on paper, in light and in dark.

A chart has no colours of its own: its marks have classes (``before``, ``after``, ``soft``, ``scale-0`` to ``scale-5``),
and the page says what these look like. That, a tenth of the bytes, and nothing to import is why matplotlib, which draws
figures for people's own documents in :mod:`calib.presentation.plots`, does not draw these.
"""

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.foundations.arrays import Array, IntArray
from calib.foundations.sealing import sealed

WIDTH = 360
_HEIGHT = 230
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 12, 12, 40
_KEY = 16
# Number of classes that a scale of colours has in the page's style.
SHADES = 6


@dataclass(frozen=True, slots=True, eq=False)
class Axis:
    """An axis with its label and limits; with ``names``, categories at 0, 1, 2, ... in place of numbers."""

    label: str
    low: float
    high: float
    log: bool = False
    names: tuple[str, ...] = ()

    def place(self, values: Array) -> Array:
        """Return where values lie between the limits, 0 to 1; what lies outside is put on the limit."""
        low, high, v = self.low, self.high, np.clip(values, self.low, self.high)
        if self.log:
            low, high, v = math.log10(low), math.log10(high), np.log10(v)
        return np.asarray((v - low) / (high - low))

    def ticks(self) -> list[tuple[float, str]]:
        """Return values and texts of the ticks: 1, 2, 5 times powers of ten, or decades alone where there are many."""
        if self.names:
            return [(float(k), name) for k, name in enumerate(self.names)]
        if self.log:
            decades = math.log10(self.high / self.low)
            steps = (1, 2, 5) if decades < 2.0 else (1,)
            powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            values = [float(f"{m}e{p}") for p in powers for m in steps]
        else:
            step = _step((self.high - self.low) / 4.0)
            values = [k * step for k in range(math.ceil(self.low / step), math.floor(self.high / step) + 1)]
        room = 1e-9 * (self.high - self.low)
        return [(v, f"{v:.6g}") for v in values if self.low - room <= v <= self.high + room]


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Points:
    """Dots of one class at x (n,), y (n,)."""

    name: str
    x: Array
    y: Array
    size: float = 4.0


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Curve:
    """A line of one class through x (n,), y (n,)."""

    name: str
    x: Array
    y: Array


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Bars:
    """Bars of one class on y = 0, between ``edges`` (n + 1,) and as high as ``heights`` (n,)."""

    name: str
    edges: Array
    heights: Array


@dataclass(frozen=True, slots=True)
class Level:
    """A dashed horizontal line, and what it means."""

    y: float
    text: str


Mark = Points | Curve | Bars | Level


def linear(label: str, values: Array, *, from_zero: bool = False) -> Axis:
    """Return an axis with round limits around values (n,)."""
    low, high = (float(np.min(values)), float(np.max(values))) if values.size else (0.0, 1.0)
    low = min(low, 0.0) if from_zero else low
    if high - low < 1e-12 * max(abs(high), 1e-9):
        low, high = (0.0, high or 1.0) if from_zero and high >= 0.0 else (low - 1.0, high + 1.0)
    step = _step((high - low) / 8.0)
    return Axis(label, step * math.floor(low / step), step * math.ceil(high / step))


def logarithmic(label: str, values: Array) -> Axis:
    """Return a logarithmic axis around the positive ones of values (n,), six decades at most."""
    positive = values[values > 0.0]
    if not positive.size:
        return Axis(label, 0.1, 10.0, log=True)
    high = 1.15 * float(positive.max())
    low = max(0.85 * float(positive.min()), 1e-6 * high)
    return Axis(label, min(low, high / 10.0), high, log=True)


def chart(
    x: Axis, y: Axis, marks: Sequence[Mark], legend: Sequence[tuple[str, str]] = (), height: int = _HEIGHT
) -> str:
    """Return a chart as one ``<svg>`` element. ``legend``: class and text of what needs a key."""
    parts = []
    at = float(_LEFT)
    for name, text in legend:
        parts.append(f'<path class="dot {name}" stroke-width="8" d="M{at + 4:.0f} 12h0"/>')
        parts.append(f'<text x="{at + 12:.0f}" y="16">{html.escape(text)}</text>')
        at += 24 + 6.2 * len(text)
    return _drawn(x, y, marks, parts, height)


def map_of(points: Array, axes: tuple[str, str], values: Array, unit: str) -> str:
    """Return points (n, 2) in m as dots, coloured by values (n,) from 0 to the largest in ``unit``, with their scale.

    The largest are drawn last and stay visible; a metre is equally long on both axes.
    """
    height, highest = 300, float(values.max())
    size = np.array([WIDTH - _LEFT - _RIGHT, height - _BOTTOM - _TOP - _KEY])
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.54 * max(float(np.max((high - low) / size)), 1e-5) * size
    middle = (low + high) / 2.0
    x, y = (Axis(f"{name} [m]", a, b) for name, a, b in zip(axes, middle - half, middle + half, strict=True))
    kinds = _shades(values, highest)
    marks = [Points(f"scale-{k}", points[kinds == k, 0], points[kinds == k, 1], 6.0) for k in range(SHADES)]
    parts = [f'<rect class="scale-{k}" x="{_LEFT + 30 + 28 * k}" y="8" width="28" height="9"/>' for k in range(SHADES)]
    parts.append(f'<text x="{_LEFT + 25}" y="16" text-anchor="end">0</text>')
    parts.append(f'<text x="{_LEFT + 35 + 28 * SHADES}" y="16">{highest:.3g} {html.escape(unit)}</text>')
    return _drawn(x, y, marks, parts, height)


def _drawn(x: Axis, y: Axis, marks: Sequence[Mark], legend: Sequence[str], height: int) -> str:
    box = (_LEFT, _TOP + (_KEY if legend else 0), WIDTH - _RIGHT, height - _BOTTOM)
    return _svg(
        WIDTH, height, [*_axes(x, y, box), *(part for mark in marks for part in _mark(mark, x, y, box)), *legend]
    )


def matrix(values: Array, names: Sequence[str]) -> str:
    """Return the lower triangle of a matrix (n, n) of numbers from -1 to 1 as tinted squares, darker where larger."""
    n, cell, room = len(names), 24, 8 + 6.4 * max(map(len, names), default=0)
    parts = []
    for i, name in enumerate(names):
        y = 4 + cell * i
        parts.append(f'<text x="{room - 5:.0f}" y="{y + 16}" text-anchor="end">{html.escape(name)}</text>')
        for j in range(i):
            r = float(values[i, j])
            if abs(r) >= 0.05:
                kind = "after" if r > 0.0 else "before"
                square = f'x="{room + cell * j:.0f}" y="{y}" width="{cell - 1}" height="{cell - 1}"'
                told = f"<title>{html.escape(name)}, {html.escape(names[j])}: {r:+.3f}</title>"
                parts.append(f'<rect class="{kind}" {square} fill-opacity="{0.6 * abs(r):.2f}">{told}</rect>')
                x = room + cell * j + (cell - 1) / 2
                number = f"{r:.1f}".replace("-0", "-").replace("0.", ".")
                parts.append(f'<text class="in" x="{x:.0f}" y="{y + 16}" text-anchor="middle">{number}</text>')
        parts.append(
            f'<rect class="diagonal" x="{room + cell * i:.0f}" y="{y}" width="{cell - 1}" height="{cell - 1}"/>'
        )
        # Columns are named on the diagonal, where there is room.
        at = f'x="{room + cell * (i + 1) + 3:.0f}" y="{y + 16}"'
        parts.append(f'<text class="small" {at}>{html.escape(name)}</text>')
    return _svg(math.ceil(2 * room + cell * n + 4), cell * n + 8, parts)


def _shades(values: Array, highest: float) -> IntArray:
    """Return the class (n,) of colours, 0 to SHADES - 1, of values (n,) between 0 and ``highest``."""
    if highest <= 0.0:
        return np.zeros(len(values), dtype=np.intp)
    return np.clip((SHADES * values / highest).astype(np.intp), 0, SHADES - 1)


def _svg(width: int, height: int, parts: Sequence[str]) -> str:
    return f'<svg viewBox="0 0 {width} {height}" width="{width}" height="{height}">{"".join(parts)}</svg>'


def _axes(x: Axis, y: Axis, box: tuple[int, int, int, int]) -> list[str]:
    left, top, right, bottom = box
    parts = []
    for value, text in x.ticks():
        at = left + (right - left) * float(x.place(np.array(value)))
        parts.append(f'<path class="grid" d="M{at:.1f} {top}V{bottom}"/>')
        parts.append(
            f'<text class="tick" x="{at:.1f}" y="{bottom + 14}" text-anchor="middle">{html.escape(text)}</text>'
        )
    for value, text in y.ticks():
        at = bottom - (bottom - top) * float(y.place(np.array(value)))
        parts.append(f'<path class="grid" d="M{left} {at:.1f}H{right}"/>')
        parts.append(f'<text class="tick" x="{left - 5}" y="{at + 4:.1f}" text-anchor="end">{html.escape(text)}</text>')
    middle = (top + bottom) / 2
    parts.append(
        f'<text class="label" x="{(left + right) / 2:.0f}" y="{bottom + 32}" text-anchor="middle">'
        f"{html.escape(x.label)}</text>"
    )
    parts.append(
        f'<text class="label" transform="translate(11 {middle:.0f}) rotate(-90)" text-anchor="middle">'
        f"{html.escape(y.label)}</text>"
    )
    return parts


def _mark(mark: Mark, x: Axis, y: Axis, box: tuple[int, int, int, int]) -> list[str]:
    left, top, right, bottom = box

    def across(values: Array) -> Array:
        return np.asarray(left + (right - left) * x.place(values))

    def up(values: Array) -> Array:
        return np.asarray(bottom - (bottom - top) * y.place(values))

    if isinstance(mark, Level):
        at = float(up(np.array(mark.y)))
        return [
            f'<path class="level" d="M{left} {at:.1f}H{right}"/>',
            f'<text class="small" x="{left + 4}" y="{at - 4:.1f}">{html.escape(mark.text)}</text>',
        ]
    if isinstance(mark, Points):
        if not mark.x.size:
            return []
        d = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(across(mark.x), up(mark.y), strict=True))
        return [f'<path class="dot {mark.name}" stroke-width="{mark.size:g}" d="{d}"/>']
    if isinstance(mark, Curve):
        if not mark.x.size:
            return []
        d = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(across(mark.x), up(mark.y), strict=True))
        return [f'<path class="line {mark.name}" d="M{d}"/>']
    a, h = across(mark.edges), up(mark.heights)
    d = "".join(
        f"M{p:.1f} {bottom}V{q:.1f}H{r:.1f}V{bottom}Z" for p, q, r in zip(a[:-1], h, a[1:], strict=True) if q < bottom
    )
    return [f'<path class="bar {mark.name}" d="{d}"/>'] if d else []


def _step(x: float) -> float:
    """Return the number 1, 2 or 5 times a power of ten at or above ``x`` > 0."""
    power = math.floor(math.log10(x))
    return next(float(f"{m}e{power}") for m in (1, 2, 5, 10) if float(f"{m}e{power}") >= x * (1.0 - 1e-9))
