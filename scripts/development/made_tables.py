"""Tables of an arm as programs and people write them, at random: whatever layout, known numbers."""

import random
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scripts.studies.repositories import urdf_of

# Where each axis is in the frame before, in m, and its direction.
_AXES = (
    ((0.0, 0.0, 0.2), (0, 0, 1)),
    ((0.1, 0.0, 0.2), (0, 1, 0)),
    ((0.0, 0.0, 0.5), (0, 1, 0)),
    ((0.2, 0.0, 0.1), (1, 0, 0)),
    ((0.3, 0.0, 0.0), (0, 1, 0)),
    ((0.1, 0.0, 0.0), (1, 0, 0)),
)
URDF = urdf_of("made", _AXES)
_TOOL = np.array([0.05, -0.03, 0.12])
_BASE = np.array([1.5, -0.8, 0.3])


class Made(NamedTuple):
    """A table: ``name`` says how it is laid out; ``numbers`` (N, 9): angles and lengths as they stand in its rows."""

    name: str
    data: bytes
    numbers: NDArray[np.float64]


def _turn(axis: Sequence[int], angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations (N, 3, 3) about one of the axes of a frame."""
    i = list(axis).index(1)
    j, k = (i + 1) % 3, (i + 2) % 3
    R = np.zeros((len(angles), 3, 3))
    R[:, i, i] = 1.0
    R[:, j, j] = R[:, k, k] = np.cos(angles)
    R[:, k, j], R[:, j, k] = np.sin(angles), -np.sin(angles)
    return R


def _points(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the tool (N, 3) of an arm with errors of a millimetre is at readings (N, 6), in m."""
    p, R = np.zeros((len(q), 3)), np.broadcast_to(np.eye(3), (len(q), 3, 3))
    for k, (at, axis) in enumerate(_AXES):
        p = p + R @ (np.array(at) + 1e-3 * np.cos(k + np.arange(3)))
        R = R @ _turn(axis, q[:, k] + 1e-3 * np.sin(3.0 * k))
    return p + R @ _TOOL + _BASE


class _Layout(NamedTuple):
    separator: str
    comma: bool  # decimal commas
    thousands: str
    titles: str
    units: str
    header: str
    gap: str
    beside: str
    quoted: str
    comment: str
    footer: str
    end: str
    trailing: bool
    codec: str
    number: str


_TITLES: dict[str, Callable[[int], str]] = {
    "plain": lambda k: f"J{k + 1}" if k < 6 else "XYZ"[k - 6],
    "urdf": lambda k: f"joint_{k + 1}" if k < 6 else "xyz"[k - 6],
    "words": lambda k: f"Joint {k + 1} Position" if k < 6 else f"Measured {'XYZ'[k - 6]}",
    "ros": lambda k: f"position[{k}]" if k < 6 else f"pose.position.{'xyz'[k - 6]}",
    "kuka": lambda k: f"A{k + 1}" if k < 6 else f"Pos_{'XYZ'[k - 6]}",
    "zero": lambda k: f"q{k}" if k < 6 else f"tcp_{'xyz'[k - 6]}",
}
_UNITS = {"square": " [{}]", "round": " ({})", "stroke": "/{}", "under": "_{}", "below": "", "above": "", "none": ""}
_CHOICES: dict[str, tuple[object, ...]] = {
    "separator": (",", ",", ";", ";", "\t", " ", "  ", "|", ", ", " ; "),
    "comma": (False, False, True),
    "thousands": ("", "", "", "", "", ",", ".", " ", "'", "\u00a0"),
    "titles": tuple(_TITLES),
    "units": tuple(_UNITS),
    "header": ("one", "one", "one", "none", "comment", "lines", "blank", "key", "date"),
    "gap": ("", "", "", "", "nan", "empty", "NA", "N/A", "-", "null", "inf"),
    "beside": ("", "", "index", "name", "time", "date", "clock", "temperature", "sigma", "commanded", "empty"),
    "quoted": ("", "", "", "words", "all", "titles"),
    "comment": ("", "", "", "#", "//", "%", ";"),
    "footer": ("", "", "", "", "mean", "end", "count", "blank", "separators"),
    "end": ("\n", "\n", "\r\n", "\r"),
    "trailing": (False, False, False, True),
    "codec": ("utf-8", "utf-8", "utf-8-sig", "utf-16", "utf-16-be", "cp1252"),
    "number": ("{:.6f}", "{:.9g}", "{:.3f}", "{:.8e}", "{:+.4f}"),
}


def made(seed: int) -> Made:
    """Return the table of a number."""
    chance = random.Random(seed)
    layout = _Layout(**{name: chance.choice(of) for name, of in _CHOICES.items()})  # type: ignore[arg-type]
    apart = layout.separator.strip(" ") or " \u00a0"
    if layout.thousands and (layout.thousands in apart or layout.thousands == ("," if layout.comma else ".")):
        layout = layout._replace(thousands="")
    degrees, mm, rows = chance.random() < 0.6, chance.random() < 0.7, chance.choice((3, 12, 30, 60))
    q = np.random.default_rng(seed).uniform(-1.5, 1.5, (rows, 6))
    values = np.column_stack([np.degrees(q) if degrees else q, (1e3 if mm else 1.0) * _points(q)])
    plain = [[layout.number.format(one) for one in row] for row in values.tolist()]
    numbers = np.array([[float(cell) for cell in row] for row in plain])
    cells = [[_written(cell, layout) for cell in row] for row in plain]
    if layout.gap and rows > 3:
        row, column = chance.randrange(rows), chance.randrange(9)
        cells[row][column] = "" if layout.gap == "empty" else layout.gap
        numbers[row, column] = np.nan
    units = ["deg" if degrees else "rad"] * 6 + ["mm" if mm else "m"] * 3
    lines = _lines(cells, units, layout)
    text = layout.end.join(lines) + ("" if chance.random() < 0.1 else layout.end)
    data = text.encode(layout.codec, errors="replace")
    if layout.codec == "utf-16-be":
        data = b"\xfe\xff" + data
    said = "_".join(
        f"{name}={value!r}" for name, value in layout._asdict().items() if value not in ("", False, "utf-8", "\n")
    )
    name = f"{seed:05d}_" + "".join(letter if letter.isalnum() or letter in "=_-" else "." for letter in said)
    return Made(f"{name[:200]}.{chance.choice(('csv', 'txt'))}", data, numbers)


def _written(cell: str, layout: _Layout) -> str:
    mantissa, mark, exponent = cell.partition("e")
    whole, point, decimals = mantissa.partition(".")
    sign, digits = (whole[0], whole[1:]) if whole[0] in "+-" else ("", whole)
    if layout.thousands and len(digits) > 3:
        digits = f"{digits[:-3]}{layout.thousands}{digits[-3:]}"
    return f"{sign}{digits}{',' if layout.comma and point else point}{decimals}{mark}{exponent}"


def _beside(kind: str, k: int) -> tuple[str, str]:
    """The title and the cell of a column that is neither a joint nor measured, in front of all."""
    return {
        "index": ("", str(k)),
        "name": ("Point", f"P{k + 1}"),
        "time": ("time [s]", f"{0.5 * k:.3f}"),
        "date": ("Date", f"2024-03-{k % 28 + 1:02d} 10:{k % 60:02d}:07"),
        "clock": ("Time", f"10:{k % 60:02d}:07.250"),
        "temperature": ("temperature [degC]", f"{20.0 + 0.1 * k:.1f}"),
        "sigma": ("Std", "0.012"),
        "commanded": ("commanded", "yes" if k % 2 else "no"),
        "empty": ("Note", ""),
    }[kind]


def _lines(cells: Sequence[Sequence[str]], units: Sequence[str], layout: _Layout) -> list[str]:
    titles = [_TITLES[layout.titles](k) for k in range(9)]
    titles = [title + _UNITS[layout.units].format(unit) for title, unit in zip(titles, units, strict=True)]
    rows = [list(row) for row in cells]
    row_of_units = [f"[{unit}]" if layout.separator != " " else unit for unit in units]
    if layout.beside:
        titles.insert(0, _beside(layout.beside, 0)[0])
        row_of_units.insert(0, "")
        for k, row in enumerate(rows):
            row.insert(0, _beside(layout.beside, k)[1])
    if layout.quoted:
        titles = [f'"{title}"' for title in titles]
        rows = [
            [
                f'"{cell}"' if layout.quoted == "all" or (layout.quoted == "words" and cell[:1].isalpha()) else cell
                for cell in row
            ]
            for row in rows
        ]
    head = [titles]
    if layout.units == "below":
        head.append(row_of_units)
    elif layout.units == "above":
        head.insert(0, row_of_units)
    tail = layout.separator.strip(" ") if layout.trailing else ""
    above = [layout.separator.join(row) + tail for row in head]
    below = [layout.separator.join(row) + tail for row in rows]
    match layout.header:
        case "none":
            above = []
        case "comment":
            above = [f"# {line}" for line in above]
        case "lines":
            above = ["Measurement report, cell 4", "Operator: N. N.", "", *above]
        case "blank":
            above = ["", *above, ""]
        case "key":
            above = [f"Robot{layout.separator}IRB 2600", f"Points{layout.separator}{len(rows)}", *above]
        case "date":
            above = ["Exported 2024-03-01 10:00:07", *above]
    if layout.comment:
        below.insert(len(below) // 2, f"{layout.comment} the arm was stopped here")
    match layout.footer:
        case "mean":
            below.append(layout.separator.join(["Mean", *rows[0][1:]]) + tail)
        case "end":
            below.append("End of file")
        case "count":
            below.append(f"{len(rows)} points")
        case "blank":
            below += ["", ""]
        case "separators":
            below.append(layout.separator * (len(rows[0]) - 1) + tail)
    return [*above, *below]
