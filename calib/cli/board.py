"""``calib board``: a board to print, and its board.toml."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from calib.cli.application import IN_WORDS, PREPARE, Telling, command
from calib.cli.options import option, refuse_idle, written
from calib_start import loading

# A chessboard of an odd number either way, or an even one, looks the same upside down.
_SQUARES = {True: "7x5", False: "8x5"}
_MARKER = "22 mm"
_DICTIONARY = "DICT_4X4_50"


@command("board", PREPARE, "calib board -o board/")
def board(
    out: Annotated[Path, written("FOLDER", "New folder for what is to be printed.")],
    kind: Annotated[str, typer.Option("--kind", help="charuco or chessboard.")] = "charuco",
    squares: Annotated[
        str | None, option("--squares", "NxM", "Squares across and down.  [default: 7x5; 8x5 of a chessboard]")
    ] = None,
    square: Annotated[str, typer.Option("--square", help="Side of a square.")] = "30 mm",
    marker: Annotated[str, typer.Option("--marker", help="Side of a marker.")] = _MARKER,
    dictionary: Annotated[
        str, typer.Option("--dictionary", help="OpenCV's name of the markers, like DICT_APRILTAG_36h11.")
    ] = _DICTIONARY,
    telling: Telling = IN_WORDS,
) -> None:
    """Write a board to print, as PDF and SVG.

    Both are at true size; board.toml names what is printed. Markers need OpenCV: python -m pip install
    "urdf-calib[vision]". Exit codes: 0 good, 1 bad input, 2 wrong usage.
    """
    with loading():
        from calib.foundations.errors import JobError
        from calib.foundations.folders import refuse_unwritable, write_folder
        from calib.foundations.ranges import RANGES, parse_within
        from calib.job.read import board_toml
        from calib.measurement.formats.images import marker_bits
        from calib.measurement.prints import Print
        from calib.presentation.printed_board import drawing, pdf, svg
    refuse_unwritable(out)
    allowed, with_markers = RANGES["square, marker"], kind != "chessboard"
    if not with_markers:
        given = {"--marker": marker != _MARKER, "--dictionary": dictionary != _DICTIONARY}
        refuse_idle("a chessboard has no markers.", given)
    print_ = Print(
        _kind(kind),
        _counts(_SQUARES[with_markers] if squares is None else squares),
        parse_within(square, allowed, "--square"),
        parse_within(marker, allowed, "--marker") if with_markers else 0.0,
        dictionary if with_markers else "",
    )
    if print_.half_turn is not None:
        across, down = print_.squares
        raise JobError(
            f"--squares: a chessboard of {across} x {down} squares looks the same upside down; make one number odd and "
            "the other one even."
        )
    of = drawing(print_, marker_bits(print_) if with_markers else ())
    write_folder(out, {"board.pdf": pdf(of), "board.svg": svg(of), "board.toml": board_toml(print_)})
    width, height = of.size
    said = f"{out} holds board.pdf and board.svg, {width:g} x {height:g} mm, and board.toml. Print at 100 %."
    telling.tell(lambda: {"folder": str(out), "size": [width, height], "marks": len(print_.marks)}, lambda: [said])


def _kind(text: str) -> Literal["charuco", "chessboard"]:
    from calib.foundations.errors import JobError
    from calib.foundations.words import shown

    if text == "charuco":
        return "charuco"
    if text == "chessboard":
        return "chessboard"
    raise JobError(f"--kind: {shown(text)} is not charuco or chessboard.")


def _counts(text: str) -> tuple[int, int]:
    from calib.foundations.errors import JobError
    from calib.foundations.words import shown

    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isascii() and part.isdigit() and len(part) < 4 for part in parts):
        raise JobError(f"--squares: {shown(text)} is not two whole numbers below 1000, like 7x5.")
    return int(parts[0]), int(parts[1])
