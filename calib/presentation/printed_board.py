"""A board as it is printed: SVG and PDF at true size, with a ruler that tells whether the printer kept it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import BoolArray
from calib.foundations.units import INCH, MM
from calib.measurement.prints import Print

# White around the board and below it for the ruler, in mm.
_MARGIN, _FOOT, _TICK, _LETTERS = 10.0, 22.0, 10.0, 3.0
_POINT = INCH / MM / 72.0


class Box(NamedTuple):
    """A black rectangle, in mm from the upper left corner of the sheet: x and y of its upper left corner, its sides."""

    x: float
    y: float
    width: float
    height: float


class Line(NamedTuple):
    """A line of text, in mm: x and y of its lower left corner."""

    x: float
    y: float
    text: str


class Drawing(NamedTuple):
    """What is black on a sheet of a size in mm."""

    size: tuple[float, float]
    boxes: tuple[Box, ...]
    lines: tuple[Line, ...]


def drawing(print_: Print, markers: Sequence[BoolArray]) -> Drawing:
    """Return a board as black rectangles; ``markers``: the cells of its markers, True where white, in their order."""
    across, down = print_.squares
    side, boxes, number = print_.square / MM, [], 0
    for j in range(down):
        for i in range(across):
            x, y = _MARGIN + i * side, _MARGIN + j * side
            if (i + j) % 2 == 0:
                boxes.append(Box(x, y, side, side))
            elif markers:
                edge = 0.5 * (side - print_.marker / MM)
                boxes += _marker(x + edge, y + edge, print_.marker / MM, markers[number])
                number += 1
    width, height = across * side, down * side
    ruler, lines = _ruler(_MARGIN, _MARGIN + height + 6.0, width)
    kind = print_.dictionary or "chessboard"
    said = f"{across} x {down} squares of {side:g} mm" + (f", markers of {print_.marker / MM:g} mm" if markers else "")
    lines.append(Line(_MARGIN, _MARGIN + height + 20.0, f"{kind}, {said}. Print at 100 %, and measure the ruler."))
    return Drawing((width + 2.0 * _MARGIN, height + _MARGIN + _FOOT + 4.0), (*boxes, *ruler), tuple(lines))


def _marker(x: float, y: float, side: float, white: BoolArray) -> list[Box]:
    """Return the black cells of a marker, those of a row in one piece."""
    cell, found = side / len(white), []
    for j, row in enumerate(white):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], ~row, [False]]).astype(np.int8)))
        found += [Box(x + a * cell, y + j * cell, (b - a) * cell, cell) for a, b in edges.reshape(-1, 2).tolist()]
    return found


def _ruler(x: float, y: float, width: float) -> tuple[list[Box], list[Line]]:
    """Return a ruler as long as whole centimetres fit, and its numbers."""
    length = int(width // _TICK) * _TICK
    boxes, lines = [Box(x, y, length, 0.2)], []
    for k in range(int(length // _TICK) + 1):
        at = x + k * _TICK
        boxes.append(Box(at - 0.1, y, 0.2, 4.0 if k % 5 == 0 else 2.5))
        if k % 5 == 0 or k == int(length // _TICK):
            lines.append(Line(at - 1.5, y + 8.0, f"{k * _TICK:g}" + (" mm" if k == 0 else "")))
    return boxes, lines


def svg(of: Drawing) -> str:
    """Return a drawing as SVG at true size."""
    width, height = of.size
    boxes = "".join(f"M{_n(b.x)} {_n(b.y)}h{_n(b.width)}v{_n(b.height)}h{_n(-b.width)}z" for b in of.boxes)
    text = "".join(
        f'<text x="{_n(one.x)}" y="{_n(one.y)}" font-size="{_LETTERS:g}" font-family="sans-serif">{one.text}</text>\n'
        for one in of.lines
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_n(width)}mm" height="{_n(height)}mm" '
        f'viewBox="0 0 {_n(width)} {_n(height)}" shape-rendering="crispEdges">\n'
        f'<rect width="{_n(width)}" height="{_n(height)}" fill="#fff"/>\n<path d="{boxes}"/>\n{text}</svg>\n'
    )


def pdf(of: Drawing) -> bytes:
    """Return a drawing as a PDF of one page at true size."""
    width, height = (length / _POINT for length in of.size)
    parts = ["0 g"]
    for box in of.boxes:
        x, y, w, h = (length / _POINT for length in box)
        parts.append(f"{_n(x)} {_n(height - y - h)} {_n(w)} {_n(h)} re")
    parts.append("f")
    parts += [
        f"BT /F1 {_n(_LETTERS / _POINT)} Tf {_n(line.x / _POINT)} {_n(height - line.y / _POINT)} Td ({line.text}) Tj ET"
        for line in of.lines
    ]
    content = "\n".join(parts).encode("ascii")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {_n(width)} {_n(height)}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode("ascii"),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    out, starts = bytearray(b"%PDF-1.4\n"), []
    for k, body in enumerate(objects, start=1):
        starts.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (k, body)
    table = b"".join(b"%010d 00000 n \n" % start for start in starts)
    out += b"xref\n0 %d\n0000000000 65535 f \n%strailer\n" % (len(objects) + 1, table)
    out += b"<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, out.index(b"xref\n"))
    return bytes(out)


def _n(value: float) -> str:
    """Return a number without a tail of zeros: a ten-thousandth of a millimetre is enough."""
    return f"{value:.4f}".rstrip("0").rstrip(".")
