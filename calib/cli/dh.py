"""``calib dh``: a DH table to a URDF, and back."""

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.application import IN_WORDS, MORE, Telling, command
from calib.cli.options import argument, option, written
from calib.foundations.choices import Convention
from calib.foundations.words import counted
from calib_start import loading


@command("dh", MORE, "calib dh table.csv -o arm.urdf")
def dh(
    source: Annotated[Path, argument("FILE", "A DH table (.csv) or a URDF (.urdf).")],
    out: Annotated[Path, written("FILE", "The other one, to be written.")],
    tip: Annotated[str | None, option("--tip", "LINK", "Tip link of a URDF.")] = None,
    base: Annotated[str | None, option("--base", "LINK", "Base link of a URDF.")] = None,
    convention: Annotated[Convention | None, typer.Option(help="Convention of the table: standard by default.")] = None,
    telling: Telling = IN_WORDS,
) -> None:
    """Turn a DH table into a URDF, or a URDF into a table.

    The endings of the files decide: table.csv to arm.urdf, or the arm of arm.urdf to table.csv.
    """
    with loading():
        from calib.foundations.errors import JobError
        from calib.foundations.files import refuse_taken, write_new
        from calib.robot.dh.files import read_dh, write_dh
        from calib.robot.dh.frames import dh_of
        from calib.robot.dh.to_urdf import dh_to_urdf
        from calib.robot.load import load_robot
    kinds = {source.suffix.lower(), out.suffix.lower()}
    if kinds != {".csv", ".urdf"}:
        raise JobError(f"{source} to {out}: one must end in .csv, the DH table, and the other in .urdf.")
    refuse_taken(out)
    if out.suffix.lower() == ".urdf":
        if tip is not None or base is not None:
            raise JobError(f"{source}: a DH table names no links, so that --tip and --base are left out.")
        table = read_dh(source, convention)
        write_new(out, dh_to_urdf(table, out.stem))
    else:
        table = dh_of(load_robot(source, tip, base), convention or "standard")
        write_new(out, write_dh(table))
    telling.tell(
        lambda: {"file": str(out), **table.contents()},
        lambda: [f"{counted(len(table.rows), 'row')}, {table.convention} convention; the file is {out}."],
    )
