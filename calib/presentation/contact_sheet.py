"""A contact sheet: small copies of all photographs, with what was found in each drawn over it."""

import base64
from collections.abc import Sequence
from typing import NamedTuple

from calib.foundations.arrays import Array
from calib.foundations.words import counted
from calib.presentation.page_files import template


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
    pictures = [base64.b64encode(shot.jpeg).decode() if all(shot.size) else "" for shot in shots]
    return template("contact_sheet.html.jinja").render(
        title=title, shots=list(zip(shots, map(_said, shots), pictures, strict=True))
    )


def _said(shot: Shot) -> str:
    if shot.left_out:
        return f"left out: {shot.left_out}"
    sigma = f", sigma {float(shot.sigma.mean()):.3f} px" if len(shot.sigma) else ""
    return f"{counted(len(shot.corners), 'corner')}{sigma}"
