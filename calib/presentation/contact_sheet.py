"""A contact sheet: small copies of all photographs, with what was found in each drawn over it."""

import base64
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

from calib.foundations.arrays import Array

_STYLE = (
    "body{font-family:sans-serif;margin:1.5em;background:#fff;color:#222}"
    "main{display:grid;grid-template-columns:repeat(auto-fill,minmax(300px,1fr));gap:1em}"
    "figure{margin:0}svg{width:100%;height:auto;background:#ddd}figcaption{font-size:.85em}"
    ".out{color:#a40000}.out svg{opacity:.5}"
)


class Shot(NamedTuple):
    """One photograph: its name, size (w, h) in px, a JPEG, corners (n, 2) in px, their sigmas (n,), why it is out."""

    name: str
    size: tuple[int, int]
    jpeg: bytes
    corners: Array
    sigma: Array
    left_out: str


def contact_sheet(title: str, shots: Sequence[Shot]) -> str:
    """Return a page of photographs; it needs no other file and runs no script."""
    figures = "\n".join(map(_figure, shots))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; '
        "style-src 'unsafe-inline'\">"
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>\n<body><h1>{escape(title)}</h1>\n"
        f"<main>\n{figures}\n</main></body></html>\n"
    )


def _figure(shot: Shot) -> str:
    w, h = shot.size
    said = f"{len(shot.corners)} corners"
    if len(shot.sigma):
        said += f", sigma {float(shot.sigma.mean()):.3f} px"
    if shot.left_out:
        said = f"left out: {shot.left_out}"
    if not (w and h and shot.jpeg):
        return f'<figure class="out"><figcaption>{escape(shot.name)}: {escape(said)}</figcaption></figure>'
    picture = base64.b64encode(shot.jpeg).decode()
    r = 0.006 * w
    rings = "".join(f'<circle cx="{u:.1f}" cy="{v:.1f}" r="{r:.1f}"/>' for u, v in shot.corners.tolist())
    return (
        f'<figure{" class=out" if shot.left_out else ""}><svg viewBox="0 0 {w} {h}">'
        f'<image width="{w}" height="{h}" href="data:image/jpeg;base64,{picture}"/>'
        f'<g fill="none" stroke="#e05a00" stroke-width="{0.3 * r:.1f}">{rings}</g></svg>'
        f"<figcaption>{escape(shot.name)}: {escape(said)}</figcaption></figure>"
    )
